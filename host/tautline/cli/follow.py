"""taut follow"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np

from tautline.cli._common import (
    NumberRange,
    compensation_option,
    emit,
    force_option,
    json_option,
    log,
    progress_bar,
    refuse_unusable,
    rig_option,
    warn,
    warn_tracked_alone,
)
from tautline.cli._live import (
    RECALLS,
    LiveOptions,
    bus_text,
    live_options,
    opened_setup,
    recall_shape,
    seed_option,
    shape_text,
    shapes_option,
    tracking_text,
)
from tautline.cli._outputs import folder_option


@click.command("follow")
@click.argument("model_path", metavar="[MODEL]", required=False, type=click.Path(path_type=Path))
@live_options
@rig_option
@compensation_option
@click.option("--strength", type=NumberRange(0.0, 1.0), default=1.0, help="Share of the lost motion that is taken up.")
@click.option(
    "--trajectory",
    metavar="FILE|SHAPE",
    default="trapezoids",
    show_default=True,
    help="A CSV with columns t_s,c_deg, or a shape: trapezoids, smooth.",
)
@click.option("--speed", type=NumberRange(min=0.1), default=15.0, show_default=True, help="deg/s of a shape.")
@seed_option
@click.option(
    "--track/--no-track",
    "track",
    default=None,
    help="Keep MODEL calibrated by the camera meanwhile, and move the board's tables with it. Default: where MODEL and "
    "--camera are named.",
)
@shapes_option(RECALLS)
@folder_option("--out", "Folder for the recording of the run.", required=False)
@force_option
@json_option
def command(
    model_path: Path | None,
    live: LiveOptions,
    rig_path: Path | None,
    compensation: str,
    strength: float,
    trajectory: str,
    speed: float,
    seed: int,
    track: bool | None,
    library_path: Path | None,
    out: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    """Follow a trajectory of the tip's bending angle with a board, open loop, and say how far off the tip was.

    With MODEL, its tables are loaded first (and its rig is used); without, those in the board are used as they are.
    With MODEL and a camera the model is kept calibrated while it runs: offset and width of the tables follow what is
    learnt, as far as the tables allow, and are the calibrated ones again after the run. With --shapes a library's model
    is used, and another shape that the shaft takes is named.
    """
    from tautline.live.following import follow_run
    from tautline.model import Model
    from tautline.shapes import Library

    model = Model.load(model_path) if model_path is not None else None
    library = None if library_path is None else Library.load(library_path)
    if track is None:
        track = library is not None or (model is not None and live.camera is not None)
    if library is not None and (not track or (live.camera is None and live.simulate is None)):
        raise click.UsageError("a shape is told by what the camera sees: name --camera, and leave --no-track out")
    if model is None and library is None and live.simulate is not None and compensation != "off":
        raise click.UsageError("a simulated board starts without tables: name MODEL, or --compensation off")
    model_of_rig = model if model is not None or library is None else library.first()
    with opened_setup(live, rig_path, seed, model=model_of_rig) as setup:
        if model is None and library is not None:
            model, model_path = recall_shape(setup, library)
        if model is not None and model_path is not None:
            refuse_unusable(model, model_path, force)
            if track:
                warn_tracked_alone(model)
        with progress_bar("follow") as progress:
            result = follow_run(
                setup,
                trajectory,
                compensation=compensation,
                model=model,
                strength=strength,
                speed_deg_s=speed,
                seed=seed,
                folder=out,
                track=track,
                library=library,
                progress=progress,
            )
    if model is not None and model_path is not None and len(result.error_deg):
        _add_to_report(model, model_path, result, compensation)
    emit(_report(result, compensation, out), as_json, _text(result, compensation, out, library))
    _warn_of_run(result, trajectory)


def _warn_of_run(result: Any, trajectory: str) -> None:
    """Prints warnings after a run: where a part of the trajectory was beyond the tip's reach, and where the tables
    could not be moved far enough; and how many telemetry samples were dropped, if any. result: a
    live.following.Followed; trajectory: its name for the text."""
    if result.clipped:
        low, high = result.reach_deg
        warn(
            f"{trajectory}: {100 * max(result.clipped, 0.01):.0f} % of it is beyond what the tip can reach with these "
            f"tables, {low:.1f} to {high:.1f} deg: it was held at the end there (clipped)"
        )
    if result.tracking is not None and result.tracking["beyond"]:
        warn(result.tracking["beyond"])
    if result.counters["telemetry_dropped"]:
        log(f"taut: {result.counters['telemetry_dropped']} telemetry samples were dropped")


def _add_to_report(model: Any, folder: Path, result: Any, compensation: str) -> None:
    """Saves the run `result` (a live.following.Followed) in the model's folder, and writes the model's report again
    with it. compensation: that of the run, which replaces an earlier run with the same."""
    from tautline.reports import pages
    from tautline.reports.evidence import Evidence, Run

    run = Run(result.t_s, goal_deg=result.c_ref_deg, tip_deg=result.c_deg, counted=result.counted)
    run.save(folder, compensation)
    pages.write(model, folder, Evidence.load(folder))


def _report(result: Any, compensation: str, out: Path | None) -> dict[str, Any]:
    """The command's result for --json from a run, a live.following.Followed. out: folder of its recording, or None."""
    return {
        "compensation": compensation,
        "seconds": _seconds(result),
        "error_rms_deg": result.rms_deg,
        "error_max_deg": result.max_deg,
        "scored_by": result.scored_by,
        "clipped": result.clipped,
        "reach_deg": list(result.reach_deg),
        "recording": out,
        "counters": result.counters,
        "bus": result.bus,
        "tracking": result.tracking,
    }


def _seconds(result: Any) -> float:
    """The time, s, from the first to the last sample of a run; 0 where it has no samples."""
    return float(np.ptp(result.t_s)) if len(result.t_s) else 0.0


def _text(result: Any, compensation: str, out: Path | None, library: Any) -> str:
    """The command's text for a person from a run, a live.following.Followed. out: folder of its recording, or None;
    library: of shapes, or None."""
    text = f"followed {_seconds(result):.1f} s, compensation {compensation}"
    if len(result.error_deg):
        text += f": tip off by {result.rms_deg:.3f} deg rms, {result.max_deg:.3f} at most (by {result.scored_by})"
    elif result.scored_by:
        text += " (nothing is scored: the tip was not seen on its way, or its backlash not taken up both ways)"
    else:
        text += " (no camera: how far off the tip was is not known)"
    text += bus_text(result.bus)
    if result.tracking is not None:
        text += f"; {tracking_text(result.tracking)}{shape_text(result.tracking, library)}"
    return text + (f"; recorded in {out}" if out else "")
