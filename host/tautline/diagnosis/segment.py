"""Recordings made ready for fitting: what was observed, when, under which motion, and what may be scored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline import effects
from tautline.core.motor import MotorPath
from tautline.core.session import SessionClock
from tautline.effects import Path
from tautline.errors import TautError
from tautline.model import Model
from tautline.prediction import settled_from
from tautline.recording import Motor, Recording
from tautline.rig import ANGLE, MARKER, Sensor
from tautline.simulators.drive import Drive

Array = npt.NDArray[np.float64]

_CONTINUOUS = 0.9  # tolerance: share of a sensor's fresh values that no other is equal to


@dataclass(frozen=True)
class Segment:
    """One recording. Observations (n, k): k = 2 px from the marker or k = 1 deg from the angle."""

    name: str
    motor: Motor  # between the encoder's counts; knots of straight lines
    arrival_s: Array  # (n,)
    observed: Array  # (n, k)
    scored: npt.NDArray[np.bool_]  # (n,) after a full backlash in both directions
    offset_s: float  # added to the recording's times to get the session's
    calibration: bool
    number: int = 1  # of the recording, the calibration is 0
    repeats: npt.NDArray[np.bool_] | None = None  # (n,) that would be scored were they no repetition of the one before
    drive: Drive | None = None  # of a simulator that stands in the motor's place

    @property
    def held(self) -> npt.NDArray[np.bool_]:
        """(n,) Observations that would be scored did they not repeat the one before."""
        return np.zeros_like(self.scored) if self.repeats is None else self.repeats

    @property
    def end_s(self) -> float:
        """Of the recording, on the session's clock."""
        return float(self.motor.t_s[-1]) + self.offset_s

    @property
    def unit(self) -> str:
        return "px" if self.observed.shape[1] == 2 else "deg"

    @property
    def sensor(self) -> Sensor:
        return MARKER if self.unit == "px" else ANGLE

    def ask(self, parameters: Mapping[str, Any]) -> None:
        """Announces that `follow` will be called with these parameters, so that a simulator can run several at once."""
        if self.drive is not None:
            self.drive.ask(parameters)

    def follow(self, model: Model, parameters: Mapping[str, Any], load_reference: float) -> Path:
        """The tip's path at the observations. parameters: of effects, by name; with a simulator its own, as changes.
        load_reference: mNm at which the model's tables hold."""
        scene = self.arrival_s - model.delay_of(self.sensor)
        motor = self.motor if self.drive is None else self.drive.motor(parameters)
        return effects.follow(
            model, motor, scene, parameters, load_reference=load_reference, clock_offset_s=self.offset_s
        )

    def seen(self, model: Model, parameters: Mapping[str, Any], path: Path) -> Array:
        """(n, k) What the sensor shows of this path: px with a marker, else deg."""
        return effects.image(model, path, parameters, self.offset_s) if self.unit == "px" else path.c_deg[:, None]

    def predict(self, model: Model, parameters: Mapping[str, Any], load_reference: float) -> tuple[Path, Array]:
        """The path at the observations and the prediction (n, k)."""
        path = self.follow(model, parameters, load_reference)
        return path, self.seen(model, parameters, path)

    def every(self, stride: int) -> Segment:
        """The same recording with every `stride`-th observation."""
        kept = slice(None, None, stride)
        few = {name: getattr(self, name)[kept] for name in ("arrival_s", "observed", "scored")}
        return replace(self, **few, repeats=self.held[kept])

    def part(self, keep: npt.NDArray[np.bool_]) -> Segment:
        """The same recording, scored only where `keep` (n,) is true."""
        return replace(self, scored=self.scored & keep)


def sensed(simulated: Segment, noise: float) -> Segment:
    """A simulator's recording with white noise of this standard deviation added (fixed seed): without, it would be told
    from the robot by its noise alone."""
    off = np.random.default_rng(0).normal(0.0, noise, simulated.observed.shape)
    return replace(simulated, observed=simulated.observed + off)


def load_reference(calibration: Recording) -> float:
    """The load, mNm, at which a model calibrated on this recording holds: its median, 0 where none was recorded."""
    load = calibration.motor.load_mNm
    return 0.0 if load is None else float(np.median(load))


def prepare(
    model: Model, calibration: Recording, tests: Sequence[Recording], drives: Sequence[Drive] = ()
) -> list[Segment]:
    """A segment of each recording, the calibration first: of markers (px) where every recording has one, else of angles
    (deg). drives: one of each recording, if the recordings' motor is a simulator's tip. TautError where a recording
    cannot be scored."""
    recordings = [calibration, *tests]
    by_marker = model.rig.has_camera and all(recording.marker is not None for recording in recordings)
    if not by_marker and not all(recording.angle is not None for recording in recordings):
        raise TautError("diagnose needs marker.csv (or a video) in every recording, or angle.csv in every one")
    segments = []
    for i, (recording, offset) in enumerate(zip(recordings, SessionClock.of(recordings).offset_s, strict=True)):
        drive = drives[i] if drives else None
        path = MotorPath.of(recording.motor, model.rig.actuator.encoder_resolution) if drive is None else None
        motor = path.lines if path else recording.motor
        if by_marker:
            marker = recording.marker
            assert marker is not None
            good = np.asarray(marker.valid, dtype=bool) & np.isfinite(marker.u_px) & np.isfinite(marker.v_px)
            times, observed = marker.t_s[good], np.column_stack([marker.u_px, marker.v_px])[good]
        else:
            angle = recording.angle
            assert angle is not None
            times, observed = angle.t_s[angle.seen], angle.c_deg[angle.seen, None]
        again = repeated(observed)
        if not by_marker:
            stride = max(1, len(times) // 6000)  # tolerance: of more than 12000 samples 6000 or some more are enough
            # Of those that repeat one and of the others as large a part: a link may repeat as regularly.
            kept = np.sort(np.concatenate([np.flatnonzero(again)[::stride], np.flatnonzero(~again)[::stride]]))
            times, observed, again = times[kept], observed[kept], again[kept]
        scene = times - model.delay_of(MARKER if by_marker else ANGLE)
        from_s = settled_from(model, recording.motor)
        within = (scene >= from_s) & (scene <= motor.t_s[-1])
        repeats = within & again
        scored = within & ~repeats
        if not scored.any():
            raise TautError(
                f"{recording.name}: the tip is never driven through a full backlash both ways while it is seen: "
                "record a motion with strokes longer than the backlash"
            )
        segments.append(
            Segment(
                recording.name,
                motor,
                times,
                observed,
                scored,
                offset,
                i == 0,
                i,
                repeats,
                drive,
            )
        )
    return segments


def repeated(observed: Array) -> npt.NDArray[np.bool_]:
    """(n,) Whether each observation (n, k) of a continuous sensor is equal to the one before to the last digit: that is
    a repetition by its link. All false for a sensor that counts in steps, which may rest within one."""
    again = np.zeros(len(observed), dtype=bool)
    again[1:] = (observed[1:] == observed[:-1]).all(axis=1)
    fresh = observed[~again]
    continuous = all(len(np.unique(column)) > _CONTINUOUS * len(fresh) for column in fresh.T)
    return again if continuous else np.zeros_like(again)
