"""Does a model stay calibrated in use? Sessions of teleoperation with instruments that share no code with it."""
