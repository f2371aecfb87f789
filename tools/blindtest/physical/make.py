"""Blind cases of a mechanism. What an effect leaves is asked of the mechanism itself, with it and without it."""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
import numpy.typing as npt
from scipy.special import expit

from tautline import trajectory
from tautline.effects import BY_ID
from tautline.geometry import rotation
from tautline.prediction import driven_both_ways_from
from tautline.recording import Angle, Marker, Motor, Recording
from tautline.rig import Actuator, AngleSensor, Coarse, Kinematics, Rig
from tautline.simulated.instrument import reference_rig
from tautline.trajectory import Trajectory
from tools.blindtest.cases import SEVERAL, VISIBLE, Case, Label
from tools.blindtest.physical.draws import KNOWN, PROJECTION, UNKNOWN
from tools.blindtest.physical.mechanism import STEP_S, MechanismPath, Topology, Values, drive

Array = npt.NDArray[np.float64]

_DRAWS = 8
_ENCODER_EVERY = 4  # of the mechanism's steps
_COUNTS = 8000  # of the encoder, over the range
_NAMES = ("calibration", "test-1", "test-2", "further")
_ANGLE_HZ = 100.0
_SHUTTER_S = 0.05  # in which a slip happens
_OTHER = "wrist_deg"  # column of the joint beside it
# The mechanism's own play, rest, stiffness and delay: what a recalibration measures, and by how much each is tried.
_MEASURED: Mapping[str, tuple[float, float]] = {
    "widened": (1.0, 0.05),
    "homing": (0.0, 2e-3),  # of the range
    "kelvin_soft": (1.0, 0.05),
    "late": (0.0, 2e-3),
}
_STEPS = 2
_BEAT, _PAUSE_S = 6, 3.0  # how short a beat is; between pushes, in the mean
_ENOUGH = 1.3  # times the play: what the motor has to go until the tip is driven


def known(topology: Topology) -> tuple[str, ...]:
    return tuple(name for name in KNOWN if topology.seen or name not in PROJECTION)


@dataclass(frozen=True)
class _Recorded:
    topology: Topology
    rig: Rig
    noise: float  # px, or deg of an angle sensor
    motions: list[Trajectory]  # in the file's unit
    others: list[Array]  # the joint beside it, rad, at the motions' times
    loads: list[Array | None]  # mNm
    starts_s: list[float]
    seeds: list[int]
    one_clock: bool

    def record(self, given: Mapping[str, float], which: int, noisy: bool = True) -> Recording:
        """Recording `which`; the calibration is before anything of `given` but what loads it came about."""
        there = {k: v for k, v in given.items() if which > 0 or k == "force_per_load"}
        topology, motion, values = self.topology, self.motions[which], Values(there)
        when = motion.t_s + self.starts_s[which]
        load = self.loads[which]
        force = np.zeros_like(when) if load is None else values("force_per_load") * load
        force = force + _from_outside(values, when)
        since = when - self.starts_s[1] + 5.0
        anchor = values("anchor") * (1.0 - np.exp(-since / values("anchor_s", 1.0)))
        course = drive(topology, values, motion.q / topology.scale, self.others[which], force, anchor)
        if topology.gravity and load is not None:  # what the weight pulls with, at the motor's angle
            load = values("payload") * topology.gravity * topology.reach_mm * np.cos(course.q)
        return _recorded(self, values, course, which, load, noisy)


def _from_outside(values: Values, when: Array) -> Array:
    """What pushes at the tip at these times of the session."""
    force: Array = values("breath") * np.sin(2 * np.pi * values("breath_hz") * when)
    force = force + values("heart") * np.maximum(np.sin(2 * np.pi * values("heart_hz") * when), 0.0) ** _BEAT
    if not values("push"):
        return force
    rng = np.random.default_rng(int(values("push_seed")))
    pushes = np.zeros_like(when)
    begins = 0.0
    while (begins := begins + float(rng.exponential(_PAUSE_S))) < when[-1]:
        lasts, strength = float(rng.uniform(0.3, 1.5)), float(rng.uniform(-1.0, 1.0))
        within = (when > begins) & (when < begins + lasts)
        pushes[within] += strength * np.sin(np.pi * (when[within] - begins) / lasts)
        begins += lasts
    return force + values("push") * pushes


def make(topology: Topology, seed: int, kind: str, effects: tuple[str, ...] = ()) -> Case:
    """As cases.make: `effects` fixes what is switched on; else it is drawn. Too weak ones are drawn again."""
    rng = np.random.default_rng([seed, 0x3EC4, zlib.crc32(" ".join((topology.name, kind, *effects)).encode())])
    chosen = effects or _drawn(rng, topology, kind)
    session = _session(rng, topology, "transmission.load_dependence" in chosen)
    values, left = _visible(rng, session, chosen)
    recordings = [session.record(values, i) for i in range(4)]
    throughout = "force_per_load" in values
    label = Label(kind, chosen, seed, throughout, values, session.noise, left, topology.name)
    return Case(session.rig, recordings[0], recordings[1:3], recordings[3], label)


def _drawn(rng: np.random.Generator, topology: Topology, kind: str) -> tuple[str, ...]:
    if kind == "none":
        return ()
    if kind == "unknown":
        return (str(rng.choice(list(UNKNOWN))),)
    names = known(topology)
    return tuple(str(name) for name in rng.choice(names, SEVERAL.get(kind, 1), replace=False))


def _visible(
    rng: np.random.Generator, session: _Recorded, chosen: tuple[str, ...]
) -> tuple[dict[str, float], tuple[float, ...]]:
    """Amplitudes, and what each effect by itself moves on the tests: the strongest of up to _DRAWS draws that end with
    the first that is identifiable."""
    best: tuple[dict[str, float], tuple[float, ...]] = ({}, ())
    if not chosen:
        return best
    truth = _Truth(session)
    for _ in range(_DRAWS):
        drawn = [(KNOWN.get(name) or UNKNOWN[name])(rng, session.topology) for name in chosen]
        for name, values in zip(chosen, drawn, strict=True):
            if name == "registration.shift":
                values["slip_time"] = (
                    session.starts_s[1] + float(rng.uniform(0.25, 0.75)) * session.motions[1].duration_s
                )
        left = tuple(
            truth.left(values, name in BY_ID and BY_ID[name].nominal)
            for name, values in zip(chosen, drawn, strict=True)
        )
        if not best[1] or min(left) > min(best[1]):
            best = {k: v for values in drawn for k, v in values.items()}, left
        if min(best[1]) >= VISIBLE * session.noise:
            break
    return best


class _Truth:
    """What the mechanism does differently on the tests with something than without it, from when it was driven through
    its play both ways (nothing before counts); beyond what the same mechanism does with another play, rest, stiffness
    and delay."""

    def __init__(self, session: _Recorded) -> None:
        self.session, self.without = session, _silent(session, {})
        span = session.rig.actuator.span / session.topology.scale
        self._size = {name: step * (span if name == "homing" else 1.0) for name, (_, step) in _MEASURED.items()}

    @cached_property
    def _columns(self) -> Array:
        usual = {name: at for name, (at, _) in _MEASURED.items()}
        return np.stack([self._apart({**usual, n: usual[n] + self._size[n]}) for n in _MEASURED], axis=1)

    def _apart(self, values: Mapping[str, float]) -> Array:
        apart = [_apart(*pair) for pair in zip(_silent(self.session, values), self.without, strict=True)]
        return np.concatenate(
            [np.where(counts, x, np.nan).ravel() for x, counts in zip(apart, self._counts, strict=True)]
        )

    @cached_property
    def _counts(self) -> list[npt.NDArray[np.bool_]]:
        """(frames, 1) of each test."""
        topology, counts = self.session.topology, []
        for recording in self.without:
            begin_s = driven_both_ways_from(
                recording.motor.t_s, recording.motor.q, _ENOUGH * topology.width * topology.scale
            )
            counts.append((_seen(recording)[0] > begin_s)[:, None])
        return counts

    def left(self, values: Mapping[str, float], nominal: bool) -> float:
        """rms of each coordinate. nominal: it is a part of the nominal model itself, and all of it counts."""
        there = apart = self._apart(values)
        if nominal or not np.isfinite(apart).any():
            return _rms(apart)
        at = np.array([usual for usual, _ in _MEASURED.values()])
        size = np.array(list(self._size.values()))
        for left_to_go in reversed(range(_STEPS)):
            known = np.isfinite(apart) & np.isfinite(self._columns).all(axis=1)
            step = np.linalg.lstsq(self._columns[known], apart[known], rcond=1e-6)[0]
            if left_to_go:
                at = np.where(at > 0.0, np.maximum(at + step * size, 0.2 * at), at + step * size)
                apart = there - self._apart(dict(zip(_MEASURED, at.tolist(), strict=True)))
        return _rms(apart - self._columns @ step)


def _silent(session: _Recorded, values: Mapping[str, float]) -> list[Recording]:
    return [session.record(values, i, noisy=False) for i in (1, 2)]


def _rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def _apart(there: Recording, without: Recording) -> Array:
    """(frames, coordinates). Frames are taken at the same times; what comes late, comes late by what it shows then."""
    (t, seen), (usual, expected) = _seen(there), _seen(without)
    shown = np.stack([np.interp(t, usual, column) for column in expected.T], axis=1)
    return np.asarray(seen - shown)


def _seen(recording: Recording) -> tuple[Array, Array]:
    if (marker := recording.marker) is not None:
        return marker.t_s, np.stack([marker.u_px, marker.v_px], axis=1)
    assert recording.angle is not None
    return recording.angle.t_s, recording.angle.c_deg[:, None]


def _recorded(
    session: _Recorded, values: Values, course: MechanismPath, which: int, load: Array | None, noisy: bool
) -> Recording:
    rig, motion, start = session.rig, session.motions[which], session.starts_s[which]
    own = start if session.one_clock else 0.0
    clock, scatter, noise = (np.random.default_rng([session.seeds[which], 0xB0D1, i]) for i in range(3))
    rate = rig.camera.frame_rate_hz if rig.camera else _ANGLE_HZ
    end = motion.t_s[-1]
    ticks = np.arange(clock.uniform(0.3, 1.3) / rate, end, 1.0 / rate)
    shown = np.arange(len(ticks))
    if stalls := values("stalls"):
        for i in np.flatnonzero(scatter.random(len(ticks)) < stalls / rate):
            held = int(scatter.exponential(values("stall_s")) * rate)
            shown[i : i + held] = shown[i]
    at = partial(np.interp, ticks, motion.t_s)
    delay = rig.camera.delay_s if rig.camera else rig.nominal_delay_s("angle")
    arrival = ticks + delay + values("late") + own
    marker = angle = None
    if rig.camera:
        image = _image(rig, values, np.stack([at(x) for x in course.tip_mm.T], axis=1), ticks + start)
        if noisy:
            image = image + noise.normal(0.0, session.noise, image.shape)
        image = image[shown]  # an image that is shown again is the same, noise and all
        inside = np.all((image >= 0) & (image <= [rig.camera.width_px - 1, rig.camera.height_px - 1]), axis=1)
        image = np.where(inside[:, None], image, np.nan)
        marker = Marker(arrival, image[:, 0], image[:, 1], inside, np.full(len(ticks), session.noise))
    else:
        c = np.degrees(at(course.s))
        angle = Angle(arrival, (c + noise.normal(0.0, session.noise, len(c)) if noisy else c)[shown])
    every = slice(None, None, _ENCODER_EVERY)
    resolution = rig.actuator.encoder_resolution
    q = np.round(course.q[every] * session.topology.scale / resolution) * resolution
    motor = Motor(
        motion.t_s[every] + own,
        q,
        motion.q[every],
        load_mNm=None if load is None else load[every],
        extra={_OTHER: np.round(np.degrees(course.other[every]), 3)},
    )
    return Recording(_NAMES[which], motor, marker, angle, rig=rig)


def _image(rig: Rig, values: Values, tip_mm: Array, when: Array) -> Array:
    """The camera stands still; what the instrument is held by may not."""
    camera, hand_eye = rig.camera, rig.hand_eye
    assert camera is not None and hand_eye is not None
    for prefix, share in (
        ("mount", np.ones(len(when))),
        ("slip", expit((when - values("slip_time", 1e12)) / _SHUTTER_S)),
    ):
        turn = rotation((values(f"{prefix}_rx"), values(f"{prefix}_ry"), values(f"{prefix}_rz")))
        move = np.array([values(f"{prefix}_{k}") for k in "xyz"])
        tip_mm = tip_mm + share[:, None] * (tip_mm @ turn.T + move - tip_mm)
    x, y, z = (tip_mm @ rotation(hand_eye.rotation_deg).T + np.asarray(hand_eye.translation_mm)).T
    return np.stack([camera.cx_px + camera.fx_px * x / z, camera.cy_px + camera.fy_px * y / z], axis=1)


def _session(rng: np.random.Generator, topology: Topology, loaded: bool) -> _Recorded:
    rig = _rig(rng, topology)
    noise = float(np.exp(rng.uniform(np.log(0.03), np.log(0.1))))
    if not topology.seen:
        noise *= 0.5
    motions = _motions(rng, rig)
    loaded = loaded or rng.random() < 0.15
    loads = [_load(rng, m, i) if loaded else None for i, m in enumerate(motions)]
    starts = list(np.concatenate([[0.0], np.cumsum([m.duration_s + 5.0 for m in motions])[:-1]]))
    return _Recorded(
        topology,
        rig,
        noise,
        motions,
        [_beside(rng, m, i) for i, m in enumerate(motions)],
        loads,
        starts,
        [int(s) for s in rng.integers(1 << 30, size=4)],
        bool(rng.random() < 0.5),
    )


def _rig(rng: np.random.Generator, topology: Topology) -> Rig:
    half = topology.half * topology.scale
    actuator = Actuator("deg" if topology.unit == "deg" else "mm", (-half, half), 2.0 * half / _COUNTS)
    coarse = Coarse(float(rng.uniform(0.8, 0.9)) * math.degrees(topology.gain) / topology.scale, 0.0)
    if not topology.seen:
        return Rig(actuator, coarse, angle=AngleSensor(float(rng.uniform(0.0, 0.03))))
    usual = reference_rig()
    assert usual.camera is not None and usual.hand_eye is not None
    camera = replace(
        usual.camera, delay_s=float(rng.uniform(0.04, 0.1)), frame_rate_hz=float(rng.choice([25.0, 30.0, 50.0]))
    )
    a, b, c = (float(v) for v in rng.normal(0.0, 4.0, 3))
    hand_eye = replace(usual.hand_eye, rotation_deg=(a, b, c))
    return Rig(actuator, coarse, Kinematics(topology.bending_mm, topology.reach_mm), camera, hand_eye)


def _motions(rng: np.random.Generator, rig: Rig) -> list[Trajectory]:
    """A calibration at two speeds with rests, two tests at several speeds with rests, one more."""
    actuator, span = rig.actuator, rig.actuator.span
    speed = float(rng.uniform(0.09, 0.13)) * span
    slow, fast = float(rng.uniform(0.06, 0.1)) * span, float(rng.uniform(0.15, 0.3)) * span
    return [
        trajectory.back_and_forth(actuator, [speed, 2.2 * speed], 0.24 * span, 14, 10 * speed, 0.4),
        trajectory.trapezoids(actuator, slow, float(rng.uniform(0.25, 0.4)) * span, 4, 12 * slow, 1.0),
        trajectory.trapezoids(actuator, fast, float(rng.uniform(0.3, 0.5)) * span, 6, 12 * fast, 2.0),
        trajectory.sines(actuator, float(rng.uniform(0.1, 0.25)) * span, 30.0),
    ]


def _beside(rng: np.random.Generator, motion: Trajectory, which: int) -> Array:
    """The joint beside it rests while calibrating, and sways from the second test on."""
    size, period = np.radians(rng.uniform(10, 35)), rng.uniform(7, 15)
    return np.asarray((which > 1) * size * np.sin(2 * np.pi * motion.t_s / period))


def _load(rng: np.random.Generator, motion: Trajectory, which: int) -> Array:
    """mNm, slowly going up and down."""
    level, swing = rng.uniform(10, 50), 0.0 if which == 0 else rng.uniform(5, 25)
    return np.asarray(level + swing * np.sin(2 * np.pi * motion.t_s / rng.uniform(20, 40)))


assert trajectory.RATE_HZ * STEP_S == 1.0  # a motion's samples are the mechanism's steps
