"""docs/safety.md: every hazard has a limit, guards and a test that is run, every fault is a hazard."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import pytest

from tautline.device import wire
from tools.guards import GUARDS, RANDOM
from tools.mutants import without

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "safety.md"
SOURCES = [f"{room}/**/*.[ch]" for room in ("common", "firmware")] + ["firmware/port/**/*.pio"]


@dataclass(frozen=True)
class Row:
    hazard: str
    promise: str
    limit: str
    test: str
    guards: str

    @property
    def names(self) -> list[str]:
        return [name for name in self.guards.split("; ") if name]


def rows(page: str) -> list[Row]:
    lines = [line for line in page.splitlines() if line.startswith("|")]
    assert lines[0] == "| hazard | promise | limit | test | guards |"
    return [Row(*(cell.strip() for cell in line.strip("|").split("|"))) for line in lines[2:]]


def lacks(row: Row) -> list[str]:
    """What is wrong with the tests that a row names."""
    tests = [test.strip() for test in row.test.split(",") if test.strip()]
    wrong = [f"{row.hazard}: {test}" for test in tests if not is_run(test)] if tests else [f"{row.hazard}: no test"]
    known = {guard.name: guard for guard in GUARDS}
    wrong += [f"{row.hazard}: {name}" for name in row.names if name not in known]
    for guard in (known[name] for name in row.names if name in known):
        if guard.test != RANDOM and not any(guard.test.startswith(test) for test in tests):
            wrong.append(f"{row.hazard}: {guard.name} is seen by {guard.test}")
    return wrong if row.names else [*wrong, f"{row.hazard}: no guard"]


def is_run(test: str) -> bool:
    """Whether path::name is a test that its suite runs."""
    path, _, name = test.partition("::")
    file = ROOT / path
    if not path.startswith(("tests/", "tools/emulator/test/")) or not file.is_file():
        return False
    text = file.read_text()
    if file.suffix == ".js":  # by how its name begins
        return len(name) > 20 and text.count(f"test('{name}") == 1
    if path == "tests/c/duplicate_code.c":
        return name == "" and "duplicate_code.c" in (file.parent / "CMakeLists.txt").read_text()
    if not re.fullmatch(r"test_\w+", name):
        return False
    if file.suffix == ".c":  # CMakeLists.txt takes every test_*.c
        built = file.parent == ROOT / "tests" / "c" and file.name.startswith("test_")
        headers = "".join((file.parent / each).read_text() for each in re.findall(r'#include "(\w+_test\.h)"', text))
        return built and f"static void {name}(void) {{" in text + headers and f"RUN_TEST({name});" in text
    return re.search(rf"^def {name}\(", text, re.MULTILINE) is not None


def test_every_hazard_has_a_test() -> None:
    found = rows(PAGE.read_text())
    assert len(found) > 30 and len({row.hazard for row in found}) == len(found)
    assert [missing for row in found for missing in lacks(row)] == []


@pytest.mark.parametrize(
    "test",
    [
        "",
        "tests/c/test_safety.c::test_nobody_wrote_this",
        "tests/c/test_nowhere.c::test_gains_that_swing_the_drive_are_a_fault",
        "tests/c/test_safety.c",
        "tests/board/test_safety.py::fault_after",
        "tests/c/test_axis.c::test_a_blocked_motor_faults, tests/board/test_safety.py::test_gone",
    ],
)
def test_a_hazard_without_a_test_is_seen(test: str) -> None:
    assert lacks(Row("fire", "none", "`stall_ms`", test, "stall"))
    assert not lacks(Row("fire", "none", "`stall_ms`", "tests/c/test_axis.c::test_a_blocked_motor_faults", "stall"))


def test_a_hazard_without_a_guard_is_seen() -> None:
    test = "tests/c/test_axis.c::test_a_blocked_motor_faults"
    for guards in ("", "nobody wrote this", "stall; nor this", "homing gives up"):  # the last one's test is another
        assert lacks(Row("fire", "none", "`stall_ms`", test, guards))


def test_every_guard_is_of_a_hazard_and_in_the_source() -> None:
    names = [guard.name for guard in GUARDS]
    assert len(set(names)) == len(names) > 60
    assert {name for row in rows(PAGE.read_text()) for name in row.names} == set(names)
    for guard in GUARDS:
        assert is_run(guard.test) and all(text != (ROOT / file).read_text() for file, text in without(guard).items())


def test_every_limit_is_in_the_source() -> None:
    source = "\n".join(path.read_text() for pattern in SOURCES for path in ROOT.glob(pattern))
    source += (ROOT / "tools" / "70-tautline.rules").read_text()
    for row in rows(PAGE.read_text()):
        named = re.findall(r"`(\w+)`", row.limit)
        assert named, row
        for name in named:
            assert re.search(rf"\b{name}\b|_{name}\b", source), (row.hazard, name)


def test_every_fault_is_a_hazard() -> None:
    named = {name for row in rows(PAGE.read_text()) for name in re.findall(r"`([A-Z_]+)`", row.promise)}
    assert named == wire.wire.FAULTS.keys() - {"NONE"}


def test_the_udev_rule_lets_the_user_at_the_machine_in() -> None:
    (path,) = (ROOT / "tools").glob("*-tautline.rules")
    assert int(path.name.split("-")[0]) < 73  # where the session's rules read the tag
    (rule,) = [line for line in path.read_text().splitlines() if line and not line.startswith("#")]
    assert 'TAG+="uaccess"' in rule and "MODE" not in rule and "GROUP" not in rule
    assert f'ATTR{{idVendor}}=="{wire.wire.USB_VENDOR:04x}"' in rule
    assert f'ATTR{{manufacturer}}=="{wire.wire.USB_MANUFACTURER}"' in rule
