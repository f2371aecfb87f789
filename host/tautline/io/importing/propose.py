"""Which channel is motor, tip, command, load and video: by what moves with what, and after what; names are hints."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tautline.io.importing.listing import QUATERNION_TYPE, Channel, Listing
from tautline.io.importing.source import Array
from tautline.io.importing.units import ANGLES, DEG_PER_RAD, LENGTHS, Named, recorded_unit, suspected_unit, unit_in
from tautline.rig import UNITS as RIG_UNITS

_MOST = 96  # tolerance: channels that are compared: the ones that change most often
_GRID = 4096  # tolerance: times at which they are compared
_LEAST_CHANGES = 4  # tolerance: at so many of them, at least: a quarter of them is the longest lag
_LEAST_ROWS = 9  # tolerance: of numbers, that a channel has: fewer tell no motion
_CHANGE_S = 0.2  # prior: over which a change is taken: a few samples of a slow sensor, less than a reversal
_LAG_S = 0.5  # prior: that a tip or a servo may be late by
_MOVES = 0.5  # prior: correlation of changes from which on two channels move together
_ALIKE = 1.25  # prior: a command moves as much as its motor, but for the servo's error
_CHAINED = 0.8  # prior: correlation of command, motor and tip with one another
_SIMULTANEOUS_S = 0.002  # tolerance: lags below it have no sign
_WHOLE_TURN, _SMALL = 6.3, 0.2  # prior: rad: what stays within a joint's turn and moves by more may be radians
_PIXELS = 20.0  # prior: that a marker moves by, at least
_RESTS = 0.1  # prior: of a channel's largest change: a smaller one is no motion
_FRICTION = 0.7  # prior: correlation with the direction of the motor's motion from which on a channel is its load

# How much a name, what is no place, a lag's sign, a wide motion and a place in a chain count beside a correlation.
_HINT, _AGAINST, _LATE, _SPAN, _CHAIN = 0.15, 1.0, 0.1, 0.05, 0.15  # prior: they decide between equals
_WORDS: Mapping[str, re.Pattern[str]] = {
    role: re.compile(words)
    for role, words in {
        "motor": r"motor|encoder|spindle|spindel|antrieb|drive|actuator|cable|seil|present_pos|(^|[^a-z])ist",
        "tip": r"tip|jaw|spitze|gelenk|abtrieb|marker|pose|bend|bieg|winkel|angle|[uv]_px|c_deg|distal|output",
        "command": r"c(om)?ma?n?d|goal|target|(^|[^a-z])soll|setpoint|set_point|reference|desired|^action",
        "load": r"load|torque|effort|force|moment|drehmoment|kraft|(^|[^a-z])last|current|strom|_mnm",
    }.items()
}
_NO_PLACE = re.compile(r"veloc|speed|geschw|drehzahl|accel|temp|covar|volt|seq|count|index|status|error|time|zeit")


@dataclass(frozen=True)
class Proposal:
    """Which channel is taken for what; None or empty where none was found."""

    motor: Named | None = None
    tip: tuple[Named, ...] = ()
    command: Named | None = None
    load: Named | None = None
    video: str | None = None
    unit: str = ""  # of q, mm or deg; "": not decided yet
    notes: tuple[str, ...] = ()  # how each was found, and what is a guess


@dataclass(frozen=True)
class _Comparison:
    """How n channels move together."""

    names: list[str]
    correlation: Array  # (n, n) absolute correlation of the changes of i and j, at the lag where it is largest
    lag_s: Array  # (n, n) that lag, s: by how much j is later than i
    span: Array  # (n,) from the 5th to the 95th percentile, the channel's unit
    turning: Array = field(repr=False)  # (n, n) absolute correlation of i's values with the direction of j's motion
    grid: Array = field(repr=False)  # (n, k) values at k common times


def propose(listing: Listing, hold: Proposal | None = None) -> Proposal:
    """Proposes which channels of an episode are motor, tip, command, load and video, with their units; its notes say
    how each was found. hold: the roles that the user has named, which stay. Without a motor only a video is
    proposed."""
    held = hold or Proposal()
    compared = _compare(listing)
    notes: list[str] = []
    motor, tip, index = held.motor, held.tip, {name: k for k, name in enumerate(compared.names)}
    if motor is None or not tip:
        pair = _motor_and_tip(listing, compared, motor, tip)
        if pair is not None:
            m, t = pair
            motor = motor or Named(compared.names[m])
            if not tip:
                tip = _whole_tip(compared.names[t], listing)
                lag = 1e3 * compared.lag_s[m, t]
                late = f", {lag:.0f} ms after it" if lag > 1e3 * _SIMULTANEOUS_S else ""
                notes.append(
                    f"{tip[0].name} moves with {motor.name}{late} (their changes correlate by "
                    f"{compared.correlation[m, t]:.2f})"
                )
    if motor is None:
        return replace(
            held, video=held.video or next(iter(listing.videos), None), notes=(*notes, _note_without_motor(listing))
        )
    taken = {motor.name, *(each.name for each in tip)}
    command = held.command
    if command is None and motor.name in index:
        command = _likely_command(listing, compared, index[motor.name], taken)
    if command is None and _name_suggests("command", motor.name):
        notes.append(f"{motor.name} is what was commanded: the servo's lag is then measured with the backlash")
    load = held.load or _likely_load(listing, compared, motor, taken | ({command.name} if command else set()))
    video = held.video or (next(iter(listing.videos), None) if len(listing.videos) else None)
    if len(listing.videos) > 1 and held.video is None:
        notes.append(f"{video} is the first of {len(listing.videos)} videos: {', '.join(listing.videos)}")
    return _with_units(Proposal(motor, tip, command, load, video, held.unit, tuple(notes)), listing)


def _compare(listing: Listing) -> _Comparison:
    """Compares the channels that move (see `_moving_channels`) by the cross-correlation of their changes over
    _CHANGE_S, at _GRID common times. Where there are fewer than two channels, or the episode is too short for that, no
    channel is related to another (correlation 0)."""
    channels = _moving_channels(listing)
    n = len(channels)
    unrelated = _Comparison(
        [c.name for c in channels], np.eye(n), np.zeros((n, n)), np.ones(n), np.zeros((n, n)), np.zeros((n, 1))
    )
    if n < 2:
        return unrelated
    times = _common_times(channels)
    step = times[1] - times[0]
    over = max(1, round(_CHANGE_S / step))
    if over > _GRID - _LEAST_CHANGES:
        return unrelated
    grid = np.array([_values_at(times, c) for c in channels])
    change = grid[:, over:] - grid[:, :-over]
    change = change - change.mean(axis=1, keepdims=True)
    scale = np.linalg.norm(change, axis=1, keepdims=True)
    change = np.divide(change, scale, out=np.zeros_like(change), where=scale > 0)
    correlation, lags = _strongest_correlations(change, min(max(1, round(_LAG_S / step)), change.shape[1] // 4))
    # The direction of motion, 0 at rest.
    moving = np.sign(np.where(np.abs(change) > _RESTS * np.abs(change).max(axis=1, keepdims=True), change, 0.0))
    middle = grid[:, over // 2 : over // 2 + change.shape[1]]  # the values half way through each change
    turning = np.abs(np.corrcoef(np.vstack([middle, moving]))[:n, n:])
    low, high = np.percentile(grid, [5.0, 95.0], axis=1)
    return _Comparison([c.name for c in channels], correlation, lags * step, high - low, np.nan_to_num(turning), grid)


def _moving_channels(listing: Listing) -> list[Channel]:
    """The channels that move and have at least _LEAST_ROWS numbers, in the listing's order, without an orientation's x,
    y, z, w. Of more than _MOST those are taken whose value changes in the largest share of their rows."""
    channels = [c for c in listing.channels.values() if c.moves and not _is_part_of_orientation(c.name, listing)]
    channels = [c for c in channels if np.isfinite(c.values).sum() >= _LEAST_ROWS]
    changes = [float(np.mean(np.diff(c.values[np.isfinite(c.values)]) != 0)) for c in channels]
    channels = [channels[k] for k in np.argsort(changes, kind="stable")[::-1][:_MOST]]
    channels.sort(key=lambda c: list(listing.channels).index(c.name))
    return channels


def _common_times(channels: Sequence[Channel]) -> Array:
    """_GRID evenly spaced times, s, within the span of time that all channels have in common; without one, from the
    first to the last time of any channel."""
    first = max(float(c.t_s[0]) for c in channels)
    last = min(float(c.t_s[-1]) for c in channels)
    if not last > first:
        first, last = min(float(c.t_s[0]) for c in channels), max(float(c.t_s[-1]) for c in channels)
    return np.linspace(first, last, _GRID)


def _strongest_correlations(series: Array, most: int) -> tuple[Array, Array]:
    """Cross-correlates n series (n, k), each of mean 0 and norm 1, at lags up to `most` samples either way. Returns,
    for each pair (i, j), (n, n) each: the largest absolute correlation, and its lag in samples, by which j is later
    than i."""
    n, size = len(series), 2 * series.shape[1]
    spectra = np.fft.rfft(series, size)  # twice as long, so that lags do not wrap around
    correlation, lag = np.eye(n), np.zeros((n, n))
    for i in range(n):
        crossed = np.fft.irfft(spectra * np.conj(spectra[i]), size)
        around = np.concatenate([crossed[:, -most:], crossed[:, : most + 1]], axis=1)  # lags -most to most
        best = np.abs(around).argmax(axis=1)
        correlation[i] = np.abs(around[np.arange(n), best])
        lag[i] = best - most
    return correlation, lag


def _values_at(times: Array, channel: Channel) -> Array:
    """A channel's values (n,) at times (n,), s, interpolated linearly between its finite rows."""
    finite = np.isfinite(channel.values)
    order = np.argsort(channel.t_s[finite], kind="stable")
    values: Array = np.interp(times, channel.t_s[finite][order], channel.values[finite][order])
    return values


def _motor_and_tip(
    listing: Listing, compared: _Comparison, motor: Named | None, tip: Sequence[Named]
) -> tuple[int, int] | None:
    """The likeliest motor and tip, as indices in `compared`: the pair with the best score. The score is the correlation
    of their changes; a lag lowers it, a tip that is later raises it; names, units, a wide motion, and places in a chain
    command, motor, tip weigh less. None where no two channels move together. motor, tip: what the user named, None or
    empty without."""
    names = compared.names
    best: tuple[int, int, float] | None = None
    has_command, has_follower = _likely_chains(listing, compared)
    for m, of_motor in enumerate(names):
        if motor is not None and of_motor != motor.name:
            continue
        for t, of_tip in enumerate(names):
            together = compared.correlation[m, t]
            if m == t or together < _MOVES or (tip and of_tip != tip[0].name):
                continue
            score = _pair_score(listing, compared, m, t, float(has_command[m]) - float(has_follower[t]))
            if best is None or score > best[2]:
                best = (m, t, score)
    return best and best[:2]


def _pair_score(listing: Listing, compared: _Comparison, m: int, t: int, chain: float) -> float:
    """How likely channel m is the motor and channel t the tip (indices in `compared`), larger where likelier: the
    correlation of their changes, less for a lag, more for a tip that is later, with hints by names, units and m's span.
    chain: 1 where m follows a likely command, less 1 where another channel follows t (see `_likely_chains`)."""
    of_motor, of_tip = compared.names[m], compared.names[t]
    lag = compared.lag_s[m, t]
    score = compared.correlation[m, t] - 0.5 * abs(lag) / _LAG_S
    score += _LATE * (np.sign(lag) if abs(lag) > _SIMULTANEOUS_S else 0.0)
    score += _HINT * (_name_suggests("motor", of_motor) - _name_suggests("motor", of_tip))
    score += _HINT * (_name_suggests("tip", of_tip) - _name_suggests("tip", of_motor))
    score -= _HINT * (2 * _name_suggests("command", of_tip) + _name_suggests("command", of_motor))
    score -= _AGAINST * (_is_no_position(of_motor, listing) + _is_no_position(of_tip, listing))
    score += _SPAN * compared.span[m] / float(compared.span.max())
    score += _CHAIN * chain
    if listing.channels[of_motor].fact.type == QUATERNION_TYPE:
        score -= _AGAINST  # an orientation is a tip's
    return float(score)


def _likely_chains(listing: Listing, compared: _Comparison) -> tuple[Array, Array]:
    """Two masks (n,) over the compared channels. The first: a channel that follows another one closely, later and with
    as wide a motion, which is then its likely command. The second: a channel that another one follows closely and
    later, so that it is no tip."""
    are_positions = np.array([not _is_no_position(name, listing) for name in compared.names], dtype=bool)
    span = np.maximum(compared.span, 1e-12)
    follows = (
        (compared.correlation > _CHAINED) & (compared.lag_s > _SIMULTANEOUS_S) & are_positions[:, None] & are_positions
    )
    alike = np.abs(np.log(span[:, None] / span)) < np.log(_ALIKE)
    return (follows & alike).any(axis=0), follows.any(axis=1)


def _likely_command(listing: Listing, compared: _Comparison, motor: int, taken: set[str]) -> Named | None:
    """The likeliest command of a motor (an index in `compared`): a channel that moves with it and as far, in deg or
    rad, and that is earlier or has a command's name. None where there is none. taken: the channels that have a role
    already."""
    best: tuple[float, str] | None = None
    for k, name in enumerate(compared.names):
        together, early = compared.correlation[motor, k], -compared.lag_s[motor, k]
        if (
            name in taken
            or together < _MOVES
            or _is_no_position(name, listing)
            or _name_suggests("tip", name) > _name_suggests("command", name)
        ):
            continue
        ratio = compared.span[k] / max(compared.span[motor], 1e-12)
        alike = any(1.0 / _ALIKE < ratio * times < _ALIKE for times in (1.0, DEG_PER_RAD, 1.0 / DEG_PER_RAD))
        if not alike or not (early > _SIMULTANEOUS_S or _name_suggests("command", name)):
            continue
        score = together + _HINT * _name_suggests("command", name)
        if best is None or score > best[0]:
            best = (score, name)
    return Named(best[1]) if best else None


def _likely_load(listing: Listing, compared: _Comparison, motor: Named, taken: set[str]) -> Named | None:
    """The likeliest load on the motor, None where there is none. taken: the channels that have a role already.

    It is a channel with a load's name or unit: the first one of the motor's joint, or the only one; of several others
    none is taken, as each may be another joint's. Where no channel has such a name, it is the one that correlates most
    with the direction of the motor's motion, as friction does: by _FRICTION at least, and by more than its changes
    correlate with the motor's."""
    joint = _joint_of(motor.name, listing)
    named = [
        name
        for name, c in listing.channels.items()
        if name not in taken and c.moves and (_name_suggests("load", name) or recorded_unit(c.fact.unit) == "mNm")
    ]
    same = [name for name in named if joint and _joint_of(name, listing) == joint]
    if same or len(named) == 1:
        return Named((same or named)[0])
    if named or motor.name not in compared.names:
        return None
    m = compared.names.index(motor.name)
    goes_with_direction = compared.turning[:, m]
    like_friction = [
        k
        for k, name in enumerate(compared.names)
        if name not in taken
        and goes_with_direction[k] > max(_FRICTION, compared.correlation[m, k])
        and not _is_no_position(name, listing)
    ]
    if not like_friction:
        return None
    return Named(compared.names[max(like_friction, key=lambda k: float(goes_with_direction[k]))])


def _whole_tip(name: str, listing: Listing) -> tuple[Named, ...]:
    """The channels of the tip that `name` is one of: u, then v, where it is a coordinate of a place in the image and
    its partner is there; else `name` alone."""
    for one, other in (("u", "v"), ("x", "y")):
        for this, that, first in ((one, other, True), (other, one, False)):
            match = re.search(rf"(?<![A-Za-z0-9]){this}(?=(_px|\s*[\[(]px|$))", name)
            partner = f"{name[: match.start()]}{that}{name[match.end() :]}" if match else ""
            if partner not in listing.channels:
                continue
            both = [listing.channels[each] for each in (name, partner)]
            if "px" in name or max(c.high - c.low for c in both) > _PIXELS:
                return (Named(name), Named(partner)) if first else (Named(partner), Named(name))
    return (Named(name),)


def _with_units(found: Proposal, listing: Listing) -> Proposal:
    """The proposal with the unit of q and of each channel filled in. A unit is the user's, the file's or the one in the
    name; q's is the motor's if not the user's. Where neither has a factor, units of a motor and a tip of one channel
    that are not known are guessed together; else such a motor is taken to be in q's unit; both are noted. A command
    without a unit of q's kind has the motor's, and a load without one of torque none. A channel with the user's factor
    gets no unit."""
    assert found.motor is not None
    notes = list(found.notes)
    motor_unit = _stated_unit(found.motor, listing)
    tip = found.tip
    unit = found.unit or recorded_unit(motor_unit)
    if unit not in RIG_UNITS:
        unit, motor_unit = "deg", ""
    one_angle = len(tip) == 1
    tip_unit = _stated_unit(tip[0], listing) if one_angle else ""
    if one_angle and found.motor.factor is None and tip[0].factor is None and tip[0].name in listing.channels:
        motor_unit, tip_unit = _guess_units(found.motor, motor_unit, tip[0], tip_unit, unit, listing, notes)
    elif not motor_unit and found.motor.factor is None:
        notes.append(f"no unit is known of {found.motor.name}: it is taken as {unit}")
    if one_angle and tip[0].factor is None:
        tip = (replace(tip[0], unit=tip_unit if tip_unit in ANGLES else ""),)
    command = found.command
    if command is not None and command.factor is None:
        stated = _stated_unit(command, listing)
        own = stated if stated in (ANGLES if unit == "deg" else LENGTHS) else ""
        command = replace(command, unit=own or motor_unit)
    load = found.load
    if load is not None and load.factor is None:
        stated = _stated_unit(load, listing)
        load = replace(load, unit=stated if recorded_unit(stated) == "mNm" else "")
        if not load.unit:
            notes.append(f"no unit is known of {load.name}: it is taken as mNm; its scale matters to no result")
    motor = found.motor if found.motor.factor is not None else replace(found.motor, unit=motor_unit)
    return Proposal(motor, tip, command, load, found.video, unit, tuple(notes))


def _stated_unit(named: Named, listing: Listing) -> str:
    """The unit of a channel: the user's, else the file's, else the one in its name or label; "" where none of them says
    one."""
    channel = listing.channels.get(named.name)
    if named.unit or channel is None:
        return named.unit
    return channel.fact.unit or unit_in(channel.name) or unit_in(channel.fact.label)


def _guess_units(
    motor: Named, motor_unit: str, tip: Named, tip_unit: str, unit: str, listing: Listing, notes: list[str]
) -> tuple[str, str]:
    """The units of motor and tip: motor_unit and tip_unit where they are known; a unit that is "" is guessed by ratios
    and ranges, and the guess is added to `notes`. unit: of the recording's q, deg or mm."""
    m, t = listing.channels[motor.name], listing.channels[tip.name]
    if unit == "deg":
        likely = _units_by_ratio(m, motor_unit, t, tip_unit) or _units_by_range([m, t], listing)
    else:
        motor_unit, likely = motor_unit or unit, _units_by_range([t], listing)
    for channel, known, name in ((m, motor_unit, motor.name), (t, tip_unit, tip.name)):
        if not known:
            notes.append(_guess_note(channel, name, likely[channel.name], listing))
    return motor_unit or likely[m.name], tip_unit or likely[t.name]


def _units_by_ratio(m: Channel, motor_unit: str, t: Channel, tip_unit: str) -> dict[str, str]:
    """Guesses the units of motor `m` and tip `t`, by channel name, from how far each moves. If one moves 57 times less
    than the other, it is in radians; else both are in degrees if one unit is known (motor_unit, tip_unit; "" if not).
    {} where neither is known and the ratio does not mean radians."""
    spans = [ANGLES.get(known, 1.0) * max(c.high - c.low, 1e-12) for c, known in ((m, motor_unit), (t, tip_unit))]
    for less, more, known in ((0, 1, motor_unit), (1, 0, tip_unit)):
        channel = (m, t)[less]
        finite = channel.values[np.isfinite(channel.values)]
        may_be = not known and channel.fact.usual != "deg"
        if may_be and suspected_unit(spans[more] / spans[less], finite, "deg", 1.0) == "rad":
            return {m.name: "deg", t.name: "deg"} | {channel.name: "rad"}
    return {m.name: "deg", t.name: "deg"} if motor_unit or tip_unit else {}


def _units_by_range(channels: Sequence[Channel], listing: Listing) -> dict[str, str]:
    """Guesses the one unit of angle that these channels have, by channel name. It is radians if no value goes beyond a
    turn and one channel moves by more than _SMALL, unless one is known to be in degrees or looks like a share of a
    range; else degrees."""
    spans = [c.high - c.low for c in channels]
    farthest = [abs(end) for c in channels for end in (*_extremes(c), _reach_of_array(c, listing))]
    known_otherwise = any(c.fact.usual == "deg" or _full_scale_of(c) for c in channels)
    radians = not known_otherwise and max(farthest) <= _WHOLE_TURN and max(spans) > _SMALL
    return {c.name: "rad" if radians else "deg" for c in channels}


def _extremes(channel: Channel) -> tuple[float, float]:
    """The lowest and the highest value of a channel, over all episodes where the file states them."""
    return float(np.fmin(channel.low, channel.fact.low)), float(np.fmax(channel.high, channel.fact.high))


def _reach_of_array(channel: Channel, listing: Listing) -> float:
    """How far from 0 the moving channels of the same array (which have one unit) go: the median of their largest
    absolute values. 0 for a channel of no array."""
    group = channel.name.rpartition("[")[0]
    others = [c for name, c in listing.channels.items() if group and name.startswith(f"{group}[") and c.moves]
    return float(np.median([max(map(abs, _extremes(c))) for c in others])) if others else 0.0


def _full_scale_of(channel: Channel) -> float:
    """The full scale, 1 or 100, that a channel's values seem to be shares of: its highest value is exactly that, and
    its lowest is 0 or the negative of it. 0 where it looks like no share."""
    low, high = _extremes(channel)
    return high if high in (1.0, 100.0) and low in (0.0, -high) else 0.0


def _guess_note(channel: Channel, name: str, guess: str, listing: Listing) -> str:
    """The note for the user on a channel's guessed unit, `guess`. name: the channel as the user would write it."""
    says = f"no unit is known of {name}: it moves by {channel.high - channel.low:.4g} in all, "
    if full := _full_scale_of(channel):
        return (
            f"{says}and ends at exactly {full:g}, as shares of a range do: write what one is in deg behind its name: "
            f"{name}:{110.0 / full:g} for ±110 deg"
        )
    return f"{says}{guess} is a guess" + (": write another unit or a factor behind its name" if guess == "rad" else "")


def _name_suggests(role: str, name: str) -> bool:
    """Whether a channel's name has a word that suggests this role, a key of _WORDS."""
    return bool(_WORDS[role].search(name.lower()))


def _is_no_position(name: str, listing: Listing) -> bool:
    """Whether a channel is not a position, by its name or unit, but such as a speed, a load, a time or a status."""
    return (
        bool(_NO_PLACE.search(name.lower()))
        or _name_suggests("load", name)
        or recorded_unit(listing.channels[name].fact.unit) == "mNm"
    )


def _joint_of(name: str, listing: Listing) -> str:
    """A key of the joint that a channel belongs to: its label, else its topic, with its index if the name ends in one;
    "" for an unknown channel."""
    channel = listing.channels.get(name)
    if channel is None:
        return ""
    index = re.search(r"\[([^\]]*)\]$", name)
    return channel.fact.label or (f"{channel.group}[{index[1]}]" if index else channel.group)


def _is_part_of_orientation(name: str, listing: Listing) -> bool:
    """Whether a channel is one of x, y, z, w of an orientation, whose angle is a channel of its own."""
    prefix = name.rpartition(".")[0]
    return prefix in listing.channels and listing.channels[prefix].fact.type == QUATERNION_TYPE


def _note_without_motor(listing: Listing) -> str:
    """The note for a proposal without a motor."""
    moving = sum(c.moves for c in listing.channels.values())
    return f"{moving} channels move, no two of them together: name them with --motor and --tip"
