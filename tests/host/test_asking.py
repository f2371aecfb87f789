"""When a live diagnosis ends, and why."""

from types import SimpleNamespace

import pytest

from tautline.live.asking import Leading, why_stop

STROKES = SimpleNamespace(why="fast strokes", separation=0.5)


def ended(probabilities, asked=("trapezoids",), following=STROKES, noise=0.1, most=5, name="transmission.lag"):
    return why_stop([Leading(name, p) for p in probabilities], asked, following, noise, most)


def test_it_goes_on_while_a_motion_tells():
    assert ended([0.6]) == ""
    assert ended([0.6, 0.8], ["trapezoids", "fast strokes"]) == ""


@pytest.mark.parametrize("name", ["transmission.lag", "none", "unknown"])
def test_one_sure_answer_is_enough(name):
    assert ended([0.94], name=name) == ""
    assert "sure" in ended([0.951], name=name) and name in ended([0.951], name=name)


def test_no_motion_no_difference_no_news_and_no_time_end_it():
    assert "no motion" not in ended([0.6], following=None) and "fewer than two" in ended([0.6], following=None)
    assert "tells the leading candidates apart" in ended([0.6], noise=1.8)
    assert "changed nothing" in ended([0.6, 0.61], ["trapezoids", "fast strokes"])
    assert ended([0.6, 0.61], ["trapezoids", "slow strokes"]) == ""
    assert "as many recordings" in ended([0.6, 0.7], ["trapezoids", "fast strokes"], most=2)


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
