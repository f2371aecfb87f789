"""From recordings to a model: the order of a calibration's steps. Delay, onsets, B(q) by the joint fit with what
departs from it, f_remain, predictions, verdict, and the effects that a diagnosis names.

grid: the (NODES,) motor positions at which B and f_remain are tabulated; B and positions are in the unit of q.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from tautline.calibration import clock, coverage
from tautline.calibration import naming as effect_names
from tautline.calibration.acquisition import in_another_unit, mistaken_unit, rig_contradictions
from tautline.calibration.backlash import WidthCurve, fit_widths
from tautline.calibration.beforehand import Beforehand
from tautline.calibration.beside import FittedEffects
from tautline.calibration.choice import JOINT, ONSETS, PASSES, Choice, image_jumps, with_width
from tautline.calibration.components import WORSE, Components, separate
from tautline.calibration.departures import SPEED
from tautline.calibration.doubts import KNOWN, common_error, component_reasons, still_changing
from tautline.calibration.findings import Findings
from tautline.calibration.holding import without_held_places
from tautline.calibration.hysteresis import PRIORS, HysteresisFit, fit_friction, most_evidence
from tautline.calibration.observations import LITTLE, Track, observe, usual_width
from tautline.calibration.on_tip import place_on_tip
from tautline.calibration.onset import BOUND, BRACKET, HINGE, Delay, Onset, delayed, find_onsets
from tautline.calibration.place import (
    PlaceNoise,
    allowing_for_place,
    as_many_as_independent,
    as_smooth_as_independent,
    place_noise,
)
from tautline.calibration.playfit import NODES, Curves, Fitted, PlayFit
from tautline.calibration.remaining import Remaining, fit_remaining, morphological, pose_of, posed
from tautline.calibration.several import fit_elements, rms_over_noise
from tautline.calibration.smooth import Domain, fit_jointly, fit_passes, overlap, prepare_tracks
from tautline.calibration.wandering import allowing_for_wander
from tautline.calibration.worth import PREDICTS, Worth, predictive_worth
from tautline.core.session import Session
from tautline.diagnosis import start
from tautline.elements import SINGLE, Elements, Hysteresis
from tautline.errors import TautError
from tautline.friction import Friction
from tautline.geometry import coarse_range_deg
from tautline.model import LOAD, Model
from tautline.nearest import Nearest
from tautline.prediction import predict
from tautline.quality import Quality, Reason
from tautline.recording import Recording, shifted
from tautline.rig import Rig
from tautline.undone import stands_in
from tautline.value import Value

Array = npt.NDArray[np.float64]
Progress = Callable[[float, str], None]

_LEAST_FRAMES = 10  # tolerance: frames from which anything is said
_TOLD_S = 0.001  # tolerance: standard deviation to which the offset of a clock that was off has to be known
_LATER = 0.05  # tolerance: of a frame's period: by less, onsets are moved with the delay and not looked for again
_GRADUAL = 0.4  # prior: rms over noise of phase.even from which several elements or friction are tried
_HELD = 0.5  # prior: of the power that one element leaves beyond noise: what several may leave at most
_OF_SENSORS = frozenset({"turn", "tracker"})  # departures that no effect of the library looks like
_OF_ELEMENTS = frozenset({"phase.even", "image.side"})  # departures that several elements, or their number, stand for
_GRADUAL_START = "transmission.smooth_onset"  # the effect that several elements are
_BETWEEN_ELEMENTS = 0.003  # prior: of B: what elements of a few shares leave, alike on every stroke
_UNIT_SLACK = 1.6  # prior: ratio by which f_coarse's gain and f_remain's may differ beside a mistaken unit
_LIKELY_GAIN = (0.4, 2.5)  # prior: range of f_remain's gain over f_coarse's that is no wrong scale
_LIKELY_BEND = 0.5  # prior: of f_coarse's span of angles: by how much f_remain may leave it
_TOLD = 0.1  # tolerance: of the span of angles: f_remain is not known if its sigma by the place is more
_LARGE = 0.1  # tolerance: of the image's motion (rms): a registration that is off by less still tells angles


@dataclass(frozen=True)
class Options:
    """What a calibration is told beside recordings and rig."""

    delay_s: float | None = None  # given, not estimated
    knots: Literal["smooth", "paper"] = "smooth"  # paper: 14 knots through the onsets alone
    remaining: Literal["direct", "morphological"] = "direct"
    elements: Literal["auto", "one"] = "auto"  # of the play: several where the data ask for them
    beforehand: Beforehand | None = None  # what is known without these recordings

    def __post_init__(self) -> None:
        """TautError where a choice or the delay is none."""
        for name, choices in get_type_hints(Options).items():
            value, allowed = getattr(self, name), get_args(choices)
            if get_origin(choices) is Literal and value not in allowed:
                raise TautError(f"{name} {value!r} is not there: choose one of {', '.join(allowed)}")
        if self.delay_s is not None and not np.isfinite(self.delay_s):
            raise TautError(f"delay_s {self.delay_s} is no time: give seconds, or None to estimate it")


@dataclass(frozen=True, eq=False, repr=False)
class Foretold(Value):
    """What the calibrated model says of one recording, beside what was seen there. All (n,) or (n, k), k = 2 px or 1
    deg."""

    name: str
    scene_s: Array  # on the motor's clock
    seen: Array
    predicted: Array

    @property
    def residual(self) -> Array:
        """(n, k) seen less predicted, px or deg."""
        return self.seen - self.predicted


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(Value):
    """The result of a calibration: the model, and what it was made from. Positions and B in the unit of q."""

    model: Model
    onsets: tuple[Onset, ...]
    delay: Delay
    source: str  # of B: "onsets", "onsets and passes", "passes", "nothing"
    onset_curve: WidthCurve | None  # B from the onsets alone
    pass_width: Array | None  # B from the passes' distance alone, on model.q; NaN where it says nothing
    pass_sigma: Array | None
    evidence: dict[str, float]
    notes: tuple[str, ...]
    names: tuple[str, ...] = field(default=())  # of the recordings
    offsets: Mapping[str, float] = field(default_factory=dict)  # by recording: the sensor's clock less the motor's
    predicted: tuple[Foretold, ...] = ()  # of every frame that was used, by recording
    gaps: tuple[coverage.Gap, ...] = ()  # where B can be seen and is not measured
    path: tuple[Array, Array] | None = None  # on model.q (k, channels) in the sensor's unit, and its sigma

    def to_json(self) -> dict[str, Any]:
        """What `taut calibrate --json` prints (formats: backlash, remaining, delay_s, onsets, and what was noted)."""
        model = self.model
        return {
            "unit": model.rig.actuator.unit,
            "backlash": {
                "q": model.q.tolist(),
                "width": model.width.tolist(),
                "sigma": [_finite(v) for v in model.width_sigma],
                "measured": list(model.measured),
                "source": self.source,
                "elements": model.elements.to_json(),
            },
            "remaining": {
                "q": model.q.tolist(),
                "c_deg": model.c_deg.tolist(),
                "sigma_deg": None
                if model.c_sigma is None or model.rig.sees_from_tip
                else [_finite(v) for v in model.c_sigma],
            },
            "delay_s": model.delay_s,
            "offset_s": model.offset_s,
            "delay_sigma_s": _finite(self.delay.sigma_s),
            "onsets": [onset_json(o, self.names) for o in self.onsets],
            "evidence": {key: _finite(value) for key, value in self.evidence.items()},
            "notes": list(self.notes),
            "coverage": coverage.to_json(self.gaps, model.rig.actuator.unit),
            "quality": model.quality.to_json(),
        }


def onset_json(onset: Onset, names: Sequence[str]) -> dict[str, Any]:
    """An onset as `taut calibrate --json` prints it: at the time of its turn where the tip did not move again, null for
    what is infinite. names: of the recordings."""
    timed = np.isfinite(onset.t_s)
    return {
        "t_s": onset.t_s if timed else onset.turn_s,
        "direction": onset.direction,
        "q1": onset.q1,
        "q2": onset.q2,
        "width": onset.width,
        "sigma": _finite(onset.sigma),
        "used": onset.used and onset.kind in (HINGE, BRACKET),
        "kind": onset.kind,
        "low": onset.low,
        "high": _finite(onset.high),
        "reason": onset.reason,
        "recording": names[onset.track] if names else "",
    }


def _foretold(model: Model, track: Track, delay_s: float) -> Foretold:
    """The model's prediction of a track's frames at this delay, s, in the track's unit, beside what was seen."""
    scene = track.scene_s(delay_s)
    told = predict(model, track.reading, scene)
    predicted = told.c_deg[:, None] if track.unit == "deg" else told.image_px
    assert predicted is not None  # the marker was seen by the rig's camera
    return Foretold(track.name, scene, track.y, predicted)


def _finite(value: float) -> float | None:
    """None, JSON's null, for what is infinite or NaN."""
    return float(value) if np.isfinite(value) else None


def calibrate(
    recordings: Sequence[Recording],
    rig: Rig,
    options: Options | None = None,
    progress: Progress | None = None,
    naming: bool = True,
) -> Calibration:
    """Measures B(q), f_remain and the delay from recordings of any motion. naming: what departs gets the name that a
    diagnosis gives it, for as much time again. Raises TautError where nothing can be measured; says in notes and
    warnings what could not."""
    options, recordings = options or Options(), Session(recordings).in_time()
    say = progress or (lambda share, what: None)
    say(0.0, "reading frames")
    every = observe(recordings, rig)
    tracks = [track for track in every if len(track.t_s)]
    if not tracks:
        raise TautError("the marker was never seen: check the marker's colour (taut marker) and the camera's view")
    frames = sum(len(track.t_s) for track in tracks)
    if frames < _LEAST_FRAMES:
        raise TautError(f"the tip was seen in {frames} frames only: record the calibration motion with it in view")
    with threadpool_limits(1, "blas"):  # its systems are small: threads that wait for each other cost 10 times more
        aligned = clock.align(tracks, rig) if options.delay_s is None else clock.AlignedTracks.as_it_is(tracks)
        moved = iter(zip(aligned.tracks, aligned.offsets_s, strict=True))
        pairs = [next(moved) if len(track.t_s) else (track, 0.0) for track in every]
        reasons = rig_contradictions(recordings, [track for track, _ in pairs], [offset for _, offset in pairs], rig)
        run = _CalibrationRun(aligned, rig, options, say, reasons)
        found = run.run()
        if naming and _worth_naming(run, found):
            aligned, offsets = _aligned_for_naming(tracks, rig, aligned, found)
            told = effect_names.effects_of_diagnosis(
                *(found.model, shifted(recordings, offsets)), lambda share, what: say(0.8 + 0.15 * share, what)
            )
            if told is not None:
                again = _CalibrationRun(
                    aligned, rig, options, lambda share, what: say(0.95 + 0.05 * share, what), reasons
                )
                found = _with_effects(found, told, again.run_with_effects(run, told))
        say(1.0, "done")
        return found


def _aligned_for_naming(
    tracks: Sequence[Track], rig: Rig, aligned: clock.AlignedTracks, found: Calibration
) -> tuple[clock.AlignedTracks, Mapping[str, float]]:
    """The aligned tracks and the sensors' offsets, s by recording, with which an effect is named. A recording whose
    image stops later than another's is not put on another clock here, since an effect makes it stop later, too."""
    own = clock.align(tracks, rig, late_are_off=False) if found.offsets else aligned
    return (own, own.offsets) if own.offsets != aligned.offsets else (aligned, found.offsets)


def _worth_naming(run: _CalibrationRun, found: Calibration) -> bool:
    """Whether a diagnosis is asked for the effect that departs. Not for an unusable calibration; nor for one that
    predicts blocks left out, if nothing departs, or if something does that a diagnosis does not weigh."""
    predicts = _predicts(found)
    if not found.model.quality.usable or (predicts and not (run.departs or start.concerns(found.model))):
        return False
    return not (effect_names.has_unweighed(found.model.quality.reasons) and predicts)


def _predicts(found: Calibration) -> bool:
    """Whether blocks left out are predicted to within PREDICTS times the noise; no where none were left out."""
    return found.evidence.get("foretold_over_noise", np.inf) <= PREDICTS


def _predicts_better(with_effects: Calibration, found: Calibration) -> bool:
    """Whether the calibration with effects is usable and predicts blocks left out with a smaller rms error than the one
    without."""
    own, other = (each.evidence.get("error", np.inf) for each in (with_effects, found))
    return with_effects.model.quality.usable and own < other


def _fits_like_components(with_effects: Calibration, found: Calibration) -> bool:
    """Whether the fit with effects leaves at most PREDICTS times the rms residual that the components leave, which
    follow no law of an effect; no where there are none."""
    return with_effects.evidence.get("residual_joint", np.inf) <= PREDICTS * found.evidence.get(
        "residual_components", 0.0
    )


def _with_effects(found: Calibration, told: start.Start, with_effects: Calibration | None) -> Calibration:
    """The calibration whose model carries the effects that were named (told), if it predicts blocks left out better
    than the one without (found); else that one with the names among its reasons. If something departs that a diagnosis
    does not weigh, the names count only where the fit with the effects is about as close as the components."""
    reasons = found.model.quality.reasons
    unweighed = effect_names.has_unweighed(reasons)
    better = with_effects is not None and _predicts_better(with_effects, found)
    if with_effects is not None and better and (not unweighed or _fits_like_components(with_effects, found)):
        model, predicts = with_effects.model, _predicts(with_effects)
        own = effect_names.reasons_with_carried(reasons, model.quality.reasons, model, predicts)
        return replace(with_effects, model=replace(model, quality=Quality.of(own)))
    if unweighed:
        return found
    own = effect_names.reasons_with_names(reasons, found.model, told.named)
    return replace(found, model=replace(found.model, quality=Quality.of(own)))


def _probabilities(fits: Sequence[Fitted]) -> Array:
    """(n,) probability of each of these fits of the same frames, alike before: proportional to scale^-N, the likelihood
    with the noise's size integrated out, N the number of independent residuals."""
    noise = place_noise(fits[0])
    number = fits[0].frames * fits[0].residuals[0].shape[1] / (1.0 if noise is None else noise.effect)
    log = -number * np.log([fit.scale for fit in fits])
    likely = np.exp(log - log.max())
    return np.asarray(likely / likely.sum())


@dataclass(frozen=True)
class _Measured:
    """What the fits of one calibration found. Arrays (grid,) on the run's grid, unit of q."""

    onsets: Sequence[Onset]
    delay: Delay
    onset_curve: WidthCurve | None  # B by the onsets alone
    joint_fit: Fitted | None
    passes: Fitted | None
    width: Array  # B that counts
    sigma: Array  # its standard deviation
    source: str  # where B is from: a constant of choice.py
    remaining: Remaining | None


@dataclass(frozen=True)
class _Extent:
    """Where B was measured, and how large it typically is there."""

    measured: tuple[float, float]  # lowest and highest position, unit of q
    inside: npt.NDArray[np.bool_]  # (grid,) between them
    usual: float  # typical B there, unit of q


class _CalibrationRun:
    """One calibration of tracks on one clock: the steps in order, and what they have found so far. Positions and B in
    the unit of q."""

    def __init__(
        self, aligned: clock.AlignedTracks, rig: Rig, options: Options, say: Progress, reasons: Sequence[Reason] = ()
    ) -> None:
        """say: told of progress; reasons: doubts that were found before. The grid covers the rig's range and what the
        motor reached beyond it, or the latter alone where the range is in another unit."""
        self.aligned, self.rig, self.options, self.say = aligned, rig, options, say
        self.tracks = tracks = aligned.tracks
        self.findings = Findings([*aligned.reasons, *reasons], list(aligned.notes))
        self.components: Components | None = None
        self.held = 0.0  # share of the frames that repeat a place that the tip had left
        self.ended: Sequence[Track] | None = None  # the tracks as if seen with the state of the session's end
        self.hysteresis: Hysteresis = SINGLE
        self.effects: tuple[FittedEffects, Array] | None = None  # beside the play, and their values
        self.load_mNm = 0.0  # at which B and f_remain hold beside them
        self.joint_fit: Fitted | None = None
        self.delay: Delay | None = None
        reached = [(float(t.motor.q.min()), float(t.motor.q.max())) for t in tracks]
        self.reached = min(r[0] for r in reached), max(r[1] for r in reached)
        low, high = self.reached if in_another_unit(self.reached, rig) else rig.actuator.range
        half = 0.5 * rig.actuator.encoder_resolution  # by less a position is not beyond the range
        below, above = self.reached[0] < low - half, self.reached[1] > high + half
        self.domain = Domain(self.reached[0] if below else low, self.reached[1] if above else high)
        self.grid = np.linspace(self.domain.low, self.domain.high, NODES)
        self.camera = tracks[0].unit == "px"
        self.framed = self.camera or rig.sees_from_tip  # a camera's delay: of frames that are still after a turn
        self.nominal_s = rig.nominal_delay_s(tracks[0].sensor)
        self.unit = rig.actuator.unit

    @property
    def departs(self) -> bool:
        """Whether the recordings show more than B, path and delay, a motor's counts, a tracker's error and noise."""
        found = self.components
        return found is not None and (
            found.unexplained > PREDICTS or any(part.name not in _OF_SENSORS for part in found.parts)
        )

    @property
    def choice(self) -> Choice:
        """What weighs the opinions of B against each other."""
        return Choice(self.tracks, self.domain, self.grid, self.unit, self.findings)

    def run(self) -> Calibration:
        """Measures the delay, onsets, B and f_remain in turn and judges them. TautError where the motor does not
        move."""
        if self.reached[1] - self.reached[0] < max(5 * self.rig.actuator.encoder_resolution, LITTLE * self.domain.span):
            raise TautError(
                f"the motor does not move (q stays within {self.reached[1] - self.reached[0]:.3g} {self.unit}): "
                "record the calibration motion, and check the encoder and its unit"
            )
        self._leave_out_held_places()
        self.say(0.05, "measuring the delay")
        delay = self._first_delay()
        self.say(0.15, "finding where the tip begins to move")
        onsets, curve = self._onsets(delay)
        self.say(0.35, "fitting the way up and down")
        joint_fit, passes = self._fit_jointly(onsets, delay, curve)
        if joint_fit is not None and (joint_fit.fit.fit_delay or joint_fit.curves.delay_s != delay.delay_s):
            first, delay = delay, self._delay_of_joint_fit(delay, joint_fit)
            onsets, curve = self._onsets_at(delay, first, onsets, curve)
        gradual = self.components is not None and any(
            part.name.startswith(("phase", SPEED)) for part in self.components.parts
        )
        like_paper = self.options.knots == "paper"
        width, sigma, source = self.choice.choose(
            onsets, curve, joint_fit, passes, like_paper=like_paper, gradual=gradual
        )  # fmt: skip
        if source == JOINT:
            # The joint fit is so much sharper that the onsets' scatter about it is their own.
            spread = float(np.sqrt(np.clip(self.findings.evidence["onsets_against_joint_z2"], 1.0, 9.0)))
            onsets = [replace(o, sigma=o.sigma * spread) if o.used and o.kind == HINGE else o for o in onsets]
        self.joint_fit, self.delay = joint_fit, delay
        self.say(0.75, "fitting f_remain")
        settled_only = joint_fit.fit.settled_only if joint_fit is not None else False
        if joint_fit is not None:
            self._find_place(joint_fit)
        remaining = self._remaining(width, delay.delay_s, settled_only) if self.choice.tip_moves() else None
        self._doubt_onsets_and_remaining(onsets, remaining, known_otherwise=source in (JOINT, PASSES))
        self._doubt_place(remaining)
        self.say(0.8, "naming what departs")
        return self._result(_Measured(onsets, delay, curve, joint_fit, passes, width, sigma, source, remaining))

    def run_with_effects(self, before: _CalibrationRun, told: start.Start) -> Calibration | None:
        """What `run` finds, with the effects that a diagnosis named fitted together with B, path and delay. told: the
        diagnosis, which has the effects, its nominal model and the load at which that holds; before: the run without
        them. If an effect has several forms each is fitted, and the most probable one counts. None where they cannot be
        fitted."""
        if before.joint_fit is None or before.delay is None:
            return None
        named = told.effects
        if not before.hysteresis.single and any(effect.id == _GRADUAL_START for effect in named):
            self.hysteresis = before.hysteresis  # its elements or friction are the gradual start
            named = tuple(effect for effect in named if effect.id != _GRADUAL_START)
        nominal = told.fit.state.model
        self.load_mNm = told.fitter.load_reference
        law = replace(nominal, extra={LOAD: self.load_mNm})
        posed = all(track.posed for track in self._on_one_curve(before.delay.delay_s))
        effects, values = FittedEffects.of(named, law, others_rest=not posed)
        if not effects.kinds:
            return None
        self._leave_out_held_places()
        self.say(0.0, f"fitting {', '.join(kind.id for kind in effects.kinds)} beside the play")
        start_s = before.delay.delay_s + (nominal.delay_s - told.fitter.model.delay_s)
        fits = [self._fit_with_effects(before.joint_fit, nominal, start_s, form, values) for form in effects.forms]
        if effects.bends:
            fits = [self._refit_with_own_law(before.joint_fit, fit) for fit in fits]
        probability = _probabilities(fits)
        joint_fit = fits[int(np.argmax(probability))]
        self.effects = joint_fit.effects_and_values
        # B and delay are as uncertain as the forms differ, by how probable each is.
        late_s = np.array([fit.curves.delay_s - joint_fit.curves.delay_s for fit in fits])
        apart = np.array([fit.fit.width(fit.curves) - joint_fit.fit.width(joint_fit.curves) for fit in fits])
        delay = self._delay_of_joint_fit(before.delay, joint_fit)
        delay = replace(delay, sigma_s=float(np.sqrt(delay.sigma_s**2 + probability @ late_s**2)))
        onsets, curve = self._onsets(delay)
        width = self.choice.held_beyond_measured(joint_fit, curve)
        sigma = np.sqrt(joint_fit.width_sigma(self.grid) ** 2 + probability @ apart**2)
        self.findings.evidence["residual_joint"] = joint_fit.scale
        self.say(0.75, "fitting f_remain")
        self._find_place(joint_fit)
        remaining = self._remaining(width, delay.delay_s, joint_fit.fit.settled_only)
        self._doubt_onsets_and_remaining(onsets, remaining, known_otherwise=True)
        self._doubt_place(remaining)
        return self._result(_Measured(onsets, delay, curve, joint_fit, None, width, sigma, JOINT, remaining))

    def _fit_with_effects(
        self, before: Fitted, nominal: Model, delay_s: float, effects: FittedEffects, values: Array
    ) -> Fitted:
        """The joint fit with effects, started from the nominal model's B, a delay, s, and values (m_e,) of theirs.
        Frames before the tip was driven both ways do not count: what effects did until then is not known. before: the
        joint fit without effects."""
        fit_delay = self.options.delay_s is None
        prepared = prepare_tracks(self._on_one_curve(delay_s), delay_s)
        basis = before.fit.backlash
        fit = PlayFit(
            prepared, basis, basis, fit_delay=fit_delay, beforehand=before.fit.beforehand, effects=effects,
            hysteresis=self.hysteresis,
        )  # fmt: skip
        channels = prepared[0].track.y.shape[1]
        design = basis.design(self.grid).toarray()
        backlash = np.linalg.lstsq(design, np.interp(self.grid, nominal.q, nominal.width), rcond=None)[0]
        curves = Curves(
            backlash, np.zeros((basis.size, channels)), delay_s if fit_delay else before.curves.delay_s, values
        )
        path_only = replace(
            fit, fit_backlash=False, fit_delay=False, fit_effects=False, smoothing=dict(fit.smoothing)
        )  # fmt: skip
        joint_fit = fit.solve(path_only.step(curves, *path_only.residuals(curves)))
        joint_fit = allowing_for_place(joint_fit, place_noise(joint_fit))
        joint_fit = allowing_for_wander(joint_fit)
        block, delay_variance = fit.layout(joint_fit.curves).backlash, joint_fit.covariance[-1, -1]
        width_by_delay = basis.design(self.grid).toarray() @ joint_fit.covariance[block, -1] / delay_variance
        return replace(joint_fit, width_by_delay=width_by_delay) if fit_delay and delay_variance > 0.0 else joint_fit

    def _refit_with_own_law(self, before: Fitted, joint_fit: Fitted) -> Fitted:
        """The joint fit with effects once more, what adds to the bending angle being turned into a place along the path
        by the f_remain that the first fit leaves. before: the joint fit without effects."""
        self.effects = effects, values = joint_fit.effects_and_values
        width, delay_s = joint_fit.fit.width(joint_fit.curves), joint_fit.curves.delay_s
        remaining = self._remaining(width, delay_s, joint_fit.fit.settled_only)
        if remaining is None:
            return joint_fit
        law = replace(effects.law, q=self.grid, width=width, width_sigma=0.0 * width, c_deg=remaining.c_deg)
        return self._fit_with_effects(before, law, delay_s, replace(effects, law=law), values)

    def _leave_out_held_places(self) -> None:
        """Leaves out frames at which the tracker repeated a place that the tip had left; sets their share, `held`."""
        if not self.camera:  # an angle sensor has no tracker: what it repeats is its own, or a joint that sticks
            return
        before = sum(len(track.t_s) for track in self.tracks)
        self.tracks = without_held_places(
            self.tracks, lambda: self._on_one_curve(self.nominal_s), self.domain, self.nominal_s
        )  # fmt: skip
        self.held = 1.0 - sum(len(track.t_s) for track in self.tracks) / before

    # ---- delay and onsets

    def _first_delay(self) -> Delay:
        """The delay to begin with: the one that is given; else of a camera by the image's stops, of an angle sensor by
        all its values."""
        if self.options.delay_s is not None:
            return Delay(self.options.delay_s, 0.0, 0)
        if not self.framed:
            return clock.delay_of_all(self.tracks, self.rig)
        return clock.delay_of_stops(self.tracks, self.rig)

    def _delay_of_joint_fit(self, stops: Delay, joint_fit: Fitted) -> Delay:
        """The joint fit's delay and its sigma, s, to which the rounding of the motor's counts at turns adds: an error
        of time at the motor's speed. Where the delay was not fitted the sigma is that of the stops, for the nominal
        delay a frame's period at most."""
        speed = float(np.median(np.concatenate([np.abs(s.speed[s.moving]) for s in joint_fit.fit.simulated])))
        counts = self.rig.actuator.encoder_resolution / np.sqrt(12.0) / max(speed, 1e-9) / np.sqrt(max(stops.stops, 1))
        own = joint_fit.delay_sigma
        if not joint_fit.fit.fit_delay:
            at_nominal = joint_fit.curves.delay_s == self.nominal_s
            own = min(stops.sigma_s, clock.period_s(self.tracks)) if at_nominal else stops.sigma_s
        return Delay(joint_fit.curves.delay_s, float(np.hypot(own, counts)), stops.stops)

    def _onsets(self, delay: Delay) -> tuple[list[Onset], WidthCurve | None]:
        """All onsets at this delay, and the curve of B through their widths, if any is known."""
        onsets = find_onsets(self.tracks, self.rig, delay.delay_s, delay.sigma_s)
        return onsets, fit_widths(onsets, self.grid)

    def _onsets_at(
        self, delay: Delay, first: Delay, onsets: list[Onset], curve: WidthCurve | None
    ) -> tuple[list[Onset], WidthCurve | None]:
        """Onsets and their curve at the joint fit's delay, given those at the first one: found anew where the delay
        changed by more than _LATER of a frame's period or became much surer, moved where it changed a little, else as
        they are."""
        surer = not self.framed and delay.sigma_s < 0.5 * first.sigma_s
        later_s = delay.delay_s - first.delay_s
        if surer or abs(later_s) > _LATER * clock.period_s(self.tracks):
            return self._onsets(delay)
        if abs(later_s) > 1e-4:
            onsets = delayed(onsets, self.tracks, later_s)
            return onsets, fit_widths(onsets, self.grid)
        return onsets, curve

    # ---- B

    def _on_one_curve(self, delay_s: float) -> Sequence[Track]:
        """Tracks on which the tip follows one curve: the image itself, or bending angles by pose where other axes move
        for more than half of the frames."""
        reference = self.tracks[0].others_reference
        still = np.concatenate([track.at_reference(track.scene_s(delay_s), reference) for track in self.tracks])
        if not self.camera or np.mean(still) > 0.5:
            return self.tracks
        self.findings.notes.append(
            "translation or rotation move most of the time: B(q) rests on the pose, as right as camera and hand_eye are"
        )
        return [posed(track, self.rig, delay_s) for track in self.tracks]

    def _fit_jointly(
        self, onsets: Sequence[Onset], delay: Delay, curve: WidthCurve | None
    ) -> tuple[Fitted | None, Fitted | None]:
        """The joint fit of B, path and delay together with what departs from it, and the fit of the passes alone; each
        None where too little was seen for it. curve: B by the onsets, a first guess."""
        prepared = prepare_tracks(self._on_one_curve(delay.delay_s), delay.delay_s)
        fit_delay = self.options.delay_s is None
        joint_fit = fit_jointly(
            prepared, self.domain, delay.delay_s, fit_delay=fit_delay, guess=curve,
            beforehand=self.options.beforehand,
        )  # fmt: skip
        if joint_fit is None:
            return None, None
        if fit_delay and not self.framed:
            joint_fit = clock.at_credible_delay(joint_fit, delay, self.tracks, self.nominal_s)
        elif fit_delay and (image_jumps(onsets) or not joint_fit.explained):
            # What the model does not know would bend the delay: the image stops tell it alone.
            joint_fit.fit.fit_delay = False
            joint_fit = joint_fit.fit.solve(replace(joint_fit.curves, delay_s=delay.delay_s))
        if fit_delay and not joint_fit.fit.fit_delay:
            joint_fit.fit.delay_sigma_s = min(self._delay_of_joint_fit(delay, joint_fit).sigma_s, 1.0)
        self.say(0.5, "looking for what is no play")
        joint_fit = self._with_departures(joint_fit, onsets, curve)
        self.say(0.6, "fitting the passes alone")
        # How far beyond an onset a pass begins: a tenth of B and a little of the range.
        margin = 0.1 * float(np.median(joint_fit.fit.width(joint_fit.curves))) + 0.005 * self.domain.span
        passes = fit_passes(joint_fit, margin)
        return joint_fit, None if passes is None else as_many_as_independent(passes)

    def _with_departures(self, joint_fit: Fitted, onsets: Sequence[Onset], curve: WidthCurve | None) -> Fitted:
        """The joint fit with B as estimated together with the departures (components.py), if that B predicts about as
        well or the onsets favour it; else as it was and less certain. Sets `components`, `hysteresis` and, where the
        session's state changed, `ended`."""
        noise = place_noise(joint_fit)
        if noise is not None:
            self.findings.evidence |= {f"place_{key}": value for key, value in asdict(noise).items()}
        joint_fit = allowing_for_place(joint_fit, noise)
        self.findings.evidence["residual_before_components"] = joint_fit.scale
        joint_fit, components = self._separated(joint_fit, noise)
        several = None
        if self.options.elements == "auto" and not image_jumps(onsets):
            several = self._several_elements_or_friction(joint_fit, components)
        if several is not None:
            joint_fit, self.hysteresis = several.fitted, several.fitted.fit.hysteresis
            components = separate(joint_fit, self.rig, without=_OF_ELEMENTS)
            spread = _BETWEEN_ELEMENTS * components.width if several.spread is None else several.spread
            components = replace(components, sigma=np.hypot(components.sigma, spread))
        self.components = components
        self.findings.evidence["residual_components"] = components.unexplained
        for part in components.parts:
            self.findings.evidence[f"component_{part.name}"] = part.rms
        apart = components.applied(joint_fit)
        alone = self.choice.residual_without_departures(components, apart, joint_fit)
        if self.choice.predicts_as_well(alone, joint_fit) or self.choice.onsets_favour_departures(
            onsets, curve, components, apart, joint_fit
        ):
            if components.from_end and apart.fit.tracks[0].track.unit == self.tracks[0].unit:
                self.ended = [t for t in components.at_the_end(self.tracks) if len(t.t_s)]
            self.findings.evidence["residual_alone"] = alone
            return apart
        self.findings.evidence["residual_alone"] = joint_fit.scale
        return self._as_uncertain_as_departures(joint_fit, components)

    def _separated(self, joint_fit: Fitted, noise: PlaceNoise | None) -> tuple[Fitted, Components]:
        """The joint fit and its components. Where these leave more than noise that is not the tracker's, both once more
        with curves that bend only for independent frames, if that leaves no more: else B's shape would be taken for
        what departs."""
        components = separate(joint_fit, self.rig)
        if components.unexplained > PREDICTS and not components.tracker_errs:
            smoother = as_smooth_as_independent(joint_fit, noise)
            again = separate(smoother, self.rig)
            if again.unexplained < WORSE * components.unexplained:
                return smoother, again
        return joint_fit, components

    def _as_uncertain_as_departures(self, joint_fit: Fitted, components: Components) -> Fitted:
        """The joint fit as it is, with what the departures would change of B in its sigma. An angle sensor's delay
        becomes the nominal one where it is off that by less than the departures leave it uncertain."""
        delay_sigma = max(components.delay_sigma, joint_fit.delay_sigma)
        near_nominal = abs(joint_fit.curves.delay_s - self.nominal_s) < delay_sigma
        if not self.framed and joint_fit.fit.fit_delay and near_nominal:
            smoothing = dict(joint_fit.fit.smoothing)
            fit = replace(joint_fit.fit, fit_delay=False, delay_sigma_s=delay_sigma, smoothing=smoothing)
            joint_fit = fit.solve(replace(joint_fit.curves, delay_s=self.nominal_s))
        width = joint_fit.fit.width(joint_fit.curves)
        joint_fit.fit.residuals(joint_fit.curves)
        spread = np.hypot(components.sigma, components.width - width)
        return replace(joint_fit, spread=spread, delay_spread=delay_sigma, width_by_delay=components.width_by_delay)

    def _several_elements_or_friction(self, joint_fit: Fitted, components: Components) -> HysteresisFit | None:
        """The joint fit with several elements or with friction, whichever has more evidence; None where the tip does
        not start gradually first of all, or where it leaves more than _HELD of the power that one element leaves
        beyond noise."""
        gradual = next((part for part in components.parts if part.name == "phase.even"), None)
        if gradual is None or gradual.rms < max(_GRADUAL, 0.5 * max(part.rms for part in components.parts)):
            return None
        start, fit_delay = components.applied(joint_fit), self.options.delay_s is None
        plays = fit_elements(start, self.rig, fit_delay=fit_delay)
        assert isinstance(plays.fit.hysteresis, Elements)
        candidates = [HysteresisFit(plays, len(plays.fit.hysteresis.width) - 1)]
        friction = (fit_friction([joint_fit, start], self.rig, kind, fit_delay) for kind in PRIORS)
        candidates += [each for each in friction if each is not None]
        best = most_evidence(candidates, components.frames_per_independent)
        several = best.fitted
        # What several leave is no noise: where that is less, it is at most that of a tip at rest.
        noise = components.unexplained
        noise = noise if several.scale > noise else min(noise, 1.0)
        same_scale = replace(several, scale=joint_fit.scale)  # outliers count as much in both
        before, after = (max(rms_over_noise(fitted) ** 2 - noise**2, 0.0) for fitted in (joint_fit, same_scale))
        return best if after < _HELD * before and not several.fit.hysteresis.single else None

    def _measured_range(
        self, curve: WidthCurve | None, joint_fit: Fitted | None, source: str
    ) -> tuple[float, float]:  # fmt: skip
        """The lowest and highest position, unit of q, at which B is measured. With friction a tip starts at every turn:
        then it is what was passed near both envelopes."""
        if joint_fit is None or not isinstance(self.hysteresis, Friction):
            return self.choice.measured(curve, joint_fit, source)
        low, high = overlap(joint_fit)
        return (low, high) if low < high else self.choice.measured(curve, joint_fit, source)

    # ---- f_remain

    def _find_place(self, joint_fit: Fitted) -> None:
        """Estimates where on a bare tip the place lies that was shown and followed instead of a marker; the rig has it
        from here on."""
        shown = self.tracks[0].shown
        if shown is not None and all(track.shown == shown for track in self.tracks):
            self.rig = replace(self.rig, place=place_on_tip(joint_fit, self.rig, shown))

    def _remaining(self, width: Array, delay_s: float, settled_only: bool) -> Remaining | None:
        """f_remain by the way that the options say, with B width (grid,) and the delay, s, held; None where the tip was
        hardly seen to move. settled_only: frames before the tip was driven both ways do not count."""
        if self.options.remaining == "morphological":
            curves = morphological(self.tracks, self.rig, self.grid, delay_s)
            if curves is not None:
                return curves
            self.findings.notes.append("the characteristic shows no closed shape: f_remain was fitted directly instead")
        tracks = self.ended or self.tracks
        return fit_remaining(
            tracks, self.rig, self.domain, self.grid, width, delay_s, settled_only, self.hysteresis, self.effects
        )

    # ---- doubts before the verdict

    def _doubt_onsets_and_remaining(
        self, onsets: Sequence[Onset], remaining: Remaining | None, known_otherwise: bool
    ) -> None:
        """Notes and doubts about onsets and f_remain: no turn, no onset, reversals that do not count, a tip that did
        not move, a rig that does not fit. known_otherwise: B is known without an onset, so that its own sigma and its
        predictions judge it."""
        if self.options.beforehand is not None:
            self.findings.notes.append("B(q) was known beforehand, from other robots: these recordings add to it")
        if stray := sum(track.stray for track in self.tracks):
            self.findings.notes.append(f"{stray} frames show the marker elsewhere for a moment: left out")
        if not onsets:
            self.findings.doubt(
                "coverage", "the motor never turned back", "move back and forth by more than B", fatal=True
            )
        counted = with_width(onsets)
        bounds = [o for o in onsets if o.used and o.kind == BOUND]
        if onsets and not counted:
            longest = max((o.low for o in bounds), default=0.0)
            moved = f", {len(bounds)} strokes up to {longest:.3g} {self.unit} moved nothing, so B is wider"
            self.findings.doubt(
                "coverage",
                f"none of {len(onsets)} reversals showed an onset" + (moved if bounds else ""),
                "make longer strokes" if bounds else "turn where the tip is seen to move",
                mild=known_otherwise and not bounds,
            )
        for reason in dict.fromkeys(o.reason for o in onsets if o.reason and not o.used):
            count = sum(o.reason == reason and not o.used for o in onsets)
            self.findings.notes.append(f"{count} of {len(onsets)} reversals not used: {reason}")
        if remaining is None:
            self.findings.doubt(
                "coverage",
                "the tip was never seen to move, f_remain is f_coarse",
                "move by more than the backlash, within the view",
                fatal=True,
            )
            return
        self.findings.notes += remaining.notes
        self._doubt_rig(remaining)

    def _doubt_place(self, remaining: Remaining | None) -> None:
        """Doubts f_remain, not B, where what is seen is no marker at a known place: by the tip's own camera, or a place
        on it that was shown."""
        place = self.rig.place
        if remaining is None:
            return
        if self.rig.sees_from_tip:
            self.findings.doubt(
                "scene",
                "f_remain is not known from this, B is: what the tip's own camera sees turns by more than the tip "
                "does, by the tip's own way over its distance, and the offset is f_coarse's",
                "measure f_remain with a camera that sees the instrument, or an angle sensor",
            )
            return
        if place is None:
            if any(track.shown is not None for track in self.tracks):
                self.findings.doubt(
                    "place",
                    "f_remain is not known from this, B is: the recordings do not tell where on the tip the place lies",
                    "show one place for all recordings (the same region.toml beside each video), or mark the tip",
                )
            return
        c = np.interp(np.linspace(*self.reached, NODES), self.grid, remaining.c_deg)
        sigma, bends = float(np.sqrt(np.mean(place.sigma_at(c) ** 2))), float(np.ptp(c))
        self.findings.evidence["place_sigma_deg"] = sigma
        unknown = sigma > _TOLD * bends
        self.findings.doubt(
            "place",
            ("f_remain is not known from this, B is" if unknown else "B is known as with a marker, f_remain less so")
            + f": {sigma:.2g} deg of {bends:.3g} deg, all of it together, as the place on the tip is not known",
            "give tip_length_mm of the place that was shown, show a smaller one, or mark the tip",
            mild=not unknown,
        )

    def _doubt_rig(self, remaining: Remaining) -> None:
        """Doubts the rig where f_remain's mean slope has not about f_coarse's sign and size, or the marker is not where
        the rig puts it: before anything else is blamed."""
        p = np.clip(self.grid, *self.reached)
        c = np.interp(p, self.grid, remaining.c_deg)
        gain = float(np.polyfit(p, c, 1)[0]) if np.ptp(p) > 0 else self.rig.coarse.gain
        self.findings.evidence["gain"] = gain
        ratio = gain / self.rig.coarse.gain
        if ratio < 0:
            self.findings.doubt(
                "coarse",
                f"the tip bends {gain:.3g} deg/{self.unit} where f_coarse says {self.rig.coarse.gain:.3g}",
                "a sign is wrong: check encoder direction, coarse.gain, hand_eye, a mirrored image",
            )
        elif not _LIKELY_GAIN[0] < ratio < _LIKELY_GAIN[1]:
            self.findings.doubt(
                "coarse",
                f"the tip bends {gain:.3g} deg/{self.unit} where f_coarse says {self.rig.coarse.gain:.3g}",
                self._remedy_of_scale(ratio),
                mild=self.camera and not self._misplaced(remaining.residual),
            )
        self.findings.evidence["residual"] = remaining.residual
        if self.camera and self._misplaced(remaining.residual):
            self._doubt_registration(remaining.residual, ratio, p, c)

    def _remedy_of_scale(self, ratio: float) -> str:
        """What to check where the tip bends `ratio` times what f_coarse says."""
        if name := mistaken_unit(ratio, self.unit, _UNIT_SLACK):
            return f"a motor in {name} looks like this: write q_{self.unit} of motor.csv in {self.unit}"
        if self.camera:
            return "check actuator.unit, the encoder's scale, camera.fx_px and the marker's distance"
        if name := mistaken_unit(1.0 / ratio, "deg", _UNIT_SLACK):
            return f"a sensor in {name} looks like this: write c_deg of angle.csv in deg"
        return "check actuator.unit, the encoder's scale, coarse.gain, and that angle.csv is in deg"

    def _misplaced(self, residual: float) -> bool:
        """Whether the marker is not where camera, hand_eye and kinematics put it: a residual (px, rms) of more than 5
        px and 20 times the noise."""
        return residual > max(5.0, 20 * float(np.median(self.tracks[0].sigma)))

    def _doubt_registration(self, residual: float, ratio: float, p: Array, c: Array) -> None:
        """Doubts the registration: the marker is residual (px, rms) off the rig's path. Fatal where f_remain had to be
        bent beyond belief to come even so near: then no angle means anything. ratio: f_remain's slope over f_coarse's;
        c (n,): f_remain in deg at p (n,)."""
        coarse = self.rig.coarse
        bent = float(np.max(np.abs(c - (coarse.gain * p + coarse.offset))))
        whole = abs(coarse.gain) * float(np.ptp(p))
        moved = float(np.std(np.concatenate([t.y for t in self.tracks]), axis=0).max())
        likely = _LIKELY_GAIN[0] < ratio < _LIKELY_GAIN[1] and bent < _LIKELY_BEND * whole
        says = f"the marker is {residual:.3g} px (rms) off where camera, hand_eye and kinematics put it"
        if likely or residual < _LARGE * moved:
            self.findings.doubt("registration.static", says, "f_remain absorbs what it can, but check them")
            return
        self.findings.doubt(
            "registration.static",
            f"{says}, and f_remain had to leave f_coarse by {bent:.3g} of {whole:.3g} deg",
            "rig.toml is not of this set-up: check camera (fx_px, size), hand_eye, kinematics and coarse.gain",
            fatal=True,
        )

    # ---- the verdict

    def _judge(self, predictions: Worth | None, measured: _Measured, extent: _Extent) -> None:
        """The verdict: good where the model predicts blocks that the fit has not seen to within the noise, B is known,
        and nothing still changes. What departs, scatters or is hidden says why it is not, and else is worth knowing.
        predictions: None where nothing could be predicted; measured.sigma: with all that is uncertain."""
        found, frames = self.components, sum(len(track.t_s) for track in self.tracks)
        predicts = predictions is None or predictions.predicts
        holds = predicts and (found is None or float(np.hypot(1.0, still_changing(found))) <= PREDICTS)
        if self.held > 0:
            self.findings.notice(
                "acquisition.held_samples",
                f"{frames / (1.0 - self.held) * self.held:.0f} frames repeat a place that the tip had left",
                "let the tracker say when it does not see the marker",
            )
        if not self.hysteresis.single and not predicts:
            held = "several plays" if isinstance(self.hysteresis, Elements) else "Bouc-Wen's and Dahl's equations"
            self.findings.notice(
                "transmission.smooth_onset",
                f"after a reversal the tip starts gradually, and not as {held} do",
                "its hysteresis is of another kind: expect as much of a prediction",
            )
        departs: list[Reason] = []
        if found is not None:
            motor_visible = found.count_visible or any(track.motor_noise > 0 for track in self.tracks)
            departs = component_reasons(found, extent.inside, extent.usual, self.unit, motor_visible, holds)
        doubted = departs or any(not reason.mild for reason in self.findings.reasons)
        if predictions is not None and not predicts and not doubted:
            self.findings.reasons.append(self._unexplained(predictions, measured))
        self.findings.noticed = [*departs, *self.findings.noticed]
        self.findings.judge(holds)
        if not holds and self.camera:
            self.findings.reasons += clock.delay_jumps(self.tracks, self.rig)
        if extent.inside.any():
            self._doubt_sigma(measured, extent, holds)

    def _doubt_sigma(self, measured: _Measured, extent: _Extent, holds: bool) -> None:
        """Doubts B where the rms of its sigma is more than KNOWN of it. Mild if the model holds and the rest is known
        that well once the delay's part is taken off: together B and delay predict as well as either that is known."""
        inside, usual, joint_fit = extent.inside, extent.usual, measured.joint_fit
        unsure = measured.sigma[inside] / usual
        by_delay = np.zeros_like(unsure)
        if joint_fit is not None and joint_fit.width_by_delay is not None:
            by_delay = joint_fit.delay_sigma * joint_fit.width_by_delay[inside] / usual
        all_of_it, of_delay = (float(np.mean(part**2)) for part in (unsure, by_delay))
        if all_of_it <= KNOWN**2:
            return
        more = "move back and forth for longer, and turn at more places"
        if of_delay > 0.5 * all_of_it:
            more = "move at several speeds: at one a delay and a width look alike"
        mild = holds and all_of_it - of_delay <= KNOWN**2
        share = float(np.sqrt(all_of_it))
        says = f"B(q) is known to {share * usual:.2g} {self.unit} only ({share:.1%} of {usual:.2g} {self.unit})"
        self.findings.doubt("coverage", says, more, mild=mild)

    def _unexplained(self, predictions: Worth, measured: _Measured) -> Reason:
        """Why a model does not predict although nothing departs from it: the rig's path, or something else."""
        times = f"{predictions.over_noise:.1f} times the noise"
        joint_fit = measured.joint_fit
        if (
            self.camera
            and joint_fit is not None
            and self.choice.residual_with_width(joint_fit, measured.width) <= PREDICTS
        ):
            says = f"the tip's path in the image is not the rig's: {times} is left"
            return Reason("registration.static", says, "check hand_eye, kinematics and the camera's calibration")
        says = f"what the fit has not seen is foretold to {times}"
        return Reason("residual", says, "taut diagnose says where it is")

    # ---- the result

    def _result(self, found: _Measured) -> Calibration:
        """The calibration: B's sigma completed by what no scatter shows, the model, its predictions, verdict and
        notes."""
        extent = self._extent(found)
        found = replace(found, sigma=self._complete_sigma(found, extent))
        pass_width, pass_sigma = self.choice.opinion_of_passes(found.onsets, found.onset_curve, found.passes)
        characteristic = self._characteristic(found.delay.delay_s)
        if self.components is not None:
            delay = found.delay
            lag_s = self.components.tracker_lag_s
            found = replace(found, delay=replace(delay, sigma_s=float(np.hypot(delay.sigma_s, lag_s))))
        delay_of_tracks_s = found.delay.delay_s
        aligned, delay = self.aligned.with_delay(found.delay, self.nominal_s)
        found = replace(found, delay=delay)
        self._doubt_clock(aligned, delay)
        model = self._model(found, aligned, extent.measured)
        joint_fit = found.joint_fit
        apart = coverage.distance_to_both_ways(joint_fit, self.grid) if joint_fit is not None else 0.0 * self.grid
        gaps = coverage.gaps(model, apart)
        self.findings.notes += [f"{gap.says(self.unit)}, and is held there" for gap in gaps]
        fit_of_remaining = None if found.remaining is None else found.remaining.fitted
        predictions = predictive_worth(model, self.ended or self.tracks, joint_fit, fit_of_remaining)
        if predictions is not None:
            self.findings.reasons += predictions.doubts
            self.findings.evidence |= {
                "error": predictions.model,
                "foretold_over_noise": predictions.over_noise,
                "foretold_blocks": float(predictions.blocks),
                "error_coarse": predictions.coarse,
                "error_constant": predictions.constant,
            }
        self._judge(predictions, found, extent)
        notes = tuple(dict.fromkeys(self.findings.notes))
        extra = self._extra(found, notes, characteristic, pass_width)
        model = replace(model, quality=Quality.of(self.findings.reasons), extra={**model.extra, **extra})
        return Calibration(
            model=model,
            onsets=tuple(found.onsets),
            delay=delay,
            source=found.source,
            onset_curve=found.onset_curve,
            pass_width=pass_width,
            pass_sigma=pass_sigma,
            evidence=self.findings.evidence,
            notes=notes,
            names=tuple(track.name for track in self.tracks),
            offsets=aligned.offsets,
            predicted=tuple(_foretold(model, track, delay_of_tracks_s) for track in self.tracks),
            gaps=gaps,
            path=None if joint_fit is None else joint_fit.path(),
        )

    def _extent(self, found: _Measured) -> _Extent:
        """Where B was measured, and its median there."""
        measured = self._measured_range(found.onset_curve, found.joint_fit, found.source)
        inside = (self.grid > measured[0]) & (self.grid < measured[1])
        return _Extent(measured, inside, usual_width(found.width[inside], self.domain.span))

    def _complete_sigma(self, found: _Measured, extent: _Extent) -> Array:
        """(grid,) B's sigma with what its scatter does not show: errors that all strokes share; half the distance
        beyond what was measured, unless B was known beforehand; what B may change where the tip passed one way only."""
        inside = extent.inside
        known_at = self.grid[inside], found.width[inside], found.sigma[inside]
        floor = common_error(self.tracks, *known_at, extent.usual, self.unit, self.findings)
        known = self.options.beforehand is not None and found.source in (JOINT, PASSES)
        beyond = np.abs(self.grid - np.clip(self.grid, *extent.measured))
        sigma = np.hypot(np.hypot(found.sigma, floor), 0.0 if known else 0.5 * beyond)
        if found.source != ONSETS and found.joint_fit is not None:
            one_way = self.choice.sigma_where_passed_one_way(found.joint_fit, found.width, inside)
            sigma = np.hypot(sigma, one_way)
        return np.asarray(sigma)

    def _doubt_clock(self, aligned: clock.AlignedTracks, delay: Delay) -> None:
        """Doubts a clock that was off and whose offset is not known to _TOLD_S; notes a delay that nothing told."""
        if any(aligned.offsets_s) and delay.sigma_s > _TOLD_S:
            self.findings.doubt(
                "clock.offset",
                f"the sensor's clock was off, and its offset is known to {2e3 * delay.sigma_s:.2g} ms only (2 sigma)",
                "put both on one clock: what a codec or glare holds back of the marker looks like a delay",
                fatal=True,
            )
        if not np.isfinite(delay.sigma_s):
            self.findings.notes.append(
                f"no stop of the tip told the delay: the nominal {delay.delay_s * 1e3:.0f} ms is used"
            )

    def _model(self, found: _Measured, aligned: clock.AlignedTracks, measured: tuple[float, float]) -> Model:
        """The model, without verdict and extra. Where a board cannot hold its hysteresis it carries the plays that come
        nearest to it, which is noted."""
        coarse, remaining = self.rig.coarse, found.remaining
        c = remaining.c_deg if remaining is not None else coarse.gain * self.grid + coarse.offset
        c_sigma = remaining.sigma_deg if remaining is not None else np.full(len(c), np.nan)
        if self.rig.place is not None:
            c_sigma = np.hypot(c_sigma, self.rig.place.sigma_at(c))
        model = Model(
            self.rig, self.grid, found.width, found.sigma, c, found.delay.delay_s, measured, c_sigma=c_sigma,
            sensor=self.tracks[0].sensor, offset_s=aligned.offset_s,
            effects=() if self.effects is None else self.effects[0].to_effects(self.effects[1]),
            elements=self.hysteresis if isinstance(self.hysteresis, Elements) else SINGLE,
            friction=self.hysteresis if isinstance(self.hysteresis, Friction) else None,
            extra={LOAD: self.load_mNm} if self.load_mNm else {},
        )  # fmt: skip
        if (near := stands_in(model)) is not None:
            self.findings.notes.append(self._note_of_plays(near))
            model = model if model.friction is None else replace(model, elements=near.elements)
        return model

    def _extra(
        self, found: _Measured, notes: Sequence[str], characteristic: dict[str, Any], pass_width: Array | None
    ) -> dict[str, Any]:
        """What model.json keeps of a calibration beside the model itself (formats)."""
        names = tuple(track.name for track in self.tracks)
        joint_fit = found.joint_fit
        extra: dict[str, Any] = {
            "source": found.source,
            "delay_sigma_s": _finite(found.delay.sigma_s),
            "onsets": [onset_json(o, names) for o in found.onsets],
            "evidence": {key: _finite(value) for key, value in self.findings.evidence.items()},
            "notes": list(notes),
            "characteristic": characteristic,
            "options": asdict(replace(self.options, beforehand=None)),
            "tracked_px": max(track.tracked_px for track in self.tracks),
        }
        if joint_fit is not None and joint_fit.width_by_delay is not None and found.source == JOINT:
            extra["width_by_delay"] = [_finite(v) for v in joint_fit.width_by_delay]
        if pass_width is not None:
            extra["pass_width"] = [_finite(v) for v in pass_width]
        return extra

    def _note_of_plays(self, near: Nearest) -> str:
        """The note that a board's tables hold a few plays instead of this hysteresis, and what these leave."""
        plays = f"{len(near.elements.width)} plays, which leave {100.0 * near.share:.2g} % of what there is to undo"
        if isinstance(self.hysteresis, Friction):
            its = self.hysteresis.says(self.unit)
            return f"its hysteresis is {its}: a board's tables and what follows the tip in use hold {plays}"
        return f"its hysteresis is {len(self.hysteresis.width)} plays: a board's tables hold {plays}"

    def _characteristic(self, delay_s: float) -> dict[str, Any]:
        """Some 3000 frames of (q, c) for the report's picture, c in deg by pose; without angles far off the coarse
        range."""
        stride = max(1, sum(len(track.t_s) for track in self.tracks) // 3000)
        tracks = [track.only(slice(None, None, stride)) for track in self.tracks]
        q = np.concatenate([t.motor_at(t.scene_s(delay_s)) for t in tracks])
        c = np.concatenate([pose_of(t, self.rig, delay_s) for t in tracks])
        low, high = coarse_range_deg(self.rig)
        good = np.flatnonzero(np.isfinite(c) & (np.abs(c) < 10 * max(abs(low), abs(high), 1.0)))
        return {"q": np.round(q[good], 5).tolist(), "c_deg": np.round(c[good], 4).tolist()}
