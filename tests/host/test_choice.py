"""What onsets and a joint fit that errs say of B, weighed by what each is uncertain by."""

from __future__ import annotations

import numpy as np
import pytest

from tautline.calibration.backlash import WidthCurve
from tautline.calibration.choice import Choice
from tautline.calibration.findings import Findings
from tautline.calibration.smooth import Domain

GRID = np.linspace(-5.0, 5.0, 101)


def weighed(sigma: float, theirs: float, excess: float = 0.0, places: int = 4) -> tuple[float, float]:
    """B and sigma in the middle: the joint fit says 1.0, the onsets 2.0."""
    flat = np.ones_like(GRID)
    curve = WidthCurve(GRID, 2.0 * flat, theirs * flat, (-4.0, 4.0), excess, places=places)
    choice = Choice([], Domain(-5.0, 5.0), GRID, "deg", Findings())
    width, spread = choice._weighed(curve, flat, sigma * flat)
    return float(width[50]), float(spread[50])


def test_a_joint_fit_that_is_as_sure_as_the_onsets_stays() -> None:
    assert weighed(0.01, 0.1) == (1.0, 0.01) and weighed(0.19, 0.1) == (1.0, 0.19)


def test_onsets_that_are_clearly_surer_count_by_their_variance() -> None:
    width, sigma = weighed(0.3, 0.1)
    assert width == pytest.approx(1.9) and sigma == pytest.approx(0.3 / np.sqrt(10.0))


def test_what_onsets_at_one_place_share_is_counted_once() -> None:
    assert weighed(0.3, 0.1, excess=0.5, places=2) == (1.0, 0.3)
    assert weighed(0.3, 0.1, excess=0.5, places=100)[0] == pytest.approx(1.0 + 0.09 / (0.09 + 0.0125), abs=1e-6)
