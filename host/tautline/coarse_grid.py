"""The best of a grid without trying all of it."""

from __future__ import annotations

from collections.abc import Callable

STRIDE = 3  # tolerance: grid steps within which a cost has one minimum


def least_of(count: int, cost: Callable[[int], float]) -> int:
    """The index, 0 to count - 1, of the smallest cost. It tries every STRIDE-th index and the last one, then those less
    than STRIDE away from the best of these, and so relies on a cost with one minimum within STRIDE steps. count: 1 or
    more; cost: of an index; it is called twice with some, so a cost that is slow to compute should be cached."""
    last = count - 1
    near = min({*range(0, last, STRIDE), last}, key=cost)
    return min(range(max(near - STRIDE + 1, 0), min(near + STRIDE, count)), key=cost)
