"""`taut ros` on a paced board, and a client of it in a process of its own (ros_client.py, plain rclpy)."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
import pytest
from click.testing import CliRunner
from ros_node import WIDTH_MM, instrument
from rosbags import rosbag2
from rosbags.typesys import Stores, get_typestore

from conftest import ClockOf
from tautline.cli import taut
from tautline.device import wire
from tautline.device.board import open_board
from tautline.drivers.ros_graph import Graph, library
from tautline.model import Model, Uncertainty
from tautline.recording import load
from tautline.simulated.instrument import reference_rig
from tautline.simulated.simlink import DesktopBoard

pytest.importorskip("rclpy", reason="the index has no ROS 2 for this Python or machine: source one, or leave it")

RIG = reference_rig()
DELAY_S = 0.08
AMPLITUDE_RAD, PERIOD_S = 0.25, 3.0  # of the client's sine
HERE = Path(__file__).parent
TYPES = {"joint_states": "sensor_msgs/msg/JointState", "tracked_px": "geometry_msgs/msg/PointStamped"}


def saved_model(folder: Path) -> Path:
    q = np.linspace(*RIG.actuator.range, 401)
    errs = Uncertainty(noise=0.5)  # times are as good as this machine keeps them
    own = RIG.actuator.range
    Model(RIG, q, WIDTH_MM + 0 * q, 0.001 + 0 * q, instrument().bend(q), DELAY_S, own, uncertainty=errs).save(folder)
    return folder


@contextmanager
def referenced() -> Iterator[DesktopBoard]:
    with DesktopBoard(realtime=True) as desktop:
        with open_board(desktop.where) as board:
            board.trust_motor(0)
            board.ask("set_position", axis=0, q=0.0)
        yield desktop


@dataclass
class Heard:
    """What the client sent and what came to it, by topic."""

    sent: list[dict[str, float]]
    rows: dict[str, list[dict[str, Any]]]

    def joint(self, topic: str, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Stamps, s, and positions, rad or m."""
        rows = self.rows[topic]
        t_s = np.array([row["stamp_ns"] for row in rows]) * 1e-9
        return t_s, np.array([row["positions"][row["names"].index(name)] for row in rows])


def client(namespace: str, out: Path, seconds: float) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, str(HERE / "ros_client.py"), namespace, str(out), str(seconds)])


def node(desktop: DesktopBoard, model: Path, namespace: str, *options: str, camera: bool) -> subprocess.Popen[bytes]:
    """`taut ros`; options stand behind --ros-args."""
    port = str(desktop.ports["sim"]) if camera else "-"
    words = [port, str(model), "--board", desktop.where, "--json", *(["--camera", "0"] if camera else [])]
    words += ["--ros-args", "-r", f"__ns:={namespace}", *options]
    return subprocess.Popen([sys.executable, str(HERE / "ros_node.py"), *words], stdout=subprocess.PIPE)


@pytest.fixture
def namespace(monkeypatch: pytest.MonkeyPatch) -> str:
    """Of this test alone: others run beside it on one machine."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return f"/n{uuid4().hex[:12]}"


def bag_of(heard: Heard, namespace: str, path: Path) -> Path:
    """The topics as a recorder leaves them: each message's own bytes, by when it came."""
    store = get_typestore(Stores.LATEST)
    rows = sorted((row["log_ns"], topic, row["cdr"]) for topic in TYPES for row in heard.rows[topic])
    with rosbag2.Writer(path, version=9) as writer:
        connections = {
            topic: writer.add_connection(f"{namespace}/{topic}", kind, typestore=store) for topic, kind in TYPES.items()
        }
        for log_ns, topic, raw in rows:
            writer.write(connections[topic], log_ns, bytes.fromhex(raw))
    return path


def heard_in(folder: Path) -> Heard:
    document = json.loads((folder / "heard.json").read_text())
    return Heard(document["sent"], document["heard"])


def test_a_client_in_another_process_leads_the_tip(tmp_path: Path, namespace: str, wall_clock: ClockOf) -> None:
    with referenced() as desktop:
        clock = wall_clock(desktop.link())
        model = saved_model(tmp_path / "model")
        process = node(desktop, model, namespace, "-p", "update_rate:=200", camera=True)
        assert client(namespace, tmp_path, 3.5).wait(40.0) == 0
        process.send_signal(signal.SIGTERM)
        out, _ = process.communicate(timeout=20.0)
        clock.need()
    assert process.returncode == 0
    result, heard = json.loads(out), heard_in(tmp_path)
    assert result["refused"] == result["unusable"] == 0
    assert result["sent"] + result["replaced"] == result["received"] >= 0.95 * len(heard.sent)
    assert result["tracking"]["frames"] > 80
    the_tip_is_led(heard)
    the_tip_is_tracked(heard)
    states = [row["values"] for row in heard.rows["/diagnostics"]]
    assert states[-1]["tracking"] == "trusted" and states[-1]["verdict"] == "good"
    assert all(row["name"] == f"{namespace}/tautline: tip" for row in heard.rows["/diagnostics"])
    a_bag_of_it_is_the_same_recording(heard, namespace, tmp_path)


def the_tip_is_led(heard: Heard) -> None:
    t_s, c = heard.joint("setpoint_js", "tip")
    t_motor_s, motor = heard.joint("motor/setpoint_js", "motor")
    sent = np.array([row["c"] for row in heard.sent])
    began_s = 1e-9 * heard.sent[0]["t_ns"]
    assert (c.min(), c.max()) == pytest.approx((sent.min(), sent.max()), abs=2e-3)
    # Its stamps are the board's own times, 5 ms apart to what aligning clocks costs.
    assert np.median(np.diff(t_s)) == pytest.approx(0.005, abs=1e-4) and np.diff(t_s).min() > 0.0
    # p = f^-1(c), and the motor is half a width before it on the side it pushes to.
    grid = np.linspace(-5.0, 5.0, 4001)
    p_mm = np.interp(np.degrees(np.interp(t_motor_s, t_s, c)), instrument().bend(grid), grid)
    speed = np.gradient(p_mm, t_motor_s)
    fast = np.degrees(AMPLITUDE_RAD) * 2.0 * np.pi / PERIOD_S / 12.4  # the sine's, mm/s of p
    moves = (t_motor_s > began_s + 0.5) & (t_motor_s < began_s + 3.4) & (np.abs(speed) > 0.5 * fast)
    for way in (1.0, -1.0):
        before = (1e3 * motor - p_mm)[moves & (np.sign(speed) == way)]
        assert len(before) > 60
        # What remains is the motor's lead of the plan, 2.4 ms of at most 2.4 mm/s.
        assert np.median(before) == pytest.approx(way * 0.5 * WIDTH_MM, abs=0.01)
    # It rests where set-points have stopped.
    _, q = heard.joint("joint_states", "motor")
    assert 1e3 * np.ptp(q[-30:]) < 0.005 and 1e3 * np.ptp(q) > 1.0


def the_tip_is_tracked(heard: Heard) -> None:
    """Beside what the board says by its encoder, at the time that a frame shows."""
    t_s, seen = heard.joint("tracked_js", "tip")
    t_board_s, by_encoder = heard.joint("measured_js", "tip")
    inside = (t_s > t_board_s[0]) & (t_s < t_board_s[-1])
    off = seen[inside] - np.interp(t_s[inside], t_board_s, by_encoder)
    assert inside.sum() > 80
    # 0.05 px of 1.3 px/deg, and a frame's time is known to a few ms of 0.5 rad/s: the camera has a clock of its own.
    assert np.sqrt(np.mean((off - np.median(off)) ** 2)) < 0.02
    assert abs(len(heard.rows["tracked_px"]) - len(heard.rows["tracked_js"])) <= 1  # the client ends between two


def a_bag_of_it_is_the_same_recording(heard: Heard, namespace: str, folder: Path) -> None:
    bag = bag_of(heard, namespace, folder / "bag")
    told = [
        "import",
        str(bag),
        "--out",
        str(folder / "rec"),
        "--rig",
        str(folder / "model" / "rig.toml"),
        "--unit",
        "mm",
    ]
    told += ["--motor", f"{namespace}/joint_states.position[motor]:m"]
    told += ["--tip", f"{namespace}/tracked_px.point.x", "--tip", f"{namespace}/tracked_px.point.y"]
    done = CliRunner().invoke(taut, told)
    assert done.exit_code == 0, done.output
    recording = load(folder / "rec")
    t_s, q = heard.joint("joint_states", "motor")
    seen = heard.rows["tracked_px"]
    t_seen_s = np.array([row["stamp_ns"] for row in seen]) * 1e-9
    marker = recording.marker
    assert marker is not None and recording.motor.t_s.shape == t_s.shape
    # Files hold microseconds, 7 digits of q and 0.1 mpx.
    assert np.ptp(recording.motor.t_s - t_s) < 3e-6
    np.testing.assert_allclose(recording.motor.q, 1e3 * q, rtol=1e-6, atol=1e-6)
    assert np.ptp(marker.t_s - t_seen_s) < 3e-6
    assert marker.t_s[0] - recording.motor.t_s[0] == pytest.approx(t_seen_s[0] - t_s[0], abs=3e-6)
    np.testing.assert_allclose(marker.u_px, [row["u"] for row in seen], atol=6e-5)
    np.testing.assert_allclose(marker.v_px, [row["v"] for row in seen], atol=6e-5)


@pytest.mark.wall_clock
def test_a_fault_ends_it_though_no_set_point_comes(tmp_path: Path, namespace: str) -> None:
    with referenced() as desktop, Graph("watcher") as graph:
        runs = threading.Event()
        kind = library("sensor_msgs.msg").JointState
        graph.node.create_subscription(kind, f"{namespace}/joint_states", lambda _: runs.set(), 10)
        graph.begin()
        process = node(desktop, saved_model(tmp_path / "model"), namespace, camera=False)
        try:
            assert runs.wait(30.0)
            with closing(desktop.link()) as link:
                link.ask("inject 0 estop")
            assert process.wait(10.0) == 1
        finally:
            process.kill()
            process.communicate()


@pytest.mark.wall_clock
def test_a_robot_in_another_process(namespace: str) -> None:
    """Its joint as the motor: tests/host/ros_robot.py."""
    address = f"ros:{namespace}/joint_states,{namespace}/commands:joint_1?rate=50"
    robot = subprocess.Popen(
        [sys.executable, str(HERE.parent / "host" / "ros_robot.py"), namespace], stdin=subprocess.PIPE
    )
    try:
        with open_board(address) as board:
            assert board.bus()["drives"] == ["joint_1: revolute, firmware -, 4096 counts a turn"]
            board.switch_on(0)
            board.ask("move", axis=0, q=300.0, speed_s=2000.0)
            end = time.monotonic() + 10.0
            while abs(board.status(0).q - 300.0) > 5.0 and time.monotonic() < end:
                time.sleep(0.02)
            assert board.status(0).q == pytest.approx(300.0, abs=5.0)
    finally:
        assert robot.stdin is not None
        robot.stdin.close()
        robot.wait(10.0)


def test_it_ends_with_the_motor_at_rest_and_off(tmp_path: Path, namespace: str, wall_clock: ClockOf) -> None:
    with referenced() as desktop:
        clock = wall_clock(desktop.link())
        process = node(desktop, saved_model(tmp_path / "model"), namespace, camera=False)
        other = client(namespace, tmp_path, 60.0)
        link = desktop.link()
        places: list[int] = []  # 1/256 counts; checking the motor moves it by a hundred
        began = time.monotonic()
        while np.ptp(places or [0]) < 256 * 400 and time.monotonic() < began + 30.0:
            time.sleep(0.02)
            places.append(link.ask("state")["q"][0])
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=20.0)
        other.kill()
        other.wait()
        link.close()
        clock.need()
        assert process.returncode == 0 and json.loads(out)["sent"] > 0
        with open_board(desktop.where) as board:
            status = board.status(0)
            assert status.mode == wire.code("MODES", "OFF") and not status.fault
            assert status.flags & wire.code("FLAGS", "AT_REST")
