"""A place on a bare instrument's tip: where it is seen, what its path tells of angles, and how far that may be off."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline
from slices import some

from tautline import geometry, trajectory
from tautline.calibration.calibrate import calibrate
from tautline.calibration.observations import observe
from tautline.calibration.result import Calibration
from tautline.errors import TautError
from tautline.model import Model
from tautline.prediction import predict_with_sigma, settled_from
from tautline.quality import Verdict
from tautline.recording import Recording, Shown
from tautline.rig import PLACES, Kinematics, Place
from tautline.simulated import simulate
from tautline.simulated.instrument import preset, reference_rig

RIG = reference_rig()
assert RIG.kinematics is not None and RIG.camera is not None and RIG.hand_eye is not None
INSTRUMENT = preset("reference", RIG)
NOISE_PX = 0.03
SIDE_PX = 30.0


def seen_beside(c_deg: np.ndarray, beside: np.ndarray, slide_mm: float = 0.0, turn_deg: float = 0.0) -> np.ndarray:
    """Where places (3, n) mm beside the tip's end are seen, (n, 2) px, by OpenCV alone: the end of the tip, moved along
    the tip's own directions, then as the other axes move it."""
    image = []
    about_z = cv2.Rodrigues(np.array([0.0, 0.0, np.radians(turn_deg)]))[0]
    for c, (aside, out, ahead) in zip(c_deg, beside.T, strict=True):
        end, further = (
            geometry.tip_bend(replace(RIG.kinematics, tip_length_mm=RIG.kinematics.tip_length_mm + more), [c])[0]
            for more in (0.0, 1.0)
        )
        along = further - end
        point = end + ahead * along + aside * np.cross([0.0, 1.0, 0.0], along) + [0.0, out, 0.0]
        point = about_z @ point + [0.0, 0.0, slide_mm]
        turn = cv2.Rodrigues(geometry.rotation(RIG.hand_eye.rotation_deg))[0]
        shown, _ = cv2.projectPoints(
            point[None], turn, np.array(RIG.hand_eye.translation_mm), RIG.camera.matrix, np.array(RIG.camera.distortion)
        )
        image.append(shown.ravel())
    return np.array(image)


def a_place(seed: int) -> Place:
    mm = np.random.default_rng(seed).normal(0.0, 0.8, (3, PLACES))
    return Place(-40.0, 5.0, tuple(map(tuple, mm.tolist())), (2.0,) * PLACES)


def between(place: Place, c_deg: np.ndarray) -> np.ndarray:
    """(3, n) mm by scipy's Hermite spline with half the distance of the neighbours as slopes, held beyond."""
    at, mm = place.from_deg + place.step_deg * np.arange(PLACES), np.array(place.mm)
    slopes = np.gradient(mm, place.step_deg, axis=1)
    return CubicHermiteSpline(at, mm, slopes, axis=1)(np.clip(c_deg, at[0], at[-1]))


@given(st.integers(0, 2**32 - 1))
def test_a_place_is_seen_where_it_lies(seed: int) -> None:
    c, place = np.random.default_rng(seed).uniform(-50.0, 50.0, 12), a_place(seed)
    for slide, turn in ((0.0, 0.0), (1.7, -35.0)):
        image = geometry.project(replace(RIG, place=place), c, slide, turn)
        np.testing.assert_allclose(image, seen_beside(c, between(place, c), slide, turn), atol=1e-6)


@given(st.integers(0, 2**32 - 1))
def test_its_slope_is_the_images_with_the_other_axes_too(seed: int) -> None:
    rng = np.random.default_rng(seed)
    c, slide, turn = rng.uniform(-39.0, 39.0, 12), rng.uniform(-3.0, 3.0, 12), rng.uniform(-60.0, 60.0, 12)
    rig, step = replace(RIG, place=a_place(seed)), 1e-4
    image, slope = geometry.project_with_slope(rig, c, slide, turn)
    high, low = (geometry.project(rig, c + off, slide, turn) for off in (step, -step))
    np.testing.assert_allclose(slope, (high - low) / (2 * step), atol=2e-3)
    assert np.isfinite(image).all()


def bare(seed: int, off_mm: np.ndarray, roams_mm: float = 0.15) -> tuple[Recording, np.ndarray]:
    """A recording whose marker is a place on the surface, and its scene times. The place is off_mm from where it faces
    the camera in the first picture, and goes on by roams_mm over the surface as the tip bends."""
    shares = np.random.default_rng(seed).uniform(0.6, 1.6, 3)
    motion = trajectory.back_and_forth(RIG.actuator, list(shares), 2.0, 10, 8.0, 0.3)
    made = simulate.run(RIG, INSTRUMENT, motion, seed=seed)
    marker = made.recording.marker
    assert marker is not None
    c = np.interp(made.scene_s, made.t_s, made.c_deg)
    beside = 0.9 * towards_camera(c[0]) + off_mm
    over = roams_mm * np.array([np.sin(c / 17.0), np.cos(c / 23.0), np.sin(c / 19.0 + 1.0)])
    noise = NOISE_PX * np.random.default_rng([seed, 1]).standard_normal((len(c), 2))
    seen = seen_beside(c, beside[:, None] + over) + noise
    shown = Shown((float(seen[0, 0]), float(seen[0, 1])), SIDE_PX)
    marker = replace(marker, u_px=seen[:, 0], v_px=seen[:, 1], sigma_px=np.full(len(c), NOISE_PX), shown=shown)
    return replace(made.recording, marker=marker, rig=RIG), made.scene_s


def towards_camera(c_deg: float) -> np.ndarray:
    """Across the tip, in its frame (3,)."""
    end, ahead = (
        geometry.tip_bend(Kinematics(RIG.kinematics.bending_length_mm, length), [c_deg])[0]
        for length in (RIG.kinematics.tip_length_mm, RIG.kinematics.tip_length_mm + 1.0)
    )
    turn = geometry.rotation(RIG.hand_eye.rotation_deg)
    view = -(end + turn.T @ np.array(RIG.hand_eye.translation_mm))
    along = ahead - end
    across = np.array([view @ np.cross([0.0, 1.0, 0.0], along), view[1], 0.0])
    return across / np.linalg.norm(across)


@pytest.fixture(scope="module")
def calibrated() -> list[tuple[Calibration, np.ndarray]]:
    """With the true f_remain on the model's grid."""
    found = []
    for seed in range(3):
        off = np.random.default_rng([seed, 2]).normal(0.0, 0.3, 3)
        recording, _ = bare(seed, off)
        calibration = calibrate([recording], RIG)
        found.append((calibration, INSTRUMENT.bend(calibration.model.q)))
    return found


def test_a_bare_calibration_is_good_and_knows_what_it_does_not(
    calibrated: list[tuple[Calibration, np.ndarray]],
) -> None:
    z2 = []
    for calibration, truth in calibrated:
        model = calibration.model
        inside = (model.q > model.measured[0]) & (model.q < model.measured[1])
        assert model.quality.verdict is Verdict.GOOD, model.quality
        assert [reason.code for reason in model.quality.reasons] == ["place"]
        assert calibration.evidence["residual"] < 1.3 * NOISE_PX  # a prediction's, as formats ask of a good one
        width = (model.width - INSTRUMENT.backlash(model.q))[inside]
        assert np.sqrt(np.mean(width**2)) < 0.003
        assert model.c_sigma is not None
        assert 0.5 < np.median(model.c_sigma[inside]) < 6.0
        z2.append(np.mean(((model.c_deg - truth) / model.c_sigma)[inside] ** 2))
    assert np.mean(z2) < 1.9**2  # one number a calibration: within 95 % of three normal ones, rms


def test_its_image_is_foretold_to_the_noise_though_its_angles_are_not(
    calibrated: list[tuple[Calibration, np.ndarray]],
) -> None:
    recording, scene = bare(7, np.random.default_rng([0, 2]).normal(0.0, 0.3, 3))
    model = calibrated[0][0].model
    told = predict_with_sigma(model, recording.motor, scene)
    marker = recording.marker
    assert marker is not None and told.image_px is not None and told.image_sigma_px is not None
    counted = (scene > settled_from(model, recording.motor)) & (np.abs(told.c_deg) < 40.0)
    off = np.column_stack([marker.u_px, marker.v_px])[counted] - told.image_px[counted]
    assert np.sqrt(np.mean(off**2)) < 2.0 * NOISE_PX
    assert np.median(told.image_sigma_px[counted]) < 3.0 * NOISE_PX
    assert told.c_sigma_deg is not None and model.rig.place is not None
    assert (told.c_sigma_deg >= model.rig.place.sigma_at(told.c_deg)).all()


def test_a_large_square_tells_no_angles() -> None:
    """Four times as wide: the place is anywhere on the tip."""
    recording, _ = bare(0, np.zeros(3))
    assert recording.marker is not None and recording.marker.shown is not None
    wide = Shown(recording.marker.shown.at_px, 8.0 * SIDE_PX)
    calibration = calibrate([replace(recording, marker=replace(recording.marker, shown=wide))], RIG)
    reasons = [reason for reason in calibration.model.quality.reasons if reason.code == "place"]
    assert calibration.model.quality.verdict is Verdict.DOUBTFUL
    assert len(reasons) == 1 and reasons[0].says.startswith("f_remain is not known from this, B is")
    inside = np.abs(calibration.model.q) < 3.0
    width = (calibration.model.width - INSTRUMENT.backlash(calibration.model.q))[inside]
    assert np.sqrt(np.mean(width**2)) < 0.003


def test_recordings_that_show_two_places_do_not_tell_f_remain() -> None:
    """Their places differ by a hand's trembling: neither is known, and B is."""
    (first, _), (second, _) = (bare(seed, np.zeros(3)) for seed in (0, 1))
    assert first.marker is not None and second.marker is not None and second.marker.shown is not None
    (u, v), side = second.marker.shown.at_px, second.marker.shown.side_px
    other = replace(second, marker=replace(second.marker, shown=Shown((u + 3.0, v), side)))
    model = calibrate([first, other], RIG, naming=False).model
    (doubt,) = [reason for reason in model.quality.reasons if reason.code == "place"]
    assert not doubt.mild and model.quality.verdict is Verdict.DOUBTFUL
    inside = (model.q > model.measured[0]) & (model.q < model.measured[1])
    off = np.abs(model.width - INSTRUMENT.backlash(model.q))[inside]
    assert (off < 4.0 * model.width_sigma[inside] + 1e-3).all()


def breath(scene_s: np.ndarray, px: float) -> np.ndarray:
    """(n, 2) px by which tissue pulls a place: two rates, not alike from one breath to the next."""
    deep = 1.0 + 0.3 * np.sin(0.31 * scene_s)
    aside = np.column_stack([np.sin(1.7 * scene_s), 0.6 * np.sin(1.7 * scene_s + 0.8) + 0.3 * np.sin(2.9 * scene_s)])
    return px * deep[:, None] * aside


def swaying(seed: int, px: float, torn: bool, noise_px: float = NOISE_PX) -> tuple[Recording, np.ndarray]:
    recording, scene = bare(seed, np.zeros(3))
    marker = recording.marker
    assert marker is not None
    seen = np.column_stack([marker.u_px, marker.v_px])
    if torn:
        seen = seen[0] + noise_px * np.random.default_rng([seed, 3]).standard_normal(seen.shape)
    seen = seen + breath(scene, px)
    told = np.full(len(seen), noise_px)
    return replace(recording, marker=replace(marker, u_px=seen[:, 0], v_px=seen[:, 1], sigma_px=told)), scene


@pytest.mark.parametrize(("px", "noise_px"), some([(0.1, NOISE_PX), (6.0, 0.5), (2.0, NOISE_PX)], 2))
def test_no_onset_is_invented_where_a_torn_tip_sways(px: float, noise_px: float) -> None:
    recording, _ = swaying(4, px, torn=True, noise_px=noise_px)
    (track,) = observe([recording], RIG)
    assert np.ptp(track.y, axis=0).max() < noise_px  # else noise after one of hundreds of turns looks like a motion
    calibration = calibrate([recording], RIG)
    assert not [o for o in calibration.onsets if o.used and o.kind != "bound"]
    assert calibration.model.quality.verdict is Verdict.UNUSABLE
    assert any("never seen to move" in reason.says for reason in calibration.model.quality.reasons)


def test_a_tip_that_moves_keeps_every_frame_as_it_is_though_it_sways() -> None:
    """A motion of a pixel is more likely the motor's than a breath's: nothing is taken off."""
    recording, scene = swaying(4, 0.1, torn=False)
    marker = recording.marker
    assert marker is not None
    for share in (1.0, 0.005):  # of what the rig foretells
        seen = np.column_stack([marker.u_px, marker.v_px]) - breath(scene, 0.1)
        seen = seen[0] + share * (seen - seen[0]) + breath(scene, 0.1)
        less = replace(recording, marker=replace(marker, u_px=seen[:, 0], v_px=seen[:, 1]))
        (track,) = observe([less], RIG)
        (paint,) = observe([replace(less, marker=replace(less.marker, shown=None))], RIG)
        np.testing.assert_allclose(track.y, paint.y, atol=1e-6)


def test_a_model_keeps_its_place(calibrated: list[tuple[Calibration, np.ndarray]], tmp_path: Path) -> None:
    model = calibrated[0][0].model
    model.save(tmp_path / "model")
    again = Model.load(tmp_path / "model")
    assert again.rig.place == model.rig.place is not None
    path = tmp_path / "model" / "model.json"
    path.write_text(path.read_text().replace('"sigma_deg": [', '"sigma_deg": [1.0, ', 1))
    with pytest.raises(TautError, match="a place is told at 65 angles"):
        Model.load(tmp_path / "model")
