"""ROS 1 bags and rosbag2 folders (sqlite3 or MCAP), by the `rosbags` library: no ROS has to be installed."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tautline.errors import TautError
from tautline.io.importing.libraries import library
from tautline.io.importing.messages import Flattener, Gathered, is_picture, picture, stamp_ns
from tautline.io.importing.source import Batch, Fact, Picture, no_pictures, no_video, origin_of, seconds_since


class Rosbag:
    """A ROS 1 bag or a ROS 2 bag's folder as a Source: one episode, a group for each topic."""

    numbers = "topic"

    def __init__(self, path: Path) -> None:
        """Reads the bag's index. TautError where it is cut or no bag, or the library is missing."""
        self.path = path
        self.kind = "ROS 1 bag" if path.suffix == ".bag" else "ROS 2 bag"
        self.facts: dict[str, Fact] = {}
        self.videos: list[str] = []
        self.notes: list[str] = []
        self._highlevel = library("rosbags.highlevel", f"{path}: a {self.kind}")
        self._typesys = library("rosbags.typesys", "a ROS bag")
        with self._opened() as reader:
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
        """The numbers in the messages of these topics (None: all), in batches. Topics whose type is not defined are
        left out, with a note."""
        gathered = Gathered()
        flatteners: dict[str, Flattener] = {}
        with self._opened() as reader:
            chosen = [
                c for c in reader.connections if not is_picture(c.msgtype) and (groups is None or c.topic in groups)
            ]
            for connection, log_ns, raw in reader.messages(chosen) if chosen else ():
                message = self._decoded(reader, connection, raw)
                if message is None:
                    continue
                topic = connection.topic
                if topic not in flatteners:
                    flatteners[topic] = Flattener(topic, connection.msgtype, self.facts)
                batch = gathered.add(
                    topic, self._seconds(log_ns), self._seconds(stamp_ns(message)), flatteners[topic].values(message)
                )
                if batch is not None:
                    yield batch
        yield from gathered.rest()

    def pictures(self, episode: int, video: str) -> Iterator[Picture]:
        """The pictures of an image topic. TautError where there is no such topic, or its pictures have an unknown
        encoding."""
        with self._opened() as reader:
            chosen = [c for c in reader.connections if c.topic == video and is_picture(c.msgtype)]
            if not chosen:  # to the library no connections are all
                raise no_video(self.path, video, self.videos)
            for connection, log_ns, raw in reader.messages(chosen):
                message = reader.deserialize(raw, connection.msgtype)
                found = picture(message, self._seconds(log_ns), self._seconds(stamp_ns(message)))
                if found is None:
                    raise no_pictures(self.path, video)
                yield found

    def _decoded(self, reader: Any, connection: Any, raw: bytes) -> Any:
        """Decodes a message of a connection (topic and type); None, with a note, where the bag does not define its
        type."""
        try:
            return reader.deserialize(raw, connection.msgtype)
        except KeyError:
            note = f"{self.path}: {connection.topic} is of {connection.msgtype}, which it does not define: left out"
            if note not in self.notes:
                self.notes.append(note)
            return None

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        """A context with a reader of the bag. Errors of the library, also within the block, become a TautError: the bag
        is cut or none."""
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
        """As `seconds_since` the source's origin."""
        return seconds_since(self._origin_ns, time_ns)
