"""What a driver of motors offers: the few calls that the board's application needs of the drives on one bus.

Positions are the drive's own counts, as it keeps them; times are seconds of the clock that the driver was given.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from tautline.errors import TautError

Clock = Callable[[], float]

RANGE = 3_900_000.0  # limit: counts either way of a drive that limits none: just within TL_AXIS_RANGE_MAX
STARTS = 20.0  # prior: 1/s: acceleration over top speed (top speed within 50 ms) where a drive limits none


class Missed(TautError):
    """No answer, or none that is whole, came in this cycle. The next one may."""


@dataclass(frozen=True)
class Measured:
    """Where one drive is, by its answer in a control cycle."""

    t_s: float  # the middle of the round trip, s of the driver's clock
    q: float  # counts
    velocity: float = 0.0  # counts/s
    current_ma: float = 0.0  # 0 where the drive measures none
    fault: str = ""  # what the drive says is wrong with it


@dataclass(frozen=True)
class Goal:
    """One drive's set-point in a control cycle."""

    q: float  # counts, where the drive is to be now
    speed: float  # counts/s of the path there, for drives that go on with it until the next one


@dataclass(frozen=True)
class DriveLimits:
    """The limits of one drive, as it is configured."""

    q_low: float  # counts
    q_high: float
    speed: float  # counts/s
    acceleration: float  # counts/s2
    current_ma: float = 0.0  # 0: not limited, or not known


@dataclass(frozen=True)
class Drive:
    """One drive of a bus, as it was found."""

    number: int | str  # its address on the bus, or its name
    model: str
    firmware: str
    counts_per_turn: int
    limits: DriveLimits
    referenced: bool  # it knows its position after being switched on
    per: str = "turn"  # or m: what counts_per_turn are of, where it slides


def all_off(axes: int, enable: Callable[[int, bool], None]) -> None:
    """Calls enable(axis, False) for each of the axes 0 to axes - 1, also after one has failed: a motor that cannot be
    reached must not keep the others on. Raises the first TautError afterwards."""
    errors = []
    for axis in range(axes):
        try:
            enable(axis, False)
        except TautError as error:
            errors.append(error)
    if errors:
        raise errors[0]


class Drives(Protocol):
    """The drives of one bus, each an axis. Every call takes a bounded time."""

    drives: Sequence[Drive]
    rest_s: float  # at the longest, from the last set-point to the beginning of the stop, where the host is lost
    watchdog: str  # what stops the drives then, in words
    enable_s: float  # the longest that switching one on takes, with its brake or a slow adapter

    def measure(self) -> list[Measured]:
        """Asks every drive where it is; returns the answers in the order of `drives`. Missed where one does not
        come."""

    def set_positions(self, goals: Sequence[Goal | None]) -> None:
        """Sends each drive its set-point, in the order of `drives`; None leaves one as it is."""

    def enable(self, axis: int, on: bool) -> None:
        """Switches the drive of this index on, holding where it is, or off, without torque."""

    def stop(self) -> None:
        """Switches all drives off, as far as they can still be reached."""

    def close(self) -> None:
        """Closes the bus; drives are left as they are."""
