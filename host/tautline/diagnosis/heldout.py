"""What a fit leaves on a block of manoeuvres that it did not see, for every block from one fit.

Near its optimum a fit is a linear least-squares problem: leaving a block out moves the parameters by -(N - N_b)^-1
g_b, where N_b and g_b are the block's own parts of the normal matrix and of the gradient. A share of the block stays
in: what it alone shows of the nominal model (the ends of a range, an axis that moves in it only) says nothing about
an effect, and would else be guessed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from tautline.diagnosis.fit import Fitter, ScoredRows
from tautline.diagnosis.fitted import Hypothesis
from tautline.nominal import Normal, Rows

Array = npt.NDArray[np.float64]
_STAYS = 0.1  # tolerance: of a block that is left out
_PER_OBSERVATION = ("p", "tip", "by_width", "by_follow", "by_c", "columns", "residual")
Labels = Sequence[npt.NDArray[np.int64]]  # of each recording's scored observations: the number of their block


def residuals(
    fitter: Fitter, hypothesis: Hypothesis, rows: Sequence[ScoredRows], labels: Labels, limits: Sequence[float]
) -> list[Array]:
    """(scored, k) for each recording: the residual of every block of manoeuvres by the fit without that block. rows: of
    the fit (Fitter.linearised). limits: of each recording, beyond which an observation counts linearly."""
    return residuals_and_surprise(fitter, hypothesis, rows, labels, limits)[0]


def residuals_and_surprise(
    fitter: Fitter, hypothesis: Hypothesis, rows: Sequence[ScoredRows], labels: Labels, limits: Sequence[float]
) -> tuple[list[Array], list[Array]]:
    """As `residuals`; and (scored,) for each recording, px^2 or deg^2 a coordinate: how much the recording as a whole
    surprises the fit of all others. Of the quadratic form of what that fit leaves, by its marginal prediction, it is
    what the fit of all does not leave, g' (N - N_r)^-1 g with the recording's own normal equations N_r and g at the fit
    of all: nothing where the others do not tell the parameters that it needs, and much where they tell others. It is
    put where it moves the prediction; 0 of a recording of one block."""
    matrix = fitter.floor**2 * fitter.prior_precision(hypothesis)
    parts: list[list[tuple[npt.NDArray[np.bool_], Rows, Normal]]] = []
    for row, label, limit in zip(rows, labels, limits, strict=True):
        parts.append([])
        for number in np.unique(label):
            here = label == number
            block = _rows_where(row, here)
            weight = np.minimum(1.0, limit / np.maximum(np.abs(block.residual), 1e-12))
            normal = fitter.normal(block, weight=weight)
            matrix += normal.matrix
            parts[-1].append((here, block, normal))
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    whole = [_sum_of([normal for _, _, normal in blocks]) for blocks in parts]
    together = _sum_of(whole)
    # A parameter at the end of its range, or a fit that is not yet at its best, pulls on in all recordings: no two of
    # them differ for that.
    onward = scale * np.linalg.lstsq(matrix * np.outer(scale, scale), scale * together.gradient, rcond=1e-10)[0]
    result, surprise = [], []
    for row, blocks, own in zip(rows, parts, whole, strict=True):
        left = row.residual.copy()
        for here, block, normal in blocks:
            rest = (matrix - (1.0 - _STAYS) * normal.matrix) * np.outer(scale, scale)
            step = -scale * np.linalg.lstsq(rest, (1.0 - _STAYS) * scale * normal.gradient, rcond=1e-10)[0]
            left[here] -= fitter.moved(block, step)
        result.append(left)
        if len(blocks) == 1:  # what is left of it is by a fit that saw nothing else of its recording
            surprise.append(np.zeros(len(left)))
            continue
        gradient = own.gradient - own.matrix @ onward
        rest = (matrix - own.matrix) * np.outer(scale, scale)
        step = scale * np.linalg.lstsq(rest, scale * gradient, rcond=1e-10)[0]
        moved = np.sum(fitter.moved(row, step) ** 2, axis=1)
        each = float(step @ gradient) / max(float(moved.sum()), 1e-300) / left.shape[1]
        surprise.append(max(each, 0.0) * moved)
    return result, surprise


def _sum_of(normals: Sequence[Normal]) -> Normal:
    """Their normal equations together."""
    return Normal(
        np.sum([normal.matrix for normal in normals], axis=0), np.sum([normal.gradient for normal in normals], axis=0)
    )


def _rows_where(row: Rows, here: npt.NDArray[np.bool_]) -> Rows:
    """The rows of the observations where the mask is true."""
    chosen = {name: getattr(row, name)[here] for name in _PER_OBSERVATION}
    return replace(row, **chosen)
