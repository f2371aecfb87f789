"""An MCAP of JSON messages with their schemas, and a layout for Foxglove beside it."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tautline.errors import TautError
from tautline.folders import whole_file, write_file
from tautline.io.exporting.log import Curve, Log, Series
from tautline.plain import plain

LAYOUT_SUFFIX = ".layout.json"
CAMERA = "/camera"
_NS = 1_000_000_000  # format: in a second
_LATEST_S = 2**63 / _NS  # format: that 64 bits of nanoseconds hold
# Foxglove's own schema of a picture: its Image panel shows no other.
_IMAGE = {
    "type": "object",
    "properties": {
        "timestamp": {
            "type": "object",
            "title": "time",
            "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
        },
        "frame_id": {"type": "string"},
        "data": {"type": "string", "contentEncoding": "base64"},
        "format": {"type": "string"},
    },
}


def write(log: Log, out: Path, progress: Callable[[float, str], None]) -> list[Path]:
    """Writes a log as the MCAP file `out`, and a layout for Foxglove beside it; returns both paths. Messages have the
    log's own times; if the first one is negative, all are shifted so that it becomes 0. A curve is one message at the
    first time. progress: gets the share done, 0 to 1, and a word. TautError for times that MCAP cannot hold."""
    from mcap.writer import Writer

    first = min((float(series.t_s[0]) for series in log.series if len(series.t_s)), default=0.0)
    shift_s = max(0.0, -min(first, log.first_frame_s))
    last = log.last_s(default=0.0)
    if last + shift_s >= _LATEST_S:
        raise TautError(f"{log.facts['name']}: its times end at {last:.4g} s: MCAP counts nanoseconds in 64 bits")
    with whole_file(out) as file, file.open("wb") as stream:
        writer = Writer(stream)
        writer.start(library="tautline")
        for series in log.series:
            _write_series(writer, series, shift_s)
            progress(0.3, series.name)
        for curve in log.curves:
            _write_curve(writer, curve, max(0.0, first + shift_s))
        if log.video is not None:
            span = max(last - first, 1e-9)
            for t_s in _write_frames(writer, log, shift_s):
                progress(0.3 + 0.7 * min(max((t_s - first) / span, 0.0), 1.0), "frames")
        writer.add_metadata("tautline", {"facts": json.dumps(plain(log.facts)), "shift_s": repr(shift_s)})
        writer.finish()  # type: ignore[no-untyped-call]
    layout = out.with_name(out.stem + LAYOUT_SUFFIX)
    write_file(layout, json.dumps(foxglove_layout(log), indent=1) + "\n")
    return [out, layout]


def _write_frames(writer: Any, log: Log, shift_s: float) -> Iterator[float]:
    """Writes the frames of a log's video with an mcap Writer, as messages of the topic CAMERA, shift_s later than in
    the log. Yields the time in the log, s, of each frame that was written."""
    schema = writer.register_schema("foxglove.CompressedImage", "jsonschema", json.dumps(_IMAGE).encode())
    channel = writer.register_channel(CAMERA, "json", schema)
    for t_s, jpeg in log.frames():
        when = _nanoseconds(t_s + shift_s)
        message = {
            "timestamp": {"sec": when // _NS, "nsec": when % _NS},
            "frame_id": "camera",
            "data": base64.b64encode(jpeg).decode("ascii"),
            "format": "jpeg",
        }
        writer.add_message(channel, when, json.dumps(message).encode(), when)
        yield t_s


def _nanoseconds(t_s: float) -> int:
    """A time in s as MCAP has it, ns."""
    return round(t_s * _NS)


def _write_series(writer: Any, series: Series, shift_s: float) -> None:
    """Writes a series into an MCAP (with mcap's Writer) as a channel of its own: a message for each row, null where a
    column has nothing. shift_s is added to its times."""
    names = list(series.columns)
    number = {"type": ["number", "null"]}
    schema = {"type": "object", "description": series.says, "properties": dict.fromkeys(names, number)}
    channel = _register_channel(writer, series.name, schema)
    rows = np.column_stack([series.columns[name] for name in names])
    complete = np.isfinite(rows.sum(axis=1))
    for t_s, row, whole_row in zip(series.t_s.tolist(), rows.tolist(), complete.tolist(), strict=True):
        when = _nanoseconds(t_s + shift_s)
        message = dict(zip(names, row, strict=True))
        writer.add_message(channel, when, json.dumps(message if whole_row else plain(message)).encode(), when)


def _write_curve(writer: Any, curve: Curve, t_s: float) -> None:
    """Writes a curve into an MCAP (with mcap's Writer) as a channel with one message, at the time t_s, that holds whole
    columns."""
    numbers = {"type": "array", "items": {"type": ["number", "null"]}}
    schema = {
        "type": "object",
        "description": curve.says,
        "properties": dict.fromkeys(curve.columns, numbers),
    }
    channel = _register_channel(writer, curve.name, schema)
    message = json.dumps(plain(curve.columns), allow_nan=False)
    writer.add_message(channel, _nanoseconds(t_s), message.encode(), _nanoseconds(t_s))


def _register_channel(writer: Any, name: str, schema: dict[str, Any]) -> int:
    """Registers a channel /NAME of JSON messages with this schema; returns its number."""
    title = "tautline." + name.replace("/", ".")
    number = writer.register_schema(title, "jsonschema", json.dumps({"title": title, **schema}).encode())
    return int(writer.register_channel(f"/{name}", "json", number))


# -- the layout ---------------------------------------------------------------------------------------------------


def foxglove_layout(log: Log) -> dict[str, Any]:
    """A layout for Foxglove, as the JSON object that a user imports there. Its panels: the picture; motor, angle, image
    coordinates and residual over time; B and f_remain over q. Panels that would stay empty are left out."""
    panels: dict[str, dict[str, Any]] = {}
    if log.video is not None:
        panels["Image!camera"] = {"imageMode": {"imageTopic": CAMERA}}
    for key, title, wanted in (
        ("motor", "Motor, and the play's centre", ("q_", "q_cmd_", "p_")),
        ("angle", "Bending angle", ("c_deg",)),
        ("image", "Marker in the image", ("u_px", "v_px")),
    ):
        paths = [path for path in _column_paths(log, wanted) if not path.startswith("/residual/")]
        panels |= _plot_panel(key, title, paths)
    left = [path for path in _column_paths(log, ("u_px", "v_px", "c_deg")) if path.startswith("/residual/")]
    panels |= _plot_panel("residual", "What is left, by stage", left)
    for key, title, column in (("backlash", "B(q)", "width_"), ("f_remain", "f_remain(q)", "c_deg")):
        curves = [curve for curve in log.curves if curve.name.startswith(key)]
        paths = [f"/{c.name}.{name}[:]" for c in curves for name in c.columns if name.startswith(column)]
        if paths:
            x = next(iter(curves[0].columns))
            panels |= _plot_panel(
                key, title, paths, {"xAxisVal": "currentCustom", "xAxisPath": f"/{curves[0].name}.{x}[:]"}
            )
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _tiled_layout(list(panels), "row"),
    }


def _column_paths(log: Log, wanted: tuple[str, ...]) -> list[str]:
    """Foxglove's paths, /SERIES.COLUMN, of all series' columns whose names begin with one of `wanted`."""
    return [f"/{s.name}.{name}" for s in log.series for name in s.columns if name.startswith(wanted)]


def _plot_panel(
    key: str, title: str, paths: list[str], more: dict[str, Any] | None = None
) -> dict[str, dict[str, Any]]:
    """The configuration of a plot panel, by its id Plot!KEY, that draws these paths over time; {} without paths. more:
    further settings."""
    if not paths:
        return {}
    lines = [{"value": path, "enabled": True, "timestampMethod": "receiveTime", "label": path[1:]} for path in paths]
    return {
        f"Plot!{key}": {
            "title": title,
            "paths": lines,
            "showLegend": True,
            "isSynced": True,
            "xAxisVal": "timestamp",
            **(more or {}),
        }
    }


def _tiled_layout(panels: list[str], direction: str) -> Any:
    """Foxglove's layout tree of panels, given by their ids: they are halved again and again, as a row and a column in
    turn. direction: of the first split, row or column. "" without panels."""
    if len(panels) <= 1:
        return panels[0] if panels else ""
    half = (len(panels) + 1) // 2
    other = "column" if direction == "row" else "row"
    first, second = _tiled_layout(panels[:half], other), _tiled_layout(panels[half:], other)
    return {"direction": direction, "first": first, "second": second}
