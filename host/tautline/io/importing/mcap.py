"""MCAP files with ROS 1, ROS 2, protobuf or JSON messages, by the `mcap` library and its decoders."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterator
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


class Mcap:
    """An MCAP file as a Source: one episode, a group for each topic."""

    kind = "MCAP"
    numbers = "topic"

    def __init__(self, path: Path) -> None:
        """Reads the file's summary: whether it has chunks and messages, and its first time. TautError where it is cut
        or no MCAP, or the library is missing."""
        self.path = path
        self.facts: dict[str, Fact] = {}
        self.videos: list[str] = []
        self.notes: list[str] = []
        self._reader = library("mcap.reader", f"{path}: MCAP")
        self._errors: tuple[type[Exception], ...] = (library("mcap.exceptions", "MCAP").McapError, EOFError, ValueError)
        self._undecoded: set[str] = set()
        try:
            with path.open("rb") as stream:
                summary = self._reader.make_reader(stream).get_summary()
        except self._errors as error:
            raise self._cut_error(error) from error
        # Which order needs less memory: with chunks, by time the library holds only those that overlap, in the file's
        # order all of them; without chunks it is the other way round.
        self._by_time = summary is not None and bool(summary.chunk_indexes)
        if summary is None or summary.statistics is None:
            self.notes.append(f"{path}: has no summary at its end, all that can be read was taken")
            first_ns = 0
        else:
            first_ns = summary.statistics.message_start_time
        self.origin_s = origin_of(first_ns * 1e-9)
        self._origin_ns = first_ns if self.origin_s else 0
        self._empty = summary is not None and summary.statistics is not None and not summary.statistics.message_count

    def episodes(self) -> tuple[int, ...]:
        """(0,): the file is one recording; () where it has no messages."""
        return () if self._empty else (0,)

    def batches(self, episode: int, groups: Collection[str] | None = None) -> Iterator[Batch]:
        """Yields the numbers in the messages of these topics (None: all), in batches. Topics of pictures are added to
        `videos` instead; topics that cannot be decoded are left out, and `notes` says so. episode: unused."""
        builder = BatchBuilder()
        flatteners: dict[str, Flattener] = {}  # by topic, which several channels may share: one for each publisher
        for schema, channel, message, decode in self._messages(groups):
            type_name = schema.name if schema is not None else ""
            if is_picture(type_name):
                if channel.topic not in self.videos:
                    self.videos.append(channel.topic)
                    self.facts[channel.topic] = Fact(type_name)
                continue
            if channel.topic not in flatteners:
                flatteners[channel.topic] = Flattener(channel.topic, type_name, self.facts)
            decoded = decode(message.data)
            stamp = stamp_ns(decoded)
            batch = builder.add(
                channel.topic,
                self._seconds(message.log_time),
                self._seconds(stamp),
                flatteners[channel.topic].values(decoded),
            )
            if batch is not None:
                yield batch
        yield from builder.rest()
        for each in sorted(self._undecoded):
            note = f"{self.path}: {each} cannot be decoded and was left out"
            if note not in self.notes:
                self.notes.append(note)

    def pictures(self, episode: int, video: str) -> Iterator[Picture]:
        """Yields the pictures of the image topic `video`; none where it has no messages. TautError where it is no image
        topic, or a picture has an unknown encoding. episode: unused."""
        for schema, _, message, decode in self._messages([video]):
            if schema is None or not is_picture(schema.name):
                raise no_video_error(self.path, video, self.videos)
            decoded = decode(message.data)
            found = picture(decoded, self._seconds(message.log_time), self._seconds(stamp_ns(decoded)))
            if found is None:
                raise unknown_encoding_error(self.path, video)
            yield found

    def _messages(self, topics: Collection[str] | None) -> Iterator[tuple[Any, Any, Any, Callable[[bytes], Any]]]:
        """Yields (schema, channel, message, function that decodes its data) of these topics (None: all), by log time if
        the file has chunks, else in the file's order. Channels that cannot be decoded are left out. TautError where the
        file is cut."""
        decoders: dict[int, Callable[[bytes], Any] | None] = {}
        wanted = None if topics is None else list(topics)
        try:
            with self.path.open("rb") as stream:
                reader = self._reader.make_reader(stream)
                for schema, channel, message in reader.iter_messages(wanted, log_time_order=self._by_time):
                    if channel.id not in decoders:
                        decoders[channel.id] = self._decoder_for(schema, channel)
                    decode = decoders[channel.id]
                    if decode is not None:
                        yield schema, channel, message, decode
        except self._errors as error:
            raise self._cut_error(error) from error

    def _decoder_for(self, schema: Any, channel: Any) -> Callable[[bytes], Any] | None:
        """The function that decodes the data of a channel's messages by its schema; None where the encoding is unknown,
        which is kept in `_undecoded`."""
        encoding = channel.message_encoding
        found: Callable[[bytes], Any] | None = None
        if encoding == "json":
            return json.loads
        if encoding == "cdr":
            ros2 = library("mcap_ros2.decoder", f"{self.path}: {channel.topic}, a ROS 2 message,")
            found = ros2.DecoderFactory().decoder_for(encoding, schema)
        elif encoding == "protobuf":
            protobuf = library("mcap_protobuf.decoder", f"{self.path}: {channel.topic}, a protobuf message,")
            found = protobuf.DecoderFactory().decoder_for(encoding, schema)
        elif encoding == "ros1" and schema is not None:
            typesys = library("rosbags.typesys", f"{self.path}: {channel.topic}, a ROS 1 message,")
            store = typesys.get_typestore(typesys.Stores.EMPTY)
            store.register(typesys.get_types_from_msg(schema.data.decode(), _ros1_name(schema.name)))
            return lambda data: store.deserialize_ros1(data, _ros1_name(schema.name))
        if found is None:
            of = f" of {schema.encoding}" if schema is not None else ""
            self._undecoded.add(f"{channel.topic} ({encoding}{of})")
        return found

    def _seconds(self, time_ns: int | None) -> float:
        """A time of the file, ns, as s since the source's origin; NaN for None."""
        return seconds_since(self._origin_ns, time_ns)

    def _cut_error(self, error: Exception) -> TautError:
        """The error to raise for an error of the library: it says that the file is cut or no MCAP, and how to save what
        is whole."""
        return TautError(
            f"{self.path}: is cut short or no MCAP file ({' '.join(str(error).split()) or 'it ends too early'}): "
            f"'mcap recover {self.path} -o whole.mcap' saves what is whole"
        )


def _ros1_name(name: str) -> str:
    """A ROS 1 type's name, PACKAGE/NAME, as rosbags has it: PACKAGE/msg/NAME."""
    package, _, short = name.partition("/")
    return name if short.startswith("msg/") else f"{package}/msg/{short}"
