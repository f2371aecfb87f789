"""The honesty benchmark: what a calibration says of instruments, clocks and files that share no code with it."""
