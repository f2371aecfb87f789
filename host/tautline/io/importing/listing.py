"""What is in a source: its channels with count, rate and range, and each thinned to what a proposal is made from."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tautline.errors import TautError
from tautline.io.importing.source import Array, Batch, Fact, Source, no_messages_error
from tautline.io.importing.tip import QUATERNION, bending_deg

Progress = Callable[[float, str], None]

_KEPT = 4096  # tolerance: rows of a group, at least, that a proposal is made from
_NEAR = 3  # display: names that an error offers


@dataclass(frozen=True)
class Channel:
    """One channel of numbers in an episode, thinned."""

    name: str
    group: str  # topic; "" where the source is one table
    fact: Fact
    count: int  # finite numbers
    rate_hz: float  # of its group's rows
    low: float
    high: float
    t_s: Array  # (k,) log times, s, of some of its rows
    values: Array  # (k,) of these rows, NaN where they have none

    @property
    def moves(self) -> bool:
        """Whether its numbers are not all the same."""
        return self.count > 1 and self.high > self.low


@dataclass(frozen=True)
class Listing:
    """What is in an episode."""

    episode: int
    channels: Mapping[str, Channel]  # by name
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
    """Collects a group's rows as they come: every one counts for count and range, each stride-th is kept, so that at
    most 2 * _KEPT are held."""

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
        """Takes in a batch: counts its numbers and widens their ranges, and keeps each stride-th row. Where more than 2
        * _KEPT rows are held then, every second one is dropped and the stride doubles."""
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
        chosen = np.arange(-self.rows % self.stride, n, self.stride)  # goes on where the batch before ended
        stamps = np.full(n, np.nan) if batch.stamp_s is None else batch.stamp_s
        self._keep(batch.log_s[chosen], stamps[chosen], {name: v[chosen] for name, v in batch.values.items()})
        self.rows += n
        while self.held > 2 * _KEPT:
            log_s, stamp_s, values = self.joined()
            self.stride *= 2
            self.kept, self.held = [], 0
            self._keep(log_s[::2], stamp_s[::2], {name: v[::2].copy() for name, v in values.items()})

    def _keep(self, log_s: Array, stamp_s: Array, values: dict[str, Array]) -> None:
        """Adds rows to those held: log times and stamps (k,) s, and values (k,) by channel."""
        self.kept.append((log_s, stamp_s, values))
        self.held += len(log_s)

    def joined(self) -> tuple[Array, Array, dict[str, Array]]:
        """All held rows as one: log times and stamps (k,) s, and values (k,) by channel, NaN where a row has none."""
        names = dict.fromkeys(name for _, _, values in self.kept for name in values)
        return (
            np.concatenate([log_s for log_s, _, _ in self.kept]),
            np.concatenate([stamp_s for _, stamp_s, _ in self.kept]),
            {n: np.concatenate([v.get(n, np.full(len(t), np.nan)) for t, _, v in self.kept]) for n in names},
        )


def scan(source: Source, episode: int | None, progress: Progress) -> Listing:
    """Lists what is in an episode (None: the first one), in one pass over it: each channel with its count, rate and
    range and at most 2 * _KEPT of its rows; an orientation also has its bending angle as a channel. progress: gets 0.5
    and the number of rows read. TautError where there is no such episode, or nothing in it."""
    episodes = source.episodes()
    if not episodes:
        raise no_messages_error(source.path)
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
        channels |= _channels_of(group, held, log_s, values, source.facts)
    if not channels and not source.videos:
        raise TautError(f"{source.path}: holds no {source.numbers} with numbers: is it the right file?")
    return Listing(episode, channels, list(source.videos), clocks)


def _channels_of(
    group: str, held: _Group, log_s: Array, values: Mapping[str, Array], facts: Mapping[str, Fact]
) -> dict[str, Channel]:
    """The channels of a group, by name, and as channels of their own the angles of its orientations, deg. log_s,
    values: the rows that were kept, (k,) each; facts: the source's."""
    channels: dict[str, Channel] = {}
    span = held.last_s - held.first_s
    rate = (held.rows - 1) / span if span > 0 else 0.0
    for name, kept in values.items():
        fact = facts.get(name, Fact())
        low, high = held.low.get(name, np.nan), held.high.get(name, np.nan)
        channels[name] = Channel(name, group, fact, held.count[name], rate, low, high, log_s, kept)
    for prefix in _orientations(values):
        angle, _ = bending_deg(np.column_stack([values[f"{prefix}.{axis}"] for axis in QUATERNION]))
        if np.isfinite(angle).any():
            fact = Fact(QUATERNION_TYPE, unit="deg")
            low, high = float(np.nanmin(angle)), float(np.nanmax(angle))
            channels[prefix] = Channel(prefix, group, fact, held.rows, rate, low, high, log_s, angle)
    return channels


def check_episode(source: Source, episode: int) -> None:
    """Raises TautError where a source does not have the episode with this number. The source has at least one."""
    listed = source.episodes()
    if episode not in listed:
        raise TautError(f"{source.path}: has no episode {episode}: its episodes are {listed[0]} to {listed[-1]}")


QUATERNION_TYPE = "orientation"


def _orientations(names: Collection[str]) -> list[str]:
    """The names NAME for which NAME.x, NAME.y, NAME.z and NAME.w are all in `names`, as of a quaternion."""
    ends = [name.removesuffix(".w") for name in names if name.endswith(".w")]
    return [each for each in ends if all(f"{each}.{axis}" in names for axis in QUATERNION)]


def resolve(wanted: str, source: Source, known: Collection[str]) -> str:
    """The channel among `known` that a user means by its name, by its label (if only one has it), or by NAME[label]. A
    name that stands for several channels, NAME of NAME.x, is returned as it is. TautError, with the most similar names,
    where there is none."""
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
    """A channel's label in the file, such as a joint's name; "" without."""
    return source.facts[name].label if name in source.facts else ""


def find(source: Source, episode: int, wanted: Sequence[str]) -> dict[str, tuple[str, str]]:
    """For each name that a user gave (see `resolve`), (its channel, the channel's group) in an episode. Reads the
    episode only until all are found. TautError where one is not in it, or the episode is empty."""
    known: dict[str, str] = dict.fromkeys(source.facts, "")
    for batch in source.batches(episode):
        known.update(dict.fromkeys(batch.values, batch.group))
        try:
            return {each: (name := resolve(each, source, known), _group_of(name, known)) for each in wanted}
        except TautError:
            continue
    if not known:
        raise _empty_episode_error(source, episode)
    return {each: (name := resolve(each, source, known), _group_of(name, known)) for each in wanted}


def _group_of(name: str, known: Mapping[str, str]) -> str:
    """The group of a channel, by `known` (group by channel); for a name that stands for several channels the group of
    the first of them."""
    return known[name] if name in known else next(g for each, g in known.items() if each.startswith(f"{name}."))


def read(source: Source, episode: int, wanted: Mapping[str, Collection[str]], progress: Progress) -> dict[str, Rows]:
    """Reads all rows of the wanted channels (by group) of an episode. Returns Rows by group; channels of a group that
    never come in one message, such as those of two publishers, have Rows of their own, under the name of the first of
    them. Memory: 8 bytes for each number and time, and once more for one channel. TautError where there are no rows."""
    parts: dict[str, dict[frozenset[str], list[_Part]]] = {group: {} for group in wanted}
    rows = 0
    for batch in source.batches(episode, list(wanted)):
        # Copies: views would keep the whole batch in memory.
        chosen = {name: batch.values[name].copy() for name in wanted.get(batch.group, ()) if name in batch.values}
        if not chosen:
            continue
        parts[batch.group].setdefault(frozenset(chosen), []).append((batch.log_s, batch.stamp_s, chosen))
        rows += len(batch.log_s)
        progress(0.5, f"{rows} rows read")
    if not rows:
        raise _empty_episode_error(source, episode)
    found: dict[str, Rows] = {}
    for group, by_names in parts.items():
        for names in _channels_held_together(by_names, wanted[group]):
            own = [part for held, each in by_names.items() if held <= set(names) for part in each]
            found[names[0] if group in found else group] = _join_parts(own, names, bool(group))
    return found


def _channels_held_together(held: Collection[frozenset[str]], wanted: Collection[str]) -> list[list[str]]:
    """Divides a group's channels into lists of channels that come in one message, directly or by way of others
    (connected components), each in the order of `wanted`. held: the sets of channels that come in one message."""
    sets: list[frozenset[str]] = []
    for each in held:
        touching = [known for known in sets if known & each]
        sets = [known for known in sets if not known & each] + [each.union(*touching)]
    return [[name for name in wanted if name in each] for each in sets]


def _empty_episode_error(source: Source, episode: int) -> TautError:
    """The error to raise for an episode without rows."""
    return TautError(f"{source.path}: episode {episode} is empty: choose another one with --episode")


def _join_parts(parts: list[_Part], names: Collection[str], by_log: bool) -> Rows:
    """Joins the parts of one group to Rows, NaN where a part lacks stamps or a channel; stamps are None if no part has
    any. Empties the parts' dictionaries of values as it goes, which saves memory. by_log: rows are sorted by log time,
    as batches may be out of order; a table's rows are not, so that a clock that was set back is noticed."""

    def pop_values(part: _Part, name: str) -> Array:
        """Removes a channel's values (n,) from a part of n rows and returns them; NaN where it has none."""
        return part[2].pop(name) if name in part[2] else np.full(len(part[0]), np.nan)

    values = {name: np.concatenate([pop_values(part, name) for part in parts]) for name in names}
    stamp_s = None
    if any(part[1] is not None for part in parts):
        stamp_s = np.concatenate([np.full(len(part[0]), np.nan) if part[1] is None else part[1] for part in parts])
    log_s = np.concatenate([part[0] for part in parts])
    if by_log and np.any(np.diff(log_s) < 0):
        order = np.argsort(log_s, kind="stable")
        values = {name: each[order] for name, each in values.items()}
        return Rows(log_s[order], None if stamp_s is None else stamp_s[order], values)
    return Rows(log_s, stamp_s, values)
