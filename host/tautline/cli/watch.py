"""taut watch MODEL"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tautline.cli._common import (
    STATE_COLOURS,
    NumberRange,
    emit,
    json_option,
    log,
    rig_option,
    warn_tracked_alone,
    warn_unusable,
)
from tautline.cli._live import (
    LiveOptions,
    live_options,
    motion_option,
    opened_setup,
    seed_option,
    shape_text,
    shapes_option,
    speed_option,
)
from tautline.model import Model

if TYPE_CHECKING:
    from tautline.tracking import Row, State

_FRAME_S = 0.2  # format: least time between two updates of the line, wall clock


@click.command("watch")
@click.argument("model_path", metavar="MODEL", type=click.Path(path_type=Path))
@live_options
@rig_option
@motion_option("whatever drives it")
@speed_option
@click.option("--duration", type=NumberRange(min=0.1), help="s. Default: until Ctrl-C, or the motion's end.")
@seed_option
@shapes_option()
@json_option
def command(
    model_path: Path,
    live: LiveOptions,
    rig_path: Path | None,
    motion: str,
    speed: float | None,
    duration: float | None,
    seed: int,
    library_path: Path | None,
    as_json: bool,
) -> None:
    """Keep a model calibrated while the instrument is used, and say when it no longer holds and why.

    Motor and camera are watched, nothing is moved unless --motion says so. Offset and scale of B are those that
    'taut track' would find in a recording of it; the board's tables stay as they are.
    """
    from tautline.live.tracking import watch
    from tautline.shapes import Library

    model = Model.load(model_path)
    warn_unusable(model, model_path)
    warn_tracked_alone(model)
    library = None if library_path is None else Library.load(library_path)
    if live.simulate is not None and motion == "none" and duration is None:
        raise click.UsageError("a simulated instrument that nothing moves: name --motion or --duration")
    with (
        opened_setup(live, rig_path, seed, model=model) as setup,
        _progress_display(model.rig.actuator.unit, as_json) as on_row,
    ):
        result = watch(
            setup, model, motion, speed=speed, duration_s=duration, seed=seed, library=library, on_row=on_row
        )
    emit(result, as_json, _result_in_words(result, model.rig.actuator.unit) + shape_text(result, library))


@contextmanager
def _progress_display(unit: str, as_json: bool) -> Iterator[Callable[[Row, float], None]]:
    """A context that yields the function to be called with each row of the tracker and its time, s. It prints a line on
    stderr for each change of state; where stderr is a terminal and not `as_json`, it also shows the latest row there,
    which is erased at the end. unit: of q."""
    last_state: State | None = None
    drawn_s = float("-inf")  # when a row was drawn last

    def log_change(row: Row, t_s: float) -> None:
        """Prints a line if the row's state differs from that of the row before; none for the first row."""
        nonlocal last_state
        if row.state is not last_state:
            if last_state is not None:
                state = click.style(row.state.value, fg=STATE_COLOURS[row.state.value], bold=True)
                log(f"taut: {t_s:.2f} s: {state}, {row.reason}")
            last_state = row.state

    if as_json or not sys.stderr.isatty():
        yield log_change
        return
    from rich.console import Console
    from rich.live import Live as Screen

    with Screen(console=Console(stderr=True), auto_refresh=False, transient=True) as screen:

        def draw(row: Row, t_s: float) -> None:
            """Prints a change of state, and shows the row unless one was shown less than _FRAME_S ago."""
            nonlocal drawn_s
            log_change(row, t_s)
            now = time.monotonic()
            if now - drawn_s >= _FRAME_S:
                drawn_s = now
                screen.update(_row_line(row, t_s, unit), refresh=True)

        yield draw


def _row_line(row: Row, t_s: float, unit: str) -> Any:
    """A tracker's row as one line of rich's text: time t_s, state, offset in `unit` (that of q), scale of B, reason."""
    from rich.text import Text

    line = Text(f"{t_s:8.1f} s  ")
    line.append(f"{row.state.value:9s}", style=f"bold {STATE_COLOURS[row.state.value]}")
    line.append(f" offset {row.offset:+.4f} ± {row.offset_sigma:.4f} {unit}")
    line.append(f", scale {row.scale:.3f} ± {row.scale_sigma:.3f}")
    line.append(f"  {row.reason}", style="dim")
    return line


def _result_in_words(result: dict[str, Any], unit: str) -> str:
    """The result of live.tracking.watch as text for a terminal. unit: of q, in which the offset is."""
    if result["state"] is None:
        return "no frame was tracked: does the board send telemetry, does the camera see the marker?"
    rms = "" if result["rms_px"] is None else f", off by {result['rms_px']:.3g} px rms"
    return (
        f"watched {result['seconds']:.1f} s, {result['frames']} frames, marker lost in {result['lost_frames']}{rms}: "
        f"{result['state']}, offset {result['offset']:+.4g} ± {result['offset_sigma']:.2g} {unit}, "
        f"scale {result['scale']:.4g} ± {result['scale_sigma']:.2g}"
    )
