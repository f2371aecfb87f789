"""Projection against OpenCV and finite differences; the pose undoes it."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tautline.geometry import pose, project, project_with_slope, tip_bend
from tautline.rig import Actuator, Camera, Coarse, HandEye, Kinematics, Rig

RIG = Rig(
    Actuator("mm", (-5.0, 5.0), 0.001),
    Coarse(12.0, 0.0),
    Kinematics(18.0, 6.0),
    Camera(720, 576, 520.0, 515.0, 360.0, 288.0, (-0.2, 0.05, 0.001, -0.002, 0.01), 25.0, 0.08),
    HandEye((4.0, -3.0, 2.0), (-4.0, 5.0, 14.0)),
)
angle = st.floats(-75, 75)
slide = st.floats(-5, 10)
turn = st.floats(-90, 90)


def test_a_quarter_circle_by_hand():
    point = tip_bend(Kinematics(np.pi, 1.0), [90.0, 0.0, -90.0])
    assert point == pytest.approx(np.array([[3, 0, 2], [0, 0, np.pi + 1], [-3, 0, 2]]))


@given(angle, slide, turn)
def test_the_projection_is_opencvs(c, z, rz):
    r = np.radians([*RIG.hand_eye.rotation_deg, rz])
    rx, ry, rh, rb = (cv2.Rodrigues(a * np.eye(3)[i])[0] for a, i in zip(r, (0, 1, 2, 2), strict=True))
    bend = tip_bend(RIG.kinematics, c)
    base = rb @ (bend[0] + [0, 0, z])
    expected, _ = cv2.projectPoints(
        base[None],
        cv2.Rodrigues(rh @ ry @ rx)[0],
        np.array(RIG.hand_eye.translation_mm),
        RIG.camera.matrix,
        np.array(RIG.camera.distortion),
    )
    assert project(RIG, c, z, rz)[0] == pytest.approx(expected.ravel(), abs=1e-6)


@given(st.one_of(angle, st.floats(-0.2, 0.2)), slide, turn)
def test_the_jacobian_is_the_projections_slope(c, z, rz):
    h = 1e-4
    expected = (project(RIG, c + h, z, rz) - project(RIG, c - h, z, rz)) / (2 * h)
    assert project_with_slope(RIG, c, z, rz)[1] == pytest.approx(expected, abs=1e-5)


@given(st.lists(angle, min_size=1, max_size=20), slide)
def test_the_pose_undoes_the_projection(c, z):
    found, left = pose(RIG, project(RIG, c, z), z)
    assert found == pytest.approx(np.array(c), abs=1e-5)
    assert left == pytest.approx(0, abs=1e-5)


def test_a_frame_without_a_marker_has_no_pose():
    image = np.vstack([project(RIG, 10.0), [[np.nan, np.nan]]])
    found, left = pose(RIG, image)
    assert found[0] == pytest.approx(10.0)
    assert np.isnan(found[1]) and np.isnan(left[1])


def test_behind_the_camera_is_nan():
    assert np.isnan(project(RIG, 0.0, translation_mm=-100.0)).all()
