"""A user's own simulator in the motor's place: where it puts the tip is what a diagnosis begins with."""

from tautline.simulators.simulator import Declared, Simulator

__all__ = ["Declared", "Simulator"]
