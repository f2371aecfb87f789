"""A sensor that rounds to a step: while the tip rests, all frames have the same rounding error, so that many frames
tell little more than one. That error is shared by the frames of one rest; the own error is the part that differs from
frame to frame."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tautline.calibration.observations import Mask, Track
from tautline.independence import stretches

Array = npt.NDArray[np.float64]

_STEADY = 0.1  # tolerance: of a step: rounding's errors of two values so near to each other are alike by half and more
_FEW = 30  # tolerance: neighbours that tell a scatter
_NOISE = np.linspace(0.0, 1.0, 101)  # tolerance: in steps, before it is rounded: of more rounding adds white noise
_K = np.arange(1, 50)  # tolerance: terms of a sawtooth's series
# Variances, in steps^2, that frames of one rest share and that are their own, at each of _NOISE (`shared_variance`).
_SHARED = np.exp(-((2.0 * np.pi * np.outer(_NOISE, _K)) ** 2)) @ (0.5 / (np.pi * _K) ** 2)
_OWN = _NOISE**2 + _SHARED[0] - _SHARED


def resting(track: Track, seen: Array) -> Mask:
    """(n - 1,) whether the tip rests from one frame to the next: its position by the model, seen (n, channels),
    sensor's unit, changes by less than _STEADY of a step in each channel, so that both frames have much the same
    rounding error."""
    return np.asarray((np.abs(np.diff(seen, axis=0)) < _STEADY * track.step).all(axis=1))


def shared_variance(track: Track, rests: Mask) -> float:
    """Variance, sensor's unit squared, of the rounding error that all frames of one rest share. It follows from how
    much these still differ (own^2), by tables for Gaussian noise of standard deviation s before rounding; in steps, by
    the Fourier series of a sawtooth: shared^2 = sum_k exp(-(2 pi k s)^2) / (2 pi^2 k^2), own^2 = s^2 + 1/12 - shared^2.
    rests (n - 1,): as `resting` gives them. 0 with fewer than _FEW pairs of frames well inside rests."""
    inner = rests[1:-1] & rests[:-2] & rests[2:]  # when a rest ends is known to a frame only
    if np.count_nonzero(inner) < _FEW:
        return 0.0
    apart = np.clip(np.diff(track.y, axis=0)[1:-1][inner] / track.step, -1.0, 1.0)
    # Half the mean squared difference is own^2, in steps^2: what frames share cancels.
    return track.step**2 * float(np.interp(0.5 * np.mean(apart**2), _OWN, _SHARED))


def independence_weights(track: Track, seen: Array, use: Mask, scale: float) -> Array:
    """(n,) weights of the frames of a sensor that rounds: own^2 / (own^2 + (m - 1) shared^2) for each of the m frames
    of one rest, 1 while the tip moves. Together the m frames then tell the tip's place with variance own^2 / m + (1 - 1
    / m) shared^2. own is taken as what the fit leaves, `scale` times the noise; it holds one frame's share of shared^2.
    seen (n, channels): positions by the model; use (n,): frames that the fit has."""
    weight, rests = np.ones(len(seen)), resting(track, seen)
    shared2, own2 = shared_variance(track, rests), (max(scale, 1.0) * float(np.median(track.sigma))) ** 2
    for rest in stretches(rests):
        frames = slice(rest.start, rest.stop + 1)  # a rest is of steps between frames: one frame more
        many = max(int(np.count_nonzero(use[frames])), 1)
        weight[frames] = own2 / (own2 + (many - 1) * shared2)
    return weight
