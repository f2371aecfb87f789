"""How far samples scatter, by what outliers do not move; intervals of draws; what rounding leaves."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

NINE_OF_TEN = 1.645  # equation: standard deviations of a normal distribution, either way, that hold 90 %
MEDIAN = 0.6745  # equation: of a normal variable's size, in standard deviations
_MEDIAN2 = 0.4549364  # equation: of a chi-squared variable's of one degree of freedom
THIRD = 20.0  # equation: 1 + 9 + 9 + 1, the variance of a third difference of white noise of variance 1


def deviation(values: Array) -> float:
    """One standard deviation of normal values about 0, an array of any shape, by the median of their absolute
    values."""
    return float(np.median(np.abs(values))) / MEDIAN


def deviation_of_squares(squares: Array) -> float:
    """One standard deviation of normal values about 0, by the median of their squares, an array of any shape."""
    return float(np.sqrt(np.median(squares) / _MEDIAN2))


def of_rounding(step: float) -> float:
    """One standard deviation of a rounding error, which is uniform over one `step`: step / sqrt(12)."""
    return step / float(np.sqrt(12.0))  # equation: of a uniform density


def interval(draws: Array, share: float) -> list[float]:
    """The lower and upper end of the interval that holds this share, 0 to 1, of the draws (n,), with as many below as
    above it."""
    return [float(end) for end in np.quantile(draws, [0.5 - 0.5 * share, 0.5 + 0.5 * share])]
