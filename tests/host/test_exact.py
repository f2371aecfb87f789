"""Noise is all that a law leaves: whatever else foretells a part of it speaks against the law."""

import numpy as np
import pytest

from tautline.diagnosis import exact

NOISE, FRAMES, LIMITS = 0.06, 1500, [1.0, 1.0]


def noise(seed: int, memory: float = 0.0) -> list[np.ndarray]:
    """Of two recordings."""
    white = NOISE * np.random.default_rng(seed).normal(size=(2, FRAMES, 2))
    for k in range(1, FRAMES):
        white[:, k] = memory * white[:, k - 1] + np.sqrt(1.0 - memory**2) * white[:, k]
    return list(white)


def after_turns() -> np.ndarray:
    """0.3 px in the one frame after each of 15 turns: a hundredth of the frames."""
    path = np.zeros((FRAMES, 2))
    path[50::100, 0] = 0.3
    return path


def test_a_few_frames_tell_of_two_hypotheses_which_is_right() -> None:
    right = noise(1)
    wrong = [own + after_turns() for own in right]
    said = exact.log_likelihood_ratio(wrong, right, LIMITS, NOISE)
    assert said == pytest.approx(2 * 15 * 0.3**2 / (2.0 * NOISE**2), rel=0.3)
    assert exact.chance([said, -3.0]) < 1e-6
    assert exact.log_likelihood_ratio(right, wrong, LIMITS, NOISE) == pytest.approx(-said)
    assert exact.chance([-said, -3.0]) == 1.0


def test_noise_that_remembers_tells_less() -> None:
    slow = 0.02 * np.sin(np.arange(FRAMES) / 40.0)[:, None] * np.ones(2)
    said = []
    for memory in (0.0, 0.95):
        right = noise(2, memory)
        said.append(exact.log_likelihood_ratio([own + slow for own in right], right, LIMITS, NOISE))
    assert 0.0 < said[1] < 0.2 * said[0]


def test_a_lost_marker_tells_no_more_than_any_outlier() -> None:
    right = noise(3)
    wrong = [own.copy() for own in right]
    wrong[0][700] = 500.0
    assert exact.log_likelihood_ratio(wrong, right, [0.2, 0.2], NOISE) < 2 * 0.2**2 / NOISE**2


@pytest.mark.parametrize(
    ("ids", "law"),
    [
        (("acquisition.delay",), True),
        (("acquisition.delay", "transmission.backlash"), True),
        (("transmission.backlash",), False),  # a curve that was another may be so elsewhere too
        (("acquisition.delay", "transmission.lag"), False),
        (("acquisition.jitter",), False),  # has no path
        ((), False),
    ],
)
def test_a_law_is_one_beside_parts_of_the_nominal_model_alone(ids, law) -> None:
    assert exact.is_law(ids) == law


def test_of_many_others_one_is_likelier_by_chance() -> None:
    assert exact.chance([2.0]) == pytest.approx(np.exp(-2.0))
    assert exact.chance([2.0] * 8) == 1.0 and exact.chance([]) == 1.0
