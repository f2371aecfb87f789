"""What is in a source: its channels with count, rate and range, and each thinned to what a proposal is made from."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tautline.errors import TautError
from tautline.io.importing.source import Array, Batch, Fact, Source
from tautline.io.importing.tip import QUATERNION, bending_deg

Progress = Callable[[float, str], None]

_KEPT = 4096  # tolerance: rows of a group, at least, that a proposal is made from
_NEAR = 3  # display: names that an error offers


@dataclass(frozen=True)
class Channel:
    name: str
    group: str  # topic; "" where the source is one table
    fact: Fact
    count: int  # finite numbers
    rate_hz: float  # of its group's rows
    low: float
    high: float
    t_s: Array  # (k,) thinned, by the log
    values: Array  # (k,)

    @property
    def moves(self) -> bool:
        """Whether its numbers differ."""
        return self.count > 1 and self.high > self.low


@dataclass(frozen=True)
class Listing:
    episode: int
    channels: Mapping[str, Channel]
    videos: Sequence[str]
    clocks: Mapping[str, tuple[Array, Array | None]]  # by group: log and stamps, thinned


_Part = tuple[Array, Array | None, dict[str, Array]]  # of a group: log times, stamps, values by channel; (n,) each


@dataclass
class Rows:
    """All rows of the channels that were asked for, of one group."""

    log_s: Array
    stamp_s: Array | None
    values: dict[str, Array]


@dataclass
class _Group:
    """A group's rows as they come: each stride-th of them is kept, so that no more than 2 * _KEPT are held."""

    rows: int = 0
    stride: int = 1
    kept: list[tuple[Array, Array, dict[str, Array]]] = field(default_factory=list)
    held: int = 0
    first_s: float = np.inf
    last_s: float = -np.inf
    count: dict[str, int] = field(default_factory=dict)
    low: dict[str, float] = field(default_factory=dict)
    high: dict[str, float] = field(default_factory=dict)

    def add(self, batch: Batch) -> None:
        """Counts a batch's rows and their range, and keeps each stride-th; where too many are kept, the stride
        doubles."""
        n = len(batch.log_s)
        self.first_s = min(self.first_s, float(np.nanmin(batch.log_s)))
        self.last_s = max(self.last_s, float(np.nanmax(batch.log_s)))
        for name, column in batch.values.items():
            finite = column[np.isfinite(column)]
            if len(finite):
                self.count[name] = self.count.get(name, 0) + len(finite)
                self.low[name] = min(self.low.get(name, np.inf), float(finite.min()))
                self.high[name] = max(self.high.get(name, -np.inf), float(finite.max()))
            else:
                self.count.setdefault(name, 0)
        chosen = np.arange(-self.rows % self.stride, n, self.stride)
        stamps = np.full(n, np.nan) if batch.stamp_s is None else batch.stamp_s
        self._keep(batch.log_s[chosen], stamps[chosen], {name: v[chosen] for name, v in batch.values.items()})
        self.rows += n
        while self.held > 2 * _KEPT:
            log_s, stamp_s, values = self.joined()
            self.stride *= 2
            self.kept, self.held = [], 0
            self._keep(log_s[::2], stamp_s[::2], {name: v[::2].copy() for name, v in values.items()})

    def _keep(self, log_s: Array, stamp_s: Array, values: dict[str, Array]) -> None:
        self.kept.append((log_s, stamp_s, values))
        self.held += len(log_s)

    def joined(self) -> tuple[Array, Array, dict[str, Array]]:
        """All kept rows: log times and stamps (k,) s, and values (k,) by channel, NaN where a row has none."""
        names = dict.fromkeys(name for _, _, values in self.kept for name in values)
        return (
            np.concatenate([log_s for log_s, _, _ in self.kept]),
            np.concatenate([stamp_s for _, stamp_s, _ in self.kept]),
            {n: np.concatenate([v.get(n, np.full(len(t), np.nan)) for t, _, v in self.kept]) for n in names},
        )


def scan(source: Source, episode: int | None, progress: Progress) -> Listing:
    """One pass over an episode (None: the first): at most 8192 rows of each channel, (k,), t_s in s. TautError where it
    has no rows or no such episode."""
    episodes = source.episodes()
    if not episodes:
        raise TautError(f"{source.path}: is empty: it holds no messages")
    episode = episodes[0] if episode is None else episode
    check_episode(source, episode)
    groups: dict[str, _Group] = {}
    rows = 0
    for batch in source.batches(episode):
        groups.setdefault(batch.group, _Group()).add(batch)
        rows += len(batch.log_s)
        progress(0.5, f"{rows} rows read")
    channels: dict[str, Channel] = {}
    clocks: dict[str, tuple[Array, Array | None]] = {}
    for group, held in sorted(groups.items()):
        log_s, stamp_s, values = held.joined()
        clocks[group] = (log_s, None if np.isnan(stamp_s).all() else stamp_s)
        span = held.last_s - held.first_s
        rate = (held.rows - 1) / span if span > 0 else 0.0
        for name, kept in values.items():
            fact = source.facts.get(name, Fact())
            low, high = held.low.get(name, np.nan), held.high.get(name, np.nan)
            channels[name] = Channel(name, group, fact, held.count[name], rate, low, high, log_s, kept)
        for prefix in _orientations(values):
            angle, _ = bending_deg(np.column_stack([values[f"{prefix}.{axis}"] for axis in QUATERNION]))
            if np.isfinite(angle).any():
                fact = Fact(QUATERNION_TYPE, unit="deg")
                low, high = float(np.nanmin(angle)), float(np.nanmax(angle))
                channels[prefix] = Channel(prefix, group, fact, held.rows, rate, low, high, log_s, angle)
    if not channels and not source.videos:
        raise TautError(f"{source.path}: holds no {source.numbers} with numbers: is it the right file?")
    return Listing(episode, channels, list(source.videos), clocks)


def check_episode(source: Source, episode: int) -> None:
    """TautError where a source that is not empty has no such episode."""
    listed = source.episodes()
    if episode not in listed:
        raise TautError(f"{source.path}: has no episode {episode}: its episodes are {listed[0]} to {listed[-1]}")


QUATERNION_TYPE = "orientation"


def _orientations(names: Collection[str]) -> list[str]:
    """Names whose .x, .y, .z and .w are all channels: quaternions."""
    ends = [name.removesuffix(".w") for name in names if name.endswith(".w")]
    return [each for each in ends if all(f"{each}.{axis}" in names for axis in QUATERNION)]


def resolve(wanted: str, source: Source, known: Collection[str]) -> str:
    """The channel that is meant by its name, its label, or NAME[label]. TautError with the nearest ones."""
    if wanted in known:
        return wanted
    labelled = {
        f"{name.rpartition('[')[0]}[{source.facts[name].label}]": name for name in known if _label(source, name)
    }
    if wanted in labelled:
        return labelled[wanted]
    same = [name for name in known if _label(source, name) == wanted]
    if len(same) == 1:
        return same[0]
    if any(name.startswith(f"{wanted}.") for name in known):
        return wanted  # of several: an orientation, or a place in the image
    near = same or difflib.get_close_matches(wanted, list(known), _NEAR, 0.5) or sorted(known)[:_NEAR]
    hint = f": is it {' or '.join(near)}?" if near else ""
    raise TautError(f"{source.path}: has no {source.numbers} {wanted}{hint} 'taut import {source.path}' lists all")


def _label(source: Source, name: str) -> str:
    """What the file calls a channel beside its name, a joint for one; "" where nothing."""
    return source.facts[name].label if name in source.facts else ""


def find(source: Source, episode: int, wanted: Sequence[str]) -> dict[str, tuple[str, str]]:
    """(channel, group) of each name that was asked for, as `resolve` takes it. Reads no further than until all are
    known; TautError where one never is."""
    known: dict[str, str] = dict.fromkeys(source.facts, "")
    for batch in source.batches(episode):
        known.update(dict.fromkeys(batch.values, batch.group))
        try:
            return {each: (name := resolve(each, source, known), _group(name, known)) for each in wanted}
        except TautError:
            continue
    if not known:
        raise _empty(source, episode)
    return {each: (name := resolve(each, source, known), _group(name, known)) for each in wanted}


def _group(name: str, known: Mapping[str, str]) -> str:
    """The group of a channel, or of a name that stands for several: that of the first one below it."""
    return known[name] if name in known else next(g for each, g in known.items() if each.startswith(f"{name}."))


def read(source: Source, episode: int, wanted: Mapping[str, Collection[str]], progress: Progress) -> dict[str, Rows]:
    """All rows of the channels wanted (by group), by group; channels of one group that no message holds together, as
    those of two publishers, have rows of their own, by the first of them. Memory: 8 bytes a number and time, and once
    more for one of them."""
    parts: dict[str, dict[frozenset[str], list[_Part]]] = {group: {} for group in wanted}
    rows = 0
    for batch in source.batches(episode, list(wanted)):
        chosen = {name: batch.values[name].copy() for name in wanted.get(batch.group, ()) if name in batch.values}
        if not chosen:
            continue
        parts[batch.group].setdefault(frozenset(chosen), []).append((batch.log_s, batch.stamp_s, chosen))  # no views
        rows += len(batch.log_s)
        progress(0.5, f"{rows} rows read")
    if not rows:
        raise _empty(source, episode)
    found: dict[str, Rows] = {}
    for group, by_names in parts.items():
        for names in _together(by_names, wanted[group]):
            own = [part for held, each in by_names.items() if held <= set(names) for part in each]
            found[names[0] if group in found else group] = _joined(own, names, bool(group))
    return found


def _together(held: Collection[frozenset[str]], wanted: Collection[str]) -> list[list[str]]:
    """The channels of a group that messages hold together, also by way of others; as `wanted` orders them. held: which
    ones there are in one message."""
    sets: list[frozenset[str]] = []
    for each in held:
        touching = [known for known in sets if known & each]
        sets = [known for known in sets if not known & each] + [each.union(*touching)]
    return [[name for name in wanted if name in each] for each in sets]


def _empty(source: Source, episode: int) -> TautError:
    return TautError(f"{source.path}: episode {episode} is empty: choose another one with --episode")


def _joined(parts: list[_Part], names: Collection[str], by_log: bool) -> Rows:
    """The parts of one group as one; their values are taken out, as they need not be there twice. A part without stamps
    or a channel has NaN; None where no part has any stamps. by_log: sorted by log time, as batches may be out of order;
    a table's rows are left as they are, so that a clock set back is seen."""

    def taken(part: _Part, name: str) -> Array:
        return part[2].pop(name) if name in part[2] else np.full(len(part[0]), np.nan)

    values = {name: np.concatenate([taken(part, name) for part in parts]) for name in names}
    stamp_s = None
    if any(part[1] is not None for part in parts):
        stamp_s = np.concatenate([np.full(len(part[0]), np.nan) if part[1] is None else part[1] for part in parts])
    log_s = np.concatenate([part[0] for part in parts])
    if by_log and np.any(np.diff(log_s) < 0):
        order = np.argsort(log_s, kind="stable")
        values = {name: each[order] for name, each in values.items()}
        return Rows(log_s[order], None if stamp_s is None else stamp_s[order], values)
    return Rows(log_s, stamp_s, values)
