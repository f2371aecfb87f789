"""By the wall clock: a camera with a clock of its own, a thread that reads, two clocks that are aligned."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from wall_camera import Reader, WallCamera

from conftest import ClockOf
from tautline.calibration.calibrate import calibrate
from tautline.device.board import open_board
from tautline.live.following import follow_run
from tautline.live.session import MotionOptions, record_calibration
from tautline.live.setup import CameraSource, Live
from tautline.recording import load
from tautline.simulated.instrument import preset
from tautline.simulated.simlink import DesktopBoard


def test_the_clock_of_a_paced_board(wall_clock: ClockOf) -> None:
    with DesktopBoard(realtime=True) as desktop, open_board(desktop.where) as board, board.reading():
        link = desktop.link()
        clock = wall_clock(link)
        board.align(32)
        error = board.clock.offset(time.monotonic())[1]
        time.sleep(0.3)
        before = time.monotonic()
        stamp = board.sync()
        after = time.monotonic()
        clock.need()
        assert error < 0.005
        # The bound holds: the stamp was taken between the two. The board paces itself in steps of a millisecond.
        offset, error = board.clock.offset(after)
        assert before + offset - error - 0.002 <= stamp * 1e-6 <= after + offset + error + 0.002


def test_answers_come_at_once_while_a_thread_reads(wall_clock: ClockOf) -> None:
    """The reading thread never keeps an answer from the one who asked."""
    with DesktopBoard(realtime=True) as desktop, open_board(desktop.where) as board:
        link = desktop.link()
        clock = wall_clock(link)
        board.ask("telemetry", axis=0, divider=1)
        with board.reading():
            took = []
            for _ in range(200):
                began = time.monotonic()
                board.sync()
                took.append(time.monotonic() - began)
        clock.need()
    assert np.median(took) < 0.02 and np.mean(took) < 0.03


@pytest.mark.long
def test_a_calibration_by_the_wall_clock(tmp_path: Path, wall_clock: ClockOf) -> None:
    instrument = preset("constant")
    with DesktopBoard(realtime=True) as desktop, open_board(desktop.where) as board, board.reading():
        board.align(32)
        board.ask("set_position", axis=0, q=0.0)
        link = desktop.link()
        clock = wall_clock(link)
        time.sleep(1.0)
        clock.need()
        live = Live(board, instrument.rig, 0, CameraSource(board, WallCamera(link, instrument), Reader()))  # type: ignore[arg-type]
        made = record_calibration(live, tmp_path / "rec", MotionOptions(cycles=2, speeds=(1.0,), low=-2.0, high=2.0))
        found = calibrate([load(tmp_path / "rec")], instrument.rig)
        t = np.arange(0.0, 8.0, 0.01)
        np.savetxt(
            tmp_path / "path.csv",
            np.column_stack([t, 8.0 * np.sin(t * np.pi / 2)]),
            "%.5f",
            ",",
            header="t_s,c_deg",
            comments="",
        )
        runs = [
            follow_run(live, str(tmp_path / "path.csv"), compensation=how, model=found.model) for how in ("off", "full")
        ]
        clock.need()
    off, full = runs
    assert off.scored_by == full.scored_by == "the camera"
    assert full.rms_deg * 10.0 < off.rms_deg
    assert made.reversals >= 8 and made.telemetry_missed == 0
    used = [onset["width"] for onset in made.onsets if onset["used"]]
    assert len(used) >= 6 and np.mean(used) == pytest.approx(0.625, abs=0.02)
    inside = (found.model.q > -1.5) & (found.model.q < 1.5)
    assert found.model.width[inside].mean() == pytest.approx(0.625, abs=0.02)
