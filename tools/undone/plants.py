"""Instruments under a motor that is driven: readings of its encoder in, angles of the tip out. None has an equation of
the package's."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tautline.model import Model
from tautline.rig import Actuator, AngleSensor, Coarse, Rig
from tautline.simulated.instrument import preset
from tautline.trajectory import Trajectory
from tautline.undone import Joint
from tools.blindtest.physical import mechanism
from tools.blindtest.reality import Plant, Truth, driven

Array = npt.NDArray[np.float64]
Values = Mapping[str, float]
Strengths = Mapping[str, Sequence[Values]]

ENCODER = "actuator.encoder_periodic"
_COUNTS = 0.001  # mm of the motor, for each of its encoder's counts
_RATE_HZ = 1000.0


@dataclass(frozen=True)
class Instrument:
    name: str
    model: Model  # by its truth, without any effect
    joint: str  # column of the other axis
    joints: Mapping[str, Joint]
    strengths: Strengths  # effect -> how this instrument does it, at three strengths
    # values, t, where the motor's shaft is, load in mNm, the other axis in its column's unit -> the tip's angle, deg
    answer: Callable[[Values, Array, Array, Array, Array], Array]

    @property
    def rig(self) -> Rig:
        return self.model.rig

    def moved(self, values: Values, t: Array, reading: Array, load: Array, beside: Array) -> Array:
        """The tip's angle, deg, at times t 1 ms apart, where the motor's encoder reads `reading`."""
        return self.answer(values, t, shaft(values, reading), load, beside)


def shaft(values: Values, reading: Array) -> Array:
    """Where the motor is whose encoder reads that."""
    q = reading.copy()
    if period := values.get("encoder_period", 0.0):
        for _ in range(30):
            angle = 2 * np.pi * q / period + values["encoder_phase"]
            q = reading - values["encoder_error"] * (np.sin(angle) + 0.15 * np.sin(2 * angle + 1.0))
    return q


def _encoder(*errors: float) -> Sequence[Values]:
    return tuple({"encoder_period": 0.8, "encoder_error": e, "encoder_phase": 0.7} for e in errors)


def _each(name: str, *sizes: float, **beside: float) -> Sequence[Values]:
    return tuple({name: size, **beside} for size in sizes)


def _model(rig: Rig, grid: Array, width: Array, c_deg: Array) -> Model:
    q = np.linspace(*rig.actuator.range, 401)
    return Model(rig, q, np.interp(q, grid, width), 0.0 * q, np.interp(q, grid, c_deg), 0.0, rig.actuator.range)


# -- the second instrument of the blind test --------------------------------------------------------------------------

# Lengths in mm of its 10 mm of range.
_SECOND: Strengths = {
    ENCODER: _encoder(0.0075, 0.015, 0.03),
    "transmission.smooth_onset": _each("softness", 0.3, 0.6, 0.9),
    "transmission.asymmetric_backlash": _each("latch", 0.08, -0.15, 0.3, latch_travel=0.6),
    "transmission.rate_dependent_backlash": _each("viscosity", 0.03, 0.06, 0.12, speed_scale=6.0),
    "transmission.lag": _each("dashpot", 0.03, 0.07, 0.15),
    "transmission.creep": _each("creep_share", 0.05, 0.1, 0.2, creep_time=1.3),
    "transmission.load_dependence": tuple(
        {"stretch_per_load": k * 2e-3, "capstan_per_load": k * 1e-3, "soften_per_load": k * 3e-4}
        for k in (1.0, 2.0, 4.0)
    ),
    "configuration.axis_coupling": _each("pull_by_translation", 0.1, 0.25, 0.6),
    "transmission.offset": _each("homing", 0.05, -0.12, 0.3),
}


def second() -> Instrument:
    made = preset("reference")
    plant = Plant(made.rig, made.grid, made.width, made.c_deg, 0.0)
    rig = Rig(made.rig.actuator, made.rig.coarse, angle=AngleSensor(0.0))

    def answer(values: Values, t: Array, q: Array, load: Array, beside: Array) -> Array:
        motion = Trajectory(t, q, translation_mm=beside)
        return driven(plant, Truth(values), motion, 0.0, 1, load, np.random.default_rng(1)).c_deg

    model = _model(rig, made.grid, made.width, made.c_deg)
    return Instrument("second", model, "translation_mm", {"translation_mm": Joint(1, _COUNTS)}, _SECOND, answer)


# -- tendons over idlers, simulated by MuJoCo -------------------------------------------------------------------------

_MECHANISM = mechanism.PULLEYS
_SPAN = 2.0 * _MECHANISM.half
_STIFF = 307.0 + mechanism.RETURN  # what the tip is held by

_PULLEYS: Strengths = {
    ENCODER: _encoder(0.0075, 0.015, 0.03),
    "transmission.smooth_onset": _each("bristles", 0.03, 0.06, 0.12),
    "transmission.rate_dependent_backlash": tuple(
        {"grip": -size * _SPAN * mechanism.TENDON, "grip_speed": 0.1 * _SPAN} for size in (0.006, 0.012, 0.02)
    ),
    "transmission.lag": _each("damper", 0.03, 0.06, 0.12),
    "transmission.creep": _each("kelvin_s", 0.7, 1.3, 2.5),
    "transmission.load_dependence": tuple({"force_per_load": size * _SPAN * _STIFF} for size in (2e-4, 4e-4, 8e-4)),
    "configuration.axis_coupling": tuple({"pull": size * _SPAN} for size in (0.02, 0.05, 0.1)),
    "transmission.offset": tuple({"homing": size * _SPAN} for size in (0.005, -0.012, 0.03)),
}


def pulleys() -> Instrument:
    half, gain = _MECHANISM.half, float(np.degrees(_MECHANISM.gain))

    def answer(values: Values, t: Array, q: Array, load: Array, beside: Array) -> Array:
        given = {name: value for name, value in values.items() if not name.startswith("encoder_")}
        pull = given.get("force_per_load", 0.0) * load
        still = np.zeros_like(q)
        return gain * mechanism.drive(_MECHANISM, mechanism.Values(given), q, np.radians(beside), pull, still).s

    rig = Rig(Actuator("mm", (-half, half), _COUNTS), Coarse(0.8 * gain, 0.0), angle=AngleSensor(0.0))
    return Instrument(
        "mujoco.pulleys", _measured(rig, answer), "wrist_deg", {"wrist_deg": Joint(1, 0.01)}, _PULLEYS, answer
    )


def _measured(rig: Rig, answer: Callable[[Values, Array, Array, Array, Array], Array]) -> Model:
    """Of an instrument that has no law to be asked for: by one slow full stroke each way, and beyond it by lines."""
    low, high = rig.actuator.range
    seconds, beyond = 40.0, 0.1 * (high - low)
    t = np.arange(0.0, 2.0 * seconds, 1.0 / _RATE_HZ)
    middle, reach = 0.5 * (low + high), 0.5 * (high - low) + beyond
    q = middle - reach * np.cos(np.pi * t / seconds)
    c = answer({}, t, q, 0.0 * t, 0.0 * t)
    n = len(t) // 2
    angles = np.linspace(c[: 2 * n].min(), c[: 2 * n].max(), 803)[20:-20]
    up, down = (np.interp(angles, *_rising(c[part], q[part])) for part in (slice(0, n), slice(n, 2 * n)))
    return _model(rig, 0.5 * (up + down), up - down, angles)


def _rising(x: Array, y: Array) -> tuple[Array, Array]:
    order = np.argsort(x)
    return x[order], y[order]


INSTRUMENTS: Mapping[str, Callable[[], Instrument]] = {"second": second, "mujoco.pulleys": pulleys}
