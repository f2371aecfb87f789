"""The picture of a live calibration in the terminal while it runs: for both directions which positions were seen, and
B(q) with its sigma over the motor's range."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np
from rich.text import Text

from tautline.cli._common import log
from tautline.live.rounds import in_words
from tautline.live.watch import BINS, View, in_short

if TYPE_CHECKING:
    from tautline.live.watch import Show

Array = np.ndarray

_HEIGHT = 6  # format: lines of the picture of B
_EIGHTHS = " ▁▂▃▄▅▆▇█"
_LABEL = 14  # format: characters before a line of the picture
_FRAME_S = 0.1  # format: least time between two pictures, wall clock


def picture(view: View) -> list[Text]:
    """The picture of a live calibration as lines for the terminal: what is being done; then over the motor's range, in
    BINS columns, the coverage in both directions and, once there is a calibration, B as bars and its sigma as digits;
    last the state in words. Colours compare sigma with the goal."""
    lines = [_heading(view), _coverage_line("seen rising", view.rising), _coverage_line("seen falling", view.falling)]
    if view.calibration is not None:
        q = view.low + (np.arange(BINS) + 0.5) * (view.high - view.low) / BINS  # the columns' middles
        model = view.calibration.model
        known = (q >= model.measured[0]) & (q <= model.measured[1])
        width = np.where(known, np.interp(q, model.q, model.width), np.nan)
        sigma = np.where(known, np.interp(q, model.q, model.width_sigma), np.inf)
        styles = [_sigma_colour(value, view.until) for value in sigma]
        lines += [*_width_columns(width, styles, view.unit), _sigma_digits(sigma, styles, view)]
    lines.append(_axis_labels(view))
    return [*lines, *(Text(part) for part in in_short(view))]


def standing_line(view: View) -> str:
    """What was recorded so far and how well B(q) is known by it, as one line."""
    return ": ".join(in_short(view))


def _heading(view: View) -> Text:
    """The picture's first line: what is being done."""
    return Text(view.doing, style="bold")


def _coverage_line(label: str, frames: Array) -> Text:
    """The line of one direction's coverage over the motor's range: in each column a block that is the higher the more
    frames saw the marker there (8 fill it), or ! where more frames lost it. frames: (BINS, 2) numbers of frames in
    which the marker was seen, and lost."""
    line = Text(label.ljust(_LABEL))
    seen, lost = frames.T
    for seen_count, lost_count in zip(seen, lost, strict=True):
        if lost_count > seen_count:
            line.append("!", style="red")
        else:
            line.append(_EIGHTHS[min(int(seen_count), 8)], style="cyan")
    return line


def _sigma_colour(sigma: float, until: float | None) -> str:
    """The colour of a sigma by the goal `until`, both in the unit of q: green up to the goal (or without a goal),
    yellow up to three times the goal, red above; dim where sigma is not finite, that is, unknown."""
    if not np.isfinite(sigma):
        return "dim"
    if until is None or sigma <= until:
        return "green"
    return "yellow" if sigma <= 3 * until else "red"


def _width_columns(width: Array, styles: list[str], unit: str) -> list[Text]:
    """B over the motor's range as vertical bars from 0 to the largest B, in _HEIGHT lines from the top down. width:
    (BINS,) unit of q, NaN where unknown, which leaves a column empty; styles: the colour of each column."""
    known = width[np.isfinite(width)]
    most = float(known.max()) if len(known) else 1.0
    # Heights in eighths of a line: a character shows 0 to 8 of them.
    eighths = np.round(np.nan_to_num(width) / max(most, 1e-9) * 8 * _HEIGHT).astype(int)
    lines = []
    for row in reversed(range(_HEIGHT)):
        label = f"B {most:.3g} {unit}" if row == _HEIGHT - 1 else ("0" if row == 0 else "")
        line = Text(label.rjust(_LABEL - 1) + " ")
        for level, style in zip(eighths - 8 * row, styles, strict=True):
            line.append(_EIGHTHS[int(np.clip(level, 0, 8))], style=style)
        lines.append(line)
    return lines


def _sigma_digits(sigma: Array, styles: list[str], view: View) -> Text:
    """The line of B's sigma (BINS,) over the motor's range, a character for each column: sigma in thirds of the goal
    (without a goal, in multiples of the smallest sigma), rounded up, as 1 to 9, or + above; a dot where sigma is inf,
    that is, unknown. styles: the colour of each column."""
    finite = sigma[np.isfinite(sigma)]
    one = view.until / 3 if view.until is not None else (float(finite.min()) if len(finite) else 1.0)
    line = Text(f"sigma/{in_words(one, view.unit)}".ljust(_LABEL))
    for value, style in zip(sigma, styles, strict=True):
        times = np.ceil(value / one) if np.isfinite(value) else np.inf
        line.append("·" if np.isinf(times) else ("+" if times > 9 else f"{times:.0f}"), style=style)
    return line


def _axis_labels(view: View) -> Text:
    """The line below the columns: the range's lowest, middle and highest motor position."""
    low, middle, high = (f"{q:.3g}" for q in (view.low, 0.5 * (view.low + view.high), view.high))
    line = f"{low}{middle.center(BINS - 2 * max(len(low), len(high)))}{high.rjust(max(len(low), len(high)))}"
    return Text(f"q, {view.unit}".ljust(_LABEL) + line, style="dim")


@contextmanager
def calibration_picture(as_json: bool) -> Iterator[Show]:
    """A context that yields the function to be called with each View of a live calibration. It shows a picture where
    stderr is a terminal and not `as_json`; else it prints lines, as `_lines` does."""
    with _pictures() if sys.stderr.isatty() and not as_json else _lines() as show:
        yield show


@contextmanager
def _pictures() -> Iterator[Show]:
    """A context that yields a function which draws a View on the terminal over the one before, at most every _FRAME_S;
    Views in between are dropped. At the end of the context the picture is erased."""
    from rich.console import Console, Group
    from rich.live import Live

    with Live(console=Console(stderr=True), auto_refresh=False, transient=True) as screen:
        yield _at_most_every(_FRAME_S, lambda view: screen.update(Group(*picture(view)), refresh=True))


def _at_most_every(seconds: float, show: Show) -> Show:
    """A function that calls `show`, but at most once in this many seconds; it ignores the calls in between."""
    shown_s = float("-inf")  # when it was called last

    def shown(view: View) -> None:
        """Calls `show` unless the last call was less than `seconds` ago."""
        nonlocal shown_s
        now = time.monotonic()
        if now - shown_s >= seconds:
            shown_s = now
            show(view)

    return shown


@contextmanager
def _lines() -> Iterator[Callable[[View], None]]:
    """A context that yields a function which, called with each View, prints a line on stderr when what is being done
    has changed, and one for each new calibration."""
    doing, calibrated_s = "", 0.0  # of the last View

    def log_news(view: View) -> None:
        """Prints what is new in the View since the last call."""
        nonlocal doing, calibrated_s
        if view.doing != doing:
            doing = view.doing
            log(f"taut: {doing}")
        if view.calibrated_s != calibrated_s:
            calibrated_s = view.calibrated_s
            log(f"taut: {standing_line(view)}")

    yield log_news
