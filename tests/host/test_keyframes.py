"""What a region's and a scene's tracker share: the nearest keyframes say together, and in the end all agree."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tautline.vision.keyframes import Keyframes


def of(places: list[float]) -> Keyframes[float]:
    keyframes = Keyframes(places[0], most=len(places), reach=2.0)
    keyframes.keys.extend(places[1:])
    return keyframes


@given(st.integers(1, 3), st.integers(0, 2**32 - 1))
def test_keyframes_that_are_off_go_where_the_others_have_them(width: int, seed: int) -> None:
    """Each picture was seen by a keyframe and the one before, each off by its own: then none is, but all as the first
    one, within what a thousandth of a picture holds them by."""
    rng, n = np.random.default_rng(seed), 12
    off = rng.normal(size=(n, width))
    keyframes = of([0.0] * n)
    for k in np.repeat(np.arange(1, n), 40).tolist():
        keyframes.note(k, k - 1, off[k] - off[k - 1])
    settled = keyframes.settle()
    assert settled is not None
    by, scatter = settled
    np.testing.assert_allclose(off + by, np.broadcast_to(off[0], off.shape), atol=0.02)
    assert scatter.shape == (n,) and scatter.max() < 0.02


def test_the_scatter_is_what_pictures_say_of_one_of_two_keyframes() -> None:
    """The difference has sqrt(2) times the scatter of each, a coordinate; a third one that nobody compared has none."""
    rng, keyframes = np.random.default_rng(1), of([0.0] * 3)
    for off in rng.normal(0.0, np.sqrt(2.0) * 0.3, (4000, 2)):
        keyframes.note(0, 1, off)
    settled = keyframes.settle()
    assert settled is not None
    np.testing.assert_allclose(settled[1], [0.3, 0.3, 0.0], rtol=0.05)  # of 8000 numbers 1 %


def test_nothing_is_learnt_once_it_is_settled() -> None:
    keyframes = of([0.0, 1.0])
    assert keyframes.settle() is None
    keyframes.note(0, 1, np.ones(1))
    assert keyframes.settle() is None and not keyframes.has_room


def test_one_that_comes_within_reach_changes_nothing_at_once() -> None:
    """Keyframes at 0 and 1.5 that each say their own place: what they say together goes on steadily."""

    def said(expected: float) -> float:
        keyframes = of([0.0, 1.5])
        found = keyframes.nearest([abs(key - expected) for key in keyframes.keys], lambda key: key)
        weights = np.array([weight for weight, _, _ in found])
        return float(weights @ [keyframes.keys[k] for _, k, _ in found] / weights.sum())

    told = np.array([said(at) for at in np.arange(-1.9, 3.4, 1e-3)])
    assert np.abs(np.diff(told)).max() < 1e-2


def test_one_that_sees_nothing_is_passed_over_and_one_beyond_the_reach_is_the_last_resort() -> None:
    keyframes = of([0.0, 1.0, 1.5, 9.0])

    def but(*blind: float) -> list[int]:
        away, see = [0.1, 0.9, 1.4, 8.9], lambda key: None if key in blind else key
        one, other = (keyframes.nearest(away, see, beyond=beyond) for beyond in (False, True))
        assert one == other or not one
        return [k for _, k, _ in other]

    assert but() == [0, 1] and but(0.0) == [1, 2] and but(0.0, 1.0) == [2]
    assert but(0.0, 1.0, 1.5) == [3] and but(0.0, 1.0, 1.5, 9.0) == []
