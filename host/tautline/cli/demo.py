"""taut demo"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tautline.cli._common import SEED, emit, json_option, log, progress_bar
from tautline.cli._outputs import folder_option
from tautline.simulated.instrument import PRESETS

if TYPE_CHECKING:
    from tautline.live.following import Followed


@click.command("demo")
@folder_option("--out", "Folder for the recording, the model and the report.  [default: tautline-demo]", required=False)
@click.option("--instrument", type=click.Choice(PRESETS), default="reference", show_default=True)
@click.option("--seed", type=SEED, default=0, help="Of the instrument 'random', the background and the noise.")
@json_option
def command(out: Path | None, instrument: str, seed: int, as_json: bool) -> None:
    """The whole job without hardware: calibrate a simulated instrument through its endoscope, flash its tables into a
    desktop board, follow a trajectory with and without them."""
    out = out or Path("tautline-demo")
    with progress_bar("demo") as progress:
        result = run(out, instrument, seed, progress, log)
    emit(result, as_json, _text(result))


def run(
    out: Path, instrument: str, seed: int, progress: Callable[[float, str], None], say: Callable[[str], None]
) -> dict[str, Any]:
    """Calibrates a simulated instrument (`instrument`: a preset's name), flashes its tables into a simulated desktop
    board, and follows a trajectory without and with them. Writes out/recording and out/model, which holds the report.
    progress: is called with the share done, 0 to 1, and a word; say: is called with a line for each step's result.
    Returns the result of `taut demo --json`."""
    from tautline import tables
    from tautline.folders import check_replaceable, replaced_folder
    from tautline.layouts import MOTOR
    from tautline.live.following import follow_run
    from tautline.live.setup import open_live
    from tautline.live.until import calibrate_until
    from tautline.model import MODEL_FILE
    from tautline.recording import FILES, load
    from tautline.reports import pages

    model_folder, recording_folder = out / "model", out / "recording"
    check_replaceable(model_folder, MODEL_FILE)

    def part(low: float, high: float) -> Callable[[float, str], None]:
        """The progress function for a step that takes the whole's progress from the share `low` to `high`."""
        return lambda share, what: progress(low + (high - low) * share, what)

    with open_live(simulate=instrument, seed=seed) as live:
        board = live.board
        say(
            f"1  board {board.identity.serial} found over USB/IP: {board.identity.axes} axis, virtual time, "
            f"instrument '{instrument}'"
        )
        with replaced_folder(recording_folder, MOTOR.file, stale=FILES) as fresh:  # of an earlier demo
            calibration, reached = calibrate_until(live, fresh, progress=part(0.0, 0.55))
        model, motion = calibration.model, reached.motion
        say(
            f"2  calibration motion: {len(calibration.onsets)} reversals in {motion.seconds:.0f} s of the board's "
            f"time, marker tracked in {motion.frames - motion.lost_frames} of {motion.frames} frames"
            + (f"; {reached.why}" if reached.why else "")
        )
        sentences = pages.save_model(model, [load(recording_folder, live.rig)], model_folder)
        say(f"3  {model.quality.verdict.value}: {' '.join(sentences)}")
        blob = tables.encode(model, axis=live.axis)
        board.load_table(live.axis, blob, part(0.55, 0.6))
        say(f"4  tables flashed by DFU: {len(blob)} bytes, read back equal")
        runs = {
            compensation: follow_run(
                live, "trapezoids", compensation=compensation, seed=seed, progress=part(begin, begin + 0.2)
            )
            for compensation, begin in (("off", 0.6), ("full", 0.8))
        }
    gain = runs["off"].rms_deg / runs["full"].rms_deg
    say(
        f"5  a trajectory followed open loop: off by {runs['off'].rms_deg:.2f} deg rms without, "
        f"{runs['full'].rms_deg:.3f} with the tables, {gain:.0f} times less"
    )
    return {
        "report": _write_report(model_folder, runs),
        "model": model_folder,
        "recording": recording_folder,
        "reversals": len(calibration.onsets),
        "seconds": motion.seconds,
        "sigma": reached.standing.worst,
        "reached": reached.reached,
        "result": sentences,
        "error_rms_deg": {compensation: followed.rms_deg for compensation, followed in runs.items()},
        "gain": gain,
    }


def _write_report(model_folder: Path, runs: Mapping[str, Followed]) -> Path:
    """Saves the runs, by compensation, in a MODEL folder, writes the model's report again with them, and returns the
    report's path."""
    from tautline.model import Model
    from tautline.reports import pages
    from tautline.reports.evidence import Evidence, Run

    for compensation, followed in runs.items():
        kept = Run(
            followed.t_s, goal_deg=followed.c_ref_deg, tip_deg=followed.c_deg, counted=followed.counted
        )  # fmt: skip
        kept.save(model_folder, compensation)
    return pages.write(Model.load(model_folder), model_folder, Evidence.load(model_folder))


def _text(result: dict[str, Any]) -> str:
    """The result as text for a person: which page to open."""
    return f"\nopen {result['report']}"
