"""f_remain is that of the session's end: what is not known of how it got there is in its sigma."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tautline.calibration import measuring
from tautline.calibration.calibrate import calibrate
from tautline.simulated.instrument import preset, reference_rig
from tautline.simulated.simulate import simulate
from tautline.trajectory import back_and_forth

RIG = reference_rig()
TRUE = preset("reference", RIG)
WANDER_PX = 0.054  # of the image, over the whole session


def session(seed: int):
    """A recording in which the image wanders slowly along u, by three half waves of the session."""
    seen = simulate(RIG, TRUE, back_and_forth(RIG.actuator, (4.0, 8.0), 3.0, 8, 40.0), seed=seed, name="wanders")
    waves = np.arange(1, 4)
    size = np.random.default_rng(seed + 100).normal(size=3) / waves
    along = (seen.marker.t_s - seen.marker.t_s[0]) / np.ptp(seen.marker.t_s)
    off = WANDER_PX * np.sin(np.pi * np.outer(along - 0.3, waves)) @ size
    return replace(seen, marker=replace(seen.marker, u_px=seen.marker.u_px + off))


@pytest.fixture(scope="module")
def ended():
    """A calibration in which such a state was found, with what fit_remaining was given and gave."""
    calls: list = []
    own = measuring.fit_remaining

    def watched(*given):
        calls.append((given, own(*given)))
        return calls[-1][1]

    measuring.fit_remaining = watched
    try:
        model = calibrate([session(4)], RIG).model
    finally:
        measuring.fit_remaining = own
    return model, *calls[-1]


def test_what_is_not_known_of_the_change_is_in_the_sigma(ended):
    """Each error that all frames share, put into what they show, moves f_remain by as much as the sigma has for it."""
    model, given, found = ended
    tracks, shared = given[0], given[-1]
    alone = measuring.fit_remaining(*given[:-1], ())
    inside = (model.q > model.measured[0]) & (model.q < model.measured[1])
    moved = np.zeros(inside.sum())
    for k in range(shared[0].shape[2]):
        shifted = [replace(track, y=track.y + by[:, :, k]) for track, by in zip(tracks, shared, strict=True)]
        again = measuring.fit_remaining(shifted, *given[1:-1], ())
        moved += (again.c_deg - alone.c_deg)[inside] ** 2
    told = found.sigma_deg[inside] ** 2 - alone.sigma_deg[inside] ** 2
    assert np.sqrt(told.mean()) > 0.1 * np.sqrt(np.mean(alone.sigma_deg[inside] ** 2))
    assert np.sqrt(told.mean()) == pytest.approx(np.sqrt(moved.mean()), rel=0.05)  # smoothing is found anew each time
