"""Whether calibration and diagnosis give one name to what was there from the first recording on."""
