"""Tracks with a board and its camera while the instrument is in use, and tells the board what was learnt: the tables in
use follow it."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from tautline import tables
from tautline.compensation import BLEND_S
from tautline.device import wire
from tautline.device.board import Board, BoardRefused
from tautline.errors import TautError
from tautline.live.setup import Frame, Live
from tautline.model import Model
from tautline.rig import MARKER
from tautline.shapes import Library, Seen, Shape
from tautline.tracking import LawTracker, Row, State

Array = np.ndarray

_NEWS_COUNTS, _NEWS_SCALE = 1.0, 0.002  # smaller changes of offset, counts, and scale are not worth a message
_BATCHES = 100  # messages of telemetry that are kept: they reach back beyond the camera's delay
_AGAIN_S = 1.0  # a board that lost its host meanwhile has forgotten: it is told again


def load_tables(board: Board, axis: int, model: Model) -> None:
    """Loads the model's tables into an axis of the board, with the limits of adaptation for use. Tables of this model
    that are there already stay as they are, with their own limits."""
    stored = board.read_table(axis)
    if not stored or tables.decode(stored).model_id != tables.model_id(model):
        board.load_table(axis, tables.encode(model, axis=axis, limits=tables.Limits.in_use(model.rig)))


@dataclass(frozen=True)
class TablesMoved:
    """How far the board's tables were moved, from a frame that arrived at t_s on."""

    t_s: float
    offset: float  # unit of q
    scale: float  # of B


class TableMover:
    """Moves the tables of a board's axis, by an offset and a scale of B, within what the tables themselves allow (their
    section `adapt`)."""

    def __init__(self, live: Live) -> None:
        """Reads how far the board's tables may be moved, and moves them back to as they were calibrated; sends nothing
        if they may not be moved."""
        self._live = live
        blob = live.board.read_table(live.axis)
        # The largest offset, unit of q, and the least and the largest scale of B; None: they may not be moved.
        self.most = tables.decode(blob).limits.adapt if blob else None
        self.moves: list[TablesMoved] = []
        self.beyond = ""  # in words, what was learnt beyond that
        self._sent_s = -np.inf  # the arrival of the frame by which the board was told last
        self._in_use = TablesMoved(-np.inf, 0.0, 1.0)
        if self.most is not None:
            self._send(self._in_use, 0.0)

    def use(self, t_s: float, offset: float, scale: float) -> None:
        """Has the board move its tables to the offset (unit of q) and scale of B learnt from a frame that arrived at
        t_s, s, clipped to what the tables allow (`beyond` then says so). Changes below _NEWS_COUNTS and _NEWS_SCALE are
        not sent; the move in use is sent again every _AGAIN_S, for a board that has lost its host meanwhile. Does
        nothing if the tables may not be moved."""
        if self.most is None:
            return
        farthest, least, most = self.most
        allowed = TablesMoved(t_s, float(np.clip(offset, -farthest, farthest)), float(np.clip(scale, least, most)))
        self.beyond = ""
        if (allowed.offset, allowed.scale) != (offset, scale):
            unit = self._live.rig.actuator.unit
            self.beyond = (
                f"offset {offset:+.4g} {unit}, scale {scale:.3g} are beyond what the board's tables allow "
                f"(+-{farthest:.4g} {unit}, {least:.3g} to {most:.3g}): calibrate and flash again"
            )
        counts = abs(allowed.offset - self._in_use.offset) / self._live.resolution
        is_new = counts > _NEWS_COUNTS or abs(allowed.scale - self._in_use.scale) > _NEWS_SCALE
        if is_new and self._send(allowed, t_s):
            self.moves.append(allowed)
        elif not is_new and self.moves and t_s > self._sent_s + _AGAIN_S:
            self._send(self._in_use, t_s)

    def _send(self, move: TablesMoved, t_s: float) -> bool:
        """Asks the board to move its tables, which takes BLEND_S, and keeps the move as the one in use. If the board
        refuses, returns False: nothing is moved from now on, and `beyond` says why."""
        offset_counts = move.offset / self._live.resolution
        fields = {"offset": offset_counts, "scale": move.scale, "within_ms": round(1e3 * BLEND_S)}
        try:
            self._live.board.ask("adapt", axis=self._live.axis, **fields)
        except BoardRefused as error:  # other tables than those that were read
            self.most, self.beyond = None, str(error)
            return False
        self._in_use, self._sent_s = move, t_s
        return True


@dataclass
class Following:
    """A tracker fed by a board's telemetry and a camera's frames, in their order, as they come."""

    live: Live
    model: Model  # that is kept calibrated
    # Gets every row of the tracker, and its frame's arrival, s.
    on_row: Callable[[Row, float], None] = lambda row, t_s: None
    mover: TableMover | None = None  # moves the board's tables to what is learnt from frames that show the marker
    library: Library | None = None  # whose shapes are looked for
    shown: Callable[[Frame, float], None] = lambda frame, q: None  # a frame that was tracked, the motor at its scene
    # The library's shape that the shaft has now; None where that is the model's own, or cannot be told.
    recognised_shape: Shape | None = field(init=False, default=None)
    tracker: LawTracker = field(init=False)
    row: Row | None = field(init=False, default=None)  # the tracker's latest
    frames: int = field(init=False, default=0)  # tracked so far
    unseen: int = field(init=False, default=0)  # of these without the marker
    lost: str = field(init=False, default="")  # why frames no longer come

    def __post_init__(self) -> None:
        """Starts the tracker and the board's telemetry. TautError where there is no camera, the model's unit is not the
        rig's, or the model is none of the library's shapes."""
        if self.live.marker_source is None:
            raise TautError("no camera: name one with --camera, or use --simulate")
        if self.live.rig.actuator.unit != self.model.rig.actuator.unit:
            unit, own = self.model.rig.actuator.unit, self.live.rig.actuator.unit
            raise TautError(
                f"the model is in {unit}, the rig in {own}: name the rig that the model was calibrated with"
            )
        self.tracker = LawTracker(self.model, MARKER)
        self.tracker.begin()
        self._model_shape = None if self.library is None else self.library.own(self.model)
        if self.library is not None and self._model_shape is None:
            raise TautError(f"{self.library.folder}: the model is none of its shapes: 'taut shapes add' makes it one")
        self._delay_s = self.model.delay_of(MARKER)
        self._waiting: list[Frame] = []  # for the telemetry of their scene
        self._batches: deque[wire.Message] = deque()  # a board's reader is another thread
        self._motor_samples: deque[tuple[Array, Array]] = deque(maxlen=_BATCHES)
        self._newest_s = -np.inf
        self._squared_error, self._frames_compared = 0.0, 0
        self._last_law: tuple[float, ...] = ()
        self.live.board.listen("batch", self._batches.append)
        self.live.board.ask("telemetry", axis=self.live.axis, divider=1)

    def close(self) -> None:
        """Ends listening to the board's telemetry."""
        self.live.board.forget("batch", self._batches.append)

    def _read_telemetry(self) -> None:
        """Hands the telemetry that has come since the last call to the tracker, each sample once, and keeps it for
        `motor_at`."""
        while self._batches:
            batch = self._batches.popleft()
            if batch.axis != self.live.axis:
                continue
            t_s = (batch.t_us + np.arange(batch.count) * batch.period_us) * 1e-6
            q = np.asarray(batch.q[: batch.count]) * self.live.resolution
            fresh = t_s > self._newest_s
            if fresh.any():
                self._motor_samples.append((t_s[fresh], q[fresh]))
                self.tracker.motor(t_s[fresh], q[fresh])
                self._newest_s = float(t_s[-1])

    def motor_at(self, t_s: float) -> float:
        """The motor's position, the rig's unit, at a board time, s; NaN for a time before the last _BATCHES messages of
        telemetry, which are kept."""
        for times, q in reversed(self._motor_samples):
            if times[0] <= t_s:
                return float(np.interp(t_s, times, q))
        return float("nan")

    def take(self, frame: Frame) -> None:
        """Queues the next frame, and tracks all queued frames whose scene time the motor's telemetry has reached."""
        self._read_telemetry()
        self._waiting.append(frame)
        while self._waiting and self._waiting[0].t_us * 1e-6 - self._delay_s <= self._newest_s:
            self._track(self._waiting.pop(0))

    def _track(self, frame: Frame) -> None:
        """Predicts where the marker is in a frame, learns from it if it shows the marker, and moves the board's tables
        to what was learnt; while the model is STALE only if two passes of one place have made the tracker dial B down.
        Hands the row to `on_row` and the frame to `shown`."""
        arrival_s, sighting = frame.t_us * 1e-6, frame.sighting
        self.row = self.tracker.predict(arrival_s - self._delay_s, arrival_s)
        self.frames += 1
        if sighting.valid:
            self.tracker.see(sighting.u_px, sighting.v_px, sighting.sigma_px)
            squared_px = ((self.row.u_px - sighting.u_px) ** 2 + (self.row.v_px - sighting.v_px) ** 2) / 2.0
            if np.isfinite(squared_px):
                self._squared_error += squared_px
                self._frames_compared += 1
            usable = self.row.state is not State.STALE or self.tracker.dialled_down
            if self.mover is not None and usable:
                self.mover.use(arrival_s, self.row.offset, self.tracker.compensation)
        else:
            self.unseen += 1
        self._recognise_shape(self.row)
        self.on_row(self.row, arrival_s)
        self.shown(frame, self.motor_at(arrival_s - self._delay_s))

    def _recognise_shape(self, row: Row) -> None:
        """Sets `recognised_shape` to the one shape of the library that agrees with the learnt offset and scale; to None
        if that is the model's own, or if none or several agree. Leaves it as it is while what was learnt has not
        changed, or is STALE."""
        if self.library is None or self._model_shape is None or row.state is State.STALE:
            return
        law = (row.offset, row.offset_sigma, row.scale, row.scale_sigma)
        if law == self._last_law:
            return
        self._last_law = law
        agreeing = self.library.nearest(Seen(*law), self._model_shape, float(np.mean(self.model.width)))
        self.recognised_shape = agreeing if agreeing is not None and agreeing.name != self._model_shape.name else None

    @property
    def beyond(self) -> str:
        """In words, by how much what was learnt is beyond what the board's tables allow; "" where it is not."""
        return "" if self.mover is None else self.mover.beyond

    @property
    def rms_px(self) -> float | None:
        """Rms error of the predicted marker per coordinate, px; None before any frame was compared."""
        return float(np.sqrt(self._squared_error / self._frames_compared)) if self._frames_compared else None

    def summary(self) -> dict[str, Any]:
        """Returns the state at the end and what was learnt, as the JSON of the commands that track has it."""
        row = self.row
        changes = [{"t_s": c.t_s, "state": c.state.value, "says": c.says} for c in self.tracker.changes]
        document: dict[str, Any] = {
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
        if self.library is not None:
            document["shape"] = None if self.recognised_shape is None else self.recognised_shape.name
        if self.mover is not None:
            document |= {
                "moves": [asdict(move) for move in self.mover.moves],
                "moves_within": None if self.mover.most is None else list(self.mover.most),
                "beyond": self.beyond,
            }
        return document


@contextmanager
def tracking_beside(following: Following) -> Iterator[Following]:
    """A context within which a thread takes frames and tracks, while the block sends set-points; afterwards `following`
    is closed. If the camera is lost only tracking ends: `following.lost` says so, and the board's tables stay as they
    were moved last."""
    ended = threading.Event()

    def work() -> None:
        """Body of the thread: tracks frame after frame until the block has ended or the camera is lost."""
        try:
            while not ended.is_set():
                following.take(following.live.look())
        except TautError as error:
            following.lost = str(error)

    thread = threading.Thread(target=work, name="tracking", daemon=True)
    thread.start()
    try:
        yield following
    finally:
        ended.set()
        thread.join(timeout=5.0)
        following.close()
