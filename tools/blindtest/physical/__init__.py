"""Instruments that MuJoCo simulates: bodies, springs, dampers, friction, contact and tendons, none of the library's
equations. Each topology of mechanism.py is a generator of blind cases (cases.py)."""
