"""The library itself as a generator: its own equations, under a noise that is not white."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from tautline import effects
from tautline.errors import TautError
from tautline.model import Effect, Model
from tautline.recording import Marker, Recording
from tautline.rig import Rig
from tautline.simulated.instrument import Corrected, preset
from tautline.simulated.simulate import run
from tautline.trajectory import Trajectory
from tautline.vision.timing import FrameTiming
from tools.blindtest.cases import SEVERAL, VISIBLE, Case, Label, motions_of, rig_of

Array = npt.NDArray[np.float64]

NAME = "library"
# Effect -> amplitudes in a user's scale (Parameter.scale) are drawn from here; the shapes are as the library starts.
_SCALES = (2.0, 8.0)
KNOWN = (
    "transmission.smooth_onset",
    "transmission.asymmetric_backlash",
    "transmission.rate_dependent_backlash",
    "transmission.lag",
    "transmission.creep",
    "configuration.axis_coupling",
    "configuration.swing",
    "registration.direction_dependent",
)
_REMEMBERS = 0.7  # of the noise from frame to frame
_OUTLIERS, _FARTHER = 0.01, 6.0  # share of the frames, times the noise
_DRAWS = 8


def make(seed: int, kind: str, wanted: tuple[str, ...] = ()) -> Case:
    """As cases.make. What is unknown to the library it cannot make."""
    if kind == "unknown":
        raise TautError(f"the generator '{NAME}' has no effect outside of the library: leave --unknown out")
    rng = np.random.default_rng([seed, 0x0117, zlib.crc32(" ".join((kind, *wanted)).encode())])
    count = {"none": 0, "single": 1, **SEVERAL}[kind]
    chosen = wanted or tuple(str(name) for name in rng.choice(KNOWN, count, replace=False))
    rig = rig_of(rng)
    instrument = preset("random", rig, int(rng.integers(1 << 30)))
    noise = float(np.exp(rng.uniform(np.log(0.02), np.log(0.1))))
    motions = motions_of(rng, rig)
    seeds = [int(s) for s in rng.integers(1 << 30, size=4)]
    assert rig.camera is not None
    sound = Model(
        rig,
        instrument.grid,
        instrument.width,
        np.zeros_like(instrument.grid),
        instrument.c_deg,
        rig.camera.delay_s,
        rig.actuator.range,
    )
    without = [record(sound, motions[i], seeds[i], 0.0) for i in (1, 2)]
    best: tuple[list[Effect], tuple[float, ...]] = ([], ())
    for _ in range(_DRAWS):
        drawn = [draw(rng, name, rig) for name in chosen]
        left = tuple(
            _moved([record(replace(sound, effects=(one,)), motions[i], seeds[i], 0.0) for i in (1, 2)], without)
            for one in drawn
        )
        if not best[1] or min(left) > min(best[1]):
            best = drawn, left
        if not chosen or min(best[1]) >= VISIBLE * noise:
            break
    there = replace(sound, effects=tuple(best[0]))
    names = ("calibration", "test-1", "test-2", "further")
    recordings = [
        replace(record(there if i else sound, motions[i], seeds[i], noise), name=name) for i, name in enumerate(names)
    ]
    values: Mapping[str, float] = {k: float(v) for one in best[0] for k, v in one.parameters.items()}
    label = Label(kind, chosen, seed, False, values, noise, best[1], NAME)
    return Case(rig, recordings[0], recordings[1:3], recordings[3], label)


def draw(rng: np.random.Generator, name: str, rig: Rig) -> Effect:
    kind = effects.BY_ID[name]
    share = {p.name: rig.actuator.span if p.unit.startswith("unit") else 1.0 for p in kind.parameters}
    values = {p.name: float(rng.choice(p.shape)) * share[p.name] for p in kind.shapes}
    for p in kind.amplitudes:
        size = float(np.exp(rng.uniform(*np.log(_SCALES)))) * p.scale * share[p.name]
        either = 1.0 if p.low >= 0.0 or p.one_way else float(rng.choice([-1.0, 1.0]))
        values[p.name] = p.inside(either * size, rig.actuator.span)
    return Effect(name, values)


def record(model: Model, motion: Trajectory, seed: int, noise_px: float) -> Recording:
    instrument = Corrected(model, "own")
    timing = FrameTiming.of(model.rig, seed=seed)
    recording = run(model.rig, instrument, motion, noise_px=0.0, timing=timing, seed=seed).recording
    marker = recording.marker
    assert marker is not None
    rng = np.random.default_rng([seed, 0x0118])
    n = len(marker.t_s)
    white = rng.normal(size=(n, 2)) * np.sqrt(1.0 - _REMEMBERS**2)
    added = lfilter([1.0], [1.0, -_REMEMBERS], white, axis=0)
    added = added + (rng.random(n) < _OUTLIERS)[:, None] * rng.normal(0.0, _FARTHER, (n, 2))
    seen = np.stack([marker.u_px, marker.v_px], axis=1) + noise_px * added
    return replace(recording, marker=Marker(marker.t_s, seen[:, 0], seen[:, 1], marker.valid))


def _moved(there: list[Recording], without: list[Recording]) -> float:
    apart = [
        np.stack([a.marker.u_px - b.marker.u_px, a.marker.v_px - b.marker.v_px])
        for a, b in zip(there, without, strict=True)
        if a.marker is not None and b.marker is not None
    ]
    return float(np.sqrt(np.nanmean(np.concatenate(apart, axis=1) ** 2)))
