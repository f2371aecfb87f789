"""Whatever goes wrong at whatever point of a calibration, a flash or a follow: at rest within the time that
docs/safety.md states, named on the terminal with its remedy, the table whole, and the same command works after it.

The points are the events of a run without a fault (events.py): evenly spread, and each at which the axis begins to do
something else. All of them make minutes; each run of the tests takes another share for each fault, the same each time,
and `./run test long` the others.
"""

from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from events import Events, HostDied, Look
from test_tables import model

from conftest import SIMULATED, Bench, bench_of
from tautline import tables
from tautline.cli import main
from tautline.device import wire
from tautline.device.board import Board
from tautline.device.usb_link import UsbLink
from tautline.errors import TautError
from tautline.live.session import MotionOptions, record_calibration
from tautline.live.setup import Live, PointEye
from tautline.simulated.instrument import preset
from tautline.simulated.simlink import Plant

EVEN = 12  # points evenly spread over a run
SHARES = 12  # of the points: the first is taken each time
RUN_DOWN_S = 0.11  # a motor that is switched off at its full speed, by its friction
BRAKING_S = 0.15  # within the limits, from any speed that these runs have
SEEN_S = 0.01  # between two looks, and the path's lead
OLD, NEW = model(), model(scale=0.7)
MOVED = 8.0  # counts: the axis was told to move


# -- what goes wrong --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Ill:
    """`faults`: what it may be called, and within what time it is, s, from the moment on at which it shows."""

    happen: Callable[[Events], object]
    faults: dict[str, float]
    shows: str = "moving"  # as soon as the axis is told to move; driven: as soon as the motor is on; at once
    rest_s: float = RUN_DOWN_S  # to rest, from then on
    says: str = "has stopped"


def injected(name: str) -> Callable[[Events], object]:
    return lambda events: events.link.ask(f"inject 0 {name}")


# In the check, at low drive and without a motion, more time passes: 0.4 s either way and as much to brake.
WIRES = {"STALL": 0.4, "FOLLOWING": 0.4, "CURRENT": 0.4, "UNMOVED": 1.2, "REVERSED": 0.25}
LOST = {"HOST_LOST": BRAKING_S}
ILLS = {
    "stall": Ill(injected("blocked"), WIRES),
    "encoder": Ill(injected("unplugged"), WIRES),
    "reversed": Ill(injected("reversed"), WIRES),
    "jump": Ill(injected("jump"), {"ENCODER": 0.005}, "at once"),
    "driver": Ill(injected("driver"), {"DRIVER": 0.01}, "driven"),
    "supply": Ill(injected("supply"), {"SUPPLY": 0.03}, "driven"),
    "silence": Ill(Events.silence, {"HOST_LOST": 1.0 + BRAKING_S}, "moving", 0.0),
    "cable": Ill(lambda events: events.link.ask("unplug"), LOST, "at once", 0.0, "the board is gone: check plug"),
    "killed": Ill(Events.die, LOST, "at once", 0.0, ""),
    "power": Ill(lambda events: events.link.ask("cut 1"), {}, "at once", 0.0, "the board is gone: check plug"),
}


# -- what is done -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Task:
    arguments: Callable[[Bench, Path], list[str]]
    ills: tuple[str, ...] = tuple(name for name in ILLS if name != "power")
    within: Callable[[], contextlib.AbstractContextManager[Any]] = contextlib.nullcontext
    moves: bool = True


def calibrate(bench: Bench, folder: Path) -> list[str]:
    return ["calibrate", "--simulate", "constant", "--thorough", "--speed", "2", "--out", str(folder / "model")]


def follow(bench: Bench, folder: Path) -> list[str]:
    t = np.array([0.0, 0.5, 0.7, 1.2, 1.4, 2.0, 2.2, 2.6])
    c = np.array([0.0, 12.0, 12.0, -6.0, -6.0, 9.0, 9.0, 0.0])
    np.savetxt(folder / "path.csv", np.column_stack([t, c]), delimiter=",", header="t_s,c_deg", comments="")
    preset("constant").rig.save(folder / "rig.toml")
    return ["follow", "--board", bench.where, "--rig", str(folder / "rig.toml"), "--trajectory", str(folder / "path.csv")]


def flash(bench: Bench, folder: Path) -> list[str]:
    if not (folder / "new").exists():
        NEW.save(folder / "new")
    return ["flash", str(folder / "new"), "--board", bench.where]


def by_messages() -> contextlib.AbstractContextManager[Any]:
    return patch.object(UsbLink, "tables", lambda link, axis: None)


TASKS = {
    "calibration": Task(calibrate),
    "follow": Task(follow),
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
            plant = Plant(bench.sim, instrument)
            yield Live(board, instrument.rig, 0, PointEye(plant), plant)

    with (
        patch("tautline.live.setup.open_live", open_live),
        patch("tautline.live.session.calibrate_live", only_record),
    ):
        yield


def terminal(*arguments: str) -> tuple[int, str]:
    """Exit status, and the last line on stderr."""
    said = io.StringIO()
    status: Any = 0
    with (
        patch.object(sys, "argv", ["taut", *arguments]),
        contextlib.redirect_stderr(said),
        contextlib.redirect_stdout(io.StringIO()),
    ):
        try:
            main()
        except SystemExit as left:
            status = left.code
    lines = said.getvalue().strip().splitlines()
    return int(status or 0), lines[-1] if lines else ""


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
    off, checks = wire.code("MODES", "OFF"), wire.code("MODES", "CHECK")
    first, *_ = looks
    for look in looks:
        if ill.shows == "at once" or (ill.shows == "driven" and look.mode != off):
            return look.t_s
        if ill.shows == "moving":
            by_check = fault in ("UNMOVED", "REVERSED") and look.mode == checks
            if by_check or (look.mode not in (off, checks) and abs(look.q_ref - first.q_ref) > MOVED):
                return look.t_s
    return np.inf


def rest_at(looks: list[Look]) -> float:
    """When the motor had moved last."""
    moving = [look.t_s for look in looks if abs(look.q - looks[-1].q) > 1.5]
    return moving[-1] if moving else looks[0].t_s


def run(bench: Bench, task: Task, folder: Path, events: Events) -> tuple[int, str]:
    """The command with these events; a host that died leaves the board as the system does, without a word."""
    with set_up(bench), task.within(), events.counted():
        try:
            return terminal(*task.arguments(bench, folder))
        except Recorded:
            return 0, ""
        except HostDied:
            return -1, ""


def mended(bench: Bench, power: bool) -> None:
    bench.sim.ask("inject 0 well")
    bench.sim.ask("plug")
    if not power:
        bench.sim.ask("reset")
    bench.run(0.1)


def named(ill: Ill, status: wire.Message, says: str) -> str:
    """The fault, as the terminal must say it: in one line, with what was measured and what to do."""
    name = next(name for name, (code, _) in wire.wire.FAULTS.items() if code == status.fault)
    assert name in ill.faults, f"{name}: {says}"
    if ill.says == "has stopped":
        assert says.startswith("taut: axis 0 has stopped: ") and wire.fault(status) in says and "taut clear" in says
    return name


def at_rest_in_time(ill: Ill, looks: list[Look], name: str, status: wire.Message) -> None:
    shows_s = shows_at(ill, looks, name)
    assert status.fault_us * 1e-6 - shows_s <= ill.faults[name] + SEEN_S
    assert rest_at(looks) - shows_s <= ill.faults[name] + ill.rest_s + SEEN_S
    assert not status.flags & wire.code("FLAGS", "ENABLED")


def goes_unnoticed(name: str, ill: Ill, looks: list[Look]) -> None:
    """No fault: there was none to be seen, or the axis is at rest because its host is gone."""
    if name in ("silence", "cable", "killed", "power"):
        follows = wire.code("MODES", "FOLLOW_TIP")
        moving = looks[0].mode in (follows, wire.code("MODES", "HOLD"), wire.code("MODES", "OFF"))
        checks = looks[0].mode in (wire.code("MODES", "CHECK"), wire.code("MODES", "STOPPING_OFF"))
        assert moving or checks, f"still {wire.text('MODES', looks[0].mode)}"
        if name != "silence":
            assert rest_at(looks) - looks[0].t_s <= BRAKING_S + SEEN_S
        return
    longest = max(ill.faults.values()) + SEEN_S
    assert looks[-1].t_s - shows_at(ill, looks, "") <= longest


def try_point(request: pytest.FixtureRequest, task: Task, name: str, at: int, folder: Path) -> None:
    ill = ILLS[name]
    with bench_of(request, axes=1) as bench:
        begin(bench)
        share = np.random.default_rng(at).uniform(0.05, 0.95)
        events = Events(bench.sim, at, lambda events: ill.happen(events), share)
        status, says = run(bench, task, folder, events)
        assert events.happened >= 0
        events.afterwards(1.5)
        looks = events.looks[events.happened :]
        assert "internal error" not in says and "Traceback" not in says
        dead = not bench.sim.ask("state")["powered"]
        mended(bench, not dead)
        with bench.open() as board:
            after = board.status(0)
            assert in_store(board) in ({tables.model_id(OLD), tables.model_id(NEW)} if not task.moves else {tables.model_id(OLD)})
        if dead:
            assert status == 1 and ill.says in says
        elif after.fault:
            assert status == 1 or name == "killed"
            at_rest_in_time(ill, looks, named(ill, after, says), after)
        else:
            goes_unnoticed(name, ill, looks)
            if status == 1:
                assert ill.says in says
        if not task.moves:
            assert np.ptp([look.q for look in looks]) == 0.0
        clear = terminal("clear", "--board", bench.where)
        assert clear[0] == 0
        with bench.open() as board:
            if not board.status(0).flags & wire.code("FLAGS", "REFERENCED"):
                bench.sim.ask("place 0 0")
                board.ask("set_position", axis=0, q=0.0)
        again = folder / "again"
        again.mkdir()
        done, says = run(bench, task, again, Events(bench.sim))
        assert done == 0, says
        if not task.moves:
            with bench.open() as board:
                assert in_store(board) == tables.model_id(NEW)


_POINTS: dict[tuple[str, str], list[int]] = {}


def points(request: pytest.FixtureRequest, name: str, folder: Path) -> list[int]:
    """The events of a run without a fault that are tried."""
    key = (request.config.getoption("--board"), name)
    if key not in _POINTS:
        with bench_of(request, axes=1) as bench:
            begin(bench)
            events = Events(bench.sim, all_looks=True)
            status, says = run(bench, TASKS[name], folder, events)
            assert status == 0, says
        count = len(events.names)
        even = np.linspace(0, count - 1, min(EVEN, count)).round().astype(int)
        _POINTS[key] = sorted({*even.tolist(), *(events.changes() if TASKS[name].moves else range(count))})
    return _POINTS[key]


SHARE = [pytest.param(i, marks=[pytest.mark.long] if i else []) for i in range(SHARES)]


@pytest.mark.parametrize("share", SHARE)
@pytest.mark.parametrize(
    ("doing", "name"), [(doing, name) for doing, task in TASKS.items() for name in task.ills]
)
def test_whatever_goes_wrong_at_any_point(
    request: pytest.FixtureRequest, tmp_path: Path, doing: str, name: str, share: int
) -> None:
    if request.config.getoption("--board") not in SIMULATED:
        pytest.skip("needs a board of our own")
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
