"""Updates a board from a file of firmware: sends the image, restarts the board, and waits until the new firmware is
confirmed or the old one runs again."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tautline.device import firmware, wire
from tautline.device.board import Board, open_board
from tautline.device.dfu import DfuError
from tautline.device.link import BoardGone
from tautline.errors import TautError

_BACK_S = 90.0  # tolerance: a restart is done within a second; new firmware that no host hears is given up after 60
_POLL_S = 0.1  # tolerance: between two looks
ANSWER_MS = 30000  # tolerance: a signature is checked in 0.2 s, on an emulated board in some seconds of a busy machine


@dataclass(frozen=True)
class Sent:
    """A board that restarts into new firmware."""

    where: str  # its address
    board: str  # its serial number
    port: str
    before: firmware.Version  # that ran
    version: firmware.Version  # that was sent
    slot: int  # that ran


@dataclass(frozen=True)
class Updated:
    """A board whose new firmware runs and is confirmed."""

    board: str  # its serial number
    port: str
    before: firmware.Version
    version: firmware.Version  # that runs
    slot: int  # that runs


def update(
    where: str | None,
    path: Path,
    older_too: bool = False,
    progress: Callable[[float, str], None] | None = None,
) -> Updated:
    """Brings new firmware to the board that `where` names (see device.board.find) and waits until it runs and is
    confirmed. path: an update file; older_too: whether an older version is taken, too; progress: gets the share sent, 0
    to 1, and a word. TautError where the board still runs the old firmware, or has not come back (see `send`,
    `finish`)."""
    return finish(send(where, path, older_too, progress))


def send(
    where: str | None,
    path: Path,
    older_too: bool = False,
    progress: Callable[[float, str], None] | None = None,
) -> Sent:
    """The first half of `update`: checks the file against the board, writes the image that fits into the board's free
    slot, and restarts the board. TautError where the file does not fit or the board refuses it."""
    images = firmware.read(path)
    with open_board(where) as board:
        runs = board.ask("get_firmware")
        image = firmware.check(path, images, board.identity, runs, older_too)
        if older_too:
            board.ask("any_firmware", key=wire.wire.KEY)
        _write_image(board, image.page + image.content, progress)
        with contextlib.suppress(BoardGone):  # it may restart before its answer is read: `finish` sees what came of it
            board.ask("reboot", key=wire.wire.KEY, bootloader=0)
        return Sent(
            where=board.where,
            board=str(board.identity.serial),
            port=str(board.identity.port),
            before=firmware.version_of(runs.version),
            version=image.version,
            slot=int(runs.slot),
        )


def finish(sent: Sent) -> Updated:
    """The second half of `update`: waits until the board is back and its new firmware is confirmed; asking it, as this
    does, is what confirms it. TautError where the board runs the old firmware again, or has not come back after
    _BACK_S."""
    deadline = time.monotonic() + _BACK_S
    trial = wire.code("FIRMWARES", "TRIAL")
    while True:
        time.sleep(_POLL_S)
        now = _ask_firmware(sent.where)
        if now is not None and now.slot != sent.slot and now.state != trial:
            version = firmware.version_of(now.version)
            return Updated(sent.board, sent.port, before=sent.before, version=version, slot=int(now.slot))
        if now is not None and now.slot == sent.slot and now.other_state != trial:  # else: not restarted yet
            raise TautError(
                f"{sent.board}: firmware {firmware.text_of(sent.version)} did not come up: the board runs "
                f"{firmware.text_of(sent.before)} as before; run 'taut clear', and tell who built the file"
            )
        if time.monotonic() > deadline:
            raise TautError(
                f"{sent.board} has not come back with confirmed firmware: switch it off and on, then see 'taut boards'"
            )


def _ask_firmware(where: str) -> wire.Message | None:
    """Opens the board and asks for its message `firmware`; None where it does not answer, as while it restarts."""
    with contextlib.suppress(TautError), open_board(where) as board:
        return board.ask("get_firmware")
    return None


def _write_image(board: Board, data: bytes, progress: Callable[[float, str], None] | None) -> None:
    """Writes an image, page and content, into the board's free slot by DFU. TautError where the link has no DFU, or the
    board refuses the firmware."""
    dfu = board.firmware_route()
    if dfu is None:
        raise TautError(f"{board.where}: firmware does not travel over a serial line: connect the board by USB")
    try:
        with dfu as route:
            route.download(data, progress, ANSWER_MS)
    except DfuError as error:
        refused = board.ask("get_firmware").refused
        why = wire.text("UPDATES", refused) if refused else str(error)
        raise TautError(f"the board refused the firmware: {why}") from error
