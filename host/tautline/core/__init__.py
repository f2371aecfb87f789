"""What calibration, diagnosis, tracking and prediction stand on: one clock, one motor path, one uncertainty."""
