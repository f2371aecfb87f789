"""A marker seen by a camera of the user's MJCF: the angle of the hinge that moves its site."""

import json
from dataclasses import replace

import arms
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tautline.errors import TautError
from tautline.recording import Marker
from tautline.simulators import mjcf
from tautline.simulators.sight import sight

pytest.importorskip("mujoco")

WIDTH, HEIGHT, FOVY, AWAY_M, REACH_M = 640, 480, 40.0, 0.6, 0.2
AXES = 'xyaxes="1 0 0 0 0 1"'
CAMERA = f'<camera name="side" pos="0 -{AWAY_M} -0.1" {AXES} fovy="{FOVY}" resolution="{WIDTH} {HEIGHT}"/>'
NOISE_PX = 0.05


def write(path, camera=CAMERA):
    path.write_text(arms.write(path).read_text().replace("<worldbody>", f"<worldbody>{camera}"))
    return path


def place(c_deg):
    """(n, 2) px: a pinhole across the hinge's plane; the arm hangs at 0 and turns about y, a tenth of a metre below the
    hinge the camera looks at."""
    c = np.radians(np.asarray(c_deg, dtype=float))
    focal = 0.5 * HEIGHT / np.tan(0.5 * np.radians(FOVY))
    x, z = -REACH_M * np.sin(c), -REACH_M * np.cos(c) + 0.1
    return np.column_stack([0.5 * WIDTH - 0.5 + focal * x / AWAY_M, 0.5 * HEIGHT - 0.5 - focal * z / AWAY_M])


def marker(px, valid=None):
    return Marker(np.arange(len(px)) * 0.02, *px.T, np.ones(len(px), dtype=bool) if valid is None else valid)


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    return sight(write(tmp_path_factory.mktemp("sight") / "arm.xml"), "tip", "side")


@settings(max_examples=20, deadline=None)
@given(c_deg=st.lists(st.floats(-150.0, 150.0), min_size=1, max_size=5))
def test_the_hinges_angle_is_read_from_where_the_camera_sees_the_site(seen, c_deg):
    angle, off = seen.angle(marker(place(c_deg)))
    assert seen.hinge == "elbow"
    np.testing.assert_allclose(angle, c_deg, atol=2e-3)  # the track's straight lines
    assert off.max() < 1e-2


def test_what_is_off_the_track_is_no_reading(seen, tmp_path):
    robot = arms.robot(tmp_path, 3, 2.0)
    px = place(np.linspace(-20.0, 20.0, 50))
    px[10] += 100.0
    valid = np.ones(50, dtype=bool)
    valid[20] = False
    read = seen.to_angle(replace(robot, marker=marker(px, valid), angle=None))
    assert read.marker is None and read.angle.seen.sum() == 48 and not read.angle.seen[[10, 20]].any()
    with pytest.raises(TautError, match="px off the track"):
        seen.to_angle(replace(robot, marker=marker(px + 150.0), angle=None))
    with pytest.raises(TautError, match=r"has no marker\.csv"):
        seen.to_angle(robot)


def test_what_is_wrong_is_said_with_what_to_do(tmp_path):
    arm = write(tmp_path / "arm.xml")
    with pytest.raises(TautError, match="has no camera front, but side"):
        sight(arm, "tip", "front")
    with pytest.raises(TautError, match="has no site end, but tip"):
        sight(arm, "end", "side")
    with pytest.raises(TautError, match="needs the resolution"):
        sight(write(tmp_path / "small.xml", CAMERA.replace(f'resolution="{WIDTH} {HEIGHT}"', "")), "tip", "side")
    with pytest.raises(TautError, match="does not see the site"):
        sight(write(tmp_path / "away.xml", CAMERA.replace(AXES, 'xyaxes="-1 0 0 0 0 1"')), "tip", "side")


def test_a_diagnosis_by_command_compares_pixels_of_the_files_camera(tmp_path, taut):
    """Simulated truth: half of the servo's gain, seen by the camera with noise."""
    robot = arms.robot(tmp_path, 3, 8.0, kp=1.5)
    arm = write(tmp_path / "arm.xml")
    into = tmp_path / "robot"
    into.mkdir()
    truth = mjcf.simulator(arms.write(tmp_path / "truth.xml", kp=1.5), "servo", "joint:elbow").tip(robot.motor, {})
    seen_s = robot.angle.t_s
    px = place(np.interp(seen_s, robot.motor.t_s, truth))
    px += np.random.default_rng(1).normal(0.0, NOISE_PX, px.shape)
    for name, columns, values in (
        ("motor.csv", "t_s,q_deg", (robot.motor.t_s, robot.motor.q)),
        ("marker.csv", "t_s,u_px,v_px,valid", (seen_s, *px.T, np.ones(len(px)))),
    ):
        np.savetxt(into / name, np.column_stack(values), delimiter=",", header=columns, comments="", fmt="%.9g")
    arms.rig(tmp_path)
    words = ("diagnose", "--simulator", arm, "--actuator", "servo")
    where = (into, "--rig", tmp_path / "rig.toml", "--out", tmp_path / "out")
    done = taut(*words, "--tip", "site:tip", "--camera", "side", *where, "--json")
    assert done.code == 0, done.err
    document = json.loads(done.out)
    assert document["effects"][0]["id"] == "simulator.servo.kp" and document["unit"] == "deg"
    told = {each["name"]: each["value"] for each in document["simulator"]["parameters"]}
    assert told["servo.kp"] == pytest.approx(1.5, rel=0.02)
    assert taut(*words, "--tip", "joint:elbow", "--camera", "side", *where).code == 2


def test_a_camera_that_sees_the_circle_from_its_edge_is_refused(tmp_path):
    """Angles to either side of it would be seen at one place."""
    edge = CAMERA.replace(f'pos="0 -{AWAY_M} -0.1" {AXES}', f'pos="{AWAY_M} 0 -0.1" xyaxes="0 1 0 0 0 1"')
    with pytest.raises(TautError, match="at one place for different angles"):
        sight(write(tmp_path / "arm.xml", edge), "tip", "side")


def test_a_track_that_passes_the_camera_s_plane_still_refuses_what_lies_off_it(tmp_path):
    beside = CAMERA.replace(f'pos="0 -{AWAY_M} -0.1" {AXES}', 'pos="0.09 -0.1 -0.1" xyaxes="0.7071 -0.7071 0 0 0 1"')
    near = sight(write(tmp_path / "arm.xml", beside), "tip", "side")
    robot = arms.robot(tmp_path, 3, 2.0)
    far = near.px[len(near.px) // 2] + [0.0, 0.5 * HEIGHT]
    with pytest.raises(TautError, match="px off the track"):
        near.to_angle(replace(robot, marker=marker(np.tile(far, (50, 1)))))


def test_where_a_track_leaves_the_image_it_has_no_line(tmp_path):
    """The camera sits on the hinge's axis: the site goes out to one side and comes back from the other."""
    (tmp_path / "inside.xml").write_text("""<mujoco><worldbody>
      <camera name="side" xyaxes="0 -1 0 0 0 1" resolution="640 480" fovy="60"/>
      <body><joint name="elbow" type="hinge" axis="0 0 1" range="5 355"/><geom size="0.01" pos="0.2 0 0"/>
      <site name="tip" pos="0.2 0 0"/></body></worldbody></mujoco>""")
    track = sight(tmp_path / "inside.xml", "tip", "side")
    angle, _ = track.angle(marker(track.px))
    np.testing.assert_allclose(angle, track.c_deg, atol=1e-6)


def test_frames_are_as_old_as_the_rig_says(seen, tmp_path):
    robot = replace(arms.robot(tmp_path, 3, 2.0), marker=marker(place(np.linspace(-20.0, 20.0, 50))))
    assert np.array_equal(seen.to_angle(robot, 0.08).angle.t_s, robot.marker.t_s - 0.08)
