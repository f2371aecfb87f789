"""What a live calibration knows while it runs: which positions were seen on the way up and down, and B(q) so far."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from tautline import spread
from tautline.calibration.calibrate import calibrate
from tautline.calibration.options import Options
from tautline.calibration.result import Calibration
from tautline.errors import TautError
from tautline.live.rounds import CameraView, Standing, in_words
from tautline.live.setup import Frame
from tautline.recording import Recording
from tautline.rig import Rig

Array = np.ndarray

BINS = 48  # of the range
_FIRST_FIT_S, _BETWEEN_FITS = 2.5, 0.2  # s, or this share of the time so far
_STILL = 0.02  # of a bin: a motor that moved less from one frame to the next rests


@dataclass
class View:
    """What a live calibration shows while it runs, updated with every frame. Positions and widths in the rig's unit."""

    low: float  # of the range
    high: float
    unit: str
    until: float | None = None  # the goal for sigma, where there is one
    doing: str = ""  # what is being done, in words
    seconds: float = 0.0  # of recording
    frames: int = 0
    lost: int = 0  # frames without the marker
    reversals: int = 0
    rising: Array = field(default_factory=lambda: np.zeros((BINS, 2), dtype=np.int64))  # frames: seen, lost
    falling: Array = field(default_factory=lambda: np.zeros((BINS, 2), dtype=np.int64))
    calibration: Calibration | None = None  # from a recording of `calibrated_s`
    standing: Standing | None = None
    calibrated_s: float = 0.0
    frame: Frame | None = None  # the latest
    q: float = float("nan")  # of the motor, at the time that the frame shows
    onsets: list[dict[str, Any]] = field(default_factory=list)  # as the board finds them, see Motion

    @property
    def coverage(self) -> float:
        """Share of the range, 0 to 1, in which the marker was seen both on the way up and on the way down."""
        return float(np.mean((self.rising[:, 0] > 0) & (self.falling[:, 0] > 0)))

    @property
    def share(self) -> float:
        """Progress, 0 to 1: the mean of `coverage` and of the progress towards the goal's sigma."""
        to_goal = self.standing.share(self.until) if self.standing is not None and self.until is not None else 0.0
        return 0.5 * (self.coverage + to_goal)

    @property
    def unseen(self) -> tuple[float, float]:
        """The positions, the rig's unit, from the first to the last of the BINS in which the marker was mostly lost;
        (0, 0) where there are none."""
        seen, lost = (self.rising + self.falling).T
        lost_bins = np.flatnonzero(lost > seen)
        if not len(lost_bins):
            return 0.0, 0.0
        width = (self.high - self.low) / BINS
        return self.low + float(lost_bins[0]) * width, self.low + float(lost_bins[-1] + 1) * width


Show = Callable[[View], None]


def in_short(view: View) -> tuple[str, str]:
    """Returns two lines for terminal and page: what was recorded so far, and how well B(q) is known by it."""
    seen = f"{view.seconds:.1f} s, {view.frames - view.lost} of {view.frames} frames, {view.reversals} reversals"
    if view.calibration is None:
        return seen, "too early to tell B(q)"
    low, high = view.calibration.model.measured
    known = f"B(q) from {low:.3g} to {high:.3g} {view.unit}"
    if view.standing is None or view.until is None:
        return seen, known
    wanted = f"wanted {in_words(view.until, view.unit)}"
    worst = view.standing.worst
    if not np.isfinite(worst):
        return seen, f"B(q) is not known anywhere yet, {wanted}"
    return seen, f"{known}, sigma {in_words(worst, view.unit)} at worst (at {view.standing.where:.3g}), {wanted}"


class Watched(Protocol):
    """Where frames come from: a Live, or a recording that is played again."""

    @property
    def rig(self) -> Rig:
        """The rig of the set-up or of the recording."""

    @property
    def virtual(self) -> bool:
        """Whether time stands still between two frames."""

    def now_us(self) -> int:
        """The time of the board, us."""

    def look(self) -> Frame:
        """Waits for the next frame."""


class Kept(Protocol):
    """What there is of the recording so far: a Recorder, or the part of a recording that was played."""

    def add(self, frame: Frame) -> None:
        """Records a frame."""

    def motor_at(self, t_s: float) -> float:
        """The motor's position, the rig's unit, at a time, s; NaN before the first sample."""

    def recording_so_far(self) -> Recording:
        """The recording so far. TautError where there is nothing yet."""

    def paused(self) -> AbstractContextManager[None]:
        """A context within which nothing is recorded."""


class Watch:
    """Takes in every frame and calibrates what was recorded so far, again and again.

    With a real camera a thread does so while frames go on to be taken. In virtual time it is done between two frames,
    so that a simulation repeats exactly.
    """

    def __init__(
        self, live: Watched, recorder: Kept, view: View, options: Options | None = None, show: Show | None = None
    ) -> None:
        """view: is updated with every frame; options: of the calibrations; show: is called with the view after every
        frame."""
        self.view = view
        self._live, self._recorder, self._options, self._show = live, recorder, options, show
        self._began_us = live.now_us()
        self._last_q = float("nan")
        self._rested: tuple[float, float] | None = None  # where the marker was in the frame before, at rest
        self._steps: list[tuple[float, float]] = []  # of a marker at rest, px from frame to frame
        self._due_s = _FIRST_FIT_S  # when the next calibration is started, s of recording
        self._pool = None if live.virtual else ThreadPoolExecutor(1, "calibration")
        self._fit: Future[tuple[Calibration, float]] | None = None

    def close(self) -> None:
        """Ends the thread of the calibrations, without waiting for the one that it is at."""
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)

    def frame(self, frame: Frame, reversals: int) -> bool:
        """Takes in a frame, and starts a calibration of what was recorded so far if one is due; `show` gets the view
        afterwards. reversals: how many were made so far. Returns whether a calibration has been finished since the last
        frame; the view then has it."""
        view = self.view
        view.seconds = (frame.t_us - self._began_us) * 1e-6
        view.frames += 1
        view.lost += not frame.sighting.valid
        view.reversals = reversals
        view.frame = frame
        self._count_positions(frame)
        fresh = self._take_calibration()
        if self._fit is None and view.seconds >= self._due_s:
            self._due_s = view.seconds + max(_FIRST_FIT_S, _BETWEEN_FITS * view.seconds)
            self._fit = self._start_calibration()
            fresh = self._take_calibration() or fresh
        if self._show is not None:
            self._show(view)
        return fresh

    def settle(self) -> None:
        """Calibrates everything that was recorded once more and waits for the result, recording frames meanwhile.
        TautError where nothing can be measured in it."""
        while not self._take_calibration() and self._fit is not None:  # an earlier one
            self._record_frame_meanwhile()
        self._fit = self._start_calibration(naming=True)
        while not self._take_calibration(strict=True):
            self._record_frame_meanwhile()
        if self._show is not None:
            self._show(self.view)

    def rest(self, resting: Callable[[], bool]) -> None:
        """Shows frames while `resting()` is true. They are not recorded, and their time does not count as time of
        recording."""
        began_us, doing = self._live.now_us(), self.view.doing
        self.view.doing = "at rest"
        with self._recorder.paused():
            while resting():
                self.view.frame = self._live.look()
                if self._show is not None:
                    self._show(self.view)
        self._began_us += self._live.now_us() - began_us
        self.view.doing = doing

    def camera_view(self) -> CameraView:
        """Returns how well the camera has seen the marker so far: its noise, px, from frame to frame at rest (NaN where
        it never rested), and the positions where it was lost."""
        steps = np.abs(self._steps)
        # A step has the noise of two frames.
        noise = spread.deviation(steps) / float(np.sqrt(2.0)) if steps.size else float("nan")
        return CameraView(noise, self.view.unseen)

    def _record_frame_meanwhile(self) -> None:
        """Records one frame during a wait, so that none is stale afterwards."""
        self._recorder.add(self._live.look())

    def _start_calibration(self, naming: bool = False) -> Future[tuple[Calibration, float]]:
        """Starts the calibration of what was recorded so far: in the thread, or in virtual time at once. Returns its
        future, whose result is the calibration and the seconds of recording that it is made of. naming: whether it also
        names what departs from the model, which takes longer."""
        recording, seconds = self._recorder.recording_so_far(), self.view.seconds

        def work() -> tuple[Calibration, float]:
            """Calibrates the recording; returns the calibration and the seconds of recording that it is of."""
            return calibrate([recording], self._live.rig, self._options, naming=naming), seconds

        if self._pool is not None:
            return self._pool.submit(work)
        done: Future[tuple[Calibration, float]] = Future()
        try:
            done.set_result(work())
        except TautError as error:
            done.set_exception(error)
        return done

    def _take_calibration(self, strict: bool = False) -> bool:
        """Puts a finished calibration, if there is one, into the view; returns whether it did. One that failed, as too
        little was recorded yet, counts as none; with `strict` its TautError is raised."""
        if self._fit is None or not self._fit.done():
            return False
        fit, self._fit = self._fit, None
        with suppress(*(() if strict else (TautError,))):  # too early to tell anything
            calibration, seconds = fit.result()
            view = self.view
            view.calibration, view.calibrated_s = calibration, seconds
            if view.until is not None:
                view.standing = Standing.of(calibration, view.low, view.high, view.until)
            return True
        return False

    def _count_positions(self, frame: Frame) -> None:
        """Counts the BINS of the range that the motor passed between the scenes of the last frame and of this one as
        seen or lost, by direction. If the motor rests, keeps how far the marker moved between both, for `camera_view`.
        Sets the view's q; does nothing else where one of both positions is not known."""
        view = self.view
        q = self._recorder.motor_at(frame.t_us * 1e-6 - self._live.rig.delay_s)
        before, self._last_q, view.q = self._last_q, q, q
        passed = np.array([before, q] if before < q else [q, before])
        if not np.isfinite(passed).all():
            return
        first, last = (passed - view.low) / (view.high - view.low) * BINS  # beyond the range too
        seen = frame.sighting
        rested, self._rested = self._rested, None
        if last - first < _STILL:
            self._rested = (seen.u_px, seen.v_px) if seen.valid else None
            if rested is not None and self._rested is not None:
                self._steps.append((self._rested[0] - rested[0], self._rested[1] - rested[1]))
            return
        bins = slice(*np.clip(np.floor([first, last + 1.0]), 0, BINS).astype(int))
        counts = view.rising if q > before else view.falling
        counts[bins, int(not seen.valid)] += 1
