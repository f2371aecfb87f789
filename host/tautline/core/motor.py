"""Where a motor was: made of its readings in one place, for calibration, predict, diagnosis and exports."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
import numpy.typing as npt

from tautline import _native
from tautline.driven import Driven
from tautline.encoder import between_counts, cut, posterior_of, reading_noise, straight_lines
from tautline.recording import Motor

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MotorPath:
    """q(t) as straight lines between knots, held before the first and after the last; other axes ride along."""

    readings: Motor  # up to the horizon
    lines: Motor  # the knots
    posterior: Driven | None = None  # that the knots are of; see `posterior_of`

    @classmethod
    def of(cls, readings: Motor, resolution: float, until_s: float = np.inf) -> Self:
        """The path by the readings up to the time until_s, s. The same readings give the same path. resolution: the
        encoder's step, unit of q."""
        known = readings if until_s >= readings.t_s[-1] else cut(readings, until_s)
        return cls(known, straight_lines(known, resolution), posterior_of(known, resolution))

    @classmethod
    def closely(cls, readings: Motor, resolution: float) -> Self:
        """The path with a knot at every reading, for estimates that average over thousands of them: without a posterior
        the few knots of `of` are off by up to a count where the motor slows down, also in the mean."""
        return cls(readings, between_counts(readings, resolution), posterior_of(readings, resolution))

    def at(self, t_s: Array) -> Array:
        """q at times t_s, s, of any shape; same shape."""
        return np.asarray(_native.lines_at(t_s.ravel(), self.lines.t_s, self.lines.q).reshape(t_s.shape))

    @cached_property
    def sampled(self) -> Motor:
        """The motor at its readings' times, each position being the path's."""
        return replace(self.readings, q=self.at(self.readings.t_s))

    @cached_property
    def noise(self) -> float:
        """Standard deviation of white noise on the path's own positions at the readings' times (`reading_noise` of
        `sampled`), unit of q: what of the readings' noise is left in the path."""
        return reading_noise(self.sampled)

    def course(self, from_s: float, to_s: float) -> tuple[Array, Array]:
        """The path from one time to another, both s and included: times t_s, s, and positions q, (n,) each, with
        straight lines between them."""
        ends, knots = np.array([from_s, to_s]), self.lines.t_s
        inner = slice(np.searchsorted(knots, from_s, side="right"), np.searchsorted(knots, to_s))
        q = self.at(ends)
        return (
            np.concatenate([ends[:1], knots[inner], ends[1:]]),
            np.concatenate([q[:1], self.lines.q[inner], q[1:]]),
        )

    def others_at(self, t_s: Array) -> tuple[Array, Array]:
        """Translation, mm, and rotation, deg, at times t_s (n,), s, (n,) each; 0 where they are not recorded."""
        columns = self.lines.translation_mm, self.lines.rotation_deg
        translation, rotation = (
            np.zeros_like(t_s) if values is None else np.asarray(np.interp(t_s, self.lines.t_s, values))
            for values in columns
        )
        return translation, rotation

    def sigma_at(self, t_s: Array) -> Array:
        """(n,) One standard deviation of q at times t_s (n,), s, unit of q: the posterior's if there is one, else
        `sigma`."""
        if self.posterior is None:
            return np.full(np.shape(t_s), self.sigma)
        return np.asarray(np.interp(t_s, self.posterior.t_s, self.posterior.sigma))

    @cached_property
    def sigma(self) -> float:
        """One standard deviation of q(t), unit of q: the rms of the readings about the lines, times sqrt(knots /
        readings), as each line averages over its readings. It does not hold how far straight lines are from a curved
        path: up to a count, or what no camera sees."""
        left = float(np.sqrt(np.mean((self.readings.q - self.at(self.readings.t_s)) ** 2)))
        return left * float(np.sqrt(min(len(self.lines.t_s) / len(self.readings.t_s), 1.0)))
