"""The result of a calibration, and what is printed of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline.calibration import coverage
from tautline.calibration.backlash import WidthCurve
from tautline.calibration.observations import Track
from tautline.calibration.onset import Delay, Onset
from tautline.model import Model
from tautline.prediction import predict
from tautline.value import Value

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Foretold(Value):
    """What the calibrated model says of one recording, beside what was seen there. All (n,) or (n, k), k = 2 px or 1
    deg."""

    name: str
    scene_s: Array  # on the motor's clock
    seen: Array
    predicted: Array

    @property
    def residual(self) -> Array:
        """(n, k) seen less predicted, px or deg."""
        return self.seen - self.predicted


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(Value):
    """The result of a calibration: the model, and what it was made from. Positions and B in the unit of q."""

    model: Model
    onsets: tuple[Onset, ...]
    delay: Delay
    source: str  # of B: "onsets", "onsets and passes", "passes", "nothing"
    onset_curve: WidthCurve | None  # B from the onsets alone
    pass_width: Array | None  # B from the passes' distance alone, on model.q; NaN where it says nothing
    pass_sigma: Array | None
    evidence: dict[str, float]
    notes: tuple[str, ...]
    names: tuple[str, ...] = field(default=())  # of the recordings
    offsets: Mapping[str, float] = field(default_factory=dict)  # by recording: the sensor's clock less the motor's
    predicted: tuple[Foretold, ...] = ()  # of every frame that was used, by recording
    gaps: tuple[coverage.Gap, ...] = ()  # where B can be seen and is not measured
    path: tuple[Array, Array] | None = None  # on model.q (k, channels) in the sensor's unit, and its sigma

    def to_json(self) -> dict[str, Any]:
        """What `taut calibrate --json` prints: B, f_remain, delay, onsets, evidence, notes, coverage and verdict; null
        for what is infinite or NaN."""
        model = self.model
        return {
            "unit": model.rig.actuator.unit,
            "backlash": {
                "q": model.q.tolist(),
                "width": model.width.tolist(),
                "sigma": [finite_or_none(v) for v in model.width_sigma],
                "measured": list(model.measured),
                "source": self.source,
                "elements": model.elements.to_json(),
            },
            "remaining": {
                "q": model.q.tolist(),
                "c_deg": model.c_deg.tolist(),
                "sigma_deg": None
                if model.c_sigma is None or model.rig.sees_from_tip
                else [finite_or_none(v) for v in model.c_sigma],
            },
            "delay_s": model.delay_s,
            "offset_s": model.offset_s,
            "delay_sigma_s": finite_or_none(self.delay.sigma_s),
            "onsets": [onset_json(o, self.names) for o in self.onsets],
            "evidence": {key: finite_or_none(value) for key, value in self.evidence.items()},
            "notes": list(self.notes),
            "coverage": coverage.to_json(self.gaps, model.rig.actuator.unit),
            "quality": model.quality.to_json(),
        }


def onset_json(onset: Onset, names: Sequence[str]) -> dict[str, Any]:
    """An onset as `taut calibrate --json` prints it, with null for what is infinite. `t_s` is when the tip moved again
    or, if it did not, when the motor turned. names: of the recordings; if empty, `recording` is ""."""
    timed = np.isfinite(onset.t_s)
    return {
        "t_s": onset.t_s if timed else onset.turn_s,
        "direction": onset.direction,
        "q1": onset.q1,
        "q2": onset.q2,
        "width": onset.width,
        "sigma": finite_or_none(onset.sigma),
        "used": onset.tells_width,
        "kind": onset.kind,
        "low": onset.low,
        "high": finite_or_none(onset.high),
        "reason": onset.reason,
        "recording": names[onset.track] if names else "",
    }


def foretold(model: Model, track: Track, delay_s: float) -> Foretold:
    """The model's prediction of a track's frames at this delay, s, with what was seen, both in the track's unit."""
    scene = track.scene_s(delay_s)
    told = predict(model, track.reading, scene)
    predicted = told.c_deg[:, None] if track.unit == "deg" else told.image_px
    assert predicted is not None  # the marker was seen by the rig's camera
    return Foretold(track.name, scene, track.y, predicted)


def finite_or_none(value: float) -> float | None:
    """The value; None, which is JSON's null, if it is infinite or NaN."""
    return float(value) if np.isfinite(value) else None
