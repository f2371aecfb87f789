"""taut calibrate RECORDING... --rig rig.toml --out MODEL"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import click

from tautline.calibration.calibrate import calibrate
from tautline.calibration.options import Options
from tautline.calibration.result import Calibration
from tautline.cli._common import (
    SEED,
    NumberRange,
    emit,
    json_option,
    log,
    progress_bar,
    quality_lines,
    read_recordings,
    rig_option,
    warn,
)
from tautline.cli._live import (
    LiveOptions,
    free_recording,
    live_options,
    opened_setup,
    refuse_live_options,
    sigma_of,
    until_option,
)
from tautline.cli._outputs import Output, folder_option
from tautline.errors import UnusableError
from tautline.live import closing
from tautline.live.rounds import in_words
from tautline.model import MODEL_FILE
from tautline.recording import load, shifted
from tautline.reports import pages
from tautline.trajectory import NEXT_FILE
from tautline.vision.marker import with_marker


@click.command("calibrate")
@click.argument("recording_paths", metavar="[RECORDING...]", nargs=-1, type=click.Path(path_type=Path))
@rig_option
@folder_option("--out", "The MODEL folder to write: model.json, rig.toml, report.html.", key_file=MODEL_FILE)
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
@click.option(
    "--prior",
    "fleet",
    metavar="FLEET",
    type=click.Path(path_type=Path),
    help="What taut fleet wrote of robots of this make: B(q) is known before the recording, which may be shorter.",
)
@live_options
@until_option
@click.option(
    "--at-most",
    "at_most_s",
    type=NumberRange(min=1.0),
    default=120.0,
    show_default=True,
    help="Live: s, after which it says why B(q) is not known so well.",
)
@click.option("--thorough", is_flag=True, help="Live: the paper's slow motion instead, some four minutes long.")
@click.option(
    "--speed",
    "speeds",
    type=NumberRange(min=0.0, min_open=True),
    multiple=True,
    help="Live: of the motion's rounds (with --thorough of its passes) in turn, the rig's unit per second; up to four "
    "times.",
)
@click.option("--recording", "kept", type=Output(), help="Live: kept here. Default: OUT-recording.")
@click.option("--video", is_flag=True, help="Live: keep the frames too.")
@click.option("--seed", type=SEED, default=0, help="Of a simulation.")
@json_option
def command(
    recording_paths: tuple[Path, ...],
    rig_path: Path | None,
    out: Path,
    knots: Literal["smooth", "paper"],
    remaining: Literal["direct", "morphological"],
    fleet: Path | None,
    as_json: bool,
    kept: Path | None,
    **live_arguments: Any,  # those of `_calibrate_live` that are not named above, LiveOptions (`live`) among them
) -> None:
    """Measure B(q) and f_remain: from recordings of one instrument, or live from a board and a camera.

    Live (--camera with a board, or --simulate), the board moves the axis until B(q) is known well enough, or it is
    said why it cannot be; Ctrl-C brings the axis to rest.
    """
    options = Options(knots=knots, remaining=remaining)
    if recording_paths:
        live_parameters = [name for name in live_arguments if name != "live"]
        refuse_live_options("kept", *live_parameters, because="leave them out, or RECORDING")
        calibration, lines, proposed = _from_recordings(recording_paths, rig_path, out, options, fleet)
    else:
        if fleet is not None:
            raise click.UsageError("--prior goes with a RECORDING: record first, with 'taut record'")
        if live_arguments["live"].camera is None and live_arguments["live"].simulate is None:
            raise click.UsageError("name a RECORDING, or for a live calibration --camera SOURCE or --simulate")
        kept = kept or free_recording(out.absolute())
        calibration, lines, made = _calibrate_live(kept, rig_path, out, options, as_json=as_json, **live_arguments)
        proposed = None  # the live motion went through all gaps already, or said why it could not
    quality = calibration.model.quality
    verdict = quality_lines(quality)
    if as_json:
        log("\n".join(verdict))
        verdict = []
    for note in calibration.notes:
        log(f"taut: {note}")
    result = {**calibration.to_json(), "model": out, "report": out / pages.FILE, "next_motion": proposed}
    if not recording_paths:
        result |= {"recording": kept, "motion": made}
    emit(result, as_json, "\n".join([*verdict, *lines, f"{out / pages.FILE} shows it."]))
    if not quality.usable:
        raise UnusableError(f"{out}: written, but unusable: {quality.reasons[0]}")


def _from_recordings(
    paths: tuple[Path, ...], rig_path: Path | None, out: Path, options: Options, fleet: Path | None
) -> tuple[Calibration, list[str], dict[str, Any] | None]:
    """Calibrates on the recordings at `paths` and writes the MODEL folder `out`, with the motion that would measure B
    where it was not measured yet. Returns the calibration, the result in sentences, and that motion's `file` and
    `seconds`; None instead if B was measured everywhere or the model is unusable. fleet: output folder of `taut fleet`
    whose robots are the prior; None: no prior."""
    recordings, rig = read_recordings(paths, rig_path)
    if fleet is not None:
        from tautline.fleet import prior

        options = replace(options, beforehand=prior.read(fleet, rig))
    with progress_bar("calibrating") as progress:
        recordings = [with_marker(recording, rig, progress) for recording in recordings]
        calibration = calibrate(recordings, rig, options, progress)
        lines = pages.save_model(calibration.model, shifted(recordings, calibration.offsets), out)
    seconds = closing.write(calibration.model, calibration.gaps, recordings, out)
    if seconds is None:
        return calibration, lines, None
    path = out / NEXT_FILE
    lines.append(
        f"{seconds:.0f} s of motion would measure the rest of the range: taut record --motion {path}, then "
        "calibrate from both recordings."
    )
    return calibration, lines, {"file": path, "seconds": seconds}


def _calibrate_live(
    kept: Path,
    rig_path: Path | None,
    out: Path,
    options: Options,
    *,
    live: LiveOptions,
    until: str | None,
    at_most_s: float,
    thorough: bool,
    speeds: tuple[float, ...],
    video: bool,
    seed: int,
    as_json: bool,
) -> tuple[Calibration, list[str], dict[str, Any]]:
    """Calibrates on a board and a camera, which moves the motor, and writes the MODEL folder `out`. Returns the
    calibration, the result in sentences, and how the motion went (the result's `motion`). kept: folder to write the
    recording to; live: the set-up; until: sigma of B(q) to reach, as text such as "3um", None: the default; at_most_s:
    time, s, after which it ends; thorough: the paper's slow motion instead; speeds: the rig's unit per second; video:
    whether frames are recorded; seed: of a simulation; as_json: no picture in the terminal. Warns where the goal was
    not reached. UsageError for more than four speeds, or `thorough` with `until`."""
    from tautline.cli._picture import calibration_picture
    from tautline.live.session import MotionOptions, calibrate_live
    from tautline.live.until import Goal, calibrate_until

    if len(speeds) > 4:
        raise click.UsageError("--speed may be given up to four times")
    if thorough and until is not None:
        raise click.UsageError("--thorough is one motion, --until as many as it takes: choose one of them")
    goal_said: list[str] = []
    with opened_setup(live, rig_path, seed) as setup, calibration_picture(as_json) as show:
        unit = setup.rig.actuator.unit
        if thorough:
            passes = MotionOptions(speeds=speeds or None)
            calibration, motion = calibrate_live(setup, kept, passes, options, video=video, show=show)
            made: dict[str, Any] = {}
        else:
            wanted = None if until is None else sigma_of(until, unit)
            goal = Goal(wanted, at_most_s=at_most_s, speeds=speeds or None)
            calibration, reached = calibrate_until(setup, kept, goal, options, video=video, show=show)
            motion = reached.motion
            made = {"until": reached.until, "sigma": reached.standing.worst, "reached": reached.reached}
            if reached.why:
                made["why"] = reached.why
                warn(f"B(q) is not known to {in_words(reached.until, unit)} everywhere: {reached.why}")
            else:
                low, high = calibration.model.measured
                worst = in_words(reached.standing.worst, unit)
                goal_said.append(f"From {low:.3g} to {high:.3g} {unit} its sigma is {worst} at most.")
    made |= {"seconds": motion.seconds, "reversals": motion.reversals, "frames": motion.frames}
    log(f"taut: {len(calibration.onsets)} reversals in {motion.seconds:.0f} s, recorded in {kept}")
    recordings = shifted([load(kept, calibration.model.rig)], calibration.offsets)
    return calibration, [*pages.save_model(calibration.model, recordings, out), *goal_said], made
