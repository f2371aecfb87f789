"""taut track MODEL RECORDING... --csv OUT.csv"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tautline.cli._common import STATE_COLOURS, emit, json_option, log, progress_bar, read_recordings, warn_unusable
from tautline.cli._outputs import Output, check_no_input
from tautline.model import Model
from tautline.rig import MARKER, RIG_FILE
from tautline.vision.marker import with_marker

if TYPE_CHECKING:
    from tautline.tracking import Tracked

_MOST_CHANGES = 12  # format: most changes of state that are printed one by one


@click.command("track")
@click.argument("model_path", metavar="MODEL", type=click.Path(path_type=Path))
@click.argument("recording_paths", metavar="RECORDING...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--csv",
    "csv_path",
    type=Output(file=True),
    required=True,
    help="Written: a row for each frame, or reading of an angle sensor.",
)
@click.option(
    "--picture",
    "picture_path",
    type=Output(file=True),
    help="Written too: state, offset and scale over time, by its ending as PNG, SVG or PDF.",
)
@json_option
def command(
    model_path: Path,
    recording_paths: tuple[Path, ...],
    csv_path: Path,
    picture_path: Path | None,
    as_json: bool,
) -> None:
    """How a model would have been kept calibrated while the instrument was used.

    The recordings follow each other in the order given. Each row is predicted from the motor up to then and the frames
    before, with the offset and the scale of B that were known by then; state is trusted, stale or adapting.
    """
    from tautline.tracking import replay, write_csv

    for out in (csv_path, picture_path):
        check_no_input(out, model_path, *recording_paths)
    if picture_path is not None:
        from tautline.reports import figures

        figures.check_ending(picture_path)
    model = Model.load(model_path)
    warn_unusable(model, model_path)
    recordings, _ = read_recordings(recording_paths, model_path / RIG_FILE, repeated=True)
    with progress_bar("tracking") as progress:
        recordings = [with_marker(recording, model.rig, progress) for recording in recordings]
        result = replay(model, recordings, progress)
    write_csv(csv_path, result)
    if picture_path is not None:
        from tautline.tracking.picture import draw

        figures.save(draw(result, recordings, model.rig.actuator.unit), picture_path)
    changes = [{"recording": c.recording, "t_s": c.t_s, "state": c.state, "says": c.says} for c in result.changes]
    summary = _summary(result, recordings)
    if not as_json:
        _log_result(result, summary)
    emit(
        {"csv": csv_path, "rows": len(result.rows), "changes": changes, "recordings": summary},
        as_json,
        f"{csv_path}: {len(result.rows)} rows" + (f"; {picture_path}" if picture_path else ""),
    )


def _summary(result: Tracked, recordings: list[Any]) -> list[dict[str, Any]]:
    """An entry for each recording, for the command's result: its name and number of rows; the rms of the residual, px
    per coordinate or deg, None where nothing was seen; offset (unit of q) and scale of B with their sigmas at its end;
    and the number of frames in each state. Each recording must have a row."""
    from tautline.tracking import residuals

    off = residuals(result, recordings)
    table = []
    for i, recording in enumerate(recordings):
        mine = (result.recording == i).nonzero()[0]
        states = [result.rows[k].state.value for k in mine]
        last = result.rows[int(mine[-1])]
        table.append(
            {
                "name": recording.name,
                "rows": len(mine),
                "rms": off[i],
                "offset": last.offset,
                "offset_sigma": last.offset_sigma,
                "scale": last.scale,
                "scale_sigma": last.scale_sigma,
                "frames": {state: states.count(state) for state in STATE_COLOURS},
            }
        )
    return table


def _log_result(result: Tracked, summary: list[dict[str, Any]]) -> None:
    """Prints on stderr the first _MOST_CHANGES changes of state, and a line for each recording. summary: the entries
    that `_summary` returned."""
    unit, shown = ("px", "frames") if result.sensor == MARKER else ("deg", "readings")
    for change in result.changes[:_MOST_CHANGES]:
        state = click.style(change.state.value, fg=STATE_COLOURS[change.state.value], bold=True)
        log(f"taut: {summary[change.recording]['name']}, {change.t_s:.2f} s: {state}, {change.says}")
    if len(result.changes) > _MOST_CHANGES:
        log(f"taut: and {len(result.changes) - _MOST_CHANGES} changes more (--json lists them)")
    for row in summary:
        rows, off = f"{row['rows']} {shown}", row["rms"]
        if off is None:
            log(f"taut: {row['name']}: the tip is seen in none of its {rows}, which says nothing of the model")
            continue
        share = 100.0 * row["frames"]["trusted"] / row["rows"]
        log(
            f"taut: {row['name']}: off by {off:.3g} {unit} rms, trusted {share:.0f} % of {rows}; at its end offset "
            f"{row['offset']:+.4g} ± {row['offset_sigma']:.2g}, scale {row['scale']:.4g} ± {row['scale_sigma']:.2g}"
        )
