"""The points of the motor's path that a play depends on, whatever its width."""

from __future__ import annotations

import numpy as np
import pytest

from tautline.tracking.path import knots


def centre(p: float, path: list[float], width: float) -> float:
    for q in path:
        p = min(max(p, q - 0.5 * width), q + 0.5 * width)
    return p


@pytest.mark.parametrize("seed", range(200))
def test_they_lead_a_play_where_the_whole_path_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    path = np.cumsum(rng.normal(size=rng.integers(1, 60)) * rng.choice([0.1, 1.0, 5.0]))
    before = float(rng.normal())
    kept = knots(before, path[:-1], float(path[-1])).tolist()
    assert kept[-1] == path[-1] and len(kept) <= len(path)
    for width in (0.0, 0.3, 2.0, 20.0):
        for start in before + width * np.array([-0.5, 0.1, 0.5]):
            assert centre(start, kept, width) == pytest.approx(centre(start, path.tolist(), width), abs=1e-12)


def test_a_stroke_within_a_stroke_is_kept() -> None:
    assert knots(0.0, np.array([5.0, -3.0, 4.0]), 1.0).tolist() == [5.0, -3.0, 4.0, 1.0]


def test_no_more_than_them() -> None:
    swing = 5.0 * np.sin(np.linspace(0.0, 6.0 * np.pi, 3000)) * np.exp(-np.linspace(0.0, 3.0, 3000))
    assert len(knots(0.0, swing[1:-1], float(swing[-1]))) == 7  # three swings either way, and the end
    assert knots(0.0, np.linspace(0.1, 0.9, 50), 1.0).tolist() == [1.0]
