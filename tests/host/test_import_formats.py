"""A recording in each format, written by the format's own library and imported: the same recording, the same model."""

from __future__ import annotations

import json
import tomllib
from base64 import b64encode
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import import_files as files
import numpy as np
import pytest
from angle_plant import RIG, Motion, tip
from cli_runner import Taut
from rosbags.rosbag2 import StoragePlugin

import tautline as tl
from tautline.calibration.calibrate import calibrate
from tautline.io.importing import open_source, scan
from tautline.io.importing.tip import bending_deg
from tautline.recording import Angle, Motor, Recording, load
from tautline.rig import Rig
from tautline.vision.camera import VideoCamera
from tools import davinci, so101

FLOAT32 = 2.0**-24  # share by which a number is rounded
FLOAT64 = 2.0**-50  # the same of a few operations
NS = 1e-9


def simulated() -> Recording:
    """A joint with a play and an angle sensor, read together at 50 Hz, as a table holds them."""
    motion = Motion.through((-35, 35, -20, 10, -15, 30, -35, 20, -10), speed=12.0)
    t_s, q = motion.t_s[::20], np.round(motion.q[::20] / 0.01) * 0.01
    c = tip(motion.q)[::20] + 0.02 * np.random.default_rng(4).normal(size=len(q))
    load_mNm = 30.0 + 12.0 * np.sign(np.gradient(q))
    return Recording("joint", Motor(t_s, q, np.roll(q, -2), load_mNm=load_mNm), angle=Angle(t_s, c), rig=RIG)


def public(room: object, name: str) -> Recording:
    """One run of a public data set; 50 s of it are enough here."""
    folder = room.find()  # type: ignore[attr-defined]
    if folder is None:
        pytest.skip(f"no shared/data beside the repository: see {room.__name__}.py in tools")  # type: ignore[attr-defined]
    rig = Rig.load(folder / "rig.toml")
    run = load(folder / name, rig)
    assert run.angle is not None and np.array_equal(run.motor.t_s, run.angle.t_s)
    return Recording(name, run.motor, angle=run.angle, rig=rig)


@dataclass(frozen=True)
class Format:
    write: Callable[[Path, Recording], Path]
    names: list[str]
    rounded: tuple[float, float, float]  # by how much t_s (s), and q and c (shares of 100 deg) may be off


def table(run: Recording) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    assert run.angle is not None
    return run.motor.t_s, run.motor.q, run.angle.c_deg


def csv(folder: Path, run: Recording) -> Path:
    path = folder / "messung.csv"
    lines = ["Prüfstand 3;;", "Zeit;Antriebswinkel;Gelenkwinkel", "ns;rad;°"]
    for t, q, c in zip(*table(run), strict=True):
        lines.append(f"{files.ns(t)};{np.radians(q):.9f};{c:.7f}".replace(".", ","))
    path.write_bytes("\r\n".join([*lines, ""]).encode("cp1252"))
    return path


def ros1(folder: Path, run: Recording) -> Path:
    t_s, q, c = table(run)
    topics = {
        "/joint_states": (t_s, {"elbow": 0 * q, "jaw_motor": np.radians(q)}),
        "/jaw": (t_s, {"jaw": np.radians(c)}),
    }
    return files.rosbag(folder / "robot.bag", topics, None)


def ros2(storage: StoragePlugin) -> Callable[[Path, Recording], Path]:
    def write(folder: Path, run: Recording) -> Path:
        t_s, q, c = table(run)
        topics = {
            "/joint_states": (t_s, {"elbow": 0 * q, "jaw_motor": np.radians(q)}),
            "/jaw": (t_s, {"jaw": np.radians(c)}),
        }
        return files.rosbag(folder / "bag", topics, storage)

    return write


def mcap_ros2(folder: Path, run: Recording) -> Path:
    t_s, q, c = table(run)
    joints = {"elbow": 0 * q, "jaw_motor": np.radians(q)}
    return files.mcap_ros2(
        folder / "robot.mcap", t_s, joints, (t_s, np.radians(c)), late=lambda t: t + 0.004 * np.sin(9e3 * t)
    )


def mcap_ros1(folder: Path, run: Recording) -> Path:
    t_s, q, c = table(run)
    return files.mcap_ros1(folder / "robot.mcap", t_s, np.radians(q), np.radians(c))


def mcap_json(folder: Path, run: Recording) -> Path:
    t_s, q, c = table(run)
    return files.mcap_json(folder / "robot.mcap", {"/motor": (t_s, {"q": q}), "/tip": (t_s, {"angle": c})})


def mcap_protobuf(folder: Path, run: Recording) -> Path:
    t_s, q, c = table(run)
    return files.mcap_protobuf(folder / "robot.mcap", {"/motor": (t_s, {"q": q}), "/tip": (t_s, {"angle": c})})


def lerobot(version: str) -> Callable[[Path, Recording], Path]:
    def write(folder: Path, run: Recording) -> Path:
        t_s, q, c = table(run)
        return files.lerobot(folder / "set", [(t_s, {"pan.pos": q}, {"pan.pos": c})], version, "deg")

    return write


JOINTS = ["--motor", "/joint_states.position[jaw_motor]", "--tip", "/jaw.position[0]"]
FIELDS = ["--motor", "/motor.q", "--tip", "/tip.angle"]
FEATURES = ["--motor", "action[0]", "--tip", "observation.state[0]"]
EXACT = (NS, FLOAT64, FLOAT64)
FORMATS = {
    "CSV": Format(
        csv, ["--motor", "Antriebswinkel", "--tip", "Gelenkwinkel"], (NS, 0.5e-9 * 180 / np.pi / 100, 0.5e-9)
    ),
    "ROS 1": Format(ros1, JOINTS, EXACT),
    "rosbag2 sqlite3": Format(ros2(StoragePlugin.SQLITE3), JOINTS, EXACT),
    "rosbag2 MCAP": Format(ros2(StoragePlugin.MCAP), JOINTS, EXACT),
    # a quaternion's angle: rounding of sine and cosine, a few times
    "MCAP ROS 2": Format(mcap_ros2, [*JOINTS[:3], "/tip_pose.pose.orientation"], (NS, FLOAT64, 2.0**-44)),
    "MCAP ROS 1": Format(mcap_ros1, JOINTS, EXACT),
    "MCAP JSON": Format(mcap_json, FIELDS, EXACT),
    "MCAP protobuf": Format(mcap_protobuf, FIELDS, EXACT),
    # times are in single precision where they are no frame's number over the rate
    "LeRobot v2.1": Format(lerobot("v2.1"), FEATURES, (200 * FLOAT32, FLOAT32, FLOAT32)),
    "LeRobot v3.0": Format(lerobot("v3.0"), FEATURES, (200 * FLOAT32, FLOAT32, FLOAT32)),
}
COARSEST = ("CSV", "MCAP ROS 2", "LeRobot v3.0")  # by rounding: a model of what they hold is compared too


def imported(taut: Taut, tmp_path: Path, run: Recording, kind: Format, *words: str) -> Recording:
    run.rig.save(tmp_path / "rig.toml")  # type: ignore[union-attr]
    path = kind.write(tmp_path, run)
    done = taut(
        "import", path, "--out", tmp_path / "out", *kind.names, "--rig", tmp_path / "rig.toml", "--json", *words
    )
    assert done.code == 0, done.err
    return tl.load(tmp_path / "out")


def same(made: Recording, run: Recording, kind: Format) -> None:
    """The recording, to the format's rounding; the clock may begin elsewhere."""
    assert made.angle is not None and run.angle is not None
    t, q, c = kind.rounded
    start = run.motor.t_s[0] - made.motor.t_s[0]
    assert len(made.motor.t_s) == len(run.motor.t_s)
    np.testing.assert_allclose(made.motor.t_s + start, run.motor.t_s, rtol=0, atol=2 * t)
    np.testing.assert_allclose(made.angle.t_s + start, run.angle.t_s, rtol=0, atol=2 * t)
    np.testing.assert_allclose(made.motor.q, run.motor.q, rtol=0, atol=100 * q + 1e-12)
    np.testing.assert_allclose(made.angle.c_deg, run.angle.c_deg, rtol=0, atol=100 * c + 1e-12)
    assert made.rig == run.rig


def same_model(made: Recording, run: Recording) -> None:
    """B and f_remain to a tenth of what is not known of them."""
    assert run.rig is not None
    ours, theirs = (calibrate([each], run.rig, naming=False).model for each in (made, run))
    known = np.isfinite(theirs.width_sigma)
    assert known.any() and ours.quality.verdict == theirs.quality.verdict
    assert np.max(np.abs(ours.width - theirs.width)[known] / theirs.width_sigma[known]) < 0.1
    assert np.max(np.abs(ours.c_deg - theirs.c_deg)[known] / theirs.c_sigma[known]) < 0.1


@pytest.mark.parametrize("name", FORMATS)
def test_a_simulated_recording_comes_back(taut: Taut, tmp_path: Path, name: str) -> None:
    run, kind = simulated(), FORMATS[name]
    same(imported(taut, tmp_path, run, kind), run, kind)


@pytest.mark.parametrize("name", COARSEST)
def test_it_calibrates_to_the_same_model(taut: Taut, tmp_path: Path, name: str) -> None:
    run = simulated()
    same_model(imported(taut, tmp_path, run, FORMATS[name]), run)


@pytest.mark.parametrize("name", COARSEST)
def test_a_real_arms_motion_comes_back(taut: Taut, tmp_path: Path, name: str) -> None:
    run, kind = public(so101, "rotation-symmetric-motion"), FORMATS[name]
    same(imported(taut, tmp_path, run, kind), run, kind)


@pytest.mark.long
@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("room, run_of", [(so101, "rotation-single-joint-rotation"), (davinci, "freq1-load1")])
def test_real_recordings_calibrate_to_the_same_model(
    taut: Taut, tmp_path: Path, name: str, room: object, run_of: str
) -> None:
    run = public(room, run_of)
    made = imported(taut, tmp_path, run, FORMATS[name])
    same(made, run, FORMATS[name])
    same_model(made, run)


def test_command_and_load_and_where_it_came_from(taut: Taut, tmp_path: Path) -> None:
    """A command is held until the next one, a load is between its samples; import.toml says what each was."""
    run = simulated()
    t_s, q, c = table(run)
    topics = {
        "/motor": (t_s, {"q_rad": np.radians(q)}),
        "/goal": (t_s[::5] - 0.001, {"q_rad": np.radians(q[::5])}),
        "/torque": (t_s[::2], {"Nm": 1e-3 * t_s[::2]}),
        "/tip": (t_s, {"angle": c}),
    }
    path = files.mcap_json(tmp_path / "robot.mcap", topics)
    words = ["--motor", "/motor.q_rad", "--tip", "/tip.angle", "--command", "/goal.q_rad", "--load", "/torque.Nm:Nm"]
    assert taut("import", path, "--out", tmp_path / "out", *words).code == 0
    made = tl.load(tmp_path / "out")
    assert made.motor.q_cmd is not None and made.motor.load_mNm is not None
    np.testing.assert_allclose(made.motor.q_cmd, q[np.arange(len(q)) // 5 * 5], atol=1e-12)
    inside = t_s <= t_s[::2][-1]
    np.testing.assert_allclose(made.motor.load_mNm[inside], t_s[inside], atol=1e-8)
    document = tomllib.loads((tmp_path / "out/import.toml").read_text())
    assert document["source"]["kind"] == "MCAP" and document["source"]["bytes"] == path.stat().st_size
    assert len(document["source"]["sha256"]) == 64 and document["clock"] == {
        "used": "log",
        "origin_s": pytest.approx(1.76e9),
    }
    roles = {each["role"]: each for each in document["channels"]}
    assert roles["motor"] == {
        "role": "motor", "name": "/motor.q_rad", "rows": len(q), "unit": "rad", "factor": pytest.approx(180 / np.pi)
    }  # fmt: skip
    assert roles["load"]["factor"] == 1000.0 and set(roles) == {"motor", "tip", "command", "load"}


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_episodes_become_recordings_with_their_own_frames(taut: Taut, tmp_path: Path, version: str) -> None:
    """Each frame of the video is as bright as its number says, over the whole file in v3.0, over its own in v2.1."""
    lengths, fps, size = (60, 83, 57), 50, 64
    episodes = []
    for k, n in enumerate(lengths):
        t_s = np.arange(n) / fps
        q = 20.0 * np.sin(6.0 * t_s + k)
        episodes.append((t_s, {"pan.pos": q}, {"pan.pos": q + k}))
    path = files.lerobot(tmp_path / "set", episodes, version, "deg", camera=size, fps=fps)
    done = taut("import", path, "--out", tmp_path / "out", *FEATURES, "--video", "observation.images.wrist", "--json")
    assert done.code == 0, done.err
    written = json.loads(done.out)["written"]
    assert [each["episode"] for each in written] == [0, 1, 2]
    first = 0
    for k, n in enumerate(lengths):
        made = load(tmp_path / f"out/episode_{k:06d}")
        assert made.video is not None and made.video.arrival_s is not None and made.angle is not None
        np.testing.assert_allclose(made.angle.c_deg - made.motor.q, k, atol=1e-5)
        named = np.flatnonzero(np.isfinite(made.video.arrival_s))
        np.testing.assert_allclose(made.video.arrival_s[named], np.arange(n) / fps, atol=1e-3)
        with VideoCamera(made.video.path) as camera:
            frames = [read[0] for _ in range(len(made.video.arrival_s)) if (read := camera.read())]
        assert len(frames) == len(made.video.arrival_s)
        seen = np.array([frames[i].mean() for i in named])
        number = np.arange(n) + (first if version == "v3.0" else 0)
        np.testing.assert_allclose(seen, [files.level(i) for i in number], atol=1.4)  # levels are 3 apart
        first += n
        assert made.rig is not None and made.rig == load(tmp_path / "out/episode_000000").rig
        assert made.rig.actuator.range[0] <= -20.0 and made.rig.actuator.range[1] >= 20.0  # of all episodes together
    only = taut("import", path, "--out", tmp_path / "one", *FEATURES, "--episode", 1)
    assert only.code == 0 and len(tl.load(tmp_path / "one").motor.t_s) == lengths[1]


def test_pictures_of_a_bag_are_copied_into_a_video(taut: Taut, tmp_path: Path) -> None:
    run = simulated()
    t_s, q, c = table(run)
    frame_s = t_s[::40] + 0.007
    coded = files.jpegs(len(frame_s), 48)
    topics = {"/joint_states": (t_s, {"jaw_motor": np.radians(q)}), "/jaw": (t_s, {"jaw": np.radians(c)})}
    path = files.rosbag(tmp_path / "bag", topics, pictures={"/scope/compressed": (frame_s, coded)})
    assert taut("import", path, "--out", tmp_path / "out", *JOINTS, "--video", "/scope/compressed").code == 0
    made = load(tmp_path / "out")
    assert made.video is not None and made.video.arrival_s is not None
    np.testing.assert_allclose(made.video.arrival_s - made.motor.t_s[0], frame_s - t_s[0], atol=2 * NS)
    assert all(each in made.video.path.read_bytes() for each in coded[:3])  # the very bytes
    with VideoCamera(made.video.path) as camera:
        seen = [read[0].mean() for _ in coded if (read := camera.read())]
    np.testing.assert_allclose(seen, [files.level(k) for k in range(len(coded))], atol=2.5)


def test_pictures_of_json_messages_are_base64(taut: Taut, tmp_path: Path) -> None:
    """As Foxglove's and the package's own MCAP files have them; two were written in the other order."""
    t_s = np.arange(0.0, 4.0, 0.02)
    coded = files.jpegs(8, 48)
    frames = [(0.4 * k, {"data": b64encode(each).decode(), "format": "jpeg"}) for k, each in enumerate(coded)]
    frames[3], frames[4] = frames[4], frames[3]
    motor = [(t, {"q": 20.0 * np.sin(t)}) for t in t_s.tolist()]
    path = files.mcap_messages(tmp_path / "log.mcap", {"/motor": motor, "/camera": frames}, ["/camera"])
    assert taut("import", path, "--out", tmp_path / "out", "--motor", "/motor.q", "--video", "/camera").code == 0
    made = load(tmp_path / "out", RIG)
    assert made.video is not None and made.video.arrival_s is not None
    seen = made.video.arrival_s[np.isfinite(made.video.arrival_s)]
    np.testing.assert_allclose(seen, [0.0, 0.4, 0.8, 1.6, 2.0, 2.4, 2.8], atol=1e-6)  # 1.2 s came too late
    with VideoCamera(made.video.path) as camera:
        shown = [read[0].mean() for _ in coded if (read := camera.read())]
    np.testing.assert_allclose(shown, [files.level(k) for k in (0, 1, 2, 4, 3, 5, 6, 7)], atol=2.5)


def test_publishers_of_one_topic_have_channels_of_their_own(taut: Taut, tmp_path: Path) -> None:
    """And rows: what one of them sends is no gap of the other's."""
    t_s = np.arange(0.0, 4.0, 0.02).tolist()
    arm = [(t, {"name": ["a", "b"], "position": [t, 2.0 * t]}) for t in t_s]
    jaw = [(t + 0.01, {"name": ["jaw"], "position": [-t]}) for t in t_s]
    path = files.mcap_messages(tmp_path / "log.mcap", {"/joints": arm, "/joints ": jaw})
    found = scan(open_source(path), None, lambda share, what: None).channels
    assert {c.fact.label: (c.low, c.high) for c in found.values()} == {
        "a": (0.0, 3.98), "b": (0.0, 7.96), "jaw": (-3.98, 0.0)
    }  # fmt: skip
    words = ("--motor", "/joints.position[b]:deg", "--tip", "/joints.position[jaw]:deg")
    done = taut("import", path, "--out", tmp_path / "out", *words)
    assert done.code == 0 and "without a number" not in done.err
    made = load(tmp_path / "out")
    assert made.angle is not None and made.angle.valid is None
    np.testing.assert_allclose(made.motor.q, 2.0 * np.array(t_s))
    np.testing.assert_allclose(made.angle.t_s - made.motor.t_s, 0.01, atol=1e-9)


@pytest.mark.parametrize("first_s, summary", [(100.0, True), (1.7e9, False)])
def test_stamps_of_another_epoch_than_the_logs_begin_at_0(
    taut: Taut, tmp_path: Path, first_s: float, summary: bool
) -> None:
    """Stamps since the robot was switched on; and since 1970 in a log without a summary, whose first time is not known
    beforehand."""
    t_s = np.arange(0.0, 4.0, 0.02)
    rows = []
    for t in t_s.tolist():
        sec = int(first_s + t)
        rows.append((t, {"header": {"stamp": {"sec": sec, "nanosec": round(1e9 * (first_s + t - sec))}}, "q": t}))
    path = files.mcap_messages(tmp_path / "log.mcap", {"/motor": rows, "/tip": rows}, summary=summary)
    done = taut("import", path, "--out", tmp_path / "out", "--motor", "/motor.q:deg", "--tip", "/tip.q:deg")
    assert done.code == 0 and "by the header times" in done.out
    np.testing.assert_allclose(load(tmp_path / "out").motor.t_s, t_s, atol=1e-6)
    document = tomllib.loads((tmp_path / "out/import.toml").read_text())
    assert document["clock"]["origin_s"] == pytest.approx(first_s)


def test_a_video_without_stamps_is_on_the_clock_of_the_motor(taut: Taut, tmp_path: Path) -> None:
    """The motor's stamps are 0.3 s before they are logged; the frames have no stamps."""
    t_s = np.arange(0.0, 4.0, 0.02)
    coded = files.jpegs(8, 48)
    frame_s = 0.4 * np.arange(8) + 0.3
    path = files.rosbag(
        tmp_path / "bag", {"/joints": (t_s, {"jaw": np.sin(t_s)})}, pictures={"/cam": (frame_s, coded)},
        late_s=0.3, stamped=("/joints",),
    )  # fmt: skip
    done = taut("import", path, "--out", tmp_path / "out", "--motor", "/joints.position[0]", "--video", "/cam")
    assert done.code == 0 and "/cam has no header stamps" in done.err and "by the log times" in done.out
    made = load(tmp_path / "out", RIG)
    assert made.video is not None and made.video.arrival_s is not None
    assert made.video.arrival_s[0] == pytest.approx(made.motor.t_s[0], abs=1e-6)


def test_a_place_in_the_image_becomes_a_marker(taut: Taut, tmp_path: Path) -> None:
    run = simulated()
    t_s, q, c = table(run)
    u, v = 300.0 + 5.0 * c, 200.0 + c
    u[7] = np.nan
    lines = ["t_s,q_mm,u,v", *(f"{a:.6f},{b:.4f},{x:.4f},{y:.4f}" for a, b, x, y in zip(t_s, q, u, v, strict=True))]
    path = tmp_path / "track.csv"
    path.write_text("\n".join(lines).replace("nan", "") + "\n")
    done = taut("import", path, "--out", tmp_path / "out", "--motor", "q_mm", "--tip", "u", "--tip", "v")
    assert done.code == 0 and "no rig.toml was written" in done.err
    made = load(tmp_path / "out", RIG_MM)
    assert made.marker is not None and not made.marker.valid[7] and made.marker.valid.sum() == len(q) - 1
    np.testing.assert_allclose(made.marker.u_px[8:], u[8:], atol=1e-4)


def test_plain_pictures_are_kept_to_the_last_bit(tmp_path: Path) -> None:
    """Padded rows, BGR and grey, as a bag's raw images have them."""
    from tautline.io.importing.messages import picture
    from tautline.io.importing.video import from_pictures

    rng = np.random.default_rng(3)
    for encoding, channels in (("bgr8", 3), ("rgb8", 3), ("mono8", 1)):
        frames = rng.integers(0, 256, (4, 30, 41, channels), dtype=np.uint8)
        messages = []
        for frame in frames:
            padded = np.zeros((30, 41 * channels + 5), np.uint8)
            padded[:, : 41 * channels] = frame.reshape(30, -1)
            step = padded.shape[1]
            messages.append({"height": 30, "width": 41, "encoding": encoding, "step": step, "data": padded.tobytes()})
        pictures = [picture(each, 0.04 * k, np.nan) for k, each in enumerate(messages)]
        path = tmp_path / f"{encoding}.mkv"
        log_s, _ = from_pictures((each for each in pictures if each is not None), path, "images")
        np.testing.assert_allclose(log_s, 0.04 * np.arange(4))
        with VideoCamera(path) as camera:
            seen = [read[0] for _ in frames if (read := camera.read())]
        for got, frame in zip(seen, frames, strict=True):
            np.testing.assert_array_equal(
                got, frame[:, :, ::-1] if encoding == "rgb8" else np.broadcast_to(frame, got.shape)
            )


def test_a_grey_picture_of_16_bits_is_the_same_from_either_end() -> None:
    """Without a step its rows stand one behind the other."""
    from tautline.io.importing.messages import picture

    grey = np.random.default_rng(4).integers(0, 65536, (3, 5), dtype=np.uint16)
    about = {"height": 3, "width": 5, "encoding": "mono16", "step": 0}
    little, big = (
        picture({**about, "is_bigendian": big, "data": grey.astype(kind).tobytes()}, 0.0, np.nan)
        for big, kind in ((0, "<u2"), (1, ">u2"))
    )
    assert little is not None and big is not None and little.data == big.data == grey.astype("<u2").tobytes()


RIG_MM = Rig.from_document(
    RIG.to_document() | {"actuator": {"unit": "mm", "range": [-40.0, 40.0], "encoder_resolution": 0.01}}, ""
)


def test_an_orientations_angle_is_the_turn_about_its_axis() -> None:
    """About any axis, from any base, through 180 deg: the twist's own equation gives it back."""
    rng = np.random.default_rng(5)
    angle = np.linspace(-120.0, 200.0, 400)
    for _ in range(10):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        half = np.radians(angle)[:, None] / 2
        found, share = bending_deg(np.hstack([np.sin(half) * axis, np.cos(half)]))
        sign = np.sign(axis[np.abs(axis).argmax()])
        np.testing.assert_allclose(
            (found - sign * angle) % 360.0 - 360.0 * ((found - sign * angle) % 360.0 > 180.0), 0.0, atol=1e-6
        )
        assert share > 1.0 - 1e-9 and np.abs(np.diff(found)).max() < 1.0
