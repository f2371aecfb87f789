"""Samples that are repeated: seen as such, left out, and named where they are the gap."""

import pickle
from dataclasses import replace
from types import SimpleNamespace

import angle_plant
import numpy as np
import pytest

from tautline import trajectory
from tautline.calibration.calibrate import calibrate
from tautline.diagnosis import repeated as room
from tautline.diagnosis.diagnose import Diagnosis, diagnose
from tautline.diagnosis.gap import shrink_interval_elsewhere
from tautline.diagnosis.hyperparameters import learnt
from tautline.diagnosis.narration import sentence
from tautline.diagnosis.repeated import HELD
from tautline.diagnosis.segment import are_repeats, prepare
from tautline.model import Effect, Model
from tautline.recording import Marker, Recording
from tautline.simulated import simulate
from tautline.simulated.instrument import preset, reference_rig

RIG = reference_rig()
GRID = np.linspace(-5.0, 5.0, 401)
NOISE = 0.05


def stalled(recording: Recording) -> Recording:
    """0.6 s in every 3 s show the frame before them."""
    marker = recording.marker
    at = np.arange(len(marker.t_s))
    at -= np.where(at % 75 < 15, at % 75, 0)
    return replace(recording, marker=Marker(marker.t_s, marker.u_px[at], marker.v_px[at], marker.valid))


def once(recording: Recording) -> Recording:
    """The frame in mid-stroke that shows the one before it, and nothing else of the kind."""
    marker = recording.marker
    at = np.arange(len(marker.t_s))
    later = at[len(at) // 2 :]  # well after the tip was driven both ways
    fast = later[np.argmax(np.abs(np.diff(marker.u_px, prepend=marker.u_px[0]))[later])]
    at[fast] -= 1
    return replace(recording, marker=Marker(marker.t_s, marker.u_px[at], marker.v_px[at], marker.valid))


def now_and_then(recording: Recording) -> Recording:
    """Six stalls of half a second: one in mid-stroke and five where the tip hardly moves."""
    marker = recording.marker
    at, frames = np.arange(len(marker.t_s)), 13
    moves = np.convolve(np.abs(np.diff(marker.u_px, prepend=marker.u_px[0])), np.ones(frames), "same")
    rests = [i for i in range(100, len(at) - 100, 25) if moves[i] < 4.0 * frames * NOISE][:5]
    for middle in (*rests, 100 + int(np.argmax(moves[100:-100]))):
        at[middle - frames // 2 : middle + frames // 2 + 1] = middle - frames // 2
    assert len(rests) == 5
    return replace(recording, marker=Marker(marker.t_s, marker.u_px[at], marker.v_px[at], marker.valid))


def diagnosed(spoilt=stalled, left_out=(), carried=()) -> Diagnosis:
    instrument = preset("reference", RIG)
    model = Model(RIG, GRID, instrument.backlash(GRID), np.full(401, 0.003), instrument.bend(GRID), 0.08, (-4.0, 4.0))
    model = replace(model, effects=carried)
    motions = [
        trajectory.back_and_forth(RIG.actuator, [0.8], 2.0, 12, 6.0),
        trajectory.trapezoids(RIG.actuator, 0.9, 2.6, 5, 8.0, 0.8),
    ]
    calibration, test = (
        simulate.run(RIG, instrument, motion, noise_px=NOISE, seed=40 + i).recording for i, motion in enumerate(motions)
    )
    test = replace(test, rig=RIG)
    later = float(calibration.motor.t_s[-1]) + 5.0
    test = replace(
        test,
        motor=replace(test.motor, t_s=test.motor.t_s + later),
        marker=replace(test.marker, t_s=test.marker.t_s + later),
    )
    return diagnose(model, replace(calibration, rig=RIG), [spoilt(test)], left_out=left_out)


def test_the_model_keeps_the_effects_that_it_carries_where_only_stalls_are_named():
    carried = (Effect("transmission.lag", {"lag": 0.001}),)
    found = diagnosed(carried=carried)
    assert [finding.id for finding in found.findings] == [HELD]
    assert found.corrected.effects == carried


def test_stalls_are_the_gap_and_not_friction():
    document = diagnosed().document
    assert document["verdict"] == "effect" and [e["id"] for e in document["effects"]] == [HELD]
    assert sum(document["count"]) == pytest.approx(1.0) and document["count"][1] > 0.9
    before = document["gap"]["before"]
    assert before > 20.0 * NOISE and before**2 - document["effects"][0]["adds"] ** 2 == pytest.approx(NOISE**2, rel=0.3)
    assert document["gap"]["after"] == pytest.approx(before)  # no model knows which sample of another motion repeats
    assert document["gap"]["shrink"] == document["effects"][0]["shrink"] == pytest.approx(0.0, abs=1e-12)
    assert document["gap"]["shrink_ci"] == [0.0, 0.0]
    assert "Leave out the samples that repeat: 0.0" in sentence(document)
    assert document["effects"][0]["parameters"]["held_share"] == pytest.approx(14 / 75, abs=0.02)
    assert document["effects"][0]["since"] == "calibration"
    total = document["probability_none"] + document["probability_unknown"]
    assert total + sum(c["probability"] for c in document["candidates"]) == pytest.approx(1.0)


def test_stalls_are_told_though_one_of_them_is_nearly_all_of_the_gap():
    """Frames stand still at any moment; where the tip rests nobody sees it."""
    found = diagnosed(now_and_then)
    assert [finding.id for finding in found.findings] == [HELD] and found.gap.before > 5.0 * NOISE


def test_who_knows_nothing_of_repeats_sees_a_gap_of_another_cause():
    found = diagnosed(left_out=(HELD,))
    assert found.verdict != "none" and found.gap.before > 20.0 * NOISE


def test_one_frame_that_is_the_one_before_is_a_coincidence():
    found = diagnosed(once)
    assert found.document["verdict"] == "none" and found.document["effects"] == []
    again = pickle.loads(pickle.dumps(found))
    assert again == found != replace(found, after=[]) and len(repr(found)) < 600  # a diagnosis is a value


def test_a_sensor_that_counts_repeats_nothing_when_it_rests_on_a_step():
    smooth = np.column_stack([np.sin(np.linspace(0.0, 6.0, 400)), np.cos(np.linspace(0.0, 6.0, 400))])
    assert not are_repeats(smooth).any() and not are_repeats(np.round(smooth, 2)).any()
    twice = np.repeat(smooth, 2, axis=0)
    assert np.array_equal(are_repeats(twice), np.arange(len(twice)) % 2 == 1)
    assert are_repeats(twice[:0]).shape == (0,)  # a test in which nothing was seen


def document_of(after: float, before: float) -> dict:
    """Of an unknown gap whose samples that repeat have three tenths of its power, with held samples as a candidate of
    probability `before`. after: rms with what is handed out, of the others."""
    gap = {"before": np.sqrt(2.8), "before_ci": [1.5, 1.8], "after": after, "after_ci": [0.9 * after, 1.1 * after]}
    gap["shrink"] = 1.0 - after / gap["before"]
    return {
        "noise_floor": 0.1, "verdict": "unknown", "gap": gap, "count": [1.0, 0.0, 0.0, 0.0], "effects": [],
        "where": {"stage": None}, "probability_none": 0.0, "probability_unknown": 1.0 - before,
        "candidates": [
            {"id": HELD, "probability": before, "shrink": 0.1},
            {"id": "transmission.lag", "probability": 0.0, "shrink": 1.0},
        ],
        "gap_recalibrated": {"before": np.sqrt(2.8)},
    }  # fmt: skip


def test_an_effect_that_is_carried_beside_something_unknown_shrinks_what_does_not_repeat(monkeypatch):
    monkeypatch.setattr(room, "_powers", lambda *_: (4.0, 2.8, 1.2))
    segment = SimpleNamespace(held=np.array([True, False]), scored=np.array([False, True]))
    document = document_of(1.0, 0.0)
    room.add_repeats(document, None, [segment, segment], 0.0)
    assert document["verdict"] == "unknown" and document["gap"]["after"] == pytest.approx(np.sqrt(2.2))
    assert document["gap"]["shrink"] == pytest.approx(1.0 - np.sqrt(2.2) / 2.0)


@pytest.mark.parametrize("before", [0.0, 0.4])
def test_what_is_named_is_taken_off_the_gap(monkeypatch: pytest.MonkeyPatch, before: float) -> None:
    """Beside something unknown; held samples may have been a candidate already."""
    monkeypatch.setattr(room, "_powers", lambda *_: (4.0, 2.8, 1.2))
    after = 1.0 if before else np.sqrt(2.8)  # without the samples that repeat
    document = document_of(after, before)
    gap = document["gap"]
    segment = SimpleNamespace(held=np.array([True, False]), scored=np.array([False, True]))
    room.add_repeats(document, None, [segment, segment], 0.0)
    assert (document["verdict"] == "effect") == (before > 0.0) == (gap["shrink"] > 0.0)
    assert gap["after"] == pytest.approx(np.sqrt(after**2 + 1.2))  # what is named takes none of them away
    assert document["gap_recalibrated"]["before"] == pytest.approx(2.0)  # no recalibration takes repeats away
    lag = next(c for c in document["candidates"] if c["id"] == "transmission.lag")
    assert lag["shrink"] == pytest.approx(1.0 - np.sqrt(1.2) / 2.0)  # nor does a lag, whatever it closes beside them
    if before:  # another motion shrinks by another share, as of every effect
        low, high = shrink_interval_elsewhere(gap["after"] / gap["before"], learnt().elsewhere)
        assert gap["shrink_ci"][0] <= low < gap["shrink"] < high <= gap["shrink_ci"][1]


def test_a_link_that_repeats_a_fast_log_is_seen_before_it_is_thinned() -> None:
    """1 kHz of a sensor that says something new every fourth time."""
    motion = angle_plant.Motion.through()
    made = angle_plant.record(motion, sensor_hz=1000.0, noise=0.02, seed=2)
    c = made.angle.c_deg[np.arange(len(made.angle.t_s)) // 4 * 4]
    held = replace(made, angle=replace(made.angle, c_deg=c))
    model = calibrate([made], angle_plant.RIG, naming=False).model
    _, segment = prepare(model, made, [held])
    fresh = np.diff(c, prepend=np.nan) != 0.0
    at = np.rint(1e3 * (segment.arrival_s - segment.arrival_s[0])).astype(int)
    assert len(c) > 12000 > len(at) > 4000
    assert fresh[at[segment.scored]].all() and not fresh[at[segment.held]].any()
    assert segment.scored.sum() == pytest.approx(segment.held.sum() / 3.0, rel=0.05)
