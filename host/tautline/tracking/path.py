"""The motor's path as it is known at a moment: by samples until then alone, of which only the last are kept."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

_SPEED_S, _SPEED_SAMPLES = 0.02, 8  # tolerance: from which a speed is taken
_KEPT = 256  # tolerance: samples that are done with, before they are dropped


def _no_samples() -> Array:
    """An array without elements, a field's default."""
    return np.empty(0)


@dataclass
class CausalPath:
    """Samples of the motor after `done_s`, and some before it. All times are s on the motor's clock."""

    t_s: Array = field(default_factory=_no_samples)  # (n,) rising
    q: Array = field(default_factory=_no_samples)  # (n,) unit of q
    others: Array = field(default_factory=lambda: np.empty((0, 2)))  # (n, 2) translation, mm, and rotation, deg
    done_s: float = -np.inf  # the motion up to this time was used

    def add(self, t_s: Array, q: Array, others: Array) -> None:
        """Appends samples (shapes and units as of the fields), all later than those that are there."""
        self.t_s = np.concatenate([self.t_s, t_s])
        self.q = np.concatenate([self.q, q])
        self.others = np.concatenate([self.others, others])

    def forget(self, done_s: float) -> None:
        """Marks the motion up to done_s as used. Samples before it, but for the _SPEED_SAMPLES that tell a speed, are
        dropped once they are more than _KEPT."""
        self.done_s = done_s
        first = int(np.searchsorted(self.t_s, done_s, side="right")) - _SPEED_SAMPLES
        if first > _KEPT:
            self.t_s, self.q, self.others = self.t_s[first:], self.q[first:], self.others[first:]

    def new_positions(self, until_s: float) -> Array:
        """(n,) The positions, unit of q, of the samples after done_s, up to until_s."""
        first, last = np.searchsorted(self.t_s, [self.done_s, until_s], side="right")
        return self.q[first:last]

    def position_at(self, t_s: float) -> float:
        """The position, unit of q, at t_s, interpolated between the samples around it; held before the first and after
        the last one."""
        return float(np.interp(t_s, self.t_s, self.q))

    def predicted_position(self, t_s: float) -> float:
        """The position, unit of q, at t_s by the samples up to it alone: the last one, extrapolated with the speed of
        the last _SPEED_S for at most one sample's period. The first sample's where all are later."""
        last = int(np.searchsorted(self.t_s, t_s, side="right"))
        if last == 0:
            return float(self.q[0])
        first = int(np.searchsorted(self.t_s[:last], self.t_s[last - 1] - _SPEED_S))
        first = max(min(first, last - 2), last - _SPEED_SAMPLES, 0)
        t, q = self.t_s[first:last], self.q[first:last]
        if len(t) < 2 or t_s == t[-1]:
            return float(q[-1])
        centred = t - t.mean()
        speed = float(centred @ q) / float(centred @ centred)  # of a line through the samples (least squares)
        return float(q[-1]) + speed * min(t_s - float(t[-1]), float(t[-1] - t[-2]))

    def other_axes_at(self, t_s: float) -> tuple[float, float]:
        """Translation (mm) and rotation (deg) of the last sample up to t_s; of the first where all are later."""
        last = max(int(np.searchsorted(self.t_s, t_s, side="right")) - 1, 0)
        translation, rotation = self.others[last].tolist()
        return translation, rotation


def knots(before: float, q: Array, end: float) -> Array:
    """Reduces a path from `before` through q (n,) to `end`, unit of q, to the points that a play of any width depends
    on; what lies between them is wiped out. They are, in order of time: the lowest and the highest point, each if it
    lies beyond both `before` and `end`; then the same of what follows the later of these, with that as `before`; and so
    on; at last `end`."""
    kept: list[float] = []
    while len(q):
        low, high = int(q.argmin()), int(q.argmax())
        beyond = [low] if q[low] < min(before, end) else []
        beyond += [high] if q[high] > max(before, end) else []
        if not beyond:
            break
        kept += [float(q[i]) for i in sorted(beyond)]
        before, q = float(q[max(beyond)]), q[max(beyond) + 1 :]
    return np.array([*kept, end])
