"""The live page: a calibration, or a recording of one, in a browser on this machine."""
