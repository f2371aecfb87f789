"""The steps that measure, in order: delay, onsets, B(q) by the joint fit with what departs from it, f_remain; alone, or
beside effects that a diagnosis named.

grid: the (NODES,) motor positions at which B and f_remain are tabulated; B and positions are in the unit of q.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
import numpy.typing as npt

from tautline.calibration import clock
from tautline.calibration.acquisition import in_another_unit
from tautline.calibration.angle_delay import at_credible_delay, delay_of_all
from tautline.calibration.backlash import WidthCurve, fit_widths
from tautline.calibration.beside import FittedEffects
from tautline.calibration.choice import JOINT, Choice, image_jumps
from tautline.calibration.components import LAW, WORSE, Components, EndedTrack, separate
from tautline.calibration.departures import SPEED
from tautline.calibration.findings import Findings
from tautline.calibration.holding import without_held_places
from tautline.calibration.hysteresis import PRIORS, HysteresisFit, fit_friction, most_evidence
from tautline.calibration.lag_scan import period_s
from tautline.calibration.observations import LITTLE, Track
from tautline.calibration.on_tip import place_on_tip
from tautline.calibration.onset import HINGE, Delay, Onset, delayed, find_onsets, with_timing_errors
from tautline.calibration.options import Options
from tautline.calibration.place import (
    PlaceNoise,
    allowing_for_place,
    as_many_as_independent,
    as_smooth_as_independent,
    place_noise,
)
from tautline.calibration.playfit import NODES, Curves, Fitted, PlayFit
from tautline.calibration.remaining import Remaining, fit_morphologically, fit_remaining, track_by_pose
from tautline.calibration.several import fit_elements, rms_over_noise
from tautline.calibration.smooth import Domain, fit_jointly, fit_passes, prepare_tracks
from tautline.calibration.wandering import allowing_for_wander
from tautline.calibration.worth import PREDICTS
from tautline.diagnosis import start
from tautline.effects import OWNER
from tautline.effects.library.lag import width_by_drag
from tautline.effects.library.rate_dependent_backlash import added_width
from tautline.elements import SINGLE, Elements, Hysteresis
from tautline.errors import TautError
from tautline.model import Model
from tautline.quality import Reason
from tautline.rig import Rig
from tautline.spread import of_rounding

Array = npt.NDArray[np.float64]
Progress = Callable[[float, str], None]

_LATER = 0.05  # tolerance: of a frame's period: by less, onsets are moved with the delay and not looked for again
_GRADUAL = 0.4  # prior: rms over noise of phase.even from which several elements or friction are tried
_HELD = 0.5  # prior: of the power that one element leaves beyond noise: what several may leave at most
_OF_SENSORS = frozenset({"turn", "tracker"})  # departures that no effect of the library looks like
_OF_ELEMENTS = frozenset({"phase.even", "image.side"})  # departures that several elements, or their number, stand for
_GRADUAL_START = "transmission.smooth_onset"  # the effect that several elements are
_RATE, _LAG = OWNER["width_per_speed"].id, OWNER["lag"].id
_SLOWEST = 0.1  # tolerance: of the frames: slower than these nothing tells the law of the speed
_MOVES = 5.0  # tolerance: counts of the encoder: a motor that moves by less does not
_MOST_Z2 = 9.0  # prior: mean squared z of onsets by which their variance is increased at most
# tolerance: of B, and of the range with it: how far beyond an onset a pass begins
_BEYOND, _BEYOND_OF_RANGE = 0.1, 0.005
_FIRST_OF_ALL = 0.5  # prior: of the strongest departure's rms: a gradual start of less is not the main one
_BETWEEN_ELEMENTS = 0.003  # prior: of B: what elements of a few shares leave, alike on every stroke


class _Setting:
    """What follows from rig and tracks, while they are measured and after it."""

    rig: Rig
    tracks: Sequence[Track]
    domain: Domain
    grid: Array
    findings: Findings

    @property
    def camera(self) -> bool:
        """Whether the tip was seen in an image of the rig's camera."""
        return self.tracks[0].unit == "px"

    @property
    def framed(self) -> bool:
        """Whether the delay is a camera's, the rig's or the tip's own: its images stand still after a turn."""
        return self.camera or self.rig.sees_from_tip

    @property
    def unit(self) -> str:
        """The unit of q."""
        return self.rig.actuator.unit

    @property
    def nominal_s(self) -> float:
        """The rig's delay of this sensor, s."""
        return self.rig.nominal_delay_s(self.tracks[0].sensor)

    @property
    def choice(self) -> Choice:
        """A `Choice` of B between its opinions, with these tracks and findings."""
        return Choice(self.tracks, self.domain, self.grid, self.unit, self.findings)


@dataclass(frozen=True)
class Measured(_Setting):
    """What one calibration was given and what its fits found. Arrays (grid,); positions and B in the unit of q."""

    aligned: clock.AlignedTracks
    rig: Rig  # with the place on a bare tip that was followed
    options: Options
    findings: Findings  # on the way; the verdict adds to them
    domain: Domain
    reached: tuple[float, float]  # lowest and highest position of the motor
    grid: Array
    tracks: Sequence[Track]  # without what a tracker held back
    onsets: Sequence[Onset]
    delay: Delay
    onset_curve: WidthCurve | None  # B by the onsets alone
    joint_fit: Fitted | None
    passes: Fitted | None
    width: Array  # B that counts
    sigma: Array  # its standard deviation
    source: str  # where B is from: a constant of choice.py
    remaining: Remaining | None
    components: Components | None = None
    held: float = 0.0  # share of the frames that repeat a place that the tip had left
    ended: Sequence[EndedTrack] = ()  # the tracks as if seen with the state of the session's end, if that changed
    hysteresis: Hysteresis = SINGLE
    effects: tuple[FittedEffects, Array] | None = None  # beside the play, and their values
    load_mNm: float = 0.0  # at which B and f_remain hold beside them

    @property
    def departs(self) -> bool:
        """Whether the recordings show more than B, path, delay and noise: an unexplained residual above PREDICTS, or a
        component other than those of the sensors (a motor's counts, a tracker's error)."""
        found = self.components
        return found is not None and (
            found.unexplained > PREDICTS or any(part.name not in _OF_SENSORS for part in found.parts)
        )


class Measuring(_Setting):
    """The measurement of tracks on one clock: the steps in order, and what they have found so far. Positions and B in
    the unit of q."""

    def __init__(
        self, aligned: clock.AlignedTracks, rig: Rig, options: Options, say: Progress, reasons: Sequence[Reason] = ()
    ) -> None:
        """say: is told the progress; reasons: doubts that were found before. The grid covers the rig's range and what
        the motor reached beyond it by more than half a count; only what it reached if the range is in another unit."""
        self.aligned, self.rig, self.options, self.say = aligned, rig, options, say
        self.tracks = tracks = aligned.tracks
        self.findings = Findings([*aligned.reasons, *reasons], list(aligned.notes))
        self.components: Components | None = None
        self.held = 0.0  # share of the frames that repeat a place that the tip had left
        self.ended: Sequence[EndedTrack] = ()
        self.hysteresis: Hysteresis = SINGLE
        self.effects: tuple[FittedEffects, Array] | None = None  # beside the play, and their values
        self.load_mNm = 0.0  # at which B and f_remain hold beside them
        reached = [(float(t.motor.q.min()), float(t.motor.q.max())) for t in tracks]
        self.reached = min(r[0] for r in reached), max(r[1] for r in reached)
        low, high = self.reached if in_another_unit(self.reached, rig) else rig.actuator.range
        half = 0.5 * rig.actuator.encoder_resolution  # by less a position is not beyond the range
        below, above = self.reached[0] < low - half, self.reached[1] > high + half
        self.domain = Domain(self.reached[0] if below else low, self.reached[1] if above else high)
        self.grid = np.linspace(self.domain.low, self.domain.high, NODES)

    def run(self) -> Measured:
        """Measures delay, onsets, B and f_remain in turn. Raises TautError if the motor does not move."""
        if self.reached[1] - self.reached[0] < max(
            _MOVES * self.rig.actuator.encoder_resolution, LITTLE * self.domain.span
        ):
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
            onsets, curve = self._onsets_at(delay, first, onsets)
        gradual = self.components is not None and any(
            part.name.startswith(("phase", SPEED)) for part in self.components.parts
        )
        like_paper = self.options.knots == "paper"
        width, sigma, source = self.choice.choose(
            onsets, curve, joint_fit, passes, like_paper=like_paper, gradual=gradual
        )  # fmt: skip
        if source == JOINT:
            onsets = _with_sigma_of_scatter(onsets, self.findings.evidence["onsets_against_joint_z2"])
        self.say(0.75, "fitting f_remain")
        settled_only = joint_fit.fit.settled_only if joint_fit is not None else False
        if joint_fit is not None:
            self._find_place(joint_fit)
        remaining = self._remaining(width, delay.delay_s, settled_only) if self.choice.tip_moves() else None
        return self._measured(onsets, delay, curve, joint_fit, passes, width, sigma, source, remaining)

    def run_with_effects(self, before: Measured, told: start.Start) -> Measured | None:
        """What `run` finds, with the effects that a diagnosis named fitted together with B, path and delay. before: the
        run without effects; told: the diagnosis, with the effects, its nominal model and the load at which that holds.
        If an effect has several forms each is fitted; the most probable one counts, and the others add to the sigmas of
        B and delay. None if there is no joint fit, or none of the effects can be fitted."""
        if before.joint_fit is None:
            return None
        named = told.effects
        if not before.hysteresis.single and any(effect.id == _GRADUAL_START for effect in named):
            self.hysteresis = before.hysteresis  # its elements or friction are the gradual start
            named = tuple(effect for effect in named if effect.id != _GRADUAL_START)
        nominal = told.fit.state.model
        self.load_mNm = told.fitter.load_reference
        law = replace(nominal, load_reference_mNm=self.load_mNm)
        by_pose = all(track.posed for track in self._on_one_curve(before.delay.delay_s))
        effects, values = FittedEffects.of(named, law, others_rest=not by_pose)
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
        # B and delay are as uncertain as the forms differ, by how probable each is, and B as another law of the speed.
        late_s = np.array([fit.curves.delay_s - joint_fit.curves.delay_s for fit in fits])
        apart = np.array([fit.fit.width(fit.curves) - joint_fit.fit.width(joint_fit.curves) for fit in fits])
        delay = self._delay_of_joint_fit(before.delay, joint_fit)
        delay = replace(delay, sigma_s=float(np.sqrt(delay.sigma_s**2 + probability @ late_s**2)))
        onsets, curve = self._onsets(delay)
        width = self.choice.held_beyond_measured(joint_fit, curve)
        by_law = LAW * self._width_extrapolated_to_rest(joint_fit)
        sigma = np.sqrt(joint_fit.width_sigma(self.grid) ** 2 + probability @ apart**2 + by_law**2)
        self.findings.evidence |= {"residual_joint": joint_fit.scale, "width_by_law_of_speed": by_law}
        self.say(0.75, "fitting f_remain")
        self._find_place(joint_fit)
        remaining = self._remaining(width, delay.delay_s, joint_fit.fit.settled_only)
        return self._measured(onsets, delay, curve, joint_fit, None, width, sigma, JOINT, remaining)

    def _width_extrapolated_to_rest(self, joint_fit: Fitted) -> float:
        """How far B is extrapolated to slow strokes, unit of q, if it follows the motor's speed: what the fitted laws
        (a width by speed, drag beside friction) add to B at the slowest tenth of the counted moving frames. Tables hold
        B of slow strokes, and below that speed only the law tells it. 0 if B follows no speed."""
        effects, values = joint_fit.effects_and_values
        laws = {effect.id: effect.parameters for effect in effects.to_effects(values)}
        pairs = zip(joint_fit.fit.simulated, joint_fit.masks, strict=True)
        speeds = np.concatenate([np.abs(s.speed[mask & s.moving]) for s, mask in pairs])
        slowest, added = np.quantile(speeds, [_SLOWEST]) if len(speeds) else np.zeros(1), np.zeros(1)
        if _RATE in laws:
            added = added + added_width(laws[_RATE], float(self.grid[-1] - self.grid[0]), slowest)
        if laws.get(_LAG, {}).get("lag_held"):
            added = added + width_by_drag(laws[_LAG], slowest)
        return float(added[0])

    def _measured(
        self, onsets: Sequence[Onset], delay: Delay, curve: WidthCurve | None, joint_fit: Fitted | None,
        passes: Fitted | None, width: Array, sigma: Array, source: str, remaining: Remaining | None,
    ) -> Measured:  # fmt: skip
        """The `Measured` of these results, with what the steps have left in this object."""
        return Measured(
            self.aligned, self.rig, self.options, self.findings, self.domain, self.reached, self.grid, self.tracks,
            onsets, delay, curve, joint_fit, passes, width, sigma, source, remaining,
            components=self.components, held=self.held, ended=self.ended, hysteresis=self.hysteresis,
            effects=self.effects, load_mNm=self.load_mNm,
        )  # fmt: skip

    def _fit_with_effects(
        self, before: Fitted, nominal: Model, delay_s: float, effects: FittedEffects, values: Array
    ) -> Fitted:
        """The joint fit with effects. It starts from the nominal model's B, a delay, s, values (m_e,) of the effects
        and the path that fits best with these. Frames before the tip was driven both ways do not count, as it is not
        known what effects did until then. Its covariance allows for errors of place and of the effects' laws. before:
        the joint fit without effects."""
        fit_delay = self.options.delay_s is None
        prepared = prepare_tracks(self._on_one_curve(delay_s), delay_s)
        basis = before.fit.backlash
        fit = PlayFit(
            prepared, basis, basis, fit_delay=fit_delay, beforehand=before.fit.beforehand, effects=effects,
            hysteresis=self.hysteresis,
        )  # fmt: skip
        channels = prepared[0].track.y.shape[1]
        backlash = basis.nearest(self.grid, np.interp(self.grid, nominal.q, nominal.width))
        curves = Curves(
            backlash, np.zeros((basis.size, channels)), delay_s if fit_delay else before.curves.delay_s, values
        )
        path_only = replace(
            fit, fit_backlash=False, fit_delay=False, fit_effects=False, smoothing=dict(fit.smoothing)
        )  # fmt: skip
        joint_fit = fit.solve(path_only.step(curves, *path_only.residuals(curves)))
        joint_fit = allowing_for_place(joint_fit, place_noise(joint_fit))
        joint_fit = allowing_for_wander(joint_fit)
        # dB/d(delay) along the posterior: cov(B, delay) / var(delay); the delay is the last unknown.
        block, delay_variance = fit.layout(joint_fit.curves).backlash, joint_fit.covariance[-1, -1]
        width_by_delay = basis.design(self.grid).toarray() @ joint_fit.covariance[block, -1] / delay_variance
        return replace(joint_fit, width_by_delay=width_by_delay) if fit_delay and delay_variance > 0.0 else joint_fit

    def _refit_with_own_law(self, before: Fitted, joint_fit: Fitted) -> Fitted:
        """The joint fit with effects once more, with the f_remain that the first one (joint_fit) leaves: by f_remain
        what effects add to the bending angle is turned into a way along the path. The first fit itself if no f_remain
        can be fitted. before: the joint fit without effects. Sets `effects`."""
        self.effects = effects, values = joint_fit.effects_and_values
        width, delay_s = joint_fit.fit.width(joint_fit.curves), joint_fit.curves.delay_s
        remaining = self._remaining(width, delay_s, joint_fit.fit.settled_only)
        if remaining is None:
            return joint_fit
        law = replace(effects.law, q=self.grid, width=width, width_sigma=0.0 * width, c_deg=remaining.c_deg)
        return self._fit_with_effects(before, law, delay_s, replace(effects, law=law), values)

    def _leave_out_held_places(self) -> None:
        """Leaves out of `tracks` the frames at which the tracker repeated a place that the tip had left, and sets
        `held`, their share. Does nothing for an angle sensor, whose repeats are its own or those of a joint that
        sticks."""
        if not self.camera:
            return
        before = sum(len(track.t_s) for track in self.tracks)
        self.tracks = without_held_places(
            self.tracks, lambda: self._on_one_curve(self.nominal_s), self.domain, self.nominal_s
        )  # fmt: skip
        self.held = 1.0 - sum(len(track.t_s) for track in self.tracks) / before

    # ---- delay and onsets

    def _first_delay(self) -> Delay:
        """The delay to begin with: the given one, with sigma 0; else a camera's by the image's stops, an angle sensor's
        by all its values."""
        if self.options.delay_s is not None:
            return Delay(self.options.delay_s, 0.0, 0)
        if not self.framed:
            return delay_of_all(self.tracks, self.rig)
        return clock.delay_of_stops(self.tracks, self.rig)

    def _delay_of_joint_fit(self, stops: Delay, joint_fit: Fitted) -> Delay:
        """The joint fit's delay, s, with a sigma. To the fit's own sigma is added the rounding of the motor's counts at
        turns: an error of time at the motor's median speed, independent at each of the stops. If the delay was not
        fitted the sigma is that of `stops`, for the nominal delay a frame's period at most. inf if the tip moves at no
        frame. stops: the delay by the image's stops, or what stood for it."""
        speeds = np.concatenate([np.abs(s.speed[s.moving]) for s in joint_fit.fit.simulated])
        if not len(speeds):
            return Delay(joint_fit.curves.delay_s, np.inf, stops.stops)
        speed = float(np.median(speeds))
        rounding_s = of_rounding(self.rig.actuator.encoder_resolution) / max(speed, 1e-9) / np.sqrt(max(stops.stops, 1))
        own = joint_fit.delay_sigma
        if not joint_fit.fit.fit_delay:
            at_nominal = joint_fit.curves.delay_s == self.nominal_s
            own = min(stops.sigma_s, period_s(self.tracks)) if at_nominal else stops.sigma_s
        return Delay(joint_fit.curves.delay_s, float(np.hypot(own, rounding_s)), stops.stops)

    def _onsets(self, delay: Delay) -> tuple[list[Onset], WidthCurve | None]:
        """All onsets at this delay, and the curve of B through their widths; None if there are no widths."""
        onsets = find_onsets(self.tracks, self.rig, delay.delay_s, delay.sigma_s)
        return onsets, fit_widths(onsets, self.grid)

    def _onsets_at(self, delay: Delay, first: Delay, onsets: list[Onset]) -> tuple[list[Onset], WidthCurve | None]:
        """Onsets and the curve of B through them at the joint fit's `delay`. `onsets` were found at the delay `first`:
        they are found anew where the two differ by more than _LATER of a frame's period, else moved."""
        later_s = delay.delay_s - first.delay_s
        if abs(later_s) > _LATER * period_s(self.tracks):
            return self._onsets(delay)
        onsets = with_timing_errors(delayed(onsets, self.tracks, later_s), self.tracks, self.rig, delay.sigma_s)
        return onsets, fit_widths(onsets, self.grid)

    # ---- B

    def _on_one_curve(self, delay_s: float) -> Sequence[Track]:
        """Tracks on which the tip follows one curve, at this delay, s: the image itself; or bending angles by pose,
        with a note, if translation or rotation are away from where they mostly are at half of the frames or more."""
        reference = self.tracks[0].others_reference
        still = np.concatenate([track.at_reference(track.scene_s(delay_s), reference) for track in self.tracks])
        if not self.camera or np.mean(still) > 0.5:
            return self.tracks
        self.findings.notes.append(
            "translation or rotation move most of the time: B(q) rests on the pose, as right as camera and hand_eye are"
        )
        return [track_by_pose(track, self.rig, delay_s) for track in self.tracks]

    def _fit_jointly(
        self, onsets: Sequence[Onset], delay: Delay, curve: WidthCurve | None
    ) -> tuple[Fitted | None, Fitted | None]:
        """The joint fit of B, path and delay, together with what departs from it, and the fit of the passes alone;
        (None, None) if too little was seen, and None for the passes if these are too few. The delay is held at `delay`
        if that was given by the user, and for a camera if the image jumps or the fit leaves more than noise. curve: B
        by the onsets, a first guess."""
        prepared = prepare_tracks(self._on_one_curve(delay.delay_s), delay.delay_s)
        fit_delay = self.options.delay_s is None
        joint_fit = fit_jointly(
            prepared, self.domain, delay.delay_s, fit_delay=fit_delay, guess=curve,
            beforehand=self.options.beforehand,
        )  # fmt: skip
        if joint_fit is None:
            return None, None
        if fit_delay and not self.framed:
            joint_fit = at_credible_delay(joint_fit, delay, self.tracks, self.nominal_s)
        elif fit_delay and (image_jumps(onsets) or not joint_fit.explained):
            # What the model does not know would bend the delay: the image stops tell it alone.
            joint_fit.fit.fit_delay = False
            joint_fit = joint_fit.fit.solve(replace(joint_fit.curves, delay_s=delay.delay_s))
        if fit_delay and not joint_fit.fit.fit_delay:
            joint_fit.fit.delay_sigma_s = min(self._delay_of_joint_fit(delay, joint_fit).sigma_s, 1.0)
        self.say(0.5, "looking for what is no play")
        joint_fit = self._with_departures(joint_fit, onsets, curve)
        self.say(0.6, "fitting the passes alone")
        usual = float(np.median(joint_fit.fit.width(joint_fit.curves)))
        margin = _BEYOND * usual + _BEYOND_OF_RANGE * self.domain.span
        passes = fit_passes(joint_fit, margin)
        return joint_fit, None if passes is None else as_many_as_independent(passes)

    def _with_departures(self, joint_fit: Fitted, onsets: Sequence[Onset], curve: WidthCurve | None) -> Fitted:
        """The joint fit with B as estimated together with the departures (components.py), if that B predicts about as
        well alone or the onsets favour it; else the fit without them, with larger sigmas. Sets `components`,
        `hysteresis` and, if a state changed during the session, `ended`; adds to the evidence."""
        noise = place_noise(joint_fit)
        if noise is not None:
            self.findings.evidence |= {f"place_{key}": value for key, value in asdict(noise).items()}
        joint_fit = allowing_for_place(joint_fit, noise)
        self.findings.evidence["residual_before_components"] = joint_fit.scale
        joint_fit, components = self._separate_components(joint_fit, noise)
        if self.options.elements == "auto" and not image_jumps(onsets):
            joint_fit, components = self._with_hysteresis(joint_fit, components)
        self.components = components
        self.findings.evidence["residual_components"] = components.unexplained
        for part in components.parts:
            self.findings.evidence[f"component_{part.name}"] = part.rms
        apart = components.applied_to(joint_fit)
        alone = self.choice.residual_without_departures(components, apart, joint_fit)
        if self.choice.predicts_as_well(alone, joint_fit) or self.choice.onsets_favour_departures(
            onsets, curve, components, apart, joint_fit
        ):
            if components.from_end and apart.fit.tracks[0].track.unit == self.tracks[0].unit:
                self.ended = components.at_the_end(self.tracks)
            self.findings.evidence["residual_alone"] = alone
            return apart
        self.findings.evidence["residual_alone"] = joint_fit.scale
        return self._with_uncertainty_of_departures(joint_fit, components)

    def _with_hysteresis(self, joint_fit: Fitted, components: Components) -> tuple[Fitted, Components]:
        """The joint fit and its components with several elements or friction, if the tip starts gradually and these
        hold it; else both as they are. Sets `hysteresis` to the one found. B's sigma is increased by the uncertainty of
        the friction, or by what a few elements leave."""
        several = self._several_elements_or_friction(joint_fit, components)
        if several is None:
            return joint_fit, components
        self.hysteresis = several.fitted.fit.hysteresis
        components = separate(several.fitted, self.rig, without=_OF_ELEMENTS)
        spread = _BETWEEN_ELEMENTS * components.width if several.spread is None else several.spread
        return several.fitted, replace(components, sigma=np.hypot(components.sigma, spread))

    def _separate_components(self, joint_fit: Fitted, noise: PlaceNoise | None) -> tuple[Fitted, Components]:
        """The joint fit and its components. If these leave more than noise, and not by a tracker's error, both are made
        once more with curves smoothed for as many frames as are independent, and taken if they leave no more: then the
        first curves had bent to what departs. If they leave more, the bends are B's shape. noise: of `place_noise`,
        None if that is not known."""
        components = separate(joint_fit, self.rig)
        if components.unexplained > PREDICTS and not components.tracker_errs:
            smoother = as_smooth_as_independent(joint_fit, noise)
            again = separate(smoother, self.rig)
            if again.unexplained < WORSE * components.unexplained:
                return smoother, again
        return joint_fit, components

    def _with_uncertainty_of_departures(self, joint_fit: Fitted, components: Components) -> Fitted:
        """The joint fit without the departures, with sigmas that include how much these would change B. An angle
        sensor's delay that differs from the nominal one by less than its sigma (the larger of the departures' and the
        fit's) becomes the nominal one, and all is fitted anew."""
        delay_sigma = max(components.delay_sigma, joint_fit.delay_sigma)
        near_nominal = abs(joint_fit.curves.delay_s - self.nominal_s) < delay_sigma
        if not self.framed and joint_fit.fit.fit_delay and near_nominal:
            smoothing = dict(joint_fit.fit.smoothing)
            fit = replace(joint_fit.fit, fit_delay=False, delay_sigma_s=delay_sigma, smoothing=smoothing)
            joint_fit = fit.solve(replace(joint_fit.curves, delay_s=self.nominal_s))
        width = joint_fit.fit.width(joint_fit.curves)
        joint_fit.fit.simulate(joint_fit.curves)
        spread = np.hypot(components.sigma, components.width - width)
        return replace(joint_fit, spread=spread, delay_spread=delay_sigma, width_by_delay=components.width_by_delay)

    def _several_elements_or_friction(self, joint_fit: Fitted, components: Components) -> HysteresisFit | None:
        """The joint fit with several elements or with friction, whichever has more evidence. None if a gradual start is
        no component or not the main one (_GRADUAL, _FIRST_OF_ALL), or if the fit leaves _HELD or more of the power that
        one element leaves beyond noise."""
        gradual = next((part for part in components.parts if part.name == "phase.even"), None)
        if gradual is None or gradual.rms < max(_GRADUAL, _FIRST_OF_ALL * components.strongest_rms):
            return None
        apart, fit_delay = components.applied_to(joint_fit), self.options.delay_s is None
        plays = fit_elements(apart, self.rig, fit_delay=fit_delay)
        assert isinstance(plays.fit.hysteresis, Elements)
        candidates = [HysteresisFit(plays, len(plays.fit.hysteresis.width) - 1)]
        friction = (fit_friction([joint_fit, apart], self.rig, kind, fit_delay) for kind in PRIORS)
        candidates += [each for each in friction if each is not None]
        best = most_evidence(candidates, components.frames_per_independent)
        several = best.fitted
        # What several leave is no noise: where that is less, it is at most that of a tip at rest.
        noise = components.unexplained
        noise = noise if several.scale > noise else min(noise, 1.0)
        same_scale = replace(several, scale=joint_fit.scale)  # outliers count as much in both
        before, after = (max(rms_over_noise(fitted) ** 2 - noise**2, 0.0) for fitted in (joint_fit, same_scale))
        return best if after < _HELD * before and not several.fit.hysteresis.single else None

    # ---- f_remain

    def _find_place(self, joint_fit: Fitted) -> None:
        """Sets the rig's `place`, if the same place on a bare tip was shown and followed in all tracks: where on the
        tip it is, None if that cannot be found. Leaves the rig as it is with a marker or with different places."""
        shown = self.tracks[0].shown
        if shown is not None and all(track.shown == shown for track in self.tracks):
            self.rig = replace(self.rig, place=place_on_tip(joint_fit, self.rig, shown))

    def _remaining(self, width: Array, delay_s: float, settled_only: bool) -> Remaining | None:
        """f_remain by the way that the options say, with B width (grid,) and the delay, s, held; on the tracks as of
        the session's end, if there are any. None if too little was seen to move. settled_only: frames before the tip
        was driven both ways do not count. A note is added if the morphological way cannot be used."""
        if self.options.remaining == "morphological":
            curves = fit_morphologically(self.tracks, self.rig, self.grid, delay_s)
            if curves is not None:
                return curves
            self.findings.notes.append("the characteristic shows no closed shape: f_remain was fitted directly instead")
        tracks, shared = [each.track for each in self.ended] or self.tracks, [each.spread for each in self.ended]
        return fit_remaining(
            tracks, self.rig, self.domain, self.grid, width, delay_s, settled_only, self.hysteresis, self.effects,
            shared,
        )  # fmt: skip


def _with_sigma_of_scatter(onsets: Sequence[Onset], z2: float) -> list[Onset]:
    """The onsets, with the sigmas of used hinges multiplied by sqrt(z2), so that their scatter about the joint fit's B
    is explained. It is taken for the onsets' own, as that B is much surer. z2: mean squared z of the onsets against
    that B, clipped to 1 to _MOST_Z2."""
    spread = float(np.sqrt(np.clip(z2, 1.0, _MOST_Z2)))
    return [replace(o, sigma=o.sigma * spread) if o.used and o.kind == HINGE else o for o in onsets]


def _probabilities(fits: Sequence[Fitted]) -> Array:
    """(n,) probability of each of n fits of the same frames, all equally probable before: proportional to scale^-N, the
    likelihood with the noise's size integrated out, with N the number of independent residuals."""
    noise = place_noise(fits[0])
    number = fits[0].frames * fits[0].residuals[0].shape[1] / (1.0 if noise is None else noise.effect)
    log = -number * np.log([fit.scale for fit in fits])
    likely = np.exp(log - log.max())
    return np.asarray(likely / likely.sum())
