"""A least-squares fit of everything smooth at once: B(p), the curve that the tip follows with p, and the delay.

The tip's measured coordinates are y = h(s(p)), p the centre of the play of width B that the motor drives, s the curve
that is followed. s is either the image itself (two channels, h = identity: no pose, no camera, no hand-eye) or the
bending angle (one channel, h = the projection, or identity for an angle sensor). B and s are cubic B-splines; B is
tabulated at NODES positions, on which the simulated play and its derivatives are exact.

Shapes: n frames of a track; coordinates k of y (2 px or 1 deg); channels of s. Residuals are whitened, (n, k): seen
less predicted, over the stated noise. A mask (n,) says which frames count. Positions and B are in the unit of q.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from tautline.calibration.beforehand import Beforehand, Term, free_bending
from tautline.calibration.beside import FittedEffects
from tautline.calibration.observations import Mask, Track
from tautline.calibration.rounding import independence_weights
from tautline.calibration.simulated_track import PreparedTrack, Simulated
from tautline.elements import SINGLE, Hysteresis
from tautline.least_squares import descend, inverse_of, with_ridge
from tautline.model import STEEPEST, allowed_width
from tautline.nominal import Nominal, Normal, Rows
from tautline.splines import Basis

Array = npt.NDArray[np.float64]
# (s (n,), translation (n,), rotation (n,)) -> y (n, k) and dy/ds (n, k)
View = Callable[[Array, Array, Array], tuple[Array, Array]]

STRAY = 4.0  # tolerance: times the usual residual, from which a frame is an outlier
EXPLAINED = 1.5  # tolerance: residual over noise up to which a model explains its data
_STIFF = 1e4  # tolerance: cost, in sigma^2, of a neighbour difference that is off its limit by the whole limit
_GAIN = 0.2  # tolerance: sigma^2: an iteration that gains less is the last but one
_MOST_STEPS = 30  # tolerance: of a descent
_LITTLE, _MUCH_LEFT = 3e-4, 1.2  # tolerance: of the cost, as _GAIN, where the residual over noise is more than so much
_FARTHEST, _LATEST_S = 0.15, 0.03  # tolerance: of B in a step, of the range; of the delay
_RIDGE = 1e-9  # tolerance: of a step's mean diagonal, added to all of it
_WITHIN = 0.98  # tolerance: of STEEPEST, at which its penalty begins: a stiff one gives way a little
_LEAST_SMOOTHING, _BEGINS, _MOST_SMOOTHING = 1e-10, 1e-8, 1e8  # tolerance: of a penalty factor; the least at first
_AT_ONCE = 20.0  # tolerance: factor of a penalty factor in one step
# The median of one or of two coordinates' rms is the standard deviation over this (of chi square).
_USUAL = {1: 1.4826, 2: 1.2}  # equation: above
NODES = 1025  # tolerance: of the tables that fits and models use


@dataclass(frozen=True)
class Curves:
    """The unknowns of a fit. Coefficients belong to the fit's two spline bases."""

    backlash: Array  # (m_b,) of B
    follow: Array  # (m_f, channels) of the curve s that the tip follows
    delay_s: float
    effect_values: Array = field(default_factory=lambda: np.zeros(0))  # (m_e,) of the effects that the fit contains


@dataclass(frozen=True)
class Layout:
    """The indices of each kind of unknown in a fit's normal equations, in this order: the followed curve's coefficients
    channel by channel, B's, the effects' values, the delay, then `extra` further columns."""

    follow_size: int
    channels: int
    backlash_size: int
    effects_size: int
    extra: int = 0

    @property
    def follow(self) -> list[slice]:
        """The indices of the followed curve's coefficients, a slice for each channel."""
        size = self.follow_size
        return [slice(k * size, (k + 1) * size) for k in range(self.channels)]

    @property
    def backlash(self) -> slice:
        """The indices of B's coefficients."""
        first = self.channels * self.follow_size
        return slice(first, first + self.backlash_size)

    @property
    def effects(self) -> slice:
        """The indices of the effects' values."""
        return slice(self.backlash.stop, self.backlash.stop + self.effects_size)

    @property
    def delay(self) -> int:
        """The index of the delay."""
        return self.channels * self.follow_size + self.backlash_size + self.effects_size

    @property
    def total(self) -> int:
        """How many unknowns there are."""
        return self.delay + 1 + self.extra


@dataclass
class PlayFit:
    """The least-squares problem: tracks, bases, what is fitted and what is known beforehand. `solve` gives a Fitted."""

    tracks: Sequence[PreparedTrack]
    backlash: Basis  # of B
    follow: Basis  # of the curve that the tip follows
    view: View | None = None  # h; None: the channels of s are y itself
    fit_backlash: bool = True
    fit_delay: bool = True
    settled_only: bool = True  # frames before the tip was driven both ways do not count
    rising: float = 0.0  # +1, -1: s must rise or fall with p by `least_slope`; 0: free
    least_slope: float = 0.0
    slope_unit: float = 1.0  # a usual slope of s
    hysteresis: Hysteresis = SINGLE
    delay_sigma_s: float = 1.0  # how well the delay is known where it is not fitted
    beforehand: Beforehand | None = None  # what is known without these tracks
    effects: FittedEffects | None = None  # between the motor and the curve that is followed
    fit_effects: bool = True
    given_width: Array | None = None  # (nodes,) B in place of the spline's
    frames_per_independent: float = 1.0  # so many frames say as much of a curve's shape as one independent frame
    smoothing: dict[str, float] = field(default_factory=lambda: {"backlash": 1e-2, "follow": 1e-6})  # penalty factors
    grid: Array = field(init=False)  # (NODES,) on which B is tabulated
    simulated: list[Simulated] = field(init=False, default_factory=list)  # by the last call of `simulate`

    def __post_init__(self) -> None:
        """Sets the grid over the range of B's basis."""
        self.grid = np.linspace(self.backlash.low, self.backlash.high, NODES)

    def layout(self, curves: Curves, extra: int = 0) -> Layout:
        """The order of the unknowns in this fit's normal equations. extra: number of columns beside them."""
        channels, values = curves.follow.shape[1], len(curves.effect_values)
        return Layout(self.follow.size, channels, self.backlash.size, values, extra)

    @property
    def moves_tip(self) -> bool:
        """Whether anything is fitted that moves the tip's place: B, delay or effects."""
        return self.fit_backlash or self.fit_delay or (self.effects is not None and self.fit_effects)

    def width(self, curves: Curves) -> Array:
        """B (nodes,) on the fit's grid: `given_width` if there is one; else the spline, limited to what a table may
        have (B >= 0, |B'| <= STEEPEST)."""
        if self.given_width is not None:
            return self.given_width
        return allowed_width(self.grid, self.backlash.value(curves.backlash, self.grid))

    # ---- prediction

    def residuals(self, curves: Curves) -> tuple[list[Array], list[Mask]]:
        """Simulates every track (sets `simulated`). By track: whitened residuals (n, k), and which frames count
        (n,)."""
        self.simulate(curves)
        return self.residuals_of_simulated(curves)

    def simulate(self, curves: Curves) -> None:
        """Sets `simulated`: what the play does at each frame of every track with the curves' B, delay and effects."""
        width = self.width(curves)
        self.simulated = [
            prepared.simulate(self.grid, width, curves.delay_s, self.hysteresis, self.effects, curves.effect_values)
            for prepared in self.tracks
        ]

    def residuals_of_simulated(self, curves: Curves) -> tuple[list[Array], list[Mask]]:
        """As `residuals`, but with `simulated` as it is: B, delay and effects must be those that were simulated
        last."""
        residuals, masks = [], []
        for prepared, sim in zip(self.tracks, self.simulated, strict=True):
            y = self.predicted(prepared.track, curves, sim.tip)
            residuals.append((prepared.track.y - y) / prepared.track.sigma[:, None])
            counts = prepared.use & (sim.settled if self.settled_only else sim.known)
            masks.append(counts & np.isfinite(y @ np.ones(y.shape[1])))  # of a sum: a reduction of short rows is slow
        return residuals, masks

    def predicted(self, track: Track, curves: Curves, tip: Array) -> Array:
        """y (n, k), sensor's unit, at each frame of a track, if the tip is at positions `tip` (n,), unit of q, along
        the followed curve."""
        s = self.follow.value(curves.follow, tip)
        if self.view is None:
            return s
        translation, rotation = track.others_at(track.scene_s(curves.delay_s))
        return self.view(s[:, 0], translation, rotation)[0]

    def slope_in_view(self, track: Track, curves: Curves, tip: Array) -> Array:
        """dy/dp (n, k), sensor's unit per unit of q, at each frame of a track, if the tip is at positions `tip` (n,),
        unit of q."""
        return self.follow.slope(curves.follow, tip) * self._view_slope(track, curves, tip, slice(None))

    def _view_slope(self, track: Track, curves: Curves, tip: Array, keep: Mask | slice) -> Array:
        """dy/ds (kept, k), sensor's unit, at the frames that are kept, if the tip is at positions `tip` (kept,), unit
        of q; ones (1, channels) if s is y itself."""
        if self.view is None:
            return np.ones((1, curves.follow.shape[1]))
        translation, rotation = track.others_at(track.scene_s(curves.delay_s)[keep])
        return self.view(self.follow.value(curves.follow, tip)[:, 0], translation, rotation)[1]

    def slopes(self, prepared: PreparedTrack, sim: Simulated, keep: Mask, curves: Curves) -> tuple[Array, Array]:
        """Derivatives of the tip's place at the frames that are kept: (kept,) by B there; and (kept, m_e + 1) by the
        effects' values and, last, the delay. 0 for what is not fitted."""
        by_b, by_delay = sim.slopes(keep, self.backlash.slope(curves.backlash, sim.p[keep]))
        by_values = np.empty((len(by_b), 0))
        if self.effects is not None and (self.fit_effects or self.fit_delay or self.fit_backlash):
            at = prepared.track.scene_s(curves.delay_s)
            by_b, by_values, by_delay = (
                each[keep]
                for each in self.effects.slopes(
                    prepared.track.reading, at, self.grid, self.width(curves), self.hysteresis, curves.effect_values
                )
            )
        elif self.effects is not None:
            by_values = np.zeros((len(by_b), len(curves.effect_values)))
        shared = np.column_stack([by_values * self.fit_effects, by_delay * self.fit_delay])
        return by_b * self.fit_backlash, shared

    # ---- the fit

    def solve(self, start: Curves, iterations: int = _MOST_STEPS, adapt: bool = True) -> Fitted:
        """Fits by damped Gauss-Newton steps from `start`, with Huber's weights for outliers. adapt: `smoothing` moves
        to the restricted likelihood's maximum (Fellner-Schall steps), in this fit; else it stays."""
        return self.fitted(self.descended(start, iterations, adapt))

    def fitted(self, point: Point) -> Fitted:
        """The solved fit at this point, where its descent ended, with weights and covariance there."""
        curves, residuals, masks = point.curves, point.residuals, point.masks
        scale, weights = _huber_weights(residuals, masks)
        weights = self.weights_with_rounding(weights, curves, scale)
        matrix, _ = self.normal(curves, residuals, weights)
        penalty, _ = self.penalty(curves, scale)
        covariance = inverse_of(with_ridge(matrix + penalty)) * scale * scale
        return Fitted(self, curves, scale, residuals, masks, weights, covariance)

    def descended(self, start: Curves, iterations: int = _MOST_STEPS, adapt: bool = True) -> Point:
        """The point where `solve` ends, without weights and covariance. Sets `simulated` and, with adapt,
        `smoothing`."""
        # The descent sees no frame that cannot count; the smoothing that it adapts is this fit's own.
        counting = replace(self, tracks=[prepared.counting for prepared in self.tracks], smoothing=self.smoothing)
        point = descend(_Descent(counting, adapt), Point.of(counting, start), iterations)
        if any(seen is not all_of_it for seen, all_of_it in zip(counting.tracks, self.tracks, strict=True)):
            point = Point.of(self, point.curves)
        self.simulated = point.simulated
        return point

    def step(self, curves: Curves, residuals: list[Array], masks: list[Mask]) -> Curves:
        """The curves after one Gauss-Newton step with weight 1 for all counted frames. residuals, masks: of `residuals`
        with these curves, called just before."""
        matrix, gradient = self.normal(curves, residuals, [m.astype(float) for m in masks])
        system = matrix + self.penalty(curves, 1.0)[0]
        ridge = _RIDGE * np.eye(len(system)) * np.trace(system) / len(system)
        return self.moved(curves, np.asarray(np.linalg.solve(system + ridge, gradient)))

    def moved(self, curves: Curves, step: Array) -> Curves:
        """The curves after a step (m,) of the unknowns, within limits. B's coefficients move by _FARTHEST of the range
        at most and stay at 0 or above, the delay moves by _LATEST_S at most, and effects stay in their ranges; what is
        not fitted stays."""
        layout = self.layout(curves)
        backlash = curves.backlash
        if self.fit_backlash:
            limit = _FARTHEST * (self.backlash.high - self.backlash.low)
            backlash = np.maximum(backlash + np.clip(step[layout.backlash], -limit, limit), 0.0)
        delay = curves.delay_s + float(np.clip(step[-1], -_LATEST_S, _LATEST_S)) if self.fit_delay else curves.delay_s
        follow = curves.follow + step[: layout.backlash.start].reshape(layout.channels, self.follow.size).T
        values = curves.effect_values
        if self.effects is not None and self.fit_effects:
            values = self.effects.inside(values + step[layout.backlash.stop : -1])
        return replace(curves, backlash=backlash, follow=follow, delay_s=delay, effect_values=values)

    def weights_with_rounding(self, weights: Sequence[Array], curves: Curves, scale: float) -> list[Array]:
        """By track: the frames' weights (n,), reduced for a sensor that rounds, as the frames of one rest share an
        error (rounding.py). scale: rms residual over noise. To be called after `residuals` with the same curves."""
        return [
            weight
            * independence_weights(prepared.track, self.predicted(prepared.track, curves, sim.tip), prepared.use, scale)
            if prepared.track.step > 0.0
            else weight
            for weight, prepared, sim in zip(weights, self.tracks, self.simulated, strict=True)
        ]

    def normal(
        self, curves: Curves, residuals: list[Array], weights: list[Array], extra: Sequence[Array] | None = None
    ) -> tuple[Array, Array]:
        """J'WJ (m, m) and J'Wr (m,) of the whitened problem, without penalties; unknowns as in `layout`. weights (n,)
        by track; extra: further columns (n, e) by track, derivatives of the tip's place. To be called after `residuals`
        with the same curves."""
        layout = self.layout(curves, extra[0].shape[1] if extra else 0)
        matrix, gradient = np.zeros((layout.total, layout.total)), np.zeros(layout.total)
        # Channels share no unknowns of the followed curve, so each has its own sums: B, its own curve, then the rest.
        nominal, after = Nominal(self.backlash, self.follow), slice(layout.backlash.stop, layout.total)
        sums = [Normal.zeros(nominal.size + layout.total - after.start) for _ in layout.follow]
        for number, (prepared, sim, r, w) in enumerate(
            zip(self.tracks, self.simulated, residuals, weights, strict=True)
        ):
            keep = w > 0
            if not keep.any():
                continue
            p, tip, track = sim.p[keep], sim.tip[keep], prepared.track
            inverse = 1.0 / track.sigma[keep]
            slope = self.follow.slope(curves.follow, tip)
            by_s = self._view_slope(track, curves, tip, keep) * inverse[:, None]
            by_b, shared_by = self.slopes(prepared, sim, keep, curves)
            shared_by = np.column_stack([shared_by, extra[number][keep]]) if extra else shared_by
            for channel, total in enumerate(sums):
                of = slice(None) if self.view is not None else slice(channel, channel + 1)
                h, steep = np.ascontiguousarray(by_s[:, of]), slope[:, channel]
                columns = h[:, :, None] * (steep[:, None] * shared_by)[:, None, :]
                residual = np.ascontiguousarray(r[keep, of])
                weight = np.ascontiguousarray(np.broadcast_to(w[keep, None], h.shape))
                nominal.add(Rows(p, tip, steep * by_b, np.ones(len(p)), h, columns, residual), total, weight=weight)
        own = slice(self.backlash.size), slice(self.backlash.size, nominal.size), slice(nominal.size, None)
        for follow, part in zip(layout.follow, sums, strict=True):
            places = list(zip(own, (layout.backlash, follow, after), strict=True))
            for rows, at in places:
                gradient[at] += part.gradient[rows]
                for across, to in places:
                    matrix[at, to] += part.matrix[rows, across]
        return matrix, gradient

    # ---- smoothness, constraints and priors

    def penalty(self, curves: Curves, scale: float) -> tuple[Array, Array]:
        """Half the Hessian P (m, m) and half the gradient (m,) of what `cost` adds to the data's squares; the gradient
        is P theta for a penalty that is quadratic about 0. They are of smoothness, violated constraints and priors, the
        latter two in units of scale^2 (scale: rms residual over noise). In P alone is what holds a step and no value:
        the precision of the effects' values (`FittedEffects.precision`), and, for what is not fitted, a unit diagonal,
        of the delay its sigma."""
        layout = self.layout(curves)
        matrix, pull = np.zeros((layout.total, layout.total)), np.zeros(layout.total)
        known_path = self._path_prior(curves)
        bending, _ = self._bending(layout.channels)
        for k, block in enumerate(layout.follow):
            rough = self.smoothing["follow"] * bending
            matrix[block, block] += rough
            pull[block] += rough @ curves.follow[:, k]
            if known_path:
                known, pulled, _ = known_path[k]
                matrix[block, block] += scale * scale * known
                pull[block] += scale * scale * pulled
        if self.fit_backlash:
            block = layout.backlash
            own, own_pull = self._width_penalty(curves, scale)
            matrix[block, block] += own
            pull[block] += own_pull
        else:
            matrix[layout.backlash, layout.backlash] += np.eye(self.backlash.size)
        if self.rising:
            block = layout.follow[0]
            stiff, bend = _wrong_way_steps(curves.follow[:, 0], self.rising, self.least_slope * self.follow.step)
            weight = _STIFF * scale * scale / (self.slope_unit * self.follow.step) ** 2
            matrix[block, block] += weight * stiff
            pull[block] += weight * bend
        if not self.fit_delay:
            matrix[-1, -1] += (scale / self.delay_sigma_s) ** 2
        elif (prior := self._path_beforehand(layout.channels)) is not None:
            known, pulled, _ = prior.of_delay(curves.delay_s)
            matrix[-1:, -1:] += scale * scale * known
            pull[-1:] += scale * scale * pulled
        if self.effects is not None:
            at = np.r_[layout.effects]
            matrix[at, at] += scale * scale * self.effects.precision if self.fit_effects else 1.0
        return matrix, pull

    def _width_penalty(self, curves: Curves, scale: float) -> tuple[Array, Array]:
        """The part of `penalty` for B's coefficients, (m_b, m_b) and (m_b,): smoothness, |B'| <= STEEPEST as a stiff
        penalty, and what is known of B beforehand."""
        rough = self.smoothing["backlash"] * self.backlash.roughness
        stiff, bend = _steep_steps(curves.backlash, STEEPEST * _WITHIN * self.backlash.step)
        weight = _STIFF * scale * scale / self.backlash.step**2
        matrix, pull = rough + weight * stiff, rough @ curves.backlash + weight * bend
        if self.beforehand is not None:
            known, pulled, _ = self.beforehand.of_width(self.backlash, curves.backlash)
            matrix += scale * scale * known
            pull += scale * scale * pulled
        return matrix, pull

    def _path_beforehand(self, channels: int) -> Beforehand | None:
        """What is known beforehand of path and delay, if the followed curve is in the sensor's own coordinates and has
        as many channels as the known path; else None."""
        known = self.beforehand
        return known if known is not None and self.view is None and len(known.path) == channels else None

    def _path_prior(self, curves: Curves) -> list[Term]:
        """The prior's Term of each channel of the followed curve; an empty list if nothing is known of it."""
        known = self._path_beforehand(curves.follow.shape[1])
        return [] if known is None else known.of_path(self.follow, curves.follow)

    def _bending(self, channels: int) -> tuple[Array, int]:
        """Smoothness penalty (m_f, m_f) on each channel of the followed curve, and its rank. If the curve is known
        beforehand at some places, only the bending between these is penalised."""
        known = self._path_beforehand(channels)
        if known is None:
            return self.follow.bending, self.follow.bending_rank
        return free_bending(self.follow, tuple(known.path[0].q.tolist()))

    def hold_at_limits(self, curves: Curves, matrix: Array, gradient: Array) -> None:
        """Changes the normal equations, matrix (m, m) and gradient (m,) along which the cost falls, in place so that
        those effects' values do not move that are at an end of their range which the gradient would take them beyond:
        sets their rows, columns and gradient to 0. What `penalty` adds to the diagonal keeps the system regular."""
        assert self.effects is not None
        at = self.layout(curves).effects
        ends = at.start + self.effects.at_ends(curves.effect_values, gradient[at])
        matrix[ends, :] = matrix[:, ends] = gradient[ends] = 0.0

    def begin_smoothing(self, curves: Curves, scale: float) -> None:
        """Sets each smoothing factor to scale^2 rank / (c' P c), the one at which a curve with coefficients c is as
        rough as its prior has it. P is its penalty's matrix, rank that of P. scale: rms residual over noise."""
        bending, rank = self._bending(curves.follow.shape[1])
        rough = sum(float(c @ bending @ c) for c in curves.follow.T)
        rank *= curves.follow.shape[1]
        self.smoothing["follow"] = float(np.clip(scale * scale * rank / max(rough, 1e-12), _BEGINS, _MOST_SMOOTHING))
        rough = float(curves.backlash @ self.backlash.roughness @ curves.backlash)
        rank = self.backlash.roughness_rank
        self.smoothing["backlash"] = float(np.clip(scale * scale * rank / max(rough, 1e-12), _BEGINS, _MOST_SMOOTHING))

    def adapt_smoothing(self, curves: Curves, system: Array, scale: float) -> None:
        """One Fellner-Schall step of each smoothing factor lambda towards the restricted likelihood's maximum, by at
        most a factor of _AT_ONCE: lambda <- frames_per_independent scale^2 (rank - lambda tr(C P)) / (c' P c). C is the
        inverse of `system` (m, m), the normal matrix with all penalties; P, rank and c are as in `begin_smoothing`.
        scale: rms residual over noise."""
        layout = self.layout(curves)
        inverse = inverse_of(with_ridge(system))
        bending, rank = self._bending(layout.channels)
        parts: list[tuple[str, list[slice], Array, int, list[Array]]] = [
            ("follow", layout.follow, bending, rank, list(curves.follow.T))
        ]
        if self.fit_backlash:
            roughness, rank_b = self.backlash.roughness, self.backlash.roughness_rank
            parts.append(("backlash", [layout.backlash], roughness, rank_b, [curves.backlash]))
        for name, blocks, form, rank_each, coefficients in parts:
            now = self.smoothing[name]
            rank = rank_each * len(blocks)
            spent = now * sum(float(np.sum(inverse[b, b] * form)) for b in blocks)
            rough = sum(float(c @ form @ c) for c in coefficients)
            ratio = self.frames_per_independent * scale * scale * max(rank - spent, 1e-3) / max(now * rough, 1e-12)
            self.smoothing[name] = float(
                np.clip(now * np.clip(ratio, 1.0 / _AT_ONCE, _AT_ONCE), _LEAST_SMOOTHING, _MOST_SMOOTHING)
            )

    def cost(self, curves: Curves, residuals: list[Array], weights: list[Array], scale: float) -> float:
        """Weighted squares of the residuals (over noise), plus the penalties of smoothness, constraints and priors, the
        latter two in units of scale^2. The squares are scaled up to as many frames as may count, so that frames that
        drop out of the simulation are no gain. Infinite if no frame counts."""
        used = sum(float(np.sum(w > 0)) for w in weights)
        if used == 0:
            return np.inf
        data = sum(
            float(np.sum(w[:, None] * np.where(w[:, None] > 0, r, 0.0) ** 2))
            for r, w in zip(residuals, weights, strict=True)
        )
        total = sum(np.count_nonzero(prepared.use) for prepared in self.tracks)
        data *= total / used
        bending, _ = self._bending(curves.follow.shape[1])
        smooth = sum(self.smoothing["follow"] * float(c @ bending @ c) for c in curves.follow.T)
        smooth += scale * scale * sum(surprise for _, _, surprise in self._path_prior(curves))
        if self.fit_delay and (prior := self._path_beforehand(curves.follow.shape[1])) is not None:
            smooth += scale * scale * prior.of_delay(curves.delay_s)[2]
        if self.fit_backlash:
            smooth += self.smoothing["backlash"] * float(curves.backlash @ self.backlash.roughness @ curves.backlash)
            excess = np.maximum(np.abs(np.diff(curves.backlash)) - STEEPEST * _WITHIN * self.backlash.step, 0.0)
            smooth += _STIFF * scale * scale / self.backlash.step**2 * float(excess @ excess)
            if self.beforehand is not None:
                smooth += scale * scale * self.beforehand.of_width(self.backlash, curves.backlash)[2]
        if self.rising:
            over = np.maximum(self.least_slope * self.follow.step - self.rising * np.diff(curves.follow[:, 0]), 0.0)
            smooth += _STIFF * scale * scale / (self.slope_unit * self.follow.step) ** 2 * float(over @ over)
        return data + smooth


@dataclass(frozen=True)
class Point:
    """Curves with what they predict: each point of a descent is simulated once."""

    curves: Curves
    residuals: list[Array]
    masks: list[Mask]
    simulated: list[Simulated]

    @property
    def scale(self) -> float:
        """rms residual over the stated noise, with outliers cut."""
        return _huber_weights(self.residuals, self.masks)[0]

    @classmethod
    def of(cls, fit: PlayFit, curves: Curves) -> Point:
        """The point at these curves."""
        residuals, masks = fit.residuals(curves)
        return cls(curves, residuals, masks, fit.simulated)

    def moved(self, fit: PlayFit, step: Array) -> Point:
        """The point after a step (m,) of the fit's unknowns, simulated anew only if the step moves the tip's place."""
        curves = fit.moved(self.curves, step)
        if fit.moves_tip:
            return Point.of(fit, curves)
        fit.simulated = self.simulated
        return Point(curves, *fit.residuals_of_simulated(curves), self.simulated)


class _Descent:
    """A PlayFit as a `least_squares.Problem`: weights by Huber, smoothing that adapts from the second step on."""

    def __init__(self, fit: PlayFit, adapt: bool) -> None:
        """adapt: as of `PlayFit.solve`."""
        self.fit, self.adapt = fit, adapt
        self.scale, self.weights = 1.0, list[Array]()
        self.steps = self.small_steps = 0

    def linearised(self, point: Point) -> tuple[Array, Array, float]:
        """Normal matrix, gradient that lowers the cost, and cost at a point. Sets scale and weights anew; starts the
        smoothing at the first call and adapts it at later ones, if it adapts."""
        fit, curves = self.fit, point.curves
        fit.simulated = point.simulated
        self.scale, weights = _huber_weights(point.residuals, point.masks)
        self.weights = fit.weights_with_rounding(weights, curves, self.scale)
        if self.adapt and self.steps == 0:
            fit.begin_smoothing(curves, self.scale)
        matrix, gradient = fit.normal(curves, point.residuals, self.weights)
        penalty, pull = fit.penalty(curves, self.scale)
        if self.adapt and self.steps > 0:
            fit.adapt_smoothing(curves, matrix + penalty, self.scale)
            penalty, pull = fit.penalty(curves, self.scale)
        self.steps += 1
        if fit.effects is not None:
            fit.hold_at_limits(curves, matrix, gradient)
        return matrix + penalty, gradient - pull, fit.cost(curves, point.residuals, self.weights, self.scale)

    def moved(self, point: Point, step: Array) -> Point:
        """The point after a step (m,)."""
        return point.moved(self.fit, step)

    def cost(self, point: Point) -> float:
        """The cost at a point, with the weights and the smoothing of the last linearisation, so that costs compare. A
        frame that did not count then and does now weighs 1."""
        kept = _ones_where_uncounted(self.weights, point.masks)
        weights = [np.where(m, w, 0.0) for m, w in zip(point.masks, kept, strict=True)]
        return self.fit.cost(point.curves, point.residuals, weights, self.scale)

    def enough(self, gained: float, cost: float) -> bool:
        """Whether this and the previous step gained too little, so that the descent ends: less than _GAIN, or, while
        residuals are clearly more than noise (_MUCH_LEFT), less than _LITTLE of the cost."""
        least = max(_GAIN * self.scale * self.scale, _LITTLE * cost * (self.scale > _MUCH_LEFT))
        self.small_steps = self.small_steps + 1 if gained < least else 0
        return self.small_steps >= 2


@dataclass(frozen=True)
class Fitted:
    """A solved PlayFit. Lists are by track."""

    fit: PlayFit
    curves: Curves
    scale: float  # rms residual over the stated noise, outliers apart: 1 where the model explains everything
    residuals: list[Array]  # (n, k) whitened
    masks: list[Mask]  # (n,) frames that count
    weights: list[Array]  # (n,) of the frames
    covariance: Array  # (m, m), unknowns as in PlayFit.layout
    spread: Array | None = None  # (nodes,) standard deviation of B where model error is known too, else None
    delay_spread: float = 0.0  # of the delay then, s
    width_by_delay: Array | None = None  # (nodes,) dB/d(delay), unit of q per s, along the posterior's correlation

    @property
    def frames(self) -> int:
        """How many frames count, of all tracks."""
        return int(sum(m.sum() for m in self.masks))

    @property
    def effects_and_values(self) -> tuple[FittedEffects, Array]:
        """The effects that were fitted, and their values (m_e,)."""
        assert self.fit.effects is not None
        return self.fit.effects, self.curves.effect_values

    @property
    def explained(self) -> bool:
        """Whether little more than noise is left: the model explains the data."""
        return self.scale < EXPLAINED

    def width_sigma(self, p: Array) -> Array:
        """Standard deviation (k,) of B at positions p (k,), unit of q: `spread` if model error is known, else by the
        residuals' noise alone."""
        if self.spread is not None:
            return np.asarray(np.interp(p, self.fit.grid, self.spread))
        design = self.fit.backlash.design(p).toarray()
        block = self.fit.layout(self.curves).backlash
        covariance = self.covariance[block, block]
        return np.asarray(np.sqrt(np.maximum(np.sum((design @ covariance) * design, axis=1), 0.0)))

    def path(self) -> tuple[Array, Array]:
        """The followed curve (nodes, channels) in the unit of s, and its standard deviation (nodes, channels) by the
        residuals' noise."""
        design = self.fit.follow.design(self.fit.grid).toarray()
        blocks = self.fit.layout(self.curves).follow
        variance = [np.sum((design @ self.covariance[block, block]) * design, axis=1) for block in blocks]
        return design @ self.curves.follow, np.sqrt(np.maximum(np.column_stack(variance), 0.0))

    @property
    def delay_sigma(self) -> float:
        """Standard deviation of the delay, s: `delay_spread` if model error is known; else by the residuals' noise
        alone, 0 if the delay was not fitted."""
        if self.spread is not None:
            return self.delay_spread
        return float(np.sqrt(self.covariance[-1, -1])) if self.fit.fit_delay else 0.0


def rms_of_frame_powers(power: Array, scale: float) -> float:
    """rms residual over noise of frames with mean squares `power` (frames,) of their residuals over noise, each cut at
    (STRAY scale)^2; infinite without frames. scale: the usual residual over noise."""
    return float(np.sqrt(np.mean(np.minimum(power, (STRAY * scale) ** 2)))) if len(power) else np.inf


def _ones_where_uncounted(weights: list[Array], masks: list[Mask]) -> list[Array]:
    """The weights (n,) by track, with 1 for frames that the mask leaves out."""
    return [np.where(m, w, 1.0) for w, m in zip(weights, masks, strict=True)]


def _huber_weights(residuals: list[Array], masks: list[Mask]) -> tuple[float, list[Array]]:
    """The scale of the residuals (n, k) over noise, by track, at frames of the masks (n,): their rms, with frames cut
    at STRAY times the usual one (by the median); 1 without frames. And each frame's Huber weight, min(1, STRAY scale /
    its rms), 0 where it does not count."""
    each = [np.sqrt(np.einsum("nk,nk->n", r, r) / r.shape[1]) for r in residuals]
    norm = np.concatenate([size[m] for size, m in zip(each, masks, strict=True)])
    if len(norm) == 0:
        return 1.0, [m.astype(float) for m in masks]
    # A first scale by the median, which outliers do not move.
    middle = float(np.sqrt(np.median(norm**2))) * _USUAL[residuals[0].shape[1]]
    limit = STRAY * max(middle, 1e-9)
    scale = max(float(np.sqrt(np.mean(np.minimum(norm, limit) ** 2))), 1e-6)
    limit = STRAY * scale
    pairs = zip(each, masks, strict=True)
    weights = [np.where(m, np.minimum(1.0, limit / np.maximum(size, 1e-12)), 0.0) for size, m in pairs]
    return scale, weights


def _steep_steps(coefficients: Array, limit: float) -> tuple[Array, Array]:
    """Matrix (m, m) and gradient (m,) of half the sum of squared excesses, by which neighbouring coefficients (m,)
    differ by more than `limit`."""
    difference = np.diff(coefficients)
    over = np.abs(difference) > limit
    d = np.diff(np.eye(len(coefficients)), axis=0)[over]
    excess = difference[over] - np.sign(difference[over]) * limit
    return d.T @ d, d.T @ excess


def _wrong_way_steps(coefficients: Array, rising: float, least: float) -> tuple[Array, Array]:
    """Matrix (m, m) and gradient (m,) of half the sum of squared shortfalls, by which steps between neighbouring
    coefficients (m,) are less than `least` in the direction `rising` (+1 up, -1 down)."""
    difference = rising * np.diff(coefficients)
    under = difference < least
    d = rising * np.diff(np.eye(len(coefficients)), axis=0)[under]
    return d.T @ d, d.T @ (difference[under] - least)
