"""What tracking costs a frame: a session of teleoperation in which B changes its shape, and one of an angle sensor."""

from __future__ import annotations

import time

import numpy as np
from threadpoolctl import threadpool_limits
from tools.tracking.sessions import Instrument, ideal_model, session

from tautline.tracking import LawTracker


def run() -> list[tuple[str, float, str]]:
    """(name, value, unit) rows."""
    rows = []
    with threadpool_limits(1, "blas"):
        frame_times("nothing", 20.0)  # what is imported or built only once
        for kind, name in (("nothing", "nothing changes"), ("shape", "B changes its shape")):
            times = frame_times(kind, 90.0)
            rows.append((f"a frame, {name}, mean", 1e3 * float(times.mean()), "ms"))
            rows.append((f"a frame, {name}, 99 % below", 1e3 * float(np.quantile(times, 0.99)), "ms"))
    return rows


def frame_times(kind: str, seconds: float) -> np.ndarray:
    """Core seconds of each frame of a session."""
    instrument = Instrument(1)
    recording = session(instrument, kind, 1, seconds).recording
    marker, motor = recording.marker, recording.motor
    assert marker is not None
    tracker = LawTracker(ideal_model(instrument), "marker")
    tracker.begin()
    times, taken = [], 0
    for k, scene in enumerate((marker.t_s - instrument.camera.delay).tolist()):
        upto = int(np.searchsorted(motor.t_s, scene, side="right"))
        began = time.process_time()
        tracker.motor(motor.t_s[taken:upto], motor.q[taken:upto])
        tracker.predict(scene)
        if marker.valid[k]:
            tracker.see(float(marker.u_px[k]), float(marker.v_px[k]))
        times.append(time.process_time() - began)
        taken = upto
    return np.array(times)
