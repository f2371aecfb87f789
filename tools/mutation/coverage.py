"""Which functions and lines each C test runs, by gcov: a mutant is shown first to the tests that come past it."""

from __future__ import annotations

import json
import subprocess
from dataclasses import dataclass
from pathlib import Path

from tools.mutation.sites import ROOMS, Mutant, functions_of


@dataclass(frozen=True)
class Reached:
    """Of one test: `lines` and `functions` (first to last line) that it ran, by file from the project's root."""

    lines: dict[str, set[int]]
    functions: dict[str, list[tuple[int, int]]]

    def line(self, mutant: Mutant) -> bool:
        return mutant.line in self.lines.get(mutant.file, ())

    def function(self, mutant: Mutant) -> bool:
        return any(first <= mutant.line <= last for first, last in self.functions.get(mutant.file, ()))


def asked(mutant: Mutant, covers: dict[str, Reached], took: dict[str, float]) -> list[str]:
    """The tests that run its function, those first that run its line, and of them those that end soonest."""
    able = [test for test, covered in covers.items() if covered.function(mutant)]
    return sorted(able, key=lambda test: (not covers[test].line(mutant), took[test]))


def reached(root: Path, folder: Path, digests: dict[str, str]) -> dict[str, Reached]:
    """Of each test in `digests`; kept in `folder`, and asked again of those alone whose digest is another."""
    kept = folder / "reached.json"
    rows = json.loads(kept.read_text("utf-8")) if kept.is_file() else {}
    rows = {test: row for test, row in rows.items() if digests.get(test) == row["of"]}
    if left := sorted(set(digests) - set(rows)):
        build = folder / "build"
        flags = ["-DCMAKE_C_FLAGS=-O0 -w --coverage", "-DCMAKE_BUILD_TYPE=", "-DCMAKE_C_COMPILER=gcc"]
        _run(["cmake", "-S", str(root), "-B", str(build), "-G", "Ninja", *flags])
        _run(["ninja", "-C", str(build), *left])
        rows |= {test: {"of": digests[test], **_of(root, build, test)} for test in left}
        kept.write_text(json.dumps(rows), "utf-8")
    return {
        test: Reached(
            {file: set(lines) for file, lines in row["lines"].items()},
            {file: [(first, last) for first, last in spans] for file, spans in row["functions"].items()},
        )
        for test, row in rows.items()
    }


def _run(command: list[str]) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SystemExit(f"mutation: {' '.join(command)}:\n{done.stdout}{done.stderr}")
    return done.stdout


def _of(root: Path, build: Path, test: str) -> dict[str, dict[str, list]]:
    for counts in build.rglob("*.gcda"):
        counts.unlink()
    _run([str(build / "tests" / "c" / test)])
    counted = [str(path) for path in build.rglob("*.gcda")]
    lines: dict[str, set[int]] = {}
    for text in _run(["gcov", "--json-format", "--stdout", *counted]).splitlines():
        for row in json.loads(text)["files"]:
            path = (build / row["file"]).resolve()
            file = path.relative_to(root).as_posix() if path.is_relative_to(root) else ""
            if file.startswith(ROOMS):
                lines.setdefault(file, set()).update(each["line_number"] for each in row["lines"] if each["count"])
    return {
        "lines": {file: sorted(numbers) for file, numbers in lines.items()},
        "functions": {file: _ran((root / file).read_bytes(), numbers) for file, numbers in lines.items()},
    }


def _ran(source: bytes, lines: set[int]) -> list[tuple[int, int]]:
    """By their lines: gcov does not list every static function."""
    return [(first, last) for first, last in functions_of(source) if lines & set(range(first, last + 1))]
