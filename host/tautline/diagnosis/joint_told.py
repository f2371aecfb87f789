"""A joint fit of a simulator's unknowns (joint.py) as a diagnosis: what is named, what it leaves, the corrected
model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline import effects
from tautline.diagnosis import decide, flexible, gap, heldout, repeated, shapley
from tautline.diagnosis.diagnose import Diagnosis
from tautline.diagnosis.hyperparameters import learnt
from tautline.diagnosis.joint import BENDS, DELAY, LAW, SPEED, WIDTH, Fitted, Joint
from tautline.diagnosis.joint_sets import Sets
from tautline.discrepancy import Discrepancy, states
from tautline.model import Deviation, Model, Uncertainty

Array = npt.NDArray[np.float64]

_FRICTION_VARIES = 0.3  # prior: share by which friction differs from recording to recording: heat, load, grease


@dataclass(frozen=True)
class Answer:
    """The answer of a joint fit: which unknowns are present, and what the fit leaves."""

    joint: Joint
    fitted: Fitted
    sets: Sets
    held_out: list[Array]  # (scored, k) of each recording: residual of every block by the fit without that block
    plainer: Answer | None = None  # of the fit with less detail that this one was found from

    @classmethod
    def of(cls, joint: Joint, fitted: Fitted) -> Answer:
        """Completes a joint fit by the posterior over sets of its unknowns and by its held-out residuals."""
        return cls(joint, fitted, Sets.of(joint.unknowns, fitted), held_out_residuals(joint, fitted))

    def corrected_model(self) -> Model:
        """The model with all unknowns as fitted, and its uncertainty. c_sigma, deg, is the law's posterior standard
        deviation. width_sigma, unit of q, is how much friction varies: _FRICTION_VARIES of the width, times the root of
        the probability that it is friction and not slack. The uncertainty holds the standard deviation of a reading of
        an unseen motion, the deviations of the posterior, and the discrepancy of motions unlike the recorded ones."""
        joint, fitted = self.joint, self.fitted
        names = [fitted.posterior.names[i] for i in joint.places[LAW]]
        c_sigma = fitted.posterior.marginal(names).spread(joint.law_slopes())
        model = joint.model_at(fitted.u)
        return replace(
            model,
            width_sigma=_FRICTION_VARIES * np.sqrt(self._friction_probability) * model.width,
            c_sigma=c_sigma,
            uncertainty=Uncertainty(
                self._noise_of_unseen(), deviations=tuple(self._deviations()), discrepancy=self._discrepancy()
            ),
        )

    def _deviations(self) -> Iterator[tuple[Deviation, Deviation]]:
        """Yields, for each column of the Cholesky factor of the posterior's covariance, the model one standard
        deviation below and above along that column. The simulator's parameters come first in u, so the later columns do
        not contain them and need no simulation."""
        free, joint = self.fitted.free, self.joint
        factor = np.linalg.cholesky(self.fitted.posterior.covariance[np.ix_(free, free)])
        for column in factor.T:
            step = np.zeros(joint.size)
            step[free] = column
            below, above = (joint.model_at(joint.within_ranges(self.fitted.u + sign * step)) for sign in (-1.0, 1.0))
            yield Deviation.of(below), Deviation.of(above)

    def _noise_of_unseen(self) -> float:
        """One standard deviation of a reading of an unseen motion about the model's prediction, in the observations'
        unit (`gap.unseen`)."""
        before = gap.rms(self.joint.residuals(np.zeros(self.joint.size)))
        return gap.unseen(before, gap.rms(self.held_out), self.joint.floor, learnt().elsewhere)

    def _discrepancy(self) -> Discrepancy | None:
        """A Gaussian process, by place, speed and load, of the residuals of the plainer fit; its prior variance is by
        how much that fit leaves more of an unseen motion than this one. Detail was seen only where the recorded motions
        were; elsewhere it is worth no more than the plainer fit. None without a plainer fit, or if that leaves no
        more."""
        if self.plainer is None:
            return None
        power = self.plainer._noise_of_unseen() ** 2 - self._noise_of_unseen() ** 2
        if power <= 0.0:
            return None
        joint, model = self.joint, self.joint.model_at(self.fitted.u)
        inputs, changes = [], joint.changes(self.fitted.u)
        for s in joint.segments:
            assert s.drive is not None  # of a simulator
            scene = s.arrival_s[s.scored] - model.delay_of(s.sensor)
            inputs.append(states(s.drive.motor(changes), s.drive.log, scene, model.rig.actuator.span))
        left = np.concatenate(self.plainer.fitted.residuals)
        return flexible.discrepancy(np.concatenate(inputs), left, joint.floor, float(np.sqrt(power)))

    @property
    def _friction_probability(self) -> float:
        """Probability that the width is due to friction: that it varies with speed or place, as slack in gears does
        not."""
        names = tuple(name for name in (SPEED, BENDS) if name in self.sets.ids)
        return self.sets.any_of(names) if names else 0.0

    def shares(self, names: Sequence[str], before: float) -> list[float]:
        """The exact Shapley share of each named unknown in the shrinkage 1 - after / before of the rms, in the
        linearised fit with all unnamed unknowns at zero. before: rms of the gap, in the observations' unit."""

        def worth(present: frozenset[str]) -> float:
            """Shrinkage of the rms with these unknowns alone."""
            is_present = np.zeros(self.joint.size, dtype=bool)
            for name in present:
                is_present[self.joint.places[name]] = True
            absent = np.where(is_present, 0.0, self.fitted.u)
            pairs = zip(self.fitted.residuals, self.fitted.slopes, strict=True)
            return gap.shrinkage(before, gap.rms([residual + slope @ absent for residual, slope in pairs]))

        return shapley.shares(names, worth)

    def parameter_values(self, name: str) -> dict[str, float]:
        """The fitted parameters of the effect with the id `name`, by name, in their own units, as diagnosis.json
        reports them. For a width that varies over the range, width_everywhere is its largest change."""
        added = {effect.id: dict(effect.parameters) for effect in self.joint.effects(self.fitted.u)}
        model = self.joint.model_at(self.fitted.u)
        in_tables = {
            WIDTH: {"width_everywhere": float(np.max(model.width - self.joint.model.width))},
            DELAY: {"delay": model.delay_s - self.joint.model.delay_s},
        }
        return {**(in_tables | added).get(name, {}), "since_calibration": 1.0}


def held_out_residuals(joint: Joint, fitted: Fitted) -> list[Array]:
    """(scored, k) for each recording: the residual of every block of manoeuvres by a fit in which only a share
    heldout.STAYS of that block's weight stays. That fit is one step -(N - N_b)^-1 g_b away; if the step does not lower
    the cost, as where the model is linear only nearby, it is found by a descent (`Joint.residuals_with_weights`)."""
    free, weight = fitted.free, fitted.noise.weight
    slopes = [slope[:, :, free] for slope in fitted.slopes]
    flat = [slope.reshape(-1, len(free)) for slope in slopes]
    normal = np.eye(len(free)) + weight * sum(rows.T @ rows for rows in flat)
    goes = weight * (1.0 - heldout.STAYS)
    result = []
    for i, (segment, residual, slope) in enumerate(zip(joint.segments, fitted.residuals, slopes, strict=True)):
        held_out, label = residual.copy(), gap.blocks(segment)
        for number in np.unique(label):
            block = label == number
            rows = slope[block].reshape(-1, len(free))
            step = np.zeros(len(fitted.u))
            step[free] = -np.linalg.solve(normal - goes * rows.T @ rows, goes * rows.T @ residual[block].ravel())
            weights = [np.ones(len(r)) for r in fitted.residuals]
            weights[i][block] = heldout.STAYS
            held_out[block] = joint.residuals_with_weights(fitted, weights, step)[i][block]
        result.append(held_out)
    return result


def with_joint_answer(diagnosis: Diagnosis, answer: Answer) -> Diagnosis:
    """The diagnosis with its answer replaced by that of the joint fit, if the joint fit names something and surely
    (gap.SURELY) leaves less on held-out blocks; else the same diagnosis object. The answer is of the robot's
    recordings: the diagnosis' segments without the first one, which is the simulator's."""
    groups = answer.sets.groups
    sure = gap.probability_of_shrinking(diagnosis.after, answer.held_out, answer.joint.segments)
    if sure < gap.SURELY or not groups:
        return diagnosis
    groups = _sorted_by_share(groups, answer, gap.rms(diagnosis.before))
    best = answer_to_hand_out(answer)
    document = _joint_document(diagnosis, answer, best, groups, sure)
    return replace(diagnosis, document=document, corrected=best.corrected_model(), after=best.held_out)


def answer_to_hand_out(answer: Answer) -> Answer:
    """The answer whose model is handed out: one with more detail of law and width if it surely leaves less of held-out
    blocks, else `answer`. What is named comes from `answer` alone, as law and width of much detail can stand for other
    causes. It fits the detailed unknowns to find out."""
    detailed = Answer.of(*answer.joint.with_more_detail(answer.fitted))
    sure = gap.probability_of_shrinking(answer.held_out, detailed.held_out, answer.joint.segments)
    return replace(detailed, plainer=answer) if sure >= gap.SURELY else answer


def _joint_document(
    diagnosis: Diagnosis, answer: Answer, best: Answer, groups: Sequence[tuple[str, ...]], sure: float
) -> dict[str, Any]:
    """The content of diagnosis.json with the joint fit's answer. best: the answer that is handed out, whose held-out
    residuals are the gap after; groups: what `answer` names; sure: probability that the joint fit leaves less than the
    diagnosis' own answer."""
    was, floor, after = diagnosis.document, diagnosis.document["noise_floor"], gap.rms(best.held_out)
    sizes = gap.with_intervals(diagnosis.before, best.held_out, answer.joint.segments, floor, learnt().elsewhere)
    named = list(_effect_entries(answer, best, groups, gap.rms(diagnosis.before), after))
    sizes, named = _with_held_samples(was, sizes, named)
    is_open = decide.is_open(diagnosis.evidence, after**2)
    closed = flexible.cross_validate(diagnosis.segments[1:], best.held_out, floor) if is_open else None
    return {
        **was,
        "verdict": "effect",
        "gap": sizes,
        "effects": named,
        "count": [sure * new + (1.0 - sure) * old for new, old in zip(answer.sets.count, was["count"], strict=True)],
        **_mixed_probabilities(was, groups[0], answer.sets.by_id, sure),
        "where": {**was["where"], "stage": effects.BY_ID[groups[0][0]].stage},
        # These were of the answer that this one is in place of.
        "signature": None,
        "moved": [],
        "resembles": [],
        "flexible": closed.to_json() if closed else None,
    }


def _with_held_samples(
    was: Mapping[str, Any], sizes: dict[str, Any], named: list[dict[str, Any]]
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """(The gap's `sizes`, the `named` effects), both extended by the held samples (values that the sensor's link sent
    twice) that diagnosis.json named before the joint fit, `was`; unchanged where it named none. They are no unknown of
    a simulator, so the joint fit is without them. The sizes become those with them, and they are named last; the
    others' shares, so far of the gap without them, become shares of all of it."""
    held = next((effect for effect in was["effects"] if effect["id"] == repeated.HELD), None)
    if held is None:
        return sizes, named
    sizes, named, closed = dict(sizes), [dict(effect) for effect in named], sizes["shrink"]
    repeated.set_size(sizes, "before", was["gap"]["before"])
    repeated.set_size(sizes, "after", float(np.hypot(sizes["after"], held["adds"])))
    repeated.set_shrinkages(sizes, was["noise_floor"] ** 2, learnt().elsewhere)
    repeated.scale_shares(named, sizes["shrink"], closed)
    return sizes, [*named, held]


def _effect_entries(
    answer: Answer, best: Answer, groups: Sequence[tuple[str, ...]], before: float, after: float
) -> Iterator[dict[str, Any]]:
    """Yields the named groups as entries of the list `effects` of diagnosis.json, each with its share of the shrinkage
    and its values in `best`, which is handed out. before, after: rms of the gap without and with the answer. A
    recalibration never swallowed them, as a simulator is not calibrated, and no board loads a simulator's model."""
    shares = answer.shares([group[0] for group in groups], before)
    total, shrink = max(sum(shares), 1e-12), gap.shrinkage(before, after)
    for group, share in zip(groups, shares, strict=True):
        yield {
            "id": group[0],
            "probability": answer.sets.any_of(group),
            "since": "calibration",
            "parameters": best.parameter_values(group[0]),
            "shrink": shrink * share / total,
            "swallowed_by_recalibration": False,
            "loads_on_board": False,
            "ambiguous_with": list(group[1:]),
        }


def _sorted_by_share(groups: list[tuple[str, ...]], answer: Answer, before: float) -> list[tuple[str, ...]]:
    """The groups sorted by the share of the gap that each closes, the largest first. A group is the ids of unknowns
    that cannot be told apart; its first id, the likeliest, counts. before: rms of the gap."""
    shares = answer.shares([group[0] for group in groups], before)
    return [groups[i] for i in np.argsort(-np.array(shares))]


def _mixed_probabilities(
    document: Mapping[str, Any], leading: tuple[str, ...], present: Mapping[str, float], sure: float
) -> dict[str, Any]:
    """The probabilities of diagnosis.json as a mixture. With probability `sure` the joint fit's `leading` group is the
    cause, shared among its members in proportion to the probability that each is `present`; otherwise the probabilities
    of `document` hold."""
    weights = {name: present[name] / sum(present[other] for other in leading) for name in leading}
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
