"""taut calibrate RECORDING... --rig rig.toml --out MODEL"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import click

from tautline import report
from tautline.calibrate import Options, calibrate
from tautline.cli._common import (
    Progress,
    emit,
    folder_option,
    json_option,
    log,
    progress_bar,
    read_recordings,
    rig_option,
    warn,
)
from tautline.folders import check_replaceable
from tautline.marker import track_video
from tautline.model import MODEL_FILE
from tautline.recording import Recording
from tautline.rig import Rig


@click.command("calibrate")
@click.argument("recording_paths", metavar="RECORDING...", nargs=-1, required=True, type=click.Path(path_type=Path))
@rig_option
@folder_option("--out", "The MODEL folder to write: model.json, rig.toml, report.html.")
@click.option(
    "--knots",
    type=click.Choice(["smooth", "paper"]),
    default="smooth",
    help="B(q): a spline smoothed as the data ask for, or the paper's 14 knots.",
)
@click.option(
    "--remaining",
    type=click.Choice(["direct", "morphological"]),
    default="direct",
    help="f_remain: fitted directly, or the paper's central fibre of the characteristic as an image.",
)
@json_option
def command(
    recording_paths: tuple[Path, ...],
    rig_path: Path | None,
    out: Path,
    knots: Literal["smooth", "paper"],
    remaining: Literal["direct", "morphological"],
    as_json: bool,
) -> None:
    """Measure B(q) and f_remain from recordings of one instrument."""
    check_replaceable(out, MODEL_FILE)
    recordings, rig = read_recordings(recording_paths, rig_path)
    with progress_bar("calibrating") as progress:
        recordings = [_tracked(recording, rig, progress) for recording in recordings]
        found = calibrate(recordings, rig, Options(knots=knots, remaining=remaining), progress)
        said = report.save_model(found.model, recordings, out)
    for warning in found.warnings:
        warn(warning)
    for note in found.notes:
        log(f"taut: {note}")
    emit(
        {**found.to_json(), "model": out, "report": out / report.FILE},
        as_json,
        "\n".join([*said, f"{out / report.FILE} shows it."]),
    )


def _tracked(recording: Recording, rig: Rig, progress: Progress) -> Recording:
    """With the marker's track, from the video where there is no marker.csv."""
    if recording.marker is not None or recording.video is None or not rig.has_camera:
        return recording
    return replace(recording, marker=track_video(recording.video, progress=progress))
