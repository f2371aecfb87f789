"""Numbers, stamps and pictures of a message, whatever decoded it: an object of fields, a protobuf or a dictionary."""

from __future__ import annotations

from base64 import b64decode
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from tautline.io.importing.source import BATCH_ROWS, Batch, Fact, Picture

LONGEST_ARRAY = 64  # prior: numbers of one field that are channels of their own: more is a map, a cloud or a picture
_NAMES = ("name", "joint_names", "names")  # of the numbers in the arrays beside it
_KEYS = ("child_frame_id", "name", "joint_name", "id")  # which one of several alike a part of a message is
_NS_PER_S = 10**9
_MOST_HELD = 4 * BATCH_ROWS  # limit: of memory: of all topics together
_NUMBER = (float, int, np.number)  # a bool is an int
_NO_NUMBERS = (str, bytes, bytearray, memoryview)


def fields(message: Any) -> list[tuple[str, Any]]:
    """The fields (name, value) of a message, however it was decoded: a dictionary, a protobuf message, or an object of
    a dataclass or with slots. [] for a value that is no message."""
    if isinstance(message, Mapping):
        return [(str(key), value) for key, value in message.items()]
    if (descriptor := getattr(message, "DESCRIPTOR", None)) is not None:
        return [(field.name, getattr(message, field.name)) for field in descriptor.fields]
    names = getattr(message, "__dataclass_fields__", None) or getattr(message, "__slots__", None) or ()
    return [(name, getattr(message, name)) for name in names if not name.startswith("_")]


def field_of(message: Any, name: str) -> Any:
    """The value of the field `name` in a message, however it was decoded; None where it has no such field."""
    return message.get(name) if isinstance(message, Mapping) else getattr(message, name, None)


def stamp_ns(message: Any) -> int | None:
    """The sender's time in a message, ns: of its header, else its field `timestamp`; of several transforms that of the
    first. None where there is none, it is 0, or its parts (seconds, nanoseconds) are no whole numbers."""
    inner = field_of(message, "transforms")
    if inner is not None and len(inner):
        return stamp_ns(inner[0])
    header = field_of(message, "header")
    stamp = field_of(header, "stamp") if header is not None else field_of(message, "timestamp")
    if stamp is None:
        return None
    whole = next((value for name in ("sec", "secs", "seconds") if (value := field_of(stamp, name)) is not None), None)
    rest = next((v for name in ("nanosec", "nsec", "nsecs", "nanos") if (v := field_of(stamp, name)) is not None), 0)
    if not isinstance(whole, int) or not isinstance(rest, int):
        return None
    return whole * _NS_PER_S + rest or None


class Flattener:
    """Takes the numbers out of one topic's messages, by channel. A joint keeps its index if later messages name their
    joints in another order, or name other joints."""

    def __init__(self, topic: str, type_name: str, facts: dict[str, Fact]) -> None:
        """facts: the source's, by channel; new channels are added to it."""
        self.topic, self.type_name, self._facts = topic, type_name, facts
        self._indices: dict[str, dict[str, int]] = {}  # by the path of the names, the index of each

    def values(self, message: Any) -> dict[str, float]:
        """A message's numbers by channel, which is the path from the topic on: TOPIC.position[0]."""
        found: dict[str, float] = {}
        self._add_message(self.topic, message, found)
        return found

    def _add_message(self, path: str, message: Any, found: dict[str, float]) -> None:
        """Adds to `found` the numbers of a message, or of an inner message, at `path`; times, headers and layouts are
        left out."""
        parts = fields(message)
        names = next((list(v) for name, v in parts if name in _NAMES and _is_list_of_texts(v)), None)
        for name, value in parts:
            if name in ("header", "timestamp", "stamp", "layout"):
                continue
            self._add_field(f"{path}.{name}", value, names, found)

    def _add_field(self, path: str, value: Any, names: list[str] | None, found: dict[str, float]) -> None:
        """Adds to `found` the numbers of a field at `path`: a number, an array of at most LONGEST_ARRAY, or those of
        inner messages. Texts and longer arrays are left out. names: the joints' names in the same message, None
        without; they label the arrays of their length."""
        if isinstance(value, _NUMBER):
            self._add_number(path, float(value), "", found)
        elif value is None or isinstance(value, _NO_NUMBERS):
            return
        elif isinstance(value, np.ndarray) or _is_sequence(value):
            if not 0 < len(value) <= LONGEST_ARRAY:
                return
            if isinstance(value[0], _NUMBER):
                labels = names if names is not None and len(names) == len(value) else None
                for k, number in enumerate(value):
                    index = self._index_of(path, labels[k]) if labels else k
                    self._add_number(f"{path}[{index}]", float(number), labels[k] if labels else "", found)
            else:
                for k, each in enumerate(value):
                    key = next((str(t) for name in _KEYS if isinstance(t := field_of(each, name), str) and t), str(k))
                    self._add_message(f"{path}[{key}]", each, found)
        else:
            self._add_message(path, value, found)

    def _add_number(self, path: str, number: float, label: str, found: dict[str, float]) -> None:
        """Adds a number to `found` under its channel `path`, and the channel to the facts if it is new. label: the
        joint's name, "" without."""
        found[path] = number
        if path not in self._facts:
            self._facts[path] = Fact(self.type_name, label, _defined_unit(self.type_name, path))

    def _index_of(self, path: str, name: str) -> int:
        """The index that a joint has in the array at `path`: always the same one; a new name gets the next free one,
        which is remembered."""
        known = self._indices.setdefault(path, {})
        return known.setdefault(name, len(known))


_Key = tuple[str, frozenset[str]]  # topic, names of its channels
_Row = tuple[float, float, dict[str, float]]  # log_s, stamp_s (as in Batch), numbers by channel


class BatchBuilder:
    """Collects rows of several topics into batches. Messages of one topic that hold other channels (two publishers of
    joints, optional fields) go into batches of their own, so that no row lacks a channel of its batch."""

    def __init__(self) -> None:
        """No rows yet."""
        self._rows: dict[_Key, list[_Row]] = {}  # those that are in no batch yet
        self._held = 0  # how many these are in sum

    def add(self, group: str, log_s: float, stamp_s: float, values: dict[str, float]) -> Batch | None:
        """Keeps a row: a message's numbers by channel. group: its topic; log_s, stamp_s: as in Batch, NaN without a
        stamp. Returns the row's batch once that has BATCH_ROWS rows, or the longest batch once _MOST_HELD rows are kept
        in all, and no longer keeps its rows; else None."""
        key = (group, frozenset(values))
        rows = self._rows.setdefault(key, [])
        rows.append((log_s, stamp_s, values))
        self._held += 1
        if len(rows) >= BATCH_ROWS:
            return self._batch(key)
        if self._held >= _MOST_HELD:
            return self._batch(max(self._rows, key=lambda each: len(self._rows[each])))
        return None

    def rest(self) -> Iterator[Batch]:
        """Yields batches of all rows that are still kept."""
        for key in list(self._rows):
            if self._rows[key]:
                yield self._batch(key)

    def _batch(self, key: _Key) -> Batch:
        """Removes the rows under a key and returns them as a batch; its stamps are None where no row has one."""
        rows = self._rows.pop(key)
        self._held -= len(rows)
        stamps = np.array([row[1] for row in rows])
        values = {name: np.array([row[2][name] for row in rows]) for name in rows[0][2]}
        return Batch(key[0], np.array([row[0] for row in rows]), None if np.isnan(stamps).all() else stamps, values)


_RAW = {
    "rgb8": "rgb24", "bgr8": "bgr24", "rgba8": "rgba", "bgra8": "bgra", "mono8": "gray", "8UC1": "gray",
    "8UC3": "bgr24", "mono16": "gray16le",
}  # fmt: skip
_ENCODED = {b"\xff\xd8": "mjpeg", b"\x89P": "png"}  # by a picture's first bytes


def is_picture(type_name: str) -> bool:
    """Whether a message type's name is that of a picture, of any package."""
    return type_name.replace("/", ".").split(".")[-1] in ("Image", "CompressedImage", "RawImage")


def picture(message: Any, log_s: float, stamp_s: float) -> Picture | None:
    """The picture in a message of an image topic, without the padding behind its rows (a row takes `step` bytes); 16
    bit pixels are made little-endian. None where its encoding cannot be taken into a video, or its data is cut. log_s,
    stamp_s: as in Picture."""
    data = field_of(message, "data")
    raw = _bytes_of(data)
    width, height = field_of(message, "width"), field_of(message, "height")
    if width is None:
        codec = _ENCODED.get(raw[:2])
        return Picture(log_s, stamp_s, raw, codec) if codec else None
    layout = _RAW.get(str(field_of(message, "encoding")))
    if layout is None:
        return None
    # bytes of a row without padding
    used = int(width) * {"gray": 1, "gray16le": 2, "rgba": 4, "bgra": 4}.get(layout, 3)
    step = int(field_of(message, "step") or used)
    if used == 0 or height == 0 or step < used or len(raw) < step * int(height):
        return None
    rows = np.frombuffer(raw, np.uint8, step * int(height)).reshape(int(height), step)[:, :used]
    if layout == "gray16le" and field_of(message, "is_bigendian"):
        rows = np.ascontiguousarray(rows).view(np.uint16).byteswap().view(np.uint8)
    return Picture(log_s, stamp_s, rows.tobytes(), layout, int(width), int(height))


def _bytes_of(data: Any) -> bytes:
    """A picture's data as bytes, however its message was decoded: JSON has base64 text. b"" for None, or a text that is
    no base64."""
    if isinstance(data, str):
        try:
            return b64decode(data, validate=True)
        except ValueError:
            return b""
    if data is None or isinstance(data, bytes | bytearray | memoryview | list):
        return bytes(data or b"")
    return np.asarray(data).tobytes()


def _defined_unit(type_name: str, path: str) -> str:
    """The unit of a channel by the definition of its message type: ROS has joint positions in radians and efforts in
    newton metres (REP 103). "" for all other channels."""
    if type_name.replace("/", ".").split(".")[-1] in ("JointState", "JointTrajectoryControllerState"):
        field = path.rsplit(".", 1)[-1]
        return "rad" if field.startswith("position") else "Nm" if field.startswith("effort") else ""
    return ""


def _is_sequence(value: Any) -> bool:
    """Whether a value has a length and items by index, and is no dictionary: a list, an array, also a text."""
    return not isinstance(value, Mapping) and hasattr(value, "__len__") and hasattr(value, "__getitem__")


def _is_list_of_texts(value: Any) -> bool:
    """Whether a value is a list of texts, by its first item; False for an empty list and for a text."""
    return _is_sequence(value) and len(value) > 0 and isinstance(value[0], str) and not isinstance(value, str)
