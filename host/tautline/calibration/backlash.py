"""B(q) from the widths at reversals: a penalised cubic B-spline through them, or the paper's spline.

Onsets are of three kinds: hinges are widths with a Gaussian error, brackets intervals that contain the width, bounds
lengths of strokes that moved nothing, which B is not below. B, widths, positions and sigmas are in the unit of q.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline
from scipy.linalg import cho_factor, cho_solve, eigh
from scipy.optimize import brentq
from scipy.special import log_ndtr

from tautline.calibration.onset import BOUND, BRACKET, Onset, with_width
from tautline.least_squares import inverse_of
from tautline.model import STEEPEST, allowed_width
from tautline.splines import Basis

Array = npt.NDArray[np.float64]

SPANS = 64  # tolerance: of the range
_ROUNDS, _STAYS = 4, 0.05  # tolerance: at most; of the widths' standard deviation: a curve that moves less is done
_STIFF = 1e3  # tolerance: weights of the heaviest width: what an inequality that is violated weighs
_ALIKE = 1e-3  # tolerance: of a score, or of the largest B: a difference that is none
_CLOSE = 1e-3  # tolerance: of the widths' standard deviation: B from brackets is solved to it
_SMOOTHINGS = np.logspace(-4, 9, 27)  # tolerance: relative to the weight of one width
_TAIL = 30.0  # tolerance: sigma
_SOFTNESS = (1.0, 0.5, 0.25, 0.12, 0.06)  # tolerance: of the brackets' edges, from round to round
SLOPE_UNTOLD = 0.5  # prior: standard deviation of B' where nothing tells it
_FEW_PLACES = 5  # tolerance: of widths: fewer tell no smoothing
_KEPT = 1e-6  # tolerance: of a place that is left out, and stays: one that alone tells a coefficient divides by no 0
_MOST_LIMITED, _MOST_NEWTON = 20, 25  # tolerance: rounds with further inequalities; steps at one softness
_SHORTEST, _SOLVED = 1e-3, 1e-7  # tolerance: of Newton's step; of the largest coefficient: a change that is none
_LINE, _RIDGE = 1e-6, 1e-12  # tolerance: of a width's weight: on second differences; of the system's trace
_PAPER_UNIFORM, _PAPER_REPEATS = 8, 3  # format: 14 knots in all, 10 coefficients


@dataclass(frozen=True)
class WidthCurve:
    """B(q) on a grid over the motor's range, constant beyond the measured positions."""

    q: Array  # (grid,)
    width: Array  # (grid,) B
    sigma: Array  # (grid,) its standard deviation
    measured: tuple[float, float]  # lowest and highest position of a width
    excess: float  # scatter of the widths about the curve beyond their stated sigma, unit of q
    notes: tuple[str, ...] = ()
    places: int = 1  # number of the spline's spans in which widths were measured

    def at(self, p: Array) -> Array:
        """B (n,) at positions p (n,), both in the unit of q."""
        return np.asarray(np.interp(p, self.q, self.width))


def paper_knots(low: float, high: float) -> Array:
    """The paper's knots (14,) for a cubic spline on [low, high]: 8 evenly spaced with both ends, and 3 repeats of
    either end (paper, section V-D)."""
    ends = [low] * _PAPER_REPEATS, [high] * _PAPER_REPEATS
    return np.concatenate([ends[0], np.linspace(low, high, _PAPER_UNIFORM), ends[1]])


def fit_paper(onsets: Sequence[Onset], grid: Array) -> WidthCurve | None:
    """The paper's B-spline by weighted least squares through the widths, on the grid's range; its excess is the rms
    residual. None where no width was measured."""
    widths = with_width(onsets)
    if not widths:
        return None
    p, w, sigma = (np.array([getattr(o, name) for o in widths]) for name in ("q_mean", "width", "sigma"))
    knots = paper_knots(float(grid[0]), float(grid[-1]))
    inside = np.clip(grid, grid[0], grid[-1] - 1e-9 * (grid[-1] - grid[0]))
    design, on_grid = (
        BSpline.design_matrix(x, knots, 3).toarray() for x in (np.clip(p, inside[0], inside[-1]), inside)
    )
    bend = np.diff(np.eye(design.shape[1]), 2, axis=0)
    weight = 1.0 / sigma**2
    # Coefficients that no width reaches take the line through their neighbours.
    system = design.T @ (weight[:, None] * design) + _LINE * float(np.median(weight)) * bend.T @ bend
    system += _RIDGE * np.trace(system) * np.eye(len(system))
    coefficients = np.linalg.solve(system, design.T @ (weight * w))
    curve = on_grid @ coefficients
    spread = np.sqrt(np.maximum(np.sum((on_grid @ np.linalg.inv(system)) * on_grid, axis=1), 0.0))
    excess = float(np.sqrt(np.mean((w - design @ coefficients) ** 2)))
    lawful = allowed_width(grid, curve)
    limited = f"the spline was limited to B >= 0 and |B'| <= {STEEPEST:g}"
    notes = (limited,) if np.abs(lawful - curve).max() > 1e-9 else ()
    return WidthCurve(grid, lawful, spread, (float(p.min()), float(p.max())), excess, notes)


def fit_widths(onsets: Sequence[Onset], grid: Array) -> WidthCurve | None:
    """B(q) by a penalised spline through all used onsets: hinges by their sigma, brackets as intervals, and bounds that
    the curve would violate as further widths. The smoothing is chosen by cross-validation, or by the restricted
    likelihood if there are brackets. Beyond the measured positions B is constant and its sigma grows by SLOPE_UNTOLD
    times the distance. None if no width was measured."""
    widths = with_width(onsets)
    if not widths:
        return None
    fit = _WidthFit(
        widths, [o for o in onsets if o.used and o.kind == BOUND], Basis(float(grid[0]), float(grid[-1]), SPANS)
    )
    fit.solve()
    low, high = float(fit.p.min()), float(fit.p.max())
    held = np.clip(grid, low, high)
    curve = fit.basis.value(fit.coefficients, held)
    lawful = allowed_width(grid, curve)
    if np.abs(lawful - curve).max() > _ALIKE * max(curve.max(), 1e-9):
        fit.notes.append(f"B(q) is limited by B >= 0 or |B'| <= {STEEPEST:g}")
    beyond = np.abs(grid - held)
    sigma = np.hypot(fit.sigma(held), SLOPE_UNTOLD * beyond)
    return WidthCurve(grid, lawful, sigma, (low, high), fit.excess, tuple(dict.fromkeys(fit.notes)), len(fit.places()))


class _WidthFit:
    """One spline through widths (n,): hinges and brackets, and bounds that the curve would violate."""

    def __init__(self, widths: Sequence[Onset], bounds: Sequence[Onset], basis: Basis) -> None:
        """Begins with a constant B, the mean of the widths weighted by 1 / sigma^2."""
        self.basis = basis
        self.notes: list[str] = []
        self.p, self.w, self.stated = (np.array([getattr(o, k) for o in widths]) for k in ("q_mean", "width", "sigma"))
        self.direction = np.array([o.direction for o in widths], dtype=float)
        self.is_bracket = np.array([o.kind == BRACKET for o in widths])
        self.low = np.array([o.low for o in widths])
        self.high = np.array([o.high for o in widths])
        self.design = basis.design(self.p).toarray()
        self.excess = 0.0
        self.spread = self.stated.copy()
        self.bounds = list(bounds)
        self.notes_of_bounds: list[str] = []
        self.coefficients = np.full(basis.size, float(np.average(self.w, weights=self.stated**-2)))

    def _effective_sigma(self) -> Array:
        """(n,) standard deviation of each width about the curve: the stated one times |1 - direction B'/2|, since
        position and width share one error, and the excess scatter."""
        slope = self.basis.slope(self.coefficients, self.p)
        turned = np.abs(1.0 - 0.5 * self.direction * np.clip(slope, -STEEPEST, STEEPEST))
        return np.asarray(np.maximum(np.hypot(self.stated * turned, self.excess), 1e-12))

    def _add_violated_bounds(self) -> None:
        """Adds to the widths each stroke that moved nothing though it was longer than B is there by the curve, as a
        width of the stroke's length with the median sigma; takes it off `bounds` and adds a note. Sets `design`
        anew."""
        for onset in list(self.bounds):
            if float(self.basis.value(self.coefficients, np.array([onset.q_mean]))[0]) < onset.low:
                self.bounds.remove(onset)
                self.notes_of_bounds.append(
                    f"a stroke of {onset.low:.4g} at {onset.q_mean:.4g} moved nothing and lifts B(q) there"
                )
                self.p, self.w = np.append(self.p, onset.q_mean), np.append(self.w, onset.low)
                self.stated = np.append(self.stated, float(np.median(self.stated)))
                self.direction = np.append(self.direction, 0.0)
                self.is_bracket = np.append(self.is_bracket, False)
                self.low, self.high = np.append(self.low, onset.low), np.append(self.high, np.inf)
        self.design = self.basis.design(self.p).toarray()

    def solve(self) -> None:
        """Fits the curve in at most _ROUNDS rounds, as weights, smoothing, excess scatter and violated bounds depend on
        the curve; then anew with brackets as intervals, if there are any."""
        for turn in range(_ROUNDS):
            if turn:
                self._add_violated_bounds()
            self.spread = self._effective_sigma()
            weight = self.spread**-2
            unit = float(np.median(weight))
            self.roughness = self._cross_validated_smoothing(weight, unit) * unit
            before = self.coefficients
            self._solve(weight)
            self.excess = self._excess(weight)
            if np.abs(self.coefficients - before).max() < _STAYS * float(np.median(self.spread)) and turn:
                break
        if self.is_bracket.any():
            self._solve_with_brackets()

    def _cross_validated_smoothing(self, weight: Array, unit: float) -> float:
        """The one of _SMOOTHINGS, relative to `unit`, with which the widths of each place are predicted best by all
        others: with the least sum of squared weighted errors, in closed form. A place is all widths in one span of the
        spline, as the smoothing decides what B is between places. The largest smoothing with fewer than _FEW_PLACES
        places. weight (n,): 1 / sigma^2; unit: its median."""
        places = self.places()
        if len(places) < _FEW_PLACES:
            return float(_SMOOTHINGS[-1])
        gram = self.design.T @ (weight[:, None] * self.design)
        # In the basis V that makes gram and roughness diagonal at once, every smoothing is a division: V'(roughness /
        # size + gram / trace) V = 1 and V' roughness V = roots, so that V' gram V = trace (1 - roots / size).
        along = self.basis.roughness / self.basis.size + gram / np.trace(gram)
        roots, vectors = eigh(self.basis.roughness, along, check_finite=False)
        told = np.maximum(1.0 - roots / self.basis.size, 0.0) * np.trace(gram)
        system = told + unit * np.outer(_SMOOTHINGS, np.maximum(roots, 0.0))  # (smoothings, size)
        seen = self.design @ vectors
        left = self.w - (seen.T @ (weight * self.w) / system) @ seen.T
        score = np.zeros(len(_SMOOTHINGS))
        for size in {len(place) for place in places}:
            alike = np.array([place for place in places if len(place) == size])  # (places, size)
            # Errors of a place that is left out: (1 - H)^-1 r, H its widths' own block of the fit's hat matrix.
            spread = seen[alike] / system[:, None, None]
            within = spread @ seen[alike].transpose(0, 2, 1) * weight[alike][:, None, :]
            out = np.linalg.solve(np.eye(size) - within * (1 - _KEPT), left[:, alike, None])[..., 0]
            score += np.sum(weight[alike] * out**2, axis=(1, 2))
        best, chosen = np.inf, float(_SMOOTHINGS[-1])
        for each, smoothing in zip(score[::-1], _SMOOTHINGS[::-1], strict=True):
            if each < best * (1.0 - _ALIKE):  # the smoother of two that are alike
                best, chosen = float(each), float(smoothing)
        return chosen

    def places(self) -> list[npt.NDArray[np.intp]]:
        """Indices of the widths, a list for each span of the spline in which there are any."""
        span = np.floor((self.p - self.basis.low) / self.basis.step)
        order = np.argsort(span, kind="stable")
        return list(np.split(order, np.flatnonzero(np.diff(span[order])) + 1))

    @staticmethod
    def _inverse(system: Array) -> Array:
        """Inverse of a symmetric system (m, m), with a ridge that is too small to pull a curve of few widths to 0."""
        ridge = 1e-14 * float(np.trace(system)) / len(system)
        return inverse_of(system + ridge * np.eye(len(system)))

    def _solve(self, weight: Array) -> None:
        """Sets `coefficients` and `gram` (the penalised normal matrix) by penalised least squares with weight (n,), 1 /
        sigma^2, and `notes` anew. Limits of B that the solution violates are added as equations of large weight, until
        none is violated, in at most _MOST_LIMITED rounds."""
        self.notes[:] = self.notes_of_bounds
        gram = self.design.T @ (weight[:, None] * self.design) + self.roughness * self.basis.roughness
        right = self.design.T @ (weight * self.w)
        coefficients = self._inverse(gram) @ right
        for _ in range(_MOST_LIMITED):
            rows, values = self._violated(coefficients)
            if not len(rows):
                break
            stiff = _STIFF * float(np.max(weight))
            again = self._inverse(gram + stiff * rows.T @ rows) @ (right + stiff * rows.T @ values)
            if np.abs(again - coefficients).max() < _SOLVED * max(np.abs(again).max(), 1e-9):
                break
            coefficients = again
        self.coefficients = coefficients
        self.gram = gram

    def _violated(self, coefficients: Array) -> tuple[Array, Array]:
        """The limits B >= 0 and |B'| <= STEEPEST that the coefficients break, within a span of the measured positions,
        as equations rows (k, m) @ coefficients = values (k,). Adds a note for each."""
        rows: list[Array] = []
        values: list[float] = []
        identity = np.eye(self.basis.size)
        near = (self.basis.centres >= self.p.min() - self.basis.step) & (
            self.basis.centres <= self.p.max() + self.basis.step
        )
        for i in np.flatnonzero((coefficients < 0) & near):
            rows.append(identity[i])
            values.append(0.0)
            self.notes.append("B >= 0 limits the curve")
        limit = STEEPEST * self.basis.step
        for i in np.flatnonzero((np.abs(np.diff(coefficients)) > limit) & near[1:]):
            rows.append(identity[i + 1] - identity[i])
            values.append(float(np.sign(coefficients[i + 1] - coefficients[i])) * limit)
            self.notes.append(f"|B'| <= {STEEPEST:g} limits the curve")
        return np.array(rows).reshape(-1, self.basis.size), np.array(values)

    def _excess(self, weight: Array) -> float:
        """Scatter of the widths, unit of q, that must be added to their stated sigma so that chi-square equals the
        degrees of freedom; 0 if the stated sigma is enough. With fewer than 2 degrees of freedom the present `excess`
        is kept. weight (n,): 1 / sigma^2 of the fit."""
        inverse = self._inverse(self.gram)
        spent = float(np.sum(np.sum((self.design @ inverse) * self.design, axis=1) * weight))
        freedom = len(self.w) - spent
        left = self.w - self.design @ self.coefficients
        if freedom < 2:
            return self.excess

        def surplus(extra: float) -> float:
            """Chi-square less degrees of freedom, with a scatter `extra` beside the stated sigma."""
            return float(np.sum(left**2 / (self.stated**2 + extra**2))) - freedom

        most = float(np.abs(left).max()) * 3 + 1e-12  # beyond it chi-square is a ninth of the widths' number at most
        if surplus(0.0) <= 0:
            return 0.0
        return float(brentq(surplus, 0.0, most)) if surplus(most) < 0 else most

    def sigma(self, p: Array) -> Array:
        """Standard deviation of B (k,) at positions p (k,), by the widths' weights and the smoothing."""
        design = self.basis.design(p).toarray()
        return np.asarray(np.sqrt(np.maximum(np.sum((design @ self._inverse(self.gram)) * design, axis=1), 0.0)))

    # ---- brackets: each says only between which two positions the onset was; many together say more

    def _solve_with_brackets(self) -> None:
        """Fits the curve anew with brackets as intervals: the smoothing by restricted likelihood, then the curve by
        Newton's method. Sets `roughness`, `coefficients` and `gram`, in which each bracket weighs as a width of its
        sigma."""
        self.notes[:] = self.notes_of_bounds
        unit = float(np.median(self.spread**-2))
        start = np.full(self.basis.size, float(np.mean(self.w)))
        self.roughness = self._smoothing_of_brackets(unit) * unit
        self.coefficients = self._newton_with_brackets(start)
        self.gram = self.design.T @ ((self.spread**-2)[:, None] * self.design) + self.roughness * self.basis.roughness
        self.notes.append(
            "the image jumps at the onset: each reversal brackets it between two frames, and B(q) is what all agree on"
        )

    def _smoothing_of_brackets(self, unit: float) -> float:
        """The one of _SMOOTHINGS, relative to `unit`, with the largest restricted likelihood, each bracket counting as
        a width at its middle with a uniform density's sigma. (Cross-validation would judge by the outermost brackets
        mostly, of which the others tell little.)"""
        weight = self.spread**-2
        gram, right = self.design.T @ (weight[:, None] * self.design), self.design.T @ (weight * self.w)

        def deviance(smoothing: float) -> float:
            """-2 log restricted likelihood but for a constant."""
            system = gram + smoothing * unit * self.basis.roughness
            system += _RIDGE * float(np.trace(gram)) / len(gram) * np.eye(len(gram))
            explained = float(right @ np.linalg.solve(system, right))
            return float(np.linalg.slogdet(system)[1]) - self.basis.roughness_rank * math.log(smoothing) - explained

        return float(min(_SMOOTHINGS, key=deviance))

    def _likelihood_terms(self, coefficients: Array, softness: float) -> tuple[Array, Array, Array]:
        """-log likelihood of each width and its first two derivatives by B(p), (n,) each: Gaussian for hinges,
        `_interval_terms` for brackets, whose edges are soft by `softness` halves of their length."""
        value = self.design @ coefficients
        gauss = ~self.is_bracket
        low, high = (np.where(gauss, self.w, edge) for edge in (self.low, self.high))
        # Brackets that contradict each other are no walls, and no edge is sharper than B is solved to.
        soft = np.maximum(0.5 * softness * (high - low), max(self.excess, self._tolerance))
        cost, first, second = _interval_terms((value - low) / soft, (value - high) / soft)
        z = (value - self.w) / self.spread
        return (
            np.where(gauss, 0.5 * z * z, cost),
            np.where(gauss, z / self.spread, first / soft),
            np.where(gauss, self.spread**-2, second / soft**2),
        )

    @property
    def _tolerance(self) -> float:
        """How far the coefficients may still move, unit of q, when B from brackets counts as solved."""
        return _CLOSE * float(np.median(self.spread))

    def _newton_with_brackets(self, start: Array) -> Array:
        """Coefficients (m,) that maximise the penalised likelihood, by Newton's method with step halving. The brackets'
        edges are soft at first and sharpen from round to round (_SOFTNESS), so that the curve ends near the middle of
        what all brackets allow. start (m,): coefficients to begin with."""
        coefficients = start
        rough = self.roughness * self.basis.roughness
        ridge = 1e-10 * self.roughness * np.eye(self.basis.size)

        def total(at: Array, soft: float) -> float:
            """-log of the penalised likelihood at coefficients (m,)."""
            return float(self._likelihood_terms(at, soft)[0].sum()) + 0.5 * float(at @ rough @ at)

        for soft in _SOFTNESS:
            for _ in range(_MOST_NEWTON):
                _, first, second = self._likelihood_terms(coefficients, soft)
                system = cho_factor(
                    self.design.T @ (second[:, None] * self.design) + rough + ridge, check_finite=False
                )  # fmt: skip
                step = cho_solve(system, self.design.T @ first + rough @ coefficients, check_finite=False)
                now, length = total(coefficients, soft), 1.0
                while length > _SHORTEST and total(coefficients - length * step, soft) > now:
                    length *= 0.5
                coefficients = coefficients - length * step
                if np.abs(length * step).max() < self._tolerance:
                    break
        return coefficients


def _interval_terms(a: Array, b: Array) -> tuple[Array, Array, Array]:
    """-log(Phi(a) - Phi(b)) (n,) and its first two derivatives by B: the cost of B in a bracket with soft edges. a, b
    (n,), a >= b: distances of B above the lower and the upper edge, over the edges' softness. More than _TAIL beyond
    the nearer edge the cost goes on as the parabola that it tends to, with cost and slope right to 0.1 %. Brackets
    narrower than a thousandth of the softness count as that wide."""
    middle, half = 0.5 * (a + b), np.maximum(0.5 * (a - b), 5e-4)
    beyond = np.maximum(np.abs(middle) - half - _TAIL, 0.0)  # of the nearer edge
    # Mirrored to below both edges, where log Phi keeps its digits; the slope is turned back by middle's sign.
    a, b = half - (np.abs(middle) - beyond), -half - (np.abs(middle) - beyond)
    upper = log_ndtr(a)
    log_mass = upper + np.log(-np.expm1(log_ndtr(b) - upper))
    log_density_a, log_density_b = (-0.5 * x * x - 0.5 * np.log(2 * np.pi) for x in (a, b))
    at_a, at_b = np.exp(log_density_a - log_mass), np.exp(log_density_b - log_mass)
    pull = at_a - at_b
    second = np.maximum(a * at_a - b * at_b + pull * pull, 1e-12)
    cost = -log_mass + beyond * pull + 0.5 * beyond**2
    return cost, np.sign(middle) * (pull + beyond), second
