"""What may have changed since the calibration, and the play that it makes of the model's."""

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
    """The calibrated law: theta (PARAMETERS,) of offset (unit of q, added to it), scale of B, its shape (further shares
    of B at PLACES), spread of the elements' shares about their mean and its skew, and what is added to f_remain."""
    theta = np.zeros(PARAMETERS)
    theta[SCALE] = 1.0
    return theta


@dataclass(frozen=True)
class Law:
    """The model by one theta: `native` runs the play, B is `width` and f_remain `c_deg` on `grid`. `followed` runs the
    same play with derivatives by what is added to B beyond the measured range, instead of those by theta."""

    grid: Array
    native: Any
    followed: Any
    width: Array
    c_deg: Array
    elements: int = 1
    most: float = 1.0  # share of B that the widest of them has

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
    """The calibrated play, of which others are made, with what was seen of it beyond the measured range."""

    beyond: Beyond
    _laws_by_theta: dict[bytes, Law] = field(default_factory=dict, repr=False)

    @property
    def model(self) -> Model:
        """As calibrated, on a grid that goes on beyond the actuator's range."""
        return self.beyond.model

    def with_beyond(self, beyond: Beyond) -> LawFamily:
        """The same family with another posterior beyond the measured range."""
        family = LawFamily(beyond)
        family.__dict__["shape_basis"] = self.shape_basis  # they depend on the grid alone
        return family

    @cached_property
    def shape_basis(self) -> Array:
        """(PLACES, nodes) Cardinal natural cubic splines: 1 at one place, 0 at the others, constant beyond the ends."""
        places = self.places
        q = np.clip(self.model.q, places[0], places[-1])
        return np.ascontiguousarray(CubicSpline(places, np.eye(PLACES), bc_type="natural")(q).T)

    @cached_property
    def places(self) -> Array:
        """(PLACES,) Centre coordinates at which the shape of B is given, evenly over the measured range, unit of q."""
        return np.linspace(*self.model.measured, PLACES)

    def powers(self, p: npt.ArrayLike) -> Array:
        """(3, n) Basis of f_remain's change at p: constant, slope and bend over the measured range scaled to -1 .. 1,
        held at +-2."""
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
        """The law's whole offset, before and behind the play, unit of q."""
        return float(theta[OFFSET] + theta[TIP][0] / self.tip_slope)

    @cached_property
    def _elements(self) -> tuple[Array, Array, Array]:
        """(elements,) each: the widths of the play's elements, in shares of B, what spread adds to them, and their
        weights; a single play is split into _LOTS equal ones, whose spread can grow."""
        elements = self.model.elements
        if elements.single:
            away = (2.0 * np.arange(_LOTS) - _LOTS + 1) / _LOTS
            return np.ones(_LOTS), away, np.full(_LOTS, 1.0 / _LOTS)
        share = np.array(elements.width)
        return share, share - 1.0, np.array(elements.weight)

    @cached_property
    def _by_spread_and_skew(self) -> Array:
        """(2, elements) Derivatives of `shares` by theta's spread and skew. Both have the weighted mean 0, so that the
        elements' mean share, and B with it, stays."""
        _, away, weight = self._elements  # away: of weighted mean 0
        return np.vstack([away, away**2 - weight @ away**2])

    @cached_property
    def _own_sigma(self) -> Array:
        """(nodes,) Standard deviation of the calibrated centre coordinate, unit of q, by B's sigma, of which it has
        half, as an envelope lies B/2 off the centre, and by the encoder's rounding."""
        model, count = self.model, self.model.rig.actuator.encoder_resolution
        return np.asarray(np.hypot(0.5 * model.width_sigma, of_rounding(count)))

    def sigma(self, p: npt.ArrayLike, sensor: npt.ArrayLike) -> Array:
        """Standard deviation, unit of q, of a frame's centre coordinate at p: the sensor's (`sensor`, the same unit)
        and the calibrated law's own, which counts up to _MOST_OWN times the sensor's, so that what a calibration hardly
        knew is learnt in use."""
        own = np.interp(np.asarray(p, dtype=float), self.model.q, self._own_sigma)
        return np.asarray(np.hypot(sensor, np.minimum(own, _MOST_OWN * np.abs(sensor))))

    def shares(self, theta: Array) -> Array:
        """(elements,) Their widths, in shares of B and not negative, by theta's spread and skew."""
        spread, skew = self._by_spread_and_skew
        return np.asarray(np.maximum(self._elements[0] + theta[SPREAD] * spread + theta[SKEW] * skew, 0.0))

    def clipped(self, theta: Array) -> Array:
        """theta with every parameter clipped to what a play can have."""
        theta = theta.copy()
        theta[SCALE] = min(max(theta[SCALE], _LEAST_SCALE), _MOST_SCALE)
        theta[SHAPE] = np.clip(theta[SHAPE], _LEAST_SHAPE, _MOST_SHAPE)
        least = 0.0 if self.model.elements.single else _LEAST_SPREAD
        theta[SPREAD] = min(max(theta[SPREAD], least), 1.0)
        theta[SKEW] = min(max(theta[SKEW], -_MOST_SKEW), _MOST_SKEW)
        return theta

    def law(self, theta: Array) -> Law:
        """The law with the parameters theta (PARAMETERS,), which are within their limits (`clipped`). The last few are
        kept, as a fit asks for each several times."""
        key = theta.tobytes()
        if key not in self._laws_by_theta:
            if len(self._laws_by_theta) > _KEPT:
                self._laws_by_theta.clear()
            self._laws_by_theta[key] = self._law_of(theta)
        return self._laws_by_theta[key]

    def _law_of(self, theta: Array) -> Law:
        """`law`, made anew. Its play `native` gives dp/dtheta up to TIP, from by_width (1 + PLACES, nodes), dB by scale
        and shape, and by_shares (2, elements), the elements' shares' derivatives by spread and skew, 0 for a single
        play; `followed` gives dp by by_beyond (CURVES, nodes), dB by each curve beyond the measured range."""
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
        """The family after n frames told something beyond the measured range. The tip is seen at c_deg (n,), deg, with
        sigma (n,); `law`, of the family `about`, predicts p (n,), with derivatives by_width (n, CURVES) by what is
        added to B. Frames that depend on nothing there do not count."""
        by = np.hstack([self.beyond.curves(p).T, law.slope(p)[:, None] * by_width])
        off = c_deg - law.angle(p) + by @ (about.beyond.mean - self.beyond.mean)
        told = by.any(1)
        return self.with_beyond(self.beyond.updated(by[told], off[told], sigma[told])) if told.any() else self

    def gradual_start(self, theta: Array) -> Array:
        """theta with a small spread of the elements where there is none: its derivatives exist only with several
        elements."""
        theta = theta.copy()
        if self.model.elements.single and theta[SPREAD] < _LEAST_GRADUAL:
            theta[SPREAD] = _GRADUAL
        return theta

    def rescaled(self, theta: Array, scale: float) -> Array:
        """theta with this scale, its shape changed so that B stays the same."""
        theta = theta.copy()
        theta[SHAPE] = (1.0 + theta[SHAPE]) * theta[SCALE] / scale - 1.0
        theta[SCALE] = scale
        return self.clipped(theta)

    def width_ratio(self, law: Law) -> Array:
        """(nodes,) A law's B over the calibrated one; 1 where that is 0."""
        width = self.model.width
        return np.asarray(np.divide(law.width, width, out=np.ones(len(width)), where=width > 0.0))

    def ratio_slopes(self, theta: Array, p: Array) -> Array:
        """(PARAMETERS,) Derivatives by theta of the mean ratio of B to the calibrated one over the places p."""
        at = np.array([np.interp(p, self.model.q, wave).mean() for wave in self.shape_basis])
        slopes = np.zeros(PARAMETERS)
        slopes[SCALE] = 1.0 + theta[SHAPE] @ at
        slopes[SHAPE] = theta[SCALE] * at
        return slopes
