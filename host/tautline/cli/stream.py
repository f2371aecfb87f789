"""taut stream"""

from __future__ import annotations

import math
import os
import selectors
import signal
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tautline.cli._common import emit, force_option, json_option, refuse_unusable
from tautline.cli._live import axis_option, board_option
from tautline.errors import TautError
from tautline.model import Model

if TYPE_CHECKING:
    from tautline.device.board import Board


@click.command("stream")
@click.argument("model_path", metavar="[MODEL]", required=False, type=click.Path(path_type=Path))
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
@force_option
@json_option
def command(
    model_path: Path | None,
    board: str | None,
    axis: int,
    rate: float,
    silence: float,
    sine: tuple[float, float] | None,
    duration: float | None,
    force: bool,
    as_json: bool,
) -> None:
    """Send tip set-points, deg, to one axis through its tables: one number a line on stdin, the newest counts.

    With MODEL, its tables are loaded first; without, those in the board are used as they are.

    While stdin says nothing new for longer than --silence, nothing is sent, and the board brings the axis to rest.
    """
    from tautline.device.board import open_board
    from tautline.device.stream import SetPointStream

    model = None if model_path is None else Model.load(model_path)
    if model is not None and model_path is not None:
        refuse_unusable(model, model_path, force)
    ended = False

    def stop(number: int, frame: object) -> None:
        nonlocal ended
        ended = True  # between two messages, not in the middle of one

    before = signal.signal(signal.SIGINT, stop)
    try:
        with open_board(board) as opened, SetPointStream(_loaded(opened, axis, model), axis, silence) as points:
            began = time.monotonic()
            newest, fresh = points.start_deg, 0.0
            lines = _Lines() if sine is None else None
            while not ended and (duration is None or time.monotonic() - began < duration):
                now = time.monotonic()
                if sine is not None:
                    newest, fresh = points.start_deg + sine[0] * math.sin(2 * math.pi * (now - began) / sine[1]), now
                elif lines is not None and (line := lines.newest()) is not None:
                    newest, fresh = _number(line), now
                if now - fresh < silence:
                    points.send(newest)
                points.pace(1.0 / rate)
                ended = ended or (lines is not None and lines.ended)
    finally:
        signal.signal(signal.SIGINT, before)
    emit(
        points.summary(),
        as_json,
        f"{points.sent} set-points in {points.seconds:.1f} s ({points.rate_hz:.0f} Hz), {points.late} late, "
        f"{points.refused} refused",
    )


def _loaded(board: Board, axis: int, model: Model | None) -> Board:
    """The board with the model's tables in the axis."""
    if model is not None:
        from tautline import tables

        board.load_table(axis, tables.encode(model, axis=axis))
    return board


class _Lines:
    """Standard input, never waited for."""

    def __init__(self) -> None:
        self._inputs = selectors.DefaultSelector()
        self._inputs.register(sys.stdin, selectors.EVENT_READ)
        self._rest = b""
        self.ended = False

    def newest(self) -> str | None:
        """The last whole line that came since, None where there is none."""
        last = None
        while not self.ended and self._inputs.select(0):
            data = os.read(sys.stdin.fileno(), 1 << 16)
            self.ended = not data
            *whole, self._rest = (self._rest + data).split(b"\n")
            last = next((line for line in reversed(whole) if line.strip()), last)
        return last.decode("utf-8", "replace") if last is not None else None


def _number(line: str) -> float:
    try:
        value = float(line)
    except ValueError:
        raise TautError(f"stdin: {line.strip()!r} is not a number: send one bending angle in deg a line") from None
    if not math.isfinite(value):
        raise TautError("stdin: the bending angle must be finite")
    return value
