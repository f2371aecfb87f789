"""How well a track fits its motor at any lag. A lag is by how much the sensor's times are later than the motor's, s.

At each lag a play of constant width and a polynomial of fifth order are fitted to what the sensor saw. The misfit is
the share of the variance of y that they leave: it needs no pose, no camera and no model of the instrument."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline import _native
from tautline.calibration.observations import Mask, Track
from tautline.geometry import project
from tautline.rig import MARKER, Rig

Array = npt.NDArray[np.float64]

DELAY_REACH_S = 0.25  # prior: a lag that is farther from the nominal delay is no delay but another clock
PITCH_S = 0.05  # tolerance: between lags of the search; a stroke lasts ten times longer
FRAMES = 400, 1500  # tolerance: frames, at most: to search with, to refine with
_NOISY = 0.05  # tolerance: share of noise in the variance of y above which there is no motion to compare
_ANEW = 8  # tolerance: lags after which all widths are tried again
_ORDER = 5  # prior: of the polynomial that stands for the path
FEWEST = 8 * _ORDER  # tolerance: frames that such a fit needs
WIDTHS = (0.0, 0.01, 0.022, 0.04, 0.065, 0.1, 0.16, 0.26, 0.4)  # tolerance: of plays that are tried, of the span
_AROUND_S = 0.5  # prior: a tip follows its motor within it
_RESTS = 0.9  # tolerance: share of the frames at which the other axes have to rest
_INSIDE = np.array([0.25, 0.75])  # tolerance: of the motor's span: between which f_coarse tells the way of the image
_DITHER = 2e-3  # tolerance: of the motor's span: turns within it do not matter here
_AROUND = 9  # tolerance: places within _AROUND_S of a frame at which the motor is looked at
_ROUNDS, _CLOSER = 9, 0.6  # tolerance: of a pattern search; of its steps, from round to round
_STEP, _STEP_OF_SPAN = 0.3, 0.005  # tolerance: of the width, and of the span with it: the first step of a width
_FORGOT = 1e-9  # tolerance: of the span: two starts of a play that are so near are one


@dataclass(frozen=True)
class Minimum:
    """A local minimum of the misfit over lags."""

    lag_s: float
    misfit: float


@dataclass(frozen=True)
class LagScan:
    """One track prepared to be fitted at many lags."""

    track: Track  # thinned out
    turn_t: Array  # (turns,) when the motor turned, s
    turn_q: Array  # (turns,) where, unit of q
    low: float  # lowest motor position
    span: float  # of the motor's positions
    noise_share: float  # of the variance of y
    reference: tuple[float, float] | None  # of the other axes; None where they rest
    coarse_direction: Array  # (channels,) in which y moves as q rises, by f_coarse
    last: dict[float, tuple[Array, npt.NDArray[np.intp], Mask]] = field(  # by lag
        init=False, default_factory=dict, compare=False, repr=False
    )

    @classmethod
    def of(cls, track: Track, rig: Rig, most: int) -> LagScan | None:
        """The track thinned out evenly to at most `most` frames. None if it has fewer than FEWEST frames, if motor or y
        do not move, if noise makes more than _NOISY of y's variance, or if other axes rest for less than _RESTS of the
        frames."""
        motor = track.motor
        span = float(np.ptp(motor.q))
        variance = float(np.mean(np.var(track.y, axis=0))) if len(track.t_s) else 0.0
        if len(track.t_s) < FEWEST or span <= 0.0 or variance <= 0.0:
            return None
        share = float(np.mean(track.sigma**2)) / variance
        reference = None if motor.translation_mm is None and motor.rotation_deg is None else track.others_reference
        if share > _NOISY:
            return None
        if reference is not None and np.mean(track.at_reference(track.t_s, reference)) < _RESTS:
            return None
        stride = -(-len(track.t_s) // most)
        few = track.only(slice(None, None, stride))
        turns = _native.turns(np.ascontiguousarray(motor.q), _DITHER * span)
        keep = np.unique(np.concatenate([[0], turns, [len(motor.q) - 1]])).astype(np.intp)
        low = float(motor.q.min())
        ends = rig.coarse.gain * (low + _INSIDE * span) + rig.coarse.offset
        if track.sensor == MARKER:
            coarse_direction = np.diff(project(rig, ends, *track.others_reference), axis=0)[0]
        else:
            coarse_direction = np.diff(ends)
        return cls(few, motor.t_s[keep], motor.q[keep], low, span, share, reference, coarse_direction)

    def least_misfits(self, lags: npt.NDArray[Any]) -> Array:
        """The least misfit over all WIDTHS at each of the lags (n,), s, in rising order and close to each other. From
        one lag to the next the best width moves by one of WIDTHS at most, so only neighbours are tried; all of them
        every _ANEW lags."""
        least, at = np.empty(len(lags)), 0
        for i, lag in enumerate(lags):
            near = range(len(WIDTHS)) if i % _ANEW == 0 else range(max(at - 1, 0), min(at + 2, len(WIDTHS)))
            tried = [self.misfit(float(lag), WIDTHS[k] * self.span) for k in near]
            at = near[int(np.argmin(tried))]
            least[i] = min(tried)
        return least

    def moves_as_coarse(self, lag_s: float) -> bool:
        """Whether, at a lag in s, y moves the way that f_coarse says as the play's centre rises. If not, the lag may be
        off by half a cycle of the motion."""
        width = min(WIDTHS, key=lambda share: self.misfit(lag_s, share * self.span)) * self.span
        return bool(self._polynomial_fit(lag_s, width)[1] @ self.coarse_direction > 0.0)

    def misfit(self, lag_s: float, width: float) -> float:
        """Share of the variance of y that is left at a lag, s, and a play's width, unit of q; infinite if fewer than
        half of the frames count (`_polynomial_fit`)."""
        return self._polynomial_fit(lag_s, width)[0]

    def _polynomial_fit(self, lag_s: float, width: float) -> tuple[float, Array]:
        """Least squares of y by a Chebyshev polynomial of order _ORDER in p, the centre of a play of this width, unit
        of q, at a lag, s. Returns the misfit and the coefficients of the linear term (channels,). Frames count if the
        motor's record covers them and the play has forgotten its start (it is at one place whether run from below or
        from above). (inf, zeros) if fewer than half of the frames count."""
        q, frame, inside = self._driven(lag_s)
        grid = np.array([self.low - self.span, self.low + 2.0 * self.span])
        plays = _native.Plays(grid, np.full(2, width))
        far = 10.0 * (self.span + float(np.abs(grid).max()))
        p, from_above = (plays.forward(q, start)[0] for start in (-far, far))
        counted = inside & (np.abs(p - from_above) < _FORGOT * self.span)
        frames, x = frame[counted], 2.0 * (p[counted] - self.low) / self.span - 1.0
        if 2 * len(frames) < len(self.track.t_s):
            return np.inf, np.zeros_like(self.coarse_direction)
        y = self.track.y[frames]
        y = y - y.mean(axis=0)
        design = np.polynomial.chebyshev.chebvander(x, _ORDER)
        gram = design.T @ design + 1e-9 * len(x) * np.eye(_ORDER + 1)
        pull = design.T @ y
        total = max(float(np.sum(y * y)), 1e-30)
        coefficients = np.linalg.solve(gram, pull)
        return max(1.0 - float(np.sum(pull * coefficients)) / total, 0.0), coefficients[1]

    def _driven(self, lag_s: float) -> tuple[Array, npt.NDArray[np.intp], Mask]:
        """What a play is driven with at a lag, s, in order of time: the motor's positions (m,), unit of q, at its turns
        and at the frames; the index of the frame (negative: a turn); and whether it is a frame that the motor's record
        covers. Kept in `last` until another lag is asked for, as a search tries several widths at each."""
        if lag_s not in self.last:
            track, scene, turns = self.track, self.track.scene_s(lag_s), len(self.turn_t)
            # Turns come first in what is sorted, so a place less their number is a frame's index.
            order = np.argsort(np.concatenate([self.turn_t, scene]), kind="stable")
            inside = track.within_motor(scene)
            if self.reference is not None:
                inside &= track.at_reference(scene, self.reference)
            q = np.concatenate([self.turn_q, track.motor_at(scene)])
            self.last.clear()
            self.last[lag_s] = q[order], order - turns, np.concatenate([np.zeros(turns, dtype=bool), inside])[order]
        return self.last[lag_s]

    def moving(self) -> Mask:
        """(n,) frames within _AROUND_S of which the motor moves: only they tell a delay."""
        t = self.track.t_s
        q = self.track.motor_at(t[:, None] + np.linspace(-_AROUND_S, _AROUND_S, _AROUND))
        moves: Mask = np.ptp(q, axis=1) > _DITHER * self.span
        return moves

    def minimum_near(self, lag_s: float) -> Minimum:
        """The minimum of the misfit over lag and width near lag_s, s, by a pattern search: lag and width are stepped
        both ways, a step that leaves less is taken, and steps become smaller from round to round."""
        width = self.span * min(WIDTHS, key=lambda share: self.misfit(lag_s, share * self.span))
        step_s, step = PITCH_S, _STEP * width + _STEP_OF_SPAN * self.span
        best = self.misfit(lag_s, width)
        for _ in range(_ROUNDS):
            for other in (lag_s - step_s, lag_s + step_s):
                if (trial := self.misfit(other, width)) < best:
                    best, lag_s = trial, other
            for other in (max(width - step, 0.0), width + step):
                if (trial := self.misfit(lag_s, other)) < best:
                    best, width = trial, other
            step_s, step = _CLOSER * step_s, _CLOSER * step
        return Minimum(lag_s, best)


def period_s(tracks: Sequence[Track]) -> float:
    """Median time between frames, s."""
    return float(np.median(np.concatenate([np.diff(track.t_s) for track in tracks])))
