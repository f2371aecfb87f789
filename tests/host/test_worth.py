"""A model that predicts worse than f_coarse or a constant is never good."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tautline.calibration.calibrate import calibrate
from tautline.calibration.observations import observe
from tautline.calibration.worth import worth
from tautline.quality import Quality, Verdict
from tautline.recording import Recording
from tautline.simulated.instrument import preset, reference_rig
from tautline.simulated.simulate import run
from tautline.trajectory import back_and_forth

RIG = reference_rig()


@pytest.fixture(scope="module")
def made() -> Recording:
    path = back_and_forth(RIG.actuator, [1.2], 1.6, 16, 5.0, 0.1)
    return run(RIG, preset("random", RIG, 3), path, seed=72).recording


def quality(recording: Recording, rig=RIG) -> Quality:
    return calibrate([recording], rig).model.quality


def turned(degrees: float):
    away = tuple(np.array(RIG.hand_eye.rotation_deg) + degrees * np.array([1.0, -1.0, 1.0]) / np.sqrt(3))
    return replace(RIG, hand_eye=replace(RIG.hand_eye, rotation_deg=away))


def test_a_right_model_is_measured_against_the_two_simplest(made: Recording) -> None:
    found = calibrate([made], RIG)
    right = worth(found.model, observe([made], RIG), None, None)
    assert right is not None
    assert right.model == pytest.approx(0.05, rel=0.1) and right.predicts and not right.doubts
    assert right.coarse > 50 * right.model and right.constant > 5 * right.coarse
    worse = replace(found.model, c_deg=found.model.c_deg[::-1].copy())
    told = worth(worse, observe([made], RIG), None, None)
    assert told is not None and not told.predicts and told.doubts[0].fatal


def test_a_model_no_better_than_a_constant_is_unusable(made: Recording) -> None:
    found = quality(made, turned(45.0))
    assert found.verdict is Verdict.UNUSABLE and "predicts" in {r.code for r in found.reasons}


def test_a_registration_that_is_a_little_off_is_doubtful(made: Recording) -> None:
    found = quality(made, turned(5.0))
    assert found.verdict is Verdict.DOUBTFUL
    assert [r.code for r in found.reasons] == ["registration.static"]


def test_a_mirrored_image_bends_f_remain_beyond_belief(made: Recording) -> None:
    mirrored = replace(made, marker=replace(made.marker, u_px=719.0 - made.marker.u_px))
    found = quality(mirrored)
    assert found.verdict is Verdict.UNUSABLE
    assert next(r for r in found.reasons if r.code == "registration.static").fatal
