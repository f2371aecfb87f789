"""Real joints with a servo's lag: calibrated on one motion, unseen ones predicted beside a constant play."""

import numpy as np
import pytest

from tautline.calibration.calibrate import calibrate
from tautline.diagnosis import narration
from tautline.diagnosis.diagnose import diagnose
from tautline.recording import load
from tautline.rig import Rig
from tools.real import DELAY, JOINT, LAG, late_s, rigid
from tools.so101 import Calibrated, constant_play, find

UNSEEN = ("rotation-symmetric-motion", "rotation-friction-gravity", "rotation-oscillation-med-freq")


def data():
    found = find()
    if found is None:
        pytest.skip("no shared/data/so101 beside the repository: see tools/so101.py")
    return found


def test_unseen_motions_within_1_5_times_a_constant_play():
    folder = data()
    rig = Rig.load(folder / "rig.toml")
    made = Calibrated.on(load(folder / "rotation-single-joint-rotation", rig), rig)
    rms = [made.rms(load(folder / name, rig)) for name in UNSEEN]
    ratios = [r["tautline"] / r["play"] for r in rms]
    print(f"delay {1e3 * made.calibration.model.delay_s:.0f} ms, {np.round(ratios, 2)} times the constant play's error")
    assert abs(made.calibration.model.delay_s - made.delay_s) < 0.01
    assert max(ratios) < 1.5 and np.median(ratios) < 1.2


def test_a_command_that_steps_is_refused():
    folder = data()
    rig = Rig.load(folder / "rig.toml")
    assert Calibrated.on(load(folder / "rotation-prbs-excitation", rig), rig).refused.startswith("steps")


@pytest.mark.long
def test_what_a_rigid_simulator_lacks_is_a_servos_delay():
    """The simulated joint is where it is told to be; the play that the real one has too is named beside the delay."""
    folder = data()
    rig = Rig.load(folder / "rig.toml")
    robot = load(folder / JOINT[0], rig)
    simulated = rigid(robot, rig)
    found = diagnose(calibrate([simulated], rig).model, simulated, [robot])
    own = constant_play(robot)[0]  # what fits it best, beside a play of its own
    print(f"{narration.text(found.document, 'out')}\n{1e3 * late_s(found.document):.0f} ms, its own {1e3 * own:.0f} ms")
    first = found.document["effects"][0]["id"]
    assert first in (LAG, DELAY), found.document["candidates"][:3]
    assert late_s(found.document) == pytest.approx(own, abs=0.01)
    assert found.document["gap"]["shrink"] > 0.9
    assert found.document["noise_floor"] > 0.02  # the sensor counts in 0.088 deg; a simulator's 0 is no floor


@pytest.mark.long
def test_motions_of_several_sizes_lead_to_a_lag_or_delay():
    """At one size a width that differs from place to place is as good as a delay; together they tell."""
    folder = data()
    rig = Rig.load(folder / "rig.toml")
    robot = [load(folder / name, rig) for name in JOINT]
    simulated = rigid(robot[0], rig)
    document = diagnose(calibrate([simulated], rig).model, simulated, robot).document
    assert document["effects"], document["candidates"][:3]
    first = document["effects"][0]
    assert {first["id"], *first["ambiguous_with"]} <= {LAG, DELAY}
    assert 0.06 < late_s(document) < 0.16
