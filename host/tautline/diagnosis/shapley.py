"""Exact Shapley values: what each member of a group adds to its worth, averaged over every order of joining."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence


def shares(names: Sequence[str], worth: Callable[[frozenset[str]], float]) -> list[float]:
    """The exact Shapley value of each name: the sum over all sets S of other names of |S|! (n - |S| - 1)! / n! (worth(S
    + name) - worth(S)). The values sum to worth(all) - worth(none). worth: called once for each of the 2^n subsets."""
    known = {frozenset(s): worth(frozenset(s)) for k in range(len(names) + 1) for s in itertools.combinations(names, k)}
    n = len(names)
    weight = [math.factorial(k) * math.factorial(n - k - 1) / math.factorial(n) for k in range(n)]
    return [
        sum(weight[len(s)] * (known[s | {name}] - value) for s, value in known.items() if name not in s)
        for name in names
    ]
