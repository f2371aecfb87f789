"""taut calibrate RECORDING... --rig rig.toml --out MODEL"""

from __future__ import annotations

from itertools import chain, count
from pathlib import Path
from typing import Any, Literal

import click

from tautline import report
from tautline.calibration.calibrate import Calibration, Options, calibrate
from tautline.cli._common import (
    emit,
    folder_option,
    json_option,
    log,
    progress_bar,
    read_recordings,
    rig_option,
    show_quality,
    tracked,
)
from tautline.cli._live import LiveOptions, live_options, opened
from tautline.errors import UnusableError
from tautline.folders import check_replaceable
from tautline.model import MODEL_FILE
from tautline.recording import load, shifted


@click.command("calibrate")
@click.argument("recording_paths", metavar="[RECORDING...]", nargs=-1, type=click.Path(path_type=Path))
@rig_option
@folder_option("--out", "The MODEL folder to write: model.json, rig.toml, report.html.")
@click.option(
    "--knots",
    type=click.Choice(["smooth", "paper"]),
    default="smooth",
    show_default=True,
    help="B(q): a spline smoothed as the data ask for, or the paper's 14 knots.",
)
@click.option(
    "--remaining",
    type=click.Choice(["direct", "morphological"]),
    default="direct",
    show_default=True,
    help="f_remain: fitted directly, or the paper's central fibre of the characteristic as an image.",
)
@live_options
@click.option(
    "--speed",
    "speeds",
    type=click.FloatRange(min=0.0, min_open=True),
    multiple=True,
    help="Live: of a pass, the rig's unit per second; up to four times.",
)
@click.option("--recording", "kept", type=click.Path(path_type=Path), help="Live: kept here. Default: OUT-recording.")
@click.option("--video", is_flag=True, help="Live: keep the frames too.")
@click.option("--seed", type=int, default=0, help="Of a simulation.")
@json_option
def command(
    recording_paths: tuple[Path, ...],
    rig_path: Path | None,
    out: Path,
    knots: Literal["smooth", "paper"],
    remaining: Literal["direct", "morphological"],
    as_json: bool,
    kept: Path | None,
    **live: Any,
) -> None:
    """Measure B(q) and f_remain: from recordings of one instrument, or live from a board and a camera.

    Live (--camera with a board, or --simulate), the board runs the calibration motion; Ctrl-C brings the axis to rest.
    """
    check_replaceable(out, MODEL_FILE)
    options = Options(knots=knots, remaining=remaining)
    if recording_paths:
        found, said = _from_recordings(recording_paths, rig_path, out, options)
    else:
        if live["live"].camera is None and live["live"].simulate is None:
            raise click.UsageError("name a RECORDING, or for a live calibration --camera SOURCE or --simulate")
        kept = kept or _free(out.absolute())
        found, said = _live(kept, rig_path, out, options, **live)
    quality = found.model.quality
    show_quality(quality)
    for note in found.notes:
        log(f"taut: {note}")
    result = {**found.to_json(), "model": out, "report": out / report.FILE}
    if not recording_paths:
        result["recording"] = kept
    emit(result, as_json, "\n".join([*said, f"{out / report.FILE} shows it."]))
    if not quality.usable:
        raise UnusableError(f"{out}: written, but unusable: {quality.reasons[0]}")


def _free(out: Path) -> Path:
    """OUT-recording, or with the next number that no folder has."""
    names = (f"{out.name}-recording{number}" for number in chain([""], (f"-{i}" for i in count(2))))
    return next(path for name in names if not (path := out.with_name(name)).exists())


def _from_recordings(
    paths: tuple[Path, ...], rig_path: Path | None, out: Path, options: Options
) -> tuple[Calibration, list[str]]:
    recordings, rig = read_recordings(paths, rig_path)
    with progress_bar("calibrating") as progress:
        recordings = [tracked(recording, rig, progress) for recording in recordings]
        found = calibrate(recordings, rig, options, progress)
        return found, report.save_model(found.model, shifted(recordings, found.offsets), out)


def _live(
    kept: Path,
    rig_path: Path | None,
    out: Path,
    options: Options,
    *,
    live: LiveOptions,
    speeds: tuple[float, ...],
    video: bool,
    seed: int,
) -> tuple[Calibration, list[str]]:
    from tautline.live.session import MotionOptions, calibrate_live

    if len(speeds) > 4:
        raise click.UsageError("--speed may be given up to four times")
    motion = MotionOptions(speeds=speeds or None)
    with (
        opened(live, rig_path, seed) as setup,
        progress_bar("calibrating") as progress,
    ):
        found, made = calibrate_live(setup, kept, motion, options, video, progress)
    log(f"taut: {made.reversals} reversals in {made.seconds:.0f} s, recorded in {kept}")
    recordings = shifted([load(kept, found.model.rig)], found.offsets)
    return found, report.save_model(found.model, recordings, out)
