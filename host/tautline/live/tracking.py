"""A tracker on a board and its camera: the same engine as a replay's, fed as motor and frames come."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tautline.device import wire
from tautline.errors import TautError
from tautline.live.following import follow, motor_trajectory, step
from tautline.live.setup import Frame, Live
from tautline.model import Model
from tautline.rig import MARKER
from tautline.tracking import LawTracker, Row

Progress = Callable[[float, str], None] | None


@dataclass
class Following:
    """Gathers telemetry and frames in their order and keeps the tracker's latest row."""

    live: Live
    model: Model
    told: Callable[[Row, float], None] = lambda row, t_s: None
    tracker: LawTracker = field(init=False)
    row: Row | None = field(init=False, default=None)
    frames: int = field(init=False, default=0)
    unseen: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        if self.live.eye is None:
            raise TautError("no camera: name one with --camera, or use --simulate")
        if self.live.rig.actuator.unit != self.model.rig.actuator.unit:
            unit, own = self.model.rig.actuator.unit, self.live.rig.actuator.unit
            raise TautError(
                f"the model is in {unit}, the rig in {own}: name the rig that the model was calibrated with"
            )
        self.tracker = LawTracker(self.model, MARKER)
        self.tracker.begin()
        self._delay_s = self.model.delay_of(MARKER)
        self._waiting: list[Frame] = []  # for the telemetry of their scene
        self._newest_s = -np.inf
        self._squares, self._counted = 0.0, 0
        self.live.board.listen("batch", self._batch)
        self.live.board.ask("telemetry", axis=self.live.axis, divider=1)

    def _batch(self, batch: wire.Message) -> None:
        if batch.axis != self.live.axis:
            return
        t_s = (batch.t_us + np.arange(batch.count) * batch.period_us) * 1e-6
        q = np.array([batch.q[i] for i in range(batch.count)]) * self.live.resolution
        fresh = t_s > self._newest_s
        if fresh.any():
            self.tracker.motor(t_s[fresh], q[fresh])
            self._newest_s = float(t_s[-1])

    def seen(self, frame: Frame) -> None:
        """A frame; those whose scene the telemetry has reached are tracked."""
        self._waiting.append(frame)
        while self._waiting and self._waiting[0].t_us * 1e-6 - self._delay_s <= self._newest_s:
            self._track(self._waiting.pop(0))

    def _track(self, frame: Frame) -> None:
        arrival_s, sighting = frame.t_us * 1e-6, frame.sighting
        self.row = self.tracker.predict(arrival_s - self._delay_s, arrival_s)
        self.frames += 1
        if sighting.valid:
            self.tracker.see(sighting.u_px, sighting.v_px, sighting.sigma_px)
            off = ((self.row.u_px - sighting.u_px) ** 2 + (self.row.v_px - sighting.v_px) ** 2) / 2.0
            if np.isfinite(off):
                self._squares += off
                self._counted += 1
        else:
            self.unseen += 1
        self.told(self.row, arrival_s)

    @property
    def rms_px(self) -> float | None:
        """Of the predictions, a coordinate."""
        return float(np.sqrt(self._squares / self._counted)) if self._counted else None

    def summary(self) -> dict[str, Any]:
        row = self.row
        changes = [{"t_s": c.t_s, "state": c.state.value, "says": c.says} for c in self.tracker.changes]
        return {
            "frames": self.frames,
            "lost_frames": self.unseen,
            "rms_px": self.rms_px,
            "state": None if row is None else row.state.value,
            "reason": None if row is None else row.reason,
            "offset": None if row is None else row.offset,
            "offset_sigma": None if row is None else row.offset_sigma,
            "scale": None if row is None else row.scale,
            "scale_sigma": None if row is None else row.scale_sigma,
            "compensation": self.tracker.compensation,
            "changes": changes,
        }


def watch(
    live: Live,
    model: Model,
    motion: str = "none",
    *,
    speed: float | None = None,
    duration_s: float | None = None,
    seed: int = 0,
    told: Callable[[Row, float], None] = lambda row, t_s: None,
    progress: Progress = None,
) -> dict[str, Any]:
    """Tracks while the motor follows `motion` (as in `record`), or whatever drives it. Ctrl-C ends it, and is no
    failure; so does duration_s."""
    following = Following(live, model, told)
    plan = None if motion == "none" else motor_trajectory(live, motion, speed, duration_s or 60.0, seed)
    began = live.now_us()
    with live.interruptible():
        try:
            if plan is not None:
                follow(live, *plan, tip=False, seen=following.seen, progress=progress)
            while plan is None:
                passed = (live.now_us() - began) * 1e-6
                if duration_s is not None and passed >= duration_s:
                    break
                step(live, following.seen)
                if progress and duration_s:
                    progress(passed / duration_s, "watching")
        except KeyboardInterrupt:
            pass
    return following.summary() | {"seconds": (live.now_us() - began) * 1e-6}
