"""Sessions of teleoperation in which an instrument changes, or is only disturbed, and the truth of them.

The hysteresis and the optics are the honesty benchmark's or written here: nothing of the library's play is used.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tautline.model import Model, Uncertainty
from tautline.recording import Marker, Motor, Recording
from tautline.rig import Rig
from tools.honesty import motion, optics
from tools.honesty.plant import crossing

Array = NDArray[np.float64]

STEP_S = 0.002  # of the simulation, and of the motor's log
COUNT = 0.001
NOISE_PX = 0.05
LOW, HIGH = -5.0, 5.0
CHANGES = ("scale", "offset", "shape", "gradual")
OUTSIDE = ("dahl", "bouc_wen", "uneven")  # hysteresis that the tracker's laws do not hold; their width is scaled
DISTURBED = ("nothing", "missing", "breathing", "contact", "held", "all")
COST = 3.0  # times the noise: what a change costs at least
_GRID = np.linspace(LOW - 2.0, HIGH + 2.0, 4001)


@dataclass(frozen=True)
class Instrument:
    """B(p), the static law and the camera of one, drawn at random."""

    seed: int
    kind: str = "play"  # or one of OUTSIDE
    width: Array = field(init=False, repr=False, compare=False)  # at _GRID
    law: Array = field(init=False, repr=False, compare=False)
    camera: optics.Camera = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        rng = np.random.default_rng([self.seed, 17])
        width = np.full(len(_GRID), rng.uniform(0.3, 0.6))
        for _ in range(2):
            width += rng.uniform(-0.1, 0.25) * np.exp(
                -0.5 * ((_GRID - rng.uniform(LOW, HIGH)) / rng.uniform(0.9, 2)) ** 2
            )
        width = np.maximum(width, 0.15)
        law = 12.0 * _GRID + rng.uniform(-5, 5) * np.sin(rng.uniform(0.3, 0.6) * _GRID + rng.uniform(0, 6))
        object.__setattr__(self, "width", width)
        object.__setattr__(self, "law", law)
        object.__setattr__(self, "camera", optics.Camera())

    @property
    def rig(self) -> Rig:
        camera = self.camera
        return Rig.from_document(
            {
                "format": "rig/1",
                "actuator": {"unit": "mm", "range": [LOW, HIGH], "encoder_resolution": COUNT},
                "coarse": {"gain": 12.0, "offset": 0.0},
                "kinematics": {"bending_length_mm": camera.bending, "tip_length_mm": camera.tip},
                "camera": {
                    "width_px": camera.width,
                    "height_px": camera.height,
                    "fx_px": camera.fx,
                    "fy_px": camera.fy,
                    "cx_px": camera.cx,
                    "cy_px": camera.cy,
                    "distortion": list(camera.distortion),
                    "frame_rate_hz": camera.frame_rate,
                    "delay_s": camera.delay,
                },
                "hand_eye": {"rotation_deg": list(camera.rotation), "translation_mm": list(camera.translation)},
            },
            "the simulated rig",
        )

    def of_place(self, table: Array, p: Array) -> Array:
        return np.interp(p, _GRID, table)


@dataclass(frozen=True)
class Change:
    """What is other from its time on; the defaults are nothing."""

    kind: str = "nothing"
    scale: float = 1.0
    offset: float = 0.0  # unit of q, added to it
    bumps: tuple[tuple[float, float, float], ...] = ()  # centre, sigma, share of B
    spread: float = 0.0  # of a gradual onset, share of B

    def width(self, instrument: Instrument) -> Array:
        share = np.full(len(_GRID), self.scale)
        for centre, sigma, more in self.bumps:
            share += more * np.exp(-0.5 * ((_GRID - centre) / sigma) ** 2)
        return instrument.width * share


def draw_change(kind: str, rng: np.random.Generator) -> Change:
    if kind == "scale":
        return Change(kind, scale=float(np.exp(rng.uniform(np.log(0.5), np.log(2.0)))))
    if kind == "offset":
        return Change(kind, offset=float(rng.choice([-1, 1]) * rng.uniform(0.01, 0.6)))
    if kind == "shape":
        bumps = tuple(
            (float(rng.uniform(-3.5, 3.5)), float(rng.uniform(1.0, 2.5)), float(rng.uniform(-0.4, 0.6)))
            for _ in range(2)
        )
        return Change(kind, bumps=bumps)
    if kind == "gradual":
        return Change(kind, spread=float(rng.uniform(0.05, 0.5)))
    if kind in OUTSIDE:
        return Change(kind, scale=float(rng.choice([rng.uniform(0.5, 0.8), rng.uniform(1.25, 1.8)])))
    return Change(kind)


@dataclass(frozen=True)
class Session:
    recording: Recording
    instrument: Instrument
    change: Change
    change_s: float  # inf where nothing changes
    p: Array  # (motor samples,) the centre coordinate
    true_px: Array  # (frames, 2) without noise and disturbance
    nominal_px: Array  # what an unchanged instrument would have shown
    disturbed: NDArray[np.bool_]  # frames that something else than motor and play moved

    @property
    def cost(self) -> float:
        """rms of the change in the image over the noise, from the change on."""
        late = self.recording.marker.t_s > self.change_s if self.recording.marker else np.zeros(0, bool)
        off = (self.true_px - self.nominal_px)[late]
        return float(np.sqrt(np.mean(off**2)) / NOISE_PX) if late.any() else 0.0


def respond(instrument: Instrument, t: Array, q: Array, change: Change, change_s: float) -> Array:
    """The centre coordinate; from change_s on by the changed law."""
    late = t >= change_s
    after = change.width(instrument)
    if instrument.kind in ("dahl", "bouc_wen", "uneven"):
        return _outside(instrument, q, np.where(late, change.scale, 1.0))
    shares = 1.0 + change.spread * np.array([-1.0, -2 / 3, -1 / 3, 0.0, 1 / 3, 2 / 3, 1.0])
    moved = q + np.where(late, change.offset, 0.0)
    total = np.zeros(len(q))
    for share in shares if change.spread else (1.0,):
        limits = []
        for side in (1.0, -1.0):
            before = crossing(lambda p: instrument.of_place(instrument.width, p), moved, side)
            later = crossing(lambda p, share=share: share * instrument.of_place(after, p), moved, side)
            limits.append(np.where(late, later, before))
        total += _clamped(*limits)
    return total / (len(shares) if change.spread else 1)


def _clamped(low: Array, high: Array) -> Array:
    out = np.empty(len(low))
    p = 0.5 * (low[0] + high[0])
    for k, (a, b) in enumerate(zip(low.tolist(), high.tolist(), strict=True)):
        p = a if p < a else (b if p > b else p)
        out[k] = p
    return out


def _outside(instrument: Instrument, q: Array, scale: Array) -> Array:
    """Hysteresis that is no play: p = q - B(q) z / 2."""
    half = 0.5 * scale * instrument.of_place(instrument.width, q)
    z, out = 0.0, np.empty(len(q))
    length = 0.25 * float(np.mean(instrument.width))
    for k, dx in enumerate((np.diff(q, prepend=q[0]) / length).tolist()):
        way = 1.0 if dx > 0 else -1.0
        if instrument.kind == "dahl":
            slope = max(1.0 - z * way, 0.0)
        elif instrument.kind == "bouc_wen":
            slope = 1.0 - z * z * (0.6 * way * (1.0 if z > 0 else -1.0) + 0.4)
        else:  # it starts sooner one way
            slope = max(1.0 - z * way, 0.0) ** (0.4 if way > 0 else 1.6)
        z = min(max(z + dx * slope, -1.0), 1.0)
        out[k] = z
    return q - half * out


def ideal_model(instrument: Instrument) -> Model:
    """What a very good calibration would have found, without the wait for one."""
    grid = np.linspace(LOW, HIGH, 1025)
    return Model(
        instrument.rig,
        grid,
        instrument.of_place(instrument.width, grid),
        np.full(len(grid), 0.0006),
        instrument.of_place(instrument.law, grid),
        instrument.camera.delay,
        (LOW + 0.3, HIGH - 0.3),
        c_sigma=np.full(len(grid), 0.005),
        uncertainty=Uncertainty(noise=NOISE_PX),
    )


def calibration(instrument: Instrument, seed: int, change: Change | None = None) -> Recording:
    """The motion that a calibration asks for."""
    rng = np.random.default_rng([seed, 3])
    made = motion.ramp_strokes(rng, LOW, HIGH, 1.6, 40, (3.0, 5.0))
    t = np.arange(0.0, made.t[-1], STEP_S)
    q = np.interp(t, made.t, made.q)
    p = respond(instrument, t, q, change or Change(), 0.0 if change else np.inf)
    return _recorded(instrument, rng, t, q, _seen(instrument, p), "calibration")[0]


def session(
    instrument: Instrument,
    kind: str,
    seed: int,
    seconds: float = 90.0,
    change: Change | None = None,
    start_s: float = 25.0,
) -> Session:
    """Teleoperation. `kind`: one of CHANGES, OUTSIDE (from start_s on) or DISTURBED (throughout)."""
    rng = np.random.default_rng([seed, 5])
    made = motion.teleoperated(rng, LOW + 0.3, HIGH - 0.3, seconds, float(rng.uniform(3.0, 6.0)))
    t = np.arange(0.0, made.t[-1], STEP_S)
    q = np.interp(t, made.t, made.q)
    changes = kind in CHANGES or kind in OUTSIDE
    change_s = start_s + float(rng.uniform(0.0, 5.0)) if changes else np.inf
    drawn = change or draw_change(kind, rng)
    p = respond(instrument, t, q, drawn, change_s)
    same = respond(instrument, t, q, Change(), np.inf)
    c, touched = _touched(instrument, rng, kind, t, q, p)
    image = optics.project(optics.tip_place(c, instrument.camera), instrument.camera)
    if kind in ("breathing", "all"):
        size, rate = rng.uniform(0.3, 4.0, 2) * rng.choice([-1, 1], 2), rng.uniform(0.2, 0.35)
        breath = np.sin(2 * np.pi * rate * t) ** 3 + 0.3 * np.sin(4 * np.pi * rate * t + 1.0)
        held_breath = 1.0 if kind == "breathing" else (np.sin(2 * np.pi * t / 171.0 + rng.uniform(0, 6)) > 0.0)
        image = image + (breath * held_breath)[:, None] * size
        touched[:] = True
    recording, at = _recorded(instrument, rng, t, q, image, kind, 0.5 if kind in ("missing", "all") else 0.02)
    true, nominal = (_seen(instrument, path) for path in (p, same))
    return Session(
        recording,
        instrument,
        drawn,
        change_s,
        p,
        *(np.column_stack([np.interp(at, t, px[:, i]) for i in range(2)]) for px in (true, nominal)),
        np.interp(at, t, touched.astype(float)) > 0.0,
    )


def _seen(instrument: Instrument, p: Array) -> Array:
    return optics.project(
        optics.tip_place(instrument.of_place(instrument.law, p), instrument.camera), instrument.camera
    )


def _touched(
    instrument: Instrument, rng: np.random.Generator, kind: str, t: Array, q: Array, p: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """The bending angle with tissue or a hand in the way, and when they were."""
    c = instrument.of_place(instrument.law, p)
    touched = np.zeros(len(t), dtype=bool)
    if kind in ("contact", "all"):
        wall = float(rng.uniform(15.0, 40.0)) * rng.choice([-1, 1])
        give = float(rng.uniform(0.0, 0.5))  # of soft tissue
        for begin in np.arange(rng.uniform(3, 10), t[-1], 14.0):
            near = (t >= begin) & (t < begin + rng.uniform(3, 10))
            beyond = near & ((c > wall) if wall > 0 else (c < wall))
            c[beyond] = wall + give * (c[beyond] - wall)
            touched |= beyond
    if kind in ("held", "all"):
        for begin in np.arange(rng.uniform(3, 10), t[-1], 16.0):
            held = np.flatnonzero((t >= begin) & (t < begin + rng.uniform(0.5, 6.0)))
            if len(held):
                c[held] = c[held[0]] + rng.uniform(-1.0, 1.0) * np.minimum(t[held] - t[held[0]], 0.3)
                touched[held] = True
    return c, touched


def _recorded(
    instrument: Instrument,
    rng: np.random.Generator,
    t: Array,
    q: Array,
    image: Array,
    name: str,
    missing: float = 0.0,
) -> tuple[Recording, Array]:
    """The files' content, and the scene times of the frames."""
    scene = np.arange(t[0] + 0.01, t[-1] - instrument.camera.delay, 1.0 / instrument.camera.frame_rate)
    uv = np.column_stack([np.interp(scene, t, image[:, i]) for i in range(2)])
    uv += rng.normal(0, NOISE_PX, uv.shape)
    valid = rng.random(len(scene)) >= missing
    uv[~valid] = np.nan
    marker = Marker(scene + instrument.camera.delay, uv[:, 0], uv[:, 1], valid)
    motor = Motor(t, COUNT * np.rint(q / COUNT))
    return Recording(name, motor, marker, rig=instrument.rig), scene
