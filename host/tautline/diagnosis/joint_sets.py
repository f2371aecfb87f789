"""Which of a joint fit's unknowns are present: the posterior over all sets of them, from one fit with all.

The evidence of a set over that of all unknowns is the posterior density of the absent ones at zero over their prior
density there (the Savage-Dickey ratio), which the fit's normal distribution gives in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
import numpy.typing as npt

from tautline.diagnosis.joint import OF_WIDTH, PRESENT, Fitted, Unknown
from tautline.diagnosis.stacked import log_sum

Array = npt.NDArray[np.float64]

_SURE = 0.8  # loss: probability from which a group is named
_MOST = 12  # tolerance: unknowns of which all 4096 sets are compared
_LARGEST_GROUP = 3  # format: unknowns in a group at most: for three the prior alone would say 49 %


@dataclass(frozen=True)
class Sets:
    """The posterior over sets of unknowns."""

    ids: tuple[str, ...]  # of the unknowns that may be there
    present: npt.NDArray[np.bool_]  # (sets, ids) which are in each set
    probability: Array  # (sets,) sum 1

    @classmethod
    def of(cls, unknowns: tuple[Unknown, ...], fitted: Fitted) -> Sets:
        """The posterior over all sets of up to _MOST unknowns. The log-posterior of a set is the evidence that the
        absent unknowns are zero plus, for each of them, the prior log odds of absence (from PRESENT). Of more unknowns,
        those whose own odds are most decided are fixed as present or absent in all sets. Unknowns at an end of their
        range are absent, and not among `ids`."""
        reached = [unknown for unknown in unknowns if np.isin(unknown.places, fitted.free).any()]
        price = np.log((1.0 - PRESENT) / PRESENT)
        odds = {unknown.id: _log_evidence_against_zero(fitted, [unknown]) - price for unknown in reached}
        reached = sorted(reached, key=lambda unknown: -abs(odds[unknown.id]))
        decided, free = reached[:-_MOST], reached[-_MOST:]
        absent = [unknown for unknown in decided if odds[unknown.id] < 0.0]
        present, log = [], []
        for size in range(len(free) + 1):
            for without in combinations(range(len(free)), size):
                present.append([odds[u.id] > 0.0 for u in decided] + [i not in without for i in range(len(free))])
                log_evidence = -_log_evidence_against_zero(fitted, absent + [free[i] for i in without])
                log.append(log_evidence + size * price)
        log_posterior = np.array(log)
        probability = np.exp(log_posterior - log_sum(log_posterior))
        return cls(tuple(unknown.id for unknown in reached), np.array(present, dtype=bool), probability)

    def any_of(self, names: tuple[str, ...]) -> float:
        """Probability that at least one of the unknowns with these ids is present."""
        columns = [self.ids.index(name) for name in names]
        return float(self.probability @ self.present[:, columns].any(axis=1))

    @cached_property
    def by_id(self) -> dict[str, float]:
        """{id of an unknown: probability that it is present}."""
        return dict(zip(self.ids, (self.probability @ self.present).tolist(), strict=True))

    @property
    def count(self) -> list[float]:
        """Probabilities that none, one, two, and three or more unknowns are present; those in OF_WIDTH are not counted,
        as they belong to the width."""
        size = np.minimum(self.present[:, [name not in OF_WIDTH for name in self.ids]].sum(axis=1), 3)
        return [float(p) for p in np.bincount(size, self.probability, minlength=4)]

    @cached_property
    def groups(self) -> list[tuple[str, ...]]:
        """Disjoint groups of ids, each with a probability of at least _SURE that one of its members is present. A group
        of several means that the data do not tell which. Each starts with the likeliest id that is left and is extended
        by the one that helps most, up to _LARGEST_GROUP."""
        rest = sorted((name for name in self.ids if name not in OF_WIDTH), key=lambda name: -self.by_id[name])
        found: list[tuple[str, ...]] = []
        while rest:
            group: tuple[str, ...] = (rest[0],)
            while self.any_of(group) < _SURE and len(group) < min(_LARGEST_GROUP, len(rest)):
                others = [name for name in rest if name not in group]
                group = (*group, max(others, key=lambda name: self.any_of((*group, name))))
            if self.any_of(group) < _SURE:
                break
            found.append(group)
            rest = [name for name in rest if name not in group]
        return found


def _log_evidence_against_zero(fitted: Fitted, unknowns: list[Unknown]) -> float:
    """log evidence(all unknowns) - log evidence(these at zero): the log of prior over posterior density at zero, (mean'
    C^-1 mean + log|C|) / 2, with the posterior's mean and covariance C and a standard normal prior. Unknowns at an end
    of their range are left out; 0 if all are."""
    places = [int(i) for unknown in unknowns for i in unknown.places if i in fitted.free]
    if not places:
        return 0.0
    mean, covariance = fitted.u[places], fitted.posterior.covariance[np.ix_(places, places)]
    squares = float(mean @ np.linalg.solve(covariance, mean))
    return 0.5 * (squares + float(np.linalg.slogdet(covariance)[1]))
