"""When a live diagnosis ends, and why."""

from types import SimpleNamespace

import pytest

from tautline.live.asking import Leading, why_stop

STROKES = SimpleNamespace(why="fast strokes", information=0.3, entropy=0.9)


def ended(probabilities, following=STROKES, most=5, name="transmission.lag"):
    return why_stop([Leading(name, p) for p in probabilities], following, most)


def test_it_goes_on_while_a_motion_tells():
    assert ended([0.6]) == ""
    assert ended([0.6, 0.8, 0.8]) == ""  # what is expected decides, not what the last recording changed


@pytest.mark.parametrize("name", ["transmission.lag", "none", "unknown"])
def test_one_sure_answer_is_enough(name):
    assert ended([0.94], name=name) == ""
    assert "sure" in ended([0.951], name=name) and name in ended([0.951], name=name)


def test_no_motion_no_information_and_no_time_end_it():
    assert "no candidate has a path" in ended([0.6], following=None)
    silent = SimpleNamespace(why="fast strokes", information=0.004, entropy=0.9)
    assert "fast strokes would tell 0.004 of the 0.9 nats" in ended([0.6], silent)
    assert "as many recordings" in ended([0.6, 0.7], most=2)


def test_the_answer_is_the_likeliest_of_all():
    document = {
        "candidates": [
            {"id": "transmission.lag", "probability": 0.3},
            {"id": "transmission.creep", "probability": 0.2},
        ],
        "probability_none": 0.1,
        "probability_unknown": 0.4,
    }
    assert Leading.of(document) == Leading("unknown", 0.4)
    assert Leading.of({**document, "probability_unknown": 0.2}) == Leading("transmission.lag", 0.3)
