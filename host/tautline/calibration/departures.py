"""How an instrument, its clock or its camera may depart from a play with one delay: columns for a mixed model.

Each departure is a linear change of what the sensor sees, frame by frame, with a roughness or size that its variance
multiplies. Those of the transmission move p and so the image along the path; those of the camera move the image.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.interpolate import BSpline
from scipy.linalg import helmert

from tautline import _native
from tautline.calibration.observations import Mask, turning_hysteresis, usual_width
from tautline.calibration.playfit import Curves, Fitted, PlayFit, PreparedTrack, Simulated
from tautline.core.motor import MotorPath
from tautline.elements import Play
from tautline.independence import first_order_sums
from tautline.rig import Rig

Array = npt.NDArray[np.float64]
Sparse = Any  # a scipy.sparse matrix, or an array

# Of the travel since a turn, in widths: where what follows a reversal is told apart; beyond the last, nothing.
# tolerance of the nodes: a width's first and last motion more finely than its middle
_PHASES = np.array([0.0, 0.12, 0.25, 0.4, 0.55, 0.7, 0.85, 0.95, 1.05, 1.15, 1.3, 1.5, 1.75, 2.0])
_TIMES, _STROKES_A_SPAN = 10, 3  # tolerance: spans of slow drifts, at most, and strokes in each, at least
_LAGS_S, _CREEPS_S = (0.02, 0.05, 0.1, 0.2), (0.6, 2.0)  # prior: time constants that are tried, s
_SATURATES = (0.1, 0.3, 1.0, 10.0)  # prior: of the usual speed, at which a width has grown by most of what speed adds
_FINE_S = 0.005  # tolerance: of the path that lags
_BREATHS_HZ = 0.08, 1.0  # prior: 5 to 60 breaths or heartbeats a minute
_SCAN = 12.0  # prior: what looking for a moment or a rhythm costs, of twice the log likelihood
_LASTS, _CONSTANT = 0.2, 0.5  # prior: of the misfit, that neighbours share; of that, both halves of a stroke
_ACROSS, _SWAYS = 0.25, 0.5  # prior: of what lies along the path, across it; of the misfit, that one rhythm explains
_PIECES, _LAGS = 100, 60  # tolerance: of all strokes, at most; frames over which neighbours share something

SPEED, SHARE = "width.speed", "%"  # of departures that add to B, of those that add a share of it
# What changes during a session and then is what it is: a model holds what it came to.
STATES = frozenset(
    {"offset.time", "offset.slip", "width.time", "image.time", "image.shift", "offset.recording", "width.recording"}
)  # fmt: skip


@dataclass(frozen=True)
class Departure:
    """One departure's columns for every row, channel by channel: (channels * n, m)."""

    name: str
    columns: sparse.csr_matrix
    penalty: Array  # (m, m)
    one_way: bool = False  # its only value cannot be negative
    not_beside: frozenset[str] = frozenset()  # departures that it would stand in for
    price: float = 0.0  # for having been looked for

    @property
    def size(self) -> int:
        return int(self.columns.shape[1])


@dataclass(frozen=True)
class CountedFrames:
    """The counted frames of all tracks, one after the other, at one state of the fit."""

    time_s: Array  # (n,) of the session
    t: Array  # the same, -1/2 to 1/2
    p: Array
    side: Array
    slope: Array  # (n, channels) of the whitened path
    width: Array  # B(p)
    by_width: Array  # dp/dB
    by_delay: Array
    speed: Array  # of the motor where the tip moves
    moving: Mask
    phase: Array  # travel since the motor turned, in widths
    way: Array  # of the motor since then
    stroke: npt.NDArray[np.intp]  # half-cycle of the tip
    recording: npt.NDArray[np.intp]
    frame: npt.NDArray[np.intp]  # of its track
    behind: Callable[[tuple[float, ...]], Array]  # (n, k) what lags of these time constants, s, would add to p
    load: Array | None  # less its mean
    inverse: Array  # 1 / stated noise
    residuals: Array  # (n, channels) whitened residuals
    weight: Array

    def along_path(self, columns: Sparse) -> sparse.csr_matrix:
        """Columns of p as columns of what is seen, channel by channel."""
        return sparse.csr_matrix(sparse.vstack([by_rows(slope, columns) for slope in self.slope.T]))

    def per_channel(self, columns: Sparse) -> sparse.csr_matrix:
        """The same columns for every channel of the image, apart."""
        return sparse.csr_matrix(sparse.block_diag([sparse.csr_matrix(columns)] * self.slope.shape[1]))

    def at_the_end(self) -> CountedFrames:
        """The same frames, had all been taken when the session ended."""
        n = len(self.t)
        last = int(self.recording[np.argmax(self.time_s)]) if n else 0
        return replace(
            self, t=np.full(n, 0.5), time_s=np.full(n, self.time_s.max(initial=0.0)), recording=np.full(n, last)
        )


def by_rows(factors: Array, columns: Sparse) -> sparse.csr_matrix:
    """(n, k) the rows of these columns times a factor (n,) each."""
    scaled = sparse.csr_matrix(columns, dtype=float, copy=True)
    scaled.data *= np.repeat(factors, np.diff(scaled.indptr))
    return scaled


@dataclass(frozen=True)
class SearchedParameters:
    """What is looked for in what is left: when the image shifted and when the transmission slipped, s, and how often
    something breathes, Hz; after how much of the path the tracker's error begins anew, px."""

    shift_s: float | None = None
    slip_s: float | None = None
    breath_hz: float | None = None
    anew_px: float | None = None

    def updated(self, counted: CountedFrames, left: Array, used: Set[str]) -> SearchedParameters:
        """The same with the moments of a shift and a slip and the rhythm that explain most of what is left (n,
        channels); those of departures that are in use stay."""
        best = self
        if "image.shift" not in used:
            best = replace(best, shift_s=_shift_time(counted.time_s, left))
        if "offset.slip" not in used:
            best = replace(best, slip_s=_slip_time(counted, left))
        if "image.breath" not in used:
            best = replace(best, breath_hz=_rhythm(counted.time_s, left))
        return best


def counted_frames(fitted: Fitted, curves: Curves, rig: Rig, clock: Array) -> CountedFrames | None:
    """All that departures are columns of, at these curves. clock (2,): how far the sensor's clock departs, s, linear
    and quadratic over the session; taken out here. None where the tip was never driven through so wide a play: no frame
    tells of it."""
    fit = fitted.fit
    first, length = _session(fit.tracks)
    tracks = on_clock(fit.tracks, clock)
    there = replace(fit, tracks=tracks, smoothing=fit.smoothing)
    residuals, masks = there.residuals(curves)
    if not any(mask.any() for mask in masks):
        return None
    usual = usual_width(there.width(curves), float(fit.grid[-1] - fit.grid[0]))
    pieces = [
        _piece(there, curves, prepared, sim, r, mask, w, usual, rig)
        for prepared, sim, r, mask, w in zip(tracks, there.simulated, residuals, masks, fitted.weights, strict=True)
    ]
    before = 0
    for piece in pieces:
        piece["stroke"] = piece["stroke"] + before
        before = int(piece["stroke"].max(initial=before - 1)) + 1
    for number, piece in enumerate(pieces):
        piece["recording"] = np.full(len(piece["p"]), number)
    load = None if any(piece["load"] is None for piece in pieces) else np.concatenate([p["load"] for p in pieces])
    courses = [piece.pop("behind") for piece in pieces]
    joined = {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0] if name != "load"}
    norm = np.sqrt(np.mean(joined["residuals"] ** 2, axis=1))
    limit = 4.0 * max(1.4826 * float(np.median(norm)), 1e-9)
    joined["weight"] = np.minimum(joined["weight"], (limit / np.maximum(norm, limit)) ** 2)  # as of a heavy tail
    time_s = joined.pop("time_s")
    return CountedFrames(
        time_s=time_s,
        t=(time_s - first) / length - 0.5,
        load=None if load is None else load - load.mean(),
        behind=lambda times_s: np.concatenate([behind(times_s) for behind in courses]),
        **joined,
    )


def departures(counted: CountedFrames, searched: SearchedParameters, *, apart: bool | None = None) -> list[Departure]:
    """Every departure that these frames could show, as columns. looked_for: moments, rhythm and length found before;
    apart: whether recordings may differ (None: where they show much the same positions)."""
    hats = _hats(counted.phase, _PHASES)[:, :-1]
    smooth, one = _smooth(hats.shape[1]), np.eye(1)
    n, channels = len(counted.p), counted.slope.shape[1]
    strokes = int(counted.stroke.max(initial=0)) + 1
    slow = slow_basis(counted.t, min(_TIMES, strokes // _STROKES_A_SPAN))
    each = sparse.csr_matrix((np.ones(n), (np.arange(n), counted.stroke)), shape=(n, strokes))
    held = by_rows(np.where(counted.moving, 0.0, 1.0), each)
    speeds = np.abs(counted.speed)
    usual = max(float(np.mean(speeds[counted.moving])) if counted.moving.any() else 0.0, 1e-12)

    def column(name: str, values: Array, *not_beside: str) -> Departure:
        return Departure(name, counted.along_path(values[:, None]), one, False, frozenset(not_beside))

    def speed_parts() -> list[Departure]:
        """One of several laws of a width that is less at rest. A motor that stops passes every speed on the
        way: a tip that rests was left there by a slow one, unless the width holds."""
        laws = {f"{SPEED}.{at:g}": -np.expm1(-speeds / (at * usual)) / -np.expm1(-1.0 / at) for at in _SATURATES}
        laws |= {f"{name}.0": np.where(counted.moving, law, 1.0) for name, law in laws.items()}
        columns = {name: counted.by_width * (law - 1.0) for name, law in laws.items()}
        columns |= {name + SHARE: column * counted.width for name, column in columns.items()}
        beside = frozenset(columns) | {"phase.even"}
        return [
            Departure(name, counted.along_path(values[:, None]), one, False, beside) for name, values in columns.items()
        ]

    def slow_parts(name: str, times_s: tuple[float, ...], columns: Array) -> list[Departure]:
        """One of several time constants."""
        names = frozenset(f"{name}.{tau:g}" for tau in times_s)
        return [
            Departure(f"{name}.{tau:g}", counted.along_path(columns[:, [i]]), one, True, names)
            for i, tau in enumerate(times_s)
        ]

    by_speed, behind = speed_parts(), counted.behind(_LAGS_S + _CREEPS_S)
    parts = [
        Departure(
            "phase.even",
            counted.along_path(by_rows(counted.way, hats)),
            smooth,
            False,
            frozenset(p.name for p in by_speed),
        ),
        Departure("phase.odd", counted.along_path(hats), smooth),
        Departure("stroke", counted.along_path(each), np.eye(strokes)),
        Departure("turn", counted.along_path(held), np.eye(strokes)),
        *([] if slow is None else [Departure("offset.time", counted.along_path(slow), _smooth(slow.shape[1]))]),
        column("width.time", counted.by_width * counted.width * counted.t),
        *by_speed,
        column("clock.rate", counted.by_delay * counted.t),
        column("clock.drift", counted.by_delay * (counted.t**2 - 1 / 12)),
        *slow_parts("lag", _LAGS_S, behind[:, : len(_LAGS_S)] / np.array(_LAGS_S)),
        *slow_parts("creep", _CREEPS_S, behind[:, len(_LAGS_S) :]),
    ]
    if searched.slip_s is not None:
        slipped = (counted.time_s >= searched.slip_s).astype(float)[:, None]
        parts.append(Departure("offset.slip", counted.along_path(slipped), one, price=_SCAN))
    if counted.load is not None and np.ptp(counted.load) > 0:
        load = counted.load / np.std(counted.load)
        effects = np.column_stack([load, counted.by_width * load, (counted.p - counted.p.mean()) * load])
        parts.append(Departure("load", counted.along_path(effects), np.eye(3)))
    recordings = int(counted.recording.max(initial=0)) + 1
    if recordings > 1 and (_same_places(counted, recordings) if apart is None else apart):
        which, free = contrasts(recordings)[counted.recording], np.eye(recordings - 1)
        parts += [
            Departure("offset.recording", counted.along_path(which), free),
            Departure("width.recording", counted.along_path(which * (counted.by_width * counted.width)[:, None]), free),
        ]
    if channels > 1:
        parts += [
            *(
                []
                if slow is None
                else [Departure("image.time", counted.per_channel(slow), _smooth(slow.shape[1], channels))]
            ),
            _of_strokes(counted, each, searched.anew_px),
            Departure("image.side", counted.per_channel(counted.side[:, None]), np.eye(channels)),
        ]
        if searched.shift_s is not None:
            after = (counted.time_s >= searched.shift_s).astype(float)[:, None]
            parts.append(
                Departure(
                    "image.shift", counted.per_channel(after * _places(counted)), np.eye(3 * channels), price=_SCAN
                )
            )
        if searched.breath_hz is not None:
            turn = 2 * np.pi * searched.breath_hz * counted.time_s
            waves = np.column_stack([np.cos(turn), np.sin(turn)])
            parts.append(Departure("image.breath", counted.per_channel(waves), np.eye(2 * channels), price=_SCAN))
    return parts


def _of_strokes(counted: CountedFrames, each: Sparse, anew_px: float | None) -> Departure:
    """The image's place on each stroke, or the tracker's error on each piece of it."""
    columns = each if anew_px is None else _pieces(counted, anew_px)
    name = "image.stroke" if anew_px is None else "tracker"
    return Departure(name, counted.per_channel(columns), np.eye(counted.slope.shape[1] * columns.shape[1]))


def starts_anew(counted: CountedFrames) -> float | None:
    """After how much of the path (px) an error of the tracker begins anew, as behind a codec that holds back what moves
    little; None where there is none. It lies across the path as well as along it, as none of the tip does, and is
    another in both halves of a stroke, as none of the camera's is but a sway."""
    if counted.slope.shape[1] < 2 or len(counted.p) < 4 * _LAGS:
        return None
    left = counted.residuals * counted.weight[:, None]
    direction = counted.slope / np.maximum(np.linalg.norm(counted.slope, axis=1), 1e-12)[:, None]
    along = np.sum(left * direction, axis=1)
    across = left[:, 0] * direction[:, 1] - left[:, 1] * direction[:, 0]

    def shared(values: Array, lag: int = 1) -> float:
        """Mean product of values `lag` frames apart on one stroke: what they have in common, noise squared."""
        same = counted.stroke[lag:] == counted.stroke[:-lag]
        return float(np.mean((values[lag:] * values[:-lag])[same])) if same.any() else 0.0

    near = shared(along) + shared(across)
    if near < _LASTS * float(np.mean(np.sum(left**2, axis=1))) or shared(across) < _ACROSS * shared(along):
        return None
    if _halves(left, counted.stroke) > _CONSTANT * near or _swaying(counted.time_s, left) > _SWAYS:
        return None
    place = _along_path(counted)
    for lag in range(1, _LAGS):
        if shared(along, lag) + shared(across, lag) < 0.5 * near:
            break
    same = (counted.stroke[lag:] == counted.stroke[:-lag]) & counted.moving[lag:]
    gone = float(np.median((place[lag:] - place[:-lag])[same])) if same.any() else 0.0
    return max(gone, float(np.sum(np.maximum(np.diff(place), 0.0))) / _PIECES)


def _along_path(counted: CountedFrames) -> Array:
    """(n,) how far, px, the image has gone since the stroke began."""
    step = np.linalg.norm(counted.slope / counted.inverse[:, None], axis=1)[1:] * np.abs(np.diff(counted.p))
    gone = np.concatenate([[0.0], np.cumsum(step)])
    first = np.searchsorted(counted.stroke, counted.stroke, side="left")
    return np.asarray(gone - gone[first])


def _pieces(counted: CountedFrames, length_px: float) -> sparse.csr_matrix:
    """(n, nodes) piecewise linear along each stroke's path, with a node every length_px."""
    place = _along_path(counted) / length_px
    spans = np.zeros(int(counted.stroke.max(initial=0)) + 1, dtype=np.intp)
    np.maximum.at(spans, counted.stroke, place.astype(np.intp) + 1)
    first = np.concatenate([[0], np.cumsum(spans + 1)])
    at = first[counted.stroke] + place.astype(np.intp)
    share, n = place % 1.0, np.arange(len(place))
    seen, node = np.unique(np.concatenate([at, at + 1]), return_inverse=True)  # no frame is near any other
    values = np.concatenate([1.0 - share, share]), (np.concatenate([n, n]), node)
    return sparse.csr_matrix(values, shape=(len(place), len(seen)))


def _halves(left: Array, stroke: npt.NDArray[np.intp]) -> float:
    """Mean product of the means of a stroke's two halves: what both share, noise squared; 0 where strokes are short."""
    begins = np.flatnonzero(np.diff(stroke, prepend=-1))
    ends = np.append(begins[1:], len(stroke))
    pairs = [(left[a : (a + b) // 2], left[(a + b) // 2 : b]) for a, b in zip(begins, ends, strict=True) if b - a >= 12]
    return float(np.mean([early.mean(axis=0) @ late.mean(axis=0) for early, late in pairs])) if pairs else 0.0


def _swaying(t: Array, left: Array) -> float:
    """Share (0 to 1) of what is left that a sine of the likeliest frequency explains; 0 where no frequency can be
    told."""
    rate = _rhythm(t, left)
    if rate is None:
        return 0.0
    turn = 2 * np.pi * rate * t
    waves = np.column_stack([np.cos(turn), np.sin(turn), np.ones_like(t)])
    rest = left - waves @ np.linalg.lstsq(waves, left, rcond=None)[0]
    return 1.0 - float(np.sum(rest**2)) / max(float(np.sum((left - left.mean(axis=0)) ** 2)), 1e-30)


def contrasts(recordings: int) -> Array:
    """(recordings, recordings - 1): what each differs by from the mean of all, which is path's and B's own."""
    return np.asarray(helmert(recordings).T)


def _same_places(counted: CountedFrames, recordings: int) -> bool:
    """Whether all recordings show much the same positions: else what differs may be the place."""
    spans = [counted.p[counted.recording == k] for k in range(recordings)]
    if any(len(span) == 0 for span in spans):
        return False
    shared = min(float(span.max()) for span in spans) - max(float(span.min()) for span in spans)
    return shared > 0.7 * max(float(np.ptp(span)) for span in spans)


def _places(counted: CountedFrames) -> Array:
    """(n, 3) constant, linear and quadratic in p: a rigid transform moves each place of the path in its own way."""
    x = (counted.p - counted.p.mean()) / max(float(np.std(counted.p)), 1e-12)
    return np.column_stack([np.ones_like(x), x, x**2 - 1])


def on_clock(tracks: Sequence[PreparedTrack], clock: Array) -> list[PreparedTrack]:
    """The tracks with the departure of their clock (see `scene_of`) taken out."""
    first, length = _session(tracks)
    corrected = []
    for prepared in tracks:
        t = (prepared.track.t_s + prepared.track.session_s - first) / length - 0.5
        departs = clock[0] * t + clock[1] * (t**2 - 1 / 12)
        corrected.append(replace(prepared, track=replace(prepared.track, t_s=prepared.track.t_s - departs)))
    return corrected


def _session(tracks: Sequence[PreparedTrack]) -> tuple[float, float]:
    """When the first frame of the session came, and how long it was until the last one, s."""
    ends = [prepared.track.t_s[[0, -1]] + prepared.track.session_s for prepared in tracks]
    first, last = float(np.min(ends)), float(np.max(ends))
    return first, max(last - first, 1e-9)


def _piece(
    fit: PlayFit, curves: Curves, prepared: PreparedTrack, sim: Simulated, rows: Array, keep: Mask, weights: Array,
    usual: float, rig: Rig,
) -> dict[str, Any]:  # fmt: skip
    """What `Scene` holds, of one track."""
    track = prepared.track
    scene_s = track.scene_s(curves.delay_s)
    gone, way = _since_turn(track.path, scene_s[keep], rig)
    p, side, moving = sim.p[keep], sim.side[keep].astype(float), sim.moving[keep]
    by_width, by_delay = sim.slopes(keep, fit.backlash.slope(curves.backlash, p))
    inverse = 1.0 / track.sigma[keep]
    stroke = np.cumsum(np.diff(sim.side.astype(int), prepend=sim.side[:1]) != 0)
    width = np.interp(p, fit.grid, fit.width(curves))
    load = track.motor.load_mNm

    def behind(times_s: tuple[float, ...]) -> Array:
        """(frames, time constants) what a first-order lag of each time constant, s, adds to the play's p, unit of q."""
        fine = np.arange(track.motor.t_s[0], track.motor.t_s[-1], _FINE_S)
        course = Play(fit.grid, fit.width(curves), fit.elements).forward(track.motor_at(fine))
        return np.column_stack([np.interp(scene_s[keep], fine, _low_pass(course, tau) - course) for tau in times_s])

    return {
        "time_s": track.t_s[keep] + track.session_s,
        "p": p,
        "side": side,
        "slope": fit.follow.slope(curves.follow, p).reshape(len(p), curves.follow.shape[1]) * inverse[:, None],
        "width": width,
        "by_width": by_width,
        "by_delay": by_delay,
        "speed": sim.speed[keep] * moving,
        "moving": moving,
        "phase": gone / np.maximum(width, 0.2 * usual),
        "way": way,
        "stroke": stroke[keep],
        "frame": np.flatnonzero(keep),
        "behind": behind,
        "load": None if load is None else np.interp(scene_s[keep], track.motor.t_s, load),
        "inverse": inverse,
        "residuals": rows[keep],
        "weight": np.where(weights[keep] > 0, weights[keep], 1.0),
    }


def _since_turn(path: MotorPath, at: Array, rig: Rig) -> tuple[Array, Array]:
    """How far the motor has gone since it last turned (n,), unit of q, and which way (n,), +1 or -1, at scene times
    (n,), s; how far is inf before its first turn."""
    motor, hysteresis = path.lines, turning_hysteresis(path, rig.actuator.encoder_resolution, rig.actuator.span)
    turns = _native.turns(np.ascontiguousarray(motor.q), hysteresis)
    edges = np.concatenate([[0], turns, [len(motor.q) - 1]]).astype(int)
    directions = np.sign(np.diff(motor.q[edges]))
    which = np.clip(np.searchsorted(motor.t_s[edges], at, side="right") - 1, 0, len(directions) - 1)
    gone = np.abs(np.interp(at, motor.t_s, motor.q) - motor.q[edges[which]])
    return np.where(which == 0, np.inf, gone), directions[which]


def _low_pass(p: Array, time_s: float) -> Array:
    """p (n,), a value every _FINE_S, after a first-order low pass with time constant time_s."""
    share = np.exp(-_FINE_S / time_s)
    return np.asarray(p[0] + first_order_sums((1 - share) * (p - p[0]), share))


def _hats(x: Array, nodes: Array) -> sparse.csr_matrix:
    """(n, nodes) piecewise linear basis; nothing beyond the last node."""
    n = np.flatnonzero(x < nodes[-1])
    at = np.clip(np.searchsorted(nodes, x[n], side="right") - 1, 0, len(nodes) - 2)
    share = (x[n] - nodes[at]) / (nodes[at + 1] - nodes[at])
    places = np.concatenate([n, n]), np.concatenate([at, at + 1])
    return sparse.csr_matrix((np.concatenate([1 - share, share]), places), shape=(len(x), len(nodes)))


def slow_basis(t: Array, spans: int) -> Sparse | None:
    """Cubic splines (n, spans + 3) at times t (n,) of the session, -1/2 to 1/2. None of fewer than 2 spans: that is no
    slower than the motion."""
    if spans < 2:
        return None
    knots = -0.5 + np.arange(-3, spans + 4) / spans
    return sparse.csr_matrix(BSpline.design_matrix(np.clip(t, -0.5, 0.5 - 1e-9), knots, 3))


def _smooth(size: int, channels: int = 1) -> Array:
    """(channels * size, channels * size) penalty on first differences of neighbours, and a little on the values, for
    each channel alike."""
    step = np.diff(np.eye(size), 1, axis=0)
    rough = step.T @ step + 0.05 * np.eye(size)
    return np.asarray(np.kron(np.eye(channels), rough), dtype=float)


def _shift_time(t: Array, left: Array) -> float | None:
    """The moment, s, at which a step of the image explains most of what is left (n, channels), at least 20 frames from
    either end; None of fewer than 60 frames."""
    n = len(left)
    if n < 60:
        return None
    total = np.cumsum(left - left.mean(axis=0), axis=0)[20:-20]
    k = np.arange(20, n - 20) + 1.0
    gain = np.sum(total**2, axis=1) * n / (k * (n - k))
    return float(t[int(np.argmax(gain)) + 21])


def _slip_time(counted: CountedFrames, left: Array) -> float | None:
    """The moment, s, from which on another place of the tip along its path explains most, beside one of all the
    session, at least 20 frames from either end; None of fewer than 60 frames."""
    if len(left) < 60:
        return None
    pull, power = np.sum(left * counted.slope, axis=1), np.sum(counted.slope**2, axis=1)
    share = np.cumsum(power) / max(float(power.sum()), 1e-30)
    inside = slice(20, -20)
    gain = (np.cumsum(pull) - share * pull.sum())[inside] ** 2 / np.maximum(share * (1.0 - share), 1e-12)[inside]
    return float(counted.time_s[int(np.argmax(gain)) + 21])


def _rhythm(t: Array, left: Array) -> float | None:
    """The frequency, Hz, at which a sine explains most of what is left; None where frames are few or the session too
    short."""
    if len(t) < 100:
        return None
    even = np.linspace(t[0], t[-1], len(t))
    step = even[1] - even[0]
    waves = [np.interp(even, t, channel) for channel in left.T]
    power = sum(np.abs(np.fft.rfft(wave - wave.mean(), 4 * len(even))) ** 2 for wave in waves)
    rates = np.fft.rfftfreq(4 * len(even), step)
    inside = (rates > max(_BREATHS_HZ[0], 4.0 / (t[-1] - t[0]))) & (rates < _BREATHS_HZ[1])
    return float(rates[inside][int(np.argmax(np.asarray(power)[inside]))]) if inside.any() else None
