"""What onsets and a joint fit that errs say of B, weighed by what each is uncertain by."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tautline.calibration import choice as choosing
from tautline.calibration.backlash import WidthCurve
from tautline.calibration.choice import Choice
from tautline.calibration.components import Components
from tautline.calibration.findings import Findings
from tautline.calibration.onset import HINGE, Onset
from tautline.calibration.playfit import Fitted
from tautline.calibration.smooth import Domain

GRID = np.linspace(-5.0, 5.0, 101)


def weighed(sigma: float, theirs: float, excess: float = 0.0, places: int = 4) -> tuple[float, float]:
    """B and sigma in the middle: the joint fit says 1.0, the onsets 2.0."""
    flat = np.ones_like(GRID)
    curve = WidthCurve(GRID, 2.0 * flat, theirs * flat, (-4.0, 4.0), excess, places=places)
    choice = Choice([], Domain(-5.0, 5.0), GRID, "deg", Findings())
    width, spread = choice._combined(curve, flat, sigma * flat) or (flat, sigma * flat)
    return float(width[50]), float(spread[50])


def test_a_joint_fit_that_is_as_sure_as_the_onsets_stays() -> None:
    assert weighed(0.01, 0.1) == (1.0, 0.01) and weighed(0.19, 0.1) == (1.0, 0.19)


def test_onsets_that_are_clearly_surer_count_by_their_variance() -> None:
    width, sigma = weighed(0.3, 0.1)
    assert width == pytest.approx(1.9) and sigma == pytest.approx(0.3 / np.sqrt(10.0))


def test_what_onsets_at_one_place_share_is_counted_once() -> None:
    assert weighed(0.3, 0.1, excess=0.5, places=2) == (1.0, 0.3)
    assert weighed(0.3, 0.1, excess=0.5, places=100)[0] == pytest.approx(1.0 + 0.09 / (0.09 + 0.0125), abs=1e-6)


@pytest.mark.parametrize(("own", "other", "counts"), [(1.3, 2.0, False), (2.0, 5.0, True), (2.0, 6.5, False)])
def test_where_the_joint_fit_predicts_well_onsets_do_not_count(own: float, other: float, counts: bool) -> None:
    joint, both = np.ones_like(GRID), 2.0 * np.ones_like(GRID)
    left = SimpleNamespace(residual_with_width=lambda _, width: own if width is joint else other)
    assert Choice._mean_is_bearable(cast(Choice, left), cast(Fitted, None), joint, both) is counts


@pytest.mark.parametrize("leads", ["phase.even", "creep.2"])
def test_onsets_confirm_no_departure_that_is_a_gradual_start(leads: str) -> None:
    def says(width: float) -> Any:
        elements = SimpleNamespace(single=True)
        fit = SimpleNamespace(hysteresis=elements, width=lambda curves: width * np.ones_like(GRID))
        return SimpleNamespace(fit=fit, curves=None, width_sigma=lambda grid: 0.01 * np.ones_like(GRID))

    at = np.linspace(-4.0, 4.0, 8)
    onsets = [Onset(0, 0.0, 1.0, 1, q - 0.5, q + 0.5, 0.05, 0.0, np.inf, HINGE, True) for q in at]
    curve = WidthCurve(GRID, np.ones_like(GRID), 0.05 * np.ones_like(GRID), (-4.0, 4.0), 0.0, places=8)
    parts = tuple(SimpleNamespace(name=name) for name in (leads, "stroke"))
    first = cast(property, Components.mainly_start_of_strokes).fget
    assert first is not None
    components = cast(Components, SimpleNamespace(mainly_start_of_strokes=first(SimpleNamespace(parts=parts))))
    choice = Choice([], Domain(-5.0, 5.0), GRID, "deg", Findings())
    assert choice.onsets_favour_departures(onsets, curve, components, says(1.0), says(2.0)) is (leads != "phase.even")


def test_where_no_onset_is_the_passes_are_as_far_off_as_they_are_elsewhere() -> None:
    """The image jumps with the direction, by more of B at one end than at the other: onsets bracket B, the passes'
    distance holds the jump."""
    true = 1.0 + 0.3 * np.exp(-(((GRID - 0.5) / 1.5) ** 2))
    jump = 0.2 + 0.02 * GRID
    flat = np.ones_like(GRID)
    at = [p for p in np.linspace(-4.5, 4.5, 46) if not -1.5 < p < 2.0]
    onsets = [Onset(0, p, p, 1, p - 0.5, p + 0.5, 0.01, 0.0, 9.0, HINGE, True) for p in at]
    passes = SimpleNamespace(
        fit=SimpleNamespace(width=lambda curves: true + jump), curves=None, width_sigma=lambda grid: 0.002 * flat
    )
    curve = WidthCurve(GRID, true, 0.01 * flat, (-4.5, 4.5), 0.0)
    choice = Choice([], Domain(-5.0, 5.0), GRID, "deg", Findings())
    width, sigma, _ = choice._onsets_filled_by_passes(onsets, curve, cast(Fitted, passes))
    hole = (GRID > -1.2) & (GRID < 1.7)
    off = np.abs(width - true)[hole]
    assert (off < 2.0 * sigma[hole]).all() and (sigma[hole] < 0.06).all()  # the jump itself is 0.2
    assert width[hole] == pytest.approx(true[hole], abs=0.03)  # its lean over the hole


@pytest.mark.parametrize("places", [(3.0, 4.0, 5.0), (2.003, 4.0, 5.0)])
def test_an_onset_at_the_end_of_what_both_ways_passed_counts(
    monkeypatch: pytest.MonkeyPatch, places: tuple[float, ...]
) -> None:
    grid = np.linspace(0.0, 10.0, 101)
    monkeypatch.setattr(choosing, "overlap", lambda fitted: (2.003, 7.004))
    fit = SimpleNamespace(width=lambda curves: np.ones(101))
    passes = SimpleNamespace(fit=fit, curves=None, width_sigma=lambda at: np.full(len(at), 0.01))
    findings = Findings()
    onsets = [Onset(0, 0.0, 0.1, 1, p - 0.75, p + 0.75, 0.01, 0.0, 9.0, HINGE, True) for p in places]
    curve = cast(WidthCurve, SimpleNamespace(excess=0.0))
    width, _ = Choice([], Domain(0.0, 10.0), grid, "mm", findings).opinion_of_passes(
        onsets, curve, cast(Fitted, passes)
    )
    assert findings.evidence["onsets_minus_passes"] == pytest.approx(0.5)
    assert width is not None and np.isnan(width[:20]).all() and np.isfinite(width[21:70]).all()


def test_onsets_narrower_than_the_grid_is_fine_are_near_the_nearest_place_of_it() -> None:
    """A stroke that always turns at the same two places, with hardly any backlash: no place of the grid is within a
    width of an onset."""
    at = [p + off for p in (-3.05, 3.05) for off in (-0.001, 0.0, 0.001)]
    onsets = [Onset(0, p, p, 1, p - 0.003, p + 0.003, 0.001, 0.0, 9.0, HINGE, True) for p in at]
    curve = WidthCurve(GRID, np.full(101, 0.006), np.full(101, 0.001), (-3.051, 3.051), 0.0, places=2)
    fit = SimpleNamespace(width=lambda curves: np.full(101, 0.009))
    passes = cast(Fitted, SimpleNamespace(fit=fit, curves=None, width_sigma=lambda grid: np.full(101, 0.002)))
    choice = Choice([], Domain(-5.0, 5.0), GRID, "mm", Findings())
    width, sigma, _ = choice._onsets_filled_by_passes(onsets, curve, passes)
    assert width == pytest.approx(0.006) and np.isfinite(sigma).all()
