"""Prints what the real board's image costs, and fails where a limit is passed: ./run firmware [--chip rp2350].

Flash, RAM and stack come from the linked image and GCC's call graph. Cycles come twice: the worst that was measured
over random tables and commands (emulator/measure.js; an RP2040 alone has an emulator), and what no path through the
machine code exceeds (bound.py).
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from tools.bound import Code, Unbounded  # noqa: E402
from tools.branches import unexplained  # noqa: E402
from tools.control_path import (  # noqa: E402
    AXES,
    CHIPS,
    CONTROL,
    CONTROL_HZ,
    EACH_STEP,
    ONE_PLAY,
    PORT,
    RP2040,
    STEP,
    Bounds,
    Chip,
    bound,
    bounds,
    ticks,
)

TASK = "main"
USB_INTERRUPT = "dcd_rp2040_irq"

EXCEPTION_FRAME = 36  # bytes, with the padding that aligns it
ROM_STACK = 64  # what the boot ROM's flash functions may take
UNKNOWN_STACK = 32  # assembly without a record of its own
ONSET, ONSET_POLL = "tl_onset_sample", "tl_onset_poll"

NOT_ALLOWED = re.compile(
    r"__aeabi_[fd](add|sub|mul|div|cmp)|__aeabi_u?ldivmod|__u?divdi3|__u?moddi3|^__u?divsi3$|^__u?modsi3$|malloc"
)


@dataclass
class Row:
    """One line of the report. `goal`: where the project wants it, where that is less than the limit."""

    what: str
    value: float
    limit: float
    unit: str
    goal: float | None = None


def _run(*command: str) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


# -- size -------------------------------------------------------------------------------------------------------------


def sizes(elf: Path) -> dict[str, int]:
    """Section name -> bytes."""
    sections = re.findall(r"^\s*\d+ (\.\S+)\s+([0-9a-f]{8})", _run("arm-none-eabi-objdump", "-h", str(elf)), re.M)
    return {name: int(size, 16) for name, size in sections}


# -- who calls whom ---------------------------------------------------------------------------------------------------


def code(elf: Path) -> tuple[dict[str, int], dict[str, set[str]]]:
    """From the disassembly: function -> address, function -> functions that it calls or jumps to by name."""
    address: dict[str, int] = {}
    calls: dict[str, set[str]] = {}
    name = ""
    for line in _run("arm-none-eabi-objdump", "-d", str(elf)).splitlines():
        if head := re.match(r"([0-9a-f]{8}) <(.+)>:$", line):
            name = head[2]
            address[name] = int(head[1], 16)
            calls[name] = set()
            if veneer := re.fullmatch(r"__(.+)_veneer", name):
                calls[name].add(veneer[1])
        elif (call := re.search(r"\t(?:bl|b\S*)\t[0-9a-f]+ <([^>+]+)>", line)) and call[1] != name:
            calls[name].add(call[1])
    return address, calls


def reached(calls: dict[str, set[str]], roots: list[str]) -> set[str]:
    functions: set[str] = set()
    open_ = list(roots)
    while open_:
        name = open_.pop()
        if name not in functions and name in calls:
            functions.add(name)
            open_ += calls[name]
    return functions


def float_instructions(elf: Path) -> list[str]:
    """Functions that use the floating-point unit."""
    at, found = "", set()
    for line in _run("arm-none-eabi-objdump", "-d", str(elf)).splitlines():
        if head := re.match(r"[0-9a-f]{8} <(.+)>:$", line):
            at = head[1]
        elif re.search(r"\tv[a-z]", line):
            found.add(at)
    return sorted(found)


# -- stack ------------------------------------------------------------------------------------------------------------


class Stack:
    """Worst depth below a function, from GCC's -fcallgraph-info. Recursion and unknown indirect calls are errors."""

    _NO_RETURN = ("panic", "__assert_func", "exit", "rom_reset_usb_boot")
    _ONCE_BEFORE_MAIN = ("runtime_run_initializers", "runtime_run_per_core_initializers", "runtime_init")

    def __init__(self, folder: Path) -> None:
        self.own: dict[str, int] = {}
        self.calls: dict[str, set[str]] = {}
        self._depth: dict[str, int] = {}
        for file in folder.rglob("*.ci"):
            if {"cycles.dir", "loader.dir"} & set(file.parts):
                continue
            text = file.read_text(encoding="utf-8")
            for title, size in re.findall(r'node: \{ title: "([^"]+)" label: "[^"]*\\n(\d+) bytes', text):
                self.own[title] = int(size)
            for source, target in re.findall(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"', text):
                self.calls.setdefault(source, set()).add(target)

    def _named(self, pattern: str) -> set[str]:
        return {title for title in self.own if re.fullmatch(pattern, title.rsplit(":", 1)[-1])}

    def _indirect(self, source: str) -> set[str]:
        name, file = source.rsplit(":", 1)[-1], source
        if name.startswith(("tl_trust", "tl_boot", "is_marked", "look_at_slot")):
            return self._named("port_slot_read")
        if name.startswith("tl_") or "/firmware/app/" in file:
            return self._named("port_.*")
        if name == "dcd_event_handler":
            return set()  # start of frame, which no class asks for
        if "/device/usbd.c" in file or name.startswith(("tud_", "usbd_", "tusb_")):
            return self._named("(vendord|dfu_moded|tud_vendor|tud_dfu)_.*(init|open|reset|xfer_cb|deinit)")
        if name == "flash_safe_execute":
            return self._named("flash_operation|default_(enter|exit|core_init)_.*")
        if name.startswith(("flash_", "rom_", "watchdog_caused")) or name in self._ONCE_BEFORE_MAIN:
            return set()  # the boot ROM, see ROM_STACK
        if name in ("alarm_pool_irq_handler", "hardware_alarm_irq_handler", "gpio_default_irq_handler"):
            return set()  # nobody registers with them
        raise SystemExit(f"budget: {source} calls through a pointer: say in tools/budget.py where that leads")

    def depth(self, title: str, above: tuple[str, ...] = ()) -> int:
        if title in above:
            raise SystemExit(f"budget: {' -> '.join([*above[above.index(title) :], title])} is recursive")
        if title in self._depth:
            return self._depth[title]
        own = self.own.get(title, UNKNOWN_STACK)
        if title in self._NO_RETURN:
            return own
        targets: set[str] = set()
        for target in self.calls.get(title, set()):
            targets |= self._indirect(title) if target == "__indirect_call" else {target}
        below = max((self.depth(target, (*above, title)) for target in targets), default=0)
        rom = ROM_STACK if title.rsplit(":", 1)[-1].startswith(("flash_range", "flash_do_cmd")) else 0
        self._depth[title] = own + max(below, rom)
        return self._depth[title]

    def of(self, name: str) -> int:
        functions = self._named(re.escape(name))
        if not functions:
            raise SystemExit(f"budget: no function {name} in the call graph")
        return max(self.depth(title) for title in functions)


# -- cycles ------------------------------------------------------------------------------------------------------------


@dataclass
class Cycles:
    """Of the control step: what was measured."""

    measured: dict[str, dict[str, int]]
    interrupt: int  # as that of Bounds, with the worst step and watch that were measured
    branches: dict[str, int]  # "step", "onset" -> conditional branches in our functions that it reaches
    one_way: dict[str, int]  # how many the measurements saw going one way or not at all
    unexplained: list[str]  # those of them for which tools/branches.py has no reason


def branches_of(chip: Chip, code_: Code, root: str) -> list[int]:
    """Addresses of the conditional branches that `root` reaches, in functions of ours."""
    objects = [*chip.build.glob("*/libtautline_*.a"), *chip.build.glob("CMakeFiles/cycles.dir/**/tl_*.c.o*")]
    ours = set(re.findall(r" [tT] (\w\S*)", _run("arm-none-eabi-nm", "--defined-only", *map(str, objects))))
    reaches = reached(code(chip.build / "cycles.elf")[1], [root]) & ours
    return sorted(at for at, here in code_.at.items() if here.conditional and code_.owner(at) in reaches)


def cycles(chip: Chip, image: Code, stand_in: Code, most: Bounds) -> Cycles:
    """Measured in the emulator; a value above its bound ends the program."""
    measured = json.loads(_run("node", str(ROOT / "tools" / "emulator" / "measure.js")))
    for kind, bound_ in (("step_tip", most.step), ("step_plays", most.step_plays), ("step_undoes", most.step_undoes)):
        if measured[kind]["worst"] > bound_:
            raise SystemExit(
                f"budget: {kind} took {measured[kind]['worst']} cycles, the bound says {bound_}: mend bound.py"
            )
    each = bound(chip, image, PORT)
    registers = sum(each.of(port) for port in EACH_STEP)
    branches = {"step": branches_of(chip, stand_in, STEP), "onset": branches_of(chip, stand_in, ONSET)}
    seen = dict(measured["seen"])
    one_way = {name: [at for at in addresses if seen.get(at, 0) != 3] for name, addresses in branches.items()}
    worst = ticks(
        chip,
        image,
        ONE_PLAY,
        measured["watch"]["worst"],
        measured["step_tip"]["worst"] + registers,
        measured["guard"]["worst"] + each.of("port_current_ma"),
    )
    missing = unexplained(chip.build / "cycles.elf", [at for addresses in one_way.values() for at in addresses])
    return Cycles(
        measured,
        max(worst),
        {name: len(addresses) for name, addresses in branches.items()},
        {name: len(addresses) for name, addresses in one_way.items()},
        list(missing.values()),
    )


# -- the report -------------------------------------------------------------------------------------------------------


def complain(label: str, names: Sequence[str]) -> None:
    if names:
        print(f"{label}: {', '.join(names)}")


def image_rows(chip: Chip) -> list[Row]:
    if chip is not RP2040:
        return [Row("flash image", (chip.build / "tautline.bin").stat().st_size, 73728, "bytes")]
    return [
        Row("loader", (chip.build / "loader.bin").stat().st_size, 2048, "bytes"),
        Row("image in a slot", (chip.build / "tautline-0.bin").stat().st_size, 94208, "bytes"),
    ]


def size_rows(chip: Chip) -> list[Row]:
    """Memory, and what is not where it has to be."""
    elf = chip.build / "tautline.elf"
    size = sizes(elf)
    ram_code_and_data = size[".data"]
    ram = ram_code_and_data + size[".bss"] + size[".ram_vector_table"]
    stack = Stack(chip.build)
    deepest = stack.of(TASK) + stack.of(USB_INTERRUPT) + stack.of(CONTROL) + 2 * EXCEPTION_FRAME
    address, calls = code(elf)
    ports = [name for name in address if name.startswith("port_")]
    control = reached(calls, [CONTROL, *(p for p in ports if p in PORT)])
    forbidden = sorted(name for name in control if NOT_ALLOWED.search(name))
    floats = sorted(name for name in address if re.match(r"__aeabi_[fd](add|sub|mul|div)", name))
    floats += float_instructions(elf)
    in_flash = sorted(name for name in control if address[name] >> 28 == 1)
    detector = sorted(name for name in reached(calls, [ONSET, ONSET_POLL]) if address[name] >> 28 == 1)
    complain("not allowed in the control path", forbidden)
    complain("float code", floats)
    complain("control path in flash", in_flash)
    complain("onset detector in flash", detector)
    return [
        *image_rows(chip),
        Row("RAM: code and initialised data", ram_code_and_data, 40960, "bytes"),
        Row("RAM with the stack", ram + size[".stack_dummy"], 160 * 1024, "bytes"),
        Row("stack, worst", deepest, size[".stack_dummy"], "bytes"),
        Row("float functions", len(floats), 0, ""),
        Row("control path: not allowed", len(forbidden), 0, "functions"),
        Row("control path: in flash", len(in_flash), 0, "functions"),
        Row("onset detector: in flash", len(detector), 0, "functions"),
    ]


def bound_rows(chip: Chip, most: Bounds) -> list[Row]:
    """What no path exceeds."""
    share = 100.0 * CONTROL_HZ / chip.core_hz
    load = 100.0 * most.millisecond * 1000 / chip.core_hz
    return [
        Row("control step with tables, any path", most.step, chip.cycles(600), "cycles"),
        Row("control step with several plays, any path", most.step_plays, chip.cycles(1200), "cycles"),
        Row("control step with all that is undone, any path", most.step_undoes, chip.cycles(1200), "cycles"),
        Row("control step, calibration, any path", most.step_any, chip.cycles(3300), "cycles"),
        Row(f"{AXES} axes at {CONTROL_HZ} Hz, any path", load, 25, "% of the core"),
        Row(f"{AXES} axes, worst tick, any path", share * most.interrupt, 25, "% of its period"),
        Row("the same with all that is undone", share * most.interrupt_undoes, 40, "% of its period"),
    ]


def measured_rows(chip: Chip, cost: Cycles) -> list[Row]:
    worst = {kind: values["worst"] for kind, values in cost.measured.items() if isinstance(values, dict)}
    has_cmsis = "arm_linear_interp_q31.c" in (chip.build / "build.ninja").read_text("utf-8")
    yardstick = "CMSIS-DSP's" if has_cmsis else "a plain loop's"
    share = 100.0 * CONTROL_HZ / chip.core_hz
    complain("branches without a reason in tools/branches.py", [f"\n  {place}" for place in cost.unexplained])
    return [
        Row("control path: fetched from flash", cost.measured["flash_fetches"], 0, "times"),
        Row("control step with tables, measured", worst["step_tip"], 600, "cycles"),
        Row("control step with tables, mean", cost.measured["step_tip"]["mean"], 500, "cycles"),
        Row("control step with several plays, measured", worst["step_plays"], 1200, "cycles"),
        Row("control step with all that is undone, measured", worst["step_undoes"], 1200, "cycles"),
        Row("control step, other modes, measured", worst["step_other"], 2200, "cycles"),
        Row("calibration motion, measured", worst["motion"], 2000, "cycles"),
        Row("once a millisecond beside it, measured", worst["watch"], 1300, "cycles"),
        Row("the same with several plays", worst["watch_plays"], 1800, "cycles"),
        Row("the same with all that is undone", worst["watch_undoes"], 2500, "cycles"),
        Row("guards, once a millisecond, measured", worst["guard"], 850, "cycles"),
        Row(f"{AXES} axes, worst tick, measured", share * cost.interrupt, 25, "% of its period"),
        Row("onset update, measured", worst["onset"], 2_000_000, "cycles"),
        *[
            Row(f"branches of the {name}, seen one way for a reason", cost.one_way[name], cost.branches[name], "")
            for name in ("step", "onset")
        ],
        Row("branches seen one way for no reason", len(cost.unexplained), 0, ""),
        Row(f"one look-up, measured; goal: {yardstick}", worst["lookup"], 120, "cycles", worst["lookup_yardstick"]),
    ]


def rows(chip: Chip) -> list[Row]:
    image = chip.code("tautline")
    stand_in = chip.code("cycles") if chip is RP2040 else None  # which has an emulator
    most = bounds(chip, image, stand_in)
    report = size_rows(chip) + bound_rows(chip, most)
    if stand_in is not None:
        report += measured_rows(chip, cycles(chip, image, stand_in, most))
    return report


def main(arguments: Sequence[str]) -> int:
    name = arguments[-1] if arguments else RP2040.name
    if name not in CHIPS:
        raise SystemExit(f"budget: no chip {name}: {' or '.join(CHIPS)}")
    over = 0
    try:
        report = rows(CHIPS[name])
    except Unbounded as unknown:
        raise SystemExit(f"budget: {unknown}: say in tools/budget.py how often, or where to") from unknown
    for row in report:
        state = (
            "OVER"
            if row.value > row.limit
            else ("above the goal" if row.goal is not None and row.value > row.goal else "")
        )
        goal = f", goal {row.goal:g}" if row.goal is not None else ""
        print(f"{row.what:46s} {row.value:>9.0f} of {row.limit:g}{goal} {row.unit}  {state}".rstrip())
        over += row.value > row.limit
    return 1 if over else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
