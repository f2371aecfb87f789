"""Which B counts: the onsets', the joint fit's of all frames, or the passes' distance; and where none tells it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tautline.calibration.backlash import WidthCurve, fit_paper
from tautline.calibration.components import Components
from tautline.calibration.coverage import HOLE, one_way
from tautline.calibration.findings import Findings
from tautline.calibration.observations import Track
from tautline.calibration.onset import BRACKET, HINGE, Onset
from tautline.calibration.playfit import EXPLAINED, NODES, Curves, Fitted
from tautline.calibration.several import left
from tautline.calibration.smooth import Domain, overlap
from tautline.model import allowed_width

Array = npt.NDArray[np.float64]

ONSETS, JOINT, PASSES, NOTHING = "onsets", "onsets and passes", "passes", "nothing"
_AGREE = 3.0  # prior: mean squared z of onsets against the joint fit up to which both are one evidence
_STANDS_OUT = 10.0  # tolerance: a motion of so many sigma is one
_AT_ONCE = 0.75  # prior: of the path's slope: a tip that starts slower starts gradually
_SURER = 2.0  # prior: times less certain: the joint fit's B beside the onsets'
_BEARABLE = 3.0  # prior: times what the joint fit's own B leaves: onsets' that leaves more stands for something else
_LITTLE = 0.03  # tolerance: of the width: differences below are no contradiction
_WORSE = 1.25  # tolerance: times what the best single curve leaves: a B that leaves more is not for predictions
_FEW_ONSETS = 6  # tolerance: onsets that may say so
_NEARER = 0.5  # prior: their mean squared z against one B over that to the other
_ONE_WAY, _OTHER_WAY = 4.0, 0.3  # prior: standard errors by which onsets are late; of that, the other way's
_BENDS = 2.0  # prior: its own size by which B may change over the range


def jumping(onsets: Sequence[Onset]) -> bool:
    """Whether the image jumps at most onsets: no joint fit knows that."""
    widths = measuring(onsets)
    return 2 * sum(o.kind == BRACKET for o in widths) > len(widths)


def measuring(onsets: Sequence[Onset]) -> list[Onset]:
    """Those that are a width, not a bound."""
    return [o for o in onsets if o.used and o.kind in (HINGE, BRACKET)]


@dataclass(frozen=True)
class Choice:
    """Between the opinions of B(q) on `grid`; what it sees on the way goes to `findings`."""

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
        """The onsets' B where there are onsets. The joint fit of all frames refines it where it agrees with them; the
        passes fill it in where no reversal was made. Where the tip starts gradually onsets
        show its first motion only. (B, its sigma, where it is from)"""
        if like_paper:
            paper = fit_paper(onsets, self.grid)
            if paper is not None:
                self.findings.notes += [*paper.notes, "B(q) is the paper's spline of 14 knots through the onsets"]
                return paper.width, paper.sigma, ONSETS
        if joint_fit is not None and curve is None and not self._passes_tell(joint_fit):
            joint_fit = None
        if joint_fit is None and curve is None:
            self.findings.doubt(
                "coverage",
                "no reversal showed an onset and no two passes cover the same positions, B(q) is taken as 0",
                "move back and forth by more than the backlash",
                fatal=True,
            )
            return np.zeros(NODES), np.full(NODES, self.domain.span / 4), NOTHING
        if joint_fit is None:
            assert curve is not None
            self.findings.notes += curve.notes
            return curve.width, curve.sigma, ONSETS
        width = self.held(joint_fit, curve)
        sigma = joint_fit.width_sigma(self.grid)
        if curve is None:
            self.findings.notes.append("no reversal gave a width: B(q) is the distance between the passes")
            return width, sigma, PASSES
        widths = measuring(onsets)
        z = self._against(widths, curve, width, sigma)
        self.findings.evidence["onsets_against_joint_z2"] = float(np.mean(z**2))
        self.findings.evidence["joint_residual_over_noise"] = joint_fit.scale
        if not joint_fit.fit.hysteresis.single:  # of several an onset shows the first
            return width, sigma, JOINT
        agreed = joint_fit.explained or float(np.mean(z**2)) < _AGREE
        jumps = jumping(widths) and not self._foretells(widths, joint_fit, curve)
        if not jumps and (agreed or not self._contradicted(widths, curve, passes)):
            both, spread = (width, sigma) if gradual else self._weighed(curve, width, sigma)
            if both is not width and self._bears(joint_fit, width, both):
                width, sigma = both, spread
            return width, sigma, JOINT
        self.findings.notes.append("the passes contradict the onsets: B(q) is the onsets' alone")
        return self._filled(widths, curve, joint_fit, passes)

    def _weighed(self, curve: WidthCurve, width: Array, sigma: Array) -> tuple[Array, Array]:
        """B and its sigma. Onsets know no model: where its errors leave the joint fit clearly less certain of B than
        they are, both count, by what each is uncertain by."""
        inside = (self.grid > curve.measured[0]) & (self.grid < curve.measured[1])
        theirs = np.hypot(curve.sigma, curve.excess / np.sqrt(curve.places))  # a place errs alike every time
        if not inside.any() or np.median(sigma[inside]) < _SURER * np.median(theirs[inside]):
            return width, sigma
        own, other = (np.maximum(each, 1e-12) ** -2 for each in (sigma, theirs))
        both = (own * width + other * curve.width) / (own + other)
        return allowed_width(self.grid, both), (own + other) ** -0.5

    def _bears(self, joint_fit: Fitted, width: Array, both: Array) -> bool:
        """Whether B may be `both` (grid,) where the joint fit has `width`: not where that predicts well, nor where the
        other leaves far more."""
        own = self.left_at(joint_fit, width)
        return own > EXPLAINED and self.left_at(joint_fit, both) < _BEARABLE * own

    def nearer(
        self,
        onsets: Sequence[Onset],
        curve: WidthCurve | None,
        components: Components,
        apart: Fitted,
        joint_fit: Fitted,
    ) -> bool:
        """Whether the onsets, which know no model, clearly agree with the B beside the departures (apart) and not with
        the one without (joint). No where few are there, or these are a gradual start first of all: onsets show its
        first motion only."""
        widths = measuring(onsets)
        if (
            curve is None
            or len(widths) < _FEW_ONSETS
            or not joint_fit.fit.hysteresis.single
            or components.mainly_start_of_strokes
        ):
            return False
        sigma = joint_fit.width_sigma(self.grid)
        off = [self._against(widths, curve, fit.fit.width(fit.curves), sigma) for fit in (apart, joint_fit)]
        near, far = (float(np.mean(z**2)) for z in off)
        return far > _AGREE and near < _NEARER * far

    def alone(self, components: Components, apart: Fitted, joint_fit: Fitted) -> float:
        """Residual over noise of B, path and delay as they are without the departures."""
        return self._left_with(apart, components.session_mean) if components.parts else joint_fit.scale

    @staticmethod
    def predicts(rest: float, joint_fit: Fitted) -> bool:
        """Whether a B that leaves so much (residual over noise) predicts what was seen about as well as the one that
        fits it best: departures that take B far from that stand for something else."""
        return rest < _WORSE * max(joint_fit.scale, 1.0)

    def bridged(self, joint_fit: Fitted, width: Array, inside: npt.NDArray[np.bool_]) -> Array:
        """(grid,) by how much B may be another, unit of q, where nothing was passed both ways: it changes as elsewhere,
        over the distance to what was. 0 elsewhere, and where B is known beforehand, which says it itself."""
        if joint_fit.fit.beforehand is not None:
            return np.zeros(len(self.grid))
        apart = one_way(joint_fit, self.grid)
        if not np.isfinite(apart).all():
            return np.zeros(len(self.grid))
        gap = np.maximum(apart - HOLE * self.domain.span, 0.0)
        holes = inside & (gap > 0)
        if not holes.any():
            return np.zeros(len(self.grid))
        steep = (
            float(np.sqrt(np.mean(np.gradient(width, self.grid)[inside & ~holes] ** 2)))
            if (inside & ~holes).any()
            else 0.5
        )
        at = self.grid[holes]
        self.findings.notice(
            "coverage",
            f"from {at[0]:.3g} to {at[-1]:.3g} {self.unit} the tip passes one way at most in places",
            "move through all of the range both ways",
        )
        return np.where(
            inside, max(2.0 * steep, _BENDS * float(np.median(width[inside])) / self.domain.span) * gap, 0.0
        )

    def measured(self, curve: WidthCurve | None, joint_fit: Fitted | None, source: str) -> tuple[float, float]:
        """The lowest and highest position at which B was measured, unit of q: of onsets, or of the passes' frames; both
        the range's middle where nowhere."""
        if curve is not None:
            return curve.measured
        if joint_fit is not None and source == PASSES:
            p = np.concatenate([s.p[m] for s, m in zip(joint_fit.fit.simulated, joint_fit.masks, strict=True)])
            return float(p.min()), float(p.max())
        middle = 0.5 * (self.grid[0] + self.grid[-1])
        return middle, middle

    def second_opinion(
        self, onsets: Sequence[Onset], curve: WidthCurve | None, passes: Fitted | None
    ) -> tuple[Array | None, Array | None]:
        """(B, its sigma) from the passes alone, (grid,) in the unit of q, NaN beyond where both ways overlap; None of
        each where nowhere. The onsets' disagreement is evidence."""
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
            self.findings.evidence["onsets_minus_passes"] = mean
            self.findings.evidence["onsets_minus_passes_rms"] = float(np.sqrt(np.mean(difference**2)))
            self.findings.evidence["onsets_minus_passes_z2"] = float(np.mean(z**2))
            share = abs(mean) / max(float(np.median([o.width for o in widths])), 1e-9)
            if float(np.mean(z**2)) > 2 * _AGREE and share > 0.03 and passes.fit.hysteresis.single and jumping(widths):
                self.findings.notice(
                    "registration.direction_dependent",
                    f"the passes lie {abs(mean):.3g} {self.unit} {'less' if mean > 0 else 'more'} apart than the "
                    "onsets say",
                    "it depends on direction, starts smoothly or unevenly: taut diagnose tells which",
                )
        return width, sigma

    def moves(self) -> bool:
        """Whether the tip was seen to move by more than noise."""
        return any((np.ptp(track.y, axis=0) > _STANDS_OUT * np.median(track.sigma)).any() for track in self.tracks)

    def _foretells(self, widths: Sequence[Onset], joint_fit: Fitted, curve: WidthCurve) -> bool:
        """Whether onsets come late (wider than the joint fit's B) one way only, and their B predicts what was seen
        worse than the joint fit's: the tip is on its envelope all the same. Where both ways jump alike, the image
        does."""
        at, up = np.array([o.q_mean for o in widths]), np.array([o.direction > 0 for o in widths])
        if min(up.sum(), (~up).sum()) < _FEW_ONSETS // 2:
            return False
        late = np.array([o.width for o in widths]) - np.interp(at, self.grid, joint_fit.fit.width(joint_fit.curves))
        near, far = sorted((late[up], late[~up]), key=lambda way: abs(way.mean()))
        clear = max(_ONE_WAY * far.std() / np.sqrt(len(far)), _LITTLE * float(np.median(curve.width)))
        if far.mean() < clear or abs(near.mean()) > _OTHER_WAY * far.mean():
            return False
        rest = self.left_at(joint_fit, curve.width)
        self.findings.evidence["residual_with_onsets"] = rest
        return not self.predicts(rest, joint_fit)

    def left_at(self, joint_fit: Fitted, width: Array) -> float:
        """Residual over noise of the joint fit with another B, width (grid,), once the path fits that."""
        design = joint_fit.fit.backlash.design(self.grid)
        backlash = np.linalg.lstsq(design.toarray(), width, rcond=None)[0]
        return self._left_with(joint_fit, replace(joint_fit.curves, backlash=backlash))

    @staticmethod
    def _left_with(fitted: Fitted, curves: Curves) -> float:
        """Residual over noise with this B and delay, once the path fits them; measured as the fit's own scale is."""
        smoothing = dict(fitted.fit.smoothing)
        alone = replace(fitted.fit, fit_backlash=False, fit_delay=False, smoothing=smoothing)
        solved = alone.solve(curves, iterations=5, adapt=False)
        return solved.scale if alone.hysteresis.single else left(replace(solved, scale=fitted.scale))

    def held(self, joint_fit: Fitted, curve: WidthCurve | None) -> Array:
        """The joint fit's B, held beyond the positions that passes both ways or onsets reached: what lies there could
        be f_remain as well. Not where something is known of it beforehand, nor of several elements: some turn in no
        stroke but there, and are where B there puts them."""
        if not joint_fit.fit.hysteresis.single or joint_fit.fit.beforehand is not None:
            return joint_fit.fit.width(joint_fit.curves)
        low, high = overlap(joint_fit)
        if curve is not None:
            low, high = (min(low, curve.measured[0]), max(high, curve.measured[1])) if low < high else curve.measured
        width = joint_fit.fit.width(joint_fit.curves)
        if low >= high:
            return width
        return allowed_width(self.grid, np.interp(np.clip(self.grid, low, high), self.grid, width))

    def _passes_tell(self, joint_fit: Fitted) -> bool:
        """Whether the tip was seen to move over the same positions both ways."""
        low, high = overlap(joint_fit)
        return low < high and self.moves()

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
        self.findings.evidence["start_over_path_slope"] = ratio
        if ratio > _AT_ONCE:
            return False
        self.findings.notice(
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
        self, widths: Sequence[Onset], curve: WidthCurve, joint_fit: Fitted, passes: Fitted | None
    ) -> tuple[Array, Array, str]:
        """The onsets' curve near onsets; farther off, the passes' shape shifted to meet it: B, its sigma, its source.
        The image's jump is in the passes' distance, another at each place: as far as it differs where onsets tell it,
        it may there."""
        p = np.sort([o.q_mean for o in widths])
        reach = max(
            1.5 * float(np.median(np.diff(p))) if len(p) > 2 else 0.0, float(np.median([o.width for o in widths]))
        )
        distance = np.min(np.abs(self.grid[:, None] - p[None, :]), axis=1)
        far = np.clip(distance / reach - 1.0, 0.0, 1.0)
        if not (far > 0).any() or passes is None:
            return curve.width, curve.sigma, ONSETS
        own = passes.fit.width(passes.curves)
        near = far == 0.0
        apart = (curve.width - own)[near]
        other = own + np.interp(self.grid, self.grid[near], apart)
        meets = np.interp(self.grid, self.grid[near], np.hypot(curve.sigma[near], float(np.std(apart))))
        share = far * far * (3 - 2 * far)  # without a corner at either end
        inside = (self.grid >= p[0]) & (self.grid <= p[-1])
        share = np.where(inside, share, 0.0)
        width = allowed_width(self.grid, (1 - share) * curve.width + share * other)
        sigma = np.hypot((1 - share) * curve.sigma, share * np.hypot(passes.width_sigma(self.grid), meets))
        if share.max() > 0.5:
            where = self.grid[share > 0.5]
            self.findings.notes.append(
                f"no onset from {where[0]:.3g} to {where[-1]:.3g} {self.unit}: there B(q) is the distance of the passes"
            )
        return width, sigma, ONSETS
