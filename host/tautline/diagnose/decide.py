"""From evidence to probabilities: a comparison of models on blocks of manoeuvres that their fits did not see.

No model of an instrument is exact: the right effect leaves a share of what it explains, because reality has other
equations. So a hypothesis predicts of each block the power floor^2 + left * (power before - floor^2), with `left` drawn
from what right effects leave; an effect that stands in for an unknown one leaves what wrong ones do. A block counts as
few independent observations, whatever its number of frames: what is left of it is one systematic misfit, not noise.
Pure: no fit, no file, no simulation.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import stats
from scipy.special import log_expit, log_ndtr, logsumexp

from tautline.effects import BY_ID, EVENTS, LIBRARY

Array = npt.NDArray[np.float64]

# Set on tuning cases (docs/diagnosis.md).
TELLS = 1.0  # independent observations in a block of misfit
NOISE_TELLS = 10.0  # and in one of noise, or of scatter that forgets
SPREADS = 3.0  # degrees of freedom of a block's own variance: how unlike blocks are
LEFT = 0.05  # share of the power that a right effect may well leave
LEFT_LAW = 1e-4  # that of one with the same equations everywhere, rigid motion and time
LEFT_WRONG = 0.2  # share from which on the best wrong one may well leave any
FOLLOWS = 0.06  # probability that a wrong one leaves no more than a right one
SPREAD = 1.5  # of the logarithm of a share beyond these
ABOVE = 0.1  # what a calibration leaves above the floor in the mean where nothing is wrong, of the floor's power
NONE, UNKNOWN, FURTHER = 30.0, 0.9, 0.05  # prior odds to one effect; of a further effect to none
PRICE = 0.5  # of a parameter, of the Bayesian information criterion's: held-out blocks have charged for most of it
NAMED = 0.5  # probability from which on an effect is named
COVERS = 0.95  # probability that a set of effects that cannot be told apart holds
COINCIDES = 0.1  # probability that an unknown effect goes with a column that was measured beside the motion
MEASURED = frozenset(kind.id for kind in LIBRARY if kind.needs == "load")  # effects that follow such a column
CONSTANT = frozenset(kind.id for kind in LIBRARY if kind.nominal)  # parts of the nominal model
LAWS = frozenset(kind.id for kind in LIBRARY if kind.law)
AHEAD = 5.0  # of every rival, as a logarithm: an event beside another effect that is told for sure
FLOOR_KNOWN, STEADY = 0.2, 0.07  # of the noise power's logarithm: how well a case's is known, and how unlike blocks are
DISTURBED = 0.03  # share of blocks in which something happens that no model has, such as the moment of a shift
MOVED = 0.2  # share of what a recalibration closes from which on a part of it is named
INEXACT = 4.0  # times the floor's power that a nominal model may leave of its own calibration
HELPS = 0.7  # standard errors of the mean over blocks; one block alone that shows an effect is 1
CONFINED = 0.5  # probability that what a wrong effect leaves is confined to its stage as well


@dataclass(frozen=True)
class Beyond:
    """What no law of a hypothesis' stages could leave (confined.py)."""

    power: Array  # (blocks,) mean squares
    count: Array  # (blocks,) of how many numbers


@dataclass(frozen=True)
class Weighed:
    """One hypothesis: effects on top of the recalibrated nominal, in the order they were added; none is the nominal
    alone."""

    ids: tuple[str, ...]
    power: Array  # (blocks,) mean squares that a fit leaves of a block it did not see
    scatter: Array  # (blocks,) logarithm of what an effect without a path takes off as a factor on the power; 0: none
    rival: Array  # (blocks,) the same of the best scatter of another origin
    parameters: int
    white: float = 0.0  # 1: the scatter forgets from frame to frame, 0: it goes on
    beyond: Beyond | None = None  # None: the effects' stages could leave anything

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> Weighed:
        beyond = document["beyond"] and Beyond(**{name: np.array(v) for name, v in document["beyond"].items()})
        arrays = {name: np.array(document[name]) for name in ("power", "scatter", "rival")}
        return cls(**{**document, **arrays, "ids": tuple(document["ids"]), "beyond": beyond})


@dataclass(frozen=True)
class Evidence:
    floor: float  # px or deg
    frozen: Array  # (blocks,) mean squares that the calibrated model leaves as it is
    hypotheses: tuple[Weighed, ...]  # the first without any effect
    applicable: int  # effects of the library that these recordings could show
    calibrated: float = 0.0  # mean square that the calibrated model leaves of its own calibration

    def to_json(self) -> dict[str, Any]:
        """All that `decide` is told: plain, once tautline.plain.plain was applied."""
        return asdict(self)

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> Evidence:
        hypotheses = tuple(Weighed.from_json(h) for h in document["hypotheses"])
        return cls(**{**document, "frozen": np.array(document["frozen"]), "hypotheses": hypotheses})


@dataclass(frozen=True)
class Verdict:
    none: float
    unknown: float
    leading: Mapping[str, float]  # of each effect weighed: that it is the leading one; with the two above they sum to 1
    posterior: Array  # (hypotheses,); of those with the same effects the best alone has any
    named: tuple[str, ...]  # the effects that are more likely there than not, given those before, leading first
    probability: tuple[float, ...]  # of each named one, given those before
    chosen: int  # the hypothesis of the named ones

    @property
    def name(self) -> str:
        return max((self.none, "none"), (self.unknown, "unknown"), (sum(self.leading.values()), "effect"))[1]

    @property
    def ranked(self) -> list[str]:
        """Effects, the likeliest to lead first."""
        return sorted(self.leading, key=lambda name: -self.leading[name])

    def ambiguous(self) -> list[str]:
        """The smallest set of effects that holds COVERS of the probability that any leads."""
        total, held = sum(self.leading.values()), 0.0
        names: list[str] = []
        for name in self.ranked:
            if names and held >= COVERS * total:
                break
            names.append(name)
            held += self.leading[name]
        return names


def decide(evidence: Evidence) -> Verdict:
    weights = _Likelihoods(evidence)
    hypotheses = evidence.hypotheses
    best: dict[frozenset[str], int] = {}
    for i, h in enumerate(hypotheses):
        key = frozenset(h.ids)
        if key not in best or weights.of[i] > weights.of[best[key]]:
            best[key] = i
    log = np.full(len(hypotheses) + 1, -np.inf)
    log[-1] = weights.unknown + np.log(UNKNOWN)
    for key, i in best.items():
        log[i] = weights.of[i] + weights.prior(key)
        log[-1] = np.logaddexp(log[-1], weights.elsewhere[i] + weights.prior(key))
    p = np.exp(log - logsumexp(log))

    leading = dict.fromkeys((name for h in hypotheses for name in h.ids), 0.0)
    first: dict[int, str] = {}
    for key, i in best.items():
        if key:
            alone = [(weights.alone(best.get(frozenset({n})), key), n) for n in key]
            first[i] = max(alone)[1]
            leading[first[i]] += float(p[i])

    named: list[str] = []
    probability: list[float] = []
    if leading:
        named.append(max(leading, key=lambda name: leading[name]))
        probability.append(sum(float(p[i]) for key, i in best.items() if named[0] in key))
    while named:
        given = {key: float(p[i]) for key, i in best.items() if set(named) <= key}
        total = sum(given.values())
        more = {n: sum(v for key, v in given.items() if n in key) for n in leading if n not in named}
        likeliest = max(more, key=lambda name: more[name], default=None)
        if likeliest is None or total <= 0.0 or more[likeliest] < NAMED * total:
            break
        named.append(likeliest)
        probability.append(more[likeliest] / total)
    return Verdict(
        float(p[0]),
        float(p[-1]),
        leading,
        p[:-1],
        tuple(named),
        tuple(probability),
        best.get(frozenset(named), 0),
    )


def with_moved(verdict: Verdict, parts: Sequence[tuple[str, float]]) -> Verdict:
    """Recalibrating closed the gap, so what these parts of the nominal model did (ids with shares) is what was there;
    it may yet stand in for an unknown effect. They are named as the nominal hypothesis has them."""
    told = (1.0 - FOLLOWS) * verdict.unknown
    leading = dict(verdict.leading)
    for name, share in parts:
        leading[name] = leading.get(name, 0.0) + share * told
    named = tuple(name for name, share in parts if share >= MOVED)
    return replace(
        verdict,
        unknown=verdict.unknown - told,
        leading=leading,
        named=named,
        probability=tuple(1.0 - FOLLOWS for _ in named),
        chosen=0,
    )


def that_help(evidence: Evidence, verdict: Verdict) -> Verdict:
    """Only effects without which the model leaves more on blocks that the fits did not see, by more than the blocks
    scatter; unknown where none does. Events have no path to be judged by."""
    ids = [h.ids for h in evidence.hypotheses]

    def least(names: Sequence[str]) -> int:
        same = [i for i, own in enumerate(ids) if set(own) == set(names)]
        return min(same, key=lambda i: float(np.mean(evidence.hypotheses[i].power)), default=0)

    named, chosen, probability = (
        list(verdict.named),
        verdict.chosen,
        dict(zip(verdict.named, verdict.probability, strict=False)),
    )
    for name in reversed(verdict.named if verdict.name == "effect" else ()):
        rest = [other for other in named if other != name]
        without = least(rest)
        if name in EVENTS or (rest and not ids[without]):
            continue
        gained = evidence.hypotheses[without].power - evidence.hypotheses[chosen].power
        if float(np.mean(gained)) <= HELPS * float(np.std(gained)) / np.sqrt(len(gained)):
            named, chosen = rest, without
    if len(named) == len(verdict.named):
        return verdict
    if named:
        return replace(verdict, named=tuple(named), probability=tuple(probability[n] for n in named), chosen=chosen)
    told = sum(verdict.leading.values())
    nothing = dict.fromkeys(verdict.leading, 0.0)
    return replace(verdict, unknown=verdict.unknown + told, leading=nothing, named=(), probability=(), chosen=0)


def is_open(evidence: Evidence, power: Array | float) -> bool:
    """Whether a fit leaves more than the noise and what a nominal model may leave of it."""
    return float(np.mean(power)) > (1.0 + ABOVE) * evidence.floor**2


class _Likelihoods:
    """Logarithms: `of` each hypothesis, of `unknown`, and of scatter of another origin (`elsewhere`) than a hypothesis
    says. A block's residual is Student's t in as many dimensions as it tells: blocks differ from what is predicted."""

    def __init__(self, evidence: Evidence) -> None:
        self._floor2 = evidence.floor**2
        self._applicable = evidence.applicable
        self._before = np.maximum(evidence.hypotheses[0].power - self._floor2, 0.0)
        self._nominal2 = float(np.clip(evidence.calibrated, self._floor2, INEXACT * self._floor2))
        self._tells = TELLS + NOISE_TELLS * np.square(self._floor2 / (self._floor2 + self._before))
        self._price = 0.5 * PRICE * np.log1p(float(np.sum(self._tells)))
        hypotheses = self._hypotheses = evidence.hypotheses
        tables = [self._by_share(h) for h in hypotheses]
        own = [
            float(logsumexp(table + _right(h))) + self._gain(h, h.scatter) if h.ids else self._nothing(evidence.frozen)
            for h, table in zip(hypotheses, tables, strict=True)
        ]
        # Scatter of an event or of another origin: as their likelihoods are.
        other = [self._gain(h, h.rival) - self._gain(h, h.scatter) if h.scatter.any() else -np.inf for h in hypotheses]
        alone = np.array([0.0 if len(h.ids) == 1 else -np.inf for h in hypotheses])
        self.elsewhere = np.array(own) + log_expit(other) + alone
        # Beside another effect an event has to say more than what that one leaves of itself, which remembers too: so
        # much is no sign of either, unless the event is far ahead of it.
        single = [float(np.logaddexp(0.0, more)) for more in other]
        beside = [max(0.0, self._gain(h, h.rival)) if h.scatter.any() else 0.0 for h in hypotheses]
        lost = [b if len(h.ids) > 1 else a for h, a, b in zip(hypotheses, single, beside, strict=True)]
        own = list(np.array(own) - lost)
        far = [
            b if len(h.ids) > 1 and more < -AHEAD else 0.0 for h, b, more in zip(hypotheses, beside, other, strict=True)
        ]
        confined = np.array([self._confined(h) for h in hypotheses])
        self.of = np.array(own) + far + confined
        for i, h in enumerate(hypotheses):
            for j, more in enumerate(hypotheses):
                if len(more.ids) == len(h.ids) + 1 and h.ids and set(h.ids) < set(more.ids):
                    all_of_it = own[j] + (far[j] if h.scatter.any() else 0.0)
                    self.of[i] = max(self.of[i], all_of_it + self._by_chance(h, more) + confined[i])
        self._give_way(hypotheses)
        self.unknown = max(
            self._stands_in(h, table) + (self.prior(h.ids) if h.ids else 0.0)
            for h, table in zip(hypotheses, tables, strict=True)
            if not h.scatter.any()
        )

    def alone(self, i: int | None, key: Collection[str]) -> float:
        """How much a single effect, if it was tried, says of a set that it is in. Of a law nothing may be left, but
        what it leaves beside others is not its own: there the one leads that leaves least."""
        if i is None:
            return -np.inf
        by_power = LAWS & set(key) and not EVENTS & set(key)
        return -float(np.mean(self._hypotheses[i].power)) if by_power else float(self.of[i])

    def _give_way(self, hypotheses: Sequence[Weighed]) -> None:
        """An effect that can do a simpler one's part too says nothing where the simpler one alone leaves no more than a
        right effect may: it is that one, and more of it only beside it."""
        before = max(float(np.mean(self._before)), 1e-300)
        simple = {
            h.ids[0]
            for h in hypotheses
            if len(h.ids) == 1 and float(np.mean(h.power)) - self._floor2 < _most(h.ids) * before
        }
        for i, h in enumerate(hypotheses):
            if len(h.ids) == 1 and simple & set(BY_ID[h.ids[0]].contains):
                self.of[i] = -np.inf

    def _stands_in(self, h: Weighed, table: Array) -> float:
        """For an unknown effect, which now and then it follows as closely as if it were right."""
        follows = np.log(FOLLOWS) + logsumexp(table + _right(h)) if h.ids else -np.inf
        chance = np.log(COINCIDES) if MEASURED & set(h.ids) else 0.0
        return float(chance + np.logaddexp(follows, np.log1p(-FOLLOWS) + logsumexp(table + _wrong())))

    def prior(self, ids: Collection[str]) -> float:
        """Of one hypothesis. Parts of the nominal model move together."""
        effects = len(set(ids) - CONSTANT) + bool(CONSTANT & set(ids))
        if effects == 0:
            return float(np.log(NONE))
        return float((effects - 1) * np.log(FURTHER) - np.log(self._applicable))

    def _by_share(self, h: Weighed) -> Array:
        """Of what is left of each block, at every one of _SHARES. Other parts in the nominal model make it no more
        exact than it was where it was calibrated; more parameters than observations are no freedom."""
        floor2 = self._nominal2 if h.ids and set(h.ids) <= CONSTANT else self._floor2
        predicted = (1.0 + ABOVE) * floor2 + _SHARES[:, None] * self._before
        n = self._tells
        freedom = min(h.parameters, float(np.sum(n)))
        loss = n * np.log(predicted) + (SPREADS + n) * np.log1p(n * h.power / (SPREADS * predicted))
        return np.asarray(-0.5 * np.sum(loss, axis=1) - self._price * freedom)

    def _gain(self, h: Weighed, scatter: Array) -> float:
        return -0.5 * (TELLS + NOISE_TELLS * h.white**2) * float(np.sum(scatter))

    def _confined(self, h: Weighed) -> float:
        """Logarithm of how much likelier what is left beyond the effects' stages is as noise, in all blocks but a few,
        than as what a wrong effect leaves: noise as well, or noise in any share of the blocks only."""
        if h.beyond is None:
            return 0.0
        x = np.log(np.maximum(h.beyond.power / self._floor2, 1e-6))
        spread = np.sqrt(2.0 / np.maximum(h.beyond.count, 1.0) + STEADY**2)
        off = np.linspace(-20.0, 3.0, 116) * FLOOR_KNOWN  # of the case's noise: what rests may well scatter more
        prior = np.where(off > 0.0, -0.5 * np.square(off / FLOOR_KNOWN), -np.abs(off))
        noise = _BLOCK.logpdf((x - off[:, None]) / spread) - np.log(spread)
        more = np.maximum(x - off[:, None], 0.0)
        disturbed = -np.log((more + spread) * np.log1p(_WIDEST / spread))  # as likely any size

        def in_all_but(share: float) -> float:
            each = np.logaddexp(np.log1p(-share) + noise, np.log(share) + disturbed)
            return float(logsumexp(prior + np.sum(each, axis=1)) - logsumexp(prior))

        right = in_all_but(DISTURBED)
        shares = (np.arange(10) + 0.5) / 10.0
        some = float(logsumexp([in_all_but(float(share)) for share in shares]) - np.log(len(shares)))
        return right - float(np.logaddexp(np.log(CONFINED) + right, np.log1p(-CONFINED) + some))

    def _nothing(self, frozen: Array) -> float:
        """The calibrated model as it is leaves noise and little more: a gap that recalibrating closes is a gap, and one
        in a single block too."""
        n = self._tells
        usual = (SPREADS + n) * np.log1p(n / SPREADS)  # where the power is as predicted both agree
        above = -ABOVE * np.log1p(-(np.arange(15) + 0.5) / 15.0)  # quantiles of an exponential prior
        predicted = (1.0 + above[:, None]) * self._floor2
        loss = usual + n * (np.log(predicted) + frozen / predicted - 1.0)
        return float(logsumexp(-0.5 * np.sum(loss, axis=1)) - np.log(len(above)))

    def _by_chance(self, h: Weighed, more: Weighed) -> float:
        """Logarithm of the probability that what a further effect closes is what a right one leaves: that this is so
        much, and that another effect looks so like it (what it closes of it is as likely to be any share)."""
        left = max(float(np.sum(h.power * np.exp(h.scatter) - self._floor2)), 1e-300)
        closed = left - float(np.sum(more.power * np.exp(more.scatter) - self._floor2))
        share = max(closed / max(float(np.sum(self._before)), 1e-300), 1e-12)
        so_much = float(log_ndtr(-(np.log(share) - np.log(_most(h.ids))) / SPREAD))
        return so_much + float(np.log(np.clip(1.0 - closed / left, 0.01, 1.0)))


_SHARES = np.geomspace(1e-5, 1.0, 41)
_BLOCK = stats.t(8.0)
_WIDEST = 12.0  # of a disturbed block's logarithm


def _up_to(most: float) -> Array:
    """Logarithms of _SHARES' probabilities where any magnitude up to `most` may well be left; falling beyond."""
    log: Array = -0.5 * np.square(np.maximum(np.log(_SHARES / most), 0.0) / SPREAD)
    return np.asarray(log - logsumexp(log))


def _right(h: Weighed) -> Array:
    """The same if a hypothesis is right; with scatter, whose power stays, any."""
    return _up_to(1.0 if h.scatter.any() else _most(h.ids))


def _wrong() -> Array:
    """The same if the best effect stands in for another: from LEFT_WRONG any magnitude to 1, and falling below."""
    log: Array = -0.5 * np.square(np.minimum(np.log(_SHARES / LEFT_WRONG), 0.0) / SPREAD)
    return np.asarray(log - logsumexp(log))


def _most(ids: Collection[str]) -> float:
    """The share that these may well leave: as the worst of them."""
    return LEFT_LAW if set(ids) <= LAWS else LEFT
