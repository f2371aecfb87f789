"""./run dossier: each hazard with the last result of its tests, from what the suites wrote."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tools import dossier, kept

PAGE = (
    "| hazard | promise | limit | test | guards |\n| --- | --- | --- | --- | --- |\n"
    "| fire | off | `x` | tests/c/test_a.c::test_one, tests/board/test_b.py::test_two | g |\n"
    "| flood & <b> | dry | `y` | tools/emulator/test/image.test.js::a drop of | g |\n"
    "| code | none | `z` | tests/c/duplicate_code.c:: | g |\n"
)
C = (
    '<testsuite><testcase name="test_a"><system-out>/x/test_a.c:12:test_one:{}\n/x/test_a.c:19:test_other:FAIL: no'
    '</system-out></testcase><testcase name="codes_given_twice_do_not_compile"/></testsuite>'
)
BOARD = (
    '<testsuites><testsuite><testcase classname="tests.board.test_b" name="test_two[1]"/>'
    '<testcase classname="tests.board.test_b" name="test_two[2]">{}</testcase></testsuite></testsuites>'
)
CHIP = "TAP version 13\n# Subtest: x\n{}ok 1 - a drop of water # time=3\n  ---\n"


def made(folder: Path, c: str = "PASS", board: str = "", chip: str = "") -> tuple[str, list[str]]:
    folder.mkdir(exist_ok=True)
    (folder / "c.xml").write_text(C.format(c))
    (folder / "board.xml").write_text(BOARD.format(board))
    (folder / "chip.tap").write_text(CHIP.format(chip))
    return dossier.page(folder, dossier.results(folder), dossier.rows(PAGE))


@pytest.fixture(autouse=True)
def sdk(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """The Pico SDK's version, where only the firmware's set-up would fetch it."""
    folder = tmp_path_factory.mktemp("sdk")
    lines = (
        f"set(PICO_SDK_VERSION_{part} {number})\n" for part, number in (("MAJOR", 2), ("MINOR", 1), ("REVISION", 1))
    )
    (folder / "pico_sdk_version.cmake").write_text("".join(lines))
    monkeypatch.setenv("PICO_SDK_PATH", str(folder))


def test_a_hazard_whose_tests_passed_is_shown_so(tmp_path: Path) -> None:
    text, wrong = made(tmp_path)
    assert wrong == []
    assert "flood &amp; &lt;b&gt;" in text and "<b>" not in text
    assert text.count('class="passed"') == 5 and 'class="failed"' not in text
    assert "Each test of each hazard passed." in text and "board (1 tests, " in text


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"c": "FAIL"}, "fire: tests/c/test_a.c::test_one: failed"),
        ({"board": "<failure/>"}, "fire: tests/board/test_b.py::test_two: failed"),
        ({"board": "<error/>"}, "fire: tests/board/test_b.py::test_two: failed"),
        ({"chip": "not "}, "flood & <b>: tools/emulator/test/image.test.js::a drop of: failed"),
    ],
)
def test_a_test_that_failed_in_any_case_is_told(tmp_path: Path, change: dict[str, str], said: str) -> None:
    text, wrong = made(tmp_path, **change)
    assert wrong == [said] and "Of the tests of hazards 1 failed, 0 were not run." in text


def test_a_test_that_was_not_run_is_no_success(tmp_path: Path) -> None:
    made(tmp_path)
    (tmp_path / "board.xml").write_text(
        BOARD.replace("{}", "")
        .replace("<testcase ", "<testcase x='' ")
        .replace('"/>', '"><skipped/></testcase>')
        .replace('[2]">', '[2]"><skipped/>')
    )
    (tmp_path / "chip.tap").unlink()
    text, wrong = dossier.page(tmp_path, dossier.results(tmp_path), dossier.rows(PAGE))
    assert [line.rpartition(": ")[2] for line in wrong] == ["not run", "not run"]
    assert 'class="missing">not run' in text


def test_a_hazard_without_a_test_is_refused() -> None:
    with pytest.raises(SystemExit, match="no test for: code"):
        dossier.rows(PAGE.replace("tests/c/duplicate_code.c::", ""))
    with pytest.raises(SystemExit, match="has no table"):
        dossier.rows(PAGE.replace("| hazard", "| danger"))


def test_every_hazard_of_the_page_is_in_it_and_what_else_was_tried(tmp_path: Path) -> None:
    table = dossier.rows(dossier.SAFETY.read_text())
    assert len(table) > 50
    kept.keep("soak", ("board", "hours"), [("desktop", 8)], tmp_path)
    kept.keep("soak", ("board", "hours"), [("emulated", 0.5)], tmp_path)
    kept.keep("soak", ("board", "hours"), [("desktop", 9)], tmp_path)  # the last one counts
    assert json.loads((tmp_path / "soak.json").read_text())["rows"] == [["desktop", "9"], ["emulated", "0.5"]]
    text, wrong = dossier.page(tmp_path, {}, table)
    assert len(wrong) == sum(len(row.tests) for row in table)
    assert "<td>emulated</td><td>0.5</td>" in text
    parts = re.findall(r"<tr><td>([\w.-]+)</td><td>([\w.]+)</td><td>([^<]+)</td></tr>", text)
    licences = {name: licence for name, _, licence in parts}
    assert licences["tautline-robotics"] == "Apache-2.0" and licences["tinyusb"] == "MIT" and "numpy" in licences


def test_in_sum_what_was_run_and_lost(tmp_path: Path) -> None:
    assert [said for _, said in dossier.summed(tmp_path)] == [
        *("not run", "not run"),
        *("no suite was run; no life was lived", "no suite was run; no life was lived"),
        *("not run", "not run"),
    ]
    heads = ("target", "executions", "edges reached", "of", "kept inputs", "broken")
    kept.keep("fuzz", heads, [("wire", 900, 20, 40, 3, ""), ("rig", 100, "-", "-", "-", "TypeError")], tmp_path)
    kept.keep("proofs", ("proof", "result"), [("a", "proven"), ("b", "2 alarms left")], tmp_path)
    lives = [
        ("desktop", "8.00", "5 h following", 30, "cable 9, power 7, cut 4", "none"),
        ("emulated", "0.50", "0 h following", 3, "cable 1, power 2, cut 0", "40:16: lost"),
    ]
    kept.keep("soak", ("board", "hours", "following", "mishaps", "of which", "failures"), lives, tmp_path)
    names = (
        "test_a_power_cut",
        "test_any[power-flash]",
        "test_any[flash-cable-0]",
        "test_unplugged",
        "test_powerful[x]",
    )
    made = [f'<testcase classname="tests.board.test_b" name="{name}">{{}}</testcase>' for name in names]
    inner = "".join(each.format("<failure/>" if "unplugged" in each else "") for each in made)
    (tmp_path / "board.xml").write_text(f"<testsuite>{inner}</testsuite>")
    assert [said for _, said in dossier.summed(tmp_path)] == [
        "1000 of 2 targets, 100 at least; broken: rig",
        "20 of 40",
        "2 cases in the suites, none failed; 13 in lives",
        "2 cases in the suites, 1 failed; 10 in lives",
        "1 of 2 without an alarm, the others' explained",
        "desktop 8.00 h with 30 mishaps, emulated 0.50 h with 3 mishaps; lost: 40:16: lost",
    ]
