"""Recordings become a diagnosis' inputs."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from reference_instrument import RIG

from tautline.diagnosis import recorded
from tautline.recording import Marker, Recording
from tautline.simulated import simulate
from tautline.simulated.instrument import preset
from tautline.trajectory import sines


def test_a_progress_only_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two videos and a calibration that each count from 0 to 1."""
    made = simulate.simulate(RIG, preset("reference", RIG), sines(RIG.actuator, 1.0, 2.0), seed=1)

    def tracked(recording: Recording, rig: object, progress: recorded.Progress) -> Recording:
        progress(0.0, "tracking")
        progress(1.0, "tracking")
        return replace(recording, marker=Marker(made.marker.t_s, made.marker.u_px, made.marker.v_px, made.marker.valid))

    def calibrate(recordings: object, rig: object, progress: recorded.Progress, naming: bool) -> SimpleNamespace:
        progress(0.0, "calibrating")
        progress(1.0, "calibrating")
        return SimpleNamespace(offsets={})

    monkeypatch.setattr(recorded, "with_marker", tracked)
    monkeypatch.setattr(recorded, "calibrate", calibrate)
    said: list[float] = []
    recorded.calibrated([made, made], RIG, lambda fraction, text: said.append(fraction))
    assert said == sorted(said) and (said[0], said[-1]) == (0.0, 1.0)
