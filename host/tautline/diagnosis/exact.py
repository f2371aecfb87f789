"""What a law leaves, frame by frame, beside what another effect leaves.

A law has one equation: nothing but noise is left beside it, and noise no path foretells. So where two hypotheses differ
in a few frames alone, as a lag and a delay do in the one after a turn, these frames tell, however little of a block's
power they are.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from tautline.diagnosis.stacked import CONSTANT, LAWS
from tautline.effects import EVENTS
from tautline.independence import frames_each

Array = npt.NDArray[np.float64]

_REMEMBERED = 100  # tolerance: lags at most
_ALIKE = 0.05  # tolerance: a correlation from which there is none


def is_law(ids: Sequence[str]) -> bool:
    """Whether the hypothesis is of laws, perhaps beside parts of the nominal model, and of nothing else."""
    key = frozenset(ids)
    return bool(key & LAWS) and key <= LAWS | CONSTANT and not key & EVENTS


def likelier(left: Sequence[Array], others: Sequence[Array], limits: Sequence[float], noise: float) -> float:
    """Log-likelihood ratio of Gaussian noise, above 0 where another hypothesis leaves less of held-out blocks
    (`others`) than a law does (`left`): (scored, k) of each recording, px or deg, cut to its one of `limits`. noise:
    one standard deviation of a coordinate."""
    more = [
        np.sum(np.square(np.clip(own, -limit, limit)) - np.square(np.clip(other, -limit, limit)), axis=1)
        for own, other, limit in zip(left, others, limits, strict=True)
    ]
    recording = np.repeat(np.arange(len(more)), [len(one) for one in more])
    score = np.concatenate(more)
    each = frames_each(score, _REMEMBERED, least=_ALIKE, group=recording)
    return float(np.sum(score)) / (2.0 * noise**2 * each)


def chance(likelier_than_law: Sequence[float]) -> float:
    """Probability that the best of so many other hypotheses is so much likelier though the law is right; 1 where none
    is likelier. likelier_than_law: of each, the logarithm that `likelier` gives."""
    surest = max(likelier_than_law, default=0.0)
    return min(1.0, len(likelier_than_law) * float(np.exp(-max(surest, 0.0)))) if surest > 0.0 else 1.0
