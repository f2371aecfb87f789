"""From evidence to probabilities: a comparison of models on blocks of manoeuvres that their fits did not see.

No model of an instrument is exact: the right effect leaves a share of what it explains, because reality has other
equations; how much is learnt (hyperparameters.py). Pure: no fit, no recording, no simulation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tautline.diagnosis.hyperparameters import Hyperparameters, Learnt, learnt
from tautline.diagnosis.hypotheses import CaseEvidence
from tautline.diagnosis.likelihoods import Likelihoods
from tautline.diagnosis.stacked import Stacked, brought, log_sum
from tautline.effects import EVENTS

Array = npt.NDArray[np.float64]

# Of a further effect, given those before: naming a wrong one costs as much as leaving two right ones out.
FURTHER = 2.0 / 3.0
_ONE_OF = 3  # format: effects at most that are named as one of them
MOVED = 0.2  # loss: share of what a recalibration closes from which on a part of it is named
CLEARLY = 10.0  # loss: times likelier as a wrong effect's, from which an amplitude is told to be another elsewhere
HELPS = 0.7  # loss: standard errors of the mean over blocks; one block alone that shows an effect is 1


@dataclass(frozen=True)
class Decision:
    none: float
    unknown: float
    leading: Mapping[str, float]  # of each effect weighed: that it is the leading one; with the two above they sum to 1
    posterior: Array  # (hypotheses,); of those with the same effects the best alone has any
    named: tuple[str, ...]  # the leading effect, and those that are surely there given those before
    probability: tuple[float, ...]  # of each named one, given those before
    chosen: int  # the hypothesis of the named ones
    brought: tuple[
        str, ...
    ] = ()  # parts of the nominal model in it that a named effect moved too: no causes of their own
    instead: tuple[str, ...] = ()  # any of these may be there in the last named one's place: it is one of them
    count: tuple[float, ...] = ()  # probability of 0, 1, 2 and of 3 or more effects; an unknown one is one

    @property
    def name(self) -> str:
        return max((self.none, "none"), (self.unknown, "unknown"), (sum(self.leading.values()), "effect"))[1]

    @property
    def ranked(self) -> list[str]:
        """Effects, the likeliest to lead first."""
        return sorted(self.leading, key=lambda name: -self.leading[name])

    def ambiguous(self, covers: float | None = None) -> list[str]:
        """The smallest set of effects that holds `covers` (what is learnt unless told) of the probability that any
        leads."""
        covers = learnt().covers if covers is None else covers
        total, held = sum(self.leading.values()), 0.0
        names: list[str] = []
        for name in self.ranked:
            if names and held >= covers * total:
                break
            names.append(name)
            held += self.leading[name]
        return names


def decide(evidence: CaseEvidence, by: Learnt | None = None) -> Decision:
    """by: what is learnt unless told; over what instruments may have of it probabilities are averaged."""
    by = by or learnt()
    case = Stacked(evidence)
    weights = Likelihoods(case, by.center)
    of_draws = [Likelihoods(case, drawn) for drawn in by.draws()] if by.spread.any() else [weights]
    p = np.mean([_posterior(drawn) for drawn in of_draws], axis=0)
    best = {key: max(of, key=lambda i: (p[i], weights.of[i])) for key, of in case.same.items()}
    for key, of in case.same.items():
        p[best[key]], p[[i for i in of if i != best[key]]] = p[of].sum(), 0.0

    leading = dict.fromkeys((name for ids in case.ids for name in ids), 0.0)
    for key, i in best.items():
        if key:
            leading[weights.leader(key, best)] += float(p[i])

    named: list[str] = []
    probability: list[float] = []
    if leading:
        named.append(max(leading, key=lambda name: leading[name]))
        probability.append(sum(float(p[i]) for key, i in best.items() if named[0] in key))
    instead: list[str] = []
    while named and not instead:
        given = {key: float(p[i]) for key, i in best.items() if set(named) <= key}
        further, *instead = _one_of(given, named)
        if not further:
            break
        named.append(further)
        probability.append(sum(v for key, v in given.items() if further in key) / sum(given.values()))
    with_them = brought(named)
    causes = {name: sure for name, sure in zip(named, probability, strict=True) if name not in with_them}
    return Decision(
        float(p[0]),
        float(p[-1]),
        leading,
        p[:-1],
        tuple(causes),
        tuple(causes.values()),
        best.get(frozenset(named), 0),
        tuple(name for name in named if name in with_them),
        tuple(instead) if named and named[-1] not in with_them else (),
        _count(case, p),
    )


def _one_of(given: Mapping[frozenset[str], float], named: Sequence[str]) -> tuple[str, ...]:
    """The effect that is surely there beside those named, or the fewest of which one is, the likeliest first; ("",)
    where that is not so sure. given: probabilities of sets that hold those named."""
    total = sum(given.values())
    likely = dict.fromkeys((name for key in given for name in sorted(key) if name not in named), 0.0)
    for key, value in given.items():
        for name in key - set(named):
            likely[name] += value
    ranked = sorted(likely, key=lambda name: -likely[name])[:_ONE_OF]
    for many in range(1, len(ranked) + 1):
        any_of = sum(value for key, value in given.items() if key & set(ranked[:many]))
        if total > 0.0 and any_of >= FURTHER * total:
            return tuple(ranked[:many])
    return ("",)


def _count(case: Stacked, p: Array) -> tuple[float, ...]:
    many = [min(len(case.leaders[key]), 3) for key in case.sets]
    told = np.bincount(many, p[:-1], minlength=4)
    told[1] += p[-1]
    return tuple(told.tolist())


def probabilities(case: Stacked, effect: str, by: Hyperparameters) -> tuple[float, float, float]:
    """Of none, of unknown, and of `effect` to lead, as `decide` has them of one instrument."""
    weights = Likelihoods(case, by)
    p, best = _posterior(weights), weights.best
    leads = (float(p[i]) for key, i in best.items() if effect in key and weights.leader(key, best) == effect)
    return float(p[0]), float(p[-1]), sum(leads)


def _posterior(weights: Likelihoods) -> Array:
    """Of each hypothesis, the best of the same effects, and at the end of none that was tried: (hypotheses + 1,)."""
    best = list(weights.best.values())
    log = np.full(len(weights.of) + 1, -np.inf)
    log[best] = weights.of[best] + weights.prior[best]
    elsewhere = weights.elsewhere[best] + weights.prior[best]
    log[-1] = log_sum(np.append(elsewhere, weights.unknown + np.log(weights.by.odds_unknown)))
    return np.asarray(np.exp(log - log_sum(log)))


def with_moved(verdict: Decision, parts: Sequence[tuple[str, float]], by: Learnt | None = None) -> Decision:
    """Recalibrating closed the gap, so what these parts of the nominal model did (ids with shares) is what was there;
    it may yet stand in for an unknown effect. They are named as the nominal hypothesis has them."""
    certain = 1.0 - (by or learnt()).center.mimics
    told = certain * verdict.unknown
    leading = dict(verdict.leading)
    for name, share in parts:
        leading[name] = leading.get(name, 0.0) + share * told
    named = tuple(name for name, share in parts if share >= MOVED)
    return replace(
        verdict,
        unknown=verdict.unknown - told,
        leading=leading,
        named=named,
        probability=tuple(certain for _ in named),
        chosen=0,
        brought=(),
        instead=(),
    )


def that_help(evidence: CaseEvidence, verdict: Decision) -> Decision:
    """Only effects without which the model leaves more on blocks that the fits did not see, by more than the blocks
    scatter; unknown where none does. Events have no path to be judged by."""
    ids = [h.ids for h in evidence.hypotheses]

    def least(names: Sequence[str]) -> int:
        same = [i for i, own in enumerate(ids) if set(own) == set(names)]
        return min(same, key=lambda i: float(np.mean(evidence.hypotheses[i].power)), default=0)

    named, with_them, chosen = list(verdict.named), list(verdict.brought), verdict.chosen
    probability = dict(zip(verdict.named, verdict.probability, strict=False))
    for name in reversed(verdict.named if verdict.name == "effect" else ()):
        rest = [other for other in named if other != name]
        kept = [other for other in with_them if other in brought([*rest, other])]
        without = least([*rest, *kept])
        if name in EVENTS or (rest and not ids[without]):
            continue
        gained = evidence.hypotheses[without].power - evidence.hypotheses[chosen].power
        if float(np.mean(gained)) <= HELPS * float(np.std(gained)) / np.sqrt(len(gained)):
            named, chosen, with_them = rest, without, kept
    if len(named) == len(verdict.named):
        return verdict
    if named[-1:] != [*verdict.named[-1:]]:
        verdict = replace(verdict, instead=())
    if named:
        sure = tuple(probability[name] for name in named)
        return replace(verdict, named=tuple(named), probability=sure, chosen=chosen, brought=tuple(with_them))
    told = sum(verdict.leading.values())
    nothing = dict.fromkeys(verdict.leading, 0.0)
    return replace(
        verdict, unknown=verdict.unknown + told, leading=nothing, named=(), probability=(), chosen=0, brought=()
    )


def wanders(evidence: CaseEvidence) -> list[bool]:
    """Of each hypothesis, whether an effect's amplitude is clearly another elsewhere, as a wrong one's rather than as a
    right one's."""
    return [bool(says < -np.log(CLEARLY)) for says in Likelihoods(Stacked(evidence), learnt().center).steady]


def is_open(evidence: CaseEvidence, power: Array | float) -> bool:
    """Whether a fit leaves more than the noise and what a nominal model may leave of it."""
    return float(np.mean(power)) > (1.0 + learnt().center.calibration_excess) * evidence.floor**2
