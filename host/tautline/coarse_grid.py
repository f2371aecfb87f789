"""The best of a grid without trying all of it."""

from __future__ import annotations

from collections.abc import Callable

STRIDE = 3  # tolerance: grid steps within which a cost has one minimum


def least_of(count: int, cost: Callable[[int], float]) -> int:
    """The index, 0 to count - 1, of the smallest cost: of every STRIDE-th and the last one first, then of those about
    the best of these. count: 1 or more; cost: of an index, may be called twice with one: it should keep what is dear.
    """
    last = count - 1
    near = min({*range(0, last, STRIDE), last}, key=cost)
    return min(range(max(near - STRIDE + 1, 0), min(near + STRIDE, count)), key=cost)
