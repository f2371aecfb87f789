"""Puts a motor into service: polarity and scale, an end, friction and speed, servo gains; then stores it all on the
board as the axis' settings. Nothing moves that was not agreed to, and the motor is off between the parts."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tautline.device import wire
from tautline.errors import TautError
from tautline.live.homing import Homing, home, settle
from tautline.live.session import driving, move_to
from tautline.live.setup import Live

Array = np.ndarray
Say = Callable[[str], None]
Agree = Callable[[str], bool]

_MARGIN = 2.0  # factor: the servo must still be stable with gains that are so much higher than the chosen ones
_HIGHEST = 4.0  # the highest factor of the gains that is tried, only to show that there is a margin
_RUNGS = 4  # gains that are tried, each _MARGIN times those before
_COUNT = 1.0  # limit: count of the encoder: errors that differ by less are equally good
_GAINS = ("proportional", "integral", "derivative")
_UNSOUND = ("OSCILLATION", "FOLLOWING", "CURRENT")  # faults that too high or too low a gain may cause
_CENTRE, _STEP = 0.3, 0.02  # shares of the range: where steps are made, from the near end on, and how long they are
# Moves that show friction: their length, share of the range; their speeds, shares of the top speed.
_WAY, _SPEEDS = 0.3, (0.1, 0.3)
_FULL_RANGE_S = 0.5  # a top speed that crosses the range in less time is taken as one that needs this time
_EVEN = 0.02  # relative: where the set-point's rate is so near to the commanded speed, the motion is even
_STOP_S = 0.02  # until the board has seen its stop input anew
_SETTLE_S, _AFTER_S = 0.3, 0.1  # rest after a step; how much of it is drawn and counted
_BLOCK = 10  # samples of 1 ms whose mean drive is one equation: short beside a swing, which may have 12 Hz
_FEWEST_BLOCKS = 4  # of an even motion, to fit friction and speed to


@dataclass(frozen=True)
class StepResponse:
    """How the motor followed a quick move (at the axis' limits) to another position."""

    t_s: Array  # (n,) from shortly before the move
    q: Array  # (n,) position, counts from where the move began
    q_ref: Array  # (n,) set-point, counts from where the move began
    rms: float  # of the following error until it has settled, counts
    overshoot: float  # counts
    settling_s: float  # from the reference's arrival until the motor stays within the settings' `arrive`


@dataclass
class Commissioned:
    """What commissioning found and stored."""

    before: dict[str, Any]  # the board's settings as they were
    settings: dict[str, Any]  # as they are stored
    friction: float = 0.0  # share of full drive
    speed_s: float = 0.0  # counts/s at full drive, without load
    current_ma: int = 0  # the most that was seen
    q: float = 0.0  # after homing, the rig's unit
    steps: dict[float, StepResponse] = field(default_factory=dict)  # by factor of the gains
    factor: float = 1.0  # of the gains, that was chosen


class _Telemetry:
    """Keeps an axis' telemetry since the last `clear`."""

    def __init__(self, axis: int) -> None:
        """axis: the only one whose telemetry is kept."""
        self._axis = axis
        self._rows: list[Array] = []

    def take(self, batch: wire.Message) -> None:
        """Listener to the message `batch`: keeps its samples if it is of this axis."""
        if batch.axis == self._axis:
            t = (batch.t_us + batch.period_us * np.arange(batch.count)) * 1e-6
            n = batch.count
            self._rows.append(np.column_stack([t, batch.q[:n], batch.q_ref[:n], batch.duty[:n]]))

    def clear(self) -> None:
        """Drops what was kept so far."""
        self._rows.clear()

    def read(self) -> tuple[Array, Array, Array, Array]:
        """Returns what was kept since the last `clear`, as (n,) arrays: times, s; position and set-point, counts; duty,
        -1 to 1. TautError where nothing came."""
        if not self._rows:
            raise TautError("the board sends no telemetry: run 'taut monitor' and look for what was dropped")
        t, q, q_ref, duty = np.concatenate(self._rows).T
        return t, q, q_ref, duty


@contextlib.contextmanager
def _recording_telemetry(live: Live) -> Iterator[_Telemetry]:
    """A context within which the axis sends telemetry each millisecond; yields the _Telemetry that keeps it. Afterwards
    the axis sends none."""
    telemetry = _Telemetry(live.axis)
    live.board.listen("batch", telemetry.take)
    try:
        live.board.ask("telemetry", axis=live.axis, divider=1)
        yield telemetry
    finally:
        live.board.forget("batch", telemetry.take)
        with contextlib.suppress(TautError):  # gone
            live.board.ask("telemetry", axis=live.axis, divider=0)


def commission(
    live: Live, agree: Agree, say: Say, homing: Homing | None = None, wanted: dict[str, Any] | None = None
) -> Commissioned:
    """Puts an axis into service: wiring, stop input, end, friction, scale and servo gains are checked or measured and
    stored on the board, which drives at low duty until the ends are known. agree: is asked a question before anything
    moves or is stored; say: is told what was found; homing: which end is used, by default the low one; wanted: settings
    by name that nothing measures and that are stored as given (None leaves one as it is). A drive with a position loop
    of its own keeps its gains and its zero. TautError, with a remedy, where something is wrong or not agreed to: the
    board's settings are then as before, but for the range and for how the stop input is wired."""
    board = live.board
    board.check_axis(live.axis)
    given = {name: value for name, value in (wanted or {}).items() if value is not None}
    if board.bus():
        if "estop" in given or (homing is not None and homing.end is not None):
            raise TautError(
                "a drive on a bus of its own has neither the board's stop input nor an end that it presses "
                "against: leave out --estop and --end"
            )
        commissioned = _commission_drive(live, agree, say, given)
    else:
        commissioned = _commission_motor(live, agree, say, homing or Homing(), given)
    _check_motor_and_encoder(live)
    say("stored, and checked again")
    return commissioned


def _commission_motor(live: Live, agree: Agree, say: Say, homing: Homing, given: dict[str, Any]) -> Commissioned:
    """`commission` of a motor whose position loop is the board's: stores the range, homes, measures the drive law,
    tunes the gains and stores them. given: settings by name that nothing measures."""
    board, axis, unit = live.board, live.axis, live.rig.actuator.unit
    if "estop" in given:
        _store_stop_input(live, agree, given["estop"])
    board.check_fault(axis)
    ranged, commissioned = _check_and_store_range(live, agree, say, given, "motor and encoder agree")

    _require_agreement(agree, f"The motor goes to the {'low' if homing.direction < 0 else 'high'} end, weakly. May it?")
    commissioned.q = home(live, homing)
    ends = ", ".join(f"{q:g}" for q in live.rig.actuator.range)
    say(f"ends: found, now at {commissioned.q:.4g} {unit}; range [{ends}] {unit}")

    _require_agreement(agree, "The motor moves over a third of its range, then in quick steps. May it?")
    with _at_full_drive(live, ranged):
        try:
            with _recording_telemetry(live) as telemetry:
                _measure_drive_law(live, telemetry, commissioned, homing.direction)
                say(
                    f"drive: friction {100 * commissioned.friction:.1f} %, {commissioned.speed_s:.0f} counts/s at full "
                    f"drive; current up to {commissioned.current_ma} mA, "
                    f"limit {commissioned.settings['current_ma']} mA"
                )
                if commissioned.settings["feed_forward"] < _feed_forward(commissioned.speed_s):
                    say(
                        f"the board takes a feed-forward of {wire.wire.GAIN_MAX} at most, and this motor asks for "
                        f"{_feed_forward(commissioned.speed_s)}: the servo's integral has to do the rest"
                    )
                _tune_gains(live, telemetry, commissioned, homing.direction, say)
        finally:
            with contextlib.suppress(TautError):  # gone: what is stored holds at its next start
                board.ask("servo", **_servo_fields(commissioned.before))

        _require_agreement(
            agree, f"Store gains x {commissioned.factor:.3g}, range, current limit and instrument on the board?"
        )
        _store(live, commissioned.settings)
    return commissioned


def _commission_drive(live: Live, agree: Agree, say: Say, given: dict[str, Any]) -> Commissioned:
    """`commission` of a drive with a position loop of its own, whose gains and zero are set by its maker's tools:
    checks its limits, stores the range, shows by moves and steps how it follows, and stores the settings. given:
    settings by name that nothing measures."""
    board, axis, actuator = live.board, live.axis, live.rig.actuator
    board.check_fault(axis)
    board.check_reference(axis)
    _check_range_within_drive(live)
    _, commissioned = _check_and_store_range(live, agree, say, given, "the drive goes where it is told")

    start = float(np.clip(live.motor_position(), *actuator.range))
    direction = 1 if start > sum(actuator.range) / 2 else -1  # in which the nearer end is: moves go away from it
    commissioned.q, commissioned.speed_s = start, live.top_speed / live.resolution
    _require_agreement(
        agree,
        f"The motor moves over a third of its range, from {start:.4g} {actuator.unit}, then in quick steps. May it?",
    )
    with _recording_telemetry(live) as telemetry:
        with driving(live):
            for target in (start, start - direction * _WAY * actuator.span, start):
                move_to(live, target, min(_SPEEDS[-1] * actuator.span / _FULL_RANGE_S, live.top_speed))
                seen_ma = abs(board.status(axis).current_ma)
                commissioned.current_ma = max(commissioned.current_ma, seen_ma)
        step = _step_responses(live, telemetry, start, direction, commissioned.before["arrive"])
    commissioned.steps[1.0] = step
    say(
        f"the drive follows {1e3 * board.bus()['lag_s']:.1f} ms behind its set-points, which is planned for: off by "
        f"{step.rms:.1f} counts rms, {step.overshoot:.1f} beyond the target, settled in {1e3 * step.settling_s:.0f} ms"
    )
    _require_agreement(agree, "Store range and instrument for this drive?")
    _store(live, commissioned.settings)
    return commissioned


def _check_range_within_drive(live: Live) -> None:
    """TautError, with the remedy, where the rig's range goes beyond the drive's own limits."""
    drive, actuator = live.board.bus()["limits"][live.axis], live.rig.actuator
    low, high = (q / live.resolution for q in actuator.range)
    if low < drive["q_low"] or high > drive["q_high"]:
        ends = "{:g}, {:g}".format(*(drive[key] * live.resolution for key in ("q_low", "q_high")))
        raise TautError(
            f"the drive's own limits are [{ends}] {actuator.unit}, the rig's range goes beyond: move its zero, or "
            "widen its limits with its maker's tools, or set actuator.range"
        )


def _check_and_store_range(
    live: Live, agree: Agree, say: Say, given: dict[str, Any], says: str
) -> tuple[dict[str, Any], Commissioned]:
    """After asking, has the board check motor and encoder by a small move, reports the success in the words `says`, and
    stores the rig's range on the board. Returns the board's settings with that range, and a first result: its settings
    also have those `given` and count as commissioned, and are not stored yet."""
    before = dict(live.board.ask("get_settings", axis=live.axis).values)
    low, high = (q / live.resolution for q in live.rig.actuator.range)
    ranged = before | {"q_low": low, "q_high": high}
    _require_agreement(agree, "The motor turns a little either way. Is the instrument free to move?")
    _check_motor_and_encoder(live)
    say(f"polarity and scale: {says}")
    _store(live, ranged)
    return ranged, Commissioned(before, ranged | given | {"commissioned": 1})


def _require_agreement(agree: Agree, question: str) -> None:
    """Asks the question; TautError, which ends the commissioning, where the answer is no."""
    if not agree(question):
        raise TautError("stopped as you said: the gains on the board are as before. Run it again when all is ready")


def _store_stop_input(live: Live, agree: Agree, estop: int) -> None:
    """Stores for all axes, after asking, which state of the stop input stops them (estop: the setting's value), and
    clears a stop that the wrong value has caused. Does nothing where all have this value."""
    board, axes = live.board, range(live.board.axes)
    kept = [dict(board.ask("get_settings", axis=axis).values) for axis in axes]
    if all(settings["estop"] == estop for settings in kept):
        return
    _require_agreement(agree, "Store for every axis of the board which state of the stop input stops it?")
    for settings in kept:
        _store(live, settings | {"estop": estop})
    live.wait(_STOP_S)
    for axis in axes:
        if board.status(axis).fault == wire.code("FAULTS", "ESTOP"):
            board.ask("clear_fault", axis=axis)


@contextlib.contextmanager
def _at_full_drive(live: Live, settings: dict[str, Any]) -> Iterator[None]:
    """A context within which the axis counts as commissioned, so that the board allows full drive. settings: the axis'
    settings on the board; where they are commissioned already nothing is done. If the block fails, the motor is
    switched off, these settings are stored again, and the error goes on."""
    if settings["commissioned"]:
        yield
        return
    try:
        _store(live, settings | {"commissioned": 1})
        yield
    except BaseException:
        with contextlib.suppress(TautError):  # gone
            live.release()  # a motor that is on takes no settings
            _store(live, settings)
        raise


def _check_motor_and_encoder(live: Live) -> None:
    """Has the board check motor and encoder by a small move at low drive, 5 s at most; the motor is off afterwards.
    TautError for a fault that this finds."""
    with live.interruptible():
        try:
            live.board.ask("check", axis=live.axis)
            settle(live, 5.0)
        finally:
            live.release()


def _store(live: Live, settings: dict[str, Any]) -> None:
    """Has the board store the settings of an axis (the fields of tl_wire.h's message `settings`, by name)."""
    live.board.ask("settings", **(settings | {"key": wire.wire.KEY}), timeout_s=5.0)


def _servo_fields(settings: dict[str, Any]) -> dict[str, Any]:
    """Picks from an axis' settings the fields of the message `servo`, which sets gains until the board's next
    restart."""
    return {name: settings[name] for name in ("axis", *_GAINS, "feed_forward", "inertia", "friction")}


# -- friction and speed -----------------------------------------------------------------------------------------------


def _measure_drive_law(live: Live, telemetry: _Telemetry, commissioned: Commissioned, direction: int) -> None:
    """Measures friction, a share of full drive, free speed, counts/s, and current, mA, by moves at two speeds in both
    directions; sets them, and the feed-forward that follows, in `commissioned`. Speeds are taken from the encoder, as
    with gains that are not tuned yet the motor oscillates about its path. direction: -1 or 1, in which the nearer end
    is: moves go away from it. TautError where too little of a move was even, or more speed took less drive."""
    span, start = live.rig.actuator.span, commissioned.q
    stretches = []
    with driving(live):
        for share in _SPEEDS:
            speed = share * min(live.top_speed, span / _FULL_RANGE_S)
            for target in (start - direction * _WAY * span, start):
                telemetry.clear()
                move_to(live, target, speed)
                commissioned.current_ma = max(commissioned.current_ma, abs(live.board.status(live.axis).current_ma))
                t, q, q_ref, duty = telemetry.read()
                reference_speed = np.abs(np.gradient(q_ref, t))
                even = np.flatnonzero(
                    np.abs(reference_speed - speed / live.resolution) < _EVEN * speed / live.resolution
                )
                if len(even) <= _FEWEST_BLOCKS * _BLOCK:
                    raise TautError("too little of the motion was even: allow more speed in the board's settings")
                stretches.append((t[even], q[even], duty[even]))
    friction, s_per_count = _fit_drive_law(stretches)
    if s_per_count <= 0:
        raise TautError("more speed took less drive: look for what rubs, and for a supply that sags")
    commissioned.friction, commissioned.speed_s = max(friction, 0.0), 1.0 / s_per_count
    commissioned.settings["friction"] = commissioned.friction
    commissioned.settings["feed_forward"] = min(_feed_forward(commissioned.speed_s), wire.wire.GAIN_MAX)


def _feed_forward(speed_s: float) -> int:
    """Returns the setting feed_forward, duty in 1/32768 per 1000 counts/s, of a motor that runs at speed_s counts/s
    with full drive and no load."""
    return round(1000.0 * 32768.0 / speed_s)


def _fit_drive_law(stretches: Sequence[tuple[Array, Array, Array]]) -> tuple[float, float]:
    """Fits duty = friction sign(v) + v / free speed + inertia dv/dt by least squares, one equation for each block of
    _BLOCK samples. Returns friction, a share of full drive, and 1 / free speed, s/count. stretches: t_s, q in counts
    and duty -1 to 1, all (n,), each of an even move in one direction, at several speeds. Blocks slower than half their
    stretch's mean are left out, as static friction may hold the motor there."""
    rows = []
    for t, q, duty in stretches:
        edges = np.arange(0, len(t), _BLOCK)
        speed = np.diff(q[edges]) / np.diff(t[edges])
        mean_duty = np.add.reduceat(duty, edges)[:-1] / _BLOCK
        acceleration = np.gradient(speed, (t[edges[1:]] + t[edges[:-1]]) / 2)
        mean_speed = (q[-1] - q[0]) / (t[-1] - t[0])
        equations = np.column_stack([np.full(len(speed), np.sign(mean_speed)), speed, acceleration, mean_duty])
        is_sliding = speed * np.sign(mean_speed) >= abs(mean_speed) / 2
        rows.append(equations[1:-1][is_sliding[1:-1]])  # without the ends, whose acceleration is one-sided
    system = np.concatenate(rows)
    friction, s_per_count, _ = np.linalg.lstsq(system[:, :3], system[:, 3], rcond=None)[0]
    return float(friction), float(s_per_count)


# -- servo gains ------------------------------------------------------------------------------------------------------


def _tune_gains(live: Live, telemetry: _Telemetry, commissioned: Commissioned, direction: int, say: Say) -> None:
    """Tries growing gains (`_gain_factors`) by step responses until the servo is unstable. Of those that are still
    stable at _MARGIN times the gains it chooses the ones with the least rms + overshoot, counts; of several that are
    within one count of the least, the highest. Sets steps, factor and gains in `commissioned`. direction: -1 or 1, in
    which the nearer end is. TautError where no gains have that margin."""
    factors = _gain_factors(commissioned.settings)
    if factors[-1] < _HIGHEST:
        name = _largest_gain(commissioned.settings)
        say(
            f"gains are tried up to x {factors[-1]:.3g}, not {_HIGHEST:g}: the {name} gain is "
            f"{commissioned.settings[name]}, and the board takes {wire.wire.GAIN_MAX} at most"
        )
    for factor in factors:
        tried = commissioned.settings | _scaled_gains(commissioned.settings, factor)
        step = _step_responses_with_gains(live, telemetry, tried, commissioned.q, direction)
        if step is None:
            say(f"gains x {factor:.3g}: not sound")
            break
        commissioned.steps[factor] = step
        say(
            f"gains x {factor:.3g}: off by {step.rms:.1f} counts rms, {step.overshoot:.1f} beyond the target, "
            f"settled in {1e3 * step.settling_s:.0f} ms"
        )
    with_margin = [factor for factor in commissioned.steps if factor * _MARGIN in commissioned.steps]
    if not with_margin:
        raise TautError(
            "no gains are sound with a margin of 2: look for play between motor and encoder, and the supply"
        )
    error_counts = {
        factor: commissioned.steps[factor].rms + commissioned.steps[factor].overshoot for factor in with_margin
    }
    commissioned.factor = max(
        factor for factor in with_margin if error_counts[factor] < min(error_counts.values()) + _COUNT
    )
    commissioned.settings |= _scaled_gains(commissioned.settings, commissioned.factor)


def _largest_gain(settings: dict[str, Any]) -> str:
    """The name of the largest of the three gains in an axis' settings."""
    return max(_GAINS, key=lambda name: settings[name])


def _gain_factors(settings: dict[str, Any]) -> list[float]:
    """Returns the factors by which an axis' gains are multiplied to be tried: _RUNGS of them, rising, each _MARGIN
    times the one before. The last one is _HIGHEST, or the largest with which the board takes all three gains: their
    ratios have to stay, or a step would show the margin of another servo."""
    highest = min(_HIGHEST, wire.wire.GAIN_MAX / max(settings[_largest_gain(settings)], 1))
    return [highest / _MARGIN**rung for rung in reversed(range(_RUNGS))]


def _scaled_gains(settings: dict[str, Any], factor: float) -> dict[str, Any]:
    """The three gains in an axis' settings times a factor, rounded."""
    return {name: round(settings[name] * factor) for name in _GAINS}


def _step_responses_with_gains(
    live: Live, telemetry: _Telemetry, settings: dict[str, Any], start: float, direction: int
) -> StepResponse | None:
    """Sets the gains in `settings` on the board until its restart, and returns `_step_responses` with them. None where
    the servo is not stable, which the board sees as one of the faults _UNSOUND; that fault is cleared. TautError for
    another fault."""
    live.board.ask("servo", **_servo_fields(settings))
    try:
        return _step_responses(live, telemetry, start, direction, settings["arrive"])
    except TautError:
        fault = live.board.status(live.axis).fault
        if fault not in [wire.code("FAULTS", name) for name in _UNSOUND]:
            raise
        live.board.ask("clear_fault", axis=live.axis)
        return None


def _step_responses(live: Live, telemetry: _Telemetry, start: float, direction: int, arrive: float) -> StepResponse:
    """Moves to a place _CENTRE of the range away from the nearer end, makes a step of _STEP of the range farther away
    and one back, and returns the curves of the first with the larger rms, overshoot and settling time of both. start:
    position near that end, the rig's unit; direction: -1 or 1, in which the end is; arrive: counts from the target
    within which the motor has arrived."""
    span = live.rig.actuator.span
    centre = start - direction * _CENTRE * span
    with driving(live):
        move_to(live, centre, 0.25 * live.top_speed)
        steps = [_step_response(live, telemetry, centre + sign * _STEP * span, arrive) for sign in (-direction, 0)]
    return replace(
        steps[0],
        rms=max(step.rms for step in steps),
        overshoot=max(step.overshoot for step in steps),
        settling_s=max(step.settling_s for step in steps),
    )


def _step_response(live: Live, telemetry: _Telemetry, q_to: float, arrive: float) -> StepResponse:
    """Moves to q_to, the rig's unit, at top speed, and returns how the motor followed, from 20 ms before the set-point
    moves until _AFTER_S after it arrives. arrive: counts from the target within which the motor has arrived."""
    live.wait(_SETTLE_S)
    telemetry.clear()
    move_to(live, q_to, live.top_speed)
    live.wait(_SETTLE_S)
    t, q, q_ref, _ = telemetry.read()
    origin, target = q_ref[0], q_to / live.resolution
    # When the set-point reaches its last value.
    arrived_s = t[np.flatnonzero(q_ref != q_ref[-1])[-1]] if np.ptp(q_ref) else t[0]
    times_away = t[np.abs(q - target) > arrive]
    sign = 1.0 if target > origin else -1.0
    moved = np.flatnonzero(q_ref != origin)
    # From 20 samples, which are 20 ms, before the set-point moves.
    shown = slice(max(int(moved[0]) - 20, 0) if len(moved) else 0, int(np.searchsorted(t, arrived_s + _AFTER_S)))
    return StepResponse(
        t[shown] - t[shown][0],
        q[shown] - origin,
        q_ref[shown] - origin,
        rms=float(np.sqrt(np.mean((q - q_ref)[shown] ** 2))),
        overshoot=float(max(np.max((q - target) * sign), 0.0)),
        settling_s=float(max(times_away[-1] - arrived_s, 0.0)) if len(times_away) else 0.0,
    )
