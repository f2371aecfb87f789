"""The paper's experiments in small: the claims that its figures make hold on the simulated instruments."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))
from tools.paper import experiments, scenes
from tools.paper.__main__ import page


def ours(experiment: experiments.Experiment) -> dict[str, list[float]]:
    return {row.what: [float(number) for number in re.findall(r"\d+\.?\d*", row.ours)] for row in experiment.rows}


@pytest.mark.long
def test_fig7_onsets_are_right_where_the_pose_is_not() -> None:
    found = ours(experiments.fig7(seed=5))
    assert found["two steps: mean |error| (deg)"][0] < 0.07
    assert found["two steps: std (deg)"][0] < 0.05
    assert found["one step: mean |error| (deg)"][0] > 4.0


def test_fig7_scene_is_the_papers() -> None:
    recording = scenes.fig7_recording(seed=1)
    turns = np.diff(np.sign(np.diff(recording.motor.q_cmd)[np.diff(recording.motor.q_cmd) != 0]))
    assert np.sum(turns != 0) <= 80
    # the frame clock and the strokes share no period: the phases of the reversals in their frames are spread evenly
    q = recording.motor.q_cmd
    at = recording.motor.t_s[1:-1][np.diff(np.sign(np.diff(q))) != 0]
    assert recording.marker is not None
    phase = np.sort(np.mod(at - recording.marker.t_s[0], 0.04) / 0.04)
    assert np.diff(np.concatenate([phase, [phase[0] + 1]])).max() < 0.15


def test_figs_8_and_9() -> None:
    fig8, fig9 = (ours(experiment) for experiment in experiments.fig8_and_9(seed=5, reversals=16))
    assert fig8["B(q), rms error (um)"][0] < fig8["B(q), rms error with the paper's 14 knots (um)"][0]
    assert fig9["f_remain, rms error, direct fit (deg)"][0] < 0.1
    assert fig9["f_remain, rms error, morphological (deg)"][0] < 0.5 * fig9["f_coarse, rms error (deg)"][0]


def test_table1_each_part_of_the_model_gains() -> None:
    found = ours(experiments.table1(seed=5, reversals=16, cycles=6))
    x = [found[f"{stage}: Qx (px), mean ± std, max"][0] for stage in experiments.STAGES]
    y = [found[f"{stage}: Qy (px), mean ± std, max"] for stage in experiments.STAGES]
    assert x[2] < 0.2 * x[0] and x[2] < 0.2 * x[1]
    assert y[2][0] == pytest.approx(34, abs=6) and y[2][1] < 3  # the registration's error stays, and is steady
    assert found["f_remain + B, right registration: rms per coordinate (px)"][0] < 0.1


def test_fig12_the_inverse_makes_the_ellipse() -> None:
    experiment = experiments.fig12(seed=5, reversals=16)
    assert ours(experiment)["times smaller"][0] > 20
    assert "data:image/svg+xml" in page([experiment])


def test_the_ellipse_is_reached_by_an_instrument_without_backlash() -> None:
    rig = scenes.bench().plant.rig
    goal = experiments.ellipse(rig, 200)
    tip = experiments.realised(rig, goal, goal.c_deg)
    np.testing.assert_allclose(tip, goal.point, atol=1e-4)
    assert np.ptp(goal.c_deg) > 20 and np.ptp(goal.rotation_deg) > 30 and np.ptp(goal.translation_mm) > 1
