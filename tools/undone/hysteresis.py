"""Hysteresis written down here, undone open loop by the tables of a calibration: several plays against one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import click
import numpy as np
import numpy.typing as npt

import tautline as tl
from tautline import effects, trajectory
from tautline.elements import SINGLE
from tautline.model import Model
from tautline.recording import Angle, Motor, Recording
from tautline.rig import Actuator, AngleSensor, Rig
from tautline.simulated.instrument import preset

Array = npt.NDArray[np.float64]
Plant = Callable[[Array], Array]  # where the motor is, mm, 1 ms apart -> the tip's angle, deg

_NOISE_DEG, _SENSOR_HZ, _ENCODER_EVERY = 0.02, 100.0, 4
_SETTLED_S = 8.0
_PATHS = range(3, 8)  # seeds of the trajectories
_LIMITS = {"speed_max": 100.0, "takeup_speed": 50.0, "takeup_accel": 5000.0, "band": 0.002}
_TIMES = {"plays": 5.0, "gradual": 5.0, "broad": 5.0, "bouc-wen": 2.0, "dahl": 2.0}
_COUNTS = 2.0  # or as near as this


def _width(p: Array) -> Array:
    return 0.45 + 0.2 * np.exp(-0.5 * ((p - 1.0) / 1.4) ** 2) - 0.1 * np.exp(-0.5 * ((p + 2.5) / 1.1) ** 2)


def _law(p: Array) -> Array:
    return 12.0 * p + 2.0 * np.sin(0.7 * p)


_GRID = np.linspace(-8.0, 8.0, 8001)


def of_plays(share: Array, weight: Array) -> Plant:
    """Each play has its own centre, and its share of B there; the tip follows their mean."""

    def tip(q: Array) -> Array:
        total = np.zeros_like(q)
        for s, w in zip(share, weight, strict=True):
            half = 0.5 * s * _width(_GRID)
            low, high = np.interp(q, _GRID + half, _GRID), np.interp(q, _GRID - half, _GRID)
            p, path = 0.5 * (low[0] + high[0]), np.empty_like(q)
            for k, (a, b) in enumerate(zip(low.tolist(), high.tolist(), strict=True)):
                p = a if p < a else min(p, b)
                path[k] = p
            total += w * path
        return _law(total)

    return tip


def of_friction(rate: Callable[[float, float], float]) -> Plant:
    """p = q - B(q) z / 2; rate(z, way) is dz over the motor's way, of friction that builds up to +-1. Where it turns,
    the tip stands still at first: the length that makes it so is the unit of the way."""
    steepest = max(rate(1.0, -1.0), rate(-1.0, 1.0))

    def tip(q: Array) -> Array:
        z, path = 0.0, np.empty_like(q)
        for k, dx in enumerate((np.diff(q, prepend=q[0]) / (0.5 * _width(q) * steepest)).tolist()):
            for _ in range(4):
                z = min(max(z + 0.25 * dx * rate(z, 1.0 if dx > 0.0 else -1.0), -1.0), 1.0)
            path[k] = z
        return _law(q - 0.5 * _width(q) * path)

    return tip


def bouc_wen(n: float) -> Plant:
    return of_friction(lambda z, way: 1.0 - abs(z) ** n * (0.6 * way * (1.0 if z > 0.0 else -1.0) + 0.4))


def gradual(spread: float) -> Plant:
    share = 1.0 + spread * np.linspace(-1.0, 1.0, 41)
    return of_plays(share, np.full(41, 1.0 / 41.0))


def _several(seed: int) -> Plant:
    rng = np.random.default_rng([seed, 0x91A7])
    count = int(rng.integers(3, 8))
    weight = rng.dirichlet(np.full(count, 3.0))
    share = np.sort(rng.uniform(0.3, 1.5, count))
    return of_plays(share / (weight @ share), weight)


def broad(kind: str) -> Plant:
    """Thresholds from nothing to far beyond B: evenly, by their exponential distribution, or of seven plays."""
    if kind == "seven":
        share, weight = np.array([0.1, 0.3, 0.6, 1.0, 1.6, 2.4, 3.2]), np.array([4.0, 4.0, 3.0, 3.0, 2.4, 2.0, 1.6])
    else:
        place = (np.arange(40) + 0.5) / 40.0
        share, weight = 2.0 * place if kind == "even" else -np.log(1.0 - place), np.ones(40)
    weight = weight / weight.sum()
    return of_plays(share / float(share @ weight), weight)


PLANTS: Mapping[str, Plant] = {
    **{f"plays {seed}": _several(seed) for seed in range(1, 5)},
    **{f"gradual {spread:.0%}": gradual(spread) for spread in (0.05, 0.1, 0.2, 0.35, 0.5)},
    **{f"broad {kind}": broad(kind) for kind in ("even", "exponential", "seven")},
    **{f"bouc-wen {n}": bouc_wen(n) for n in (1, 2, 5)},
    "dahl": of_friction(lambda z, way: 1.0 - z * way),
}


def recorded(plant: Plant, rig: Rig) -> Recording:
    """The motion of a calibration, then 40 s of use, whose strokes end within the backlash too; by encoder and an angle
    sensor with noise."""
    actuator = rig.actuator
    speed = 0.09 * actuator.span
    strokes = trajectory.back_and_forth(actuator, [speed, 2.2 * speed], 0.24 * actuator.span, 16, 10 * speed, 0.4)
    used = trajectory.random_smooth(Actuator("mm", (-4.0, 4.0), actuator.encoder_resolution), 1.2, 40.0, 9)
    between = np.linspace(strokes.q[-1], used.q[0], 2000)
    q = np.concatenate([strokes.q, between, used.q])
    motion = trajectory.Trajectory(1e-3 * np.arange(len(q)), q)
    rows = slice(None, None, _ENCODER_EVERY)
    resolution = actuator.encoder_resolution
    motor = Motor(motion.t_s[rows], np.round(motion.q[rows] / resolution) * resolution)
    seen = np.arange(0.007, motion.t_s[-1], 1.0 / _SENSOR_HZ)
    noise = np.random.default_rng(0xCA1).normal(0.0, _NOISE_DEG, len(seen))
    return Recording(
        "calibration", motor, angle=Angle(seen, np.interp(seen, motion.t_s, plant(motion.q)) + noise), rig=rig
    )


def one_play(model: Model, recording: Recording) -> Model:
    """The same curves with one play, of the width that follows the recording best."""
    assert recording.angle is not None
    scene = recording.angle.t_s - model.delay_of("angle")

    def with_scale(scale: float) -> Model:
        return replace(model, elements=SINGLE, friction=None, width=scale * model.width)

    def off(scale: float) -> float:
        assert recording.angle is not None
        path = effects.follow(with_scale(scale), recording.motor, scene, {})
        return float(np.mean((path.c_deg - recording.angle.c_deg)[scene > 3.0] ** 2))

    return with_scale(min(np.linspace(0.4, 1.1, 36).tolist(), key=off))


def tip_off(plant: Plant, model: Model, t: Array, c_deg: Array) -> float:
    """deg rms."""
    from tautline import _native, tables

    table = _native.FixedTable(tables.encode(model, limits=tables.Limits(**_LIMITS)))
    c = np.rint(c_deg * _native.DEG_ONE).astype(np.int32)
    at = int(np.clip(table.angle_inverse(c[:1])[0][0], table.fields["q_min"], table.fields["q_max"]))
    board = _native.FixedCompensator(table, 1000, _native.MODE_FULL, at, int(c[0]))
    q = board.run(c)[0] * model.rig.actuator.encoder_resolution / _native.COUNT_ONE
    return float(np.sqrt(np.mean((plant(q) - c_deg)[t > _SETTLED_S] ** 2)))


@click.command()
@click.option("--plant", "only", multiple=True, help="Part of a plant's name; all without.")
@click.option("--seconds", default=40.0, show_default=True, help="Of the trajectory that is scored.")
def main(only: tuple[str, ...], seconds: float) -> None:
    """Plays, gradual onsets, Bouc-Wen and Dahl: the tip's error, deg rms, by the tables of a calibration; medians of
    five trajectories, and the least of their ratios."""
    rig = Rig(preset("reference").rig.actuator, preset("reference").rig.coarse, angle=AngleSensor(0.0))
    count = rig.actuator.encoder_resolution * abs(rig.coarse.gain)
    paths = [trajectory.random_smooth(Actuator("deg", (-38.0, 38.0), 1e-3), 15.0, seconds, seed) for seed in _PATHS]
    columns = "plant", "plays", "one play", "several plays", "counts", "times closer", "worst", "goal", "met"
    print("| " + " | ".join(columns) + " |\n|" + " --- |" * len(columns))
    for name, plant in PLANTS.items():
        if only and not any(part in name for part in only):
            continue
        recording = recorded(plant, rig)
        model = tl.calibrate(recording).model
        single = one_play(model, recording)
        each = np.array([[tip_off(plant, m, path.t_s, path.q) for m in (single, model)] for path in paths])
        one, several = np.median(each, axis=0)
        times = each[:, 0] / each[:, 1]
        goal = next(least for start, least in _TIMES.items() if name.startswith(start))
        met = np.median(times) >= goal or several <= _COUNTS * count
        print(
            f"| {name} | {len(model.elements.width)} | {one:.4f} | {several:.4f} | {several / count:.2f} | "
            f"{np.median(times):.1f} | {times.min():.1f} | {goal:g} or {_COUNTS:g} counts | {'yes' if met else 'NO'} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
