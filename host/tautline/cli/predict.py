"""taut predict MODEL RECORDING --csv OUT.csv"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from tautline.cli._common import Number, emit, json_option, warn, warn_unusable
from tautline.cli._outputs import Output, check_no_input
from tautline.errors import TautError
from tautline.model import Model
from tautline.prediction import (
    COLUMNS,
    TRUTH_FILE,
    predict_with_sigma,
    rms_to_truth,
    score,
    times_of,
    write_csv,
)
from tautline.recording import load, load_motor
from tautline.vision.marker import with_marker


@click.command("predict")
@click.argument("model_path", metavar="MODEL", type=click.Path(path_type=Path))
@click.argument("recording_path", metavar="RECORDING", type=click.Path(path_type=Path))
@click.option("--csv", "csv_path", type=Output(file=True), required=True, help=f"Written: {COLUMNS}.")
@click.option("--times", "times_path", type=click.Path(path_type=Path), help="Predict at this file's column t_s.")
@click.option("--start-deg", type=Number(), help="Where the tip starts; default: on the centre line, f_remain(q[0]).")
@click.option("--score", "scores", is_flag=True, help="Say as well how far off what the recording's sensor saw is.")
@json_option
def command(
    model_path: Path,
    recording_path: Path,
    csv_path: Path,
    times_path: Path | None,
    start_deg: float | None,
    scores: bool,
    as_json: bool,
) -> None:
    """What a model says the tip does under a recorded motor motion.

    Only motor.csv is needed. One row per row of marker.csv, else of angle.csv, else of a video's frames.csv, else one
    per frame period. These are arrival times: c, u and v are those of t_s minus the delay of the camera or the sensor.
    The sigmas are one standard deviation of what the sensor would show, its noise included; with --score they are held
    against what it did show. Where truth.csv lies beside motor.csv, it is said how far off the bending angle is.
    """
    check_no_input(csv_path, model_path, recording_path, times_path)
    model = Model.load(model_path)
    warn_unusable(model, model_path)
    warnings: list[str] = []
    motor = load_motor(recording_path, model.rig, warnings)
    times = times_of(model, recording_path, motor, times_path, warnings)
    for warning in warnings:
        warn(warning)
    prediction = predict_with_sigma(model, motor, times.scene_s, start_deg)
    write_csv(csv_path, times, prediction)
    off_deg = None
    try:
        off_deg = rms_to_truth(model, recording_path, motor, times, prediction)
    except TautError as error:  # somebody else's file of that name
        warn(f"{error}: the prediction is not held against it")
    result: dict[str, Any] = {"csv": csv_path, "rows": len(times.cells), "delay_s": times.delay_s}
    result["off_truth_deg"] = off_deg
    text = f"{csv_path}: {len(times.cells)} rows" + (
        "" if off_deg is None else f", {off_deg:.2g} deg rms off {TRUTH_FILE}"
    )
    if scores:
        found = score(model, with_marker(load(recording_path, model.rig), model.rig), start_deg)
        result["score"] = asdict(found)
        text += (
            f", {found.rms:.3g} {found.unit} (rms) off what was seen: {found.over_sigma:.2f} of the stated sigma, "
            f"{100 * found.within_90:.0f} % within what 90 % should be"
        )
    emit(result, as_json, text)
