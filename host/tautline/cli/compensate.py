"""taut compensate MODEL --trajectory C.csv --csv OUT.csv"""

from __future__ import annotations

from pathlib import Path

import click

from tautline.cli._common import Number, compensation_option, emit, json_option, progress_bar, warn, warn_unusable
from tautline.cli._outputs import Output, check_no_input
from tautline.compensation import RATES_HZ, compensate, read_trajectory, write_csv
from tautline.model import Model
from tautline.undone import in_words, not_undone


@click.command("compensate")
@click.argument("model_path", metavar="MODEL", type=click.Path(path_type=Path))
@click.option(
    "--trajectory",
    "trajectory_path",
    type=click.Path(path_type=Path),
    required=True,
    help="A CSV with columns t_s,c_deg: the bending angle wanted, straight between its rows.",
)
@click.option("--csv", "csv_path", type=Output(file=True), required=True, help="Written: t_s,q_mm (or q_deg),clipped.")
@click.option(
    "--rate",
    "rate_hz",
    type=click.IntRange(int(RATES_HZ[0]), int(RATES_HZ[1])),
    default=1000,
    show_default=True,
    help="Set-points per second.",
)
@compensation_option
@click.option("--start-deg", type=Number(), help="Where the tip starts, on the centre line; default: the first c_deg.")
@json_option
def command(
    model_path: Path,
    trajectory_path: Path,
    csv_path: Path,
    rate_hz: int,
    compensation: str,
    start_deg: float | None,
    as_json: bool,
) -> None:
    """Motor set-points that lead the tip along a trajectory, for any motor: the board's own code, run here.

    Each set-point knows the trajectory up to its own time only. clipped is 1 where the command was beyond the table's
    range or faster than the motor may be (actuator.speed_max in the rig; without it there is no limit).
    """
    check_no_input(csv_path, model_path, trajectory_path)
    model = Model.load(model_path)
    warn_unusable(model, model_path)
    if remains := not_undone(model):  # a trajectory says nothing of other axes
        warn(f"{model_path}: no table can undo {in_words(remains)}: these are not undone")
    warnings: list[str] = []
    t_s, c_deg = read_trajectory(trajectory_path, warnings)
    for warning in warnings:
        warn(warning)
    with progress_bar("compensating") as progress:
        points = compensate(model, t_s, c_deg, rate_hz, compensation, start_deg, progress)
    actuator = model.rig.actuator
    write_csv(csv_path, actuator.unit, points, actuator.encoder_resolution)
    clipped = int(points.clipped.sum())
    if clipped:
        warn(f"{clipped} of {len(points.q)} set-points were clipped: beyond the table, the range or the speed")
    emit(
        {"csv": csv_path, "rows": len(points.q), "clipped": clipped, "mode": compensation, "rate_hz": rate_hz},
        as_json,
        f"{csv_path}: {len(points.q)} set-points, {clipped} clipped",
    )
