"""The numbers that decide: every literal of the rooms that calibrate, diagnose and track, with its kind.

A kind stands in the comment behind a number: `# prior: ...`, `# loss: ...`, `# tolerance: ...`, `# limit: ...` (of
physics), `# format: ...` (of a file or a bus) or `# equation: ...` (no other value makes sense). What has none is
unstated, and varied with the others: only a choice can be another one.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "host" / "tautline"
ROOMS = ("calibration", "diagnosis", "tracking", "effects", "core", "simulators", ".")
KINDS = ("prior", "loss", "tolerance", "limit", "format", "equation")
FIXED = frozenset({"limit", "format", "equation"})
UNSTATED = "unstated"
_KIND = re.compile(rf"#\s*({'|'.join(KINDS)}):")
_OF_ALL = re.compile(rf"^# ({'|'.join(KINDS)}) of all:", re.MULTILINE)
_PLAIN = (0.0, 0.5, 1.0, 2.0)  # of equations far more often than chosen
_GUARD = 1e-6  # what is smaller keeps a division or a comparison from failing


@dataclass(frozen=True)
class Constant:
    file: str  # below the package
    line: int
    column: int
    value: float
    kind: str

    @property
    def key(self) -> str:
        return f"{self.file}:{self.line}:{self.column}"

    @property
    def varied(self) -> bool:
        return self.kind not in FIXED


def constants(package: Path = PACKAGE) -> list[Constant]:
    """Of every module that decides, in the order of files and lines."""
    files = [path for room in ROOMS for path in sorted((package / room).glob("**/*.py" if room != "." else "*.py"))]
    return [each for path in files for each in of_source(path.read_text(encoding="utf-8"), _name(path, package))]


def of_source(source: str, file: str) -> Iterator[Constant]:
    """Floats wherever they stand, and whole numbers that a module gives a name; others are shapes and indices."""
    tree = ast.parse(source)
    kinds, of_all = _kinds(source), _OF_ALL.search(source)
    places = {id(node) for each in ast.walk(tree) if isinstance(each, ast.Subscript) for node in ast.walk(each.slice)}
    usual = of_all[1] if of_all else UNSTATED
    named = {id(node) for each in tree.body if isinstance(each, ast.Assign | ast.AnnAssign) for node in ast.walk(each)}
    for node in ast.walk(tree):
        if not isinstance(node, ast.Constant) or isinstance(node.value, bool):
            continue
        value = node.value
        chosen = isinstance(value, float) or (isinstance(value, int) and id(node) in named - places)
        if chosen and abs(value) not in _PLAIN and abs(value) > _GUARD:
            kind = next((kinds[n] for n in range(node.lineno, node.end_lineno + 1) if n in kinds), usual)
            yield Constant(file, node.lineno, node.col_offset, float(value), kind)


def _kinds(source: str) -> dict[int, str]:
    comments = (t for t in tokenize.generate_tokens(io.StringIO(source).readline) if t.type == tokenize.COMMENT)
    return {t.start[0]: found[1] for t in comments if (found := _KIND.match(t.string))}


def _name(path: Path, package: Path) -> str:
    return path.relative_to(package).as_posix()
