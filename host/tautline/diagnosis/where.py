"""Under which conditions a gap is large: the residual's power as a function of position, speed, time and so on
(axes)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline.diagnosis.segment import Segment

Array = npt.NDArray[np.float64]

_BINS = 12  # tolerance: of an axis, with about as many observations each
_MOVES = 0.02  # tolerance: share of the fastest motion: slower is at rest
# Axis: (its low end in words, its high end, its unit); "unit" is the actuator's.
AXES: Mapping[str, tuple[str, str, str]] = {
    "q": ("at low motor positions", "at high motor positions", "unit"),
    "direction": ("while the motor falls", "while the motor rises", ""),
    "speed": ("at rest or slow", "when fast", "unit/s"),
    "phase": ("just after a reversal", "long after a reversal", "s"),
    "time": ("early in the session", "late in the session", "s"),
    "translation": ("drawn in", "pushed out", "mm"),
    "rotation": ("turned one way", "turned the other way", "deg"),
    "u": ("at the image's left", "at the image's right", "px"),
    "v": ("at the image's top", "at the image's bottom", "px"),
    "load": ("at low load", "at high load", "mNm"),
}


@dataclass(frozen=True)
class Condition:
    """How the residual's power varies along one axis."""

    axis: str  # one of AXES
    share: float  # of the residual's power that goes with the axis, 0 to 1
    range: tuple[float, float]  # the bin with the largest power per observation, in the axis' unit
    says: str  # at which end that is, in words
    centres: Array  # (bins,) in the axis' unit
    mean: Array  # (bins, k) residual, px or deg
    power: Array  # (bins,) mean over observations of the squared residual, summed over its coordinates

    def to_json(self) -> dict[str, Any]:
        """The condition as an entry of the list `where.conditions` of diagnosis.json; without its curves."""
        return {"axis": self.axis, "share": self.share, "range": list(self.range), "says": self.says}


def conditions(segments: Sequence[Segment], residuals: Sequence[Array]) -> list[Condition]:
    """How the residuals, (scored, k) of each segment, vary along each axis; the largest share first. Axes that a
    recording lacks, or that do not vary, are left out."""
    columns: dict[str, list[Array]] = {}
    for segment in segments:
        for name, values in axis_values(segment).items():
            columns.setdefault(name, []).append(values[segment.scored])
    residual = np.concatenate(residuals)
    result = []
    for name, parts in columns.items():
        if sum(map(len, parts)) != len(residual):
            continue  # not known in every recording
        values = np.concatenate(parts)
        if np.ptp(values) > 0.0:
            result.append(_condition_of_axis(name, values, residual))
    return sorted(_without_apparent_time(result, columns, residual), key=lambda c: -c.share)


def _without_apparent_time(
    conditions: Sequence[Condition], columns: Mapping[str, list[Array]], residual: Array
) -> list[Condition]:
    """The conditions with the share of time reduced. As motions differ between recordings, a gap that goes with speed
    seems to go with time too; so the share of time is at most that in the residual divided by its rms over the best
    other axis. columns: {axis: its values (scored,) of each recording}; residual: (n, k) of all recordings."""
    others = [c for c in conditions if c.axis != "time"]
    if not others:
        return list(conditions)
    best = max(others, key=lambda c: c.share)
    rms_by_best = np.sqrt(np.interp(np.concatenate(columns[best.axis]), best.centres, best.power))
    normalised = residual / np.maximum(rms_by_best, 1e-12)[:, None]
    result = []
    for condition in conditions:
        if condition.axis == "time":
            beside_best = _condition_of_axis("time", np.concatenate(columns["time"]), normalised).share
            condition = replace(condition, share=min(condition.share, beside_best))
        result.append(condition)
    return result


def constant_share(residuals: Sequence[Array]) -> float:
    """Share, 0 to 1, of the residuals' power that the means of each recording hold. residuals: (scored, k) of each
    recording."""
    power = sum(float(np.sum(r**2)) for r in residuals)
    return sum(float(np.sum(r.mean(axis=0) ** 2)) * len(r) for r in residuals) / max(power, 1e-300)


def axis_values(segment: Segment) -> dict[str, Array]:
    """{axis: its values (n,) at the recording's observations, in its unit}, for those of AXES that were recorded.
    direction: -1 or 1, 0 at rest; phase: time since the last change of direction, a rest between not counting as
    one."""
    motor, t = segment.motor, segment.arrival_s
    q = np.interp(t, motor.t_s, motor.q)
    rate = np.gradient(q, t) if len(t) > 1 else np.zeros_like(q)
    moves = np.abs(rate) > _MOVES * max(float(np.abs(rate).max()), 1e-12)
    direction = np.where(moves, np.sign(rate), 0.0)
    reversal_s, phase, current = t[0], np.zeros_like(t), 0.0
    for i in range(len(t)):
        if direction[i] != 0.0 and direction[i] != current:
            current, reversal_s = direction[i], t[i]
        phase[i] = t[i] - reversal_s
    values = {"q": q, "direction": direction, "speed": np.abs(rate), "phase": phase, "time": t + segment.offset_s}
    others = {"translation": motor.translation_mm, "rotation": motor.rotation_deg, "load": motor.load_mNm}
    values |= {name: np.interp(t, motor.t_s, v) for name, v in others.items() if v is not None}
    if segment.unit == "px":
        values |= {"u": segment.observed[:, 0], "v": segment.observed[:, 1]}
    return values


def _condition_of_axis(name: str, values: Array, residual: Array) -> Condition:
    """How the residual (n, k) varies with the values (n,) of the axis `name`. The share of the power is the larger of
    two: what the bins' mean residuals explain, and what would have to move to other bins for all to have the same power
    per observation (half the mean relative deviation from the mean power)."""
    edges = _bin_edges(values)
    bin_of = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    count = np.bincount(bin_of, minlength=len(edges) - 1).astype(float)
    filled = count > 0
    low, high, count = edges[:-1][filled], edges[1:][filled], count[filled]
    squares = np.bincount(bin_of, np.sum(residual**2, axis=1))[filled]
    mean = np.column_stack([np.bincount(bin_of, column)[filled] / count for column in residual.T])
    total = float(np.sum(residual**2))
    explained = float(np.sum(count * np.sum(mean**2, axis=1))) / total
    power = squares / count
    weight = count / count.sum()
    uneven = float(np.sum(weight * np.abs(power / (total / count.sum()) - 1.0))) / 2
    worst = int(np.argmax(power))
    at_low_end, at_high_end, _ = AXES[name]
    middle = 0.5 * (low[worst] + high[worst])
    return Condition(
        axis=name,
        share=max(explained, uneven),
        range=(float(low[worst]), float(high[worst])),
        says=at_low_end if middle < float(np.median(values)) else at_high_end,
        centres=0.5 * (low + high),
        mean=mean,
        power=power,
    )


def _bin_edges(values: Array) -> Array:
    """(bins + 1,) Edges of up to _BINS bins with about as many of the values (n,) each. With at most three distinct
    values, such as directions, each value has a bin of its own."""
    levels = np.unique(values)
    if len(levels) > 3:
        return np.unique(np.quantile(values, np.linspace(0.0, 1.0, _BINS + 1)))
    middles = 0.5 * (levels[1:] + levels[:-1])
    return np.concatenate([[2 * levels[0] - middles[0]], middles, [2 * levels[-1] - middles[-1]]])
