"""./run bench [--json], and one of: videos, faults, importing, bare, rig, drivers, constants"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from typing import Any

import click
from rich.console import Console
from rich.table import Table

from tautline.cli._common import log, plain, progress_bar
from tautline.errors import TautError
from tools.bench import (
    bare,
    calibration,
    control_step,
    diagnosis,
    drivers,
    faults,
    importing,
    live_page,
    rigging,
    trackers,
    tracking,
    videos,
)
from tools.constants import command as constants

Rows = list[tuple[str, float, str]]


@click.group(invoke_without_command=True)
@click.option("--json", "as_json", is_flag=True, help="Print the result as one JSON object on stdout.")
@click.option("--frames", type=click.IntRange(5, 1000), default=40, show_default=True, help="At each of 5 places.")
@click.pass_context
def main(context: click.Context, as_json: bool, frames: int) -> None:
    """Times what matters, side by side with what others use, in one run on this machine."""
    if context.invoked_subcommand is not None:
        return
    with progress_bar("trackers") as progress:
        scores, notes = trackers.run(frames, progress)
    result: dict[str, Any] = {
        "trackers": [
            {
                "name": score.name,
                "frames_per_s": score.frames_per_s,
                "still_noise_px": score.noise_px,
                "error_px": score.error_px,
                "found": score.detected,
                "time_ratio": score.frame_us / scores[0].frame_us,
                "noise_ratio": score.noise_px / scores[0].noise_px,
            }
            for score in scores
        ],
        "notes": notes,
    }
    parts: list[tuple[str, str, Callable[[], Rows]]] = [
        ("control_step", "control step", control_step.run),
        ("calibration", "calibration", calibration.run),
        ("diagnosis", "diagnosis", diagnosis.run),
        ("tracking", "tracking in use", tracking.run),
        ("live_page", "the live page's server", live_page.run),
    ]
    for key, title, part in parts:
        log(f"{title} ...")
        try:
            result[key] = [{"name": name, "value": value, "unit": unit} for name, value, unit in part()]
        except TautError as error:
            result[key] = []
            notes.append(f"{title}: {error}")
    if as_json:
        click.echo(json.dumps(plain(result), allow_nan=False))
        return
    console = Console(width=None if sys.stdout.isatty() else 120)
    table = Table(title="Trackers: a still marker of 20 px in 720 x 576, the same light and noise for all")
    for name in ("", "frames/s", "time, ours = 1", "noise, px", "noise, ours = 1", "error, px", "found"):
        table.add_column(name, justify="left" if not name else "right")
    for row in result["trackers"]:
        table.add_row(
            row["name"],
            f"{row['frames_per_s']:,.0f}",
            f"{row['time_ratio']:.3g}",
            f"{row['still_noise_px']:.4f}",
            f"{row['noise_ratio']:.2f}",
            f"{row['error_px']:.4f}",
            f"{100 * row['found']:.0f} %",
        )
    console.print(table)
    for key, title, _ in parts:
        if result[key]:
            table = Table(title=title.capitalize(), show_header=False)
            for row in result[key]:
                table.add_row(row["name"], f"{row['value']:.4g}", row["unit"])
            console.print(table)
    for note in notes:
        console.print(f"note: {note}", highlight=False)


main.add_command(videos.command)
main.add_command(faults.command)
main.add_command(importing.command)
main.add_command(bare.command)
main.add_command(rigging.command)
main.add_command(drivers.command)
main.add_command(constants.command)

if __name__ == "__main__":
    main()
