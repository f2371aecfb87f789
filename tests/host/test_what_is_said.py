"""What commands and scripts say to someone who does not know them: the true reason, and what to do about it."""

from __future__ import annotations

import json
import os
import pty
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import click
import numpy as np
import pytest
from cli_runner import Taut
from reference_instrument import PLANT, RIG, moved, saved_model, saved_recording

from tautline import cli
from tautline.calibration.calibrate import calibrate
from tautline.calibration.doubts import common_error
from tautline.calibration.findings import Findings
from tautline.calibration.observations import observe
from tautline.cli._commands import COMMANDS, EXIT_STATUS, GROUPS, Command
from tautline.compensation import MODES
from tautline.encoder import between_samples
from tautline.errors import TautError
from tautline.explain import topics
from tautline.live.setup import Recorder
from tautline.recording import Motor, load
from tautline.rig import Actuator, Rig
from tautline.simulated import instrument, simulate
from tautline.trajectory import back_and_forth
from tools.blindtest import command as blindtest

ROOT = Path(__file__).parents[2]
SCRIPTS = [ROOT / "run", ROOT / "tools" / "setup", ROOT / "tools" / "release"]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return saved_recording(tmp_path / "run")


@pytest.fixture
def model(tmp_path: Path) -> Path:
    return saved_model(tmp_path / "model")


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


# -- the scripts ------------------------------------------------------------------------------------------------------


def test_usage_is_the_whole_of_it() -> None:
    head = re.match(r"#!.*\n((?:# .*\n)+)", (ROOT / "run").read_text())
    assert head is not None
    done = subprocess.run([ROOT / "run", "nonsense"], capture_output=True, text=True, check=False)
    assert done.returncode == 2 and done.stdout == re.sub("^# ", "", head[1], flags=re.MULTILINE)


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_no_script_closes_a_pipe_that_is_still_written_to(script: Path) -> None:
    """Under pipefail the writer's SIGPIPE is the pipe's status."""
    text = script.read_text()
    assert "pipefail" in text and re.findall(r"\|\s*(?:grep -\w*q|head)\b.*", text) == []


def setup_says(environment: dict[str, str], err: int) -> None:
    """What the set-up says of the C sources when it has to be said, on that file."""
    text = (ROOT / "tools" / "setup").read_text()
    defined = "\n".join(re.findall(r"^(?:bold|say)\(\) .*$", text, re.MULTILINE))
    script = f'{defined}\nsay "getting the sources"'
    subprocess.run(["bash", "-c", script], env={**os.environ, **environment}, stderr=err, check=True)


def test_escapes_are_for_terminals_alone(tmp_path: Path) -> None:
    for environment, on_terminal in (({"NO_COLOR": ""}, True), ({"NO_COLOR": "1"}, True), ({"NO_COLOR": ""}, False)):
        reader, writer = pty.openpty() if on_terminal else os.pipe()
        setup_says(environment, writer)
        said = os.read(reader, 1000).decode()
        os.close(writer)
        os.close(reader)
        assert "[setup]" in said and ("\033" in said) == (on_terminal and not environment["NO_COLOR"])


# -- folders that are written to --------------------------------------------------------------------------------------


def test_a_demo_again_takes_the_place_of_the_first(taut: Taut, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "tautline-demo"
    saved_recording(out / "recording")
    saved_model(out / "model")
    before = files(out)
    identity = SimpleNamespace(serial="DESKTOP", axes=1)
    nothing = {name: lambda *_, **__: None for name in ("listen", "forget", "ask")}
    board = SimpleNamespace(identity=identity, log_divider=1, **nothing)

    @contextmanager
    def opened(**_: object) -> Iterator[Any]:
        yield SimpleNamespace(board=board, rig=RIG, axis=0)

    def record(live: Any, folder: Path, **_: object) -> None:
        with Recorder(live, folder):
            raise TautError("it records")

    monkeypatch.setattr("tautline.live.setup.open_live", opened)
    monkeypatch.setattr("tautline.live.until.calibrate_until", record)
    done = taut("demo", "--out", out)
    assert done.code == 1 and done.err.splitlines()[-1] == "taut: it records"
    assert files(out) == before  # until it is whole


def test_a_link_to_a_folder_stays_a_link(taut: Taut, folder: Path, model: Path, tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    (disk / "results").mkdir(parents=True)
    link = tmp_path / "out"
    link.symlink_to(disk / "results")
    words = ("simulate", "--motion", "sines", "--duration", 1, "--out", link)
    assert taut(*words).code == 0 and taut(*words).code == 0
    assert link.is_symlink() and (disk / "results" / "motor.csv").is_file()
    assert sorted(path.name for path in disk.iterdir()) == ["results"]


# -- the true reason --------------------------------------------------------------------------------------------------


def rig_with(path: Path, *changes: tuple[str, str]) -> Path:
    RIG.save(path)
    text = path.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)
    return path


def test_a_misspelt_key_is_asked_about(taut: Taut, folder: Path, tmp_path: Path) -> None:
    rig = rig_with(tmp_path / "rig.toml", ("encoder_resolution", "speedmax = 20.0\nencoder_resolution"))
    rig.write_text(rig.read_text() + '\n[cammera]\n[lab]\nroom = "7"\n')
    done = taut("simulate", "--rig", rig, "--motion", "sines", "--duration", 1, "--out", tmp_path / "made")
    warnings = [line for line in done.err.splitlines() if "did you mean" in line]
    assert done.code == 0 and warnings == [
        f"taut: warning: {rig}: actuator.speedmax is no key that is known: did you mean speed_max?",
        f"taut: warning: {rig}: [cammera] is no section that is known: did you mean [camera]?",
    ]
    (folder / "rig.toml").write_text(rig.read_text())
    assert any("did you mean speed_max" in said for said in load(folder).warnings)


def test_what_is_needed_and_misspelt_is_found(taut: Taut, folder: Path, tmp_path: Path) -> None:
    for old, new, says in (
        ("[actuator]", "[actuater]", "section [actuator] is missing: [actuater] is there, did you mean it?"),
        ("range", "rnage", "actuator.range is missing (rnage is there, did you mean it?)"),
    ):
        rig = rig_with(tmp_path / "rig.toml", (old, new))
        assert says in taut.refuses("calibrate", folder, "--rig", rig, "--out", tmp_path / "model")


def test_a_model_is_no_recording_and_a_recording_no_model(
    taut: Taut, folder: Path, model: Path, tmp_path: Path
) -> None:
    line = taut.refuses("calibrate", model, "--out", tmp_path / "out")
    assert f"{model}: is a model: name the recording" in line
    line = taut.refuses("predict", folder, folder, "--csv", tmp_path / "o.csv")
    assert f"{folder}: is a recording, not a model: 'taut calibrate {folder}" in line


def test_a_rig_in_another_encoding_is_told_to_be_saved_in_utf_8(taut: Taut, folder: Path, tmp_path: Path) -> None:
    rig = rig_with(tmp_path / "rig.toml")
    rig.write_bytes(b'format = "rig/1"\n# the cam\xe9ra of room 7\n' + rig.read_bytes().split(b"\n", 1)[1])
    line = taut.refuses("calibrate", folder, "--rig", rig, "--out", tmp_path / "out")
    assert f"{rig}, line 2: is not UTF-8 text" in line and "codec" not in line and "--rig" not in line


def test_the_page_on_ones_own_recordings_has_a_rig_for_an_angle_sensor() -> None:
    page = (ROOT / "docs" / "own-recordings.md").read_text()
    (block,) = re.findall(r"^```toml\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    rig = Rig.from_document(tomllib.loads(block), "the page's")
    assert rig.angle is not None and rig.camera is None and rig.actuator.unit == "deg" and rig.misspelt == []
    named = re.findall(r"^\| `([\w.]+)`[^|]*\|", page, re.MULTILINE)
    assert len(named) > 4 and [code for code in named if code not in topics()] == []
    assert "MJPEG" in page and "In mm/s" in page


# -- the command line -------------------------------------------------------------------------------------------------


def test_every_command_is_in_one_group_and_shows_how_it_is_typed(taut: Taut) -> None:
    listed = taut("--help").out
    assert all(f"\n{title}:\n" in listed for title in GROUPS)
    here = {path.stem for path in Path(cli.__file__).parent.glob("[a-z]*.py")} | {"blindtest"}  # a clone's own
    assert {name for group in GROUPS.values() for name in (each.name for each in group)} == here
    assert sum(map(len, GROUPS.values())) == len(here)


@pytest.mark.parametrize("command", COMMANDS.values(), ids=COMMANDS)
def test_the_example_of_a_command_is_one(taut: Taut, command: Command) -> None:
    first, name, *words = shlex.split(command.example)
    parser = cli.taut.get_command(click.Context(cli.taut), name)
    assert first == "taut" and name == command.name and parser is not None
    parser.make_context(name, words)
    assert command.example in " ".join(taut(name, "--help").out.split())


def test_a_misspelt_command_is_asked_about(taut: Taut) -> None:
    done = taut("calibrat", "x")
    assert done.code == 2 and "did you mean 'taut calibrate'?" in done.err
    assert "did you mean" not in taut("xyz").err


def test_every_exit_status_is_told(taut: Taut, monkeypatch: pytest.MonkeyPatch, folder: Path, tmp_path: Path) -> None:
    for page in (taut("--help").out, (ROOT / "docs" / "commands.md").read_text()):
        flat = " ".join(page.replace("|", " ").split())
        assert all(f"{status} {says}" in flat for status, says in EXIT_STATUS.items())

    def stopped(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("tautline.cli.calibrate.calibrate", stopped)
    done = taut("calibrate", folder, "--out", tmp_path / "model", "--json")
    assert done.code == 130 and json.loads(done.out) == {"error": "stopped", "status": 130}


def test_with_json_stdout_is_json_whatever_happens(taut: Taut, folder: Path, tmp_path: Path) -> None:
    done = taut("predict", folder, folder, "--csv", tmp_path / "o.csv", "--json")
    assert json.loads(done.out)["status"] == done.code == 1 and json.loads(done.out)["error"] in done.err
    done = taut("predict", "--json")
    assert json.loads(done.out)["status"] == done.code == 2 and "MODEL" in json.loads(done.out)["error"]
    wide = rig_with(tmp_path / "rig.toml", ("    -5.0,", "    -5000.0,"), ("    5.0,", "    5000.0,"))
    done = taut("calibrate", folder, "--rig", wide, "--out", tmp_path / "model", "--json")
    assert done.code == 3 and json.loads(done.out)["quality"]["verdict"] == "unusable"  # one object: the result


def test_no_color_is_kept_to(monkeypatch: pytest.MonkeyPatch, taut: Taut) -> None:
    """On a terminal; what is no terminal gets none anyway."""
    for value, coloured in (("", True), ("1", False)):
        reader, writer = pty.openpty()
        environment = {**os.environ, "NO_COLOR": value}
        subprocess.run([sys.executable, "-m", "tautline", "explain", "B"], env=environment, stdout=writer, check=True)
        said = os.read(reader, 10000).decode()
        os.close(writer)
        os.close(reader)
        assert "backlash" in said and ("\033" in said) == coloured


def test_what_is_being_done_is_said_in_words() -> None:
    recording = moved([-2.0, 1.0, -1.0, 2.0, -2.0], 2.0)
    said: list[str] = []
    calibrate([recording], RIG, progress=lambda _, text: said.append(text))
    assert len(said) > 5 and [text for text in said if not re.match(r"(\w+ing [a-z]|done$)", text)] == []


def test_a_log_that_is_too_slow_is_told_a_rate_that_is_faster() -> None:
    recording = moved([-2.0, 1.0, -1.0, 2.0, -2.0], 2.0)
    t_s = np.arange(recording.motor.t_s[0], recording.motor.t_s[-1], 0.005)
    swing = np.abs(20.0 * t_s % 4.0 - 2.0) - 1.0  # a turn within each tenth of a second
    track = observe([replace(recording, motor=Motor(t_s, swing))], RIG)[0]
    grid = np.linspace(-4.0, 4.0, 201)
    found = Findings()
    usual = float(np.median(PLANT.backlash(grid)))
    common_error([track], grid, PLANT.backlash(grid), np.full(201, 0.01), usual, "mm", found)
    (reason,) = [each for each in found.noticed if each.code == "rate"]
    rate = re.search(r"log the motor at (\d+) Hz or more", reason.remedy)
    assert "5 ms apart" in reason.says and rate is not None and int(rate[1]) > 200
    allowed = 0.015 * usual
    faster_s = np.arange(t_s[0], t_s[-1], 1.0 / int(rate[1]))
    assert between_samples(Motor(faster_s, np.abs(20.0 * faster_s % 4.0 - 2.0) - 1.0)) <= allowed


def test_completion_knows_the_commands_without_loading_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(type(cli.taut), "get_command", lambda *_: pytest.fail("a command was loaded"))
    found = cli.taut.shell_complete(click.Context(cli.taut), "comp")
    assert [each.value for each in found] == ["compensate", "compare"]
    page = (ROOT / "docs" / "commands.md").read_text()
    assert all(f"_TAUT_COMPLETE={shell}_source" in page for shell in ("bash", "zsh", "fish"))


def test_compensation_is_called_the_same_everywhere() -> None:
    for name in ("follow", "compensate"):
        parser = cli.taut.get_command(click.Context(cli.taut), name)
        assert parser is not None
        (option,) = [each for each in parser.params if "--compensation" in each.opts]
        assert isinstance(option.type, click.Choice) and list(option.type.choices) == list(MODES)
        assert option.opts == ["--compensation", "--mode"] and option.name == "compensation"


def test_a_campaign_says_how_long_it_takes(
    taut: Taut, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    count = len(blindtest._QUICK.cases())
    assert f"{count} cases" in " ".join(taut("blindtest", "--help").out.split())
    assert f"--quick    # {count} cases" in (ROOT / "docs" / "blindtest.md").read_text()
    clock = iter(range(0, 10_000, 60))
    monkeypatch.setattr("time.monotonic", lambda: next(clock))
    report = blindtest.announcing(lambda done, text: None)
    for done in range(11):
        report(done / 10, f"diagnosed {done} of 10")
    assert capsys.readouterr().err == "taut: diagnosed 2 of 10; the rest takes about 8 min\n"


def test_verdict_and_result_go_together(taut: Taut, folder: Path, tmp_path: Path) -> None:
    done = taut("calibrate", folder, "--out", tmp_path / "model")
    assert done.out.startswith("taut: calibration ") and "calibration" not in done.err
    assert "After every change of direction" in done.out


# -- what a sensor shows ----------------------------------------------------------------------------------------------


def of_an_angle(folder: Path) -> Path:
    rig = Rig(Actuator("mm", RIG.actuator.range, 0.001), RIG.coarse)
    motion = back_and_forth(rig.actuator, (4.0,), 2.5, 12, 5.0)
    simulate.run(rig, instrument.preset("reference", rig), motion, angle_noise_deg=0.02).save(folder)
    return folder


def test_a_sensor_at_the_tip_is_called_one(taut: Taut, tmp_path: Path) -> None:
    session, model = of_an_angle(tmp_path / "session"), tmp_path / "model"
    said = [taut("calibrate", session, "--out", model), taut("track", model, session, "--csv", tmp_path / "t.csv")]
    assert all(done.code == 0 for done in said)
    page = re.sub(r"<style>.*</style>|<[^>]*>", "", (model / "report.html").read_text(), flags=re.DOTALL)
    for text in (page, *(done.out + done.err for done in said)):
        assert not re.search("frame|image|marker|camera|pixel|px", text), text
    assert "readings" in said[1].err


def test_what_was_never_seen_is_not_trusted_aloud(taut: Taut, folder: Path, model: Path, tmp_path: Path) -> None:
    rows = (folder / "marker.csv").read_text().splitlines()
    assert rows[0].split(",")[:4] == ["t_s", "u_px", "v_px", "valid"]
    blind = [f"{row.split(',')[0]},,,0,0.05" for row in rows[1:]]
    (folder / "marker.csv").write_text("\n".join(["t_s,u_px,v_px,valid,sigma_px", *blind]) + "\n")
    done = taut("track", model, folder, "--csv", tmp_path / "t.csv")
    assert done.code == 0 and "seen in none of its" in done.err and "trusted" not in done.err


def test_one_recording_is_not_evidence_twice(taut: Taut, folder: Path, model: Path, tmp_path: Path) -> None:
    shutil.copytree(folder, tmp_path / "copy")
    for words in (
        ("calibrate", folder, folder, "--out", tmp_path / "out"),
        ("calibrate", folder, tmp_path / "copy", "--out", tmp_path / "out"),
        ("diagnose", folder, tmp_path / "copy", "--out", tmp_path / "out"),
    ):
        assert "is the same recording as run: name it once" in taut.refuses(*words)
    assert taut("track", model, folder, folder, "--csv", tmp_path / "t.csv").code == 0  # it was used twice


def test_only_what_a_command_has_is_advised(taut: Taut, model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("TAUTLINE_BOARD", raising=False)
    monkeypatch.setattr("tautline.device.board.find_usb", list)  # whatever is plugged in here
    monkeypatch.setattr("tautline.drivers.ros_graph.Graph", MagicMock())
    monkeypatch.setattr("tautline.ros.parameters.Parameters.of", lambda node: None)
    assert "--simulate" not in taut.refuses("ros", model)
    assert "--simulate" in taut.refuses("home", "--rig", model / "rig.toml")
