"""What an import refuses: one line that says what to do, and nothing is written."""

from __future__ import annotations

import builtins
import json
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import import_files as files
import numpy as np
import pyarrow.parquet as pq
import pytest
from cli_runner import Taut

import tautline as tl
from tautline.recording import load
from tautline.rig import Actuator, Coarse, Rig

T_S = np.arange(0.0, 20.0, 0.02)
Q = 30.0 * np.sin(0.8 * T_S)  # deg
C = 0.9 * np.roll(Q, 3)
FIELDS = ("--motor", "/motor.q", "--tip", "/tip.angle")
FEATURES = ("--motor", "action[0]", "--tip", "observation.state[0]")
COLUMNS = ("--motor", "q", "--tip", "c")


def mcap(folder: Path, q: np.ndarray = Q, c: np.ndarray = C, t: np.ndarray = T_S, tip_s: np.ndarray = T_S) -> Path:
    return files.mcap_json(folder / "robot.mcap", {"/motor": (t, {"q": q}), "/tip": (tip_s, {"angle": c})})


def csv(folder: Path, t: np.ndarray = T_S, q: np.ndarray = Q, c: np.ndarray = C, header: str = "t_s,q,c") -> Path:
    path = folder / "log.csv"
    rows = [",".join(f"{x:.9g}" for x in row) for row in zip(t, q, c, strict=True)]
    path.write_text("\n".join([header, *rows, ""]))
    return path


def dataset(folder: Path, version: str = "v3.0", lengths: tuple[int, ...] = (400,)) -> Path:
    episodes = [(T_S[:n], {"pan": Q[:n]}, {"pan": C[:n]}) for n in lengths]
    return files.lerobot(folder / "set", episodes, version, "deg")


def bag(folder: Path, storage: Any = files.rosbag2.StoragePlugin.SQLITE3) -> Path:
    return files.rosbag(folder / "bag", {"/joint_states": (T_S, {"jaw": Q})}, storage)


def cut(path: Path, share: float = 0.5) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])


def inner(folder: Path, pattern: str) -> Path:
    return next(folder.rglob(pattern))


def truncated(make: Callable[[Path], Path], pattern: str = "") -> Callable[[Path], Path]:
    def made(folder: Path) -> Path:
        path = make(folder)
        cut(inner(path, pattern) if pattern else path)
        return path

    return made


def ros1(folder: Path) -> Path:
    return files.rosbag(folder / "robot.bag", {"/joint_states": (T_S, {"jaw": Q})}, None)


def without_info(folder: Path) -> Path:
    path = dataset(folder)
    document = json.loads((path / "meta/info.json").read_text())
    (path / "meta/info.json").write_text(json.dumps(document | {"codebase_version": "v1.6"}))
    return path


def pose(folder: Path) -> Path:
    return files.mcap_ros2(folder / "pose.mcap", T_S, {"jaw": np.radians(Q)}, (T_S, np.radians(C)))


def without_column(folder: Path, pattern: str, name: str) -> Path:
    path = dataset(folder)
    table = inner(path, pattern)
    pq.write_table(pq.read_table(table).drop_columns([name]), table)
    return path


def without_files(folder: Path) -> Path:
    return without_column(folder, "meta/episodes/*/*.parquet", "data/file_index")


def without_numbers(folder: Path) -> Path:
    return without_column(folder, "data/*/*.parquet", "episode_index")


def other_list(folder: Path) -> Path:
    path = dataset(folder, "v2.1")
    (path / "meta/episodes.jsonl").write_text("[1]\n")
    return path


def pictures(folder: Path, cut_at: int) -> Path:
    coded = files.jpegs(6, 32)
    coded[cut_at] = coded[cut_at][:-50]
    return files.rosbag(folder / "bag", {"/joint_states": (T_S, {"jaw": Q})}, pictures={"/cam": (T_S[:60:10], coded)})


def swapped(values: np.ndarray) -> np.ndarray:
    """Times of a clock that was set back by 4 s in the middle."""
    return np.where(np.arange(len(values)) < len(values) // 2, values, values - 4.0)


NAN = np.where(np.arange(len(Q)) % 10 == 0, np.nan, Q)
JOINT = ("--motor", "/joint_states.position[0]", "--tip", "/joint_states.position[0]")
CASES: dict[str, tuple[Callable[[Path], Path], tuple[str, ...], tuple[str, ...]]] = {
    "radians": (lambda f: csv(f, q=np.radians(Q)), COLUMNS, ("57", "radians", "--motor 'q:rad'")),
    "tip in radians": (lambda f: csv(f, c=np.radians(C)), COLUMNS, ("radians", "--tip 'c:rad'")),
    "a unit of another kind": (csv, ("--motor", "q:Nm", "--tip", "c"), ("q: is in Nm", "q:deg")),
    "no unit": (csv, ("--motor", "q:furlong", "--tip", "c"), ("'furlong' is no unit", "deg, rad")),
    "a motor that rests": (lambda f: csv(f, q=0 * Q), COLUMNS, ("q: does not move", "--motor")),
    "two recordings": (lambda f: mcap(f, tip_s=T_S + 500.0), FIELDS, ("/tip.angle 500 to", "one clock")),
    "a clock set back": (lambda f: csv(f, t=swapped(T_S)), COLUMNS, ("goes back by 3.98", "split it there")),
    "a coarse clock": (lambda f: csv(f, t=np.floor(T_S * 10) / 10), COLUMNS, ("repeat the time", "finer times")),
    "whole seconds": (lambda f: csv(f, t=np.floor(T_S), header="time,q,c"), COLUMNS, ("same in most", "time:UNIT")),
    "a whole topic for the motor": (
        mcap, ("--motor", "/motor", "--tip", "/tip.angle"), ("/motor is several", "name one of /motor.q")
    ),
    "a topic that is not there": (mcap, ("--motor", "/motr.q", "--tip", "/tip.angle"), ("/motr.q", "is it /motor.q")),
    "a column that is not there": (csv, ("--motor", "qq", "--tip", "c"), ("no column qq", "is it q")),
    "a time that is not there": (csv, (*COLUMNS, "--time", "T"), ("no column T", "t_s, q, c")),
    "no time": (lambda f: csv(f, t=Q, header="a,q,c"), COLUMNS, ("no column rises", "--time NAME")),
    "a cut MCAP file": (truncated(mcap), FIELDS, ("is cut short", "mcap recover")),
    "a cut ROS 1 bag": (truncated(ros1), JOINT, ("is cut short", "rosbag reindex")),
    "a cut rosbag2": (truncated(bag, "*.db3"), JOINT, ("is cut short", "ros2 bag reindex")),
    "a bag without its metadata": (truncated(bag, "metadata.yaml"), JOINT, ("is cut short", "ros2 bag reindex")),
    "a cut Parquet file": (truncated(dataset, "data/*/*.parquet"), FEATURES, ("is cut short", "copy it again")),
    "a data set that is too old": (without_info, FEATURES, ("'v1.6'", "convert it")),
    "an empty episode": (lambda f: dataset(f, lengths=(400, 0)), (*FEATURES, "--episode", "1"), ("episode 1", "empty")),
    "an empty episode's file": (
        lambda f: dataset(f, "v2.1", (400, 0)), (*FEATURES, "--episode", "1"), ("episode 1", "empty")
    ),
    "an episode that is not there": (dataset, (*FEATURES, "--episode", "7"), ("no episode 7", "0 to 0")),
    "an empty MCAP file": (lambda f: files.mcap_json(f / "e.mcap", {}), FIELDS, ("is empty",)),
    "NaN of the motor": (lambda f: mcap(f, q=NAN), FIELDS, ("100 of 1000 rows are NaN", "--motor")),
    "NaN of the tip": (lambda f: mcap(f, c=np.nan * C), FIELDS, ("/tip.angle: holds no number", "--tip")),
    "no names": (lambda f: csv(f, header=""), COLUMNS, ("line of names",)),
    "a picture": (lambda f: binary(f), COLUMNS, ("not a text file",)),
    "a folder of something": (lambda f: folder_of(f), COLUMNS, ("no LeRobot data set", "no ROS 2 bag")),
    "three tips": (csv, (*COLUMNS, "--tip", "q", "--tip", "c"), ("u, then v",)),
    "one time": (lambda f: csv(f, t=0 * T_S[:2], q=Q[:2], c=C[:2]), COLUMNS, ("one time", "expected a motion")),
    "a factor of 0": (csv, ("--motor", "q", "--tip", "c:0"), ("c:0", "finite number")),
    "a factor that is no number": (csv, ("--motor", "q:nan", "--tip", "c"), ("q:nan", "finite number")),
    "a factor of a place in the image": (csv, ("--motor", "q", "--tip", "c:2", "--tip", "q"), ("c:2", "in px")),
    "an orientation in radians": (
        pose, ("--motor", "/joint_states.position[0]", "--tip", "/tip_pose.pose.orientation:rad"), ("in deg",)
    ),
    "a time of messages": (mcap, (*FIELDS, "--time", "t"), ("--time t: goes with a CSV",)),
    "a video that a bag has not": (bag, (*JOINT[:2], "--video", "/cam"), ("has no video /cam",)),
    "a video that is none": (mcap, (*FIELDS, "--video", "/motor"), ("has no video /motor",)),
    "a video that a data set has not": (dataset, (*FEATURES[:2], "--video", "wrist"), ("has no video wrist",)),
    "a table of episodes without its files": (lambda f: without_files(f), FEATURES, ("data/file_index", "meta whole")),
    "rows of no episode": (without_numbers, FEATURES, ("column episode_index is missing", "meta/info.json names it")),
    "a list of other things": (lambda f: other_list(f), FEATURES, ("list of episodes", "copy it again")),
    "a picture that is cut": (
        lambda f: pictures(f, cut_at=3), (*JOINT[:2], "--video", "/cam"), ("picture 3 cannot be decoded",)
    ),
}  # fmt: skip


def binary(folder: Path) -> Path:
    path = folder / "picture.png"
    path.write_bytes(b"\x89PNG\r\n\0\0\0")
    return path


def folder_of(folder: Path) -> Path:
    path = folder / "things"
    path.mkdir()
    (path / "notes.txt").write_text("x")
    return path


@pytest.mark.parametrize("name", CASES)
def test_what_is_wrong_is_one_line_and_nothing_is_written(taut: Taut, tmp_path: Path, name: str) -> None:
    make, words, told = CASES[name]
    path = make(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    line = taut.refuses("import", path, "--out", tmp_path / "out", *words)
    assert all(each in line for each in told), line
    assert sorted(tmp_path.rglob("*")) == before


def test_a_first_row_without_a_time_is_left_out(taut: Taut, tmp_path: Path) -> None:
    path = csv(tmp_path)
    lines = path.read_text().splitlines()
    lines[1] = "," + lines[1].partition(",")[2]
    path.write_text("\n".join([*lines, ""]))
    assert taut("import", path, "--out", tmp_path / "out", *COLUMNS).code == 0
    recording = load(tmp_path / "out")
    assert recording.motor.t_s[0] == pytest.approx(0.02) and len(recording.motor.q) == len(Q) - 1
    np.testing.assert_allclose(np.diff(recording.motor.t_s), 0.02, atol=1e-6)


@pytest.mark.parametrize("ends", ["\n", "\r"])
def test_a_row_that_is_longer_than_the_others_takes_none_away(taut: Taut, tmp_path: Path, ends: str) -> None:
    path = csv(tmp_path)
    lines = path.read_text().splitlines()
    lines[100] += ",a word"
    path.write_bytes(ends.join([*lines, ""]).encode())
    assert taut("import", path, "--out", tmp_path / "out", *COLUMNS).code == 0
    np.testing.assert_allclose(load(tmp_path / "out").motor.q, Q, atol=1e-6)


def test_a_word_among_times_is_a_row_without_one(taut: Taut, tmp_path: Path) -> None:
    path = csv(tmp_path)
    lines = path.read_text().splitlines()
    lines[100] = "paused,,"
    path.write_text("\n".join([*lines, ""]))
    done = taut("import", path, "--out", tmp_path / "out", *COLUMNS)
    assert done.code == 0 and "1 rows without a time" in done.err
    np.testing.assert_allclose(load(tmp_path / "out").motor.t_s, np.delete(T_S, 99), atol=1e-9)


@pytest.mark.parametrize("empty", [None, 0, 65536])
def test_dates_are_read_alike_whichever_cell_is_empty(taut: Taut, tmp_path: Path, empty: int | None) -> None:
    """March 4th in the file's first part and in its second one, which begins with row 65536."""
    t_s = np.arange(65600) * 1e-3
    cells = [f"2026-03-04 10:{int(t) // 60:02d}:{t % 60:06.3f}" for t in t_s]
    if empty is not None:
        cells[empty] = ""
    q = 30.0 * np.sin(t_s)
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["time,q,c", *(f"{d},{a:.6f},{a:.6f}" for d, a in zip(cells, q, strict=True)), ""]))
    assert taut("import", path, "--out", tmp_path / "out", *COLUMNS).code == 0
    made = load(tmp_path / "out").motor.t_s
    kept = np.arange(len(t_s)) != (-1 if empty is None else empty)
    np.testing.assert_allclose(made, t_s[kept] - t_s[kept][0], atol=1e-6)


@pytest.mark.parametrize("name", ["Time", "elapsed"])
def test_a_column_of_days_is_not_taken_for_the_times(taut: Taut, tmp_path: Path, name: str) -> None:
    clock = [f"10:00:{t:06.3f}" if name == "Time" else f"{t:.3f}" for t in T_S]
    rows = [f"2026-03-04,{x},{a:.6f},{b:.6f}" for x, a, b in zip(clock, Q, C, strict=True)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join([f"Date,{name},q,c", *rows, ""]))
    assert taut("import", path, "--out", tmp_path / "out", *COLUMNS).code == 0
    np.testing.assert_allclose(load(tmp_path / "out").motor.t_s, T_S, atol=1e-6)


def test_a_joint_takes_no_other_columns_place(taut: Taut, tmp_path: Path) -> None:
    """One that is called as the recording's q, and two whose names are one where only letters count."""
    path = tmp_path / "log.csv"
    others = (0.1 * Q, 0.2 * Q, 0.3 * Q)
    np.savetxt(path, np.c_[T_S, Q, C, *others], delimiter=",", header="t_s,m,c,q,a b,a_b", comments="")
    words = ("--motor", "m", "--tip", "c", *(each for name in ("q", "a b", "a_b") for each in ("--joint", name)))
    assert taut("import", path, "--out", tmp_path / "out", *words).code == 0
    made = load(tmp_path / "out").motor
    np.testing.assert_allclose(made.q, Q, atol=1e-9)
    assert list(made.joints) == ["q_2_deg", "a_b_deg", "a_b_2_deg"]
    for values, truth in zip(made.joints.values(), others, strict=True):
        np.testing.assert_allclose(values, truth, atol=1e-9)


def test_a_motor_that_rests_nearly_always_is_imported(taut: Taut, tmp_path: Path) -> None:
    q = np.where(np.arange(len(T_S)) < 970, 0.0, Q)
    assert taut("import", csv(tmp_path, q=q, c=0.9 * q), "--out", tmp_path / "out", *COLUMNS).code == 0
    np.testing.assert_allclose(load(tmp_path / "out").motor.q, q, atol=1e-6)


def test_a_tip_that_is_seen_once_tells_no_slope(taut: Taut, tmp_path: Path) -> None:
    c = np.where(np.arange(len(T_S)) == 4, C, np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        done = taut("import", csv(tmp_path, c=c), "--out", tmp_path / "out", *COLUMNS)
    assert done.code == 0 and "999 rows have no number" in done.err


def test_a_factor_of_an_orientation_counts(taut: Taut, tmp_path: Path) -> None:
    path = pose(tmp_path)
    made = []
    for end in ("", ":-2"):
        words = ("--motor", "/joint_states.position[0]", "--tip", f"/tip_pose.pose.orientation{end}")
        assert taut("import", path, "--out", tmp_path / "out", *words).code == 0
        made.append(load(tmp_path / "out").angle)
    np.testing.assert_allclose(made[1].c_deg, -2.0 * made[0].c_deg)


def test_a_unit_that_is_not_the_rigs_is_refused(taut: Taut, tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    Rig(Actuator("mm", (-5.0, 5.0), 0.001), Coarse(10.0, 0.0)).save(rig)
    words = ("--out", tmp_path / "out", *COLUMNS, "--rig", rig)
    assert "--unit deg" in taut.refuses("import", csv(tmp_path, q=0.1 * Q), *words, "--unit", "deg")
    assert "as in q:um" in taut.refuses("import", csv(tmp_path, q=1e5 * Q), *words)


def test_an_episode_that_is_not_there_is_no_proposal(taut: Taut, tmp_path: Path) -> None:
    assert "has no episode 5" in taut.refuses("import", csv(tmp_path), "--episode", 5)


def test_a_motion_too_short_to_compare_is_listed(taut: Taut, tmp_path: Path) -> None:
    done = taut("import", csv(tmp_path, T_S[:10], Q[:10], C[:10]))
    assert done.code == 0 and "nothing is proposed" in done.out


def test_a_recording_that_was_there_stays_when_an_import_fails(taut: Taut, tmp_path: Path) -> None:
    words = ("--out", tmp_path / "out", *FIELDS)
    path = mcap(tmp_path)
    assert taut("import", path, *words).code == 0
    before = {each.name: each.read_bytes() for each in (tmp_path / "out").iterdir()}
    cut(path)
    taut.refuses("import", path, *words)
    assert {each.name: each.read_bytes() for each in (tmp_path / "out").iterdir()} == before
    strange = tmp_path / "mine"
    strange.mkdir()
    (strange / "thesis.tex").write_text("")
    assert "holds other files" in taut.refuses("import", mcap(tmp_path), "--out", strange, *FIELDS)


def test_a_unit_that_was_said_is_taken_with_a_warning(taut: Taut, tmp_path: Path) -> None:
    path = csv(tmp_path, q=np.radians(Q))
    done = taut("import", path, "--out", tmp_path / "out", "--motor", "q:deg", "--tip", "c")
    assert done.code == 0 and "is it in radians?" in done.err
    np.testing.assert_allclose(tl.load(tmp_path / "out").motor.q, np.radians(Q), atol=1e-8)


def test_stamps_of_two_clocks_are_told_and_the_log_is_used(taut: Taut, tmp_path: Path) -> None:
    tip = (T_S, np.radians(C))
    joints = {"jaw": np.radians(Q)}
    words = ("--motor", "/joint_states.position[0]", "--tip", "/tip_pose.pose.orientation")
    one = files.mcap_ros2(tmp_path / "one.mcap", T_S, joints, tip, late=lambda t: t + 0.1)
    done = taut("import", one, "--out", tmp_path / "one", *words)
    assert done.code == 0 and "by the header times" in done.out and "two clocks" not in done.err
    two = files.mcap_ros2(tmp_path / "two.mcap", T_S, joints, tip, tip_stamp_s=40.0)
    done = taut("import", two, "--out", tmp_path / "two", *words)
    assert done.code == 0 and "two clocks" in done.err and "40" in done.err and "by the log times" in done.out
    made = load(tmp_path / "two")
    assert made.angle is not None
    np.testing.assert_allclose(made.angle.t_s, made.motor.t_s, atol=1e-9)


def test_a_clock_that_runs_faster_is_told(taut: Taut, tmp_path: Path) -> None:
    """The joints' stamps gain 1 ms a second on the log, the tip has none of its own drift."""
    t_s = np.arange(0.0, 60.0, 0.02)
    q = 30.0 * np.sin(0.8 * t_s)
    path = files.mcap_ros2(tmp_path / "drift.mcap", t_s, {"jaw": np.radians(q)}, (t_s, np.radians(q)), tip_rate=1e-3)
    words = ("--motor", "/joint_states.position[0]", "--tip", "/tip_pose.pose.orientation")
    done = taut("import", path, "--out", tmp_path / "out", *words)
    assert done.code == 0 and "1000 ppm faster" in done.err and "by the log times" in done.out


def test_single_rows_are_mended_and_told(taut: Taut, tmp_path: Path) -> None:
    q, c, t_s = Q.copy(), C.copy(), T_S.copy()
    q[100], c[200:203] = np.nan, np.nan
    t_s[400], t_s[401] = t_s[401], t_s[400]
    t_s[600] = t_s[599]
    done = taut("import", csv(tmp_path, t_s, q, c), "--out", tmp_path / "out", *COLUMNS)
    assert done.code == 0, done.err
    for told in ("1 rows without a number", "3 rows have no number", "1 rows were out of order", "1 rows that repeat"):
        assert told in done.err
    made = tl.load(tmp_path / "out")
    assert made.angle is not None and made.angle.seen.sum() == len(made.angle.c_deg) - 3
    assert np.all(np.diff(made.motor.t_s) > 0) and len(made.motor.q) == len(Q) - 2
    assert made.motor.q[np.searchsorted(made.motor.t_s, T_S[400] - 1e-6)] == pytest.approx(Q[401], abs=1e-6)


def test_an_empty_episode_among_others_is_left_out(taut: Taut, tmp_path: Path) -> None:
    path = dataset(tmp_path, lengths=(400, 0, 300))
    done = taut("import", path, "--out", tmp_path / "out", *FEATURES, "--json")
    result = json.loads(done.out)
    assert [each["episode"] for each in result["written"]] == [0, 2]
    assert len(result["skipped"]) == 1 and "episode 1 was left out" in done.err
    assert sorted(each.name for each in (tmp_path / "out").iterdir()) == [
        "episode_000000",
        "episode_000002",
        "import.toml",
    ]


def test_a_program_is_told_which_episodes_were_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = dataset(tmp_path, lengths=(400, 0, 300))
    written = tl.import_recording(path, tmp_path / "out", FEATURES[1], FEATURES[3])
    assert [each.episode for each in written] == [0, 2]
    (told,) = caplog.messages
    assert told.startswith("episode 1 was left out")


@pytest.mark.parametrize(
    "module, make, words", [("mcap", mcap, FIELDS), ("pyarrow", dataset, FEATURES), ("rosbags", bag, JOINT)]
)
def test_a_library_that_is_missing_names_the_extra(
    taut: Taut, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str, make: Callable[[Path], Path], words: Any
) -> None:
    path = make(tmp_path)
    for name in [each for each in sys.modules if each.partition(".")[0] == module]:
        monkeypatch.delitem(sys.modules, name)
    there = builtins.__import__

    def absent(name: str, *rest: Any, **more: Any) -> Any:
        if name.partition(".")[0] == module:
            raise ImportError(name)
        return there(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", absent)
    monkeypatch.setitem(sys.modules, module, None)
    line = taut.refuses("import", path, "--out", tmp_path / "out", *words)
    assert f"{module}, which is not installed: pip install 'tautline-robotics[import]'" in line
    assert not (tmp_path / "out").exists()
