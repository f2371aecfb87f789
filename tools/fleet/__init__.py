"""Fleets of simulated robots: does taut fleet find who is worn, and does what it learns shorten a calibration?"""
