"""Motor set-points for a trajectory of the tip: the board's own compensator, run on this computer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline import _native, tables
from tautline.columns import read_columns
from tautline.errors import TautError, check_start
from tautline.folders import write_file
from tautline.model import Model
from tautline.undone import INT32_MAX
from tautline.value import Value

# format of all: rates and rows of taut compensate

Array = npt.NDArray[np.float64]
Progress = Callable[[float, str], None]

MODES = {"off": _native.MODE_OFF, "backlash": _native.MODE_BACKLASH, "full": _native.MODE_FULL}
BLEND_S = 0.5  # loss: over which tables in use are moved: an offset is no step of the motor
RATES_HZ = 16.0, 100_000.0  # limit: that the compensator runs at
MOST_ROWS = 10_000_000
_FLAGS = _native.COMPENSATOR_FLAGS
_CLIPPED = _FLAGS["BELOW"] | _FLAGS["ABOVE"] | _FLAGS["CLIPPED"] | _FLAGS["LIMITED"]
_PIECE = 200_000  # display: rows between two reports of progress


@dataclass(frozen=True, eq=False, repr=False)
class SetPoints(Value):
    """The motor's set-points, one each tick."""

    t_s: Array  # (n,)
    q: Array  # (n,) the rig's unit
    clipped: npt.NDArray[np.bool_]  # (n,) the command was beyond the table or a limit


def read_trajectory(path: Path, warnings: list[str] | None = None) -> tuple[Array, Array]:
    """Reads a trajectory's CSV. Returns its times t_s, s, rising, and angles c_deg, deg, (n,) each. warnings: if given,
    gets what was mended."""
    columns = read_columns(path, ["t_s", "c_deg"], "t_s,c_deg")
    t_s, c_deg = columns.rising_times(), columns.finite("c_deg")
    if warnings is not None:
        warnings.extend(columns.warnings)
    return t_s, c_deg


def compensate(
    model: Model,
    t_s: npt.ArrayLike,
    c_deg: npt.ArrayLike,
    rate_hz: int = 1000,
    mode: str = "full",
    start_deg: float | None = None,
    progress: Progress = lambda fraction, text: None,
) -> SetPoints:
    """Computes set-points at rate_hz, from the first time to the last, with which the tip is at angles c_deg (n,), deg,
    at times t_s (n,), s; each set-point depends on the commands up to its own time only. The motor starts at rest where
    the mode (a key of MODES) puts it for c_deg[0], or for start_deg if given, with the tip on the centre line. Take-up
    and feed are as fast as the rig's motor may be, without a limit if the rig names none."""
    return Compensator(model, rate_hz, mode, start_deg).run(t_s, c_deg, progress)


class Compensator:
    """The board's compensator in a loop of one's own: `step` with each command as it comes, or `run` with many.

    It ticks at rate_hz from the time of the first command on, and each tick knows the commands up to its own time: a
    straight line from one to the next. So `run` on a trajectory is `compensate`, and so are its rows one by one.
    """

    def __init__(self, model: Model, rate_hz: int = 1000, mode: str = "full", start_deg: float | None = None) -> None:
        """Prepares a compensator that ticks at rate_hz, a whole number within RATES_HZ. It starts at rest, where `mode`
        (a key of MODES) puts the motor for the first command, or for start_deg, deg, if given, with the tip on the
        centre line. TautError for an unknown mode or rate, a start_deg that is no number, and a model that a board
        would refuse."""
        if mode not in MODES:
            raise TautError(f"mode {mode!r} is not there: choose one of {', '.join(MODES)}")
        if not (RATES_HZ[0] <= rate_hz <= RATES_HZ[1] and rate_hz == int(rate_hz)):
            low, high = RATES_HZ
            raise TautError(f"--rate {rate_hz}: the compensator runs at {low:.0f} to {high:.0f} Hz, a whole number")
        check_start(start_deg)
        self.rate_hz, self.mode = int(rate_hz), mode
        limits = _limits(model)
        assert limits.adapt is not None
        self._farthest = limits.adapt  # offset at most, unit; least and most share of B
        self._table = _native.FixedTable(tables.encode(model, limits=limits))
        self._start_deg = start_deg
        self._unit = model.rig.actuator.encoder_resolution / _native.COUNT_ONE  # of q, in a Q8 count
        speed = model.rig.actuator.speed_max
        self._most = None if speed is None else speed / rate_hz  # unit, of one tick
        self._native: Any = None  # from the first command on
        self._moved = 0, _native.RATIO_ONE  # offset, Q8 counts, and share of B that the tables in use have or go to
        self._begin_s = 0.0  # of the first tick
        self._before_s = self._before_deg = 0.0  # the last command
        self._ticks = 0  # that have been made
        self._q, self._clipped = 0.0, False  # of the last tick

    @property
    def clipped(self) -> bool:
        """Whether the last tick was clipped: its command was beyond the table, the range or the motor's speed."""
        return self._clipped

    def step(self, c_deg: float, t_s: float) -> float:
        """Takes the command to be at c_deg, deg, at time t_s, s, and returns the motor's set-point, unit of q, at the
        last tick up to t_s. TautError for a time that is not after the one before, and for a value that is no finite
        number."""
        try:
            time, angle = float(t_s), float(c_deg)
        except (TypeError, ValueError):
            raise TautError(f"step takes an angle, deg, and a time, s: not {c_deg!r} and {t_s!r}") from None
        self.run([time], [angle])
        return self._q

    def run(
        self,
        t_s: npt.ArrayLike,
        c_deg: npt.ArrayLike,
        progress: Progress = lambda fraction, text: None,
    ) -> SetPoints:
        """Takes commands, angles c_deg (n,), deg, at times t_s (n,), s, and returns the set-points of all ticks that
        have not been made yet, up to the last command. TautError as in `step`."""
        t_s, c_deg = np.asarray(t_s, dtype=float), np.asarray(c_deg, dtype=float)
        known_s, known_deg = self._with_last_command(t_s, c_deg)
        if self._native is None:
            self._start(float(t_s[0]), float(c_deg[0]))
        last = int((t_s[-1] - self._begin_s) * self.rate_hz * (1 + 1e-12) + 1e-6)  # a tick at the end is in, if rounded
        times = self._begin_s + np.arange(self._ticks, last + 1) / self.rate_hz
        raw = _raw(np.interp(times, known_s, known_deg))
        q, clipped = self._run_native(raw, progress)
        if self._most is not None and len(q):  # the first tick of all is free: the motor starts there
            limited = _rate_limited(q, self._most, float(q[0]) if self._ticks == 0 else self._q)
            clipped |= limited != q
            q = limited
        if len(q):
            self._q, self._clipped = float(q[-1]), bool(clipped[-1])
        self._ticks = last + 1
        self._before_s, self._before_deg = float(t_s[-1]), float(c_deg[-1])
        return SetPoints(times, q, clipped)

    def _run_native(self, raw: npt.NDArray[np.int32], progress: Progress) -> tuple[Array, npt.NDArray[np.bool_]]:
        """Runs the board's compensator for one tick after the other, on commands raw (n,), DEG_ONE to a degree. Returns
        set-points (n,), unit of q, and which of them were clipped (n,)."""
        q, flags = np.empty(len(raw)), np.empty(len(raw), np.uint32)  # q: Q8 counts at first
        for begin in range(0, len(raw), _PIECE):
            piece = slice(begin, begin + _PIECE)
            q[piece], _, _, flags[piece] = self._native.run(raw[piece])
            progress(min(1.0, (begin + _PIECE) / len(raw)), f"{len(raw)} set-points")
        return q * self._unit, flags & _CLIPPED != 0

    def _with_last_command(self, t_s: Array, c_deg: Array) -> tuple[Array, Array]:
        """The commands between which the new ticks are interpolated: times t_s, s, and angles c_deg, deg, (n,) each,
        with the last command of the call before in front, if there was one. TautError where shapes differ, times do not
        rise after that command, a value is not finite, or the ticks would be MOST_ROWS or more."""
        if t_s.ndim != 1 or t_s.shape != c_deg.shape or not len(t_s):
            shapes = f"t_s {t_s.shape} and c_deg {c_deg.shape}"
            raise TautError(f"the trajectory's {shapes} must have one length of 1 or more")
        first = self._native is None
        known_s = t_s if first else np.concatenate([[self._before_s], t_s])
        known_deg = c_deg if first else np.concatenate([[self._before_deg], c_deg])
        if not (np.isfinite(known_s).all() and np.isfinite(known_deg).all() and (np.diff(known_s) > 0.0).all()):
            raise TautError("the trajectory's times must rise, and its times and angles be finite")
        if (t_s[-1] - known_s[0]) * self.rate_hz * (1 + 1e-12) >= MOST_ROWS:
            rows = f"{MOST_ROWS} rows at {self.rate_hz} Hz"
            raise TautError(f"the trajectory has more than {rows}: lower the rate or cut it; after a pause begin anew")
        return known_s, known_deg

    def adapt(self, offset: float, share: float, within_s: float = BLEND_S) -> None:
        """Moves the tables in use, as a board does when it is told what a tracker learnt: by `offset` of the
        transmission, unit of q (`Row.offset` of a `Tracker`), and to `share` of the calibrated backlash
        (`Tracker.compensation`), blended over within_s, s. Raises a TautError and leaves the tables as they were for an
        offset above a tenth of the range, a share outside 0 to 2, or a within_s that is negative or infinite."""
        farthest, least, most = self._farthest
        if not (abs(offset) <= farthest and least <= share <= most and 0.0 <= within_s < np.inf):
            raise TautError(
                f"adapt to an offset of {offset:g} and a share of {share:g} in {within_s:g} s: tables in use move by "
                f"{farthest:g} at most and to {least:g} to {most:g} of the backlash: calibrate again"
            )
        self._moved = round(offset / self._unit), round(share * _native.RATIO_ONE)
        if self._native is not None:
            self._native.adapt(*self._moved, round(within_s * self.rate_hz))

    def _start(self, t_s: float, c_deg: float) -> None:
        """Creates the board's compensator for the first command, c_deg, deg, at t_s, s. The motor is at rest at q0, Q8
        counts, where the mode puts it for that angle, or for start_deg if given, clipped to the table's range."""
        start = _raw(np.array([c_deg if self._start_deg is None else self._start_deg]))
        inverse = self._table.angle_inverse if self.mode == "full" else self._table.coarse_inverse
        low, high = self._table.fields["q_min"], self._table.fields["q_max"]
        q0 = int(np.clip(inverse(start)[0][0], low, high))
        self._native = _native.FixedCompensator(self._table, self.rate_hz, MODES[self.mode], q0, int(start[0]))
        self._native.adapt(*self._moved, 0)
        self._begin_s = t_s


def _raw(c_deg: Array) -> npt.NDArray[np.int32]:
    """Angles c_deg (n,) in the board's fixed point, DEG_ONE to a degree, rounded, and clipped to 32 bits."""
    return np.asarray(np.clip(np.rint(c_deg * _native.DEG_ONE), -INT32_MAX - 1, INT32_MAX), dtype=np.int32)


def _limits(model: Model) -> tables.Limits:
    """Limits of tables that may be moved in use, but as fast as the rig's motor may be or, where the rig names no
    speed, as fast as a board computes with, and without a least slope of f."""
    resolution = model.rig.actuator.encoder_resolution
    most = _native.TABLE_VALUE_MAX // _native.COUNT_ONE * resolution  # unit/s
    speed = min(most, model.rig.actuator.speed_max or most)
    accel = INT32_MAX * resolution  # unit/s^2
    own = tables.Limits.in_use(model.rig)
    return replace(own, speed_max=speed, takeup_speed=speed, takeup_accel=accel, slope_min=0.0)


def _rate_limited(q: Array, step: float, position: float) -> Array:
    """(n,) Positions that follow q (n,) by at most `step` at a time, beginning from `position`, all in the unit of
    q."""
    limited = np.empty(len(q))
    for k, wanted in enumerate(q.tolist()):
        position = wanted if abs(wanted - position) <= step else position + np.copysign(step, wanted - position)
        limited[k] = position
    return limited


def write_csv(path: Path, unit: str, points: SetPoints, resolution: float) -> None:
    """Writes the set-points as a CSV with columns t_s, q_mm (or q_deg, by `unit`) and clipped. Positions have six
    decimals, or as many as show a 256th of a count. resolution: unit of q per count."""
    digits = max(6, int(np.ceil(-np.log10(resolution / _native.COUNT_ONE))))
    lines = [f"t_s,q_{unit},clipped"]
    rows = zip(points.t_s.tolist(), points.q.tolist(), points.clipped.tolist(), strict=True)
    lines += [f"{t:.9f},{q:.{digits}f},{clipped:d}" for t, q, clipped in rows]
    write_file(path, "\n".join(lines) + "\n")
