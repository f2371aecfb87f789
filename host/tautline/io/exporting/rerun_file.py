"""A rerun recording (.rrd): each column a curve over time, the marker on the picture, B and f_remain over q."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tautline.folders import whole_file
from tautline.io.exporting.log import Curve, Log, Series

TIME, PLACE = "t_s", "q"
_PLACES = 1e6  # format: steps of the timeline "q" in a unit of q: it counts in whole numbers


def write(log: Log, out: Path, progress: Callable[[float, str], None]) -> list[Path]:
    """Writes a log as the rerun recording `out` and returns [out]. Times are the log's own, as durations; curves are on
    a timeline of their own, q in millionths of its unit. progress: gets the share done, 0 to 1, and a word."""
    import rerun as rr

    with whole_file(out) as file:
        recording = rr.RecordingStream("tautline", recording_id=str(log.facts["name"]))
        recording.save(file)
        for series in log.series:
            _send_series(recording, series, with_places=log.video is not None)
            progress(0.3, series.name)
        for curve in log.curves:
            _send_curve(recording, curve)
        last = log.last_s(default=1.0)
        for t_s, jpeg in log.frames():
            recording.set_time(TIME, duration=t_s)
            recording.log("camera", rr.EncodedImage(contents=jpeg, media_type="image/jpeg"))
            progress(0.3 + 0.7 * min(max(t_s / (last or 1.0), 0.0), 1.0), "frames")
        recording.reset_time()
        recording.log(
            "about", rr.TextDocument("\n".join(f"{key}: {value}" for key, value in log.facts.items())), static=True
        )
        recording.flush()
        recording.disconnect()
    return [out]


def _send_series(recording: Any, series: Series, with_places: bool) -> None:
    """Adds the columns of a series to a rerun.RecordingStream as curves over time, without NaN. with_places: there is a
    video, on which the series' image coordinates, if it has any and is no residual, are drawn as points."""
    import rerun as rr

    for name, values in series.columns.items():
        kept = np.isfinite(values)
        if kept.any():
            when = rr.TimeColumn(TIME, duration=series.t_s[kept])
            recording.send_columns(f"{series.name}/{name}", [when], rr.Scalars.columns(scalars=values[kept]))
    if with_places and {"u_px", "v_px"} <= series.columns.keys() and "residual" not in series.name:
        places = np.column_stack([series.columns["u_px"], series.columns["v_px"]])
        seen = np.isfinite(places.sum(axis=1))
        when = rr.TimeColumn(TIME, duration=series.t_s[seen])
        recording.send_columns(
            f"camera/{series.name}", [when], rr.Points2D.columns(positions=places[seen].astype(np.float32))
        )


def _send_curve(recording: Any, curve: Curve) -> None:
    """Adds the columns of a curve over q to a rerun.RecordingStream, on the timeline PLACE, NaN left out."""
    import rerun as rr

    (_, q), *columns = curve.columns.items()
    for name, values in columns:
        kept = np.isfinite(values)
        if kept.any():
            where = rr.TimeColumn(PLACE, sequence=np.rint(q[kept] * _PLACES).astype(np.int64))
            recording.send_columns(f"{curve.name}/{name}", [where], rr.Scalars.columns(scalars=values[kept]))
