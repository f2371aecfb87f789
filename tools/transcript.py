"""python -m tools.transcript WHEEL [--out docs/transcript.md]: README followed from the wheel alone, as it was typed.

Nothing of the repository is used: the README is the one inside the wheel, the commands are typed into one shell in an
empty folder that holds the wheel. What needs a clone or a robot is left out, and said so.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import click

from tools.readme import Block, blocks

ROOT = Path(__file__).resolve().parents[1]
_MARK = "\x1e"
_OURS = ("TAUTLINE", "VIRTUAL_ENV", "PYTHON")


@dataclass(frozen=True)
class Step:
    """A command as it was typed and what it printed."""

    typed: str
    printed: str


def readme_of(wheel: Path) -> str:
    """The README that the wheel carries."""
    with zipfile.ZipFile(wheel) as archive:
        name = next(name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        return archive.read(name).decode().split("\n\n", 1)[1]


def environment(path_first: Path | None = None) -> dict[str, str]:
    """A shell's that knows nothing of the repository or its Python; `path_first` leads its PATH."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(_OURS)}
    own = Path(os.environ.get("VIRTUAL_ENV") or "/nowhere") / "bin"
    paths = [each for each in kept["PATH"].split(os.pathsep) if Path(each) != own and not each.startswith(str(ROOT))]
    if path_first is not None:
        paths.insert(0, str(path_first))
    return kept | {"PATH": os.pathsep.join(paths), "PIP_QUIET": "1", "PIP_DISABLE_PIP_VERSION_CHECK": "1"}


def typed(chosen: Sequence[Block], folder: Path, env: dict[str, str]) -> list[Step]:
    """All commands in one shell; the first that fails ends it with its output as an error."""
    lines = ["set -e"]
    steps: list[str] = []
    for number, block in enumerate(chosen):
        commands = block.commands
        if block.where == "python":
            (folder / f"steps{number}.py").write_text(block.text)
            commands = [f"python steps{number}.py"]
        for command in commands:
            steps.append(command)
            lines += [f"printf '{_MARK}'", command]
    done = subprocess.run(
        ["bash", "-c", "\n".join(lines)], cwd=folder, env=env, text=True, stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False,
    )  # fmt: skip
    outputs = done.stdout.split(_MARK)[1:]
    if done.returncode:
        raise RuntimeError(f"{steps[len(outputs) - 1]}\nexit status {done.returncode}\n{outputs[-1]}")
    return [Step(command, output) for command, output in zip(steps, outputs, strict=True)]


def page(steps: Sequence[Step], left_out: Sequence[Block], wheel: str) -> str:
    text = [
        "# README followed from the wheel",
        "",
        f"Made by `python -m tools.transcript WHEEL` with {wheel}, in an empty folder that held nothing else: the "
        "commands of the README inside the wheel, typed into one shell in their order, and what they printed.",
        "",
        "```console",
    ]
    for step in steps:
        text += [f"$ {step.typed}", *([step.printed.rstrip()] if step.printed.strip() else [])]
    text += ["```", "", "Left out, because they need what a wheel has not:", ""]
    for block in left_out:
        needs = {"clone": "a clone of the repository", "robot": "a board, a camera and an instrument"}[block.where]
        names = [re.split(r" +#", command)[0] for command in block.commands]
        text.append(f"- {needs}: " + ", ".join(f"`{name}`" for name in names))
    return "\n".join(text) + "\n"


@click.command()
@click.argument("wheel", type=click.Path(path_type=Path, exists=True))
@click.option("--out", type=click.Path(path_type=Path), default=ROOT / "docs" / "transcript.md", show_default=True)
def main(wheel: Path, out: Path) -> None:
    """Follows the README of WHEEL and writes what was typed and printed."""
    every = blocks(readme_of(wheel))
    left_out = [block for block in every if block.where in ("clone", "robot")]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copy(wheel, folder)
        steps = typed([block for block in every if block not in left_out], folder, environment())
        shown = [Step(step.typed, step.printed.replace(str(folder), "~")) for step in steps]
        out.write_text(page(shown, left_out, wheel.name))
    click.echo(str(out))


if __name__ == "__main__":
    main()
