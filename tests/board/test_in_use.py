"""Kept calibrated in use: the instrument changes while it follows, and the board's tables are moved after it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from wall_camera import Reader, WallCamera

from conftest import Bench, ClockOf
from tautline import tables
from tautline.cli import taut
from tautline.device import wire
from tautline.device.board import open_board
from tautline.live import setup
from tautline.live.following import Followed, follow_run
from tautline.live.in_use import TableMover, load_tables
from tautline.live.setup import Frame, Live, PointSource
from tautline.model import Model, Uncertainty
from tautline.simulated.instrument import Instrument, reference_rig
from tautline.simulated.simlink import DesktopBoard, SimulatedAxis
from tautline.vision.colour import MarkerColour
from tautline.vision.marker import Sighting

CHANGE_S = 25.0
SECONDS = 75.0
RIG = reference_rig()


class Changing(Instrument):
    """From a time of use on its cable pushes as if the motor were `offset` further, and its backlash is `scale` of what
    it was."""

    offset, scale, at_s = 0.0, 1.0, np.inf

    def centre(self, t_s: np.ndarray, q: np.ndarray) -> np.ndarray:
        if self.p != self.p:
            self.p = float(q[0])
        p = np.empty(len(q))
        for k, (t, motor) in enumerate(zip(t_s, q, strict=True)):
            late = t >= self.at_s
            q_here = motor + (self.offset if late else 0.0)
            half = 0.2 * (self.scale if late else 1.0)
            self.p = min(max(self.p, q_here - half), q_here + half)
            p[k] = self.p
        return p


def changing(offset: float = 0.0, scale: float = 1.0) -> Changing:
    made = Changing.of(RIG, lambda p: 0.4 + 0 * p, lambda p: 12.0 * p + 0.4 * np.sin(p))
    assert isinstance(made, Changing)
    made.offset, made.scale = offset, scale
    return made


def model_of(instrument: Instrument, residual_px: float = 0.05) -> Model:
    q = np.linspace(*RIG.actuator.range, 401)
    errs = Uncertainty(noise=residual_px)
    own = RIG.actuator.range
    return Model(RIG, q, 0.4 + 0 * q, 0.001 + 0 * q, instrument.bend(q), RIG.delay_s, own, uncertainty=errs)


def path(folder: Path) -> str:
    """Back and forth, a little further each time than the last."""
    t = np.linspace(0.0, SECONDS, 1501)
    c = 24.0 * np.sin(2.0 * np.pi * t / 6.0) + 8.0 * np.sin(2.0 * np.pi * t / 23.0)
    file = folder / "path.csv"
    np.savetxt(file, np.column_stack([t, c]), "%.5f", ",", header="t_s,c_deg", comments="")
    return str(file)


class Blind(PointSource):
    """From a time on it sees nothing."""

    def __init__(self, plant: SimulatedAxis, from_s: float) -> None:
        super().__init__(plant)
        self._from_s = from_s

    def look(self) -> Frame:
        frame = super().look()
        if frame.t_us * 1e-6 < self._from_s:
            return frame
        nothing = float("nan")
        return replace(frame, sighting=Sighting(nothing, nothing, nothing, nothing, "covered"))


def run(bench: Bench, folder: Path, instrument: Changing, track: bool = True, blind: bool = False) -> Followed:
    with bench.open() as board:
        plant = SimulatedAxis(bench.sim, instrument)
        instrument.at_s = plant.now_s + CHANGE_S
        marker_source = Blind(plant, instrument.at_s - 1.0) if blind else PointSource(plant)
        live = Live(board, RIG, 0, marker_source, plant)
        return follow_run(live, path(folder), model=model_of(instrument), track=track)


def rms(followed: Followed, low_s: float, high_s: float = np.inf) -> float:
    """Of the tip's error between two times since the run began."""
    t_s = followed.t_s - followed.t_s[0]
    part = (t_s >= low_s) & (t_s < high_s) & followed.counted
    return float(np.sqrt(np.mean((followed.c_deg - followed.c_ref_deg)[part] ** 2)))


@pytest.mark.minutes
@pytest.mark.parametrize(
    ("offset", "scale"),
    [
        (0.3, 1.0),
        pytest.param(-0.2, 1.0, marks=pytest.mark.long),
        (0.0, 0.6),
        pytest.param(0.15, 1.5, marks=pytest.mark.long),
    ],
)
def test_the_tip_follows_again_after_the_instrument_changed(
    bench: Bench, tmp_path: Path, offset: float, scale: float
) -> None:
    instrument = changing(offset, scale)
    followed = run(bench, tmp_path, instrument)
    before, after = rms(followed, 5.0, CHANGE_S - 4.0), rms(followed, CHANGE_S + 25.0)
    learnt = followed.tracking
    assert learnt is not None and learnt["moves"]
    assert all(move["t_s"] > instrument.at_s for move in learnt["moves"])
    assert learnt["moves"][-1]["offset"] == pytest.approx(offset, abs=0.01)
    assert learnt["moves"][-1]["scale"] == pytest.approx(scale, abs=0.03)
    assert learnt["beyond"] == ""
    assert after < 1.5 * before + 0.05
    assert rms(followed, CHANGE_S + 1.0, CHANGE_S + 4.0) > 5.0 * after  # what was in the way


@pytest.mark.minutes
def test_without_tracking_it_does_not(bench: Bench, tmp_path: Path) -> None:
    followed = run(bench, tmp_path, changing(0.3), track=False)
    assert followed.tracking is None
    assert rms(followed, CHANGE_S + 25.0) > 2.5  # 0.3 mm of 12 deg each


@pytest.mark.minutes
def test_a_lost_marker_moves_nothing(bench: Bench, tmp_path: Path) -> None:
    followed = run(bench, tmp_path, changing(0.3), blind=True)
    learnt = followed.tracking
    assert learnt is not None and learnt["lost_frames"] > 500
    assert learnt["moves"] == [] and learnt["offset"] == 0.0
    assert rms(followed, CHANGE_S + 25.0) > 2.5


def test_only_as_far_as_the_tables_allow(bench: Bench) -> None:
    with bench.open() as board:
        instrument = changing()
        model = model_of(instrument)
        limits = replace(tables.Limits.of(RIG), adapt=(0.1, 0.5, 1.2))
        board.load_table(0, tables.encode(model, limits=limits))
        mover = TableMover(Live(board, RIG, 0, None, SimulatedAxis(bench.sim, instrument)))
        mover.use(1.0, 0.05, 1.1)
        assert mover.beyond == "" and (mover.moves[-1].offset, mover.moves[-1].scale) == (0.05, 1.1)
        mover.use(2.0, -0.3, 1.5)
        assert "beyond" in mover.beyond and "calibrate" in mover.beyond
        assert mover.moves[-1].offset == pytest.approx(-0.1, abs=1e-4)
        assert mover.moves[-1].scale == pytest.approx(1.2, abs=1e-4)
        assert len(mover.moves) == 2
        mover.use(3.5, -0.3, 1.5)  # told again, but no news
        assert len(mover.moves) == 2
        board.load_table(0, tables.encode(model, limits=tables.Limits.of(RIG)))  # which may not be moved
        mover.use(5.0, 0.02, 1.0)
        assert len(mover.moves) == 2 and mover.most is None and mover.beyond


def test_tables_that_may_not_be_moved_are_left_alone(bench: Bench) -> None:
    with bench.open() as board:
        instrument = changing()
        board.load_table(0, tables.encode(model_of(instrument), limits=tables.Limits.of(RIG)))
        mover = TableMover(Live(board, RIG, 0, None, SimulatedAxis(bench.sim, instrument)))
        mover.use(1.0, 0.05, 0.9)
        assert mover.moves == [] and mover.most is None
        assert board.status(0).mode == wire.code("MODES", "OFF")


@pytest.mark.parametrize("until_s", [np.inf, 2.0], ids=["seen", "unplugged"])
def test_a_stream_is_tracked_beside_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, wall_clock: ClockOf, until_s: float
) -> None:
    instrument = changing(0.3)
    instrument.at_s = 4.0
    model_of(instrument, residual_px=0.5).save(tmp_path / "model")  # times are as good as this machine keeps them
    with DesktopBoard(realtime=True) as desktop:
        with open_board(desktop.where) as board:
            board.trust_motor(0)
            board.ask("set_position", axis=0, q=0.0)
        link, seen_by = desktop.link(), desktop.link()
        clock = wall_clock(link)
        monkeypatch.setattr(setup, "VideoCamera", lambda *_, **__: WallCamera(seen_by, instrument, until_s))
        monkeypatch.setattr(setup, "MarkerTracker", lambda _: Reader())
        monkeypatch.setattr(MarkerColour, "load", lambda _: object())
        told = ["stream", str(tmp_path / "model"), "--board", desktop.where, "--camera", "0"]
        done = CliRunner().invoke(taut, [*told, "--sine", "20", "4", "--duration", "16", "--rate", "100", "--json"])
        seen_by.close()
        clock.need()
    assert done.exit_code == 0, done.output
    sent = json.loads(done.stdout)
    assert sent["refused"] == 0 and sent["sent"] > 1000
    learnt = sent["tracking"]
    if until_s < np.inf:
        assert learnt["moves"] == [] and learnt["frames"] < 60
        assert "camera" in done.stderr
        return
    assert learnt["moves"][-1]["offset"] == pytest.approx(0.3, abs=0.05)
    assert learnt["moves"][-1]["scale"] == pytest.approx(1.0, abs=0.1)


def test_what_was_flashed_says_how_far(bench: Bench, tmp_path: Path) -> None:
    """A follow does not load what is there already: the limits are those of the flash."""
    model = model_of(changing())
    model.save(tmp_path / "model")
    told = ["flash", str(tmp_path / "model"), "--board", bench.where, "--json"]
    for how, adapt in (
        (["--adapt", "0.2", "0.5", "1.5"], [0.2, 0.5, 1.5]),
        (["--adapt", "0", "1", "1"], None),
        ([], []),
    ):
        done = CliRunner().invoke(taut, [*told, *how])
        assert done.exit_code == 0, done.output
        flashed = json.loads(done.stdout)["adapt"]
        assert flashed == (adapt if adapt is None else pytest.approx(adapt or [1.0, 0.0, 2.0], abs=1e-4))
        with bench.open() as board:
            load_tables(board, 0, model)
            there = tables.decode(board.read_table(0)).limits.adapt
            assert there == (adapt if adapt is None else pytest.approx(adapt or [1.0, 0.0, 2.0], abs=1e-4))
            load_tables(board, 0, replace(model, width=0.9 * model.width))
            assert tables.decode(board.read_table(0)).limits.adapt == pytest.approx([1.0, 0.0, 2.0], abs=1e-4)
