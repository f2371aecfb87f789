"""What a fit leaves that no law of its effects' stages could leave, whatever their equations.

No model of an effect is exact, but its error is confined to its own stage. What moves the tip through the bending angle
(actuator, transmission, configuration) shifts the image along d image / dc and nowhere else; a bending section that is
curved otherwise keeps the tip in its plane, at a place that the angle tells; an instrument that rocks in its channel is
a rigid body that settles after a reversal; a lens shifts the image by a function of where it is; unsteady frame times
shift it along its velocity; a rigid transform and a delay have one equation. What is left beyond that is the camera's
noise, or another cause.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from tautline.diagnosis.fit import MOVE_COLUMNS, STATIC_COLUMNS, Fitter, ScoredRows
from tautline.diagnosis.fitted import Fit
from tautline.diagnosis.segment import Segment
from tautline.effects import Kind
from tautline.geometry import across

Array = npt.NDArray[np.float64]

_LENS_ORDER = 5  # prior: total degree of the polynomials over the image
_PLANE_ORDER = 5  # prior: degree of the polynomials over the bending angle
_MOST_COLUMNS = 192  # tolerance: unknowns of a fit with stage freedom: more would take seconds
_TRAVELS = (0.003, 0.01, 0.03, 0.1)  # prior: decay lengths, in shares of the motor's range, of settling in the channel
_RANK = 1e-9  # tolerance: relative singular value below which a direction of the unknowns is dropped


def residuals(fitter: Fitter, fit: Fit, further: Sequence[Kind] = ()) -> list[Array] | None:
    """For each recording the residual, px, that is left after fitting everything that the stages of the fit's effects
    could leave, whatever their laws. It is (scored, 2); where the bending angle or the time is free at every frame,
    only its component across the image motion that this causes, (scored, 1). None where the stages could leave anything
    (no camera, no effect, or angle and time both free), or where the unknowns, with angle and time not free, are more
    than _MOST_COLUMNS. further: effects that are not fitted but may free the angle or the time too."""
    kinds = (*fit.hypothesis.kinds, *further)
    if not fitter.px or not kinds:
        return None
    angle_is_free = any(kind.through_angle for kind in kinds)
    time_is_free = any(kind.leaves == "time" for kind in kinds)
    if angle_is_free and time_is_free:
        return None
    rows = _with_stage_freedom(fitter, fit)
    if not (angle_is_free or time_is_free):
        return fitter.residuals_after_step(rows) if rows[0].columns.shape[2] <= _MOST_COLUMNS else None
    directions = [row.by_c for row in rows] if angle_is_free else [_image_velocity(s) for s in fitter.segments]
    return _residuals_across(rows, directions)


def _residuals_across(rows: Sequence[ScoredRows], directions: Sequence[Array]) -> list[Array]:
    """(scored, 1) px for each recording: the residual's component across the given image directions (scored, 2), after
    a least-squares fit of the rows' columns to this component alone. Columns are scaled to unit norm first, as their
    units differ."""
    parts = [
        (across(row.residual, direction), across(row.columns, direction))
        for row, direction in zip(rows, directions, strict=True)
    ]
    columns = np.concatenate([part[1] for part in parts])
    norm = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    residual = np.concatenate([part[0] for part in parts])
    step = np.linalg.lstsq(columns / norm, residual, rcond=_RANK)[0] / norm
    return [(before - slopes @ step)[:, None] for before, slopes in parts]


def _with_stage_freedom(fitter: Fitter, fit: Fit) -> list[ScoredRows]:
    """The rows of the fit, linearised, with further columns for whatever the stages of its effects could leave (lens,
    plane, channel). These columns are zero in the calibration where all effects of that stage came later. The effects'
    own parameters are free again, as an inexact law has biased them."""
    rows = fitter.linearised(fit)
    scopes = list(zip(fit.hypothesis.kinds, fit.hypothesis.scopes, strict=True))
    for stage_freedom, columns_of in _FREEDOM.items():
        since = [scope for kind, scope in scopes if kind.leaves == stage_freedom]
        if since:
            came_later = all(since)
            present = [not (came_later and s.calibration) for s in fitter.segments]
            rows = [
                replace(row, columns=np.concatenate([row.columns, added * is_present], axis=2))
                for row, added, is_present in zip(rows, columns_of(fitter, rows), present, strict=True)
            ]
    return rows


def _image_velocity(segment: Segment) -> Array:
    """Velocity of the observed marker in the image at the scored observations, (scored, 2) px/s."""
    velocity: Array = np.gradient(segment.observed, segment.arrival_s, axis=0)
    return velocity[segment.scored]


def _lens_columns(fitter: Fitter, rows: Sequence[ScoredRows]) -> list[Array]:
    """Columns (scored, 2, m) for each recording of any smooth lens distortion: Chebyshev products T_i(u) T_j(v), i + j
    <= _LENS_ORDER, once for either coordinate. u, v: the predicted image position, scaled to -1 .. 1 over all
    recordings (the observed one has noise in it)."""
    seen = [s.observed[s.scored] - row.residual for s, row in zip(fitter.segments, rows, strict=True)]
    low, high = (f([f(x, axis=0) for x in seen], axis=0) for f in (np.min, np.max))
    columns = []
    for x in seen:
        u, v = (2.0 * (x - low) / np.maximum(high - low, 1e-9) - 1.0).T
        of_u, of_v = (np.polynomial.chebyshev.chebvander(c, _LENS_ORDER) for c in (u, v))
        terms = [of_u[:, i] * of_v[:, j] for i in range(_LENS_ORDER + 1) for j in range(_LENS_ORDER + 1 - i)]
        columns.append(np.einsum("nm,kl->nkml", np.column_stack(terms), np.eye(2)).reshape(len(x), 2, -1))
    return columns


def _plane_columns(fitter: Fitter, rows: Sequence[ScoredRows]) -> list[Array]:
    """Columns (scored, 2, m) for each recording of a tip displaced within its bending plane: the image of a move
    sideways in the plane and of one along the axis, each times Chebyshev polynomials of the bending angle up to degree
    _PLANE_ORDER."""
    angles = [row.path.c_deg[s.scored] for s, row in zip(fitter.segments, rows, strict=True)]
    low, high = min(float(c.min()) for c in angles), max(float(c.max()) for c in angles)
    columns = []
    for segment, row, c in zip(fitter.segments, rows, angles, strict=True):
        x, y, z = np.moveaxis(row.columns[:, :, MOVE_COLUMNS], 2, 0)  # (scored, 2) each
        # The tip bends in the x-z plane, turned about z by the roll.
        roll_deg = row.path.rotation_deg
        roll = np.zeros(len(c)) if roll_deg is None else np.radians(roll_deg[segment.scored])
        sideways = np.cos(roll)[:, None] * x + np.sin(roll)[:, None] * y
        of_c = np.polynomial.chebyshev.chebvander(2.0 * (c - low) / max(high - low, 1e-9) - 1.0, _PLANE_ORDER)
        columns.append(np.concatenate([sideways[:, :, None] * of_c[:, None], z[:, :, None] * of_c[:, None]], axis=2))
    return columns


def _channel_columns(fitter: Fitter, rows: Sequence[ScoredRows]) -> list[Array]:
    """Columns (scored, 2, m) for each recording of an instrument that rocks in its channel: the six rigid motions, each
    times 1, s and s exp(-travel / L) for each L of _TRAVELS, in which s = +-1 is the direction of motion, and travel
    the way of the play's centre p since the last reversal, as a share of the motor's range."""
    columns = []
    for segment, row in zip(fitter.segments, rows, strict=True):
        p = row.path.p
        index = np.arange(len(p))
        direction = np.sign(np.diff(p, prepend=p[0]))
        last_moving = np.maximum.accumulate(np.where(direction != 0, index, 0))
        direction = direction[last_moving]  # at rest the direction of the motion before
        # The first sample of each motion; the tip turned at the one before it.
        reversal = np.maximum.accumulate(np.where(np.diff(direction, prepend=direction[0]) != 0, index, 0))
        travel = np.abs(p - p[np.maximum(reversal - 1, 0)]) / fitter.model.rig.actuator.span
        settling = [np.exp(-travel / length) for length in _TRAVELS]
        law = np.column_stack([np.ones(len(p)), direction, *(direction * decay for decay in settling)])[segment.scored]
        motions = row.columns[:, :, STATIC_COLUMNS]
        columns.append(np.einsum("nki,nj->nkij", motions, law).reshape(len(law), motions.shape[1], -1))
    return columns


_FREEDOM = {"lens": _lens_columns, "plane": _plane_columns, "channel": _channel_columns}  # by `Kind.leaves`
