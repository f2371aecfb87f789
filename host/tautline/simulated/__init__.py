"""The simulated world: instrument, endoscope, motions and the board that drives it."""
