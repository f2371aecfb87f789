"""Frames of different quality: what the marker's own sigma says must not look like motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tautline import trajectory
from tautline.calibrate import calibrate
from tautline.instrument import preset
from tautline.recording import Recording
from tautline.simulate import simulate


def _recording() -> Recording:
    instrument = preset("reference")
    motion = trajectory.back_and_forth(instrument.rig.actuator, [1.0], 1.6, 20, 8.0)
    return simulate(instrument.rig, instrument, motion, noise_px=0.02, seed=31)


def test_a_sigma_that_differs_from_frame_to_frame_leaves_the_onsets_where_they_are() -> None:
    recording = _recording()
    marker = recording.marker
    assert marker is not None and recording.rig is not None
    rng = np.random.default_rng(5)
    uneven = replace(marker, sigma_px=0.02 * rng.uniform(0.7, 1.4, len(marker.t_s)))
    even = calibrate([recording], recording.rig)
    found = calibrate([replace(recording, marker=uneven)], recording.rig)
    widths = [np.array([o.width for o in c.onsets]) for c in (even, found)]
    assert len(widths[0]) == len(widths[1]) and all(o.used for o in found.onsets)
    assert np.abs(widths[0] - widths[1]).max() < 0.003


def test_a_poor_frame_that_says_so_is_left_out() -> None:
    recording = _recording()
    marker = recording.marker
    assert marker is not None and recording.rig is not None
    rng = np.random.default_rng(6)
    poor = rng.random(len(marker.t_s)) < 0.04
    u = marker.u_px + np.where(poor, rng.normal(0.0, 1.5, len(poor)), 0.0)
    sigma = np.where(poor, 1.5, 0.02)
    found = calibrate([replace(recording, marker=replace(marker, u_px=u, sigma_px=sigma))], recording.rig)
    truth = preset("reference")
    errors = [o.width - float(truth.backlash(np.array([o.q_mean]))[0]) for o in found.onsets if o.used]
    assert len(errors) >= 0.9 * len(found.onsets)
    assert float(np.sqrt(np.mean(np.square(errors)))) < 0.004
