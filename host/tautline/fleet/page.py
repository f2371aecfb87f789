"""A fleet's page: who drifts, which batch is worn, what is unlike, and what could not be calibrated."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from tautline.fleet.findings import Findings, Named, count_of
from tautline.fleet.rows import Row
from tautline.reports import figures, pages

FILE = "fleet.html"
_MOST = 40  # display: most lines of a table
_USUAL: dict[str, Any] = {"color": figures.UP, "linewidth": 0.5, "alpha": 0.35}
_CURVES = 400  # display: robots, evenly taken, whose curves a picture shows


def write(rows: Sequence[Row], found: Findings, out: Path) -> None:
    """Writes OUT/fleet.html: the findings in sentences, two pictures, and tables. rows: of all sessions, each robot's
    in the order of time; found: the findings of these rows. In a table's head, | before a name marks a column of
    text."""
    last = _last_usable(rows)
    failed = [[row.robot, row.session, row.error or ""] for row in rows if row.error is not None]
    growth = ["|robot", "|batch", "B a session (%)", "sigma (%)", "|last session", "|verdict"]
    page = {
        "title": f"What a fleet of {count_of(found.robots, 'robot')} loses between motor and tip",
        "sentences": found.sentences(),
        "growth": pages.picture(
            growth_picture(rows, found), "Growth of B", "Of each robot, a session, with 2 sigma. Red: worn sooner."
        )
        if any(row.wear is not None for row in rows)
        else None,
        "spread": pages.picture(
            spread_picture(list(last.values()), found),
            "B of all robots",
            "B of each robot's last session. Red: unlike.",
        )
        if last
        else None,
        "parts": [
            _table("Worn batches", "All of whose robots together wear sooner.", ["|batch", "B a session (%)"],
                  [[one.name, _percent(one.value)] for one in found.worn_batches]),
            _table("Worn sooner", "Of a group whose B grows faster than the others'.", growth,
                   _growth_rows(found.worn, last)),
            _table("Unlike", "B of the last session is off the fleet's by more than any robot's of as many.",
                  ["|robot", "|batch", "squared distance over its mean"],
                  [[one.name, _batch(last, one.name), f"{one.value:.3g}"] for one in found.unlike]),
            _table("Drifting", "B changes from session to session for certain; fastest first.", growth,
                  _growth_rows(found.drifting, last)),
            _table("Robots", "Each with its last usable session.",
                  ["|robot", "|batch", "sessions", "|last session", "|verdict", "B in the mean"],
                  _robot_rows(rows, last)),
            _table("Without a calibration",
                  "They are tried again when their files change; where those cannot be read, or workers died, always.",
                  ["|robot", "|session", "|why"], failed),
        ],
    }  # fmt: skip
    pages.write_page("fleet.html", page, out / FILE)


def _table(title: str, says: str, head: list[str], rows: list[list[str]]) -> dict[str, Any]:
    """One table of the page as the template takes it: the title with the number of rows, a sentence `says`, the column
    names `head`, and the cells `rows`. Only the first _MOST rows are kept; a sentence then says so."""
    if len(rows) > _MOST:
        says += f" The first {_MOST} of {len(rows)}; --json and the data set have all."
    return {"title": f"{title}: {len(rows)}", "says": says, "head": head, "rows": rows[:_MOST]}


def _growth_rows(named: Sequence[Named], last: dict[str, Row]) -> list[list[str]]:
    """The cells of a table of robots that are named for their growth, a row each: robot, batch, growth of B a session
    and its sigma, %, last usable session and its verdict. last: of `_last_usable`."""
    return [
        [one.name, _batch(last, one.name), _percent(one.value), _percent(one.sigma), last[one.name].session,
         last[one.name].verdict]
        for one in named
    ]  # fmt: skip


def _robot_rows(rows: Sequence[Row], last: dict[str, Row]) -> list[list[str]]:
    """The cells of the table of all robots, a row each: robot, batch, number of sessions, then name, verdict and mean B
    of the last usable session, empty where there is none. last: of `_last_usable`."""
    lines = []
    for robot, sessions in Counter(row.robot for row in rows).items():
        row = last.get(robot)
        batch = next((each.batch or "" for each in rows if each.robot == robot), "")
        of_last = ["", "", ""] if row is None else [row.session, row.verdict, _mean_width(row)]
        lines.append([robot, batch, str(sessions), *of_last])
    return lines


def _mean_width(row: Row) -> str:
    """The mean of B over the places where it was measured, with its unit, as text; "" where there is no such place."""
    _, width = _measured_curve(row)
    return f"{np.mean(width):.3g} {row.unit}" if len(width) else ""


def _measured_curve(row: Row) -> tuple[np.ndarray, np.ndarray]:
    """The places q and widths B of a session, (n,) each, unit of q, at the places where B was measured."""
    q, width = np.array(row.q), np.array(row.width)
    inside = (q >= (row.measured_low or 0.0)) & (q <= (row.measured_high or 0.0))
    return q[inside], width[inside]


def _last_usable(rows: Sequence[Row]) -> dict[str, Row]:
    """The last usable session of each robot that has one, by robot."""
    return {row.robot: row for row in rows if row.usable}


def _batch(last: dict[str, Row], robot: str) -> str:
    """The batch of a robot that has a usable session (else KeyError); "" where it is of no batch. last: of
    `_last_usable`."""
    return last[robot].batch or ""


def _percent(share: float) -> str:
    """A share as percent, without the sign %, to two digits."""
    return f"{100 * share:.2g}"


@mpl.rc_context(figures.STYLE)
def growth_picture(rows: Sequence[Row], found: Findings) -> Figure:
    """A figure of each robot's growth of B a session, %, with 2 sigma. The robots stand side by side, sorted by batch;
    those that are named as worn have another colour."""
    known = {row.robot: row for row in rows if row.wear is not None}
    order = sorted(known.values(), key=lambda row: (row.batch or "", row.robot))
    worn = {one.name for one in found.worn}
    made, axes = figures.figure(10.5, 3.6)
    ax = axes[0, 0]
    for of_group, colour in ((False, figures.UP), (True, figures.MODEL)):
        at = [k for k, row in enumerate(order) if (row.robot in worn) is of_group]
        rate = [100 * (order[k].wear or 0.0) for k in at]
        two_sigma = [2.0 * 100 * (order[k].wear_sigma or 0.0) for k in at]
        ax.errorbar(at, rate, yerr=two_sigma, fmt="o", markersize=2.5, linewidth=0.7, color=colour)
    ax.axhline(0.0, color=figures.GREY, linewidth=0.8)
    ax.set_xlabel("robot, batch by batch")
    ax.set_ylabel("growth of B a session (%)")
    return made


@mpl.rc_context(figures.STYLE)
def spread_picture(last: Sequence[Row], found: Findings) -> Figure:
    """A figure of B over q, where it was measured, of about _CURVES robots at most, evenly taken; and, in another
    colour, of all robots that are named as unlike. last: one usable row of each robot, of one robot at least."""
    unlike = {one.name for one in found.unlike}
    shown = last[:: max(1, len(last) // _CURVES)]
    made, axes = figures.figure(10.5, 3.6)
    ax = axes[0, 0]
    for row in [*shown, *(row for row in last if row.robot in unlike)]:
        look: dict[str, Any] = {"color": figures.MODEL, "linewidth": 1.0} if row.robot in unlike else _USUAL
        ax.plot(*_measured_curve(row), **look)
    unit = last[0].unit or ""
    ax.set_xlabel(f"q ({unit})")
    ax.set_ylabel(f"B ({unit})")
    return made
