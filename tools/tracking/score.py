"""What a session's rows are worth, from the plant's truth."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tautline.model import Model
from tautline.tracking import State, Tracked, off_by
from tools.tracking.sessions import COUNT, DISTURBED, NOISE_PX, OUTSIDE, Session

Array = NDArray[np.float64]
Scores = dict[str, Any]

_TURN = 0.15  # mm: a motor that goes back by more has been turned by its user
_CELL = 0.1  # mm
_STEADY = 3  # reversals


def turns_of(q: Array, hysteresis: float = _TURN) -> list[int]:
    """Where q turns: the extremes from which it goes back by more."""
    turns, way, far = [], 0, 0
    for k in range(1, len(q)):
        if way == 0:
            if abs(q[k] - q[far]) > hysteresis:
                way, far = (1 if q[k] > q[far] else -1), k
        elif way * (q[k] - q[far]) > 0.0:
            far = k
        elif way * (q[far] - q[k]) > hysteresis:
            turns.append(far)
            way, far = -way, k
    return turns


def score(session: Session, model: Model, tracked: Tracked) -> Scores:
    """The reference is the noise; where the hysteresis is none of the tracker's, what was left before the change."""
    changed = session.change_s < math.inf
    law = np.array([(row.offset, row.scale) for row in tracked.rows])
    result: Scores = {
        "kind": session.recording.name,
        "cost": session.cost,
        "learnt": bool(np.any(law[:, 0] != 0.0) or np.any(law[:, 1] != 1.0)),
        "trusted": float(np.mean([row.state is State.TRUSTED for row in tracked.rows])),
    }
    if not changed:
        result["learnt_offset"], result["learnt_scale"] = np.abs(law - [0.0, 1.0]).max(0).tolist()
        return result
    motor = session.recording.motor
    at = np.array(turns_of(motor.q))
    at = at[motor.t_s[at] > session.change_s]
    turns = motor.t_s[at]
    doubted = np.array([row.state is not State.TRUSTED for row in tracked.rows])
    doubts = tracked.t_s[doubted & (tracked.t_s > session.change_s)]
    result["reversals"] = len(turns)
    result["stale_after"] = int(np.searchsorted(turns, doubts[0])) if len(doubts) else math.inf
    result["stale_before"] = float(np.mean(doubted[tracked.t_s < session.change_s]))
    result["over"] = _over_compensated(session, model, tracked, turns)
    late = tracked.t_s > (turns[9] if len(turns) > 9 else math.inf)
    if session.recording.name in ("shape", "gradual"):
        late &= _known_places(session, tracked, at)
    off = off_by(tracked, [session.recording])
    late &= np.isfinite(off)
    if late.sum() > 50:
        marker = session.recording.marker
        assert marker is not None
        seen = np.column_stack([marker.u_px, marker.v_px])
        result["rms"] = _rms(off[late])
        reference = (seen - session.true_px)[late].ravel()
        if session.recording.name in OUTSIDE:
            reference = off[(tracked.t_s > 8.0) & (tracked.t_s < session.change_s) & np.isfinite(off)]
        result["reference"] = max(_rms(reference), NOISE_PX)
        result["untracked"] = _rms((seen - session.nominal_px)[late].ravel())
    last = tracked.rows[-1]
    result["offset_z"] = (last.offset - session.change.offset) / last.offset_sigma
    if session.recording.name in ("scale", "offset"):
        result["scale_z"] = (last.scale - session.change.scale) / last.scale_sigma
    return result


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _known_places(session: Session, tracked: Tracked, turns: Array) -> NDArray[np.bool_]:
    """Frames at places within one B of which the user turned twice since the change."""
    motor = session.recording.motor
    scene = tracked.t_s - session.instrument.camera.delay
    q = np.interp(scene, motor.t_s, motor.q)
    width = session.instrument.of_place(session.change.width(session.instrument), q)
    near = np.zeros(len(q), dtype=int)
    for turn in turns.tolist():
        near += (scene > motor.t_s[turn]) & (np.abs(q - motor.q[turn]) < width)
    return near >= 2


def _over_compensated(session: Session, model: Model, tracked: Tracked, turns: Array) -> int:
    """For how many of the user's reversals more was taken up than is there, at a place that was passed both ways since
    the change; -1: never. Single rows do not count."""
    motor, p = session.recording.motor, session.p
    cells = np.arange(-6.0, 6.0, _CELL)
    true = session.instrument.of_place(session.change.width(session.instrument), cells)
    nominal = np.interp(cells, model.q, model.width)
    most = true + np.maximum(0.02 * true, 3 * COUNT)
    step = np.diff(p, prepend=p[0])
    cell = np.clip(((p - cells[0]) / _CELL).astype(int), 0, len(cells) - 1)
    after = motor.t_s > session.change_s
    first = np.full((2, len(cells)), math.inf)
    for side, way in enumerate((1.0, -1.0)):
        moving = after & (way * step > 1e-9)
        np.minimum.at(first[side], cell[moving], motor.t_s[moving])
    since = first.max(0)
    last, run = -1, 0
    for t, row in zip(tracked.t_s.tolist(), tracked.rows, strict=True):
        over = (since < t) & (row.scale * nominal > most)
        run = run + 1 if over.any() else 0
        if run >= 2:
            last = max(last, int(np.searchsorted(turns, t) - np.searchsorted(turns, since[over].min())))
    return last


def table(results: Sequence[Mapping[str, Any]], least_cost: float) -> list[dict[str, Any]]:
    """A row for each kind; of those that change, only what costs enough."""
    rows = []
    for kind in dict.fromkeys(r["kind"] for r in results):
        group = [r for r in results if r["kind"] == kind]
        if kind in DISTURBED:
            rows.append(
                {
                    "kind": kind,
                    "sessions": len(group),
                    "learnt": sum(r["learnt"] for r in group),
                    "trusted": float(np.mean([r["trusted"] for r in group])),
                }
            )
            continue
        group = [r for r in group if r["cost"] >= least_cost]
        scored = [r for r in group if "rms" in r]
        ratios = np.array([r["rms"] / r["reference"] for r in scored])
        most = 1.3 if kind in ("scale", "offset") else 2.0
        rows.append(
            {
                "kind": kind,
                "sessions": len(group),
                "stale within 3": _share(r["stale_after"] <= _STEADY for r in group),
                "of the time before": float(np.mean([r["stale_before"] for r in group])) if group else None,
                "ratio median": float(np.median(ratios)) if len(ratios) else None,
                "ratio 95 %": float(np.quantile(ratios, 0.95)) if len(ratios) else None,
                "within": _share(ratios <= most),
                "untracked": float(np.median([r["untracked"] / r["reference"] for r in scored])) if scored else None,
                "over at most 2": _share(r["over"] <= 2 for r in group),
                "offset z": _rms(np.array([r["offset_z"] for r in group])) if group else None,
                "scale z": _rms(np.array([r["scale_z"] for r in group])) if group and "scale_z" in group[0] else None,
            }
        )
    return rows


def _share(good: Any) -> float | None:
    good = list(good)
    return float(np.mean(good)) if good else None
