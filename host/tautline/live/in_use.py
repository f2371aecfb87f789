"""A tracker on a board and its camera, and what the board is told of it: the tables in use follow what was learnt."""

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

_NEWS_COUNTS, _NEWS_SCALE = 1.0, 0.002  # smaller changes are not worth a message
_BATCHES = 100  # of telemetry that are kept: the delay's and more
_AGAIN_S = 1.0  # a board that lost its host meanwhile has forgotten: it is told again


def load_tables(board: Board, axis: int, model: Model) -> None:
    """Loads the model's tables into an axis, unless it already has them; then their limits of adaptation stay too."""
    there = board.read_table(axis)
    if not there or tables.decode(there).model_id != tables.model_id(model):
        board.load_table(axis, tables.encode(model, axis=axis, limits=tables.Limits.in_use(model.rig)))


@dataclass(frozen=True)
class TablesMoved:
    """How far the board's tables were moved, from a frame that arrived at t_s on."""

    t_s: float
    offset: float  # unit of q
    scale: float  # of B


class TableMover:
    """Moves the tables of a board's axis, within what they allow themselves (their section `adapt`)."""

    def __init__(self, live: Live) -> None:
        """Reads how far the board's tables may be moved, and resets them to as they were calibrated."""
        self._live = live
        blob = live.board.read_table(live.axis)
        self.most = tables.decode(blob).limits.adapt if blob else None
        self.moves: list[TablesMoved] = []
        self.beyond = ""  # what was learnt beyond that
        self._told_s = -np.inf
        if self.most is not None:
            self._send(TablesMoved(-np.inf, 0.0, 1.0), 0.0)

    def use(self, t_s: float, offset: float, scale: float) -> None:
        """Moves the board's tables to what was learnt by a frame that arrived at t_s: offset (unit of q) and scale of
        B, clipped to what the tables allow. Small changes are not sent; the last one is repeated every _AGAIN_S."""
        if self.most is None:
            return
        farthest, least, most = self.most
        within = TablesMoved(t_s, float(np.clip(offset, -farthest, farthest)), float(np.clip(scale, least, most)))
        self.beyond = ""
        if (within.offset, within.scale) != (offset, scale):
            unit = self._live.rig.actuator.unit
            self.beyond = (
                f"offset {offset:+.4g} {unit}, scale {scale:.3g} are beyond what the board's tables allow "
                f"(+-{farthest:.4g} {unit}, {least:.3g} to {most:.3g}): calibrate and flash again"
            )
        by = abs(within.offset - self._now.offset) / self._live.resolution
        news = by > _NEWS_COUNTS or abs(within.scale - self._now.scale) > _NEWS_SCALE
        if news:
            self.moves.append(within)
        if news or (self.moves and t_s > self._told_s + _AGAIN_S):
            self._send(within if news else self._now, t_s)

    def _send(self, move: TablesMoved, t_s: float) -> None:
        """Tells the board, which blends to it over BLEND_S. A refusal ends all moving."""
        offset = move.offset / self._live.resolution
        scale = {"offset": offset, "scale": move.scale, "within_ms": round(1e3 * BLEND_S)}
        try:
            self._live.board.ask("adapt", axis=self._live.axis, **scale)
        except BoardRefused as error:  # other tables than those that were read
            self.most, self.beyond = None, str(error)
        self._now, self._told_s = move, t_s


@dataclass
class Following:
    """Gathers telemetry and frames in their order and keeps the tracker's latest row. `mover`: whose tables follow what
    is learnt; without frames that show the marker nothing is told to it."""

    live: Live
    model: Model
    told: Callable[[Row, float], None] = lambda row, t_s: None
    mover: TableMover | None = None
    library: Library | None = None  # whose shapes are looked for
    shown: Callable[[Frame, float], None] = lambda frame, q: None  # a frame that was tracked, the motor at its scene
    known: Shape | None = field(init=False, default=None)  # the shape that the shaft has now, where that is another
    tracker: LawTracker = field(init=False)
    row: Row | None = field(init=False, default=None)
    frames: int = field(init=False, default=0)
    unseen: int = field(init=False, default=0)
    lost: str = field(init=False, default="")  # why frames no longer come

    def __post_init__(self) -> None:
        """Begins to gather telemetry. TautError where there is no camera, the model is in another unit than the rig, or
        is none of the library's shapes."""
        if self.live.marker_source is None:
            raise TautError("no camera: name one with --camera, or use --simulate")
        if self.live.rig.actuator.unit != self.model.rig.actuator.unit:
            unit, own = self.model.rig.actuator.unit, self.live.rig.actuator.unit
            raise TautError(
                f"the model is in {unit}, the rig in {own}: name the rig that the model was calibrated with"
            )
        self.tracker = LawTracker(self.model, MARKER)
        self.tracker.begin()
        self._own = None if self.library is None else self.library.own(self.model)
        if self.library is not None and self._own is None:
            raise TautError(f"{self.library.folder}: the model is none of its shapes: 'taut shapes add' makes it one")
        self._delay_s = self.model.delay_of(MARKER)
        self._waiting: list[Frame] = []  # for the telemetry of their scene
        self._batches: deque[wire.Message] = deque()  # a board's reader is another thread
        self._path: deque[tuple[Array, Array]] = deque(maxlen=_BATCHES)
        self._newest_s = -np.inf
        self._squares, self._counted = 0.0, 0
        self._looked_at: tuple[float, ...] = ()
        self.live.board.listen("batch", self._batches.append)
        self.live.board.ask("telemetry", axis=self.live.axis, divider=1)

    def close(self) -> None:
        """What the board sends is no longer gathered."""
        self.live.board.forget("batch", self._batches.append)

    def _read_telemetry(self) -> None:
        """Hands the telemetry that has come to the tracker, samples not seen before."""
        while self._batches:
            batch = self._batches.popleft()
            if batch.axis != self.live.axis:
                continue
            t_s = (batch.t_us + np.arange(batch.count) * batch.period_us) * 1e-6
            q = np.asarray(batch.q[: batch.count]) * self.live.resolution
            fresh = t_s > self._newest_s
            if fresh.any():
                self._path.append((t_s[fresh], q[fresh]))
                self.tracker.motor(t_s[fresh], q[fresh])
                self._newest_s = float(t_s[-1])

    def motor_at(self, t_s: float) -> float:
        """q at a time not long ago, the rig's unit; NaN before the telemetry that is kept."""
        for times, q in reversed(self._path):
            if times[0] <= t_s:
                return float(np.interp(t_s, times, q))
        return float("nan")

    def seen(self, frame: Frame) -> None:
        """Queues a frame, and tracks those whose scene time the telemetry has reached."""
        self._read_telemetry()
        self._waiting.append(frame)
        while self._waiting and self._waiting[0].t_us * 1e-6 - self._delay_s <= self._newest_s:
            self._track(self._waiting.pop(0))

    def _track(self, frame: Frame) -> None:
        """Predicts a frame, learns from it if it shows the marker, and moves the tables by what was learnt."""
        arrival_s, sighting = frame.t_us * 1e-6, frame.sighting
        self.row = self.tracker.predict(arrival_s - self._delay_s, arrival_s)
        self.frames += 1
        if sighting.valid:
            self.tracker.see(sighting.u_px, sighting.v_px, sighting.sigma_px)
            off = ((self.row.u_px - sighting.u_px) ** 2 + (self.row.v_px - sighting.v_px) ** 2) / 2.0
            if np.isfinite(off):
                self._squares += off
                self._counted += 1
            told = self.row.state is not State.STALE or self.tracker.dialled_down
            if self.mover is not None and told:
                self.mover.use(arrival_s, self.row.offset, self.tracker.compensation)
        else:
            self.unseen += 1
        self._recognise(self.row)
        self.told(self.row, arrival_s)
        self.shown(frame, self.motor_at(arrival_s - self._delay_s))

    def _recognise(self, row: Row) -> None:
        """Sets `known` to another shape of the library, if what was learnt is nearest to that."""
        if self.library is None or self._own is None or row.state is State.STALE:
            return
        law = (row.offset, row.offset_sigma, row.scale, row.scale_sigma)
        if law == self._looked_at:
            return
        self._looked_at = law
        near = self.library.nearest(Seen(*law), self._own, float(np.mean(self.model.width)))
        self.known = near if near is not None and near.name != self._own.name else None

    @property
    def beyond(self) -> str:
        """What was learnt beyond what the tables allow, "" where nothing was."""
        return "" if self.mover is None else self.mover.beyond

    @property
    def rms_px(self) -> float | None:
        """Rms of the predictions' error per coordinate, px; None before any."""
        return float(np.sqrt(self._squares / self._counted)) if self._counted else None

    def summary(self) -> dict[str, Any]:
        """The tracking part of a command's JSON result."""
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
            document["shape"] = None if self.known is None else self.known.name
        if self.mover is not None:
            document |= {
                "moves": [asdict(move) for move in self.mover.moves],
                "moves_within": None if self.mover.most is None else list(self.mover.most),
                "beyond": self.beyond,
            }
        return document


@contextmanager
def beside(following: Following) -> Iterator[Following]:
    """A thread looks at the camera and tracks while the block sends set-points. A camera that is lost ends that, not
    the block: `lost` says so, and the tables stay as they were told last, until the host is lost too."""
    ended = threading.Event()

    def work() -> None:
        try:
            while not ended.is_set():
                following.seen(following.live.look())
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
