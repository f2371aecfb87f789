"""A motion through known angles: where the marker and the motor stood at each."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tautline import layouts
from tautline.columns import read_columns
from tautline.errors import TautError
from tautline.recording import Angle, Recording
from tautline.rig import Coarse

Array = npt.NDArray[np.float64]
SETTLES_S = 0.3  # prior: after a stated time: a frame's age, and what rings
STANDS_S = 1.0  # from a stated time on
_LEAST_FRAMES = 5  # tolerance: of a rest, for the scatter of its mean
_LEAST_PLACES = 4  # tolerance: a pose has six numbers and a place gives two; one place checks them
_MOVES = 1e-2  # of the motor's travel: what moves more does not rest


@dataclass(frozen=True)
class Places:
    """Where marker and motor stood while the tip rested at n known angles."""

    c_deg: Array  # (n,) angles as stated
    image_px: Array  # (n, 2) the marker's mean position, u and v
    sigma_px: Array  # (n,) standard deviation of that mean, of each coordinate
    q: Array  # (n,) the motor's mean position


def read_known_angles(file: Path) -> Angle:
    """Reads a CSV of known angles. Its column t_s is when a rest of at least STANDS_S began, s on the recording's
    clock, rising from row to row; c_deg is the tip's angle during that rest, deg. TautError where the file is no such
    table. Its last line is read as it is, also one that was cut off: unlike a log's, it is not left out."""
    columns = read_columns(file, layouts.ANGLE.required(), layouts.ANGLE.header(), mend=False)
    return Angle(columns.rising_times(), columns.finite("c_deg"))


def places_of(recording: Recording, known: Angle) -> Places:
    """Averages marker and motor positions over each rest in `known`: the motor over STANDS_S from the rest's time on,
    the marker over that span less its first SETTLES_S. TautError where there is no marker, there are fewer than
    _LEAST_PLACES rests, or in a rest the motor moves, has no log, or the marker is hardly seen."""
    marker, motor = recording.marker, recording.motor
    if marker is None:
        raise TautError(f"{recording.name}: holds no marker: record a video of the motion, or a marker.csv")
    if len(known.t_s) < _LEAST_PLACES:
        raise TautError(f"{len(known.t_s)} known angles, {_LEAST_PLACES} are needed, better 8: add rows to the file")
    travel = float(np.ptp(motor.q))
    image, sigma, q = [], [], []
    for t_s, c_deg in zip(known.t_s.tolist(), known.c_deg.tolist(), strict=True):
        resting = (motor.t_s >= t_s) & (motor.t_s <= t_s + STANDS_S)
        seen = (marker.t_s >= t_s + SETTLES_S) & (marker.t_s <= t_s + STANDS_S) & marker.valid
        what = f"{recording.name}: the rest at {t_s:g} s, {c_deg:g} deg,"
        if resting.sum() < 2:
            raise TautError(f"{what} lies outside of the motor's log: are the times those of its clock?")
        if np.ptp(motor.q[resting]) > _MOVES * travel:
            raise TautError(f"{what} is none: the motor moves in the {STANDS_S:g} s after it; say when it has stopped")
        if seen.sum() < _LEAST_FRAMES:
            raise TautError(f"{what} shows the marker in {seen.sum()} frames: it has to be in the picture there")
        uv = np.column_stack([marker.u_px[seen], marker.v_px[seen]])
        image.append(uv.mean(axis=0))
        # Standard deviation of the mean, from the variance of u and v together.
        sigma.append(float(np.sqrt(uv.var(axis=0, ddof=1).mean() / seen.sum())))
        q.append(float(motor.q[resting].mean()))
    return Places(known.c_deg, np.array(image), np.array(sigma), np.array(q))


def fit_coarse_law(places: Places) -> tuple[Coarse, float]:
    """Fits the coarse law c = gain q + offset (deg, unit of q) to the places by least squares. Returns it and the rms
    of its residual, deg, which play and curvature add to. TautError where the motor stood at one place."""
    if np.ptp(places.q) <= 0.0:
        raise TautError("the motor stood at one place for all known angles: is the log that of the motion?")
    gain, offset = np.polyfit(places.q, places.c_deg, 1)
    residual = places.c_deg - gain * places.q - offset
    return Coarse(float(gain), float(offset)), float(np.sqrt(np.mean(residual**2)))
