"""taut predict MODEL RECORDING --csv OUT.csv"""

from __future__ import annotations

from pathlib import Path

import click

from tautline.cli._common import emit, json_option, warn, warn_unusable
from tautline.model import Model
from tautline.prediction import TRUTH_FILE, off_the_truth, predict, times_of, write_csv
from tautline.recording import load_motor


@click.command("predict")
@click.argument("model_path", metavar="MODEL", type=click.Path(path_type=Path))
@click.argument("recording_path", metavar="RECORDING", type=click.Path(path_type=Path))
@click.option("--csv", "csv_path", type=click.Path(path_type=Path), required=True, help="Written: t_s,c_deg,u_px,v_px.")
@click.option("--times", "times_path", type=click.Path(path_type=Path), help="Predict at this file's column t_s.")
@click.option("--start-deg", type=float, help="Where the tip starts; default: on the centre line, f_remain(q[0]).")
@json_option
def command(
    model_path: Path,
    recording_path: Path,
    csv_path: Path,
    times_path: Path | None,
    start_deg: float | None,
    as_json: bool,
) -> None:
    """What a model says the tip does under a recorded motor motion.

    Only motor.csv is needed. One row per row of marker.csv, else of angle.csv, else of a video's frames.csv, else one
    per frame period. These are arrival times: c, u and v are those of t_s minus the delay of the camera or the sensor.
    Where truth.csv lies beside motor.csv, it is said how far off the bending angle is.
    """
    model = Model.load(model_path)
    warn_unusable(model, model_path)
    warnings: list[str] = []
    motor = load_motor(recording_path, model.rig, warnings)
    times = times_of(model, recording_path, motor, times_path, warnings)
    for warning in warnings:
        warn(warning)
    prediction = predict(model, motor, times.scene_s, start_deg)
    write_csv(csv_path, times, prediction)
    off_deg = off_the_truth(model, recording_path, motor, times, prediction)
    score = "" if off_deg is None else f", {off_deg:.2g} deg rms off {TRUTH_FILE}"
    emit(
        {"csv": csv_path, "rows": len(times.cells), "delay_s": times.delay_s, "off_truth_deg": off_deg},
        as_json,
        f"{csv_path}: {len(times.cells)} rows{score}",
    )
