"""The evidence of a diagnosis: hypotheses of one effect, and of more on top of the likeliest, fitted and judged."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tautline.diagnose import decide, scatter
from tautline.diagnose.candidates import Found, Search
from tautline.diagnose.decide import Evidence, Weighed
from tautline.diagnose.fit import Fit, Fitter
from tautline.effects import BY_ID, EVENTS, Kind

Array = npt.NDArray[np.float64]
Progress = Callable[[float, str], None]

MOST_EFFECTS = 3
_REFITS, _BOTH_SCOPES = 8, 3  # of single effects
_FURTHER_REFITS = 3  # of effects on top of others
_EXTENDED = (2, 1)  # hypotheses of one and of two effects that a further one is put on


@dataclass(frozen=True)
class Gathered:
    evidence: Evidence
    found: list[Found]  # of each of the evidence's hypotheses


def gather(fitter: Fitter, frozen: Sequence[Array], base: Fit, kinds: Sequence[Kind], progress: Progress) -> Gathered:
    """`frozen`: what the calibrated model leaves of each recording as it is. `base`: the recalibrated nominal."""
    steps = [0]

    def told(text: str) -> None:
        steps[0] += 1
        progress(min(1.0, steps[0] / (_REFITS + _BOTH_SCOPES + sum(_EXTENDED) * _FURTHER_REFITS)), text)

    search = Search(fitter, base, kinds, told)
    weighing = _Weighing(search, search.power(frozen))
    weighing.add(search.base, events=True)
    weighing.add_all(search.on_top_of(search.base, _REFITS, _BOTH_SCOPES))
    for size, most in enumerate(_EXTENDED, start=1):
        for _ in range(most):
            below = weighing.next_to_extend(size)
            if below is None:
                break
            weighing.add_all(search.on_top_of(below, _FURTHER_REFITS, 0))
    return Gathered(weighing.evidence(), weighing.found)


class _Weighing:
    def __init__(self, search: Search, frozen: Array) -> None:
        self.search, self._frozen = search, frozen
        self.found: list[Found] = []
        self._weighed: list[Weighed] = []
        self._extended: set[tuple[str, ...]] = set()

    def add(self, found: Found, events: bool = False) -> None:
        """events: with the effects without a path on top of it."""
        self.found.append(found)
        nothing = np.zeros_like(found.power)
        weighed = Weighed(found.ids, found.power, nothing, nothing, found.parameters, beyond=found.beyond)
        self._weighed.append(weighed)
        if not events:
            return
        for only_tests in (False, True):
            said = scatter.of_fit(self.search.fitter, found.fit, self.search.labels, only_tests)
            plain, level = said.loss["as it is"], said.loss["level"]
            rival = min((said.loss[name] for name in scatter.RIVALS), key=lambda loss: float(np.mean(loss)))
            white = float(np.exp(min(0.0, float(np.mean((said.loss["memory"] - level)[level != 0.0])))))
            for kind in self.search.kinds:
                if kind.id in EVENTS and kind.id not in found.ids:
                    amplitude = said.jitter_s if kind.id == "acquisition.jitter" else said.stick
                    beyond = self.search.beyond(found.fit, [kind])
                    fit = _with_event(found.fit, kind, only_tests, amplitude)
                    self.found.append(replace(found, fit=fit, beyond=beyond))
                    self._weighed.append(
                        replace(
                            weighed,
                            ids=(*found.ids, kind.id),
                            scatter=said.loss[kind.id] - plain,
                            rival=rival - plain,
                            parameters=found.parameters + 1,
                            white=white,
                            beyond=beyond,
                        )
                    )

    def add_all(self, found: Sequence[Found]) -> None:
        """Of one size, best first."""
        for i, one in enumerate(found):
            self.add(one, events=i == 0 and len(one.ids) < MOST_EFFECTS)

    def next_to_extend(self, size: int) -> Found | None:
        """The most probable hypothesis of so many effects with a path that has room for a further one, which may well
        account for what their own stages cannot."""
        evidence = self.evidence()
        anyhow = replace(evidence, hypotheses=tuple(replace(h, beyond=None) for h in evidence.hypotheses))
        verdict = decide.decide(anyhow)
        for i in np.argsort(-verdict.posterior):
            one = self.found[i]
            if len(one.ids) != size or one.ids in self._extended or set(one.ids) & EVENTS:
                continue
            self._extended.add(one.ids)
            return one if decide.is_open(evidence, one.power) else None
        return None

    def evidence(self) -> Evidence:
        return Evidence(self.search.fitter.floor, self._frozen, tuple(self._weighed), len(self.search.kinds))


def _with_event(fit: Fit, kind: Kind, only_tests: bool, amplitude: float) -> Fit:
    """The fit as it is: what scatters has no path."""
    values = {**fit.state.values, BY_ID[kind.id].amplitudes[0].name: amplitude}
    return replace(fit, hypothesis=fit.hypothesis.plus(kind, only_tests), state=replace(fit.state, values=values))
