"""New firmware over USB, from the file to what runs. What an image for the desktop board does its first word says; the
emulated board gets the real image, signed with the build's development key."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

import monocypher
import pytest
from passing_time import time_passes
from test_commands import run

from tautline.device import firmware, wire
from tautline.device.board import open_board
from tautline.device.updating import update
from tautline.errors import TautError
from tautline.simulated.simlink import DesktopBoard
from tools.signing import update_file

NEWER, OLDER = (0, 9, 0), (0, 0, 9)
SIZE = 3000  # bytes: a part of a sector


class Keys:
    def __init__(self) -> None:
        self.secret, self.public = map(bytes, monocypher.generate_signing_key_pair())


@pytest.fixture(scope="module")
def keys() -> Keys:
    return Keys()


@pytest.fixture
def desktop(request: pytest.FixtureRequest, keys: Keys) -> Iterator[DesktopBoard]:
    if request.config.getoption("--board") != "desktop":
        pytest.skip("images for the desktop board")
    with DesktopBoard(serial="TEST-1", axes=getattr(request, "param", 1), update_key=keys.public) as board:
        yield board


def give(board: DesktopBoard, file: Path, force: bool = False) -> firmware.Version:
    with contextlib.closing(board.link()) as link, time_passes(link):
        return update(board.where, file, force).version


def file_of(
    folder: Path,
    keys: Keys,
    word: str,
    version: firmware.Version = NEWER,
    port: str = "desktop-1",
    protocol: int = wire.wire.MAJOR,
) -> Path:
    image = word.encode().ljust(SIZE, b"\1")
    path = folder / f"{word}.update"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(firmware, "PROTOCOL", (protocol, 0))
        path.write_bytes(update_file(keys.secret, port, [image, image], version))
    return path


def running(board: DesktopBoard) -> tuple[firmware.Version, str]:
    with open_board(board.where) as opened:
        told = opened.ask("get_firmware")
        return firmware.version_of(told.version), wire.name("FIRMWARES", told.state)


def test_an_update_runs_and_is_confirmed(desktop: DesktopBoard, keys: Keys, tmp_path: Path) -> None:
    first, second = file_of(tmp_path, keys, "one"), file_of(tmp_path, keys, "two", (0, 9, 1))
    assert give(desktop, first) == NEWER
    assert running(desktop) == (NEWER, "CONFIRMED")
    assert give(desktop, second) == (0, 9, 1)
    with pytest.raises(TautError, match=r"is firmware 0\.9\.0, the board runs 0\.9\.1: --force"):
        give(desktop, first)
    assert give(desktop, first, force=True) == NEWER
    assert running(desktop) == (NEWER, "CONFIRMED")


def test_the_command(desktop: DesktopBoard, keys: Keys, tmp_path: Path) -> None:
    file = file_of(tmp_path, keys, "one")
    with contextlib.closing(desktop.link()) as link, time_passes(link):
        done = run("update", str(file), board=desktop.where)
    assert (done["firmware"], done["slot"], done["confirmed"]) == ("0.9.0", 0, True) and done["before"] != "0.9.0"


def test_firmware_that_hangs_gives_way_to_the_old_one(desktop: DesktopBoard, keys: Keys, tmp_path: Path) -> None:
    give(desktop, file_of(tmp_path, keys, "one"))
    for bad in ("hangs", "mute"):
        with pytest.raises(TautError, match=r"did not come up: the board runs 0\.9\.0 as before"):
            give(desktop, file_of(tmp_path, keys, bad, (1, 0, 0)))
        assert running(desktop) == (NEWER, "CONFIRMED")


def test_a_file_that_is_not_for_this_board_is_refused_in_a_line(
    desktop: DesktopBoard, keys: Keys, tmp_path: Path
) -> None:
    good = file_of(tmp_path, keys, "one")
    cut, damaged, none = (tmp_path / name for name in ("cut", "damaged", "none"))
    cut.write_bytes(good.read_bytes()[:-500])
    damaged.write_bytes(good.read_bytes()[:900] + b"\0" + good.read_bytes()[901:])
    none.write_bytes(b"UF2\n" * 300)
    generation = file_of(tmp_path, keys, "generation", protocol=wire.wire.MAJOR + 1)
    stranger = file_of(tmp_path, Keys(), "two")
    with contextlib.closing(desktop.link()) as link:
        for file, says in (
            (cut, "cut short"),
            (damaged, "damaged"),
            (none, "no update file"),
            (tmp_path / "missing", "No such file"),
            (generation, f"speaks protocol {wire.wire.MAJOR + 1}, this tautline"),
            (stranger, "not signed with the key"),
            (file_of(tmp_path, keys, "pico", port="rp2040"), "is for rp2040, this board is desktop-1"),
            (file_of(tmp_path, keys, "three", port="desktop-3"), "is for a desktop with 3 axes, this board has 1: get"),
            (file_of(tmp_path, keys, "four", port="desktop"), "is for a desktop with 4 axes, this board has 1: get"),
        ):
            with pytest.raises(TautError, match=says):
                update(desktop.where, file)
        assert link.ask("state")["flash_operations"] == 0


def test_the_board_itself_refuses_what_a_host_lets_through(
    desktop: DesktopBoard, keys: Keys, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(firmware, "check", lambda _, images, *__: images[0])
    with contextlib.closing(desktop.link()) as link:
        for file, why in (
            (file_of(tmp_path, Keys(), "two"), "SIGNATURE"),
            (file_of(tmp_path, keys, "pico", port="rp2040"), "PORT"),
            (file_of(tmp_path, keys, "three", port="desktop-3"), "PORT"),
            (file_of(tmp_path, keys, "four", port="desktop"), "PORT"),
            (file_of(tmp_path, keys, "old", OLDER), "OLDER"),
        ):
            with pytest.raises(TautError) as refused:
                update(desktop.where, file)
            assert wire.text("UPDATES", wire.code("UPDATES", why)) in str(refused.value)
        assert link.ask("state")["flash_operations"] == 0


@pytest.mark.parametrize("desktop", [4], indirect=True, ids=["four axes"])
def test_a_board_of_all_axes_keeps_what_runs_from_an_image_of_three(
    desktop: DesktopBoard, keys: Keys, tmp_path: Path
) -> None:
    three = file_of(tmp_path, keys, "three", port="desktop-3")
    assert give(desktop, file_of(tmp_path, keys, "four", port="desktop")) == NEWER
    with pytest.raises(TautError, match="is for a desktop with 3 axes, this board has 4: get the file for"):
        give(desktop, three, force=True)
    with open_board(desktop.where) as opened, opened.firmware_route() as route, pytest.raises(TautError):
        route.download(three.read_bytes())
    assert running(desktop) == (NEWER, "CONFIRMED")


def test_a_motor_that_is_on(desktop: DesktopBoard, keys: Keys, tmp_path: Path) -> None:
    with open_board(desktop.where) as board:
        board.trust_motor(0)
        board.ask("enable", axis=0, on=1)
        dfu = board.firmware_route()
        with dfu as route, pytest.raises(TautError):
            route.download(file_of(tmp_path, keys, "one").read_bytes())
        assert wire.name("UPDATES", board.ask("get_firmware").refused) == "NOT_OFF"


def test_a_power_cut_over_usb_leaves_one_that_runs(desktop: DesktopBoard, keys: Keys, tmp_path: Path) -> None:
    give(desktop, file_of(tmp_path, keys, "one"))
    new = file_of(tmp_path, keys, "two", (1, 0, 0))
    version, cut = NEWER, 0
    with contextlib.closing(desktop.link()) as link:
        while version == NEWER:
            cut += 1
            link.ask(f"cut {cut}")
            with contextlib.suppress(TautError), open_board(desktop.where) as board, board.firmware_route() as route:
                route.download(new.read_bytes())
            assert not link.ask("state")["powered"]
            link.ask("reset")
            version, _ = running(desktop)
    # two sectors, the image's pages, its head: the record's first half is the whole of it
    assert version == (1, 0, 0) and cut == 2 + -(-SIZE // 256) + 1 + 1


@pytest.mark.falls_to("m4")
def test_a_board_without_a_key_takes_none(tmp_path: Path, keys: Keys, request: pytest.FixtureRequest) -> None:
    if request.config.getoption("--board") not in ("desktop", "m4"):
        pytest.skip("boards that take updates")
    with (
        DesktopBoard(serial="TEST-1") as board,
        pytest.raises(TautError, match="takes no update over USB: flash it as the first time"),
    ):
        update(board.where, file_of(tmp_path, keys, "one"))
