"""How long a calibration takes, and how good it is, on a simulated recording of the paper's motion."""

from __future__ import annotations

import time

import numpy as np
from threadpoolctl import threadpool_limits

from tautline.calibration.calibrate import calibrate
from tautline.simulated.endoscope import Endoscope
from tautline.simulated.instrument import preset, reference_rig
from tautline.simulated.simulate import run as simulated
from tautline.trajectory import back_and_forth
from tautline.vision.colour import pick
from tautline.vision.marker import MarkerTracker


def run() -> list[tuple[str, float, str]]:
    """(name, value, unit) rows."""
    rig = reference_rig()
    instrument = preset("reference", rig)
    motion = back_and_forth(rig.actuator, [0.5, 1.0], 1.6, 40, 4.0, 0.1)
    recording = simulated(rig, instrument, motion, noise_px=0.05, seed=21).recording
    assert recording.marker is not None
    short = back_and_forth(rig.actuator, [1.0], 1.6, 20, 8.0, 0.1)
    with threadpool_limits(1, "blas"):
        # What is imported or built only once.
        calibrate([simulated(rig, instrument, short, noise_px=0.05, seed=22).recording], rig)
        start = time.process_time()
        model = calibrate([recording], rig).model
        took = time.process_time() - start
    reached = (model.q > model.measured[0]) & (model.q < model.measured[1])
    error = model.width[reached] - instrument.backlash(model.q[reached])

    scope = Endoscope(rig, seed=21)
    frames = [scope.frame(c) for c in np.linspace(-20.0, 20.0, 50)]
    u, v = scope.position(-20.0)[0]
    tracker = MarkerTracker(pick(frames[0], (float(u), float(v))))
    start = time.perf_counter()
    for c in np.linspace(-20.0, 20.0, 50):
        scope.frame(c)
    drawn = time.perf_counter()
    for frame in frames:
        tracker.track(frame)
    return [
        ("recording", motion.duration_s, "s"),
        ("frames in it", float(len(recording.marker.t_s)), ""),
        ("calibration of it", took, "core s"),
        ("error of B, rms", 1e3 * float(np.sqrt(np.mean(error**2))), "um"),
        ("simulated endoscope, a frame", 1e3 * (drawn - start) / 50, "ms"),
        ("tracking, a frame", 1e3 * (time.perf_counter() - drawn) / 50, "ms"),
    ]
