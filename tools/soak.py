"""Long lives of a board at work: teleoperation of two axes in virtual time, while what can go wrong does, at random.

    ./run trust soak [--hours 8] [--board desktop|emulated] [--seed 1] [--at SEED:STEP]

A life is ten minutes on a fresh board (two and a half on the emulated one): an operator's set-points at 50 Hz on both
axes, one through the tables, and every few seconds a mishap: the cable pulled, the host killed or silent, the power cut
in a flash operation or while it moves, an encoder that drops out, the stop button, a driver, a supply, a motor that is
blocked, a main loop that hangs. After each the host does what the board says and goes on. What must hold is looked at
in every 20 ms of it, as tests/c/test_random.c does in every control step of a board without a bus. Lives differ by
their seed alone and nothing in them goes by the wall clock: a failure prints SEED:STEP, and --at lives that life again
up to there and says each step. Ctrl-C ends it, and what was lived by then is told.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import Progress

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from tautline import tables  # noqa: E402
from tautline.device import wire  # noqa: E402
from tautline.device.board import Board, BoardGone, BoardRefused, open_board  # noqa: E402
from tautline.errors import TautError  # noqa: E402
from tautline.model import Model  # noqa: E402
from tautline.simulated.instrument import preset, reference_rig  # noqa: E402
from tautline.simulated.simlink import PROGRAM, DesktopBoard, SimLink  # noqa: E402
from tools.kept import keep  # noqa: E402

AXES = 2
LIFE_S = {"desktop": 600.0, "emulated": 150.0}  # board time of one
SLICE_US = 20_000  # a set-point, and a look at what holds
LISTEN = 25  # slices from one look at what the board says to the next: a read that brings nothing takes a millisecond
AHEAD_US = 40_000  # that set-points are sent before they hold: two periods, as docs/protocol.md asks
DEGREE, COUNT = 65536, 256  # a set-point's value: deg Q16 or counts Q8, by what `follow` said
SWEEP = 25.0  # deg, and
REACH = 3000.0  # counts to either side: well within tables and range
DUTY = 0.8  # the most of the settings, which drives at
SPEED = 8000.0  # counts/s with all of their acceleration
MOST_DUTY = int(32768 * DUTY) + 33  # and a thousandth: a bridge's PWM is seen in whole steps
LATEST_S = 1.15  # after its last word, with the braking: docs/safety.md, the host dies
LATCH_US = 1000  # several periods of the PWM: from the next one on a bridge has the duty that it was given
LAG_US = 1000  # by which what the board says of its position may be older than where the motor is
SETTLED = 2.0  # counts that a motor at rest may still be seen to move, by rounding
GRID = np.linspace(-5.0, 5.0, 257)
OFF = wire.code("MODES", "OFF")
WIRES = {"STALL", "FOLLOWING", "CURRENT", "ENCODER", "EDGES", "UNMOVED", "SCALE", "REVERSED"}
HOST = {"HOST_LOST"}


class Broken(Exception):
    """What did not hold."""


def blob(axis: int, scale: float) -> bytes:
    instrument = preset("reference", reference_rig(), 0)
    width = instrument.backlash(GRID) * scale
    model = Model(instrument.rig, GRID, width, 0.001 + 0 * GRID, instrument.bend(GRID), 0.08, (-4.5, 4.5))
    return tables.encode(model, axis=axis, created_s=0)


@dataclass
class Life:
    """One board's. `step` counts mishaps; what they may be called is in `allowed` until they are mended."""

    process: DesktopBoard
    seed: int
    say: Callable[[str], None]
    step: int = 0
    seconds: float = 0.0
    allowed: set[str] = field(default_factory=set)
    seen: Counter[str] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        self.link: SimLink = self.process.link()
        self.random = random.Random(self.seed)
        self.board: Board | None = None
        self.now_us = 0  # the board's clock
        self.true: list[float] = [0.0] * AXES  # counts, of the last slice
        self.way = [0.0] * AXES  # of it, in the last slice
        self.known = [False] * AXES  # nothing has spoilt the position since it was set
        self.phase = [0.0] * AXES
        self.table = {axis: blob(axis, 1.0) for axis in range(AXES)}

    # -- time, and what holds ------------------------------------------------------------------------------------

    def pass_by(self, seconds: float, look: bool = True) -> None:
        for _ in range(max(1, round(seconds * 1e6 / SLICE_US))):
            passed, state = self.link.ask_all(f"advance {SLICE_US}", "state")
            self.seconds += SLICE_US * 1e-6
            for axis, row in enumerate(passed["q"][:AXES]):
                if row:
                    self.way[axis] = (max(row) - min(row)) / COUNT
                    self.true[axis] = row[-1] / COUNT
            if look and any(each["mode"] == OFF and each["duty_q15"] for each in state["axes"][:AXES]):
                _, state = self.link.ask_all(f"advance {LATCH_US}", "state")
                self.seconds += LATCH_US * 1e-6
            if look:
                self.look(state)

    def look(self, state: dict[str, Any]) -> None:
        self.now_us = state["board_us"]
        if not state["powered"]:
            return
        for axis, each in enumerate(state["axes"][:AXES]):
            fault = wire.name("FAULTS", each["fault"])
            off = each["mode"] == OFF
            self.holds(off or fault == "NONE", f"axis {axis} has the fault {fault} and is driven")
            self.holds(not off or each["duty_q15"] == 0, f"axis {axis} is off, at duty {each['duty_q15']}")
            self.holds(abs(each["duty_q15"]) <= MOST_DUTY, f"axis {axis} is at duty {each['duty_q15']}")
            self.holds(fault == "NONE" or fault in self.allowed, f"axis {axis} has the fault {fault} for no reason")
            referenced = bool(each.get("flags", 0) & wire.code("FLAGS", "REFERENCED"))  # the image's are not shown
            if referenced and self.known[axis] and not off:
                apart = each["q_q8"] / COUNT - self.true[axis]
                lag = 2.0 + self.way[axis] * LAG_US / SLICE_US
                self.holds(abs(apart) < lag, f"axis {axis} is {apart:.1f} counts off where it says that it is")
                self.holds(abs(self.true[axis]) < 2.0 * REACH, f"axis {axis} is at {self.true[axis]:.0f} counts")
            if fault != "NONE":
                self.seen[fault] += 1

    def holds(self, what: bool, otherwise: str) -> None:
        if not what:
            raise Broken(otherwise)

    def rests(self, after_s: float) -> None:
        """So long after now nothing moves, and it stays so."""
        self.pass_by(after_s)
        before = list(self.true)
        self.pass_by(0.2)
        for axis in range(AXES):
            moved = abs(self.true[axis] - before[axis])
            self.holds(moved <= SETTLED, f"axis {axis} moved {moved:.1f} counts where it had to rest")

    # -- the host ------------------------------------------------------------------------------------------------

    @property
    def host(self) -> Board:
        assert self.board is not None
        return self.board

    def begin(self) -> None:
        self.arrive()
        for axis in range(AXES):
            own = dict(self.host.ask("get_settings", axis=axis).values)
            own |= {"duty": DUTY, "speed_s": SPEED, "commissioned": 1, "key": wire.wire.KEY}
            self.host.ask("settings", **own, timeout_s=5.0)
            self.host.load_table(axis, self.table[axis])
        self.work()

    def arrive(self) -> None:
        self.leave()
        self.board = open_board(self.process.where)

    def leave(self) -> None:
        if self.board is not None:
            self.board.close()
            self.board = None

    def work(self) -> None:
        """Clears, says where the axes stand, switches on and follows."""
        for axis in range(AXES):
            status = self.host.status(axis)
            if status.fault:
                self.host.ask("clear_fault", axis=axis)
        self.allowed = set()
        for axis in range(AXES):
            self.host.ask("enable", axis=axis, on=0)
        self.pass_by(0.5)
        for axis in range(AXES):
            if not self.host.status(axis).flags & wire.code("FLAGS", "REFERENCED"):
                self.link.ask(f"place {axis} 0")
                self.host.ask("set_position", axis=axis, q=0.0)
                self.true[axis], self.known[axis] = 0.0, True
            self.host.switch_on(axis, self.pass_by)
        for axis in range(AXES):
            self.host.ask("move", axis=axis, q=0.0)
        self.until_held()
        for axis in range(AXES):
            self.host.ask("follow", axis=axis, target=int(axis == 0), compensation=2, silence_us=0)
            self.phase[axis] = 0.0

    def until_held(self) -> None:
        for _ in range(500):
            modes = {int(self.host.status(axis).mode) for axis in range(AXES)}
            if modes == {wire.code("MODES", "HOLD")}:
                return
            self.pass_by(SLICE_US * 1e-6)
        raise Broken("a move has not arrived within 10 s")

    def teleoperate(self, seconds: float) -> None:
        """Strokes of an operator's hand: both axes, at a rate that changes from one to the next, with pauses."""
        rate = [self.random.uniform(0.3, 2.5) for _ in range(AXES)]
        pause = self.random.random() < 0.2
        for each in range(round(seconds * 1e6 / SLICE_US)):
            points = []
            for axis in range(AXES):
                self.phase[axis] += 0.0 if pause else rate[axis] * SLICE_US * 1e-6
                hand = float(np.sin(self.phase[axis]))
                value = int(hand * (SWEEP * DEGREE if axis == 0 else REACH * COUNT))
                points.append({"axis": axis, "value": value, "at_us": self.now_us + AHEAD_US})
            self.host.tell_all("set_point", points)
            self.pass_by(SLICE_US * 1e-6)
            if each % LISTEN == 0:
                self.host.poll(0.0)
        self.seen["following, s"] += round(seconds)

    # -- what goes wrong -----------------------------------------------------------------------------------------

    def well(self) -> None:
        for axis in range(AXES):
            self.link.ask(f"inject {axis} well")
        self.pass_by(0.1)

    def cable(self) -> None:
        self.allowed = HOST
        self.link.ask("unplug")
        self.rests(LATEST_S)
        self.leave()
        self.link.ask("plug")
        self.arrive()

    def killed(self) -> None:
        self.allowed = HOST
        self.leave()
        self.rests(LATEST_S)
        self.arrive()

    def silent(self) -> None:
        self.allowed = HOST
        self.rests(LATEST_S)

    def power(self) -> None:
        self.link.ask("reset")
        self.known = [False] * AXES
        self.leave()
        self.pass_by(0.2, look=False)
        self.arrive()
        self.stored(list(self.table.values()))

    def cut(self) -> None:
        """While a table is written."""
        axis = self.random.randrange(AXES)
        for each in range(AXES):
            self.host.ask("enable", axis=each, on=0)
        self.pass_by(0.5)
        new = blob(axis, self.random.uniform(0.5, 1.2))
        self.link.ask(f"cut {self.random.randint(1, 20)}")
        try:
            self.host.load_table(axis, new)
        except TautError:
            self.seen["tables cut"] += 1
        self.link.ask("cut 0")
        self.link.ask("reset")
        self.known = [False] * AXES
        self.leave()
        self.arrive()
        found = self.host.read_table(axis)
        self.holds(found in (self.table[axis], new), f"axis {axis} has neither the old table nor the new one")
        self.table[axis] = found
        self.stored(list(self.table.values()))

    def stored(self, expected: list[bytes]) -> None:
        for axis in range(AXES):
            self.holds(self.host.read_table(axis) == expected[axis], f"axis {axis} has lost its table")
            own = self.host.ask("get_settings", axis=axis)
            self.holds(own.commissioned == 1, f"axis {axis} has lost its settings")

    def dropout(self) -> None:
        axis = self.random.randrange(AXES)
        self.allowed = WIRES | HOST
        self.known[axis] = False
        self.link.ask(f"inject {axis} {self.random.choice(('unplugged', 'coarse'))}")
        self.pass_by(self.random.uniform(0.02, 0.5))
        self.well()
        self.host.ask("safe_stop", axis=axis)
        self.allowed |= {"STOPPED"}
        self.pass_by(0.3)
        self.host.ask("clear_fault", axis=axis)
        self.link.ask(f"place {axis} 0")
        self.host.ask("set_position", axis=axis, q=0.0)
        self.true[axis], self.known[axis] = 0.0, True

    def injected(self, ill: str, faults: set[str]) -> None:
        axis = self.random.randrange(AXES)
        self.allowed = faults | HOST
        self.link.ask(f"inject {axis} {ill}")
        self.pass_by(self.random.uniform(0.05, 1.5))
        self.well()

    def stop(self) -> None:
        self.allowed = {"ESTOP"} | HOST
        self.link.ask("inject 0 estop")
        self.pass_by(0.02, look=False)
        state = self.link.ask("state")
        for axis, each in enumerate(state["axes"][:AXES]):
            self.holds(each["mode"] == OFF, f"axis {axis} is driven though the stop button is pressed")
        self.rests(0.3)
        self.well()

    def hung(self) -> None:
        self.allowed = {"WATCHDOG"}
        self.link.ask("hang")
        self.known = [False] * AXES
        self.pass_by(1.5, look=False)
        self.leave()
        self.arrive()
        self.stored(list(self.table.values()))

    def live(self, last: int | None, least_s: float) -> None:
        """For so long, or up to a step. Broken: what did not hold; TautError: what the board refused."""
        self.begin()
        names = list(MISHAPS)
        while self.seconds < least_s and (last is None or self.step <= last):
            self.teleoperate(self.random.uniform(1.0, 8.0))
            name = self.random.choice(names)
            self.step += 1
            self.say(f"{self.seed}:{self.step} after {self.seconds:.2f} s: {name}")
            self.seen[name] += 1
            MISHAPS[name](self)
            self.work()


MISHAPS: dict[str, Callable[[Life], None]] = {
    "cable": Life.cable,
    "killed": Life.killed,
    "silent": Life.silent,
    "power": Life.power,
    "cut": Life.cut,
    "dropout": Life.dropout,
    "stop": Life.stop,
    "hung": Life.hung,
    "driver": lambda life: life.injected("driver", {"DRIVER"}),
    "supply": lambda life: life.injected("supply", {"SUPPLY"}),
    "blocked": lambda life: life.injected("blocked", WIRES),
}


def lived(seed: int, last: int | None, least_s: float, say: Callable[[str], None]) -> tuple[Life, str]:
    """A life, and what broke in it."""
    with DesktopBoard(axes=AXES) as process:
        life = Life(process, seed, say)
        try:
            life.live(last, least_s)
        except (Broken, TautError, BoardGone, BoardRefused) as error:
            return life, f"{seed}:{life.step}: {error}"
        finally:
            life.leave()
            life.link.close()
    return life, ""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, help="of board time; 8, on the emulated board 0.5")
    parser.add_argument("--board", choices=("desktop", "emulated"), default="desktop")
    parser.add_argument("--seed", type=int, default=1, help="of the first life; the next ones count on")
    parser.add_argument("--at", metavar="SEED:STEP", help="this life again, up to this step")
    options = parser.parse_args()
    if options.board == "emulated":
        os.environ[PROGRAM] = str(ROOT / "tools" / "emulator" / "board.js")
    if options.at:
        seed, _, step = options.at.partition(":")
        life, broken = lived(int(seed), int(step), LIFE_S[options.board], print)
        print(broken or f"{options.at}: nothing broke in {life.seconds:.0f} s")
        return 1 if broken else 0
    left_s = 3600.0 * (options.hours or (8.0 if options.board == "desktop" else 0.5))
    seen: Counter[str] = Counter()
    failures, lived_s, seed, began = [], 0.0, options.seed, time.monotonic()
    with Progress(transient=True) as progress, contextlib.suppress(KeyboardInterrupt):  # Ctrl-C: as far as it came
        task = progress.add_task("board time", total=left_s)
        while lived_s < left_s:
            life, broken = lived(seed, None, min(LIFE_S[options.board], left_s - lived_s), lambda _: None)
            seen += life.seen
            failures += [broken] if broken else []
            lived_s, seed = lived_s + max(life.seconds, 1.0), seed + 1
            progress.update(task, completed=lived_s)
    mishaps = sum(seen[name] for name in MISHAPS)
    follows = f"{seen['following, s'] / 3600.0:.2f} h following"
    print(
        f"{options.board}: {lived_s / 3600.0:.2f} h in {time.monotonic() - began:.0f} s, {follows}, {mishaps} mishaps"
    )
    print("    " + ", ".join(f"{name} {seen[name]}" for name in MISHAPS))
    for each in failures:
        print(
            f"soak: {each} (again: ./run trust soak --board {options.board} --at {each.split(': ')[0]})",
            file=sys.stderr,
        )
    heads = ("board", "hours", "following", "mishaps", "of which", "failures")
    kinds = ", ".join(f"{name} {seen[name]}" for name in MISHAPS)
    kept = (options.board, f"{lived_s / 3600.0:.2f}", follows, mishaps, kinds, "; ".join(failures) or "none")
    keep("soak", heads, [kept])
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
