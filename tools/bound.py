"""Most cycles that a function of a linked Cortex-M0+ or Cortex-M33 image can take: the longest path through its machine
code.

No run is needed: every branch may go either way, every instruction under a condition may act or not, every call takes
its callee's bound, every loop goes round as often as `Knowledge` says. So it holds for every input, and is too high
where the data forbid a path. Cycles by the core's table (cores.py): zero wait states.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from tools.cores import M0PLUS, Core

_CASE = re.compile(r"__gnu_thumb1_case_([us])([qh])i")  # libgcc's switch: a table of offsets / 2 behind the call
_LINE = re.compile(r"^\s*([0-9a-f]+):\t([0-9a-f ]+?)\s*\t(\S+)(?:\t([^@<]*)(?:<([^>]+)>)?.*)?$")
_CONDITION = "(eq|ne|cs|cc|mi|pl|vs|vc|hi|ls|ge|lt|gt|le|hs|lo)"
_HEAD = re.compile(r"^([0-9a-f]{8}) <(.+)>:$")


NEVER = -(10**12)  # cycles of a path that is never taken


class Unbounded(Exception):
    """The code does something whose cost cannot be told; the text says what to add where."""


@dataclass(frozen=True)
class Instruction:
    """One line of the disassembly, its name without width or condition. target: of a direct branch or call, else 0.
    conditional: a branch that may be taken or not. maybe: under a condition of an IT block, it may do nothing."""

    address: int
    size: int
    name: str
    operands: str
    target: int
    conditional: bool = False
    maybe: bool = False

    @property
    def words(self) -> int:
        """How many it moves between registers and memory."""
        if not self.name.startswith(("push", "pop", "ldr", "str", "ldm", "stm")):
            return 0
        match = re.search(r"\{(.*?)\}", self.operands)
        count = 0
        for part in match[1].split(",") if match else []:
            ends = re.findall(r"\d+", part)
            count += int(ends[1]) - int(ends[0]) + 1 if "-" in part else 1
        return count or (2 if self.name in ("ldrd", "strd") else 1)

    @property
    def on_the_bus(self) -> bool:
        return self.name.startswith(("ldr", "str", "ldm", "stm")) and not re.search(r"\[(pc|sp)|^sp!", self.operands)

    @property
    def loads_pc(self) -> bool:
        return (self.name in ("pop", "ldm", "ldmia") and "pc" in self.operands) or (
            self.name == "ldr" and self.operands.startswith("pc,")
        )

    @property
    def writes_pc(self) -> bool:
        return self.name in ("mov", "add") and self.operands.lstrip().startswith("pc")

    @property
    def jumps(self) -> bool:
        return self.name in ("b", "bl", "bx", "blx") or self.writes_pc or self.loads_pc


class Code:
    """The disassembly of an ELF file for a core."""

    def __init__(self, elf: Path, core: Core = M0PLUS) -> None:
        self.core = core
        self._conditions = 0  # instructions left of an IT block
        self.at: dict[int, Instruction] = {}
        self.words: dict[int, int] = {}  # byte address -> byte, of data among the code
        self.starts: dict[str, int] = {}
        self.names: dict[int, str] = {}
        listing = subprocess.run(["arm-none-eabi-objdump", "-d", str(elf)], check=True, capture_output=True, text=True)
        for line in listing.stdout.splitlines():
            if head := _HEAD.match(line):
                self.starts[head[2]] = int(head[1], 16)
                self.names.setdefault(int(head[1], 16), head[2])
            elif match := _LINE.match(line):
                self._take(int(match[1], 16), match[2].replace(" ", ""), match[3], match[4] or "")

    def _take(self, address: int, digits: str, name: str, operands: str) -> None:
        size = len(digits) // 2
        if name.startswith("."):
            for i, byte in enumerate(int(digits, 16).to_bytes(size, "little")):
                self.words[address + i] = byte
            return
        name = re.sub(r"\.[nw]$", "", name)
        maybe, self._conditions = self._conditions > 0, max(self._conditions - 1, 0)
        if re.fullmatch(r"it[te]*", name):
            self._conditions = len(name) - 1
        elif maybe:
            name = re.sub(f"{_CONDITION}$", "", name)
        conditional = re.fullmatch(f"b{_CONDITION}|cbn?z", name) is not None
        direct = conditional or name in ("b", "bl")
        target = int(operands.split()[-1], 16) if direct else 0
        self.at[address] = Instruction(address, size, name, operands.strip(), target, conditional, maybe)

    def _start(self, address: int) -> int:
        return max(start for start in self.names if start <= address)

    def owner(self, address: int) -> str:
        """The function that an instruction belongs to."""
        return self.names[self._start(address)]

    def where(self, address: int) -> str:
        return f"{self.owner(address)}+{address - self._start(address):#x}"


Graph = dict[int, dict[int, int]]  # node -> its successors and the cycles from the one to the other


@dataclass(frozen=True)
class Knowledge:
    """What the code does not say. Functions by name.

    loops: most times that the way back to a loop's head is taken for each time that the loop is entered (its rounds
    where it is tested at the head, one less where it is tested at the end), in the order of the heads' addresses.
    known: functions whose cost is given; NEVER: paths that call them are left out. pointers: where calls through
    registers may lead. waits: cycles that each load and store of a function may wait for the bus (not those from the
    stack or beside the code).
    """

    loops: Mapping[str, Sequence[int]] = field(default_factory=dict)
    known: Mapping[str, int] = field(default_factory=dict)
    pointers: Mapping[str, Sequence[str]] = field(default_factory=dict)
    waits: Mapping[str, int] = field(default_factory=dict)


class Bound:
    """Bounds of functions; every call it meets is worked out once."""

    def __init__(self, code: Code, knowledge: Knowledge) -> None:
        self.code, self.knowledge = code, knowledge
        self._found: dict[int, int] = {}
        self._above: list[int] = []

    def of(self, name: str) -> int:
        """Cycles from the function's first instruction to its return, both included; the call is not. NEVER (or less)
        if each of its paths is left out."""
        return self._function(self.code.starts[name])

    def _function(self, start: int) -> int:
        name = self.code.names[start]
        if name in self.knowledge.known:
            return self.knowledge.known[name]
        if start in self._found:
            return self._found[start]
        if start in self._above:
            raise Unbounded(f"{name} is recursive")
        self._above.append(start)
        graph, ends = self._graph(start)
        heads = sorted(self._heads(graph, start))
        rounds = self.knowledge.loops.get(name, ())
        if len(rounds) != len(heads):
            raise Unbounded(f"{name} has {len(heads)} loops, {len(rounds)} are bounded: "
                            f"{', '.join(self.code.where(head) for head in heads)}")  # fmt: skip
        arrive = self._longest(graph, start, dict(zip(heads, rounds, strict=True)))
        self._found[start] = max((arrive[node] + cycles for node, cycles in ends.items()), default=NEVER)
        self._above.pop()
        return self._found[start]

    # -- a function's graph: its instructions, with the cost of what they call ----------------------------------------

    def _graph(self, start: int) -> tuple[Graph, dict[int, int]]:
        graph: Graph = {}
        ends: dict[int, int] = {}
        open_ = [start]
        while open_:
            address = open_.pop()
            if address in graph:
                continue
            graph[address] = {}
            for target, cycles in self._successors(start, self.code.at[address]):
                if target == 0:
                    ends[address] = max(ends.get(address, NEVER), cycles)
                elif target != start and target in self.code.names and target != address + self.code.at[address].size:
                    ends[address] = max(ends.get(address, NEVER), cycles + self._function(target))  # a tail call
                else:
                    graph[address][target] = max(graph[address].get(target, NEVER), cycles)
                    open_.append(target)
        return graph, ends

    def _successors(self, start: int, here: Instruction) -> Iterator[tuple[int, int]]:
        """(address, cycles); address 0 is the return."""
        after = here.address + here.size
        cycles = self.code.core.cycles(here.name, here.words, here.jumps)
        if here.maybe:
            yield after, 1
        if here.conditional:
            yield after, cycles
            yield here.target, cycles + self.code.core.taken
        elif here.name == "b":
            yield here.target, cycles
        elif here.name == "bl":
            yield from self._call(start, here, after, cycles)
        elif here.name == "blx":
            yield after, cycles + self._through_pointer(start, here)
        elif here.name == "bx" and here.operands != "lr":
            yield 0, cycles + self._through_pointer(start, here)
        elif here.name in ("tbb", "tbh"):
            size = 1 if here.name == "tbb" else 2
            yield from ((target, cycles) for target in self._cases(after, signed=False, size=size))
        elif here.name == "bx" or here.loads_pc or here.writes_pc:
            yield 0, cycles + self._leaves(here)
        elif here.name in ("bkpt", "udf"):
            return  # the end of the program
        else:
            wait = self.knowledge.waits.get(self.code.names[start], 0) * here.words if here.on_the_bus else 0
            yield after, cycles + wait

    def _leaves(self, here: Instruction) -> int:
        """Cycles of what follows a load or move of the program counter: a return, or the linker's long jump."""
        if here.name == "ldr" and (literal := re.search(r"\[pc(?:, #(\d+))?\]", here.operands)):
            return self._function(self._word((here.address + 4 & ~3) + int(literal[1] or 0)) & ~1)
        if (here.writes_pc and "lr" not in here.operands) or (here.name == "ldr" and "[sp]" not in here.operands):
            raise Unbounded(f"a computed jump at {self.code.where(here.address)}")
        return 0

    def _word(self, at: int) -> int:
        return int.from_bytes(bytes(self.code.words[at + i] for i in range(4)), "little")

    def _call(self, start: int, here: Instruction, after: int, cycles: int) -> Iterator[tuple[int, int]]:
        name = self.code.names.get(here.target)
        if name is None:  # a far jump within the function
            yield here.target, cycles
        elif match := _CASE.search(name):
            for target in self._cases(after, signed=match[1] == "s", size=1 if match[2] == "q" else 2):
                yield target, cycles + self._function(here.target)
        else:
            yield after, cycles + self._function(here.target)

    def _cases(self, table: int, *, signed: bool, size: int) -> Iterator[int]:
        at = table
        while at in self.code.words:
            offset = int.from_bytes(bytes(self.code.words.get(at + i, 0) for i in range(size)), "little", signed=signed)
            if table + 2 * offset in self.code.at:  # else it is the padding behind the table
                yield table + 2 * offset
            at += size

    def _through_pointer(self, start: int, here: Instruction) -> int:
        name = self.code.names[start]
        if re.fullmatch(r"__.+_veneer", name):  # the linker's long jump: its target is the word behind it
            return self._function(self._word((here.address + here.size + 3) & ~3) & ~1)
        if name not in self.knowledge.pointers:
            raise Unbounded(f"{self.code.where(here.address)} calls through a pointer")
        return max(self.of(target) for target in self.knowledge.pointers[name])

    # -- the longest path ----------------------------------------------------------------------------------------------

    def _heads(self, graph: Graph, start: int) -> list[int]:
        heads = []
        for part in _components(graph, start):
            if len(part) > 1 or part[0] in graph[part[0]]:
                head = self._head(graph, part, start)
                heads += [head, *self._heads(_within(graph, part, head), head)]
        return heads

    def _head(self, graph: Graph, part: Iterable[int], start: int) -> int:
        inside = set(part)
        entries = {target for node, to in graph.items() if node not in inside for target in to if target in inside}
        entries |= {start} & inside
        if len(entries) != 1:
            raise Unbounded(f"a loop with several entries at {self.code.where(min(inside))}")
        return entries.pop()

    def _longest(self, graph: Graph, start: int, rounds: Mapping[int, int]) -> dict[int, int]:
        """Most cycles from `start` to before each node, loops included."""
        arrive = {start: 0}
        for part in _components(graph, start):
            if len(part) == 1 and part[0] not in graph[part[0]]:
                inner = {part[0]: 0}
                head = part[0]
            else:
                head = self._head(graph, part, start)
                inner = self._longest(_within(graph, part, head), head, rounds)
                once = max(inner[node] + graph[node][head] for node in part if head in graph[node])
                arrive[head] += rounds[head] * max(once, 0)
            for node in part:
                arrive[node] = max(arrive.get(node, NEVER), arrive[head] + inner[node])
            inside = set(part)
            for node in part:
                for target, cycles in graph[node].items():
                    if target not in inside:
                        arrive[target] = max(arrive.get(target, NEVER), arrive[node] + cycles)
        return arrive


def _within(graph: Graph, part: Iterable[int], head: int) -> Graph:
    """A loop's body: its nodes without the way back to its head."""
    inside = set(part)
    return {node: {t: c for t, c in graph[node].items() if t in inside and t != head} for node in inside}


def _components(graph: Graph, start: int) -> list[list[int]]:
    """Strongly connected components reached from `start`, in an order that every edge between them follows (Tarjan)."""
    number: dict[int, int] = {}
    low: dict[int, int] = {}
    path: list[int] = []
    on_path: set[int] = set()
    components: list[list[int]] = []
    work = [(start, iter(graph[start]))]
    number[start] = low[start] = 0
    path.append(start)
    on_path.add(start)
    while work:
        node, targets = work[-1]
        for target in targets:
            if target not in number:
                number[target] = low[target] = len(number)
                path.append(target)
                on_path.add(target)
                work.append((target, iter(graph[target])))
                break
            if target in on_path:
                low[node] = min(low[node], number[target])
        else:
            work.pop()
            if work:
                low[work[-1][0]] = min(low[work[-1][0]], low[node])
            if low[node] == number[node]:
                part = []
                while not part or part[-1] != node:
                    part.append(path.pop())
                    on_path.discard(part[-1])
                components.append(part)
    return components[::-1]
