"""From evidence to probabilities and a verdict: a Bayesian comparison of hypotheses by their power on held-out blocks.

No model of an instrument is exact: the right effect leaves a share of what it explains, because reality has other
equations; how much is learnt (hyperparameters.py). An effect leads a set of effects if it is the main cause of the
gap. Pure functions: no fit, no recording, no simulation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tautline.diagnosis.hyperparameters import Hyperparameters, Learnt, learnt
from tautline.diagnosis.hypotheses import CaseEvidence
from tautline.diagnosis.likelihoods import Likelihoods
from tautline.diagnosis.stacked import Stacked, brought_parts, log_sum

Array = npt.NDArray[np.float64]

FURTHER = 2.0 / 3.0  # loss: probability of a further effect from which it is named: a wrong one costs two missed ones
_LARGEST_GROUP = 3  # format: most effects of a group of which one is said to be there
MOVED = 0.2  # loss: share of what a recalibration closes, from which a part of the nominal model is named
CLEARLY = 10.0  # loss: likelihood ratio, wrong effect's over right one's, from which an amplitude is said to vary


@dataclass(frozen=True)
class Decision:
    """The probabilities of what causes the gap, and which effects are named."""

    none: float  # probability that nothing is there but noise and what a calibration leaves
    unknown: float  # probability that the cause is no effect of the library
    leading: Mapping[str, float]  # probability of each effect to lead; with the two above they sum to 1
    posterior: Array  # (hypotheses,); among hypotheses with the same effects only the best one has any
    named: tuple[str, ...]  # the leading effect, and further ones whose probability given those before is FURTHER
    probability: tuple[float, ...]  # of each named one, given those before
    chosen: int  # index of the hypothesis with just the named effects
    brought: tuple[str, ...] = ()  # parts of the nominal model that a named effect changed too: no causes of their own
    alternatives: tuple[str, ...] = ()  # to the last named effect: one of these or it is there
    count: tuple[float, ...] = ()  # probability of 0, 1, 2 and of 3 or more effects; an unknown one counts as one
    unknown_from_start: float = 0.0  # share of `unknown`: it was there while calibrating, nothing changed since

    @property
    def name(self) -> str:
        """The verdict with the largest probability: "none", "unknown" or "effect" (any known one)."""
        return max((self.none, "none"), (self.unknown, "unknown"), (sum(self.leading.values()), "effect"))[1]

    @property
    def ranked(self) -> list[str]:
        """Ids of the effects by their probability to lead, the largest first."""
        return sorted(self.leading, key=lambda name: -self.leading[name])

    def ambiguous(self, covers: float | None = None) -> list[str]:
        """The effects that the recordings cannot tell apart: the smallest set whose probabilities to lead sum to at
        least a share `covers`, 0 to 1, of the sum over all effects; the likeliest first. covers: by default the learnt
        level, with which the set holds the right effect in 95 % of cases."""
        covers = learnt().covers if covers is None else covers
        total, held = sum(self.leading.values()), 0.0
        names: list[str] = []
        for name in self.ranked:
            if names and held >= covers * total:
                break
            names.append(name)
            held += self.leading[name]
        return names


def decide(evidence: CaseEvidence, learned: Learnt | None = None) -> Decision:
    """Works out the verdict: probabilities of none, of unknown and of each effect to lead, and which effects are named.
    learned: the hyperparameters, by default those of the package."""
    learned = learned or learnt()
    case = Stacked(evidence)
    likelihoods = Likelihoods(case, learned.center)
    p, unknown_from_start = _posterior(likelihoods)
    best = likelihoods.best

    leading = dict.fromkeys((name for ids in case.ids for name in ids), 0.0)
    for key, i in best.items():
        if key:
            leading[likelihoods.leader(key, best)] += float(p[i])

    by_set = {key: float(p[i]) for key, i in best.items()}
    named, probability, alternatives = _effects_to_name(leading, by_set)
    parts = brought_parts(named)
    causes = {name: sure for name, sure in zip(named, probability, strict=True) if name not in parts}
    return Decision(
        none=float(p[0]),
        unknown=float(p[-1]),
        leading=leading,
        posterior=p[:-1],
        named=tuple(causes),
        probability=tuple(causes.values()),
        chosen=best.get(frozenset(named), 0),
        brought=tuple(name for name in named if name in parts),
        alternatives=tuple(alternatives) if named and named[-1] not in parts else (),
        count=_count_probabilities(case, p),
        unknown_from_start=unknown_from_start,
    )


def _effects_to_name(
    leading: Mapping[str, float], by_set: Mapping[frozenset[str], float]
) -> tuple[list[str], list[float], list[str]]:
    """(The effects to name, the probability of each given those before it, the alternatives to the last one). The first
    is the effect that is likeliest to lead; `_next_to_name` gives further ones, until it gives none, or a group of
    alternatives. leading: {effect: probability to lead}; by_set: {set of effects: probability}."""
    if not leading:
        return [], [], []
    named = [max(leading, key=lambda name: leading[name])]
    probability = [sum(value for key, value in by_set.items() if named[0] in key)]
    alternatives: list[str] = []
    while not alternatives:
        given = {key: value for key, value in by_set.items() if set(named) <= key}
        further, *alternatives = _next_to_name(given, named)  # alternatives end the search
        if not further:
            break
        named.append(further)
        probability.append(sum(v for key, v in given.items() if further in key) / sum(given.values()))
    return named, probability, alternatives


def _next_to_name(given: Mapping[frozenset[str], float], named: Sequence[str]) -> tuple[str, ...]:
    """The next effect to name: the likeliest further one, if its probability given those named reaches FURTHER;
    otherwise that effect with one or two others, if at least one of the group is there with that probability; ("",) if
    neither. given: probability of each set of effects that contains all of those named."""
    total = sum(given.values())
    likely = dict.fromkeys((name for key in given for name in sorted(key) if name not in named), 0.0)
    for key, value in given.items():
        for name in key - set(named):
            likely[name] += value
    ranked = sorted(likely, key=lambda name: -likely[name])[:_LARGEST_GROUP]
    for size in range(1, len(ranked) + 1):
        any_of_group = sum(value for key, value in given.items() if key & set(ranked[:size]))
        if total > 0.0 and any_of_group >= FURTHER * total:
            return tuple(ranked[:size])
    return ("",)


def _count_probabilities(case: Stacked, p: Array) -> tuple[float, ...]:
    """(4,) Probabilities of 0, 1, 2 and of 3 or more effects; an unknown cause counts as one effect. p: (hypotheses +
    1,), posterior of each hypothesis and, last, of an unknown cause."""
    effects = [min(len(case.leaders[key]), 3) for key in case.sets]
    count = np.bincount(effects, p[:-1], minlength=4)
    count[1] += p[-1]
    return tuple(count.tolist())


def probabilities(case: Stacked, effect: str, hyper: Hyperparameters) -> tuple[float, float, float]:
    """(Probability of none, of unknown, of `effect` to lead), as `decide` finds them with these hyperparameters."""
    likelihoods = Likelihoods(case, hyper)
    p, best = _posterior(likelihoods)[0], likelihoods.best
    leads = (float(p[i]) for key, i in best.items() if effect in key and likelihoods.leader(key, best) == effect)
    return float(p[0]), float(p[-1]), sum(leads)


def _posterior(likelihoods: Likelihoods) -> tuple[Array, float]:
    """((hypotheses + 1,) posterior probability of each hypothesis, likelihood times prior over their sum, and last that
    of an unknown cause: of scatter, of a path, or of what the calibration leaves of itself; the share of the latter).
    Among hypotheses with the same effects only the best has any."""
    best = list(likelihoods.best.values())
    log = np.full(len(likelihoods.log_likelihood) + 1, -np.inf)
    log[best] = likelihoods.log_likelihood[best] + likelihoods.prior[best]
    unknown_scatter = likelihoods.unknown_scatter[best] + likelihoods.prior[best]
    unknown_path = likelihoods.unknown + np.log(likelihoods.hyper.odds_unknown)
    log[-1] = log_sum(np.append(unknown_scatter, unknown_path))
    p = np.exp(log - log_sum(log))
    from_start = likelihoods.unknown_from_start * float(p[0])
    p[0], p[-1] = p[0] - from_start, p[-1] + from_start
    return p, from_start / max(float(p[-1]), 1e-300)


def with_moved(verdict: Decision, parts: Sequence[tuple[str, float]], learned: Learnt | None = None) -> Decision:
    """The verdict for a gap that a recalibration closes: the parts of the nominal model that moved are its cause. They
    take over the probability of unknown, except for the chance that they only imitate another cause, each counting as
    one parameter (`Hyperparameters.mimicked`). Named are those with a share of at least MOVED. parts: (id, share of
    what the recalibration closes, 0 to 1); learned: as in `decide`."""
    certain = 1.0 - float((learned or learnt()).center.mimicked(len(parts)))
    taken = certain * verdict.unknown
    leading = dict(verdict.leading)
    for name, share in parts:
        leading[name] = leading.get(name, 0.0) + share * taken
    named = tuple(name for name, share in parts if share >= MOVED)
    return replace(
        verdict,
        unknown=verdict.unknown - taken,
        leading=leading,
        named=named,
        probability=tuple(certain for _ in named),
        chosen=0,
        brought=(),
        alternatives=(),
    )


def wanders(evidence: CaseEvidence) -> list[bool]:
    """For each hypothesis whether the amplitude of one of its effects varies over place, speed, time, side or load so
    much that it is more than CLEARLY times likelier as a wrong effect's than as a right one's."""
    log_ratios = Likelihoods(Stacked(evidence), learnt().center).log_ratio_of_steadiness  # right over wrong
    return [bool(log_ratio < -np.log(CLEARLY)) for log_ratio in log_ratios]


def is_open(evidence: CaseEvidence, power: Array | float) -> bool:
    """Whether a fit leaves more than the sensor's noise and what a sound calibration leaves: its mean power exceeds (1
    + calibration_excess) floor^2. power: mean squares of the residuals, px^2 or deg^2, one number or (blocks,)."""
    return float(np.mean(power)) > (1.0 + learnt().center.calibration_excess) * evidence.floor**2
