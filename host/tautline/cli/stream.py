"""taut stream"""

from __future__ import annotations

import math
import selectors
import sys
import time

import click

from tautline.cli._common import emit, json_option
from tautline.cli._live import axis_option, board_option
from tautline.errors import TautError


@click.command("stream")
@board_option
@axis_option
@click.option(
    "--rate", type=click.FloatRange(50.0, 1000.0), default=250.0, show_default=True, help="Set-points per second."
)
@click.option(
    "--silence", type=click.FloatRange(0.01, 2.0), default=0.1, show_default=True, help="s after which it rests."
)
@click.option(
    "--sine", type=(float, float), metavar="DEG SECONDS", help="Instead of stdin: a sine, amplitude and period."
)
@click.option("--duration", type=click.FloatRange(min=0.1), help="s; default until stdin or Ctrl-C ends it.")
@json_option
def command(
    board: str | None,
    axis: int,
    rate: float,
    silence: float,
    sine: tuple[float, float] | None,
    duration: float | None,
    as_json: bool,
) -> None:
    """Send tip set-points, deg, to one axis through its tables: one number a line on stdin, the newest counts.

    While stdin says nothing new for longer than --silence, nothing is sent, and the board brings the axis to rest.
    """
    from tautline.board import open_board
    from tautline.stream import SetPoints

    with open_board(board) as opened, SetPoints(opened, axis, silence) as points:
        began = time.monotonic()
        newest, fresh, ended = points.start_deg, 0.0, False
        inputs = selectors.DefaultSelector()
        if sine is None:
            inputs.register(sys.stdin, selectors.EVENT_READ)
        try:
            while not ended and (duration is None or time.monotonic() - began < duration):
                now = time.monotonic()
                if sine is not None:
                    newest, fresh = points.start_deg + sine[0] * math.sin(2 * math.pi * (now - began) / sine[1]), now
                elif inputs.select(0):
                    line = sys.stdin.readline()
                    ended = not line
                    if line.strip():
                        newest, fresh = _number(line), now
                if now - fresh < silence:
                    points.send(newest)
                points.pace(1.0 / rate)
        except KeyboardInterrupt:
            pass
    emit(
        points.summary(),
        as_json,
        f"{points.sent} set-points in {points.seconds:.1f} s ({points.rate_hz:.0f} Hz), {points.late} late, "
        f"{points.refused} refused",
    )


def _number(line: str) -> float:
    try:
        value = float(line)
    except ValueError:
        raise TautError(f"stdin: {line.strip()!r} is not a number: send one bending angle in deg a line") from None
    if not math.isfinite(value):
        raise TautError("stdin: the bending angle must be finite")
    return value
