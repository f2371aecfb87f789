"""What a host does to a simulated board in one run, event by event: messages, transfers of tables, grants of time.
Before any of them, or in the middle of a grant, something can be made to happen; from then on the axis is watched."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any
from unittest.mock import patch

from tautline.device import wire
from tautline.device.board import Board
from tautline.device.dfu import Dfu
from tautline.simulated.simlink import SimLink

_ASK, _WRITE, _CONTROL = SimLink.ask, Board._write, Dfu._control
_Q8 = 256.0
_WATCH_US = 2000  # between looks, from the moment on at which something happened
_WATCHED_S = 4.0  # of looking
PATIENCE_S = 3.0  # that a silent host says nothing
_TELLING = wire.code("FLAGS", "AT_REST") | wire.code("FLAGS", "TAKE_UP") | wire.code("FLAGS", "CHECKED")


class HostDied(BaseException):
    """The host's process was killed: nothing of it runs any more."""


class BoardTime:
    """Stands where a command has the wall clock: the simulation's time, which passes only where the command sleeps."""

    def __init__(self, link: SimLink) -> None:
        self._link = link

    def monotonic(self) -> float:
        return float(_ASK(self._link, "state")["t_us"]) * 1e-6

    def sleep(self, seconds: float) -> None:
        if seconds > 0.0:
            self._link.ask(f"advance {round(seconds * 1e6)}")

    @contextmanager
    def of_stream(self) -> Iterator[None]:
        """`taut stream` goes by it."""

        def align(board: Board, trips: int = 8) -> float:
            for _ in range(trips):
                now = self.monotonic()
                board.clock.add(now, now, board.sync())
            return board.clock.offset(now)[1]

        switch_on = Board.switch_on
        with (
            patch("tautline.device.stream.time", self),
            patch("tautline.cli.stream.time", self),
            patch.object(Board, "align", align),
            patch.object(Board, "switch_on", lambda board, axis: switch_on(board, axis, self.sleep)),
        ):
            yield


@dataclass(frozen=True)
class Look:
    """Axis 0 as the simulation knows it. Positions are counts, the time is the board's."""

    t_s: float
    q: float  # where the motor truly is
    q_ref: float
    mode: int
    fault: int
    flags: int


@dataclass
class Events:
    """The events of one run; `happen` is called before event `at`, where that is a grant at `share` of it."""

    link: SimLink
    at: int = -1
    happen: Callable[[Events], None] = lambda events: None
    share: float = 0.5
    in_grants: bool = False  # not before a message, but in the next grant: who grants the time knows it
    all_looks: bool = False  # from the start on, one after each event
    names: list[str] = field(default_factory=list)
    looks: list[Look] = field(default_factory=list)
    happened: int = -1  # index of the look at that moment
    dead: bool = False
    _rows: dict[str, Any] | None = None  # of grants that nobody has been told of yet

    @contextmanager
    def counted(self) -> Iterator[Events]:
        """Inside, every event passes here."""
        with (
            patch.object(SimLink, "ask", lambda link, request: self._asked(link, request)),
            patch.object(Board, "_write", lambda board, frame: self._does("message", _WRITE, board, frame)),
            patch.object(Dfu, "_control", lambda dfu, *what: self._does("transfer", _CONTROL, dfu, *what)),
        ):
            yield self

    def look(self) -> Look:
        state = _ASK(self.link, "state")
        axis = state["axes"][0]
        t_s = 1e-6 * state.get("axes_us", state["board_us"])
        q, q_ref = axis.get("true_q8", state["q"][0]) / _Q8, axis["q_ref_q8"] / _Q8
        self.looks.append(Look(t_s, q, q_ref, axis["mode"], axis["fault"], axis["flags"]))
        return self.looks[-1]

    def silence(self) -> None:
        """The host hangs for so long, then goes on."""
        self._pass(round(PATIENCE_S * 1e6))

    def die(self) -> None:
        self.dead = True
        raise HostDied

    def afterwards(self, seconds: float) -> None:
        """Watches on when the run is over, whatever became of it."""
        self._pass(round(seconds * 1e6))

    def changes(self) -> list[int]:
        """Events with which what the axis does became another."""
        told, way = [], 0
        for before, now in zip(self.looks, self.looks[1:], strict=False):
            if now.t_s > before.t_s:
                way = (now.q_ref > before.q_ref) - (now.q_ref < before.q_ref)
            told.append((now.mode, now.fault, now.flags & _TELLING, way))
        return [i + 1 for i in range(len(told)) if i == 0 or told[i] != told[i - 1]]

    # ----------------------------------------------------------------------------------------------------------

    def _is_it(self, name: str) -> bool:
        if self.dead:
            raise HostDied
        self.names.append(name)
        is_it = len(self.names) - 1 == self.at
        if is_it and self.in_grants and name != "grant":
            self.at += 1
            return False
        return is_it

    def _strike(self) -> None:
        self.look()
        self.happened = len(self.looks) - 1
        self.happen(self)

    def _does(self, name: str, what: Callable[..., Any], *given: Any) -> Any:
        if self._is_it(name):
            self._strike()
        answer = what(*given)
        if self.all_looks:
            self.look()
        return answer

    def _asked(self, link: SimLink, request: str) -> dict[str, Any]:
        if not request.startswith("advance "):
            return _ASK(link, request)
        us = int(request.split()[1])
        if self._is_it("grant"):
            before = round(self.share * us)
            self._keep(_ASK(link, f"advance {before}"))
            us -= before
            self._strike()
        self._pass(us)
        assert self._rows is not None
        answer, self._rows = self._rows, None
        if self.all_looks:
            self.look()
        return answer

    def _pass(self, us: int) -> None:
        while self.happened >= 0 and us > _WATCH_US and self.looks[-1].t_s < self.looks[self.happened].t_s + _WATCHED_S:
            self._keep(_ASK(self.link, f"advance {_WATCH_US}"))
            self.look()
            us -= _WATCH_US
        self._keep(_ASK(self.link, f"advance {us}"))
        if self.happened >= 0:
            self.look()

    def _keep(self, answer: dict[str, Any]) -> None:
        """An answer holds what passed since the one before: several are put together for who asked for the whole."""
        if self._rows is not None:
            answer["q"] = [[*early, *late] for early, late in zip(self._rows["q"], answer["q"], strict=True)]
            answer["from_us"] = self._rows["from_us"]
        self._rows = answer
