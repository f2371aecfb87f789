"""Motor set-points for a trajectory of the tip: the board's own compensator, run on this computer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tautline import _native, tables
from tautline.columns import read_columns
from tautline.errors import TautError
from tautline.folders import write_file
from tautline.model import Model

Array = npt.NDArray[np.float64]
Progress = Callable[[float, str], None]

MODES = {"off": _native.MODE_OFF, "backlash": _native.MODE_BACKLASH, "full": _native.MODE_FULL}
RATES_HZ = 16.0, 100_000.0  # that the compensator runs at
MOST_ROWS = 10_000_000
_FLAGS = _native.COMPENSATOR_FLAGS
_CLIPPED = _FLAGS["BELOW"] | _FLAGS["ABOVE"] | _FLAGS["CLIPPED"] | _FLAGS["LIMITED"]
_PIECE = 200_000  # rows between two reports of progress


@dataclass(frozen=True)
class SetPoints:
    t_s: Array  # (n,)
    q: Array  # (n,) the rig's unit
    clipped: npt.NDArray[np.bool_]  # (n,) the command was beyond the table or a limit


def read_trajectory(path: Path, warnings: list[str] | None = None) -> tuple[Array, Array]:
    """t_s and c_deg of a CSV; straight lines between its rows."""
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
    """The set-points at rate_hz from the first time to the last, each from the commands up to its own time. It starts
    at rest where the mode puts the motor for c_deg[0], or start_deg, with the tip on the centre line. Take-up and feed
    are as fast as the rig's motor may be, without a limit if the rig names none."""
    t_s, c_deg = np.asarray(t_s, dtype=float), np.asarray(c_deg, dtype=float)
    if t_s.ndim != 1 or t_s.shape != c_deg.shape or not len(t_s):
        raise TautError(f"the trajectory's t_s {t_s.shape} and c_deg {c_deg.shape} must have one length of 1 or more")
    if not (np.isfinite(t_s).all() and np.isfinite(c_deg).all() and (np.diff(t_s) > 0.0).all()):
        raise TautError("the trajectory's times must rise, and its times and angles be finite")
    if mode not in MODES:
        raise TautError(f"mode {mode!r} is not there: choose one of {', '.join(MODES)}")
    if not RATES_HZ[0] <= rate_hz <= RATES_HZ[1]:
        raise TautError(f"--rate {rate_hz}: the compensator runs at {RATES_HZ[0]:.0f} to {RATES_HZ[1]:.0f} Hz")
    steps = (t_s[-1] - t_s[0]) * rate_hz * (1 + 1e-12)
    if steps >= MOST_ROWS:
        raise TautError(f"the trajectory has more than {MOST_ROWS} rows at {rate_hz} Hz: lower --rate or cut it")
    times = t_s[0] + np.arange(int(steps + 1e-6) + 1) / rate_hz
    raw = np.clip(np.rint(np.interp(times, t_s, c_deg) * _native.DEG_ONE), -(2**31), 2**31 - 1).astype(np.int32)
    table = _native.FixedTable(tables.encode(model, limits=_limits(model)))
    start = raw[0] if start_deg is None else np.int32(np.clip(round(start_deg * _native.DEG_ONE), -(2**31), 2**31 - 1))
    inverse = table.angle_inverse if mode == "full" else table.coarse_inverse
    low, high = table.fields["q_min"], table.fields["q_max"]
    q0 = int(np.clip(inverse(np.array([start], np.int32))[0][0], low, high))
    compensator = _native.FixedCompensator(table, rate_hz, MODES[mode], q0, int(start))
    q, flags = np.empty(len(raw)), np.empty(len(raw), np.uint32)
    for begin in range(0, len(raw), _PIECE):
        piece = slice(begin, begin + _PIECE)
        q[piece], _, _, flags[piece] = compensator.run(raw[piece])
        progress(min(1.0, (begin + _PIECE) / len(raw)), f"{len(raw)} set-points")
    clipped = flags & _CLIPPED != 0
    speed = model.rig.actuator.speed_max
    q *= model.rig.actuator.encoder_resolution / _native.COUNT_ONE
    if speed is not None:
        limited = _no_faster(q, speed / rate_hz)
        clipped |= limited != q
        q = limited
    return SetPoints(times, q, clipped)


def _limits(model: Model) -> tables.Limits:
    """The board's, but no slower than the rig's motor."""
    resolution = model.rig.actuator.encoder_resolution
    most = _native.TABLE_VALUE_MAX // _native.COUNT_ONE * resolution
    speed = min(most, model.rig.actuator.speed_max or most)
    accel = (2**31 - 1) * resolution
    own = tables.Limits.of(model.rig)
    return replace(own, speed_max=speed, takeup_speed=speed, takeup_accel=accel, slope_min=0.0)


def _no_faster(q: Array, step: float) -> Array:
    """q, following itself by at most `step` a row."""
    limited = np.empty(len(q))
    here = float(q[0])
    for k, wanted in enumerate(q.tolist()):
        here = wanted if abs(wanted - here) <= step else here + np.copysign(step, wanted - here)
        limited[k] = here
    return limited


def write_csv(path: Path, unit: str, points: SetPoints, resolution: float) -> None:
    """t_s,q_mm (or q_deg),clipped; positions to a 256th of a count."""
    digits = max(6, int(np.ceil(-np.log10(resolution / _native.COUNT_ONE))))
    lines = [f"t_s,q_{unit},clipped"]
    rows = zip(points.t_s.tolist(), points.q.tolist(), points.clipped.tolist(), strict=True)
    lines += [f"{t:.9f},{q:.{digits}f},{clipped:d}" for t, q, clipped in rows]
    write_file(path, "\n".join(lines) + "\n")
