"""An episode's channels as a recording: units, one clock, motor.csv's times for all that belongs to the motor."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from tautline.errors import TautError
from tautline.io.importing import clocks, video
from tautline.io.importing.listing import Progress, Rows, find, read
from tautline.io.importing.source import Array, Clip, Source, origin_of
from tautline.io.importing.tip import QUATERNION, bending_deg
from tautline.io.importing.units import ANGLES, SPOKEN, Named, factor, parse_channel, suspected_unit, unit_in
from tautline.layouts import MOTOR
from tautline.recording import FARTHEST, MAX_MOTOR_GAP_S, MAX_MOTOR_STEP_S, Angle, Marker, Motor, Recording, Video
from tautline.rig import Actuator, AngleSensor, Coarse, Rig

_MOST_LOST = 0.05  # tolerance: share of a motor's rows without a number that may be left out
_TIME_DIGITS = 9  # format: of seconds: what clocks and bags count in
_RANGE_DIGITS = 4  # format: of a rig's range, rounded outwards
# By how much a ratio may be off from a unit's: a command goes where the motor goes, less a servo's error; a rig's gain
# is nominal; where none is given a tip may move half or twice as much as its motor.
_SURE, _BY_RIG, _ANY_GAIN = 0.1, 0.25, 1.0  # prior
_ONE_AXIS = 0.9  # tolerance: share of a tip's turning that is about one axis, below which it is told
_SAMPLED = 20_000  # tolerance: values that a rig's count and coarse law are taken from
_RESOLUTION_LEAST = 1e-6  # tolerance: of the span: a finer count is none, it is a float's rounding


@dataclass(frozen=True)
class Roles:
    """Which channels the user named for what, each as NAME, NAME:UNIT or NAME:FACTOR."""

    motor: str
    tip: tuple[str, ...] = ()  # one angle or orientation, or u and v in px
    command: str | None = None
    load: str | None = None
    video: str | None = None
    joints: tuple[str, ...] = ()  # further ones, which may couple in


@dataclass
class Assembled:
    """A recording made from an episode, and what was done for it."""

    recording: Recording
    rig_known: bool  # by the user; else what the recording shows of it
    channels: list[dict[str, Any]] = field(default_factory=list)  # what became of each, for import.toml
    clock: str = clocks.LOG
    origin_s: float = 0.0  # what was taken off all times of the file
    warnings: list[str] = field(default_factory=list)


def assemble(
    source: Source, episode: int, roles: Roles, unit: str | None, rig: Rig | None, scratch: Path, progress: Progress
) -> Assembled:
    """Makes a recording from the channels of an episode that the user named. q is in the unit of `rig`, or without one
    in `unit` (mm or deg), or in that of the motor's channel. scratch: a folder for the video; progress: gets the share
    done, 0 to 1, and a word. TautError where a channel is missing or empty, or units or times contradict each other."""
    if rig is not None and unit is not None and unit != rig.actuator.unit:
        raise TautError(f"--unit {unit}: the rig's actuator.unit is {rig.actuator.unit}: leave --unit out")
    chosen = _ChosenChannels(source, episode, roles)
    rows = read(source, episode, chosen.by_group(), progress)
    frames = _write_video(source, episode, roles.video, scratch) if roles.video else None
    times = {group: (each.log_s, each.stamp_s) for group, each in rows.items()}
    if frames is not None and roles.video is not None and "" not in rows:  # a table's clip is on the table's times
        times[roles.video] = (frames[0], frames[1])
    # All parts go on one clock, and their times are counted from the first of them if they are an epoch's.
    clock = clocks.choose(times)
    warnings = list(clock.warnings)
    origin_s = origin_of(clocks.first_s(times, clock.used))
    made = _Maker(chosen, rows, clock.used, origin_s, warnings)
    target = rig.actuator.unit if rig else unit or made.target_unit(chosen.motor)
    motor = made.motor(target)
    marker = angle = None
    if len(chosen.tip) == 2:
        marker = made.marker()
    elif chosen.tip:
        angle = made.angle()
    seen = made.recorded_video(frames, roles.video or "")
    _check_motor(motor, chosen.motor.name, rig, warnings)
    tip = marker or angle
    if tip is not None:
        clocks.check_overlap(motor.t_s, tip.t_s, roles.motor, "".join(roles.tip[:1]))
    if seen is not None and seen.arrival_s is not None:
        clocks.check_overlap(motor.t_s, seen.arrival_s[np.isfinite(seen.arrival_s)], roles.motor, roles.video or "")
    _check_units(chosen, motor, angle, target, rig, warnings)
    own = rig or _rig_from_motion(motor, angle, target)
    recording = Recording(source.path.stem, motor, marker, angle, seen, own)
    return Assembled(recording, rig is not None, made.told, clock.used, source.origin_s + origin_s, warnings)


class _ChosenChannels:
    """The channels of the user's roles, by their names in the source."""

    def __init__(self, source: Source, episode: int, roles: Roles) -> None:
        """Finds the channels of the roles in an episode. TautError where a name means no channel, or several where one
        is needed."""
        listed = list(source.facts)
        asked = {
            "motor": [roles.motor], "tip": roles.tip, "command": [roles.command] if roles.command else [],
            "load": [roles.load] if roles.load else [], "joint": roles.joints,
        }  # fmt: skip
        texts = [parse_channel(text, listed) for each in asked.values() for text in each]
        found = find(source, episode, [each.name for each in texts])
        self.source = source
        self.groups = {found[each.name][0]: found[each.name][1] for each in texts}

        def of(role: str) -> list[Named]:
            """The role's channels by their names in the source, with unit or factor as the user gave them."""
            return [
                Named(found[n.name][0], n.unit, n.factor) for n in (parse_channel(text, listed) for text in asked[role])
            ]

        self.motor, self.tip = of("motor")[0], of("tip")
        self.command = next(iter(of("command")), None)
        self.load = next(iter(of("load")), None)
        self.joints = of("joint")
        for each in (self.motor, *self.joints, *(x for x in (self.command, self.load) if x)):
            if each.name not in source.facts:
                raise self._error_for_group(each)
        self.parts: dict[str, tuple[str, ...]] = {}  # of a name that stands for several channels
        self._expand_tip()

    def _expand_tip(self) -> None:
        """Where the tip is named as a group of channels: an orientation stays and its four channels go into `parts`; a
        point becomes its channels x and y. TautError for any other group, for more than two channels, or for a unit
        that an orientation (other than deg) or a place in the image cannot have."""
        known = set(self.source.facts)
        for each in list(self.tip):
            inner = {axis: f"{each.name}.{axis}" for axis in QUATERNION if f"{each.name}.{axis}" in known}
            if each.name in known:
                continue
            if len(inner) == 4:
                if each.unit not in ("", "deg"):
                    raise TautError(f"{each.text}: the angle of an orientation is in deg: leave {each.unit} out")
                self.parts[each.name] = tuple(inner[axis] for axis in QUATERNION)
            elif {"x", "y"} <= set(inner) and len(self.tip) == 1:
                self.tip = [replace(each, name=inner[axis]) for axis in ("x", "y")]
                self.groups.update({inner[axis]: self.groups[each.name] for axis in ("x", "y")})
            else:
                raise self._error_for_group(each)
        if len(self.tip) > 2:
            raise TautError("--tip is one angle or orientation, or twice a place in the image: u, then v, in px")
        if len(self.tip) == 2 and (scaled := [each for each in self.tip if each.text != each.name]):
            raise TautError(f"--tip {scaled[0].text}: a place in the image is in px: name {scaled[0].name} alone")

    def _error_for_group(self, each: Named) -> TautError:
        """The error to raise for a name that means several channels where one is needed."""
        held = sorted(name for name in self.source.facts if name.startswith(f"{each.name}."))
        return TautError(f"{self.source.path}: {each.name} is several channels: name one of {', '.join(held[:6])}")

    def by_group(self) -> dict[str, list[str]]:
        """The names of the channels to read, by their group (topic), each once."""
        wanted: dict[str, list[str]] = {}
        everything = [self.motor, *self.tip, *self.joints, *(x for x in (self.command, self.load) if x)]
        for each in everything:
            names = self.parts.get(each.name, (each.name,))
            wanted.setdefault(self.groups[each.name], []).extend(names)
        return {group: list(dict.fromkeys(names)) for group, names in wanted.items()}

    def stated_unit(self, channel: Named) -> str:
        """A channel's unit, of units.UNITS: the user's, else the file's, else the one in its label or name; "" where
        none of them says one."""
        fact = self.source.facts.get(channel.name)
        said = (fact.unit or unit_in(fact.label)) if fact else ""
        return channel.unit or said or unit_in(channel.name)


class _Maker:
    """Turns a source's rows into the parts of a recording, all on one clock. `told` gets an entry on each channel that
    was used, for import.toml."""

    def __init__(
        self, chosen: _ChosenChannels, rows: dict[str, Rows], clock: str, origin_s: float, warnings: list[str]
    ) -> None:
        """rows: by group, or by the first channel of a part of a group (see `listing.read`); clock: which times are
        used (LOG, STAMP or FILE); origin_s: what is subtracted from them; warnings: new ones are added to this list."""
        self._chosen, self._rows, self._warnings = chosen, rows, warnings
        self._clock, self._origin_s = clock, origin_s
        self.told: list[dict[str, Any]] = []
        # Times, s, and the rows that have them, None for all.
        self._times_by_group: dict[str, tuple[Array, Array | None]] = {}

    def target_unit(self, channel: Named) -> str:
        """The unit that a recording has a channel in: "mm" where the channel's own unit is known to be a length, else
        "deg"."""
        stated = self._chosen.stated_unit(channel)
        return "mm" if stated and stated not in ANGLES and factor_fits(channel, stated, "mm") else "deg"

    def motor(self, target: str) -> Motor:
        """The motor's log from its channels, q in the unit `target`. Command, load (mNm) and joints are brought to the
        times of q: a command is held until the next one, the others are interpolated linearly."""
        t_s, q = self._series(self._chosen.motor, target, "motor")
        q_cmd = load = None
        if (command := self._chosen.command) is not None:
            at, value = self._series(command, target, "command")
            q_cmd = value[np.clip(np.searchsorted(at, t_s, side="right") - 1, 0, None)]  # held until the next one
        if (channel := self._chosen.load) is not None:
            at, value = self._series(channel, "mNm", "load")
            load = np.interp(t_s, at, value)
        joints: dict[str, Array] = {}
        for joint in self._chosen.joints:
            own = self.target_unit(joint)
            at, value = self._series(joint, own, "joint")
            joints[_joint_column(joint, self._chosen.source, own, {*joints, *_reserved_columns(target)})] = np.interp(
                t_s, at, value
            )
        return Motor(t_s=t_s, q=q, q_cmd=q_cmd, load_mNm=load, extra=joints)

    def angle(self) -> Angle:
        """The tip's angle, deg, from its channel, or from an orientation's four channels (see `bending_deg`) and then
        times the user's factor. Rows without a number are not valid, which is added to the warnings. TautError where
        there is no number."""
        tip = self._chosen.tip[0]
        if tip.name in self._chosen.parts:
            t_s, parts = self._times(tip, self._chosen.parts[tip.name])
            c_deg, share = bending_deg(np.column_stack(parts))
            times = 1.0 if tip.factor is None else tip.factor
            if not np.isfinite(c_deg).any():
                raise TautError(f"{tip.name}: holds no orientation: its x, y, z, w have not length 1")
            if share < _ONE_AXIS:
                self._warnings.append(
                    f"{tip.name}: {100 * share:.0f} % of its turning is about one axis, the angle is about that one"
                )
            c_deg = c_deg * times
            self._record_use("tip", tip, len(t_s), "quaternion", tip.factor)
        else:
            t_s, c_deg = self._series(tip, "deg", "tip", keep_lost=True)
        lost = ~np.isfinite(c_deg)
        if lost.any():
            self._warnings.append(f"{tip.name}: {int(lost.sum())} rows have no number: they are kept as not valid")
        return Angle(t_s, c_deg, ~lost if lost.any() else None)

    def marker(self) -> Marker:
        """The tip's place in the image, px, from its channels u and v; where a row lacks one of them both are NaN and
        it is not valid. TautError where the two are of different topics, or hold no number."""
        u, v = self._chosen.tip
        if self._chosen.groups[u.name] != self._chosen.groups[v.name]:
            raise TautError(f"{u.name} and {v.name} are of two topics: name u and v of one")
        t_s, (u_px, v_px) = self._times(u, (u.name, v.name))
        valid = np.isfinite(u_px) & np.isfinite(v_px)
        if not valid.any():
            raise TautError(f"{u.name}: holds no number: name another --tip")
        for each in (u, v):
            self._record_use("tip", each, len(t_s), "px", 1.0)
        return Marker(t_s, np.where(valid, u_px, np.nan), np.where(valid, v_px, np.nan), valid)

    def recorded_video(self, frames: tuple[Array, Array | None, Path] | None, name: str) -> Video | None:
        """The video with its frames' arrival times, s by the clock in use. A frame whose time is not later than those
        of all frames before it gets NaN, with a warning. None without frames. frames: as of `_write_video`; name: its
        channel, for import.toml."""
        if frames is None:
            return None
        log_s, stamp_s, path = frames
        t_s = clocks.times_by_clock(log_s, stamp_s, self._clock) - self._origin_s
        highest = np.maximum.accumulate(np.where(np.isfinite(t_s), t_s, -np.inf))
        late = np.concatenate([[False], t_s[1:] <= highest[:-1]])
        if late.any():
            self._warnings.append(
                f"video: {int(late.sum())} frames have no time after the one before: they are not named"
            )
            t_s[late] = np.nan
        self.told.append({"role": "video", "name": name, "rows": int(np.isfinite(t_s).sum())})
        return Video(path, t_s)

    def _series(self, channel: Named, target: str, role: str, keep_lost: bool = False) -> tuple[Array, Array]:
        """A channel's times, s, and its values in the unit `target`, (n,) each; notes the channel's use in `told`. Rows
        without a number are left out, with a warning; keep_lost keeps them as NaN. role: for messages and import.toml.
        TautError where there are no numbers, or more than a share _MOST_LOST of the motor's rows have none."""
        t_s, (values,) = self._times(channel, (channel.name,))
        multiplier, unit = factor(channel, self._chosen.stated_unit(channel), target)
        finite = np.isfinite(values)
        lost = int((~finite).sum())
        if not finite.any():
            raise TautError(f"{channel.name}: holds no number: name another --{role}")
        if lost and not keep_lost:
            if role == "motor" and lost > _MOST_LOST * len(values):
                raise TautError(
                    f"{channel.name}: {lost} of {len(values)} rows are NaN: the motor is needed throughout: name "
                    "another --motor, or cut that part off"
                )
            self._warnings.append(f"{channel.name}: {lost} rows without a number were left out")
            t_s, values = t_s[finite], values[finite]
        self._record_use(role, channel, len(t_s), unit, multiplier)
        return t_s, values if multiplier == 1.0 else values * multiplier

    def _times(self, channel: Named, names: tuple[str, ...]) -> tuple[Array, list[Array]]:
        """The rising times of a channel's group, s, and the values at these times of the channels `names`, all of this
        group, (n,) each. TautError where the group has no rows."""
        group = next((group for group, rows in self._rows.items() if rows.values.keys() >= set(names)), None)
        if group is None:
            raise TautError(f"{self._chosen.source.path}: {channel.name} has no rows: choose another --episode")
        rows = self._rows[group]
        if group not in self._times_by_group:
            self._times_by_group[group] = self._usable_times(group, rows)
        t_s, kept = self._times_by_group[group]
        return t_s, [rows.values[name] if kept is None else rows.values[name][kept] for name in names]

    def _usable_times(self, group: str, rows: Rows) -> tuple[Array, Array | None]:
        """A group's times by the clock in use, s since the origin, made to rise by sorting rows and leaving some out;
        and the indices of the rows kept, in that order, None where all are as they were."""
        t_s = clocks.times_by_clock(rows.log_s, rows.stamp_s, self._clock) - self._origin_s
        kept = clocks.rows_in_time_order(t_s, group or str(self._chosen.source.path), self._warnings)
        whole = len(kept) == len(t_s) and bool(np.all(kept[1:] > kept[:-1]))
        return np.round(t_s if whole else t_s[kept], _TIME_DIGITS), None if whole else kept

    def _record_use(self, role: str, channel: Named, rows: int, unit: str, times: float | None) -> None:
        """Adds an entry on a channel to `told`. rows: how many of its rows were taken; unit: of its numbers, "" where
        nobody said one; times: the factor that they were multiplied by, None for none."""
        fact = self._chosen.source.facts.get(channel.name)
        entry = {"role": role, "name": channel.name, "label": fact.label if fact else "", "rows": rows}
        entry |= {"unit": unit or "not said", "factor": times}
        self.told.append({key: value for key, value in entry.items() if value not in (None, "")})


def factor_fits(channel: Named, stated: str, target: str) -> bool:
    """Whether a channel's numbers can be converted to the unit `target` (units.factor raises where not). stated: their
    unit by the file, "" without; a unit that the user gave with the channel's name is taken instead."""
    try:
        factor(channel, stated, target)
    except TautError:
        return False
    return True


def _write_video(source: Source, episode: int, name: str, scratch: Path) -> tuple[Array, Array | None, Path]:
    """Writes the video of an episode's channel `name` into the folder `scratch`. Returns its frames' log times (n,) s,
    their stamps (n,) s (None if no sender set any, and for a part of a video file), and its path."""
    found = source.pictures(episode, name)
    if isinstance(found, Clip):
        path = scratch / f"video{'.mkv' if found.path.suffix == '.mkv' else '.mp4'}"
        return video.cut(found, path), None, path
    path = scratch / "video.mkv"
    log_s, stamp_s = video.from_pictures(found, path, f"{source.path}: {name}")
    return log_s, None if np.isnan(stamp_s).all() else stamp_s, path


def _check_units(
    chosen: _ChosenChannels, motor: Motor, angle: Angle | None, target: str, rig: Rig | None, warnings: list[str]
) -> None:
    """Checks units by how far command and tip move beside the motor: a ratio of 57.3 means radians, one of 1000 metres.
    A contradiction is a TautError where nobody stated the wrong channel's unit, else it is added to `warnings`. Nothing
    is checked where the motor rests nearly always. target: unit of q. TautError where the motor does not move at
    all."""
    if np.ptp(motor.q) <= 0.0:
        raise TautError(f"{chosen.motor.name}: does not move: name another --motor")
    if (span := _span(motor.q)) <= 0.0:
        return  # it rests nearly always: no ratio tells anything
    for option, partner, values, unit_of_values, expected, off in _motions_beside_motor(
        chosen, motor, angle, target, rig, span
    ):
        if (seen := _span(values)) <= 0.0:
            continue
        # Either of the two channels may be the one whose unit is wrong.
        for role, wrong, raw, ratio, base in (
            (option, partner, values, expected / seen, unit_of_values),
            ("--motor", chosen.motor, motor.q, seen / expected, target),
        ):
            if not (unit := suspected_unit(ratio, raw, base, off)):
                continue
            moves = f"{ratio:.4g} times less" if ratio > 1.0 else f"{1.0 / ratio:.4g} times more"
            says = f"{wrong.name} moves {moves} than {(chosen.motor if wrong is partner else partner).name} tells"
            if chosen.stated_unit(wrong) or wrong.factor is not None:
                warnings.append(f"{says}: is it in {SPOKEN[unit]}?")
                continue
            raise TautError(
                f"{says}, as {SPOKEN[unit]} do: write {role} '{wrong.name}:{unit}', or '{wrong.name}:{base}' "
                "if that is its unit"
            )


def _motions_beside_motor(
    chosen: _ChosenChannels, motor: Motor, angle: Angle | None, target: str, rig: Rig | None, span: float
) -> list[tuple[str, Named, Array, str, float, float]]:
    """The motions whose span tells of units beside the motor's: the command's, and the tip's where a gain is known or
    both are in deg. Each is (option, channel, its values (n,), their unit, the span that they should have in that unit,
    the share by which the ratio may be off). target: unit of q; span: of the motor, in that unit."""
    pairs: list[tuple[str, Named, Array, str, float, float]] = []
    if motor.q_cmd is not None and chosen.command is not None:
        pairs.append(("--command", chosen.command, motor.q_cmd, target, span, _SURE))
    if angle is not None and rig is not None:
        pairs.append(("--tip", chosen.tip[0], angle.c_deg[angle.seen], "deg", span * abs(rig.coarse.gain), _BY_RIG))
    elif angle is not None and target == "deg":
        pairs.append(("--tip", chosen.tip[0], angle.c_deg[angle.seen], "deg", span, _ANY_GAIN))
    return pairs


def _check_motor(motor: Motor, name: str, rig: Rig | None, warnings: list[str]) -> None:
    """Raises TautError for a motor's log that loading the recording would refuse: rows too far apart, gaps, or far
    beyond the rig's range. A position beyond that range by more than its width is added to `warnings`. name: the
    motor's channel."""
    step = np.diff(motor.t_s)
    if (usual := float(np.median(step))) >= MAX_MOTOR_STEP_S:
        raise TautError(
            f"{name}: rows are {usual:.4g} s apart, a motor's come at 10 Hz or more: is the time's unit right?"
        )
    if (longest := float(step.max())) > MAX_MOTOR_GAP_S:
        raise TautError(
            f"{name}: {longest:.6g} s pass without a row at {motor.t_s[step.argmax()]:.6g} s: split it there"
        )
    if rig is not None:
        low, high = rig.actuator.range
        beyond = max(low - float(motor.q.min()), float(motor.q.max()) - high)
        says = f"{name} goes from {motor.q.min():.6g} to {motor.q.max():.6g} {rig.actuator.unit}, the rig's range is "
        if beyond > FARTHEST * rig.actuator.span:
            other = {"deg": "tick", "mm": "um"}[rig.actuator.unit]  # what has so large numbers
            raise TautError(f"{says}[{low:g}, {high:g}]: say its unit, as in {name}:{other}")
        if beyond > rig.actuator.span:
            warnings.append(f"{says}[{low:g}, {high:g}]")


def _rig_from_motion(motor: Motor, angle: Angle | None, unit: str) -> Rig:
    """The rig that a recording itself shows, for a user who named none: the motor's range, rounded outwards, its
    smallest step as the encoder's, and the coarse law by least squares (c = q without an angle, or where that fails).
    unit: of q."""
    low, high = float(motor.q.min()), float(motor.q.max())
    step = 10.0 ** (np.ceil(np.log10(high - low)) - _RANGE_DIGITS)
    low, high = (float(f"{side(end / step) * step:.10g}") for side, end in ((np.floor, low), (np.ceil, high)))
    gain, offset = 1.0, 0.0
    if angle is not None:
        seen = angle.seen
        every = max(1, int(seen.sum()) // _SAMPLED)
        t_s, c_deg = angle.t_s[seen][::every], angle.c_deg[seen][::every]
        q = np.interp(t_s, motor.t_s, motor.q)
        line = np.polyfit(q, c_deg, 1) if np.ptp(q) > 0.0 else np.zeros(2)
        if np.isfinite(line).all() and line[0] != 0.0:
            gain, offset = (float(f"{value:.4g}") for value in line)
    return Rig(
        Actuator(unit, (low, high), _encoder_step(motor.q)),
        Coarse(gain, offset),
        angle=AngleSensor() if angle else None,
    )


def _encoder_step(q: Array) -> float:
    """The encoder's resolution, unit of q, from positions (n,): the 5th percentile of the differences between
    neighbouring values that occur, as a few of them may be smaller. At least _RESOLUTION_LEAST of the span."""
    values = np.unique(q[:: max(1, len(q) // _SAMPLED)])
    steps = np.diff(values)
    least = _RESOLUTION_LEAST * (values[-1] - values[0])
    real = steps[steps > least]
    return float(f"{max(float(np.percentile(real, 5.0)) if real.size else least, least):.4g}")


def _span(values: Array) -> float:
    """The range of values (n,) from their 5th to their 95th percentile, so that a few outliers do not count."""
    low, high = np.percentile(values, [5.0, 95.0])
    return float(high - low)


def _reserved_columns(unit: str) -> set[str]:
    """The names of motor.csv's columns that a joint's column must not have, as it would replace the motor's own.
    translation_mm and rotation_deg are not among them: a joint may be that motion of the instrument. unit: of q."""
    return set(MOTOR.names(unit)) - {"translation_mm", "rotation_deg"}


def _joint_column(channel: Named, source: Source, unit: str, taken: Collection[str]) -> str:
    """The name of a joint's column in motor.csv: LABEL_UNIT, or CHANNEL_UNIT without a label; a number goes before the
    unit where that name is in `taken`."""
    label = source.facts[channel.name].label if channel.name in source.facts else ""
    plain = "".join(c if c.isalnum() else "_" for c in (label or channel.name)).strip("_")
    plain = plain.removesuffix(f"_{unit}")
    names = (f"{plain}_{unit}" if k == 1 else f"{plain}_{k}_{unit}" for k in count(1))
    return next(name for name in names if name not in taken)
