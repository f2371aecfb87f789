"""Live calibration: check scale and sign, then run the board's calibration motion and record it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tautline.calibration.calibrate import calibrate
from tautline.calibration.options import Options
from tautline.calibration.result import Calibration
from tautline.device import wire
from tautline.errors import TautError
from tautline.geometry import project
from tautline.live.rounds import Round, Strokes, check_speeds
from tautline.live.setup import Frame, Live, Recorder
from tautline.live.watch import Show, View, Watch
from tautline.recording import load

Array = np.ndarray
Progress = Callable[[float, str], None] | None

_PROBE_SHARES = (0.06, 0.2)  # of the range to either side: first carefully, then beyond backlash and dead zone
_STILL_FRAMES = 8  # that are taken of an axis at rest
_OFF_PX = 0.02  # error of a marker's place that no number of frames averages out
_TIP_DEG_S = 8.0  # of the tip in the fastest pass: a camera of 30 Hz sees it move by a quarter of a degree a frame
_OF_TOP_SPEED = 0.25  # the fastest pass, of the axis' top speed: its turns are short beside its passes
_APPROACH = 0.03  # of the range: so far on the envelope before each turn, that the play is taken up for sure
_STROKE = 0.25  # of the range: more than any backlash
_ACCELERATION = 20.0  # of the calibration motion: from rest to its fastest pass in 1/20 s
_HOST_TIMEOUT_S = 1.0  # without a frame for so long the board ends its motion
# The board's onset detector, in shares of the range: sigma of an onset that is good enough to turn round, of one too
# vague to use, and the travel of a turn; and by how many times itself the image's slope may change over the range.
_SIGMA_WANTED, _SIGMA_USABLE, _TURN, _SLOPE_CHANGES = 1.5e-4, 2.5e-3, 4e-4, 4.0
_LEAST_TURN, _MOST_CHANGE = 4.0, 0.5  # limit: counts that a turn has at least; change of the slope in one at most
_RUNNING = (wire.code("MOTIONS", "RUNNING"), wire.code("MOTIONS", "STOPPING"))
_COMPLETE, _STOPPED = wire.code("MOTIONS", "COMPLETE"), wire.code("MOTIONS", "STOPPED")
_TOO_LITTLE, _TOO_MUCH = 0.08, 2.0  # observed motion of the marker to that of f_coarse: beyond, a scale is wrong


@dataclass(frozen=True)
class MotionOptions:
    """The thorough calibration motion. Lengths in the rig's unit; None takes what suits the rig."""

    speeds: tuple[float, ...] | None = None  # unit/s, of the passes
    cycles: int = 12  # turning points of a pass
    approach: float | None = None  # on the envelope before each turn, at the pass's speed
    stroke: float | None = None  # a reversal without an onset ends here: more than any backlash
    low: float | None = None
    high: float | None = None
    probe: bool = True


@dataclass
class Motion:
    """How the calibration motion went."""

    folder: Path
    reversals: int = 0
    onsets: list[dict[str, Any]] = field(default_factory=list)  # as the board found them, the rig's unit
    frames: int = 0
    lost_frames: int = 0
    seconds: float = 0.0
    telemetry_missed: int = 0


@contextmanager
def driving(live: Live) -> Iterator[None]:
    """A context within which the motor is on; afterwards the axis is at rest and the motor off. TautError where the
    axis has a fault, or does not know its position."""
    live.board.check_fault(live.axis)
    live.board.check_reference(live.axis)
    with live.powered():
        yield


def set_range(live: Live, low: float, high: float) -> None:
    """Sets the position limits of the axis, the rig's unit, to the part of low to high that the settings on the board
    allow; its other limits stay. TautError where the two ranges do not overlap."""
    limits = dict(live.board.ask("get_limits", axis=live.axis).values)
    own = live.board.ask("get_settings", axis=live.axis)
    limits.update(q_low=max(low / live.resolution, own.q_low), q_high=min(high / live.resolution, own.q_high))
    if limits["q_low"] >= limits["q_high"]:
        raise TautError(
            f"the settings on the board keep axis {live.axis} within [{own.q_low * live.resolution:g}, "
            f"{own.q_high * live.resolution:g}] {live.rig.actuator.unit}, outside the rig's range: check both"
        )
    live.board.ask("limits", **limits)


def move_to(live: Live, q: float, speed: float, seen: Callable[[Frame], object] | None = None) -> None:
    """Moves the motor to q, the rig's unit, at up to `speed`, unit/s, and waits until it is there; frames meanwhile go
    to `seen`. TautError for a fault, or where it takes 2 s more than 1.5 times the way at this speed."""
    start = live.motor_position()
    live.board.ask("move", axis=live.axis, q=q / live.resolution, speed_s=speed / live.resolution)
    longest = 2.0 + 1.5 * abs(q - start) / speed  # s, tolerance
    deadline = live.now_us() + longest * 1e6
    late = False
    while not late:
        late = live.now_us() >= deadline  # before the status is asked for: this process may have been held up
        if seen is not None and live.marker_source is not None:
            seen(live.look())
        else:
            live.wait(0.02)
        status = live.board.status(live.axis)
        if status.fault:
            live.board.check_fault(live.axis)
        if status.mode == wire.code("MODES", "HOLD"):
            return
    raise TautError(f"axis {live.axis} does not reach {q:g} {live.rig.actuator.unit}: check limits and servo gains")


# -- scale and sign ---------------------------------------------------------------------------------------------------


def probe(live: Live, seen: Callable[[Frame], object], speed: float) -> None:
    """Checks that scale and sign in the rig are right, before a calibration motion is made: moves the motor to both
    sides, by a little and then farther (_PROBE_SHARES), and compares how far the marker moves with how far the motor
    does. speed: unit/s; frames go to `seen`. TautError, with the likely reason, where the two do not fit, or the motor
    is outside of the rig's range."""
    rig, unit = live.rig, live.rig.actuator.unit
    low, high = rig.actuator.range
    start = live.motor_position()
    if not low <= start <= high:
        raise TautError(
            f"the motor is at {start:.4g} {unit}, outside the rig's range [{low:g}, {high:g}]: "
            "move it inside, or say where it is with --at"
        )
    for share in _PROBE_SHARES:
        reach = share * rig.actuator.span
        centre = min(max(start, low + reach), high - reach)
        # Marker and motor after each move. The first move only takes up the backlash: the other two are compared.
        spots = []
        for q in (centre - reach, centre + reach, centre - reach):
            move_to(live, q, speed, seen)
            spots.append((_marker_at_rest(live, seen), live.motor_position()))
        (first, sigma), q_first = spots[1]
        (second, _), q_second = spots[2]
        if abs(q_second - q_first) < reach:
            raise TautError(
                f"the motor was sent {2 * reach:.3g} {unit}, its encoder saw {abs(q_second - q_first):.3g}: "
                "check actuator.encoder_resolution in rig.toml and the encoder"
            )
        moved = second - first
        c = rig.coarse.gain * np.array([q_first, q_second]) + rig.coarse.offset
        expected = np.subtract(*project(rig, c)[::-1])
        enough = _check_marker_motion(moved, expected, sigma)
    if not enough:  # nor after the larger moves
        moved_px, expected_px = float(np.linalg.norm(moved)), float(np.linalg.norm(expected))
        raise TautError(
            f"the motor moved {2 * reach:.3g} {unit}, the marker {moved_px:.2g} px of {expected_px:.3g}: is this camera"
            f" looking at the instrument of axis {live.axis}? Else a scale in rig.toml is too small, or the backlash "
            "larger"
        )


def _check_marker_motion(moved: Array, expected: Array, sigma: float) -> bool:
    """TautError where the marker moved more than _TOO_MUCH times as far as expected, or the other way. moved, expected:
    (2,) px; sigma: standard error of the marker's place, px. Returns whether it moved far enough for its direction to
    be told."""
    expected_px, moved_px = float(np.linalg.norm(expected)), float(np.linalg.norm(moved))
    if moved_px > _TOO_MUCH * expected_px + 10 * sigma:
        raise TautError(
            f"the marker moved {moved_px:.3g} px where f_coarse says {expected_px:.3g}: a scale is too large: check "
            "actuator.unit, encoder_resolution and coarse.gain in rig.toml, and that the camera is the rig's"
        )
    along = float(moved @ expected / max(expected_px, 1e-9))
    enough = moved_px > max(_TOO_LITTLE * expected_px, 12 * sigma)
    if enough and along < -0.5 * moved_px:
        raise TautError(
            f"the marker moves against what f_coarse says ({along:.3g} px of {expected_px:.3g}): turn the sign of "
            "coarse.gain in rig.toml, or check how the camera is mounted (hand_eye)"
        )
    return enough


def _marker_at_rest(live: Live, seen: Callable[[Frame], object]) -> tuple[Array, float]:
    """Takes frames of the axis at rest: first those that are still on their way from before, then _STILL_FRAMES.
    Returns the marker's mean position (2,) and its standard error, px, in those of the latter that show it. All frames
    go to `seen`. TautError where fewer than half of _STILL_FRAMES show it."""
    delayed_frames = round(live.rig.delay_s * (live.rig.camera.frame_rate_hz if live.rig.camera else 25.0)) + 1
    places = []
    for taken in range(delayed_frames + _STILL_FRAMES):
        frame = live.look()
        seen(frame)
        if taken >= delayed_frames and frame.sighting.valid:
            places.append((frame.sighting.u_px, frame.sighting.v_px))
    if len(places) < _STILL_FRAMES / 2:
        raise TautError(
            "the marker is not seen while all is at rest: check the camera, or pick its colour: taut marker"
        )
    return np.mean(places, axis=0), float(np.std(places, axis=0).mean() / np.sqrt(len(places)) + _OFF_PX)


# -- calibration motion -----------------------------------------------------------------------------------------------


class Motions:
    """Runs rounds of calibration motion on a board, one after the other, and records each frame."""

    def __init__(self, live: Live, recorder: Recorder, made: Motion) -> None:
        """recorder: gets every frame; made: the counts and onsets that are updated as rounds are run."""
        self.live, self.recorder, self.made = live, recorder, made
        self.permille = 0  # progress of the present round in 1/1000, as the board reports it
        self._before = 0  # reversals of the rounds before this one
        self._state = _RUNNING[0]  # of the board's motion, a number of TL_WIRE_MOTIONS

    def listening(self) -> AbstractContextManager[None]:
        """A context within which the board's messages on progress and onsets are kept; `run` needs it."""
        return self.live.board.listening(progress=self._on_progress, onset=self._on_onset)

    def _on_progress(self, message: wire.Message) -> None:
        """Listener to the message `progress`: keeps the motion's state, its progress and its reversals."""
        self._state, self.permille = message.state, message.permille
        self.made.reversals = self._before + message.reversals

    def _on_onset(self, message: wire.Message) -> None:
        """Listener to the message `onset`: keeps an onset that the board found, positions in the unit of q, times in s
        of the board."""
        onset = {key: message.values[key] * self.live.resolution for key in ("q1", "q2", "width", "sigma")}
        onset |= {"direction": message.direction, "t_s": message.start_us * 1e-6, "used": message.reason == 0}
        self.made.onsets.append(onset)

    def run(self, wanted: Round, enough: Callable[[Frame], bool]) -> None:
        """Runs a round of passes, which the board's own calibration motion makes, until it is complete or
        `enough(frame)`, which gets every frame, was true once; the axis is at rest afterwards. TautError where the
        motion ends otherwise."""
        live = self.live
        self._before = self.made.reversals
        live.board.ask("motion_start", axis=live.axis, **self._motion_fields(wanted))
        self._state, self.permille = _RUNNING[0], 0
        live.feeding = True
        stopped = False
        while self._state in _RUNNING:
            frame = self.live.look()
            self._record_frame(frame)
            if enough(frame) and not stopped:
                live.board.ask("motion_stop", axis=live.axis)
                stopped = True
        live.feeding = False
        ended = wire.text("MOTIONS", self._state)
        if self._state not in (_COMPLETE, *((_STOPPED,) if stopped else ())):
            live.board.check_fault(live.axis)
            raise TautError(f"the calibration motion is {ended}: what was recorded is in {self.made.folder}")

    def _motion_fields(self, wanted: Round) -> dict[str, Any]:
        """Returns the fields of the message `motion_start` for a round of passes: lengths in counts, times in us."""
        resolution, camera = self.live.resolution, self.live.rig.camera
        assert camera is not None
        counts = (wanted.high - wanted.low) / resolution
        return {
            "cycles": wanted.cycles,
            "low": wanted.low / resolution,
            "high": wanted.high / resolution,
            "speed_s": [speed / resolution for speed in (*wanted.speeds, 0.0, 0.0, 0.0)[:4]],  # 0 ends the list
            "transit_s": wanted.transit / resolution,
            "acceleration_s2": wanted.acceleration / resolution,
            "approach": wanted.approach / resolution,
            "stroke_max": wanted.stroke / resolution,
            "host_timeout_us": round(_HOST_TIMEOUT_S * 1e6),
            "delay_us": round(camera.delay_s * 1e6),
            "sigma_wanted": wanted.sigma_wanted / resolution,
            "sigma_usable": wanted.sigma_usable / resolution,
            "turn": max(_TURN * counts, _LEAST_TURN),
            "curvature": round(min(_SLOPE_CHANGES / counts, _MOST_CHANGE) * 2**20),  # for a count, in 1/2**20
        }

    def stroke(self, wanted: Strokes, enough: Callable[[Frame], bool]) -> None:
        """Runs a round of strokes, one place after the other, until all are done or `enough(frame)`, which gets every
        frame, was true once: the move that is under way is then finished. The axis is at rest afterwards."""
        done = False

        def on_frame(frame: Frame) -> None:
            """Records a frame; sets `done` if the frame is enough."""
            nonlocal done
            self._record_frame(frame)
            done = enough(frame) or done

        for place in wanted.places:
            move_to(self.live, place.low, wanted.transit, on_frame)
            for end in (place.high, place.low) * place.times:
                if done:
                    return
                move_to(self.live, end, place.speed, on_frame)
                self.made.reversals += 1

    def _record_frame(self, frame: Frame) -> None:
        """Records a frame and counts it, also if it shows no marker."""
        self.recorder.add(frame)
        self.made.frames += 1
        self.made.lost_frames += not frame.sighting.valid

    def record_rest(self) -> None:
        """Records _STILL_FRAMES of the axis at rest: the last ones of the motion, which are still on their way, and
        some that show the noise. They are not counted in `made`."""
        for _ in range(_STILL_FRAMES):
            self.recorder.add(self.live.look())


@contextmanager
def moving(live: Live, folder: Path, low: float, high: float, video: bool) -> Iterator[Motions]:
    """A context within which the motor is on, limited to low to high (the rig's unit), and everything is recorded in
    `folder`; yields the Motions that runs rounds. video: the frames are kept too. Whatever happens, the axis comes to
    rest and what was recorded stays; Ctrl-C becomes a TautError that says so. Time and missed telemetry are set in
    `Motions.made` if the block ends without an error."""
    made, missed_before = Motion(folder), live.board.missed
    began = live.now_us()
    with Recorder(live, folder, video) as recorder, driving(live):
        set_range(live, low, high)
        motions = Motions(live, recorder, made)
        try:
            with motions.listening():
                yield motions
        except BaseException as error:
            live.feeding = False
            _stop_motion(live)
            if isinstance(error, KeyboardInterrupt):
                raise TautError(
                    f"stopped after {made.reversals} reversals, the axis is at rest: "
                    f"'taut calibrate {folder} --out MODEL' uses what was recorded"
                ) from None
            raise
    made.seconds = (live.now_us() - began) * 1e-6
    made.telemetry_missed = live.board.missed - missed_before


def check_rig(live: Live) -> None:
    """TautError, with the remedy, where the rig lacks what a live calibration needs, or is for another instrument than
    the board's settings."""
    rig = live.rig
    if rig.sees_from_tip:
        raise TautError("a camera on the tip sees no marker: 'taut record --video' first, then 'taut calibrate' that")
    if rig.camera is None or rig.kinematics is None or rig.hand_eye is None:
        raise TautError("a live calibration needs [camera], [kinematics] and [hand_eye] in rig.toml")
    here, there = rig.actuator.instrument, live.board.ask("get_settings", axis=live.axis).instrument
    if here and there and here != there:
        raise TautError(
            f"the rig is of instrument {here}, but the board's settings of axis {live.axis} are for {there}: name that "
            f"one's rig with --rig, or run 'taut commission --instrument {here}'"
        )


def thorough_round(live: Live, options: MotionOptions) -> Round:
    """Plans the thorough calibration motion (that of the paper), slow passes with many reversals, for this set-up; what
    `options` leave as None (approach and stroke: or 0) is chosen. TautError unless there are 1 to 4 speeds, above 0 and
    no faster than the axis may move."""
    rig, top_speed = live.rig, live.top_speed
    low = rig.actuator.range[0] if options.low is None else options.low
    high = rig.actuator.range[1] if options.high is None else options.high
    fast = min(_TIP_DEG_S / abs(rig.coarse.gain), _OF_TOP_SPEED * top_speed)
    speeds = options.speeds or (fast, 0.5 * fast)
    if not 1 <= len(speeds) <= 4 or min(speeds) <= 0:
        raise TautError("the calibration motion takes 1 to 4 speeds above 0")
    check_speeds(speeds, top_speed, rig.actuator.unit)
    return Round(
        low, high, speeds, options.cycles,
        transit=min(2.0 * max(speeds), top_speed), acceleration=_ACCELERATION * max(speeds),
        approach=options.approach or _APPROACH * (high - low), stroke=options.stroke or _STROKE * (high - low),
        sigma_wanted=_SIGMA_WANTED * (high - low), sigma_usable=_SIGMA_USABLE * (high - low),
    )  # fmt: skip


def record_calibration(
    live: Live,
    folder: Path,
    options: MotionOptions | None = None,
    video: bool = False,
    progress: Progress = None,
    show: Show | None = None,
) -> Motion:
    """Runs the thorough calibration motion and records it in `folder`, for `calibrate` to use. video: the frames are
    kept too; progress: gets the share done, 0 to 1, and a word; show: gets what is known so far after every frame.
    Stopped at any time (Ctrl-C, an error), the axis comes to rest and what was recorded stays. TautError where the rig
    does not fit, or the marker was lost in most frames."""
    check_rig(live)
    options = options or MotionOptions()
    wanted = thorough_round(live, options)
    low, high, unit = wanted.low, wanted.high, live.rig.actuator.unit
    with moving(live, folder, low, high, video) as motions:
        watch = Watch(live, motions.recorder, View(low, high, unit, doing=wanted.says(unit)), show=show)
        if options.probe:
            if progress:
                progress(0.0, "checking scale and sign")
            probe(live, motions.recorder.add, wanted.transit)

        def show_frame(frame: Frame) -> bool:
            """Shows a frame. Returns False, as the motion shall run to its end."""
            made = motions.made
            if show:
                watch.frame(frame, made.reversals)
            if progress:
                progress(motions.permille / 1000.0, f"{made.reversals} reversals")
            return False

        with closing(watch):
            motions.run(wanted, show_frame)
        motions.record_rest()
    made = motions.made
    if made.lost_frames > 0.5 * made.frames:
        raise TautError(
            f"the marker was lost in {made.lost_frames} of {made.frames} frames: pick its colour again with 'taut "
            f"marker', or bring it into view over all of [{low:g}, {high:g}] {unit}"
        )
    return made


def calibrate_live(
    live: Live,
    folder: Path,
    motion: MotionOptions | None = None,
    options: Options | None = None,
    video: bool = False,
    progress: Progress = None,
    show: Show | None = None,
) -> tuple[Calibration, Motion]:
    """Runs the thorough calibration motion, records it in `folder` (see `record_calibration`), and calibrates that
    recording with `options`."""

    def progress_of_part(low: float, high: float) -> Progress:
        """Returns a `progress` for a step that goes from the share `low` of the whole to `high`; None without
        `progress`."""
        return (lambda share, what: progress(low + (high - low) * share, what)) if progress else None

    made = record_calibration(live, folder, motion, video, progress_of_part(0.0, 0.8), show)
    return calibrate([load(folder, live.rig)], live.rig, options, progress_of_part(0.8, 1.0)), made


def _stop_motion(live: Live) -> None:
    """Ends the board's calibration motion and waits until the axis rests. Does nothing more where the board does not
    answer or has a fault: it then comes to rest by itself."""
    try:
        live.board.ask("motion_stop", axis=live.axis)
        live.rest()
    except TautError:
        pass  # gone or faulted
