"""What recordings cannot tell apart because of how they were made."""

import numpy as np
import pytest

from tautline.diagnosis.confounded import (
    DRIFT,
    LOAD,
    _load_variation_beside_motion,
    add_hidden,
    drift_hidden_by_load,
    load_goes_with_time,
    load_tells_apart,
)
from tautline.diagnosis.segment import Segment
from tautline.effects import BY_ID
from tautline.recording import Motor

T = np.arange(0.0, 40.0, 0.02)
Q = 4.0 * np.sin(2 * np.pi * T / 9.0)


def runs(*loads) -> list[Segment]:
    """A recording for each load: a number or (n,) mNm."""
    rng = np.random.default_rng(3)
    made = []
    for i, load in enumerate(loads):
        noisy = None if load is None else load + 0.3 * Q * np.sign(np.gradient(Q)) + rng.normal(0.0, 0.8, len(T))
        made.append(Segment(f"r{i}", Motor(T, Q, None, None, None, noisy), T, Q[:, None], T > 3.0, 40.0 * i, i == 0))
    return made


@pytest.mark.parametrize(
    ("loads", "expected"),
    [
        ((12.0, 24.0), True),
        ((24.0, 12.0, 12.2), True),
        ((12.0, 24.0, 36.0), False),
        ((12.0, 24.0, 12.0), False),
        ((12.0, 12.0), False),
        ((12.0, None), False),
        ((12.0, 24.0 + 6.0 * np.sin(T / 5.0)), False),
    ],
    ids=["two", "and stays", "three", "and back", "one", "unknown", "moving"],
)
def test_a_load_that_changes_once_goes_with_time(loads, expected):
    assert load_goes_with_time(runs(*loads)) is expected


@pytest.mark.parametrize(
    ("loads", "expected"),
    [
        ((12.0, 24.0), True),
        ((12.0, 24.0, 12.0), True),
        ((12.0, 12.5), False),
        ((12.0, None), False),
        ((18.0 + 9.0 * np.sin(T / 5.0), 18.0 + 6.0 * np.sin(T / 4.0)), False),
    ],
    ids=["two", "and back", "one", "unknown", "moving"],
)
def test_a_load_tells_recordings_apart_where_its_levels_differ_by_more_than_it_scatters(loads, expected):
    assert load_tells_apart(runs(*loads)) is expected


def test_a_load_varies_as_much_beside_a_motor_that_counts():
    """More where the motor is at its last count: no place of its own."""
    q = np.round(1e4 * np.clip(1.3 * Q, -4.0, 4.0))
    load = 10.0 + 2.0 * (q == q.max())
    in_units = [Segment("r", Motor(T, c, None), T, c[:, None], T > 3.0, 0.0, False) for c in (q, 1e-4 * q)]
    counts, fine = (_load_variation_beside_motion(segment, load[T > 3.0]) for segment in in_units)
    assert counts == pytest.approx(fine) and fine > 0.0


def test_loads_are_compared_in_the_order_of_time():
    first, second, third = runs(12.0, 12.0, 24.0)
    assert load_goes_with_time([first, third, second])


def test_what_stands_for_another_shares_its_probability():
    document = {
        "effects": [{"id": LOAD, "ambiguous_with": []}],
        "candidates": [
            {"id": LOAD, "probability": 0.9, "shrink": 0.8, "identifiable": True},
            {"id": "transmission.lag", "probability": 0.05, "shrink": 0.1, "identifiable": True},
        ],
    }
    add_hidden(document, drift_hidden_by_load([BY_ID[LOAD], BY_ID[DRIFT]], runs(12.0, 24.0)))
    assert document["effects"][0]["ambiguous_with"] == [DRIFT]
    found = {c["id"]: c for c in document["candidates"]}
    assert list(found) == [LOAD, DRIFT, "transmission.lag"]
    assert found[LOAD]["probability"] + found[DRIFT]["probability"] == pytest.approx(0.9)
    assert not found[LOAD]["identifiable"] and not found[DRIFT]["identifiable"]


def test_a_library_without_the_load_hides_nothing():
    assert drift_hidden_by_load([BY_ID[DRIFT]], runs(12.0, 24.0)) == {}
