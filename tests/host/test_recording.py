"""Recordings: what is read is what is there, what is broken says where, and nothing ends in a traceback."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import tautline as tl
from tautline.columns import read_times
from tautline.errors import TautError
from tautline.model import Model
from tautline.recording import (
    PICTURE_NAME,
    Angle,
    Marker,
    Motor,
    Recording,
    Video,
    check_distinct,
    load,
    load_all,
    load_motor,
    save,
)
from tautline.rig import Actuator, Camera, Coarse, HandEye, Kinematics, Rig

RIG = Rig(
    Actuator("mm", (-5.0, 5.0), 0.001),
    Coarse(12.0, 0.0),
    Kinematics(18.0, 6.0),
    Camera(720, 576, 520.0, 520.0, 360.0, 288.0, (0.0, 0.0, 0.0, 0.0, 0.0), 25.0, 0.08),
    HandEye((4.0, -3.0, 2.0), (-4.0, 5.0, 14.0)),
)
DEG_RIG = Rig(Actuator("deg", (0.0, 60.0), 0.044), Coarse(-0.9, 77.0))
MOTOR = "t_s,q_mm\n" + "".join(f"{i / 100:.3f},{i / 50:.4f}\n" for i in range(200))
MARKER = "t_s,u_px,v_px\n" + "".join(f"{i / 25:.3f},{300 + i:.2f},{200 + i:.2f}\n" for i in range(50))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "run"
    path.mkdir()
    (path / "motor.csv").write_text(MOTOR)
    (path / "marker.csv").write_text(MARKER)
    return path


def refused(folder: Path, rig: Rig | None = RIG) -> str:
    with pytest.raises(TautError) as caught:
        load(folder, rig)
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_reads_what_is_there(folder: Path) -> None:
    recording = load(folder, RIG)
    assert recording.name == "run" and recording.warnings == ()
    np.testing.assert_array_equal(recording.motor.q, np.arange(200) / 50)
    assert recording.marker is not None and recording.marker.valid.all()
    np.testing.assert_allclose(recording.marker.u_px, 300 + np.arange(50))
    assert recording.angle is None and recording.video is None and recording.rig is None


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n", "\r\n"),
        lambda text: "\ufeff" + text,
        lambda text: "\n\n" + text + "\n\n  \n",
        lambda text: text.replace(",", " , "),
        lambda text: text.replace("\n", ",\n"),
        lambda text: text.rstrip("\n"),
    ],
    ids=["CRLF", "BOM", "blank lines", "spaces", "trailing commas", "no newline at the end"],
)
def test_harmless_differences(folder: Path, change) -> None:
    (folder / "motor.csv").write_bytes(change(MOTOR).encode())
    recording = load(folder, RIG)
    assert len(recording.motor.t_s) == 200 and recording.warnings == ()


def lines_of(text: str, **changes: str) -> str:
    """The text with numbered lines replaced: line_5='...'."""
    lines = text.splitlines()
    for key, value in changes.items():
        lines[int(key.removeprefix("line_")) - 1] = value
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("file", "content", "says"),
    [
        ("motor.csv", b"", "empty"),
        ("motor.csv", b"t_s,q_mm\n", "no rows"),
        ("motor.csv", b"t_s,q_mm\n0.0,1.0\n", "single row"),
        ("motor.csv", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "not a text file"),
        ("motor.csv", b"\xff\xfet\0_\0s\0", "UTF-16"),
        ("motor.csv", "t_s,q_mm\n0,1µ\n".encode("latin-1"), "not a UTF-8"),
        ("motor.csv", MOTOR.replace(",", ";").encode(), "semicolons"),
        ("motor.csv", MOTOR.replace(",", ";").replace(".", ",").encode(), "semicolons"),
        ("motor.csv", MOTOR.replace(",", "\t").encode(), "tabs"),
        ("motor.csv", ("t_s,q_mm\n" + MOTOR[9:].replace(".", ",")).encode(), "decimal commas"),
        ("motor.csv", MOTOR.replace("q_mm", "q").encode(), "column q_mm is missing (found t_s, q)"),
        ("motor.csv", MOTOR.replace("t_s", "time").encode(), "column t_s is missing"),
        ("motor.csv", MOTOR.replace("q_mm", "q_deg").encode(), 'actuator.unit is "mm"'),
        ("motor.csv", MOTOR.replace("t_s,q_mm", "t_s,q_mm,q_mm").encode(), "twice"),
        ("motor.csv", MOTOR[9:].encode(), "header line"),
        ("motor.csv", lines_of(MOTOR, line_7="0.05,nan").encode(), "line 7: q_mm is empty or NaN"),
        ("motor.csv", lines_of(MOTOR, line_7="0.05,").encode(), "line 7: q_mm is empty or NaN"),
        ("motor.csv", lines_of(MOTOR, line_7="0.05").encode(), "line 7: q_mm is empty or NaN"),
        ("motor.csv", lines_of(MOTOR, line_7="nan,0.1").encode(), "line 7: t_s"),
        ("motor.csv", lines_of(MOTOR, line_7="0.05,inf").encode(), "line 7: q_mm is infinite"),
        ("motor.csv", lines_of(MOTOR, line_7="0.05,fast").encode(), "line 7: q_mm is 'fast'"),
        ("motor.csv", ("\n" + lines_of(MOTOR, line_7="0.05,fast")).encode(), "line 8: q_mm is 'fast'"),
        ("motor.csv", lines_of(MOTOR, line_7="0.05,1,2").encode(), "line 7: has 3 cells"),
        ("motor.csv", lines_of(MOTOR, line_7="0.03,0.1").encode(), "line 7: t_s goes back"),
        ("motor.csv", "\n".join([*MOTOR.splitlines()[:1], *MOTOR.splitlines()[:0:-1]]).encode(), "goes back"),
        ("motor.csv", ("t_s,q_mm\n" + "".join(f"{i // 10},{i}\n" for i in range(50))).encode(), "repeats in 45 of 50"),
        ("motor.csv", ("t_s,q_mm\n" + "".join(f"{i * 10},{i}\n" for i in range(50))).encode(), "in seconds"),
        ("motor.csv", lines_of(MOTOR, line_201="1e9,0.1").encode(), "line 201: t_s jumps"),
        ("motor.csv", b't_s,q_mm\n0.0,1.0\n0.1,"1.0\n0.2,1.0\n', "quotation mark"),
        ("motor.csv", b"t_s,q_mm,load_mNm\n0,1\n0.1,2,3\n0.2,3,4\n", "line 2: load_mNm is empty"),
        ("marker.csv", b"t_s,x,y\n0,1,2\n", "column u_px is missing"),
        ("marker.csv", b"t_s,u_px,v_px\n100,1,2\n101,1,2\n", "do not overlap"),
        ("marker.csv", b"t_s,u_px,v_px,valid\n0.1,1,2,1\n0.2,1,2,maybe\n", "valid is 'maybe'"),
        ("marker.csv", b"t_s,u_px,v_px,valid\n0.1,1,2,1\n0.2,1,2,\n", "valid is empty"),
        ("angle.csv", b"t_s,c_deg\n0.1,nan\n0.2,nan\n", "no number"),
        ("frames.csv", b"frame,t_s\n0,0.1\n0.5,0.2\n", "whole numbers"),
    ],
)
def test_what_is_broken_says_where(folder: Path, file: str, content: bytes, says: str) -> None:
    (folder / file).write_bytes(content)
    if file == "frames.csv":
        (folder / "video.mkv").write_bytes(b"")
    text = refused(folder)
    assert says in text and str(folder / file) in text


def test_missing_parts(folder: Path, tmp_path: Path) -> None:
    assert "no such folder" in refused(tmp_path / "nothing")
    assert "is a file" in refused(folder / "motor.csv")
    assert "--rig" in refused(folder, None)
    (folder / "marker.csv").unlink()
    assert "one of them is needed" in refused(folder)
    (folder / "angle.csv").mkdir()
    assert "cannot be read" in refused(folder)
    (folder / "motor.csv").unlink()
    assert "motor.csv: there is no such file" in refused(folder)


def test_repairs_warn(folder: Path) -> None:
    (folder / "motor.csv").write_text(lines_of(MOTOR, line_9="0.060,0.1400"))
    (folder / "marker.csv").write_text(lines_of(MARKER, line_5="0.120,,", line_6="0.160,nan,3"))
    recording = load(folder, RIG)
    assert recording.marker is not None
    assert len(recording.motor.t_s) == 199 and recording.motor.q[6] == 0.12 and recording.motor.q[7] == 0.16
    assert list(np.flatnonzero(~recording.marker.valid)) == [3, 4] and np.isnan(recording.marker.v_px[4])
    assert len(recording.warnings) == 2
    assert "repeat" in recording.warnings[0] and "2 rows without finite u_px" in recording.warnings[1]


@pytest.mark.parametrize("end", ["2.0", "2.000", "2.000,", "2.000,3", "2.000,4.0", "2.000,-", "1"])
def test_a_cut_last_line_is_left_out(folder: Path, end: str) -> None:
    (folder / "motor.csv").write_text(MOTOR + end)
    recording = load(folder, RIG)
    assert len(recording.motor.t_s) == 200
    assert len(recording.warnings) == 1 and "cut short" in recording.warnings[0]


def test_a_whole_last_line_without_newline_stays(folder: Path) -> None:
    (folder / "motor.csv").write_text("t_s,q_mm\n0.0,0.123456\n0.1,0.2\n0.2,0.25\n0.3,0.3")
    recording = load(folder, RIG)
    assert len(recording.motor.t_s) == 4 and recording.warnings == ()


def test_degrees_and_own_rig(tmp_path: Path) -> None:
    DEG_RIG.save(tmp_path / "rig.toml")
    (tmp_path / "motor.csv").write_text(MOTOR.replace("q_mm", "q_deg"))
    (tmp_path / "angle.csv").write_text("t_s,c_deg,note\n0.0,70,a\n0.5,nan,b\n1.0,71,c\n")
    recording = load(tmp_path)
    assert recording.rig == DEG_RIG and recording.angle is not None
    np.testing.assert_array_equal(recording.angle.c_deg, [70, np.nan, 71])
    assert recording.angle.seen.tolist() == [True, False, True]
    assert list(recording.angle.extra["note"]) == ["a", "b", "c"] and "not valid" in recording.warnings[0]
    assert "expected q_mm" in refused(tmp_path, RIG)


def test_a_broken_rig_beside_a_recording_matters_only_if_it_is_used(folder: Path) -> None:
    (folder / "rig.toml").write_text("format = 'rig/2'")
    assert "ignored" in load(folder, RIG).warnings[0]
    assert "format is 'rig/2'" in refused(folder, None)


def test_video_times(folder: Path) -> None:
    (folder / "video.mkv").write_bytes(b"")
    assert load(folder, RIG).warnings == ()  # marker.csv is there: the video is not needed
    (folder / "marker.csv").unlink()
    recording = load(folder, RIG)
    assert recording.video is not None and recording.video.arrival_s is None
    assert "first frame at 0" in recording.warnings[0]
    (folder / "frames.csv").write_text("frame,t_s\n0,0.1\n2,0.18\n")
    recording = load(folder, RIG)
    assert recording.video is not None
    np.testing.assert_array_equal(recording.video.arrival_s, [0.1, np.nan, 0.18])
    for broken in ("frame,t_s\n0,0.1\n0.5,0.2\n", "frame,t_s\n1,0.1\n0,0.2\n", "frame,t_s\n0,0.1\n1e17,0.2\n"):
        (folder / "frames.csv").write_text(broken)
        assert "whole numbers" in refused(folder)


def test_times_are_read_as_they_are_written(tmp_path: Path) -> None:
    path = tmp_path / "times.csv"
    path.write_text('u_px,t_s\nx,1.50\n\n"a,b",+0.25\r\n,1e-1\n')
    cells, times = read_times(path)
    assert cells == ["1.50", "+0.25", "1e-1"]
    np.testing.assert_array_equal(times, [1.5, 0.25, 0.1])


@pytest.mark.parametrize(("end", "count"), [("0.3,1.5\n", 4), ("0.3,1.5", 4), ("0.3,", 4), ("0.3", 3), ("-", 3)])
def test_a_cut_line_counts_if_its_time_is_whole(tmp_path: Path, end: str, count: int) -> None:
    path = tmp_path / "times.csv"
    path.write_text("t_s,u_px\n0.0,1.25\n0.1,1.25\n0.2,1.25\n" + end)
    warnings: list[str] = []
    cells, times = read_times(path, warnings)
    assert len(cells) == len(times) == count and len(warnings) == (count < 4)


def test_save_replaces_a_recording_and_nothing_else(folder: Path, tmp_path: Path) -> None:
    recording = replace(load(folder, RIG), rig=RIG)
    (folder / "notes.txt").write_text("mine")
    save(recording, folder)
    assert (folder / "notes.txt").read_text() == "mine" and load(folder).rig == RIG
    other = tmp_path / "other"
    other.mkdir()
    (other / "thesis.tex").write_text("mine")
    with pytest.raises(TautError, match="holds other files"):
        save(recording, other)
    assert [path.name for path in other.iterdir()] == ["thesis.tex"]
    with pytest.raises(TautError, match="named"), pytest.MonkeyPatch.context() as patch:
        patch.setattr("tautline.recording._write", lambda *_: (_ for _ in ()).throw(OSError("disk full")))
        try:
            save(recording, folder)
        except TautError as error:
            raise TautError("named " + str(error)) from error
    assert load(folder).rig == RIG and not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_save_keeps_the_picture(folder: Path, tmp_path: Path) -> None:
    (folder / PICTURE_NAME).write_bytes(b"a picture")
    for _ in range(2):  # into a new folder, and over itself
        save(replace(load(folder, RIG), rig=RIG), tmp_path / "other")
        folder = tmp_path / "other"
        kept = load(folder).picture
        assert kept is not None and kept.read_bytes() == b"a picture"


def test_save_copies_the_video(folder: Path, tmp_path: Path) -> None:
    (folder / "video.mkv").write_bytes(b"frames")
    arrival = np.array([0.1, np.nan, 0.3])
    save(replace(load(folder, RIG), rig=RIG, video=Video(folder / "video.mkv", arrival)), tmp_path / "copy")
    copy = load(tmp_path / "copy")
    assert copy.video is not None and copy.video.path.read_bytes() == b"frames"
    np.testing.assert_array_equal(copy.video.arrival_s, arrival)


finite = st.floats(-1e4, 1e4, allow_subnormal=False)


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    unit = draw(st.sampled_from(["mm", "deg"]))
    rig = RIG if unit == "mm" else DEG_RIG

    def times(n: int) -> np.ndarray:
        return draw(st.floats(-1.0, 1.0)) + np.cumsum(draw(hnp.arrays(float, n, elements=st.floats(1e-4, 0.01))))

    def column(n: int) -> np.ndarray:
        return draw(hnp.arrays(float, n, elements=finite))

    n = draw(st.integers(2, 12))
    optional = {
        name: column(n) for name in ("q_cmd", "translation_mm", "rotation_deg", "load_mNm") if draw(st.booleans())
    }
    motor_s = times(n)
    extra = {"temperature_C": column(n)} if draw(st.booleans()) else {}
    q = draw(hnp.arrays(float, n, elements=st.floats(-10, 10, allow_subnormal=False)))
    motor = Motor(motor_s, q, **optional, extra=extra)
    m = draw(st.integers(1, 12))
    valid = draw(hnp.arrays(bool, m))
    u, v = (np.where(valid, column(m), np.nan) for _ in range(2))
    sigma = np.abs(column(m)) + 0.01 if draw(st.booleans()) else None
    t_s = motor_s[0] + np.cumsum(draw(hnp.arrays(float, m, elements=st.floats(1e-4, 0.01)))) - 1e-4
    t_s[0] = motor_s[0]
    marker = Marker(t_s, u, v, valid, sigma) if unit == "mm" else None
    read = None if valid.all() or not valid.any() or draw(st.booleans()) else valid
    c = np.where(valid, column(m), np.nan) if read is not None else column(m)
    angle = Angle(t_s, c, read) if unit == "deg" or draw(st.booleans()) else None
    return Recording("r", motor, marker, angle, rig=rig)


def assert_same(a: object, b: object) -> None:
    if isinstance(a, np.ndarray):
        np.testing.assert_array_equal(a, b)
    elif isinstance(a, dict):
        assert isinstance(b, dict) and a.keys() == b.keys()
        for key in a:
            assert_same(a[key], b[key])
    elif hasattr(a, "__dataclass_fields__") and not isinstance(a, Rig):
        for name in a.__dataclass_fields__:
            if name not in ("name", "warnings"):
                assert_same(getattr(a, name), getattr(b, name))
    else:
        assert a == b


@settings(max_examples=60, deadline=None)
@given(recording=recordings())
def test_round_trip(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("round") / "r"
    save(recording, folder)
    back = load(folder)
    assert back.warnings == ()
    assert_same(recording, back)


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    file=st.sampled_from(["motor.csv", "marker.csv", "angle.csv", "frames.csv", "rig.toml"]),
    damage=st.lists(
        st.tuples(st.sampled_from(["flip", "cut", "insert"]), st.floats(0, 1), st.binary(min_size=1, max_size=6)),
        min_size=1,
        max_size=4,
    ),
)
def test_damaged_files_load_or_say_why(file: str, damage: list[tuple[str, float, bytes]], tmp_path: Path) -> None:
    RIG.save(tmp_path / "rig.toml")
    (tmp_path / "motor.csv").write_text(MOTOR)
    (tmp_path / "marker.csv").write_text(MARKER.replace("\n", ",1,0.05\n").replace("px,1,0.05", "px,valid,sigma_px", 1))
    (tmp_path / "angle.csv").write_text("t_s,c_deg,note\n" + "".join(f"{i / 100},{i},x\n" for i in range(200)))
    (tmp_path / "frames.csv").write_text("frame,t_s\n" + "".join(f"{i},{i / 25}\n" for i in range(50)))
    (tmp_path / "video.mkv").write_bytes(b"")
    data = (tmp_path / file).read_bytes()
    for kind, place, garbage in damage:
        at_byte = int(place * len(data))
        if kind == "flip":
            data = data[:at_byte] + garbage + data[at_byte + len(garbage) :]
        elif kind == "cut":
            data = data[:at_byte]
        else:
            data = data[:at_byte] + garbage + data[at_byte:]
    (tmp_path / file).write_bytes(data)
    for call in (lambda: load(tmp_path), lambda: load_motor(tmp_path, RIG), lambda: read_times(tmp_path / file)):
        try:
            result = call()
        except TautError as error:
            assert "\n" not in str(error) and len(str(error)) < 400
        else:
            if isinstance(result, Recording):
                assert np.all(np.diff(result.motor.t_s) > 0) and np.isfinite(result.motor.q).all()


# -- recordings of one's own arrays -----------------------------------------------------------------------------------


def own(**changed: object) -> Recording:
    t_s = np.arange(0.0, 4.0, 0.01)
    seen = np.arange(0.0, 4.0, 0.04)
    motor = Motor(t_s, np.sin(t_s), extra={"note": np.array(["a", np.nan] * 200, dtype=object)})
    marker = Marker(seen, seen, np.full_like(seen, np.nan), seen > 1.0)
    return replace(Recording("own", motor, marker, Angle(seen, seen), Video(Path("video.mkv"), seen), RIG), **changed)


def test_a_recording_is_equal_to_one_that_holds_the_same() -> None:
    one, other = own(), own(warnings=("of another place",))
    assert one == other and one.motor == other.motor and hash(one.motor) == hash(other.motor)
    assert one.motor is not other.motor and len(repr(one)) < 1000
    t_s = one.motor.t_s
    for changed in (
        {"motor": Motor(t_s, np.cos(t_s))}, {"marker": None}, {"angle": Angle(np.zeros(1), np.zeros(1))}, {"name": "b"},
        {"motor": replace(one.motor, extra={"note": np.array(["a", "b"] * 200, dtype=object)})},
    ):  # fmt: skip
        assert own(**changed) != one


def test_a_recording_that_is_read_again_is_equal(tmp_path: Path) -> None:
    save(own(video=None), tmp_path / "run")
    assert load(tmp_path / "run") == load(tmp_path / "run")


@pytest.mark.parametrize(
    "column, row, value, says",
    [
        ("t_s", 7, np.nan, "motor, row 7: t_s is nan, expected a finite number"),
        ("q", 5, np.inf, "motor, row 5: q is inf, expected a finite number"),
        ("load_mNm", 3, np.nan, "motor, row 3: load_mNm is nan"),
        ("t_s", 9, 0.0, "motor, row 9: t_s goes from 0.08 to 0: times must rise"),
        ("t_s", 9, 0.08, "motor, row 9: t_s goes from 0.08 to 0.08: times must rise"),
        ("t_s", slice(9, None), np.arange(1e6, 1e6 + 391), "rows are 1 s apart"),
        ("q", slice(None), None, "its columns have not one length .t_s 400, q 0"),
    ],
)
def test_a_motor_that_no_file_could_hold_is_refused(column: str, row: int, value: object, says: str) -> None:
    t_s = np.arange(0.0, 4.0, 0.01)
    columns = {"t_s": t_s.copy(), "q": np.sin(t_s), "load_mNm": np.zeros_like(t_s)}
    if value is None:
        columns[column] = np.zeros(0)
    else:
        columns[column][row] = value
    model = Model(DEG_RIG, np.linspace(0, 60, 9), np.ones(9), np.ones(9), np.linspace(77, 23, 9), 0.0, (0.0, 60.0))
    recording = Recording("own", Motor(**columns), angle=Angle(t_s, t_s), rig=DEG_RIG)
    with pytest.raises(TautError, match=says):
        tl.predict(model, recording.motor, t_s)
    for function in (tl.calibrate, lambda it: tl.track(model, it), lambda it: tl.diagnose(own(), it)):
        with pytest.raises(TautError, match=f"own: {says}" if says.startswith("motor") else says):
            function(recording)


def test_a_sensor_that_no_file_could_hold_is_refused() -> None:
    marker = own().marker
    for changed, says in (
        ({"marker": replace(marker, t_s=marker.t_s[::-1])}, "own: marker, row 1: t_s goes from 3.96 to 3.92"),
        ({"marker": replace(marker, valid=marker.valid[1:])}, "own: marker: its columns have not one length"),
        ({"marker": replace(marker, sigma_px=np.ones(3))}, "own: marker: its columns have not one length .*sigma_px 3"),
        ({"angle": Angle(np.array([0.0, np.nan]), np.zeros(2))}, "own: angle, row 1: t_s is nan"),
        ({"angle": Angle(np.arange(9.0), np.zeros(9), np.ones(3, bool))}, "own: angle: its .* one length .*valid 3"),
        ({"motor": replace(own().motor, extra={"j_deg": np.zeros(3)})}, "own: motor: its .* one length .*j_deg 3"),
    ):
        with pytest.raises(TautError, match=says):
            tl.calibrate(own(**changed))


def test_one_recording_is_not_evidence_twice(tmp_path: Path) -> None:
    one, other = own(video=None), own(video=None, name="copy")
    for call in (tl.calibrate, lambda both: tl.diagnose(both[0], both[1])):
        with pytest.raises(TautError, match="copy: is the same recording as own: name it once"):
            call([one, other])
    check_distinct([one, own(video=None, angle=None), own(video=None, marker=None)])
    for name, frames in (("a", b"1"), ("b", b"1"), ("c", b"2")):
        (tmp_path / f"{name}.mkv").write_bytes(frames)
    a, b, c = (own(video=Video(tmp_path / f"{name}.mkv", None), name=name) for name in "abc")
    check_distinct([a, c])
    with pytest.raises(TautError, match="b: is the same recording as a"):
        check_distinct([a, c, b])


def test_a_column_that_holds_no_numbers_is_no_joint(folder: Path) -> None:
    header, *rows = MOTOR.splitlines()
    more = (f"{row},{'on' if i % 2 else 'off'},{i % 2 == 0},{i / 10}" for i, row in enumerate(rows))
    (folder / "motor.csv").write_text("\n".join([f"{header},tool_mm,locked_deg,arm_deg", *more]) + "\n")
    assert list(load(folder, RIG).motor.joints) == ["arm_deg"]


def test_blanks_around_a_cell_are_none_of_it(folder: Path) -> None:
    (folder / "marker.csv").write_text(lines_of(MARKER, line_3="0.04 , nan , nan "))
    recording = load(folder, RIG)
    assert recording.marker is not None and not recording.marker.valid[1] and recording.marker.valid.sum() == 49


def test_a_motor_that_is_cut_before_its_position_loses_that_row(folder: Path) -> None:
    rows = "".join(f"{i / 100},{i * 0.013}\n" for i in range(50))
    (folder / "motor.csv").write_text(f"t_s,q_mm\n{rows}0.5,")
    recording = load(folder, RIG)
    assert len(recording.motor.t_s) == 50 and "cut short" in recording.warnings[0]


def test_a_whole_last_line_of_many_columns_stays(folder: Path) -> None:
    names = ",".join(f"joint_{i}_deg" for i in range(600))
    rows = [f"{i / 100:.2f},{i / 50:.4f}" + ",1.23456" * 600 for i in range(200)]
    (folder / "motor.csv").write_text("\n".join([f"t_s,q_mm,{names}", *rows]))
    recording = load(folder, RIG)
    assert len(recording.motor.t_s) == 200 and recording.warnings == ()


def test_times_beside_a_cell_without_end(tmp_path: Path) -> None:
    (tmp_path / "times.csv").write_text(f"t_s,note\n0.0,{'9' * 200_000}\n")
    with pytest.raises(TautError, match=r"times\.csv: cannot be read as comma-separated numbers"):
        read_times(tmp_path / "times.csv")


def test_recordings_of_one_name_get_names_that_no_other_has(folder: Path, tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ("x/run", "y/run", "z/run (2)", "w/run")]
    for path in paths:
        shutil.copytree(folder, path)
    assert [each.name for each in load_all(paths, RIG)] == ["run", "run (2)", "run (2) (2)", "run (3)"]


def test_a_rig_that_begins_with_a_byte_order_mark(tmp_path: Path) -> None:
    RIG.save(tmp_path / "rig.toml")
    (tmp_path / "rig.toml").write_bytes(b"\xef\xbb\xbf" + (tmp_path / "rig.toml").read_bytes())
    assert Rig.load(tmp_path / "rig.toml") == RIG


@pytest.mark.parametrize("line", ["depth = " + 100_000 * "[", "gain = " + 5000 * "1"])
def test_a_rig_that_no_parser_gets_through(line: str, tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(f'format = "rig/1"\n{line}\n')
    with pytest.raises(TautError, match="not valid TOML"):
        Rig.load(tmp_path / "rig.toml")


@pytest.mark.parametrize("name", ["actuator", "camera"])
def test_a_key_in_a_sections_place_is_named(name: str) -> None:
    with pytest.raises(TautError, match=rf"{name} is no section: write \[{name}\]"):
        Rig.from_document({**RIG.to_document(), name: 5}, "rig.toml")


def test_a_video_that_cannot_be_saved_is_named(tmp_path: Path) -> None:
    with pytest.raises(TautError, match=r"gone\.mkv: No such file") as caught:
        save(own(video=Video(tmp_path / "gone.mkv", None)), tmp_path / "out")
    assert "out" not in str(caught.value).partition("gone.mkv")[2]
    (tmp_path / "other.avi").write_bytes(b"1")
    with pytest.raises(TautError, match=r"other\.avi: a recording's video is a video\.mkv or video\.mp4"):
        save(own(video=Video(tmp_path / "other.avi", None)), tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["other.avi"]


def test_a_motor_at_other_times_keeps_what_its_other_columns_say_there() -> None:
    t_s = np.array([0.0, 1.0, 2.0])
    motor = Motor(t_s, 3.0 * t_s, q_cmd=t_s, rotation_deg=10.0 * t_s, extra={"wrist_deg": -t_s, "note_mm": 0.0 * t_s})
    at = np.array([0.5, 1.75, 5.0])  # held beyond the last sample
    other = motor.resampled(at, np.array([7.0, 8.0, 9.0]), motor.joints)
    assert other.q.tolist() == [7.0, 8.0, 9.0] and other.q_cmd is None and other.load_mNm is None
    assert other.rotation_deg is not None and other.rotation_deg.tolist() == [5.0, 17.5, 20.0]
    assert {name: values.tolist() for name, values in other.extra.items()} == {"wrist_deg": [-0.5, -1.75, -2.0]}
