"""`taut ros` in a process of its own, with a camera by the wall clock on a paced board where there is a sim link.

python ros_node.py SIM_PORT|- ARGUMENT...
"""

import sys

import numpy as np
from wall_camera import Reader, WallCamera

from tautline.cli import main
from tautline.live import setup
from tautline.simulated.instrument import Instrument, reference_rig
from tautline.simulated.simlink import SimLink
from tautline.vision.colour import MarkerColour

WIDTH_MM = 0.4


def instrument() -> Instrument:
    return Instrument.of(reference_rig(), lambda p: WIDTH_MM + 0 * p, lambda p: 12.0 * p + 0.4 * np.sin(p))


if __name__ == "__main__":
    port, *arguments = sys.argv[1:]
    if port != "-":
        plant = instrument()
        setup.VideoCamera = lambda *_, **__: WallCamera(SimLink(int(port)), plant)  # type: ignore
        setup.MarkerTracker = lambda _: Reader()  # type: ignore
        MarkerColour.load = classmethod(lambda cls, path: object())  # type: ignore
    sys.argv = ["taut", "ros", *arguments]
    main()
