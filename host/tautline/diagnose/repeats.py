"""Whether a residual repeats: what a model could still predict, whatever its equations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from tautline.diagnose import gap
from tautline.diagnose.segment import Segment

Array = npt.NDArray[np.float64]

_ASKED, _USED = 60, 6


def share(segments: Sequence[Segment], residuals: Sequence[Array]) -> float:
    """Of the power, 0 to 1, that the _USED nearest observations from other manoeuvres predict: near in motor
    position, travel since the reversal, direction, speed and the other axes. Scatter without a path gives 0."""
    inputs, seen, manoeuvres, count = [], [], [], 0
    for segment, residual in zip(segments, residuals, strict=True):
        inputs.append(features(segment)[segment.scored])
        seen.append(residual)
        block = gap.blocks(segment)
        manoeuvres.append(block + count)
        count += int(block.max(initial=0)) + 1
    if count < 2:
        return 0.0
    where, values, manoeuvre = np.concatenate(inputs), np.concatenate(seen), np.concatenate(manoeuvres)
    near = np.asarray(cKDTree(where).query(where, k=min(_ASKED, len(where)))[1])
    other = manoeuvre[near] != manoeuvre[:, None]
    used = other & (np.cumsum(other, axis=1) <= _USED)
    full = used.sum(axis=1) == _USED
    if full.sum() < 50:
        return 0.0
    said = np.sum(values[near[full]] * used[full][:, :, None], axis=1) / _USED
    left = float(np.sum((values[full] - said) ** 2)) / (1.0 + 1.0 / _USED)  # the mean of _USED scatters itself
    return float(np.clip(1.0 - left / max(float(np.sum(values[full] ** 2)), 1e-300), 0.0, 1.0))


def features(segment: Segment) -> Array:
    """(n, 6) in units in which a neighbour at distance 0.05 behaves alike."""
    motor, t = segment.motor, segment.arrival_s
    span = float(np.ptp(motor.q)) or 1.0
    q = np.interp(t, motor.t_s, motor.q) / span
    step = np.diff(motor.q)
    way = np.sign(step)
    turning = np.flatnonzero(way != 0)
    turns = turning[1:][np.diff(way[turning]) != 0]
    last = np.searchsorted(motor.t_s[turns], t, side="right") - 1
    start = np.where(last >= 0, motor.q[turns][np.maximum(last, 0)] if len(turns) else motor.q[0], motor.q[0]) / span
    travel = np.minimum(np.abs(q - start), 0.3)
    rate = np.gradient(q, t) if len(t) > 1 else np.zeros_like(q)
    fastest = max(float(np.abs(rate).max()), 1e-12)
    columns = [q, 2.0 * travel, 0.2 * np.sign(q - start), 0.3 * np.abs(rate) / fastest]
    for values in (motor.translation_mm, motor.rotation_deg):
        reach = 0.0 if values is None else float(np.ptp(values))
        columns.append(
            np.zeros_like(q) if values is None or reach == 0.0 else 0.5 * np.interp(t, motor.t_s, values) / reach
        )
    return np.column_stack(columns)
