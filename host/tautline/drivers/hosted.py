"""The board's application on the host, over the drives of a bus: `Board` speaks to it as to a board on USB.

A cycle asks the drives where they are, lets the application run until then, and hands each its set-point. Between two
cycles drives are taken to move in straight lines. The application is the board's own code, at the board's own rate;
what is slower than a board is how often a drive is asked and told, and how late it follows: both are measured here.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import threading
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tautline import _native
from tautline.device import wire
from tautline.device.link import BoardGone
from tautline.drivers.drives import Clock, Drives, Goal, Measured, Missed
from tautline.errors import TautError

_Q8 = 256.0
_FARTHEST = 0x7FFFFF  # format: counts, of the application's 32 bits in Q8
_LOST_S = 0.1  # without an answer a drive is lost: the application's own longest pause, and most drives' watchdog
_FORGET = 0.998  # factor, per cycle in motion, by which older cycles count less for the lag
_SLOW = 0.02  # of the speed limit: in slower motion a lag is not measured
_LAG_MOST_S = 0.2  # a larger lag is taken as this one
_FOLLOWING_S = 0.15  # a drive may be as far behind as it goes in this time at the speed limit
_CHECK_SHARE = 0.05  # of the speed limit: the speed at which the first enable checks whether a drive moves
_LOW_DUTY, _FRICTION, _CHECK_PUSH = 8192, 0, 2621  # of the application's check; see hosted/actuator.h


@dataclass
class Timing:
    """How regularly a bus and its drives have worked since they were opened."""

    cycles: int = 0
    missed: int = 0  # cycles without a whole answer
    late: int = 0  # cycles that began more than half a period late
    jitter_s: float = 0.0  # of the time between two measurements, rms about the period
    round_trip_s: float = 0.0  # mean, of asking and being told
    round_trip_most_s: float = 0.0
    lag_s: float = 0.0  # of the slowest drive behind its set-point, in its last motion; planned for
    fault: str = ""  # what a drive said last that is wrong with it


def flash_file(where: str) -> Path:
    """Returns the path of the file that keeps tables and settings for the drives at the address `where`, as a board
    keeps them in flash: below $XDG_STATE_HOME."""
    base = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
    return base / "tautline" / f"{where.split(':')[0]}-{hashlib.sha256(where.encode()).hexdigest()[:16]}.bin"


class HostedLink:
    """A link to the board's application, which runs here and moves the drives."""

    hello_tries = 1

    def __init__(
        self, drives: Drives, where: str, rate_hz: float, clock: Clock = time.monotonic, paced: bool = True
    ) -> None:
        """Starts the application at the drives' positions. where: the drives' address, which names their flash file;
        rate_hz: of the control cycles; paced: whether a thread calls `cycle` by the wall clock, else the caller does.
        TautError where the drives or the flash file cannot be used."""
        self.drives, self.where, self.period_s, self.timing = drives, where, 1.0 / rate_hz, Timing()
        self.log_divider = min(max(round(1e3 * self.period_s), 1), 60)  # ms between rows of a log: one each cycle
        self._clock, self._epoch_s = clock, clock()
        self._lock, self._arrived = threading.Lock(), threading.Condition()
        self._out = bytearray()  # the application's bytes that nobody has read yet
        self._gone: TautError | None = None  # why the link has ended
        self._answered_s = self._epoch_s  # when the drives answered last
        # Of the steps from one measurement to the next, neither missed: sum of (step - period)^2, s^2, and count.
        self._squared_deviations, self._steps_counted = 0.0, 0
        self._last_cycle_whole = False  # whether the cycle before was not missed
        self._lag_sums = [np.zeros(2) for _ in drives.drives]  # of lag times speed, of speed squared, while it moves
        self._lags_s = [0.0 for _ in drives.drives]  # their quotients, s
        self._enabled = [False for _ in drives.drives]
        for drive in drives.drives:
            if not drive.limits.speed > 0.0:
                raise TautError(f"{where}: motor {drive.number} has a speed limit of 0: set one with its maker's tools")
        self._file = flash_file(where)
        flash = self._file.read_bytes() if self._file.is_file() else b""
        # The application's counts in one of the drive's.
        self._scales = [_counts_scale(drive.limits.speed) for drive in drives.drives]
        first = self._as_application_rows(self._first_measurement(), whole=True)
        self._last_s = clock()  # up to which the application has run
        most_ma = max(round(min(drive.limits.current_ma for drive in drives.drives)), 0)
        kind, _, serial = where.partition(":")
        try:
            self._board = _native.HostedBoard(kind[:15], _serial_number(serial), min(most_ma, 0xFFFF), flash, first)
        except ValueError as error:
            raise TautError(f"{self._file}: is no memory of such motors ({error}): remove it") from error
        self._writes = 0  # of the application's flash, that its file has
        self._adopt_limits_and_positions([q / _Q8 for q, _, _ in first])
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        if paced:
            self._thread = threading.Thread(target=self._pace, name="drives", daemon=True)
            self._thread.start()

    def _first_measurement(self) -> list[Measured]:
        """Measures all drives, with five tries, as they may still be starting. Missed where none succeeds."""
        for left in reversed(range(5)):
            try:
                return self.drives.measure()
            except Missed:
                if left == 0:
                    raise
        raise AssertionError

    def _as_application_rows(self, measured: list[Measured], whole: bool = False) -> list[tuple[int, int, bool]]:
        """Converts measurements, one of each drive, to what the application takes: a row (counts Q8, mA, whether there
        is a fault) for each axis. whole: whether positions are rounded to whole counts. TautError where a position does
        not fit into the application's 32 bits."""
        counts = [m.q * scale for m, scale in zip(measured, self._scales, strict=True)]
        for drive, q in zip(self.drives.drives, counts, strict=True):
            if not abs(q) <= _FARTHEST:
                raise TautError(
                    f"{self.where}: motor {drive.number} is at {q:.0f} counts, and up to {_FARTHEST} can be counted: "
                    "set its zero nearer with its maker's tools"
                )
        counts_q8 = [round(q) * round(_Q8) if whole else round(q * _Q8) for q in counts]
        return [(q, round(m.current_ma), bool(m.fault)) for q, m in zip(counts_q8, measured, strict=True)]

    def _adopt_limits_and_positions(self, first: list[float]) -> None:
        """Sets the axes' positions to `first`, the drives' in the application's counts, for drives that know theirs.
        Where the flash file holds no settings, also sets and stores the axes' settings from the drives' limits, with
        hold_ms 0: an axis that is on holds until its host is lost or says otherwise."""
        ask = self._ask_application
        ask("hello", protocol_major=wire.wire.MAJOR, protocol_minor=wire.wire.MINOR)
        is_unset = ask("get_status", axis=0).settings == wire.code("STORES", "DEFAULT")
        for axis, drive in enumerate(self.drives.drives):
            settings = dict(ask("get_settings", axis=axis).values)
            if is_unset:
                limits, scale = drive.limits, self._scales[axis]
                speed = limits.speed * scale
                # feed_forward, duty per 1000 counts/s: the check's push then moves at _CHECK_SHARE of the speed limit.
                settings.update(
                    key=wire.wire.KEY, q_low=limits.q_low * scale, q_high=limits.q_high * scale, speed_s=speed,
                    acceleration_s2=min(limits.acceleration * scale, _native.HOSTED_ACCELERATION_MAX),
                    friction=_FRICTION / 32768, following_error=max(_FOLLOWING_S * speed, 8.0),  # counts
                    low_duty=_LOW_DUTY / 32768, current_ma=0,
                    feed_forward=min(max(round(1000.0 * _CHECK_PUSH / (_CHECK_SHARE * speed)), 1), wire.wire.GAIN_MAX),
                    arrive=4.0, hold_ms=0, commissioned=1,
                )  # fmt: skip
                ask("settings", **settings)
            if drive.referenced:
                ask("set_position", axis=axis, q=first[axis])
        self._save_flash()

    def _ask_application(self, name: str, **values: Any) -> wire.Message:
        """Sends the application a message of this link's own, as a host would, and returns its answer. TautError where
        the application refuses, as it does limits that it cannot use."""
        self._board.receive(wire.encode(name, 1, **values), self._us(self._clock()))
        for message in wire.Decoder().feed(self._board.transmit()):
            if message.sequence == 1 and message.name not in ("batch", "event", "progress", "onset"):
                if message.name == "error":
                    says = wire.text("REASONS", message.reason)
                    raise TautError(f"{self.where}: the limits of its drive cannot be used ('{name}': {says})")
                return message
        raise AssertionError(f"the application answers '{name}'")

    def _us(self, t_s: float) -> int:
        """Converts a time of the clock, s, to the application's: us since the link was opened; never below 0."""
        return max(round((t_s - self._epoch_s) * 1e6), 0)

    # -- the bus ------------------------------------------------------------------------------------------------

    def _pace(self) -> None:
        """Body of the thread: one `cycle` each period until the link is closed. A cycle that begins more than half a
        period late is counted; an error switches the drives off and ends the link."""
        due = self._clock()
        while not self._stop.is_set():
            due += self.period_s
            now = self._clock()
            if now > due + 0.5 * self.period_s:
                self.timing.late += 1
                due = now
            self._stop.wait(max(due - now, 0.0))
            try:
                self.cycle()
            except TautError as error:
                self._stop_and_report(error)
                return
            except Exception as error:  # nobody would drive them any more, or say so
                self._stop_and_report(TautError(f"{self.where}: {type(error).__name__}: {error}"))
                return

    def cycle(self) -> None:
        """Makes one control cycle: measures, runs the application up to then, and sends its set-points. A cycle in
        which an answer is missing is only counted. TautError where the drives are gone, or have not answered for
        _LOST_S."""
        if self._gone is not None:
            raise self._gone
        began = self._clock()
        self.timing.cycles += 1
        try:
            measured = self.drives.measure()
        except Missed as missed:
            self._count_missed()
            if began - self._answered_s > _LOST_S:
                self._connection_lost(missed)
            return
        except TautError as error:
            self._connection_lost(error)
            return
        t_s = measured[0].t_s
        self._answered_s = t_s
        self.timing.fault = next((m.fault for m in measured if m.fault), self.timing.fault)
        with self._lock:
            rows = self._as_application_rows(measured)
            self._board.run(self._us(t_s), rows, 0)  # 0: the motors' supply is not measured
            goals = [self._board.goal(axis) for axis in range(len(measured))]
            self._estimate_delay([q for q, _, _ in rows], goals)
            self._save_flash()
            sent = self._board.transmit()
        self._queue_for_host(sent)
        waited = 0.0
        try:
            waited = self._send(goals)
        except Missed:
            self._count_missed()
            self._last_s = t_s
            return
        except TautError as error:
            self._connection_lost(error)
        self._update_timing(began + waited, t_s + waited)

    def _send(self, goals: list[tuple[int, int, bool, bool]]) -> float:
        """Sends the application's set-points to the drives, and switches those whose axis was switched. goals: of each
        axis (counts Q8, counts/s Q8, whether it is on, whether in closed loop). Returns the seconds for which the
        application's time was held meanwhile (see `_switch`). Missed or TautError as the drives raise them."""
        waited = 0.0
        set_points = [
            Goal(goal / _Q8 / scale, speed / _Q8 / scale) if on else None
            for (goal, speed, on, _), scale in zip(goals, self._scales, strict=True)
        ]
        for axis, (_, _, on, _) in enumerate(goals):
            if on != self._enabled[axis]:
                waited += self._switch(axis, on)
        if any(goal is not None for goal in set_points):
            self.drives.set_positions(set_points)
        return waited

    def _switch(self, axis: int, on: bool) -> float:
        """Switches the drive of an axis on or off. If it is the first one to be switched on and takes no longer than
        `enable_s`, the application's time is held meanwhile; returns for how many seconds. Else returns 0: the
        application then sees one late control step."""
        began = self._clock()
        with self._lock:
            self.drives.enable(axis, on)
            now = self._clock()
            hold_time = on and not any(self._enabled) and now - began <= self.drives.enable_s
            if hold_time:
                self._board.wait(self._us(now))
                self._answered_s = now
        self._enabled[axis] = on
        return now - began if hold_time else 0.0

    def _estimate_delay(self, places: list[int], goals: list[tuple[int, int, bool, bool]]) -> None:
        """Estimates the lag of each drive behind its set-points, s, while its axis moves in closed loop: the
        least-squares ratio of how far it is behind, counts, to the set-point's speed, counts/s, in which older cycles
        count less. Once the set-point rests the application gets the lag, and plans that much ahead. places: measured
        positions, counts Q8; goals: as in `_send`."""
        for axis, (goal, speed, _, closed_loop) in enumerate(goals):
            sums = self._lag_sums[axis]
            counts_per_s = speed / _Q8
            slowest = _SLOW * self.drives.drives[axis].limits.speed * self._scales[axis]  # counts/s of the application
            if closed_loop and abs(counts_per_s) > slowest:
                sums *= _FORGET  # sum of error times speed, sum of speed squared
                sums += ((goal - places[axis]) / _Q8 * counts_per_s, counts_per_s**2)
            elif closed_loop and counts_per_s == 0.0 and sums[1] > 0.0:
                lag_s = float(np.clip(sums[0] / sums[1], 0.0, _LAG_MOST_S))
                self._lags_s[axis] = lag_s
                self.timing.lag_s = max(self._lags_s)
                self._board.lead(axis, round(lag_s * 1e6))

    def _update_timing(self, began: float, t_s: float) -> None:
        """Adds a cycle with whole answers to `timing`: its round trip, and its step from the cycle before if that was
        whole, too. began: when the cycle began, t_s: when it measured, s of the clock; to both the caller adds what
        switching a drive on took, so that this does not count."""
        timing, n = self.timing, max(self.timing.cycles - self.timing.missed, 1)
        took = self._clock() - began
        timing.round_trip_s += (took - timing.round_trip_s) / n
        timing.round_trip_most_s = max(timing.round_trip_most_s, took)
        if self._last_cycle_whole:
            self._steps_counted += 1
            self._squared_deviations += (t_s - self._last_s - self.period_s) ** 2
            timing.jitter_s = (self._squared_deviations / self._steps_counted) ** 0.5
        self._last_s, self._last_cycle_whole = t_s, True

    def _count_missed(self) -> None:
        """Counts a cycle in which no answer came or no set-point was sent. The step from it to the next one does not
        count for the jitter."""
        self.timing.missed += 1
        self._last_cycle_whole = False

    def _connection_lost(self, error: TautError) -> None:
        """Ends the link: raises BoardGone, here and in each later `read`, `write` or `cycle`, with the error and how
        the motors come to rest."""
        says = f"{self.where}: {error}. Its motors come to rest by themselves, within {self.drives.rest_s:.2g} s and "
        gone = BoardGone(says + f"what braking takes ({self.drives.watchdog})")
        with self._arrived:
            self._gone = gone
            self._arrived.notify_all()
        raise gone

    def _stop_and_report(self, error: TautError) -> None:
        """Ends the link after an error: switches all drives off; each later `read`, `write` or `cycle` raises the
        error."""
        with contextlib.suppress(Exception):
            self.drives.stop()
        with self._arrived:
            self._gone = self._gone or error
            self._arrived.notify_all()

    def _save_flash(self) -> None:
        """Writes the application's flash to its file if it has changed: whole or not at all, by renaming a new file.
        TautError where it cannot be written."""
        if self._board.flash_writes == self._writes:
            return
        self._writes = self._board.flash_writes
        fresh = self._file.with_suffix(f".{os.getpid()}")
        try:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            fresh.write_bytes(self._board.flash)
            fresh.replace(self._file)
        except OSError as error:
            raise TautError(f"{self._file}: cannot be written ({error.strerror}): set XDG_STATE_HOME") from error

    # -- the link -----------------------------------------------------------------------------------------------

    def write(self, data: bytes) -> None:
        """Gives the application bytes from the host and queues its answers. TautError where the link has ended."""
        if self._gone is not None:
            raise self._gone
        with self._lock:
            self._board.receive(data, self._us(self._last_s))  # no later than the application's own last step
            self._save_flash()
            sent = self._board.transmit()
        self._queue_for_host(sent)

    def _queue_for_host(self, data: bytes) -> None:
        """Queues the application's bytes for `read`."""
        if data:
            with self._arrived:
                self._out += data
                self._arrived.notify_all()

    def read(self, timeout_s: float) -> bytes:
        """Returns the application's bytes for the host, b"" where there are none. Waits for them up to timeout_s; not
        at all where no thread makes the cycles. Raises the link's error where it has ended and no bytes are left."""
        with self._arrived:
            if not self._out and self._thread is not None:
                self._arrived.wait_for(lambda: self._out or self._gone is not None, timeout_s)
            if not self._out and self._gone is not None:
                raise self._gone
            data = bytes(self._out)
            self._out.clear()
            return data

    def tables(self, axis: int) -> None:
        """Returns None: tables travel in messages."""
        return None

    def bus(self) -> dict[str, Any]:
        """Returns what is known of drives and bus, for JSON: rate, `Timing`, each drive in words, its own limits in the
        application's counts (mA for the current), and what stops it when the host is lost."""
        drives = [
            f"{drive.number}: {drive.model}, firmware {drive.firmware}, "
            f"{drive.counts_per_turn * scale:g} counts a {drive.per}"
            for drive, scale in zip(self.drives.drives, self._scales, strict=True)
        ]
        limits = [
            {
                "q_low": drive.limits.q_low * scale, "q_high": drive.limits.q_high * scale,
                "speed": drive.limits.speed * scale, "acceleration": drive.limits.acceleration * scale,
                "current_ma": drive.limits.current_ma,
            }
            for drive, scale in zip(self.drives.drives, self._scales, strict=True)
        ]  # fmt: skip
        return {
            "rate_hz": 1.0 / self.period_s, **asdict(self.timing), "drives": drives, "limits": limits,
            "rest_s": self.drives.rest_s, "watchdog": self.drives.watchdog,
        }  # fmt: skip

    def close(self) -> None:
        """Ends the thread, switches the drives off as far as they answer, and closes their bus."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
        try:
            with contextlib.suppress(TautError):
                self.drives.stop()
        finally:
            self.drives.close()


def _counts_scale(speed: float) -> float:
    """Returns how many of the application's counts one count of a drive is: 1, halved until the drive's top `speed`,
    its counts/s, is within the application's limit. Nothing is lost, as the application resolves 1/256 count."""
    scale = 1.0
    while speed * scale > _native.HOSTED_SPEED_MAX:
        scale *= 0.5
    return scale


def _serial_number(text: str) -> str:
    """Makes a board's serial number of the end of an address, `text`: at most 31 ASCII letters, digits and dashes."""
    return "".join(c if c.isascii() and c.isalnum() else "-" for c in text)[-31:].strip("-")
