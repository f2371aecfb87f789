"""Strokes of two or three frames: no single reversal shows an onset, and all of them together tell B."""

import numpy as np

from tautline.calibration.calibrate import calibrate
from tautline.simulated.instrument import preset, reference_rig
from tautline.simulated.simulate import run as simulated
from tautline.trajectory import back_and_forth


def test_where_no_reversal_shows_an_onset_b_is_judged_by_what_it_predicts():
    rig = reference_rig()
    run = simulated(
        rig, preset("reference", rig), back_and_forth(rig.actuator, [15.0], 0.9, 200, 160.0), noise_px=0.05, seed=3
    )
    found = calibrate([run.recording], rig)
    model = found.model
    inside = (model.q >= model.measured[0]) & (model.q <= model.measured[1])
    off = (model.width - np.interp(model.q, run.instrument.grid, run.instrument.width))[inside]
    (reason,) = model.quality.reasons
    assert "showed an onset" in reason.says and reason.mild and model.quality.verdict == "good"
    assert np.sqrt(np.mean(off**2)) < 2.0 * np.median(model.width_sigma[inside])
