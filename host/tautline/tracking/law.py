"""What may have changed since the calibration (theta), and the play that a theta makes of the calibrated model.

B: the play's width, unit of q, over its centre coordinate p; f_remain: the bending angle, deg, over p.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from tautline import _native
from tautline.model import Model, allowed_width, interpolate, interpolate_inverse
from tautline.spread import of_rounding
from tautline.tracking.beyond import PLACES, Beyond

Array = npt.NDArray[np.float64]

OFFSET, SCALE, SHAPE, SPREAD, SKEW = 0, 1, slice(2, 2 + PLACES), 2 + PLACES, 3 + PLACES  # format: of theta
TIP = slice(SKEW + 1, SKEW + 1 + 3)  # format: deg, constant, slope and bend of f_remain's change
PARAMETERS = TIP.stop  # format: of theta
_LOTS = 5  # tolerance: elements that a single play is split into where its onset has become gradual
_LEAST_SCALE, _MOST_SCALE = 0.02, 5.0  # prior: of B, that use leaves of it or makes it
_MOST_OWN = 1.5  # prior: of a frame's noise, what of a calibrated law's own sigma is taken for noise
_LEAST_SHAPE, _MOST_SHAPE = -0.9, 4.0  # prior: the same, in one place
_LEAST_SPREAD = -0.95  # limit: of the elements' own, at which all of them start together
_MOST_SKEW = 0.6  # prior: shares of five even lots between 0.8 and 1.2 of B by it
_KEPT = 8  # tolerance: laws that a family remembers
_LEAST_GRADUAL, _GRADUAL = 0.1, 0.2  # tolerance: of an onset, from which its derivatives are taken


def calibrated_theta() -> Array:
    """Returns theta (PARAMETERS,) of the calibrated law. Its parts: offset (unit of q, added to q), scale of B, shape
    of B (further shares of it at PLACES places), spread of the play's elements' shares about their mean, skew of these,
    and what is added to f_remain (deg, TIP). All are 0 but the scale, 1."""
    theta = np.zeros(PARAMETERS)
    theta[SCALE] = 1.0
    return theta


@dataclass(frozen=True)
class Law:
    """The model by one theta: `native` runs the play with derivatives by theta up to TIP; `followed` runs the same play
    with derivatives by the offset and by what is added to B beyond the measured range."""

    grid: Array  # (nodes,) centre coordinates, unit of q
    native: Any
    followed: Any
    width: Array  # (nodes,) B, unit of q
    c_deg: Array  # (nodes,) f_remain
    elements: int = 1  # of the play
    most: float = 1.0  # share of B that the widest element has

    def angle(self, p: npt.ArrayLike) -> Array:
        """f_remain, deg, at centre coordinates p, unit of q, of any shape."""
        return np.asarray(interpolate(p, self.grid, self.c_deg))

    def place(self, c_deg: npt.ArrayLike) -> Array:
        """Centre coordinates, unit of q, at which f_remain is c_deg, of any shape."""
        return interpolate_inverse(c_deg, self.grid, self.c_deg)

    @cached_property
    def _slopes(self) -> Array:
        """(nodes,) df_remain/dp on the grid, deg per unit of q."""
        return np.asarray(np.gradient(self.c_deg, self.grid))

    def slope(self, p: npt.ArrayLike) -> Array:
        """df_remain/dp, deg per unit of q, at centre coordinates p, of any shape."""
        return np.asarray(np.interp(np.asarray(p, dtype=float), self.grid, self._slopes))


@dataclass(frozen=True)
class LawFamily:
    """The calibrated play, with what was seen of it beyond the measured range; `law` makes a play of it by any
    theta."""

    beyond: Beyond
    _laws_by_theta: dict[bytes, Law] = field(default_factory=dict, repr=False)

    @property
    def model(self) -> Model:
        """The model as calibrated, on a grid that goes on beyond the actuator's range."""
        return self.beyond.model

    def with_beyond(self, beyond: Beyond) -> LawFamily:
        """Returns the same family with another posterior beyond the measured range, on the same grid."""
        family = LawFamily(beyond)
        family.__dict__["shape_basis"] = self.shape_basis  # the cached property: it depends on the grid alone
        return family

    @cached_property
    def shape_basis(self) -> Array:
        """(PLACES, nodes) Cardinal natural cubic splines on the grid: each is 1 at one of `places`, 0 at the others,
        and constant beyond the first and the last."""
        places = self.places
        q = np.clip(self.model.q, places[0], places[-1])
        return np.ascontiguousarray(CubicSpline(places, np.eye(PLACES), bc_type="natural")(q).T)

    @cached_property
    def places(self) -> Array:
        """(PLACES,) Centre coordinates at which the shape of B is given, evenly over the measured range, unit of q."""
        return np.linspace(*self.model.measured, PLACES)

    def powers(self, p: npt.ArrayLike) -> Array:
        """Basis (3, n) of f_remain's change at centre coordinates p (n,), unit of q: 1, x and x^2, where x is p scaled
        so that the measured range is -1 .. 1, and held at +-2."""
        low, high = self.places[0], self.places[-1]
        along = np.clip((np.asarray(p) - 0.5 * (low + high)) / (0.5 * (high - low)), -2.0, 2.0)
        return np.stack([np.ones_like(along), along, along**2])

    @cached_property
    def tip_slope(self) -> float:
        """Mean slope of f_remain over the measured range, deg per unit of q; negative where c falls as q rises."""
        low, high = self.places[0], self.places[-1]
        ends = self.model.remaining(np.array([low, high]))
        return float((ends[1] - ends[0]) / (high - low))

    def offset(self, theta: Array) -> float:
        """The whole offset of theta, unit of q: before the play, and behind it, where it is a shift of f_remain."""
        return float(theta[OFFSET] + theta[TIP][0] / self.tip_slope)

    @cached_property
    def _elements(self) -> tuple[Array, Array, Array]:
        """(elements,) each: the widths of the play's elements, in shares of B; what a spread of 1 adds to these; and
        their weights, of sum 1. A single play is split into _LOTS equal elements, whose spread can grow."""
        elements = self.model.elements
        if elements.single:
            away = (2.0 * np.arange(_LOTS) - _LOTS + 1) / _LOTS  # even lots of -1 .. 1: their middles
            return np.ones(_LOTS), away, np.full(_LOTS, 1.0 / _LOTS)
        share = np.array(elements.width)
        return share, share - 1.0, np.array(elements.weight)

    @cached_property
    def _by_spread_and_skew(self) -> Array:
        """(2, elements) Derivatives of `shares` by theta's spread, e, and skew, e^2 less its mean. Both have the
        weighted mean 0, so that the elements' mean share, and B with it, stays."""
        _, away, weight = self._elements  # away: of weighted mean 0
        return np.vstack([away, away**2 - weight @ away**2])

    @cached_property
    def _own_sigma(self) -> Array:
        """(nodes,) Standard deviation, unit of q, of the calibrated law's centre coordinate: half that of B, as an
        envelope lies B/2 off the centre, and the rounding of the encoder."""
        model, count = self.model, self.model.rig.actuator.encoder_resolution
        return np.asarray(np.hypot(0.5 * model.width_sigma, of_rounding(count)))

    def sigma(self, p: npt.ArrayLike, sensor: npt.ArrayLike) -> Array:
        """Standard deviation, unit of q, of a frame's centre coordinate at p: that of the sensor (`sensor`, unit of q)
        and the calibrated law's own in quadrature. The own one counts up to _MOST_OWN times the sensor's, so that what
        a calibration hardly knew is learnt in use."""
        own = np.interp(np.asarray(p, dtype=float), self.model.q, self._own_sigma)
        return np.asarray(np.hypot(sensor, np.minimum(own, _MOST_OWN * np.abs(sensor))))

    def shares(self, theta: Array) -> Array:
        """(elements,) The widths of the play's elements by theta's spread and skew, in shares of B, 0 at least."""
        spread, skew = self._by_spread_and_skew
        return np.asarray(np.maximum(self._elements[0] + theta[SPREAD] * spread + theta[SKEW] * skew, 0.0))

    def clipped(self, theta: Array) -> Array:
        """Returns theta with every parameter within its limits for a play; offset and f_remain's change have none."""
        theta = theta.copy()
        theta[SCALE] = min(max(theta[SCALE], _LEAST_SCALE), _MOST_SCALE)
        theta[SHAPE] = np.clip(theta[SHAPE], _LEAST_SHAPE, _MOST_SHAPE)
        least = 0.0 if self.model.elements.single else _LEAST_SPREAD
        theta[SPREAD] = min(max(theta[SPREAD], least), 1.0)
        theta[SKEW] = min(max(theta[SKEW], -_MOST_SKEW), _MOST_SKEW)
        return theta

    def law(self, theta: Array) -> Law:
        """The law with the parameters theta (PARAMETERS,), which must be within their limits (`clipped`). Laws are
        kept, as a fit asks for each several times; all are forgotten once they are more than _KEPT."""
        key = theta.tobytes()
        if key not in self._laws_by_theta:
            if len(self._laws_by_theta) > _KEPT:
                self._laws_by_theta.clear()
            self._laws_by_theta[key] = self._law_of(theta)
        return self._laws_by_theta[key]

    def _law_of(self, theta: Array) -> Law:
        """Makes the law of theta. Its play `native` gives dp by the offset, by scale and shape (through by_width (1 +
        PLACES, nodes), dB by these), and by spread and skew (through by_shares (2, elements), derivatives of the
        elements' shares, 0 for a single play). `followed` gives dp by the offset and through by_beyond (CURVES, nodes),
        dB by each curve that is added beyond the measured range."""
        model = self.beyond.posterior_model
        shape = 1.0 + theta[SHAPE] @ self.shape_basis
        width = allowed_width(model.q, theta[SCALE] * model.width * shape)
        by_width = np.vstack([model.width * shape, theta[SCALE] * model.width * self.shape_basis])
        c_deg = model.c_deg
        if np.any(theta[TIP]):
            c_deg = self.beyond.monotone(model.c_deg + theta[TIP] @ self.powers(model.q))
        if model.elements.single and not theta[SPREAD] and not theta[SKEW]:
            shares, weight, by_shares = np.ones(1), np.ones(1), np.zeros((2, 1))
        else:
            shares, weight, by_shares = self.shares(theta), self._elements[2], self._by_spread_and_skew
            shares = shares / (weight @ shares)  # B stays the distance between full strokes
        native = _native.TrackModel(model.q, width, shares, weight, by_width, by_shares)
        by_beyond, none = theta[SCALE] * shape * self.beyond.curves_on_grid, np.empty((0, len(shares)))
        followed = _native.TrackModel(model.q, width, shares, weight, by_beyond, none)
        return Law(model.q, native, followed, width, c_deg, len(shares), float(shares.max()))

    def with_frames(
        self, about: LawFamily, law: Law, p: Array, by_width: Array, c_deg: Array, sigma: Array
    ) -> LawFamily:
        """Returns the family after n frames told something beyond the measured range; itself where none did. The tip is
        seen at c_deg (n,), deg, with sigma (n,), deg; `law`, of the family `about`, predicts p (n,), unit of q, with
        derivatives by_width (n, CURVES) by what is added to B. Frames that depend on nothing there do not count."""
        by = np.hstack([self.beyond.curves(p).T, law.slope(p)[:, None] * by_width])  # of c by theta of `beyond`
        # The prediction is linear about the mean of `about`: this is what is left by this family's own mean.
        residual = c_deg - law.angle(p) + by @ (about.beyond.mean - self.beyond.mean)
        told = by.any(1)
        return self.with_beyond(self.beyond.updated(by[told], residual[told], sigma[told])) if told.any() else self

    def gradual_start(self, theta: Array) -> Array:
        """Returns theta as a start for a fit of a gradual onset. Of a single play a spread below _LEAST_GRADUAL becomes
        _GRADUAL, as its derivatives exist only with several elements."""
        theta = theta.copy()
        if self.model.elements.single and theta[SPREAD] < _LEAST_GRADUAL:
            theta[SPREAD] = _GRADUAL
        return theta

    def rescaled(self, theta: Array, scale: float) -> Array:
        """Returns theta with this scale, and its shape changed so that B stays the same, both within their limits."""
        theta = theta.copy()
        theta[SHAPE] = (1.0 + theta[SHAPE]) * theta[SCALE] / scale - 1.0
        theta[SCALE] = scale
        return self.clipped(theta)

    def width_ratio(self, law: Law) -> Array:
        """(nodes,) A law's B over the calibrated one; 1 where the calibrated one is 0."""
        width = self.model.width
        return np.asarray(np.divide(law.width, width, out=np.ones(len(width)), where=width > 0.0))

    def ratio_slopes(self, theta: Array, p: Array) -> Array:
        """(PARAMETERS,) Derivatives by theta of the ratio of B to the calibrated one, its mean over the centre
        coordinates p (n,), unit of q."""
        at = np.array([np.interp(p, self.model.q, wave).mean() for wave in self.shape_basis])
        slopes = np.zeros(PARAMETERS)
        slopes[SCALE] = 1.0 + theta[SHAPE] @ at
        slopes[SHAPE] = theta[SCALE] * at
        return slopes
