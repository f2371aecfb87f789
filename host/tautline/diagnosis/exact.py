"""Whether noise alone explains that another effect leaves less than a law does, frame by frame.

A law (`Kind.law`: rigid motion, time) has one exact equation, so the right law leaves nothing but noise, which no other
path can predict. Where two hypotheses differ in a few frames alone, as a lag and a delay do in the one after a turn,
the Gaussian likelihood of all frames tells them apart, though these frames are hardly anything of a block's power.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from tautline.diagnosis.stacked import CONSTANT, LAWS
from tautline.effects import EVENTS
from tautline.independence import frames_each

Array = npt.NDArray[np.float64]

_LONGEST_LAG = 100  # tolerance: frames over which the autocorrelation is summed at most
_UNCORRELATED = 0.05  # tolerance: autocorrelation at which the sum ends


def is_law(ids: Sequence[str]) -> bool:
    """Whether the effects with these ids are laws without events, at least one, with nothing beside them but parts of
    the nominal model."""
    key = frozenset(ids)
    return bool(key & LAWS) and key <= LAWS | CONSTANT and not key & EVENTS


def log_likelihood_ratio(
    by_law: Sequence[Array], by_other: Sequence[Array], limits: Sequence[float], noise: float
) -> float:
    """log p(residuals of another hypothesis) / p(those of a law), both as Gaussian noise: sum(r_law^2 - r_other^2) / (2
    noise^2 n), positive where the other hypothesis leaves less. n is the number of successive frames that count as one,
    by the terms' autocorrelation. by_law, by_other: held-out residuals (scored, k) of each recording, px or deg, which
    are cut to the recording's limit in `limits`. noise: one standard deviation of a coordinate."""
    terms = [
        np.sum(np.square(np.clip(law, -limit, limit)) - np.square(np.clip(other, -limit, limit)), axis=1)
        for law, other, limit in zip(by_law, by_other, limits, strict=True)
    ]
    recording = np.repeat(np.arange(len(terms)), [len(of_frames) for of_frames in terms])
    all_terms = np.concatenate(terms)
    frames_per_independent = frames_each(all_terms, _LONGEST_LAG, least=_UNCORRELATED, group=recording)
    return float(np.sum(all_terms)) / (2.0 * noise**2 * frames_per_independent)


def chance(log_ratios: Sequence[float]) -> float:
    """Upper bound, at most 1, of the probability that noise alone makes the largest of these log-likelihood ratios
    against a right law: n exp(-largest) for n other hypotheses, as P(ratio > x) <= 1/x for each; 1 if none is positive.
    log_ratios: as `log_likelihood_ratio` gives them."""
    largest = max(log_ratios, default=0.0)
    return min(1.0, len(log_ratios) * float(np.exp(-largest))) if largest > 0.0 else 1.0
