"""A curve as polynomials of fourth order, one after the other: what a chain of MuJoCo's joint equalities can hold.

One polynomial leaves 75 um of a B(q) with a bump; a second and third one stretch its axis first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numpy.polynomial import polynomial
from scipy.optimize import least_squares

Array = npt.NDArray[np.float64]

ORDER = 4  # format: of MuJoCo's polycoef
MOST_LINKS, MOST_CHAINS = 4, 2  # tolerance: further ones cost seconds each
_STARTS, _EVALUATIONS = 5, 40  # tolerance: of the search for the links before the last one
_NODES = 101  # tolerance: of the curve that the search looks at: 20 to each coefficient's own
_SPREAD = 0.3  # prior: of the starting coefficients: a curve of [-1, 1] that stays monotone in most draws
_STIFF = 1e-3  # prior: of a coefficient, in shares of the curve's spread: none grows without a gain


@dataclass(frozen=True)
class Chain:
    """y = links[-1](... links[0](x)); each has five coefficients, the constant first. The value between two links runs
    from -1 to 1 over the curve's own range."""

    links: tuple[Array, ...]
    rms: float  # of the curve less the chain, on the curve's nodes

    def values(self, x: npt.ArrayLike) -> list[Array]:
        """The outputs of all links at x, first link first, each in the shape of x; the last one is y."""
        at = np.asarray(x, dtype=float)
        found = []
        for link in self.links:
            at = np.asarray(polynomial.polyval(at, link))
            found.append(at)
        return found

    def __call__(self, x: npt.ArrayLike) -> Array:
        """The chain's value y at x, in x's shape."""
        return self.values(x)[-1]


def fit(x: Array, y: Array, enough: float) -> Chain:
    """Fits a chain of polynomials to a curve, x (n,) rising and y (n,): the shortest one of at most MOST_LINKS whose
    rms error is at most `enough`, in the unit of y, or else the best one. Deterministic; takes 0.1 to 5 s."""
    u = (2.0 * x - x[0] - x[-1]) / (x[-1] - x[0])  # x scaled to [-1, 1], and `scale` as (constant, slope)
    scale = np.array([-(x[0] + x[-1]), 2.0]) / (x[-1] - x[0])
    best, free = _chain_with_best_last_link([], u, y, scale), np.zeros(0)
    for _ in range(2, MOST_LINKS + 1):
        if best.rms <= enough:
            break
        found, free = _search(u, y, scale, free)
        best = min(best, found, key=lambda chain: chain.rms)
    return best


@dataclass(frozen=True)
class Sum:
    """A sum of chains: each was fitted to what those before it leave of a curve."""

    chains: tuple[Chain, ...]

    def __call__(self, x: npt.ArrayLike) -> Array:
        """The sum of all chains' values at x, in x's shape."""
        return np.asarray(sum(chain(x) for chain in self.chains))


def fit_sum(x: Array, y: Array, enough: float) -> Sum:
    """Fits a sum of up to MOST_CHAINS chains to a curve, x (n,) rising and y (n,), each to what those before it leave,
    until the rms error is at most `enough`, in the unit of y."""
    chains = [fit(x, y, enough)]
    while chains[-1].rms > enough and len(chains) < MOST_CHAINS:
        chains.append(fit(x, y - Sum(tuple(chains))(x), enough))
    return Sum(tuple(chains))


def _search(u: Array, y: Array, scale: Array, known: Array) -> tuple[Chain, Array]:
    """Searches for the best chain that has one link more than the best one before. A random link is put in front of its
    inner links, with the free coefficients `known` (see `_inner_links`); nonlinear least squares varies all of them,
    from _STARTS such starts. Returns the chain and the free coefficients of its inner links. u, y, scale: as in
    `_chain_with_best_last_link`."""
    nodes = np.linspace(-1.0, 1.0, _NODES)
    wanted = np.interp(nodes, u, y)
    spread = max(float(np.ptp(wanted)), 1e-300)
    rng = np.random.default_rng(0)

    def residuals(free: Array) -> Array:
        """Residuals (_NODES + len(free),) at these free coefficients: the chain's error at each node, in thousandths of
        the curve's spread, its last link being solved for; then _STIFF times the coefficients, which is their prior.
        The error is 1e3 at all nodes where a link is constant or not finite."""
        at = nodes
        for link in _inner_links(free):
            at = np.asarray(polynomial.polyval(at, link))
            if not np.isfinite(at).all() or np.ptp(at) < 1e-6:
                return np.concatenate([np.full(_NODES, 1e3), _STIFF * free])
            at = _scaled_to_unit(at)[0]
        design = polynomial.polyvander(at, ORDER)
        solved, *_ = np.linalg.lstsq(design, wanted, rcond=None)
        return np.concatenate([(design @ solved - wanted) / spread * 1e3, _STIFF * free])

    best: tuple[float, Array] | None = None
    for _ in range(_STARTS):
        begin = np.concatenate([rng.normal(0.0, _SPREAD, ORDER), known])
        found = least_squares(residuals, begin, max_nfev=_EVALUATIONS)
        if best is None or found.cost < best[0]:
            best = found.cost, found.x
    assert best is not None
    return _chain_with_best_last_link(_inner_links(best[1]), u, y, scale), best[1]


def _inner_links(free: Array) -> list[Array]:
    """All links but the last one, five coefficients each (constant first), from their free coefficients (ORDER for each
    link): the constant, then second order and up. The coefficient of first order is 1, as the next link can scale."""
    return [np.concatenate([part[:1], [1.0], part[1:]]) for part in free.reshape(-1, ORDER)]


def _scaled_to_unit(values: Array) -> tuple[Array, Array]:
    """Values (n,) scaled to [-1, 1], and the straight line (constant, slope) that scales them."""
    low, high = float(values.min()), float(values.max())
    line = np.array([-(low + high), 2.0]) / (high - low)
    return line[0] + line[1] * values, line


def _chain_with_best_last_link(inner: list[Array], u: Array, y: Array, scale: Array) -> Chain:
    """The chain of the links `inner`, the output of each scaled to [-1, 1], and a last link that is fitted to y (n,) by
    linear least squares. u (n,): the curve's x, scaled to [-1, 1] by the straight line `scale` (constant, slope)."""
    # argument: the straight line that is applied to what the next link takes; of the first one `scale`, else none.
    at, argument, links = u, scale, []
    for link in inner:
        raw: Array = np.asarray(polynomial.polyval(at, link), dtype=float)
        at, line = _scaled_to_unit(raw)
        scaled = line[1] * link
        scaled[0] += line[0]
        links.append(_composed_with_line(scaled, argument))
        argument = np.array([0.0, 1.0])
    design = polynomial.polyvander(at, ORDER)
    solved: Array = np.asarray(np.linalg.lstsq(design, y, rcond=None)[0], dtype=float)
    links.append(_composed_with_line(solved, argument))
    return Chain(tuple(links), float(np.sqrt(np.mean((design @ solved - y) ** 2))))


def _composed_with_line(link: Array, line: Array) -> Array:
    """The coefficients (5,) of link(line(x)); link: five coefficients, line: (constant, slope)."""
    composed = np.zeros(1)  # Horner's rule, in polynomials
    for coefficient in link[::-1]:
        composed = polynomial.polyadd(polynomial.polymul(composed, line), [coefficient])
    return np.pad(composed, (0, ORDER + 1 - len(composed)))
