#!/usr/bin/env python3
"""The MPS2 port on a Cortex-M4 or M33 in QEMU, behind the desktop board's options and ports: a host's line, a sim link.

QEMU runs the image; its two serial ports come here. The first is the host's line. The second carries the world: time is
granted in ticks, together with the number of the line's bytes that were sent before, and answered with the number of
those that the board sent meanwhile, so that everything depends on the requests and their order alone.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import selectors
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
MACHINES = {"m4": "mps2-an386", "m33": "mps2-an505"}  # core -> QEMU's machine
CORE = "TAUTLINE_QEMU_CORE"  # environment: the core, where no option names it
PSRAM_BYTES = 16 << 20
FLASH_BYTES = 1 << 20  # of it that stand for the flash chip: more than the app keeps things in
OPTIONS_AT = 0xF00000  # world.c
INJECT = "inject takes an axis and well, blocked, unplugged, reversed, coarse, jump, driver, supply or estop"
AXES_MAX = 4
ADVANCE_MAX_US = 10_000_000
START_S = 20.0
ANSWER_S = 120.0
SLICE_US = 4000  # of the wall clock, between looks at the sockets
LAG_US = 20_000
IDLE_S = 0.5  # between looks whether the parent is there
HELP = (
    "not a request: advance US, state, realtime on|off, cut N, place AXIS Q8, inject AXIS ILL, unplug, plug, "
    "reset, hang, quit"
)


class Stopped(Exception):
    """QEMU or the image is not there any more."""


class Refused(Exception):
    """A request that cannot be."""


def _die_with_us() -> None:
    """QEMU ends when this process does, however that ends."""
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


class Machine:
    """QEMU with the image, and what it says on its two serial ports."""

    def __init__(self, options: argparse.Namespace, folder: Path) -> None:
        flash = Path(options.flash) if options.flash else folder / "flash.bin"
        self._make_psram(flash, options)
        listeners = [self._listen(folder / name) for name in ("line", "world")]
        qemu = shutil.which("qemu-system-arm")
        if qemu is None:
            sys.exit("qemu-system-arm is not installed: run 'tools/setup m4'")
        image = ROOT / "build" / options.core / "tautline.elf"
        if not image.is_file():
            sys.exit(f"{image} is missing: run './run {options.core}'")
        command = [qemu, "-M", f"{MACHINES[options.core]},memory-backend=psram", "-kernel", str(image)]
        command += ["-object", f"memory-backend-file,id=psram,size={PSRAM_BYTES},mem-path={flash},share=on"]
        command += ["-icount", "shift=4,sleep=off,align=off"]  # 16 ns an instruction, and no waiting
        command += ["-nodefaults", "-display", "none", "-monitor", "none", "-nic", "none"]
        for name in ("line", "world"):
            command += ["-chardev", f"socket,id={name},path={folder / name}", "-serial", f"chardev:{name}"]
        self.process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=sys.stderr, preexec_fn=_die_with_us)
        self.line, self.world = (self._accept(listener) for listener in listeners)
        self.line.setblocking(False)
        self._text = b""
        self.sent = 0  # bytes to the line
        self.got = 0  # bytes from it
        self.take: Callable[[bytes], None] = lambda data: None

    @staticmethod
    def _make_psram(flash: Path, options: argparse.Namespace) -> None:
        held = flash.read_bytes()[:FLASH_BYTES] if flash.exists() else b""
        with flash.open("wb" if not held else "r+b") as file:
            file.seek(len(held))
            file.write(b"\xff" * (FLASH_BYTES - len(held)))
            file.truncate(PSRAM_BYTES)
            file.seek(OPTIONS_AT)
            file.write(struct.pack("<II32s", options.axes, options.rate, options.serial.encode()))

    @staticmethod
    def _listen(path: Path) -> socket.socket:
        listener = socket.socket(socket.AF_UNIX)
        listener.bind(str(path))
        listener.listen(1)
        listener.settimeout(START_S)
        return listener

    def _accept(self, listener: socket.socket) -> socket.socket:
        try:
            connection, _ = listener.accept()
        except TimeoutError:
            sys.exit("QEMU does not start: see its message above")
        listener.close()
        return connection

    def ask(self, request: str) -> list[str]:
        """The words of the answer. What the board says on its line meanwhile is passed on."""
        self.world.sendall(request.encode() + b"\n")
        deadline = time.monotonic() + ANSWER_S
        with selectors.DefaultSelector() as both:
            both.register(self.world, selectors.EVENT_READ)
            both.register(self.line, selectors.EVENT_READ)
            while b"\n" not in self._text:
                for key, _ in both.select(1.0):
                    if key.fileobj is self.line:
                        self.receive()
                    elif data := self.world.recv(65536):
                        self._text += data
                    else:
                        raise Stopped("QEMU has ended")
                if time.monotonic() > deadline:
                    raise Stopped(f"the image does not answer '{request}'")
        answer, _, self._text = self._text.partition(b"\n")
        return answer.decode().split()

    def receive(self, until: int | None = None) -> None:
        """Passes on what the line holds; with `until`, until so many bytes have come in all."""
        while True:
            try:
                data = self.line.recv(65536)
            except BlockingIOError:
                if until is None or (self.got - until) & 0x80000000 == 0:
                    return
                with selectors.DefaultSelector() as line:
                    line.register(self.line, selectors.EVENT_READ)
                    if not line.select(START_S):
                        raise Stopped("bytes of the line are missing") from None
                continue
            if not data:
                raise Stopped("QEMU has ended")
            self.got = (self.got + len(data)) & 0xFFFFFFFF
            self.take(data)

    def send(self, data: bytes) -> None:
        self.line.setblocking(True)
        self.line.sendall(data)
        self.line.setblocking(False)
        self.sent = (self.sent + len(data)) & 0xFFFFFFFF

    def close(self) -> None:
        self.process.kill()
        self.process.wait()


class World:
    """The sim link's requests, as the desktop board answers them (docs/protocol.md)."""

    def __init__(self, machine: Machine, options: argparse.Namespace) -> None:
        self.machine, self.axes = machine, options.axes
        self.tick_us = 1_000_000 // options.rate
        self.ticks = 0
        self.granted_us = 0
        self.rows: list[list[int]] = []  # true positions of each millisecond that was not told yet
        self.row = 0  # index of the first
        self.client: socket.socket | None = None
        self.plugged = True
        self.ills = ["well"] * options.axes
        self.quit = False
        self.realtime = options.realtime
        self._paced = (0, 0.0)
        machine.take = self._give
        machine.ask("state")
        self._pace()

    # -- the line ---------------------------------------------------------------------------------------------------

    def _give(self, data: bytes) -> None:
        if self.client is not None:
            try:
                self.client.setblocking(True)
                self.client.sendall(data)
            except OSError:
                self.hang_up()

    def attach(self, client: socket.socket) -> bool:
        if self.client is not None or not self.plugged:
            client.close()
            return False
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.client = client
        return True

    def hang_up(self) -> None:
        if self.client is not None:
            self.client.close()
            self.client = None

    def listen(self) -> None:
        """Takes what the host has sent by now to the board."""
        while self.client is not None:
            self.client.setblocking(False)
            try:
                data = self.client.recv(65536)
            except BlockingIOError:
                return
            except OSError:
                data = b""
            if not data:
                self.hang_up()
                return
            self.machine.send(data)

    # -- time -------------------------------------------------------------------------------------------------------

    def run(self, ticks: int) -> None:
        answer = self.machine.ask(f"run {ticks} {self.machine.sent}")
        assert answer[0] == "ran", answer
        values = [int(word) for word in answer[1:]]
        self.ticks = values[0]
        self.machine.receive(values[1] & 0xFFFFFFFF)
        positions = values[3:]
        self.rows += [positions[i : i + self.axes] for i in range(0, len(positions), self.axes)]

    def _pace(self) -> None:
        self._paced = (self.ticks * self.tick_us, time.monotonic())

    def keep_pace(self) -> None:
        """By the wall clock; where the machine is too slow the board's time falls behind, and does not hurry later."""
        start_us, at = self._paced
        behind = start_us + (time.monotonic() - at) * 1e6 - self.ticks * self.tick_us
        if behind >= self.tick_us:
            self.listen()
            self.run(int(min(behind, SLICE_US)) // self.tick_us)
            self.granted_us = self.ticks * self.tick_us
        if behind > LAG_US:
            self._paced = (start_us - int(behind - LAG_US), at)

    # -- requests ---------------------------------------------------------------------------------------------------

    def _advance(self, us: int) -> dict[str, Any]:
        if self.realtime:
            until = time.monotonic() + us * 1e-6
            while time.monotonic() < until:
                self.keep_pace()
                time.sleep(0.0005)
        else:
            self.granted_us += us
            self.run((self.granted_us - self.ticks * self.tick_us) // self.tick_us)
        rows, first = self.rows, self.row + 1
        self.row += len(rows)
        self.rows = []
        q = [[row[axis] for row in rows] for axis in range(self.axes)]
        return {"t_us": self.ticks * self.tick_us, "from_us": first * 1000, "dt_us": 1000, "q": q}

    def _arrived(self) -> None:
        """Waits for bytes that are on their way to the image: a restart would lose them, and a run wait for them."""
        until = time.monotonic() + 1.0  # one that hangs takes none in
        while int(self.machine.ask("state")[8]) & 0xFFFFFFFF != self.machine.sent and time.monotonic() < until:
            time.sleep(0.001)

    def _state(self) -> dict[str, Any]:
        values = [int(word) for word in self.machine.ask("state")[1:]]
        ticks, boot, powered, bootloader, hung, starts, operations = values[:7]
        axes = [values[i : i + 7] for i in range(9, len(values), 7)]
        names = ("q_q8", "q_ref_q8", "duty_q15", "mode", "fault", "flags")
        return {
            "t_us": ticks * self.tick_us,
            "board_us": (ticks - boot) * self.tick_us,
            "powered": bool(powered),
            "bootloader": bool(bootloader),
            "hung": bool(hung),
            "attached": self.client is not None,
            "realtime": self.realtime,
            "starts": starts,
            "flash_operations": operations,
            "q": [axis[0] for axis in axes],
            "axes": [dict(zip(names, axis[1:], strict=True)) for axis in axes],
        }

    def request(self, line: str) -> dict[str, Any]:
        self.listen()  # what the host sent before comes before
        verb, *words = line.split(" ")
        match verb:
            case "advance":
                try:
                    (us,) = _numbers(words, (0, ADVANCE_MAX_US))
                except Refused:
                    return {"error": f"advance takes 0 to {ADVANCE_MAX_US} microseconds"}
                return self._advance(us)
            case "state":
                return self._state()
            case "realtime" if words in (["on"], ["off"]):
                self.realtime = words == ["on"]
                self._pace()
            case "cut":
                self.machine.ask(f"cut {_numbers(words, (0, 1_000_000))[0]}")
            case "place":
                try:
                    axis, q = _numbers(words, (0, self.axes - 1), (-1_000_000_000, 1_000_000_000))
                except Refused:
                    return {"error": "place takes an axis and a position in counts Q8"}
                self.machine.ask(f"place {axis} {q}")
            case "inject":
                known = len(words) == 2 and words[0] in map(str, range(self.axes)) and words[1].isalpha()
                if not known or self.machine.ask(f"inject {words[0]} {words[1]}") != ["ok"]:
                    return {"error": INJECT}
                self.ills[int(words[0])] = words[1]
                return {"t_us": self.ticks * self.tick_us, "ills": self.ills}
            case "unplug" if not words:
                self.hang_up()
                self.plugged = False
            case "plug" if not words:
                self.plugged = True
            case "reset" | "hang" if not words:
                self._arrived()
                self.machine.ask(verb)
            case "quit" if not words:
                self.quit = True
            case _:
                raise Refused
        return {"t_us": self.ticks * self.tick_us}


def _numbers(words: list[str], *ranges: tuple[int, int]) -> list[int]:
    """The words as whole numbers, one within each range; Refused where they are not that."""
    if len(words) != len(ranges):
        raise Refused
    try:
        values = [int(word) for word in words]
    except ValueError:
        raise Refused from None
    if not all(low <= value <= high for value, (low, high) in zip(values, ranges, strict=True)):
        raise Refused
    return values


def serve(world: World, line: socket.socket, sim: socket.socket, parent: int) -> None:
    texts: dict[socket.socket, bytes] = {}
    with selectors.DefaultSelector() as sockets:
        for listener in (line, sim):
            sockets.register(listener, selectors.EVENT_READ)
        sockets.register(world.machine.line, selectors.EVENT_READ)
        watched: socket.socket | None = None
        while not world.quit and (parent == 0 or os.getppid() == parent):
            watched = _watched(sockets, watched, world.client)
            ready = [key.fileobj for key, _ in sockets.select(0.001 if world.realtime else IDLE_S)]
            world.machine.receive()
            world.listen()
            watched = _watched(sockets, watched, world.client)  # before another socket gets its number
            if line in ready:
                world.attach(line.accept()[0])
            if sim in ready:
                client = sim.accept()[0]
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                texts[client] = b""
                sockets.register(client, selectors.EVENT_READ)
            for client in [one for one in texts if one in ready]:
                if not answer(world, client, texts):
                    sockets.unregister(client)
                    client.close()
                    del texts[client]
            if world.realtime:
                world.keep_pace()
    for client in texts:
        client.close()


def _watched(
    sockets: selectors.BaseSelector, watched: socket.socket | None, client: socket.socket | None
) -> socket.socket | None:
    """The host's socket: it has come, or gone."""
    if watched is not client:
        if watched is not None:
            sockets.unregister(watched)
        if client is not None:
            sockets.register(client, selectors.EVENT_READ)
    return client


def answer(world: World, client: socket.socket, texts: dict[socket.socket, bytes]) -> bool:
    """The requests that a sim link's client has sent whole; False: it is gone."""
    try:
        data = client.recv(65536)
        if not data:
            return False
        *lines, texts[client] = (texts[client] + data).split(b"\n")
        for line in lines:
            try:
                reply = world.request(line.decode("latin1").strip())
            except Refused:
                reply = {"error": HELP}
            client.sendall(json.dumps(reply).encode() + b"\n")
    except OSError:
        return False
    return len(texts[client]) < 65536


def options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="board.py", description="The port for Arm's MPS2 boards in QEMU.")
    core = os.environ.get(CORE, "m4")
    parser.add_argument("--core", default=core, choices=MACHINES)
    parser.add_argument("--uart", type=int, required=True, help="port of the host's line, on 127.0.0.1; 0: any")
    parser.add_argument("--sim", type=int, required=True, help="port of the sim link")
    parser.add_argument("--flash", help="keeps the tables between runs")
    parser.add_argument("--axes", type=int, default=1, choices=range(1, AXES_MAX + 1))
    parser.add_argument("--rate", type=int, default=5000, choices=(1000, 2000, 4000, 5000, 8000, 10000))
    parser.add_argument("--serial", default="MPS2-1")
    parser.add_argument("--realtime", action="store_true")
    parser.add_argument("--parent", type=int, default=0)
    return parser.parse_args()


def main() -> None:
    chosen = options()
    listeners = [socket.create_server(("127.0.0.1", port)) for port in (chosen.uart, chosen.sim)]
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    with tempfile.TemporaryDirectory(prefix="tautline-") as folder:
        machine = Machine(chosen, Path(folder))
        try:
            world = World(machine, chosen)
            uart, sim = (listener.getsockname()[1] for listener in listeners)
            ports = {"uart": uart, "sim": sim, "serial": chosen.serial, "axes": chosen.axes, "rate": chosen.rate}
            print(json.dumps(ports), flush=True)
            serve(world, *listeners, chosen.parent)
        except Stopped as error:
            sys.exit(f"the board has stopped: {error}")
        finally:
            machine.close()


if __name__ == "__main__":
    main()
