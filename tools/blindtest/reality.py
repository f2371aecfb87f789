"""A second, independent instrument, for blind tests: its effects follow other equations than the library's.

The transmission is a pin in a slot with bristles, latches, dashpots, Kelvin elements and gripping walls (reality.h);
the bending section is a chain of discrete elastic joints; the lens a fisheye or Brown-Conrady's with a rolling shutter;
the instrument rocks in its channel. What `Truth` switches on is what a case's label says; draws.py says how strongly.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from scipy.special import expit

from tautline import _native
from tautline.geometry import rotation as rotation_of
from tautline.model import Model
from tautline.recording import Marker, Motor, Recording
from tautline.rig import Rig
from tautline.trajectory import Trajectory

Array = npt.NDArray[np.float64]
_JOINTS = 96
_ENCODER_EVERY = 4  # of the motion's samples, 1 ms apart


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
    plant: Plant,
    truth: Truth,
    motion: Trajectory,
    session_s: float,
    seed: int,
    name: str,
    load: Array | None = None,
    starts_s: float = 0.0,
) -> Recording:
    """Drives the plant along `motion`, which starts `session_s` into the session; its own clock then says `starts_s`.
    What it was goes nowhere. Two truths at one seed share frame times, noise and lost frames."""
    clock, scatter, noise, loss = (np.random.default_rng([seed, 0xB11D, i]) for i in range(4))
    rig = plant.rig
    camera = rig.camera
    assert camera is not None
    t = motion.t_s
    tip = driven(plant, truth, motion, session_s, seed, load, scatter)
    scene, arrival, shown = _frames(t, rig, truth, clock, scatter)
    image = _image(rig, truth, motion, scene, session_s, tip)
    if readout := truth("readout"):  # a row is read the later the lower it is
        for _ in range(2):
            late = readout * (np.nan_to_num(image[:, 1], nan=0.5 * camera.height_px) / camera.height_px - 0.5)
            image = _image(rig, truth, motion, np.clip(scene + late, t[0], t[-1]), session_s, tip)
    if truth("sliding_marker"):
        walk = np.cumsum(scatter.normal(0.0, 1.0, len(scene))) * truth("sliding_marker")
        image = image + walk[:, None] * np.array([0.8, 0.6])
    if locking := truth("locking"):  # a centroid that is drawn to the pixels' centres
        image = image - locking * np.sin(2 * np.pi * image / truth("locking_px", 1.0))
    image = (image + noise.normal(0.0, 1.0, image.shape) * plant.noise_px)[shown]
    u, v = np.nan_to_num(image, nan=-1.0).T
    inside = (u >= 0) & (u <= camera.width_px - 1) & (v >= 0) & (v <= camera.height_px - 1)
    kept = loss.random(len(scene)) > 0.003  # a frame is lost now and then
    image, inside, arrival = image[kept], inside[kept], arrival[kept]
    image = np.where(inside[:, None], image, np.nan)

    q = motion.q
    if period := truth("encoder_period"):  # the encoder errs, not the motor: what is recorded is off by this
        angle = 2 * np.pi * q / period + truth("encoder_phase")
        q = q + truth("encoder_error") * (np.sin(angle) + 0.15 * np.sin(2 * angle + 1.0))
    resolution = rig.actuator.encoder_resolution
    sampled = np.unique(np.append(np.arange(0, len(t), _ENCODER_EVERY), len(t) - 1))

    def column(values: Array | None) -> Array | None:
        return values[sampled] if values is not None and np.ptp(values) else None

    motor = Motor(
        t[sampled] + starts_s,
        np.round(q[sampled] / resolution) * resolution,
        None,
        column(motion.translation_mm),
        column(motion.rotation_deg),
        None if load is None else load[sampled],
    )
    return Recording(name, motor, Marker(arrival + starts_s, image[:, 0], image[:, 1], inside, None), rig=rig)


@dataclass(frozen=True)
class Tip:
    """(n,) at the motion's times: bending angle, and which way the instrument lies in its channel, -1 to 1."""

    c_deg: Array
    lies: Array


def _by_load(truth: Truth, load: Array) -> tuple[Array, Array, Array]:
    """What a load (n,) mNm adds to q, and times what B and c are."""
    stretched = truth("stretch_per_load") * load / (1.0 + 0.003 * np.abs(load))
    return stretched, np.exp(truth("capstan_per_load") * load), 1.0 + truth("soften_per_load") * load


def at_load(sound: Model, truth: Truth, load_mNm: float) -> Model:
    """The sound model's tables as they are at a load."""
    shift, wider, stiffer = (float(of[0]) for of in _by_load(truth, np.array([load_mNm])))
    width, c_deg = (np.interp(sound.q + shift, sound.q, values) for values in (sound.width, sound.c_deg))
    return replace(sound, width=wider * width, c_deg=stiffer * c_deg)


def driven(
    plant: Plant,
    truth: Truth,
    motion: Trajectory,
    session_s: float,
    seed: int,
    load: Array | None,
    scatter: np.random.Generator,
) -> Tip:
    """Where the tip goes, whose motor goes where `motion` says."""
    t, span = motion.t_s, plant.rig.actuator.span
    when = t + session_s
    q = motion.q + truth("homing")
    if rate := truth("lost_counts"):  # fast moves lose counts now and then
        lost = scatter.random(len(q)) < rate * np.abs(np.gradient(q, t)) / span * 1e-3
        q = q + np.cumsum(lost * scatter.choice([-1.0, 1.0], len(q))) * truth("lost_size")
    warm = 1.0 - np.exp(-np.maximum(when - truth("warms_from"), 0.0) / truth("warm_up", 300.0))
    q = q + truth("creeping_offset") * warm
    factor = 1.0 + truth("widening") * warm
    shift, wider, stiffer = _by_load(truth, np.zeros_like(t) if load is None else load)
    q, factor = q + shift, factor * wider
    factor = factor + truth("worn") * np.exp(-0.5 * ((q - truth("worn_at")) / truth("worn_reach", 1.0)) ** 2)
    values = {name: truth(name) for name in _TRANSMISSION if name in truth.values}
    p, way = _native.reality_transmission(
        values, plant.grid, plant.width, t, np.ascontiguousarray(q), np.ascontiguousarray(factor), np.nan, seed
    )
    slope = np.gradient(plant.c_deg, plant.grid)
    low, high = plant.grid[0], plant.grid[-1]
    c = np.interp(p, plant.grid, plant.c_deg)
    c = c + slope[0] * np.minimum(p - low, 0) + slope[-1] * np.maximum(p - high, 0)
    c = c + truth("kink") * np.exp(-0.5 * ((p - truth("kink_at")) / truth("kink_reach", 1.0)) ** 2)
    c = c * stiffer
    if motion.translation_mm is not None:
        c = c + truth("pull_by_translation") * motion.translation_mm
    if motion.rotation_deg is not None:
        c = c + truth("twist") * np.degrees(np.sin(np.radians(motion.rotation_deg)))
    if stiffness := truth("obstacle"):
        c = _held(c, stiffness, truth("obstacle_at"), float(np.sign(truth("obstacle_side", 1.0))))
    rocks = any(truth(f"rock_{k}") for k in "xyz")
    return Tip(c, _native.reality_rocking(p, way, truth("rock_travel", 0.02)) if rocks else np.zeros_like(t))


def _held(c: Array, stiffness: float, at: float, side: float) -> Array:
    """A Hertzian wall against an elastic section: what it gives way by solves d + k d^1.5 = depth."""
    result = c.copy()
    touching = side * c > at
    depth = side * c[touching] - at
    give = depth.copy()
    for _ in range(25):
        give = give - (give + stiffness * give**1.5 - depth) / (1.0 + 1.5 * stiffness * np.sqrt(give + 1e-12))
        give = np.maximum(give, 0.0)
    result[touching] -= side * (depth - give)
    return result


def _frames(
    t: Array, rig: Rig, truth: Truth, clock: np.random.Generator, scatter: np.random.Generator
) -> tuple[Array, Array, npt.NDArray[np.int64]]:
    """Scene and arrival times, and which frame is shown: a link that stalls repeats the last one. An unsteady link
    delays frames by gamma-distributed times; arrival tells the nominal clock."""
    camera = rig.camera
    assert camera is not None
    period = 1.0 / camera.frame_rate_hz
    ticks = np.arange(t[0] + clock.uniform(0.3, 1.3) * period, t[-1], period)
    arrival = ticks + camera.delay_s + truth("late")
    scene = ticks.copy()
    if unsteady := truth("unsteady"):
        scene = scene + unsteady * (scatter.gamma(4.0, 0.5, len(scene)) - 2.0)
    scene = scene + truth("skew") * (ticks - t[0])
    shown = np.arange(len(ticks))
    if rate := truth("stalls"):
        for start in np.flatnonzero(scatter.random(len(ticks)) < rate * period):
            held = int(scatter.exponential(truth("stall_s", 0.3)) / period)
            shown[start : start + held] = shown[start]
    return np.clip(scene, t[0], t[-1]), arrival, shown


def _image(rig: Rig, truth: Truth, motion: Trajectory, scene: Array, session_s: float, tip: Tip) -> Array:
    """(n, 2) px of the marker at scene times (n,), without noise."""

    def at(values: Array | None) -> Array:
        return np.zeros(len(scene)) if values is None else np.interp(scene, motion.t_s, values)

    when = scene + session_s
    c = at(tip.c_deg)
    bend = np.radians(c)
    point = _chain(rig, c, truth("taper"))
    tangent = np.stack([np.sin(bend), np.zeros_like(bend), np.cos(bend)], axis=1)
    point = point + truth("beside_x") * np.stack([np.cos(bend), np.zeros_like(bend), -np.sin(bend)], axis=1)
    point = point + np.array([0.0, truth("beside_y"), 0.0])
    point[:, 2] += at(motion.translation_mm)
    rolled = np.zeros((len(scene), 3))
    rolled[:, 2] = at(motion.rotation_deg)
    base, along = _tilted(point, rolled), _tilted(tangent, rolled)
    if sag := truth("sag"):  # a section bends under its own weight: only what pulls across it
        down = np.radians(truth("sag_towards"))
        weight = np.array([np.cos(down), np.sin(down), 0.0])
        base = base + sag * (weight - (along @ weight)[:, None] * along)
    base = _tilted(base, at(tip.lies)[:, None] * np.array([truth("rock_x"), truth("rock_y"), truth("rock_z")]))
    moved = expit((when - truth("slip_time", 1e12)) / 0.05)
    for prefix, share in (("mount", np.ones(len(scene))), ("slip", moved)):
        base = _tilted(base, share[:, None] * np.array([truth(f"{prefix}_r{k}") for k in "xyz"]))
        base = base + share[:, None] * np.array([truth(f"{prefix}_{k}") for k in "xyz"])
    breath = truth("breath") * np.sin(2 * np.pi * truth("breath_hz", 0.25) * when)
    base = base + breath[:, None] * np.array([0.3, 1.0, 0.2])
    hand_eye = rig.hand_eye
    assert hand_eye is not None
    seen = base @ rotation_of(hand_eye.rotation_deg).T + np.asarray(hand_eye.translation_mm)
    return _lens(rig, seen, truth, 1.0 + truth("zoom") * (1.0 - np.exp(-when / 200.0)))


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
