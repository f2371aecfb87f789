"""What commands and scripts say to someone who does not know them: the true reason, and what to do about it."""

from __future__ import annotations

import os
import pty
import re
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from cli_runner import Taut
from reference_instrument import RIG, saved_model, saved_recording

from tautline.errors import TautError
from tautline.live.setup import Recorder
from tautline.recording import load

ROOT = Path(__file__).parents[2]
SCRIPTS = [ROOT / "run", ROOT / "tools" / "setup", ROOT / "tools" / "release"]


@pytest.fixture
def taut(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Taut:
    return Taut(monkeypatch, capsys)


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
    board = SimpleNamespace(identity=identity, listen=lambda *_: None, ask=lambda *_, **__: None)

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
