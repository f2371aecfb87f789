"""What of a View goes to the page, as JSON documents. Positions and widths in the rig's unit, angles in deg."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tautline.calibration.result import Calibration
from tautline.diagnosis.narration import SHOWN, sentence
from tautline.geometry import coarse_range_deg, project
from tautline.live.asking import Leading, answers_of
from tautline.live.rounds import in_words
from tautline.live.setup import Frame
from tautline.live.watch import View, in_short
from tautline.model import Model
from tautline.rig import Rig
from tautline.tracking import Row

_NODES = 161  # of B(q), as it is drawn
_ANGLES = 481  # of the rig's curve: to 0.002 px of its bows


class Bending:
    """Finds the bending angle in a frame quickly, from a table of the rig's curve in the image. `pose`, which fits the
    angle, takes some 3 ms of the 40 ms between two frames, and the tracker needs these."""

    def __init__(self, rig: Rig) -> None:
        """Tabulates the curve that the rig's marker follows in the image: over the range of f_coarse and a quarter of
        it beyond either end."""
        low, high = coarse_range_deg(rig)
        margin = 0.25 * (high - low)
        self._c_deg = np.linspace(low - margin, high + margin, _ANGLES)
        self._points = project(rig, self._c_deg)
        self._segments = np.diff(self._points, axis=0)
        self._squared_lengths = np.sum(self._segments**2, axis=1)

    def of(self, frame: Frame) -> float | None:
        """Returns the bending angle, deg, of the point on the tabulated curve that is nearest to the marker; None where
        the marker is lost."""
        if not frame.sighting.valid:
            return None
        from_start = (frame.sighting.u_px, frame.sighting.v_px) - self._points[:-1]
        # The nearest point of each segment, as a share of its length; then the segment whose point is nearest.
        share = np.clip(np.sum(from_start * self._segments, axis=1) / self._squared_lengths, 0.0, 1.0)
        distance = from_start - share[:, None] * self._segments
        k = int(np.argmin(np.sum(distance * distance, axis=1)))
        return _json_number(float(self._c_deg[k] + share[k] * (self._c_deg[k + 1] - self._c_deg[k])))


def frame_document(frame: Frame, q: float, c_deg: float | None) -> dict[str, Any]:
    """One frame as a JSON document: its arrival time, s; q, the motor at its scene time, the rig's unit; c_deg, the
    bending angle; and the marker, px."""
    seen = frame.sighting
    return {
        "t_s": frame.t_us * 1e-6,
        "q": _json_number(q),
        "c_deg": c_deg,
        "u_px": _json_number(seen.u_px),
        "v_px": _json_number(seen.v_px),
        "diameter_px": _json_number(seen.diameter_px),
        "lost": seen.lost,
    }


def progress_document(view: View) -> dict[str, Any]:
    """A live calibration's progress as a JSON document: what is being done, what was seen, what is missing."""
    seen, known = in_short(view)
    return {
        "doing": view.doing,
        "seen": seen,
        "known": known,
        "share": view.share,
        "rising": view.rising.tolist(),
        "falling": view.falling.tolist(),
        "missing": missing_in_words(view),
        "onsets": [
            {"q": 0.5 * (o["q1"] + o["q2"]), "width": o["width"], "direction": o["direction"], "used": o["used"]}
            for o in view.onsets
        ],
    }


def missing_in_words(view: View) -> list[str]:
    """Says in sentences, one for each thing, what is missing for the goal of a live calibration, a sigma of B; [] where
    nothing is."""
    unit, standing = view.unit, view.standing
    said = []
    if view.coverage < 1.0:
        said.append(f"seen in both directions over {100 * view.coverage:.0f} % of the range")
    low, high = view.unseen  # low = high where the marker was seen everywhere
    if low < high:
        said.append(f"the marker is mostly lost from {low:.3g} to {high:.3g} {unit}")
    if standing is None or view.until is None:
        return said
    said += [gap.says(unit) for gap in standing.missing]
    said += [
        f"sigma of B is {in_words(place.sigma, unit)} from {place.low:.3g} to {place.high:.3g} {unit}"
        for place in standing.need
        if place.sigma > view.until
    ]
    return said


def calibration_document(calibration: Calibration, seconds: float | None) -> dict[str, Any]:
    """A calibration as a JSON document: `backlash_document` and its onsets, but those without a finite width. seconds:
    how much of the recording it is from, s; None for all of it."""
    return backlash_document(calibration.model) | {
        "seconds": seconds,
        "onsets": [
            {
                "q": o.q_mean,
                "width": o.width,
                "sigma": _json_number(o.sigma),
                "direction": o.direction,
                "used": o.used,
            }
            for o in calibration.onsets
            if np.isfinite(o.width)
        ],
    }


def backlash_document(model: Model) -> dict[str, Any]:
    """A model as a JSON document: B(q) with its sigma, unit of q, at _NODES places of the measured range, the delay,
    ms, and the verdict with its reasons. It has no onsets."""
    low, high = model.measured
    q = np.linspace(low, high, _NODES) if low < high else np.zeros(0)
    return {
        "seconds": None,
        "q": q.tolist(),
        "width": _json_numbers(np.interp(q, model.q, model.width)),
        "sigma": _json_numbers(np.interp(q, model.q, model.width_sigma)),
        "measured": [low, high],
        "delay_ms": 1e3 * model.delay_s,
        "onsets": [],
        "verdict": model.quality.verdict.value,
        "reasons": [
            {"code": reason.code, "says": reason.says, "remedy": reason.remedy, "mild": reason.mild}
            for reason in model.quality.reasons
        ],
    }


def diagnosis_document(document: Mapping[str, Any], answers: Sequence[Leading], why: str) -> dict[str, Any]:
    """A live diagnosis so far as a JSON document: its probable answers, the likeliest one after each recording, and
    what the next motion is for, or why there is none. document: the content of diagnosis.json; answers: the likeliest
    ones, by recording; why: why the diagnosis ends, "" if it goes on."""
    following = document["next_motion"]
    probable = sorted(answers_of(document).items(), key=lambda item: -item[1])
    return {
        "says": sentence(document),
        "answers": [{"id": name, "probability": p} for name, p in probable if p >= SHOWN],
        "led": [str(leading) for leading in answers],
        "next": "" if why or not following else following["why"],
        "why": why,
    }


def row_document(row: Row, t_s: float) -> dict[str, Any]:
    """A tracker's row at time t_s, s, as a JSON document: the state and its reason, the offset (the rig's unit) and the
    scale of B, with their sigmas."""
    numbers = {
        name: _json_number(float(getattr(row, name))) for name in ("offset", "offset_sigma", "scale", "scale_sigma")
    }
    return {"t_s": t_s, "state": row.state.value, "reason": row.reason} | numbers


def _json_numbers(values: np.ndarray) -> list[float | None]:
    """Returns the numbers as a list for JSON, with None in place of NaN and inf."""
    return [_json_number(float(value)) for value in values]


def _json_number(value: float) -> float | None:
    """Returns the number, None in place of NaN and inf, which JSON does not have."""
    return value if np.isfinite(value) else None
