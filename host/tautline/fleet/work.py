"""What a worker does: it calibrates one session's files and returns its row, also where the calibration fails."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from tautline.calibration.calibrate import calibrate
from tautline.calibration.result import Calibration
from tautline.errors import TautError
from tautline.fleet.rows import Row
from tautline.folders import unpacked_folder
from tautline.prediction import width_by_delay
from tautline.recording import check_distinct, load_all, of_another_rig
from tautline.rig import RIG_FILE, Rig
from tautline.vision.marker import with_marker

PLACES = 33  # tolerance: places of a row's curves: on 10 mm, two in the finest bump that a calibration resolves, 0.6 mm


def calibrate_session(row: Row, files: Mapping[str, bytes]) -> Row:
    """Calibrates one session's files (as Session.files returns them) and returns its row with the result and the
    seconds of processor time. An exception does not leave it: its text becomes the row's `error`. row: with the names
    and `inputs` of the session."""
    began = time.process_time()
    try:
        with unpacked_folder(files) as folder:
            row = _calibrate_files(row, folder)
    except Exception as error:  # one session of many: a row that says so
        text = str(error) if isinstance(error, TautError) else f"{type(error).__name__}: {error}"
        row = replace(row, error=text)
    return replace(row, seconds=time.process_time() - began)


def _calibrate_files(row: Row, folder: Path) -> Row:
    """Calibrates the recordings in `folder`, each of which is a folder in it, and returns the row with the result. The
    rig is rig.toml in `folder`, else that of the first recording. Paths in a TautError are made relative to `folder`,
    which is temporary."""
    try:
        paths = sorted(each for each in folder.iterdir() if each.is_dir())
        own = folder / RIG_FILE
        rig = Rig.load(own if own.is_file() else paths[0] / RIG_FILE)
        given = load_all(paths, rig)
        if other := of_another_rig(given, rig):
            raise TautError(f"{other.name}: its {RIG_FILE} differs from the session's: make it another session")
        check_distinct(given)
        recordings = [with_marker(recording, rig) for recording in given]
        motion_s = sum(float(np.ptp(recording.motor.t_s)) for recording in recordings)
        return _with_calibration(replace(row, motion_s=motion_s), calibrate(recordings, rig))
    except TautError as error:
        raise TautError(str(error).replace(f"{folder}/", "")) from error


def _with_calibration(row: Row, calibration: Calibration) -> Row:
    """The row with the columns filled that a calibration gives; its curves are sampled at PLACES places over the rig's
    range."""
    model = calibration.model
    places = np.linspace(*model.rig.actuator.range, PLACES)

    def curve(values: np.ndarray | None) -> tuple[float, ...]:
        """The values (grid,) on the model's grid, interpolated at `places`; () for None."""
        return () if values is None else tuple(np.interp(places, model.q, values).tolist())

    # (grid, coordinates) each, with no coordinates if the calibration has no path
    path, path_sigma = calibration.path or (np.zeros((len(model.q), 0)),) * 2

    return replace(
        row,
        verdict=model.quality.verdict.value,
        reasons=tuple(reason.code for reason in model.quality.reasons),
        unit=model.rig.actuator.unit,
        q=tuple(places.tolist()),
        width=curve(model.width),
        width_sigma=curve(model.width_sigma),
        width_by_delay=curve(width_by_delay(model, calibration.delay.sigma_s)),
        c_deg=curve(model.c_deg),
        c_sigma_deg=curve(model.c_sigma),
        path=sum((curve(each) for each in path.T), ()),
        path_sigma=sum((curve(each) for each in path_sigma.T), ()),
        measured_low=model.measured[0],
        measured_high=model.measured[1],
        delay_s=model.delay_s,
        delay_sigma_s=calibration.delay.sigma_s,
        residual=model.noise_of(model.sensor),
    )
