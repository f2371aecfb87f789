"""What a fleet's rows say: who drifts, which robots and which batch wear sooner, and what is unlike the others.

Robots and batches are named only as long as fewer than half a false name is expected among all that are named, so that
in a fleet of sound robots usually none is named."""

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
    """A robot or a batch that stands out."""

    name: str
    probability: float  # that it stands out: a posterior, or 1 - p of a test
    value: float  # growth of B a session as a share; for robots that are unlike, squared distance over its mean
    sigma: float  # standard deviation of `value`; NaN for robots that are unlike


@dataclass(frozen=True)
class Findings:
    """What the rows of all sessions say of the fleet."""

    robots: int
    sessions: int
    failed: int
    wear: float  # usual growth of B a session, as a share of B; NaN with too few robots
    wear_spread: float  # standard deviation of the growth between robots, as a share of `wear`; NaN likewise
    drifting: tuple[Named, ...]  # robots whose B grows or shrinks beyond doubt; fastest first
    worn: tuple[Named, ...]  # robots of the group that wears sooner; likeliest first
    worn_batches: tuple[Named, ...]  # batches whose robots are of that group; likeliest first
    unlike: tuple[Named, ...]  # robots whose B differs in shape or size from the fleet's; furthest first

    def to_json(self) -> dict[str, Any]:
        """The fields by name, for JSON."""
        return asdict(self)

    def sentences(self) -> list[str]:
        """The findings as sentences for terminal and page: counts, the usual growth of B if it is known, and a sentence
        for each kind of finding that names anyone, with the first _SHOWN names."""
        sessions, robots = count_of(self.sessions, "session"), count_of(self.robots, "robot")
        said = [f"{sessions} of {robots}, {self.failed} without a calibration."]
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


def count_of(count: int, what: str) -> str:
    """A count with its noun, such as "1 robot" or "3 robots"."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


@dataclass(frozen=True)
class _Growth:
    """The growth of B from session to session of n robots. Growth is wear times use, and use is log-normal; so robots
    are compared by the logarithm of growth (`log`), which becomes linear where growth is not larger than its sigma."""

    robot: tuple[str, ...]  # n names
    batch: tuple[str | None, ...]  # n names; None for a robot of no batch
    rate: Array  # (n,) growth a session, as a share of B
    sigma: Array  # (n,) standard deviation of `rate`

    @classmethod
    def of(cls, rows: Sequence[Row]) -> _Growth:
        """The growth of all robots for which it is known (Row.wear is not None), each from the robot's last such
        row."""
        last = {row.robot: row for row in rows if row.wear is not None}
        values = np.array([[row.wear, row.wear_sigma] for row in last.values()], dtype=float).reshape(-1, 2)
        return cls(tuple(last), tuple(row.batch for row in last.values()), values[:, 0], values[:, 1])

    @property
    def usual_sigma(self) -> float:
        """The median of the robots' `sigma`: the growth about which `log` turns from a line into a logarithm."""
        return float(np.median(self.sigma))

    @property
    def log(self) -> Array:
        """(n,) arcsinh(rate / usual_sigma): a logarithm where growth is large, but linear near 0, so that it is defined
        for negative growth too."""
        return np.asarray(np.arcsinh(self.rate / self.usual_sigma))

    @property
    def log_sigma(self) -> Array:
        """(n,) Standard deviations of `log`: `sigma` times the derivative of arcsinh(rate / s), which is
        1 / sqrt(s^2 + rate^2) with s = usual_sigma."""
        return np.asarray(self.sigma / np.hypot(self.usual_sigma, self.rate))


@dataclass(frozen=True)
class _Groups:
    """A mixture of two normal distributions of _Growth.log: the first is of usual robots, the second of robots that
    wear sooner."""

    usual_mean: float  # of the first
    spread: float  # standard deviation of each
    shift: float  # mean of the second minus mean of the first, > 0
    odds: float  # prior log odds that a robot is of the second; minus infinity: there is no second

    def log_odds(self, growth: _Growth) -> Array:
        """(n,) For each robot the logarithm of its likelihood in the second group over that in the first; the prior
        `odds` are not added."""
        sigma = np.hypot(self.spread, growth.log_sigma)
        second = norm.logpdf(growth.log, self.usual_mean + self.shift, sigma)
        return np.asarray(second - norm.logpdf(growth.log, self.usual_mean, sigma))


def findings(rows: Sequence[Row]) -> Findings:
    """Finds the drifting robots, the worn robots and batches, and the robots that are unlike the others. rows: of all
    sessions, with the columns that `changes.with_changes` fills."""
    with threadpool_limits(1, "blas"):  # small systems: more threads would only wait for each other
        return _findings(rows)


def _findings(rows: Sequence[Row]) -> Findings:
    """Does the work of `findings`, without its limit of BLAS threads."""
    growth = _Growth.of(rows)
    groups = _fit_groups(growth)
    worn: list[Named] = []
    batches: list[Named] = []
    if groups is not None and np.isfinite(groups.odds):
        odds = groups.log_odds(growth)
        worn = _name_likely(growth.robot, expit(odds + groups.odds), growth.rate, growth.sigma)
        batches = _worn_batches(growth, odds, groups.odds)
    return Findings(
        robots=len({row.robot for row in rows}),
        sessions=len(rows),
        failed=sum(row.verdict == FAILED for row in rows),
        wear=growth.usual_sigma * float(np.sinh(groups.usual_mean)) if groups else float("nan"),  # undoes _Growth.log
        wear_spread=groups.spread if groups else float("nan"),
        drifting=tuple(sorted(_drifting_robots(growth), key=lambda one: -abs(one.value))),
        worn=tuple(worn),
        worn_batches=tuple(batches),
        unlike=tuple(_unlike_robots(rows)),
    )


def _drifting_robots(growth: _Growth) -> list[Named]:
    """The robots whose growth differs from 0, in the order of `growth`. A two-sided normal test of rate / sigma gives
    p-values; a robot is named where p times the number of robots (Bonferroni) is below _FALSE."""
    if not len(growth.rate):
        return []
    p_values = 2.0 * norm.sf(np.abs(growth.rate) / growth.sigma)
    return [
        Named(name, float(1.0 - p), float(rate), float(sigma))
        for name, p, rate, sigma in zip(growth.robot, p_values, growth.rate, growth.sigma, strict=True)
        if p * len(p_values) < _FALSE
    ]


def _name_likely(names: Sequence[str], probability: Array, value: Array, sigma: Array) -> list[Named]:
    """The likeliest of n names, likeliest first: as many of them as keep the expected number of false names, the sum of
    1 - probability, below _FALSE. names (n,); probability (n,) that each is right; value, sigma (n,): what is said of
    each."""
    order = np.argsort(-probability, kind="stable")
    expected_false = np.cumsum(1.0 - probability[order])  # among the first 1, 2, ... names
    keep = order[: int(np.sum(expected_false < _FALSE))]
    return [Named(names[k], float(probability[k]), float(value[k]), float(sigma[k])) for k in keep]


def _worn_batches(growth: _Growth, odds: Array, prior: float) -> list[Named]:
    """The batches that are likely to belong to the group that wears sooner, each as a whole: its log odds are `prior`,
    the group's prior log odds, plus the sum of its robots' `odds` (n,), the log-likelihood ratios of _Groups.log_odds.
    Empty with fewer than two batches, as there is nothing to compare with. A value is the batch's mean growth."""
    names = sorted({batch for batch in growth.batch if batch is not None})
    if len(names) < 2:
        return []
    members = [np.array([batch == name for batch in growth.batch]) for name in names]  # masks over robots
    probability = np.array([expit(prior + float(odds[own].sum())) for own in members])
    rate = np.array([growth.rate[own].mean() for own in members])
    # Sigma of each mean. The scatter of a single robot would be 0, so it is at least the rms of the stated sigmas.
    scatter = [max(growth.rate[own].std(), np.sqrt(np.mean(growth.sigma[own] ** 2))) for own in members]
    sigma = np.array([each / np.sqrt(own.sum()) for each, own in zip(scatter, members, strict=True)])
    return _name_likely(names, probability, rate, sigma)


def _fit_groups(growth: _Growth) -> _Groups | None:
    """Fits the mixture of usual and worn robots by maximum posterior. Returns a single group (odds of minus infinity)
    unless two groups raise the log posterior by more than log(n), which is what their two further parameters cost by
    Schwarz' criterion (BIC). None for fewer than _FEWEST robots."""
    if len(growth.rate) < _FEWEST:
        return None
    middle = float(np.median(growth.log))
    # The parameters x are in this unit, the robust standard deviation of the logarithms.
    unit = max(spread.deviation(growth.log - middle), 1e-3)

    def groups_at(x: Array) -> _Groups:
        """The groups for the parameters x (4,): the first group's mean minus `middle`, in `unit`; log(spread / unit);
        log(d / unit), where the second group's mean is _APART spreads plus d above the first's; and the log odds."""
        own_spread = unit * np.exp(x[1])
        shift = _APART * own_spread + unit * np.exp(x[2])
        return _Groups(usual_mean=middle + unit * x[0], spread=own_spread, shift=shift, odds=float(x[3]))

    # The prior of both costs: log(spread / unit), which is x[1], is standard normal.
    def cost_of_one(x: Array) -> float:
        """Minus the log posterior of a single group; x (2,): the first two parameters of `groups_at`."""
        sigma = np.hypot(unit * np.exp(x[1]), growth.log_sigma)
        return 0.5 * float(x[1]) ** 2 - float(norm.logpdf(growth.log, middle + unit * x[0], sigma).sum())

    def cost_of_two(x: Array) -> float:
        """Minus the log posterior of two groups; x (4,) as in `groups_at`."""
        groups = groups_at(x)
        # log p = log p1 + log(w1 + w2 p2 / p1), with the groups' weights w1 = 1 - w2 by the log odds
        first = norm.logpdf(growth.log, groups.usual_mean, np.hypot(groups.spread, growth.log_sigma))
        mixed = np.logaddexp(log_expit(-groups.odds), groups.log_odds(growth) + log_expit(groups.odds))
        return 0.5 * float(x[1]) ** 2 - float((first + mixed).sum())

    # tolerance: bounds of the search; starts combine a near and a far second group with few and many worn robots.
    one = minimize(cost_of_one, np.zeros(2), method="L-BFGS-B", bounds=[(-9.0, 9.0)] * 2)
    bounds = [(-9.0, 9.0), (-4.0, 4.0), (-4.0, 4.0), (-12.0, 0.0)]
    starts = [np.array([0.0, 0.0, np.log(far), odds]) for far in (1.0, 4.0, 12.0) for odds in (-4.0, -1.5)]
    fits = [minimize(cost_of_two, start, method="L-BFGS-B", bounds=bounds) for start in starts]
    two = min(fits, key=lambda fit: fit.fun)
    if one.fun - two.fun > np.log(len(growth.rate)):
        return groups_at(two.x)
    return replace(groups_at(np.array([*one.x, 0.0, 0.0])), odds=-np.inf)


def _unlike_robots(rows: Sequence[Row]) -> list[Named]:
    """The robots whose B, by their last usable session, is further from the fleet's mean than chance explains, furthest
    first: p-values by the fleet's distribution of B, p times the number of robots (Bonferroni) below _FALSE. A value is
    the squared Mahalanobis distance over the number of places. Empty where too few robots are calibrated."""
    try:
        curves = log_widths(list({row.robot: row for row in rows if row.usable}.values()))
    except TautError:  # too few robots: nothing is usual
        return []
    spread_of_fleet = population(curves)
    p_values = spread_of_fleet.chance(curves)
    distance = spread_of_fleet.distance(curves) / np.maximum(curves.dimensions, 1.0)
    found = [
        Named(name, float(1.0 - p), float(d), float("nan"))
        for name, p, d in zip(curves.names, p_values, distance, strict=True)
        if p * len(p_values) < _FALSE
    ]
    return sorted(found, key=lambda one: -one.value)
