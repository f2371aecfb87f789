"""The bound on cycles against programs whose worst path is counted by hand, from the tables of tools/cores.py."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tools.bound import NEVER, Bound, Code, Knowledge, Unbounded
from tools.cores import M0PLUS, M33, Core


def code_of(folder: Path, assembly: str, core: Core = M0PLUS) -> Code:
    (folder / "x.s").write_text(
        f".syntax unified\n.cpu {core.name}\n.thumb\n" + assembly.replace("FUNCTION ", ".thumb_func\n.global "),
        "utf-8",
    )
    command = ["arm-none-eabi-gcc", f"-mcpu={core.name}", "-mthumb", "-nostdlib", "-Wl,-Ttext=0x20000000", "-Wl,-e0"]
    subprocess.run([*command, "-o", str(folder / "x.elf"), str(folder / "x.s")], check=True)
    return Code(folder / "x.elf", core)


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


# Cortex-M33: a load 2, a refill 3, and one more for each word over the bus that the code comes over, too.
M33_PROGRAM = """
FUNCTION f
f:  push {r4, r5, lr}       @ 1 + 3, 3 on the bus
    ldrd r0, r1, [r0]       @ 1 + 2, 2
    cbz r0, 1f              @ 1 on, 4 taken
    umull r2, r3, r0, r1    @ 5
    udiv r2, r3, r0         @ 12
    cmp r2, #0              @ 1
    ittt ne                 @ 1
    movne r2, #1            @ 1
    strne r2, [r1]          @ 2, 1
    blne g                  @ 4 + 4
1:  pop.w {r4, r5, pc}      @ 1 + 3, 3, refill 3
FUNCTION g
g:  it eq                   @ 1
    bxeq lr                 @ 4, or 1 on
    mla r0, r0, r1, r2      @ 2
    b h                     @ 4, a tail call
FUNCTION h
h:  ldr.w pc, [pc, #0]      @ 2, 1, refill 3
    .word far + 1
FUNCTION far
far:
    tbb [pc, r0]            @ 2, 1, refill 3
4:  .byte (5f - 4b) / 2, (6f - 4b) / 2
5:  nop                     @ 1
6:  mov pc, lr              @ 4
"""


def test_a_cortex_m33(tmp_path: Path) -> None:
    code = code_of(tmp_path, M33_PROGRAM, M33)
    far = 6 + 1 + 4
    assert Bound(code, Knowledge()).of("far") == far
    g = 1 + 1 + 2 + 4 + 6 + far
    assert Bound(code, Knowledge()).of("g") == g
    before, end = 7 + 5 + 1 + 5 + 12 + 1 + 1 + 1 + 3, 7 + 3
    assert Bound(code, Knowledge()).of("f") == before + 4 + g + end
    # What stands under a condition may be left out: a path that never calls g is still there.
    assert Bound(code, Knowledge(known={"g": NEVER})).of("f") == before + 1 + end
    # Each word waits for the bus, but for those of the stack.
    assert Bound(code, Knowledge(known={"g": 0}, waits={"f": 10})).of("f") == before + 4 + end + 3 * 10


def test_a_computed_jump_of_a_cortex_m33_is_said(tmp_path: Path) -> None:
    code = code_of(tmp_path, """
FUNCTION f
f:  ldr.w pc, [r1, r0, lsl #2]
""", M33)  # fmt: skip
    with pytest.raises(Unbounded, match="computed jump"):
        Bound(code, Knowledge()).of("f")
