"""What tracking costs a frame: a session of teleoperation in which B changes its shape, and one of an angle sensor."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
from threadpoolctl import threadpool_limits

from tautline.tracking import LawTracker
from tools.tracking.sessions import Instrument, ideal_model, session

REPLAYS = 5  # of a session: a frame's time is the least of as many, as the machine's other work is not the tracker's
SECONDS = 90.0  # of a session


def run() -> list[tuple[str, float, str]]:
    """(name, value, unit) rows."""
    rows = []
    with threadpool_limits(1, "blas"):
        next(frame_times("nothing", 20.0))  # what is imported or built only once
        for kind, name in (("nothing", "nothing changes"), ("shape", "B changes its shape"), ("contact", "contact")):
            times = np.min(
                [times for times, _ in zip(frame_times(kind, SECONDS), range(REPLAYS), strict=False)], axis=0
            )
            rows.append((f"a frame, {name}, mean", 1e3 * float(times.mean()), "ms"))
            rows.append((f"a frame, {name}, most", 1e3 * float(times.max()), "ms"))
    return rows


def frame_times(kind: str, seconds: float) -> Iterator[np.ndarray]:
    """Core seconds of each frame of a session, replayed again and again."""
    instrument = Instrument(1)
    recording = session(instrument, kind, 1, seconds).recording
    marker, motor = recording.marker, recording.motor
    assert marker is not None
    model = ideal_model(instrument)
    while True:
        tracker = LawTracker(model, "marker")
        tracker.begin()
        times, taken = [], 0
        for k, scene in enumerate((marker.t_s - instrument.camera.delay).tolist()):
            upto = int(np.searchsorted(motor.t_s, scene, side="right"))
            began = time.thread_time()
            tracker.motor(motor.t_s[taken:upto], motor.q[taken:upto])
            tracker.predict(scene)
            if marker.valid[k]:
                tracker.see(float(marker.u_px[k]), float(marker.v_px[k]))
            times.append(time.thread_time() - began)
            taken = upto
        yield np.array(times)
