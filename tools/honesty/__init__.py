"""The honesty benchmark: instruments, clocks and files that share no code with the library, and what a calibration says of them."""
