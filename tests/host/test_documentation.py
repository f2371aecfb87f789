"""Documentation names only what is there: files, links, commands with their options, functions, words of the code."""

from __future__ import annotations

import ast
import re
import shlex
import subprocess
from functools import cache
from pathlib import Path

import click
import pytest

from tautline import cli
from tautline.explain import topics
from tautline.layouts import LAYOUTS

ROOT = Path(__file__).parents[2]
PAGES = [
    ROOT / "README.md",
    ROOT / "DESIGN.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted(ROOT.glob("*/*/README.md")),
]
EXTENSIONS = r"\.(?:py|c|h|cpp|md|toml|js|html|rules|sh|csv|json|npz|uf2|elf|png|jpg)"
MADE = {
    ".csv",
    ".json",
    ".npz",
    ".uf2",
    ".elf",
    ".html",
    ".toml",
    ".mkv",
    ".mp4",
    ".jpg",
    ".png",
}  # by users and builds


CODE = {".py", ".c", ".h", ".cpp", ".js", ".toml", ".html", ".txt", ".rules", ".json", ".ld", ""}


@cache
def tracked() -> tuple[str, ...]:
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split(
        "\n"
    )
    return tuple(name for name in listed if name)


@cache
def source() -> str:
    """All tracked text that is no page."""
    parts = []
    for name in tracked():
        path = ROOT / name
        if path.suffix in CODE and path.is_file():
            parts.append(path.read_text(encoding="utf-8", errors="replace"))
    columns = [name for layout in LAYOUTS for unit in ("mm", "deg") for name in layout.names(unit)]
    return "\n".join([*parts, *columns])


def prose(page: Path) -> tuple[str, str]:
    """A page's text outside and inside of its fenced blocks."""
    inside, outside, fenced = [], [], False
    for line in page.read_text(encoding="utf-8").split("\n"):
        if line.startswith("```"):
            fenced = not fenced
        else:
            (inside if fenced else outside).append(line)
    return "\n".join(outside), "\n".join(inside)


def spans(page: Path) -> list[str]:
    return re.findall(r"`([^`\n]+)`", prose(page)[0])


def anchors(page: Path) -> set[str]:
    titles = re.findall(r"^#+ (.*)$", prose(page)[0], re.M)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def here(name: str, page: Path) -> bool:
    """Whether a tracked file or folder has this path, from the root, the page or any folder of the code."""
    name = name.rstrip("/")
    if (page.parent / name).exists() or (ROOT / name).exists():
        return True
    return any(path == name or path.endswith("/" + name) or f"/{name}/" in f"/{path}" for path in tracked())


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_no_link_is_dead(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(page)[0]):
        if "://" in target:
            continue
        file, _, anchor = target.partition("#")
        other = page.parent / file if file else page
        assert other.exists(), f"{page.name} leads to {target}"
        assert not anchor or anchor in anchors(other), f"{page.name} leads to {target}: no such heading"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_file_that_is_named_is_there(page: Path) -> None:
    missing = []
    for span in spans(page):
        for name in re.findall(rf"(?<![\w./*{{-])((?:[\w-]+/)*[\w-]+{EXTENSIONS})(?![\w*])", span):
            made = Path(name).suffix in MADE or f'"{Path(name).name}"' in source() or "NAME" in name
            if not here(name, page) and not made:  # by users, by builds, by the code that writes it
                missing.append(name)
    assert not missing, f"{page.name} names {sorted(set(missing))}"


def commands_of(page: Path) -> list[str]:
    inside = prose(page)[1]
    lines = [line.split("#")[0].removeprefix("$ ").strip() for line in inside.replace("\\\n", " ").split("\n")]
    return [text.strip() for text in (*spans(page), *lines) if re.match(r"(\./run taut|taut|\./run) ", text.strip())]


@cache
def options(name: str) -> frozenset[str]:
    command = cli.taut.get_command(click.Context(cli.taut), name)
    assert command is not None
    return frozenset(word for each in command.params for word in (*each.opts, *each.secondary_opts)) | {"--help"}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_command_that_is_named_is_there(page: Path) -> None:
    run = (ROOT / "run").read_text()
    for text in commands_of(page):
        words = shlex.split(re.sub(r"[\[\]()|]", " ", text.split(";")[0].split("&&")[0]).replace("'", ""))
        words = words[1:] if words[:2] == ["./run", "taut"] else words
        if words[0] == "./run":
            assert re.search(rf"\b{re.escape(words[1])}\)", run), f"{page.name}: {text}"
            continue
        if words[1].startswith("-") or not words[1].islower():
            continue  # taut --help, taut COMMAND
        assert words[1] in cli.COMMANDS, f"{page.name}: {text}: no such command"
        for word in words[2:]:
            if word.startswith("--"):
                assert word.split("=")[0].rstrip(",.") in options(words[1]), f"{page.name}: {text}: no {word}"


@cache
def defined() -> dict[str, set[str]]:
    """What each module of the package, by its last name, defines: functions, classes, their methods and fields."""
    found: dict[str, set[str]] = {}
    for path in (ROOT / "host" / "tautline").rglob("*.py"):
        name = path.parent.name if path.stem == "__init__" else path.stem
        names = found.setdefault(name, set())
        names |= {module.stem for module in path.parent.glob("*.py")} if path.stem == "__init__" else set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                names.add(node.name)
            elif isinstance(node, ast.Assign):
                names |= {target.id for target in node.targets if isinstance(target, ast.Name)}
            elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                names.add(node.target.id)
            elif isinstance(node, ast.ImportFrom) and path.stem == "__init__":
                names |= {alias.asname or alias.name for alias in node.names}
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_function_that_is_named_is_where_it_is_said_to_be(page: Path) -> None:
    """`module.name`: moved ones are found out."""
    wrong = []
    for span in spans(page):
        named = re.fullmatch(r"(\w+)\.(\w+)(?:\(.*\))?", span)
        if not named or named[1] not in defined() or span in topics() or re.search(EXTENSIONS + "$", span):
            continue
        key = re.search(rf'"{named[1]}".*"{named[2]}"|"{named[2]}".*"{named[1]}"', source())  # of a JSON document
        if named[2] not in defined()[named[1]] and not key and f'"{span}"' not in source():
            wrong.append(span)
    assert not wrong, f"{page.name} names {wrong}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_word_of_code_is_in_the_code(page: Path) -> None:
    wrong = []
    for span in spans(page):
        if re.fullmatch(r"[A-Za-z][A-Za-z0-9]*(?:_[A-Za-z0-9]+)+", span) and span not in source():
            wrong.append(span)
    assert not wrong, f"{page.name} names {wrong}"


@pytest.mark.parametrize(
    ("name", "headings"),
    [("diagnosis", ("The model", "The decision", "Limits")), ("calibration", ("The model", "The decisions", "Limits"))],
)
def test_what_a_method_does_is_read_before_its_details(name: str, headings: tuple[str, ...]) -> None:
    """A page each, in sentences that are understood at once: short ones."""
    text = (ROOT / "docs" / f"{name}.md").read_text()
    first, _, _ = text.partition("\n## In detail\n")
    assert re.findall(r"^## (.*)$", first, re.MULTILINE) == list(headings)
    for part in re.split(r"^## .*$", first, flags=re.MULTILINE)[1:]:
        plain = re.sub(r"```.*?```", "", part, flags=re.DOTALL)
        assert 60 < len(plain.split()) < 350
        items = re.split(r"(?<=[.:?])\s+|\n(?:- |\d\. |\n)", re.sub(r"\n(?!- |\d\. |\n)", " ", plain))
        assert [each for each in items if len(each.split()) > 30] == []
