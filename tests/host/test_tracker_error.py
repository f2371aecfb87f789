"""What the tracker of a video errs by at each place is the calibration's to say, and no effect."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from slices import some

from tautline import effects, trajectory
from tautline.diagnosis import narration, tracker
from tautline.diagnosis.diagnose import diagnose
from tautline.diagnosis.segment import prepare
from tautline.geometry import project
from tautline.model import Model
from tautline.recording import Marker, Recording, Video
from tautline.simulated import simulate
from tautline.simulated.instrument import preset, reference_rig

RIG, NOISE, DELAY_S = reference_rig(), 0.05, 0.08
GRID = np.linspace(-5.0, 5.0, 401)
GLARE_DEG = (8.0, 12.0)  # where light throws the marker off


def model() -> Model:
    instrument = preset("reference", RIG)
    return Model(RIG, GRID, instrument.backlash(GRID), np.full(401, 0.003), instrument.bend(GRID), DELAY_S, (-4.0, 4.0))


def across(c_deg: np.ndarray) -> np.ndarray:
    """(n, 2) a unit vector across the marker's path."""
    step = project(RIG, c_deg + 0.01) - project(RIG, c_deg - 0.01)
    step /= np.linalg.norm(step, axis=1)[:, None]
    return np.column_stack([-step[:, 1], step[:, 0]])


def shading(c_deg: np.ndarray) -> np.ndarray:
    """px across the path."""
    return 0.15 + 0.12 * np.sin(c_deg / 7.0)


def recordings(error=shading, glare_px: float = 0.0, effect=None) -> list[Recording]:
    """A calibration and two tests, as if from videos."""
    rng = np.random.default_rng(5)
    motions = [
        trajectory.back_and_forth(RIG.actuator, [0.8], 2.0, 12, 6.0),
        trajectory.trapezoids(RIG.actuator, 0.9, 2.6, 5, 8.0, 0.8),
        trajectory.sines(RIG.actuator, 1.5, 30.0),
    ]
    made, clock = [], 0.0
    for i, motion in enumerate(motions):
        recording = simulate.simulate(RIG, preset("reference", RIG), motion, seed=5 + i)
        t = recording.marker.t_s
        values = effect if effect and i else {}
        path = effects.simulate(model(), recording.motor, t - DELAY_S, values, clock_offset_s=clock)
        c = path.c_deg
        thrown = np.where((c > GLARE_DEG[0]) & (c < GLARE_DEG[1]), glare_px, 0.0)
        seen = path.image_px + (error(c) + thrown)[:, None] * across(c) + rng.normal(0.0, NOISE, (len(t), 2))
        marker = Marker(t, seen[:, 0], seen[:, 1], np.ones(len(t), bool))
        made.append(replace(recording, marker=marker, rig=RIG, video=Video(Path("video.mkv"), None)))
        clock += recording.motor.t_s[-1]
    return made


def segments(made: list[Recording]):
    return prepare(model(), made[0], made[1:])


def test_what_goes_with_the_place_is_taken_off_across_the_path_alone() -> None:
    before = segments(recordings())
    found = tracker.without_tracker_error(model(), before, 0.0)
    assert found is not None
    assert found.noise == pytest.approx(NOISE, rel=0.1) and found.left_out < 0.05
    for old, new in zip(before, found.segments, strict=True):
        c = old.predict(model(), {}, 0.0)[0].c_deg
        gone = (old.observed - new.observed)[new.scored]
        side = across(c)[new.scored]
        along = np.column_stack([side[:, 1], -side[:, 0]])
        assert np.abs(np.sum(gone * along, axis=1)).max() < 0.005  # the path's own bend between neighbours
        wrong = np.sum(gone * side, axis=1) - shading(c[new.scored])
        assert np.sqrt(np.mean(wrong**2)) < 0.2 * np.sqrt(np.mean(shading(c) ** 2))


def test_where_the_calibration_does_not_hold_no_recording_is_scored() -> None:
    before = segments(recordings(glare_px=3.0))
    found = tracker.without_tracker_error(model(), before, 0.0)
    assert found is not None
    assert found.noise == pytest.approx(NOISE, rel=0.1)
    for old, new in zip(before, found.segments, strict=True):
        c = old.predict(model(), {}, 0.0)[0].c_deg
        inside = old.scored & (c > GLARE_DEG[0]) & (c < GLARE_DEG[1])
        far = old.scored & ((c < GLARE_DEG[0] - 3.0) | (c > GLARE_DEG[1] + 3.0))
        assert inside.any() and not new.scored[inside].any()
        assert new.scored[far].mean() > 0.97


def test_other_axes_move_the_path_and_nothing_is_said() -> None:
    made = recordings()
    moved = replace(made[1].motor, translation_mm=np.linspace(0.0, 2.0, len(made[1].motor.t_s)))
    made[1] = replace(made[1], motor=moved)
    assert tracker.without_tracker_error(model(), segments(made), 0.0) is None


def test_a_tracker_that_errs_by_the_place_is_no_effect() -> None:
    made = recordings()
    document = diagnose(model(), made[0], made[1:]).document
    assert document["verdict"] == "none" and "left out" not in narration.text(document, "there")
    assert document["noise_floor"] == pytest.approx(NOISE, rel=0.1)
    others = [replace(recording, video=None) for recording in made]  # another's positions may err by no tracker
    left = diagnose(model(), others[0], others[1:]).document  # as much as in the calibration, and told as a gap
    assert left["gap"]["before"] > 1.2 * document["gap"]["before"]
    # An image that errs by the place from the start on is one through another lens: none, or that.
    assert {effect["id"] for effect in left["effects"]} <= {"camera.distortion"} and left["verdict"] != "unknown"


def test_beside_such_a_tracker_an_effect_has_its_name() -> None:
    made = recordings(glare_px=3.0, effect={"lag": 0.05})
    document = diagnose(model(), made[0], made[1:]).document
    assert [effect["id"] for effect in document["effects"]] == ["transmission.lag"]
    assert 0.05 < document["tracker"]["left_out"] < 0.3 and "left out" in narration.text(document, "there")


@pytest.mark.parametrize(("effect", "id"), some([("delay", "acquisition.delay"), ("lag", "transmission.lag")], 1))
def test_a_lag_of_less_than_a_frame_is_told_from_a_delay(effect, id) -> None:
    """They differ only in the frame after a turn."""
    made = recordings(effect={effect: 0.03})
    document = diagnose(model(), made[0], made[1:]).document
    assert document["effects"][0]["id"] == id


def test_a_calibration_that_rests_for_long_before_it_moves_is_no_less() -> None:
    """All that counts is then in one of the parts that foretell each other."""
    calibration, *tests = segments(recordings())
    n = len(calibration.scored)
    rest_s = np.linspace(calibration.arrival_s[0] - 1.0, calibration.arrival_s[0] - 1e-3, 9 * n)
    waited = replace(
        calibration,
        arrival_s=np.concatenate([rest_s, calibration.arrival_s]),
        observed=np.concatenate([np.repeat(calibration.observed[:1], 9 * n, axis=0), calibration.observed]),
        scored=np.concatenate([np.zeros(9 * n, dtype=bool), calibration.scored]),
        repeats=None,
    )
    found = tracker.without_tracker_error(model(), [waited, *tests], 0.0)
    assert found is not None and found.noise == pytest.approx(NOISE, rel=0.1)
