"""Exact Shapley shares: what each member adds, averaged over every order in which the members may come."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence


def shares(names: Sequence[str], worth: Callable[[frozenset[str]], float]) -> list[float]:
    """The Shapley share of each name; worth(names) is asked once for every subset, 2^n times."""
    known = {frozenset(s): worth(frozenset(s)) for k in range(len(names) + 1) for s in itertools.combinations(names, k)}
    n = len(names)
    weight = [math.factorial(k) * math.factorial(n - k - 1) / math.factorial(n) for k in range(n)]
    return [
        sum(weight[len(s)] * (known[s | {name}] - value) for s, value in known.items() if name not in s)
        for name in names
    ]
