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
_FORGET = 0.998  # per cycle in motion, of what is known of the lag
_SLOW = 0.02  # of the speed limit: below it a lag is not seen
_LAG_MOST_S = 0.2
_FOLLOWING_S = 0.15  # of motion at the speed limit: how far a drive may be behind
_CHECK_SHARE = 0.05  # of the speed limit, at which the first enable looks whether a drive moves
_LOW_DUTY, _FRICTION, _CHECK_PUSH = 8192, 0, 2621  # of the application's check; see hosted/actuator.h


@dataclass
class Timing:
    """Of a bus and its drives, since they were opened."""

    cycles: int = 0
    missed: int = 0  # cycles without a whole answer
    late: int = 0  # cycles that began more than half a period late
    jitter_s: float = 0.0  # of the time between two measurements, rms about the period
    round_trip_s: float = 0.0  # mean, of asking and being told
    round_trip_most_s: float = 0.0
    lag_s: float = 0.0  # of the slowest drive behind its set-point, in its last motion; planned for
    fault: str = ""  # what a drive said last that is wrong with it


def flash_file(where: str) -> Path:
    """The file that keeps tables and settings for these drives, as a board keeps them in flash."""
    base = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
    return base / "tautline" / f"{where.split(':')[0]}-{hashlib.sha256(where.encode()).hexdigest()[:16]}.bin"


class HostedLink:
    """A link to the application, with the drives behind it. `paced`: by a thread and the wall clock; else whoever owns
    the time calls `cycle`."""

    hello_tries = 1

    def __init__(
        self, drives: Drives, where: str, rate_hz: float, clock: Clock = time.monotonic, paced: bool = True
    ) -> None:
        """where: the drives' address, which names their flash file; paced: cycles by the clock in a thread of their
        own."""
        self.drives, self.where, self.period_s, self.timing = drives, where, 1.0 / rate_hz, Timing()
        self.log_divider = min(max(round(1e3 * self.period_s), 1), 60)  # ms between rows of a log: one each cycle
        self._clock, self._epoch_s = clock, clock()
        self._lock, self._arrived = threading.Lock(), threading.Condition()
        self._out = bytearray()
        self._gone: TautError | None = None
        self._heard_s = self._epoch_s
        self._squares, self._steps = 0.0, 0  # of steps from one cycle to the next, where neither was missed
        self._steady = False  # whether the cycle before was not missed either
        self._lag_sums = [np.zeros(2) for _ in drives.drives]  # of lag times speed, of speed squared, while it moves
        self._lags_s = [0.0 for _ in drives.drives]  # their quotients, s
        self._on = [False for _ in drives.drives]
        for drive in drives.drives:
            if not drive.limits.speed > 0.0:
                raise TautError(f"{where}: motor {drive.number} has a speed limit of 0: set one with its maker's tools")
        self._file = flash_file(where)
        flash = self._file.read_bytes() if self._file.is_file() else b""
        self._scales = [_scale(drive.limits.speed) for drive in drives.drives]  # the application's counts per drive's
        first = self._rows(self._first_measurement(), whole=True)
        self._last_s = clock()
        most_ma = max(round(min(drive.limits.current_ma for drive in drives.drives)), 0)
        kind, _, serial = where.partition(":")
        try:
            self._board = _native.HostedBoard(kind[:15], _serial(serial), min(most_ma, 0xFFFF), flash, first)
        except ValueError as error:
            raise TautError(f"{self._file}: is no memory of such motors ({error}): remove it") from error
        self._writes = 0
        self._adopt_limits_and_positions([q / _Q8 for q, _, _ in first])
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        if paced:
            self._thread = threading.Thread(target=self._pace, name="drives", daemon=True)
            self._thread.start()

    def _first_measurement(self) -> list[Measured]:
        """The first measurement of all drives; retried, as drives may still be starting."""
        for left in reversed(range(5)):
            try:
                return self.drives.measure()
            except Missed:
                if left == 0:
                    raise
        raise AssertionError

    def _rows(self, measured: list[Measured], whole: bool = False) -> list[tuple[int, int, bool]]:
        """Measurements as the application takes them: counts Q8, current in mA, and whether there is a fault. whole:
        rounded to counts, so that its positions are the drives' own. TautError where one is too far to be counted."""
        counts = [m.q * scale for m, scale in zip(measured, self._scales, strict=True)]
        for drive, q in zip(self.drives.drives, counts, strict=True):
            if not abs(q) <= _FARTHEST:
                raise TautError(
                    f"{self.where}: motor {drive.number} is at {q:.0f} counts, and up to {_FARTHEST} can be counted: "
                    "set its zero nearer with its maker's tools"
                )
        places = [round(q) * round(_Q8) if whole else round(q * _Q8) for q in counts]
        return [(q, round(m.current_ma), bool(m.fault)) for q, m in zip(places, measured, strict=True)]

    def _adopt_limits_and_positions(self, first: list[float]) -> None:
        """Sets the axes' positions to the drives', `first` in the application's counts, and where no settings are
        stored, their limits too. A drive takes no duty that could sink: it holds until its host is lost or says
        otherwise."""
        ask = self._request
        ask("hello", protocol_major=wire.wire.MAJOR, protocol_minor=wire.wire.MINOR)
        fresh = ask("get_status", axis=0).settings == wire.code("STORES", "DEFAULT")
        for axis, drive in enumerate(self.drives.drives):
            settings = dict(ask("get_settings", axis=axis).values)
            if fresh:
                limits, scale = drive.limits, self._scales[axis]
                speed = limits.speed * scale
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
        self._store_flash()

    def _request(self, name: str, **values: Any) -> wire.Message:
        """Sends the application a message of this link's own, and returns its answer. TautError where it refuses."""
        self._board.receive(wire.encode(name, 1, **values), self._us(self._clock()))
        for message in wire.Decoder().feed(self._board.transmit()):
            if message.sequence == 1 and message.name not in ("batch", "event", "progress", "onset"):
                if message.name == "error":
                    says = wire.text("REASONS", message.reason)
                    raise TautError(f"{self.where}: the limits of its drive cannot be used ('{name}': {says})")
                return message
        raise AssertionError(f"the application answers '{name}'")

    def _us(self, t_s: float) -> int:
        """The application's time, us since the link was opened, at a time of the clock, s; never below 0."""
        return max(round((t_s - self._epoch_s) * 1e6), 0)

    # -- the bus ------------------------------------------------------------------------------------------------

    def _pace(self) -> None:
        """The thread: a cycle each period until the link is closed. Late ones are counted; an error ends the link."""
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
                self._end(error)
                return
            except Exception as error:  # nobody would drive them any more, or say so
                self._end(TautError(f"{self.where}: {type(error).__name__}: {error}"))
                return

    def cycle(self) -> None:
        """One control cycle: measures, runs the application up to then, and sends its set-points. TautError where the
        drives are gone."""
        if self._gone is not None:
            raise self._gone
        began = self._clock()
        self.timing.cycles += 1
        try:
            measured = self.drives.measure()
        except Missed as missed:
            self._missed()
            if began - self._heard_s > _LOST_S:
                self._connection_lost(missed)
            return
        except TautError as error:
            self._connection_lost(error)
            return
        t_s = measured[0].t_s
        self._heard_s = t_s
        self.timing.fault = next((m.fault for m in measured if m.fault), self.timing.fault)
        with self._lock:
            rows = self._rows(measured)
            self._board.run(self._us(t_s), rows, 0)
            goals = [self._board.goal(axis) for axis in range(len(measured))]
            self._estimate_delay([q for q, _, _ in rows], goals)
            self._store_flash()
            sent = self._board.transmit()
        self._give(sent)
        waited = 0.0
        try:
            waited = self._send(goals)
        except Missed:
            self._missed()
            self._last_s = t_s
            return
        except TautError as error:
            self._connection_lost(error)
        self._note(began + waited, t_s + waited)

    def _send(self, goals: list[tuple[int, int, bool, bool]]) -> float:
        """Sends the set-points; goals: of each axis (counts Q8, counts/s Q8, whether it is on, whether in closed loop).
        Returns the seconds that switching a drive on took, during which the application stood still."""
        waited = 0.0
        wanted = [
            Goal(goal / _Q8 / scale, speed / _Q8 / scale) if on else None
            for (goal, speed, on, _), scale in zip(goals, self._scales, strict=True)
        ]
        for axis, (_, _, on, _) in enumerate(goals):
            if on != self._on[axis]:
                waited += self._switch(axis, on)
        if any(goal is not None for goal in wanted):
            self.drives.set_positions(wanted)
        return waited

    def _switch(self, axis: int, on: bool) -> float:
        """Switches an axis. Returns the seconds for which the application was made to stand still: the time this took,
        where no drive was on and it took no longer than drives name; else 0, and its rule for late control steps
        holds."""
        began = self._clock()
        with self._lock:
            self.drives.enable(axis, on)
            now = self._clock()
            patient = on and not any(self._on) and now - began <= self.drives.enable_s
            if patient:
                self._board.wait(self._us(now))
                self._heard_s = now
        self._on[axis] = on
        return now - began if patient else 0.0

    def _estimate_delay(self, places: list[int], goals: list[tuple[int, int, bool, bool]]) -> None:
        """Estimates how late each drive follows, s, by least squares of its lag over its speed while it moves; used
        once it rests. places: measured, counts Q8; goals: as of `_send`."""
        for axis, (goal, speed, _, moves) in enumerate(goals):
            sums = self._lag_sums[axis]
            v = speed / _Q8
            if moves and abs(v) > _SLOW * self.drives.drives[axis].limits.speed * self._scales[axis]:
                sums *= _FORGET
                sums += ((goal - places[axis]) / _Q8 * v, v * v)
            elif moves and v == 0.0 and sums[1] > 0.0:
                lag_s = float(np.clip(sums[0] / sums[1], 0.0, _LAG_MOST_S))
                self._lags_s[axis] = lag_s
                self.timing.lag_s = max(self._lags_s)
                self._board.lead(axis, round(lag_s * 1e6))

    def _note(self, began: float, t_s: float) -> None:
        """Keeps a cycle's round trip and jitter. began: when it began; t_s: of its measurement, s; both moved on by
        what switching a drive on took."""
        timing, n = self.timing, max(self.timing.cycles - self.timing.missed, 1)
        took = self._clock() - began
        timing.round_trip_s += (took - timing.round_trip_s) / n
        timing.round_trip_most_s = max(timing.round_trip_most_s, took)
        if self._steady:
            self._steps += 1
            self._squares += (t_s - self._last_s - self.period_s) ** 2
            timing.jitter_s = (self._squares / self._steps) ** 0.5
        self._last_s, self._steady = t_s, True

    def _missed(self) -> None:
        """Counts a cycle of which nothing came or was sent: the next one is no step from it."""
        self.timing.missed += 1
        self._steady = False

    def _connection_lost(self, error: TautError) -> None:
        """Raises BoardGone, here and for whoever reads, with how the motors come to rest."""
        says = f"{self.where}: {error}. Its motors come to rest by themselves, within {self.drives.rest_s:.2g} s and "
        gone = BoardGone(says + f"what braking takes ({self.drives.watchdog})")
        with self._arrived:
            self._gone = gone
            self._arrived.notify_all()
        raise gone

    def _end(self, error: TautError) -> None:
        """Switches all drives off and tells whoever waits for the link."""
        with contextlib.suppress(Exception):
            self.drives.stop()
        with self._arrived:
            self._gone = self._gone or error
            self._arrived.notify_all()

    def _store_flash(self) -> None:
        """Writes what was stored to the file, whole or not at all."""
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
        """Gives the application bytes from the host."""
        if self._gone is not None:
            raise self._gone
        with self._lock:
            self._board.receive(data, self._us(self._last_s))  # no later than the application's own last step
            self._store_flash()
            sent = self._board.transmit()
        self._give(sent)

    def _give(self, data: bytes) -> None:
        """Queues the application's bytes for `read`."""
        if data:
            with self._arrived:
                self._out += data
                self._arrived.notify_all()

    def read(self, timeout_s: float) -> bytes:
        """The application's bytes for the host, b"" where there are none; waits for them at most this long, not at all
        where cycles are not paced by a thread."""
        with self._arrived:
            if not self._out and self._thread is not None:
                self._arrived.wait_for(lambda: self._out or self._gone is not None, timeout_s)
            if not self._out and self._gone is not None:
                raise self._gone
            data = bytes(self._out)
            self._out.clear()
            return data

    def tables(self, axis: int) -> None:
        """None: tables travel in messages."""
        return None

    def bus(self) -> dict[str, Any]:
        """Drives, their own limits in counts, watchdog and the bus' measured timing, for JSON."""
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
        of_drives = {
            "drives": drives, "limits": limits, "rest_s": self.drives.rest_s, "watchdog": self.drives.watchdog
        }  # fmt: skip
        return {"rate_hz": 1.0 / self.period_s, **asdict(self.timing), **of_drives}

    def close(self) -> None:
        """Switches the drives off and ends the thread."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
        try:
            with contextlib.suppress(TautError):
                self.drives.stop()
        finally:
            self.drives.close()


def _scale(speed: float) -> float:
    """Counts of the application per count of the drive: halved until the application, which resolves 1/256 count, can
    count at this speed, counts/s of the drive."""
    scale = 1.0
    while speed * scale > _native.HOSTED_SPEED_MAX:
        scale *= 0.5
    return scale


def _serial(text: str) -> str:
    """A serial number of at most 31 letters, digits and dashes, all ASCII, from the end of an address."""
    return "".join(c if c.isascii() and c.isalnum() else "-" for c in text)[-31:].strip("-")
