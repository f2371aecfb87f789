"""Drives trajectories on a board in open loop, of the tip through the tables on the board or of the motor alone;
records and scores them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tautline import tables, trajectory
from tautline.columns import read_columns
from tautline.compensation import MODES
from tautline.device import wire
from tautline.errors import TautError
from tautline.geometry import coarse_range_deg, pose
from tautline.layouts import TRAJECTORY
from tautline.live.in_use import Following, TableMover, load_tables
from tautline.live.session import driving, set_range
from tautline.live.setup import Frame, Live, Recorder
from tautline.model import Model
from tautline.recording import read_motor
from tautline.rig import Actuator
from tautline.shapes import Library

Array = np.ndarray
Progress = Callable[[float, str], None] | None

SHAPES = ("trapezoids", "smooth")
SET_POINT_HZ = 250.0
_AHEAD_S = 0.1  # set-points are sent so long before they hold
_SILENCE_S = 0.5  # after so long without a set-point the board brings the axis to rest
_STEP_S = 0.06  # one wait of a loop without a camera
_SETTLE_S = 0.25  # rest before a trajectory begins and after its end
_LEAD_SHARE = 0.15  # of the range per second: the move to where a trajectory begins
_MARGIN = 0.06  # of the range of c, left free at either end by the built-in shapes
_COUNTS_AS_BEYOND, _LOOKS = (
    0.05,
    4001,
)  # deg: less is the table's own rounding; times along a trajectory that are looked at


@dataclass(frozen=True)
class Followed:
    """A followed trajectory of the tip. `scored_by`: where c is from, empty where it is not known."""

    t_s: Array  # (n,) board time
    c_ref_deg: Array  # (n,) c*, as planned
    c_deg: Array  # (n,) c, as it was; NaN where it is not known
    counted: Array  # (n,) bool: in a simulation, once the backlash was crossed in both directions; else all
    scored_by: str = ""
    counters: dict[str, Any] = field(default_factory=dict)  # the board's, of this run, by name
    clipped: float = 0.0  # share of the trajectory's time that is beyond `reach_deg`: the tip is held at its end there
    reach_deg: tuple[float, float] = (float("-inf"), float("inf"))  # that the tables, or f_coarse without any, can give
    bus: dict[str, Any] = field(default_factory=dict)  # of motors on a bus of their own: rate, jitter, lag
    tracking: dict[str, Any] | None = None  # what was learnt meanwhile, and how the tables were moved

    @property
    def error_deg(self) -> Array:
        """c less c*, deg, at the samples that are counted and where c is known: (m,), empty where there are none."""
        error: Array = (self.c_deg - self.c_ref_deg)[self.counted & np.isfinite(self.c_deg)]
        return error

    @property
    def rms_deg(self) -> float:
        """Rms of error_deg; NaN where that is empty."""
        return float(np.sqrt(np.mean(self.error_deg**2))) if len(self.error_deg) else float("nan")

    @property
    def max_deg(self) -> float:
        """The largest size of error_deg; NaN where that is empty."""
        return float(np.abs(self.error_deg).max()) if len(self.error_deg) else float("nan")


def tip_trajectory(live: Live, what: str, speed_deg_s: float, seed: int, seconds: float = 60.0) -> tuple[Array, Array]:
    """Returns a trajectory for the tip: times, s, and angles c*, deg, both (n,). what: a CSV file with t_s,c_deg, or
    one of SHAPES over the instrument's range. speed_deg_s: a shape's top speed, limited to what 0.3 of the motor's top
    speed gives; seconds, seed: of the smooth shape. TautError where `what` is neither a shape nor such a file."""
    if what not in SHAPES:
        if not Path(what).is_file():
            raise TautError(f"--trajectory {what}: neither a file nor a shape (trapezoids, smooth)")
        columns = read_columns(Path(what), TRAJECTORY.required(), TRAJECTORY.header())
        return columns.rising_times(), columns.finite("c_deg")
    speed_deg_s = min(speed_deg_s, 0.3 * live.top_speed * abs(live.rig.coarse.gain))  # f may be flatter than f_coarse
    low, high = _reachable_deg(live)
    free = _MARGIN * (high - low)
    return _shape(what, Actuator("deg", (low + free, high - free), 1e-3), speed_deg_s, seconds, seed)


def _shape(what: str, actuator: Actuator, speed: float, seconds: float, seed: int) -> tuple[Array, Array]:
    """Returns one of SHAPES over the actuator's range: times, s, and positions, both (n,). speed: top speed, unit/s;
    seconds, seed: of the smooth shape."""
    if what == "smooth":
        planned = trajectory.random_smooth(actuator, speed, seconds, seed)
    else:
        # 6 trapezoids as high as 0.35 of the range; 1/8 s to full speed, 0.3 s of rest at each end.
        planned = trajectory.trapezoids(actuator, speed, 0.35 * actuator.span, 6, 8.0 * speed, 0.3)
    return planned.t_s, planned.q


def _reachable_deg(live: Live) -> tuple[float, float]:
    """Returns the lowest and the highest angle that the tip can take, deg: by the tables on the board, or by f_coarse
    where there are none or they are empty."""
    blob = live.board.read_table(live.axis)
    if blob:
        table = tables.decode(blob)
        if len(table.q):
            ends = np.interp(table.q_range, table.q, table.c_deg)
            return float(ends.min()), float(ends.max())
    return coarse_range_deg(live.rig)


def follow(
    live: Live,
    t_s: Array,
    value: Array,
    *,
    tip: bool,
    compensation: str = "full",
    strength: float = 1.0,
    seen: Callable[[Frame], None] | None = None,
    progress: Progress = None,
) -> tuple[float, Array, Array]:
    """Drives an axis along a trajectory by set-points: first a straight move to where it begins, at the end rest, motor
    off. t_s, value: (n,), the trajectory; tip: whether values are angles of the tip, deg, that go through the tables on
    the board, or motor positions, the rig's unit. compensation: one of MODES; strength: its share that is applied, 0 to
    1; seen: gets the frames meanwhile. Returns the board time, s, at which the trajectory itself begins, and times
    (board, s) and values of all set-points, both (m,). TautError for a fault, or where set-points are refused."""
    board, axis = live.board, live.axis
    scale = wire.DEG if tip else wire.COUNT / live.resolution
    wire.set_point_values(value, scale)  # raises, before anything moves, where a value does not fit into the message
    board.refused.clear()
    with driving(live):
        set_range(live, *live.rig.actuator.range)
        board.ask("strength", axis=axis, strength=strength)
        silence_us = round(_SILENCE_S * 1e6)
        mode = MODES[compensation]
        board.ask("follow", axis=axis, target=int(tip), compensation=mode, silence_us=silence_us)
        status = board.status(axis)
        current = status.c_ref if tip else status.q_ref * live.resolution
        span = np.ptp(coarse_range_deg(live.rig)) if tip else live.rig.actuator.span
        lead_s = max(abs(value[0] - current) / (_LEAD_SHARE * span), 0.2)  # of the move to where it begins
        # The plan: the lead from the current value, a rest, the trajectory; its set-points are on an even grid.
        plan_t = np.concatenate([[0.0, lead_s], lead_s + _SETTLE_S + (t_s - t_s[0])])
        grid_s = np.arange(0.0, plan_t[-1] + _SETTLE_S, 1.0 / SET_POINT_HZ)
        plan = np.interp(grid_s, plan_t, np.concatenate([[current, value[0]], value]))
        start_us = _send_ahead(live, grid_s, wire.set_point_values(plan, scale), seen, progress)
        while live.now_us() < start_us + grid_s[-1] * 1e6:
            step(live, seen)
    _check_refusals(live)
    return start_us * 1e-6 + lead_s + _SETTLE_S, start_us * 1e-6 + grid_s, plan


def _send_ahead(
    live: Live, grid_s: Array, values: Array, seen: Callable[[Frame], None] | None, progress: Progress
) -> int:
    """Sends the set-points `values` (n,), as the message has them, for the times grid_s (n,), s from the first one,
    each _AHEAD_S before its time. Those whose time has passed, as after this process was held up, are left out. Returns
    the board time, us, at which the grid begins. TautError where the board refuses one."""
    board = live.board
    # An emulated board may have run ahead of the time that was granted, by what loading a table took.
    start_us = max(live.now_us(), board.sync()) + round(_AHEAD_S * 1e6)
    sent = 0
    while sent < len(grid_s):
        now_s = (live.now_us() - start_us) * 1e-6
        due = int(np.searchsorted(grid_s, now_s + _AHEAD_S, side="right"))
        sent = max(sent, min(int(np.searchsorted(grid_s, now_s)), due - 1))  # skips those that are too late
        points = zip(values[sent:due], np.rint(start_us + grid_s[sent:due] * 1e6), strict=True)
        board.tell_all("set_point", [{"axis": live.axis, "value": int(v), "at_us": int(t)} for v, t in points])
        sent = max(due, sent)
        step(live, seen)
        _check_refusals(live)
        if progress:
            progress(sent / len(grid_s), "following")
    return start_us


def step(live: Live, seen: Callable[[Frame], None] | None) -> None:
    """Makes one turn of a loop that waits: for the next frame, which goes to `seen`; without a camera or `seen`, for
    _STEP_S."""
    if live.marker_source is not None and seen is not None:
        seen(live.look())
    else:
        live.wait(_STEP_S)


def _check_refusals(live: Live) -> None:
    """TautError where the board has refused a set-point since `follow` began: the axis' fault if it has one, else the
    reason of the first refusal."""
    if live.board.refused:
        live.board.check_fault(live.axis)
        refused = live.board.refused[0]
        if refused.reason == "NOT_FOLLOWING":
            raise TautError(
                f"axis {live.axis} came to rest: no set-points came for {_SILENCE_S:g} s. Close what keeps this "
                "machine busy, and run the command again"
            )
        raise refused


def follow_run(
    live: Live,
    what: str,
    *,
    compensation: str = "full",
    model: Model | None = None,
    strength: float = 1.0,
    speed_deg_s: float = 15.0,
    seed: int = 0,
    folder: Path | None = None,
    track: bool = False,
    library: Library | None = None,
    progress: Progress = None,
) -> Followed:
    """Makes one run of `taut follow`: loads the model's tables if one is given, follows a trajectory of the tip,
    records it in `folder` if one is given, and returns what the tip did, compared with the plan. what, speed_deg_s,
    seed: as in `tip_trajectory`; compensation: off (the motor follows f_coarse's inverse), backlash (f_coarse and B) or
    full (f_remain and B); strength: its share that is applied, 0 to 1. track: the camera keeps the model calibrated
    meanwhile and moves the board's tables; shapes of `library` are then recognised. TautError where `track` has no
    model, or compensation is not off and the axis has no tables."""
    if track and model is None:
        raise TautError("nothing to track: name the MODEL whose tables are in the board")
    board, axis, coarse = live.board, live.axis, live.rig.coarse
    if model is not None:
        load_tables(board, axis, model)
    has_tables = bool(board.read_table(axis))
    if not has_tables and compensation != "off":
        raise TautError(f"axis {axis} has no tables: flash a model first, or use --compensation off")
    t_s, c_deg = tip_trajectory(live, what, speed_deg_s, seed)
    reach_deg = _reachable_deg(live)
    clipped = _share_beyond(t_s, c_deg, reach_deg)
    frames: list[Frame] = []
    with ExitStack() as stack:
        following: Following | None = None
        if track and model is not None:
            made = Following(live, model, mover=TableMover(live), library=library)
            following = stack.enter_context(closing(made))
        board.counters(clear=True)
        recorder = None if folder is None else stack.enter_context(Recorder(live, folder))

        def on_frame(frame: Frame) -> None:
            """Keeps a frame, without its picture, records it and tracks it."""
            frames.append(replace(frame, picture=None))  # the pictures of a run would fill the memory
            if recorder is not None:
                recorder.add(frame)
            if following is not None:
                following.take(frame)

        begin_s, sent_s, sent = follow(
            live,
            t_s,
            c_deg if has_tables else (c_deg - coarse.offset) / coarse.gain,  # else f_coarse's inverse: motor positions
            tip=has_tables,
            compensation=compensation,
            strength=strength,
            seen=on_frame if recorder is not None or following is not None or live.plant is None else None,
            progress=progress,
        )
    plan = sent if has_tables else coarse.gain * sent + coarse.offset
    counters = board.counters()
    if folder is not None:
        rows = np.column_stack([sent_s, plan])
        np.savetxt(
            folder / "trajectory.csv", rows, fmt=["%.6f", "%.5f"], delimiter=",", header="t_s,c_deg", comments=""
        )
    scored = _compared_with_plan(live, begin_s, sent_s, plan, frames)
    counted = {name: int(v) for name, v in counters.values.items() if name != "t_us"}
    learnt = None if following is None else following.summary()
    return replace(scored, counters=counted, bus=board.bus(), clipped=clipped, reach_deg=reach_deg, tracking=learnt)


def _share_beyond(t_s: Array, c_deg: Array, reach_deg: tuple[float, float]) -> float:
    """Returns the share, 0 to 1, of a trajectory's time in which the wanted angle is beyond what the tip can take. t_s,
    c_deg: the trajectory, (n,); reach_deg: the lowest and the highest angle."""
    low, high = reach_deg
    wanted_deg = np.interp(np.linspace(t_s[0], t_s[-1], _LOOKS), t_s, c_deg)
    return float(np.mean((wanted_deg < low - _COUNTS_AS_BEYOND) | (wanted_deg > high + _COUNTS_AS_BEYOND)))


def _compared_with_plan(live: Live, begin_s: float, t_s: Array, plan: Array, frames: list[Frame]) -> Followed:
    """Returns the run compared with its plan. The tip's angle is the simulated instrument's true one, counted once the
    backlash was crossed both ways; else the one that the camera saw, all of it counted; NaN where there is neither.
    begin_s: when the trajectory itself begins; t_s, plan: times of the set-points, board time in s, and c*, deg, (n,);
    frames: those of the run, with their markers."""
    if live.plant is not None:
        times_s, q, p, c = live.plant.truth()
        half_width = 0.5 * live.plant.instrument.backlash(p)
        keep = (times_s >= begin_s) & (times_s <= t_s[-1])
        counted = backlash_crossed(q[keep], p[keep], half_width[keep])
        return Followed(
            times_s[keep], np.interp(times_s[keep], t_s, plan), c[keep], counted, "the simulated instrument"
        )
    with_marker = [frame for frame in frames if frame.sighting.valid]
    times_s = np.array([frame.t_us for frame in with_marker]) * 1e-6 - live.rig.delay_s
    inside = (times_s >= begin_s) & (times_s <= t_s[-1])
    if inside.any():
        c, _ = pose(live.rig, [(frame.sighting.u_px, frame.sighting.v_px) for frame in with_marker])
        ref = np.interp(times_s, t_s, plan)
        return Followed(times_s[inside], ref[inside], c[inside], np.ones(int(inside.sum()), dtype=bool), "the camera")
    return Followed(t_s, plan, np.full(len(t_s), np.nan), np.ones(len(t_s), dtype=bool))


def backlash_crossed(q: Array, p: Array, half: Array) -> Array:
    """Returns for each sample (n,) whether the motor has by then driven through the backlash in both directions, that
    is, q - p has been +B/2 and -B/2. Before that the tip's place within the backlash is not known, and errors are not
    counted. q, p: motor and centre coordinate, half: B/2, (n,) each, unit of q."""
    up, down = q - p >= half - 1e-9, q - p <= 1e-9 - half
    counted: Array = np.logical_or.accumulate(up) & np.logical_or.accumulate(down)
    return counted


def record(
    live: Live,
    folder: Path,
    motion: str = "none",
    *,
    speed: float | None = None,
    duration_s: float = 60.0,
    video: bool = False,
    seed: int = 0,
    seen: Callable[[Frame], None] = lambda frame: None,
    progress: Progress = None,
) -> dict[str, Any]:
    """Records motor and marker in `folder` while the motor follows a motion. motion: a file or shape, as in
    `motor_trajectory`, or "none": something else moves the motor, and duration_s are recorded. speed: unit/s;
    duration_s: also of the smooth shape; video: the frames are kept too; seen: gets every frame. Ctrl-C, also a
    KeyboardInterrupt from `seen`, ends the recording and is no failure. Returns the result of `taut record` for
    JSON."""
    counts = {"motor_samples": 0, "frames": 0, "lost_frames": 0}

    def add(frame: Frame) -> None:
        """Records and counts a frame."""
        recorder.add(frame)
        counts["frames"] += 1
        counts["lost_frames"] += not frame.sighting.valid
        seen(frame)

    def count_samples(message: wire.Message) -> None:
        """Counts the samples of a telemetry message, if it is of this axis."""
        counts["motor_samples"] += message.count if message.axis == live.axis else 0

    missed_before = live.board.missed
    live.board.counters(clear=True)
    plan = None if motion == "none" else motor_trajectory(live, motion, speed, duration_s, seed)
    left_out = other_axes(motion)
    began = live.now_us()
    with live.board.listening(batch=count_samples), Recorder(live, folder, video) as recorder, live.interruptible():
        try:
            if plan is not None:
                follow(live, *plan, tip=False, seen=add, progress=progress)
            while plan is None and (passed := (live.now_us() - began) * 1e-6) < duration_s:
                step(live, add)
                if progress:
                    progress(passed / duration_s, "recording")
        except KeyboardInterrupt:
            pass
    return {
        "recording": folder,
        "seconds": (live.now_us() - began) * 1e-6,
        "other_axes": left_out,
        **counts,
        "telemetry_dropped": int(live.board.counters().telemetry_dropped),
        "messages_missed": live.board.missed - missed_before,
        "bus": live.board.bus(),
    }


def other_axes(motion: str) -> list[str]:
    """Returns those columns of a motion's file that are motions of other axes (translation, rotation), which this
    board's axis does not make, so that the user can be told; none for a shape or "none"."""
    if motion == "none" or motion in SHAPES:
        return []
    names = read_columns(Path(motion), (), "").names
    return [name for name in ("translation_mm", "rotation_deg") if name in names]


def motor_trajectory(live: Live, what: str, speed: float | None, seconds: float, seed: int) -> tuple[Array, Array]:
    """Returns a trajectory for the motor: times, s, and positions, the rig's unit, both (n,). what: a motor.csv within
    the rig's range, or one of SHAPES over it. speed: a shape's top speed, unit/s; None: 15 deg/s of the tip, or half
    the motor's top speed if that is less. seconds, seed: of the smooth shape. TautError where `what` is neither, or
    leaves the range."""
    actuator = live.rig.actuator
    if what not in SHAPES:
        if not Path(what).is_file():
            raise TautError(f"--motion {what}: neither a file nor a shape (none, trapezoids, smooth)")
        motor = read_motor(Path(what), live.rig)
        low, high = actuator.range
        if motor.q.min() < low - 1e-6 or motor.q.max() > high + 1e-6:
            raise TautError(f"{what}: goes beyond the rig's range, {low:g} to {high:g} {actuator.unit}")
        return motor.t_s, motor.q
    speed = speed or min(15.0 / abs(live.rig.coarse.gain), 0.5 * live.top_speed)
    return _shape(what, actuator, speed, seconds, seed)
