"""What counts of a first approach, before the tip was driven both ways: where it foretells what comes later."""

from dataclasses import replace

import numpy as np
import pytest
from angle_plant import RIG, Motion, record

from tautline.calibration import smooth
from tautline.calibration.observations import observe
from tautline.calibration.playfit import NODES
from tautline.calibration.simulated_track import PreparedTrack
from tautline.calibration.smooth import Domain, fit_jointly, prepare_tracks

TURNS = (-40, 35, -30, 25, -35, -5, -25, 10, -10, 35, 0, 20, -35, 35, -35)  # it comes from farther than it ever returns


def fitted(off_deg: float, noise: float = 0.03):
    """With a tip that is off by so much until the motor turns for the first time."""
    motion = Motion.through(TURNS)
    made = record(motion, noise=noise)
    early = made.angle.t_s < motion.t_s[int(np.argmax(motion.q))]
    made = replace(made, angle=replace(made.angle, c_deg=made.angle.c_deg + off_deg * early))
    low, high = RIG.actuator.range
    return fit_jointly(prepare_tracks(observe([made], RIG), 0.0), Domain(low, high), 0.0, fit_delay=False)


def test_an_approach_on_the_same_curves_counts() -> None:
    assert not fitted(0.0).fit.settled_only


@pytest.mark.parametrize("off_deg", [0.08, -0.08])
def test_an_approach_that_misleads_later_strokes_does_not(off_deg: float) -> None:
    assert fitted(off_deg).fit.settled_only


def test_a_width_of_nothing_at_the_start_is_not_driven_through_at_once() -> None:
    """The encoder trembles where the motor begins; B there is what a spline makes of it."""
    motion = Motion.through((-35, 30, -20, 20))
    trembles = 0.03 * np.sin(2 * np.pi * 20 * motion.t_s) * (motion.t_s < 0.5)
    track = observe([record(Motion(motion.t_s, motion.q + trembles))], RIG)[0]
    grid = np.linspace(-40.0, 40.0, NODES)
    width = np.clip(1.8 * (grid + 35.0), 0.0, 2.0)
    settled = PreparedTrack.of(track).simulate(grid, width, 0.0).settled
    turned = motion.t_s[int(np.argmax(motion.q))]
    assert settled.any() and track.t_s[settled][0] == pytest.approx(turned + 2.0 / 8.0, abs=0.02)


@pytest.mark.parametrize("frames", [5_900, 13_000, 130_000])
def test_a_fit_begins_with_thousands_of_frames_however_many_there_are(frames: int) -> None:
    """Of 130,000 that count one in eleven, and one in 43 of all were 275."""
    motion = Motion.through()
    tracks = observe([record(motion, sensor_hz=frames / motion.t_s[-1])], RIG)
    begin = smooth._thinned(prepare_tracks(tracks, 0.0))
    assert 2_900 < sum(np.count_nonzero(each.use) for each in begin) < 6_000
