"""Recordings made ready for fitting: what was observed, when, under which motion, and what may be scored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline import effects
from tautline.core.motor import MotorPath
from tautline.core.samples import least_noise, noise_of, repeats, strays
from tautline.core.session import SessionClock
from tautline.effects import Path
from tautline.encoder import with_few_knots
from tautline.errors import TautError
from tautline.model import Model
from tautline.prediction import settled_from
from tautline.recording import Motor, Recording
from tautline.rig import ANGLE, MARKER, Sensor
from tautline.simulators.drive import Drive

Array = npt.NDArray[np.float64]

_CONTINUOUS = 0.9  # tolerance: share of distinct values from which a sensor does not count in steps
_FEWEST = 8  # tolerance: scored observations of a recording: of fewer `noise_of` tells no noise
_UNSEEN = 0.3  # tolerance: of the noise, by which a first fit's straight lines may be off
_ANGLES = 6000  # tolerance: samples of an angle sensor that are enough: of twice as many every second is taken


@dataclass(frozen=True)
class Segment:
    """One recording as it is fitted. Observations (n, k): k = 2 px from the marker or k = 1 deg from the angle."""

    name: str
    motor: Motor  # the motor's path, its samples the knots of straight lines
    arrival_s: Array  # (n,) when each observation arrived, on the recording's clock
    observed: Array  # (n, k)
    scored: npt.NDArray[np.bool_]  # (n,) whether it counts: once the tip was driven through B in both directions
    offset_s: float  # added to the recording's times to get the session's
    calibration: bool  # whether the model was calibrated on it
    number: int = 1  # the recording's index in the session, the calibration 0
    repeats: npt.NDArray[np.bool_] | None = None  # (n,) not scored only because they repeat the one before
    drive: Drive | None = None  # of a simulator that stands in the motor's place

    @property
    def held(self) -> npt.NDArray[np.bool_]:
        """(n,) Which observations would be scored if they did not repeat the one before to the last digit; all False
        where this is not known."""
        return np.zeros_like(self.scored) if self.repeats is None else self.repeats

    @property
    def end_s(self) -> float:
        """The time at which the recording ends, s on the session's clock."""
        return float(self.motor.t_s[-1]) + self.offset_s

    @property
    def unit(self) -> str:
        """The unit of the observations, "px" or "deg"."""
        return "px" if self.observed.shape[1] == 2 else "deg"

    @property
    def sensor(self) -> Sensor:
        """The sensor that made the observations: MARKER (a camera) or ANGLE."""
        return MARKER if self.unit == "px" else ANGLE

    def with_repeats(self) -> Segment:
        """The same recording with repeated samples scored like all others, as if nothing were known of them."""
        return replace(self, scored=self.scored | self.held, repeats=None)

    @property
    def session_s(self) -> Array:
        """(n,) Arrival time of each observation, s on the session's clock."""
        return np.asarray(self.arrival_s + self.offset_s)

    def scene_s(self, model: Model, parameters: Mapping[str, Any]) -> Array:
        """(n,) Time at which each observation's scene was as it shows, s on the session's clock: its arrival less the
        sensor's delay and the effect "delay". An effect on the clock's rate is not taken off. parameters: as for
        `follow`."""
        return np.asarray(self.session_s - (model.delay_of(self.sensor) + parameters.get("delay", 0.0)))

    def ask(self, parameters: Mapping[str, Any]) -> None:
        """Announces to a user's simulator, if there is one, that `follow` will be called with these parameters, so that
        it can run several at once."""
        if self.drive is not None:
            self.drive.ask(parameters)

    def follow(self, model: Model, parameters: Mapping[str, Any], load_reference: float) -> Path:
        """Simulates the path of the tip at the observations' scene times (arrival less the sensor's delay). parameters:
        of the effects, by name; those of a user's simulator are changes from its nominal values. load_reference: mNm at
        which the model's tables hold."""
        scene = self.arrival_s - model.delay_of(self.sensor)
        motor = self.motor if self.drive is None else self.drive.motor(parameters)
        return effects.follow(
            model, motor, scene, parameters, load_reference=load_reference, clock_offset_s=self.offset_s
        )

    def seen(self, model: Model, parameters: Mapping[str, Any], path: Path) -> Array:
        """(n, k) What the sensor would show of this path, with these effects' parameters: px for a marker, else deg."""
        return effects.image(model, path, parameters, self.offset_s) if self.unit == "px" else path.c_deg[:, None]

    def predict(self, model: Model, parameters: Mapping[str, Any], load_reference: float) -> tuple[Path, Array]:
        """(The simulated path, the predicted observations (n, k)); arguments as for `follow`."""
        path = self.follow(model, parameters, load_reference)
        return path, self.seen(model, parameters, path)

    def coarse(self, stride: int, noise: float) -> Segment:
        """The same recording with every `stride`-th observation, and with fewer motor samples: straight lines between
        them are off by so little that it does not show beside `noise`, one standard deviation of an observation, px or
        deg."""
        kept = slice(None, None, stride)
        few = {name: getattr(self, name)[kept] for name in ("arrival_s", "observed", "scored")}
        reach = float(np.linalg.norm(np.ptp(self.observed[self.scored], axis=0)))
        motor = with_few_knots(self.motor, _UNSEEN * noise / max(reach, noise))
        return replace(self, **few, motor=motor, repeats=self.held[kept])

    def part(self, keep: npt.NDArray[np.bool_]) -> Segment:
        """The same recording; only observations that were scored already and for which `keep` (n,) is true stay
        scored."""
        return replace(self, scored=self.scored & keep)


def with_noise(simulated: Segment, noise: float) -> Segment:
    """A simulator's recording with white noise added (fixed seed), as the robot's recordings have noise and a
    difference in it would look like an effect. noise: one standard deviation, px or deg."""
    added = np.random.default_rng(0).normal(0.0, noise, simulated.observed.shape)
    return replace(simulated, observed=simulated.observed + added)


def load_reference(calibration: Recording) -> float:
    """The load, mNm, at which a model calibrated on this recording holds: the recording's median load, 0 where none was
    recorded."""
    load = calibration.motor.load_mNm
    return 0.0 if load is None else float(np.median(load))


def prepare(
    model: Model, calibration: Recording, tests: Sequence[Recording], drives: Sequence[Drive] = ()
) -> list[Segment]:
    """Makes a segment of each recording, the calibration first: of markers (px) where every recording has one and the
    rig a camera, else of angles (deg). drives: one for each recording, where a user's simulator stands in the motor's
    place. Observations that only repeat the one before are not scored. TautError where recordings lack a sensor, or one
    of them has too few observations to score."""
    recordings = [calibration, *tests]
    by_marker = model.rig.has_camera and all(recording.marker is not None for recording in recordings)
    if not by_marker and not all(recording.angle is not None for recording in recordings):
        raise TautError("diagnose needs marker.csv (or a video) in every recording, or angle.csv in every one")
    segments = []
    for i, (recording, offset) in enumerate(zip(recordings, SessionClock.of(recordings).offset_s, strict=True)):
        drive = drives[i] if drives else None
        if drive is None:
            path = MotorPath.of(recording.motor, model.rig.actuator.encoder_resolution)
        else:
            path = MotorPath(recording.motor, recording.motor)  # simulated: straight lines between its samples
        motor = path.lines
        arrival_s, observed, again = (_marker_observations if by_marker else _angle_observations)(recording, path)
        scene_s = arrival_s - model.delay_of(MARKER if by_marker else ANGLE)
        settled = (scene_s >= settled_from(model, recording.motor)) & (scene_s <= motor.t_s[-1])
        scored = settled & ~again
        _check_scored(recording.name, settled, scored)
        segments.append(
            Segment(
                recording.name, motor, arrival_s, observed, scored, offset_s=offset, calibration=i == 0, number=i,
                repeats=settled & again, drive=drive,
            )
        )  # fmt: skip
    return segments


def _check_scored(name: str, settled: npt.NDArray[np.bool_], scored: npt.NDArray[np.bool_]) -> None:
    """Raises TautError, with the recording's name, where too few observations are `scored` (n,). settled (n,): which of
    them show the tip after it was driven through B both ways."""
    if not settled.any():
        raise TautError(
            f"{name}: the tip is never driven through a full backlash both ways while it is seen: "
            "record a motion with strokes longer than the backlash"
        )
    if int(scored.sum()) < _FEWEST:
        raise TautError(
            f"{name}: only {int(scored.sum())} new readings of the sensor once the tip was driven through a full "
            f"backlash both ways, and {_FEWEST} are needed: record for longer, or see whether the sensor stands still"
        )


def _marker_observations(recording: Recording, path: MotorPath) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
    """(Arrival times (n,), s; positions of the marker (n, 2), px; whether each repeats the one before (n,)), only of
    valid frames. path: of the motor meanwhile."""
    marker = recording.marker
    assert marker is not None
    good = np.asarray(marker.valid, dtype=bool) & np.isfinite(marker.u_px) & np.isfinite(marker.v_px)
    return _without_strays(path, marker.t_s[good], np.column_stack([marker.u_px, marker.v_px])[good], "px")


def _angle_observations(recording: Recording, path: MotorPath) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
    """(Arrival times (n,), s; angles (n, 1), deg; whether each repeats the one before (n,)). Of more than 2 _ANGLES
    readings every n-th is kept, so that _ANGLES to 2 _ANGLES are left. path: of the motor meanwhile."""
    angle = recording.angle
    assert angle is not None
    times, observed, again = _without_strays(path, angle.t_s[angle.seen], angle.c_deg[angle.seen, None], "deg")
    stride = max(1, len(times) // _ANGLES)
    # Of those that repeat one and of the others as large a part: a link may repeat as regularly.
    kept = np.sort(np.concatenate([np.flatnonzero(again)[::stride], np.flatnonzero(~again)[::stride]]))
    return times[kept], observed[kept], again[kept]


def _without_strays(
    path: MotorPath, times: Array, observed: Array, unit: str
) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
    """(Times (n,), s; observations (n, k); whether each repeats the one before (n,)), without observations so far off
    that they are no readings of the tip (`strays`). path: of the motor meanwhile; unit: "px" or "deg"."""
    again = are_repeats(observed)
    fresh = np.flatnonzero(~again)
    noise = noise_of(times[fresh], observed[fresh], least_noise(unit))
    kept = np.ones(len(times), dtype=bool)
    kept[fresh[strays(path, times[fresh], observed[fresh], noise)]] = False
    return times[kept], observed[kept], again[kept]


def are_repeats(observed: Array) -> npt.NDArray[np.bool_]:
    """(n,) Whether each observation (n, k) equals the one before to the last digit, so that the link has sent it twice.
    All False for a sensor that counts in steps, as such a reading may stay the same by itself."""
    again = repeats(observed)
    fresh = observed[~again]
    continuous = all(len(np.unique(column)) > _CONTINUOUS * len(fresh) for column in fresh.T)
    return again if continuous else np.zeros_like(again)
