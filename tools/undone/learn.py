"""How an instrument's effect becomes tables: as `taut diagnose` finds it, or as the library's nearest effect fits."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

import tautline as tl
from tautline import effects, trajectory
from tautline.model import Effect, Model
from tautline.recording import Angle, Motor, Recording
from tautline.trajectory import Trajectory
from tools.undone.plants import ENCODER, Instrument, Values

Array = npt.NDArray[np.float64]

NOISE_DEG, SENSOR_HZ = 0.02, 100.0
_EVERY = 8  # ms between the samples that are fitted to
_ENCODER_EVERY = 4  # ms between the rows of a recording's motor


@dataclass(frozen=True)
class Learnt:
    old: Model  # of the instrument before it had the effect
    new: Model
    named: str  # what was found


def beside(t: Array) -> tuple[Array, Array]:
    """Load, mNm, and another axis, its unit."""
    return 20.0 * np.sin(2 * np.pi * t / 17.0), 2.0 * np.sin(2 * np.pi * t / 13.0)


# -- diagnosed --------------------------------------------------------------------------------------------------------


def diagnosed(instrument: Instrument, values: Values, seed: int = 1) -> Learnt:
    """One calibration before the effect and two tests with it, recorded by encoder and an angle sensor with noise:
    then all is `taut diagnose`'s."""
    rng = np.random.default_rng([seed, 0x07D0])
    calibration, *tests = _motions(instrument)
    diagnosis = tl.diagnose(
        _recorded(instrument, {}, calibration, "calibration", rng),
        [_recorded(instrument, values, motion, f"test-{i + 1}", rng) for i, motion in enumerate(tests)],
    )
    named = [f"{effect['id']} {effect['probability']:.2f}" for effect in diagnosis.document["effects"]]
    return Learnt(diagnosis.nominal, diagnosis.corrected, ", ".join(named) or str(diagnosis.document["verdict"]))


def _motions(instrument: Instrument) -> list[Trajectory]:
    """A calibration at two speeds with rests; a slow and a fast test with rests."""
    actuator, span = instrument.rig.actuator, instrument.rig.actuator.span
    speed = 0.09 * span
    return [
        trajectory.back_and_forth(actuator, [speed, 2.2 * speed], 0.24 * span, 16, 10 * speed, 0.4),
        trajectory.trapezoids(actuator, 0.08 * span, 0.33 * span, 6, span, 1.2),
        trajectory.trapezoids(actuator, 0.25 * span, 0.42 * span, 9, 3.0 * span, 2.5),
    ]


def _recorded(
    instrument: Instrument, values: Values, motion: Trajectory, name: str, rng: np.random.Generator
) -> Recording:
    t = np.arange(0.0, motion.t_s[-1], 1e-3)
    reading = np.interp(t, motion.t_s, motion.q)
    load, other = beside(t)
    other = other if values else 0.0 * other  # at rest while it is calibrated
    c = instrument.moved(values, t, reading, load, other)
    resolution = instrument.rig.actuator.encoder_resolution
    rows = slice(None, None, _ENCODER_EVERY)
    q = np.round(reading[rows] / resolution) * resolution
    columns = {"translation_mm": other[rows]} if instrument.joint == "translation_mm" else {}
    extra = {} if columns else {instrument.joint: np.round(other[rows], 3)}
    motor = Motor(t[rows], q, load_mNm=load[rows], extra=extra, **columns)
    seen = np.arange(0.007, t[-1], 1.0 / SENSOR_HZ)
    angle = Angle(seen, np.interp(seen, t, c) + rng.normal(0.0, NOISE_DEG, len(seen)))
    return Recording(name, motor, angle=angle, rig=instrument.rig)


# -- fitted -----------------------------------------------------------------------------------------------------------


def fitted(instrument: Instrument, name: str, values: Values) -> Learnt:
    """The library's effect that comes nearest on top of the true model, from one motion without noise."""
    model = instrument.model
    effect = _nearest(instrument, name, values)
    kind = effects.BY_ID[name]
    new = replace(model, effects=(effect,))
    if kind.holds is not None:
        new = replace(kind.holds(model, effect.parameters, 0.0), effects=(effect,))
    return Learnt(model, new, name)


def _nearest(instrument: Instrument, name: str, values: Values) -> Effect:
    model = instrument.model
    kind, rig, span = effects.BY_ID[name], model.rig, model.rig.actuator.span
    by_translation = instrument.joint == "translation_mm"
    if kind.of_joint is not None and not by_translation:
        kind = kind.of_joint(instrument.joint)
    path = trajectory.trapezoids(rig.actuator, 0.12 * span, 0.35 * span, 5, 1.5 * span, 1.0)
    fast = trajectory.random_smooth(rig.actuator, 0.25 * span, 25.0, 5)
    t = np.arange(0.0, path.t_s[-1] + fast.t_s[-1], 1e-3)
    q = np.interp(t, np.concatenate([path.t_s, path.t_s[-1] + 0.5 + fast.t_s]), np.concatenate([path.q, fast.q]))
    load, other = beside(t)
    seen = instrument.moved(values, t, q, load, other)[::_EVERY]
    motor = Motor(
        t,
        q,
        translation_mm=other if by_translation else None,
        rotation_deg=0.0 * t if by_translation else None,
        load_mNm=load,
        extra={} if by_translation else {instrument.joint: other},
    )
    left_out = "c_per_rotation", "offset_at_tip", "joint_play"
    own = [p for p in kind.parameters if not (p.name in left_out or p.searched)]
    unit = np.array([p.scale * (span if p.unit.startswith("unit") else 1.0) for p in own])
    low, high = (np.array([getattr(p, end) for p in own]) / 1.0 for end in ("low", "high"))
    fixed: dict[str, Any] = {p.name: p.shape[-1] for p in kind.shapes if p.searched}
    fixed |= {"offset_at_tip": 0.0} if "offset" in name else {}
    fixed |= {"column": kind.column, "joint_play": 0.0} if kind.column else {}

    def off(x: Array) -> Array:
        v = dict(zip((p.name for p in own), (x * unit).tolist(), strict=True)) | fixed
        return effects.follow(model, motor, t[::_EVERY], v).c_deg - seen

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
