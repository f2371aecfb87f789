"""A least-squares fit of everything smooth at once: B(p), the curve that the tip follows with p, and the delay.

The tip's measured coordinates are y = h(s(p)), p the play of the motor through B. s is either the image itself (two
channels, h = identity: no pose, no camera, no hand-eye) or the bending angle (one channel, h = the projection, or
identity for an angle sensor). Residuals and Jacobian are exact on the linear table; every row has few entries.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_solve

from tautline.calibration.beforehand import Beforehand, Term, between
from tautline.calibration.beside import FittedEffects
from tautline.calibration.observations import Mask, Track, corners
from tautline.calibration.rounding import counts
from tautline.elements import SINGLE, Hysteresis, Play
from tautline.least_squares import descend, factor
from tautline.model import STEEPEST, allowed_width
from tautline.nominal import Nominal, Normal, Rows, by_width, steepness
from tautline.splines import Basis

Array = npt.NDArray[np.float64]
# (s (n,), translation (n,), rotation (n,)) -> y (n, k) and dy/ds (n, k)
View = Callable[[Array, Array, Array], tuple[Array, Array]]

EXPLAINED = 1.5  # tolerance: residual over noise up to which a model explains its data
_STIFF = 1e4  # cost, in sigma^2, of a neighbour difference that is off its limit by the whole limit
_GAIN = 0.2  # sigma^2: an iteration that gains less is the last but one
NODES = 1025  # of the tables that fits and models use
_SELDOM = 0.1  # of the positions, at which B may be less than what counts as driven through
_SLOPE_S = 0.004  # least half interval over which the motor's speed is taken


@dataclass(frozen=True)
class Curves:
    """The state of a fit. Coefficients belong to the fit's two bases."""

    backlash: Array  # (m_b,)
    follow: Array  # (m_f, channels)
    delay_s: float
    beside: Array = field(default_factory=lambda: np.zeros(0))  # values of the effects that the fit holds


@dataclass(frozen=True)
class Simulated:
    """What the model says at each frame of one track."""

    p: Array
    tip: Array  # where along the law: p, but for effects beside the play
    known: Mask  # the play has forgotten where it started, and motor samples cover the frame
    settled: Mask  # known, and driven through a full backlash in both directions
    side: npt.NDArray[np.int8]  # envelope that last moved p (of several elements: that last held them all)
    lean: Array  # -2 dp/dB where B is constant; of one element its side
    share: Array  # dp/dq there: of one element 1 where p moves with q at this frame, else 0
    speed: Array  # dq/dt, unit/s

    @property
    def moving(self) -> Mask:
        """(n,) frames at which the tip moves."""
        moves: Mask = self.share > 0
        return moves

    def slopes(self, keep: Mask, slope: Array) -> tuple[Array, Array]:
        """dp/dB and dp/d(delay) (in the unit of q per s) at the frames that are kept, dB/dp there being `slope`."""
        lean = self.lean[keep]
        return by_width(lean, slope), -self.speed[keep] * self.share[keep] / steepness(lean, slope)


@dataclass(frozen=True)
class MotorAtFrames:
    """What the motor did, as the frames of one track saw it at one delay."""

    positions: Array  # all that a play needs, in order of time
    at: npt.NDArray[np.intp]  # which of them are at the frames
    within: Mask  # motor samples cover the frame
    speed: Array  # dq/dt, unit/s


@dataclass(frozen=True)
class PreparedTrack:
    """One track prepared for many simulations."""

    track: Track
    corner_t: Array
    corner_q: Array
    use: Mask  # frames that count
    half_s: float  # half the interval over which the motor's speed is taken
    last: dict[float, MotorAtFrames] = field(
        init=False, default_factory=dict, compare=False, repr=False
    )  # of one delay

    @classmethod
    def of(cls, track: Track, use: Mask | None = None) -> PreparedTrack:
        """The track with its motor's extremes; use (n,): frames that count, all by default."""
        times, positions = corners(track.motor)
        samples_s = track.reading.t_s
        half_s = max(_SLOPE_S, float(np.median(np.diff(samples_s)))) if len(samples_s) > 1 else _SLOPE_S
        return cls(track, times, positions, np.ones(len(track.t_s), bool) if use is None else use, half_s)

    def course(self, scene_s: Array) -> tuple[Array, npt.NDArray[np.intp]]:
        """All that a play needs of the motor's positions, in order of time, and which of them are at `scene_s`."""
        times = np.concatenate([self.corner_t, scene_s])
        order = np.argsort(times, kind="stable")
        back = np.empty(len(times), dtype=np.intp)
        back[order] = np.arange(len(times))
        return np.concatenate([self.corner_q, self.track.motor_at(scene_s)])[order], back[len(self.corner_t) :]

    def driven(self, delay_s: float) -> MotorAtFrames:
        """What the motor did at this delay, s. Kept until another one is asked for: a scan of widths has one."""
        if delay_s not in self.last:
            track, scene = self.track, self.track.scene_s(delay_s)
            positions, at = self.course(scene)
            speed = (track.motor_at(scene + self.half_s) - track.motor_at(scene - self.half_s)) / (2 * self.half_s)
            self.last.clear()
            self.last[delay_s] = MotorAtFrames(positions, at, track.within_motor(scene), speed)
        return self.last[delay_s]

    def simulate(
        self, grid: Array, width: Array, delay_s: float, elements: Hysteresis = SINGLE,
        beside: FittedEffects | None = None, values: Array | None = None,
    ) -> Simulated:  # fmt: skip
        """What a play of B width (nodes,) on grid, unit of q, says at each frame at this delay, s, with effects beside
        it. Run from both far ends: where the two agree it has forgotten its start."""
        driven = self.driven(delay_s)
        positions, at = driven.positions, driven.at
        far = 10.0 * (abs(grid[-1] - grid[0]) + abs(positions).max(initial=1.0))
        plays = Play(grid, width, elements).native
        p, side, lean, share = plays.trace(positions, -far)
        other, other_side = plays.forward(positions, far)
        known = (np.abs(p - other) < elements.forgotten * (grid[-1] - grid[0]))[at] & driven.within
        both = np.logical_or.accumulate(side == -1) & np.logical_or.accumulate(other_side == 1)
        both &= _there_and_back(positions, _low_width(grid, width, positions))
        alone = Simulated(p[at], p[at], known, known & both[at], side[at], lean[at], share[at], driven.speed)
        if beside is None or values is None:
            return alone
        path = beside.follow(self.track.reading, self.track.scene_s(delay_s), grid, width, elements, values)
        return replace(alone, p=path.p, tip=path.tip, side=np.sign(path.side).astype(np.int8), lean=path.lean)


@dataclass
class PlayFit:
    """Fits `Curves` to tracks. `view` None: the channels are y itself."""

    tracks: Sequence[PreparedTrack]
    backlash: Basis
    follow: Basis
    view: View | None = None
    fit_backlash: bool = True
    fit_delay: bool = True
    settled_only: bool = True  # frames before the tip was driven both ways do not count
    rising: float = 0.0  # +1, -1: s must rise or fall with p by `least_slope`; 0: free
    least_slope: float = 0.0
    slope_unit: float = 1.0  # a usual slope of s
    elements: Hysteresis = SINGLE
    delay_sigma_s: float = 1.0  # how well the delay is known where it is not fitted
    beforehand: Beforehand | None = None  # what is known without these tracks
    beside: FittedEffects | None = None  # effects between the motor and the curve that is followed
    fit_beside: bool = True
    alike: float = 1.0  # frames for each independent one: that many say as much of a curve's shape as one
    smoothing: dict[str, float] = field(default_factory=lambda: {"backlash": 1e-2, "follow": 1e-6})
    grid: Array = field(init=False)
    simulated: list[Simulated] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        self.grid = np.linspace(self.backlash.low, self.backlash.high, NODES)

    def width(self, curves: Curves) -> Array:
        """B (nodes,) on the fit's grid, unit of q, limited to what a table may have."""
        return allowed_width(self.grid, self.backlash.value(curves.backlash, self.grid))

    def residuals(self, curves: Curves) -> tuple[list[Array], list[Mask]]:
        """Per track: (y - model)/sigma (n, k), and which frames count (n,). Sets `simulated`."""
        width = self.width(curves)
        self.simulated = [
            t.simulate(self.grid, width, curves.delay_s, self.elements, self.beside, curves.beside) for t in self.tracks
        ]
        residuals, masks = [], []
        for prepared, sim in zip(self.tracks, self.simulated, strict=True):
            y = self.seen(prepared.track, curves, sim.tip)
            residuals.append((prepared.track.y - y) / prepared.track.sigma[:, None])
            masks.append(prepared.use & (sim.settled if self.settled_only else sim.known) & np.isfinite(y).all(axis=1))
        return residuals, masks

    def seen(self, track: Track, curves: Curves, p: Array) -> Array:
        """The model's y (n, coordinates), sensor's unit, at each frame of a track, the tip being at p (n,)."""
        s = self.follow.value(curves.follow, p)
        if self.view is None:
            return s
        translation, rotation = track.others_at(track.scene_s(curves.delay_s))
        return self.view(s[:, 0], translation, rotation)[0]

    def counted(self, weights: Sequence[Array], curves: Curves, scale: float) -> list[Array]:
        """Weights (n,) of each track's frames times as much of an independent frame as each one is (rounding.py), where
        the residuals are `scale` times the noise. After `residuals` with the same curves."""
        return [
            weight * counts(prepared.track, self.seen(prepared.track, curves, sim.tip), prepared.use, scale)
            if prepared.track.step > 0.0
            else weight
            for weight, prepared, sim in zip(weights, self.tracks, self.simulated, strict=True)
        ]

    def normal(
        self, curves: Curves, residuals: list[Array], weights: list[Array], extra: Sequence[Array] | None = None
    ) -> tuple[Array, Array]:
        """J'WJ and J'Wr of the whitened problem, unknowns ordered follow (channel by channel), backlash, what is beside
        them, delay, and the factors of `extra`: columns (frames, m) of each track, unit of the tip's place.
        After `residuals` with the same curves."""
        channels = curves.follow.shape[1]
        mf, mb = self.follow.size, self.backlash.size
        total = channels * mf + mb + len(curves.beside) + 1 + (extra[0].shape[1] if extra else 0)
        matrix, gradient = np.zeros((total, total)), np.zeros(total)
        # For each channel: where its unknowns and those that all share (backlash to delay) are, and their own sums.
        shared = np.arange(channels * mf, total)
        places = [np.concatenate([shared[:mb], np.arange(k * mf, (k + 1) * mf), shared[mb:]]) for k in range(channels)]
        nominal, sums = Nominal(self.backlash, self.follow), [Normal.zeros(len(at)) for at in places]
        for number, (prepared, sim, r, w) in enumerate(
            zip(self.tracks, self.simulated, residuals, weights, strict=True)
        ):
            keep = w > 0
            if not keep.any():
                continue
            p, tip, track = sim.p[keep], sim.tip[keep], prepared.track
            inverse = 1.0 / track.sigma[keep]
            slope = self.follow.slope(curves.follow, tip)
            by_s = self._seen_at(track, self.follow.value(curves.follow, tip), keep, curves.delay_s)
            by_s = by_s * inverse[:, None]
            by_b, shared_by = self.slopes(prepared, sim, keep, curves)
            shared_by = np.column_stack([shared_by, extra[number][keep]]) if extra else shared_by
            for channel, own in enumerate(sums):
                of = slice(None) if self.view is not None else slice(channel, channel + 1)
                h, steep = np.ascontiguousarray(by_s[:, of]), slope[:, channel]
                columns = h[:, :, None] * (steep[:, None] * shared_by)[:, None, :]
                residual = np.ascontiguousarray(r[keep, of])
                weight = np.ascontiguousarray(np.broadcast_to(w[keep, None], h.shape))
                nominal.add(Rows(p, tip, steep * by_b, np.ones(len(p)), h, columns, residual), own, weight=weight)
        for at, part in zip(places, sums, strict=True):
            matrix[np.ix_(at, at)] += part.matrix
            gradient[at] += part.gradient
        return matrix, gradient

    def slopes(self, prepared: PreparedTrack, sim: Simulated, keep: Mask, curves: Curves) -> tuple[Array, Array]:
        """Derivatives of the tip's place at the frames that are kept: by B there (kept,), and (kept, m) by what is
        beside it and the delay."""
        by_b, by_delay = sim.slopes(keep, self.backlash.slope(curves.backlash, sim.p[keep]))
        by_values = np.empty((len(by_b), 0))
        if self.beside is not None and (self.fit_beside or self.fit_delay or self.fit_backlash):
            at = prepared.track.scene_s(curves.delay_s)
            by_b, by_values, by_delay = (
                each[keep]
                for each in self.beside.slopes(
                    prepared.track.reading, at, self.grid, self.width(curves), self.elements, curves.beside
                )
            )
        elif self.beside is not None:
            by_values = np.zeros((len(by_b), len(curves.beside)))
        shared = np.column_stack([by_values * self.fit_beside, by_delay * self.fit_delay])
        return by_b * self.fit_backlash, shared

    def slope_in_view(self, track: Track, curves: Curves, p: Array) -> Array:
        """dy/dp (n, coordinates) in the sensor's unit at each frame of a track."""
        slope = self.follow.slope(curves.follow, p)
        if self.view is None:
            return slope
        s = self.follow.value(curves.follow, p)
        return self._seen_at(track, s, np.ones(len(p), dtype=bool), curves.delay_s) * slope

    def _seen_at(self, track: Track, s: Array, keep: Mask, delay_s: float) -> Array:
        """dy/ds (kept, coordinates), sensor's unit; 1 where s is y itself."""
        if self.view is None:
            return np.ones_like(s)
        translation, rotation = track.others_at(track.scene_s(delay_s)[keep])
        return self.view(s[:, 0], translation, rotation)[1]

    # ---- the fit

    def solve(self, start: Curves, iterations: int = 30, robust: bool = True, adapt: bool = True) -> Fitted:
        """Least squares from `start`. robust: outliers are weighed by Huber; adapt: smoothing by restricted maximum
        likelihood (Fellner-Schall steps), else as it is."""
        minimum = descend(_Descent(self, robust, adapt), _Point.of(self, start), iterations)
        curves = minimum.curves
        residuals, masks = self.residuals(curves)
        scale, weights = _weights(residuals, masks, robust)
        weights = self.counted(weights, curves, scale)
        matrix, _ = self.normal(curves, residuals, weights)
        penalty, _ = self.penalty(curves, scale)
        covariance = np.asarray(np.linalg.inv(matrix + penalty + 1e-12 * np.eye(len(matrix))) * scale * scale)
        return Fitted(self, curves, scale, residuals, masks, weights, covariance)

    def step(self, curves: Curves, residuals: list[Array], masks: list[Mask]) -> Curves:
        """One Gauss-Newton step of all counted frames alike; after `residuals` with the same curves."""
        matrix, gradient = self.normal(curves, residuals, [m.astype(float) for m in masks])
        system = matrix + self.penalty(curves, 1.0)[0]
        ridge = 1e-9 * np.eye(len(system)) * np.trace(system) / len(system)
        return self.moved(curves, np.asarray(np.linalg.solve(system + ridge, gradient)))

    def moved(self, curves: Curves, step: Array) -> Curves:
        """The curves a step further, within what they may be: B moves by 15 % of the range at most and not below 0, the
        delay by 30 ms; what is not fitted stays."""
        channels = curves.follow.shape[1]
        cut = channels * self.follow.size
        backlash = curves.backlash
        if self.fit_backlash:
            change = step[cut : cut + self.backlash.size]
            limit = 0.15 * (self.backlash.high - self.backlash.low)
            backlash = np.maximum(backlash + np.clip(change, -limit, limit), 0.0)
        delay = curves.delay_s + float(np.clip(step[-1], -0.03, 0.03)) if self.fit_delay else curves.delay_s
        follow = curves.follow + step[:cut].reshape(channels, self.follow.size).T
        beside = curves.beside
        if self.beside is not None and self.fit_beside:
            beside = self.beside.inside(beside + step[cut + self.backlash.size : -1])
        return replace(curves, backlash=backlash, follow=follow, delay_s=delay, beside=beside)

    def penalty(self, curves: Curves, scale: float) -> tuple[Array, Array]:
        """Matrix P and gradient P theta of smoothness, of constraints that are violated and of priors, which count in
        units of scale^2 (scale: residual over noise). What is not fitted is held by a unit diagonal, the delay by its
        sigma."""
        channels = curves.follow.shape[1]
        mf, mb = self.follow.size, self.backlash.size
        cut = channels * mf
        total = cut + mb + len(curves.beside) + 1
        matrix, pull = np.zeros((total, total)), np.zeros(total)
        known_path = self._known_path(curves)
        bending, _ = self._bending(channels)
        for k in range(channels):
            block = slice(k * mf, (k + 1) * mf)
            rough = self.smoothing["follow"] * bending
            matrix[block, block] += rough
            pull[block] += rough @ curves.follow[:, k]
            if known_path:
                known, pulled, _ = known_path[k]
                matrix[block, block] += scale * scale * known
                pull[block] += scale * scale * pulled
        if self.fit_backlash:
            block = slice(cut, cut + mb)
            rough = self.smoothing["backlash"] * self.backlash.roughness
            matrix[block, block] += rough
            pull[block] += rough @ curves.backlash
            stiff, bend = _steep(curves.backlash, STEEPEST * 0.98 * self.backlash.step)
            weight = _STIFF * scale * scale / self.backlash.step**2
            matrix[block, block] += weight * stiff
            pull[block] += weight * bend
            if self.beforehand is not None:
                known, pulled, _ = self.beforehand.of_width(self.backlash, curves.backlash)
                matrix[block, block] += scale * scale * known
                pull[block] += scale * scale * pulled
        else:
            matrix[cut : cut + mb, cut : cut + mb] += np.eye(mb)
        if self.rising:
            block = slice(0, mf)
            stiff, bend = _monotone(curves.follow[:, 0], self.rising, self.least_slope * self.follow.step)
            weight = _STIFF * scale * scale / (self.slope_unit * self.follow.step) ** 2
            matrix[block, block] += weight * stiff
            pull[block] += weight * bend
        if not self.fit_delay:
            matrix[-1, -1] += (scale / self.delay_sigma_s) ** 2
        if self.beside is not None:
            at = np.arange(cut + mb, total - 1)
            matrix[at, at] += scale * scale * self.beside.precision if self.fit_beside else 1.0
        return matrix, pull

    def _path_known(self, channels: int) -> Beforehand | None:
        """What is known of the path, where it is followed in the sensor's own coordinates and these are as many."""
        known = self.beforehand
        return known if known is not None and self.view is None and len(known.path) == channels else None

    def _known_path(self, curves: Curves) -> list[Term]:
        """The prior's Term of each channel of the path; none where nothing is known of it."""
        known = self._path_known(curves.follow.shape[1])
        return [] if known is None else known.of_path(self.follow, curves.follow)

    def _bending(self, channels: int) -> tuple[Array, int]:
        """Penalty (size, size) on each channel of the path, and its rank: what is known of it beforehand is not
        smoothed as well."""
        known = self._path_known(channels)
        if known is None:
            return self.follow.bending, self.follow.size - 2
        return between(self.follow, tuple(known.path[0].q.tolist()))

    def hold(self, curves: Curves, matrix: Array, gradient: Array) -> None:
        """Takes out of the normal equations what is beside B and at an end of its range that they lead beyond."""
        assert self.beside is not None
        first = len(gradient) - 1 - len(curves.beside)
        ends = first + self.beside.at_ends(curves.beside, gradient[first:-1])
        matrix[ends, :] = matrix[:, ends] = gradient[ends] = 0.0

    def begin(self, curves: Curves, scale: float) -> None:
        """Sets the smoothing as the start's own roughness suggests. scale: residual over noise."""
        bending, rank = self._bending(curves.follow.shape[1])
        rough = sum(float(c @ bending @ c) for c in curves.follow.T)
        rank *= curves.follow.shape[1]
        self.smoothing["follow"] = float(np.clip(scale * scale * rank / max(rough, 1e-12), 1e-8, 1e8))
        rough = float(curves.backlash @ self.backlash.roughness @ curves.backlash)
        rank = self.backlash.size - 2
        self.smoothing["backlash"] = float(np.clip(scale * scale * rank / max(rough, 1e-12), 1e-8, 1e8))

    def adapt(self, curves: Curves, system: Array, scale: float) -> None:
        """A step of the smoothing towards the restricted likelihood's maximum. system: normal matrix with all
        penalties; scale: residual over noise."""
        channels = curves.follow.shape[1]
        mf, mb = self.follow.size, self.backlash.size
        cut = channels * mf
        inverse = cho_solve(factor(system), np.eye(len(system)), check_finite=False)
        bending, rank = self._bending(channels)
        parts: list[tuple[str, list[slice], Array, int, list[Array]]] = [
            (
                "follow",
                [slice(k * mf, (k + 1) * mf) for k in range(channels)],
                bending,
                rank,
                list(curves.follow.T),
            )
        ]
        if self.fit_backlash:
            block = [slice(cut, cut + mb)]
            parts.append(("backlash", block, self.backlash.roughness, mb - 2, [curves.backlash]))
        for name, blocks, form, rank_each, values in parts:
            now = self.smoothing[name]
            rank = rank_each * len(blocks)
            spent = now * sum(float(np.sum(inverse[b, b] * form)) for b in blocks)
            rough = sum(float(v @ form @ v) for v in values)
            ratio = self.alike * scale * scale * max(rank - spent, 1e-3) / max(now * rough, 1e-12)
            self.smoothing[name] = float(np.clip(now * np.clip(ratio, 0.05, 20.0), 1e-10, 1e8))

    def cost(self, curves: Curves, residuals: list[Array], weights: list[Array], scale: float) -> float:
        """Weighted squares of the residuals over noise, with smoothness, priors and constraints, which count in units
        of scale^2; infinite where no frame counts."""
        used = sum(float(np.sum(w > 0)) for w in weights)
        if used == 0:
            return np.inf
        data = sum(
            float(np.sum(w[:, None] * np.where(w[:, None] > 0, r, 0.0) ** 2))
            for r, w in zip(residuals, weights, strict=True)
        )
        total = sum(len(w) for w in weights)
        data *= total / used  # frames that drop out of the simulation are no gain
        bending, _ = self._bending(curves.follow.shape[1])
        smooth = sum(self.smoothing["follow"] * float(c @ bending @ c) for c in curves.follow.T)
        smooth += scale * scale * sum(told for _, _, told in self._known_path(curves))
        if self.fit_backlash:
            smooth += self.smoothing["backlash"] * float(curves.backlash @ self.backlash.roughness @ curves.backlash)
            _, bend = _steep(curves.backlash, STEEPEST * 0.98 * self.backlash.step)
            smooth += _STIFF * scale * scale / self.backlash.step**2 * float(curves.backlash @ bend)
            if self.beforehand is not None:
                smooth += scale * scale * self.beforehand.of_width(self.backlash, curves.backlash)[2]
        if self.rising:
            over = np.maximum(self.least_slope * self.follow.step - self.rising * np.diff(curves.follow[:, 0]), 0.0)
            smooth += _STIFF * scale * scale / (self.slope_unit * self.follow.step) ** 2 * float(over @ over)
        return data + smooth


@dataclass(frozen=True)
class _Point:
    curves: Curves
    residuals: list[Array]
    masks: list[Mask]
    simulated: list[Simulated]

    @classmethod
    def of(cls, fit: PlayFit, curves: Curves) -> _Point:
        """With the residuals and the simulation of these curves."""
        residuals, masks = fit.residuals(curves)
        return cls(curves, residuals, masks, fit.simulated)


class _Descent:
    """A PlayFit as a least-squares problem: weights by Huber, smoothing that adapts from the second step on."""

    def __init__(self, fit: PlayFit, robust: bool, adapt: bool) -> None:
        self.fit, self.robust, self.adapt = fit, robust, adapt
        self.scale, self.weights = 1.0, list[Array]()
        self.steps = self.settled = 0

    def linearised(self, point: _Point) -> tuple[Array, Array, float]:
        """Normal matrix, gradient that lowers the cost, and cost at a point, with new weights and, from the second on,
        adapted smoothing."""
        fit, curves = self.fit, point.curves
        fit.simulated = point.simulated
        self.scale, weights = _weights(point.residuals, point.masks, self.robust)
        self.weights = fit.counted(weights, curves, self.scale)
        if self.adapt and self.steps == 0:
            fit.begin(curves, self.scale)
        matrix, gradient = fit.normal(curves, point.residuals, self.weights)
        penalty, pull = fit.penalty(curves, self.scale)
        if self.adapt and self.steps > 0:
            fit.adapt(curves, matrix + penalty, self.scale)
            penalty, pull = fit.penalty(curves, self.scale)
        self.steps += 1
        if fit.beside is not None:
            fit.hold(curves, matrix, gradient)
        return matrix + penalty, gradient - pull, fit.cost(curves, point.residuals, self.weights, self.scale)

    def moved(self, point: _Point, step: Array) -> _Point:
        """The point a step further."""
        return _Point.of(self.fit, self.fit.moved(point.curves, step))

    def cost(self, point: _Point) -> float:
        """The cost at a point, by the weights and the smoothing of the last linearisation, so that costs compare;
        frames that did not count then weigh 1."""
        kept = _again(self.weights, point.masks)
        weights = [np.where(m, w, 0.0) for m, w in zip(point.masks, kept, strict=True)]
        return self.fit.cost(point.curves, point.residuals, weights, self.scale)

    def enough(self, gained: float, cost: float) -> bool:
        """Whether two steps in a row gained too little: 0.2 sigma^2, or 3e-4 of the cost while the residuals are
        clearly more than noise (1.2)."""
        least = max(_GAIN * self.scale * self.scale, 3e-4 * cost * (self.scale > 1.2))
        self.settled = self.settled + 1 if gained < least else 0
        return self.settled >= 2


@dataclass(frozen=True)
class Fitted:
    fit: PlayFit
    curves: Curves
    scale: float  # rms residual over the stated noise, outliers apart: 1 where the model explains everything
    residuals: list[Array]
    masks: list[Mask]
    weights: list[Array]
    covariance: Array  # of follow (channel by channel), backlash, what is beside them, delay
    spread: Array | None = None  # of B on fit.grid, and of the delay, where model error is known too
    delay_spread: float = 0.0
    width_by_delay: Array | None = None  # on fit.grid, by how much B is another for each second that the delay is

    @property
    def frames(self) -> int:
        """How many frames count, of all tracks."""
        return int(sum(m.sum() for m in self.masks))

    @property
    def beside(self) -> tuple[FittedEffects, Array]:
        """The effects that were fitted, and their values."""
        assert self.fit.beside is not None
        return self.fit.beside, self.curves.beside

    @property
    def explained(self) -> bool:
        """Whether little more than noise is left: the model explains the data."""
        return self.scale < EXPLAINED

    def width_sigma(self, p: Array) -> Array:
        """Standard deviation of B at p: from the residuals' noise alone where nothing more is known."""
        if self.spread is not None:
            return np.asarray(np.interp(p, self.fit.grid, self.spread))
        cut = self.curves.follow.size
        design = self.fit.backlash.design(p).toarray()
        block = self.covariance[cut : cut + self.fit.backlash.size, cut : cut + self.fit.backlash.size]
        return np.asarray(np.sqrt(np.maximum(np.sum((design @ block) * design, axis=1), 0.0)))

    def path(self) -> tuple[Array, Array]:
        """(grid, channels) each: the path in the sensor's unit, and its standard deviation by the residuals' noise."""
        design = self.fit.follow.design(self.fit.grid).toarray()
        size = self.fit.follow.size
        blocks = [slice(k * size, (k + 1) * size) for k in range(self.curves.follow.shape[1])]
        variance = [np.sum((design @ self.covariance[block, block]) * design, axis=1) for block in blocks]
        return design @ self.curves.follow, np.sqrt(np.maximum(np.column_stack(variance), 0.0))

    @property
    def delay_sigma(self) -> float:
        """Standard deviation of the delay, s, with model error where that is known; 0 where the delay was not
        fitted."""
        if self.spread is not None:
            return self.delay_spread
        return float(np.sqrt(self.covariance[-1, -1])) if self.fit.fit_delay else 0.0


def _low_width(grid: Array, width: Array, positions: Array) -> float:
    """A low quantile of B over the positions that the motor reached, unit of q: a way that counts as driven through a
    full backlash. Not the least B: at the ends of the motion only the start tells it, and a B of 0 there would be
    driven through at once. grid, width (nodes,); positions (n,)."""
    first, last = np.searchsorted(grid, [positions.min(), positions.max()])
    return float(np.quantile(width[first : max(last, first + 1)], _SELDOM))


def _there_and_back(positions: Array, way: float) -> Mask:
    """(n,) whether the motor, in positions (n,), had gone up by `way` and down by it so far, both in the unit of q."""
    up = positions - np.minimum.accumulate(positions) >= way
    down = np.maximum.accumulate(positions) - positions >= way
    both: Mask = np.logical_or.accumulate(up) & np.logical_or.accumulate(down)
    return both


def _again(weights: list[Array], masks: list[Mask]) -> list[Array]:
    """Weights with those of frames that did not count set to 1, in case they count next time."""
    return [np.where(m, w, 1.0) for w, m in zip(weights, masks, strict=True)]


def _weights(residuals: list[Array], masks: list[Mask], robust: bool) -> tuple[float, list[Array]]:
    """Scale of the residuals (rms over noise, outliers bounded; 1 without frames) and each frame's Huber weight, 0
    where it does not count. 1.4826 and 1.2 make a median of one and of two coordinates' rms a standard deviation."""
    used = [np.sqrt(np.mean(r[m] ** 2, axis=1)) for r, m in zip(residuals, masks, strict=True)]
    norm = np.concatenate(used) if used else np.zeros(0)
    if len(norm) == 0:
        return 1.0, [m.astype(float) for m in masks]
    if not robust:
        return max(float(np.sqrt(np.mean(norm**2))), 1e-6), [m.astype(float) for m in masks]
    middle = float(np.sqrt(np.median(norm**2))) * (1.4826 if residuals[0].shape[1] == 1 else 1.2)
    limit = 4.0 * max(middle, 1e-9)
    scale = max(float(np.sqrt(np.mean(np.minimum(norm, limit) ** 2))), 1e-6)
    limit = 4.0 * scale
    weights = []
    for r, m in zip(residuals, masks, strict=True):
        size = np.sqrt(np.mean(np.where(m[:, None], r, 0.0) ** 2, axis=1))
        weights.append(np.where(m, np.minimum(1.0, limit / np.maximum(size, 1e-12)), 0.0))
    return scale, weights


def _steep(coefficients: Array, limit: float) -> tuple[Array, Array]:
    """Quadratic penalty where neighbours differ by more than `limit`: matrix and gradient."""
    difference = np.diff(coefficients)
    over = np.abs(difference) > limit
    d = np.diff(np.eye(len(coefficients)), axis=0)[over]
    excess = difference[over] - np.sign(difference[over]) * limit
    return d.T @ d, d.T @ excess


def _monotone(coefficients: Array, rising: float, least: float) -> tuple[Array, Array]:
    """Quadratic penalty where neighbours do not rise (rising +1) or fall (-1) by at least `least`: matrix and
    gradient."""
    difference = rising * np.diff(coefficients)
    under = difference < least
    d = rising * np.diff(np.eye(len(coefficients)), axis=0)[under]
    return d.T @ d, d.T @ (difference[under] - least)
