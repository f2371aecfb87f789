"""taut diagnose CALIBRATION TEST [TEST ...]"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from tautline import report
from tautline.calibration.calibrate import calibrate
from tautline.calibration.clock import on_motor_clock
from tautline.cli._common import (
    emit,
    folder_option,
    json_option,
    progress_bar,
    read_recordings,
    rig_option,
    tracked,
    warn_unusable,
)
from tautline.diagnose import motion, page, words
from tautline.diagnose.diagnosis import Diagnosis, diagnose
from tautline.folders import check_replaceable, replaced, write_file
from tautline.plain import plain
from tautline.recording import shifted

DOCUMENT = "diagnosis.json"


@click.command("diagnose")
@click.argument("calibration_path", metavar="CALIBRATION", type=click.Path(path_type=Path))
@click.argument("test_paths", metavar="TEST...", nargs=-1, required=True, type=click.Path(path_type=Path))
@rig_option
@folder_option("--out", "Folder for diagnosis.json, report.html, corrected/ and nominal/.")
@json_option
def command(
    calibration_path: Path, test_paths: tuple[Path, ...], rig_path: Path | None, out: Path, as_json: bool
) -> None:
    """Where model and instrument part, which effect is the cause, and how far the gap shrinks."""
    check_replaceable(out, DOCUMENT)
    recordings, rig = read_recordings([calibration_path, *test_paths], rig_path)
    with progress_bar("diagnosing") as progress:
        recordings = [tracked(recording, rig, progress) for recording in recordings]
        found = calibrate(recordings[:1], rig, progress=lambda fraction, text: progress(0.3 * fraction, text))
        warn_unusable(found.model, calibration_path)
        recordings = [*shifted(recordings[:1], found.offsets), *on_motor_clock(recordings[1:], rig)]
        diagnosis = diagnose(
            found.model, recordings[0], recordings[1:], lambda fraction, text: progress(0.3 + 0.65 * fraction, text)
        )
        progress(0.96, "writing the report")
        save(diagnosis, out)
    emit(diagnosis.document, as_json, words.text(diagnosis.document, str(out)))


def save(diagnosis: Diagnosis, out: Path) -> None:
    """The whole folder, or nothing."""
    with replaced(out, DOCUMENT) as folder:
        for name, model in (("nominal", diagnosis.nominal), ("corrected", diagnosis.corrected)):
            model.save(folder / name)
            report.write(model, folder / name, None, name)
        if diagnosis.next_motion is not None:
            table = motion.table(diagnosis.next_motion.motion, diagnosis.nominal.rig.actuator.unit)
            table.to_csv(folder / "next_motion.csv", index=False, float_format="%.6f")
        document: dict[str, Any] = plain(diagnosis.document)
        write_file(folder / DOCUMENT, json.dumps(document, indent=1, allow_nan=False) + "\n")
        page.write(diagnosis, folder, str(out))
