"""A camera by the wall clock, and what stands where the marker's tracker does."""

from __future__ import annotations

import time

import numpy as np

from tautline.geometry import project
from tautline.simulated.instrument import Instrument
from tautline.simulated.simlink import SimLink
from tautline.vision.marker import Sighting

FRAME_S, LATE = 0.04, 2  # frames


class WallCamera:
    """25 frames a second of the host's clock, each LATE frames old when it arrives. Its time is its device's: when it
    was taken and these frames, however late this process came to read it. A picture's first two values are where its
    marker is. After `until_s` it is gone."""

    clock = "the host's monotonic clock"
    dropped = 0
    exposure = ""

    def __init__(self, link: SimLink, instrument: Instrument, until_s: float = np.inf) -> None:
        self._link, self._instrument = link, instrument
        self._began = self._next = time.monotonic()
        self._until = self._began + until_s
        self._waiting: list[tuple[np.ndarray, float]] = []
        self._rng = np.random.default_rng(3)

    def read(self) -> tuple[np.ndarray, float] | None:
        rig = self._instrument.rig
        assert rig.camera is not None
        while True:
            self._next += FRAME_S
            time.sleep(max(self._next - time.monotonic(), 0.0))
            now = time.monotonic()
            if now > self._until:
                return None
            q = self._link.ask("state")["q"][0] / 256.0 * rig.actuator.encoder_resolution
            taken = 0.5 * (now + time.monotonic())
            c = self._instrument.move(np.array([now - self._began]), np.array([q]))
            picture = np.zeros((rig.camera.height_px, rig.camera.width_px), np.float32)
            picture[0, :2] = project(rig, c)[0] + self._rng.normal(0.0, 0.05, 2)
            self._waiting.append((picture, taken + LATE * FRAME_S))
            if len(self._waiting) > LATE:
                return self._waiting.pop(0)

    def lock_exposure(self) -> None:
        """It is no device: it has none."""

    def close(self) -> None:
        """Nothing is held."""


class Reader:
    """Stands where the marker's tracker does."""

    def track(self, picture: np.ndarray) -> Sighting:
        return Sighting(float(picture[0, 0]), float(picture[0, 1]), 0.05, 15.0)
