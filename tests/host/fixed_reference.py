"""Random valid tables, and the float64 evaluation of the same quantised table that the fixed point is held against.

Everything here is in raw units: Q8 counts and Q16 degrees, as float64.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from hypothesis import strategies as st

from tautline import _native

COUNT = float(_native.COUNT_ONE)
VALUE_MAX = _native.TABLE_VALUE_MAX
POSITION_MAX = _native.TABLE_POSITION_MAX


@dataclass(frozen=True)
class Reference:
    """The table's functions in float64, from their definitions."""

    p: np.ndarray  # nodes
    width: np.ndarray
    angle: np.ndarray
    fields: dict[str, int]

    def width_at(self, p: np.ndarray) -> np.ndarray:
        return np.interp(p, self.p, self.width)

    def angle_at(self, p: np.ndarray) -> np.ndarray:
        return np.interp(p, self.p, self.angle)

    def angle_inverse(self, c: np.ndarray) -> np.ndarray:
        order = slice(None) if self.angle[-1] > self.angle[0] else slice(None, None, -1)
        return np.interp(c, self.angle[order], self.p[order])

    def envelope_inverse(self, q: np.ndarray, sign: int) -> np.ndarray:
        """p with p + sign B(p)/2 = q; B held beyond the ends."""
        phi = self.p + sign * self.width / 2
        inside = np.interp(q, phi, self.p)
        inside = np.where(q < phi[0], q - sign * self.width[0] / 2, inside)
        return np.where(q > phi[-1], q - sign * self.width[-1] / 2, inside)

    def coarse_at(self, q: np.ndarray) -> np.ndarray:
        return np.interp(q, self.q_range, [self.fields["coarse_c_min"], self.fields["coarse_c_max"]])

    def coarse_inverse(self, c: np.ndarray) -> np.ndarray:
        first, last = self.fields["coarse_c_min"], self.fields["coarse_c_max"]
        low, high = self.q_range
        return low + (high - low) * np.clip((c - first) / (last - first), 0, 1)

    def play(self, q: np.ndarray, p0: float) -> np.ndarray:
        low, high = self.envelope_inverse(q, 1), self.envelope_inverse(q, -1)
        p = np.empty(len(q))
        last = p0
        for k in range(len(q)):
            last = min(max(last, low[k]), high[k])
            p[k] = last
        return p

    def blob(self) -> bytes:
        return _native.table_encode(
            self.fields, self.width.astype(np.int32), self.angle.astype(np.int32), b"\x01\x02\x03\x04\x05\x06\x07\x08"
        )

    @property
    def q_range(self) -> tuple[int, int]:
        return self.fields["q_min"], self.fields["q_max"]


FIELDS = {
    "axis": 0,
    "kind": 0,
    "unit": 0,
    "strength_q15": 32768,
    "nano_units_per_count": 1_000_000,
    "speed_max_q8": 1 << 29,
    "takeup_speed_q8": 1 << 22,
    "takeup_accel": 1 << 17,
    "band": 512,
    "slope_min_q28": 0,
    "flat_speed_q8": 0,
    "delay_us": 80_000,
    "created_s": 1_760_000_000,
}


@st.composite
def tables(draw: st.DrawFn, steepest: float = 2.0) -> Reference:
    """Any shape the board accepts: smooth or ragged B, |B'| up to its bound, f rising or falling, steep or flat."""
    log2 = draw(st.integers(0, 22))
    step = 1 << log2
    most = min(257, POSITION_MAX // step)  # half of the range that may be
    nodes = draw(st.integers(2, most))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    extent = (nodes - 1) * step
    room = POSITION_MAX - extent
    q0 = draw(st.integers(-room // 2 - extent // 2, room // 2 - extent // 2))

    steepness = min(steepest, draw(st.sampled_from([0.0, 0.1, 1.0, 1.8, 1.99, 2.0])))
    slopes = rng.uniform(-steepness, steepness, nodes - 1)
    if draw(st.booleans()):  # at the bound wherever it moves
        slopes = np.sign(slopes) * steepness
    rises = np.clip(np.trunc(slopes * step), -(2 * step - 1), 2 * step - 1).astype(np.int64)
    width = np.concatenate([[rng.integers(0, 4 * step + 1)], rises])
    for i in range(1, nodes):  # bounced off zero and off a ceiling, so that widths stay useful
        ceiling = min(_native.TABLE_WIDTH_MAX, 20 * step)
        up = width[i - 1] + width[i]
        width[i] = up if 0 <= up <= ceiling else max(0, width[i - 1] - width[i])

    # c per span over six decades, so that flat and steep spans lie side by side
    decades = draw(st.floats(0.0, 6.0))
    spans = np.maximum(1, np.rint(10 ** rng.uniform(0, decades, nodes - 1) * draw(st.integers(1, 1 << 14))))
    spans = np.maximum(1, np.floor(spans * min(1.0, 0.9 * VALUE_MAX / spans.sum())))
    sign = draw(st.sampled_from([1, -1]))
    angle = sign * np.concatenate([[0.0], np.cumsum(spans)])
    angle -= np.floor(angle[-1] / 2)

    low = q0 + int(draw(st.floats(0, 0.4)) * extent)
    high = max(low + 1, q0 + extent - int(draw(st.floats(0, 0.4)) * extent))
    coarse = [int(angle[0]), int(angle[-1])]
    fields = dict(FIELDS, step_log2=log2, q0=q0, q_min=low, q_max=high, coarse_c_min=coarse[0], coarse_c_max=coarse[1])
    return Reference(q0 + step * np.arange(nodes, dtype=float), width.astype(float), angle, fields)


def positions(draw: st.DrawFn, reference: Reference, count: int) -> np.ndarray:
    """Motor positions within the grid, beyond it, and exactly on nodes and on the ends of the number range."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    first, last = reference.p[0], reference.p[-1]
    margin = last - first
    spread = rng.uniform(first - 0.5 * margin, last + 0.5 * margin, count)
    nodes = rng.choice(reference.p, count // 4) + rng.integers(-1, 2, count // 4)
    corners = [-(2.0**31), 2.0**31 - 1, -VALUE_MAX, VALUE_MAX, -POSITION_MAX, POSITION_MAX, 0, first, last]
    return np.clip(np.concatenate([np.rint(spread), nodes, corners]), -(2**31), 2**31 - 1)
