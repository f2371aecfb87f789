"""What a fleet's rows say: who drifts, which robots and which batch wear sooner, and what is unlike the others.

Names are given while fewer than half a false one is expected among all that are named, so that a fleet of sound robots
names none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize
from scipy.special import expit, log_expit
from scipy.stats import norm
from threadpoolctl import threadpool_limits

from tautline import spread
from tautline.errors import TautError
from tautline.fleet.population import log_widths, population
from tautline.fleet.rows import FAILED, Row

Array = npt.NDArray[np.float64]

_FALSE = 0.5  # loss: expected among all that are named
_APART = 2.0  # equation: spreads: nearer together, two normal distributions of one spread have one mode
_FEWEST = 4  # tolerance: robots of whom growth is known, to speak of groups
_SHOWN = 8  # display: names in a sentence


@dataclass(frozen=True)
class Named:
    """A robot or a batch, and how likely it is what it is named as."""

    name: str
    probability: float
    value: float  # growth of B a session, or squared distance over its mean
    sigma: float


@dataclass(frozen=True)
class Findings:
    robots: int
    sessions: int
    failed: int
    wear: float  # usual growth of B a session, as a share
    wear_spread: float  # between robots, as a share of it
    drifting: tuple[Named, ...]  # B grows or shrinks, beyond doubt; fastest first
    worn: tuple[Named, ...]  # of a group that wears sooner
    worn_batches: tuple[Named, ...]
    unlike: tuple[Named, ...]  # B's shape or size is no other robot's

    def to_json(self) -> dict[str, Any]:
        return asdict(self)

    def sentences(self) -> list[str]:
        """The findings in sentences, the most urgent first."""
        made, of = counted(self.sessions, "session"), counted(self.robots, "robot")
        said = [f"{made} of {of}, {self.failed} without a calibration."]
        if np.isfinite(self.wear):
            goes = "grows" if self.wear >= 0.0 else "shrinks"
            more = f"by {100 * self.wear_spread:.0f} % more or less of that"
            said.append(f"B {goes} by {100 * abs(self.wear):.2g} % a session, {more}.")
        for names, words in (
            (self.drifting, "B changes for certain in {}"),
            (self.worn, "Worn sooner than the others: {}"),
            (self.worn_batches, "Worn batches: {}"),
            (self.unlike, "B is unlike the others': {}"),
        ):
            if names:
                shown = ", ".join(each.name for each in names[:_SHOWN])
                more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
                said.append(words.format(f"{len(names)}: {shown}{more}."))
        return said


def counted(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


@dataclass(frozen=True)
class _Growth:
    """Growth of B a session by robot, (n,). It is wear times use, and use is log-normal: `log` is its logarithm, going
    over into a straight line where growth is no more than its sigma; so that the spread is that of use."""

    robot: tuple[str, ...]
    batch: tuple[str | None, ...]
    rate: Array
    sigma: Array

    @classmethod
    def of(cls, rows: Sequence[Row]) -> _Growth:
        """The growth of all robots of which it is known, from their last rows that state it."""
        last = {row.robot: row for row in rows if row.wear is not None}
        values = np.array([[row.wear, row.wear_sigma] for row in last.values()], dtype=float).reshape(-1, 2)
        return cls(tuple(last), tuple(row.batch for row in last.values()), values[:, 0], values[:, 1])

    @property
    def usual_sigma(self) -> float:
        """The median standard deviation of a growth a session: where `log` goes over into a straight line."""
        return float(np.median(self.sigma))

    @property
    def log(self) -> Array:
        """(n,) arcsinh(growth / usual_sigma): a logarithm where growth is large, straight about 0, where it may be
        negative."""
        return np.asarray(np.arcsinh(self.rate / self.usual_sigma))

    @property
    def log_sigma(self) -> Array:
        """Standard deviations (n,) of `log`: the rates', times its derivative by them."""
        return np.asarray(self.sigma / np.hypot(self.usual_sigma, self.rate))


@dataclass(frozen=True)
class _Groups:
    """Two normal distributions of the logarithm of growth, of one spread; `odds`: log odds of the second."""

    usual: float
    spread: float
    sooner: float  # by so much the second is later
    odds: float

    def log_odds(self, growth: _Growth) -> Array:
        """(n,) For each robot the log-likelihood ratio of being of the second group, by the data alone, without prior
        odds."""
        sigma = np.hypot(self.spread, growth.log_sigma)
        second = norm.logpdf(growth.log, self.usual + self.sooner, sigma)
        return np.asarray(second - norm.logpdf(growth.log, self.usual, sigma))


def findings(rows: Sequence[Row]) -> Findings:
    """What a run finds in the rows of all sessions, as it ends with them."""
    with threadpool_limits(1, "blas"):  # its systems are small
        return _findings(rows)


def _findings(rows: Sequence[Row]) -> Findings:
    """Findings from the rows of all sessions."""
    growth = _Growth.of(rows)
    groups = _groups(growth)
    worn: list[Named] = []
    batches: list[Named] = []
    if groups is not None and np.isfinite(groups.odds):
        odds = groups.log_odds(growth)
        each = expit(odds + groups.odds)
        worn = _named(growth.robot, each, growth.rate, growth.sigma)
        batches = _batches(growth, odds, groups.odds)
    certain = 2.0 * norm.sf(np.abs(growth.rate) / growth.sigma) if len(growth.rate) else np.zeros(0)
    drifting = [
        Named(name, float(1.0 - p), float(rate), float(sigma))
        for name, p, rate, sigma in zip(growth.robot, certain, growth.rate, growth.sigma, strict=True)
        if p * len(certain) < _FALSE
    ]
    return Findings(
        robots=len({row.robot for row in rows}),
        sessions=len(rows),
        failed=sum(row.verdict == FAILED for row in rows),
        wear=growth.usual_sigma * float(np.sinh(groups.usual)) if groups else float("nan"),
        wear_spread=groups.spread if groups else float("nan"),
        drifting=tuple(sorted(drifting, key=lambda one: -abs(one.value))),
        worn=tuple(worn),
        worn_batches=tuple(batches),
        unlike=tuple(_unlike(rows)),
    )


def _named(names: Sequence[str], probability: Array, value: Array, sigma: Array) -> list[Named]:
    """The likeliest of these, as many as leave the expected number of false ones below _FALSE. probability, value,
    sigma (n,)."""
    order = np.argsort(-probability, kind="stable")
    false = np.cumsum(1.0 - probability[order])
    keep = order[: int(np.sum(false < _FALSE))]
    return [Named(names[k], float(probability[k]), float(value[k]), float(sigma[k])) for k in keep]


def _batches(growth: _Growth, odds: Array, prior: float) -> list[Named]:
    """Batches all of whose robots are more likely of the second group than of the first. odds (n,): of each robot by
    the data; prior: log odds of the second group."""
    names = sorted({batch for batch in growth.batch if batch is not None})
    if len(names) < 2:
        return []
    of = [np.array([batch == name for batch in growth.batch]) for name in names]
    probability = np.array([expit(prior + float(odds[own].sum())) for own in of])
    rate = np.array([growth.rate[own].mean() for own in of])
    scatter = [max(growth.rate[own].std(), np.sqrt(np.mean(growth.sigma[own] ** 2))) for own in of]  # 0 of one robot
    sigma = np.array([each / np.sqrt(own.sum()) for each, own in zip(scatter, of, strict=True)])
    return _named(names, probability, rate, sigma)


def _groups(growth: _Growth) -> _Groups | None:
    """The likeliest groups; one alone (odds of minus infinity) unless two are likelier by more than their two further
    numbers are worth (Schwarz). None where too few robots tell."""
    if len(growth.rate) < _FEWEST:
        return None
    middle = float(np.median(growth.log))
    apart = max(spread.deviation(growth.log - middle), 1e-3)

    def read(x: Array) -> _Groups:
        """The groups by x (4,), lengths over `apart`: usual log growth less the median, log of the spread, log of how
        much later than _APART spreads the second group is; log odds."""
        own = apart * np.exp(x[1])
        return _Groups(middle + apart * x[0], own, _APART * own + apart * np.exp(x[2]), float(x[3]))

    def one(x: Array) -> float:  # the spread is about what the median deviation says, within a factor of e
        """Minus the log posterior of one group, x (2,) as in `read`."""
        sigma = np.hypot(apart * np.exp(x[1]), growth.log_sigma)
        return 0.5 * float(x[1]) ** 2 - float(norm.logpdf(growth.log, middle + apart * x[0], sigma).sum())

    def two(x: Array) -> float:
        """Minus the log posterior of two groups, x (4,) as in `read`."""
        groups = read(x)
        usual = norm.logpdf(growth.log, groups.usual, np.hypot(groups.spread, growth.log_sigma))
        both = np.logaddexp(log_expit(-groups.odds), groups.log_odds(growth) + log_expit(groups.odds))
        return 0.5 * float(x[1]) ** 2 - float((usual + both).sum())

    single = minimize(one, np.zeros(2), method="L-BFGS-B", bounds=[(-9.0, 9.0)] * 2)
    bounds = [(-9.0, 9.0), (-4.0, 4.0), (-4.0, 4.0), (-12.0, 0.0)]
    starts = [np.array([0.0, 0.0, np.log(far), odds]) for far in (1.0, 4.0, 12.0) for odds in (-4.0, -1.5)]
    best = min((minimize(two, start, method="L-BFGS-B", bounds=bounds) for start in starts), key=lambda fit: fit.fun)
    if single.fun - best.fun > np.log(len(growth.rate)):
        return read(best.x)
    return replace(read(np.array([*single.x, 0.0, 0.0])), odds=-np.inf)


def _unlike(rows: Sequence[Row]) -> list[Named]:
    """Robots whose last usable session is too far off the fleet's B."""
    try:
        curves = log_widths(list({row.robot: row for row in rows if row.usable}.values()))
    except TautError:  # too few robots: nothing is usual
        return []
    known = population(curves)
    chance = known.chance(curves)
    far = known.distance(curves) / np.maximum(curves.told, 1.0)
    found = [
        Named(name, float(1.0 - p), float(d), float("nan"))
        for name, p, d in zip(curves.names, chance, far, strict=True)
        if p * len(chance) < _FALSE
    ]
    return sorted(found, key=lambda one: -one.value)
