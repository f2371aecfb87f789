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
        """Whichever is likeliest: "none", "unknown" or "effect" (any known one)."""
        return max((self.none, "none"), (self.unknown, "unknown"), (sum(self.leading.values()), "effect"))[1]

    @property
    def ranked(self) -> list[str]:
        """Effects, the likeliest to lead first."""
        return sorted(self.leading, key=lambda name: -self.leading[name])

    def ambiguous(self, covers: float | None = None) -> list[str]:
        """The smallest set of effects whose probabilities of leading sum to a share `covers` of that of any effect, the
        likeliest first. covers: the learnt level by default."""
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
    """The probabilities of none, of unknown and of each effect to lead, and which effects are named. by: the
    hyperparameters, the learnt ones by default."""
    by = by or learnt()
    case = Stacked(evidence)
    weights = Likelihoods(case, by.center)
    p = _posterior(weights)
    best = weights.best

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
        further, *instead = _next_to_name(given, named)
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
        _count_probabilities(case, p),
    )


def _next_to_name(given: Mapping[frozenset[str], float], named: Sequence[str]) -> tuple[str, ...]:
    """The next effect to name beside those named: one whose conditional probability reaches FURTHER, or the smallest
    group of which one is there with that probability, the likeliest first; ("",) where there is none. given: the
    probability of each set of effects that contains those named."""
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


def _count_probabilities(case: Stacked, p: Array) -> tuple[float, ...]:
    """Probabilities of 0, 1, 2 and at least 3 effects; an unknown one counts as one. p: (hypotheses + 1,), the last of
    unknown."""
    many = [min(len(case.leaders[key]), 3) for key in case.sets]
    told = np.bincount(many, p[:-1], minlength=4)
    told[1] += p[-1]
    return tuple(told.tolist())


def probabilities(case: Stacked, effect: str, by: Hyperparameters) -> tuple[float, float, float]:
    """Probabilities of none, of unknown and of `effect` to lead, as `decide` finds them with one set of
    hyperparameters."""
    weights = Likelihoods(case, by)
    p, best = _posterior(weights), weights.best
    leads = (float(p[i]) for key, i in best.items() if effect in key and weights.leader(key, best) == effect)
    return float(p[0]), float(p[-1]), sum(leads)


def _posterior(weights: Likelihoods) -> Array:
    """(hypotheses + 1,) Posterior probability of each hypothesis, and last that of an unknown cause. Of hypotheses with
    the same effects only the best has any."""
    best = list(weights.best.values())
    log = np.full(len(weights.of) + 1, -np.inf)
    log[best] = weights.of[best] + weights.prior[best]
    elsewhere = weights.elsewhere[best] + weights.prior[best]
    log[-1] = log_sum(np.append(elsewhere, weights.unknown + np.log(weights.by.odds_unknown)))
    return np.asarray(np.exp(log - log_sum(log)))


def with_moved(verdict: Decision, parts: Sequence[tuple[str, float]], by: Learnt | None = None) -> Decision:
    """The verdict with parts of the nominal model as the cause, as recalibrating closed the gap: those are named whose
    share is at least MOVED. parts: ids and shares of what was closed. Of the probability of unknown a learnt share
    stays: they may imitate an unknown effect."""
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
    """The verdict without effects that do not lower the held-out loss: one stays only if without it the mean square
    over blocks rises by more than HELPS standard errors. Unknown where none stays. Events are kept, as they have no
    path to be judged by."""
    ids = [h.ids for h in evidence.hypotheses]

    def least(names: Sequence[str]) -> int:
        """Index of the hypothesis of just these effects that leaves the least power; 0, no effect, where none is."""
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
    """For each hypothesis, whether an effect's amplitude differs between places, speeds, times or loads, CLEARLY as a
    wrong effect's does rather than as a right one's."""
    return [bool(says < -np.log(CLEARLY)) for says in Likelihoods(Stacked(evidence), learnt().center).steady]


def is_open(evidence: CaseEvidence, power: Array | float) -> bool:
    """Whether a fit leaves more than the noise and the little that a nominal model leaves where nothing is wrong.
    power: its mean squares, px^2 or deg^2, one or (blocks,)."""
    return float(np.mean(power)) > (1.0 + learnt().center.calibration_excess) * evidence.floor**2
