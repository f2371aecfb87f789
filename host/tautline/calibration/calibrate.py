"""From recordings to a model: onsets, delay, B(q), its second opinion from the passes, f_remain, and their worth."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from tautline.calibration import clock
from tautline.calibration.acquisition import doubts as acquisition_doubts
from tautline.calibration.acquisition import in_another_unit
from tautline.calibration.backlash import WidthCurve, fit_paper, fit_widths
from tautline.calibration.components import Components, separate
from tautline.calibration.doubts import doubts, floor_of
from tautline.calibration.observations import Track, observe
from tautline.calibration.onset import BOUND, BRACKET, HINGE, Delay, Onset, find_onsets
from tautline.calibration.place import (
    allowing_for_place,
    as_many_as_independent,
    as_smooth_as_independent,
    place_noise,
)
from tautline.calibration.playfit import NODES, Fitted
from tautline.calibration.remaining import Remaining, fit_remaining, morphological, pose_of, posed
from tautline.calibration.several import fit_elements
from tautline.calibration.smooth import Domain, fit_jointly, fit_passes, freeze, overlap
from tautline.calibration.worth import worth
from tautline.elements import SINGLE
from tautline.errors import TautError
from tautline.geometry import coarse_range_deg
from tautline.model import Model, allowed_width
from tautline.quality import Quality, Reason
from tautline.recording import Recording
from tautline.rig import Rig

Array = npt.NDArray[np.float64]
Progress = Callable[[float, str], None]

ONSETS, JOINT, PASSES, NOTHING = "onsets", "onsets and passes", "passes", "nothing"
_AGREE = 3.0  # mean squared z of onsets against the joint fit up to which both are one evidence
_LEAST_FRAMES = 10
_STANDS_OUT = 10.0  # a motion of so many sigma is one
_AT_ONCE = 0.75  # of the path's slope: a tip that starts slower starts gradually
_SURER = 2.0  # times less certain: the joint fit's B beside the onsets'
_LITTLE = 0.03  # of the width: differences below are no contradiction
_GRADUAL = 0.4  # noise: what a gradual start must leave for several elements to be tried
_WORSE = 1.25  # times what the best single curve leaves: a B that leaves more is not for predictions
_FEW_ONSETS, _NEARER = 6, 0.5  # onsets that may say so, and their mean squared z against one B over that to the other
_HELD = 0.5  # of the square of what one element leaves beyond noise: several may leave so much
_LIKELY_GAIN = (0.4, 2.5)  # of f_coarse's, between which f_remain's is no wrong scale
_LIKELY_BEND = 0.5  # of f_coarse's span, by which f_remain may leave it
_LARGE = 0.1  # of the image's motion (rms): a registration that is off by less still tells angles
_EXPLAINED = 1.5  # residual over noise up to which a model explains its data
_UNNAMED = 1.3  # the same of model and departures: beyond, what is left has no name


@dataclass(frozen=True)
class Options:
    delay_s: float | None = None  # given, not estimated
    knots: Literal["smooth", "paper"] = "smooth"  # paper: 14 knots through the onsets alone
    remaining: Literal["direct", "morphological"] = "direct"
    elements: Literal["auto", "one"] = "auto"  # of the play: several where the data ask for them


@dataclass(frozen=True)
class Calibration:
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
                "sigma_deg": None if model.c_sigma is None else [_finite(v) for v in model.c_sigma],
            },
            "delay_s": model.delay_s,
            "offset_s": model.offset_s,
            "delay_sigma_s": _finite(self.delay.sigma_s),
            "onsets": [onset_json(o, self.names) for o in self.onsets],
            "evidence": {key: _finite(value) for key, value in self.evidence.items()},
            "notes": list(self.notes),
            "quality": model.quality.to_json(),
        }


def onset_json(onset: Onset, names: Sequence[str]) -> dict[str, Any]:
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


def jumping(onsets: Sequence[Onset]) -> bool:
    """Whether the image jumps at most onsets: no joint fit knows that."""
    widths = [o for o in onsets if o.used and o.kind in (HINGE, BRACKET)]
    return 2 * sum(o.kind == BRACKET for o in widths) > len(widths)


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def calibrate(
    recordings: Sequence[Recording], rig: Rig, options: Options | None = None, progress: Progress | None = None
) -> Calibration:
    """Measures B(q), f_remain and the delay from recordings of any motion. Raises TautError where nothing can be
    measured; says in notes and warnings what could not."""
    options = options or Options()
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
        aligned = clock.align(tracks, rig) if options.delay_s is None else clock.Clock.as_it_is(tracks)
        moved = iter(zip(aligned.tracks, aligned.offsets_s, strict=True))
        pairs = [next(moved) if len(track.t_s) else (track, 0.0) for track in every]
        reasons = acquisition_doubts(recordings, [track for track, _ in pairs], [offset for _, offset in pairs], rig)
        return _Session(aligned, rig, options, say, reasons).run()


class _Session:
    def __init__(
        self, aligned: clock.Clock, rig: Rig, options: Options, say: Progress, reasons: Sequence[Reason] = ()
    ) -> None:
        self.clock, self.rig, self.options, self.say = aligned, rig, options, say
        self.tracks = tracks = aligned.tracks
        self.notes: list[str] = list(aligned.notes)
        self.reasons: list[Reason] = [*aligned.reasons, *reasons]
        self.evidence: dict[str, float] = {}
        self.components: Components | None = None
        self.elements = SINGLE
        reached = [(float(t.motor.q.min()), float(t.motor.q.max())) for t in tracks]
        self.reached = min(r[0] for r in reached), max(r[1] for r in reached)
        low, high = self.reached if in_another_unit(self.reached, rig) else rig.actuator.range
        self.domain = Domain(min(low, self.reached[0]), max(high, self.reached[1]))
        self.grid = np.linspace(self.domain.low, self.domain.high, NODES)
        self.camera = tracks[0].unit == "px"
        self.nominal_s = rig.nominal_delay_s(tracks[0].sensor)
        self.unit = rig.actuator.unit

    def doubt(self, code: str, says: str, remedy: str, *, fatal: bool = False) -> None:
        self.reasons.append(Reason(code, says, remedy, fatal))

    def run(self) -> Calibration:
        if self.reached[1] - self.reached[0] < max(5 * self.rig.actuator.encoder_resolution, 1e-3 * self.domain.span):
            raise TautError(
                f"the motor does not move (q stays within {self.reached[1] - self.reached[0]:.3g} {self.unit}): "
                "record the calibration motion, and check the encoder and its unit"
            )
        self.say(0.05, "image stops")
        delay = self._delay()
        self.say(0.15, "onsets")
        onsets = find_onsets(self.tracks, self.rig, delay.delay_s, delay.sigma_s)
        curve = fit_widths(onsets, self.grid)
        self.say(0.35, "passes")
        joint, passes = self._smooth(onsets, delay, curve)
        if joint is not None and (joint.fit.fit_delay or joint.curves.delay_s != delay.delay_s):
            before, delay = delay, self._joint_delay(delay, joint)
            surer = not self.camera and delay.sigma_s < 0.5 * before.sigma_s
            if surer or abs(before.delay_s - delay.delay_s) > 1e-4:
                onsets = find_onsets(self.tracks, self.rig, delay.delay_s, delay.sigma_s)
                curve = fit_widths(onsets, self.grid)
        width, sigma, source = self._choose(onsets, curve, joint, passes)
        if source == JOINT:
            # The joint fit is so much sharper that the onsets' scatter about it is their own.
            spread = float(np.sqrt(np.clip(self.evidence["onsets_against_joint_z2"], 1.0, 9.0)))
            onsets = [replace(o, sigma=o.sigma * spread) if o.used and o.kind == HINGE else o for o in onsets]
        self.say(0.75, "f_remain")
        settled = joint.fit.settled_only if joint is not None else False
        remaining = self._remaining(width, delay.delay_s, settled) if self._moves() else None
        self._comment(onsets, curve, remaining)
        self._depart(joint, curve, source)
        self.say(1.0, "done")
        return self._result(onsets, delay, curve, joint, passes, width, sigma, source, remaining)

    # ---- the delay

    def _delay(self) -> Delay:
        if self.options.delay_s is not None:
            return Delay(self.options.delay_s, 0.0, 0)
        if not self.camera:
            return clock.delay_of_all(self.tracks, self.rig)
        return clock.delay_of_stops(self.tracks, self.rig)

    def _joint_delay(self, stops: Delay, joint: Fitted) -> Delay:
        # Each turn is known to a rounded count: an error of time at the motor's speed.
        speed = float(np.median(np.concatenate([np.abs(s.speed[s.moving]) for s in joint.fit.simulated])))
        counts = self.rig.actuator.encoder_resolution / np.sqrt(12.0) / max(speed, 1e-9) / np.sqrt(max(stops.stops, 1))
        own = joint.delay_sigma
        if not joint.fit.fit_delay:  # at the nominal delay: within a sample of it
            own = (
                min(stops.sigma_s, clock.period_s(self.tracks))
                if joint.curves.delay_s == self.nominal_s
                else stops.sigma_s
            )
        return Delay(joint.curves.delay_s, float(np.hypot(own, counts)), stops.stops)

    # ---- B

    def _one_curve(self, delay_s: float) -> Sequence[Track]:
        """Tracks on which the tip follows one curve: the image itself, or poses where other axes move all the time."""
        reference = self.tracks[0].others_reference
        still = np.concatenate([track.at_reference(track.scene_s(delay_s), reference) for track in self.tracks])
        if not self.camera or np.mean(still) > 0.5:
            return self.tracks
        self.notes.append(
            "translation or rotation move most of the time: B(q) rests on the pose, as right as camera and hand_eye are"
        )
        return [posed(track, self.rig, delay_s) for track in self.tracks]

    def _smooth(
        self, onsets: Sequence[Onset], delay: Delay, curve: WidthCurve | None
    ) -> tuple[Fitted | None, Fitted | None]:
        frozen = freeze(self._one_curve(delay.delay_s), delay.delay_s)
        fit_delay = self.options.delay_s is None
        joint = fit_jointly(frozen, self.domain, delay.delay_s, fit_delay=fit_delay, guess=curve)
        if joint is None:
            return None, None
        if fit_delay and not self.camera:
            joint = clock.settled(joint, delay, self.tracks, self.nominal_s)
        elif fit_delay and (jumping(onsets) or not self._explained(joint)):
            # What the model does not know would bend the delay: the image stops tell it alone.
            joint.fit.fit_delay = False
            joint = joint.fit.solve(replace(joint.curves, delay_s=delay.delay_s))
        if fit_delay and not joint.fit.fit_delay:
            joint.fit.delay_sigma_s = self._joint_delay(delay, joint).sigma_s
        self.say(0.5, "what departs from a play")
        joint = self._separated(joint, onsets, curve)
        self.say(0.6, "passes alone")
        margin = 0.1 * float(np.median(joint.fit.width(joint.curves))) + 0.005 * self.domain.span
        passes = fit_passes(joint, margin)
        return joint, None if passes is None else as_many_as_independent(passes)

    def _separated(self, joint: Fitted, onsets: Sequence[Onset], curve: WidthCurve | None) -> Fitted:
        """The joint fit with all that departs from its model beside it."""
        noise = place_noise(joint)
        if noise is not None:
            self.evidence |= {f"place_{key}": value for key, value in asdict(noise).items()}
        joint = allowing_for_place(joint, noise)
        self.evidence["residual_before_components"] = joint.scale
        self.components = separate(joint, self.rig)
        if self.components.noise > _UNNAMED:
            joint = as_smooth_as_independent(joint, noise)
            self.components = separate(joint, self.rig)
        several = self._several(joint, self.components) if self.options.elements == "auto" else None
        if several is not None:
            joint, self.elements = several, several.fit.elements
            self.components = separate(joint, self.rig, without=frozenset({"phase.even"}))
        for part in self.components.parts:
            self.evidence[f"component_{part.name}"] = part.rms
        apart = self.components.applied(joint)
        if self._predicts(apart, joint) or self._nearer(onsets, curve, apart, joint):
            return apart
        return self._as_one(joint, self.components)

    def _nearer(self, onsets: Sequence[Onset], curve: WidthCurve | None, apart: Fitted, joint: Fitted) -> bool:
        """Whether the onsets, which know no model, say the B beside the departures."""
        widths = [o for o in onsets if o.used and o.kind in (HINGE, BRACKET)]
        if curve is None or len(widths) < _FEW_ONSETS:
            return False
        sigma = joint.width_sigma(self.grid)
        off = [self._against(widths, curve, fit.fit.width(fit.curves), sigma) for fit in (apart, joint)]
        near, far = (float(np.mean(z**2)) for z in off)
        return far > _AGREE and near < _NEARER * far

    def _predicts(self, apart: Fitted, joint: Fitted) -> bool:
        """Whether B as it is without the departures predicts what was seen about as well as the one that fits it best:
        a departure that takes B far from that stands for something else."""
        if self.components is None or not self.components.parts:
            return True
        smoothing = dict(apart.fit.smoothing)
        alone = replace(apart.fit, fit_backlash=False, fit_delay=False, smoothing=smoothing)
        left = alone.solve(self.components.usual, iterations=5, adapt=False).scale
        self.evidence["residual_without_components"] = left
        return left < _WORSE * max(joint.scale, 1.0)

    @staticmethod
    def _as_one(joint: Fitted, found: Components) -> Fitted:
        """The joint fit as it is; how far the departures would take B from it is its uncertainty."""
        width = joint.fit.width(joint.curves)
        joint.fit.residuals(joint.curves)
        spread = np.hypot(found.sigma, found.width - width)
        return replace(joint, spread=spread, delay_spread=max(found.delay_sigma, joint.delay_sigma))

    def _several(self, joint: Fitted, found: Components) -> Fitted | None:
        """The joint fit with several elements, where the tip starts gradually and they hold most of it."""
        gradual = next((part for part in found.parts if part.name == "phase.even"), None)
        if gradual is None or gradual.rms < max(_GRADUAL, 0.5 * max(part.rms for part in found.parts)):
            return None
        several = fit_elements(found.applied(joint), self.rig)
        before, after = (max(scale**2 - found.noise**2, 0.0) for scale in (joint.scale, several.scale))
        return several if after < _HELD * before and not several.fit.elements.single else None

    def _explained(self, joint: Fitted) -> bool:
        return joint.scale < _EXPLAINED

    def _choose(
        self, onsets: Sequence[Onset], curve: WidthCurve | None, joint: Fitted | None, passes: Fitted | None
    ) -> tuple[Array, Array, str]:
        """The onsets' B where there are onsets. The joint fit of all frames refines it where it agrees with them; the
        passes fill it in where no reversal was made."""
        if self.options.knots == "paper":
            paper = fit_paper(onsets, self.grid)
            if paper is not None:
                self.notes += [*paper.notes, "B(q) is the paper's spline of 14 knots through the onsets"]
                return paper.width, paper.sigma, ONSETS
        if joint is not None and curve is None and not self._passes_tell(joint):
            joint = None
        if joint is None and curve is None:
            self.doubt(
                "coverage",
                "no reversal showed an onset and no two passes cover the same positions, B(q) is taken as 0",
                "move back and forth by more than the backlash",
                fatal=True,
            )
            return np.zeros(NODES), np.full(NODES, self.domain.span / 4), NOTHING
        if joint is None:
            assert curve is not None
            self.notes += curve.notes
            return curve.width, curve.sigma, ONSETS
        width = self._held(joint, curve)
        sigma = joint.width_sigma(self.grid)
        if curve is None:
            self.notes.append("no reversal gave a width: B(q) is the distance between the passes")
            return width, sigma, PASSES
        widths = [o for o in onsets if o.used and o.kind in (HINGE, BRACKET)]
        z = self._against(widths, curve, width, sigma)
        self.evidence["onsets_against_joint_z2"] = float(np.mean(z**2))
        self.evidence["joint_residual_over_noise"] = joint.scale
        agreed = self._explained(joint) or float(np.mean(z**2)) < _AGREE
        if not jumping(widths) and (agreed or not self._contradicted(widths, curve, passes)):
            return *self._weighed(curve, width, sigma), JOINT
        self.notes.append("the passes contradict the onsets: B(q) is the onsets' alone")
        return self._filled(widths, curve, joint, passes)

    def _weighed(self, curve: WidthCurve, width: Array, sigma: Array) -> tuple[Array, Array]:
        """B and its sigma. Onsets know no model: where its errors leave the joint fit clearly less certain of B than
        they are, both count, by what each is uncertain by. Not where a tip starts gradually."""
        gradual = self.components is not None and any(part.name.startswith("phase") for part in self.components.parts)
        inside = (self.grid > curve.measured[0]) & (self.grid < curve.measured[1])
        theirs = np.hypot(curve.sigma, curve.excess / np.sqrt(curve.places))  # a place errs alike every time
        surer = not inside.any() or bool(np.median(sigma[inside]) < _SURER * np.median(theirs[inside]))
        if surer or gradual or not self.elements.single:
            return width, sigma
        own, other = (np.maximum(each, 1e-12) ** -2 for each in (sigma, theirs))
        both = (own * width + other * curve.width) / (own + other)
        return allowed_width(self.grid, both), (own + other) ** -0.5

    def _held(self, joint: Fitted, curve: WidthCurve | None) -> Array:
        """The joint fit's B, held beyond the positions that passes both ways or onsets reached: what lies there could
        be f_remain as well."""
        low, high = overlap(joint)
        if curve is not None:
            low, high = (min(low, curve.measured[0]), max(high, curve.measured[1])) if low < high else curve.measured
        width = joint.fit.width(joint.curves)
        if low >= high:
            return width
        return allowed_width(self.grid, np.interp(np.clip(self.grid, low, high), self.grid, width))

    def _moves(self) -> bool:
        """Whether the tip was seen to move by more than noise."""
        return any((np.ptp(track.y, axis=0) > _STANDS_OUT * np.median(track.sigma)).any() for track in self.tracks)

    def _passes_tell(self, joint: Fitted) -> bool:
        """Whether the tip was seen to move over the same positions both ways."""
        low, high = overlap(joint)
        return low < high and self._moves()

    def _contradicted(self, widths: Sequence[Onset], curve: WidthCurve, passes: Fitted | None) -> bool:
        """Whether onsets and passes, where both say something, differ by more than noise and by more than a little."""
        if passes is None or self._gradual(widths, passes):
            return False
        low, high = overlap(passes)
        inside = [o for o in widths if low <= o.q_mean <= high]
        if len(inside) < 3:
            return False
        width, sigma = passes.fit.width(passes.curves), passes.width_sigma(self.grid)
        z = self._against(inside, curve, width, sigma)
        difference = [o.width - float(np.interp(o.q_mean, self.grid, width)) for o in inside]
        share = abs(float(np.median(difference))) / max(float(np.median([o.width for o in inside])), 1e-9)
        return float(np.mean(z**2)) > _AGREE and share > _LITTLE

    def _gradual(self, widths: Sequence[Onset], passes: Fitted) -> bool:
        """Whether the tip starts more slowly than it goes on along the passes: then an onset is where a gradual start
        begins, and no play's width."""
        p = np.array([o.q_mean for o in widths])
        path = passes.fit.follow.slope(passes.curves.follow, p)
        turn = 0.5 * np.array([o.direction for o in widths]) * passes.fit.backlash.slope(passes.curves.backlash, p)
        usual = np.linalg.norm(path.reshape(len(p), -1), axis=1) / (1.0 + turn)
        ratio = float(np.median(np.array([o.slope for o in widths]) / np.maximum(usual, 1e-12)))
        self.evidence["start_over_path_slope"] = ratio
        if ratio > _AT_ONCE:
            return False
        self.doubt(
            "transmission.smooth_onset",
            f"the tip starts gradually, at {ratio:.2f} of its later speed",
            "B(q) is what fits all frames, not where the first motion shows",
        )
        return True

    def _against(self, widths: Sequence[Onset], curve: WidthCurve, width: Array, sigma: Array) -> Array:
        """Each onset's distance from another curve of B, over what both are uncertain by."""
        p = np.array([o.q_mean for o in widths])
        w = np.array([o.width for o in widths])
        own = np.array([o.sigma for o in widths])
        there = np.interp(p, self.grid, width)
        slope = np.interp(p, self.grid, np.gradient(width, self.grid))
        own = own * np.abs(1.0 - 0.5 * np.array([o.direction for o in widths]) * slope)
        spread = np.sqrt(own**2 + np.interp(p, self.grid, sigma) ** 2 + curve.excess**2)
        return np.asarray((w - there) / spread)

    def _filled(
        self, widths: Sequence[Onset], curve: WidthCurve, joint: Fitted, passes: Fitted | None
    ) -> tuple[Array, Array, str]:
        """The onsets' curve near onsets; farther off, the passes' shape shifted to meet it."""
        p = np.sort([o.q_mean for o in widths])
        reach = max(
            1.5 * float(np.median(np.diff(p))) if len(p) > 2 else 0.0, float(np.median([o.width for o in widths]))
        )
        distance = np.min(np.abs(self.grid[:, None] - p[None, :]), axis=1)
        far = np.clip(distance / reach - 1.0, 0.0, 1.0)
        if not (far > 0).any() or passes is None:
            return curve.width, curve.sigma, ONSETS
        other = passes.fit.width(passes.curves)
        share = far * far * (3 - 2 * far)
        inside = (self.grid >= p[0]) & (self.grid <= p[-1])
        share = np.where(inside, share, 0.0)
        width = allowed_width(self.grid, (1 - share) * curve.width + share * other)
        sigma = np.hypot((1 - share) * curve.sigma, share * passes.width_sigma(self.grid))
        if share.max() > 0.5:
            where = self.grid[share > 0.5]
            self.notes.append(
                f"no onset from {where[0]:.3g} to {where[-1]:.3g} {self.unit}: there B(q) is the distance of the passes"
            )
        return width, sigma, ONSETS

    # ---- f_remain

    def _remaining(self, width: Array, delay_s: float, settled: bool) -> Remaining | None:
        if self.options.remaining == "morphological":
            found = morphological(self.tracks, self.rig, self.grid, delay_s)
            if found is not None:
                return found
            self.notes.append("the characteristic shows no closed shape: f_remain was fitted directly instead")
        return fit_remaining(self.tracks, self.rig, self.domain, self.grid, width, delay_s, settled, self.elements)

    # ---- what to think of it

    def _comment(self, onsets: Sequence[Onset], curve: WidthCurve | None, remaining: Remaining | None) -> None:
        if stray := sum(track.stray for track in self.tracks):
            self.notes.append(f"{stray} frames show the marker elsewhere for a moment: left out")
        if not onsets:
            self.doubt("coverage", "the motor never turned back", "move back and forth by more than B", fatal=True)
        counted = [o for o in onsets if o.used and o.kind in (HINGE, BRACKET)]
        bounds = [o for o in onsets if o.used and o.kind == BOUND]
        if onsets and not counted:
            longest = max((o.low for o in bounds), default=0.0)
            moved = f", {len(bounds)} strokes up to {longest:.3g} {self.unit} moved nothing, so B is wider"
            self.doubt(
                "coverage",
                f"none of {len(onsets)} reversals showed an onset" + (moved if bounds else ""),
                "make longer strokes" if bounds else "turn where the tip is seen to move",
            )
        for reason in dict.fromkeys(o.reason for o in onsets if o.reason and not o.used):
            count = sum(o.reason == reason and not o.used for o in onsets)
            self.notes.append(f"{count} of {len(onsets)} reversals not used: {reason}")
        if curve is not None:
            low, high = self.rig.actuator.range
            if curve.measured[0] > low + 0.2 * (high - low) or curve.measured[1] < high - 0.2 * (high - low):
                self.notes.append(
                    f"onsets reach from {curve.measured[0]:.3g} to {curve.measured[1]:.3g} {self.unit} of the range "
                    f"[{low:g}, {high:g}]: beyond, B(q) is held"
                )
        if remaining is None:
            self.doubt(
                "coverage",
                "the tip was never seen to move, f_remain is f_coarse",
                "move by more than the backlash, within the view",
                fatal=True,
            )
            return
        self.notes += remaining.notes
        self._sanity(remaining)

    def _depart(self, joint: Fitted | None, curve: WidthCurve | None, source: str) -> None:
        if self.components is not None:
            low, high = self._measured(curve, joint, source)
            inside = (self.grid > low) & (self.grid < high)
            self.reasons += doubts(self.components, inside, self.unit)

    def _sanity(self, remaining: Remaining) -> None:
        """Scale and sign before anything else is blamed."""
        p = np.clip(self.grid, *self.reached)
        c = np.interp(p, self.grid, remaining.c_deg)
        gain = float(np.polyfit(p, c, 1)[0]) if np.ptp(p) > 0 else self.rig.coarse.gain
        self.evidence["gain"] = gain
        ratio = gain / self.rig.coarse.gain
        if ratio < 0:
            self.doubt(
                "coarse",
                f"the tip bends {gain:.3g} deg/{self.unit} where f_coarse says {self.rig.coarse.gain:.3g}",
                "a sign is wrong: check encoder direction, coarse.gain, hand_eye, a mirrored image",
            )
        elif not _LIKELY_GAIN[0] < ratio < _LIKELY_GAIN[1]:
            self.doubt(
                "coarse",
                f"the tip bends {gain:.3g} deg/{self.unit} where f_coarse says {self.rig.coarse.gain:.3g}",
                "check actuator.unit, the encoder's scale, camera.fx_px and the marker's distance",
            )
        self.evidence["residual"] = remaining.residual
        if self.camera and remaining.residual > max(5.0, 20 * float(np.median(self.tracks[0].sigma))):
            self._registration(remaining.residual, ratio, p, c)

    def _registration(self, residual: float, ratio: float, p: Array, c: Array) -> None:
        """The marker is off the path that the rig gives it. Where f_remain was bent beyond belief to come near it, no
        angle means anything."""
        coarse = self.rig.coarse
        bent = float(np.max(np.abs(c - (coarse.gain * p + coarse.offset))))
        whole = abs(coarse.gain) * float(np.ptp(p))
        moved = float(np.std(np.concatenate([t.y for t in self.tracks]), axis=0).max())
        likely = _LIKELY_GAIN[0] < ratio < _LIKELY_GAIN[1] and bent < _LIKELY_BEND * whole
        says = f"the marker is {residual:.3g} px (rms) off where camera, hand_eye and kinematics put it"
        if likely or residual < _LARGE * moved:
            self.doubt("registration.static", says, "f_remain absorbs what it can, but check them")
            return
        self.doubt(
            "registration.static",
            f"{says}, and f_remain had to leave f_coarse by {bent:.3g} of {whole:.3g} deg",
            "rig.toml is not of this set-up: check camera (fx_px, size), hand_eye, kinematics and coarse.gain",
            fatal=True,
        )

    # ---- the result

    def _result(
        self, onsets: Sequence[Onset], delay: Delay, curve: WidthCurve | None, joint: Fitted | None,
        passes: Fitted | None, width: Array, sigma: Array, source: str, remaining: Remaining | None,
    ) -> Calibration:  # fmt: skip
        names = tuple(track.name for track in self.tracks)
        measured = self._measured(curve, joint, source)
        beyond = np.abs(self.grid - np.clip(self.grid, *measured))
        inside = (self.grid > measured[0]) & (self.grid < measured[1])
        floor = floor_of(self.tracks, self.grid[inside], width[inside], sigma[inside], self.unit)
        self.reasons += floor.reasons
        sigma = np.hypot(np.hypot(sigma, floor.sigma), 0.5 * beyond)
        pass_width, pass_sigma = self._second_opinion(onsets, curve, passes)
        characteristic = self._characteristic(delay.delay_s)
        aligned, delay = self.clock.with_delay(delay, self.nominal_s)
        if not np.isfinite(delay.sigma_s):
            self.notes.append(f"no stop of the tip told the delay: the nominal {delay.delay_s * 1e3:.0f} ms is used")
        coarse = self.rig.coarse
        c = remaining.c_deg if remaining is not None else coarse.gain * self.grid + coarse.offset
        c_sigma = remaining.sigma_deg if remaining is not None else np.full(len(c), np.nan)
        model = Model(
            self.rig, self.grid, width, sigma, c, delay.delay_s, measured, elements=self.elements, c_sigma=c_sigma,
            sensor=self.tracks[0].sensor, offset_s=aligned.offset_s,
        )  # fmt: skip
        told = worth(model, self.tracks, self.rig)
        if told is not None:
            self.reasons += told.doubts
            self.evidence |= {"error": told.model, "error_coarse": told.coarse, "error_constant": told.constant}
        notes = tuple(dict.fromkeys(self.notes))
        extra: dict[str, Any] = {
            "source": source,
            "delay_sigma_s": _finite(delay.sigma_s),
            "onsets": [onset_json(o, names) for o in onsets],
            "evidence": {key: _finite(value) for key, value in self.evidence.items()},
            "notes": list(notes),
            "characteristic": characteristic,
            "options": asdict(self.options),
        }
        if pass_width is not None:
            extra["pass_width"] = [_finite(v) for v in pass_width]
        model = replace(model, quality=Quality.of(self.reasons), extra=extra)
        return Calibration(
            model, tuple(onsets), delay, source, curve, pass_width, pass_sigma, self.evidence, notes, names,
            aligned.offsets,
        )  # fmt: skip

    def _measured(self, curve: WidthCurve | None, joint: Fitted | None, source: str) -> tuple[float, float]:
        if curve is not None:
            return curve.measured
        if joint is not None and source == PASSES:
            p = np.concatenate([s.p[m] for s, m in zip(joint.fit.simulated, joint.masks, strict=True)])
            return float(p.min()), float(p.max())
        middle = 0.5 * (self.grid[0] + self.grid[-1])
        return middle, middle

    def _second_opinion(
        self, onsets: Sequence[Onset], curve: WidthCurve | None, passes: Fitted | None
    ) -> tuple[Array | None, Array | None]:
        """B from the passes alone beside the onsets': its disagreement is evidence."""
        if passes is None:
            return None, None
        low, high = overlap(passes)
        if not low < high:
            return None, None
        told = (self.grid >= low) & (self.grid <= high)
        width = np.where(told, passes.fit.width(passes.curves), np.nan)
        sigma = np.where(told, passes.width_sigma(self.grid), np.nan)
        widths = [o for o in onsets if o.used and o.kind in (HINGE, BRACKET) and low <= o.q_mean <= high]
        if curve is not None and len(widths) >= 2:
            p = np.array([o.q_mean for o in widths])
            difference = np.array([o.width for o in widths]) - np.interp(p, self.grid, width)
            z = self._against(widths, curve, passes.fit.width(passes.curves), passes.width_sigma(self.grid))
            mean = float(np.mean(difference))
            self.evidence["onsets_minus_passes"] = mean
            self.evidence["onsets_minus_passes_rms"] = float(np.sqrt(np.mean(difference**2)))
            self.evidence["onsets_minus_passes_z2"] = float(np.mean(z**2))
            share = abs(mean) / max(float(np.median([o.width for o in widths])), 1e-9)
            if float(np.mean(z**2)) > 2 * _AGREE and share > 0.03 and self.elements.single and jumping(widths):
                self.doubt(
                    "registration.direction_dependent",
                    f"the passes lie {abs(mean):.3g} {self.unit} {'less' if mean > 0 else 'more'} apart than the "
                    "onsets say",
                    "it depends on direction, starts smoothly or unevenly: taut diagnose tells which",
                )
        return width, sigma

    def _characteristic(self, delay_s: float) -> dict[str, Any]:
        """Up to 3000 frames of (q, c) for the report's picture."""
        q = np.concatenate([t.motor_at(t.scene_s(delay_s)) for t in self.tracks])
        c = np.concatenate([pose_of(t, self.rig, delay_s) for t in self.tracks])
        low, high = coarse_range_deg(self.rig)
        good = np.flatnonzero(np.isfinite(c) & (np.abs(c) < 10 * max(abs(low), abs(high), 1.0)))
        good = good[:: max(1, len(good) // 3000)]
        return {"q": np.round(q[good], 5).tolist(), "c_deg": np.round(c[good], 4).tolist()}
