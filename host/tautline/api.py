"""The package's functions: what the commands do, on arrays and files of your own.

Each of them is one step: load -> calibrate -> predict, encode, compensate, track, diagnose -> plot, report, export. The
commands take the same steps. `B` is the backlash width, `f_remain` the law behind it (docs/calibration.md); `q` is the
motor's position in the unit of the rig (mm of cable or deg of a spindle), `c` the bending angle in deg.

Every error that a caller can act on is a TautError whose text says what to do; a wrong type is Python's own. Recordings
of your own arrays are refused as their files would be: times that do not rise, a motor with NaN, the same one twice.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy.typing as npt

from tautline import recording as recordings_room
from tautline.errors import TautError
from tautline.recording import Motor, Recording
from tautline.rig import Rig

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tautline.calibration.result import Calibration
    from tautline.compensation import SetPoints
    from tautline.diagnosis.diagnose import Diagnosis
    from tautline.io.exporting import Exported
    from tautline.io.importing import Imported, Proposal
    from tautline.model import Model
    from tautline.prediction import Prediction
    from tautline.simulators import Simulator
    from tautline.tables import Limits
    from tautline.tracking import Tracked

_BEFORE = 0.3  # display: share of a diagnosis that is its calibration
Progress = Callable[[float, str], None]  # (share done, 0 to 1; what is being done)
_log = logging.getLogger(__name__)


def _silent(share: float, what: str) -> None:
    """The `progress` of a caller that gives none: logs, at level debug, the share that is done, 0 to 1, and what is
    being done."""
    _log.debug("%3.0f %%: %s", 100.0 * share, what)


def load(path: str | Path, rig: Rig | str | Path | None = None, progress: Progress = _silent) -> Recording:
    """Loads a recording from its folder. If it holds a video and no marker.csv, the marker is tracked in the video.

    Shapes: motor.t_s and motor.q are (n,); marker.t_s, u_px, v_px, valid (m,); angle.t_s, c_deg (k,).
    Units: t_s in s on one clock, arrival times for marker and angle; q in mm or deg as the rig says; c_deg in deg.
    Errors: TautError names file, line and column of what cannot be read, a missing rig, or a video without a marker.
        What was mended is told in `.warnings`, and logged.
    Source: the files of docs/files.md; the tracker of docs/marker.md.

    path: the folder. rig: a Rig or its file; it wins over the folder's own rig.toml and is the result's `.rig`.
    """
    named = Rig.load(rig) if isinstance(rig, str | Path) else rig
    recording = recordings_room.load(path, named)
    used = named or recording.rig
    assert used is not None  # else load has refused it
    for warning in recording.warnings:
        _log.warning("%s", warning)
    if recording.marker is None and recording.video is not None:
        from tautline.vision.marker import with_marker

        recording = with_marker(recording, used, progress)
    return replace(recording, rig=used)


def propose_import(source: str | Path, *, time: str = "", episode: int = 0, progress: Progress = _silent) -> Proposal:
    """Proposes which channels of another program's file are motor, tip, command, load and video. It writes nothing.

    Shapes: none; `.motor`, `.tip`, `.command`, `.load` have each a `.name` and a `.unit`, `.tip` one or two of them.
    Units: `.unit` is that of q, mm or deg; each channel's own is what the file says or, by `.notes`, a guess.
    Errors: TautError for a file of another kind, one that is cut short or empty, or one whose library is not installed.
    Source: docs/import.md: of two channels that move together the later one is the tip; names decide between equals.

    source: an MCAP file, a ROS 1 bag, a rosbag2 folder, a LeRobot folder or a CSV. time: name of a CSV's column of
    times; by default the one that rises. episode: the number of the data set's episode that is looked at.
    """
    from tautline.io import importing

    return importing.propose(importing.scan(importing.open_source(source, time), episode, progress))


def import_recording(
    source: str | Path,
    folder: str | Path,
    motor: str,
    tip: str | Sequence[str] = (),
    *,
    command: str | None = None,
    load: str | None = None,
    video: str | None = None,
    joints: Sequence[str] = (),
    time: str = "",
    unit: Literal["mm", "deg"] | None = None,
    rig: Rig | None = None,
    episode: int | None = None,
    progress: Progress = _silent,
) -> list[Imported]:
    """Writes recordings made of another program's file, as `taut import` does.

    Shapes: one Imported for each recording that was written: `.folder`, `.rows` of motor.csv, `.warnings`. Why an
        episode was left out is logged as a warning, and kept in import.toml.
    Units: a channel is NAME, NAME:UNIT (rad, m, Nm, tick, ...) or NAME:FACTOR; q is written in `unit` or the rig's.
    Errors: TautError where a channel is missing, empty or, as the ratio of motor and tip shows, in another unit than
        was stated, where times are those of two clocks, and for a file that is cut; nothing is written then.
    Source: docs/import.md; the files of docs/files.md and import.toml, which says where each number came from.

    source: as propose_import's. folder: of the recording, or of all recordings where a data set has several episodes
    and `episode` is None. tip: one angle or orientation, or u and v in px. command, load, video, joints: further
    channels. time: a CSV's column of times. rig: written beside each recording; by default one with the range,
    smallest step and slope that the recording shows.
    """
    from tautline.io import importing

    tips = (tip,) if isinstance(tip, str) else tuple(tip)
    roles = importing.Roles(motor, tips, command=command, load=load, video=video, joints=tuple(joints))
    opened = importing.open_source(source, time)
    written, skipped = importing.import_episodes(
        opened, Path(folder), roles, progress, unit=unit, rig=rig, episode=episode
    )  # fmt: skip
    for text in skipped:
        _log.warning("%s", text)
    return written


def calibrate(
    recordings: Recording | Sequence[Recording],
    rig: Rig | None = None,
    *,
    knots: Literal["smooth", "paper"] = "smooth",
    remaining: Literal["direct", "morphological"] = "direct",
    progress: Progress = _silent,
) -> Calibration:
    """Estimates B(q), f_remain and the sensor's delay from recordings of any motion of one instrument.

    Shapes: `.model.q`, `.width`, `.width_sigma`, `.c_deg` and `.c_sigma` are (n,), on one grid over the motor's range.
    Units: q and widths in the rig's unit, c in deg, delay in s; sigmas are one standard deviation, model error
        included.
    Errors: TautError where nothing can be measured: no marker, no motion, no rig. What is measured but cannot be
        trusted raises nothing: `.model.quality` has the verdict (good, doubtful, unusable) and each doubt's remedy.
    Source: the onsets of in-situ backlash estimation, B = |q(t2 - t_delay) - q1| at q_mean = (q1 + q2)/2, sharpened by
        a fit of all frames; f_remain from the pose, eq. 8. docs/calibration.md has what differs and why.

    knots: B as a spline smoothed as the data ask for, or through the paper's 14 knots. remaining: f_remain fitted
    directly, or the paper's central fibre of the characteristic as an image. rig: default the first recording's.
    """
    from tautline.calibration.calibrate import calibrate as calibrated
    from tautline.calibration.options import Options

    several, used = _recordings_and_rig(recordings, rig)
    found = calibrated(several, used, Options(knots=knots, remaining=remaining), progress)
    for note in found.notes:
        _log.info("%s", note)
    quality = found.model.quality
    _log.info("the calibration is %s", quality.verdict)
    for reason in quality.reasons:
        _log.log(logging.INFO if reason.mild else logging.WARNING, "%s", reason)
    return found


def predict(model: Model, motor: Motor, scene_s: npt.ArrayLike, start_deg: float | None = None) -> Prediction:
    """Predicts where the tip was from the model and the motor's motion alone.

    Shapes: scene_s (n,) in any order; `.c_deg` (n,), `.image_px` (n, 2), or None on a rig without a camera; of the same
        shapes `.c_sigma_deg`, `.image_sigma_px`: one standard deviation of what the sensor would show, noise included.
    Units: scene_s in s on the motor's clock, which is arrival time less `model.delay_s`; start_deg and c in deg; px.
    Errors: TautError where the motor lacks a column that one of the model's effects needs, or its times do not rise. A
        place where the marker cannot be is NaN.
    Source: the play p[k] = min(max(p[k-1], p_lo(q)), p_hi(q)) with p_lo + B(p_lo)/2 = q = p_hi - B(p_hi)/2, then
        c = f_remain(p) and the rig's pinhole camera (eqs. 3 and 5, their signs for a law that rises or falls).

    The tip starts on the centre line, c = f_remain(q[0]), or at start_deg; q is held before and after motor's samples.
    """
    from tautline.prediction import predict_with_sigma

    recordings_room.check_motor(motor)
    return predict_with_sigma(model, motor, scene_s, start_deg)


def encode(
    model: Model, axis: int = 0, *, limits: Limits | None = None, kind: str = "bending", instrument: str | None = None
) -> bytes:
    """Encodes the model as a board's table, which `taut flash` or any DFU tool writes to the board.

    Shapes: at most 257 nodes over the motor's range, 1.4 kB (2.5 kB with several plays).
    Units: of the result: Q8 encoder counts and Q16 deg; limits in the rig's unit, s.
    Errors: TautError with the board's own reason where it would refuse the table: |B'| >= 2, a law that is not
        monotone, numbers beyond its range, an axis or kind that does not exist.
    Source: the layout and its rules are common/tl_table.h's; the board's own C checks the result.

    kind: bending, translation or rotation. instrument: serial of the one it is for, 8 characters at most; default the
    rig's. limits: of the take-up; default moderate ones.
    """
    from tautline import tables

    return tables.encode(model, axis, limits, kind, instrument=instrument)


def compensate(
    model: Model,
    t_s: npt.ArrayLike,
    c_deg: npt.ArrayLike,
    *,
    rate_hz: int = 1000,
    mode: Literal["off", "backlash", "full"] = "full",
    start_deg: float | None = None,
    progress: Progress = _silent,
) -> SetPoints:
    """Computes motor set-points that lead the tip of `model` along a trajectory, by the board's own code, run here.

    Shapes: t_s and c_deg (n,), straight lines between them; the result's t_s, q, clipped (m,), m = duration x rate_hz.
    Units: t_s in s, rising; c_deg and start_deg in deg; q in the rig's unit; rate_hz 16 to 100 000.
    Errors: TautError for a trajectory that is not finite, does not rise or is too long, a rate or a mode that is not
        there. What lies beyond the table, the range or the motor's speed is clipped and marked.
    Source: q* = p* + B(p*)/2 while p* = f^-1(c*) rises, p* - B(p*)/2 while it falls, unchanged at rest (eq. 9 with its
        signs put right); firmware/estimator/tl_compensator.h.

    Each set-point knows the trajectory up to its own time only. mode: off inverts f_coarse alone, backlash
    f_coarse and B, full f_remain and B. The tip starts at rest on the centre line at start_deg, default c_deg[0].
    """
    from tautline.compensation import compensate as compensated

    return compensated(model, t_s, c_deg, rate_hz, mode, start_deg, progress)


def track(model: Model, recordings: Recording | Sequence[Recording], progress: Progress = _silent) -> Tracked:
    """Replays recordings frame by frame, in turn: how a tracker would have kept the model calibrated during use.

    Shapes: `.rows` has one row for each frame (or angle), `.t_s`, `.column(name)` and `.recording` are (n,).
    Units: t_s in s, arrival times; offset in the rig's unit, scale in shares of B, c in deg, u and v in px.
    Errors: TautError where there is no recording, or not all have a marker, or all an angle.
    Source: docs/tracking.md: laws nested from nothing to a new shape of B, the simplest that leaves no more than noise.

    A row is predicted from the motor up to its time and the frames before it, so a recording cut short gives the same
    rows. state is trusted, stale or adapting; `.changes` tells what changed, and when.
    """
    from tautline.tracking import replay

    return replay(model, _several(recordings), progress)


def diagnose(
    calibration: Recording,
    tests: Recording | Sequence[Recording],
    rig: Rig | None = None,
    progress: Progress = _silent,
) -> Diagnosis:
    """Finds where model and instrument differ, which effect causes it, and how far the gap shrinks with that effect.

    Shapes: `.before` and `.after` hold for each test the residuals (frames, 2) in px, or (samples, 1) in deg.
    Units: of every gap px where a marker was recorded, else deg; probabilities and shares 0 to 1.
    Errors: TautError where the calibration measures nothing, or no test is given or can be scored. An unusable
        calibration is not refused: look at `.nominal.quality`.
    Source: docs/diagnosis.md: the nominal model and one effect after the other fitted together, judged on blocks that
        the fit did not see. `.document` is diagnosis.json (docs/files.md).

    calibration may be a simulator's recording and tests the robot's: the diagnosis then says what the simulator lacks.
    `.verdict`, `.findings`, `.gap` and `.probabilities` say what was found, `.document` all of it as diagnosis.json has
    it; `.corrected` is the model with the effects that were named. rig: default the calibration's.
    """
    from tautline.diagnosis.diagnose import diagnose as diagnosed
    from tautline.diagnosis.recorded import calibrated

    tests = _listed(tests)
    if not tests:
        raise TautError("no test: give one recording or more that the calibration was not made from")
    several, used = _recordings_and_rig([calibration, *tests], rig)
    first, on_one_clock, of_clocks = calibrated(several, used, lambda share, what: progress(_BEFORE * share, what))
    for reason in of_clocks:
        _log.warning("%s", reason)
    found = diagnosed(
        first.model,
        on_one_clock[0],
        on_one_clock[1:],
        lambda share, what: progress(_BEFORE + (1.0 - _BEFORE) * share, what),
    )
    named = ", ".join(f"{each.id} ({each.probability:.2f})" for each in found.findings)
    _log.info("%s%s", found.verdict, f": {named}" if named else "")
    return found


def diagnose_simulator(
    simulator: Simulator,
    robots: Recording | Sequence[Recording],
    rig: Rig | None = None,
    progress: Progress = _silent,
    workers: int = 1,
) -> Diagnosis:
    """Finds what a simulator of your own lacks, and which of its parameters differ from the robot's, with both values.

    Shapes: as diagnose's; `.document["simulator"]["parameters"]` has name, unit, nominal and value of what was named,
        `["step"]` what the simulator errs by at its own step of time, where that shows beside the noise.
    Units: those that the simulator declares; gaps in px or deg as diagnose's.
    Errors: TautError where a recording has nothing to compare, where nothing can be scored, and where the simulator
        gives something else than angles.
    Source: docs/diagnosis.md: the simulated tip takes the motor's place, with no backlash and f_remain = f_coarse; the
        library's effects act on it, and the simulator's parameters are further unknowns, by finite differences.

    simulator: tautline.simulators.mjcf.simulator(FILE, ACTUATOR, TIP), or a tautline.simulators.Simulator around any
    function. robots: with the motor's log or command, and what was seen. rig: default the recordings' own. workers:
    processes in which a slow simulator is run side by side; the result is the same.
    """
    from tautline.diagnosis.simulated import diagnose_simulator as diagnosed

    several, used = _recordings_and_rig(robots, rig)
    return diagnosed(simulator, several, used, progress, workers)


def report(
    result: Calibration | Model | Diagnosis,
    folder: str | Path,
    recordings: Recording | Sequence[Recording] = (),
) -> Path:
    """Writes a result with its page, report.html, as the commands do; returns the page.

    Shapes: none; a calibration's recordings are those that it was made from.
    Units: as in the result.
    Errors: TautError where the folder holds something else or cannot be written (what was there then stays), and for a
        calibration without its recordings.
    Source: the figures of a page are those of the paper's Figs. 7 to 11; docs/files.md lists the files.

    A calibration becomes a MODEL folder (model.json, rig.toml), which the commands and Model.load take, with the motion
    that would measure the rest of the range where there is one (next_motion.csv); a Model becomes one too, its
    page without measured frames; a diagnosis becomes its DIR (diagnosis.json, corrected/, nominal/).
    """
    from tautline.diagnosis.diagnose import Diagnosis
    from tautline.live import closing
    from tautline.model import Model
    from tautline.reports import pages

    folder = Path(folder)
    if isinstance(result, Diagnosis):
        from tautline.diagnosis.folder import save

        save(result, folder)
    elif isinstance(result, Model):
        pages.save_model(result, _several(recordings), folder)
    else:
        several = _several(recordings)
        if not several:
            raise TautError(f"{folder}: a calibration's report shows its recordings: give them too")
        pages.save_model(result.model, recordings_room.shifted(several, result.offsets), folder)
        closing.write(result.model, result.gaps, several, folder)
    return folder / pages.FILE


def plot(
    result: Calibration | Model | Diagnosis | Mapping[str, Model],
    recordings: Recording | Sequence[Recording] = (),
) -> Figure:
    """Draws the first picture of a result's page, as a matplotlib figure to show, change or save.

    Shapes: none; recordings: those that a calibration was made from, to draw what was seen behind the curves.
    Units: as in the result.
    Errors: TautError where a recording cannot be read, and for a mapping that is empty or has models of two units.
    Source: B(q), its widths and the characteristic as in the paper's Figs. 7 to 9; of a diagnosis what both models
        leave over the session's time; of several models by name how they differ.
    """
    from tautline.diagnosis.diagnose import Diagnosis
    from tautline.model import Model
    from tautline.reports import evidence, figures

    if isinstance(result, Diagnosis):
        from tautline.diagnosis.page import residuals

        return residuals(result)
    if isinstance(result, Mapping):
        return figures.compared(result)
    model, offsets = (result, {}) if isinstance(result, Model) else (result.model, result.offsets)
    several = _several(recordings)
    seen = evidence.collect(model, recordings_room.shifted(several, offsets)) if several else None
    return figures.hero(model, figures.onsets_of(model), seen, figures.knots_of(model))


def export(
    what: Recording | Model | Diagnosis,
    to: str,
    out: str | Path,
    *,
    model: Model | None = None,
    into: str | Path | None = None,
    actuator: str = "",
    tip: str = "",
    scale: float | None = None,
    axis: str | None = None,
    progress: Progress = _silent,
) -> Exported:
    """Writes a recording, a model or a diagnosis for another program: a log viewer, a simulator, a motor controller.

    Shapes: none; the result's `.files` were written, `.lost` says line by line what the format cannot hold.
    Units: of a format's own numbers as docs/export.md says; scale is the control's per unit of q, default 0.001 for mm
        and pi/180 for deg.
    Errors: TautError for a format that is not there or does not take this, a package that is missing (with the command
        that installs it), names that the MJCF has not; nothing is written then.
    Source: docs/export.md, which has each format's own source.

    to: mcap, rerun, csv, mjcf, linuxcnc, marlin, fluidnc or klipper; out: the file or folder. model: with a
    recording, what foretells it. into, actuator, tip: of mjcf, where the model goes. axis: the joint's number or the
    axis' letter of a controller. Of a diagnosis the corrected model is taken.
    """
    from tautline.io.exporting import Mount
    from tautline.io.exporting import export as exported
    from tautline.io.exporting.source import of

    mount = None if into is None else Mount(Path(into), actuator, tip, scale)
    return exported(of(what, model), to, Path(out), mount=mount, axis=axis, progress=progress)


def _listed(recordings: Recording | Sequence[Recording]) -> list[Recording]:
    """The argument as a list: a single recording becomes a list of one."""
    return [recordings] if isinstance(recordings, Recording) else list(recordings)


def _several(recordings: Recording | Sequence[Recording]) -> list[Recording]:
    """The recordings as a list, with names made unique as the commands do it (`recording.told_apart`). TautError for a
    recording that no file could hold (`recording.check`)."""
    several = _listed(recordings)
    for recording in several:
        recordings_room.check(recording)
    return recordings_room.told_apart(several)


def _recordings_and_rig(recordings: Recording | Sequence[Recording], rig: Rig | None) -> tuple[list[Recording], Rig]:
    """The recordings as a list, and the one rig that holds for all of them (`_rig_of`). TautError as `_several` and
    `_rig_of` raise it, and where a recording is given twice."""
    several = _several(recordings)
    used = _rig_of(several, rig)
    recordings_room.check_distinct(several)
    return several, used


def _rig_of(recordings: Sequence[Recording], rig: Rig | None) -> Rig:
    """`rig` if it is given, else the recordings' own. TautError where no recording has one, or two have different
    ones."""
    if rig is not None:
        return rig
    rigs = [recording.rig for recording in recordings if recording.rig is not None]
    if not rigs:
        raise TautError("no recording, or none with a rig: give rig, or load them with one")
    for recording in recordings:
        if recording.rig is not None and recording.rig != rigs[0]:
            raise TautError(f"{recording.name}: its rig differs from the others': say which with rig")
    return rigs[0]
