"""The simulated instrument: a known B(p) and f_remain(p) behind a motor: the truth beside every estimate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.special import erf

from tautline import _native, effects
from tautline.errors import TautError
from tautline.geometry import project
from tautline.model import MODEL_FILE, Model
from tautline.recording import Motor
from tautline.rig import Actuator, Camera, Coarse, HandEye, Kinematics, Rig

Array = np.ndarray
Law = Callable[[Array], Array]

_NODES = 4097  # of the true tables: 2.7 um apart on 11 mm of cable, straight in between
_BEYOND = 0.05  # share of the range that the true laws go on for beyond either end of it


@dataclass(frozen=True)
class InstrumentPath:
    """Where an instrument went, (n,) each."""

    p: Array  # unit of q
    c_deg: Array
    way: Array  # which way it lies in its channel, -1 to 1


class Instrument:
    """A play and a law behind a motor: p is the play's centre coordinate (unit of q), c = f_remain(p) the bending
    angle, deg.

    The motor drags p along inside [p_lo(q), p_hi(q)], where p_lo + B(p_lo)/2 = q and p_hi - B(p_hi)/2 = q. Between the
    nodes of the tables B and f_remain are straight lines by definition, so the truth is exact."""

    def __init__(self, rig: Rig, grid: Array, width: Array, c_deg: Array, name: str = "own") -> None:
        """grid (n,): rising, unit of q; width (n,): B there, >= 0, |B'| < 2, unit of q; c_deg (n,): f_remain there,
        deg, strictly monotone; name: as in truth.json. TautError where a table breaks one of these rules."""
        self.rig, self.name = rig, name
        self.grid = np.ascontiguousarray(grid, dtype=np.float64)
        self.width = np.ascontiguousarray(width, dtype=np.float64)
        self.c_deg = np.ascontiguousarray(c_deg, dtype=np.float64)
        step = np.diff(self.grid)
        if not (len(self.grid) >= 2 and self.grid.shape == self.width.shape == self.c_deg.shape and np.all(step > 0)):
            raise TautError("instrument: grid, width and c_deg need one length of 2 or more, and grid must rise")
        if np.any(self.width < 0) or np.any(np.abs(np.diff(self.width) / step) >= 2.0):
            raise TautError(
                "instrument: the backlash must be >= 0 with a slope within +-2, or the play has no solution"
            )
        rise = np.diff(self.c_deg)
        if not (np.all(rise > 0) or np.all(rise < 0)):
            raise TautError("instrument: f_remain must rise or fall everywhere")
        self._play = _native.Plays(self.grid, self.width)
        self.p = float("nan")
        self.jitter_s = 0.0  # of its camera's frames, rms
        self.drawn = True  # whether the endoscope's pictures, which know the rig alone, show where it is

    @classmethod
    def of(cls, rig: Rig, backlash: Law, remaining: Law, name: str = "own") -> Instrument:
        """An instrument from functions of p (n,), unit of q: backlash gives B(p), in that unit, and remaining
        f_remain(p), deg. They are sampled on a fine grid somewhat wider than the motor's range."""
        low, high = rig.actuator.range
        margin = _BEYOND * rig.actuator.span
        grid = np.linspace(low - margin, high + margin, _NODES)
        return cls(rig, grid, backlash(grid), remaining(grid), name)

    def reset(self, p: float = float("nan")) -> None:
        """Puts the play at p, unit of q. NaN: the next call begins with p at the first motor position, the play centred
        on it."""
        self.p = p

    def centre(self, t_s: Array, q: Array) -> Array:
        """The centre coordinates p (n,) at motor positions q (n,), both in the unit of q, in order of time; the state
        carries over to the next call. Exact where q is monotone between neighbours. t_s (n,), s, is only checked for
        its length (ValueError)."""
        q = np.atleast_1d(np.asarray(q, dtype=np.float64))
        if q.shape != np.atleast_1d(t_s).shape:
            raise ValueError("t_s and q differ in length")
        if not len(q):
            return q
        p: Array = self._play.forward(q, self.p)[0]
        self.p = float(p[-1])
        return p

    def bend(self, p: Array) -> Array:
        """The bending angles c = f_remain(p) (n,), deg, at centre coordinates p (n,), unit of q."""
        c: Array = np.interp(p, self.grid, self.c_deg)
        return c

    def move(self, t_s: Array, q: Array) -> Array:
        """The bending angles c (n,), deg, at motor positions q (n,) at times t_s (n,), s; moves the state on (see
        `centre`)."""
        return self.bend(self.centre(t_s, q))

    def course(self, t_s: Array, q: Array, translation_mm: Array | None, rotation_deg: Array | None) -> InstrumentPath:
        """Moves the instrument along motor positions q (n,) at times t_s (n,), s (see `centre`), and returns its path.
        The other degrees of freedom, (n,) at the same times (None: at rest at 0), have no effect here, and `way` is 0,
        as there is no channel."""
        p = self.centre(t_s, q)
        return InstrumentPath(p, self.bend(p), np.zeros_like(p))

    def see(self, c_deg: Array, way: Array, translation_mm: Array | float, rotation_deg: Array | float) -> Array:
        """The marker's places in the image (n, 2), px, at bending angles c_deg (n,); translation_mm, rotation_deg: (n,)
        or one number. way: as in InstrumentPath, has no effect here."""
        return project(self.rig, c_deg, translation_mm, rotation_deg)

    def backlash(self, p: Array) -> Array:
        """The width B(p) (n,) at centre coordinates p (n,), both in the unit of q."""
        width: Array = np.interp(p, self.grid, self.width)
        return width


class Corrected(Instrument):
    """The instrument of a model with all effects that a diagnosis added, so that a controller can be tried on it.
    Without a load column the load stays where the model was calibrated."""

    def __init__(self, model: Model, name: str) -> None:
        """model: with its effects; its delay becomes the rig's. Beyond the ends of its tables B stays as at the end, so
        that the motor may go a little beyond the range. name: the instrument's, as in truth.json."""
        rig = model.rig
        if rig.camera is not None:
            rig = replace(rig, camera=replace(rig.camera, delay_s=model.delay_s))
        beyond = _BEYOND * rig.actuator.span
        grid = np.concatenate([[model.q[0] - beyond], model.q, [model.q[-1] + beyond]])
        width = np.concatenate([model.width[:1], model.width, model.width[-1:]])
        super().__init__(rig, grid, width, model.remaining(grid), name)
        self._model, self._effects = model, effects.of_model(model, scatter=True)
        self.jitter_s = self._effects.pop("jitter", 0.0)
        for of_camera in ("held_share", "clock_rate"):  # its camera repeats nothing and has the motor's clock
            self._effects.pop(of_camera, None)
        self.drawn = effects.PROJECTION.isdisjoint(self._effects)
        self.reset()

    def reset(self, p: float = float("nan")) -> None:
        """As `Instrument.reset`; the motor's past motion is forgotten, too."""
        super().reset(p)
        self._start_deg = None if np.isnan(p) else float(self._model.remaining(p))
        self._past = np.empty((2, 0))

    def centre(self, t_s: Array, q: Array) -> Array:
        """As `Instrument.centre`, with the model's effects."""
        return self.course(t_s, q, translation_mm=None, rotation_deg=None).p

    def move(self, t_s: Array, q: Array) -> Array:
        """As `Instrument.move`, with the model's effects."""
        return self.course(t_s, q, translation_mm=None, rotation_deg=None).c_deg

    def course(self, t_s: Array, q: Array, translation_mm: Array | None, rotation_deg: Array | None) -> InstrumentPath:
        """As `Instrument.course`, with the model's effects, which depend on the motor's motion since `reset`."""
        new = np.array([np.atleast_1d(t_s), np.atleast_1d(q)], dtype=np.float64)
        if not new.size:
            return InstrumentPath(*np.empty((3, 0)))
        t, moved = past = np.concatenate([self._past, new], axis=1)
        # Of the past only the corners of straight lines (within 1e-9 of the range) and the ends of rests (longer than
        # 0.05 s) are kept, so that a call's time depends on what is new.
        self._past = past[:, _native.thin(t, moved, np.array([1e-9 * self.rig.actuator.span]), 0.05).view(bool)]

        def over_all_times(values: Array | None) -> Array | None:
            """Another degree of freedom's new values (n,), interpolated at all times, past and new, before the first
            new one held at it; None stays None."""
            return None if values is None else np.interp(t, new[0], values)

        motor = Motor(
            t, moved, translation_mm=over_all_times(translation_mm), rotation_deg=over_all_times(rotation_deg)
        )
        path = effects.follow(self._model, motor, new[0], self._effects, self._start_deg)
        self.p = float(path.p[-1])
        return InstrumentPath(path.p, path.c_deg, path.way)

    def see(self, c_deg: Array, way: Array, translation_mm: Array | float, rotation_deg: Array | float) -> Array:
        """As `Instrument.see`, with the model's effects on what the camera sees."""
        return effects.see(self._model, c_deg, way, translation_mm, rotation_deg, self._effects)


def of_name(name: str, rig: Rig | None = None, seed: int = 0) -> Instrument:
    """The instrument with a name: a preset made for `rig`, or, where the name is a model's folder, that model's
    instrument with all its effects and its own rig (rig and seed are then unused). TautError for an unknown name."""
    if name not in PRESETS and (Path(name) / MODEL_FILE).is_file():
        return Corrected(Model.load(name), name)
    return preset(name, rig, seed)


def reference_rig() -> Rig:
    """A flexible instrument seen by the endoscope that carries it: 5 mm of cable, 60 deg to either side."""
    return Rig(
        Actuator(unit="mm", range=(-5.0, 5.0), encoder_resolution=0.001),
        Coarse(gain=12.0, offset=0.0),
        Kinematics(bending_length_mm=18.0, tip_length_mm=6.0),
        Camera(
            width_px=720, height_px=576, fx_px=520.0, fy_px=520.0, cx_px=360.0, cy_px=288.0,
            distortion=(0.0, 0.0, 0.0, 0.0, 0.0), frame_rate_hz=25.0, delay_s=0.080,
        ),
        HandEye(rotation_deg=(4.0, -3.0, 2.0), translation_mm=(-4.0, 5.0, 14.0)),
    )  # fmt: skip


class _Scale:
    """Turns shapes into an instrument for a rig. Presets are shapes over x = (p - straight) / half, so that they fit
    every rig."""

    def __init__(self, rig: Rig) -> None:
        """Sets half, half of the motor's range, and straight, the p at which f_coarse is 0 deg, or the range's middle
        if that p is outside of the range; both in the unit of q."""
        low, high = rig.actuator.range
        self.rig, self.half = rig, 0.5 * (high - low)
        straight = -rig.coarse.offset / rig.coarse.gain
        self.straight = straight if low < straight < high else 0.5 * (low + high)

    def instrument(self, name: str, backlash: Law, remaining: Law) -> Instrument:
        """The instrument whose B and f_remain are given as shapes: functions of x (n,), with values in half ranges. The
        shape `remaining` is x where f_remain equals f_coarse."""
        coarse = self.rig.coarse

        def width(p: Array) -> Array:
            """B(p), unit of q."""
            return self.half * backlash((p - self.straight) / self.half)

        def angle(p: Array) -> Array:
            """f_remain(p), deg; equal to f_coarse where the tip is straight, if remaining(0) is 0."""
            at_straight = coarse.gain * self.straight + coarse.offset
            return at_straight + coarse.gain * self.half * remaining((p - self.straight) / self.half)

        return Instrument.of(self.rig, width, angle, name)


def _bump(x: Array, centre: float, spread: float) -> Array:
    """A Gaussian bump (n,) of height 1 about `centre`, at x (n,); spread: its standard deviation, in the unit of x."""
    height: Array = np.exp(-0.5 * ((x - centre) / spread) ** 2)
    return height


def _bump_integral(x: Array, centre: float, spread: float) -> Array:
    """The integral (n,) of `_bump` from 0 to x (n,)."""
    scale = spread * np.sqrt(2)
    area: Array = scale * np.sqrt(np.pi) / 2 * (erf((x - centre) / scale) - erf(-centre / scale))
    return area


def _weighted_sum(
    shape: Callable[[Array, float, float], Array], x: Array, parts: list[tuple[float, float, float]]
) -> Array:
    """The sum (n,) at x (n,) of several shapes, all `_bump` or all `_bump_integral`; parts: (centre, spread, height) of
    each."""
    total: Array = np.sum([height * shape(x, centre, spread) for centre, spread, height in parts], axis=0)
    return total


def _reference(rig: Rig, seed: int) -> Instrument:
    """B with a bump near the straight pose, f_remain with a dead zone there; numbers in half ranges. seed: unused."""
    return _Scale(rig).instrument(
        "reference",
        lambda x: 0.07 + 0.01 * x + 0.09 * _bump(x, 0.06, 0.17),
        lambda x: 0.85 * (x - 0.7 * _bump_integral(x, 0.0, 0.12)),  # slope 0.85 (1 - 0.7 bump)
    )


def _constant(rig: Rig, seed: int) -> Instrument:
    """B is an eighth of half the range everywhere, f_remain = f_coarse. seed: unused."""
    return _Scale(rig).instrument("constant", lambda x: np.full_like(x, 0.125), lambda x: x)


def _davinci(rig: Rig, seed: int) -> Instrument:
    """A rigid cable-driven tool: a wide, flat bump of B, f_remain slightly curved; numbers in half ranges. seed:
    unused."""
    return _Scale(rig).instrument(
        "davinci", lambda x: 0.085 + 0.03 * _bump(x, 0.0, 0.5), lambda x: 0.93 * x + 0.05 * np.sin(2.0 * x)
    )


def _random(rig: Rig, seed: int) -> Instrument:
    """B with two to four bumps, |B'| <= 1.2; f_remain with one to three dead or lively zones, slope 0.25 to 1.6 of
    f_coarse's; all drawn by the seed, numbers in half ranges."""
    rng = np.random.default_rng([seed, 0x1457])  # any number: other draws of this seed are independent
    count = rng.integers([2, 1], [5, 4])  # of bumps and of zones; below, (centre, spread, height) of each
    bumps = [(rng.uniform(-0.9, 0.9), rng.uniform(0.12, 0.5), rng.uniform(-0.6, 1.0)) for _ in range(count[0])]
    zones = [(rng.uniform(-0.8, 0.8), rng.uniform(0.1, 0.4), rng.uniform(-0.25, 0.15)) for _ in range(count[1])]
    level, size, slope = rng.uniform(0.03, 0.15), rng.uniform(0.02, 0.08), rng.uniform(0.8, 1.1)
    x = np.linspace(-2.2, 2.2, 4401)
    size = min(size, 1.2 / np.abs(np.gradient(_weighted_sum(_bump, x, bumps), x)).max())  # |B'| <= 1.2
    depth = min(1.0, (slope - 0.25) / max(-_weighted_sum(_bump, x, zones).min(), 1e-9))  # f_remain's slope >= 0.25
    return _Scale(rig).instrument(
        f"random-{seed}",
        lambda x: np.maximum(0.01, level + size * _weighted_sum(_bump, x, bumps)),
        lambda x: slope * x + depth * _weighted_sum(_bump_integral, x, zones),
    )


_PRESETS: dict[str, Callable[[Rig, int], Instrument]] = {
    "reference": _reference,
    "constant": _constant,
    "davinci": _davinci,
    "random": _random,
}
PRESETS = tuple(_PRESETS)


def preset(name: str, rig: Rig | None = None, seed: int = 0) -> Instrument:
    """A preset instrument for `rig` (default: `reference_rig()`); its angle falls with q where the rig's gain is
    negative. TautError for an unknown name.

    reference: B with a bump near the straight pose, f_remain with a dead zone there, else 0.85 of f_coarse's slope.
    constant: B an eighth of half the range, f_remain = f_coarse. davinci: a rigid cable-driven tool. random: by
    `seed`."""
    if name not in _PRESETS:
        raise TautError(f"no instrument is called '{name}': choose one of {', '.join(PRESETS)}, or a model's folder")
    return _PRESETS[name](rig or reference_rig(), seed)
