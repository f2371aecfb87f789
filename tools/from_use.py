"""python -m tools.from_use [DATA] [--seeds N]: B from use alone, beside what 20 s of calibration motion give.

Simulated instruments (of seed 100 on) are led for five minutes by reaches between targets, with favourite places, small
corrections and rests, never from end to end and within part of the range; the truth is known. Then the proposed motion
is recorded too. DATA holds SO-101 recordings (tools/so101.py; default: beside the repository): the free motions of each
joint, some five minutes, beside its longest calibration motion, which is no truth: what both differ by is scored in
their joint sigma.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.progress import track
from rich.table import Table

from tautline.calibration.calibrate import calibrate
from tautline.calibration.result import Calibration
from tautline.live.closing import closing
from tautline.model import Model
from tautline.recording import load
from tautline.rig import Actuator, Rig
from tautline.simulated.instrument import preset, reference_rig
from tautline.simulated.simulate import simulate
from tautline.trajectory import RATE_HZ, Trajectory, back_and_forth, in_turn, through
from tools.so101 import find

Array = npt.NDArray[np.float64]

FIRST_SEED = 100  # those below are for tuning
NOISE_PX = 0.05
PLACES = 201  # at which B is compared
SURE, WIDER = 2.0, 2.0  # sigma within which B is to be; times a calibration's sigma
# Calibration motion and five minutes of free motions.
JOINTS = {
    "rotation": ("single-joint-rotation", ("random-waypoints", "figure-eight", "repetitive-motion")),
    "elbow": ("single-joint-elbow", ("dual-joint-elbow-wrist", "workspace-sweep", "large-amplitude")),
}

# Of the generator, times in s, lengths in shares of the range.
_VISITED = 0.5, 0.85
_HABITS, _HABIT = 4, 0.4  # favourite places; how often one is the target
_BESIDE, _CORRECTION = 0.02, 0.015  # standard deviations of a target about its place, of a correction
_PACE_S, _LEAST_S, _CORRECTION_S = (2.5, 7.0), 0.4, (0.25, 0.6)  # of a reach over the range; of any; of a correction
_CORRECTIONS, _REST_S = 4, 1.0  # fewer than so many after a reach; the mean of a rest


def teleoperation(actuator: Actuator, seconds: float, seed: int) -> Trajectory:
    """Reaches of least jerk (Flash and Hogan 1985) as a person leads an instrument, within 50 to 85 % of the range."""
    rng = np.random.default_rng([seed, 0x7E1E])
    span = actuator.span
    visited = rng.uniform(*_VISITED) * span
    low = actuator.range[0] + rng.uniform(0.0, span - visited)
    high = low + visited
    habits = rng.uniform(low, high, _HABITS)
    parts = [np.array([rng.uniform(low, high)])]
    samples = 1

    def reach(target: float, duration_s: float) -> None:
        nonlocal samples
        here, count = parts[-1][-1], max(int(duration_s * RATE_HZ), 1)
        x = np.arange(1, count + 1) / count
        parts.append(here + (np.clip(target, low, high) - here) * x**3 * (10.0 - 15.0 * x + 6.0 * x * x))
        samples += count

    while samples < seconds * RATE_HZ:
        habit = rng.choice(habits) + rng.normal(0.0, _BESIDE * span)
        target = habit if rng.random() < _HABIT else rng.uniform(low, high)
        far = abs(target - parts[-1][-1]) / span
        reach(target, max(_LEAST_S, far * rng.uniform(*_PACE_S)))
        for _ in range(rng.integers(_CORRECTIONS)):
            reach(parts[-1][-1] + rng.normal(0.0, _CORRECTION * span), rng.uniform(*_CORRECTION_S))
        reach(parts[-1][-1], rng.exponential(_REST_S))
    q = np.concatenate(parts)[: int(seconds * RATE_HZ)]
    return Trajectory(np.arange(len(q)) / RATE_HZ, q)


def calibration_motion(actuator: Actuator) -> Trajectory:
    """20 s over the range as a live calibration moves: quick strokes up and down, and a turn where they began."""
    low, span = actuator.range[0], actuator.span
    strokes = back_and_forth(actuator, [0.56 * span], 0.18 * span, 28, 10.0 * span, 0.03)
    return in_turn(strokes, through([low, low + 0.18 * span], 0.56 * span, 10.0 * span))


@dataclass(frozen=True)
class Score:
    """B from use beside a calibration's, at places that were passed and measured unless it is said otherwise."""

    z: float  # rms of its error in sigma
    within: float  # share of the places that are within SURE sigma
    ratio: float  # median of its sigma over the calibration's
    sharp: float  # of all places passed, measured or not: share with a sigma of at most WIDER times the calibration's
    both: float  # the same, of those with B within SURE sigma too

    @classmethod
    def of(cls, model: Model, passed: tuple[float, float], beside: Model, truth: Array, truth_sigma: Array) -> Score:
        """truth, truth_sigma: (PLACES,) of B, on even places of `passed`."""
        q = np.linspace(*passed, PLACES)
        width, sigma, other = (
            np.interp(q, each.q, values)
            for each, values in ((model, model.width), (model, model.width_sigma), (beside, beside.width_sigma))
        )
        measured = (q >= model.measured[0]) & (q <= model.measured[1])
        z, ratio = (width - truth) / np.hypot(sigma, truth_sigma), sigma / other
        sharp = measured & (ratio <= WIDER)
        within = np.abs(z) <= SURE
        return cls(
            float(np.sqrt(np.mean(z[measured] ** 2))), float(np.mean(within[measured])), float(np.median(ratio)),
            float(np.mean(sharp)), float(np.mean(sharp & within)),
        )  # fmt: skip

    def cells(self) -> list[str]:
        return [
            f"{self.z:.2f}", f"{100 * self.within:.0f} %", f"{self.ratio:.2f}", f"{100 * self.sharp:.0f} %",
            f"{100 * self.both:.0f} %",
        ]  # fmt: skip


@dataclass(frozen=True)
class Used:
    """One simulated instrument; `closed` is the calibration with the proposed motion's recording beside the use's."""

    found: Calibration
    score: Score
    passed: tuple[float, float]  # by the play's centre
    closed: Calibration | None
    closing_s: float

    @classmethod
    def of(cls, seed: int, seconds: float = 300.0) -> Used:
        rig = reference_rig()
        instrument = preset("random", rig, seed)
        led = teleoperation(rig.actuator, seconds, seed)
        use = simulate(rig, instrument, led, noise_px=NOISE_PX, seed=seed, name="use")
        instrument.reset()
        p = instrument.centre(led.t_s, led.q)
        passed = float(p.min()), float(p.max())
        moved = calibration_motion(rig.actuator)
        beside = calibrate([simulate(rig, instrument, moved, noise_px=NOISE_PX, seed=seed)], rig).model
        found = calibrate([use], rig)
        truth = instrument.backlash(np.linspace(*passed, PLACES))
        score = Score.of(found.model, passed, beside, truth, np.zeros(PLACES))
        proposed = closing(found.model, found.gaps, [use])
        if proposed is None:
            return cls(found, score, passed, None, 0.0)
        further = simulate(rig, instrument, proposed, noise_px=NOISE_PX, seed=seed + 1, name="proposed")
        return cls(found, score, passed, calibrate([use, further], rig), proposed.duration_s)


def _spans(found: Calibration) -> str:
    return ", ".join(f"{gap.low:.3g} to {gap.high:.3g}" for gap in found.gaps) or "none"


def simulated(console: Console, seeds: int) -> None:
    table = Table(
        "seed", "verdict", "z", "in 2 sigma", "sigma ratio", "<= 2", "both", "missing, mm", "s", "then missing"
    )
    scores = []
    for seed in track(range(FIRST_SEED, FIRST_SEED + seeds), "instruments", console=console):
        used = Used.of(seed)
        scores.append(used.score)
        then = "" if used.closed is None else _spans(used.closed)
        verdict = used.found.model.quality.verdict.value
        table.add_row(
            str(seed), verdict, *used.score.cells(), _spans(used.found), f"{used.closing_s:.0f}", then
        )  # fmt: skip
    console.print(table)
    enough = sum(score.both >= 0.6 for score in scores)
    console.print(f"{enough} of {seeds}: B within 2 sigma and sigma within 2 times over 60 % of what was passed")


def joints(console: Console, folder: Path) -> None:
    rig = Rig.load(folder / "rig.toml")
    table = Table("joint", "verdict", "z", "in 2 sigma", "sigma ratio", "<= 2", "both", "missing, deg")
    for joint, (motion, free) in JOINTS.items():
        beside = calibrate([load(folder / f"{joint}-{motion}", rig)], rig).model
        found = calibrate([load(folder / f"{joint}-{each}", rig) for each in free], rig)
        low, high = (max(found.model.measured[0], beside.measured[0]), min(found.model.measured[1], beside.measured[1]))
        q = np.linspace(low, high, PLACES)
        truth, sigma = np.interp(q, beside.q, beside.width), np.interp(q, beside.q, beside.width_sigma)
        score = Score.of(found.model, (low, high), beside, truth, sigma)
        table.add_row(joint, found.model.quality.verdict.value, *score.cells(), _spans(found))
    console.print(table)


@click.command()
@click.argument("data", required=False, type=click.Path(path_type=Path, exists=True))
@click.option("--seeds", default=20, show_default=True, help="Simulated instruments.")
def main(data: Path | None, seeds: int) -> None:
    """B from teleoperation alone, beside a calibration's."""
    console = Console(width=170, highlight=False)
    simulated(console, seeds)
    folder = data or find()
    if folder is None:
        console.print("no SO-101 data beside the repository: name their folder")
    else:
        joints(console, folder)


if __name__ == "__main__":
    main()
