"""Blind cases: recordings of the second instrument, and what was switched on, which stays sealed until the diagnoses
are written."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline import trajectory
from tautline.diagnosis import candidates
from tautline.diagnosis.fit import Fitter
from tautline.diagnosis.fitted import Fit, Scope
from tautline.diagnosis.gap import rms
from tautline.diagnosis.screen import Screened, screen
from tautline.diagnosis.segment import load_reference, prepare
from tautline.model import Model
from tautline.recording import Recording
from tautline.rig import Rig
from tautline.simulated.instrument import preset, reference_rig
from tautline.trajectory import Trajectory
from tools.blindtest.draws import KNOWN, UNKNOWN
from tools.blindtest.reality import Plant, Truth, record

Array = npt.NDArray[np.float64]

KINDS = ("single", "pair", "triple", "unknown", "none")
SEVERAL = {"pair": 2, "triple": 3}  # known effects at once
SCORED_FROM = 1_000_000  # seeds below are for tuning
VISIBLE = 2.0  # times the noise: what a recalibration leaves of an effect that counts as identifiable
_DRAWS = 8  # tries for an effect that can be seen
_IMITATORS = 4  # of the library's effects that an effect outside of it is told from
_SEEN = 0.8  # share of each recording's frames that must show the marker
# What is there already while calibrating and could be anything that calibration measures is no effect then: an obstacle
# or a kink is f_remain's, a worn spot B's, an encoder's error that of both envelopes: another B with another f_remain.
_ONLY_AFTER = {
    "actuator.encoder_periodic",
    "configuration.contact",
    "registration.static",
    "acquisition.delay",
    "configuration.remaining",
    "transmission.backlash",
    "transmission.offset",
}
# The load is there all along, what is recorded is how much of it; a shift happens when it does; weight and a marker
# beside the axis that came later would be a shift most of all.
_ONLY_THROUGHOUT = {"transmission.load_dependence", "registration.shift", "gravity", "marker_offset"}


@dataclass(frozen=True)
class Label:
    kind: str  # of KINDS
    effects: tuple[str, ...]  # library ids, or one name of UNKNOWN
    seed: int
    throughout: bool  # else only after the calibration
    values: Mapping[str, float]
    noise_px: float  # deg where the recordings hold angles, and so is `left`
    left: tuple[float, ...]  # of each effect: its gap on the tests after a recalibration, px rms per coordinate
    generator: str = "second"  # of generators.GENERATORS

    @property
    def identifiable(self) -> bool:
        return all(left >= VISIBLE * self.noise_px for left in self.left)

    def to_json(self) -> dict[str, Any]:
        lists = {"effects": list(self.effects), "left": list(self.left)}
        return {**asdict(self), **lists, "identifiable": self.identifiable}

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> Label:
        known = {name: document[name] for name in cls.__dataclass_fields__ if name in document}
        return cls(**{**known, "effects": tuple(known["effects"]), "left": tuple(known["left"])})


@dataclass(frozen=True)
class Case:
    rig: Rig
    calibration: Recording
    tests: list[Recording]
    further: Recording  # a motion that the diagnosis never sees: what a claim is measured by
    label: Label


@dataclass(frozen=True)
class Course:
    """One set-up and its motions: calibration, two tests, a further motion."""

    plant: Plant
    motions: list[Trajectory]
    starts_s: list[float]  # into the session
    seeds: list[int]
    loads: list[Array | None]
    one_clock: bool  # recordings tell the session's time; else each begins at 0

    def record(self, plant: Plant, truth: Truth, throughout: bool, which: int) -> Recording:
        there = truth if throughout or which > 0 else Truth()
        start = self.starts_s[which]
        own = start if self.one_clock else 0.0
        name = ("calibration", "test-1", "test-2", "further")[which]
        return record(plant, there, self.motions[which], start, self.seeds[which], name, self.loads[which], own)


def make(seed: int, kind: str, effects: tuple[str, ...] = ()) -> Case:
    """The case of a seed. `effects` fixes what is switched on; else it is drawn. What is too weak to be seen is drawn
    again, up to _DRAWS times."""
    rng = np.random.default_rng([seed, 0xCA5E, zlib.crc32(" ".join((kind, *effects)).encode())])
    plant = plant_of(rng)
    chosen = effects or _drawn(rng, kind)
    session = course_of(rng, plant, "transmission.load_dependence" in chosen)
    throughout, values, left = _visible(rng, session, chosen)
    recordings = [session.record(plant, Truth(values), throughout, i) for i in range(4)]
    label = Label(kind, chosen, seed, throughout, values, plant.noise_px, left)
    return Case(plant.rig, recordings[0], recordings[1:3], recordings[3], label)


def plant_of(rng: np.random.Generator) -> Plant:
    """An instrument in front of a camera."""
    rig = rig_of(rng)
    instrument = preset("random" if rng.random() < 0.7 else "reference", rig, int(rng.integers(1 << 30)))
    noise = float(np.exp(rng.uniform(np.log(0.02), np.log(0.1))))
    return Plant(rig, instrument.grid, instrument.width, instrument.c_deg, noise)


def course_of(rng: np.random.Generator, plant: Plant, loaded: bool = False, speeds: int = 2) -> Course:
    """loaded: a load varies; now and then it does anyhow. speeds: of the calibration, 1 or 2."""
    loaded = loaded or rng.random() < 0.15
    motions = motions_of(rng, plant.rig, speeds)
    starts = list(np.concatenate([[0.0], np.cumsum([m.duration_s + 5.0 for m in motions])[:-1]]))
    seeds = [int(s) for s in rng.integers(1 << 30, size=4)]
    loads = [_load(rng, motion, i) if loaded else None for i, motion in enumerate(motions)]
    return Course(plant, motions, starts, seeds, loads, bool(rng.random() < 0.5))


def _visible(
    rng: np.random.Generator, session: Course, chosen: tuple[str, ...]
) -> tuple[bool, dict[str, float], tuple[float, ...]]:
    """Whether the effects are there throughout, their amplitudes, and what of each one's gap on the tests a
    recalibration leaves (px rms per coordinate): the strongest of up to _DRAWS draws that end with the first that is
    identifiable."""
    best: tuple[bool, dict[str, float], tuple[float, ...]] = (False, {}, ())
    for _ in range(_DRAWS):
        throughout = bool(rng.random() < 0.5) and not _ONLY_AFTER & set(chosen)
        if _ONLY_THROUGHOUT & set(chosen):
            throughout = True
        drawn = [(KNOWN.get(name) or UNKNOWN[name])(rng, session.plant.rig) for name in chosen]
        for name, values in zip(chosen, drawn, strict=True):
            if name == "registration.shift":
                within = float(rng.uniform(0.25, 0.75)) * session.motions[1].duration_s
                values["slip_time"] = session.starts_s[1] + within
        left = tuple(
            left_by(session, Truth(values), throughout, name in UNKNOWN)
            for name, values in zip(chosen, drawn, strict=True)
        )
        if not best[2] or min(left) > min(best[2]):
            best = throughout, {k: v for values in drawn for k, v in values.items()}, left
        if not chosen or min(best[2]) >= VISIBLE * session.plant.noise_px:
            break
    return best


def left_by(session: Course, truth: Truth, throughout: bool, outside: bool) -> float:
    """What the true nominal model with B, f_remain, registration and delay free, one for all recordings, cannot follow
    of the tests, were there no noise: the least-squares residual of its linearisation, px rms per coordinate. Of an
    effect `outside` the library, what no single effect of the library on top of it can follow either. 0 where the
    marker is hardly seen."""
    fitter = fitter_of(session, truth, throughout)
    if fitter is None:
        return 0.0
    noise = session.plant.noise_px
    left = rms(fitter.residuals_after_step(fitter.rows(fitter.start(), fitter.no_effect))[1:])
    if not outside or left < VISIBLE * noise:
        return left
    return min(left, *(rms(fit.residuals[1:]) for fit in _imitations(fitter)))


def fitter_of(session: Course, truth: Truth, throughout: bool) -> Fitter | None:
    """Of the true nominal model and the recordings as they would be without noise; None where the marker is hardly
    seen."""
    plant = session.plant
    model = Model(
        plant.rig,
        plant.grid,
        plant.width,
        np.zeros_like(plant.grid),
        plant.c_deg,
        plant.rig.camera.delay_s if plant.rig.camera else 0.0,
        plant.rig.actuator.range,
    )
    silent = Plant(plant.rig, plant.grid, plant.width, plant.c_deg, 0.0)
    recordings = [session.record(silent, truth, throughout, i) for i in range(3)]
    if any(r.marker is None or r.marker.valid.mean() < _SEEN for r in recordings):
        return None
    fitter = Fitter(model, prepare(model, recordings[0], recordings[1:]), load_reference(recordings[0]))
    fitter.floor = plant.noise_px
    return fitter


def _imitations(fitter: Fitter) -> list[Fit]:
    """The library's effects that come nearest, one at a time."""
    base = fitter.nominal()
    limits = candidates.outlier_limits(fitter, base)
    best: dict[tuple[str, Scope], Screened] = {}
    for entry in screen(fitter, base, candidates.applicable(fitter), limits):
        best.setdefault((entry.kind.id, entry.scope), entry)
    nearest = list(best.values())[:_IMITATORS]
    return [fitter.fit(fitter.no_effect.plus(e.kind, e.scope), e.values, start=base.state) for e in nearest]


def _drawn(rng: np.random.Generator, kind: str) -> tuple[str, ...]:
    if kind == "none":
        return ()
    if kind == "unknown":
        return (str(rng.choice(list(UNKNOWN))),)
    return tuple(str(name) for name in rng.choice(list(KNOWN), SEVERAL.get(kind, 1), replace=False))


def rig_of(rng: np.random.Generator) -> Rig:
    document: dict[str, Any] = reference_rig().to_document()
    document["camera"]["delay_s"] = float(rng.uniform(0.04, 0.1))
    document["camera"]["frame_rate_hz"] = float(rng.choice([25.0, 30.0, 50.0]))
    document["kinematics"]["bending_length_mm"] = float(rng.uniform(15.0, 20.0))
    document["hand_eye"]["rotation_deg"] = [float(v) for v in rng.normal(0.0, 4.0, 3)]
    return Rig.from_document(document, "case")


def motions_of(rng: np.random.Generator, rig: Rig, speeds: int = 2) -> list[Trajectory]:
    """A calibration (at two speeds or the slower one, with rests), two tests at several speeds with rests and the other
    axes moving, one more."""
    span = rig.actuator.span
    speed = float(rng.uniform(0.07, 0.11)) * span
    calibration = trajectory.back_and_forth(
        rig.actuator, [speed, 2.2 * speed][:speeds], 0.22 * span, 20, 10 * speed, 0.4
    )

    def steps(rate: float, share: float, cycles: int, dwell: float) -> Trajectory:
        return trajectory.trapezoids(rig.actuator, rate, share * span, cycles, 12 * rate, dwell)

    first = steps(float(rng.uniform(0.05, 0.1)) * span, float(rng.uniform(0.25, 0.4)), 7, 1.2)
    second = steps(float(rng.uniform(0.15, 0.3)) * span, float(rng.uniform(0.3, 0.5)), 9, 2.5)
    third = trajectory.sines(rig.actuator, float(rng.uniform(0.1, 0.25)) * span, 40.0)

    def sway(motion: Trajectory) -> Trajectory:
        return motion.with_sway(float(rng.uniform(1, 3)), float(rng.uniform(10, 35)), float(rng.uniform(9, 21)))

    return [calibration, first, sway(second), sway(third)]


def _load(rng: np.random.Generator, motion: Trajectory, which: int) -> Array:
    """mNm, slowly going up and down."""
    level = rng.uniform(10, 50)
    swing = 0.0 if which == 0 else rng.uniform(5, 25)
    return np.asarray(level + swing * np.sin(2 * np.pi * motion.t_s / rng.uniform(20, 40)))
