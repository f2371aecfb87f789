"""taut live [RECORDING]"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from tautline.cli._common import (
    NumberRange,
    emit,
    json_option,
    log,
    progress_bar,
    read_recordings,
    rig_option,
    warn_tracked_alone,
    warn_unusable,
)
from tautline.cli._live import (
    LiveOptions,
    free_recording,
    free_recordings,
    live_options,
    motion_option,
    opened_setup,
    refuse_live_options,
    seed_option,
    sigma_of,
    speed_option,
    until_option,
)
from tautline.cli._outputs import folder_option
from tautline.diagnosis.folder import DOCUMENT
from tautline.folders import check_replaceable
from tautline.model import MODEL_FILE, Model


@click.command("live")
@click.argument("recording_path", metavar="[RECORDING]", required=False, type=click.Path(path_type=Path))
@live_options
@rig_option
@folder_option(
    "--out", "Live: the MODEL or DIAGNOSIS folder to write; what is recorded is kept beside it.", required=False
)
@until_option
@click.option(
    "--pace",
    type=NumberRange(min=0.0, min_open=True),
    default=1.0,
    show_default=True,
    help="Of a recording: times its own speed.",
)
@click.option(
    "--watch",
    "watched",
    metavar="MODEL",
    type=click.Path(path_type=Path),
    help="Live: as 'taut watch MODEL', whether the model still holds while the instrument is used.",
)
@click.option(
    "--diagnose",
    "diagnosed",
    metavar="CALIBRATION",
    type=click.Path(path_type=Path),
    help="Live: as 'taut diagnose --live CALIBRATION', which effect is the cause, until one answer is sure.",
)
@motion_option("whatever drives it; with --watch alone")
@speed_option
@seed_option
@json_option
def command(
    recording_path: Path | None,
    live: LiveOptions,
    rig_path: Path | None,
    out: Path | None,
    until: str | None,
    pace: float,
    watched: Path | None,
    diagnosed: Path | None,
    motion: str,
    speed: float | None,
    seed: int,
    as_json: bool,
) -> None:
    """Calibrate in a browser on this machine, or watch a recording again: picture, q and c, onsets, B(q) as it grows.

    The page's address is told on stderr; nothing moves before its Start. Ctrl-C stops what runs, and ends the page
    where nothing does. --watch shows whether a model still holds instead, --diagnose which effect is missing in it.
    """
    if recording_path is not None:
        refuse_live_options(
            "out", "until", "watched", "diagnosed", "motion", "speed", "seed",
            because="a RECORDING is played again, choose one of them",
        )  # fmt: skip
        result = _replay(recording_path, rig_path, pace)
    else:
        if live.camera is None and live.simulate is None:
            raise click.UsageError("name a RECORDING to play, or for a live calibration --camera SOURCE or --simulate")
        if watched is not None and diagnosed is not None:
            raise click.UsageError("--watch and --diagnose are two pages: choose one of them")
        if watched is not None:
            result = _watch(live, rig_path, watched, motion, speed, seed)
            emit(result, as_json, result["says"] or "nothing was started")
            return
        if out is None:
            raise click.UsageError("what is found is kept: name a folder for it with --out")
        check_replaceable(out, MODEL_FILE if diagnosed is None else DOCUMENT)
        if diagnosed is not None:
            result = _diagnose(live, rig_path, diagnosed, out, seed)
        else:
            result = _calibrate(live, rig_path, out, until, seed)
    emit(result, as_json, result["says"] or "nothing was started")


def _calibrate(live: LiveOptions, rig_path: Path | None, out: Path, until: str | None, seed: int) -> dict[str, Any]:
    """Serves a page for live calibrations, each of which goes on until the sigma `until` (text such as "3um", None: the
    default) is reached and writes its MODEL to `out`. Returns the command's result: `says`, the last message, "" if
    nothing was started; `model`, the folder, and `quality`, both None if there was no calibration."""
    from tautline.live.page.work import Calibrating
    from tautline.live.until import Goal

    with opened_setup(live, rig_path, seed, picks=True) as setup, setup.interruptible():
        goal = Goal(None if until is None else sigma_of(until, setup.rig.actuator.unit))
        colour_file = live.colour if live.simulate is None else None
        work = Calibrating(setup, out, lambda: free_recording(out.absolute()), goal, colour_file)
        says = _serve_page(work)
    quality = None if work.found is None else work.found.model.quality.to_json()
    return {"says": says, "model": None if work.found is None else out, "quality": quality}


def _watch(
    live: LiveOptions, rig_path: Path | None, path: Path, motion: str, speed: float | None, seed: int
) -> dict[str, Any]:
    """Serves a page on which the model at `path` is kept calibrated while the motor makes `motion` (of --motion) at
    `speed`, the rig's unit per second (None: the default). Returns the command's result: `says`, the last message, and
    the model's path."""
    from tautline.live.page.work import Watching

    model = Model.load(path)
    warn_unusable(model, path)
    warn_tracked_alone(model)
    with opened_setup(live, rig_path, seed, model=model) as setup, setup.interruptible():
        return {"says": _serve_page(Watching(setup, model, motion, speed, seed=seed)), "model": path}


def _diagnose(live: LiveOptions, rig_path: Path | None, path: Path, out: Path, seed: int) -> dict[str, Any]:
    """Calibrates on the recording at `path` and serves a page for a live diagnosis of that instrument, which is written
    to `out`. Returns the command's result: `says`, the last message, and `diagnosis`, the folder, or None if there was
    no diagnosis."""
    from tautline.diagnosis.recorded import calibrated
    from tautline.live.page.work import Diagnosing

    recordings, rig = read_recordings([path], rig_path)
    with progress_bar("calibrating") as progress:
        calibration, recordings, _ = calibrated(recordings, rig, progress)  # no tests, whose clocks might be off
    warn_unusable(calibration.model, path)
    with opened_setup(live, rig_path, seed, model=calibration.model) as setup, setup.interruptible():
        work = Diagnosing(setup, calibration, recordings, out, lambda: free_recordings(out.absolute()))
        says = _serve_page(work)
    found = work.found
    if found is None:
        return {"says": says, "diagnosis": None}
    return {"says": says, "diagnosis": out, "verdict": found.diagnosis.document["verdict"], "sure": found.sure}


def _replay(path: Path, rig_path: Path | None, pace: float) -> dict[str, Any]:
    """Serves a page on which the recording at `path` is played again at `pace` times its own speed. Returns the
    command's result: `says`, the last message, and the recording's path."""
    from tautline.live.page.work import Replaying
    from tautline.vision.marker import with_marker

    recordings, rig = read_recordings([path], rig_path)
    with progress_bar("tracking") as progress:
        recording = with_marker(recordings[0], rig, progress)
    return {"says": _serve_page(Replaying(recording, rig, pace)), "recording": path}


def _serve_page(work: Any) -> str:
    """Serves the page of `work` (a live.page.work.Work) until Ctrl-C, and prints its address and messages. Returns the
    last message, "" if nothing was started."""
    from tautline.live.page.desk import Desk
    from tautline.live.page.server import serving
    from tautline.live.page.work import attend

    last_message = ""

    def say(text: str) -> None:
        """Prints a message on what came of a run, and keeps it as the last one."""
        nonlocal last_message
        last_message = text
        log(f"taut: {text}")

    desk = Desk(work.rig, work.about)
    with serving(desk) as server:
        log(f"taut: {server.address} (on this machine alone; Ctrl-C ends it)")
        attend(desk, work, say)
    return last_message
