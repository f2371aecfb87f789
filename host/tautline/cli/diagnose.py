"""taut diagnose CALIBRATION TEST [TEST ...], ROBOT [ROBOT ...] with --simulator, or --live"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tautline.calibration.result import Calibration
from tautline.cli._common import (
    SEED,
    Number,
    emit,
    json_option,
    log,
    progress_bar,
    read_recordings,
    rig_option,
    warn,
    warn_unusable,
)
from tautline.cli._live import LiveOptions, live_options, opened_setup, options_given, refuse_live_options
from tautline.cli._outputs import Output, folder_option
from tautline.diagnosis import narration
from tautline.diagnosis.diagnose import diagnose
from tautline.diagnosis.folder import DOCUMENT, save
from tautline.diagnosis.recorded import calibrated
from tautline.diagnosis.simulated import diagnose_simulator
from tautline.recording import Recording, load
from tautline.rig import ANGLE, Rig
from tautline.simulators import Simulator, mjcf, source
from tautline.simulators.sight import sight

if TYPE_CHECKING:
    from tautline.diagnosis.diagnose import Diagnosis
    from tautline.live.asking import Asked

Progress = Callable[[float, str], None]


@click.command("diagnose")
@click.argument("calibration_path", metavar="[CALIBRATION]", required=False, type=click.Path(path_type=Path))
@click.argument("test_paths", metavar="[TEST...]", nargs=-1, type=click.Path(path_type=Path))
@rig_option
@folder_option("--out", "Folder for diagnosis.json, report.html, corrected/ and nominal/.", key_file=DOCUMENT)
@click.option(
    "--live",
    "is_live",
    is_flag=True,
    help="Record the motion that tells most, diagnose, and go on until one answer has 95 % or nothing that could be "
    "recorded would help: with --board and --camera, or --simulate. Without CALIBRATION the axis is calibrated first.",
)
@click.option(
    "--simulator",
    help="Your simulator in the calibration's place: MJCF or URDF, with --actuator and --tip, or MODULE:NAME of a "
    "tautline.simulators.Simulator. Every recording is then one of the robot.",
)
@click.option("--actuator", help="With --simulator: its actuator whose control is q (or q_cmd, where it was recorded).")
@click.option("--tip", help="With --simulator: what bends, joint:NAME or site:NAME.")
@click.option(
    "--scale",
    type=Number(),
    help="With --simulator: of the control, per unit of q; default 0.001 for mm, pi/180 for deg.",
)
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="With --simulator: processes in which a slow one is run side by side; the result is the same.",
)
@live_options
@click.option(
    "--most", type=click.IntRange(min=1), default=5, show_default=True, help="Live: recordings, after which it ends."
)
@click.option("--recordings", "kept", type=Output(), help="Live: kept here. Default: OUT-recordings.")
@click.option("--seed", type=SEED, default=0, help="Of a simulation.")
@json_option
def command(
    calibration_path: Path | None,
    test_paths: tuple[Path, ...],
    rig_path: Path | None,
    out: Path,
    is_live: bool,
    simulator: str | None,
    actuator: str | None,
    tip: str | None,
    scale: float | None,
    workers: int,
    live: LiveOptions,
    most: int,
    kept: Path | None,
    seed: int,
    as_json: bool,
) -> None:
    """Where model and instrument part, which effect is the cause, and how far the gap shrinks.

    CALIBRATION may be a recording of a simulator and each TEST one of the robot: the diagnosis then says what the
    simulator lacks. With --simulator it is run here, by the robot's own motor logs, and its own parameters are among
    what may be named. --camera is then one of its file, which sees the site of --tip where marker.csv has the marker.
    """
    if simulator is not None:
        if is_live:
            raise click.UsageError("--simulator needs recordings: name them")
        refuse_live_options("most", "kept", "seed", because="leave them out", used="camera")
        robots = [path for path in (calibration_path, *test_paths) if path is not None]
        diagnosis = _diagnose_simulator(
            simulator, actuator, tip, live.camera, scale, workers=workers, paths=robots, rig_path=rig_path, out=out
        )
        _print_diagnosis(diagnosis, out, as_json)
        return
    if any(options_given("actuator", "tip", "scale", "workers")):
        raise click.UsageError("--actuator, --tip, --scale and --workers go with --simulator")
    if is_live:
        if live.camera is None and live.simulate is None:
            raise click.UsageError("--live needs --camera SOURCE (and a board), or --simulate")
        kept = kept or out.absolute().with_name(f"{out.name}-recordings")
        asked = _diagnose_live(calibration_path, test_paths, rig_path, kept=kept, live=live, most=most, seed=seed)
        save(asked.diagnosis, out)
        more = {"recordings": asked.recordings, "why": asked.why, "sure": asked.sure}
        said = f"{narration.text(asked.diagnosis.document, str(out))}\n\nStopped: {asked.why}."
        emit({**asked.diagnosis.document, "live": more}, as_json, said)
        _log_topics(asked.diagnosis.document)
        return
    refuse_live_options("most", "kept", "seed", because="name --live with them, or leave them out")
    if calibration_path is None or not test_paths:
        raise click.UsageError("name CALIBRATION and at least one TEST, or record them with --live")
    recordings, rig = read_recordings([calibration_path, *test_paths], rig_path)
    with progress_bar("diagnosing") as progress:
        calibration, recordings = _calibrate_first(recordings, rig, calibration_path, progress)
        diagnosis = diagnose(
            calibration.model,
            recordings[0],
            recordings[1:],
            lambda fraction, text: progress(0.3 + 0.65 * fraction, text),
        )
        progress(0.96, "writing the report")
        save(diagnosis, out)
    _print_diagnosis(diagnosis, out, as_json)


def _print_diagnosis(diagnosis: Diagnosis, out: Path, as_json: bool) -> None:
    """Prints a diagnosis as the command's result, and then a hint for each effect that it names. out: the folder of the
    diagnosis, which the text names."""
    emit(diagnosis.document, as_json, narration.text(diagnosis.document, str(out)))
    _log_topics(diagnosis.document)


def _diagnose_simulator(
    name: str,
    actuator: str | None,
    tip: str | None,
    camera: str | None,
    scale: float | None,
    workers: int,
    paths: list[Path],
    rig_path: Path | None,
    out: Path,
) -> Diagnosis:
    """Diagnoses a simulator against the robot's recordings at `paths` and writes the diagnosis into `out`. name: the
    value of --simulator; actuator, tip: those of its file; camera: a camera of its file, through which the marker's
    positions are turned into angles, or None where the recordings have angles or the rig's camera is to be used; scale:
    the actuator's control per unit of q, None: by the unit; workers: number of processes. UsageError without a
    recording, or where the options do not go together."""
    if not paths:
        raise click.UsageError("name at least one recording of the robot")
    robots, rig = read_recordings(paths, rig_path)
    with progress_bar("diagnosing") as progress:
        if camera is not None:
            tip, robots = _angles_through_camera(name, tip, camera, robots, rig)
        simulator = _open_simulator(name, actuator, tip, scale, rig)
        diagnosis = diagnose_simulator(
            simulator, robots, rig, lambda fraction, text: progress(0.95 * fraction, text), workers
        )
        progress(0.96, "writing the report")
        save(diagnosis, out)
    return diagnosis


def _open_simulator(name: str, actuator: str | None, tip: str | None, scale: float | None, rig: Rig) -> Simulator:
    """Opens the simulator that --simulator names: a Python object, MODULE:NAME, or else an MJCF or URDF file, which
    needs `actuator` and `tip` (UsageError without). scale: the actuator's control per unit of q, None: by the unit."""
    if source.is_python(name):
        return source.of_python(name)
    if actuator is None or tip is None:
        raise click.UsageError("--simulator FILE needs --actuator A and --tip joint:J or site:S")
    return mjcf.simulator(name, actuator, tip, rig.actuator.unit, scale)


def _angles_through_camera(
    name: str, tip: str | None, camera: str, robots: list[Recording], rig: Rig
) -> tuple[str, list[Recording]]:
    """Turns the marker's positions in the recordings into angles of the hinge that moves the site `tip`, as the camera
    of the simulator's file `name` sees that site. Returns the value that --tip then has, joint:HINGE, and the
    recordings with angles. UsageError where there is no file, or the tip is not site:NAME."""
    if source.is_python(name) or tip is None or not tip.startswith("site:"):
        raise click.UsageError("--camera goes with --simulator FILE and --tip site:S, which it sees")
    seen = sight(Path(name), tip.removeprefix("site:"), camera)
    late_s = rig.delay_s - rig.nominal_delay_s(ANGLE)  # a frame's delay beyond an angle sensor's
    return f"joint:{seen.hinge}", [seen.to_angle(robot, late_s) for robot in robots]


def _log_topics(document: Mapping[str, Any]) -> None:
    """Prints, for each effect that a diagnosis' document (diagnosis.json) names, where to read more about it."""
    for effect in document["effects"]:
        log(f"taut: 'taut explain {effect['id']}' says how to tell it and what mends it")


def _calibrate_first(
    recordings: list[Recording], rig: Rig, path: Path, progress: Progress
) -> tuple[Calibration, list[Recording]]:
    """Calibrates on the first recording. Returns the calibration and all recordings, put on the motor's clock. Prints
    warnings where the calibration is unusable, and where a test's clock was off or cannot be told. path: of the first
    recording, for the first one; progress: is taken from 0 to 0.3."""
    calibration, recordings, of_clocks = calibrated(recordings, rig, lambda share, text: progress(0.3 * share, text))
    warn_unusable(calibration.model, path)
    for reason in of_clocks:
        warn(str(reason))
    return calibration, recordings


def _diagnose_live(
    calibration_path: Path | None, test_paths: tuple[Path, ...], rig_path: Path | None, kept: Path, live: LiveOptions,
    most: int, seed: int,
) -> Asked:  # fmt: skip
    """Calibrates, and then diagnoses live: up to `most` motions are made on the board and recorded into the folder
    `kept`. The calibration is on the recording at calibration_path; if that is None one is made first, in
    KEPT-calibration. The diagnosis begins with the recordings at test_paths, if any. rig_path: of --rig; seed: of a
    simulation."""
    from tautline.live.asking import diagnose_live
    from tautline.live.until import calibrate_until

    paths = [calibration_path, *test_paths] if calibration_path else []
    made, rig = read_recordings(paths, rig_path) if paths else ([], None)
    with opened_setup(live, rig_path, seed) as setup, progress_bar("diagnosing") as progress:
        if calibration_path is None:
            calibration_path = kept.with_name(f"{kept.name}-calibration")
            progress(0.0, "calibrating")
            calibrate_until(setup, calibration_path, progress=progress)
            made, rig = [load(calibration_path, setup.rig)], setup.rig
        assert rig is not None
        calibration, recordings = _calibrate_first(made, rig, calibration_path, progress)
        return diagnose_live(
            setup, calibration, recordings[0], recordings[1:], folder=kept, most=most, progress=progress, say=log
        )
