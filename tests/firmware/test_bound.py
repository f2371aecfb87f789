"""The bound on cycles against programs whose worst path is counted by hand (Cortex-M0+ Technical Reference Manual)."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tools.bound import NEVER, Bound, Code, Knowledge, Unbounded


def code_of(folder: Path, assembly: str) -> Code:
    (folder / "x.s").write_text(
        ".syntax unified\n.cpu cortex-m0plus\n.thumb\n" + assembly.replace("FUNCTION ", ".thumb_func\n.global "),
        "utf-8",
    )
    command = ["arm-none-eabi-gcc", "-mcpu=cortex-m0plus", "-mthumb", "-nostdlib", "-Wl,-Ttext=0x20000000", "-Wl,-e0"]
    subprocess.run([*command, "-o", str(folder / "x.elf"), str(folder / "x.s")], check=True)
    return Code(folder / "x.elf")


def test_the_dearer_branch_and_the_calls(tmp_path: Path) -> None:
    code = code_of(tmp_path, """
FUNCTION f
f:  push {r4, r5, lr}   @ 4
    ldr r0, [r0]        @ 2
    cmp r0, #0          @ 1
    beq 1f              @ 1 on, 2 taken
    muls r0, r1, r0     @ 1
    bl g                @ 3 + 5
1:  pop {r4, r5, pc}    @ 6
FUNCTION g
g:  adds r0, #1         @ 1
    b h                 @ 2, a tail call
FUNCTION h
h:  bx lr               @ 2
""")  # fmt: skip
    assert Bound(code, Knowledge()).of("f") == 4 + 2 + 1 + 1 + 1 + 3 + 5 + 6
    assert Bound(code, Knowledge(known={"g": 100})).of("f") == 4 + 2 + 1 + 1 + 1 + 3 + 100 + 6
    assert Bound(code, Knowledge(known={"g": NEVER})).of("f") == 4 + 2 + 1 + 2 + 6
    assert Bound(code, Knowledge(known={"g": NEVER}, waits={"f": 3})).of("f") == 4 + 2 + 3 + 1 + 2 + 6


LOOPS = """
FUNCTION f
f:  movs r2, #0         @ 1
1:  movs r3, #0         @ 1
2:  adds r3, #1         @ 1
    cmp r3, r0          @ 1
    bne 2b              @ 2, last 1
    adds r2, #1         @ 1
    cmp r2, r1          @ 1
    bne 1b              @ 2, last 1
    bx lr               @ 2
"""


def test_loops_in_loops(tmp_path: Path) -> None:
    code = code_of(tmp_path, LOOPS)
    inner = 10 * 4 - 1
    assert Bound(code, Knowledge(loops={"f": (6, 9)})).of("f") == 1 + 7 * (1 + inner + 4) - 1 + 2
    with pytest.raises(Unbounded, match="2 loops"):
        Bound(code, Knowledge()).of("f")


def test_what_cannot_be_bounded_is_said(tmp_path: Path) -> None:
    code = code_of(tmp_path, """
FUNCTION f
f:  push {lr}
    bl g
    pop {pc}
FUNCTION g
g:  push {lr}
    bl f
    pop {pc}
FUNCTION pointer
pointer:
    push {lr}           @ 2
    blx r3              @ 2 + 4
    pop {pc}            @ 4
FUNCTION small
small:
    movs r0, #1         @ 1
    nop                 @ 1
    bx lr               @ 2
FUNCTION two_entries
two_entries:
    cmp r0, #0
    beq 2f
1:  adds r0, #1
2:  subs r0, #3
    bne 1b
    bx lr
""")  # fmt: skip
    with pytest.raises(Unbounded, match="recursive"):
        Bound(code, Knowledge()).of("f")
    with pytest.raises(Unbounded, match="pointer"):
        Bound(code, Knowledge()).of("pointer")
    assert Bound(code, Knowledge(pointers={"pointer": ["small"]})).of("pointer") == 2 + 2 + 4 + 4
    with pytest.raises(Unbounded, match="several entries"):
        Bound(code, Knowledge(loops={"two_entries": (3,)})).of("two_entries")


def test_a_switch_of_libgcc(tmp_path: Path) -> None:
    code = code_of(tmp_path, """
FUNCTION f
f:  push {lr}                       @ 2
    bl __gnu_thumb1_case_uqi        @ 3 + 2
4:  .byte (1f - 4b) / 2, (2f - 4b) / 2, (3f - 4b) / 2
    .align 1
1:  pop {pc}                        @ 4
2:  muls r0, r0, r0                 @ 1
    muls r0, r0, r0                 @ 1
3:  pop {pc}                        @ 4
FUNCTION __gnu_thumb1_case_uqi
__gnu_thumb1_case_uqi:
    bx lr
""")  # fmt: skip
    assert Bound(code, Knowledge()).of("f") == 2 + 3 + 2 + 2 + 4
