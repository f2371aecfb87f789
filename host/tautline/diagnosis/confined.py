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

from tautline.diagnosis.fit import STATIC_COLUMNS, Fitter, ScoredRows
from tautline.diagnosis.fitted import Fit
from tautline.diagnosis.segment import Segment
from tautline.effects import Kind
from tautline.geometry import across

Array = npt.NDArray[np.float64]

_LENS_ORDER = 5  # prior: of polynomials over the image
_PLANE_ORDER = 5  # prior: and over the bending angle
_MOST_COLUMNS = 192  # tolerance: of a fit that is continued: more would take seconds
_TRAVELS = (0.003, 0.01, 0.03)  # prior: of the motor's range, in which an instrument settles in its channel


def residuals(fitter: Fitter, fit: Fit, further: Sequence[Kind] = ()) -> list[Array] | None:
    """For each recording, px: the residual's part that no law of the effects' stages could leave, each stage's freedom
    fitted; (scored, 2), or (scored, 1) across the image motion that a free angle or time causes. None where they could
    leave anything (no camera, no effect, angle and time both free). further: effects allowed besides, not fitted."""
    kinds = (*fit.hypothesis.kinds, *further)
    if not fitter.px or not kinds:
        return None
    along = any(kind.through_angle for kind in kinds)
    timed = any(kind.leaves == "time" for kind in kinds)
    if along and timed:
        return None
    rows = _with_stage_freedom(fitter, fit)
    if not (along or timed):
        return fitter.left(rows) if rows[0].columns.shape[2] <= _MOST_COLUMNS else None
    directions = [row.by_c for row in rows] if along else [_velocity(s) for s in fitter.segments]
    parts = [(across(row.residual, way), across(row.columns, way)) for row, way in zip(rows, directions, strict=True)]
    columns = np.concatenate([part[1] for part in parts])
    size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    seen = np.concatenate([part[0] for part in parts])
    step = np.linalg.lstsq(columns / size, seen, rcond=1e-9)[0] / size
    return [(left - moved @ step)[:, None] for left, moved in parts]


def _with_stage_freedom(fitter: Fitter, fit: Fit) -> list[ScoredRows]:
    """The fit's rows with the columns of what the stages of its effects could leave (lens, plane, channel); those of
    effects that came later are zero in the calibration. The effects' own parameters are free, too: an inexact law has
    biased them."""
    rows = fitter.linearised(fit)
    scopes = list(zip(fit.hypothesis.kinds, fit.hypothesis.scopes, strict=True))
    for what, freedom in _FREEDOM.items():
        since = [scope for kind, scope in scopes if kind.leaves == what]
        if since:
            later = all(since)
            rows = [
                replace(row, columns=np.concatenate([row.columns, more * (not (later and s.calibration))], axis=2))
                for s, row, more in zip(fitter.segments, rows, freedom(fitter, rows), strict=True)
            ]
    return rows


def _velocity(segment: Segment) -> Array:
    """Image velocity of the scored observations, (scored, 2) px/s."""
    velocity: Array = np.gradient(segment.observed, segment.arrival_s, axis=0)
    return velocity[segment.scored]


def _lens(fitter: Fitter, rows: Sequence[ScoredRows]) -> list[Array]:
    """Freedom of a lens: columns (n, 2, m), Chebyshev polynomials of the predicted image position for either coordinate
    (the observed position has noise in it)."""
    seen = [s.observed[s.scored] - row.residual for s, row in zip(fitter.segments, rows, strict=True)]
    low, high = (f([f(x, axis=0) for x in seen], axis=0) for f in (np.min, np.max))
    columns = []
    for x in seen:
        u, v = (2.0 * (x - low) / np.maximum(high - low, 1e-9) - 1.0).T
        of_u, of_v = (np.polynomial.chebyshev.chebvander(c, _LENS_ORDER) for c in (u, v))
        terms = [of_u[:, i] * of_v[:, j] for i in range(_LENS_ORDER + 1) for j in range(_LENS_ORDER + 1 - i)]
        columns.append(np.einsum("nm,kl->nkml", np.column_stack(terms), np.eye(2)).reshape(len(x), 2, -1))
    return columns


def _plane(fitter: Fitter, rows: Sequence[ScoredRows]) -> list[Array]:
    """Freedom of another curvature within the bending plane: the plane's two directions in the image, each times
    polynomials of the bending angle, (n, 2, m)."""
    angles = [row.path.c_deg[s.scored] for s, row in zip(fitter.segments, rows, strict=True)]
    low, high = min(float(c.min()) for c in angles), max(float(c.max()) for c in angles)
    columns = []
    for segment, row, c in zip(fitter.segments, rows, angles, strict=True):
        # px per mm that the registration is shifted along x, y and z, (n, 2) each
        x, y, z = np.moveaxis(row.columns[:, :, STATIC_COLUMNS], 2, 0)[3:6]
        roll = row.path.rotation_deg
        turned = np.zeros(len(c)) if roll is None else np.radians(roll[segment.scored])
        sideways = np.cos(turned)[:, None] * x + np.sin(turned)[:, None] * y
        of_c = np.polynomial.chebyshev.chebvander(2.0 * (c - low) / max(high - low, 1e-9) - 1.0, _PLANE_ORDER)
        columns.append(np.concatenate([sideways[:, :, None] * of_c[:, None], z[:, :, None] * of_c[:, None]], axis=2))
    return columns


def _channel(fitter: Fitter, rows: Sequence[ScoredRows]) -> list[Array]:
    """Freedom of an instrument that rocks in its channel: rigid motions that depend on the direction and decay
    exponentially with the travel since the last reversal, (n, 2, m)."""
    columns = []
    for segment, row in zip(fitter.segments, rows, strict=True):
        step = np.diff(row.path.p, prepend=row.path.p[0])
        way = np.sign(step)
        last = np.maximum.accumulate(np.where(way != 0, np.arange(len(way)), 0))
        way = way[last]
        turn = np.maximum.accumulate(np.where(np.diff(way, prepend=way[0]) != 0, np.arange(len(way)), 0))
        travel = np.abs(row.path.p - row.path.p[np.maximum(turn - 1, 0)]) / fitter.model.rig.actuator.span
        settles = [np.exp(-travel / reach) for reach in _TRAVELS]
        law = np.column_stack([np.ones(len(way)), way, *(way * s for s in settles)])[segment.scored]
        motions = row.columns[:, :, STATIC_COLUMNS]
        columns.append(np.einsum("nki,nj->nkij", motions, law).reshape(len(law), motions.shape[1], -1))
    return columns


_FREEDOM = {"lens": _lens, "plane": _plane, "channel": _channel}
