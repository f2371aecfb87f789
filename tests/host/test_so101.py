"""Real joints with a servo's lag: calibrated on one motion, unseen ones predicted beside a constant play."""

import numpy as np
import pytest
from tools.so101 import Calibrated, find

from tautline.recording import load
from tautline.rig import Rig

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
    print(f"delay {1e3 * made.found.model.delay_s:.0f} ms, {np.round(ratios, 2)} times the constant play's error")
    assert abs(made.found.model.delay_s - made.delay_s) < 0.01
    assert max(ratios) < 1.5 and np.median(ratios) < 1.2


def test_a_command_that_steps_is_refused():
    folder = data()
    rig = Rig.load(folder / "rig.toml")
    assert Calibrated.on(load(folder / "rotation-prbs-excitation", rig), rig).refused.startswith("steps")
