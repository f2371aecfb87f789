"""Plays a set-up through: recording folders as formats of recordings ask for, and a truth that is kept elsewhere."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

from tools.honesty.motion import STEP_S, Motion
from tools.honesty.optics import Camera, project, tip_place
from tools.honesty.plant import envelopes
from tools.honesty.setup import Setup

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Made:
    """What the benchmark needs to run and score one case."""

    recordings: list[Path]
    rig: Path
    test: Path
    times: Path
    truth: dict[str, Any]  # arrays and numbers; nothing of it is in the folders


@dataclass(frozen=True)
class _Moved:
    """One motion with everything that happened on it, at STEP_S."""

    t: Array  # on the set-up's time
    q: Array  # motor, as it was
    p: Array
    c: Array
    columns: dict[str, Array]
    clock0: float  # what its clock says at t[0]


def make(setup: Setup, folder: Path) -> Made:
    rng = setup.rng
    setup.motor.phase = float(rng.uniform(0, 1))
    moved, end = _moves(setup)
    paths = []
    for number, one in enumerate(moved):
        path = folder / f"recording-{number}"
        path.mkdir(parents=True)
        _write_motor(setup, one, path, rng)
        if setup.angle is not None:
            _write_angle(setup, one, path, rng)
        if setup.video is not None:
            from tools.honesty.render import write_video

            write_video(setup, path, *_frames(setup, one, rng))
        elif setup.image is not None:
            _write_marker(setup, one, path, rng)
        paths.append(path)
    rig = folder / "rig.toml"
    rig.write_text(tomli_w.dumps(rig_of(setup)))
    test, times, truth = _test(setup, folder, end)
    return Made(paths, rig, test, times, {**truth, **_static_truth(setup, moved)})


def rig_of(setup: Setup) -> dict[str, Any]:
    a = setup.actuator
    rig: dict[str, Any] = {
        "format": "rig/1",
        "actuator": {"unit": a.unit, "range": [a.low, a.high], "encoder_resolution": a.resolution},
        "coarse": {"gain": setup.gain, "offset": setup.offset},
    }
    if setup.camera is not None and setup.image is not None:
        k = setup.camera
        rig["kinematics"] = {"bending_length_mm": k.bending, "tip_length_mm": k.tip}
        rig["camera"] = {
            "width_px": k.width,
            "height_px": k.height,
            "fx_px": k.fx,
            "fy_px": k.fy,
            "cx_px": k.cx,
            "cy_px": k.cy,
            "distortion": list(k.distortion),
            "frame_rate_hz": k.frame_rate,
            "delay_s": k.delay,
        }
        rig["hand_eye"] = {"rotation_deg": list(k.rotation), "translation_mm": list(k.translation)}
    if setup.angle is not None and setup.angle.told_delay_s is not None:
        rig["angle"] = {"delay_s": setup.angle.told_delay_s}
    return setup.rig_file(rig) if setup.rig_file else rig


def _moves(setup: Setup) -> tuple[list[_Moved], float]:
    """Every recording in turn: the tip carries over where the motor stands; else it is somewhere in the backlash."""
    out, t0 = [], 0.0
    for motion in setup.recordings:
        out.append(_play_through(setup, motion, t0, 0.0 if setup.own_clocks else t0, float(setup.rng.uniform(-1, 1))))
        t0 = float(out[-1].t[-1]) + setup.gap_s
    return out, float(out[-1].t[-1])


def _play_through(setup: Setup, motion: Motion, t0: float, clock0: float, start: float, frozen: bool = False) -> _Moved:
    t = motion.t + t0
    when = np.full(len(t), t0) if frozen else t
    q = motion.q
    if setup.motor.vibration:
        q = q + _vibration(setup, len(q))
    columns = setup.columns(motion, setup.rng) if setup.columns else {}
    scale = None if setup.scale is None else setup.scale(when, q)
    pulled = q if setup.shift is None else q + setup.shift(when, q)
    if setup.load_scale:
        factor, pull = setup.load_scale(columns)
        scale = factor if scale is None else scale * factor
        pulled = pulled + pull
    p = setup.hysteresis.respond(pulled, scale, start)
    for effect in setup.tendon:
        p = effect(motion.t, p)
    c = setup.law(p)
    for bend in setup.bend:
        c = bend(motion.t, c, columns)
    return _Moved(when, q, p, c, columns, clock0)


def _vibration(setup: Setup, n: int) -> Array:
    """A narrow-band tremble around the motor's own frequency."""
    t = np.arange(n) * STEP_S
    rng, f = setup.rng, setup.motor.vibration_hz
    lines = f * rng.uniform(0.8, 1.25, 7)
    wave = sum(np.sin(2 * np.pi * line * t + phase) for line, phase in zip(lines, rng.uniform(0, 6.28, 7), strict=True))
    return np.asarray(setup.motor.vibration * wave / np.sqrt(3.5))


def _write_motor(setup: Setup, one: _Moved, path: Path, rng: np.random.Generator) -> None:
    log, a = setup.motor, setup.actuator
    n = len(one.q)
    own = np.arange(n) * STEP_S
    t = np.arange(0.0, own[-1], 1.0 / log.rate_hz)
    q = np.interp(t + log.lead_s, own, one.q)
    if log.periodic:
        q = q + log.periodic * np.sin(2 * np.pi * (q / log.period + log.phase))
    if log.noise:
        q = q + rng.normal(0, log.noise, len(q))
    count = log.resolution or a.resolution
    q = (np.floor(q / count + log.phase) + 0.5 - log.phase) * count
    t = t + one.clock0
    if log.change:
        t, q = log.change(t, q)
    table = {"t_s": t, f"q_{a.unit}": q}
    for name, values in one.columns.items():
        if setup.logged is None or name in setup.logged:
            table[name] = np.interp(t - one.clock0, own, values)
    write_csv(path / "motor.csv", table)


def _frames(setup: Setup, one: _Moved, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Scene times (own), true arrival times (own) and the marker's true places in px at those frames."""
    assert setup.image is not None and setup.camera is not None
    image = setup.image
    own = np.arange(len(one.q)) * STEP_S
    rate = setup.camera.frame_rate
    scene = np.arange(rng.uniform(0, 1 / rate), own[-1] - image.delay_s, 1 / rate)
    arrival = scene + image.delay_s
    if image.exposure:
        scene = np.clip(scene - image.exposure(scene + one.t[0]), 0, own[-1])
    if image.lost:
        kept = rng.random(len(scene)) >= image.lost
        scene, arrival = scene[kept], arrival[kept]
    return scene, arrival, _image(setup, one, scene)


def _image(setup: Setup, one: _Moved, scene: Array) -> Array:
    camera: Camera | None = setup.seen_by or setup.camera
    assert camera is not None
    own = np.arange(len(one.q)) * STEP_S
    c = np.interp(scene, own, one.c)
    joints = {name: np.interp(scene, own, values) for name, values in one.columns.items()}
    place = tip_place(c, camera, joints.get("translation_mm", 0.0), joints.get("rotation_deg", 0.0))
    when = np.interp(scene, own, one.t)
    heading = np.interp(scene, own, _heading(one.p))
    tilt = None if setup.tilt is None else setup.tilt(when, heading)
    return project(place, camera, tilt)


def _heading(p: Array) -> Array:
    """The direction of the tip's last motion, +-1."""
    step = np.sign(np.diff(p, prepend=p[0]))
    last = np.maximum.accumulate(np.where(step != 0, np.arange(len(p)), 0))
    return np.where(step[last] == 0, 1.0, step[last])


def _write_marker(setup: Setup, one: _Moved, path: Path, rng: np.random.Generator) -> None:
    assert setup.image is not None
    image = setup.image
    scene, arrival, uv = _frames(setup, one, rng)
    sigma = np.full(len(uv), image.noise_px)
    if image.noise_wave:
        sigma = sigma * image.noise_wave(scene)
    if image.place_error:
        uv = uv + image.place_error(uv)
    uv = uv + rng.normal(0, 1, uv.shape) * sigma[:, None]
    if image.spoil:
        uv = image.spoil(scene, uv, rng)
    stamps = (image.stamp(arrival, rng) if image.stamp else arrival) + image.offset_s
    table = {"t_s": stamps + one.clock0, "u_px": uv[:, 0], "v_px": uv[:, 1]}
    if image.missed:
        table["valid"] = _stretches(len(uv), image.missed, rng)
    if image.sigma_column:
        table["sigma_px"] = sigma
    if image.extra:
        table = image.extra(table, rng)
    write_csv(path / "marker.csv", table)


def _stretches(n: int, share: float, rng: np.random.Generator) -> Array:
    """1 where the marker is seen: misses come in stretches of a few frames."""
    valid = np.ones(n)
    while valid.mean() > 1 - share:
        at = int(rng.integers(0, n))
        valid[at : at + int(rng.geometric(0.15))] = 0
    return valid


def _write_angle(setup: Setup, one: _Moved, path: Path, rng: np.random.Generator) -> None:
    angle = setup.angle
    assert angle is not None
    own = np.arange(len(one.q)) * STEP_S
    scene = np.arange(rng.uniform(0, 1 / angle.rate_hz), own[-1] - angle.delay_s, 1 / angle.rate_hz)
    c = np.interp(scene, own, one.c)
    if angle.error:
        c = c + angle.error(c)
    c = c + rng.normal(0, angle.noise_deg, len(c))
    if angle.resolution_deg:
        c = np.round(c / angle.resolution_deg) * angle.resolution_deg
    if angle.held > 1:
        c = c[(np.arange(len(c)) // angle.held) * angle.held]
    if angle.spoil:
        c = angle.spoil(scene, c, rng)
    table = {"t_s": scene + angle.delay_s + one.clock0, "c_deg": c}
    if angle.valid:
        table["valid"] = angle.valid(scene, rng)
    write_csv(path / "angle.csv", table)


def write_csv(path: Path, table: dict[str, Array]) -> None:
    cells = "%.6f" + ",%.7f" * (len(table) - 1) + "\n"
    rows = zip(*(column.tolist() for column in table.values()), strict=True)
    path.write_text(",".join(table) + "\n" + "".join([cells % row for row in rows]))


def _test(setup: Setup, folder: Path, end: float) -> tuple[Path, Path, dict[str, Any]]:
    """The unseen motion: the motor's log as good as the rig says, the truth without noise."""
    path = folder / "test"
    path.mkdir()
    quiet = replace(
        setup,
        motor=replace(setup.motor, change=None, vibration=0.0, rate_hz=max(setup.motor.rate_hz, 200.0)),
    )
    one = _play_through(quiet, setup.test, end, 0.0, float(setup.rng.uniform(-1, 1)), frozen=True)
    _write_motor(quiet, one, path, setup.rng)
    delay, rate = 0.0, 100.0
    by_image = setup.image is not None and setup.camera is not None
    if by_image:
        assert setup.image is not None and setup.camera is not None
        delay, rate = setup.image.delay_s, setup.camera.frame_rate
        if setup.image.exposure:
            delay += float(setup.image.exposure(np.array([end]))[0])
    elif setup.angle is not None:
        delay, rate = setup.angle.delay_s, min(setup.angle.rate_hz, 100.0)
    own = np.arange(len(one.q)) * STEP_S
    scene = np.arange(0.01, own[-1], 1.0 / rate)
    write_csv(folder / "times.csv", {"t_s": scene + delay})
    widest = float(np.max(setup.width(np.linspace(setup.actuator.low, setup.actuator.high, 501)))) * 1.3
    truth: dict[str, Any] = {
        "c_deg": np.interp(scene, own, one.c),
        "counted": scene >= _driven(one.q, widest) * STEP_S,
        "delay_s": delay + setup.motor.lead_s,  # against what is logged
        "offset_s": setup.image.offset_s if setup.image else 0.0,
        "coarse_deg": setup.gain * np.interp(scene, own, one.q) + setup.offset,
    }
    if by_image:
        truth["uv"] = _image(setup, one, scene)
        assert setup.camera is not None
        truth["coarse_uv"] = project(tip_place(truth["coarse_deg"], setup.camera), setup.camera)
        truth["noise"] = setup.image.noise_px if setup.image else 0.0
    else:
        truth["noise"] = setup.angle.noise_deg if setup.angle else 0.0
    return path, folder / "times.csv", truth


def _driven(q: Array, way: float) -> int:
    """The first sample at which the motor has gone `way` in one direction and then `way` in the other."""
    low = high = float(q[0])
    seen: set[int] = set()
    for k, x in enumerate(q.tolist()):
        low, high = min(low, x), max(high, x)
        if x - low >= way:
            seen.add(1)
            low = high = x
        elif high - x >= way:
            seen.add(-1)
            low = high = x
        if len(seen) == 2:
            return k
    return len(q)


def _state(setup: Setup, moved: list[_Moved]) -> tuple[float, float]:
    """Factor of the width and offset of q that count as true: as at the end, of what comes and goes the mean."""
    factor, pull, end = 1.0, 0.0, float(moved[-1].t[-1])
    still = (setup.actuator.low + setup.actuator.high) / 2
    when = np.linspace(0.0, end, 400) if setup.comes_and_goes else np.full(400, end)
    if setup.scale:
        factor = float(np.mean(setup.scale(when, np.full(400, still))))
    if setup.shift:
        pull = float(np.mean(setup.shift(when, np.full(400, still))))
    if setup.load_scale:
        loaded = [np.mean(setup.load_scale(one.columns), axis=1) for one in moved]
        factor, pull = factor * float(np.mean([x[0] for x in loaded])), pull + float(np.mean([x[1] for x in loaded]))
    return factor, pull


def _static_truth(setup: Setup, moved: list[_Moved]) -> dict[str, Any]:
    """B and f on a grid of the centre coordinate, as full strokes would show them."""
    a = setup.actuator
    grid = np.linspace(a.low, a.high, 401)
    widest = float(np.max(setup.width(grid)))
    shape = envelopes(setup.hysteresis, a.low, a.high, 12.0 * widest)
    ours = envelopes(setup.hysteresis, a.low, a.high, 0.0)
    # Where the rig's own strokes are too short for the envelopes to be reached, B is not defined by them.
    near = np.interp(shape.centre, ours.centre, ours.width, left=np.nan, right=np.nan)
    reached = np.abs(near - shape.width) < 0.015 * shape.width
    widths = np.where(reached, shape.width, np.nan)
    factor, pull = _state(setup, moved)
    c = setup.law(shape.state)
    return {
        "unit": a.unit,
        "um_per_unit": a.um_per_unit,
        "q": grid,
        "width": np.interp(grid, shape.centre - pull, widths * factor + setup.wider, left=np.nan, right=np.nan),
        "remaining_deg": np.interp(grid, shape.centre - pull, c, left=np.nan, right=np.nan),
        "codes": sorted(setup.codes),
        "benign": setup.benign,
        "must_not_pass": setup.must_not_pass,
    }
