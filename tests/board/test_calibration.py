"""Live calibration on the simulated instrument: measured, stopped, and refused where scale or sign are wrong."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from conftest import Bench
from tautline.calibration.calibrate import calibrate
from tautline.device import wire
from tautline.device.board import Board
from tautline.errors import TautError
from tautline.live.session import MotionOptions, calibrate_live, record_calibration
from tautline.live.setup import Frame, Live, LockstepSource, PointSource, open_live
from tautline.recording import load
from tautline.rig import Rig
from tautline.simulated.instrument import Instrument, preset
from tautline.simulated.simlink import SimulatedAxis
from tautline.vision.marker import Sighting

pytestmark = pytest.mark.minutes

SHORT = MotionOptions(cycles=3, speeds=(0.7,))


@contextmanager
def live_on(bench: Bench, instrument: Instrument, rig: Rig | None = None, axis: int = 0) -> Iterator[Live]:
    """`rig` is what the host believes, where that is not the instrument's."""
    with bench.open() as board:
        plant = SimulatedAxis(bench.sim, instrument, axis)
        yield Live(board, rig or instrument.rig, axis, PointSource(plant), plant)


def off(board: Board, axis: int = 0) -> bool:
    return board.status(axis).mode == wire.code("MODES", "OFF")


def test_a_calibration_from_frames_finds_the_truth(tmp_path: Path) -> None:
    """The whole way: rendered frames, tracker, USB, the board's onset detector, recording, calibration."""
    with open_live(simulate="reference") as live:
        assert isinstance(live.marker_source, LockstepSource) and live.plant is not None
        found, motion = calibrate_live(live, tmp_path / "rec", MotionOptions(cycles=4, speeds=(0.7,)), video=False)
        truth = live.plant.instrument
        assert off(live.board) and live.board.counters().telemetry_dropped == 0
    used = [onset for onset in motion.onsets if onset["used"]]
    assert len(used) >= 0.8 * motion.reversals and motion.reversals >= 16
    error = np.array([onset["width"] - truth.backlash(0.5 * (onset["q1"] + onset["q2"])) for onset in used])
    print(f"board's onsets: {len(used)} of {motion.reversals}, width error {1e3 * error.mean():.2f} um mean, "
          f"{1e3 * error.std():.2f} um std")  # fmt: skip
    assert abs(error.mean()) < 0.003 and error.std() < 0.005
    q = found.model.q
    inside = (q > found.model.measured[0]) & (q < found.model.measured[1])
    rms = np.sqrt(np.mean((found.model.width - truth.backlash(q))[inside] ** 2))
    angle = np.sqrt(np.mean((found.model.c_deg - truth.bend(q))[inside] ** 2))
    print(f"calibration: B {1e3 * rms:.2f} um rms, f_remain {angle:.4f} deg rms, delay {found.model.delay_s:.4f} s")
    assert rms < 0.02 and angle < 0.1  # 16 reversals sample the bump thinly; the calibration's own tests go further
    assert found.model.delay_s == pytest.approx(0.080, abs=0.002)


def test_a_second_axis_is_calibrated_as_well(bench: Bench, tmp_path: Path) -> None:
    with live_on(bench, preset("constant"), axis=1) as live:
        motion = record_calibration(live, tmp_path / "rec", SHORT)
        assert motion.reversals >= 10 and off(live.board, 1)
    assert calibrate([load(tmp_path / "rec")], live.rig).model.width.mean() == pytest.approx(0.625, abs=0.01)


def test_stopped_by_the_user_it_rests_and_keeps_what_there_is(bench: Bench, tmp_path: Path) -> None:
    def until_half(share: float, what: str) -> None:
        if share > 0.5:
            raise KeyboardInterrupt

    with live_on(bench, preset("reference")) as live:
        with pytest.raises(TautError, match=r"the axis is at rest.*taut calibrate"):
            record_calibration(live, tmp_path / "rec", SHORT, progress=until_half)
        assert off(live.board) and live.board.status(0).fault == 0
        q = [live.board.status(0).q]
        live.wait(0.5)
        assert live.board.status(0).q == pytest.approx(q[0], abs=1.0)
        assert calibrate([load(tmp_path / "rec")], live.rig).onsets
        record_calibration(live, tmp_path / "again", SHORT)


def test_unplugged_during_the_motion_it_rests_and_keeps_what_there_is(bench: Bench, tmp_path: Path) -> None:
    def pull(share: float, what: str) -> None:
        if share > 0.3 and bench.sim.ask("state")["attached"]:
            bench.sim.ask("unplug")

    with live_on(bench, preset("reference")) as live, pytest.raises(TautError, match="the board is gone"):
        record_calibration(live, tmp_path / "rec", SHORT, progress=pull)
    assert len(load(tmp_path / "rec").motor.t_s) > 1000
    for _ in range(100):
        bench.sim.ask("advance 20000")
    state = bench.sim.ask("state")["axes"][0]
    assert state["duty_q15"] == 0
    bench.sim.ask("plug")
    with bench.open() as board:
        status = board.status(0)
        assert status.fault == wire.code("FAULTS", "HOST_LOST") and status.flags & wire.code("FLAGS", "AT_REST")
        board.ask("clear_fault", axis=0)
        board.ask("enable", axis=0, on=1)
        board.ask("enable", axis=0, on=0)


def test_a_host_that_hangs_during_the_motion(bench: Bench, tmp_path: Path) -> None:
    """No more frames: the board brings the axis to rest by itself and says why."""

    class Hanging(PointSource):
        def look(self) -> Frame:
            if hung:
                live.wait(1.5)
                live.board.check_fault(0)
            return super().look()

    hung = False

    def hang(share: float, what: str) -> None:
        nonlocal hung
        hung = share > 0.3

    with live_on(bench, preset("reference")) as live:
        assert live.plant is not None
        live.marker_source = Hanging(live.plant)
        with pytest.raises(TautError, match="host was lost"):
            record_calibration(live, tmp_path / "rec", SHORT, progress=hang)
        assert live.board.status(0).flags & wire.code("FLAGS", "AT_REST")


def wrong(rig: Rig, what: str) -> Rig:
    actuator, coarse = rig.actuator, rig.coarse
    if what == "sign":
        return replace(rig, coarse=replace(coarse, gain=-coarse.gain))
    if what == "gain":
        return replace(rig, coarse=replace(coarse, gain=coarse.gain / 10))
    if what == "resolution":  # moves 10 times too far for what it believes
        return replace(rig, actuator=replace(actuator, encoder_resolution=actuator.encoder_resolution / 10))
    return rig.with_camera(fx_px=rig.camera.fx_px / 10, fy_px=rig.camera.fy_px / 10) if rig.camera else rig


@pytest.mark.parametrize(
    ("what", "says"),
    [
        ("sign", "turn the sign of coarse.gain"),
        ("gain", "a scale is too large"),
        ("resolution", "a scale is too large"),
        ("camera", "a scale is too large"),
    ],
)
def test_wrong_scale_and_sign_are_said_before_the_motion(bench: Bench, tmp_path: Path, what: str, says: str) -> None:
    instrument = preset("reference")
    with live_on(bench, instrument, wrong(instrument.rig, what)) as live:
        with pytest.raises(TautError, match=says):
            record_calibration(live, tmp_path / "rec", SHORT)
        assert off(live.board)


def test_another_instrument_in_view_and_a_covered_camera(bench: Bench, tmp_path: Path) -> None:
    class Still(PointSource):
        def look(self) -> Frame:
            frame = super().look()
            return replace(frame, sighting=Sighting(300.0, 200.0, 0.05, 15.0))

    class Covered(PointSource):
        def look(self) -> Frame:
            return replace(
                super().look(), sighting=Sighting(np.nan, np.nan, np.nan, np.nan, "no marker of this colour")
            )

    with live_on(bench, preset("reference")) as live:
        assert live.plant is not None
        for number, (marker_source, says) in enumerate(
            ((Still, "is this camera looking at"), (Covered, "the marker is not seen"))
        ):
            live.marker_source = marker_source(live.plant)
            with pytest.raises(TautError, match=says):
                record_calibration(live, tmp_path / f"rec{number}", SHORT)
            assert off(live.board)
