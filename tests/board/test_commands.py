"""The commands that use a board, as a user calls them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from test_board_tables import model

from conftest import Bench, ClockOf
from tautline import tables
from tautline.cli import taut
from tautline.device import wire
from tautline.errors import TautError
from tautline.live.session import check_rig
from tautline.live.setup import open_live
from tautline.model import Effect, Model
from tautline.prediction import predict
from tautline.recording import load
from tautline.simulated.instrument import preset
from tautline.simulated.simlink import DesktopBoard

pytestmark = pytest.mark.minutes

EXAMPLES = Path(__file__).parents[2] / "tools" / "examples"


def run(*arguments: str, board: str | None = None, stdin: str | None = None) -> Any:
    """The JSON that a command prints."""
    environment = {"TAUTLINE_BOARD": board} if board else {}
    done = CliRunner().invoke(taut, [*arguments, "--json"], env=environment, input=stdin, standalone_mode=False)
    if done.exception is not None:
        raise done.exception
    return json.loads(done.stdout)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A model's folder."""
    model().save(tmp_path / "model")
    return tmp_path / "model"


def test_flash_reads_back_and_boards_shows_the_model(bench: Bench, folder: Path) -> None:
    flashed = run("flash", str(folder), "--board", bench.where, "--axis", "1")
    assert flashed["verified"] and flashed["axis"] == 1
    assert flashed["model_id"] == tables.model_id(Model.load(folder)).hex()
    (row,) = [row for row in run("boards", board=bench.where)["boards"] if row["board"] == bench.where]
    assert row["axes"][1]["model_id"] == flashed["model_id"] and row["axes"][0]["model_id"] is None
    assert (
        row["serial"] and row["firmware"].count(".") == 2 and row["protocol"] == f"{wire.wire.MAJOR}.{wire.wire.MINOR}"
    )
    with bench.open():
        (row,) = [row for row in run("boards", "--board", bench.where)["boards"] if row["board"] == bench.where]
        assert row["busy"]
    state = run("monitor", board=bench.where)
    assert len(state["axes"]) >= 2 and state["counters"]["telemetry_dropped"] == 0


def of_instrument(serial: str) -> Model:
    made = model()
    return replace(made, rig=replace(made.rig, actuator=replace(made.rig.actuator, instrument=serial)))


def test_a_model_of_another_instrument_is_refused_unless_forced(bench: Bench, tmp_path: Path) -> None:
    with bench.open() as board:
        own = dict(board.ask("get_settings", axis=0).values) | {"instrument": "SN-0042", "key": wire.wire.KEY}
        board.ask("settings", **own, timeout_s=5.0)
    for name, serial in (("mine", "SN-0042"), ("others", "SN-0043")):
        of_instrument(serial).save(tmp_path / name)
    mine, others = str(tmp_path / "mine"), str(tmp_path / "others")
    assert run("flash", mine, board=bench.where)["instrument"] == "SN-0042"
    with pytest.raises(TautError, match=r"made for another instrument .* or --force"):
        run("flash", others, board=bench.where)
    (row,) = [row for row in run("boards", board=bench.where)["boards"] if row["board"] == bench.where]
    assert row["axes"][0]["instrument"] == "SN-0042" and row["axes"][0]["created"].startswith("20")
    assert run("flash", others, "--force", board=bench.where)["instrument"] == "SN-0043"
    with pytest.raises(TautError, match="made for another instrument"):  # once
        run("flash", others, board=bench.where)


def test_a_live_calibration_is_of_the_instrument_that_the_board_is_for(bench: Bench) -> None:
    with bench.open() as board:
        own = dict(board.ask("get_settings", axis=0).values) | {"instrument": "SN-0042", "key": wire.wire.KEY}
        board.ask("settings", **own, timeout_s=5.0)
    rig = preset("reference").rig
    with open_live(board=bench.where, rig=rig) as live:
        assert live.rig.actuator.instrument == "SN-0042"
        check_rig(live)
    other = open_live(board=bench.where, rig=replace(rig, actuator=replace(rig.actuator, instrument="SN-0043")))
    with other as live, pytest.raises(TautError, match=r"of instrument SN-0043, but .* are for SN-0042"):
        check_rig(live)


def test_boards_that_are_not_there(folder: Path) -> None:
    with pytest.raises(TautError, match="no USB/IP server answers"):
        run("flash", str(folder), "--board", "usbip:127.0.0.1:1")
    with pytest.raises(TautError, match="expected usbip:HOST:PORT"):
        run("boards", "--board", "usbip:nonsense")
    with pytest.raises(TautError, match="no board 'NOT-HERE' was found"):
        run("boards", "--board", "NOT-HERE")


def test_follow_a_file_with_and_without_compensation(folder: Path, tmp_path: Path) -> None:
    t = np.arange(0.0, 8.0, 0.01)
    rows = np.column_stack([t, 15.0 * np.sin(2 * np.pi * t / 4.0)])
    np.savetxt(tmp_path / "path.csv", rows, delimiter=",", header="t_s,c_deg", comments="")
    arguments = ("follow", str(folder), "--simulate", "--trajectory", str(tmp_path / "path.csv"))
    off = run(*arguments, "--compensation", "off")
    full = run(*arguments, "--out", str(tmp_path / "run"))
    assert full["scored_by"] and full["error_rms_deg"] * 10.0 <= off["error_rms_deg"]
    assert full["seconds"] >= 7.5
    recording = load(tmp_path / "run")
    assert recording.marker is not None and recording.marker.valid.mean() > 0.9
    assert (tmp_path / "run" / "trajectory.csv").exists()
    with pytest.raises(TautError, match="neither a file nor a shape"):
        run("follow", str(folder), "--simulate", "--trajectory", "nowhere.csv")


def test_follow_says_what_the_tip_cannot_reach(folder: Path, tmp_path: Path) -> None:
    reach = float(np.abs(Model.load(folder).c_deg).max())
    (tmp_path / "path.csv").write_text(f"t_s,c_deg\n0,0\n4,{2 * reach:.3f}\n8,0\n")
    arguments = ["follow", str(folder), "--simulate", "--trajectory", str(tmp_path / "path.csv")]
    done = CliRunner().invoke(taut, [*arguments, "--json"], standalone_mode=False)
    assert done.exception is None
    told = json.loads(done.stdout)
    assert told["clipped"] == pytest.approx(0.5, abs=0.05) and told["reach_deg"][1] == pytest.approx(reach, abs=0.1)
    assert "beyond what the tip can reach" in done.stderr and f"{told['reach_deg'][1]:.1f} deg" in done.stderr


def test_a_busy_board_says_who_uses_it(bench: Bench) -> None:
    """Whoever watches a board that follows learns which program has it."""
    if not bench.leaves_its_bus:
        pytest.skip("nobody says on a serial line that it is in use")
    hold = (
        "import sys, time; from tautline.device.board import open_board; board = open_board(sys.argv[2]); "
        "sys.stdout.write('open\\n'); sys.stdout.flush(); time.sleep(60)"
    )
    start = f"import sys; sys.argv[0] = 'taut'; exec({hold!r})"
    with subprocess.Popen([sys.executable, "-c", start, "follow", bench.where], stdout=subprocess.PIPE) as other:
        assert other.stdout is not None and other.stdout.readline() == b"open\n"
        try:
            with pytest.raises(TautError, match=rf"'taut follow' \(process {other.pid}\) uses the board"):
                run("monitor", "--board", bench.where)
        finally:
            other.kill()
    assert run("monitor", "--board", bench.where)["axes"]


def test_record_the_motor_and_the_marker(tmp_path: Path) -> None:
    arguments = ("record", "--simulate", "constant", "--out", str(tmp_path / "rec"))
    made = run(*arguments, "--motion", "smooth", "--duration", "4", "--video", "--at", "-1.5")
    recording = load(tmp_path / "rec")
    assert recording.motor.q[0] == -1.5
    assert made["motor_samples"] >= len(recording.motor.t_s) >= 4000 and np.ptp(recording.motor.q) > 1.0
    assert recording.video is not None and recording.video.arrival_s is not None and recording.marker is not None
    assert len(recording.marker.t_s) == made["frames"] == np.isfinite(recording.video.arrival_s).sum()
    assert made["telemetry_dropped"] == made["messages_missed"] == 0
    with pytest.raises(TautError, match="holds a recording already"):
        run(*arguments)


def test_a_motion_from_a_file_against_an_instrument_with_an_effect(folder: Path, tmp_path: Path) -> None:
    """What a diagnosis asks for next, driven through the board; what the corrected model predicts is what is seen."""
    made = Model.load(folder)
    replace(made, effects=(Effect("transmission.lag", {"lag": 0.15}),)).save(tmp_path / "corrected")
    t = np.arange(0.0, 9.0, 0.01)
    rows = np.column_stack([t, 3.0 * np.sin(2 * np.pi * t / 4.0), np.sin(t)])
    np.savetxt(tmp_path / "next.csv", rows, delimiter=",", header="t_s,q_mm,translation_mm", comments="")
    arguments = ("record", "--simulate", str(tmp_path / "corrected"), "--motion", str(tmp_path / "next.csv"))
    done = run(*arguments, "--out", str(tmp_path / "more"))
    assert done["other_axes"] == ["translation_mm"]
    recording = load(tmp_path / "more")
    marker = recording.marker
    assert marker is not None and np.ptp(recording.motor.q) == pytest.approx(6.0, abs=0.05)
    seen = np.column_stack([marker.u_px, marker.v_px])
    late = marker.t_s > 6.0
    errors = {}
    for name, path in (("with", tmp_path / "corrected"), ("without", folder)):
        told = predict(Model.load(path), recording.motor, marker.t_s - made.delay_s).image_px
        assert told is not None
        errors[name] = float(np.sqrt(np.nanmean((told - seen)[late] ** 2)))
    assert errors["with"] < 0.1 < 1.0 < errors["without"]
    rows[:, 1] *= 2.0
    np.savetxt(tmp_path / "next.csv", rows, delimiter=",", header="t_s,q_mm,translation_mm", comments="")
    with pytest.raises(TautError, match="beyond the rig's range"):
        run(*arguments, "--out", str(tmp_path / "wide"))


@pytest.fixture
def paced() -> Any:
    """A board that runs by the wall clock, with a table."""
    with DesktopBoard(realtime=True, serial="PACED") as desktop:
        from tautline.device.board import open_board

        with open_board(desktop.where) as board:
            board.load_table(0, tables.encode(model()))
            board.trust_motor(0)
            board.ask("set_position", axis=0, q=0.0)
        yield desktop


def test_stream_at_250_hz(paced: DesktopBoard, wall_clock: ClockOf) -> None:
    link = paced.link()
    clock = wall_clock(link)
    sent = run("stream", "--sine", "10", "2", "--duration", "1.5", board=paced.where)
    state = run("monitor", board=paced.where)
    assert state["axes"][0]["mode"] == wire.text("MODES", wire.code("MODES", "OFF"))
    clock.need()
    assert sent["rate_hz"] >= 200.0 and sent["refused"] == 0
    assert state["counters"]["set_points"] == sent["sent"] and state["counters"]["set_points_dropped"] == 0


def test_stream_stops_with_its_sender(paced: DesktopBoard, wall_clock: ClockOf) -> None:
    """One angle on stdin, then silence: the axis comes to rest, and the end of stdin switches it off."""
    command = [sys.executable, "-m", "tautline", "stream", "--json", "--silence", "0.2"]
    environment = os.environ | {"TAUTLINE_BOARD": paced.where}
    link = paced.link()
    clock = wall_clock(link)

    def until(mode: str) -> None:
        deadline = time.monotonic() + 20.0
        while link.ask("state")["axes"][0]["mode"] != wire.code("MODES", mode):
            if time.monotonic() > deadline:
                clock.need()
                raise AssertionError(f"not {mode} in 20 s")
            time.sleep(0.02)

    with subprocess.Popen(command, env=environment, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as sender:
        assert sender.stdin is not None and sender.stdout is not None
        until("FOLLOW_TIP")
        sender.stdin.write("1.5\n")
        sender.stdin.flush()
        time.sleep(0.3)
        until("HOLD")  # with its sender silent
        sender.stdin.write("-1.5\n")
        sender.stdin.flush()
        until("FOLLOW_TIP")  # and again with a word from it
        sender.stdin.close()
        summary = json.loads(sender.stdout.read())
    state = run("monitor", board=paced.where)
    assert state["counters"]["silences"] >= 1 and "at_rest" in state["axes"][0]["flags"]
    clock.need()
    assert 20 <= summary["sent"] <= 160 and summary["silences"] == 1


def test_the_python_example_streams(paced: DesktopBoard, wall_clock: ClockOf) -> None:
    command = [sys.executable, str(EXAMPLES / "stream.py"), "--board", paced.where, "--seconds", "1"]
    link = paced.link()
    clock = wall_clock(link)
    done = subprocess.run(command, capture_output=True, text=True, timeout=30)
    assert done.returncode == 0, done.stderr
    clock.need()
    assert int(done.stdout.split()[0]) >= 200 and "0 refused" in done.stdout


def test_ctrl_c_during_a_calibration(tmp_path: Path) -> None:
    """As on a terminal, where it goes to the whole process group: the simulated board lives until its axis is at rest.
    A last line that says what to do, exit status 1, and a recording that can be used."""
    command = [sys.executable, "-m", "tautline", "calibrate", "--simulate", "--out", str(tmp_path / "model")]
    reset = (
        "import signal, sys, runpy; signal.signal(signal.SIGINT, signal.default_int_handler); sys.argv = sys.argv[1:]; "
    )
    command = [sys.executable, "-c", reset + "runpy.run_module('tautline', run_name='__main__')", "taut", *command[3:]]
    pipes: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "start_new_session": True}
    with subprocess.Popen(command, text=True, **pipes) as calibration:
        assert calibration.stderr is not None
        motor = tmp_path / "model-recording" / "motor.csv"
        size, grown = 0, time.monotonic()  # as fast as this machine simulates, but it must go on
        while size <= 350_000 and calibration.poll() is None and time.monotonic() < grown + 60.0:
            time.sleep(0.05)
            now = motor.stat().st_size if motor.exists() else 0
            size, grown = now, grown if now == size else time.monotonic()
        os.killpg(calibration.pid, signal.SIGINT)
        said = calibration.stderr.read()
    assert calibration.returncode == 1
    assert f"'taut calibrate {tmp_path / 'model-recording'} --out MODEL'" in said
    assert "the axis is at rest" in said.strip().splitlines()[-1] and "Traceback" not in said
    recording = load(tmp_path / "model-recording")
    assert recording.motor.t_s[-1] > 10.0 and recording.marker is not None
