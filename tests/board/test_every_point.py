"""Whatever goes wrong at whatever point of a calibration, a flash, a follow or a stream: at rest within the time that
docs/safety.md states, named on the terminal with its remedy, the table whole, and the same command works after it.

The points are the events of a run without a fault (events.py): evenly spread, and each at which the axis begins to do
something else. All of them make minutes; each run of the tests takes another share for each fault, the same each time,
and `./run test long` the others.
"""

from __future__ import annotations

import contextlib
import io
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from events import PATIENCE_S, BoardTime, Events, HostDied, Look
from test_board_tables import model

from conftest import IN_QEMU, SIMULATED, Bench, bench_of
from tautline import tables
from tautline.cli import main
from tautline.device import wire
from tautline.device.board import Board
from tautline.device.usb_link import UsbLink
from tautline.live.session import MotionOptions, record_calibration
from tautline.live.setup import Live, PointSource
from tautline.simulated.instrument import preset
from tautline.simulated.simlink import SimulatedAxis

pytestmark = pytest.mark.minutes

EVEN = 12  # points evenly spread over a run
SHARES = 16  # of the points: the first is taken each time
RUN_DOWN_S = 0.11  # a motor that is switched off at its full speed, by its friction
BRAKING_S = 0.15  # within the limits, from any speed that these runs have
LAST_S = 1.1  # in which a command may end without a word of a fault: a calibration ends with a second of frames at rest
SEEN_S = 0.01  # between two looks, and the path's lead
OLD, NEW = model(), model(scale=0.7)
RANGE = 5000.0  # counts: the instrument's
MOVED = 8.0  # counts: the axis was told to move


# -- what goes wrong --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Ill:
    """`faults`: what it may be called, and within what time it is, s, from the moment on at which it shows."""

    happen: Callable[[Events], object]
    faults: dict[str, float]
    shows: str = "moving"  # as soon as the axis is told to move; driven: as soon as the motor is on; at once
    rest_s: float = RUN_DOWN_S  # from then on
    host: bool = False  # it is the host's, not the axis'
    says: str = ""  # the error of a host that is still there


def injected(name: str) -> Callable[[Events], object]:
    return lambda events: events.link.ask(f"inject 0 {name}")


# docs/safety.md. In the check, at low drive and without a motion, more time passes: 0.4 s either way and as much to
# brake.
WIRES = {"STALL": 0.45, "FOLLOWING": 0.45, "CURRENT": 0.45, "UNMOVED": 1.2, "REVERSED": 0.25, "SCALE": 1.2}
LOST = {"HOST_LOST": BRAKING_S}
GONE, SILENT = "the board is gone: check plug and power", "the host was lost|no set-points came for"
SILENT_S = 1.0  # that the host may be
SILENCE = {"HOST_LOST": SILENT_S + BRAKING_S}
ILLS = {
    "stall": Ill(injected("blocked"), WIRES),
    "encoder": Ill(injected("unplugged"), WIRES),
    "reversed": Ill(injected("reversed"), WIRES),
    "jump": Ill(injected("jump"), {"ENCODER": 0.005}, "at once"),
    "driver": Ill(injected("driver"), {"DRIVER": 0.01}, "driven"),
    "supply": Ill(injected("supply"), {"SUPPLY": 0.03}, "driven"),
    "silence": Ill(Events.silence, SILENCE, "at once", SILENT_S + BRAKING_S, True, SILENT),
    "cable": Ill(lambda events: events.link.ask("unplug"), LOST, "at once", BRAKING_S, True, GONE),
    "killed": Ill(Events.die, LOST, "at once", BRAKING_S, True),
    "power": Ill(lambda events: events.link.ask("cut 1"), {}, "at once", 0.0, True, GONE),
}
ON_A_LINE = ("serial", *IN_QEMU)  # which tells nobody of a host that is gone


def ill_of(name: str, board: str) -> Ill:
    """As the board notices it."""
    if board in ON_A_LINE and name in ("cable", "killed"):
        return replace(ILLS[name], faults=SILENCE, rest_s=SILENT_S + BRAKING_S)
    return ILLS[name]


OFF, CHECK = (wire.code("MODES", name) for name in ("OFF", "CHECK"))


# -- what is done -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Task:
    arguments: Callable[[Bench, Path], list[str]]
    ills: tuple[str, ...] = tuple(name for name in ILLS if name != "power")
    within: Callable[[Bench], contextlib.AbstractContextManager[Any]] = lambda bench: contextlib.nullcontext()
    moves: bool = True

    @property
    def tables(self) -> tuple[bytes, ...]:
        """The models of the tables that may be in use while it goes wrong; the last one when it has gone well."""
        return (tables.model_id(OLD),) if self.moves else (tables.model_id(OLD), tables.model_id(NEW))


def calibrate(bench: Bench, folder: Path) -> list[str]:
    return ["calibrate", "--simulate", "constant", "--thorough", "--speed", "4", "--out", str(folder / "model")]


def follow(bench: Bench, folder: Path) -> list[str]:
    t = np.array([0.0, 0.5, 0.7, 1.2, 1.4, 2.0, 2.2, 2.6])
    c = np.array([0.0, 12.0, 12.0, -6.0, -6.0, 9.0, 9.0, 0.0])
    np.savetxt(folder / "path.csv", np.column_stack([t, c]), delimiter=",", header="t_s,c_deg", comments="")
    preset("constant").rig.save(folder / "rig.toml")
    return [
        "follow",
        "--board",
        bench.where,
        "--rig",
        str(folder / "rig.toml"),
        "--trajectory",
        str(folder / "path.csv"),
    ]


def stream(bench: Bench, folder: Path) -> list[str]:
    return ["stream", "--board", bench.where, "--sine", "8", "2", "--duration", "2.6", "--rate", "50"]


def flash(bench: Bench, folder: Path) -> list[str]:
    if not (folder / "new").exists():
        NEW.save(folder / "new")
    return ["flash", str(folder / "new"), "--board", bench.where]


def by_board_time(bench: Bench) -> contextlib.AbstractContextManager[Any]:
    return BoardTime(bench.sim).of_stream()


def by_messages(bench: Bench) -> contextlib.AbstractContextManager[Any]:
    return patch.object(UsbLink, "tables", lambda link, axis: None)


TASKS = {
    "calibration": Task(calibrate),
    "follow": Task(follow),
    "stream": Task(stream, within=by_board_time),
    "flash": Task(flash, tuple(ILLS), moves=False),
    "flash-by-messages": Task(flash, tuple(ILLS), by_messages, moves=False),
}


class Recorded(BaseException):
    """The calibration's motion is over: what the fit makes of it is no matter of the board's."""


def only_record(live: Live, folder: Path, motion: MotionOptions, *_: object, **__: object) -> None:
    record_calibration(live, folder, replace(motion, cycles=1))
    raise Recorded


@contextmanager
def set_up(bench: Bench) -> Iterator[None]:
    """Live commands use this bench's board, and the calibration motion is the shortest."""

    @contextmanager
    def open_live(**_: object) -> Iterator[Live]:
        with bench.open() as board:
            instrument = preset("constant")
            plant = SimulatedAxis(bench.sim, instrument)
            yield Live(board, instrument.rig, 0, PointSource(plant), plant)

    with (
        patch("tautline.live.setup.open_live", open_live),
        patch("tautline.live.session.calibrate_live", only_record),
    ):
        yield


@dataclass(frozen=True)
class Said:
    """What a command left: exit status, its last line on stderr, what it printed; -1 where it was killed."""

    status: int
    error: str = ""
    printed: str = ""
    ended_s: float = 0.0  # board time


def terminal(*arguments: str) -> Said:
    errors, printed = io.StringIO(), io.StringIO()
    status: Any = 0
    with (
        patch.object(sys, "argv", ["taut", *arguments]),
        contextlib.redirect_stderr(errors),
        contextlib.redirect_stdout(printed),
    ):
        try:
            main()
        except SystemExit as left:
            status = left.code
        except Recorded:
            pass
        except HostDied:
            status = -1
    assert "Traceback" not in errors.getvalue() and "internal error" not in errors.getvalue()
    lines = errors.getvalue().strip().splitlines()
    return Said(int(status or 0), lines[-1] if lines else "", printed.getvalue())


# -- a case -----------------------------------------------------------------------------------------------------------


def in_store(board: Board) -> bytes:
    """The model of the table in use: the blob is whole, or this fails."""
    return tables.decode(board.read_table(0)).model_id


def begin(bench: Bench) -> None:
    """At 0, with the old table. Motor and encoder are to be checked again."""
    with bench.open() as board:
        bench.ready(board)
        board.load_table(0, tables.encode(OLD, created_s=0))
        board.ask("servo", **board.ask("get_servo", axis=0).values)


def shows_at(ill: Ill, looks: list[Look], fault: str) -> float:
    """When there was something to be seen of it, board time; infinite where there never was."""
    began = next((look.q_ref for look in looks if look.mode not in (OFF, CHECK)), 0.0)
    for look in looks:
        if ill.shows == "at once" or (ill.shows == "driven" and look.mode != OFF):
            return look.t_s
        if ill.shows == "moving":
            by_check = fault in ("UNMOVED", "REVERSED", "SCALE") and look.mode == CHECK
            if by_check or (look.mode not in (OFF, CHECK) and abs(look.q_ref - began) > MOVED):
                return look.t_s
    return np.inf


def rest_at(looks: list[Look]) -> float:
    """When the motor had moved last."""
    moving = [look.t_s for look in looks if abs(look.q - looks[-1].q) > 1.5]
    return moving[-1] if moving else looks[0].t_s


def run(bench: Bench, task: Task, folder: Path, events: Events) -> Said:
    with set_up(bench), task.within(bench), events.counted():
        said = terminal(*task.arguments(bench, folder))
    return replace(said, ended_s=bench.sim.ask("state")["board_us"] * 1e-6)


def mend(bench: Bench) -> None:
    """What a user does about the cause. A board without power starts again, and knows no position then."""
    bench.sim.ask("inject 0 well")
    bench.sim.ask("cut 0")  # where nothing was written any more
    bench.sim.ask("plug")
    if not bench.sim.ask("state")["powered"]:
        bench.sim.ask("reset")
    bench.run(0.1)


def knows_where(bench: Bench, board: Board) -> None:
    """A position that the axis trusts is the motor's."""
    status = board.status(0)
    if status.flags & wire.code("FLAGS", "REFERENCED"):
        assert status.q == pytest.approx(bench.sim.ask("state")["q"][0] / 256.0, abs=2.0)


def find_again(bench: Bench) -> None:
    """Homes it; turns it back by hand where it has run out of the rig's range."""
    with bench.open() as board:
        status = board.status(0)
        if not status.flags & wire.code("FLAGS", "REFERENCED") or abs(status.q) > RANGE:
            bench.sim.ask("place 0 0")
            board.ask("set_position", axis=0, q=0.0)


def is_named(status: wire.Message, said: Said, cleared: Said) -> None:
    """In the one line of the command's error, with what was measured and what to do; what comes when the command has
    nothing to ask any more, by `taut clear`."""
    fault = wire.fault(status)
    assert fault in cleared.printed
    if said.status == 0:
        assert said.ended_s - status.fault_us * 1e-6 < LAST_S
        return
    assert said.status == 1 and said.error.startswith("taut: axis 0 has stopped: ")
    assert fault in said.error and "taut clear" in said.error


def rests_in_time(ill: Ill, looks: list[Look], status: wire.Message) -> None:
    """Noticed, off and at rest."""
    name = next(name for name, (code, _) in wire.wire.FAULTS.items() if code == status.fault)
    assert name in ill.faults
    shows_s = shows_at(ill, looks, name)
    assert status.fault_us * 1e-6 - shows_s <= ill.faults[name] + SEEN_S
    assert rest_at(looks) - shows_s <= ill.faults[name] + ill.rest_s + SEEN_S
    assert not status.flags & wire.code("FLAGS", "ENABLED")


def had_nothing_to_notice(ill: Ill, looks: list[Look]) -> None:
    """No fault: nothing was to be seen of it for as long as it takes; without its host, an axis whose motion is over or
    that only follows is at rest all the same, and holds."""
    if ill.host:
        gone = [look for look in looks if look.t_s < looks[0].t_s + PATIENCE_S]  # one that was silent is there again
        assert rest_at(gone) - looks[0].t_s <= ill.rest_s + SEEN_S
    else:
        driven = [look.t_s for look in looks if look.mode != OFF]
        assert not driven or driven[-1] - shows_at(ill, looks, "") <= max(ill.faults.values()) + SEEN_S


def try_point(request: pytest.FixtureRequest, task: Task, name: str, at: int, folder: Path) -> None:
    ill = ill_of(name, request.config.getoption("--board"))
    with bench_of(request, axes=1) as bench:
        begin(bench)
        share = np.random.default_rng(at).uniform(0.05, 0.95)
        in_grants = name == "silence" and task.moves
        events = Events(bench.sim, at, lambda events: ill.happen(events), share, in_grants)
        said = run(bench, task, folder, events)
        if events.happened < 0:
            assert in_grants and said.status == 0  # no time was left to be silent in
            return
        events.afterwards(1.5)
        looks = events.looks[events.happened :]
        lost = not bench.sim.ask("state")["powered"]
        mend(bench)
        with bench.open() as board:
            status = board.status(0)
            assert in_store(board) in task.tables
            knows_where(bench, board)
        cleared = terminal("clear", "--board", bench.where)
        assert cleared.status == 0
        if status.fault:
            rests_in_time(ill, looks, status)
            if not ill.host:
                is_named(status, said, cleared)
        elif not lost:
            had_nothing_to_notice(ill, looks)
        if ill.host and said.status == 1:
            assert re.search(ill.says, said.error), said.error
        assert task.moves or np.ptp([look.q for look in looks]) == 0.0
        find_again(bench)
        folder = folder / "again"
        folder.mkdir()
        again = run(bench, task, folder, Events(bench.sim))
        assert again.status == 0, again.error
        with bench.open() as board:
            assert in_store(board) == task.tables[-1]


_POINTS: dict[tuple[str, str], list[int]] = {}


def points(request: pytest.FixtureRequest, name: str, folder: Path) -> list[int]:
    """The events of a run without a fault that are tried."""
    key = (request.config.getoption("--board"), name)
    if key not in _POINTS:
        with bench_of(request, axes=1) as bench:
            begin(bench)
            events = Events(bench.sim, all_looks=True)
            assert run(bench, TASKS[name], folder, events).status == 0
        count = len(events.names)
        even = np.linspace(0, count - 1, min(EVEN, count)).round().astype(int)
        _POINTS[key] = sorted({*even.tolist(), *(events.changes() if TASKS[name].moves else range(count))})
    return _POINTS[key]


SHARE = [pytest.param(i, marks=[pytest.mark.long] if i else []) for i in range(SHARES)]


@pytest.mark.parametrize("share", SHARE)
@pytest.mark.parametrize(("doing", "name"), [(doing, name) for doing, task in TASKS.items() for name in task.ills])
def test_whatever_goes_wrong_at_any_point(
    request: pytest.FixtureRequest, tmp_path: Path, doing: str, name: str, share: int
) -> None:
    if request.config.getoption("--board") not in SIMULATED:
        pytest.skip("needs a board of our own")
    if name == "jump" and request.config.getoption("--board") == "emulated":
        pytest.skip("an emulated encoder does not jump")
    (tmp_path / "whole").mkdir()
    first = (share + 5 * list(ILLS).index(name)) % SHARES
    for at in points(request, doing, tmp_path / "whole")[first::SHARES]:
        folder = tmp_path / f"before-{at}"
        folder.mkdir()
        try:
            try_point(request, TASKS[doing], name, at, folder)
        except BaseException as error:
            error.add_note(f"{name} before event {at} of {doing}")
            raise
