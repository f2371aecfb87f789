"""python -m tools.next_motion OUT [--cases N] [--seed S] [--jobs J]: recordings until one answer is sure, by the next
motion of each diagnosis and by the same fixed strokes again.

The second instrument (tools/blindtest) with a weak effect (2 to 8 times the noise after a recalibration), a cause
outside of the library, or nothing. A calibration and one short recording of strokes; a case counts where no answer has
95 % after that. Then either way adds recordings of at most a minute to all before, until one has, or there are eight.
Each case comes from its seed alone and is stored in OUT; a campaign that was broken off goes on where it was.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import click
import matplotlib.pyplot as plt
import numpy as np
from rich.console import Console
from rich.progress import Progress

from tautline import trajectory
from tautline.calibration.calibrate import calibrate
from tautline.diagnosis.diagnose import diagnose
from tautline.folders import write_file
from tautline.live.asking import SURE, Leading
from tautline.recording import Recording
from tautline.trajectory import Trajectory
from tools.blindtest.cases import VISIBLE, Course, course_of, left_by, plant_of
from tools.blindtest.draws import KNOWN, UNKNOWN
from tools.blindtest.reality import Plant, Truth, record

FIRST_SEED = 8_000_000  # scored; below it is tuned
MOST = 8  # recordings
WAYS = ("next motion", "fixed strokes")
_SHARES = {"single": 0.7, "unknown": 0.15, "none": 0.15}
_WEAK = 8.0  # times the noise: what a recalibration leaves, at most
_DRAWS = 16  # tries for an effect as weak
PAUSE_S = 5.0  # between recordings
_NO_COLUMN = tuple(name for name in KNOWN if name not in ("transmission.load_dependence", "registration.shift"))


@dataclass(frozen=True)
class World:
    """An instrument with what is wrong with it, and the clock of its session."""

    course: Course
    truth: Truth
    throughout: bool
    right: frozenset[str]  # answers that are right

    def motion(self, which: int, motion: Trajectory, starts_s: float, seed: int) -> Recording:
        """Recording number `which` of the session (0: calibration), from `starts_s` on."""
        there = self.truth if self.throughout or which else Truth()
        own = starts_s if self.course.one_clock else 0.0
        name = f"test-{which}" if which else "calibration"
        return record(self.course.plant, there, motion, starts_s, seed, name, None, own)


def world_of(seed: int) -> World:
    """The world of a seed: the first cause that is seen and as weak, else the last of _DRAWS draws."""
    rng = np.random.default_rng([seed, 0x5E0])
    kind = str(rng.choice(list(_SHARES), p=list(_SHARES.values())))
    plant = plant_of(rng)
    course = replace(course_of(rng, plant), loads=[None] * 4)
    if kind == "none":
        return World(course, Truth(), False, frozenset(["none"]))
    known = kind == "single"
    throughout = bool(rng.random() < 0.3) and not known
    for _ in range(_DRAWS):
        name = str(rng.choice(_NO_COLUMN if known else list(UNKNOWN)))
        values = dict((KNOWN if known else UNKNOWN)[name](rng, plant.rig))
        left = left_by(course, Truth(values), throughout, not known)
        if VISIBLE * plant.noise_px <= left <= _WEAK * plant.noise_px:
            break
    return World(course, Truth(values), throughout, frozenset([name if known else "unknown"]))


def strokes(plant: Plant) -> Trajectory:
    """The fixed motion: the paper's trapezoids on a mean that rises, within a minute."""
    actuator = plant.rig.actuator
    speed = 0.12 * actuator.span
    return trajectory.trapezoids(actuator, speed, 0.35 * actuator.span, 5, 10 * speed, 1.0)


def run(seed: int) -> dict[str, Any]:
    """The case of a seed, as it is stored: after the first recording, and by either way where that left it open."""
    world = world_of(seed)
    plant, fixed = world.course.plant, strokes(world.course.plant)
    seeds = np.random.default_rng([seed, 0x5E1]).integers(1 << 30, size=MOST + 1).tolist()
    calibration = world.motion(0, world.course.motions[0], 0.0, seeds[0])
    model = calibrate([calibration], plant.rig).model
    second_s = world.course.motions[0].duration_s + PAUSE_S
    first = world.motion(1, fixed, second_s, seeds[1])
    opened = diagnose(model, calibration, [first])
    leading = Leading.of(opened.document)
    case: dict[str, Any] = {"seed": seed, "right": sorted(world.right), "first": [leading.name, leading.probability]}
    if leading.probability >= SURE:
        return case
    for way in WAYS:
        tests, diagnosis, starts = [first], opened, second_s + fixed.duration_s + PAUSE_S
        said = [[leading.name, leading.probability]]
        while said[-1][1] < SURE and len(tests) < MOST:
            following = diagnosis.next_motion
            motion = following.motion if following and way == WAYS[0] else fixed
            tests.append(world.motion(len(tests) + 1, motion, starts, seeds[len(tests) + 1]))
            starts += motion.duration_s + PAUSE_S
            diagnosis = diagnose(model, calibration, tests)
            latest = Leading.of(diagnosis.document)
            said.append([latest.name, latest.probability])
        case[way] = said
        case[f"{way}, s"] = starts - second_s
    return case


def summary(cases: Sequence[Mapping[str, Any]]) -> str:
    """The table: recordings to 95 %, and how often what is sure is wrong."""
    ways = [case for case in cases if WAYS[0] in case]
    lines = [f"{len(cases)} cases, {len(ways)} with no answer at {SURE:.0%} after the first recording"]
    for way in WAYS:
        recordings = [len(case[way]) - 1 for case in ways]
        sure = [case for case in ways if case[way][-1][1] >= SURE]
        false = [case for case in sure if case[way][-1][0] not in case["right"]]
        seconds = [case[f"{way}, s"] for case in ways]
        lines.append(
            f"{way:14s} {np.mean(recordings or [0]):.2f} further recordings ({np.mean(seconds or [0]):.0f} s) in the "
            f"mean, sure {len(sure)}, of these wrong {len(false)}"
        )
    at_once = [case for case in cases if WAYS[0] not in case]
    wrong = sum(case["first"][0] not in case["right"] for case in at_once)
    return "\n".join([*lines, f"sure after the first: {len(at_once)}, of these wrong {wrong}"])


def picture(cases: Sequence[Mapping[str, Any]], path: Path) -> None:
    """The share of cases that are sure by the number of further recordings, either way."""
    ways = [case for case in cases if WAYS[0] in case]
    figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
    numbers = np.arange(MOST)
    for way in WAYS:
        sure = [len(case[way]) - 1 if case[way][-1][1] >= SURE else MOST for case in ways]
        axes.step(numbers, [100.0 * np.mean(np.array(sure) <= n) for n in numbers], where="post", label=way)
    axes.set(xlabel="further recordings", ylabel=f"% of {len(ways)} cases sure at {SURE:.0%}", ylim=(0, 100))
    axes.legend()
    figure.savefig(path, dpi=150)
    plt.close(figure)


@click.command()
@click.argument("out", type=click.Path(path_type=Path))
@click.option(
    "--cases", default=100, show_default=True, help="cases that no answer is sure of after the first recording"
)
@click.option("--seed", default=FIRST_SEED, show_default=True, help="of the first case")
@click.option("--jobs", default=2, show_default=True, help="processes")
def main(out: Path, cases: int, seed: int, jobs: int) -> None:
    """Runs cases until as many count, and prints the table."""
    out.mkdir(parents=True, exist_ok=True)
    done: dict[int, dict[str, Any]] = {}
    with Progress() as progress, ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        bar = progress.add_task("cases that count", total=cases)
        following = seed
        while (counted := sum(WAYS[0] in case for case in done.values())) < cases:
            progress.update(bar, completed=counted)
            batch = range(following, following + 2 * jobs)
            following = batch.stop
            stored = {s: out / f"{s}.json" for s in batch}
            jobs_of = {pool.submit(run, s): s for s, path in stored.items() if not path.exists()}
            for future in as_completed(jobs_of):
                write_file(stored[jobs_of[future]], json.dumps(future.result(), indent=1))
            done |= {s: json.loads(path.read_text()) for s, path in stored.items()}
    every = list(done.values())
    picture(every, out / "sure.png")
    Console(highlight=False).print(summary(every))


if __name__ == "__main__":
    main()
