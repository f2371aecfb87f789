"""Blind cases: recordings of the second instrument, with labels that stay sealed until the diagnoses are written."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tautline.blindtest.reality import KNOWN, UNKNOWN, Plant, Truth, record
from tautline.recording import Recording
from tautline.rig import Rig
from tautline.simulated import trajectory
from tautline.simulated.instrument import preset, reference_rig
from tautline.simulated.trajectory import Trajectory


@dataclass(frozen=True)
class Label:
    kind: str  # none, single, pair or unknown
    effects: tuple[str, ...]  # library ids, or names of UNKNOWN
    throughout: bool  # else only after the calibration
    values: Mapping[str, float]

    def sealed(self, salt: str) -> str:
        """A commitment to the label: SHA-256 over salt and label."""
        text = json.dumps([self.kind, self.effects, self.throughout, dict(self.values)], sort_keys=True)
        return hashlib.sha256((salt + text).encode()).hexdigest()


@dataclass(frozen=True)
class Case:
    rig: Rig
    calibration: Recording
    tests: list[Recording]
    further: Recording  # a motion that the diagnosis never sees: what a claim is measured by
    label: Label


def make(seed: int, kind: str, effects: tuple[str, ...] = ()) -> Case:
    """The case of a seed. `effects` fixes what is switched on; else it is drawn."""
    rng = np.random.default_rng([seed, 0xCA5E])
    rig = _rig(rng)
    instrument = preset("random" if rng.random() < 0.7 else "reference", rig, int(rng.integers(1 << 30)))
    plant = Plant(
        rig, instrument.grid, instrument.width, instrument.c_deg, float(np.exp(rng.uniform(np.log(0.02), np.log(0.1))))
    )
    chosen = effects or _drawn(rng, kind)
    values: dict[str, float] = {}
    for name in chosen:
        values |= (KNOWN.get(name) or UNKNOWN[name])(rng, rig)
    throughout = bool(rng.random() < 0.5) and not {
        "registration.static",
        "acquisition.delay",
        "configuration.contact",
    } & set(chosen)
    if "transmission.load_dependence" in chosen:
        throughout = True  # the load is there all along; what is recorded is how much of it
    loaded = "transmission.load_dependence" in chosen or rng.random() < 0.15
    motions = _motions(rng, rig)
    starts = np.concatenate([[0.0], np.cumsum([m.duration_s + 5.0 for m in motions])])
    if "registration.shift" in chosen:
        values["slip_time"] = float(starts[1] + rng.uniform(0.25, 0.75) * motions[1].duration_s)
        throughout = True  # it happens when it happens
    recordings = []
    for i, (motion, start) in enumerate(zip(motions, starts, strict=False)):
        truth = Truth(values if throughout or i > 0 else {})
        load = _load(rng, motion, i) if loaded else None
        recordings.append(record(plant, truth, motion, float(start), int(rng.integers(1 << 30)), f"motion-{i}", load))
    return Case(rig, recordings[0], recordings[1:3], recordings[3], Label(kind, chosen, throughout, values))


def _drawn(rng: np.random.Generator, kind: str) -> tuple[str, ...]:
    if kind == "none":
        return ()
    if kind == "unknown":
        return (str(rng.choice(list(UNKNOWN))),)
    count = 1 if kind == "single" else 2
    return tuple(str(name) for name in rng.choice(list(KNOWN), count, replace=False))


def _rig(rng: np.random.Generator) -> Rig:
    document: dict[str, Any] = reference_rig().to_document()
    document["camera"]["delay_s"] = float(rng.uniform(0.04, 0.1))
    document["camera"]["frame_rate_hz"] = float(rng.choice([25.0, 30.0, 50.0]))
    document["kinematics"]["bending_length_mm"] = float(rng.uniform(15.0, 20.0))
    document["hand_eye"]["rotation_deg"] = [float(v) for v in rng.normal(0.0, 4.0, 3)]
    return Rig.from_document(document, "case")


def _motions(rng: np.random.Generator, rig: Rig) -> list[Trajectory]:
    """A calibration (two speeds, rests), two tests at several speeds with rests and the other axes moving, one more."""
    span = rig.actuator.span
    speed = float(rng.uniform(0.05, 0.09)) * span
    calibration = trajectory.back_and_forth(rig.actuator, [speed, 2.2 * speed], 0.22 * span, 20, 10 * speed, 0.4)

    def steps(rate: float, share: float, cycles: int, dwell: float) -> Trajectory:
        return trajectory.trapezoids(rig.actuator, rate, share * span, cycles, 12 * rate, dwell)

    first = steps(float(rng.uniform(0.05, 0.1)) * span, float(rng.uniform(0.25, 0.4)), 7, 1.2)
    second = steps(float(rng.uniform(0.15, 0.3)) * span, float(rng.uniform(0.3, 0.5)), 9, 2.5)
    third = trajectory.sines(rig.actuator, float(rng.uniform(0.1, 0.25)) * span, 40.0)

    def sway(motion: Trajectory) -> Trajectory:
        return motion.with_sway(float(rng.uniform(1, 3)), float(rng.uniform(10, 35)), float(rng.uniform(9, 21)))

    return [calibration, first, sway(second), sway(third)]


def _load(rng: np.random.Generator, motion: Trajectory, which: int) -> np.ndarray:
    """mNm, slowly going up and down."""
    level = rng.uniform(10, 50)
    swing = 0.0 if which == 0 else rng.uniform(5, 25)
    return level + swing * np.sin(2 * np.pi * motion.t_s / rng.uniform(20, 40))
