"""Teleoperation from Python: sends the tip's bending angle to a board 250 times a second.

    python tools/examples/stream.py [--board usbip:127.0.0.1:3240] [--axis 0] [--seconds 5]

Put your own master device where `demand` is. When the sender stops or hangs, the board brings the axis to rest.
"""

from __future__ import annotations

import argparse
import math

from tautline.device.board import open_board
from tautline.device.stream import SetPointStream

RATE_HZ = 250.0


def demand(t_s: float) -> float:
    """Where the tip shall be at t_s, deg from where it was at the start."""
    return 10.0 * math.sin(2.0 * math.pi * t_s / 4.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--board", help="serial number, or usbip:HOST:PORT; default: the only one attached")
    parser.add_argument("--axis", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=5.0)
    options = parser.parse_args()
    with open_board(options.board) as board, SetPointStream(board, options.axis) as points:
        while points.seconds < options.seconds:
            points.send(points.start_deg + demand(points.seconds))
            points.pace(1.0 / RATE_HZ)
    print(f"{points.sent} set-points in {points.seconds:.2f} s, {points.late} late, {points.refused} refused")


if __name__ == "__main__":
    main()
