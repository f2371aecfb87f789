"""How far a motion is from those that a corrected simulator was fitted to: a Gaussian process of the simulated joint's
place, speed and load, whose variance is nothing where they were and back at the prior's where they never were."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.distance import cdist

from tautline.recording import Motor

Array = npt.NDArray[np.float64]

JITTER = 1e-10  # tolerance: added to the kernel's diagonal, so that it can be factored


@dataclass(frozen=True)
class Discrepancy:
    """A Gaussian process with a squared-exponential kernel, whose variances are over that of the prior, sigma^2."""

    sigma: float  # one standard deviation a priori, in the sensor's unit
    inputs: Array  # (n, d) where it was seen
    lengths: Array  # (d,) in the inputs' units
    white: float  # variance of the white noise

    def sigma_at(self, inputs: Array) -> Array:
        """(m,) One standard deviation, in the sensor's unit, at inputs x (m, d): sigma sqrt(1 - k(x, X) (K + white
        I)^-1 k(X, x)), the Gaussian process' own, where X are the `inputs` and K = k(X, X)."""
        to_seen = kernel(inputs, self.inputs, self.lengths)
        known = np.sum(to_seen * cho_solve(self._factor, to_seen.T).T, axis=1)
        return np.asarray(self.sigma * np.sqrt(np.clip(1.0 - known, 0.0, 1.0)))

    @cached_property
    def _factor(self) -> tuple[Array, bool]:
        """The Cholesky factor (n, n) of the covariance at `inputs`, white noise included, and whether it is the lower
        one, as cho_solve takes them."""
        own = kernel(self.inputs, self.inputs, self.lengths)
        factor, lower = cho_factor(own + (self.white + JITTER) * np.eye(len(self.inputs)), lower=True)
        return factor, bool(lower)

    def to_json(self) -> dict[str, Any]:
        """The fields as plain values, for model.json."""
        arrays = {"inputs": self.inputs.tolist(), "lengths": self.lengths.tolist()}
        return {"sigma": self.sigma, "white": self.white, **arrays}

    @classmethod
    def from_json(cls, told: Mapping[str, Any]) -> Self:
        """Reads what `to_json` gave. KeyError, TypeError or ValueError where it is something else."""
        inputs, lengths = (np.array(told[name], dtype=float) for name in ("inputs", "lengths"))
        found = cls(float(told["sigma"]), inputs, lengths, float(told["white"]))
        if inputs.ndim != 2 or lengths.shape != inputs.shape[1:] or not found._is_possible:
            raise ValueError("a discrepancy's places, lengths or variances are none")
        return found

    @property
    def _is_possible(self) -> bool:
        """Whether all numbers are finite, no variance is negative, and every length is above 0."""
        finite = bool(np.isfinite(self.inputs).all() and np.isfinite([self.sigma, self.white, *self.lengths]).all())
        return finite and bool(self.sigma >= 0.0 and self.white >= 0.0 and (self.lengths > 0.0).all())


def kernel(a: Array, b: Array, lengths: Array) -> Array:
    """(n, m) The squared-exponential kernel exp(-|a - b|^2 / 2) of inputs a (n, d) and b (m, d), each coordinate
    divided by its length in `lengths` (d,)."""
    return np.exp(-0.5 * cdist(a / lengths, b / lengths, "sqeuclidean"))


def states(simulated: Motor, command: Motor, scene_s: Array, span: float) -> Array:
    """(n, 3) The inputs of a Discrepancy at scene times scene_s (n,), s: the simulated joint's place, its speed (1/s)
    and its load, in shares of `span`, the motor's range. The load is its command less its place. simulated: the motor's
    log with the simulated tip's coordinate as q; command: the recorded motor, q_cmd or, without it, q."""
    later = np.diff(simulated.t_s, prepend=-np.inf) > 0.0  # samples of one and the same time tell no speed
    t_s, place = simulated.t_s[later], simulated.q[later] / span
    speed = np.gradient(place, t_s)
    commanded = command.q if command.q_cmd is None else command.q_cmd
    q = np.interp(scene_s, t_s, place)
    load = np.interp(scene_s, command.t_s, commanded) / span - q
    return np.column_stack([q, np.interp(scene_s, t_s, speed), load])
