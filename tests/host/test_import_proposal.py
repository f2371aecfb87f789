"""What is proposed: by what moves with what, and after what; and that its command does as it says."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import import_files as files
import numpy as np
import pytest
from cli_runner import Taut
from hypothesis import given
from hypothesis import strategies as st

import tautline as tl
from tautline.errors import TautError
from tautline.io.importing import clocks
from tautline.io.importing.units import (
    DEG_PER_RAD,
    UNITS,
    Named,
    factor,
    known_unit,
    parse_channel,
    suspected_unit,
    unit_in,
)

RATE_HZ, WIDTH, LAG_S, SERVO_S = 100.0, 2.0, 0.06, 0.04


def robot(seed: int = 1, seconds: float = 60.0) -> dict[str, np.ndarray]:
    """A servo that follows its command, friction on it, a tip behind a play that is seen late, and things that move by
    themselves."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(0.0, seconds, 1.0 / RATE_HZ)
    wave = sum(rng.uniform(5, 15) * np.sin(2 * np.pi * f * t_s + rng.uniform(0, 6)) for f in (0.11, 0.23, 0.37))
    motor = np.interp(t_s - SERVO_S, t_s, wave) + 0.01 * rng.normal(size=len(t_s))
    late = np.interp(t_s - LAG_S, t_s, motor)
    state, tip = late[0], []
    for q in late:
        state = min(max(state, q - 0.5 * WIDTH), q + 0.5 * WIDTH)
        tip.append(state)
    other = 20.0 * np.sin(0.9 * t_s + 1.0) + rng.normal(size=len(t_s))
    return {
        "t": t_s,
        "command": wave,
        "motor": motor,
        "tip": 0.9 * np.array(tip) + 0.02 * rng.normal(size=len(t_s)),
        "load": 40.0 * np.sign(np.gradient(motor)) + 5.0 * rng.normal(size=len(t_s)),
        "other": other,
        "volts": 12.0 + 0.1 * rng.normal(size=len(t_s)),
    }


def table(folder: Path, columns: Mapping[str, np.ndarray], scale: Mapping[str, float] | None = None) -> Path:
    path = folder / "log.csv"
    scaled = [values * (scale or {}).get(name, 1.0) for name, values in columns.items()]
    rows = [",".join(f"{x:.7g}" for x in row) for row in zip(*scaled, strict=True)]
    path.write_text("\n".join([",".join(columns), *rows, ""]))
    return path


def proposed(taut: Taut, *words: str | Path) -> dict[str, Any]:
    done = taut("import", *words, "--json")
    assert done.code == 0, done.err
    result: dict[str, Any] = json.loads(done.out)
    return result


@pytest.mark.parametrize("seed", range(4))
def test_roles_are_told_from_the_motion_alone(taut: Taut, tmp_path: Path, seed: int) -> None:
    """Columns in any order whose names say nothing."""
    made = robot(seed)
    names = ["command", "motor", "tip", "load", "other", "volts"]
    order = [int(k) for k in np.random.default_rng(seed).permutation(len(names))]
    columns = {"t": made["t"]} | {f"x{k}": made[names[i]] for k, i in enumerate(order)}
    found = proposed(taut, table(tmp_path, columns))["proposal"]
    called = {names[i]: f"x{k}" for k, i in enumerate(order)}
    assert found["command"] == f"{called['command']}:deg", (called, found)
    assert found["motor"] == f"{called['motor']}:deg" and found["tip"] == [f"{called['tip']}:deg"]
    assert found["load"] == called["load"] and found["video"] is None


@pytest.mark.parametrize("stronger", ["x3", "x4"])
def test_the_load_is_what_goes_most_with_the_direction(taut: Taut, tmp_path: Path, stronger: str) -> None:
    """Two columns go with the direction of the motor's motion, one of them with much beside it."""
    made = robot()
    beside = 40.0 * np.random.default_rng(5).normal(size=len(made["t"]))
    columns = {"t": made["t"], "x0": made["command"], "x1": made["motor"], "x2": made["tip"]}
    columns |= {name: made["load"] + (name != stronger) * 0.6 * beside for name in ("x3", "x4")}
    assert proposed(taut, table(tmp_path, columns))["proposal"]["load"] == stronger


def test_the_command_that_is_printed_writes_what_was_proposed(taut: Taut, tmp_path: Path) -> None:
    """Radians in a table without units: guessed, said, and in the command."""
    made = robot()
    columns = {"Zeit": made["t"], "Soll": made["command"], "Ist": made["motor"], "Gelenk": made["tip"]}
    scale = dict.fromkeys(("Soll", "Ist", "Gelenk"), 1.0 / DEG_PER_RAD)
    path = table(tmp_path, columns, scale)
    before = sorted(tmp_path.iterdir())
    result = proposed(taut, path, "--out", tmp_path / "out")
    assert sorted(tmp_path.iterdir()) == before
    assert sum("rad is a guess" in note for note in result["notes"]) == 2
    words = shlex.split(result["command"])
    assert words[:2] == ["taut", "import"] and "Ist:rad" in words and "Gelenk:rad" in words and "Soll:rad" in words
    assert taut(*words[1:]).code == 0
    recording = tl.load(tmp_path / "out")
    assert recording.angle is not None and recording.motor.q_cmd is not None
    np.testing.assert_allclose(recording.motor.q, made["motor"], atol=1e-3)
    np.testing.assert_allclose(recording.angle.c_deg, made["tip"], atol=1e-3)
    np.testing.assert_allclose(recording.motor.q_cmd, made["command"], atol=1e-3)


def test_a_bag_with_a_tip_pose(taut: Taut, tmp_path: Path) -> None:
    made = robot()
    t_s = made["t"][::2]
    joints = {"base": np.radians(made["other"][::2]), "jaw": np.radians(made["motor"][::2])}
    effort = {"base": 0.01 * np.cos(t_s), "jaw": 1e-3 * made["load"][::2]}
    tip = (made["t"][::4], np.radians(made["tip"][::4]))
    path = files.mcap_ros2(tmp_path / "robot.mcap", t_s, joints, tip, effort)
    result = proposed(taut, path)
    assert result["proposal"] == {
        "motor": "/joint_states.position[1]:rad",
        "tip": ["/tip_pose.pose.orientation:deg"],
        "command": None,
        "load": "/joint_states.effort[1]:Nm",
        "video": None,
        "unit": "deg",
    }
    channel = next(each for each in result["channels"] if each["name"] == "/joint_states.position[1]")
    assert channel["label"] == "jaw" and channel["count"] == len(t_s) and channel["rate_hz"] == pytest.approx(50.0)
    assert channel["low"] == pytest.approx(np.radians(made["motor"][::2]).min())


def test_a_joint_keeps_its_number_when_messages_name_joints_in_another_order(taut: Taut, tmp_path: Path) -> None:
    """Two publishers on one topic: each joint's rows are those that name it."""
    made = robot(seconds=20.0)
    t_s = made["t"]
    path = tmp_path / "two.mcap"
    rows: list[tuple[float, dict[str, float]]] = []
    for k, t in enumerate(t_s):
        rows.append((t, {"jaw": made["motor"][k], "base": 1.0} if k % 2 else {"base": 1.0, "jaw": made["motor"][k]}))
        rows.append((t + 0.003, {"gripper": 7.0}))
    with path.open("wb") as stream:
        writer = files.Ros2Writer(stream)
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", files.JOINT_STATE)
        pose = writer.register_msgdef("geometry_msgs/msg/PoseStamped", files.POSE)
        for t, joints in rows:
            message = {"header": files.stamp(files.ns(t)), "name": list(joints), "velocity": [], "effort": []}
            message["position"] = [np.radians(v) for v in joints.values()]
            writer.write_message("/joint_states", schema, message, files.ns(t), files.ns(t))
        for t, angle in zip(t_s, np.radians(made["tip"]), strict=True):
            turned = {"x": 0.0, "y": np.sin(angle / 2), "z": 0.0, "w": np.cos(angle / 2)}
            pose_message = {
                "header": files.stamp(files.ns(t)),
                "pose": {"position": {"x": 0, "y": 0, "z": 0}, "orientation": turned},
            }
            writer.write_message("/tip", pose, pose_message, files.ns(t), files.ns(t))
        writer.finish()
    words = ("--motor", "/joint_states.position[jaw]", "--tip", "/tip.pose.orientation")
    done = taut("import", path, "--out", tmp_path / "out", *words)
    assert done.code == 0 and "without a number" not in done.err, done.err
    np.testing.assert_allclose(tl.load(tmp_path / "out").motor.q, made["motor"], atol=1e-9)


def test_a_data_set_proposes_a_joint_that_moves(taut: Taut, tmp_path: Path) -> None:
    made = robot()
    still = 0.02 * np.sin(made["t"])
    action = {"pan.pos": still, "elbow.pos": made["command"], "grip.pos": 5.0 * np.round(still / 0.02)}
    state = {"pan.pos": still, "elbow.pos": made["motor"], "grip.pos": 0 * still}
    path = files.lerobot(tmp_path / "set", [(made["t"], action, state)] * 2, camera=32)
    result = proposed(taut, path, "--episode", "1")
    assert result["proposal"]["motor"] == "action[1]:deg" and result["proposal"]["tip"] == ["observation.state[1]:deg"]
    assert result["proposal"]["video"] == "observation.images.wrist" and "--episode 1" in result["command"]
    assert any("what was commanded" in note for note in result["notes"]) and result["episodes"] == 2
    assert "says no unit" in taut("import", path).err


@pytest.mark.parametrize(
    "motor, tip, units",
    [
        (20.0, 18.0, ("deg", "deg")),
        (20.0, 3.0, ("deg", "deg")),  # a tip that moves 57 times more than its motor is none
        (20.0, 0.3, ("deg", "rad")),
        (0.3, 18.0, ("rad", "deg")),
        (0.8, 0.1, ("rad", "rad")),
        (3.0, 2.0, ("rad", "rad")),
        (6.0, 7.0, ("deg", "deg")),
    ],
)
def test_motor_and_tip_share_a_unit_unless_their_ratio_says_otherwise(
    taut: Taut, tmp_path: Path, motor: float, tip: float, units: tuple[str, str]
) -> None:
    made = robot()
    scale = {name: to / np.abs(made[name]).max() for name, to in (("motor", motor), ("tip", tip))}
    columns = {"t": made["t"], "motor": made["motor"], "tip": made["tip"]}
    found = proposed(taut, table(tmp_path, columns, scale))["proposal"]
    assert (found["motor"], found["tip"]) == (f"motor:{units[0]}", [f"tip:{units[1]}"])


@pytest.mark.parametrize("full", [1.0, 100.0])
def test_what_ends_at_full_scale_is_told_to_be_a_share(taut: Taut, tmp_path: Path, full: float) -> None:
    made = robot()
    columns = {"t": made["t"]} | {
        name: full * np.clip(1.2 * made[name] / np.abs(made[name]).max(), -1.0, 1.0) for name in ("motor", "tip")
    }
    result = proposed(taut, table(tmp_path, columns))
    assert result["proposal"]["motor"] == "motor:deg"
    assert sum(f"ends at exactly {full:g}, as shares" in note for note in result["notes"]) == 2


@pytest.mark.parametrize("how", ["its names", "its other joints", "its other episodes"])
def test_a_data_set_of_small_motions_is_not_taken_for_radians(taut: Taut, tmp_path: Path, how: str) -> None:
    made, end = robot(), ".pos" if how == "its names" else ""
    small = {name: 2.0 * made[name] / np.abs(made[name]).max() for name in ("command", "motor")}
    others = {f"{k}{end}": (40.0 if how == "its other joints" else 1.0) * np.sin(k * made["t"]) for k in (2, 3)}
    action, state = ({f"elbow{end}": small[name], **others} for name in ("command", "motor"))
    path = files.lerobot(tmp_path / "set", [(made["t"], action, state)])
    if how == "its other episodes":
        stats = {"min": [-70.0] * 3, "max": [70.0] * 3}
        (path / "meta/stats.json").write_text(json.dumps({"action": stats, "observation.state": stats}))
    found = proposed(taut, path, "--motor", "action[0]")["proposal"]
    assert found["motor"] == "action[0]:deg" and found["tip"] == ["observation.state[0]:deg"]


def test_nothing_is_proposed_where_nothing_moves_together(taut: Taut, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    t_s = np.arange(0.0, 60.0, 0.01)
    columns = {"t": t_s, "a": 5 * np.sin(t_s), "b": 5 * np.sin(3.7 * t_s), "c": rng.normal(size=len(t_s))}
    result = proposed(taut, table(tmp_path, columns))
    assert result["command"] is None and "--motor and --tip" in result["notes"][0]
    assert "nothing is proposed" in taut("import", tmp_path / "log.csv").out


def test_what_was_named_stays_in_the_proposal(taut: Taut, tmp_path: Path) -> None:
    made = robot()
    columns = {"t": made["t"], "a": made["motor"], "b": made["tip"], "c": made["other"]}
    result = proposed(taut, table(tmp_path, columns), "--motor", "a:0.5", "--unit", "mm", "--joint", "c")
    assert result["proposal"]["motor"] == "a:0.5" and result["proposal"]["tip"][0].startswith("b")
    assert "--unit mm" in result["command"] and "--joint c" in result["command"]


@pytest.mark.parametrize(
    "text, names, rows, tells",
    [
        ("t_ms;a;b\n0;1,5;2\n20;1.234,5;3\n40;2,5;4\n", ["a", "b"], [1.5, 1234.5, 2.5], 0.02),
        ("time\ta [mm]\n0.00\t1e-3\n0.02\t2E-3\n0.04\t.5\n", ["a [mm]"], [1e-3, 2e-3, 0.5], 0.02),
        ("Datum;a\n" + "".join(f"23.11.2026 15:00:00,0{k}0;{k}\n" for k in (0, 2, 4)), ["a"], [0, 2, 4], 0.02),
        ("stamp,a\n" + "".join(f"2026-11-23T15:00:00.0{k}0,{k}\n" for k in (0, 2, 4)), ["a"], [0, 2, 4], 0.02),
        ("t a b\n0 1 2\n0.02 2 3\n0.04 ERR 4\n", ["a", "b"], [1, 2, np.nan], 0.02),
        ("Test 7\nt [s],a,b\n[s],[rad],[deg]\n0,1,2\n0.02,2,3\n0.04,3,4", ["a", "b"], [1, 2, 3], 0.02),
        ("time_us|a\n1760000000000000|1\n1760000000020000|2\n1760000000040000|3\n", ["a"], [1, 2, 3], 0.02),
    ],
)  # fmt: skip
def test_tables_are_read_as_they_are_written(
    tmp_path: Path, text: str, names: list[str], rows: list[float], tells: float
) -> None:
    from tautline.io.importing import open_source

    path = tmp_path / "log.csv"
    for encoding in ("utf-8", "utf-8-sig", "utf-16"):
        path.write_text(text, encoding=encoding)
        source = open_source(path)
        batch = next(iter(source.batches(0)))
        assert list(batch.values) == names
        np.testing.assert_allclose(batch.values[names[0]], rows)
        np.testing.assert_allclose(np.diff(batch.log_s), tells, atol=1e-9)


@given(st.sampled_from([(unit, of) for of, units in UNITS.items() for unit in units]), st.floats(0.1, 10.0))
def test_a_unit_takes_a_number_to_the_recordings(unit: tuple[str, str], value: float) -> None:
    """Whichever way it was told, and against what the ISO units are."""
    name, target = unit
    si = {"deg": np.pi / 180, "rad": 1, "mrad": 1e-3, "turn": 2 * np.pi, "tick": 2 * np.pi / 4096, "mm": 1e-3, "m": 1,
          "cm": 1e-2, "um": 1e-6, "in": 0.0254, "mNm": 1e-3, "Nm": 1, "Ncm": 1e-2}  # fmt: skip
    told, taken = factor(parse_channel(f"q:{name}", ["q"]), "", target)
    assert taken == name and told * value * si[target] == pytest.approx(value * si[name])
    assert factor(Named("q"), name, target)[0] == told
    assert unit_in(f"q [{name}]") == unit_in(f"q ({name})") == known_unit(name) == name


@pytest.mark.parametrize(
    "name, unit",
    [("Winkel [°]", "deg"), ("q_deg", "deg"), ("winkel in Grad", "deg"), ("load_mNm", "mNm"), ("Kraft (N)", ""),
     ("Position [MM]", "mm"), ("velocity", ""), ("pos_m", "m"), ("x.position", ""), ("alpha (rad)", "rad")],
)  # fmt: skip
def test_units_in_names(name: str, unit: str) -> None:
    assert unit_in(name) == unit


@given(st.floats(0.95, 1.05), st.sampled_from([("deg", "rad"), ("mm", "m"), ("mm", "in")]))
def test_a_ratio_gives_a_unit_away(near: float, unit: tuple[str, str]) -> None:
    values = np.linspace(-0.5, 0.5, 50)
    ratio = UNITS[unit[0]][unit[1]] * near
    assert suspected_unit(ratio, values, unit[0], 0.1) == unit[1]
    assert suspected_unit(1.0, values, unit[0], 0.1) == "" == suspected_unit(3.0 * ratio, values, unit[0], 0.1)
    if unit[1] == "rad":
        assert suspected_unit(ratio, 100.0 * values, unit[0], 0.1) == ""  # no joint turns 50 rad
    assert suspected_unit(360.0 / 4096, np.arange(2048.0), "deg", 0.1) == "tick"
    assert suspected_unit(360.0 / 4096, np.arange(2048.0) / 3.0, "deg", 0.1) == ""


@given(st.lists(st.integers(0, 400), min_size=50, max_size=60, unique=True), st.integers(0, 48))
def test_tidied_times_rise_and_hold_every_row(ticks: list[int], swapped: int) -> None:
    """One swap of neighbours is sorted; what is kept is what was there."""
    t_s = np.sort(np.array(ticks)) * 0.002
    mixed = t_s.copy()
    mixed[[swapped, swapped + 1]] = mixed[[swapped + 1, swapped]]
    warnings: list[str] = []
    kept = clocks.rows_in_time_order(mixed, "topic", warnings)
    np.testing.assert_array_equal(mixed[kept], t_s)
    assert any("out of order" in each for each in warnings)


def test_a_gap_and_a_jump_back() -> None:
    t_s = np.arange(0.0, 10.0, 0.01)
    warnings: list[str] = []
    clocks.rows_in_time_order(np.delete(t_s, np.arange(300, 500)), "topic", warnings)
    assert warnings == ["topic: 1 gap without rows, the longest 2.01 s at 2.99 s"]
    with pytest.raises(TautError, match=r"goes back by 5\.01 s at 9\.99 s"):
        clocks.rows_in_time_order(np.concatenate([t_s, t_s[500:] - 0.02]), "topic", [])
