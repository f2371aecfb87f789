"""State, offset and scale of B over the time of use."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tautline.core.session import SessionClock
from tautline.recording import Recording
from tautline.reports import figures
from tautline.tracking.replay import Tracked, off_by

# format of all: sizes and colours of a picture

_STATES = {"trusted": "#d9efdf", "stale": "#fbe9b7", "adapting": "#d5e6f5"}
_MANY = 4000  # tolerance: rows that are drawn


def draw(tracked: Tracked, recordings: Sequence[Recording], unit: str) -> Figure:
    """Draws, over the time of use: how far off predictions were; offset and scale of B, each with a band of two
    standard deviations; the state as the background. At most _MANY rows are drawn. unit: of q."""
    with mpl.rc_context(figures.STYLE):
        made, axes = figures.figure(9.0, 6.0, rows=3, sharex=True)
        t_s = tracked.t_s + np.array(SessionClock.of(recordings).offset_s)[tracked.recording]
        shown = np.unique(np.linspace(0, len(t_s) - 1, _MANY).astype(int))
        sensor = "px" if tracked.sensor == "marker" else "deg"
        off = off_by(tracked, recordings)
        axes[0, 0].plot(t_s[shown], off[shown], ".", ms=2, color=figures.INK, rasterized=len(shown) > figures.MANY)
        axes[0, 0].set_ylabel(f"off by ({sensor})")
        axes[0, 0].set_yscale("log")
        for row, name, label in ((1, "offset", f"offset ({unit})"), (2, "scale", "scale of B (1)")):
            value, sigma = tracked.column(name)[shown], tracked.column(f"{name}_sigma")[shown]
            axes[row, 0].fill_between(t_s[shown], value - 2 * sigma, value + 2 * sigma, color=figures.BAND, lw=0)
            axes[row, 0].plot(t_s[shown], value, color=figures.MODEL, lw=1.4, drawstyle="steps-post")
            axes[row, 0].set_ylabel(label)
        states = [row.state.value for row in tracked.rows]
        for panel in axes[:, 0]:
            _bands(panel, t_s, states)
        for name, colour in _STATES.items():
            axes[0, 0].plot([], [], "s", color=colour, label=name)
        axes[0, 0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.1)
        axes[0, 0].set_title("Tracked while in use: how far off, and what changed")
        axes[2, 0].set_xlabel("time (s)")
    return made


def _bands(panel: Axes, t_s: np.ndarray, states: list[str]) -> None:
    """Shades a panel's background by the state: states (n) of the rows at the times t_s (n,), s."""
    begin = 0
    for k in range(1, len(states) + 1):
        if k == len(states) or states[k] != states[begin]:
            panel.axvspan(t_s[begin], t_s[min(k, len(states) - 1)], color=_STATES[states[begin]], lw=0, zorder=0)
            begin = k
