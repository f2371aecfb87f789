"""Set-points, and what is recorded meanwhile: no motor stays on, no listener, no picture, and errors are words."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from reference_instrument import RIG, saved_model

from tautline.device import wire
from tautline.device.stream import SetPointStream
from tautline.errors import TautError
from tautline.geometry import project
from tautline.live import following, session
from tautline.live.following import follow, follow_run, other_axes
from tautline.live.setup import Frame, Recorder
from tautline.model import Model
from tautline.vision.sighting import Sighting


class Board:
    """Notes what it is asked; refuses what it is told to."""

    def __init__(self, refuses: str = "") -> None:
        self.refuses, self.asked = refuses, []
        self.refused: list[Any] = []
        self.axes, self.log_divider, self.missed = 1, 1, 7
        self.listeners: list[Callable[..., None]] = []
        self.clock = SimpleNamespace(board_us=lambda now: 0)

    def ask(self, name: str, **values: Any) -> Any:
        self.asked.append((name, values))
        if name == self.refuses:
            raise TautError(f"refused {name}")
        return SimpleNamespace(speed_s=1e4)

    def listen(self, _: str, listener: Callable[..., None]) -> None:
        self.listeners.append(listener)

    def forget(self, _: str, listener: Callable[..., None]) -> None:
        self.listeners.remove(listener)

    @contextmanager
    def listening(self, **_: Callable[..., None]) -> Iterator[None]:
        yield

    def status(self, _: int) -> Any:
        return SimpleNamespace(c_ref=0.0, q=0.0, mode=wire.code("MODES", "OFF"))

    def counters(self, clear: bool = False) -> Any:
        return SimpleNamespace(values={}, telemetry_dropped=0)

    def read_table(self, _: int) -> bytes:
        return b""

    def nothing(self, *_: Any) -> Any:
        return None

    align = check_axis = check_fault = check_reference = switch_on = tell = nothing

    def bus(self) -> dict[str, Any]:
        return {}


def live_of(board: Board, plant: Any = None) -> Any:
    return SimpleNamespace(
        board=board, rig=RIG, axis=0, resolution=RIG.actuator.encoder_resolution, plant=plant, marker_source=object(),
        top_speed=16.0, now_us=lambda: 0, feeding=False, interruptible=contextmanager(lambda: iter([None])),
    )  # fmt: skip


def test_a_stream_that_cannot_begin_leaves_no_motor_on() -> None:
    board = Board(refuses="follow")
    with pytest.raises(TautError, match="refused follow"), SetPointStream(cast(Any, board), 0):
        pass
    assert board.asked[-1] == ("enable", {"axis": 0, "on": 0})


@pytest.mark.parametrize("c_deg", [1e6, -1e6, float("nan")])
def test_a_set_point_that_no_board_can_be_told_is_an_error_in_words(c_deg: float) -> None:
    with pytest.raises(TautError, match="check its unit"):
        SetPointStream(cast(Any, Board()), 0).send(c_deg)
    board = Board()
    with pytest.raises(TautError, match="check its unit"):
        follow(live_of(board), np.array([0.0, 1.0]), np.array([0.0, c_deg]), tip=True)
    assert not board.asked  # nothing was switched on


def test_set_points_are_on_the_grid_of_their_message() -> None:
    assert wire.set_point_values([1.0, -0.5], wire.DEG).tolist() == [65536.0, -32768.0]
    assert wire.set_point_values(3.0, wire.COUNT) == 768.0 and not len(wire.set_point_values([], wire.COUNT))


def test_a_recording_that_ends_while_telemetry_is_written_ends_after_it(tmp_path: Path) -> None:
    recorder = Recorder(live_of(Board()), tmp_path / "run")
    inside, closed = threading.Event(), threading.Event()
    failed: list[BaseException] = []

    class Slow(list[float]):
        def __getitem__(self, at: Any) -> Any:
            if at == 1:
                inside.set()
                closed.wait(0.2)
            return super().__getitem__(at)

    def write() -> None:
        batch = SimpleNamespace(axis=0, count=4, t_us=0, period_us=1000, q=Slow([0.0] * 4), q_ref=[0.0] * 4)
        try:
            recorder._write_telemetry(cast(Any, batch))
        except ValueError as error:
            failed.append(error)

    writer = threading.Thread(target=write)
    writer.start()
    inside.wait()
    recorder.__exit__()
    closed.set()
    writer.join()
    assert not failed
    assert len((tmp_path / "run" / "motor.csv").read_text().splitlines()) == 1 + 4


def seen_of(c_deg: float, t_us: int) -> Frame:
    u, v = project(RIG, np.array([c_deg]))[0]
    return Frame(t_us, Sighting(float(u), float(v), 0.05, 16.0), np.zeros((4, 4, 3), np.uint8))


def test_a_run_keeps_no_pictures_and_is_scored_by_its_own_frames_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[list[Frame]] = []
    scored = following._compared_with_plan

    def compared(live: Any, begin_s: float, t_s: np.ndarray, plan: np.ndarray, frames: list[Frame]) -> Any:
        given.append(frames)
        return scored(live, begin_s, t_s, plan, frames)

    def followed(live: Any, t_s: np.ndarray, value: np.ndarray, **options: Any) -> Any:
        for k in range(5):
            options["seen"](seen_of(10.0, at_us + 40_000 * k))
        return 1.0, np.array([0.0, 2.0]), np.array([value[0], value[0]])

    monkeypatch.setattr(following, "_compared_with_plan", compared)
    monkeypatch.setattr(following, "follow", followed)
    (tmp_path / "c.csv").write_text("t_s,c_deg\n0,10\n1,10\n")
    at_us = 1_500_000
    run = follow_run(live_of(Board()), str(tmp_path / "c.csv"), compensation="off")
    assert len(given[0]) == 5 and all(frame.picture is None for frame in given[0])
    assert run.scored_by == "the camera" and run.rms_deg < 1e-3
    at_us = 0  # all of them before it begins
    run = follow_run(live_of(Board()), str(tmp_path / "c.csv"), compensation="off")
    assert run.scored_by == "" and len(run.t_s) == 2 and np.isnan(run.rms_deg)


def test_a_run_that_cannot_be_recorded_ends_all_listening(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    saved_model(tmp_path / "model")
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "motor.csv").write_text("")
    (tmp_path / "c.csv").write_text("t_s,c_deg\n0,10\n1,10\n")
    monkeypatch.setattr(following, "load_tables", lambda *_: None)
    board = Board()
    with pytest.raises(TautError, match="holds a recording already"):
        follow_run(
            live_of(board), str(tmp_path / "c.csv"), compensation="off", model=Model.load(tmp_path / "model"),
            folder=tmp_path / "run", track=True,
        )  # fmt: skip
    assert not board.listeners


def test_what_was_missed_before_a_recording_is_not_of_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    live = live_of(Board())
    monkeypatch.setattr(session, "driving", lambda live: contextmanager(lambda: iter([None]))())
    monkeypatch.setattr(session, "set_range", lambda *_: None)
    with session.moving(live, tmp_path / "a", -5.0, 5.0, False) as motions:
        live.board.missed += 2
    assert motions.made.telemetry_missed == 2
    assert following.record(live, tmp_path / "b", duration_s=0.0)["messages_missed"] == 0


@pytest.mark.parametrize("header", ["t_s,q_mm,rotation_deg", "t_s, q_mm, rotation_deg", '\nt_s,q_mm,"rotation_deg"'])
def test_axes_that_are_not_moved_are_named_however_the_header_is_written(header: str, tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_text(f"{header}\n0,0,1\n0.001,0,1\n")
    assert other_axes(str(tmp_path / "m.csv")) == ["rotation_deg"]
    assert other_axes("none") == other_axes("smooth") == []
