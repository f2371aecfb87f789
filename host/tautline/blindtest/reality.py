"""A second, independent instrument, for blind tests: its effects follow other equations than the library's.

The transmission is a pin in a slot with bristles, latches, dashpots, Kelvin elements and gripping walls (reality.h);
the bending section is a chain of discrete elastic joints; the lens a fisheye or Brown-Conrady's with a rolling shutter;
the instrument rocks in its channel. What `Truth` switches on is what a case's label says.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.special import expit

from tautline import _native
from tautline.geometry import rotation as rotation_of
from tautline.recording import Marker, Motor, Recording
from tautline.rig import Rig
from tautline.simulated.trajectory import Trajectory

Array = npt.NDArray[np.float64]
_JOINTS = 96


@dataclass(frozen=True)
class Plant:
    """The instrument itself: its laws on a fine grid of p."""

    rig: Rig
    grid: Array
    width: Array
    c_deg: Array
    noise_px: float


@dataclass(frozen=True)
class Truth:
    """What is switched on, by name; amplitudes in the units of the functions below. Empty: nothing unmodelled."""

    values: Mapping[str, float] = field(default_factory=dict)

    def __call__(self, name: str, otherwise: float = 0.0) -> float:
        return float(self.values.get(name, otherwise))


_TRANSMISSION = tuple(name for name, _ in _native.reality_fields)


def record(
    plant: Plant, truth: Truth, motion: Trajectory, session_s: float, seed: int, name: str, load: Array | None = None
) -> Recording:
    """Drives the plant along `motion`, which starts `session_s` into the session; what it was goes nowhere."""
    rng = np.random.default_rng([seed, 0xB11D])
    rig = plant.rig
    camera = rig.camera
    assert camera is not None
    t = motion.t_s
    when = t + session_s
    span = rig.actuator.span

    q = motion.q.copy()
    if period := truth("encoder_period"):
        angle = 2 * np.pi * q / period + truth("encoder_phase")
        # The encoder errs, not the motor: what is recorded is off by this.
        error = truth("encoder_error") * (np.sin(angle) + 0.15 * np.sin(2 * angle + 1.0))
    else:
        error = np.zeros_like(q)
    true_q = q.copy()
    if rate := truth("lost_counts"):  # fast moves lose counts now and then
        lost = rng.random(len(q)) < rate * np.abs(np.gradient(q, t)) / span * 1e-3
        true_q = true_q + np.cumsum(lost * rng.choice([-1.0, 1.0], len(q))) * truth("lost_size")
    true_q = true_q + truth("creeping_offset") * (1.0 - np.exp(-when / truth("warm_up", 300.0)))
    factor = np.full(len(q), 1.0) + truth("widening") * (1.0 - np.exp(-when / truth("warm_up", 300.0)))
    if load is not None:
        true_q = true_q + truth("stretch_per_load") * load / (1.0 + 0.003 * np.abs(load))
        factor = factor * np.exp(truth("capstan_per_load") * load)
    values = {name: truth(name) for name in _TRANSMISSION if name in truth.values}
    p, way = _native.reality_transmission(
        values, plant.grid, plant.width, t, np.ascontiguousarray(true_q), np.ascontiguousarray(factor), np.nan, seed
    )
    translation = np.zeros_like(t) if motion.translation_mm is None else motion.translation_mm
    turn = np.zeros_like(t) if motion.rotation_deg is None else motion.rotation_deg

    slope = np.gradient(plant.c_deg, plant.grid)
    low, high = plant.grid[0], plant.grid[-1]
    c = np.interp(p, plant.grid, plant.c_deg)
    c = c + slope[0] * np.minimum(p - low, 0) + slope[-1] * np.maximum(p - high, 0)
    if load is not None:
        c = c * (1.0 + truth("soften_per_load") * load)
    c = c + truth("pull_by_translation") * translation + truth("twist") * np.degrees(np.sin(np.radians(turn)))
    c = c * (1.0 + truth("sag") * np.sin(np.radians(turn)))
    if stiffness := truth("obstacle"):
        side = np.sign(truth("obstacle_side", 1.0))
        depth = np.maximum(side * c - truth("obstacle_at"), 0.0)
        # A Hertzian wall against an elastic section: what it gives way by solves d + k d^1.5 = depth.
        give = depth.copy()
        for _ in range(25):
            give = give - (give + stiffness * give**1.5 - depth) / (1.0 + 1.5 * stiffness * np.sqrt(give + 1e-12))
            give = np.maximum(give, 0.0)
        c = c - side * (depth - give)

    scene, arrival = _frames(t, rig, truth, rng)

    def at(values: Array) -> Array:
        return np.asarray(np.interp(scene, t, values))

    point = _chain(rig, at(c), truth("taper"))
    point[:, 2] += at(translation)
    a = np.radians(at(turn))
    base = np.stack(
        [
            np.cos(a) * point[:, 0] - np.sin(a) * point[:, 1],
            np.sin(a) * point[:, 0] + np.cos(a) * point[:, 1],
            point[:, 2],
        ],
        1,
    )
    rocked = _rocking(t, p, way, truth)
    base = _tilted(base, at(rocked)[:, None] * np.array([truth("rock_x"), truth("rock_y"), truth("rock_z")]))
    moved = expit((scene + session_s - truth("slip_time", 1e12)) / 0.05)
    for prefix, share in (("mount", np.ones(len(scene))), ("slip", moved)):
        base = _tilted(base, share[:, None] * np.array([truth(f"{prefix}_r{k}") for k in "xyz"]))
        base = base + share[:, None] * np.array([truth(f"{prefix}_{k}") for k in "xyz"])
    base = base + truth("breath") * np.sin(2 * np.pi * truth("breath_hz", 0.25) * (scene + session_s))[
        :, None
    ] * np.array([0.3, 1.0, 0.2])
    hand_eye = rig.hand_eye
    assert hand_eye is not None
    seen = base @ rotation_of(hand_eye.rotation_deg).T + np.asarray(hand_eye.translation_mm)
    focal = 1.0 + truth("zoom") * (1.0 - np.exp(-(scene + session_s) / 200.0))
    image = _lens(rig, seen, truth, focal)
    if truth("sliding_marker"):
        walk = np.cumsum(rng.normal(0.0, 1.0, len(scene))) * truth("sliding_marker")
        image = image + walk[:, None] * np.array([0.8, 0.6])
    image = image + rng.normal(0.0, plant.noise_px, image.shape)
    inside = np.all((image >= 0) & (image <= [camera.width_px - 1, camera.height_px - 1]), axis=1) & np.isfinite(
        image
    ).all(1)
    kept = rng.random(len(scene)) > 0.003  # a frame is lost now and then
    image, inside, arrival = image[kept], inside[kept], arrival[kept]
    image = np.where(inside[:, None], image, np.nan)

    resolution = rig.actuator.encoder_resolution
    measured = np.round((q + error) / resolution) * resolution

    def column(values: Array) -> Array | None:
        return values if np.ptp(values) else None

    motor = Motor(t, measured, None, column(translation), column(turn), load)
    return Recording(name, motor, Marker(arrival, image[:, 0], image[:, 1], inside, None), rig=rig)


def _frames(t: Array, rig: Rig, truth: Truth, rng: np.random.Generator) -> tuple[Array, Array]:
    """Scene and arrival times. An unsteady link delays frames by gamma-distributed times; arrival tells the nominal
    clock."""
    camera = rig.camera
    assert camera is not None
    period = 1.0 / camera.frame_rate_hz
    clock = np.arange(t[0] + rng.uniform(0.3, 1.3) * period, t[-1], period)
    arrival = clock + camera.delay_s + truth("late")
    scene = clock.copy()
    if unsteady := truth("unsteady"):
        scene = scene + unsteady * (rng.gamma(4.0, 0.5, len(scene)) - 2.0)
    if truth("skew"):
        scene = scene + truth("skew") * (clock - t[0])
    if truth("frozen"):
        held = rng.random(len(scene)) < truth("frozen")
        for i in np.flatnonzero(held):
            if i:
                scene[i] = scene[i - 1]
    return np.clip(scene, t[0], t[-1]), arrival


def _chain(rig: Rig, c_deg: Array, taper: float) -> Array:
    """(n, 3) mm: equal links between elastic joints whose stiffness falls towards the tip by `taper`."""
    kinematics = rig.kinematics
    assert kinematics is not None
    compliance = 1.0 + taper * (2.0 * (np.arange(_JOINTS) + 0.5) / _JOINTS - 1.0)
    share = compliance / compliance.sum()
    # A joint in the middle of each link: half of its angle before, half after.
    bent = np.radians(c_deg)[:, None] * (np.cumsum(share) - 0.5 * share)
    link = kinematics.bending_length_mm / _JOINTS
    end = np.radians(c_deg)
    x = link * np.sin(bent).sum(1) + kinematics.tip_length_mm * np.sin(end)
    z = link * np.cos(bent).sum(1) + kinematics.tip_length_mm * np.cos(end)
    return np.stack([x, np.zeros_like(x), z], axis=1)


def _rocking(t: Array, p: Array, way: Array, truth: Truth) -> Array:
    """-1 to 1: which way the instrument lies in its channel; friction of the moving tip turns it over within a little
    travel."""
    if not any(truth(f"rock_{k}") for k in "xyz"):
        return np.zeros_like(t)
    lies = np.empty_like(t)
    state, travel = 0.0, max(truth("rock_travel", 0.02), 1e-9)
    steps = np.abs(np.diff(p, prepend=p[0]))
    for i in range(len(t)):
        state += (way[i] - state) * (1.0 - np.exp(-steps[i] / travel))
        lies[i] = state
    return lies


def _tilted(points: Array, degrees: Array) -> Array:
    """Rz Ry Rx by (n, 3) angles."""
    x, y, z = points.T
    a, b, c = np.radians(degrees).T
    y, z = np.cos(a) * y - np.sin(a) * z, np.sin(a) * y + np.cos(a) * z
    x, z = np.cos(b) * x + np.sin(b) * z, -np.sin(b) * x + np.cos(b) * z
    x, y = np.cos(c) * x - np.sin(c) * y, np.sin(c) * x + np.cos(c) * y
    return np.stack([x, y, z], axis=1)


def _lens(rig: Rig, seen: Array, truth: Truth, focal: Array) -> Array:
    camera = rig.camera
    assert camera is not None
    z = np.where(seen[:, 2] > 0.5, seen[:, 2], np.nan)
    x, y = seen[:, 0] / z, seen[:, 1] / z
    radius = np.hypot(x, y)
    if truth("fisheye"):  # a share of the way from the tangent to the equidistant projection
        angle = np.arctan(radius)
        scale = 1.0 + truth("fisheye") * (angle / np.maximum(radius, 1e-9) - 1.0)
        x, y = x * scale, y * scale
    if truth("barrel") or truth("decentred"):
        r2 = radius**2
        radial = 1.0 + truth("barrel") * r2 - 0.3 * truth("barrel") * r2**2
        x, y = (
            x * radial + 2 * truth("decentred") * x * y,
            y * radial + truth("decentred") * (r2 + 2 * y * y),
        )
    return np.stack([camera.cx_px + camera.fx_px * focal * x, camera.cy_px + camera.fy_px * focal * y], axis=1)


Draw = Callable[[np.random.Generator, Rig], dict[str, float]]


def _around(rng: np.random.Generator, low: float, high: float) -> float:
    """Log-uniform, either sign."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))) * rng.choice([-1.0, 1.0]))


def _size(rng: np.random.Generator, low: float, high: float) -> float:
    return abs(_around(rng, low, high))


def _six(rng: np.random.Generator, prefix: str, turn: float, move: float) -> dict[str, float]:
    a, b = rng.normal(size=3), rng.normal(size=3)
    a, b = a / np.linalg.norm(a) * _size(rng, 0.4 * turn, turn), b / np.linalg.norm(b) * _size(rng, 0.2 * move, move)
    return {f"{prefix}_r{k}": float(v) for k, v in zip("xyz", a, strict=True)} | {
        f"{prefix}_{k}": float(v) for k, v in zip("xyz", b, strict=True)
    }


# Effect of the library -> how this instrument does it. Lengths are shares of the motor's range.
KNOWN: Mapping[str, Draw] = {
    "actuator.encoder_periodic": lambda g, r: {
        "encoder_period": _size(g, 0.03, 0.15) * r.actuator.span,
        "encoder_error": _size(g, 0.0015, 0.006) * r.actuator.span,
        "encoder_phase": float(g.uniform(0, 6.28)),
    },
    "transmission.smooth_onset": lambda g, r: {"softness": float(g.uniform(0.3, 0.9))},
    "transmission.asymmetric_backlash": lambda g, r: {
        "latch": _around(g, 0.008, 0.03) * r.actuator.span,
        "latch_travel": _size(g, 0.03, 0.12) * r.actuator.span,
    },
    "transmission.rate_dependent_backlash": lambda g, r: {
        "viscosity": _size(g, 0.03, 0.12),
        "speed_scale": 0.6 * r.actuator.span,
    },
    "transmission.lag": lambda g, r: {"dashpot": _size(g, 0.03, 0.15)},
    "transmission.creep": lambda g, r: {"creep_share": _size(g, 0.05, 0.2), "creep_time": _size(g, 0.7, 2.5)},
    "transmission.stick_slip": lambda g, r: {
        "static_grip": _size(g, 0.004, 0.015) * r.actuator.span,
        "kinetic_grip": float(g.uniform(0.0, 0.3)),
        "grip_scatter": float(g.uniform(0.1, 0.4)),
    },
    "transmission.drift": lambda g, r: {
        "creeping_offset": _around(g, 0.01, 0.04) * r.actuator.span,
        "widening": float(g.choice([0.0, 1.0])) * _around(g, 0.1, 0.4),
        "warm_up": _size(g, 200.0, 600.0),
    },
    "transmission.load_dependence": lambda g, r: {
        "stretch_per_load": _around(g, 2e-4, 8e-4) * r.actuator.span,
        "capstan_per_load": _around(g, 1e-3, 6e-3),
        "soften_per_load": _around(g, 3e-4, 2e-3),
    },
    "configuration.axis_coupling": lambda g, r: {
        "pull_by_translation": _around(g, 0.1, 0.6),
        "twist": _around(g, 0.01, 0.06),
    },
    "configuration.contact": lambda g, r: {
        "obstacle": _size(g, 0.3, 3.0),
        "obstacle_at": float(g.uniform(10.0, 28.0)),
        "obstacle_side": float(g.choice([-1.0, 1.0])),
    },
    "kinematics.nonconstant_curvature": lambda g, r: {"taper": _around(g, 0.15, 0.6)},
    "registration.static": lambda g, r: _six(g, "mount", 3.0, 1.0),
    "registration.direction_dependent": lambda g, r: {
        **{f"rock_{k}": float(v) for k, v in zip("xyz", g.normal(size=3) * _size(g, 0.2, 0.8), strict=True)},
        "rock_travel": _size(g, 0.001, 0.006) * r.actuator.span,
    },
    "registration.shift": lambda g, r: _six(g, "slip", 2.0, 0.8),
    "camera.distortion": lambda g, r: (
        {"fisheye": _size(g, 0.15, 0.8)}
        if g.random() < 0.5
        else {"barrel": _around(g, 0.04, 0.25), "decentred": _around(g, 0.002, 0.02)}
    ),
    "acquisition.delay": lambda g, r: {"late": _around(g, 0.015, 0.05)},
    "acquisition.jitter": lambda g, r: {"unsteady": _size(g, 0.004, 0.012)},
}

UNKNOWN: Mapping[str, Draw] = {
    "breathing": lambda g, r: {"breath": _size(g, 0.05, 0.3), "breath_hz": float(g.uniform(0.15, 0.4))},
    "zoom": lambda g, r: {"zoom": _around(g, 0.01, 0.05)},
    "sliding_marker": lambda g, r: {"sliding_marker": _size(g, 0.02, 0.15)},
    "lost_counts": lambda g, r: {
        "lost_counts": _size(g, 0.5, 2.0),
        "lost_size": _size(g, 0.003, 0.012) * r.actuator.span,
    },
    "ringing": lambda g, r: {"ring_hz": float(g.uniform(0.5, 2.0)), "ring_damping": float(g.uniform(0.05, 0.3))},
    "gravity": lambda g, r: {"sag": _around(g, 0.1, 0.5)},
    "bouc_wen": lambda g, r: {
        "bulge": _around(g, 0.006, 0.02) * r.actuator.span,
        "bulge_travel": _size(g, 0.08, 0.3) * r.actuator.span,
    },
    "frozen_frames": lambda g, r: {"frozen": float(g.uniform(0.05, 0.3))},
    "clock_skew": lambda g, r: {"skew": _around(g, 3e-4, 2e-3)},
}
