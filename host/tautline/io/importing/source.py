"""What every kind of file gives: channels of numbers in batches, frames of pictures, on the times that it has."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from tautline.errors import TautError

Array = np.ndarray

BATCH_ROWS = 8192  # limit: of memory: rows that are held at once while a file is read
EPOCH_S = 1e8  # prior: times beyond it (three years) count from an epoch: a recording's then start at 0


@dataclass(frozen=True)
class Batch:
    """Rows of one group (a topic, or a table). A table's are in the order of the file; a topic's messages that hold
    other channels come as other batches, which may be before or after one another."""

    group: str
    log_s: Array  # (n,) s since the source's origin: when a row was written
    stamp_s: Array | None  # (n,) s since the same origin, by the sender's clock; NaN where it set none
    values: Mapping[str, Array]  # (n,) float64 by channel, NaN where a row has none


@dataclass(frozen=True)
class Fact:
    """What a file says of a channel beside its numbers."""

    type: str = ""  # of the message or column
    label: str = ""  # another name: a joint's
    unit: str = ""  # of units.UNITS; "" where the file says none
    usual: str = ""  # the unit that what wrote the file is known to take where it says none; "" where it may be any
    low: float = np.nan  # of all episodes, where the file says it
    high: float = np.nan


@dataclass(frozen=True)
class Picture:
    """One frame of a channel of pictures."""

    log_s: float  # s since the source's origin: when it was written
    stamp_s: float  # NaN where the sender set none
    data: bytes
    codec: str  # of PyAV: mjpeg, png; or a pixel format such as bgr24, then with a size
    width: int = 0
    height: int = 0


@dataclass(frozen=True)
class Clip:
    """A part of a video file. The frame at first_s of the container's time is at 0 s of the recording."""

    path: Path
    first_s: float = 0.0
    last_s: float = np.inf  # exclusive


class Source(Protocol):
    """A file or folder that was opened. It is read from the start at each call, a batch at a time."""

    path: Path
    kind: str  # "MCAP", ...
    numbers: str  # what a missing channel is a lack of, in words
    facts: dict[str, Fact]  # by channel, as far as was read
    videos: list[str]  # channels of pictures, as far as was read
    origin_s: float  # what was taken off all times
    notes: list[str]  # what a reader should know of the file as a whole

    def episodes(self) -> Sequence[int]:
        """The numbers of the episodes; (0,) where the source is one recording."""

    def batches(self, episode: int, groups: Collection[str] | None = None) -> Iterator[Batch]:
        """Reads all rows of an episode in the groups named (None: all). TautError for a file that is cut or
        unreadable."""

    def pictures(self, episode: int, video: str) -> Iterator[Picture] | Clip:
        """The frames of an episode's channel of pictures: one after the other, or a part of a video file. TautError
        where there is no such channel."""


def no_video_error(path: Path, video: str, known: Collection[str] = ()) -> TautError:
    """The error to raise where a source has no channel of pictures `video`. known: those that it has."""
    return TautError(f"{path}: has no video {video}" + (f": it has {', '.join(known)}" if known else ""))


def unknown_encoding_error(path: Path, video: str) -> TautError:
    """The error to raise where a channel of pictures holds one whose encoding is not known."""
    return TautError(f"{path}: {video} holds pictures that are no JPEG, PNG or plain colours")


def no_messages_error(path: Path) -> TautError:
    """The error to raise where a source has no episode."""
    return TautError(f"{path}: is empty: it holds no messages")


def seconds_since(origin_ns: int, time_ns: int | None) -> float:
    """The time from origin_ns to time_ns, both ns of one clock, in s; NaN where time_ns is None."""
    return np.nan if time_ns is None else (time_ns - origin_ns) * 1e-9


def origin_of(first_s: float) -> float:
    """The origin that is subtracted from a source's times, s: first_s, the first of them, if they count from an epoch
    (beyond EPOCH_S), else 0."""
    return first_s if abs(first_s) > EPOCH_S else 0.0
