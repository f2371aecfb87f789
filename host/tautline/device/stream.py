"""Set-points of the tip for teleoperation: paced by the wall clock, late ones counted; the axis is at rest
afterwards."""

from __future__ import annotations

import contextlib
import time
from types import TracebackType
from typing import Any

from tautline.compensation import MODES
from tautline.device import wire
from tautline.device.board import Board
from tautline.errors import TautError

_LEAD_US = 8_000  # a set-point holds so long after it was sent: the board moves there in a straight line
_ALIGN_S = 0.25  # from one alignment of the clocks to the next


class SetPointStream:
    """Sends set-points of the tip's angle c*, deg, to one axis through its tables. After the block the axis is at rest
    and off."""

    def __init__(self, board: Board, axis: int, silence_s: float = 0.1) -> None:
        """Checks that the axis is there, without a fault, and knows its position; nothing moves yet. silence_s: after
        so long without a set-point the board brings the axis to rest by itself. TautError with the remedy."""
        board.check_axis(axis)
        board.check_fault(axis)
        board.check_reference(axis)
        self._board, self._axis, self._silence_s = board, axis, silence_s
        self.start_deg = 0.0  # of the tip's set-point as the axis began to follow
        self.sent = 0
        self.late = 0  # calls of `pace` that came more than half a period too late
        self.silences = 0  # after which the axis was made to follow again
        # Host times, s: when the next set-point is due, when the stream began and ended (0: not yet), when the last
        # one was sent, and when the clocks were aligned last.
        self._next = self._began = self._ended = self._last = self._aligned = 0.0

    def __enter__(self) -> SetPointStream:
        """Aligns the clocks, switches the motor on and makes the axis follow set-points from where it is (`start_deg`);
        the first period of `pace` begins."""
        self._board.align(16)
        self._board.refused.clear()
        try:
            self._board.switch_on(self._axis)
            self._follow()
            self.start_deg = float(self._board.status(self._axis).c_ref)
        except BaseException:
            with contextlib.suppress(TautError):  # gone: what failed says so
                self._board.ask("enable", axis=self._axis, on=0)
            raise
        self._began = self._next = self._last = time.monotonic()
        return self

    def _follow(self) -> None:
        """Makes the board take set-points of the tip's angle, fully compensated by its table."""
        silence_us, configuration = round(self._silence_s * 1e6), 1  # `target` of tl_wire.h's follow: the tip's angle
        self._board.ask(
            "follow", axis=self._axis, target=configuration, compensation=MODES["full"], silence_us=silence_us
        )

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Brings the axis to rest and switches it off, waiting 2 s at most. TautError for a fault, unless the block has
        failed already."""
        self._ended = time.monotonic()
        self._board.ask("enable", axis=self._axis, on=0)
        while self._board.status(self._axis).mode != wire.code("MODES", "OFF") and time.monotonic() < self._ended + 2.0:
            time.sleep(0.01)
        if kind is None:
            self._board.check_fault(self._axis)  # one that came too late for pace() to see

    def send(self, c_deg: float) -> bool:
        """Sends a set-point of the tip's angle, deg, to be reached _LEAD_US from now. False where nothing was sent as
        the axis is still coming to rest after a silence: call it again. TautError for an angle that does not fit into
        the message."""
        value = int(wire.set_point_values(c_deg, wire.DEG))
        now = time.monotonic()
        # 0.9: by the time it arrives the board may have come to rest.
        if now - self._last > 0.9 * self._silence_s and not self._resume():
            return False
        at_us = self._board.clock.board_us(now) + _LEAD_US
        self._board.tell("set_point", axis=self._axis, value=value, at_us=at_us)
        self.sent += 1
        self._last = now
        return True

    def _resume(self) -> bool:
        """After a silence of this stream: if the axis has come to rest, makes it follow again from where it is. Returns
        whether the axis takes set-points now: it does not while it is still coming to rest. TautError for a fault."""
        mode = self._board.status(self._axis).mode
        if mode == wire.code("MODES", "HOLD"):
            self._follow()
            self.silences += 1
            return True
        self._board.check_fault(self._axis)
        return bool(mode == wire.code("MODES", "FOLLOW_TIP"))

    def pace(self, period_s: float) -> None:
        """Sleeps until the next set-point is due, period_s after the one before. A caller that is more than half a
        period late counts in `late`, and the time goes on from there. Every _ALIGN_S it also aligns the clocks and
        looks at what the board has refused. TautError where the axis has a fault."""
        self._next += period_s
        now = time.monotonic()
        if now > self._next + 0.5 * period_s:
            self.late += 1
            self._next = now
        if now > self._aligned + _ALIGN_S:
            self._board.align(1)
            self._aligned = now
            if any(error.reason == "FAULT" for error in self._board.refused):
                self._board.check_fault(self._axis)
            if any(error.reason == "NOT_FOLLOWING" for error in self._board.refused):
                self._last = 0.0  # it had come to rest when they came: `send` resumes
                self._board.refused = [e for e in self._board.refused if e.reason != "NOT_FOLLOWING"]
        time.sleep(max(self._next - time.monotonic(), 0.0))

    @property
    def seconds(self) -> float:
        """How long the block lasted, or has lasted so far, s."""
        return (self._ended or time.monotonic()) - self._began

    @property
    def rate_hz(self) -> float:
        """Set-points sent per second, on the mean."""
        return self.sent / max(self.seconds, 1e-9)

    @property
    def refused(self) -> int:
        """How many set-points the board has refused, without those that it refused after a silence."""
        return len(self._board.refused)

    def summary(self) -> dict[str, Any]:
        """Returns what `taut stream --json` says of the stream: set-points sent, late and refused, seconds, rate in Hz,
        silences."""
        return {
            "sent": self.sent,
            "seconds": self.seconds,
            "rate_hz": self.rate_hz,
            "late": self.late,
            "silences": self.silences,
            "refused": self.refused,
        }
