"""What the host reads, made hostile: recordings, models, rigs, replies of a board and of its USB.

One execution is one of TARGETS with a random.Random: it may end in a result or in a TautError, in nothing else, and
within moments. What is changed is whole files and messages, in their own terms (a cell, a key, a field), now and then
in bytes. `guided.py` looks for what nobody has tried.
"""

from __future__ import annotations

import contextlib
import copy
import errno
import json
import random
import socket
import tempfile
import zlib
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import usb.core

from tautline import columns, recording, tables
from tautline import rig as rigs
from tautline.device import board as boards
from tautline.device import dfu, usbip, wire
from tautline.device.link import BoardAddress, BoardGone
from tautline.errors import TautError
from tautline.model import Model
from tautline.rig import Rig
from tautline.simulated.instrument import preset, reference_rig

FOLDER = tempfile.TemporaryDirectory(prefix="hostile-")

CELLS = (
    "", "nan", "inf", "-inf", "-1", "0", "1e308", "-1e308", "1e400", "1e-320", "9" * 400, "0x10", "1_000", "true",
    '"', '"a', "\0", " ", "1,5", ";", "t_s", "\N{FULLWIDTH DIGIT ONE}", "1e5", "#", "3.5.1", "\ufeff",
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    None, True, "", "x", "1e3", -1, 0, 1, 2.5, 1e308, -1e308, float("nan"), float("inf"), 10**400, [], {}, [[]],
    [1, "a"], {"a": 1}, [None], [[1.0, 2.0], [3.0]], [1e308, -1e308], "\0" * 3,
)  # fmt: skip
RAW = (*CELLS, "[", "]", "[[]]", "{a = 1}", "[1, 2]", "[2, 1]", "[nan, nan]", "'x'", "1979-05-27", "[0.0, inf]", "-0.0")


class Link:
    """A board that says anything, whatever it is asked."""

    hello_tries, log_divider = 1, 1

    def __init__(self, draw: random.Random) -> None:
        self.draw, self.asked, self.left = draw, b"", 200

    def write(self, data: bytes) -> None:
        self.asked += data

    def read(self, _: float) -> bytes:
        self.left -= 1
        if self.left < 0:
            raise BoardGone("gone")
        asked, self.asked = self.asked, b""
        return _replies(self.draw, asked)

    def tables(self, _: int) -> Any:
        return None

    def bus(self) -> dict[str, Any]:
        return {}

    def close(self) -> None:
        pass


def _replies(draw: random.Random, asked: bytes) -> bytes:
    """Frames with the sequence of what was asked for, mostly of the type that answers it."""
    said = b""
    for name, _, sequence, _ in wire.wire.Parser().feed(asked):
        likely = {"hello": "identity", "ping": "pong", "table_read": "table_part"}.get(name, name.removeprefix("get_"))
        kinds = [likely if likely in wire.wire.MESSAGES else "ack"] * 20 + ["ack", "error", "batch", "event", "onset"]
        frame = bytearray(wire.encode(draw.choice(kinds), sequence))
        size = len(frame) - HEADER - 4
        if name == "hello" and draw.random() < 0.9:
            values = {
                "protocol_major": wire.wire.MAJOR,
                "protocol_minor": draw.randrange(12),
                "axes": draw.randrange(6),
            }
            frame = bytearray(wire.encode("identity", sequence, **values))
            size = 0
        for _ in range(draw.randrange(6) if size > 0 else 0):
            frame[HEADER + draw.randrange(size)] = draw.choice((0, 1, 127, 128, 255, draw.randrange(256)))
        frame[-4:] = zlib.crc32(frame[:-4]).to_bytes(4, "little")
        said += bytes(frame[: draw.randrange(len(frame))]) if draw.random() < 0.05 else bytes(frame)
    return draw.randbytes(draw.randrange(40)) + said if draw.random() < 0.1 else said


HEADER = len(wire.encode("ping", 1)) - 4 - 8  # a ping is eight bytes


def replies(draw: random.Random) -> None:
    with patch.object(boards, "_SIMULATED_S", 0.02), patch.object(boards, "_ANSWER_S", 0.02):
        address = BoardAddress("usb:FUZZ", "FUZZ", False, (wire.wire.MAJOR, wire.wire.MINOR), lambda: Link(draw))
        with boards.Board(address) as board, patch.object(boards, "_STORE_S", 0.02):
            board.listen("event", lambda message: str(message.values))
            for _ in range(draw.randrange(1, 6)):
                draw.choice(
                    (
                        lambda: wire.fault(board.status(0)),
                        lambda: board.read_table(0),
                        lambda: board.load_table(0, TABLE),
                        lambda: board.switch_on(0, lambda _: None),
                        lambda: board.align(2),
                        lambda: board.trust_motor(0),
                        lambda: board.check_reference(0),
                        lambda: board.counters().values,
                    )
                )()


def stream(draw: random.Random) -> None:
    """Bytes of the bus, whatever they are."""
    decoder = wire.Decoder()
    names = sorted(wire.wire.MESSAGES)
    for _ in range(draw.randrange(1, 8)):
        frame = bytearray(wire.encode(draw.choice(names), draw.randrange(65536)))
        for _ in range(draw.randrange(4)):
            frame[draw.randrange(len(frame))] = draw.randrange(256)
        if draw.random() < 0.7:
            frame[-4:] = zlib.crc32(frame[:-4]).to_bytes(4, "little")
        for message in decoder.feed(bytes(frame)):
            str(message.values)


class Device:
    """DFU requests answered with anything."""

    def __init__(self, draw: random.Random) -> None:
        self.draw, self.left = draw, 60

    def ctrl_transfer(self, kind: int, request: int, value: int, index: int, what: bytes | int, _: int) -> bytes | int:
        self.left -= 1
        if self.left < 0 or self.draw.random() < 0.02:
            raise usb.core.USBError("stalled", errno=self.draw.choice((errno.EPIPE, errno.ENODEV, errno.EIO)))
        if isinstance(what, bytes):
            return len(what)
        if request == dfu._GETSTATUS:
            state = self.draw.choice((2, 5, 2, 5, self.draw.randrange(256)))
            status = self.draw.choice((0, 0, 0, self.draw.randrange(256)))
            answer = bytes((status, *self.draw.choice((b"\0\0\0", self.draw.randbytes(3))), state, 0))
            return answer if self.draw.random() < 0.95 else answer[: self.draw.randrange(6)]
        return self.draw.randbytes(what if self.draw.random() < 0.8 else self.draw.randrange(what + 1))


def tables_by_dfu(draw: random.Random) -> None:
    route = object.__new__(dfu.Dfu)
    route._device, route._interface, route._answer_ms, route._block = Device(draw), 1, 1000, 256
    route._asked_s = 0.0
    slept: list[float] = []
    with patch.object(dfu.time, "sleep", slept.append), patch.object(dfu.usb.util, "release_interface"):
        try:
            with route:
                draw.choice((lambda: route.download(TABLE), route.upload))()
        except usb.core.USBError:
            pass  # which the link explains
    assert sum(slept) < 60.0, f"sleeps {sum(slept):.0f} s because the board says so"


def usb_over_ip(draw: random.Random) -> None:
    ours, theirs = socket.socketpair()
    device = usbip.Exported("fuzz", 0, "1-1", 1, 2, 2, 1, 2, 3, (0, 0, 0), 1, 1)
    with theirs, ours, contextlib.suppress(OSError), patch.object(usbip, "_connect", lambda *_: ours):
        imported = usbip._OP.pack(usbip.VERSION, 3, 0) + bytes(usbip._DEVICE.size)
        said = bytearray(imported)
        for _ in range(draw.randrange(5)):
            actual = draw.choice((0, 8, 64, draw.randrange(200), -1, 1 << 30))
            status = draw.choice((0, 0, -errno.EPIPE, -errno.ECONNRESET, 5))
            kind, sequence = draw.choice((3, 3, 4, draw.randrange(9))), draw.randrange(5)
            header = usbip._URB.pack(kind, sequence, 0, 0, 0, status, actual, 0, 0, 0, b"")
            said += header + draw.randbytes(max(min(actual, 200), 0))
        for _ in range(draw.choice((0, 0, 1, 4))):
            said[draw.randrange(len(said))] = draw.randrange(256)
        theirs.sendall(bytes(said))
        theirs.shutdown(socket.SHUT_WR)
        connection = usbip.Connection(device)
        for _ in range(3):
            connection.transfer(0x81, draw.choice((None, None, b"abc")), 64, b"", 1)


# -- files ------------------------------------------------------------------------------------------------------------


def _written(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text("utf-8") for path in sorted(folder.iterdir()) if path.suffix != ".png"}


def _samples() -> tuple[dict[str, str], dict[str, str]]:
    """A short recording and a model, as the host writes them."""
    with tempfile.TemporaryDirectory() as folder:
        rig, plant, q = reference_rig(), preset("reference", reference_rig(), 0), np.linspace(-5.0, 5.0, 21)
        t_s = np.arange(12) * 0.02
        marker = recording.Marker(t_s + 0.01, 300.0 + t_s, 200.0 - t_s, np.ones(12, dtype=bool), 0.1 + 0.0 * t_s)
        angle = recording.Angle(t_s, 10.0 * t_s)
        motor = recording.Motor(t_s, 0.1 * t_s, load_mNm=0.0 * t_s)
        recording.save(recording.Recording("run", motor, marker, angle, rig=rig), Path(folder) / "run")
        made = Model(rig, q, plant.backlash(q), 0.01 + 0 * q, plant.bend(q), 0.08, (-4.0, 4.0))
        made.save(Path(folder) / "model")
        return _written(Path(folder) / "run"), _written(Path(folder) / "model")


RECORDING, MODEL = _samples()
TABLE = tables.encode(
    Model(
        reference_rig(),
        np.linspace(-5.0, 5.0, 257),
        preset("reference", reference_rig(), 0).backlash(np.linspace(-5.0, 5.0, 257)),
        np.full(257, 0.001),
        preset("reference", reference_rig(), 0).bend(np.linspace(-5.0, 5.0, 257)),
        0.08,
        (-4.5, 4.5),
    ),
    axis=0,
    created_s=0,
)


def _bytes(draw: random.Random, text: str) -> bytes:
    """Now and then damaged as a disk or an editor does it."""
    data = text.encode("utf-16" if draw.random() < 0.01 else "utf-8", "surrogatepass")
    if draw.random() < 0.05:
        data = data[: draw.randrange(len(data) + 1)]
    if draw.random() < 0.1 and data:
        at = draw.randrange(len(data))
        data = data[:at] + draw.randbytes(draw.randrange(4)) + data[at + draw.randrange(4) :]
    return data.replace(b"\n", b"\r\n") if draw.random() < 0.02 else data


def _csv(draw: random.Random, text: str) -> str:
    rows = [line.split(",") for line in text.splitlines()]
    for _ in range(draw.randrange(4)):
        row = draw.randrange(len(rows))
        kind = draw.randrange(8)
        if kind < 4 and rows[row]:
            rows[row][draw.randrange(len(rows[row]))] = draw.choice(CELLS)
        elif kind == 4:
            rows.insert(draw.randrange(len(rows) + 1), list(rows[row]))
        elif kind == 5 and len(rows) > 1:
            del rows[row]
        elif kind == 6:
            rows[row] = [*rows[row][: draw.randrange(len(rows[row]) + 1)], draw.choice(CELLS)]
        else:
            column = draw.randrange(len(rows[0]) + 1)
            value = draw.choice(CELLS)
            rows = [[*r[:column], value, *r[column + 1 :]] for r in rows]
    return "\n".join(",".join(row) for row in rows) + "\n"


def _toml(draw: random.Random, text: str) -> str:
    lines = text.splitlines()
    for _ in range(draw.randrange(4)):
        at = draw.randrange(len(lines))
        kind = draw.randrange(6)
        if kind < 3 and "=" in lines[at]:
            lines[at] = lines[at].partition("=")[0] + "= " + draw.choice(RAW)
        elif kind == 3 and len(lines) > 1:
            del lines[at]
        elif kind == 4:
            lines.insert(draw.randrange(len(lines) + 1), lines[at])
        else:
            lines[at] = draw.choice(("[a]", "[[actuator]]", "[camera]", "camera = 1", lines[at].upper()))
    return "\n".join(lines) + "\n"


def _json(draw: random.Random, text: str) -> str:
    document = json.loads(text)
    for _ in range(draw.randrange(1, 4)):
        at: Any = document
        while True:
            places = list(at) if isinstance(at, dict) else list(range(len(at)))
            if not places:
                break
            place = draw.choice(places)
            if isinstance(at[place], dict | list) and at[place] and draw.random() < 0.6:
                at = at[place]
                continue
            if draw.random() < 0.15:
                del at[place]
            else:
                at[place] = copy.deepcopy(draw.choice(VALUES))
            break
    deep = draw.randrange(2000) if draw.random() < 0.01 else 0
    return "[" * deep + json.dumps(document) + "]" * deep


# All but one file of a folder are as they were: what is made of a text needs making once.
columns._table = lru_cache(64)(columns._table)
rigs.tomllib = SimpleNamespace(loads=lru_cache(64)(rigs.tomllib.loads), TOMLDecodeError=rigs.tomllib.TOMLDecodeError)


def _in_folder(
    files: dict[str, str], needed: tuple[str, ...], read: Callable[[Path], object]
) -> Callable[[random.Random], None]:
    """One of the files is changed, any that is not needed may be left out."""
    changes = {".csv": _csv, ".toml": _toml, ".json": _json}
    there: dict[str, bytes] = {}

    def read_once(draw: random.Random) -> None:
        chosen = draw.choice(sorted(files))
        change = changes[Path(chosen).suffix]
        wanted = {name: text.encode() for name, text in files.items() if name in needed or draw.random() < 0.5}
        wanted[chosen] = _bytes(draw, change(draw, files[chosen]))
        for name in there.keys() - wanted.keys():
            Path(FOLDER.name, name).unlink()
        for name, data in wanted.items():
            if there.get(name) != data:
                Path(FOLDER.name, name).write_bytes(data)
        there.clear()
        there.update(wanted)
        read(Path(FOLDER.name))

    return read_once


def _load_recording(folder: Path) -> None:
    found = recording.load(folder)
    assert np.isfinite(found.motor.t_s).all() and np.isfinite(found.motor.q).all()
    assert (np.diff(found.motor.t_s) > 0).all()


def _load_model(folder: Path) -> None:
    found = Model.load(folder)
    assert np.isfinite(found.width).all() and np.isfinite(found.c_deg).all()


def _load_rig(folder: Path) -> None:
    found = Rig.load(folder / "rig.toml")
    assert np.isfinite(found.actuator.range).all() and found.actuator.span > 0


TARGETS: dict[str, Callable[[random.Random], None]] = {
    "recording": _in_folder(RECORDING, ("rig.toml", "motor.csv"), _load_recording),
    "model": _in_folder(MODEL, tuple(MODEL), _load_model),
    "rig": _in_folder({"rig.toml": RECORDING["rig.toml"]}, ("rig.toml",), _load_rig),
    "replies": replies,
    "stream": stream,
    "dfu": tables_by_dfu,
    "usbip": usb_over_ip,
}


def once(name: str, draw: random.Random) -> None:
    """Ends as it may, or in the error that it may not end in."""
    with contextlib.suppress(TautError):
        TARGETS[name](draw)
