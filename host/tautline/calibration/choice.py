"""Which B(q) counts, of three opinions: the curve through the onsets' widths (backlash.py), the joint fit of all frames
(playfit.py), and the passes alone, whose B is the distance between the ways up and down away from the reversals.

grid: (grid,) motor positions at which B is tabulated; B, its sigma and positions are in the unit of q, (grid,).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tautline.calibration.backlash import SLOPE_UNTOLD, WidthCurve, fit_paper
from tautline.calibration.components import Components
from tautline.calibration.coverage import HOLE, distance_to_both_ways
from tautline.calibration.findings import Findings
from tautline.calibration.observations import Track
from tautline.calibration.onset import BRACKET, Onset, with_width
from tautline.calibration.playfit import EXPLAINED, Curves, Fitted
from tautline.calibration.several import rms_over_noise
from tautline.calibration.smooth import Domain, overlap
from tautline.independence import stretches
from tautline.model import allowed_width

Array = npt.NDArray[np.float64]

ONSETS, JOINT, PASSES, NOTHING = "onsets", "onsets and passes", "passes", "nothing"
_AGREE = 3.0  # prior: mean squared z of onsets against the joint fit up to which both are one evidence
_STANDS_OUT = 10.0  # tolerance: noise sigmas by which y has to range for a motion
_AT_ONCE = 0.75  # prior: of the path's slope: a tip whose first slope is less starts gradually
_SURER = 2.0  # prior: ratio of the sigmas, joint fit's to onsets', from which both are averaged
_BEARABLE = 3.0  # prior: times what the joint fit's own B leaves: a B that leaves more stands for something else
_LITTLE = 0.03  # tolerance: of the width: a smaller difference is no contradiction
_WORSE = 1.25  # tolerance: times the best fit's residual: a B that leaves more does not predict as well
_FEW_ONSETS = 6  # tolerance: onsets that are needed to contradict the joint fit
_NEARER = 0.5  # prior: ratio of their mean squared z for two curves of B, below which they favour one
_ONE_WAY = 4.0  # prior: standard errors by which onsets of one direction are late
_OTHER_WAY = 0.3  # prior: of that: what those of the other may be
_BETWEEN = 1.5  # tolerance: of the usual distance of onsets: as far the onsets' curve counts alone
_BENDS = 2.0  # prior: times its own size by which B may change over the range
_STEPS = 5  # tolerance: in which a path is fitted anew to a B that is held
_STEEPER = 2.0  # prior: standard deviation of B' in a hole, of its rms elsewhere
_UNKNOWN = 0.25  # prior: of the range: standard deviation of a B that nothing measured
_FAR = 2.0  # prior: times _AGREE: passes that are farther from the onsets contradict them


def image_jumps(onsets: Sequence[Onset]) -> bool:
    """Whether most onsets' widths are brackets: the image jumps at them, which no joint fit contains."""
    widths = with_width(onsets)
    return 2 * sum(o.kind == BRACKET for o in widths) > len(widths)


@dataclass(frozen=True)
class Choice:
    """Weighs the opinions of B(q); notes, evidence and doubts that come up go to `findings`."""

    tracks: Sequence[Track]
    domain: Domain
    grid: Array
    unit: str  # of q
    findings: Findings

    def choose(
        self,
        onsets: Sequence[Onset],
        curve: WidthCurve | None,
        joint_fit: Fitted | None,
        passes: Fitted | None,
        *,
        like_paper: bool,
        gradual: bool,
    ) -> tuple[Array, Array, str]:
        """B, its sigma and its source (ONSETS, JOINT, PASSES or NOTHING). B is the joint fit's (`_by_joint_fit`);
        without one the onsets' curve; without either 0, with a fatal doubt. A joint fit without onsets counts only if
        the tip passed the same positions both ways. like_paper: use the paper's spline through the onsets, if there are
        any. gradual: the tip starts gradually. Notes and doubts are added to `findings`."""
        if like_paper:
            paper = fit_paper(onsets, self.grid)
            if paper is not None:
                self.findings.notes += [*paper.notes, "B(q) is the paper's spline of 14 knots through the onsets"]
                return paper.width, paper.sigma, ONSETS
        if joint_fit is not None and curve is None and not self._passed_both_ways(joint_fit):
            joint_fit = None
        if joint_fit is None and curve is None:
            self.findings.doubt(
                "coverage",
                "no reversal showed an onset and no two passes cover the same positions, B(q) is taken as 0",
                "move back and forth by more than the backlash",
                fatal=True,
            )
            return np.zeros_like(self.grid), np.full_like(self.grid, _UNKNOWN * self.domain.span), NOTHING
        if joint_fit is None:
            assert curve is not None
            self.findings.notes += curve.notes
            return curve.width, curve.sigma, ONSETS
        return self._by_joint_fit(onsets, curve, joint_fit, passes, gradual=gradual)

    def _by_joint_fit(
        self,
        onsets: Sequence[Onset],
        curve: WidthCurve | None,
        joint_fit: Fitted,
        passes: Fitted | None,
        *,
        gradual: bool,
    ) -> tuple[Array, Array, str]:
        """B, its sigma and its source where there is a joint fit. Its own B without onsets, and with several elements,
        as an onset shows the first of them only. The onsets' curve, filled in by the passes, where the image jumps.
        Else its own, or its mean with the onsets' curve (`_combined`), if that leaves little more. gradual: onsets show
        the first motion of a gradual start, and are not averaged into B."""
        width = self.held_beyond_measured(joint_fit, curve)
        sigma = joint_fit.width_sigma(self.grid)
        if curve is None:
            self.findings.notes.append("no reversal gave a width: B(q) is the distance between the passes")
            return width, sigma, PASSES
        widths = with_width(onsets)
        z = self._z_scores(widths, curve, width, sigma)
        self.findings.evidence["onsets_against_joint_z2"] = float(np.mean(z**2))
        self.findings.evidence["joint_residual_over_noise"] = joint_fit.scale
        if not joint_fit.fit.hysteresis.single:
            return width, sigma, JOINT
        if image_jumps(widths) and not self._late_one_way_only(widths, joint_fit, curve):
            self.findings.notes.append("the image jumps at the onsets: B(q) is the onsets' alone")
            return self._onsets_filled_by_passes(widths, curve, passes)
        if passes is not None and not joint_fit.explained and float(np.mean(z**2)) > _AGREE:
            self._notice_gradual_start(widths, passes)
        both = None if gradual else self._combined(curve, width, sigma)
        if both is not None and self._mean_is_bearable(joint_fit, width, both[0]):
            width, sigma = both
        return width, sigma, JOINT

    def _combined(self, curve: WidthCurve, width: Array, sigma: Array) -> tuple[Array, Array] | None:
        """The mean, weighted by 1 / sigma^2, of the joint fit's B `width` and of the onsets' curve, and its sigma. None
        unless the joint fit's sigma is at least _SURER times that of the onsets: model errors make it so uncertain,
        while onsets depend on no model."""
        inside = (self.grid > curve.measured[0]) & (self.grid < curve.measured[1])
        theirs = np.hypot(curve.sigma, curve.excess / np.sqrt(curve.places))  # a place errs alike every time
        if not inside.any() or np.median(sigma[inside]) < _SURER * np.median(theirs[inside]):
            return None
        own, other = (np.maximum(each, 1e-12) ** -2 for each in (sigma, theirs))
        both = (own * width + other * curve.width) / (own + other)
        return allowed_width(self.grid, both), (own + other) ** -0.5

    def _mean_is_bearable(self, joint_fit: Fitted, width: Array, both: Array) -> bool:
        """Whether the mean `both` (grid,) may take the place of the joint fit's B `width` (grid,): `width` leaves more
        than noise itself, and `both` less than _BEARABLE times as much."""
        own = self.residual_with_width(joint_fit, width)
        return own > EXPLAINED and self.residual_with_width(joint_fit, both) < _BEARABLE * own

    def onsets_favour_departures(
        self,
        onsets: Sequence[Onset],
        curve: WidthCurve | None,
        components: Components,
        apart: Fitted,
        joint_fit: Fitted,
    ) -> bool:
        """Whether the onsets, which depend on no model, clearly agree with the B that was estimated together with the
        departures (apart) and not with the one without (joint_fit), by mean squared z. False if onsets are few, if
        there are several elements, or if the strongest departure is a gradual start, of which onsets show the first
        motion only."""
        widths = with_width(onsets)
        if (
            curve is None
            or len(widths) < _FEW_ONSETS
            or not joint_fit.fit.hysteresis.single
            or components.mainly_start_of_strokes
        ):
            return False
        sigma = joint_fit.width_sigma(self.grid)
        off = [self._z_scores(widths, curve, fit.fit.width(fit.curves), sigma) for fit in (apart, joint_fit)]
        near, far = (float(np.mean(z**2)) for z in off)
        return far > _AGREE and near < _NEARER * far

    def residual_without_departures(self, components: Components, apart: Fitted, joint_fit: Fitted) -> float:
        """Residual over noise that B and delay as estimated with the departures leave when the departures are taken out
        again: how well the model that is handed out predicts, as it does not contain them."""
        return self._residual_with_curves(apart, components.session_mean) if components.parts else joint_fit.scale

    @staticmethod
    def predicts_as_well(residual: float, joint_fit: Fitted) -> bool:
        """Whether a B that leaves `residual` (over noise) predicts what was seen about as well as the joint fit's,
        which leaves the least. If it does not, the departures that moved B there stand for something else."""
        return residual < _WORSE * max(joint_fit.scale, 1.0)

    def sigma_where_passed_one_way(self, joint_fit: Fitted, width: Array, inside: npt.NDArray[np.bool_]) -> Array:
        """(grid,) standard deviation, unit of q, to be added to B's in a hole: where no frame of one direction is
        within HOLE of the range. It is the distance beyond that, times a slope: _STEEPER times the rms slope of B
        elsewhere (SLOPE_UNTOLD if there is no elsewhere), or _BENDS typical widths over the range if that is more. 0
        outside of holes; 0 everywhere if one direction has no frame, or if B was known beforehand, as its prior covers
        this. inside (grid,): where B was measured. A hole is noticed in `findings`."""
        if joint_fit.fit.beforehand is not None:
            return np.zeros(len(self.grid))
        distance = distance_to_both_ways(joint_fit, self.grid)
        if not np.isfinite(distance).all():
            return np.zeros(len(self.grid))
        gap = np.maximum(distance - HOLE * self.domain.span, 0.0)
        holes = inside & (gap > 0)
        if not holes.any():
            return np.zeros(len(self.grid))
        usual_slope = (
            float(np.sqrt(np.mean(np.gradient(width, self.grid)[inside & ~holes] ** 2)))
            if (inside & ~holes).any()
            else SLOPE_UNTOLD
        )
        at = self.grid[holes]
        self.findings.notice(
            "coverage",
            f"from {at[0]:.3g} to {at[-1]:.3g} {self.unit} the tip passes one way at most in places",
            "move through all of the range both ways",
        )
        return np.where(
            inside, max(_STEEPER * usual_slope, _BENDS * float(np.median(width[inside])) / self.domain.span) * gap, 0.0
        )

    def measured_range(self, curve: WidthCurve | None, joint_fit: Fitted | None, source: str) -> tuple[float, float]:
        """The lowest and highest position at which B was measured: of the onsets; if these are at one place or none, of
        the counted frames, where B is the joint fit's or the passes'; else the middle of the range, twice."""
        if curve is not None and (source == ONSETS or curve.measured[0] < curve.measured[1]):
            return curve.measured
        if joint_fit is not None and source in (JOINT, PASSES):
            p = np.concatenate([s.p[m] for s, m in zip(joint_fit.fit.simulated, joint_fit.masks, strict=True)])
            return float(p.min()), float(p.max())
        middle = 0.5 * (self.grid[0] + self.grid[-1])
        return middle, middle

    def opinion_of_passes(
        self, onsets: Sequence[Onset], curve: WidthCurve | None, passes: Fitted | None
    ) -> tuple[Array | None, Array | None]:
        """B (grid,) and its sigma from the passes alone, NaN where the ways up and down do not overlap; (None, None) if
        they overlap nowhere or there are no passes. Two onsets or more are compared with it
        (`_compare_with_passes`)."""
        if passes is None:
            return None, None
        low, high = overlap(passes)
        if not low < high:
            return None, None
        width, sigma = passes.fit.width(passes.curves), passes.width_sigma(self.grid)
        widths = [o for o in with_width(onsets) if low <= o.q_mean <= high]
        if curve is not None and len(widths) >= 2:
            self._compare_with_passes(widths, curve, width, sigma)
        told = (self.grid >= low) & (self.grid <= high)
        return np.where(told, width, np.nan), np.where(told, sigma, np.nan)

    def _compare_with_passes(self, widths: Sequence[Onset], curve: WidthCurve, width: Array, sigma: Array) -> None:
        """Adds to the evidence by how much the onsets' widths differ from the passes' B `width` with sigma, (grid,)
        each; and notices a dependence on direction if the image jumps and the difference is clear (_FAR, _LITTLE)."""
        p = np.array([o.q_mean for o in widths])
        difference = np.array([o.width for o in widths]) - np.interp(p, self.grid, width)
        z = self._z_scores(widths, curve, width, sigma)
        mean = float(np.mean(difference))
        self.findings.evidence["onsets_minus_passes"] = mean
        self.findings.evidence["onsets_minus_passes_rms"] = float(np.sqrt(np.mean(difference**2)))
        self.findings.evidence["onsets_minus_passes_z2"] = float(np.mean(z**2))
        share = abs(mean) / max(float(np.median([o.width for o in widths])), 1e-9)
        if float(np.mean(z**2)) > _FAR * _AGREE and share > _LITTLE and image_jumps(widths):
            self.findings.notice(
                "registration.direction_dependent",
                f"the passes lie {abs(mean):.3g} {self.unit} {'less' if mean > 0 else 'more'} apart than the "
                "onsets say",
                "it depends on direction, starts smoothly or unevenly: taut diagnose tells which",
            )

    def tip_moves(self) -> bool:
        """Whether a coordinate of the image or angle ranges over more than _STANDS_OUT times the noise."""
        return any((np.ptp(track.y, axis=0) > _STANDS_OUT * np.median(track.sigma)).any() for track in self.tracks)

    def _late_one_way_only(self, widths: Sequence[Onset], joint_fit: Fitted, curve: WidthCurve) -> bool:
        """Whether onsets are wider than the joint fit's B after turns one way only, and their B predicts what was seen
        worse. Then the tip starts late that way but ends on the same envelope, and the joint fit is right. (Onsets that
        are wider both ways mean an image that jumps.) False with fewer than half of _FEW_ONSETS onsets one way. Adds
        the residual with the onsets' B to the evidence."""
        at, up = np.array([o.q_mean for o in widths]), np.array([o.direction > 0 for o in widths])
        if min(up.sum(), (~up).sum()) < _FEW_ONSETS // 2:
            return False
        excess = np.array([o.width for o in widths]) - np.interp(at, self.grid, joint_fit.fit.width(joint_fit.curves))
        less, more = sorted((excess[up], excess[~up]), key=lambda way: abs(way.mean()))
        clear = max(_ONE_WAY * more.std() / np.sqrt(len(more)), _LITTLE * float(np.median(curve.width)))
        if more.mean() < clear or abs(less.mean()) > _OTHER_WAY * more.mean():
            return False
        residual = self.residual_with_width(joint_fit, curve.width)
        self.findings.evidence["residual_with_onsets"] = residual
        return not self.predicts_as_well(residual, joint_fit)

    def residual_with_width(self, joint_fit: Fitted, width: Array) -> float:
        """Residual over noise with B held at width (grid,) and the delay at the joint fit's; only the path is fitted
        anew."""
        backlash = joint_fit.fit.backlash.nearest(self.grid, width)
        return self._residual_with_curves(joint_fit, replace(joint_fit.curves, backlash=backlash))

    @staticmethod
    def _residual_with_curves(fitted: Fitted, curves: Curves) -> float:
        """Residual over noise with B and delay held at those of `curves` and the path fitted anew. The smoothing stays,
        and outliers are cut as for the fit's own scale."""
        smoothing = dict(fitted.fit.smoothing)
        alone = replace(fitted.fit, fit_backlash=False, fit_delay=False, smoothing=smoothing)
        point = alone.descended(curves, _STEPS, adapt=False)
        if alone.hysteresis.single:
            return point.scale
        return rms_over_noise(replace(alone.fitted(point), scale=fitted.scale))

    def held_beyond_measured(self, joint_fit: Fitted, curve: WidthCurve | None) -> Array:
        """The joint fit's B (grid,), held constant beyond the positions that passes both ways or onsets reached: what
        frames show beyond could be f_remain as well. Not held if B was known beforehand, or with several elements, some
        of which turn only there."""
        if not joint_fit.fit.hysteresis.single or joint_fit.fit.beforehand is not None:
            return joint_fit.fit.width(joint_fit.curves)
        low, high = overlap(joint_fit)
        if curve is not None:
            low, high = (min(low, curve.measured[0]), max(high, curve.measured[1])) if low < high else curve.measured
        width = joint_fit.fit.width(joint_fit.curves)
        if low >= high:
            return width
        return allowed_width(self.grid, np.interp(np.clip(self.grid, low, high), self.grid, width))

    def _passed_both_ways(self, joint_fit: Fitted) -> bool:
        """Whether the tip was seen to move, and over the same positions both ways."""
        low, high = overlap(joint_fit)
        return low < high and self.tip_moves()

    def _notice_gradual_start(self, widths: Sequence[Onset], passes: Fitted) -> None:
        """Adds to the evidence the ratio of two slopes of the image by q, in the median over the onsets: just after the
        onset, and of the passes' path there. Notices a gradual start if it is at most _AT_ONCE: an onset is where the
        gradual start begins then, and not the play's width."""
        p = np.array([o.q_mean for o in widths])
        path = passes.fit.follow.slope(passes.curves.follow, p)
        turn = 0.5 * np.array([o.direction for o in widths]) * passes.fit.backlash.slope(passes.curves.backlash, p)
        # dp/dq on an envelope is 1 / (1 + direction B'/2), so the image's usual slope by q is this.
        usual = np.linalg.norm(path.reshape(len(p), -1), axis=1) / (1.0 + turn)
        ratio = float(np.median(np.array([o.slope for o in widths]) / np.maximum(usual, 1e-12)))
        self.findings.evidence["start_over_path_slope"] = ratio
        if ratio <= _AT_ONCE:
            self.findings.notice(
                "transmission.smooth_onset",
                f"the tip starts gradually, at {ratio:.2f} of its later speed",
                "B(q) is what fits all frames, not where the first motion shows",
            )

    def _z_scores(self, widths: Sequence[Onset], curve: WidthCurve, width: Array, sigma: Array) -> Array:
        """(onsets,) each onset's width less the B `width` (grid,) there, over the standard deviation of the difference:
        the onset's own (corrected for B', since its position and width share one error), sigma (grid,) of B, and the
        onsets' excess scatter."""
        p = np.array([o.q_mean for o in widths])
        w = np.array([o.width for o in widths])
        own = np.array([o.sigma for o in widths])
        there = np.interp(p, self.grid, width)
        slope = np.interp(p, self.grid, np.gradient(width, self.grid))
        own = own * np.abs(1.0 - 0.5 * np.array([o.direction for o in widths]) * slope)
        spread = np.sqrt(own**2 + np.interp(p, self.grid, sigma) ** 2 + curve.excess**2)
        return np.asarray((w - there) / spread)

    def _onsets_filled_by_passes(
        self, widths: Sequence[Onset], curve: WidthCurve, passes: Fitted | None
    ) -> tuple[Array, Array, str]:
        """B, its sigma and its source (ONSETS): the onsets' curve near onsets; between them, where they are far apart,
        the passes' B, shifted to meet that curve. The shift is the image's jump, which differs from place to place; its
        scatter near onsets is added to sigma."""
        p = np.sort([o.q_mean for o in widths])
        # How far from an onset its curve counts alone: at least to the nearest place of the grid.
        between = _BETWEEN * float(np.median(np.diff(p))) if len(p) > 2 else 0.0
        reach = max(between, float(np.median([o.width for o in widths])), float(self.grid[1] - self.grid[0]))
        distance = np.min(np.abs(self.grid[:, None] - p[None, :]), axis=1)
        far = np.clip(distance / reach - 1.0, 0.0, 1.0)
        if not (far > 0).any() or passes is None:
            return curve.width, curve.sigma, ONSETS
        own = passes.fit.width(passes.curves)
        near = far == 0.0
        shift = (curve.width - own)[near]
        shifted = own + np.interp(self.grid, self.grid[near], shift)
        sigma_of_shift = np.interp(self.grid, self.grid[near], np.hypot(curve.sigma[near], float(np.std(shift))))
        share = far * far * (3 - 2 * far)  # without a corner at either end
        inside = (self.grid >= p[0]) & (self.grid <= p[-1])
        share = np.where(inside, share, 0.0)
        width = allowed_width(self.grid, (1 - share) * curve.width + share * shifted)
        sigma = np.hypot((1 - share) * curve.sigma, share * np.hypot(passes.width_sigma(self.grid), sigma_of_shift))
        if share.max() > 0.5:
            where = ", ".join(f"{self.grid[at][0]:.3g} to {self.grid[at][-1]:.3g}" for at in stretches(share > 0.5))
            self.findings.notes.append(f"no onset from {where} {self.unit}: there B(q) is the distance of the passes")
        return width, sigma, ONSETS
