"""python -m tools.fleet campaign | prior: does taut fleet find who is worn, and does its prior cover?"""

from __future__ import annotations

import resource
import time
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import click
import matplotlib as mpl
import numpy as np
import numpy.typing as npt

from tautline.calibration.calibrate import Options, calibrate
from tautline.fleet import prior
from tautline.fleet.findings import findings
from tautline.fleet.run import died, run
from tautline.pool import pool
from tautline.reports import figures
from tautline.simulated.instrument import reference_rig
from tools.fleet.robots import Robot, write

Array = npt.NDArray[np.float64]

SEED = 7
_seed = click.option("--seed", type=int, default=SEED, show_default=True, help="Of the robots.")
_BEYOND = 100000  # robots from this number on are in no fleet
_NINE_IN_TEN = 1.645  # sigmas
_PLACES = np.linspace(-5.0, 5.0, 33)


@click.group()
def main() -> None:
    """Fleets of simulated robots."""


@main.command()
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--robots", type=int, multiple=True, default=(100, 1000), show_default=True)
@click.option("--sessions", type=int, default=10, show_default=True)
@click.option("--worn", type=float, default=0.03, show_default=True, help="Share of the robots.")
@click.option("--seconds", type=float, default=20.0, show_default=True, help="Of motion, a session.")
@click.option("--jobs", type=int, multiple=True, default=(1, 2, 4), show_default=True)
@_seed
def campaign(
    out: Path, robots: tuple[int, ...], sessions: int, worn: float, seconds: float, jobs: tuple[int, ...], seed: int
) -> None:
    """Fleets of these sizes by so many workers: what each costs the cores, which others may share (OUT/cost.svg), and
    who is found worn. A fleet's sessions are the first of a larger one's, whichever are worn."""
    spent: dict[tuple[int, int], float] = {}
    for count, workers_at in product(robots, jobs):
        truth = set(write(out / f"{count}", count, sessions, round(worn * count), seed, seconds))
        result = out / f"{count}-by-{workers_at}"
        began, cores_s = time.monotonic(), _cores_s()
        with pool(workers_at, None, died) as workers:
            done = run(out / f"{count}", result, workers, lambda share, what: None)
        wall_s, spent[count, workers_at] = time.monotonic() - began, _cores_s() - cores_s
        each = spent[count, workers_at] / max(done.new, 1)
        named = {one.name for one in findings(done.rows).worn}
        click.echo(
            f"{count} robots, {workers_at} workers, {done.new} sessions: {wall_s:.0f} s, "
            f"{spent[count, workers_at]:.0f} s of the cores, {each:.3f} a session; "
            f"worn {len(truth)}, found {len(truth & named)}, false {len(named - truth)}"
        )
    _plot(spent, sessions, out / "cost.svg")


def _cores_s() -> float:
    """Of this process and of those that it waited for."""
    own, theirs = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + theirs.ru_utime + theirs.ru_stime


def _plot(spent: dict[tuple[int, int], float], sessions: int, path: Path) -> None:
    with mpl.rc_context(figures.STYLE):
        made, axes = figures.figure(6.0, 4.0)
        for colour, jobs in zip(figures.SERIES, sorted({at for _, at in spent}), strict=False):
            count = sorted(robots for robots, at in spent if at == jobs)
            cores_s = [spent[robots, jobs] for robots in count]
            axes[0, 0].loglog(count, cores_s, "o-", color=colour, label=f"{jobs} workers")
        axes[0, 0].set_xlabel(f"robots, {sessions} sessions each")
        axes[0, 0].set_ylabel("s of the cores")
        axes[0, 0].legend()
        figures.save(made, path)


@dataclass
class _Score:
    error: list[Array]
    sigma: list[Array]

    def line(self, inside: npt.NDArray[np.bool_]) -> str:
        error, sigma = np.array(self.error)[:, inside], np.array(self.sigma)[:, inside]
        covers = np.mean(np.abs(error / sigma) < _NINE_IN_TEN)
        rms = (1e3 * float(np.sqrt(np.mean(each**2))) for each in (error, sigma))
        return "error {:.2f}, sigma {:.2f} um rms, {:.2f} um median; 90 % cover {:.1f} %".format(
            *rms, 1e3 * float(np.median(sigma)), 100.0 * covers
        )


@main.command("prior")
@click.argument("fleet", type=click.Path(path_type=Path))
@click.option("--robots", type=int, default=20, show_default=True)
@click.option("--session", type=int, default=2, show_default=True, help="How long they are in use.")
@_seed
def of_prior(fleet: Path, robots: int, session: int, seed: int) -> None:
    """Robots that are not in FLEET, calibrated by 5 and 20 s with and without what it taught."""
    rig = reference_rig()
    known = Options(beforehand=prior.read(fleet, rig))
    reversals = (_PLACES >= -3.0) & (_PLACES <= 4.5)
    for worn, seconds, options in product((False, True), (5.0, 20.0), (Options(), known)):
        score = _Score([], [])
        for number in range(_BEYOND, _BEYOND + robots):
            robot, at = Robot(seed, number, worn), session * (4 if worn else 1)
            model = calibrate([robot.recording(at, seconds, rig)], rig, options).model
            truth = robot.instrument(at, rig).backlash(_PLACES)
            score.error.append(np.interp(_PLACES, model.q, model.width) - truth)
            score.sigma.append(np.interp(_PLACES, model.q, model.width_sigma))
        what = f"{'worn' if worn else 'usual'}, {seconds:g} s, {'with' if options is known else 'without'} a fleet"
        click.echo(f"{what}: between the reversals {score.line(reversals)}; whole range {score.line(_PLACES > -9.0)}")


if __name__ == "__main__":
    main()
