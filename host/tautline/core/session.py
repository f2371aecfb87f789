"""Recordings on one clock: whoever looks at several asks it where they lie."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from tautline.recording import Recording
from tautline.value import Value

GAP_S = 1.0  # prior: that an unknown gap is taken for


@dataclass(frozen=True)
class SessionClock:
    """Add offset_s[i] to the times of recording i. Where `known` is false, how long the gap before it was is unknown:
    its own clock overlaps those of recordings before it, and GAP_S is stated instead."""

    offset_s: tuple[float, ...]
    known: tuple[bool, ...]

    @classmethod
    def of(cls, recordings: Sequence[Recording]) -> Self:
        """The offsets, s, that put recordings on one clock. A recording shares the clock of those before it where their
        times do not overlap, in whatever order they are given. One that overlaps is put GAP_S after the end of all
        before it, and later ones that begin after its own begin may share its clock."""
        offsets: list[float] = []
        known: list[bool] = []
        group: list[tuple[float, float]] = []  # spans that share the clock in use
        offset, opened, end = 0.0, -np.inf, -np.inf  # that clock's; where its spans may begin; the end of all so far
        for recording in recordings:
            first, last = float(recording.motor.t_s[0]), float(recording.motor.t_s[-1])
            shares = first >= opened and all(last <= low or first >= high for low, high in group)
            if not shares:
                group, offset, opened = [], end + GAP_S - first, first
            group.append((first, last))
            offsets.append(offset)
            known.append(shares)
            end = max(end, last + offset)
        return cls(tuple(offsets), tuple(known))


@dataclass(frozen=True, eq=False, repr=False)
class Session(Value, Sequence[Recording]):
    """Several recordings, which every function takes as it takes a list of them."""

    recordings: tuple[Recording, ...]

    def __init__(self, recordings: Sequence[Recording]) -> None:
        """Keeps the recordings, in the order given."""
        object.__setattr__(self, "recordings", tuple(recordings))

    @cached_property
    def clock(self) -> SessionClock:
        """Where each of the recordings lies on the session's clock, in the order given."""
        return SessionClock.of(self.recordings)

    def in_time(self) -> Session:
        """The same session in order of time, the earliest recording first: results then do not depend on the order of
        the files."""
        begins = [
            float(r.motor.t_s[0]) + offset for r, offset in zip(self.recordings, self.clock.offset_s, strict=True)
        ]
        return Session([self.recordings[i] for i in np.argsort(begins, kind="stable")])

    def __len__(self) -> int:
        """How many recordings there are."""
        return len(self.recordings)

    def __getitem__(self, i):  # type: ignore[no-untyped-def]
        """The i-th recording; of a slice a tuple of them."""
        return self.recordings[i]

    def __iter__(self) -> Iterator[Recording]:
        """The recordings, in order."""
        return iter(self.recordings)
