"""A live diagnosis on the simulated board: it asks for motions until it is sure, or says why it stops."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from conftest import Bench
from tautline import trajectory
from tautline.calibration.calibrate import calibrate
from tautline.live.asking import MOTION, SURE, diagnose_live
from tautline.live.setup import Live, PointSource
from tautline.model import Effect
from tautline.simulated import simulate
from tautline.simulated.instrument import Corrected, preset, reference_rig
from tautline.simulated.simlink import SimulatedAxis

pytestmark = pytest.mark.minutes


def test_a_lag_that_came_after_the_calibration_is_asked_for_until_it_is_sure(bench: Bench, tmp_path: Path) -> None:
    rig = reference_rig()
    motion = trajectory.back_and_forth(rig.actuator, [0.8], 2.0, 12, 6.0)
    calibration = simulate.simulate(rig, preset("reference", rig), motion, seed=3)
    found = calibrate([calibration], rig)
    late = Effect("transmission.lag", {"lag": 0.12, "lag_second": 0.0})
    lagging = Corrected(replace(found.model, effects=(late,)), "lagging")
    told: list[str] = []
    with bench.open() as board:
        plant = SimulatedAxis(bench.sim, lagging, 0)
        live = Live(board, rig, 0, PointSource(plant), plant)
        asked = diagnose_live(live, found, calibration, [], tmp_path / "made", most=3, say=told.append)
    print(asked.why, told)
    document = asked.diagnosis.document
    assert document["effects"][0]["id"] == "transmission.lag"
    assert document["effects"][0]["parameters"]["lag"] == pytest.approx(0.12, abs=0.03)
    assert asked.why and len(told) == len(asked.answers) == len(asked.recordings)
    assert asked.sure == (asked.answers[-1].probability >= SURE)
    for i, path in enumerate(asked.recordings, 1):
        assert (path / "motor.csv").exists() and (path / "marker.csv").exists()
        assert (tmp_path / "made" / f"test-{i}-{MOTION}").exists() == (i > 1)
