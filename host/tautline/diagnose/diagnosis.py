"""The diagnosis: from a calibrated model and recordings to verdict, effects, their shares and a corrected model."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from tautline import effects
from tautline.diagnose import confounded, decide, flexible, gap, motion, where
from tautline.diagnose.decide import Candidate
from tautline.diagnose.fit import Fit, Fitter, Hypothesis, State
from tautline.diagnose.segment import Segment, prepare
from tautline.effects import Kind
from tautline.geometry import rotation
from tautline.model import Effect, Model, allowed_width
from tautline.recording import Recording
from tautline.rig import HandEye

Array = npt.NDArray[np.float64]
Progress = Callable[[float, str], None]

FORMAT = "diagnosis/1"
_MOST_EFFECTS = 3
_WORTH = 30.0  # twice the log-likelihood that an effect must gain beyond its price
_SHARE_WORTH = 0.3  # share of the open power that a further effect must close
_GAP_WORTH = 0.01  # and of the whole gap's: less nobody would model
# Share of the power that a recalibration leaves: if more is still open, the cause is more likely unknown; and how
# sharply.
_LEFT_MIDDLE, _LEFT_WIDTH = 0.30, 0.06
_SWALLOWED = 0.02  # a recalibration that leaves less of the gap's power has closed it
_STEADY = 0.5  # share of a gap's power that does not change within a recording
_NO_GAP = 1.25  # times the noise floor


@dataclass(frozen=True)
class Diagnosis:
    document: dict[str, Any]  # diagnosis.json
    nominal: Model
    corrected: Model
    next_motion: motion.NextMotion | None
    segments: list[Segment]
    before: list[Array]  # residuals of each test, (scored, k)
    after: list[Array]
    conditions: list[where.Condition]


def diagnose(
    model: Model,
    calibration: Recording,
    tests: Sequence[Recording],
    progress: Progress = lambda fraction, text: None,
    left_out: Collection[str] = (),
) -> Diagnosis:
    """`model` is what `calibration` gave. `left_out`: effects that the library shall not know. Raises TautError where
    nothing can be scored."""
    progress(0.0, "preparing")
    segments = prepare(model, calibration, tests)
    fitter = Fitter(model, segments, _load_reference(calibration))
    frozen = _as_is(fitter)
    fitter.floor = gap.noise_floor(segments, frozen.residuals)
    base = fitter.nominal()
    floor = fitter.floor = gap.noise_floor(segments, base.residuals)
    kinds = decide.applicable(fitter, left_out)
    hidden = confounded.hidden(kinds, segments)
    kinds = [kind for kind in kinds if kind.id not in hidden]

    progress(0.1, "screening")
    ordered, effective = decide.candidates(
        fitter, base, kinds, lambda fraction, text: progress(0.1 + 0.5 * fraction, text)
    )
    without = decide.log_likelihood(fitter, base, effective)
    probability = decide.probabilities(ordered, effective, without)

    named: list[Candidate] = []
    current = base
    before_rms = gap.rms(frozen.residuals[1:])
    excess = max(before_rms**2 - floor**2, 1e-12)
    if ordered[0].fit is not None and ordered[0].penalised(effective) - 2 * without > _WORTH:
        named, current = [ordered[0]], ordered[0].fit
        while len(named) < _MOST_EFFECTS and gap.rms(current.residuals[1:]) > _NO_GAP * floor:
            progress(0.6 + 0.1 * len(named), "looking for another effect")
            others = [k for k in kinds if k not in current.hypothesis.kinds]
            more, more_effective = decide.candidates(fitter, current, others, lambda fraction, text: None, refits=4)
            here = decide.log_likelihood(fitter, current, more_effective)
            best = more[0]
            if best.fit is None or best.kind.id in decide.EVENTS:
                break
            if best.penalised(more_effective) - 2 * here < _WORTH or not _needed(
                fitter, current, best.fit, floor, excess
            ):
                break
            named.append(best)
            current = best.fit

    progress(0.85, "checking on data the fit did not see")
    held_out = _held_out(fitter, current) if named else frozen.residuals[1:]
    event = bool(named) and named[0].kind.id in decide.EVENTS
    before, after = frozen.residuals[1:], frozen.residuals[1:] if event else held_out
    after_rms = gap.rms(after)
    recalibrated = gap.rms(base.residuals[1:])
    left = 0.0 if event else min(max((after_rms**2 - floor**2) / excess, 0.0), 1.0)
    # A recalibration closes a share without any effect: the effect must explain what that leaves.
    unexplained = (after_rms**2 - floor**2) / max(recalibrated**2 - floor**2, _SWALLOWED * excess)

    no_gap = _logistic((_NO_GAP - before_rms / floor) / 0.05)
    none = float(no_gap if named else max(no_gap, probability[-1] if before_rms < 2 * floor else 0.0))
    unknown = (1.0 - none) * (
        _logistic((unexplained - _LEFT_MIDDLE) / _LEFT_WIDTH) if named and not event else float(not named)
    )
    known = 1.0 - none - unknown
    shares = probability[:-1] / max(float(probability[:-1].sum()), 1e-300)
    verdict = max((none, "none"), (unknown, "unknown"), (known, "effect"))[1]
    if verdict != "effect":
        named_out: list[Candidate] = []
        corrected_fit = None
        after, after_rms = before, before_rms  # nothing was added
    else:
        named_out, corrected_fit = named, current

    progress(0.92, "attributing")
    paths = [s.predict(model, {}, fitter.load_reference)[0] for s in segments[1:]]
    conditions = where.conditions(segments[1:], paths, before)
    ambiguous = {
        c.kind.id: [o.kind.id for o in ordered if o is not c and _as_good(o, c, effective)] for c in ordered[:4]
    }
    leading = [c.fit for c in ordered[:3] if c.fit is not None and c.kind.id not in decide.EVENTS]
    following = motion.best(fitter, leading)
    boot = gap.bootstrap(before, after, [gap.blocks(s) for s in segments[1:]])
    shrink = 1.0 - after_rms / before_rms if before_rms > 0 else 0.0
    shapley = _shapley(fitter, named_out, current, before_rms)
    rest = flexible.close(segments[1:], after, floor) if after_rms > _NO_GAP * floor else None
    document: dict[str, Any] = {
        "format": FORMAT,
        "unit": segments[0].unit,
        "verdict": verdict,
        "noise_floor": floor,
        "gap": {
            "before": before_rms,
            "after": after_rms,
            "before_ci": _interval(boot[0]),
            "after_ci": _interval(boot[1]),
            "shrink": shrink,
            "shrink_ci": _interval(1.0 - boot[1] / boot[0]),
            "closable_shrink": (1.0 - left) if verdict == "effect" and not event else 0.0,
        },
        "gap_recalibrated": {"before": recalibrated},
        "flexible": rest.to_json() if rest else None,  # what a Gaussian process closes of the gap after
        "effects": [
            {
                "id": c.kind.id,
                "probability": float(known * (shares[0] if i == 0 else 0.9)),
                "parameters": _reported(c.kind, current.state if corrected_fit else None, c.only_tests),
                "shrink": shapley[i],
                "swallowed_by_recalibration": bool(recalibrated**2 - floor**2 < 0.1 * excess),
                "loads_on_board": c.kind.on_board,
                "ambiguous_with": ambiguous.get(c.kind.id, []),
            }
            for i, c in enumerate(named_out)
        ],
        "candidates": [
            {
                "id": c.kind.id,
                "probability": float(known * share),
                "shrink": 1.0 - gap.rms(c.fit.residuals[1:]) / before_rms if c.fit else 0.0,
                "identifiable": not ambiguous.get(c.kind.id, []),
            }
            for c, share in zip(ordered, shares, strict=True)
        ],
        "probability_none": none,
        "probability_unknown": unknown,
        "where": {
            "stage": ordered[0].kind.stage if verdict != "none" else None,
            "conditions": [c.to_json() for c in conditions[:5]],
        },
        "signature": _signature(conditions, before)
        if verdict == "unknown" or any(c.kind.id == confounded.DRIFT for c in named_out)
        else None,
        "next_motion": {"why": following.why, "file": "next_motion.csv"} if following else None,
    }
    confounded.told(document, hidden)
    progress(1.0, "done")
    corrected = _corrected(corrected_fit, segments[-1]) if corrected_fit else model
    corrected = replace(corrected, extra={**model.extra, "load_reference_mNm": fitter.load_reference})
    return Diagnosis(document, model, corrected, following, segments, list(before), list(after), conditions)


def _load_reference(calibration: Recording) -> float:
    load = calibration.motor.load_mNm
    return 0.0 if load is None else float(np.median(load))


def _as_is(fitter: Fitter) -> Fit:
    state = fitter.start()
    hypothesis = Hypothesis()
    residuals = []
    for segment in fitter.segments:
        _, predicted = segment.predict(state.model, {}, fitter.load_reference)
        residuals.append((segment.observed - predicted)[segment.scored])
    return Fit(hypothesis, state, residuals)


def _needed(fitter: Fitter, now: Fit, then: Fit, floor: float, excess: float) -> bool:
    """Whether a further effect closes _SHARE_WORTH of the power still open in what the fit did not see, _GAP_WORTH of
    the whole gap's `excess` power, and does so throughout: the bootstrap's 2.5 % quantile over blocks of manoeuvres
    still closes a third of the former."""

    def closed(a: Array | float, b: Array | float) -> Array:
        return np.asarray((np.square(a) - np.square(b)) / np.maximum(np.square(a) - floor**2, 1e-12))

    def worth(before: Sequence[Array], after: Sequence[Array]) -> bool:
        a, b = gap.rms(before), gap.rms(after)
        return bool(closed(a, b) >= _SHARE_WORTH and a**2 - b**2 >= _GAP_WORTH * excess)

    if not worth(now.residuals[1:], then.residuals[1:]):
        return False
    before, after = _held_out(fitter, now), _held_out(fitter, then)
    drawn = gap.bootstrap(before, after, [gap.blocks(s) for s in fitter.segments[1:]])
    low = float(np.quantile(closed(drawn[0], drawn[1]), 0.025))
    return worth(before, after) and low >= _SHARE_WORTH / 3


def _held_out(fitter: Fitter, fit: Fit) -> list[Array]:
    """Residuals of the tests where each half of the blocks was predicted by a fit that saw only the other half."""
    labels = [gap.blocks(s) for s in fitter.segments]
    result = [r.copy() for r in fit.residuals[1:]]
    for half in (0, 1):
        parts = [fitter.segments[0]]
        for segment, label in zip(fitter.segments[1:], labels[1:], strict=True):
            seen = np.zeros(len(segment.scored), dtype=bool)
            seen[segment.scored] = (label % 2 == half) if label.max() > 0 else True
            parts.append(segment.part(seen))
        parts = [p for p in parts if p.scored.any()]
        partial = Fitter(fitter.model, parts, fitter.load_reference)
        partial.floor = fitter.floor
        found = partial.descend(fit.hypothesis, fit.state, 3)
        for i, (segment, label) in enumerate(zip(fitter.segments[1:], labels[1:], strict=True)):
            at = found.state.at(segment, fit.hypothesis)
            _, predicted = segment.predict(found.state.model, at, fitter.load_reference)
            other = label % 2 != half
            result[i][other] = (segment.observed - predicted)[segment.scored][other]
    return result


def _as_good(other: Candidate, one: Candidate, effective: float) -> bool:
    return abs(other.penalised(effective) - one.penalised(effective)) < 2 * decide.TEMPERATURE * math.log(8.0)


def _shapley(fitter: Fitter, named: Sequence[Candidate], fit: Fit, before: float) -> list[float]:
    """Each effect's exact Shapley share of the shrinkage, over all subsets with the others at zero."""
    n = len(named)
    if n == 0:
        return []
    names = [{p.name for p in c.kind.amplitudes} for c in named]

    def value(subset: tuple[int, ...]) -> float:
        off = set().union(*(names[i] for i in range(n) if i not in subset), set())
        values = {k: (0.0 if k in off else v) for k, v in fit.state.values.items()}
        state = replace(fit.state, values=values)
        residuals = []
        for s in fitter.segments[1:]:
            _, predicted = s.predict(state.model, state.at(s, fit.hypothesis), fitter.load_reference)
            residuals.append((s.observed - predicted)[s.scored])
        return 1.0 - gap.rms(residuals) / before

    worth = {subset: value(subset) for k in range(n + 1) for subset in itertools.combinations(range(n), k)}
    shares = []
    for i in range(n):
        rest = [j for j in range(n) if j != i]
        share = 0.0
        for k in range(n):
            weight = math.factorial(k) * math.factorial(n - k - 1) / math.factorial(n)
            for subset in itertools.combinations(rest, k):
                share += weight * (worth[tuple(sorted((*subset, i)))] - worth[subset])
        shares.append(share)
    return shares


def _reported(kind: Kind, state: State | None, only_tests: bool) -> dict[str, float]:
    if state is None:
        return {}
    names = [p.name for p in (*kind.amplitudes, *kind.shapes)]
    values = {name: float(state.values[name]) for name in names if name in state.values}
    return {**values, "since_calibration": float(only_tests)}


def _corrected(fit: Fit, last: Segment) -> Model:
    """The fitted model with its effects, its state as at the end of the last test: a shift has happened, a drift has
    gone so far (its offset moved the tables' grid, its width scaled B)."""
    model = fit.state.model
    model = _with_registration(replace(model, c_deg=_monotone(model.c_deg)), fit.state.static)
    values = fit.state.at(last, fit.hypothesis)
    end = float(last.motor.t_s[-1]) + last.offset_s
    added = []
    for kind in fit.hypothesis.kinds:
        own = {p.name: values[p.name] for p in (*kind.amplitudes, *kind.shapes) if p.name in values}
        if kind.id == "transmission.drift":
            width = allowed_width(model.q, model.width * max(0.0, 1.0 + own["width_drift"] * end))
            model = replace(model, q=model.q - own["offset_drift"] * end, width=width)
        elif kind.id == "registration.static":
            model = _with_registration(model, own)
        elif kind.id == "registration.shift":
            if end >= own["shift_time"]:
                moved = {name.replace("shift", "static"): own[name] for name in own if name != "shift_time"}
                model = _with_registration(model, moved)
        elif kind.id == "acquisition.delay":
            model = replace(model, delay_s=model.delay_s + own["delay"])
        elif kind.id == "camera.distortion":
            rig = model.rig
            assert rig.camera
            model = replace(model, rig=replace(rig, camera=effects.distorted(rig.camera, own)))
        added.append(Effect(kind.id, own))
    return replace(model, effects=tuple(added))


def _monotone(c_deg: Array) -> Array:
    """f_remain rising or falling strictly, as a model's must, where a fit left it level."""
    sign = np.sign(c_deg[-1] - c_deg[0])
    least = 1e-6 * abs(c_deg[-1] - c_deg[0]) / len(c_deg) * np.arange(len(c_deg))
    rising: Array = sign * (np.maximum.accumulate(sign * c_deg - least) + least)
    return rising


def _with_registration(model: Model, static: Mapping[str, float]) -> Model:
    """X_cam = R (Exp(turn) X + move) + t folded into the rig's hand-eye."""
    rig = model.rig
    if rig.hand_eye is None or not static:
        return model
    turn = Rotation.from_rotvec([static.get(f"static_r{a}", 0.0) for a in "xyz"], degrees=True).as_matrix()
    move = np.array([static.get(f"static_{a}", 0.0) for a in "xyz"])
    old = rotation(rig.hand_eye.rotation_deg)
    rz, ry, rx = Rotation.from_matrix(old @ turn).as_euler("ZYX", degrees=True)
    t = old @ move + np.asarray(rig.hand_eye.translation_mm)
    hand_eye = HandEye((float(rx), float(ry), float(rz)), (float(t[0]), float(t[1]), float(t[2])))
    return replace(model, rig=replace(rig, hand_eye=hand_eye))


def _interval(values: Array) -> list[float]:
    return [float(v) for v in np.quantile(values, [0.025, 0.975])]


def _logistic(x: float) -> float:
    return 1.0 / (1.0 + math.exp(-min(max(x, -50.0), 50.0)))


def _signature(conditions: Sequence[where.Condition], residuals: Sequence[Array]) -> str | None:
    """What a gap without a cause looks like: of an unknown effect, and of a drift, which only says when."""
    if not conditions:
        return None
    top = [c for c in conditions if c.share > 0.5 * conditions[0].share][:3]
    says = "largest " + ", ".join(c.says for c in top)
    if where.steady(residuals) > _STEADY:
        says = (
            "much the same throughout each recording, as where something changed between them that no column tells: "
            f"a load, a temperature, the mounting; {says}"
        )
    return says
