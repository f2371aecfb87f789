"""`taut ros` before any board is there: its parameters, its arguments, what it takes out of a message.

What it does with a board is in tests/board/test_ros.py, motors behind ROS topics in test_drivers.py.
"""

from __future__ import annotations

import math
import os
import sys
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from cli_runner import Taut
from reference_instrument import saved_model

from tautline.drivers.ros_graph import Graph, library
from tautline.errors import TautError
from tautline.ros.messages import NS, position_of, stamp

pytest.importorskip("rclpy", reason="the index has no ROS 2 for this Python or machine: source one, or leave it")


@dataclass
class JointState:
    name: list[str] = field(default_factory=list)
    position: list[float] = field(default_factory=list)


@pytest.mark.parametrize(
    ("message", "position"),
    [
        (JointState(["shaft", "tip"], [1.0, 2.0]), 2.0),
        (JointState(["tip"], [0.5]), 0.5),
        (JointState([], [0.5]), 0.5),  # CRTK's clients may leave the names out
        (JointState([], [0.5, 0.6]), None),
        (JointState(["shaft"], [1.0]), None),
        (JointState(["shaft", "tip"], [1.0]), None),
        (JointState(["tip"], [math.nan]), None),
        (JointState(["tip"], [-math.inf]), None),
        (JointState(["tip"], [1e6]), None),  # no angle of the board
        (JointState(["tip"], [-499.0]), -499.0),
        (JointState(["tip"], [math.inf]), None),
        (JointState(), None),
    ],
)
def test_a_set_point_is_the_joints_own(message: JointState, position: float | None) -> None:
    assert position_of(message, "tip") == position


def test_a_stamp_is_whole_nanoseconds() -> None:
    at = stamp(1_795_473_421_545_270_901)
    assert at.sec * NS + at.nanosec == 1_795_473_421_545_270_901


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ("update_rate:=5", "50 to 500"),
        ("update_rate:=fast", "update_rate"),
        ("cmd_timeout:=5.0", "0.01 to 2"),
        ("joints:=['a', 'b']", "names 2 joints"),
        ("joints:=['motor']", "both 'motor'"),
    ],
)
def test_a_parameter_that_cannot_be_used_is_one_line(given: str, says: str, tmp_path: Path, taut: Taut) -> None:
    line = taut.refuses("ros", saved_model(tmp_path / "model"), "--ros-args", "-p", given)
    assert "parameter" in line and says in line


def test_what_ros_does_not_understand_is_one_line() -> None:
    with pytest.raises(TautError, match=r"does not start a node with --ros-args -r __ns==: "):
        Graph("tautline", ["--ros-args", "-r", "__ns=="])


def test_a_misspelt_option_is_no_argument_of_ros(tmp_path: Path, taut: Taut) -> None:
    done = taut("ros", saved_model(tmp_path / "model"), "--boord", "usbip:127.0.0.1:1")
    assert done.code == 2 and "--boord" in done.err and "--ros-args" in done.err


def test_a_graph_is_this_machines_alone_unless_it_is_said_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    name = "ROS_AUTOMATIC_DISCOVERY_RANGE"
    for given, kept in ((None, "LOCALHOST"), ("SUBNET", "SUBNET")):
        monkeypatch.delenv(name, raising=False)
        if given is not None:
            monkeypatch.setenv(name, given)
        with Graph("tautline"):
            assert os.environ[name] == kept


def test_without_ros_its_remedy_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    with pytest.raises(TautError, match=r"source its set-up, or run 'pip install 'tautline-robotics\[ros\]''"):
        library("rclpy")
