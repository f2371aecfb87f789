"""The emulated image against the desktop board: the same calibration gives the same tables, damaged tables are told."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tautline import tables
from tautline.device import wire
from tautline.device.board import Board, open_board
from tautline.elements import Elements
from tautline.live.session import MotionOptions, calibrate_live
from tautline.live.setup import Live, PointSource
from tautline.model import Effect, Model
from tautline.simulated.instrument import preset
from tautline.simulated.simlink import PROGRAM, DesktopBoard, SimLink, SimulatedAxis

ROOT = Path(__file__).resolve().parents[2]
EMULATED = ROOT / "tools" / "emulator" / "board.js"
SECTOR = 4096


@pytest.fixture
def emulated(monkeypatch: pytest.MonkeyPatch) -> None:
    if not (ROOT / "build" / "rp2040" / "tautline.bin").is_file():
        pytest.skip("the image is not built: run './run firmware'")
    monkeypatch.setenv(PROGRAM, str(EMULATED))


def made_ready(board: Board, link: SimLink) -> None:
    """The axis is checked, referenced at 0 and off: what a board that was just switched on wants before it moves."""
    board.switch_on(0, lambda seconds: link.ask(f"advance {round(seconds * 1e6)}"))
    board.ask("enable", axis=0, on=0)
    link.ask("advance 20000")
    link.ask("place 0 0")
    board.ask("set_position", axis=0, q=0.0)


def calibrated() -> tuple[Model, float]:
    """The model of the reference instrument as this board measures it, and how long the axis moved, s."""
    with DesktopBoard() as process, open_board(process.where) as board, tempfile.TemporaryDirectory() as folder:
        link = process.link()
        made_ready(board, link)
        instrument = preset("reference")
        plant = SimulatedAxis(link, instrument)
        marker_source = PointSource(plant, noise_px=0.005)  # so that two boards are compared, not two samples of noise
        live = Live(board, instrument.rig, 0, marker_source, plant)
        options = MotionOptions(cycles=3, speeds=(1.4,))
        found, motion = calibrate_live(live, Path(folder) / "recording", options, video=False)
        link.close()
        assert all(onset["used"] for onset in motion.onsets) and len(motion.onsets) >= 12
        return found.model, plant.now_s


def test_a_calibration_gives_the_desktop_boards_tables(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(PROGRAM, raising=False)
    desktop, _ = calibrated()
    request.getfixturevalue("emulated")
    image, moved_s = calibrated()
    assert moved_s <= 120.0
    count = desktop.rig.actuator.encoder_resolution
    inside = (desktop.q > max(desktop.measured[0], image.measured[0])) & (
        desktop.q < min(desktop.measured[1], image.measured[1])
    )
    width = np.interp(desktop.q, image.q, image.width) - desktop.width
    slope = np.gradient(desktop.c_deg, desktop.q)
    angle = (np.interp(desktop.q, image.q, image.c_deg) - desktop.c_deg) / slope
    print(f"largest difference: B {np.abs(width[inside]).max() / count:.2f} counts, "
          f"f_remain {np.abs(angle[inside]).max() / count:.2f} counts")  # fmt: skip
    assert np.abs(width[inside]).max() <= 2.0 * count
    assert np.abs(angle[inside]).max() <= 2.0 * count


def blob(scale: float) -> bytes:
    instrument = preset("reference")
    q = np.linspace(-5.0, 5.0, 257)
    width = scale * instrument.backlash(q)
    model = Model(instrument.rig, q, width, np.full_like(q, 0.001), instrument.bend(q), 0.08, (-4.5, 4.5))
    return tables.encode(model, axis=0, created_s=0)


@pytest.mark.usefixtures("emulated")
def test_a_flipped_bit_in_a_slot_leaves_the_other_table_or_a_fault(tmp_path: Path) -> None:
    flash = tmp_path / "flash.bin"
    old, new = blob(1.0), blob(0.5)
    with DesktopBoard(flash=flash) as process, open_board(process.where) as board:
        board.load_table(0, old)
        board.load_table(0, new)
    stored = flash.read_bytes()
    slots = [stored[:SECTOR], stored[SECTOR : 2 * SECTOR]]
    newest = next(i for i, slot in enumerate(slots) if new in slot)
    rng = np.random.default_rng(11)
    for hurt in ([newest], [1 - newest], [0, 1]):
        damaged = bytearray(stored)
        for slot in hurt:
            content = slots[slot]
            start = content.index(new if slot == newest else old)
            bit = int(rng.integers(8 * len(new)))
            damaged[slot * SECTOR + start + bit // 8] ^= 1 << bit % 8
        flash.write_bytes(bytes(damaged))
        with DesktopBoard(flash=flash) as process, open_board(process.where) as board:
            status = board.status(0)
            if hurt == [0, 1]:
                assert status.fault == wire.code("FAULTS", "TABLE") and status.table == wire.code("TABLES", "BAD")
                assert board.read_table(0) == b""
            else:
                assert status.fault == 0
                assert board.read_table(0) == (old if hurt == [newest] else new)


@pytest.mark.usefixtures("emulated")
@pytest.mark.parametrize(("kind", "after_us"), [("hardfault", 40_000), ("nmi", 40_313), ("panic", 40_777)])
def test_a_crash_of_the_processor_coasts_every_bridge_first(kind: str, after_us: int) -> None:
    """With an axis driving: before the breakpoint that a debugger sees; without one the watchdog restarts the board."""
    with DesktopBoard() as process:
        link = process.link()
        with open_board(process.where) as board:
            made_ready(board, link)
            board.ask("enable", axis=0, on=1)
            board.ask("move", axis=0, q=3000.0, speed_s=6000.0)
            link.ask("advance 60000")
            link.ask(f"advance {after_us}")
        assert abs(link.ask("state")["axes"][0]["duty_q15"]) > 3000
        crash = link.ask(f"crash {kind}")
        assert crash["locked_up"] and crash["us"] < 5.0
        driven = crash["before"][:2]
        assert max(driven) == 1.0 and min(driven) < 0.95 and crash["before"][2:] == [1.0] * 6  # these brake
        assert crash["after"] == [0.0] * 8
        before = link.ask("state")["q"][0]
        link.ask("advance 20000")
        assert link.ask("state")["q"][0] > before + 20 * 256, "it coasts"
        link.ask("advance 600000")
        after = link.ask("state")
        assert after["starts"] == 2
        moved = [link.ask("advance 20000")["q"][0][-1] for _ in range(20)]
        assert moved[-1] == moved[-5], "the motor is at rest"
        with open_board(process.where) as board:
            status = board.status(0)
            assert status.fault == wire.code("FAULTS", "WATCHDOG") and status.mode == wire.code("MODES", "OFF")
        link.close()


@pytest.mark.usefixtures("emulated")
def test_a_debugger_that_holds_the_core_leaves_no_motor_running() -> None:
    """PWM goes on with the last duty; the watchdog bites all the same."""
    with DesktopBoard() as process:
        link = process.link()
        with open_board(process.where) as board:
            made_ready(board, link)
            board.ask("enable", axis=0, on=1)
            board.ask("move", axis=0, q=3000.0, speed_s=6000.0)
            link.ask("advance 60000")
        assert abs(link.ask("state")["axes"][0]["duty_q15"]) > 3000
        link.ask("halt")
        link.ask("advance 400000")
        after = link.ask("state")
        assert after["starts"] == 2 and after["axes"][0]["duty_q15"] == 0
        with open_board(process.where) as board:
            assert board.status(0).fault == wire.code("FAULTS", "WATCHDOG")
        link.close()


@pytest.mark.usefixtures("emulated")
@pytest.mark.parametrize("state", ["off", "hold", "move", "follow", "calibrate"])
def test_the_watchdog_bites_in_every_state(state: str) -> None:
    """The main loop hangs: the board restarts, every motor off, and says why."""
    with DesktopBoard() as process:
        link = process.link()
        with open_board(process.where) as board:
            board.load_table(0, blob(1.0))
            if state != "off":
                made_ready(board, link)
                board.ask("enable", axis=0, on=1)
            if state == "move":
                board.ask("move", axis=0, q=2000.0, speed_s=1000.0)
            elif state == "follow":
                board.ask("follow", axis=0, target=0, silence_us=5_000_000)
                board.tell("set_point", axis=0, value=400 * 256, at_us=0)
            elif state == "calibrate":
                board.ask("motion_start", axis=0, cycles=2, low=-3000.0, high=3000.0, speed_s=[700.0, 0.0, 0.0, 0.0],
                          transit_s=1400.0, acceleration_s2=20000.0, approach=400.0, stroke_max=1500.0,
                          host_timeout_us=500_000, delay_us=80_000)  # fmt: skip
            link.ask("advance 60000")
            link.ask("hang")
            link.ask("advance 600000")
        after = link.ask("state")
        assert after["starts"] == 2 and after["board_us"] < 600_000
        moved = [link.ask("advance 20000")["q"][0][-1] for _ in range(20)]
        assert moved[-1] == moved[-5], "the motor is at rest"
        with open_board(process.where) as board:
            assert board.identity.boot == wire.code("BOOTS", "WATCHDOG")
            status = board.status(0)
            assert status.fault == wire.code("FAULTS", "WATCHDOG") and status.mode == wire.code("MODES", "OFF")
            assert board.read_table(0) == blob(1.0)
        link.close()


def all_that_is_undone() -> bytes:
    """A table of seven plays and all that models bring, which may be moved."""
    instrument = preset("reference")
    q = np.linspace(-5.0, 5.0, 257)
    effects = (
        Effect("actuator.encoder_periodic", {"encoder_sin": 0.01, "encoder_cos": 0.006, "encoder_sin2": 0.002,
                                             "encoder_cos2": 0.001, "encoder_period": 0.5}),
        Effect("transmission.lag", {"lag": 0.05, "lag_second": 0.2}),
        Effect("transmission.creep", {"creep_share": 0.1, "creep_time": 1.0, "creep_slow": 0.3}),
        Effect("transmission.asymmetric_backlash", {"asymmetry": 0.1, "asymmetry_travel": 0.3, "asymmetry_form": 1.0,
                                                    "asymmetry_renewed": 1.0}),
    )  # fmt: skip
    weight = (0.2, 0.1, 0.1, 0.15, 0.15, 0.2, 0.1)
    share = np.array([0.2, 0.5, 0.8, 1.0, 1.2, 1.5, 1.8])
    elements = Elements(tuple(share / (np.array(weight) @ share)), weight)
    model = Model(instrument.rig, q, 0.4 + 0.01 * q, 0 * q, instrument.bend(q), 0.08, (-4.5, 4.5),
                  elements=elements, effects=effects)  # fmt: skip
    limits = replace(tables.Limits.of(model.rig), adapt=(0.4, 0.5, 1.5))
    return tables.encode(model, axis=0, created_s=0, limits=limits)


@pytest.mark.usefixtures("emulated")
def test_no_command_keeps_the_control_step_out() -> None:
    """Interrupts are off for 6.5 us at most, even with nothing of what is needed in the flash cache."""
    longest: dict[str, tuple[float, str]] = {}
    with DesktopBoard() as process, open_board(process.where) as board:
        link = process.link()
        board.load_table(0, all_that_is_undone())
        made_ready(board, link)
        link.ask("locks")

        def ask(name: str, **values: object) -> None:
            board.ask(name, **values)
            link.ask("advance 3000")
            worst = link.ask("locks")
            longest[name] = max(longest.get(name, (0.0, "")), (worst["us"], worst["from"]))
            longest["usb"] = max(longest.get("usb", (0.0, "")), (worst["usb_us"], ""))

        gains = dict(board.ask("get_servo", axis=0).values)
        limits = dict(board.ask("get_limits", axis=0).values)
        for name in ("get_status", "get_settings", "get_servo", "get_limits", "telemetry", "set_position", "strength"):
            ask(name, axis=0, **{"telemetry": {"divider": 1}, "set_position": {"q": 100.0},
                                 "strength": {"strength": 0.9}}.get(name, {}))  # fmt: skip
        ask("servo", **gains)
        ask("limits", **limits)
        ask("check", axis=0)
        link.ask("advance 900000")
        ask("ping", host_us=1)
        ask("home", axis=0, direction=1, reach=300.0, end=0.0, retreat=40.0)
        link.ask("advance 100000")
        link.ask("inject 0 blocked")
        while not board.status(0).flags & wire.code("FLAGS", "REFERENCED"):
            ask("ping", host_us=1)
            link.ask("advance 10000")
        link.ask("inject 0 well")
        ask("ping", host_us=1)
        link.ask("advance 300000")
        ask("jog", axis=0, way=-50.0)
        link.ask("advance 300000")
        ask("move", axis=0, q=100.0)
        link.ask("advance 300000")
        ask("follow", axis=0, target=1, compensation=2, silence_us=5_000_000)
        ask("strength", axis=0, strength=0.8)
        ask("adapt", axis=0, offset=20.0, scale=0.9, within_ms=300)
        ask("load", axis=0, load=4.0, within_ms=100)
        for value in (3 * 65536, 65536, 65536 // 2):
            board.tell("set_point", axis=0, value=value, at_us=0)
            ask("get_status", axis=0)
        ask("enable", axis=0, on=0)
        link.ask("advance 300000")
        ask("enable", axis=0, on=1)
        ask("follow", axis=0, target=0, silence_us=5_000_000)
        ask("enable", axis=0, on=0)
        link.ask("advance 300000")
        ask("enable", axis=0, on=1)
        ask("motion_start", axis=0, cycles=2, low=-3000.0, high=3000.0, speed_s=[700.0, 0.0, 0.0, 0.0],
            transit_s=1400.0, acceleration_s2=20000.0, approach=400.0, stroke_max=1500.0,
            host_timeout_us=500_000, delay_us=80_000)  # fmt: skip
        ask("motion_stop", axis=0)
        link.ask("advance 300000")
        ask("safe_stop", axis=0)
        ask("clear_fault", axis=0)
        ask("get_counters", clear=1)
        link.close()
    assert longest.pop("usb")[0] < 20.0  # TinyUSB's own queue, in the SDK's sources
    assert not {name: value for name, value in longest.items() if value[0] > 6.5}
