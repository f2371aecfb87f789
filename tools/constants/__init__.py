"""Do a calibration's verdicts hang on the numbers that were chosen? `./run bench constants`."""
