"""Which of a joint fit's unknowns are there: a posterior over all sets of them, from one fit of all.

A set's evidence beside that of all is the density of what it leaves out at zero, after the data over before them
(Savage and Dickey): the fit's normal distribution has it in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
import numpy.typing as npt

from tautline.diagnosis.joint import BENDS, Fitted, Unknown
from tautline.diagnosis.stacked import log_sum

Array = npt.NDArray[np.float64]

_SURE = 0.8  # loss: probability from which on a group is named
_THERE = 0.2  # prior: probability of an unknown to be there before anything is seen
_MOST = 12  # tolerance: unknowns of which all sets are weighed, 4096
_TOGETHER = 3  # format: in a group at most: of three the prior alone would say 49 %


@dataclass(frozen=True)
class Sets:
    """(sets, ids): what is in each, and its probability (sets,)."""

    ids: tuple[str, ...]
    present: npt.NDArray[np.bool_]
    probability: Array

    @classmethod
    def of(cls, unknowns: tuple[Unknown, ...], fitted: Fitted) -> Sets:
        """The posterior over the sets of up to _MOST unknowns, those that would be missed most; the others are in every
        set. One at an end of its range is in none."""
        free = [unknown for unknown in unknowns if np.isin(unknown.places, fitted.free).any()]
        free = sorted(free, key=lambda unknown: -_log_evidence_against_zero(fitted, [unknown]))[-_MOST:]
        present, log = [], []
        for size in range(len(free) + 1):
            for without in combinations(range(len(free)), size):
                present.append([i not in without for i in range(len(free))])
                log.append(
                    -_log_evidence_against_zero(fitted, [free[i] for i in without])
                    + size * np.log((1.0 - _THERE) / _THERE)
                )
        weights = np.array(log)
        return cls(tuple(u.id for u in free), np.array(present, dtype=bool), np.exp(weights - log_sum(weights)))

    def any_of(self, names: tuple[str, ...]) -> float:
        """Probability that at least one of these is there."""
        columns = [self.ids.index(name) for name in names]
        return float(self.probability @ self.present[:, columns].any(axis=1))

    @cached_property
    def each(self) -> dict[str, float]:
        """Probability of each unknown to be there, by id."""
        return dict(zip(self.ids, (self.probability @ self.present).tolist(), strict=True))

    @property
    def count(self) -> list[float]:
        """Probabilities that none, one, two, and three or more are there; bends of the width count as part of it."""
        many = np.minimum(self.present[:, [name != BENDS for name in self.ids]].sum(axis=1), 3)
        return [float(p) for p in np.bincount(many, self.probability, minlength=4)]

    @cached_property
    def groups(self) -> list[tuple[str, ...]]:
        """Disjoint groups of ids, the likeliest first in each, of which at least one is there with probability _SURE; a
        group of several means that the data do not tell which."""
        rest = sorted((name for name in self.ids if name != BENDS), key=lambda name: -self.each[name])
        found: list[tuple[str, ...]] = []
        while rest:
            group: tuple[str, ...] = (rest[0],)
            while self.any_of(group) < _SURE and len(group) < min(_TOGETHER, len(rest)):
                others = [name for name in rest if name not in group]
                group = (*group, max(others, key=lambda name: self.any_of((*group, name))))
            if self.any_of(group) < _SURE:
                break
            found.append(group)
            rest = [name for name in rest if name not in group]
        return found


def _log_evidence_against_zero(fitted: Fitted, unknowns: list[Unknown]) -> float:
    """log evidence(all unknowns) - log evidence(these at zero), by the Savage-Dickey ratio of the normal posterior; 0
    where all of them are at an end of their range."""
    places = [int(i) for unknown in unknowns for i in unknown.places if i in fitted.free]
    if not places:
        return 0.0
    mean, covariance = fitted.u[places], fitted.posterior.covariance[np.ix_(places, places)]
    squares = float(mean @ np.linalg.solve(covariance, mean))
    return 0.5 * (squares + float(np.linalg.slogdet(covariance)[1]))
