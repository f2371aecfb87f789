"""A branch that went one way only is told by its line, and is accepted where a reason covers it."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tools import branches
from tools.bound import Code

SOURCE = """
static inline __attribute__((always_inline)) int tl_clamp(int x, int most) { return x > most ? f_of(x) : x; }
int f(int x, int y) {
    if (y == 3) { return f_of(7); }
    return tl_clamp(x, 100);
}
"""


@pytest.fixture
def program(tmp_path: Path) -> Path:
    (tmp_path / "f.c").write_text("int f_of(int x);\n" + SOURCE, "utf-8")
    (tmp_path / "g.c").write_text("int f_of(int x) { return x * 3; }\n", "utf-8")
    command = ["arm-none-eabi-gcc", "-mcpu=cortex-m0plus", "-mthumb", "-Os", "-g", "-nostdlib", "-Wl,-Ttext=0x20000000"]
    subprocess.run([*command, "-Wl,-ef", "-o", "x.elf", "f.c", "g.c"], check=True, cwd=tmp_path)
    return tmp_path / "x.elf"


def test_lines_through_helpers_and_reasons_that_run_out(program: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = Code(program)
    conditional = sorted(at for at, here in code.at.items() if here.conditional)
    lines = [line for _, line in branches.lines_of(program, conditional).values()]
    assert sorted(lines) == [5, 6]  # the clamp's branch is the line's that asks for it
    monkeypatch.setattr(branches, "ROOT", program.parent)
    reason = branches.Reason("f.c", "if (y == 3)", 1, "y is never 3")
    monkeypatch.setattr(branches, "REASONS", (reason,))
    left = branches.unexplained(program, conditional)
    assert len(left) == 1 and "return tl_clamp(x, 100);" in next(iter(left.values()))
    monkeypatch.setattr(branches, "REASONS", (branches.Reason("f.c", "", 1, "any, but one"),))
    assert len(branches.unexplained(program, conditional)) == 1
    assert branches.lines_of(program, []) == {}
