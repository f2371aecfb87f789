"""taut stream"""

from __future__ import annotations

import math
import os
import selectors
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tautline.cli._common import (
    Number,
    NumberRange,
    emit,
    force_option,
    json_option,
    read_rig,
    refuse_unusable,
    rig_option,
    warn,
    warn_tracked_alone,
)
from tautline.cli._live import (
    RECALLS,
    axis_option,
    board_option,
    camera_option,
    colour_option,
    recall_shape,
    shape_text,
    shapes_option,
    tracking_text,
)
from tautline.errors import TautError
from tautline.model import Model

if TYPE_CHECKING:
    from tautline.device.board import Board
    from tautline.device.stream import SetPointStream
    from tautline.live.in_use import Following
    from tautline.shapes import Library


@click.command("stream")
@click.argument("model_path", metavar="[MODEL]", required=False, type=click.Path(path_type=Path))
@board_option
@axis_option
@camera_option
@colour_option
@rig_option
@shapes_option(RECALLS)
@click.option("--rate", type=NumberRange(50.0, 1000.0), default=250.0, show_default=True, help="Set-points per second.")
@click.option("--silence", type=NumberRange(0.01, 2.0), default=0.1, show_default=True, help="s after which it rests.")
@click.option(
    "--sine",
    type=(Number(), NumberRange(min=0.0, min_open=True)),
    metavar="DEG SECONDS",
    help="Instead of stdin: a sine, amplitude and period.",
)
@click.option("--duration", type=NumberRange(min=0.1), help="s; default until stdin or Ctrl-C ends it.")
@force_option
@json_option
def command(
    model_path: Path | None,
    board: str | None,
    axis: int,
    camera: str | None,
    colour: Path,
    rig_path: Path | None,
    library_path: Path | None,
    rate: float,
    silence: float,
    sine: tuple[float, float] | None,
    duration: float | None,
    force: bool,
    as_json: bool,
) -> None:
    """Send tip set-points, deg, to one axis through its tables: one number a line on stdin, the newest counts.

    With MODEL, its tables are loaded first; without, those in the board are used as they are. With MODEL and --camera
    the model is kept calibrated meanwhile: the tables' offset and width follow what is learnt, as far as they allow.

    With --shapes as well the model is one of a library's, and another shape that the shaft takes is named.

    While stdin says nothing new for longer than --silence, nothing is sent, and the board brings the axis to rest.
    """
    from tautline.device.stream import SetPointStream
    from tautline.shapes import Library

    model = None if model_path is None else Model.load(model_path)
    library = None if library_path is None else Library.load(library_path)
    if model is not None and model_path is not None:
        refuse_unusable(model, model_path, force)
    if library is not None and camera is None:
        raise click.UsageError("a shape is told by what the camera sees: name --camera")
    if camera is not None and model is None and library is None:
        raise click.UsageError("--camera keeps a model calibrated: name MODEL")
    with ExitStack() as stack:
        stopped = stack.enter_context(_stop_on_interrupt())
        opened, following = _open_board(stack, board, axis, model, camera, colour, rig_path, library, force)
        points = stack.enter_context(SetPointStream(opened, axis, silence))
        _send_until_ended(points, sine, rate, silence=silence, duration=duration, stopped=stopped)
    tracking = None if following is None else following.summary()
    if following is not None and (following.lost or following.beyond):
        warn(following.lost or following.beyond)
    text = (
        f"{points.sent} set-points in {points.seconds:.1f} s ({points.rate_hz:.0f} Hz), {points.late} late, "
        f"{points.refused} refused"
    )
    emit(
        points.summary() | {"tracking": tracking},
        as_json,
        text if tracking is None else f"{text}; {tracking_text(tracking)}{shape_text(tracking, library)}",
    )


@contextmanager
def _stop_on_interrupt() -> Iterator[Callable[[], bool]]:
    """A context that yields a function which returns whether Ctrl-C (SIGINT) came. Within the context Ctrl-C does
    nothing else, so that it takes effect between two messages; at its end the earlier handler is restored."""
    came = False

    def stop(number: int, frame: object) -> None:
        """The handler of SIGINT: notes that it came."""
        nonlocal came
        came = True

    before = signal.signal(signal.SIGINT, stop)
    try:
        yield lambda: came
    finally:
        signal.signal(signal.SIGINT, before)


def _send_until_ended(
    points: SetPointStream,
    sine: tuple[float, float] | None,
    rate: float,
    silence: float,
    duration: float | None,
    stopped: Callable[[], bool],
) -> None:
    """Sends set-points of the tip, deg, at `rate`, Hz, until `stopped()` is true, `duration`, s, is over (None: never),
    or stdin has ended. With `sine`, an amplitude in deg and a period in s, they are a sine about the tip's angle at the
    start; without, the newest number on stdin. Nothing is sent where that number is older than `silence`, s."""
    began = time.monotonic()
    newest_deg, came_s = points.start_deg, 0.0
    lines = _Lines() if sine is None else None
    while not stopped() and (duration is None or time.monotonic() - began < duration):
        now = time.monotonic()
        if sine is not None:
            amplitude, period_s = sine
            newest_deg = points.start_deg + amplitude * math.sin(2 * math.pi * (now - began) / period_s)
            came_s = now
        elif lines is not None and (line := lines.newest()) is not None:
            newest_deg, came_s = _number(line), now
        if now - came_s < silence:
            points.send(newest_deg)
        points.pace(1.0 / rate)
        if lines is not None and lines.ended:
            return


def _open_board(
    stack: ExitStack,
    where: str | None,
    axis: int,
    model: Model | None,
    camera: str | None,
    colour: Path,
    rig_path: Path | None,
    library: Library | None,
    force: bool,
) -> tuple[Board, Following | None]:
    """Opens the board at the address `where`, which the stack closes, and loads the model's tables into the axis;
    without a model the axis keeps its tables. Returns the board and a tracker. With a camera the tracker, which keeps
    the model calibrated, is started; without one it is None. With a library and no model, a short motion finds which
    shape the shaft has now, and that shape's model is used; force: even if it is unusable."""
    from tautline.device.board import open_board
    from tautline.live.in_use import Following, TableMover, load_tables, tracking_beside

    model_of_rig = model if model is not None or library is None else library.first()
    if camera is None or model_of_rig is None:
        own_rig = None if rig_path is None else read_rig(rig_path)
        rig_or_none = own_rig or (model.rig if model is not None else None)
        rigs_board = None if rig_or_none is None else rig_or_none.actuator.board
        board = stack.enter_context(open_board(where or rigs_board))
        if model is not None:
            load_tables(board, axis, model)
        return board, None
    from tautline.live.setup import open_live
    from tautline.vision.colour import MarkerColour

    rig = model_of_rig.rig if rig_path is None else read_rig(rig_path)
    seen_as = MarkerColour.load(colour)
    live = stack.enter_context(open_live(board=where, camera=camera, rig=rig, axis=axis, colour=seen_as))
    if model is None and library is not None:
        model, folder = recall_shape(live, library)
        refuse_unusable(model, folder, force)
    assert model is not None  # named, or a library's
    load_tables(live.board, axis, model)
    warn_tracked_alone(model)
    following = Following(live, model, mover=TableMover(live), library=library)
    return live.board, stack.enter_context(tracking_beside(following))


class _Lines:
    """Reads lines from standard input without waiting for them."""

    def __init__(self) -> None:
        """Prepares for reading from standard input, which may also be a file."""
        self._inputs = selectors.SelectSelector()  # other selectors refuse a file
        self._inputs.register(sys.stdin, selectors.EVENT_READ)
        self._rest = b""  # beginning of a line whose end has not come yet
        self.ended = False  # whether standard input has ended

    def newest(self) -> str | None:
        """Reads all that has come since the last call and returns the last complete line that is not blank; None where
        there is none. It sets `ended` at the end of the input, where a line without its line feed counts as
        complete."""
        last = None
        while not self.ended and self._inputs.select(0):
            data = os.read(sys.stdin.fileno(), 1 << 16)
            self.ended = not data
            lines = (self._rest + data).split(b"\n")
            self._rest = b"" if self.ended else lines.pop()
            last = next((line for line in reversed(lines) if line.strip()), last)
        return last.decode("utf-8", "replace") if last is not None else None


def _number(line: str) -> float:
    """Parses a line of stdin as a bending angle, deg. TautError where it is not a finite number."""
    try:
        value = float(line)
    except ValueError:
        raise TautError(f"stdin: {line.strip()!r} is not a number: send one bending angle in deg a line") from None
    if not math.isfinite(value):
        raise TautError("stdin: the bending angle must be finite")
    return value
