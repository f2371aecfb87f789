"""Results are values: equal by what they hold, picklable, and short in print."""

import copy
import logging
import pickle
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import tautline as tl
from tautline.calibration.options import Options
from tautline.value import Value, same
from tools.tracking.sessions import Instrument, calibration, ideal_model

MODEL = ideal_model(Instrument(1))


@pytest.fixture(scope="module")
def found() -> tl.Calibration:
    return tl.calibrate(calibration(Instrument(1), 1))


@dataclass(frozen=True, eq=False, repr=False)
class Held(Value):
    array: np.ndarray
    parts: dict
    one: float = np.nan


def held(**changed) -> Held:
    return replace(Held(np.array([1.0, np.nan]), {"a": [1, (2, np.zeros(2))]}), **changed)


def test_equal_is_what_holds_the_same():
    assert held() == held()
    others = (
        {"array": np.array([1.0, 2.0])}, {"array": np.array([1.0, np.nan, 0.0])}, {"array": np.array([1, 2])},
        {"parts": {}}, {"parts": {"a": [1, (2, np.ones(2))]}}, {"parts": {"a": 1}}, {"one": 1.0},
    )  # fmt: skip
    assert all(held() != held(**other) for other in others) and held() != "held"
    assert same([1, 2.0], (1.0, np.int64(2))) and not same([1], [1, 2]) and not same(np.zeros(1), [0.0])
    with pytest.raises(TypeError):
        hash(held())


def test_a_model_is_a_value(tmp_path: Path):
    own = replace(MODEL)
    assert own.play.forward([0.0, 2.0]) is not None  # what is cached on it is native, and no part of it
    assert pickle.loads(pickle.dumps(own)) == own == copy.deepcopy(own) == MODEL
    assert own != replace(own, delay_s=0.5) and own != replace(own, width=own.width + 1e-12)
    own.save(tmp_path)
    assert tl.Model.load(tmp_path) == own
    assert repr(own).startswith("Model(") and "0 to" not in repr(own)[:8] and len(repr(own)) < 400


def test_a_calibration_and_a_prediction_are_values(found, tmp_path: Path):
    again = pickle.loads(pickle.dumps(found))
    assert again == found and again.model == found.model and len(repr(found)) < 600
    assert again != replace(found, source="nothing")
    found.model.save(tmp_path)
    assert tl.Model.load(tmp_path) == found.model
    motor = calibration(Instrument(1), 1).motor
    told = tl.predict(found.model, motor, motor.t_s[::100])
    assert pickle.loads(pickle.dumps(told)) == told != replace(told, c_deg=told.c_deg + 1.0)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"knots": "cubic"}, "knots 'cubic' is not there: choose one of smooth, paper"),
        ({"remaining": "poly"}, "remaining 'poly' is not there: choose one of direct, morphological"),
        ({"elements": "two"}, "elements 'two' is not there: choose one of auto, one"),
        ({"delay_s": float("nan")}, "delay_s nan is no time"),
    ],
)
def test_an_option_that_is_not_there_is_refused(wrong, says):
    with pytest.raises(tl.TautError, match=says):
        Options(**wrong)
    if "knots" in wrong:
        with pytest.raises(tl.TautError, match=says):
            tl.calibrate(calibration(Instrument(1), 1), **wrong)


def test_what_was_found_is_logged_under_tautline(caplog: pytest.LogCaptureFixture):
    with caplog.at_level(logging.DEBUG, "tautline"):
        found = tl.calibrate(calibration(Instrument(1), 1))
    assert {record.name.split(".")[0] for record in caplog.records} == {"tautline"}
    text = caplog.text
    assert found.model.quality.verdict.value in text and all(note in text for note in found.notes)
    assert any(record.levelno == logging.DEBUG for record in caplog.records)
    assert any(isinstance(handler, logging.NullHandler) for handler in logging.getLogger("tautline").handlers)
