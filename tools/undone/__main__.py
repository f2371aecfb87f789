"""python -m tools.undone: how much of what an instrument's effect costs do the tables take away, open loop?

The second instrument shares no equation with the package. Its effect is learnt as the library's, from one motion of the
motor and the tip's angle beside it, and undone by the board's own code at 1 kHz on another trajectory of the tip.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Mapping
from dataclasses import replace

import click
import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from tools.undone.plants import ENCODER, STRENGTHS, instrument, moved

from tautline import _native, effects, tables, trajectory
from tautline.model import Effect, Model
from tautline.recording import Motor
from tautline.rig import Actuator
from tautline.undone import Joint

Array = npt.NDArray[np.float64]

RATE_HZ = 1000
EVERY = 8  # ms between the samples that are learnt from
SETTLED_S = 8.0
LIMITS = tables.Limits(speed_max=100.0, takeup_speed=50.0, takeup_accel=5000.0, band=0.002)
JOINTS = {"translation_mm": Joint(1, 0.001)}


def model_of(plant_grid: Array, width: Array, c_deg: Array, rig: object) -> Model:
    q = np.linspace(-5.0, 5.0, 401)
    b, c = np.interp(q, plant_grid, width), np.interp(q, plant_grid, c_deg)
    return Model(rig, q, b, 0.0 * q, c, 0.08, (-5.0, 5.0))  # type: ignore[arg-type]


def beside(t: Array) -> tuple[Array, Array]:
    """Load, mNm, and another axis, mm."""
    return 20.0 * np.sin(2 * np.pi * t / 17.0), 2.0 * np.sin(2 * np.pi * t / 13.0)


def learnt(model: Model, name: str, values: Mapping[str, float]) -> Effect:
    """The library's effect that comes nearest, from one motion."""
    kind, rig, span = effects.BY_ID[name], model.rig, model.rig.actuator.span
    path = trajectory.trapezoids(rig.actuator, 0.12 * span, 0.35 * span, 5, 1.5 * span, 1.0)
    fast = trajectory.random_smooth(rig.actuator, 0.25 * span, 25.0, 5)
    t = np.arange(0.0, path.t_s[-1] + fast.t_s[-1], 1e-3)
    q = np.interp(t, np.concatenate([path.t_s, path.t_s[-1] + 0.5 + fast.t_s]), np.concatenate([path.q, fast.q]))
    load, translation = beside(t)
    seen = moved(instrument(), values, t, q, load, translation)[::EVERY]
    motor = Motor(t, q, None, translation, 0.0 * t, load)
    own = [p for p in kind.parameters if not (p.name in ("c_per_rotation", "offset_at_tip") or p.searched)]
    unit = np.array([p.scale * (span if p.unit.startswith("unit") else 1.0) for p in own])
    low, high = (np.array([getattr(p, end) for p in own]) / 1.0 for end in ("low", "high"))
    fixed = {p.name: p.shape[-1] for p in kind.shapes if p.searched} | (
        {"offset_at_tip": 0.0} if "offset" in name else {}
    )

    def off(x: Array) -> Array:
        v = dict(zip((p.name for p in own), (x * unit).tolist(), strict=True)) | fixed
        return effects.follow(model, motor, t[::EVERY], v).c_deg - seen

    best = None
    starts = [[s * (span if p.unit.startswith("unit") else 1.0) for s in p.shape] or [0.0] for p in own]
    if name == ENCODER:  # a turn is looked for by `taut diagnose`; here it is nearly known
        starts = [
            [1.01 * values["encoder_period"]] if p.name == "encoder_period" else s
            for p, s in zip(own, starts, strict=False)
        ]
    for first in itertools.islice(itertools.product(*starts), 4):
        for way in (1.0, -1.0) if own[0].one_way else (1.0,):
            begin = np.array(first)
            begin[0] += way * own[0].probe * unit[0]
            x0 = np.clip(begin, low + 1e-9, high - 1e-9) / unit
            minimum = least_squares(off, x0, bounds=(low / unit, high / unit), diff_step=1e-3, max_nfev=25)
            best = minimum if best is None or minimum.cost < best.cost else best
    assert best is not None
    return Effect(name, dict(zip((p.name for p in own), (best.x * unit).tolist(), strict=True)) | fixed)


def set_points(model: Model, t: Array, c_deg: Array, load: Array, translation: Array) -> Array:
    """The board's, of a host that tells it the load every 20 ms."""
    table = _native.FixedTable(tables.encode(model, limits=LIMITS, joints=JOINTS))
    c = np.rint(c_deg * _native.DEG_ONE).astype(np.int32)
    at = int(np.clip(table.angle_inverse(c[:1])[0][0], table.fields["q_min"], table.fields["q_max"]))
    board = _native.FixedCompensator(table, RATE_HZ, _native.MODE_FULL, at, int(c[0]))
    q = np.empty(len(c))
    coupled = "joints" in table.fields["sections"]
    step = 1 if coupled else 20
    for i in range(0, len(c), step):
        if i % 20 == 0:
            board.load(round(load[i] * 256.0), 20)
        if coupled:
            board.joint(0, round(translation[i] / 0.001 * _native.COUNT_ONE))
        q[i : i + step] = board.run(c[i : i + step])[0]
    return q * model.rig.actuator.encoder_resolution / _native.COUNT_ONE


def tip_off(model: Model, values: Mapping[str, float], t: Array, c_deg: Array) -> float:
    load, translation = beside(t)
    reading = set_points(model, t, c_deg, load, translation)
    c = moved(instrument(), values, t, reading, load, translation)
    return float(np.sqrt(np.mean((c - c_deg)[t > SETTLED_S] ** 2)))


@click.command()
@click.option("--effect", "only", multiple=True, help="Part of an effect's name; all without.")
@click.option("--seconds", default=40.0, show_default=True, help="Of the trajectory that is scored.")
def main(only: tuple[str, ...], seconds: float) -> None:
    """The tip's error, deg rms: old tables, new ones, and without the effect, as its true inverse would leave it."""
    plant = instrument()
    model = model_of(plant.grid, plant.width, plant.c_deg, plant.rig)
    planned = trajectory.random_smooth(Actuator("deg", (-38.0, 38.0), 1e-3), 15.0, seconds, 3)
    t = np.arange(0.0, planned.t_s[-1], 1.0 / RATE_HZ)
    c_deg = np.interp(t, planned.t_s, planned.q)
    true = tip_off(model, {}, t, c_deg)
    print("| effect | strength | old tables | new tables | true inverse | gained of what it gains |\n|" + " --- |" * 6)
    for name, strengths in STRENGTHS.items():
        if only and not any(part in name for part in only):
            continue
        for values in strengths:
            begun = time.monotonic()
            effect = learnt(model, name, values)
            kind = effects.BY_ID[name]
            new = replace(model, effects=(effect,))
            if kind.holds is not None:
                new = replace(kind.holds(model, effect.parameters, 0.0), effects=(effect,))
            old, now = tip_off(model, values, t, c_deg), tip_off(new, values, t, c_deg)
            says = ", ".join(f"{key} {value:g}" for key, value in values.items())
            gained = (old - now) / (old - true)
            print(f"| {name} | {says} | {old:.4f} | {now:.4f} | {true:.4f} | {100 * gained:.0f} % |", flush=True)
            click.echo(f"{name}: {time.monotonic() - begun:.0f} s, {effect.parameters}", err=True)


if __name__ == "__main__":
    main()
