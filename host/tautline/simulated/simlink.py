"""The desktop board as a process, its sim link, and the simulated instrument and endoscope in lockstep with it.

Only simulation comes through here: a board's own data takes USB. Time is virtual: it stands still between `advance`s.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import socket
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from tautline.closable import Closable
from tautline.errors import TautError
from tautline.simulated.instrument import Instrument

Array = np.ndarray
PROGRAM = "TAUTLINE_DESKTOP_BOARD"  # environment: the program, where it is not built in the usual place
LINE = "TAUTLINE_DESKTOP_LINE"  # environment: "uart" puts simulated boards on a serial line in place of USB
_PACKAGED = Path(__file__).resolve().parents[1] / "bin" / "tautline-board"  # in a wheel
_BUILT = Path(__file__).resolve().parents[3] / "build" / "gcc" / "firmware" / "port" / "desktop" / "tautline-board"
_START_S = 10.0
_ANSWER_S = 60.0
_Q8 = 256.0
_END_STEP_US = 5000  # between which a mechanical end is looked for


class SimLink:
    """One text request a line, one JSON object a line back; see `tautline-board`."""

    def __init__(self, port: int, host: str = "127.0.0.1") -> None:
        """Connects to the board's sim link at host:port. TautError where no board answers."""
        try:
            self._socket = socket.create_connection((host, port), timeout=_START_S)
        except OSError as error:
            raise TautError(f"no simulated board answers at {host}:{port}: start it, or use --simulate") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.settimeout(_ANSWER_S)
        self._lines = self._socket.makefile("rb")

    def ask(self, request: str) -> dict[str, Any]:
        """Sends a request and returns its answer. TautError where the board has stopped, or refuses the request."""
        self._send(request)
        return self._answer(request)

    def ask_all(self, *requests: str) -> list[dict[str, Any]]:
        """Sends several requests at once and returns their answers in order: one round trip, which takes longer than
        the board needs for most requests. None of them may be one that ends the connection. TautError as of `ask`."""
        self._send("\n".join(requests))
        return [self._answer(request) for request in requests]

    def _send(self, lines: str) -> None:
        """Sends one or more requests, one a line. TautError where the board has stopped."""
        try:
            self._socket.sendall(lines.encode() + b"\n")
        except OSError as error:
            raise _stopped_error() from error

    def _answer(self, request: str) -> dict[str, Any]:
        """Reads the next answer. TautError where the board has stopped, or refused the request."""
        try:
            line = self._lines.readline()
        except OSError as error:
            raise _stopped_error() from error
        if not line:
            raise _stopped_error()
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise TautError(f"the simulated board refused '{request}': {answer['error']}")
        return answer

    def close(self) -> None:
        """Closes the socket; the board's process goes on."""
        with contextlib.suppress(OSError):
            self._lines.close()
            self._socket.close()


def _stopped_error() -> TautError:
    """The error to raise where the simulated board no longer answers."""
    return TautError("the simulated board has stopped: start it again")


def program() -> Path:
    """The path of the desktop board's executable: the one named in the environment, in the wheel, on the PATH, or built
    here. TautError, which says where it was looked for, where there is none."""
    named = os.environ.get(PROGRAM)
    if named and not Path(named).is_file():
        raise TautError(f"{PROGRAM} names {named}, which is not there: build it, or unset {PROGRAM}")
    for candidate in (named, _PACKAGED, shutil.which("tautline-board"), _BUILT):
        if candidate and Path(candidate).is_file():
            return Path(candidate)
    clone = _BUILT.parents[5]
    remedy = "install a release's wheel, which holds it"
    if (clone / "CMakePresets.json").is_file():
        remedy = f"in {clone} run 'cmake --preset gcc && cmake --build --preset gcc'"
    raise TautError(
        f"the desktop board, which simulations run on, is neither {_PACKAGED} nor tautline-board on the PATH: "
        f"{remedy}, or name it in {PROGRAM}"
    )


class DesktopBoard(Closable):
    """A process of the desktop board, which lives until `close` or the end of the with block. Its flash is a file,
    which is kept if the caller names it."""

    def __init__(
        self,
        axes: int = 1,
        flash: Path | None = None,
        serial: str = "DESKTOP",
        realtime: bool = False,
        rate_hz: int = 5000,
        update_key: bytes | None = None,
    ) -> None:
        """Starts the desktop board and waits until it says where its links are. flash: the file that it keeps, by
        default a temporary one. realtime: time runs with the wall clock, else only by `advance`. rate_hz: of its
        control loop. update_key: 32 bytes that the signature of new firmware is checked with; None: it takes no
        firmware. TautError where it does not start."""
        self._folder = None if flash else tempfile.TemporaryDirectory(prefix="tautline-")
        self.flash = flash or Path(self._folder.name if self._folder else ".") / "flash.bin"
        line = os.environ.get(LINE, "usbip")
        command = [str(program()), f"--{line}", "0", "--sim", "0", "--flash", str(self.flash), "--axes", str(axes)]
        command += ["--rate", str(rate_hz), "--serial", serial, "--parent", str(os.getpid())]
        command += ["--realtime"] if realtime else []
        command += ["--update-key", update_key.hex()] if update_key else []
        # In a group of its own: Ctrl-C on a terminal goes to every process of a group, and the board has to live until
        # its axis is at rest. It ends with this process (--parent).
        self.process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, start_new_session=True
        )
        assert self.process.stdout is not None
        started = self.process.stdout.readline()
        if not started:
            self.close()
            raise TautError(f"the desktop board did not start (exit status {self.process.returncode})")
        self.ports: dict[str, Any] = json.loads(started)
        prefix = "serial:tcp" if "uart" in self.ports else "usbip"
        self.where = f"{prefix}:127.0.0.1:{self.ports[line]}"

    def link(self) -> SimLink:
        """A new sim link to the board, which the caller closes."""
        return SimLink(self.ports["sim"])

    def close(self) -> None:
        """Ends the board's process and removes its temporary flash."""
        self.process.kill()
        self.process.wait()
        if self.process.stdout is not None:
            self.process.stdout.close()
        if self._folder is not None:
            self._folder.cleanup()


class SimulatedAxis:
    """A simulated instrument on one axis of a simulated board: q, p and c at each millisecond of board time."""

    def __init__(self, link: SimLink, instrument: Instrument, axis: int = 0) -> None:
        """Begins where the axis' motor stands now, with the play on its centre. link: to the board. All times are the
        board's, s since it was switched on; q is the motor's true position, in the rig's unit."""
        self.link, self.instrument, self.axis = link, instrument, axis
        self.resolution = instrument.rig.actuator.encoder_resolution
        # A part (n,) for each advance: s, q and p in the rig's unit, deg, and `way` of InstrumentPath.
        self._t: list[Array] = []
        self._q: list[Array] = []
        self._p: list[Array] = []
        self._c: list[Array] = []
        self._way: list[Array] = []
        self._ends: tuple[float, float] | None = None  # of the motor, the rig's unit; None: it has none
        instrument.reset()
        state = link.ask("state")
        self._boot_us = state["t_us"] - state["board_us"]  # the simulation's time when the board was switched on
        self._move_instrument(
            np.array([state["board_us"] * 1e-6]), np.array([state["q"][axis]]) * self.resolution / _Q8
        )

    def _move_instrument(self, t_s: Array, q: Array) -> None:
        """Moves the instrument by the motor's positions q (n,), the rig's unit, at t_s (n,), s; appends its path to
        `_t`, `_q`, `_p`, `_c` and `_way`."""
        self._t.append(t_s)
        self._q.append(q)
        course = self.instrument.course(t_s, q, translation_mm=None, rotation_deg=None)
        self._p.append(course.p)
        self._c.append(course.c_deg)
        self._way.append(course.way)

    @property
    def now_s(self) -> float:
        """The time of the last known position, s on the board's clock."""
        return float(self._t[-1][-1])

    def advance_to(self, t_s: float) -> None:
        """Runs board and instrument in lockstep to the first millisecond at or after t_s; does nothing if that is past.
        With mechanical ends it looks every _END_STEP_US whether the motor is at one."""
        # 1e-6 ms: rounding of t_s adds no millisecond.
        behind_us = int(np.ceil((t_s - self.now_s) * 1e3 - 1e-6)) * 1000
        if behind_us <= 0:
            return
        while self._ends is not None and behind_us > 0:
            self._advance(min(behind_us, _END_STEP_US))
            self._block_at_ends(*self._ends)
            behind_us -= _END_STEP_US
        if behind_us > 0:
            self._advance(behind_us)

    def end_at(self, low: float, high: float) -> None:
        """Gives the motor mechanical ends at low and high, the rig's unit, from now on: it cannot go beyond them, but
        come back."""
        self._ends = low, high

    def _block_at_ends(self, low: float, high: float) -> None:
        """Blocks the motor where it is at or beyond an end (low, high, the rig's unit) and driven farther out; else
        frees it."""
        q, drive = float(self._q[-1][-1]), self.link.ask("state")["axes"][self.axis]["duty_q15"]
        held = (q <= low and drive < 0) or (q >= high and drive > 0)
        self.link.ask(f"inject {self.axis} {'blocked' if held else 'well'}")

    def _advance(self, us: int) -> None:
        """Lets the board run for `us` microseconds and moves the instrument along. The board answers with the motor's
        positions, 1/256 counts, at each millisecond since the last answer; the last one is now."""
        answer = self.link.ask(f"advance {us}")
        q = np.asarray(answer["q"][self.axis], dtype=np.float64) * self.resolution / _Q8
        step = answer["dt_us"]
        self._move_instrument((answer["t_us"] - self._boot_us + step * np.arange(1 - len(q), 1)) * 1e-6, q)

    def truth(self) -> tuple[Array, Array, Array, Array]:
        """The whole path so far, (n,) each, a sample per millisecond of board time: t_s, s, q and p, the rig's unit,
        and c, deg."""
        t, q, p, c = (np.concatenate(parts) for parts in (self._t, self._q, self._p, self._c))
        return t, q, p, c

    def scene(self, t_s: Array) -> tuple[Array, float, float]:
        """The state that a simulated camera draws: c (n,), deg, at past times t_s (n,), s; translation 0 mm and
        rotation 0 deg."""
        return self._past_values(t_s, self._c), 0.0, 0.0

    def marker(self, t_s: Array) -> Array:
        """Where the marker was seen, (n, 2) px, at past times t_s (n,), s, with translation and rotation at 0."""
        c_deg, way = self._past_values(t_s, self._c), self._past_values(t_s, self._way)
        return self.instrument.see(c_deg, way, translation_mm=0.0, rotation_deg=0.0)

    def _past_values(self, t_s: Array, values: list[Array]) -> Array:
        """Values at past times t_s (n,), s, interpolated linearly. values: in parts as `_t` is. Only so many of the
        last parts are joined as reach back to the earliest time, so that a long run stays fast."""
        recent = 1
        while recent < len(self._t) and self._t[-recent][0] > t_s.min():
            recent += 1
        past: Array = np.interp(t_s, np.concatenate(self._t[-recent:]), np.concatenate(values[-recent:]))
        return past
