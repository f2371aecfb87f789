"""A rig.toml out of pictures of a board and a motion through known angles."""

from tautline.rigging.board import DICTIONARIES, Board, Intrinsics, intrinsics
from tautline.rigging.places import Places, fit_coarse_law, places_of, read_known_angles
from tautline.rigging.pose import HandEyeFit, hand_eye

__all__ = [
    "DICTIONARIES",
    "Board",
    "HandEyeFit",
    "Intrinsics",
    "Places",
    "fit_coarse_law",
    "hand_eye",
    "intrinsics",
    "places_of",
    "read_known_angles",
]
