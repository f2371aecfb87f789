"""A live calibration on the screen while it runs: coverage both ways, B(q) and its sigma over the motor's range."""

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
_FRAME_S = 0.1  # format: between two pictures, wall clock


def picture(view: View) -> list[Text]:
    """The picture of a live calibration for the terminal, line by line: what is done, coverage both ways, B and its
    sigma as columns over the motor's range. Colours show how far sigma is from the goal."""
    lines = [_heading(view), _coverage_line("seen rising", view.rising), _coverage_line("seen falling", view.falling)]
    if view.calibration is not None:
        q = view.low + (np.arange(BINS) + 0.5) * (view.high - view.low) / BINS
        model = view.calibration.model
        known = (q >= model.measured[0]) & (q <= model.measured[1])
        width = np.where(known, np.interp(q, model.q, model.width), np.nan)
        sigma = np.where(known, np.interp(q, model.q, model.width_sigma), np.inf)
        styles = [_sigma_colour(value, view.until) for value in sigma]
        lines += [*_width_columns(width, styles, view.unit), _sigma_digits(sigma, styles, view)]
    lines.append(_axis_labels(view))
    return [*lines, *(Text(part) for part in in_short(view))]


def standing(view: View) -> str:
    """One line: what was recorded so far and how well B(q) is known."""
    return ": ".join(in_short(view))


def _heading(view: View) -> Text:
    """What is being done."""
    return Text(view.doing, style="bold")


def _coverage_line(label: str, frames: Array) -> Text:
    """One direction's coverage over the motor's range: a higher block for more frames (8 fill it), ! where the marker
    was mostly lost. frames (BINS, 2): numbers of frames, seen and lost."""
    line = Text(label.ljust(_LABEL))
    seen, lost = frames.T
    for here, away in zip(seen, lost, strict=True):
        if away > here:
            line.append("!", style="red")
        else:
            line.append(_EIGHTHS[min(int(here), 8)], style="cyan")
    return line


def _sigma_colour(sigma: float, until: float | None) -> str:
    """The colour of a sigma beside the goal `until`, both in the unit of q: green at most that (or without a goal),
    yellow up to three times, red above; dim where it is not finite, so unknown."""
    if not np.isfinite(sigma):
        return "dim"
    if until is None or sigma <= until:
        return "green"
    return "yellow" if sigma <= 3 * until else "red"


def _width_columns(width: Array, styles: list[str], unit: str) -> list[Text]:
    """B over the motor's range as columns from 0 up, _HEIGHT lines. width (BINS,), in the unit of q, NaN (left empty)
    where unknown; styles: a colour for each column."""
    known = width[np.isfinite(width)]
    most = float(known.max()) if len(known) else 1.0
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
    """Sigma (BINS,) over the motor's range in thirds of the goal (without one, in multiples of the smallest), rounded
    up: 1 to 9, + above, a dot where it is inf, so unknown. styles: a colour for each."""
    finite = sigma[np.isfinite(sigma)]
    one = view.until / 3 if view.until is not None else (float(finite.min()) if len(finite) else 1.0)
    line = Text(f"sigma/{in_words(one, view.unit)}".ljust(_LABEL))
    for value, style in zip(sigma, styles, strict=True):
        times = np.ceil(value / one) if np.isfinite(value) else np.inf
        line.append("·" if np.isinf(times) else ("+" if times > 9 else f"{times:.0f}"), style=style)
    return line


def _axis_labels(view: View) -> Text:
    """The lowest, middle and highest motor position below the columns."""
    low, middle, high = (f"{q:.3g}" for q in (view.low, 0.5 * (view.low + view.high), view.high))
    line = f"{low}{middle.center(BINS - 2 * max(len(low), len(high)))}{high.rjust(max(len(low), len(high)))}"
    return Text(f"q, {view.unit}".ljust(_LABEL) + line, style="dim")


@contextmanager
def calibration_picture(as_json: bool) -> Iterator[Show]:
    """A context with a function that shows each View of a live calibration: as a picture where stderr is a terminal
    (and not as_json), else as a line for each calibration made meanwhile."""
    with _pictures() if sys.stderr.isatty() and not as_json else _lines() as show:
        yield show


@contextmanager
def _pictures() -> Iterator[Show]:
    """A context with a function that draws each View on the terminal over the one before, at most every _FRAME_S; the
    picture is taken away in the end."""
    from rich.console import Console, Group
    from rich.live import Live

    with Live(console=Console(stderr=True), auto_refresh=False, transient=True) as screen:
        yield _at_most_every(_FRAME_S, lambda view: screen.update(Group(*picture(view)), refresh=True))


def _at_most_every(seconds: float, show: Show) -> Show:
    """A function that calls `show`, but at most once in so many seconds: others are dropped."""
    shown_s = float("-inf")  # when it was called last

    def shown(view: View) -> None:
        """Calls `show` if it is time."""
        nonlocal shown_s
        now = time.monotonic()
        if now - shown_s >= seconds:
            shown_s = now
            show(view)

    return shown


@contextmanager
def _lines() -> Iterator[Callable[[View], None]]:
    """A context with a function that logs a line when what is being done changes, and for each new calibration."""
    doing, calibrated_s = "", 0.0  # of the last View

    def log_news(view: View) -> None:
        """Logs what is new in the View."""
        nonlocal doing, calibrated_s
        if view.doing != doing:
            doing = view.doing
            log(f"taut: {doing}")
        if view.calibrated_s != calibrated_s:
            calibrated_s = view.calibrated_s
            log(f"taut: {standing(view)}")

    yield log_news
