"""A sensor that rounds: while the tip rests, all of its values are off by the same, and say little more than one."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tautline.calibration.observations import Track
from tautline.independence import stretches

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_STEADY = 0.1  # tolerance: of a step: rounding's errors of two values so near to each other are alike by half and more
_FEW = 30  # tolerance: neighbours that tell a scatter
_NOISE = np.linspace(0.0, 1.0, 101)  # tolerance: in steps, before it is rounded: of more rounding adds white noise
_K = np.arange(1, 50)  # tolerance: terms of a sawtooth's series
_SHARED = np.exp(-((2.0 * np.pi * np.outer(_NOISE, _K)) ** 2)) @ (0.5 / (np.pi * _K) ** 2)
_OWN = _NOISE**2 + _SHARED[0] - _SHARED


def resting(track: Track, seen: Array) -> Mask:
    """(n - 1,) whether the tip rests from one frame to the next, for a sensor that rounds. seen (n, channels): where a
    model has the tip, the sensor's unit."""
    return np.asarray((np.abs(np.diff(seen, axis=0)) < _STEADY * track.step).all(axis=1))


def shared_variance(track: Track, rests: Mask) -> float:
    """Variance, the sensor's unit squared, of the error that frames of one rest share, by how much these still scatter
    (own^2). With Gaussian noise of standard deviation s before it is rounded, in steps and with Fourier's series of a
    sawtooth: shared^2 = sum exp(-(2 pi k s)^2) / (2 pi^2 k^2), own^2 = s^2 + 1/12 - shared^2. rests: as `resting` gives
    them; by more than a step a resting tip is not off."""
    inner = rests[1:-1] & rests[:-2] & rests[2:]  # when a rest ends is known to a frame only
    if np.count_nonzero(inner) < _FEW:
        return 0.0
    apart = np.clip(np.diff(track.y, axis=0)[1:-1][inner] / track.step, -1.0, 1.0)
    return track.step**2 * float(np.interp(0.5 * np.mean(apart**2), _OWN, _SHARED))


def independence_weights(track: Track, seen: Array, use: Mask, scale: float) -> Array:
    """(n,) As how much of an independent frame each one counts, 1 at most: n frames of one rest know the tip's place to
    own^2 / n + shared^2. own^2 is all else that is left of them, in a fit that leaves `scale` times the noise: its
    misfit is no rounding. use (n,): frames that the fit has."""
    every, rests = np.ones(len(seen)), resting(track, seen)
    shared2, left2 = shared_variance(track, rests), (max(scale, 1.0) * float(np.median(track.sigma))) ** 2
    for rest in stretches(rests):
        frames = slice(rest.start, rest.stop + 1)
        many = max(int(np.count_nonzero(use[frames])), 1)
        every[frames] = left2 / (left2 + (many - 1) * shared2)
    return every
