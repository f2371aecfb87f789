"""The mixed model of what a joint fit leaves, at one linearisation: nominal unknowns, and the values of departures,
each with a variance of its own.

r = J d(theta) + sum_k Z_k u_k + e, u_k ~ N(0, s_k^2 P_k^-1): theta are the coefficients of path, B and delay, each Z_k
the columns of one departure (departures.py). Variances are handled as penalties lambda_k = sigma^2 / s_k^2 on
u_k' P_k u_k, sigma^2 the residual variance in units of the stated noise; they maximise the restricted likelihood (REML,
by Fellner-Schall steps), and the values are solved together with the nominal unknowns (Henderson's equations).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.linalg import eigh

from tautline.calibration.counted import CountedFrames, scaled_rows
from tautline.calibration.departures import Departure, SearchedParameters
from tautline.calibration.playfit import STRAY, Curves, Fitted, PlayFit
from tautline.independence import frames_each
from tautline.least_squares import inverse_of
from tautline.nominal import Normal

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

REML_GAIN = 20.0  # prior: of twice the restricted log likelihood, for a component; noise alone gives 5 to 8
_JOIN_AT_ONCE = 2  # tolerance: components that may join at one linearisation
_VARIANCE_STEPS = 6  # tolerance: Fellner-Schall steps at one linearisation
_PENALTIES = np.logspace(-6, 3, 19)  # tolerance: tried for a new component, in units of its own information
_MOST, _LEAST = 1e12, 1e-12  # tolerance: of a penalty
_STILL = 0.05  # tolerance: a change of B, in its sigma, that is none
_FEW = 30  # tolerance: frames that are too few to tell a scatter
_LAGS = 60  # tolerance: frames of autocorrelation
_RIDGE, _RIDGE_OF_MEAN = 1e-10, 1e-12  # tolerance: of each unknown's information and of the mean one: is added to it
_FASTER = 1.5  # tolerance: exponent of Fellner-Schall's ratio: converges in fewer steps than 1
_MOST_AT_ONCE, _SETTLED = 100.0, 0.1  # tolerance: factor of a penalty in one step; a change of its logarithm: none
_UNSTEADIEST = 30.0  # tolerance: scatter of moving frames over that of resting ones: more says no more


@dataclass
class Selected:
    """Which departures are components, and what carries over from one linearisation to the next."""

    active: list[str] = field(default_factory=list)  # names of the components
    penalties: dict[str, float] = field(default_factory=dict)  # of active departures, by name
    refused: set[str] = field(default_factory=set)  # departures whose value would be negative and must not
    moving_noise: float = 1.0  # scatter of frames at which the tip moves, over that of the others


def nominal_columns(fit: PlayFit, counted: CountedFrames) -> list[sparse.csr_matrix]:
    """Derivatives of the whitened image by the nominal unknowns, as blocks (channels * n, ...), sparse, to be put side
    by side: by the path's coefficients (channel by channel), by B's, and by the delay."""
    path = scaled_rows(counted.inverse, fit.follow.design(counted.p))
    by_width = scaled_rows(counted.by_width, fit.backlash.design(counted.p))
    return [
        counted.per_channel(path),
        counted.along_path(by_width),
        counted.along_path(counted.by_delay[:, None]),
    ]


def normal_with_columns(fit: PlayFit, counted: CountedFrames, columns: Array) -> tuple[Array, Array, int]:
    """Normal matrix (m, m) and gradient (m,) by the frames' weights, without penalties, of the nominal unknowns
    followed by k further ones, which move the tip's place by columns (n, k); and the number of nominal unknowns."""
    weight = np.tile(counted.weight, counted.residuals.shape[1])
    blocks = [*nominal_columns(fit, counted), counted.along_path(columns)]
    normal = Normal.of_sparse(blocks, weight, counted.residuals.T.ravel())
    return normal.matrix, normal.gradient, len(normal.gradient) - columns.shape[1]


class MixedModel:
    """The mixed model at one linearisation. Unknowns: those of the nominal model (path channel by channel, B, delay),
    `nominal` of them, then the values of every candidate. Only those of active components are solved for: `solved`
    has their indices, and `values`, `inverse` are in its order."""

    def __init__(
        self, fitted: Fitted, selected: Selected, curves: Curves, counted: CountedFrames, candidates: list[Departure],
        clock_error: Array, searched: SearchedParameters,
    ) -> None:  # fmt: skip
        """Sums the weighted normal equations of the nominal unknowns and all candidates; solves nothing yet. fitted:
        the joint fit. selected: which candidates are active, and their penalties. curves: at which all is linearised.
        counted: the frames at these. clock_error (2,): s, as in `counted_frames`. searched: with which the candidates
        were made."""
        self.selected, self.curves, self.counted = selected, curves, counted
        self.clock_error, self.searched = clock_error, searched
        self.fit = fit = fitted.fit
        nominal = nominal_columns(fit, counted)
        self.design = [*nominal, *(part.columns for part in candidates)]
        moving_weight = np.where(counted.moving, selected.moving_noise**-2, 1.0)
        self.weight = np.tile(counted.weight * moving_weight, counted.residuals.shape[1])
        self.target = counted.residuals.T.ravel()
        normal = Normal.of_sparse(self.design, self.weight, self.target)
        self.gram, self.right = normal.matrix, normal.gradient
        self.target_squares = float(self.weight @ self.target**2)
        self.nominal = sum(int(block.shape[1]) for block in nominal)
        ends = np.cumsum([self.nominal, *(part.size for part in candidates)])
        self.candidates = {part.name: part for part in candidates}
        self.places = {part.name: np.arange(a, b) for part, a, b in zip(candidates, ends[:-1], ends[1:], strict=True)}
        self.noise = fitted.scale  # rms over the stated noise of what the model leaves
        self.nominal_penalty, self.nominal_pull = fit.penalty(curves, max(self.noise, 1e-6))

    # ---- estimation with the active components

    def solve_with_variances(self) -> None:
        """Solves with the active components while their penalties move to the restricted likelihood's maximum, in at
        most _VARIANCE_STEPS steps. Active components that are no candidates at these curves leave `selected`."""
        self.selected.active = [name for name in self.selected.active if name in self.candidates]
        self._solve()
        for _ in range(_VARIANCE_STEPS if self.selected.active else 0):
            if not self._adapt_penalties():
                break
            self._solve()

    def _solve(self) -> None:
        """Henderson's equations at the present penalties: sets `values`, the system's `inverse` (the covariance in
        units of the noise's variance) and `noise`^2 = residual squares over residual degrees of freedom, the frames'
        weight less the trace of inverse times gram. _RIDGE keeps it regular where no frame tells of an unknown."""
        self.solved = np.concatenate(
            [np.arange(self.nominal), *(self.places[name] for name in self.selected.active)]
        )  # fmt: skip
        gram, right = self.gram[np.ix_(self.solved, self.solved)], self.right[self.solved]
        system = gram.copy()
        system[: self.nominal, : self.nominal] += self.nominal_penalty
        for name, at in self.active_blocks():
            system[np.ix_(at, at)] += self.selected.penalties[name] * self.candidates[name].penalty
        diagonal = np.diag_indices_from(system)
        system[diagonal] += _RIDGE * system[diagonal] + _RIDGE_OF_MEAN * float(np.mean(system[diagonal]))
        pull = np.zeros(len(self.solved))  # the nominal penalty's gradient at the curves from which the step starts
        pull[: self.nominal] = self.nominal_pull
        self.inverse = inverse_of(system)
        self.values = self.inverse @ (right - pull)
        squares = self.target_squares - 2 * float(self.values @ right) + float(self.values @ gram @ self.values)
        freedom = float(self.weight.sum()) - float(np.vdot(self.inverse, gram))
        self.noise = float(np.sqrt(max(squares, 1e-12) / max(freedom, 1.0)))

    def active_blocks(self) -> list[tuple[str, Indices]]:
        """Each active component's name and the places of its values in `values`."""
        blocks, at = [], self.nominal
        for name in self.selected.active:
            size = self.candidates[name].size
            blocks.append((name, np.arange(at, at + size)))
            at += size
        return blocks

    def value(self, name: str) -> float | None:
        """The first value of an active component; None of one that is not active."""
        at = dict(self.active_blocks()).get(name)
        return None if at is None else float(self.values[at][0])

    def _adapt_penalties(self) -> bool:
        """One Fellner-Schall step of every active penalty: lambda <- lambda (noise^2 edf / (lambda u' P u))^_FASTER,
        with edf = m - lambda tr(C P) the component's effective degrees of freedom and C its block of the inverse; by a
        factor of _MOST_AT_ONCE at most. Returns whether any penalty changed by more than _SETTLED (of its
        logarithm)."""
        changed = False
        for name, at in self.active_blocks():
            now, penalty = self.selected.penalties[name], self.candidates[name].penalty
            freedom = len(at) - now * float(np.sum(self.inverse[np.ix_(at, at)] * penalty))
            size = float(self.values[at] @ penalty @ self.values[at])
            ratio = self.noise**2 * max(freedom, 1e-4) / max(now * size, 1e-30)
            then = float(np.clip(now * np.clip(ratio**_FASTER, 1.0 / _MOST_AT_ONCE, _MOST_AT_ONCE), _LEAST, _MOST))
            changed |= abs(np.log(then / now)) > _SETTLED
            self.selected.penalties[name] = then
        return changed

    # ---- selection of further components

    def join(self) -> bool:
        """Makes up to _JOIN_AT_ONCE candidates components and solves with them. Each is the one whose REML gain less
        its price is largest; it joins if its gain is at least REML_GAIN plus its price, times the frames per
        independent one. A one-way component whose value comes out negative is refused for good. Returns whether any
        candidate was tried."""
        joined = False
        for _ in range(_JOIN_AT_ONCE):
            taken = set(self.selected.active) | self.selected.refused
            open_parts = [p for p in self.candidates.values() if p.name not in taken and not p.not_beside & taken]
            gains = {part.name: self._reml_gain(part) for part in open_parts}
            if not gains:
                break
            name = max(gains, key=lambda each: gains[each][0] - self.candidates[each].price)
            if gains[name][0] < (REML_GAIN + self.candidates[name].price) * self.frames_per_independent():
                break
            self.selected.active.append(name)
            self.selected.penalties[name] = gains[name][1]
            self.solve_with_variances()
            value = self.value(name)
            if self.candidates[name].one_way and value is not None and value < 0:
                self.selected.active.remove(name)
                self.selected.refused.add(name)
                self.solve_with_variances()
            joined = True
        return joined

    def _reml_gain(self, part: Departure) -> tuple[float, float]:
        """By how much twice the restricted log likelihood grows if this candidate joins, at the best of _PENALTIES, and
        that penalty lambda. The gain is sum_i f_i^2 / (noise^2 (d_i + lambda)) - log(1 + d_i / lambda), with d_i the
        eigenvalues, relative to P, of its information given the other unknowns, and f_i its gradient along their
        eigenvectors. (0, 1) if no frame tells of it."""
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
        gains = (1.0 / np.add.outer(penalties, roots)) @ squares - np.log1p(np.outer(1.0 / penalties, roots)).sum(
            axis=1
        )
        best = int(np.argmax(gains))
        return float(gains[best]), float(penalties[best])

    def searched_again(self) -> SearchedParameters:
        """The moments of a shift and a slip and the frequency of a breath that explain most of what the solution
        leaves; those of active components stay."""
        return self.searched.updated(self.counted, self.residuals_left(), set(self.selected.active))

    # ---- residuals

    def residuals_left(self) -> Array:
        """(n, channels) whitened residuals that remain after the solution."""
        values = np.zeros(len(self.right))
        values[self.solved] = self.values
        ends = np.cumsum([block.shape[1] for block in self.design])[:-1]
        left = self.target - sum(
            (block @ each for block, each in zip(self.design, np.split(values, ends), strict=True)), 0.0
        )
        return np.asarray(left.reshape(self.counted.residuals.shape[1], -1).T)

    def moving_noise(self) -> float:
        """Scatter between neighbouring frames while the tip moves over that while it rests, clipped to 1 to
        _UNSTEADIEST: the root of the ratio of median squared differences. 1 with fewer than _FEW pairs of moving or of
        resting frames."""
        step = np.mean(np.diff(self.residuals_left(), axis=0) ** 2, axis=1)
        moves = self.counted.moving[1:] & self.counted.moving[:-1]
        rests = ~self.counted.moving[1:] & ~self.counted.moving[:-1]
        if moves.sum() < _FEW or rests.sum() < _FEW:
            return 1.0
        ratio = np.sqrt(np.median(step[moves]) / max(float(np.median(step[rests])), 1e-30))
        return float(np.clip(ratio, 1.0, _UNSTEADIEST))

    def moving_ratio(self, left: Array) -> float:
        """rms of the residuals left (n, channels) while the tip moves over that while it rests, or over that of all
        frames if at most _FEW rest; 1 if it never moves."""
        power, moves = np.mean(left**2, axis=1), self.counted.moving
        rests = np.mean(power[~moves]) if (~moves).sum() > _FEW else np.mean(power)
        return float(np.sqrt(np.mean(power[moves]) / max(float(rests), 1e-30)) if moves.any() else 1.0)

    def frames_per_independent(self) -> float:
        """How many frames tell as much as one independent frame, by the autocorrelation of the residuals that the
        solution leaves."""
        return frames_per_independent(self.residuals_left())

    # ---- the Gauss-Newton step

    @property
    def solution(self) -> Curves:
        """The curves after the step that the solution makes."""
        return self.fit.moved(self.curves, self.values[: self.nominal])

    @property
    def clock_step(self) -> Array:
        """(2,) by how much the solution changes the clock's error, s (rate and drift, as in `counted_frames`); 0 for a
        component that is not active."""
        return np.array([self.value(name) or 0.0 for name in ("clock.rate", "clock.drift")])

    @property
    def moves_width(self) -> bool:
        """Whether the step changes B by more than _STILL of its median sigma anywhere."""
        shift = np.abs(self.width_step(self.values))
        return bool(shift.max() > _STILL * float(np.median(self.width_sigma())))

    def width_block(self) -> tuple[slice, Array]:
        """Where B's coefficients are among the unknowns, and the matrix (grid, coefficients) that makes B on the grid
        of them."""
        first = self.curves.follow.size
        return slice(first, first + self.fit.backlash.size), np.asarray(
            self.fit.backlash.design(self.fit.grid).toarray()
        )

    def width_step(self, values: Array) -> Array:
        """(grid,) by how much these values of the unknowns change B, unit of q."""
        block, design = self.width_block()
        return np.asarray(design @ values[block])

    def width_sigma(self, inverse: Array | None = None) -> Array:
        """(grid,) standard deviation of B, unit of q. inverse: covariance in units of the noise's variance, by default
        that of the solution."""
        block, design = self.width_block()
        covariance = (self.inverse if inverse is None else inverse)[block, block]
        return np.asarray(self.noise * np.sqrt(np.maximum(np.sum((design @ covariance) * design, axis=1), 0.0)))


def frames_per_independent(residuals: Array) -> float:
    """How many of the residuals' frames (n, channels) tell as much as one independent frame: 1 + 2 times the sum of
    their autocorrelation, up to the lag at which it could be chance. Outliers are cut at STRAY rms."""
    clipped = np.clip(residuals / max(float(np.sqrt(np.mean(residuals**2))), 1e-30), -STRAY, STRAY)
    return frames_each(clipped, min(_LAGS, len(clipped) // 4), least=2.0 / float(np.sqrt(clipped.size)))
