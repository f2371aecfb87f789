"""A simulator as the nominal of a diagnosis: what it shows under the robots' own motions stands for a calibration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from tautline import effects
from tautline.errors import TautError
from tautline.model import Model
from tautline.recording import Angle, Marker, Recording
from tautline.rig import ANGLE, MARKER, Rig
from tautline.simulators.drive import Drive
from tautline.simulators.simulator import Simulator

_POINTS = 257  # tolerance: of the model's tables


@dataclass(frozen=True)
class StepError:
    """The error of a simulator that integrates with too long a step of time."""

    own_s: float  # its own step
    enough_s: float  # a step at which it would err by no more than what a sound calibration leaves
    error: float  # rms at its own, px or deg, of the recording in which it is largest
    noise: float  # of the sensor, in the same unit
    unit: str

    def to_json(self) -> dict[str, Any]:
        """The object `simulator.step` of diagnosis.json."""
        return asdict(self)


@dataclass(frozen=True)
class SimulatedNominal:
    """What a diagnosis takes in place of a calibrated model."""

    model: Model  # no backlash, f_remain = f_coarse, over the simulated tip's coordinate
    calibration: Recording  # what the simulator shows under the first robot's motion
    tests: tuple[Recording, ...]  # the robot's, with the simulated tip's coordinate in the motor's place
    drives: tuple[Drive, ...]  # of the calibration, then of each test
    simulator: Simulator
    step: StepError | None = None  # where the simulator is another one than the user's in its step of time

    @property
    def kinds(self) -> tuple[effects.Kind, ...]:
        """The effects that the diagnosis may name: one for each parameter of the simulator, whose value is 0 where the
        robot is as the simulator."""
        return tuple(
            effects.of_simulator(p.name, p.unit, p.spread, low=p.low - p.nominal, high=p.high - p.nominal)
            for p in self.simulator.parameters
        )

    def to_json(self, named: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """The object `simulator` of diagnosis.json: the source, the parameters that the diagnosis names, with their
        values in the simulator and on the robot, and the StepError if there is one. named: the effects of
        diagnosis.json."""
        changes = {name: value for effect in named for name, value in effect["parameters"].items()}
        return {
            "source": dict(self.simulator.source),
            "parameters": [
                {"name": p.name, "unit": p.unit, "nominal": p.nominal, "value": p.nominal + changes[key]}
                for p in self.simulator.parameters
                if (key := effects.simulator_id(p.name)) in changes
            ],
            **({} if self.step is None else {"step": self.step.to_json()}),
        }


def nominal(
    simulator: Simulator, robots: Sequence[Recording], rig: Rig, pool: Executor | None = None
) -> SimulatedNominal:
    """What a diagnosis compares the robots' recordings with, from a simulator instead of a calibration. Markers are
    compared if the rig has a camera and all recordings have a marker, else angles. All recordings are simulated, side
    by side with a pool of side_by_side.pool. TautError where there is no recording, one lacks what is compared, or the
    simulator fails."""
    if not robots:
        raise TautError("name at least one recording of the robot")
    by_marker = rig.has_camera and all(robot.marker is not None for robot in robots)
    if not by_marker and any(robot.angle is None for robot in robots):
        raise TautError("a simulator is compared with marker.csv (or a video) in every recording, or with angle.csv")
    drives = [Drive(simulator, robot.motor, rig, pool) for robot in robots]
    for drive in drives:
        drive.ask({})  # so that all are simulated at once, where there is a pool
    tests = [replace(robot, motor=drive.motor({})) for robot, drive in zip(robots, drives, strict=True)]
    model = _backlash_free_model(simulator, rig, by_marker)
    calibration = replace(_simulated_recording(model, tests[0], by_marker), name="simulator")
    return SimulatedNominal(
        model, calibration, tests=tuple(tests), drives=(drives[0], *drives), simulator=simulator
    )  # fmt: skip


def _backlash_free_model(simulator: Simulator, rig: Rig, by_marker: bool) -> Model:
    """A model of the rig without backlash, whose f_remain is f_coarse, over the simulated tip's coordinate: so all that
    the tip does beyond f_coarse comes from the simulator."""
    low, high = rig.actuator.range
    q = np.linspace(low, high, _POINTS)
    sensor = MARKER if by_marker else ANGLE
    return Model(
        rig=rig,
        q=q,
        width=np.zeros(_POINTS),
        width_sigma=np.zeros(_POINTS),  # a simulator's own chain is known
        c_deg=rig.coarse.gain * q + rig.coarse.offset,
        delay_s=rig.nominal_delay_s(sensor),
        measured=(low, high),
        sensor=sensor,
        simulator=dict(simulator.source),
    )


def _simulated_recording(model: Model, test: Recording, by_marker: bool) -> Recording:
    """The recording `test` with the simulator's marker or angle, at the same times and without noise, in place of what
    the robot's sensor saw; without video."""
    seen = test.marker if by_marker else test.angle
    assert seen is not None  # nominal has looked
    path = effects.simulate(model, test.motor, seen.t_s - model.delay_s, {})
    if not by_marker:
        return replace(test, marker=None, angle=Angle(seen.t_s, path.c_deg), video=None)
    u, v = path.image_px.T
    return replace(test, marker=Marker(seen.t_s, u, v, np.isfinite(u)), angle=None, video=None)
