"""Which part of the nominal model had to move, of recordings of the second instrument."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tautline import trajectory
from tautline.calibration.calibrate import calibrate
from tautline.diagnosis import moved, narration
from tautline.diagnosis.diagnose import diagnose
from tautline.prediction import predict
from tautline.rig import Rig
from tautline.simulated.instrument import preset, reference_rig
from tools.blindtest.reality import Plant, Truth, record

RIG = reference_rig()
TRUE = preset("random", RIG, 5)
PLANT = Plant(RIG, TRUE.grid, TRUE.width, TRUE.c_deg, 0.05)
CALIBRATION = trajectory.back_and_forth(RIG.actuator, [0.8, 1.8], 2.2, 16, 8.0, 0.4)


def calibrated(rig):
    """The calibration's recording of the plant as it is, and the model that this rig makes of it."""
    made = replace(record(PLANT, Truth(), CALIBRATION, 0.0, 40, "motion-0", None, 0.0), rig=rig)
    return made, calibrate([made], rig).model


@cache
def calibrated_rightly():
    return calibrated(RIG)


def diagnosed(plants, rig=RIG, seen=(-np.inf, np.inf)):
    """After the calibration tests and one motion more, a plant each; the last is not diagnosed. seen: the tests' marker
    has an image where u is within these px."""
    actuator = RIG.actuator
    motions = [
        CALIBRATION,
        trajectory.trapezoids(actuator, 0.9, 2.6, 4, 9.0, 0.8).with_sway(2.0, 20.0, 17.0),
        trajectory.sines(actuator, 1.5, 30.0).with_sway(1.5, 15.0, 13.0),
        trajectory.trapezoids(actuator, 1.2, 3.4, 3, 9.0, 0.8).with_sway(1.5, 25.0, 11.0),
    ]
    starts = np.concatenate([[0.0], np.cumsum([m.duration_s + 5.0 for m in motions])])
    calibration, model = calibrated_rightly() if rig is RIG else calibrated(rig)
    made = [calibration] + [
        replace(record(plant, Truth(), motion, starts[i], 40 + i, f"motion-{i}", None, starts[i]), rig=rig)
        for i, (plant, motion) in enumerate(zip(plants, motions[1:], strict=True), 1)
    ]
    for i in (1, 2):
        marker = made[i].marker
        within = (marker.u_px > seen[0]) & (marker.u_px < seen[1])
        made[i] = replace(made[i], marker=replace(marker, valid=marker.valid & within))
    found = diagnose(model, made[0], made[1:3])
    last = made[3]
    scene = last.marker.t_s - found.corrected.delay_s
    late = last.marker.valid & (scene > last.motor.t_s[0] + 8.0) & (scene < last.motor.t_s[-1])
    seen = np.column_stack([last.marker.u_px, last.marker.v_px])[late]
    off = seen - predict(found.corrected, last.motor, scene[late]).image_px
    return found.document, float(np.sqrt(np.mean(off**2)))


def wider(plant):
    return replace(plant, width=1.3 * plant.width)


def bent(plant):
    x = plant.grid / 5.0
    return replace(plant, c_deg=plant.c_deg + 1.2 * x - 2.0 * x**2)


def worn(plant):
    """At one place, over a tenth of the range."""
    return replace(plant, c_deg=plant.c_deg + 2.2 * np.exp(-0.5 * ((plant.grid - 0.9) / 0.4) ** 2))


def stiff(plant):
    """At one place, over a tenth of the range."""
    return replace(plant, width=plant.width * (1.0 + 0.5 * np.exp(-0.5 * ((plant.grid - 0.9) / 0.4) ** 2)))


def homed(plant, by=0.2):
    return replace(plant, grid=plant.grid - by)


@pytest.mark.parametrize(
    ("made", "name"),
    [
        (wider, "transmission.backlash"),
        pytest.param(stiff, "transmission.backlash", marks=pytest.mark.long),
        pytest.param(bent, "configuration.remaining", marks=pytest.mark.long),
        pytest.param(worn, "configuration.remaining", marks=pytest.mark.long),
        pytest.param(homed, "transmission.offset", marks=pytest.mark.long),  # below each recording has another
    ],
)
def test_what_is_another_since_the_calibration_is_named(made, name):
    document, further = diagnosed([made(PLANT)] * 3)
    assert [(e["id"], e["since"]) for e in document["effects"]] == [(name, "calibration")]
    assert [(m["id"], m["share"]) for m in document["moved"]] == [(name, pytest.approx(1.0))]
    assert document["effects"][0]["loads_on_board"]
    assert further < 1.3 * 0.05, further  # on a motion that nobody saw


def test_where_the_tests_saw_nothing_the_law_is_as_it_was():
    document, further = diagnosed([worn(PLANT)] * 3, seen=(170.0, 440.0))
    assert [e["id"] for e in document["effects"]] == ["configuration.remaining"]
    assert further < 1.3 * 0.05, further


def test_each_recording_may_have_its_own_offset_and_the_corrected_model_has_the_last():
    document, further = diagnosed([homed(PLANT, -0.15), homed(PLANT, 0.25), homed(PLANT, 0.25)])
    effect = document["effects"][0]
    assert (effect["id"], effect["since"]) == ("transmission.offset", "recording")
    assert [r["offset"] for r in effect["recordings"]] == pytest.approx([-0.15, 0.25], abs=2e-3)
    assert effect["parameters"]["offset"] == pytest.approx(0.25, abs=2e-3)
    assert further < 1.3 * 0.05, further


def test_a_hand_eye_transform_that_was_wrong_from_the_start_is_named():
    document_of = RIG.to_document()
    document_of["hand_eye"]["rotation_deg"] = [5.5, -4.8, 0.5]
    document, further = diagnosed([PLANT] * 3, Rig.from_document(document_of, "wrong"))
    assert [(e["id"], e["since"]) for e in document["effects"]] == [("registration.static", "start")]
    assert document["moved"][0] == {"id": "registration.static", "share": pytest.approx(1.0), "since": "start"}
    assert "[hand_eye]" in " ".join(step.says for step in narration.steps(document, "out"))
    total = sum(c["probability"] for c in document["candidates"])
    assert total + document["probability_none"] + document["probability_unknown"] == pytest.approx(1.0)
    assert further < 1.5 * 0.05, further


def test_a_nominal_delay_that_the_calibration_mends_is_none():
    document_of = RIG.to_document()
    document_of["camera"]["delay_s"] += 0.02
    document, _ = diagnosed([PLANT] * 3, Rig.from_document(document_of, "late"))
    assert document["verdict"] == "none" and document["moved"] == []


def test_shares_add_up_and_small_ones_are_not_told():
    def worth(parts):
        return sum({"a": 0.7, "b": 0.28, "c": 0.01}[part] for part in parts)

    found = moved._shapley_shares(("a", "b", "c"), worth)
    assert [m.id for m in found] == ["a", "b"]
    assert [m.share for m in found] == pytest.approx([0.7 / 0.98, 0.28 / 0.98])
