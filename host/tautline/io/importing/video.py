"""A recording's video from pictures in messages, or from a part of a video file. Frames are copied, never coded anew,
but for plain pixels, which are coded without loss."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from tautline.errors import TautError
from tautline.io.importing.libraries import library
from tautline.io.importing.source import Clip, Picture

Array = np.ndarray

_TICK = Fraction(1, 1000)  # format: s: Matroska's own
_ROUNDED_S = 1e-3  # format: by which a container's times, in its ticks, may be early


def from_pictures(pictures: Iterable[Picture], path: Path, name: str) -> tuple[Array, Array]:
    """Writes pictures as the Matroska video `path`. Returns the frames' log times and their stamps (NaN without), (n,)
    s each. The file's own times are the log times since the first, in whole ms and made to rise. name: of the channel,
    for errors. TautError where there is no picture, one cannot be decoded, or they differ in kind or size."""
    av = library("av", f"{name}: video")
    log: list[float] = []
    stamps: list[float] = []
    stream: Any = None
    kind: tuple[str, int, int] | None = None
    with av.open(str(path), "w", format="matroska") as output:
        last = -1
        for k, each in enumerate(pictures):
            size = _size(av, each, f"{name}: picture {k}")
            if kind is None:
                kind = (each.codec, *size)
                stream = _add_stream(av, output, each, size)
            if kind != (each.codec, *size):
                raise TautError(f"{name}: picture {k} is {each.codec} {size[0]}x{size[1]}, the first {kind[0]} "
                                f"{kind[1]}x{kind[2]}: record pictures of one kind and size")  # fmt: skip
            tick = round(max(each.log_s - (log[0] if log else each.log_s), 0.0) / _TICK)
            last = max(tick, last + 1)  # a container's times rise; the frames' own are those that are returned
            for packet in _encode_packets(av, stream, each, size):
                packet.stream, packet.time_base = stream, _TICK
                packet.pts = packet.dts = last
                output.mux(packet)
            log.append(each.log_s)
            stamps.append(each.stamp_s)
    if not log:
        raise TautError(f"{name}: holds no pictures")
    return np.array(log), np.array(stamps)


def cut(clip: Clip, path: Path) -> Array:
    """Copies the clip's part of a video file to the file `path` without coding it anew; so it begins at the key frame
    before the clip's first frame. Returns the time (n,) s of each written frame since the clip's begin, in the order in
    which they are shown, NaN for frames outside of the clip. TautError where the file is missing, no video, or has no
    frame there."""
    av = library("av", f"{clip.path}: video")
    if not clip.path.is_file():
        raise TautError(f"{clip.path}: the video is not there: copy it too, or leave --video out")
    times: list[float] = []
    try:
        with av.open(str(clip.path)) as source, av.open(str(path), "w") as output:
            read = source.streams.video[0]
            written = output.add_stream_from_template(read)
            source.seek(int(clip.first_s / read.time_base), stream=read)
            base = None
            for packet in source.demux(read):
                if packet.dts is None or packet.pts is None:
                    continue
                at = float(packet.pts * read.time_base)
                # Packets come in the order of decoding (dts), so one that is shown later (pts) may come before the
                # clip's last ones: the clip ends where both times are past its end.
                if float(packet.dts * read.time_base) >= clip.last_s - _ROUNDED_S and at >= clip.last_s - _ROUNDED_S:
                    break
                base = packet.dts if base is None else base
                packet.pts, packet.dts = packet.pts - base, packet.dts - base
                packet.stream = written
                output.mux(packet)
                times.append(at)
    except (av.FFmpegError, IndexError) as error:
        raise TautError(f"{clip.path}: cannot be read as a video ({error}): copy it again") from error
    shown = np.sort(np.array(times))  # as they are shown; packets come as they are decoded
    inside = (shown >= clip.first_s - _ROUNDED_S) & (shown < clip.last_s - _ROUNDED_S)
    if not inside.any():
        raise TautError(f"{clip.path}: holds no frames from {clip.first_s:.6g} to {clip.last_s:.6g} s")
    result: Array = np.where(inside, shown - clip.first_s, np.nan)
    return result


def _size(av: Any, picture: Picture, what: str) -> tuple[int, int]:
    """Width and height, px, of a picture. A picture in mjpeg or png does not state them and is decoded for it. av: the
    module PyAV; what: names the picture in the TautError that is raised where it cannot be decoded."""
    if picture.width:
        return picture.width, picture.height
    try:
        context = av.CodecContext.create(picture.codec, "r")
        frames = context.decode(av.Packet(picture.data))
        frame = frames[0] if frames else next(iter(context.decode(None)))
    except (av.FFmpegError, StopIteration) as error:
        raise TautError(f"{what} cannot be decoded ({error or 'it is cut'}): cut the recording before it") from error
    return frame.width, frame.height


def _add_stream(av: Any, output: Any, picture: Picture, size: tuple[int, int]) -> Any:
    """Adds a video stream to PyAV's file `output`, for pictures like this one of `size` (width, height), and returns
    it: in the picture's own codec, so that its bytes are copied; for plain pixels in FFV1, which is lossless. av: the
    module PyAV."""
    plain = bool(picture.width)
    stream = output.add_stream("ffv1" if plain else picture.codec, rate=25)  # nominal: packets carry their times
    stream.width, stream.height = size
    stream.time_base = _TICK
    grey = picture.codec.startswith("gray")
    stream.pix_fmt = (
        (picture.codec if grey else "bgr0") if plain else ("yuvj420p" if picture.codec == "mjpeg" else "rgb24")
    )
    return stream


def _encode_packets(av: Any, stream: Any, picture: Picture, size: tuple[int, int]) -> list[Any]:
    """PyAV's packets of the stream for a picture of `size` (width, height): the bytes of an encoded picture as they
    are, plain pixels encoded."""
    if not picture.width:
        return [av.Packet(picture.data)]
    channels = {"gray": 1, "gray16le": 1, "rgba": 4, "bgra": 4}.get(picture.codec, 3)
    pixels = np.frombuffer(picture.data, np.uint16 if picture.codec == "gray16le" else np.uint8)
    shape = (size[1], size[0]) if channels == 1 else (size[1], size[0], channels)
    frame = av.VideoFrame.from_ndarray(pixels.reshape(shape), format=picture.codec)
    return list(stream.encode(frame.reformat(format=stream.pix_fmt)))
