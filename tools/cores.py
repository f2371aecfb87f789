"""How many cycles instructions take, by core: the tables that tools/bound.py adds up. Without wait states.

Cortex-M0+: its Technical Reference Manual, table 3-1, with the fast multiplier; code and data in RAM that no other bus
master uses.

Cortex-M33: Arm publishes no such table for it. Here stand the upper ends of the Cortex-M3's (Technical Reference Manual
r2p1, table 3-1), whose pipeline has three stages, too, but issues one instruction at a time and forms addresses and
resolves branches a stage later. On an RP2350 code in SRAM comes over the bus that its data come over: each word that
an instruction moves costs a cycle more, as if it kept a fetch waiting every time.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Core:
    """name: GCC's. cycles: of an instruction by its name without width or condition, the number of words that it
    moves, and whether it changes the program counter; a conditional branch's are those where it is not taken. taken:
    what a taken one costs more."""

    name: str
    cycles: Callable[[str, int, bool], int]
    taken: int


def _m0plus(name: str, words: int, jumps: bool) -> int:
    if name in ("push", "pop", "ldmia", "stmia", "ldm", "stm"):
        return words + (3 if jumps else 1)
    if name.startswith(("ldr", "str")):
        return 2
    if name == "bl" or name in ("mrs", "msr", "dmb", "dsb", "isb"):
        return 3
    return 2 if jumps else 1


_REFILL = 3  # cycles to fill the pipeline behind a jump: 1 to 3
_DIVIDE = 12  # 2 to 12
_BARRIER = 8  # as long as the writes before it take: one to a peripheral is under way at most


def _m33(name: str, words: int, jumps: bool) -> int:
    refill = _REFILL if jumps else 0
    if re.match(r"(push|pop|ldm|stm|ldrd|strd)", name):
        return 1 + 2 * words + refill
    if name.startswith(("ldr", "str", "lda", "stl")):
        return 3 + refill
    if name in ("tbb", "tbh"):
        return 3 + _REFILL
    if re.match(r"[us]m(lal|laal)", name):
        return 7
    if re.match(r"[us]mull", name):
        return 5
    if name in ("udiv", "sdiv"):
        return _DIVIDE
    if name.startswith(("mul", "mla", "mls", "smul", "smla", "mrs", "msr", "cps")):
        return 2
    return _BARRIER if name in ("dmb", "dsb", "isb") else 1 + refill


M0PLUS = Core("cortex-m0plus", _m0plus, 1)
M33 = Core("cortex-m33", _m33, _REFILL)
