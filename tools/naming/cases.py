"""Sessions with one effect that was there from the first recording on, as strong as asked for."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tautline import effects
from tautline.diagnosis.fit import Fitter
from tautline.diagnosis.gap import rms
from tautline.diagnosis.segment import load_reference, prepare
from tautline.model import Effect, Model
from tautline.recording import Recording
from tautline.rig import Rig
from tools.blindtest import cases, draws, own
from tools.blindtest.reality import Plant, Truth, at_load

Array = npt.NDArray[np.float64]

SECOND, LIBRARY = "second", "library"
COUPLING = "configuration.axis_coupling"
SWING = "configuration.swing"  # the second instrument's is all there or not at all
LOAD = "transmission.load_dependence"
SCORED_FROM = 1000  # seeds below are for tuning
# Effect -> what its strength multiplies, of the second instrument. The library's own are multiplied as they are.
_STRENGTH: Mapping[str, tuple[str, ...]] = {
    "actuator.encoder_periodic": ("encoder_error",),
    "transmission.smooth_onset": ("softness",),
    "transmission.asymmetric_backlash": ("latch",),
    "transmission.rate_dependent_backlash": ("viscosity",),
    "transmission.lag": ("dashpot",),
    "transmission.creep": ("creep_share",),
    LOAD: ("stretch_per_load", "capstan_per_load", "soften_per_load"),
    COUPLING: ("pull_by_translation", "twist"),
    SWING: (),
}
EFFECTS = tuple(_STRENGTH)
_MOTIONS = 0, 1, 2  # of the blind test's, that are recorded
_OTHERS_MOVE = 0, 2, 3  # those in which other axes do, but for the calibration
OVER_NOISE = 2.0, 20.0  # what a recalibration leaves of the effect
_NOISE_PX = 0.02, 0.1
_PERIODS = 0.03, 0.15  # of the range, of an encoder
_ITERATIONS, _STRONGER = 4, 4.0  # a step of the strength, at most
_STRENGTHS = 0.05, 4.0  # times what the blind test draws


@dataclass(frozen=True)
class Case:
    effect: str  # "": none
    generator: str
    seed: int
    noise_px: float
    left_px: float  # what the true nominal, recalibrated on all recordings, leaves of the effect without any noise
    rig: Rig
    recordings: list[Recording]  # the calibration, two tests
    truth: Model  # the nominal that was recorded, at the load of the first recording


@dataclass(frozen=True)
class _Source:
    truth: Model
    noise_px: float
    record: Callable[[float, float], list[Recording]]  # strength, noise in px
    loaded: Callable[[float], Model] | None = None  # the truth at the load of the first recording, by the strength


def makes(generator: str, effect: str) -> bool:
    """The library's own instrument has no load."""
    return not (generator == LIBRARY and effect == LOAD)


def make(generator: str, effect: str, seed: int) -> Case:
    rng = np.random.default_rng([seed, 0x5747, zlib.crc32(f"{generator} {effect}".encode())])
    source = {SECOND: _second, LIBRARY: _library}[generator](rng, effect)
    if not effect:
        return Case(
            effect,
            generator,
            seed,
            source.noise_px,
            0.0,
            source.truth.rig,
            source.record(0.0, source.noise_px),
            source.truth,
        )
    wanted = source.noise_px * float(np.exp(rng.uniform(*np.log(OVER_NOISE))))
    strength, left = 1.0, 0.0
    for _ in range(_ITERATIONS):
        left = _left(source.truth, source.record(strength, 0.0), source.noise_px)
        step = float(np.clip(wanted / max(left, 1e-9), 1.0 / _STRONGER, _STRONGER))
        if abs(np.log(step)) < 0.1 or not _STRENGTHS[0] < strength * step < _STRENGTHS[1]:
            break
        strength *= step
    truth = source.loaded(strength) if source.loaded else source.truth
    return Case(
        effect,
        generator,
        seed,
        source.noise_px,
        left,
        source.truth.rig,
        source.record(strength, source.noise_px),
        truth,
    )


def _left(truth: Model, recordings: list[Recording], noise_px: float) -> float:
    fitter = Fitter(truth, prepare(truth, recordings[0], recordings[1:]), load_reference(recordings[0]))
    fitter.floor = noise_px
    return rms(fitter.residuals_after_step(fitter.rows(fitter.start(), fitter.no_effect))[1:])


def _which(effect: str) -> tuple[int, int, int]:
    return _OTHERS_MOVE if effect == COUPLING else _MOTIONS


def _noise(rng: np.random.Generator) -> float:
    return float(np.exp(rng.uniform(*np.log(_NOISE_PX))))


def _second(rng: np.random.Generator, effect: str) -> _Source:
    """The blind test's second instrument: its effects have other equations than the library's, its noise is white."""
    plant = cases.plant_of(rng)
    course = cases.course_of(rng, plant, effect == LOAD)
    values = draws.KNOWN[effect](rng, plant.rig) if effect else {}

    def record(strength: float, noise_px: float) -> list[Recording]:
        there = {name: value * (strength if name in _STRENGTH[effect] else 1.0) for name, value in values.items()}
        silent = Plant(plant.rig, plant.grid, plant.width, plant.c_deg, noise_px)
        return [course.record(silent, Truth(there), True, which) for which in _which(effect)]

    truth = _model(plant.rig, plant.grid, plant.width, plant.c_deg)

    def loaded(strength: float) -> Model:
        load = 0.0 if course.loads[0] is None else float(np.median(course.loads[0]))
        return at_load(truth, Truth({name: strength * value for name, value in values.items()}), load)

    return _Source(truth, plant.noise_px, record, loaded if effect == LOAD else None)


def _library(rng: np.random.Generator, effect: str) -> _Source:
    """The library's equations, under a noise that remembers and has outliers."""
    rig = cases.rig_of(rng)
    instrument = own.preset("random", rig, int(rng.integers(1 << 30)))
    motions, seeds = cases.motions_of(rng, rig), [int(s) for s in rng.integers(1 << 30, size=3)]
    motions = [motions[which] for which in _which(effect)]
    truth = _model(rig, instrument.grid, instrument.width, instrument.c_deg)
    values = own.draw(rng, effect, rig).parameters if effect else {}
    if "encoder_period" in values:
        values = {**values, "encoder_period": draws.size(rng, *_PERIODS) * rig.actuator.span}
    amplitudes = {p.name for p in effects.BY_ID[effect].amplitudes} if effect else set()

    def record(strength: float, noise_px: float) -> list[Recording]:
        own_values = {name: value * (strength if name in amplitudes else 1.0) for name, value in values.items()}
        there = replace(truth, effects=(Effect(effect, own_values),) if effect else ())
        return [
            replace(own.record(there, motion, seed, noise_px), name=name)
            for motion, seed, name in zip(motions, seeds, ("calibration", "test-1", "test-2"), strict=True)
        ]

    return _Source(truth, _noise(rng), record)


def _model(rig: Rig, grid: Array, width: Array, c_deg: Array) -> Model:
    assert rig.camera is not None
    return Model(rig, grid, width, np.zeros_like(grid), c_deg, rig.camera.delay_s, rig.actuator.range)
