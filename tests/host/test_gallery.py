"""Notebooks and examples: all of them run, and what they show is what they say."""

from __future__ import annotations

import math
import re
import subprocess
import sys
import warnings
from pathlib import Path

import nbformat
import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
SCRIPTS = sorted(EXAMPLES.glob("*.py"))
NOTEBOOKS = sorted(EXAMPLES.glob("*.ipynb"))
NUMBERS = {  # in what an example prints: within these limits, low and high
    "angle_sensor": [(r"B from ([\d.]+) ", 5.2, 5.5), (r"to ([\d.]+) deg", 6.85, 6.95)],
    "open_loop": [(r"without tables: ([\d.]+)", 5.0, 12.0), (r"with tables: ([\d.]+)", 0.0, 0.05)],
    "kept_calibrated": [(r"in the end B is ([\d.]+)", 0.69, 0.71)],
    "own_data": [(r"off by ([\d.]+) px", 0.03, 0.07), (r"table: (\d+) bytes", 1000, 4000)],
    "diagnosis": [(r"transmission.lag: ([\d.]+) s", 0.055, 0.065), (r"corrected: off by ([\d.]+)", 0.03, 0.07)],
}


def holds(name: str, printed: str) -> list[str]:
    """What of NUMBERS is not so."""
    wrong = []
    for pattern, low, high in NUMBERS[name]:
        found = re.search(pattern, printed)
        if found is None or not low <= float(found[1]) <= high:
            wrong.append(f"{pattern}: {found and found[1]}, expected {low} to {high}")
    return wrong


def printed(notebook: nbformat.NotebookNode) -> str:
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    return "".join(output.get("text", "") for output in outputs)


_NUMBER = re.compile(r"(-?\d+(?:\.\d+)?)( %)?")


def parts(shown: str, fresh: str) -> list[str]:
    """Where a page and a fresh run of it part: in a word, by a tenth in a number, by five in a percentage."""
    if _NUMBER.sub("0", shown).split() != _NUMBER.sub("0", fresh).split():
        words = zip(shown.splitlines(), fresh.splitlines(), strict=False)
        return [f"{old!r}, now {new!r}" for old, new in words if _NUMBER.sub("0", old) != _NUMBER.sub("0", new)] or [
            "lines are missing"
        ]
    pairs = zip(_NUMBER.findall(shown), _NUMBER.findall(fresh), strict=True)
    return [
        f"{old}{per}, now {new}"
        for (old, per), (new, _) in pairs
        if not math.isclose(float(old), float(new), rel_tol=0.1, abs_tol=5.0 if per else 0.001)
    ]


def test_every_example_is_in_the_gallery_with_its_numbers() -> None:
    page = (EXAMPLES / "README.md").read_text()
    names = [path.stem for path in (*SCRIPTS, *NOTEBOOKS)]
    assert sorted(names) == sorted(NUMBERS) and len(NOTEBOOKS) >= 2
    assert [path.name for path in (*SCRIPTS, *NOTEBOOKS) if f"]({path.name})" not in page] == []


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_the_example_runs(script: Path, tmp_path: Path) -> None:
    command = [sys.executable, str(script), "made.png"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert holds(script.stem, done.stdout) == []
    made = (tmp_path / "made.png").read_bytes()
    assert made.startswith(b"\x89PNG") and len(made) > 10_000
    assert (EXAMPLES / "pictures" / f"{script.stem}.png").is_file()


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_notebook_runs(path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the kernel's own packages
        from tools.pictures import run_notebook

        ran = run_notebook(path)
    assert holds(path.stem, printed(ran)) == []
    assert parts(printed(nbformat.read(path, as_version=4)), printed(ran)) == []  # what a reader of the page sees


def test_a_wrong_number_is_seen() -> None:
    assert holds("open_loop", "without tables: 8.3 deg rms\nwith tables: 0.4 deg rms") != []
    assert holds("open_loop", "without tables: 8.3 deg rms") != []


def test_an_old_page_is_seen() -> None:
    page = "lag, 96 % sure: off by 0.050 px\ntaut flash out"
    assert parts(page, page.replace("96", "94").replace("0.050", "0.053")) == []
    assert parts(page, page.replace("96", "69")) == ["96 %, now 69"]
    assert parts(page, page.replace("0.050", "0.060")) == ["0.050, now 0.060"]
    assert parts(page, page.replace("flash out", "flash out --without-effects")) != []
    assert parts(page, page + "\nmore") == ["lines are missing"]
