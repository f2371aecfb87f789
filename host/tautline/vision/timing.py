"""When a simulated camera shows what: frames at a steady rate, delayed, with jitter, some of them lost."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tautline.rig import Rig


@dataclass(frozen=True)
class FrameTiming:
    """Frame k shows the scene at (k + phase) / rate_hz, the middle of its exposure, and arrives delay_s later.

    jitter_s (rms) is in the arrival only; frames still arrive in order. `lost` is the share of frames that never
    arrive. phase is a share of the frame period; None draws it from the seed, as motor and frame clock are not in step.
    """

    rate_hz: float
    delay_s: float
    jitter_s: float = 0.0
    lost: float = 0.0
    phase: float | None = None
    seed: int = 0

    @classmethod
    def of(cls, rig: Rig, **changes: float | int | None) -> FrameTiming:
        """Returns the timing with the rig's nominal rate (25 Hz without a camera) and delay. changes: other values of
        fields, by name."""
        rate_hz = rig.camera.frame_rate_hz if rig.camera else 25.0
        nominal = {"rate_hz": rate_hz, "delay_s": rig.delay_s}
        return cls(**{**nominal, **changes})  # type: ignore[arg-type]

    def frames(self) -> Iterator[tuple[float, float]]:
        """Yields (scene time, arrival time), s, of every frame that arrives, without end. No frame arrives before its
        scene, or less than 0.1 ms after the last one."""
        rng = np.random.default_rng([self.seed, 0xF3A3E])  # any number: other draws of this seed are independent
        phase = rng.uniform() if self.phase is None else self.phase
        latest = -np.inf
        k = 0
        while True:
            scene = (k + phase) / self.rate_hz
            late, fate = rng.normal(0.0, self.jitter_s), rng.uniform()
            k += 1
            if fate < self.lost:
                continue
            latest = max(scene + self.delay_s + late, scene, latest + 1e-4)
            yield scene, latest
