"""Under which conditions a gap is large: the residual's power over the axes that an engineer would look at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline.diagnosis.segment import Segment
from tautline.effects import Path

Array = npt.NDArray[np.float64]

_BINS = 12
# Axis: (what its ends are called, unit); "unit" is the actuator's.
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
    """`share` of the residual's power that its value along the axis predicts (0 to 1, noise taken off)."""

    axis: str
    share: float
    range: tuple[float, float]  # where the power per observation is largest
    says: str
    centres: Array  # of the bins
    mean: Array  # (bins, k) residual
    power: Array  # (bins,) mean square

    def to_json(self) -> dict[str, Any]:
        return {"axis": self.axis, "share": self.share, "range": list(self.range), "says": self.says}


def conditions(segments: Sequence[Segment], paths: Sequence[Path], residuals: Sequence[Array]) -> list[Condition]:
    """How much of the residuals' power goes with each axis (position, speed, time, ...), the largest share first.
    paths, residuals: of each segment, at all and at scored observations."""
    columns: dict[str, list[Array]] = {}
    for segment, path in zip(segments, paths, strict=True):
        for name, values in axis_values(segment, path).items():
            columns.setdefault(name, []).append(values[segment.scored])
    residual = np.concatenate(residuals)
    result = []
    for name, parts in columns.items():
        if sum(map(len, parts)) != len(residual):
            continue  # not known in every recording
        values = np.concatenate(parts)
        if np.ptp(values) > 0.0:
            result.append(_condition(name, values, residual))
    return sorted(_without_apparent_time(result, columns, residual), key=lambda c: -c.share)


def _without_apparent_time(
    conditions: Sequence[Condition], columns: Mapping[str, list[Array]], residual: Array
) -> list[Condition]:
    """The conditions with time's share reduced to what is left of it once the power is normalised by the best other
    axis: as motions differ between recordings, a gap that goes with speed seems to go with time."""
    others = [c for c in conditions if c.axis != "time"]
    if not others:
        return list(conditions)
    best = max(others, key=lambda c: c.share)
    usual = np.sqrt(np.interp(np.concatenate(columns[best.axis]), best.centres, best.power))
    even = residual / np.maximum(usual, 1e-12)[:, None]
    result = []
    for condition in conditions:
        if condition.axis == "time":
            apart = _condition("time", np.concatenate(columns["time"]), even).share
            condition = replace(condition, share=min(condition.share, apart))
        result.append(condition)
    return result


def steady(residuals: Sequence[Array]) -> float:
    """Share of the power, 0 to 1, that is constant within each recording."""
    power = sum(float(np.sum(r**2)) for r in residuals)
    return sum(float(np.sum(r.mean(axis=0) ** 2)) * len(r) for r in residuals) / max(power, 1e-300)


def axis_values(segment: Segment, path: Path) -> dict[str, Array]:
    """Values (n,) of each axis of AXES that was recorded, in its unit there, at the recording's observations. The
    direction is -1 or 1, 0 at rest."""
    motor, t = segment.motor, segment.arrival_s
    q = np.interp(t, motor.t_s, motor.q)
    rate = np.gradient(q, t) if len(t) > 1 else np.zeros_like(q)
    # Slower than 2 % of the fastest is at rest.
    quick = np.abs(rate) > 0.02 * max(float(np.abs(rate).max()), 1e-12)
    sign = np.where(quick, np.sign(rate), 0.0)
    last, since, direction = t[0], np.zeros_like(t), 0.0
    for i in range(len(t)):
        if sign[i] != 0.0 and sign[i] != direction:
            direction, last = sign[i], t[i]
        since[i] = t[i] - last
    values = {"q": q, "direction": sign, "speed": np.abs(rate), "phase": since, "time": t + segment.offset_s}
    others = {"translation": motor.translation_mm, "rotation": motor.rotation_deg, "load": motor.load_mNm}
    values |= {name: np.interp(t, motor.t_s, v) for name, v in others.items() if v is not None}
    if segment.unit == "px":
        values |= {"u": segment.observed[:, 0], "v": segment.observed[:, 1]}
    return values


def _condition(name: str, values: Array, residual: Array) -> Condition:
    """How the residual (n, k) goes with one axis' values (n,). Its share of the power is the larger of what the bins'
    mean residuals explain, and of how unevenly the power is spread over the bins (half the mean deviation)."""
    edges = _bin_edges(values)
    at = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    count = np.bincount(at, minlength=len(edges) - 1).astype(float)
    filled = count > 0
    low, high, count = edges[:-1][filled], edges[1:][filled], count[filled]
    squares = np.bincount(at, np.sum(residual**2, axis=1))[filled]
    mean = np.column_stack([np.bincount(at, column)[filled] / count for column in residual.T])
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
    """Edges of bins that hold about as many values each; of up to three distinct values (directions) a bin for each."""
    levels = np.unique(values)
    if len(levels) > 3:
        return np.unique(np.quantile(values, np.linspace(0.0, 1.0, _BINS + 1)))
    middles = 0.5 * (levels[1:] + levels[:-1])
    return np.concatenate([[2 * levels[0] - middles[0]], middles, [2 * levels[-1] - middles[-1]]])
