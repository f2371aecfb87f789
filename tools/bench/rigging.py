"""./run bench rig: is a recording calibrated as well with a rig.toml that `taut rig` made as with the true one?

A ChArUco board is drawn before the true camera ray by ray, then a video of the instrument at rest at known angles, then
one of a calibration's motion. `taut rig` makes a file from the first two, and the third is calibrated with either.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import click
import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from tautline import trajectory
from tautline.cli._common import json_option, progress_bar
from tautline.plain import plain
from tautline.rig import Camera, Rig
from tautline.rigging import Board
from tautline.rigging.places import STANDS_S
from tautline.simulated.endoscope import Endoscope
from tautline.simulated.instrument import preset, reference_rig
from tautline.simulated.simulate import Simulation
from tautline.simulated.simulate import run as simulate
from tools.bench import videos
from tools.bench.videos import bends, said

Array = np.ndarray
BOARD = Board(8, 6, 4.0, 3.0, "4X4_50")
LENS = {"fx_px": 515.0, "fy_px": 512.0, "cx_px": 352.0, "cy_px": 281.0, "distortion": (-0.22, 0.06, 6e-4, -4e-4, 0.0)}


def rays_of(camera: Camera, u: Array, v: Array) -> Array:
    """(n, 3) directions with z = 1: Brown and Conrady's equations, turned round by iteration."""
    k1, k2, p1, p2, k3 = camera.distortion
    xd, yd = (u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px
    x, y = xd.copy(), yd.copy()
    for _ in range(50):
        r2 = x * x + y * y
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        x = (xd - 2 * p1 * x * y - p2 * (r2 + 2 * x * x)) / radial
        y = (yd - p1 * (r2 + 2 * y * y) - 2 * p2 * x * y) / radial
    return np.column_stack([x, y, np.ones_like(x)])


@cache
def _rays(camera: Camera) -> Array:
    v, u = np.mgrid[0 : camera.height_px, 0 : camera.width_px]
    return rays_of(camera, u.ravel().astype(float), v.ravel().astype(float))


def pictures(camera: Camera, count: int, seed: int) -> list[Array]:
    """A board that is held before the camera: each pixel's ray meets its plane; nothing of OpenCV's calibration."""
    rng = np.random.default_rng(seed)
    fine = 40  # px a mm of the print
    width, height = BOARD.columns * BOARD.square_mm, BOARD.rows * BOARD.square_mm
    size = (int(width * fine / 4), int(height * fine / 4))
    print_ = BOARD.opencv().generateImage(size, marginSize=0).astype(float)
    shape = (camera.height_px, camera.width_px)
    rays = _rays(camera)
    made = []
    for _ in range(count):
        tilt = np.radians([rng.uniform(-35, 35), rng.uniform(-35, 35), rng.uniform(-20, 20)])
        turn = cv2.Rodrigues(tilt)[0]
        middle = turn @ np.array([width / 2, height / 2, 0.0])
        at = np.array([rng.uniform(-6, 6), rng.uniform(-5, 5), rng.uniform(32, 48)]) - middle
        normal = turn[:, 2]
        there = rays * ((normal @ at) / (rays @ normal))[:, None] - at
        x, y = there @ turn[:, 0], there @ turn[:, 1]
        seen = (x > 0) & (x < width) & (y > 0) & (y < height)
        grid = [c.reshape(shape).astype(np.float32) * fine / 4 - 0.5 for c in (x, y)]
        picture = cv2.remap(cv2.GaussianBlur(print_, (0, 0), 1.2), *grid, cv2.INTER_LINEAR)
        picture = np.where(seen.reshape(shape), picture, 140.0) + rng.normal(0, 2.0, shape)
        made.append(np.clip(picture, 0, 255).astype(np.uint8))
    return made


def rests(rig: Rig, places: int) -> tuple[trajectory.Trajectory, list[float]]:
    """A motion that rests at so many places over nine tenths of the range, and when each rest has begun, s."""
    low, high = rig.actuator.range
    steps = np.linspace(low, high, places) * 0.9
    t, q, when = [0.0], [low], []
    for at in steps:
        for wait in (1.2, STANDS_S + 0.6):
            t.append(t[-1] + wait)
            q.append(float(at))
        when.append(t[-2] + 0.2)
    grid = np.arange(0.0, t[-1], 0.004)
    return trajectory.Trajectory(grid, np.interp(grid, t, q), 0 * grid, 0 * grid), when


@dataclass(frozen=True)
class Outcome:
    seed: int
    width_um: tuple[float, float]  # B's error, rms within `measured`: with the true rig, with the one made
    remaining_deg: tuple[float, float]  # f_remain's, likewise
    said_deg: float  # what `taut rig` says that angles measured with its pose are uncertain by, at worst
    verdicts: tuple[str, str]


def angles(made: Simulation, when: Sequence[float], sigma_deg: float, seed: int) -> str:
    """angles.csv as by a protractor that errs by sigma_deg."""
    off = np.random.default_rng([seed, 0xA6]).normal(0.0, sigma_deg, len(when))
    read = np.interp(np.add(when, 0.5 * STANDS_S), made.t_s, made.c_deg) + off
    return "t_s,c_deg\n" + "".join(f"{t_s:.3f},{c_deg:.5f}\n" for t_s, c_deg in zip(when, read, strict=True))


def once(room: Path, seed: int, places: int, views: int, sigma_deg: float) -> Outcome:
    plain_rig = reference_rig()
    assert plain_rig.camera is not None
    rig = replace(plain_rig, camera=replace(plain_rig.camera, **LENS))
    plant = preset("reference", rig, seed)
    motion, when = rests(rig, places)
    known = simulate(rig, plant, motion, seed=seed)
    known.save(room / "known", Endoscope(rig, seed=seed))
    (room / "known" / "rig.toml").unlink()
    (room / "known" / "angles.csv").write_text(angles(known, when, sigma_deg, seed))
    (room / "board").mkdir()
    for k, picture in enumerate(pictures(rig.camera, views, seed)):
        cv2.imwrite(str(room / "board" / f"{k:03d}.png"), picture)
    strokes = trajectory.back_and_forth(rig.actuator, [0.5, 1.0], 1.6, 40, 4.0, 0.1)
    simulate(rig, plant, strokes, seed=seed + 1000).save(room / "strokes", Endoscope(rig, seed=seed))
    rig.save(room / "true.toml")
    board = [word for file in sorted((room / "board").iterdir()) for word in ("--board", str(file))]
    given = [word for text in _given(rig) for word in ("--set", text)]
    _, told = said(
        "rig", "--out", str(room / "made.toml"), *board, "--squares", f"{BOARD.columns}x{BOARD.rows}",
        "--square-mm", str(BOARD.square_mm), "--marker-mm", str(BOARD.marker_mm), "--motion", str(room / "known"),
        "--angle-sigma", str(sigma_deg), *given,
    )  # fmt: skip
    truth = json.loads((room / "strokes" / "truth.json").read_text())
    scores = [_score(room, name, seed, truth) for name in ("true", "made")]
    width, remaining, verdicts = zip(*scores, strict=True)
    return Outcome(seed, width, remaining, max(told["hand_eye"]["measured_angle_sigma_deg"]), verdicts)


def _given(rig: Rig) -> list[str]:
    """What nobody measures with a board or a motion: as it would be typed."""
    camera = rig.camera
    assert camera is not None and rig.kinematics is not None
    low, high = rig.actuator.range
    return [
        f"actuator.unit={rig.actuator.unit}", f"actuator.range={low}, {high}",
        f"actuator.encoder_resolution={rig.actuator.encoder_resolution}",
        f"kinematics.bending_length_mm={rig.kinematics.bending_length_mm}",
        f"kinematics.tip_length_mm={rig.kinematics.tip_length_mm}",
        f"camera.frame_rate_hz={camera.frame_rate_hz}", f"camera.delay_s={camera.delay_s}",
    ]  # fmt: skip


def _score(room: Path, name: str, seed: int, truth: dict[str, Any]) -> tuple[float, float, str]:
    words = ("--rig", str(room / f"{name}.toml"), "--out", str(room / f"model-{name}"))
    status, document = said("calibrate", str(room / "strokes"), *words)
    outcome = videos.Outcome.of(name, seed, status, document, truth)
    return outcome.error_um, bends(document, truth)[0], outcome.verdict


@click.command("rig")
@click.option("--seeds", type=click.IntRange(1, 100), default=5, show_default=True)
@click.option("--first-seed", type=click.IntRange(0), default=0, show_default=True)
@click.option("--places", type=click.IntRange(4, 100), default=15, show_default=True, help="Known angles.")
@click.option("--views", type=click.IntRange(3, 100), default=30, show_default=True, help="Of the board.")
@click.option("--angle-sigma", type=click.FloatRange(0.0), default=0.001, show_default=True, help="What angles err by.")
@json_option
def command(seeds: int, first_seed: int, places: int, views: int, angle_sigma: float, as_json: bool) -> None:
    """Calibrates videos with a rig.toml that `taut rig` made from videos, beside the true one."""
    outcomes = []
    with progress_bar("rigs") as progress:
        for k in range(seeds):
            progress(k / seeds, f"seed {first_seed + k}")
            with tempfile.TemporaryDirectory() as room:
                outcomes.append(once(Path(room), first_seed + k, places, views, angle_sigma))
    if as_json:
        click.echo(json.dumps([plain(asdict(outcome)) for outcome in outcomes], allow_nan=False))
        return
    table = Table(title=f"with the true rig, with the one made (angles to {angle_sigma:g} deg)")
    for name in ("seed", "B, um", "f_remain, deg", "said, deg", "verdict"):
        table.add_column(name, justify="left" if name == "verdict" else "right")
    for o in outcomes:
        table.add_row(
            str(o.seed), "{:.3f}  {:.3f}".format(*o.width_um), "{:.4f}  {:.4f}".format(*o.remaining_deg),
            f"{o.said_deg:.4f}", ", ".join(o.verdicts),
        )  # fmt: skip
    Console().print(table)
    for what, pairs in (("B", [o.width_um for o in outcomes]), ("f_remain", [o.remaining_deg for o in outcomes])):
        ratios = np.sort([made / true for true, made in pairs])
        click.echo(f"{what}: {np.median(ratios):.2f} times in the median, {ratios[-1]:.2f} at worst")
