"""Which of a file's times are used, and times as a recording needs them: rising, on one clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tautline.columns import MAX_REPEATED_TIMES
from tautline.errors import TautError

Array = np.ndarray

_UNSET = 1e-3  # tolerance: share of messages without a stamp from which on stamps are not used
_APART_S = 0.5  # prior: between the clocks of two senders: no message is under way for as long
_DRIFT = 1e-4  # prior: rate of one clock against another: ten times what quartz is off by
_LONG_ENOUGH_S = 30.0  # tolerance: of a recording, that a rate is told from: 3 ms, what messages take, at that one
_MOST_BACK = 0.01  # tolerance: share of rows that may be out of order, as two threads write them
_FARTHEST_BACK_S = 1.0  # tolerance: that one of them may go back
_GAP_S, _GAP_STEPS = 0.5, 10.0  # display: without rows, and so many usual steps: that is told
LOG, STAMP, FILE = "log", "header", "file"  # when messages were written, when their senders made them, a table's own


@dataclass(frozen=True)
class Clock:
    """Which of a file's times are used for all of a recording."""

    used: str  # LOG, STAMP or FILE
    warnings: tuple[str, ...] = ()  # why not the stamps


def choose(times: Mapping[str, tuple[Array, Array | None]]) -> Clock:
    """Chooses which times are used for all groups (topics) of a recording: the senders' stamps if all groups have them
    and they are on one clock, else the times at which messages were logged, with a warning why. times: by group its log
    times (n,) s and its stamps (n,) s, None without; a single group "" is a table, whose own times are used."""
    stamped = {group: stamp for group, (_, stamp) in times.items() if stamp is not None}
    if not stamped:
        return Clock(FILE if set(times) == {""} else LOG)
    without = sorted(set(times) - set(stamped))
    if without:
        return Clock(LOG, (f"{without[0]} has no header stamps: the times at which messages were logged are used",))
    for group, stamp in stamped.items():
        if (share := float(np.mean(~np.isfinite(stamp)))) > _UNSET:
            lost = f"{100 * share:.2g} % of the header stamps of {group} are 0"
            return Clock(LOG, (f"{lost}: the times at which messages were logged are used",))
    disagreement = _disagreement({group: (times[group][0], stamp) for group, stamp in stamped.items()})
    return Clock(LOG, (disagreement,)) if disagreement else Clock(STAMP)


def _disagreement(times: Mapping[str, tuple[Array, Array]]) -> str:
    """A warning that says why the stamps of several groups are not on one clock; "" where they are. All log times are
    on one clock: each group's median of stamp less log time is compared, s, and over more than _LONG_ENOUGH_S its rate
    of change. times: by group its log times and stamps (NaN: not set), (n,) s each."""
    offsets: dict[str, float] = {}
    rates: dict[str, float] = {}
    for group, (log, stamp) in times.items():
        is_set = np.isfinite(stamp)
        offset = stamp[is_set] - log[is_set]
        offsets[group] = float(np.median(offset))
        if np.ptp(log[is_set]) > _LONG_ENOUGH_S:
            rates[group] = float(np.polyfit(log[is_set], offset - offsets[group], 1)[0])
    first, last = min(offsets, key=offsets.__getitem__), max(offsets, key=offsets.__getitem__)
    if (apart := offsets[last] - offsets[first]) > _APART_S:
        return (
            f"two clocks: the header stamps of {last} are {apart:.6g} s ahead of those of {first}: the times at "
            "which messages were logged are used; set both senders by one clock (chrony, PTP, use_sim_time)"
        )
    if rates and (drift := max(rates.values()) - min(rates.values())) > _DRIFT:
        fast, slow = max(rates, key=rates.__getitem__), min(rates, key=rates.__getitem__)
        return (
            f"two clocks: the header stamps of {fast} run {1e6 * drift:.0f} ppm faster than those of {slow}: the "
            "times at which messages were logged are used"
        )
    return ""


def times_by_clock(log_s: Array, stamp_s: Array | None, used: str) -> Array:
    """The times (n,), s, of a group by the clock `used` (of Clock): its stamps where that is STAMP and there are any,
    else its log times."""
    return stamp_s if used == STAMP and stamp_s is not None else log_s


def first_s(times: Mapping[str, tuple[Array, Array | None]], used: str) -> float:
    """The earliest time of all groups, s, by the clock `used` (of Clock); infinity where none is finite. times: as in
    `choose`."""
    own = [times_by_clock(log_s, stamp_s, used) for log_s, stamp_s in times.values()]
    return min(float(np.min(t_s, initial=np.inf, where=np.isfinite(t_s))) for t_s in own)


def rows_in_time_order(t_s: Array, what: str, warnings: list[str]) -> Array:
    """The rows to keep so that times rise strictly: indices (m,) into t_s (n,), s, in the order of time, without rows
    that have no time or repeat one. What was left out or sorted, and gaps, are added to `warnings`; what: names the
    rows there. TautError where fewer than two rows are left, or times go back or repeat too often to be of one
    clock."""
    kept: Array = np.flatnonzero(np.isfinite(t_s))
    if lost := len(t_s) - len(kept):
        warnings.append(f"{what}: {lost} rows without a time were left out")
    if len(kept) < 2:
        raise TautError(f"{what}: has {len(kept)} rows with a time: expected a motion")
    kept = kept[_sorting_order(t_s[kept], what, warnings)]
    kept = kept[_mask_of_new_times(t_s[kept], what, warnings)]
    _warn_of_gaps(t_s[kept], what, warnings)
    return kept


def _sorting_order(t_s: Array, what: str, warnings: list[str]) -> Array:
    """The indices (n,) that sort t_s (n,), s, finite. If anything was out of order, that is added to `warnings`; what:
    names the rows there. TautError where times go back too often or too far."""
    step = np.diff(t_s)
    back = int(np.sum(step < 0))
    if not back:
        return np.arange(len(t_s))
    row = int(step.argmin())
    if back > max(1.0, _MOST_BACK * len(t_s)) or -step[row] > _FARTHEST_BACK_S:
        raise TautError(
            f"{what}: time goes back by {-step[row]:.6g} s at {t_s[row]:.9g} s: two clocks, or two "
            "recordings in one: split it there"
        )
    warnings.append(f"{what}: {back} rows were out of order by {-step[row]:.3g} s or less: they were sorted")
    order: Array = np.argsort(t_s, kind="stable")
    return order


def _mask_of_new_times(t_s: Array, what: str, warnings: list[str]) -> Array:
    """A mask (n,) of the times t_s (n,), s, sorted, that differ from the one before. The number of the others is added
    to `warnings`; what: names the rows there. TautError where these are too many, or all times are one."""
    new: Array = np.concatenate([[True], np.diff(t_s) != 0])
    if repeated := int(np.sum(~new)):
        if repeated > max(1.0, MAX_REPEATED_TIMES * len(t_s)):
            raise TautError(
                f"{what}: {repeated} of {len(t_s)} rows repeat the time before them: log them with finer times, each "
                "once"
            )
        warnings.append(f"{what}: {repeated} rows that repeat the time before them were left out")
        if new.sum() < 2:
            raise TautError(f"{what}: all of its rows have one time: expected a motion")
    return new


def _warn_of_gaps(t_s: Array, what: str, warnings: list[str]) -> None:
    """Adds to `warnings` the number of gaps in t_s (n,), s, rising, and the longest one. A gap is a step of more than
    _GAP_S and _GAP_STEPS usual steps. what: names the rows there."""
    step = np.diff(t_s)
    gaps = int(np.sum(step > max(_GAP_S, _GAP_STEPS * float(np.median(step)))))
    if gaps:
        longest = int(step.argmax())
        warnings.append(
            f"{what}: {gaps} gap{'s' if gaps > 1 else ''} without rows, the longest {step[longest]:.3g} s "
            f"at {t_s[longest]:.6g} s"
        )


def check_overlap(motor_s: Array, tip_s: Array, motor: str, tip: str) -> None:
    """Raises TautError where the times of motor and tip, rising, s, (n,) and (m,), do not overlap. motor, tip: their
    channels' names."""
    if motor_s[0] <= tip_s[-1] and tip_s[0] <= motor_s[-1]:
        return
    raise TautError(
        f"{motor} has times {motor_s[0]:.6g} to {motor_s[-1]:.6g} s, {tip} {tip_s[0]:.6g} to {tip_s[-1]:.6g} s: two "
        "clocks, or two recordings: record both on one clock"
    )
