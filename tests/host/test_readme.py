"""README.md: its commands are run as they are written, from a clone and from a wheel alone; what cannot be is parsed.

Run here: from a wheel all that needs no robot, over the packages that are installed already; with `./run test long`
also `./run demo` in this clone, and the installation itself in an environment that holds nothing else. Only checked to
exist: what needs a board or a camera (words and options are parsed as `taut` does), `./run test` (this is inside it),
and commands inside sentences and tables.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import shlex
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from pathlib import Path

import click
import pytest

from tautline.cli import COMMANDS, taut
from tools.readme import Block, blocks, unfenced
from tools.transcript import environment, readme_of, typed

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
BLOCKS = blocks(README)


def of(*where: str) -> list[Block]:
    return [block for block in BLOCKS if block.where in where]


def pages() -> list[Path]:
    """All that a person reads in the repository."""
    listed = subprocess.run(["git", "ls-files", "*.md"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return [ROOT / name for name in listed.split()]


def parsed(line: str, whole: bool = True) -> str:
    """What is wrong with a command line, by the parsers of what it calls; empty where nothing is. `whole`: all that the
    command needs is in it; else its name and its options' alone."""
    words = shlex.split(line, comments=True)
    if words[:1] == ["taut"]:
        if len(words) == 1 or words[1] in ("--version", "--help"):
            return ""
        command = taut.get_command(click.Context(taut), words[1]) if words[1] in COMMANDS else None
        if command is None:
            return f"{line}: no such command"
        try:
            if whole:
                command.make_context(words[1], words[2:])
        except click.ClickException as error:
            return f"{line}: {error.format_message()}"
        options = {name for option in command.params for name in (*option.opts, *option.secondary_opts)}
        unknown = [word for word in words[2:] if word.startswith("--") and word.split("=")[0] not in options]
        return f"{line}: {unknown}" if unknown else ""
    if words[:1] == ["./run"]:
        script = (ROOT / "run").read_text()
        named = words[1].rstrip(".")
        if named and not re.search(rf"^    {named}\)", script, re.MULTILINE):
            return f"{line}: ./run knows no {named}"
        if named == "test" and "-k" in words:
            wanted = words[words.index("-k") + 1]
            folder = ROOT / "tests" / words[2]
            files = (folder if folder.is_dir() else folder.parent).rglob("test_*.py")
            if not any(wanted in path.stem or re.search(rf"def test_\w*{wanted}", path.read_text()) for path in files):
                return f"{line}: no test is called {wanted}"
        if named == "paper" and words[2:] and words[2] not in (ROOT / "tools" / "paper" / "experiments.py").read_text():
            return f"{line}: no experiment is called {words[2]}"
        return ""
    if words[:2] == ["python", "-m"]:
        module = ROOT / words[2].replace(".", "/")
        return "" if module.is_dir() or module.with_suffix(".py").is_file() else f"{line}: no such module"
    missing = [word for word in words if word.startswith(("tools/", "build/")) and not (ROOT / word).exists()]
    return f"{line}: {missing}" if missing else ""


def test_the_page_has_its_parts() -> None:
    assert [block.where for block in BLOCKS] == ["clone", "install", "anywhere", "python", "robot"]
    assert of("clone")[0].commands[1].startswith("./run test ")
    assert README.index("docs/pictures/report.png") < README.index("## ")  # before all headings
    rows = [line for line in README.splitlines() if line.startswith("| ") and line.endswith(" |")]
    assert len(rows) == 1 + 1 + 6  # header, rule, results


def test_what_is_not_run_is_there() -> None:
    lines = [command for block in of("clone", "robot") for command in block.commands]
    assert len(lines) > 10
    assert [wrong for line in lines if (wrong := parsed(line))] == []


def test_commands_inside_sentences_are_there() -> None:
    lines = [
        (page.name, line)
        for page in pages()
        for line in unfenced(page.read_text())
        if re.match(r"(\./run|taut|python -m|sudo) ", line)
    ]
    assert len(lines) > 50
    assert [(name, wrong) for name, line in lines if (wrong := parsed(line, whole=False))] == []


def test_a_command_that_is_not_there_is_seen() -> None:
    assert parsed("taut calibrat monday") != ""
    assert parsed("taut flash monday --axel 1") != ""
    assert parsed("taut calibrate --camera 0 --at-most never --out monday") != ""
    assert parsed("./run demon") != ""
    assert parsed("./run test board -k three_millimetres -s") != ""
    assert parsed("./run paper fig6") != ""
    assert parsed("python -m tools.realy") != ""
    assert parsed("sudo cp tools/71-tautline.rules /etc") != ""


def test_no_link_is_dead() -> None:
    dead = []
    for page in pages():
        for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text()):
            if not target.startswith(("http:", "https:", "mailto:")) and not (page.parent / target).exists():
                dead.append(f"{page.relative_to(ROOT)}: {target}")
    assert len(pages()) > 10 and dead == []


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel of this clone, made once for all workers: what the editable installation compiled is used again."""
    folder = tmp_path_factory.getbasetemp()
    folder = (folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder) / "wheel"
    folder.mkdir(exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        return next(folder.glob("*.whl"), None) or _made(folder)


def _made(folder: Path) -> Path:
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", str(folder)]
    subprocess.run([*command, str(ROOT)], check=True, env=environment() | _paths())
    return next(folder.glob("*.whl"))


def _paths() -> dict[str, str]:
    """Where the build finds ninja and TinyUSB."""
    own = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return {"PATH": own, **{name: value for name, value in os.environ.items() if name.startswith("TAUTLINE")}}


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bin folder of an environment that holds the wheel, beside the packages that this Python has."""
    folder = tmp_path_factory.mktemp("installed") / "env"
    venv.create(folder, symlinks=True)
    packages = Path(sysconfig.get_path("purelib", vars={"base": str(folder)}))
    python = folder / "bin" / "python"
    command = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet", "--no-deps", str(wheel)]
    subprocess.run(command, check=True)
    (packages / "others.pth").write_text(sysconfig.get_path("purelib") + "\n")  # appended: ours comes first
    where = [str(python), "-c", "import tautline; print(tautline.__file__, tautline.__version__)"]
    said = subprocess.run(where, check=True, capture_output=True, text=True, cwd=folder, env=environment()).stdout
    assert said.startswith(str(packages))
    return python.parent


def test_the_wheel_is_whole(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        assert "tautline/py.typed" in names and "tautline/reports/templates/model.html" in names
        assert "tautline/bin/tautline-board" in names, "TinyUSB's sources were not there: run 'tools/setup sources'"
        board = archive.getinfo("tautline/bin/tautline-board")
        assert board.external_attr >> 16 & 0o111  # a program
        metadata = next(archive.read(name).decode() for name in names if name.endswith("/METADATA"))
    name = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["name"]
    assert re.search(rf"^Name: {name}$", metadata, re.MULTILINE)
    assert readme_of(wheel).strip() == README.strip()
    assert not any(name.startswith(("tests/", "tools/")) for name in names)


def test_readme_from_the_wheel(installed: Path, tmp_path: Path) -> None:
    """Every command that needs no robot, as written, in one shell, in an empty folder."""
    steps = typed(of("anywhere", "python"), tmp_path, environment(installed))
    printed = {step.typed.split(" #")[0].strip(): step.printed for step in steps}
    assert len(steps) == len(of("anywhere")[0].commands) + 1
    assert re.search(r"off by [\d.]+ deg rms without, 0\.0\d+ with the tables", printed["taut demo"])
    assert "good 0.8" in steps[-1].printed  # the Python block
    for made in ("tautline-demo/model/report.html", "monday/report.html", "friday/report.html", "model/report.html"):
        assert (tmp_path / made).stat().st_size > 50_000
    assert (tmp_path / "q.csv").read_text().startswith("t_s,q_mm,clipped\n")


def test_the_first_command_is_a_command_of_this_clone() -> None:
    """What it comes to is seen of the wheel, and in long runs here."""
    words = shlex.split(of("clone")[0].commands[0], comments=True)
    done = subprocess.run([*words, "--help"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "Usage: taut demo" in done.stdout, done.stderr


@pytest.mark.long
def test_the_first_command_in_this_clone(tmp_path: Path) -> None:
    command = of("clone")[0].commands[0]
    assert command.startswith("./run demo ")
    run = f"cd {ROOT} && {command.split(' #')[0].strip()} --out {tmp_path / 'demo'}"
    done = subprocess.run(["bash", "-c", run], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.rstrip().endswith("report.html") and (tmp_path / "demo/model/report.html").is_file()
    onsets = json.loads((tmp_path / "demo/model/model.json").read_text())["extra"]["onsets"]
    assert onsets and {onset["recording"] for onset in onsets} == {"recording"}  # as its folder is called


@pytest.mark.long
def test_readme_from_the_wheel_alone(wheel: Path, tmp_path: Path) -> None:
    """The installation as well, in an environment that has nothing else: what someone without the repository types."""
    (tmp_path / wheel.name).write_bytes(wheel.read_bytes())
    steps = typed(of("install", "anywhere", "python"), tmp_path, environment())
    assert len(steps) > 12 and "good 0.8" in steps[-1].printed


def test_without_the_board_it_says_where_it_would_be(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from tautline.errors import TautError
    from tautline.simulated import simlink

    packaged = tmp_path / "tautline" / "bin" / "tautline-board"
    monkeypatch.delenv(simlink.PROGRAM, raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(simlink, "_PACKAGED", packaged)
    monkeypatch.setattr(simlink, "_BUILT", tmp_path / "a/b/c/d/e/f/tautline-board")
    with pytest.raises(TautError, match="install a release's wheel") as refused:
        simlink.program()
    assert str(packaged) in str(refused.value)
    packaged.parent.mkdir(parents=True)
    packaged.touch()
    assert simlink.program() == packaged
