"""Variance components of a calibration: effects that a play with one delay does not contain, found in the residuals of
the joint fit of B, path and delay, and estimated together with it.

The whitened residuals are a linear mixed model, r = J d(theta) + sum_k Z_k u_k + e, u_k ~ N(0, s_k^2 P_k^-1): theta are
the coefficients of path, B and delay (the nominal unknowns), each Z_k the columns of one departure (departures.py), one
way in which a real instrument, clock or camera differs from the model. A departure becomes a component where the
restricted likelihood (REML) gains enough by it. Its variance maximises that likelihood (Fellner-Schall steps), and its
values are solved together with B, so that they add to B's covariance (Henderson's mixed-model equations).

Variances are handled as penalties lambda_k = sigma^2 / s_k^2 on u_k' P_k u_k, sigma^2 the residual variance in units of
the stated noise. grid: the joint fit's positions, (grid,); B in the unit of q.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.linalg import eigh

from tautline.calibration.departures import (
    SHARE,
    SPEED,
    STATES,
    CountedFrames,
    Departure,
    SearchedParameters,
    Sparse,
    contrasts,
    counted_frames,
    departures,
    on_clock,
    scaled_rows,
    slow_basis,
    tracker_error_length,
)
from tautline.calibration.observations import Track
from tautline.calibration.playfit import Curves, Fitted, PlayFit
from tautline.encoder import count_of
from tautline.independence import frames_each
from tautline.least_squares import inverse_of
from tautline.nominal import Normal
from tautline.rig import Rig

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

REML_GAIN = 20.0  # prior: of twice the restricted log likelihood, for a component; noise alone gives 5 to 8
_LINEARISATIONS = 14  # tolerance: at most
_JOIN_AT_ONCE = 2  # tolerance: components that may join at one linearisation
_VARIANCE_STEPS = 6  # tolerance: Fellner-Schall steps at one linearisation
_PENALTIES = np.logspace(-6, 3, 19)  # tolerance: tried for a new component, in units of its own information
_MOST, _LEAST = 1e12, 1e-12  # tolerance: of a penalty
_STEP_SHARES = (1.0, 0.5, 0.2)  # tolerance: of a step, tried in turn
WORSE = 1.02  # tolerance: ratio of what is left after and before, from which a step leads too far
_STILL = 0.05  # tolerance: a change of B, in its sigma, that is none
_COUNT_SIGMA = 0.29  # equation: of an encoder's step: the standard deviation of a place within it
_SHOWS = 0.3  # tolerance: of the noise: an encoder's count that moves the image by more shows
_FEW = 30  # tolerance: frames that are too few to tell a scatter
LAW = 0.5  # prior: of what speed adds to B: its uncertainty, as slower than what was seen it may follow another law
CORRECTS = 0.3  # prior: of a component's correction of B: its standard deviation
_SHORT_LAG = 0.1  # tolerance: of a frame's period: a shorter lag is not told from a delay
_LAGS = 60  # tolerance: frames of autocorrelation
_LATE = 0.25  # equation: of the session, which goes from -1/2 to 1/2: its last quarter


@dataclass(frozen=True)
class Component:
    """One departure as it was estimated. "Held at zero": as if the component were not in the model."""

    name: str
    rms: float  # rms over the stated noise by which residuals would grow if it were held at zero
    chi2: float  # the same as a sum of squares over the noise's variance (Wald statistic)
    width_shift: Array  # (grid,) by how much B would change if it were held at zero
    delay_shift_s: float  # by how much the delay would change then
    values: Array  # (m,) of its columns


@dataclass(frozen=True)
class DifferenceFromEnd:
    """How the counted frames of one track differ from what they would show with the state at the session's end."""

    frames: Indices  # (n,) of the track
    over_noise: Array  # (n, channels) seen less what would be seen at the end, over the stated noise
    late: npt.NDArray[np.bool_]  # (n,) frames of the last quarter of the session


@dataclass(frozen=True)
class Components:
    """The joint fit with all components, B being that of the session's end."""

    curves: Curves  # B as it is when the session ends
    session_mean: Curves  # B as it is in the mean of the session
    width: Array  # (grid,) B of `curves`
    sigma: Array  # (grid,) standard deviation of B, model error included
    delay_sigma: float
    width_by_delay: Array  # (grid,) dB/d(delay), unit of q per s, along the posterior's correlation
    tracker_lag_s: float  # by how much a tracker may show a moving tip late
    unexplained: float  # rms over the stated noise of the residuals that no component explains
    moving_ratio: float  # rms of these while the tip moves over that while it rests
    frames_per_independent: float  # of these: how many neighbours tell as much as one independent frame
    parts: tuple[Component, ...]  # strongest first
    clock_error: Array  # (2,) s by which the sensor's clock departs, linear and quadratic over the session
    count_visible: bool  # an encoder's count shows in the image
    from_end: tuple[DifferenceFromEnd, ...] = ()  # by track; empty where nothing changed during the session

    @property
    def late_change(self) -> float:
        """rms over the noise of what still differed from the end's state in the last quarter of the session."""
        late = [each.over_noise[each.late] for each in self.from_end if each.late.any()]
        return float(np.sqrt(np.mean(np.concatenate(late) ** 2))) if late else 0.0

    def at_the_end(self, tracks: Sequence[Track]) -> list[Track]:
        """The counted frames of the fit's tracks as if all had been seen with the state of the session's end."""
        if not self.from_end:
            return list(tracks)
        kept = [track.only(change.frames) for track, change in zip(tracks, self.from_end, strict=True)]
        return [
            replace(track, y=track.y - change.over_noise * track.sigma[:, None])
            for track, change in zip(kept, self.from_end, strict=True)
        ]

    @property
    def tracker_errs(self) -> bool:
        """Whether the error of a marker's tracker is one of the components."""
        return any(part.name == "tracker" for part in self.parts)

    @property
    def mainly_start_of_strokes(self) -> bool:
        """Whether the strongest component is how the tip starts after a reversal (gradual or asymmetric)."""
        return bool(self.parts) and self.parts[0].name.startswith("phase")

    def applied(self, fitted: Fitted) -> Fitted:
        """The joint fit with B, path and delay, sigmas and clock as the components leave them; scale is
        `unexplained`."""
        fit = replace(fitted.fit, tracks=on_clock(fitted.fit.tracks, self.clock_error), smoothing=fitted.fit.smoothing)
        residuals, masks = fit.residuals(self.curves)
        return replace(
            fitted, fit=fit, curves=self.curves, residuals=residuals, masks=masks, scale=self.unexplained,
            spread=self.sigma, delay_spread=self.delay_sigma, width_by_delay=self.width_by_delay,
        )  # fmt: skip


def separate(fitted: Fitted, rig: Rig, without: frozenset[str] = frozenset()) -> Components:
    """Re-estimates B, path and delay of a joint fit together with the components that its residuals show. without:
    names of departures that the fit's own model contains, which are not tried."""
    return _Selection(fitted, rig, without).run()


@dataclass
class _Selection:
    """The forward selection of components, and what carries over from one linearisation to the next."""

    fitted: Fitted
    rig: Rig
    without: frozenset[str] = frozenset()
    active: list[str] = field(default_factory=list)  # names of the components
    penalties: dict[str, float] = field(default_factory=dict)  # of active departures, by name
    refused: set[str] = field(default_factory=set)  # departures whose value would be negative and must not
    count_visible: bool = False  # an encoder's count shows in the image
    moving_noise: float = 1.0  # scatter of frames at which the tip moves, over that of the others

    def run(self) -> Components:
        """Alternates: components join and are estimated at one linearisation, path, B and delay move by the solution
        (Gauss-Newton), until no component joins and B stays where it is."""
        self._begin_with_turns()
        counted = counted_frames(self.fitted, self.fitted.curves, self.rig, np.zeros(2))
        assert counted is not None  # it was fitted to frames
        searched = SearchedParameters(tracker_length_px=tracker_error_length(counted))
        if counted.residuals.shape[1] == 1:
            # An angle sensor has no image that may have moved instead: a slip is looked for before components that
            # differ by stroke stand in for it.
            searched = searched.updated(counted, counted.residuals, set())
        model = self._model(self.fitted.curves, counted, np.zeros(2), searched)
        for _ in range(_LINEARISATIONS):
            joined = model.join()
            self.moving_noise = model.moving_noise()
            searched = model.searched_again()
            if not joined and not model.moves_width:
                break
            ahead = self._ahead(model, searched)
            if ahead is None:
                break
            model = ahead
        return model.result()

    def _begin_with_turns(self) -> None:
        """Makes `turn` a component at once where the standard deviation within an encoder's count moves the image by
        more than _SHOWS of its noise: then the motor's turns are known no better, whatever else departs."""
        fit, resolution = self.fitted.fit, self.rig.actuator.encoder_resolution
        count = _COUNT_SIGMA * max(count_of(prepared.track.reading, resolution) for prepared in fit.tracks)
        steep = np.linalg.norm(fit.follow.slope(self.fitted.curves.follow, fit.grid).reshape(len(fit.grid), -1), axis=1)
        sigma = float(np.median(np.concatenate([prepared.track.sigma for prepared in fit.tracks])))
        if count * float(np.median(steep)) > _SHOWS * sigma:
            self.count_visible = True
            self.active.append("turn")
            self.penalties["turn"] = (self.fitted.scale / count) ** 2

    def _model(
        self, curves: Curves, counted: CountedFrames, clock_error: Array, searched: SearchedParameters
    ) -> _MixedModel:
        """The mixed model linearised at these curves, solved with the active components. counted: the frames at these
        curves and this clock error (2,), s."""
        candidates = [part for part in departures(counted, searched) if part.name not in self.without]
        model = _MixedModel(self, curves, counted, candidates, clock_error, searched)
        model.solve_with_variances()
        return model

    def _ahead(self, model: _MixedModel, searched: SearchedParameters) -> _MixedModel | None:
        """The model linearised anew where its solution leads, or at a share of that step; None where the residuals grow
        by more than the factor WORSE all the same."""
        penalties = dict(self.penalties)
        for share in _STEP_SHARES:
            curves = interpolated(model.curves, model.solution, share)
            clock_error = model.clock_error + share * model.clock_step
            counted = counted_frames(self.fitted, curves, self.rig, clock_error)
            there = None if counted is None else self._model(curves, counted, clock_error, searched)
            if there is not None and there.noise < WORSE * model.noise:
                return there
            self.penalties = dict(penalties)
        return None


def interpolated(start: Curves, end: Curves, share: float) -> Curves:
    """The curves at this share, 0 to 1, of the way from `start` to `end`; without effects."""
    return Curves(
        start.backlash + share * (end.backlash - start.backlash),
        start.follow + share * (end.follow - start.follow),
        start.delay_s + share * (end.delay_s - start.delay_s),
    )


def nominal_columns(fit: PlayFit, counted: CountedFrames) -> Sparse:
    """(channels * n, unknowns), sparse: derivatives of the whitened image by the coefficients of the path (channel by
    channel), those of B, and the delay."""
    path = scaled_rows(counted.inverse, fit.follow.design(counted.p))
    by_width = scaled_rows(counted.by_width, fit.backlash.design(counted.p))
    shared = sparse.csr_matrix(sparse.hstack([by_width, sparse.csr_matrix(counted.by_delay[:, None])]))
    return sparse.csr_matrix(sparse.hstack([counted.per_channel(path), counted.along_path(shared)]))


def normal_with_columns(fit: PlayFit, counted: CountedFrames, columns: Array) -> tuple[Array, Array, int]:
    """Weighted normal matrix (m, m) and gradient (m,) of the nominal unknowns followed by further ones, which move the
    tip's place by columns (n, k); and the number of nominal unknowns. No penalties."""
    nominal = nominal_columns(fit, counted)
    design = sparse.csr_matrix(sparse.hstack([nominal, counted.along_path(columns)]))
    weight = np.tile(counted.weight, counted.residuals.shape[1])
    normal = Normal.of_sparse(design, weight, counted.residuals.T.ravel())
    return normal.matrix, normal.gradient, int(nominal.shape[1])


class _MixedModel:
    """The mixed model at one linearisation. Unknowns: those of the nominal model (path channel by channel, B, delay),
    `nominal` of them, then the values of every candidate. Only those of active components are solved for: `solved`
    has their indices, and `values`, `inverse` are in its order."""

    def __init__(
        self, selection: _Selection, curves: Curves, counted: CountedFrames, candidates: list[Departure],
        clock_error: Array, searched: SearchedParameters,
    ) -> None:  # fmt: skip
        """Sums the weighted normal equations of all candidates; solves nothing yet. clock_error (2,): s, as in
        `counted_frames`; searched: with which the candidates were made."""
        self.selection, self.curves, self.counted = selection, curves, counted
        self.clock_error, self.searched = clock_error, searched
        self.fit = fit = selection.fitted.fit
        nominal = nominal_columns(fit, counted)
        self.design = sparse.hstack([nominal, *(part.columns for part in candidates)], format="csr")
        moving_weight = np.where(counted.moving, selection.moving_noise**-2, 1.0)
        self.weight = np.tile(counted.weight * moving_weight, counted.residuals.shape[1])
        self.target = counted.residuals.T.ravel()
        normal = Normal.of_sparse(self.design, self.weight, self.target)
        self.gram, self.right = normal.matrix, normal.gradient
        self.target_squares = float(self.weight @ self.target**2)
        self.nominal = int(nominal.shape[1])
        ends = np.cumsum([self.nominal, *(part.size for part in candidates)])
        self.candidates = {part.name: part for part in candidates}
        self.places = {part.name: np.arange(a, b) for part, a, b in zip(candidates, ends[:-1], ends[1:], strict=True)}
        self.noise = selection.fitted.scale  # rms over the stated noise of what the model leaves
        self.nominal_penalty, self.nominal_pull = fit.penalty(curves, max(self.noise, 1e-6))

    # ---- estimation with the active components

    def solve_with_variances(self) -> None:
        """Solves with the active components while their penalties move to the restricted likelihood's maximum, in at
        most _VARIANCE_STEPS steps."""
        self.selection.active = [name for name in self.selection.active if name in self.candidates]
        self._solve()
        for _ in range(_VARIANCE_STEPS if self.selection.active else 0):
            if not self._adapt_penalties():
                break
            self._solve()

    def _solve(self) -> None:
        """Henderson's equations at the present penalties: sets `values`, the system's `inverse` (the covariance in
        units of the noise's variance) and `noise`^2 = residual squares over residual degrees of freedom."""
        self.solved = np.concatenate(
            [np.arange(self.nominal), *(self.places[name] for name in self.selection.active)]
        )  # fmt: skip
        gram, right = self.gram[np.ix_(self.solved, self.solved)], self.right[self.solved]
        system = gram.copy()
        system[: self.nominal, : self.nominal] += self.nominal_penalty
        for name, at in self._active_blocks():
            system[np.ix_(at, at)] += self.selection.penalties[name] * self.candidates[name].penalty
        diagonal = np.diag_indices_from(system)
        system[diagonal] += 1e-10 * system[diagonal] + 1e-12 * float(np.mean(system[diagonal]))
        pull = np.zeros(len(self.solved))
        pull[: self.nominal] = self.nominal_pull
        self.inverse = inverse_of(system)
        self.values = self.inverse @ (right - pull)
        squares = self.target_squares - 2 * float(self.values @ right) + float(self.values @ gram @ self.values)
        freedom = float(self.weight.sum()) - float(np.vdot(self.inverse, gram))
        self.noise = float(np.sqrt(max(squares, 1e-12) / max(freedom, 1.0)))

    def _active_blocks(self) -> list[tuple[str, Indices]]:
        """Each active component's name and the places of its values in `values`."""
        blocks, at = [], self.nominal
        for name in self.selection.active:
            size = self.candidates[name].size
            blocks.append((name, np.arange(at, at + size)))
            at += size
        return blocks

    def _value(self, name: str) -> float | None:
        """The first value of an active component; None of one that is not active."""
        at = dict(self._active_blocks()).get(name)
        return None if at is None else float(self.values[at][0])

    def _adapt_penalties(self) -> bool:
        """One Fellner-Schall step of every active penalty, lambda <- lambda (noise^2 edf / (lambda u' P u))^1.5, edf =
        m - lambda tr(C P) the component's effective degrees of freedom, C its block of the inverse. The exponent 1.5
        converges faster. Whether any penalty changed by more than a tenth."""
        changed = False
        for name, at in self._active_blocks():
            now, penalty = self.selection.penalties[name], self.candidates[name].penalty
            freedom = len(at) - now * float(np.sum(self.inverse[np.ix_(at, at)] * penalty))
            size = float(self.values[at] @ penalty @ self.values[at])
            ratio = self.noise**2 * max(freedom, 1e-4) / max(now * size, 1e-30)
            then = float(np.clip(now * np.clip(ratio**1.5, 0.01, 100.0), _LEAST, _MOST))
            changed |= abs(np.log(then / now)) > 0.1
            self.selection.penalties[name] = then
        return changed

    # ---- selection of further components

    def join(self) -> bool:
        """Makes up to _JOIN_AT_ONCE candidates components, each the one with the largest REML gain less its price, if
        that is at least REML_GAIN per independent frame. One whose value comes out negative and must not is refused for
        good. Whether any was tried."""
        joined = False
        for _ in range(_JOIN_AT_ONCE):
            closed = set(self.selection.active) | self.selection.refused
            open_parts = [p for p in self.candidates.values() if p.name not in closed and not p.not_beside & closed]
            gains = {part.name: self._reml_gain(part) for part in open_parts}
            if not gains:
                break
            name = max(gains, key=lambda each: gains[each][0] - self.candidates[each].price)
            if gains[name][0] < (REML_GAIN + self.candidates[name].price) * self._frames_per_independent():
                break
            self.selection.active.append(name)
            self.selection.penalties[name] = gains[name][1]
            self.solve_with_variances()
            value = self._value(name)
            if self.candidates[name].one_way and value is not None and value < 0:
                self.selection.active.remove(name)
                self.selection.refused.add(name)
                self.solve_with_variances()
            joined = True
        return joined

    def _reml_gain(self, part: Departure) -> tuple[float, float]:
        """By how much twice the restricted log likelihood grows with this candidate, and its penalty lambda there, the
        best of _PENALTIES: sum_i f_i^2 / (noise^2 (d_i + lambda)) - log(1 + d_i / lambda), d_i the eigenvalues of its
        information given the other unknowns relative to P, f_i its gradient along them. (0, 1) where no frame tells of
        it."""
        at = self.places[part.name]
        across = self.gram[np.ix_(self.solved, at)]
        information = self.gram[np.ix_(at, at)] - across.T @ self.inverse @ across
        gradient = self.right[at] - across.T @ self.values
        roots, vectors = eigh(information, part.penalty, check_finite=False)
        roots = np.maximum(roots, 0.0)
        squares = (vectors.T @ gradient) ** 2 / max(self.noise**2, 1e-30)
        if not roots.max() > 0:
            return 0.0, 1.0
        penalties = _PENALTIES * float(roots.max())
        gains = [float(np.sum(squares / (roots + each) - np.log1p(roots / each))) for each in penalties]
        best = int(np.argmax(gains))
        return gains[best], float(penalties[best])

    def searched_again(self) -> SearchedParameters:
        """The moments of a shift and a slip and the frequency of a breath that fit the residuals that are left; those
        of active components stay."""
        return self.searched.updated(self.counted, self._left(), set(self.selection.active))

    # ---- residuals

    def _left(self) -> Array:
        """(n, channels) whitened residuals that the solution leaves."""
        left = self.target - self.design[:, self.solved] @ self.values
        return np.asarray(left.reshape(self.counted.residuals.shape[1], -1).T)

    def moving_noise(self) -> float:
        """Scatter between neighbouring frames while the tip moves, over that while it rests, 1 to 30 (root of the ratio
        of median squared steps); 1 where fewer than _FEW frames do either."""
        step = np.mean(np.diff(self._left(), axis=0) ** 2, axis=1)
        moves = self.counted.moving[1:] & self.counted.moving[:-1]
        rests = ~self.counted.moving[1:] & ~self.counted.moving[:-1]
        if moves.sum() < _FEW or rests.sum() < _FEW:
            return 1.0
        return float(np.clip(np.sqrt(np.median(step[moves]) / max(float(np.median(step[rests])), 1e-30)), 1.0, 30.0))

    def _moving_ratio(self, left: Array) -> float:
        """rms of residuals (n, channels) while the tip moves over that while it rests, of all where few frames rest; 1
        where it never moves."""
        power, moves = np.mean(left**2, axis=1), self.counted.moving
        rests = np.mean(power[~moves]) if (~moves).sum() > _FEW else np.mean(power)
        return float(np.sqrt(np.mean(power[moves]) / max(float(rests), 1e-30)) if moves.any() else 1.0)

    def _frames_per_independent(self) -> float:
        """`frames_per_independent` of the residuals that are left."""
        return frames_per_independent(self._left())

    # ---- the Gauss-Newton step

    @property
    def solution(self) -> Curves:
        """The curves after the step that the solution makes."""
        return self.fit.moved(self.curves, self.values[: self.nominal])

    @property
    def clock_step(self) -> Array:
        """(2,) by how much the solution moves the clock's rate and drift, s, as in `counted_frames`; 0 for what is not
        active."""
        return np.array([self._value(name) or 0.0 for name in ("clock.rate", "clock.drift")])

    @property
    def moves_width(self) -> bool:
        """Whether the step changes B by more than _STILL of its median sigma anywhere."""
        shift = np.abs(self._width_step(self.values))
        return bool(shift.max() > _STILL * float(np.median(self._width_sigma())))

    def _width_block(self) -> tuple[slice, Array]:
        """Where B's coefficients are among the unknowns, and the basis (grid, coefficients) that makes B of them."""
        first = self.curves.follow.size
        return slice(first, first + self.fit.backlash.size), np.asarray(
            self.fit.backlash.design(self.fit.grid).toarray()
        )

    def _width_step(self, values: Array) -> Array:
        """(grid,) by how much these values of the unknowns change B, unit of q."""
        block, design = self._width_block()
        return np.asarray(design @ values[block])

    def _width_sigma(self, inverse: Array | None = None) -> Array:
        """(grid,) standard deviation of B, unit of q. inverse: covariance in units of the noise's variance, by default
        that of the solution."""
        block, design = self._width_block()
        covariance = (self.inverse if inverse is None else inverse)[block, block]
        return np.asarray(self.noise * np.sqrt(np.maximum(np.sum((design @ covariance) * design, axis=1), 0.0)))

    # ---- the result

    def result(self) -> Components:
        """What was found, B being that of slow strokes at the session's end."""
        left = self._left()
        each = frames_per_independent(left)
        # Covariances of the nominal unknowns without components: of frames that are all independent, and of as many as
        # are. Only the frames' share is divided, what is known beforehand is known all the same.
        without_components, of_independent = self._nominal_inverse(1.0), self._nominal_inverse(each)
        found = (self._component(name, at) for name, at in self._active_blocks())
        parts = sorted(found, key=lambda part: -part.chi2)
        mean = self.solution
        mean = replace(mean, delay_s=mean.delay_s + self._lag_taken_for_delay())
        curves = replace(mean, backlash=self._width_at_the_end(mean.backlash))
        width = self.fit.width(curves)
        changed = float(np.mean((curves.backlash - mean.backlash) ** 2))
        return Components(
            curves=curves,
            session_mean=mean,
            width=width,
            sigma=self._total_width_sigma(without_components, of_independent, parts, changed, width),
            delay_sigma=self._total_delay_sigma(without_components, of_independent, parts),
            width_by_delay=self._width_by_delay(of_independent),
            tracker_lag_s=self._tracker_lag_s(parts),
            unexplained=self.noise,
            moving_ratio=self._moving_ratio(left),
            frames_per_independent=each,
            parts=tuple(parts),
            clock_error=self.clock_error + self.clock_step,
            count_visible=self.selection.count_visible,
            from_end=self._from_end(),
        )

    def _nominal_inverse(self, frames_each: float) -> Array:
        """Covariance (nominal, nominal) of path, B and delay in units of the noise's variance, without components,
        where one of `frames_each` frames is independent."""
        system = self.gram[: self.nominal, : self.nominal] / frames_each + self.nominal_penalty
        system[np.diag_indices_from(system)] += 1e-10 * float(np.mean(np.diag(system)))
        return inverse_of(system)

    def _total_width_sigma(
        self, without_components: Array, of_independent: Array, parts: Sequence[Component], changed: float, width: Array
    ) -> Array:
        """(grid,) standard deviation of B, unit of q, in quadrature: what the components add to its variance; the noise
        of as many frames as are independent; CORRECTS of what the components correct and of what the session's change
        does (changed: its mean square); the scatter between recordings; and LAW of what speed adds to B, `width`.
        without_components, of_independent: `_nominal_inverse` of all frames and of the independent ones."""
        without, own = self._width_sigma(without_components), self._width_sigma()
        corrected = sum((np.mean(part.width_shift**2) for part in parts), 0.0)
        independent = self._width_sigma(of_independent)
        sigma = np.sqrt(np.maximum(own**2 - without**2, 0.0) + independent**2 + CORRECTS**2 * corrected)
        between, slower = self._scatter_between_recordings() * width, LAW * self._added_by_speed(width)
        return np.asarray(np.sqrt(sigma**2 + CORRECTS**2 * changed + between**2 + slower**2))

    def _total_delay_sigma(self, without_components: Array, of_independent: Array, parts: Sequence[Component]) -> float:
        """Standard deviation of the delay, s, in quadrature: what the components add to its variance, the noise of as
        many frames as are independent, and CORRECTS of what the components correct. without_components, of_independent:
        `_nominal_inverse` of all frames and of the independent ones, the delay last."""
        delay = self.nominal - 1
        added = max(self.inverse[delay, delay] - without_components[delay, delay], 0.0)
        own = self.noise * float(np.sqrt(added + of_independent[delay, delay]))
        corrected = CORRECTS * float(np.sqrt(sum(part.delay_shift_s**2 for part in parts)))
        return float(np.hypot(own, corrected))

    def _width_by_delay(self, covariance: Array) -> Array:
        """(grid,) cov(B, delay) / var(delay): by how much B changes, unit of q, for each second that the delay does.
        covariance (nominal, nominal)."""
        block, design = self._width_block()
        return np.asarray(design @ covariance[block, -1] / covariance[-1, -1])

    def _component(self, name: str, at: Indices) -> Component:
        """An active component with its strength, and how B and the delay would change if its values, at these places
        of `values`, were held at zero (the conditional mean of the others)."""
        values = self.values[at]
        own = self.inverse[np.ix_(at, at)]
        pulled = np.linalg.solve(own + 1e-12 * float(np.trace(own)) / len(at) * np.eye(len(at)), values)
        chi2 = float(values @ pulled) / max(self.noise**2, 1e-30)
        rms = self.noise * float(np.sqrt(max(chi2, 0.0) / max(float(self.weight.sum()), 1.0)))
        without = -self.inverse[:, at] @ pulled
        return Component(name, rms, chi2, self._width_step(without), float(without[self.nominal - 1]), values)

    def _tracker_lag_s(self, parts: Sequence[Component]) -> float:
        """By how much, s, a tracker that holds back small motions shows a moving tip late: the rms of its components
        over the median speed in the image. What all strokes share of that is taken to be as large as what they do not,
        which is what the components show. 0 without a component `tracker`."""
        rms = {part.name: part.rms for part in parts if part.name in ("tracker", "phase.even")}
        speed = np.linalg.norm(self.counted.slope, axis=1) * np.abs(self.counted.speed)
        speed = speed[self.counted.moving]
        if "tracker" not in rms or not len(speed):
            return 0.0
        return sum(rms.values()) / max(float(np.median(speed)), 1e-12)

    def _lag_taken_for_delay(self) -> float:
        """The sum of the lags, s, where it is so short (_SHORT_LAG of a frame's period) that frames do not tell it from
        a delay, to which it is added then; 0 where it is longer."""
        lags = sum(float(self.values[at][0]) for name, at in self._active_blocks() if name.startswith("lag"))
        return lags if lags < _SHORT_LAG * float(np.median(np.diff(self.counted.time_s))) else 0.0

    def _added_by_speed(self, width: Array) -> Array:
        """(k,) by how much a width (k,) at the usual speed is more than that of slow strokes, unit of q."""
        added = [(name, float(self.values[at][0])) for name, at in self._active_blocks() if name.startswith(SPEED)]
        return np.asarray(sum((v * (width if name.endswith(SHARE) else 1.0) for name, v in added), 0.0 * width))

    def _scatter_between_recordings(self) -> float:
        """rms, as a share of B, by which B differs from one recording to the next: no B is known better."""
        values = [self.values[at] for name, at in self._active_blocks() if name == "width.recording"]
        return float(np.sqrt(np.mean(values[0] ** 2))) if values else 0.0

    # ---- the state at the session's end

    def _from_end(self) -> tuple[DifferenceFromEnd, ...]:
        """By track, how its frames differ from what they would show with the state of the session's end; empty where no
        component is such a state."""
        changed = [(name, at) for name, at in self._active_blocks() if name in STATES]
        if not changed:
            return ()
        counted = self.counted
        ended = {part.name: part for part in departures(counted.at_the_end(), self.searched, apart=True)}
        difference = np.zeros(counted.residuals.size)
        for name, at in changed:
            difference += (self.candidates[name].columns - ended[name].columns) @ self.values[at]
        by_frame = difference.reshape(counted.residuals.shape[1], -1).T
        own = [counted.recording == k for k in range(len(self.fit.tracks))]
        return tuple(DifferenceFromEnd(counted.frame[k], by_frame[k], counted.t[k] > _LATE) for k in own)

    def _offset_at_the_end(self) -> float:
        """Offset of the motor's positions at the session's end against its mean, unit of q: the tip at q is where it
        was at q + offset."""
        offset = 0.0
        for name, at in self._active_blocks():
            values = self.values[at]
            if name == "offset.recording":
                offset += float(contrasts(len(values) + 1)[-1] @ values)
            elif name == "offset.slip":
                offset += float(values[0])
            elif name == "offset.time":
                slow = slow_basis(np.array([0.5]), len(values) - 3)
                offset += float((slow @ values)[0])
        return offset

    def _width_at_the_end(self, backlash: Array) -> Array:
        """B's coefficients (m,), given those of the session's mean, for slow strokes at the session's end: moved along
        by the transmission's offset, times its growth in time and in the last recording, less what speed adds."""
        values = {name: self.values[at] for name, at in self._active_blocks() if name.startswith("width.")}
        if offset := self._offset_at_the_end():
            basis, grid = self.fit.backlash, self.fit.grid
            there = basis.value(backlash, np.clip(grid + offset, grid[0], grid[-1]))
            backlash = np.linalg.lstsq(basis.design(grid).toarray(), there, rcond=None)[0]
        grown = 1.0 + 0.5 * float(values["width.time"][0]) if "width.time" in values else 1.0
        if "width.recording" in values:
            each = values["width.recording"]
            grown += float(contrasts(len(each) + 1)[-1] @ each)
        return np.maximum(backlash * grown - self._added_by_speed(backlash), 0.0)


def frames_per_independent(residuals: Array) -> float:
    """How many residuals (n, channels) tell as much as one independent frame: 1 + 2 sum of their autocorrelation while
    that is more than chance, outliers cut at 4 rms."""
    clipped = np.clip(residuals / max(float(np.sqrt(np.mean(residuals**2))), 1e-30), -4.0, 4.0)
    return frames_each(clipped, min(_LAGS, len(clipped) // 4), least=2.0 / float(np.sqrt(clipped.size)))
