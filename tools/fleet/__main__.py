"""python -m tools.fleet campaign | prior: does taut fleet find who is worn, and does its prior cover?"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import click
import numpy as np
import numpy.typing as npt

from tautline.calibration.calibrate import calibrate
from tautline.calibration.options import Options
from tautline.fleet import prior
from tautline.rig import Rig
from tautline.simulated.instrument import reference_rig
from tools.fleet.cost import Cost, measure, told
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
@click.option("--robots", type=int, multiple=True, default=(30, 100, 1000), show_default=True)
@click.option("--sessions", type=int, default=10, show_default=True)
@click.option("--worn", type=float, default=0.03, show_default=True, help="Share of the robots.")
@click.option("--seconds", type=float, default=20.0, show_default=True, help="Of motion, a session.")
@click.option("--jobs", type=int, multiple=True, default=(1, 2), show_default=True)
@_seed
def campaign(
    out: Path, robots: tuple[int, ...], sessions: int, worn: float, seconds: float, jobs: tuple[int, ...], seed: int
) -> None:
    """Fleets of these sizes by so many workers: what each costs the cores, which others may share, and who is found
    worn. What OUT holds already is not measured again, and an interrupted run goes on. A fleet's sessions are the first
    of a larger one's, whichever are worn."""
    for count, workers in product(robots, jobs):
        write(out / f"{count}", count, sessions, round(worn * count), seed, seconds)
        measure(out / f"{count}", out / f"{count}-by-{workers}", Cost(count, workers, count * sessions, seconds))
    _say_costs(out)


@main.command()
@click.argument("out", type=click.Path(path_type=Path, exists=True))
def costs(out: Path) -> None:
    """What campaign has measured so far in OUT, and the plot of it (OUT/cost.svg)."""
    _say_costs(out)


def _say_costs(out: Path) -> None:
    for line in told(out):
        click.echo(line)


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


_MOVED_MM, _LATE_S, _BENT = 2.0, 0.005, 0.05  # a camera elsewhere, a later one, a law as no robot of the fleet has it
_MODES = (("5 s without", 5.0, False), ("5 s with the fleet", 5.0, True), ("20 s without", 20.0, False))


def _moved(rig: Rig) -> Rig:
    assert rig.hand_eye is not None
    x, y, z = rig.hand_eye.translation_mm
    return replace(rig, hand_eye=replace(rig.hand_eye, translation_mm=(x + _MOVED_MM, y, z)))


@main.command("prior")
@click.argument("fleet", type=click.Path(path_type=Path))
@click.option("--robots", type=int, default=20, show_default=True)
@click.option("--session", type=int, default=2, show_default=True, help="How long they are in use; worn ones 4 times.")
@_seed
def of_prior(fleet: Path, robots: int, session: int, seed: int) -> None:
    """Robots that are not in FLEET, also such as it has none of, calibrated by 5 and 20 s with and without what it
    taught."""
    rig = reference_rig()
    options = {True: Options(beforehand=prior.read(fleet, rig)), False: Options()}
    reversals = (_PLACES >= -3.0) & (_PLACES <= 4.5)
    kinds: list[tuple[str, Callable[[int], Robot], int, Rig]] = [
        ("usual", lambda number: Robot(seed, number), session, rig),
        ("worn", lambda number: Robot(seed, number, worn=True), 4 * session, rig),
        ("later by 5 ms", lambda number: Robot(seed, number, late_s=_LATE_S), session, rig),
        ("another f_remain", lambda number: Robot(seed, number, bent=_BENT), session, rig),
        ("camera 2 mm elsewhere", lambda number: Robot(seed, number), session, _moved(rig)),
    ]
    for (kind, robot_of, at, own), (mode, seconds, known) in product(kinds, _MODES):
        score = _Score([], [])
        for robot in map(robot_of, range(_BEYOND, _BEYOND + robots)):
            model = calibrate([robot.recording(at, seconds, own)], own, options[known]).model
            truth = robot.instrument(at, own).backlash(_PLACES)
            score.error.append(np.interp(_PLACES, model.q, model.width) - truth)
            score.sigma.append(np.interp(_PLACES, model.q, model.width_sigma))
        between, whole = score.line(reversals), score.line(_PLACES > -9.0)
        click.echo(f"{kind}, {mode}: between the reversals {between}; whole range {whole}")


if __name__ == "__main__":
    main()
