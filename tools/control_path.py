"""What no path through the control step exceeds, by chip: what bound.py has to be told, and the sums over ticks."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tools.bound import NEVER, Bound, Code, Knowledge
from tools.cores import M0PLUS, M33, Core

ROOT = Path(__file__).resolve().parents[1]
CONTROL = "control_interrupt"  # what the timer interrupt runs
AXES = 4
CONTROL_HZ = 5000

STEP = "tl_axis_step"
CLEARED = 64  # bytes at most that the control path clears at once
ROM_MEMSET = 200  # cycles of the boot ROM's memset for them

# Most times that the loops of the control path go back.
LOOPS = {
    "tl_app_control": (AXES, 1, 1),  # one axis is watched in a tick, and one guarded
    "come_late": (AXES,),
    "tl_elements_ahead": (6,),  # as many elements as a table has, but the first
    "tl_elements_behind": (7,),
    "tl_stop_watch": (AXES, AXES),
    "tl_stop_group": (AXES,),
    "tl_undo_join": (3,),  # joints
    "tl_axis_join": (3,),  # the same
    "tl_undo_late": (4,),  # followers
    "tl_undo_pushing": (2,),  # as many rounds as the watch asks for
    "tl_history_push": (2,),  # pushed once a millisecond and jitter
    "port_encoder": (4,),  # the state machine leaves its count within 11 cycles of its own, a round here takes 5
    "bridge_sense_finish": (5,),  # four samples are in the FIFO, and one may come meanwhile
    CONTROL: (1,),  # its alarm passed while it was set; the next one is a period away
    "port_time_us": (2,),  # the high word changes once in 71 minutes
}


@dataclass(frozen=True)
class Chip:
    """exception: cycles into the interrupt and back. bus_wait: those that a peripheral's register takes longer than
    RAM. loops, known: what bound.py is told of every function."""

    name: str
    core: Core
    core_hz: int
    exception: int
    bus_wait: int
    loops: Mapping[str, Sequence[int]]
    known: Mapping[str, int]

    @property
    def build(self) -> Path:
        return ROOT / "build" / self.name

    def cycles(self, at_125_mhz: int) -> int:
        """As long as so many cycles of an RP2040."""
        return at_125_mhz * self.core_hz // RP2040.core_hz

    def code(self, program: str) -> Code:
        return Code(self.build / f"{program}.elf", self.core)


RP2040 = Chip("rp2040", M0PLUS, 125_000_000, 2 * 15, 3, LOOPS, {"__wrap_memset": ROM_MEMSET})
# An exception takes a Cortex-M33 12 cycles where stack, vectors and code have a bus each; here eight words and a vector
# share the code's. A register: twice the four cycles of the APB bridge (RP2350 data sheet, 2.1.4), as the write before
# may be under way.
RP2350 = Chip(
    "rp2350",
    M33,
    150_000_000,
    2 * (12 + 9 + 3),
    8,
    LOOPS
    | {
        "memset": (CLEARED, CLEARED // 4, 3),  # bytes where it is not aligned; words; the bytes behind them
        "bridge_sense_finish": (9,),  # its FIFO holds eight
    },
    {},
)
CHIPS = {chip.name: chip for chip in (RP2040, RP2350)}

# What a table never comes to that undoes no more than the play and the curve; and one that has a single play.
UNDONE = ("angle", "join", "late", "weigh", "wider", "turned", "anew", "scaled", "reading", "pushing", "tick")
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


def bound(chip: Chip, code: Code, ports: Sequence[str], **known: int) -> Bound:
    calls_port = re.compile(r"tl_axis_|tl_stop_|drive$|tl_app_control$")
    return Bound(
        code,
        Knowledge(
            loops=chip.loops,
            known={**chip.known, **known},
            pointers={name: ports for name in code.starts if calls_port.match(name)},
            waits=dict.fromkeys(REGISTERS, chip.bus_wait),
        ),
    )


def step_bound(chip: Chip, code_: Code, ports: Sequence[str], job: str, **known: int) -> int:
    """Of the control step in the tick of `job`, a fault included; "": of a tick without a job."""
    never = {other: NEVER for other in (*JOBS, *([] if job == JOBS[0] else [BEGIN])) if other != job}
    return bound(chip, code_, ports, **never, **known).of(STEP)


@dataclass
class Bounds:
    """Of the control step: what no path exceeds, cycles."""

    step: int  # encoder value to duty
    step_plays: int  # with several plays
    step_undoes: int  # with all that tables undo
    step_any: int  # calibration motion included
    interrupt: int  # AXES axes, from the request to the return, registers included
    interrupt_undoes: int  # the same with several plays and all that tables undo
    millisecond: int  # the same over the ticks of a millisecond


def ticks(
    chip: Chip,
    image: Code,
    plays: dict[str, int],
    watch: int | None = None,
    step: int | None = None,
    guard: int | None = None,
) -> list[int]:
    """Bounds of the control interrupt's cycles in each tick of a millisecond, where AXES axes follow by tables; with
    measured values in place of the bounds of a step, watch or guard, the registers' cycles included."""
    if gone := [name for name in (*JOBS, BEGIN, WATCH, GUARD, FAIL, LATE, TRIAL, STOP) if name not in image.starts]:
        raise SystemExit(f"budget: no function {', '.join(gone)} in the image: mend JOBS")
    count = CONTROL_HZ // 1000
    jobs = [*JOBS, *[""] * (count - len(JOBS))]
    # An axis that fails for a late tick does so after more than a hundred lost periods: nobody waits for that one.
    tick = bound(chip, image, PORT, **{STEP: 0, WATCH: 0, GUARD: 0, STOP: 0, LATE: NEVER}).of(CONTROL) + chip.exception
    steps = [
        step_bound(chip, image, PORT, job, **{CALIBRATION: NEVER, **plays}) if step is None else step for job in jobs
    ]
    watch = bound(chip, image, PORT, **plays).of(WATCH) if watch is None else watch
    guard = bound(chip, image, PORT, **{FAIL: NEVER, TRIAL: NEVER}).of(GUARD) if guard is None else guard
    stop = bound(chip, image, PORT, **{FAIL: NEVER}).of(STOP)
    return [
        tick
        + (stop if (at + 1) % count == count - 1 else 0)
        + sum(steps[(at - axis) % count] for axis in range(AXES))
        + (watch if (at + 1) % count < AXES else 0)
        + (guard if (at + 1 - GUARD_LATER) % count < AXES else 0)
        for at in range(count)
    ]


def bounds(chip: Chip, image: Code, stand_in: Code | None) -> Bounds:
    """With the stand-in's port in the step's own bounds, or none of a port where there is no stand-in."""
    worst, with_all = ticks(chip, image, ONE_PLAY), ticks(chip, image, {})
    alone, ports, given = (image, PORT, dict.fromkeys(PORT, 0)) if stand_in is None else (stand_in, STAND_IN_PORT, {})
    step, step_plays, step_undoes = (
        max(step_bound(chip, alone, ports, job, **{CALIBRATION: NEVER, **plays, **given}) for job in JOBS)
        for plays in (ONE_PLAY, PLAYS_ALONE, {})
    )
    step_any = bound(chip, alone, ports, **given).of(STEP)
    return Bounds(step, step_plays, step_undoes, step_any, max(worst), max(with_all), sum(worst))
