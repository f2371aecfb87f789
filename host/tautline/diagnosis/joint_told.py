"""A joint fit of a simulator's unknowns as a diagnosis: what is named, what it leaves, the corrected model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline import effects
from tautline.diagnosis import decide, flexible, gap, repeated, shapley
from tautline.diagnosis.diagnose import Diagnosis
from tautline.diagnosis.hyperparameters import learnt
from tautline.diagnosis.joint import BENDS, DELAY, LAW, SPEED, WIDTH, Fitted, Joint
from tautline.diagnosis.joint_sets import Sets
from tautline.model import Model

Array = npt.NDArray[np.float64]

_ANOTHER_TIME = 0.3  # prior: share by which a joint's friction is another in another recording: heat, load, grease


@dataclass(frozen=True)
class Answer:
    """A joint fit with what it is worth beside the diagnosis that is there."""

    joint: Joint
    fitted: Fitted
    sets: Sets
    left: list[Array]  # of each recording, (scored, k), of blocks that the fit did not see

    @classmethod
    def of(cls, joint: Joint, fitted: Fitted) -> Answer:
        """With the sets' posterior and the held-out residuals of a joint fit."""
        return cls(joint, fitted, Sets.of(joint.unknowns, fitted), held_out_residuals(joint, fitted))

    def corrected_model(self) -> Model:
        """The model with all unknowns as fitted; its c_sigma, deg, is the law's posterior spread, its width_sigma, unit
        of q, the rms by which friction may be another time, 0 as far as the width is slack; its evidence what a reading
        of an unseen motion is off by."""
        joint, fitted = self.joint, self.fitted
        names = [fitted.posterior.names[i] for i in joint.places[LAW]]
        c_sigma = fitted.posterior.marginal(names).spread(joint.law_slopes())
        before = gap.rms(joint.residuals(np.zeros(joint.size)))
        noise = gap.unseen(before, gap.rms(self.left), joint.floor, learnt().elsewhere)
        model = joint.model_at(fitted.u)
        return replace(
            model,
            width_sigma=_ANOTHER_TIME * np.sqrt(self._is_friction) * model.width,
            c_sigma=c_sigma,
            extra={**model.extra, "evidence": {"residual": noise}},
        )

    @property
    def _is_friction(self) -> float:
        """Probability that the width is friction's: it goes with speed or place, as slack in gears does not."""
        names = tuple(name for name in (SPEED, BENDS) if name in self.sets.ids)
        return self.sets.any_of(names) if names else 0.0

    def shares(self, names: Sequence[str], before: float) -> list[float]:
        """Exact Shapley share of each named unknown of the shrinkage, by the linearised fit with the unnamed at zero.
        before: rms."""

        def worth(there: frozenset[str]) -> float:
            """Shrinkage of the rms with these unknowns alone."""
            on = np.zeros(self.joint.size, dtype=bool)
            for name in there:
                on[self.joint.places[name]] = True
            off = np.where(on, 0.0, self.fitted.u)
            pairs = zip(self.fitted.residuals, self.fitted.slopes, strict=True)
            return 1.0 - gap.rms([residual + slope @ off for residual, slope in pairs]) / before

        return shapley.shares(names, worth)

    def parameter_values(self, name: str) -> dict[str, float]:
        """The fitted parameters of one effect as diagnosis.json reports them."""
        added = {effect.id: dict(effect.parameters) for effect in self.joint.effects(self.fitted.u)}
        model = self.joint.model_at(self.fitted.u)
        own = {
            WIDTH: {"width_everywhere": float(np.max(model.width - self.joint.model.width))},
            DELAY: {"delay": model.delay_s - self.joint.model.delay_s},
        }
        return {**(own | added).get(name, {}), "since_calibration": 1.0}


def held_out_residuals(joint: Joint, fitted: Fitted) -> list[Array]:
    """(scored, k) for each recording: the residual of every block of manoeuvres by a fit without it, from one linear
    step as in heldout.py; the prior holds what the block alone shows."""
    free, weight = fitted.free, fitted.noise.weight
    slopes = [slope[:, :, free] for slope in fitted.slopes]
    flat = [slope.reshape(-1, len(free)) for slope in slopes]
    whole = np.eye(len(free)) + weight * sum(each.T @ each for each in flat)
    result = []
    for segment, residual, slope in zip(joint.segments, fitted.residuals, slopes, strict=True):
        left, label = residual.copy(), gap.blocks(segment)
        for number in np.unique(label):
            own = slope[label == number].reshape(-1, len(free))
            gradient = weight * own.T @ residual[label == number].ravel()
            step = -np.linalg.solve(whole - weight * own.T @ own, gradient)
            left[label == number] -= slope[label == number] @ step
        result.append(left)
    return result


def improved(told: Diagnosis, answer: Answer) -> Diagnosis:
    """The diagnosis with the joint fit's answer in place of its own, if that surely leaves less on blocks that neither
    saw; else unchanged."""
    groups = answer.sets.groups
    sure = gap.probability_of_shrinking(told.after, answer.left, answer.joint.segments)
    if sure < gap.SURELY or not groups:
        return told
    before, after = gap.rms(told.before), gap.rms(answer.left)
    groups = _largest_share_first(groups, answer, before)
    names = [group[0] for group in groups]
    shrink, shares = 1.0 - after / before, answer.shares(names, before)
    total, floor = max(sum(shares), 1e-12), told.document["noise_floor"]
    document = {
        **told.document,
        "verdict": "effect",
        "gap": gap.with_intervals(told.before, answer.left, answer.joint.segments, floor, learnt().elsewhere),
        "effects": [
            {
                "id": group[0],
                "probability": answer.sets.any_of(group),
                "since": "calibration",
                "parameters": answer.parameter_values(group[0]),
                "shrink": shrink * share / total,
                "swallowed_by_recalibration": False,
                "loads_on_board": False,
                "ambiguous_with": list(group[1:]),
            }
            for group, share in zip(groups, shares, strict=True)
        ]
        + [effect for effect in told.document["effects"] if effect["id"] == repeated.HELD],  # of the sensor's link
        "count": [sure * j + (1.0 - sure) * t for j, t in zip(answer.sets.count, told.document["count"], strict=True)],
        **_mixed_probabilities(told.document, groups[0], answer.sets.each, sure),
        "where": {**told.document["where"], "stage": effects.BY_ID[names[0]].stage},
        "signature": None,
        "moved": [],
        "resembles": [],
    }
    is_open = decide.is_open(told.evidence, after**2)
    rest = flexible.close(told.segments[1:], answer.left, floor) if is_open else None
    document["flexible"] = rest.to_json() if rest else None
    return replace(told, document=document, corrected=answer.corrected_model(), after=answer.left)


def _largest_share_first(groups: list[tuple[str, ...]], answer: Answer, before: float) -> list[tuple[str, ...]]:
    """The groups in order of what their first member closes."""
    shares = answer.shares([group[0] for group in groups], before)
    return [groups[i] for i in np.argsort(-np.array(shares))]


def _mixed_probabilities(
    document: Mapping[str, Any], leading: tuple[str, ...], each: Mapping[str, float], sure: float
) -> dict[str, Any]:
    """The probabilities of diagnosis.json as a mixture: with probability `sure` the joint fit's leading group, each
    member by its own, else as they were."""
    weights = {name: each[name] / sum(each[other] for other in leading) for name in leading}
    candidates = [
        {
            **candidate,
            "probability": (1.0 - sure) * candidate["probability"] + sure * weights.get(candidate["id"], 0.0),
            "identifiable": candidate["id"] not in leading or len(leading) == 1,
        }
        for candidate in document["candidates"]
    ]
    return {
        "candidates": sorted(candidates, key=lambda candidate: -candidate["probability"]),
        "probability_none": (1.0 - sure) * document["probability_none"],
        "probability_unknown": (1.0 - sure) * document["probability_unknown"],
    }
