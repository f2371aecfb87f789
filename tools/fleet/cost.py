"""What fleets' runs cost the cores: every call's share is kept beside its results, so that a run in parts is the sum of
them, and no part is taken for a whole one.

How much a second of a core does depends on what else the machine does meanwhile. So a yardstick goes along, one session
that is calibrated again and again, and a run's cost is told in it too.
"""

from __future__ import annotations

import json
import resource
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd

from tautline.calibration.calibrate import calibrate
from tautline.fleet.changes import with_changes
from tautline.fleet.findings import findings
from tautline.fleet.rows import DataSet
from tautline.fleet.run import row_of_lost_worker, run
from tautline.fleet.sessions import MANIFEST
from tautline.folders import write_file
from tautline.pool import pool
from tautline.reports import figures
from tautline.simulated.instrument import reference_rig
from tools.fleet.robots import WORN, Robot

FILE = "cost.json"
_EVERY_S = 20.0  # of wall time, from one yardstick to the next: some 5 % of one core
_LINEAR = 0.15  # the goal: of the cost of a session, whatever the fleet and its workers


@dataclass(frozen=True)
class Part:
    """One call."""

    sessions: int
    wall_s: float
    cores_s: float  # of this process and its workers
    yardstick_s: float  # the same of one session, in the mean over the call


@dataclass(frozen=True)
class Cost:
    """Of one fleet by so many workers."""

    robots: int
    workers: int
    sessions: int  # that the fleet has
    motion_s: float  # each
    parts: tuple[Part, ...] = ()

    @classmethod
    def read(cls, path: Path) -> Cost:
        values = json.loads(path.read_text(encoding="utf-8"))
        return cls(**values | {"parts": tuple(Part(**part) for part in values["parts"])})

    def write(self, path: Path) -> None:
        write_file(path, json.dumps(asdict(self), indent=1) + "\n")

    @property
    def known(self) -> int:
        """Sessions whose cost is known: not those of a call that was killed."""
        return sum(part.sessions for part in self.parts)

    @property
    def whole(self) -> bool:
        return self.known == self.sessions

    @property
    def cores_s(self) -> float:
        return sum(part.cores_s for part in self.parts)

    @property
    def each_s(self) -> float:
        return self.cores_s / max(self.known, 1)

    @property
    def each(self) -> float:
        """What a session cost, in yardsticks."""
        return sum(part.cores_s / part.yardstick_s for part in self.parts) / max(self.known, 1)


class _Yardstick:
    """A calibration of one session, whose core seconds are no part of the run's."""

    def __init__(self, motion_s: float) -> None:
        self.rig = reference_rig()
        self.recording = Robot(0, 0).recording(0, motion_s, self.rig)
        calibrate([self.recording], self.rig)  # what is loaded once
        self.taken_s: list[float] = []
        self.last_s = 0.0

    def beside(self) -> None:
        if time.monotonic() - self.last_s > _EVERY_S:
            began_s = time.process_time()
            calibrate([self.recording], self.rig)
            self.taken_s.append(time.process_time() - began_s)
            self.last_s = time.monotonic()


def measure(folder: Path, out: Path, cost: Cost) -> None:
    """Does what is new of a run, and adds what that cost, even if it is interrupted. Nothing where all is known."""
    path = out / FILE
    if path.exists():
        cost = Cost.read(path)
    if cost.whole:
        return
    done, yardstick = 0, _Yardstick(cost.motion_s)

    def count(share: float, what: str) -> None:
        nonlocal done
        done += 1
        yardstick.beside()

    began_s, spent_s = time.monotonic(), _cores_s()
    try:
        with pool(cost.workers, None, row_of_lost_worker) as workers:
            run(folder, out, workers, count)
    finally:
        yardstick.beside()
        wall_s, cores_s = time.monotonic() - began_s, _cores_s() - spent_s - sum(yardstick.taken_s)
        part = Part(done, wall_s, cores_s, float(np.mean(yardstick.taken_s)))
        replace(cost, parts=(*cost.parts, part)).write(path)


def _cores_s() -> float:
    """Of this process and of those that it waited for."""
    own, theirs = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + theirs.ru_utime + theirs.ru_stime


def told(out: Path) -> list[str]:
    """A line for each run in OUT, and OUT/cost.svg with all that are whole."""
    costs = {path.parent: Cost.read(path) for path in out.glob(f"*/{FILE}")}
    ordered = sorted(costs, key=lambda at: (costs[at].robots, costs[at].workers))
    lines = [f"{_cost(costs[at])}; {_found(out / str(costs[at].robots), at)}" for at in ordered]
    if whole := [costs[at] for at in ordered if costs[at].whole]:
        each = np.array([cost.each for cost in whole])
        off = float(np.ptp(each) / (each.max() + each.min()))
        lines.append(f"{each.min():.3f} to {each.max():.3f} yardsticks a session: linear to {100.0 * off:.0f} %")
        _plot(whole, out / "cost.svg")
    return lines


def _cost(cost: Cost) -> str:
    wall_s = sum(part.wall_s for part in cost.parts)
    which = f"{cost.sessions} sessions" if cost.whole else f"{cost.known} of {cost.sessions} sessions"
    return (
        f"{cost.robots} robots, {cost.workers} workers, {which} in {len(cost.parts)} calls: {wall_s:.0f} s, "
        f"{cost.cores_s:.0f} s of the cores, {cost.each_s:.3f} a session, {cost.each:.3f} yardsticks"
    )


def _found(folder: Path, result: Path) -> str:
    """Who of the robots of whom there is any row is worn, and who is found so."""
    rows = sorted(DataSet(result).read().values(), key=lambda row: (row.robot, row.session))
    batch = pd.read_csv(folder / MANIFEST).set_index("robot")["batch"]
    truth = {robot for robot in batch.index[batch == WORN] if any(row.robot == robot for row in rows)}
    said = findings(with_changes(rows))
    named = {one.name for one in said.worn}
    batches = ", ".join(one.name for one in said.worn_batches) or "none"
    return (
        f"{len(rows)} rows, {said.failed} failed; worn {len(truth)}, found {len(truth & named)}, "
        f"false {len(named - truth)}; worn batches: {batches}"
    )


def _plot(costs: Sequence[Cost], path: Path) -> None:
    """Of whole runs: what each costs, and what a session of it costs beside the goal."""
    with mpl.rc_context(figures.STYLE):
        made, axes = figures.figure(9.0, 3.8, columns=2)
        all_of_it, each = axes[0]
        middle = 0.5 * (min(cost.each for cost in costs) + max(cost.each for cost in costs))
        for colour, workers in zip(figures.SERIES, sorted({cost.workers for cost in costs}), strict=False):
            own = [cost for cost in costs if cost.workers == workers]
            robots, name = [cost.robots for cost in own], f"{workers} worker{'s' * (workers > 1)}"
            all_of_it.loglog(robots, [cost.cores_s for cost in own], "o-", color=colour, label=name)
            each.semilogx(robots, [cost.each for cost in own], "o-", color=colour, label=name)
        each.axhspan(
            *(middle * (1.0 + way * _LINEAR) for way in (-1.0, 1.0)), color=figures.BAND, alpha=0.4,
            label=f"linear to {100.0 * _LINEAR:.0f} %", zorder=0,
        )  # fmt: skip
        each.set_ylim(bottom=0.0)
        all_of_it.set_ylabel("s of the cores")
        each.set_ylabel("of a session, in one calibrated meanwhile")
        for ax in axes[0]:
            ax.set_xlabel(f"robots, {costs[-1].sessions // costs[-1].robots} sessions each")
            ax.legend()
        figures.save(made, path)
