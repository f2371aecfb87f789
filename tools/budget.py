"""Prints what the real board's image costs, and fails where a limit is passed: ./run firmware.

Flash, RAM and stack come from the linked image and GCC's call graph. Cycles come twice: the worst that was measured
over random tables and commands (emulator/measure.js), and what no path through the
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
from tools.bound import NEVER, Bound, Code, Knowledge, Unbounded  # noqa: E402
from tools.branches import unexplained  # noqa: E402

BUILD = ROOT / "build" / "rp2040"
CONTROL = "control_interrupt"  # what the timer interrupt runs
TASK = "main"
USB_INTERRUPT = "dcd_rp2040_irq"

EXCEPTION_FRAME = 36  # bytes, with the padding that aligns it
ROM_STACK = 64  # what the boot ROM's flash functions may take
UNKNOWN_STACK = 32  # assembly without a record of its own
AXES = 4
CONTROL_HZ = 5000
CORE_HZ = 125_000_000

STEP, ONSET, ONSET_POLL = "tl_axis_step", "tl_onset_sample", "tl_onset_poll"
EXCEPTION = 2 * 15  # cycles into the interrupt and back
BUS_WAIT = 3  # cycles that a peripheral's register takes longer than RAM
ROM_MEMSET = 200  # cycles of the boot ROM's memset for the 64 bytes or less that the control path clears

# Most times that the loops of the control path go back.
LOOPS = {
    "tl_app_control": (AXES, 1, 1),  # one axis is watched in a tick, and one guarded
    "come_late": (AXES,),
    "tl_elements_ahead": (6,),  # as many elements as a table has, but the first
    "tl_elements_behind": (7,),
    "tl_stop_watch": (AXES, AXES),
    "tl_stop_group": (AXES,),
    "tl_undo_angle": (3,),  # joints
    "tl_axis_watch": (3,),  # the same
    "tl_undo_late": (4,),  # followers
    "tl_undo_pushing": (2,),  # as many rounds as the watch asks for
    "tl_history_push": (2,),  # pushed once a millisecond and jitter
    "port_encoder": (4,),  # the state machine leaves its count within 11 cycles of its own, a round here takes 5
    "bridge_sense_finish": (5,),  # four samples are in the FIFO, and one may come meanwhile
    CONTROL: (1,),  # its alarm passed while it was set; the next one is a period away
    "port_time_us": (2,),  # the high word changes once in 71 minutes
}
# What a table never comes to that undoes no more than the play and the curve; and one that has a single play.
UNDONE = ("angle", "late", "wider", "turned", "scaled", "reading", "pushing", "tick")
PLAYS_ALONE = {f"tl_undo_{name}": NEVER for name in UNDONE} | {"tl_undoing_feed": NEVER, "tl_undoing_turn": NEVER}
PLAYS_ALONE |= {"tl_compensator_hear": NEVER, "tl_compensator_reach": NEVER, "turn_one": NEVER}
ONE_PLAY = {"tl_several_turn": NEVER, "tl_several_lead": NEVER, "tl_elements_behind": NEVER} | PLAYS_ALONE
CALIBRATION = "tl_motion_tick"  # for one axis at a time, and not while it follows the tip
# One of these in a tick, in this order, each once a millisecond (tl_axis_step: `switch (job)`). The axes are apart by a
# tick: tl_axis_init() begins axis i with a tick less than axis i - 1, and all of them count on together.
JOBS = ("tl_axis_listen", "tl_compensator_feed", "tl_compensator_turn", "tl_compensator_take_up", "tl_axis_plan")
BEGIN = "tl_path_begin"  # where axis->slot is 0, and there the job is the first one
WATCH, GUARD, FAIL = "tl_axis_watch", "tl_axis_guard", "tl_axis_fail"  # an axis that fails is off from then on
TRIAL = "try_out"  # of moves, homing and checks
LATE = "come_late"  # a tick that comes late has been waited for already
STOP = "tl_stop_watch"  # of all axes, in the last tick of a millisecond
GUARD_LATER = 1  # ticks from an axis' watch to its guard (tl_app.c)
PORT = (
    "port_encoder",
    "port_drive",
    "port_current_ma",
    "port_time_us",
    "port_supply_mv",
    "port_driver_fault",
    "port_estop_closed",
)
EACH_STEP = ("port_encoder", "port_drive")
STAND_IN_PORT = (
    "read_encoder",
    "take_drive",
    "read_current",
    "no_time",
    "read_supply",
    "read_fault",
)  # of tools/emulator/cycles.c
REGISTERS = ("port_encoder", "port_time_us", "bridge_drive", "bridge_sense_start", "bridge_sense_finish", CONTROL)

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
        if name.startswith(("flash_", "rom_")) or name in self._ONCE_BEFORE_MAIN:
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


# -- cycles -----------------------------------------------------------------------------------------------------------


def bound(code: Code, ports: Sequence[str], **known: int) -> Bound:
    calls_port = re.compile(r"tl_axis_|tl_stop_|drive$|tl_app_control$")
    return Bound(
        code,
        Knowledge(
            loops=LOOPS,
            known={"__wrap_memset": ROM_MEMSET, **known},
            pointers={name: ports for name in code.starts if calls_port.match(name)},
            waits=dict.fromkeys(REGISTERS, BUS_WAIT),
        ),
    )


def step_bound(code_: Code, ports: Sequence[str], job: str, **known: int) -> int:
    """Of the control step in the tick of `job`, a fault included; "": of a tick without a job."""
    never = {other: NEVER for other in (*JOBS, *([] if job == JOBS[0] else [BEGIN])) if other != job}
    return bound(code_, ports, **never, **known).of(STEP)


@dataclass
class Cycles:
    """Of the control step: measured, and the bound of every path."""

    measured: dict[str, dict[str, int]]
    step: int  # encoder value to duty
    step_plays: int  # with several plays
    step_undoes: int  # with all that tables undo
    step_any: int  # calibration motion included
    interrupt: int  # AXES axes, from the request to the return, registers included
    interrupt_undoes: int  # the same with several plays and all that tables undo
    millisecond: int  # the same over the ticks of a millisecond
    interrupt_measured: int  # as `interrupt`, with the worst step and watch that were measured
    branches: dict[str, int]  # "step", "onset" -> conditional branches in our functions that it reaches
    one_way: dict[str, int]  # how many the measurements saw going one way or not at all
    unexplained: list[str]  # those of them for which tools/branches.py has no reason


def ticks(
    image: Code, plays: dict[str, int], watch: int | None = None, step: int | None = None, guard: int | None = None
) -> list[int]:
    """Bounds of the control interrupt's cycles in each tick of a millisecond, where AXES axes follow by tables; with
    measured values in place of the bounds of a step, watch or guard, the registers' cycles included."""
    if gone := [name for name in (*JOBS, BEGIN, WATCH, GUARD, FAIL, LATE, TRIAL, STOP) if name not in image.starts]:
        raise SystemExit(f"budget: no function {', '.join(gone)} in the image: mend JOBS")
    count = CONTROL_HZ // 1000
    jobs = [*JOBS, *[""] * (count - len(JOBS))]
    # An axis that fails for a late tick does so after more than a hundred lost periods: nobody waits for that one.
    tick = bound(image, PORT, **{STEP: 0, WATCH: 0, GUARD: 0, STOP: 0, LATE: NEVER}).of(CONTROL) + EXCEPTION
    steps = [step_bound(image, PORT, job, **{CALIBRATION: NEVER, **plays}) if step is None else step for job in jobs]
    watch = bound(image, PORT, **plays).of(WATCH) if watch is None else watch
    guard = bound(image, PORT, **{FAIL: NEVER, TRIAL: NEVER}).of(GUARD) if guard is None else guard
    stop = bound(image, PORT, **{FAIL: NEVER}).of(STOP)
    return [
        tick
        + (stop if (at + 1) % count == count - 1 else 0)
        + sum(steps[(at - axis) % count] for axis in range(AXES))
        + (watch if (at + 1) % count < AXES else 0)
        + (guard if (at + 1 - GUARD_LATER) % count < AXES else 0)
        for at in range(count)
    ]


def branches_of(code_: Code, root: str) -> list[int]:
    """Addresses of the conditional branches that `root` reaches, in functions of ours."""
    objects = [*BUILD.glob("*/libtautline_*.a"), *BUILD.glob("CMakeFiles/cycles.dir/**/tl_*.c.o*")]
    ours = set(re.findall(r" [tT] (\w\S*)", _run("arm-none-eabi-nm", "--defined-only", *map(str, objects))))
    reaches = reached(code(BUILD / "cycles.elf")[1], [root]) & ours
    return sorted(at for at, here in code_.at.items() if here.conditional and code_.owner(at) in reaches)


def cycles() -> Cycles:
    measured = json.loads(_run("node", str(ROOT / "tools" / "emulator" / "measure.js")))
    stand_in, image = Code(BUILD / "cycles.elf"), Code(BUILD / "tautline.elf")
    step_any = bound(stand_in, STAND_IN_PORT).of(STEP)
    step, step_plays, step_undoes = (
        max(step_bound(stand_in, STAND_IN_PORT, job, **{CALIBRATION: NEVER, **plays}) for job in JOBS)
        for plays in (ONE_PLAY, PLAYS_ALONE, {})
    )
    for kind, most in (("step_tip", step), ("step_plays", step_plays), ("step_undoes", step_undoes)):
        if measured[kind]["worst"] > most:
            raise SystemExit(
                f"budget: {kind} took {measured[kind]['worst']} cycles, the bound says {most}: mend bound.py"
            )
    each = bound(image, PORT)
    registers = sum(each.of(port) for port in EACH_STEP)
    worst, with_all = ticks(image, ONE_PLAY), ticks(image, {})
    branches = {"step": branches_of(stand_in, STEP), "onset": branches_of(stand_in, ONSET)}
    seen = dict(measured["seen"])
    one_way = {name: [at for at in addresses if seen.get(at, 0) != 3] for name, addresses in branches.items()}
    return Cycles(
        measured,
        step,
        step_plays,
        step_undoes,
        step_any,
        max(worst),
        max(with_all),
        sum(worst),
        max(
            ticks(
                image,
                ONE_PLAY,
                measured["watch"]["worst"],
                measured["step_tip"]["worst"] + registers,
                measured["guard"]["worst"] + each.of("port_current_ma"),
            )
        ),
        {name: len(addresses) for name, addresses in branches.items()},
        {name: len(addresses) for name, addresses in one_way.items()},
        list(unexplained(BUILD / "cycles.elf", [at for addresses in one_way.values() for at in addresses]).values()),
    )


# -- the report -------------------------------------------------------------------------------------------------------


def rows() -> list[Row]:
    elf = BUILD / "tautline.elf"
    size = sizes(elf)
    ram_code_and_data = size[".data"]
    ram = ram_code_and_data + size[".bss"] + size[".ram_vector_table"]
    stack = Stack(BUILD)
    deepest = stack.of(TASK) + stack.of(USB_INTERRUPT) + stack.of(CONTROL) + 2 * EXCEPTION_FRAME
    address, calls = code(elf)
    ports = [name for name in address if name.startswith("port_")]
    control = reached(calls, [CONTROL, *(p for p in ports if p in PORT)])
    forbidden = sorted(name for name in control if NOT_ALLOWED.search(name))
    floats = sorted(name for name in address if re.match(r"__aeabi_[fd](add|sub|mul|div)", name))
    in_flash = sorted(name for name in control if address[name] >> 28 == 1)
    detector = sorted(name for name in reached(calls, [ONSET, ONSET_POLL]) if address[name] >> 28 == 1)
    cost = cycles()
    worst = {kind: values["worst"] for kind, values in cost.measured.items() if isinstance(values, dict)}
    has_cmsis = "arm_linear_interp_q31.c" in (BUILD / "build.ninja").read_text("utf-8")
    yardstick = "CMSIS-DSP's" if has_cmsis else "a plain loop's"
    share = 100.0 * CONTROL_HZ / CORE_HZ
    load = 100.0 * cost.millisecond * 1000 / CORE_HZ
    for label, names in (
        ("not allowed in the control path", forbidden),
        ("float code", floats),
        ("control path in flash", in_flash),
        ("onset detector in flash", detector),
        ("branches without a reason in tools/branches.py", [f"\n  {place}" for place in cost.unexplained]),
    ):
        if names:
            print(f"{label}: {', '.join(names)}")
    return [
        Row("loader", (BUILD / "loader.bin").stat().st_size, 2048, "bytes"),
        Row("image in a slot", (BUILD / "tautline-0.bin").stat().st_size, 94208, "bytes"),
        Row("RAM: code and initialised data", ram_code_and_data, 40960, "bytes"),
        Row("RAM with the stack", ram + size[".stack_dummy"], 160 * 1024, "bytes"),
        Row("stack, worst", deepest, size[".stack_dummy"], "bytes"),
        Row("float functions", len(floats), 0, ""),
        Row("control path: not allowed", len(forbidden), 0, "functions"),
        Row("control path: in flash", len(in_flash) + cost.measured["flash_fetches"], 0, "functions"),
        Row("onset detector: in flash", len(detector), 0, "functions"),
        Row("control step with tables, measured", worst["step_tip"], 600, "cycles"),
        Row("control step with tables, any path", cost.step, 600, "cycles"),
        Row("control step with tables, mean", cost.measured["step_tip"]["mean"], 500, "cycles"),
        Row("control step with several plays, measured", worst["step_plays"], 1200, "cycles"),
        Row("control step with several plays, any path", cost.step_plays, 1200, "cycles"),
        Row("control step with all that is undone, measured", worst["step_undoes"], 1200, "cycles"),
        Row("control step with all that is undone, any path", cost.step_undoes, 1200, "cycles"),
        Row("control step, other modes, measured", worst["step_other"], 2200, "cycles"),
        Row("calibration motion, measured", worst["motion"], 2000, "cycles"),
        Row("control step, calibration, any path", cost.step_any, 3300, "cycles"),
        Row("once a millisecond beside it, measured", worst["watch"], 1300, "cycles"),
        Row("the same with several plays", worst["watch_plays"], 1800, "cycles"),
        Row("the same with all that is undone", worst["watch_undoes"], 2100, "cycles"),
        Row("guards, once a millisecond, measured", worst["guard"], 700, "cycles"),
        Row(f"{AXES} axes at {CONTROL_HZ} Hz, any path", load, 25, "% of the core"),
        Row(f"{AXES} axes, worst tick, measured", share * cost.interrupt_measured, 25, "% of its period"),
        Row(f"{AXES} axes, worst tick, any path", share * cost.interrupt, 25, "% of its period"),
        Row("the same with all that is undone", share * cost.interrupt_undoes, 40, "% of its period"),
        Row("onset update, measured", worst["onset"], 2_000_000, "cycles"),
        *[
            Row(f"branches of the {name}, seen one way for a reason", cost.one_way[name], cost.branches[name], "")
            for name in ("step", "onset")
        ],
        Row("branches seen one way for no reason", len(cost.unexplained), 0, ""),
        Row(f"one look-up, measured; goal: {yardstick}", worst["lookup"], 120, "cycles", worst["lookup_yardstick"]),
    ]


def main() -> int:
    over = 0
    try:
        measured = rows()
    except Unbounded as unknown:
        raise SystemExit(f"budget: {unknown}: say in tools/budget.py how often, or where to") from unknown
    for row in measured:
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
    sys.exit(main())
