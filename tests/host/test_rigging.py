"""taut rig: a rig.toml out of pictures of a board and a motion through known angles."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from cli_runner import Taut
from reference_instrument import PLANT, RIG

from tautline import trajectory
from tautline.calibration.calibrate import calibrate
from tautline.errors import TautError
from tautline.geometry import project
from tautline.recording import save
from tautline.rig import Rig
from tautline.rigging import Places, hand_eye, intrinsics
from tautline.rigging import keys as rig_keys
from tautline.simulated.simulate import run, simulate

sys.path.insert(0, str(Path(__file__).parents[2]))
from tools.bench.rigging import BOARD, pictures, rays_of, rests
from tools.bench.rigging import LENS as DRAWN

LENS = replace(RIG.camera, **DRAWN)
ANGLES = np.linspace(-50.0, 50.0, 9)


@pytest.fixture(scope="module")
def board_pictures() -> list[np.ndarray]:
    return pictures(LENS, 14, 3)


def test_a_board_gives_the_camera_within_its_sigma(board_pictures):
    found = intrinsics(board_pictures, BOARD)
    true = np.array([LENS.fx_px, LENS.fy_px, LENS.cx_px, LENS.cy_px, *LENS.distortion])
    assert found.views >= 12
    off = (found.values - true)[:4]
    assert np.all(np.abs(off) < np.maximum(4.0 * found.sigma[:4], 0.2)), (off, found.sigma[:4])
    assert found.sigma[0] < 2.0
    u, v = (g.ravel() for g in np.meshgrid(np.linspace(60, 660, 9), np.linspace(60, 516, 7)))
    camera = replace(LENS, **{k: tuple(x) if isinstance(x, list) else x for k, x in found.camera().items()})
    between = rays_of(camera, u, v) - rays_of(LENS, u, v)
    assert np.abs(between).max() < 3e-3  # of the focal length: 0.17 deg at the picture's ends


def places(angle_sigma: float, seed: int, noise_px: float = 0.05, rig: Rig = RIG) -> Places:
    rng = np.random.default_rng(seed)
    image = project(rig, ANGLES + rng.normal(0.0, angle_sigma, len(ANGLES))) + rng.normal(0, noise_px, (9, 2))
    return Places(ANGLES, image, np.full(9, 1e-3), ANGLES / 12.0)


POSE = np.array([*RIG.hand_eye.rotation_deg, *RIG.hand_eye.translation_mm])


@pytest.mark.parametrize("angle_sigma", [0.02, 0.5])
def test_known_angles_give_the_pose_within_its_sigma(angle_sigma):
    z, measured = [], []
    for seed in range(40):
        found = hand_eye(places(angle_sigma, seed), RIG.kinematics, RIG.camera, angle_sigma)
        pose = np.array([*found.hand_eye.rotation_deg, *found.hand_eye.translation_mm])
        z.append((pose - POSE) / found.sigma)
        measured.append(found.measures_deg.max())
        assert found.rival > 100.0
    rms = np.sqrt(np.mean(np.square(z), axis=0))
    assert np.all((rms > 0.5) & (rms < 1.5)), rms
    assert np.mean(measured) < 1.2 * max(angle_sigma, 0.05)


@pytest.mark.parametrize("rotation", [(0.0, 60.0, 0.0), (25.0, 10.0, 120.0), (4.0, -3.0, 180.0)])
def test_a_camera_may_look_from_anywhere(rotation):
    rig = replace(RIG, hand_eye=replace(RIG.hand_eye, rotation_deg=rotation, translation_mm=(-2.0, 3.0, 40.0)))
    found = hand_eye(places(0.02, 1, rig=rig), rig.kinematics, rig.camera, 0.02)
    again = project(replace(rig, hand_eye=found.hand_eye), ANGLES) - project(rig, ANGLES)
    assert np.abs(again).max() < 0.3


@pytest.mark.parametrize(
    "c_deg", [np.full(8, 10.0), np.array(4 * [10.0, 20.0]), 1e-8 * np.arange(6.0), np.array([0.0, 20.0, 40.0])]
)
def test_angles_at_too_few_places_give_no_pose(c_deg: np.ndarray) -> None:
    seen = Places(c_deg, project(RIG, c_deg), np.full(len(c_deg), 0.02), c_deg / 12.0)
    with pytest.raises(TautError, match="do not tell where the camera is"):
        hand_eye(seen, RIG.kinematics, RIG.camera, 0.1)


def test_a_marker_that_is_always_seen_at_one_place_gives_no_pose() -> None:
    seen = Places(ANGLES, np.full((9, 2), 300.0), np.full(9, 0.02), ANGLES / 12.0)
    with pytest.raises(TautError, match="do not tell where the camera is"):
        hand_eye(seen, RIG.kinematics, RIG.camera, 0.1)


def known_motion(folder: Path) -> None:
    motion, when = rests(RIG, 9)
    made = run(RIG, PLANT, motion, noise_px=0.05, seed=4)
    save(made.recording, folder)
    (folder / "rig.toml").unlink()
    rows = [f"{t_s:.2f},{np.interp(t_s + 0.5, made.t_s, made.c_deg):.4f}" for t_s in when]
    (folder / "angles.csv").write_text("t_s,c_deg\n" + "\n".join(rows) + "\n")


GIVEN = [
    "actuator.unit=mm", "actuator.range=-5, 5", "actuator.encoder_resolution=0.001",
    "kinematics.bending_length_mm=18", "kinematics.tip_length_mm=6", "camera.frame_rate_hz=25", "camera.delay_s=0.08",
]  # fmt: skip
INTRINSICS = [
    f"camera.{name}={','.join(str(v) for v in value) if isinstance(value, tuple) else value}"
    for name, value in asdict(RIG.camera).items()
    if name not in ("frame_rate_hz", "delay_s") and value is not None
]


def given(texts: list[str]) -> list[str]:
    return [part for text in texts for part in ("--set", text)]


def test_a_motion_makes_a_rig_that_calibrates_as_the_true_one(taut: Taut, tmp_path: Path) -> None:
    known_motion(tmp_path / "motion")
    out = tmp_path / "rig.toml"
    done = taut(
        "rig",
        "--out",
        out,
        "--motion",
        tmp_path / "motion",
        "--angle-sigma",
        "0.05",
        "--json",
        *given(GIVEN + INTRINSICS),
    )
    assert done.code == 0, done.err
    said = json.loads(done.out)
    assert said["hand_eye"]["places"] == 9 and said["hand_eye"]["strays"] < 2.0
    least_deg, most_deg = said["hand_eye"]["measured_angle_sigma_deg"]
    assert 0.0 < least_deg < most_deg
    assert (tmp_path / "rig.png").stat().st_size > 10_000
    made = Rig.load(out)
    assert made.coarse.gain * RIG.coarse.gain > 0  # the direction
    recording = simulate(RIG, PLANT, trajectory.back_and_forth(RIG.actuator, [0.5, 1.0], 1.6, 40, 4.0, 0.1), seed=7)
    errors = []
    for rig in (RIG, made):
        model = calibrate([recording], rig).model
        inside = (model.q > model.measured[0]) & (model.q < model.measured[1])
        errors.append(float(np.sqrt(np.mean((model.width - PLANT.backlash(model.q))[inside] ** 2))))
    assert errors[1] <= 1.3 * errors[0]


def test_what_is_not_known_is_named_as_it_would_be_given(taut: Taut, tmp_path: Path) -> None:
    done = taut("rig", "--out", tmp_path / "rig.toml", "--sensor", "angle", "--set", "actuator.unit=deg")
    assert done.code == 1 and not (tmp_path / "rig.toml").exists()
    assert "--set actuator.range=-5,5" in done.err and "camera" not in done.err
    answers = [part for part in done.err.split() if "=" in part]
    again = taut(
        "rig", "--out", tmp_path / "rig.toml", "--sensor", "angle", "--set", "actuator.unit=deg", *given(answers)
    )
    assert again.code == 0 and Rig.load(tmp_path / "rig.toml").angle is not None


def test_a_rig_that_is_there_is_kept(taut: Taut, tmp_path: Path) -> None:
    RIG.save(tmp_path / "rig.toml")
    done = taut("rig", "--out", tmp_path / "rig.toml")
    assert done.code == 1 and f"--from {tmp_path / 'rig.toml'}" in done.err
    done = taut("rig", "--out", tmp_path / "rig.toml", "--from", tmp_path / "rig.toml", "--set", "camera.delay_s=0.12")
    assert done.code == 0
    assert Rig.load(tmp_path / "rig.toml") == RIG.with_camera(delay_s=0.12)


def test_a_terminal_is_asked_key_by_key_until_the_answer_fits(taut: Taut, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    answers = iter(["mm", "5, -5, 1", "-5, 5", "0.001", "12", "0"])
    monkeypatch.setattr("click.prompt", lambda *args, **kwargs: next(answers))
    done = taut("rig", "--out", tmp_path / "rig.toml", "--sensor", "angle")
    assert done.code == 0 and Rig.load(tmp_path / "rig.toml").actuator.range == (-5.0, 5.0)
    assert "expected a list of 2 numbers" in done.err


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda rows: rows[:3], "4 are needed"),
        (lambda rows: [*rows[:-1], "900,20"], "outside of the motor's log"),
        (lambda rows: ["0.3,-50", *rows[1:]], "the motor moves"),
        (lambda rows: [*rows[:-1], rows[-1].split(",")[0] + ",much"], "expected a number"),
    ],
)
def test_angles_that_cannot_be_are_one_line(taut: Taut, tmp_path: Path, change, says) -> None:
    known_motion(tmp_path / "motion")
    file = tmp_path / "motion" / "angles.csv"
    head, *rows = file.read_text().split()
    file.write_text("\n".join([head, *change(rows)]) + "\n")
    done = taut("rig", "--out", tmp_path / "rig.toml", "--motion", tmp_path / "motion", *given(GIVEN + INTRINSICS))
    assert done.code == 1 and says in done.err and len(done.err.strip().splitlines()) == 1
    assert not (tmp_path / "rig.toml").exists()


@pytest.mark.parametrize(
    ("given_alone", "says"), [(["--angles", "a.csv"], "--motion"), (["--squares", "8x6"], "--board")]
)
def test_what_says_nothing_by_itself_is_refused(taut: Taut, tmp_path: Path, given_alone, says) -> None:
    done = taut("rig", "--out", tmp_path / "rig.toml", *given_alone)
    assert done.code == 2 and says in done.err
    assert not (tmp_path / "rig.toml").exists()


def test_angles_with_the_wrong_sign_are_doubted(taut: Taut, tmp_path: Path) -> None:
    known_motion(tmp_path / "motion")
    file = tmp_path / "motion" / "angles.csv"
    head, *rows = file.read_text().split()
    rows[2] = rows[2].replace(",-", ",")
    file.write_text("\n".join([head, *rows]) + "\n")
    done = taut("rig", "--out", tmp_path / "rig.toml", "--motion", tmp_path / "motion", *given(GIVEN + INTRINSICS))
    assert done.code == 0 and "the angles' signs" in done.err


def test_a_board_on_the_command_line(taut: Taut, tmp_path: Path, board_pictures) -> None:
    files = []
    for k, picture in enumerate(board_pictures[:6]):
        files.append(tmp_path / f"{k}.png")
        cv2.imwrite(str(files[-1]), picture)
    board = [part for file in files for part in ("--board", file)]
    print_ = ["--squares", "8x6", "--square-mm", "4", "--marker-mm", "3"]
    rest = [
        *GIVEN,
        "coarse.gain=12",
        "coarse.offset=0",
        "hand_eye.rotation_deg=4,-3,2",
        "hand_eye.translation_mm=-4,5,14",
    ]
    done = taut("rig", "--out", tmp_path / "rig.toml", *board, *print_, *given(rest))
    assert done.code == 0, done.err
    assert abs(Rig.load(tmp_path / "rig.toml").camera.fx_px / LENS.fx_px - 1.0) < 0.02
    wrong = ["--squares", "11x8", *print_[2:], "--dictionary", "6X6_250"]
    done = taut("rig", "--out", tmp_path / "other.toml", *board, *wrong, *given(rest))
    assert done.code == 1 and "0 of 6 pictures show a ChArUco board" in done.err


def test_every_key_is_read_as_it_is_typed():
    document = {"format": "rig/1"}
    for text in (*GIVEN, *INTRINSICS):
        name, _, value = text.partition("=")
        rig_keys.put(document, *rig_keys.find_key(name), value)
    assert document["actuator"] == {"unit": "mm", "range": [-5.0, 5.0], "encoder_resolution": 0.001}
    with pytest.raises(TautError, match=r"coarse\.gain is '9+', expected"):
        rig_keys.put(document, *rig_keys.find_key("coarse.gain"), 5000 * "9")
    asked = {key: value for key, value in asdict(RIG.camera).items() if value is not None}
    assert {**document["camera"], "distortion": tuple(document["camera"]["distortion"])} == asked


def test_an_angle_sensors_rig_goes_on_as_one(taut: Taut, tmp_path: Path) -> None:
    first = tmp_path / "a.toml"
    keys = ["actuator.unit=deg", "actuator.range=-5,5", "actuator.encoder_resolution=0.01"]
    keys += ["coarse.gain=1", "coarse.offset=0"]
    assert taut("rig", "--out", first, "--sensor", "angle", *given(keys)).code == 0
    done = taut("rig", "--from", first, "--out", tmp_path / "b.toml", "--set", "angle.delay_s=0.01")
    assert done.code == 0 and Rig.load(tmp_path / "b.toml").angle.delay_s == 0.01
    done = taut("rig", "--out", tmp_path / "c.toml", "--sensor", "angle", "--motion", tmp_path)
    assert done.code == 2 and "leave --sensor angle out" in done.err
