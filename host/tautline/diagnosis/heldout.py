"""Leave-one-block-out cross-validation of a fit, for every block of manoeuvres by one linear step.

Near its optimum a fit is a linear least-squares problem: leaving block b out moves the parameters by -(N - N_b)^-1 g_b,
where N is the normal matrix of all (with the prior), and N_b and g_b are the block's parts of matrix and gradient. A
share STAYS of the block stays in: what it alone shows of the nominal model (the ends of a range, an axis that moves
in it only) would else be guessed, and says nothing about an effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from tautline.diagnosis.fit import Fitter, ScoredRows
from tautline.diagnosis.fitted import Hypothesis
from tautline.diagnosis.huber import huber_weight
from tautline.nominal import Normal, Rows

Array = npt.NDArray[np.float64]
STAYS = 0.1  # tolerance: share of a block's weight that stays when it is left out
RANK = 1e-10  # tolerance: relative singular value below which a direction of the parameters is dropped
_PER_OBSERVATION = ("p", "tip", "by_width", "by_follow", "by_c", "columns", "residual")  # format: fields of Rows
Labels = Sequence[npt.NDArray[np.int64]]  # (scored,) of each recording: the number of each observation's block


def residuals_and_surprise(
    fitter: Fitter, hypothesis: Hypothesis, rows: Sequence[ScoredRows], labels: Labels, limits: Sequence[float]
) -> tuple[list[Array], list[Array]]:
    """(Held-out residuals (scored, k), surprise (scored,)) of each recording. The former are the residuals of every
    block of manoeuvres by the fit without that block. The latter, px^2 or deg^2 a coordinate over the square of the
    relative noise, is how much the recording as a whole contradicts the fit of the others (`_surprise`); 0 for a
    recording of one block, whose held-out residuals are by the others already. rows: of the fit (Fitter.linearised).
    limits: of each recording, px or deg, beyond which a residual counts linearly (Huber)."""
    matrix = fitter.floor**2 * fitter.prior_precision(hypothesis)
    blocks_of = [
        _blocks_of_recording(fitter, *recording)
        for recording in zip(rows, labels, limits, fitter.relative_noise, strict=True)
    ]
    for blocks in blocks_of:
        for block in blocks:
            matrix += block.normal.matrix
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    normals = [_sum_of([block.normal for block in blocks]) for blocks in blocks_of]
    # A parameter at the end of its range, or a fit that is not yet at its best, has a gradient left in all recordings
    # alike, which is no difference between them: gradients are taken after this step.
    to_optimum = _solution(matrix, _sum_of(normals).gradient, scale)
    held_out, surprise = [], []
    for row, blocks, normal in zip(rows, blocks_of, normals, strict=True):
        residual = row.residual.copy()
        for block in blocks:
            without = matrix - (1.0 - STAYS) * block.normal.matrix
            step = -scale * scaled_solution(without, (1.0 - STAYS) * scale * block.normal.gradient, scale)
            residual[block.in_block] -= fitter.moved(block.rows, step)
        held_out.append(residual)
        single = len(blocks) == 1
        surprise.append(
            np.zeros(len(residual)) if single else _surprise(fitter, row, normal, matrix, scale, to_optimum)
        )
    return held_out, surprise


def _surprise(fitter: Fitter, row: Rows, normal: Normal, matrix: Array, scale: Array, to_optimum: Array) -> Array:
    """(scored,) px^2 or deg^2 a coordinate: g' (N - N_r)^-1 g of one recording r, spread over its observations in
    proportion to the square of what its step (N - N_r)^-1 g changes in the prediction there. It equals e' (I + J (N -
    N_r)^-1 J')^-1 e, the quadratic form of the residuals e by the fit of the others under its marginal prediction (J:
    their derivatives), minus the recording's squares that the fit of all leaves. It is small where the others do not
    determine the parameters that the recording needs, and large where they determine other values. matrix: N, with the
    prior; normal: N_r, with the gradient before the step to_optimum (m,), after which g is taken; scale (m,): of the
    unknowns."""
    gradient = normal.gradient - normal.matrix @ to_optimum
    step = _solution(matrix - normal.matrix, gradient, scale)
    moved = np.sum(fitter.moved(row, step) ** 2, axis=1)
    share = float(step @ gradient) / max(float(moved.sum()), 1e-300) / row.residual.shape[1]
    return np.asarray(max(share, 0.0) * moved)


@dataclass(frozen=True)
class _Block:
    """One block of manoeuvres of a recording, linearised."""

    in_block: npt.NDArray[np.bool_]  # (scored,) which of the recording's observations are in the block
    rows: Rows
    normal: Normal


def _blocks_of_recording(
    fitter: Fitter, row: Rows, label: npt.NDArray[np.int64], limit: float, times: float
) -> list[_Block]:
    """Splits a recording into its blocks, each with its normal equations. label (scored,): the number of each
    observation's block; limit: of Huber's cost, px or deg; times: the recording's relative noise."""
    blocks = []
    for number in np.unique(label):
        in_block = label == number
        rows = _rows_where(row, in_block)
        weight = huber_weight(rows.residual, limit) / times**2
        blocks.append(_Block(in_block, rows, fitter.normal(rows, weight=weight)))
    return blocks


def _solution(matrix: Array, gradient: Array, scale: Array) -> Array:
    """(m,) The solution x of matrix x = gradient, of minimum norm in the scaled unknowns x / scale where it is not
    unique. scale: (m,)."""
    return scale * scaled_solution(matrix, scale * gradient, scale)


def scaled_solution(matrix: Array, scaled_gradient: Array, scale: Array) -> Array:
    """(m,) The solution y of S y = scaled_gradient with S_ij = scale_i matrix_ij scale_j. By Cholesky's factor if its
    smallest pivot tells that S is regular; else by singular values, of minimum norm."""
    scaled = matrix * np.outer(scale, scale)
    with suppress(LinAlgError):
        factored, lower = cho_factor(scaled, check_finite=False)
        if float(np.min(np.diag(factored))) ** 2 > RANK:
            return np.asarray(cho_solve((factored, lower), scaled_gradient, check_finite=False))
    return np.asarray(np.linalg.lstsq(scaled, scaled_gradient, rcond=RANK)[0], dtype=np.float64)


def _sum_of(normals: Sequence[Normal]) -> Normal:
    """The sum of the normal equations: of their matrices, and of their gradients."""
    return Normal(
        np.sum([normal.matrix for normal in normals], axis=0), np.sum([normal.gradient for normal in normals], axis=0)
    )


def _rows_where(row: Rows, mask: npt.NDArray[np.bool_]) -> Rows:
    """The rows of those observations where the mask `here` (scored,) is true."""
    chosen = {name: getattr(row, name)[mask] for name in _PER_OBSERVATION}
    return replace(row, **chosen)
