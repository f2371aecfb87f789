"""What a model is worth on the recordings it was made from: beside f_coarse, and beside a tip that never moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tautline.calibration.observations import Track
from tautline.calibration.playfit import Frozen
from tautline.geometry import project
from tautline.model import Model
from tautline.prediction import misses, rms
from tautline.quality import Reason
from tautline.rig import Rig

Array = npt.NDArray[np.float64]

_BEATEN = 1.05  # times the error of f_coarse or a constant from which a model is worse
_NOISE = 1.5  # times the noise up to which it is right, whatever else is


@dataclass(frozen=True)
class Worth:
    """Errors rms per coordinate, px or deg, of frames after the tip was driven both ways."""

    model: float
    coarse: float  # c = gain q + offset, no backlash
    constant: float  # the mean of what was seen
    noise: float
    unit: str

    @property
    def doubts(self) -> list[Reason]:
        best = min(self.coarse, self.constant)
        if self.model <= max(_BEATEN * best, _NOISE * self.noise):
            return []
        return [
            Reason(
                "predicts",
                f"it predicts its own recordings to {self.model:.3g} {self.unit}, f_coarse to {self.coarse:.3g}, "
                f"a tip that never moves to {self.constant:.3g}",
                "nothing fits the rig: check camera, hand_eye, actuator.unit and the clock of the frames",
                fatal=True,
            )
        ]


def worth(model: Model, tracks: Sequence[Track], rig: Rig) -> Worth | None:
    """None where nothing was seen after the tip was driven both ways."""
    model_error, coarse_error, seen, sigma = [], [], [], []
    for track in tracks:
        frozen = Frozen.of(track)
        settled = frozen.simulate(model.q, model.width, model.delay_s).settled
        if not settled.any():
            continue
        scene = track.scene_s(model.delay_s)
        coarse = rig.coarse.gain * track.motor_at(scene) + rig.coarse.offset
        by_coarse = project(rig, coarse, *track.others_at(scene)) if track.unit == "px" else coarse[:, None]
        model_error.append(misses(model, track.reading, scene, track.y)[settled])
        coarse_error.append((track.y - by_coarse)[settled])
        seen.append(track.y[settled])
        sigma.append(track.sigma[settled])
    if not seen:
        return None
    y = np.concatenate(seen)
    noise, unit = float(np.median(np.concatenate(sigma))), tracks[0].unit
    return Worth(rms(model_error), rms(coarse_error), rms([y - y.mean(axis=0)]), noise, unit)
