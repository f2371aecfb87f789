"""ROS 1 bags and rosbag2 folders (sqlite3 or MCAP), by the `rosbags` library: no ROS has to be installed."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tautline.errors import TautError
from tautline.io.importing.libraries import library
from tautline.io.importing.messages import BatchBuilder, Flattener, is_picture, picture, stamp_ns
from tautline.io.importing.source import (
    Batch,
    Fact,
    Picture,
    no_video_error,
    origin_of,
    seconds_since,
    unknown_encoding_error,
)


class Rosbag:
    """A ROS 1 bag or a ROS 2 bag's folder as a Source: one episode, a group for each topic."""

    numbers = "topic"

    def __init__(self, path: Path) -> None:
        """Reads the bag's index: its topics with pictures, its first time and its number of messages. TautError where
        it is cut or no bag, or the library is missing."""
        self.path = path
        self.kind = "ROS 1 bag" if path.suffix == ".bag" else "ROS 2 bag"
        self.facts: dict[str, Fact] = {}
        self.videos: list[str] = []
        self.notes: list[str] = []
        self._highlevel = library("rosbags.highlevel", f"{path}: a {self.kind}")
        self._typesys = library("rosbags.typesys", "a ROS bag")
        with self._open_reader() as reader:
            self._count = reader.message_count
            first_ns = reader.start_time if self._count else 0
            self.videos += sorted({c.topic for c in reader.connections if is_picture(c.msgtype)})
            self.facts.update({c.topic: Fact(c.msgtype) for c in reader.connections if is_picture(c.msgtype)})
        self.origin_s = origin_of(first_ns * 1e-9)
        self._origin_ns = first_ns if self.origin_s else 0

    def episodes(self) -> tuple[int, ...]:
        """(0,): the bag is one recording; () where it has no messages."""
        return (0,) if self._count else ()

    def batches(self, episode: int, groups: Collection[str] | None = None) -> Iterator[Batch]:
        """Yields the numbers in the messages of these topics (None: all), in batches. Topics with a type that the bag
        does not define are left out, and `notes` says so. episode: unused."""
        builder = BatchBuilder()
        flatteners: dict[str, Flattener] = {}
        with self._open_reader() as reader:
            chosen = [
                c for c in reader.connections if not is_picture(c.msgtype) and (groups is None or c.topic in groups)
            ]
            for connection, log_ns, raw in reader.messages(chosen) if chosen else ():
                message = self._decode(reader, connection, raw)
                if message is None:
                    continue
                topic = connection.topic
                if topic not in flatteners:
                    flatteners[topic] = Flattener(topic, connection.msgtype, self.facts)
                batch = builder.add(
                    topic, self._seconds(log_ns), self._seconds(stamp_ns(message)), flatteners[topic].values(message)
                )
                if batch is not None:
                    yield batch
        yield from builder.rest()

    def pictures(self, episode: int, video: str) -> Iterator[Picture]:
        """Yields the pictures of the image topic `video`. TautError where there is no such topic, or a picture has an
        unknown encoding. episode: unused."""
        with self._open_reader() as reader:
            chosen = [c for c in reader.connections if c.topic == video and is_picture(c.msgtype)]
            if not chosen:  # an empty list would mean all topics to the library
                raise no_video_error(self.path, video, self.videos)
            for connection, log_ns, raw in reader.messages(chosen):
                message = reader.deserialize(raw, connection.msgtype)
                found = picture(message, self._seconds(log_ns), self._seconds(stamp_ns(message)))
                if found is None:
                    raise unknown_encoding_error(self.path, video)
                yield found

    def _decode(self, reader: Any, connection: Any, raw: bytes) -> Any:
        """Decodes a message of a connection (topic and type). None, and a line in `notes`, where the bag does not
        define the type."""
        try:
            return reader.deserialize(raw, connection.msgtype)
        except KeyError:
            note = f"{self.path}: {connection.topic} is of {connection.msgtype}, which it does not define: left out"
            if note not in self.notes:
                self.notes.append(note)
            return None

    @contextmanager
    def _open_reader(self) -> Iterator[Any]:
        """A context with an open reader of the bag. Errors of the library, also those within the block, become a
        TautError that says that the bag is cut or none, and how to mend it."""
        store = self._typesys.get_typestore(self._typesys.Stores.LATEST)
        try:
            with self._highlevel.AnyReader([self.path], default_typestore=store) as reader:
                yield reader
        except (TautError, OSError):
            raise
        except Exception as error:  # the library raises its readers', sqlite's and struct's own kinds for a broken bag
            mend = (
                "'rosbag reindex' mends one that was not closed"
                if self.kind == "ROS 1 bag"
                else "'ros2 bag reindex' makes its metadata.yaml again, 'mcap recover' mends a cut .mcap"
            )
            what = " ".join(str(error).split())[:120]
            raise TautError(f"{self.path}: is cut short or no {self.kind} ({what}): {mend}") from error

    def _seconds(self, time_ns: int | None) -> float:
        """A time of the bag, ns, as s since the source's origin; NaN for None."""
        return seconds_since(self._origin_ns, time_ns)
