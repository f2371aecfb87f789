"""One page of why this board may be trusted with a motor: build/dossier/index.html.

    ./run dossier [--results build/results] [--out build/dossier]

Its first table is docs/safety.md's, each hazard with the last result of its tests: those that './run test' left in
build/results. Behind it what else was tried: fuzzing, wrong programs, proofs, long lives, the image's budgets; and what
it is made of, with licences. Ends with 1 where a hazard has no test, or one that failed or was not run.
"""

from __future__ import annotations

import argparse
import html
import json
import re
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement

from tools.kept import RESULTS
from tools.sbom import DISTRIBUTION, c_components

ROOT = Path(__file__).resolve().parents[1]
SAFETY = ROOT / "docs" / "safety.md"
HEADS = ["hazard", "promise", "limit", "test", "guards"]
COMPILED = "tests/c/duplicate_code.c::"  # a file that must not compile: ctest's name of it
COMPILED_AS = "codes_given_twice_do_not_compile"
STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 70rem; padding: 0 1rem }
:root { color-scheme: light dark }
table { border-collapse: collapse; width: 100%; margin: 1rem 0 }
th, td { text-align: left; vertical-align: top; padding: .3rem .6rem; border-bottom: 1px solid #8886 }
small, pre { opacity: .75 }
pre, .table { overflow-x: auto }
@media (min-width: 60rem) { td:first-child { min-width: 9rem } td:has(> small) { min-width: 24rem } }
.passed { color: #2a8f45 }
.failed, .missing { color: #d2363e; font-weight: 600 }
"""


@dataclass(frozen=True)
class Row:
    hazard: str
    promise: str
    tests: tuple[str, ...]


@dataclass(frozen=True)
class Outcome:
    """Of one test in one suite; a test with parameters passed where all of its cases did."""

    suite: str
    passed: bool
    cases: int = 1


Results = dict[str, dict[str, Outcome]]  # by test, by suite


def rows(page: str) -> list[Row]:
    """The table of docs/safety.md. SystemExit where it has none, or a hazard without a test."""
    lines = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in page.splitlines() if line.startswith("|")
    ]
    if not lines or lines[0] != HEADS:
        raise SystemExit(f"dossier: docs/safety.md has no table of {', '.join(HEADS)}")
    found = [Row(line[0], line[1], tuple(each for each in line[3].split(", ") if each)) for line in lines[2:]]
    if lacking := [row.hazard for row in found if not row.tests]:
        raise SystemExit(f"dossier: no test for: {'; '.join(lacking)}")
    return found


# -- results -----------------------------------------------------------------------------------------------------


def results(folder: Path) -> Results:
    """What every file of a suite says: pytest's and ctest's JUnit, and node's TAP."""
    found: Results = {}
    for file in sorted((*folder.glob("*.xml"), *folder.glob("*.tap"))):
        for test, passed in _tap(file) if file.suffix == ".tap" else _junit(file):
            before = found.setdefault(test, {}).get(file.stem, Outcome(file.stem, True, 0))
            found[test][file.stem] = Outcome(file.stem, before.passed and passed, before.cases + 1)
    return found


def _junit(file: Path) -> Iterator[tuple[str, bool]]:
    for test, _, passed in cases(file):
        yield test, passed


def cases(file: Path) -> Iterator[tuple[str, str, bool]]:
    """Of one file of JUnit: test, parameters, whether it passed."""
    for case in ElementTree.parse(file).getroot().iter("testcase"):
        passed = case.find("failure") is None and case.find("error") is None
        name, place = case.get("name", ""), case.get("classname", "")
        if case.find("skipped") is not None:
            continue
        if place.startswith("tests."):
            yield f"{place.replace('.', '/')}.py::{name.partition('[')[0]}", name.partition("[")[2].rstrip("]"), passed
        elif name == COMPILED_AS:
            yield COMPILED, "", passed
        else:  # one of ctest's programs: Unity says what each of its tests did
            for test, said in re.findall(r":\d+:(\w+):(PASS|FAIL)", case.findtext("system-out") or ""):
                yield f"tests/c/{name}.c::{test}", "", said == "PASS"


def _tap(file: Path) -> Iterator[tuple[str, bool]]:
    for bad, name in re.findall(r"^\s*(not )?ok \d+ - (.+?)(?: # .*)?$", file.read_text("utf-8"), re.MULTILINE):
        yield name.replace("\\#", "#"), not bad


def of_test(test: str, found: Results) -> list[Outcome]:
    """A test of the emulator is named by how its name begins."""
    if not test.startswith("tools/emulator/"):
        return list(found.get(test, {}).values())
    begins = test.partition("::")[2]
    return [outcome for name, by in found.items() if name.startswith(begins) for outcome in by.values()]


# -- in sum -------------------------------------------------------------------------------------------------------


def _kept(folder: Path, name: str) -> list[dict[str, str]]:
    """What a long command left, its rows by their heads; none where it was not run."""
    file = folder / f"{name}.json"
    said = json.loads(file.read_text("utf-8")) if file.is_file() else {"heads": [], "rows": []}
    return [dict(zip(said["heads"], row, strict=True)) for row in said["rows"]]


def _tried(folder: Path, what: str, parameter: str) -> str:
    """Cases of the suites in which something is done, by a test's name or its parameter."""
    found = [
        passed
        for file in sorted(folder.glob("*.xml"))
        for test, parameters, passed in cases(file)
        if re.search(what, test.partition("::")[2]) or parameter in parameters.split("-")
    ]
    lost = found.count(False)
    return f"{len(found)} cases in the suites, {lost or 'none'} failed" if found else "no suite was run"


def _in_lives(soak: list[dict[str, str]], *kinds: str) -> str:
    counts = [(kind, int(n)) for row in soak for kind, n in re.findall(r"(\w+) (\d+)", row.get("of which", ""))]
    return f"{sum(n for kind, n in counts if kind in kinds)} in lives" if soak else "no life was lived"


def _count(n: int, of: str) -> str:
    return f"{n} {of}{'' if n == 1 else 's'}"


def _fuzzed(fuzz: list[dict[str, str]]) -> tuple[str, str]:
    """Executions, and edges."""
    if not fuzz:
        return "not run", "not run"
    runs = [int(row["executions"]) for row in fuzz]
    edges = [(int(row["edges reached"]), int(row["of"])) for row in fuzz if row["of"].isdigit()]
    broken = [row["target"] for row in fuzz if row["broken"]]
    return (
        f"{sum(runs)} of {_count(len(runs), 'target')}, {min(runs)} at least; broken: {', '.join(broken) or 'none'}",
        f"{sum(reached for reached, _ in edges)} of {sum(of for _, of in edges)}" if edges else "of C none was run",
    )


def summed(folder: Path) -> list[tuple[str, str]]:
    """Executions, coverage, cuts, unplugs, proofs, hours: what of it was run, and what it lost."""
    soak, proofs = _kept(folder, "soak"), _kept(folder, "proofs")
    executions, edges = _fuzzed(_kept(folder, "fuzz"))
    proven = sum(row["result"] == "proven" for row in proofs)
    lost = [row["failures"] for row in soak if row.get("failures", "none") != "none"]
    hours = [f"{row['board']} {row['hours']} h with {row.get('mishaps', 'no')} mishaps" for row in soak]
    return [
        ("executions", executions),
        ("edges reached", edges),
        ("cuts of power", f"{_tried(folder, 'power_cut|cut_short', 'power')}; {_in_lives(soak, 'power', 'cut')}"),
        ("pulled plugs", f"{_tried(folder, 'unplugged', 'cable')}; {_in_lives(soak, 'cable')}"),
        ("proofs", f"{proven} of {len(proofs)} without an alarm, the others' explained" if proofs else "not run"),
        ("hours", f"{', '.join(hours)}; lost: {'; '.join(lost) or 'nothing'}" if soak else "not run"),
    ]


# -- the page ----------------------------------------------------------------------------------------------------


def _table(heads: tuple[str, ...], body: list[list[str]]) -> str:
    head = "".join(f"<th>{html.escape(each)}</th>" for each in heads)
    return (
        f'<div class="table"><table><tr>{head}</tr>'
        + "".join(f"<tr>{''.join(f'<td>{c}</td>' for c in row)}</tr>" for row in body)
        + "</table></div>"
    )


def _text(markdown: str) -> str:
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", html.escape(markdown))


def _suites(folder: Path, found: Results) -> str:
    """Which were run, when, and how many tests they had."""
    said = []
    for file in sorted((*folder.glob("*.xml"), *folder.glob("*.tap"))):
        count = sum(file.stem in by for by in found.values())
        said.append(f"{file.stem} ({count} tests, {datetime.fromtimestamp(file.stat().st_mtime, UTC):%Y-%m-%d %H:%M})")
    return ", ".join(said) or "none was run"


def _said(outcomes: list[Outcome]) -> str:
    if not outcomes:
        return '<span class="missing">not run</span>'
    verdicts = [(each.suite, "passed" if each.passed else "failed") for each in outcomes]
    return ", ".join(f'<span class="{verdict}">{suite}: {verdict}</span>' for suite, verdict in verdicts)


def hazards(table: list[Row], found: Results) -> tuple[str, list[str]]:
    """The table, and what is wrong in it."""
    body, wrong = [], []
    for row in table:
        said = []
        for test in row.tests:
            outcomes = of_test(test, found)
            name = test.partition("::")[2].removeprefix("test_").replace("_", " ") or test.removesuffix("::")
            said.append(f"<small>{html.escape(name)}</small><br>{_said(outcomes)}")
            if not outcomes or not all(each.passed for each in outcomes):
                wrong.append(f"{row.hazard}: {test}: {'failed' if outcomes else 'not run'}")
        body.append([_text(row.hazard), _text(row.promise), "<br>".join(said)])
    return _table(("hazard", "promise", "test and its last result"), body), wrong


def components() -> list[list[str]]:
    """What the package needs at run time, and the C beside it: name, version, licence."""
    found: dict[str, list[str]] = {}
    names = [DISTRIBUTION]
    while names:
        name = names.pop()
        if name.lower() in found:
            continue
        try:
            known = metadata.metadata(name)
        except metadata.PackageNotFoundError:
            continue  # for another platform
        found[name.lower()] = [name, known["Version"], _licence(known)]
        needs = (Requirement(each) for each in metadata.requires(name) or [])
        names += [each.name for each in needs if each.marker is None or each.marker.evaluate({"extra": ""})]
    c = [
        [str(each["name"]), str(each["version"]), str(each["licenses"][0]["license"]["id"])] for each in c_components()
    ]
    return sorted(found.values()) + c


def _licence(known: metadata.PackageMetadata) -> str:
    """Its expression, or what its classifiers say, or the first line of its text."""
    classifiers = [
        each.rpartition(" :: ")[2] for each in known.get_all("Classifier") or [] if each.startswith("License ::")
    ]
    text = (
        known.get("License-Expression")
        or ", ".join(classifiers)
        or (known.get("License") or "not said").splitlines()[0]
    )
    return str(text)[:80]


def _lists(folder: Path) -> Iterator[tuple[str, str, str]]:
    """Title, what it is, and the last result of each long command, as it left it: {"heads": [..], "rows": [[..]]}."""
    kinds = {
        "fuzz": ("Hostile bytes", "./run trust --long"),
        "fuzz-short": ("Hostile bytes, the same in every run of the tests", "./run test trust"),
        "mutants": ("Wrong programs that the C tests see", "./run trust mutants"),
        "proofs": ("Proofs", "./run trust proofs"),
        "soak": ("Long lives", "./run trust soak"),
    }
    for name, (title, command) in kinds.items():
        file = folder / f"{name}.json"
        if not file.is_file():
            yield title, command, '<p class="missing">not run</p>'
            continue
        said = json.loads(file.read_text("utf-8"))
        yield (
            title,
            command,
            _table(tuple(said["heads"]), [[html.escape(str(cell)) for cell in row] for row in said["rows"]]),
        )


def page(folder: Path, found: Results, table: list[Row]) -> tuple[str, list[str]]:
    safety, wrong = hazards(table, found)
    failed = sum(each.endswith(": failed") for each in wrong)
    parts = [
        "<h1>tautline: dossier</h1>",
        f"<p>{len(table)} hazards, made {datetime.now(UTC):%Y-%m-%d %H:%M} UTC of the suites that were run: "
        f"{html.escape(_suites(folder, found))}.</p>",
        f'<p class="failed">Of the tests of hazards {failed} failed, {len(wrong) - failed} were not run.</p>'
        if wrong
        else '<p class="passed">Each test of each hazard passed.</p>',
        f"<h2>In sum</h2>{_table(('what', 'came to'), [[*map(html.escape, row)] for row in summed(folder)])}",
        f"<h2>Hazards</h2>{safety}",
    ]
    parts += [f"<h2>{title}</h2><p><code>{command}</code></p>{body}" for title, command, body in _lists(folder)]
    budget = folder / "budget.txt"
    said = (
        f"<pre>{html.escape(budget.read_text('utf-8'))}</pre>" if budget.is_file() else '<p class="missing">not run</p>'
    )
    parts.append(f"<h2>The image's budgets</h2><p><code>./run firmware</code></p>{said}")
    parts.append(f"<h2>What it is made of</h2>{_table(('component', 'version', 'licence'), components())}")
    head = (
        '<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>tautline: dossier</title><style>{STYLE}</style>"
    )
    return head + "\n".join(parts) + "</html>\n", wrong


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "dossier")
    parser.add_argument("--sum", action="store_true", help="prints the page's first table alone")
    options = parser.parse_args()
    if options.sum:
        for what, said in summed(options.results):
            print(f"{what:14s} {said}")
        return 0
    text, wrong = page(options.results, results(options.results), rows(SAFETY.read_text("utf-8")))
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "index.html").write_text(text, "utf-8")
    print(options.out / "index.html")
    for each in wrong:
        print(f"dossier: {each}", file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
