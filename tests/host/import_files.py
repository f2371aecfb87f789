"""Recordings in other programs' files, each written by its format's own library."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from google.protobuf.descriptor_pb2 import FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.writer import Writer
from mcap_protobuf.writer import Writer as ProtobufWriter
from mcap_ros2.writer import Writer as Ros2Writer
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

Array = np.ndarray
EPOCH_NS = 1_760_000_000_000_000_000
HEADER = """================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
JOINT_STATE = (
    """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
"""
    + HEADER
)
POSE = (
    """std_msgs/Header header
geometry_msgs/Pose pose
"""
    + HEADER
    + """================================================================================
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""
)


def ns(t_s: float) -> int:
    return EPOCH_NS + round(1e9 * t_s)


def stamp(time_ns: int) -> dict[str, object]:
    return {"stamp": {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9}, "frame_id": ""}


def mcap_json(path: Path, topics: Mapping[str, tuple[Array, Mapping[str, Array]]]) -> Path:
    """topic: (t_s, field: values), as JSON messages."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for topic, (t_s, columns) in topics.items():
            schema = writer.register_schema(topic.strip("/"), "jsonschema", b'{"type": "object"}')
            channel = writer.register_channel(topic, "json", schema)
            for k, t in enumerate(t_s):
                row = {name: float(values[k]) for name, values in columns.items()}
                writer.add_message(channel, ns(t), json.dumps(row).encode(), ns(t))
        writer.finish()
    return path


def mcap_messages(
    path: Path, topics: Mapping[str, Sequence[tuple[float, Mapping[str, object]]]], pictures: Sequence[str] = (),
    summary: bool = True,
) -> Path:  # fmt: skip
    """JSON messages (t, message) of each topic in the order given, without chunks; a topic's name with a blank behind
    it is another channel of that topic."""
    with path.open("wb") as stream:
        writer = Writer(stream, use_chunking=False, use_statistics=summary)
        writer.start()
        for topic, messages in topics.items():
            kind = "foxglove.CompressedImage" if topic in pictures else "message"
            schema = writer.register_schema(kind, "jsonschema", b'{"type": "object"}')
            channel = writer.register_channel(topic.strip(), "json", schema)
            for t, message in messages:
                writer.add_message(channel, ns(t), json.dumps(message).encode(), ns(t))
        writer.finish()
    return path


def mcap_protobuf(path: Path, topics: Mapping[str, tuple[Array, Mapping[str, Array]]]) -> Path:
    file = FileDescriptorProto(name="robot.proto", package="robot", syntax="proto3")
    for k, (_, columns) in enumerate(topics.values()):
        described = file.message_type.add(name=f"Message{k}")
        for number, name in enumerate(columns, 1):
            described.field.add(name=name, number=number, type=1, label=1)  # an optional double
    pool = DescriptorPool()
    pool.Add(file)
    with path.open("wb") as stream, ProtobufWriter(stream) as writer:
        for k, (topic, (t_s, columns)) in enumerate(topics.items()):
            kind = GetMessageClass(pool.FindMessageTypeByName(f"robot.Message{k}"))
            for row, t in enumerate(t_s):
                message = kind(**{name: float(values[row]) for name, values in columns.items()})
                writer.write_message(topic, message, ns(t), ns(t))
    return path


def mcap_ros1(path: Path, t_s: Array, q: Array, c: Array) -> Path:
    """/joint_states and /jaw as ROS 1 messages."""
    store = get_typestore(Stores.ROS1_NOETIC)
    state = store.types["sensor_msgs/msg/JointState"]
    header, time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    definition = store.generate_msgdef(state.__msgtype__)[0]
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("sensor_msgs/JointState", "ros1msg", definition.encode())
        channels = {topic: writer.register_channel(topic, "ros1", schema) for topic in ("/joint_states", "/jaw")}
        for k, t in enumerate(t_s):
            head = header(seq=k, stamp=time(sec=ns(t) // 10**9, nanosec=ns(t) % 10**9), frame_id="")
            for topic, names, values in (
                ("/joint_states", ["elbow", "jaw_motor"], [0.0, q[k]]),
                ("/jaw", ["jaw"], [c[k]]),
            ):
                message = state(head, names, np.array(values), np.zeros(0), np.zeros(0))
                data = bytes(store.serialize_ros1(message, state.__msgtype__))
                writer.add_message(channels[topic], ns(t), data, ns(t))
        writer.finish()
    return path


def mcap_ros2(
    path: Path,
    t_s: Array,
    joints: Mapping[str, Array],
    tip: tuple[Array, Array] | None = None,
    effort: Mapping[str, Array] | None = None,
    late: Callable[[float], float] = lambda t: t,
    tip_stamp_s: float = 0.0,
    tip_rate: float = 0.0,
) -> Path:
    """/joint_states with the joints, rad, and /tip_pose, which turns about y by angles of (t_s, rad). late: when a
    message of a time is logged. tip_stamp_s, tip_rate: by how much the tip's own clock is ahead, and runs
    faster."""
    with path.open("wb") as stream:
        writer = Ros2Writer(stream)
        state = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
        pose = writer.register_msgdef("geometry_msgs/msg/PoseStamped", POSE)
        rows: list[tuple[float, str, object, dict[str, object]]] = []
        for k, t in enumerate(t_s):
            rows.append(
                (
                    t,
                    "/joint_states",
                    state,
                    {
                        "header": stamp(ns(t)),
                        "name": list(joints),
                        "position": [float(values[k]) for values in joints.values()],
                        "velocity": [],
                        "effort": [float(values[k]) for values in (effort or {}).values()],
                    },
                )
            )
        for t, angle in zip(*tip, strict=True) if tip is not None else ():
            turned = {"x": 0.0, "y": float(np.sin(angle / 2)), "z": 0.0, "w": float(np.cos(angle / 2))}
            place = {"x": float(0.02 * np.sin(angle)), "y": 0.0, "z": float(0.02 * np.cos(angle))}
            message = {
                "header": stamp(ns(t + tip_stamp_s + tip_rate * t)),
                "pose": {"position": place, "orientation": turned},
            }
            rows.append((t, "/tip_pose", pose, message))
        for t, topic, schema, message in sorted(rows, key=lambda row: row[0]):
            writer.write_message(topic, schema, message, ns(late(t)), ns(t))
        writer.finish()
    return path


def rosbag(
    path: Path,
    topics: Mapping[str, tuple[Array, Mapping[str, Array]]],
    storage: rosbag2.StoragePlugin | None = rosbag2.StoragePlugin.SQLITE3,
    pictures: Mapping[str, tuple[Array, Sequence[bytes]]] | None = None,
    late_s: float = 0.0,
    stamped: Sequence[str] | None = None,
) -> Path:
    """JointState messages of any joints, and CompressedImage; storage None writes a ROS 1 bag. late_s: from a joint's
    stamp to its log. stamped: topics whose headers have a stamp; None: all."""
    store = get_typestore(Stores.ROS1_NOETIC if storage is None else Stores.ROS2_HUMBLE)
    types = store.types
    header, time = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    state, image = types["sensor_msgs/msg/JointState"], types["sensor_msgs/msg/CompressedImage"]
    writer = rosbag1.Writer(path) if storage is None else rosbag2.Writer(path, version=9, storage_plugin=storage)

    def head(k: int, topic: str, t: float) -> object:
        set_ns = ns(t) if stamped is None or topic in stamped else 0
        at = time(sec=set_ns // 10**9, nanosec=set_ns % 10**9)
        return header(seq=k, stamp=at, frame_id="") if storage is None else header(stamp=at, frame_id="")

    empty = np.zeros(0)
    rows: list[tuple[float, str, object]] = []
    for topic, (t_s, joints) in topics.items():
        for k, t in enumerate(t_s):
            position = np.array([values[k] for values in joints.values()])
            rows.append((t + late_s, topic, state(head(k, topic, t), list(joints), position, empty, empty)))
    for topic, (t_s, frames) in (pictures or {}).items():
        for k, t in enumerate(t_s):
            rows.append((t, topic, image(head(k, topic, t), "jpeg", np.frombuffer(frames[k], np.uint8))))
    with writer as opened:
        connections = {}
        for topic in {row[1] for row in rows}:
            kind = image if topic in (pictures or {}) else state
            connections[topic] = opened.add_connection(topic, kind.__msgtype__, typestore=store)
        for t, topic, message in sorted(rows, key=lambda row: row[0]):
            if storage is None:
                data = store.serialize_ros1(message, message.__msgtype__)
            else:
                data = store.serialize_cdr(message, message.__msgtype__)
            opened.write(connections[topic], ns(t), data)
    return path


Episode = tuple[Array, Mapping[str, Array], Mapping[str, Array]]  # t_s, action and observation.state by joint


def lerobot(
    folder: Path, episodes: Sequence[Episode], version: str = "v3.0", unit: str = "", camera: int = 0, fps: int = 50
) -> Path:
    """A data set as LeRobot publishes it. camera: the width of a video of grey frames, each as bright as its number."""
    first = episodes[0]
    (folder / "meta").mkdir(parents=True)
    features: dict[str, dict[str, object]] = {}
    for name, joints in (("action", first[1]), ("observation.state", first[2])):
        features[name] = {"dtype": "float32", "shape": [len(joints)], "names": list(joints)}
        if unit:
            features[name]["unit"] = unit
    key = "observation.images.wrist"
    if camera:
        features[key] = {"dtype": "video", "shape": [camera, camera, 3], "names": ["height", "width", "channels"]}
    for name in ("timestamp", "frame_index", "episode_index", "index", "task_index"):
        features[name] = {"dtype": "float32" if name == "timestamp" else "int64", "shape": [1], "names": None}
    new = version.startswith("v3")
    data_path = (
        "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
        if new
        else "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
    )
    video_path = (
        "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
        if new
        else "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"
    )
    info = {
        "codebase_version": version,
        "robot_type": "so101_follower",
        "total_episodes": len(episodes),
        "total_frames": sum(len(each[0]) for each in episodes),
        "total_tasks": 1,
        "chunks_size": 1000,
        "fps": fps,
        "splits": {"train": f"0:{len(episodes)}"},
        "data_path": data_path,
        "video_path": video_path if camera else None,
        "features": features,
    }
    (folder / "meta/info.json").write_text(json.dumps(info))
    (folder / "meta/stats.json").write_text("{}")
    tables, lines, start = [], [], 0
    for k, (t_s, action, state) in enumerate(episodes):
        n = len(t_s)
        columns = {
            "action": pa.FixedSizeListArray.from_arrays(_flat(action), len(action)),
            "observation.state": pa.FixedSizeListArray.from_arrays(_flat(state), len(state)),
            "timestamp": pa.array(t_s, pa.float32()),
            "frame_index": pa.array(np.arange(n)),
            "episode_index": pa.array(np.full(n, k)),
            "index": pa.array(np.arange(start, start + n)),
            "task_index": pa.array(np.zeros(n, dtype=np.int64)),
        }
        tables.append(pa.table(columns))
        line: dict[str, object] = {"episode_index": k, "tasks": ["calibrate"], "length": n}
        if new:
            line |= {"data/chunk_index": 0, "data/file_index": 0}
            line |= {"dataset_from_index": start, "dataset_to_index": start + n}
            if camera:
                line |= {f"videos/{key}/chunk_index": 0, f"videos/{key}/file_index": 0}
                line |= {f"videos/{key}/from_timestamp": start / fps, f"videos/{key}/to_timestamp": (start + n) / fps}
            line |= {"stats/action/max": [1.0], "meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0}
        lines.append(line)
        start += n
    if new:
        (folder / "data/chunk-000").mkdir(parents=True)
        pq.write_table(pa.concat_tables(tables), folder / data_path.format(chunk_index=0, file_index=0))
        (folder / "meta/episodes/chunk-000").mkdir(parents=True)
        pq.write_table(pa.Table.from_pylist(lines), folder / "meta/episodes/chunk-000/file-000.parquet")
    else:
        (folder / "data/chunk-000").mkdir(parents=True)
        for k, table in enumerate(tables):
            pq.write_table(table, folder / data_path.format(episode_chunk=0, episode_index=k))
        (folder / "meta/episodes.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
        (folder / "meta/tasks.jsonl").write_text('{"task_index": 0, "task": "calibrate"}\n')
    if camera:
        lengths = [sum(len(t) for t, _, _ in episodes)] if new else [len(t) for t, _, _ in episodes]
        for k, length in enumerate(lengths):
            at = {"video_key": key, "chunk_index": 0, "file_index": 0, "episode_chunk": 0, "episode_index": k}
            video(folder / video_path.format(**at), length, camera, fps)
    return folder


def _flat(joints: Mapping[str, Array]) -> pa.Array:
    return pa.array(np.column_stack(list(joints.values())).ravel(), pa.float32())


def level(frame: int) -> int:
    """How bright a frame of `video` and `jpegs` is."""
    return 40 + 3 * (frame % 60)


def video(path: Path, frames: int, size: int, fps: int) -> None:
    """H.264 with a key frame every fifth frame."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as output:
        stream = output.add_stream("libx264", rate=Fraction(fps), options={"g": "5", "crf": "10"})
        stream.width = stream.height = size
        stream.pix_fmt = "yuv420p"
        for k in range(frames):
            grey = np.full((size, size, 3), level(k), np.uint8)
            output.mux(stream.encode(av.VideoFrame.from_ndarray(grey, format="rgb24")))
        output.mux(stream.encode(None))


def jpegs(frames: int, size: int) -> list[bytes]:
    coder = av.CodecContext.create("mjpeg", "w")
    coder.width = coder.height = size
    coder.pix_fmt, coder.time_base = "yuvj420p", Fraction(1, 25)
    found = []
    for k in range(frames):
        frame = av.VideoFrame.from_ndarray(np.full((size, size, 3), level(k), np.uint8), format="rgb24")
        found += [bytes(packet) for packet in coder.encode(frame.reformat(format="yuvj420p"))]
    return found
