"""How an instrument, its clock or its camera may depart from a play with one delay, as columns of a mixed model
(components.py).

Each departure is a linear change of what the sensor sees, frame by frame: columns Z with a penalty matrix P, so that
its values u have the prior N(0, s^2 P^-1). Departures of the transmission move the tip's place p, and with it the image
along the path; those of the camera move the image itself. n: counted frames; channels: 2 of an image (px), 1 of an
angle (deg). Columns are for the whitened image (over the stated noise), channel by channel: (channels * n, m)."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.interpolate import BSpline
from scipy.linalg import helmert

from tautline.calibration.counted import CountedFrames, Sparse, scaled_rows

Array = npt.NDArray[np.float64]

# Of the travel since a turn, in widths: where what follows a reversal is told apart; beyond the last, nothing.
# tolerance of the nodes: a width's first and last motion more finely than its middle
_PHASES = np.array([0.0, 0.12, 0.25, 0.4, 0.55, 0.7, 0.85, 0.95, 1.05, 1.15, 1.3, 1.5, 1.75, 2.0])
_TIMES, _STROKES_A_SPAN = 10, 3  # tolerance: spans of slow drifts, at most, and strokes in each, at least
_LAGS_S, _CREEPS_S = (0.02, 0.05, 0.1, 0.2), (0.6, 2.0)  # prior: time constants that are tried, s
_SATURATES = (0.1, 0.3, 1.0, 10.0)  # prior: of the usual speed, at which a width has grown by most of what speed adds
_BREATHS_HZ = 0.08, 1.0  # prior: 5 to 60 breaths or heartbeats a minute
_CYCLES = 4.0  # prior: of a sway, at least: what is slower is a drift
_A_CYCLE, _MOST_SAMPLES = 4, 1_000_000  # tolerance: samples of the fastest of them; and in all: three days
_PULL = 0.05  # prior: of a smooth departure: what its values cost of what their steps do
_SCAN = 12.0  # prior: what looking for a moment or a rhythm costs, of twice the log likelihood
# Of a tracker's error: the share of the residuals' power that neighbours share, at least; of that what is alike in
# both halves of a stroke, at most; what lies across the path of what lies along it, at least; what of the residuals
# one sine explains, at most.
_LASTS, _CONSTANT, _ACROSS, _SWAYS = 0.2, 0.5, 0.25, 0.5  # prior: above
_MUCH = 0.7  # prior: of the positions of any recording: what all have to show so that what differs is not the place
_PIECES, _LAGS = 100, 60  # tolerance: of all strokes, at most; frames over which neighbours share something
_HALF = 0.5  # prior: of what neighbours share: an error that has fallen to it has begun anew
_ENDS = 20  # tolerance: frames at either end in which no moment is looked for, and that lie between them at least
_WAVE_FEWEST = 100  # tolerance: frames from which a frequency is told
_FINER = 4  # tolerance: frequencies of a periodogram for each that are independent
_HALVES = 12  # tolerance: frames of a stroke that has two halves

SPEED, SHARE = "width.speed", "%"  # names of departures that add to B begin so; of those that add a share of B end so
# What changes during a session and then is what it is: a model holds what it came to.
STATES = frozenset(
    {"offset.time", "offset.slip", "width.time", "image.time", "image.shift", "offset.recording", "width.recording"}
)  # fmt: skip


@dataclass(frozen=True)
class Departure:
    """A candidate for a component: its columns and the prior of its values."""

    name: str
    columns: sparse.csr_matrix  # (channels * n, m)
    penalty: Array  # (m, m) P
    one_way: bool = False  # its only value cannot be negative
    not_beside: frozenset[str] = frozenset()  # what it would stand in for: not if one of them is active or was refused
    price: float = 0.0  # of twice the log likelihood, for a parameter that was searched for

    @property
    def size(self) -> int:
        """m, the number of its values."""
        return int(self.columns.shape[1])


@dataclass(frozen=True)
class SearchedParameters:
    """Parameters in which departures are not linear: found by a search in the residuals, None where nothing was
    found."""

    shift_s: float | None = None  # when the image shifted, session time
    slip_s: float | None = None  # when the transmission slipped
    breath_hz: float | None = None  # frequency at which the image sways
    tracker_length_px: float | None = None  # length of the image's path over which a tracker's error stays alike

    def updated(self, counted: CountedFrames, left: Array, in_use: Set[str]) -> SearchedParameters:
        """The parameters searched for anew in the whitened residuals left (n, channels): the moments of a shift and a
        slip and the frequency that explain most of them. Those of departures in use (names) stay, as the tracker's
        length does."""
        best = self
        if "image.shift" not in in_use:
            best = replace(best, shift_s=_shift_time(counted.time_s, left))
        if "offset.slip" not in in_use:
            best = replace(best, slip_s=_slip_time(counted, left))
        if "image.breath" not in in_use:
            best = replace(best, breath_hz=_sway_frequency(counted.time_s, left))
        return best


# ---- the departures


def departures(counted: CountedFrames, searched: SearchedParameters, *, apart: bool | None = None) -> list[Departure]:
    """Every departure that these frames could show. searched: parameters that are not linear. apart: whether recordings
    may differ; None: they may if they show much the same positions."""
    n = len(counted.p)
    strokes = int(counted.stroke.max(initial=0)) + 1
    slow = slow_basis(counted.t, min(_TIMES, strokes // _STROKES_A_SPAN))
    by_stroke = sparse.csr_matrix((np.ones(n), (np.arange(n), counted.stroke)), shape=(n, strokes))
    by_speed = _speed_departures(counted)
    found = [
        *_start_departures(counted, by_speed),
        *_stroke_departures(counted, by_stroke),
        *(
            []
            if slow is None
            else [Departure("offset.time", counted.along_path(slow), _smoothness_penalty(slow.shape[1]))]
        ),
        _one_value(counted, "width.time", counted.by_width * counted.width * counted.t),
        *by_speed,
        _one_value(counted, "clock.rate", counted.by_delay * counted.t),
        _one_value(counted, "clock.drift", counted.by_delay * (counted.t**2 - 1 / 12)),
        *_lag_departures(counted),
    ]
    if searched.slip_s is not None:
        slipped = (counted.time_s >= searched.slip_s).astype(float)[:, None]
        found.append(Departure("offset.slip", counted.along_path(slipped), np.eye(1), price=_SCAN))
    if counted.load is not None and np.ptp(counted.load) > 0:
        found.append(_load_departure(counted, counted.load))
    recordings = int(counted.recording.max(initial=0)) + 1
    if recordings > 1 and (_same_places(counted, recordings) if apart is None else apart):
        found += _recording_departures(counted, recordings)
    if counted.slope.shape[1] > 1:
        found += _image_departures(counted, searched, slow, by_stroke)
    return found


def _one_value(counted: CountedFrames, name: str, column: Array) -> Departure:
    """The departure with one value, from what one unit of it adds to p at each frame, column (n,)."""
    return Departure(name, counted.along_path(column[:, None]), np.eye(1))


def _start_departures(counted: CountedFrames, by_speed: Sequence[Departure]) -> list[Departure]:
    """How the tip starts after a reversal, as a curve over the motor's travel since the turn, in widths B. phase.even:
    an offset of p along the stroke's direction, alike both ways; not beside a width by speed, which looks like it.
    phase.odd: an offset of p that has the same sign both ways, so that the tip starts early one way and late the
    other."""
    hats = _hat_functions(counted.phase, _PHASES)[:, :-1]  # without the last one: 0 from there on
    smooth = _smoothness_penalty(hats.shape[1])
    even = counted.along_path(scaled_rows(counted.direction, hats))
    return [
        Departure("phase.even", even, smooth, not_beside=frozenset(part.name for part in by_speed)),
        Departure("phase.odd", counted.along_path(hats), smooth),
    ]


def _stroke_departures(counted: CountedFrames, by_stroke: Sparse) -> list[Departure]:
    """An offset of p for each half-cycle, at all its frames (stroke), and one at those where the tip rests (turn).
    by_stroke (n, strokes): 1 where a frame is of a stroke."""
    resting = scaled_rows(np.where(counted.moving, 0.0, 1.0), by_stroke)
    each = np.eye(by_stroke.shape[1])
    return [
        Departure("stroke", counted.along_path(by_stroke), each),
        Departure("turn", counted.along_path(resting), each),
    ]


def _speed_departures(counted: CountedFrames) -> list[Departure]:
    """A width that depends on the motor's speed: B + v (law - 1) or, with SHARE in the name, B (1 + v (law - 1)), v
    being the value. law is 1 at the usual speed and rises as 1 - exp(-speed / (a usual)), with a candidate for each a
    of _SATURATES. While the tip does not move, as the motor rests or crosses the play, law is 0: a motor that stops
    passes every speed and leaves the tip where a slow one would; or it is 1, as if the width stayed the usual one (".0"
    in the name). Only one of all joins, and not beside phase.even, which looks alike."""
    speeds = np.abs(counted.speed)
    usual = max(float(np.mean(speeds[counted.moving])) if counted.moving.any() else 0.0, 1e-12)
    laws = {f"{SPEED}.{a:g}": -np.expm1(-speeds / (a * usual)) / -np.expm1(-1.0 / a) for a in _SATURATES}
    laws |= {f"{name}.0": np.where(counted.moving, law, 1.0) for name, law in laws.items()}
    columns = {name: counted.by_width * (law - 1.0) for name, law in laws.items()}
    columns |= {name + SHARE: column * counted.width for name, column in columns.items()}
    alike = frozenset(columns) | {"phase.even"}
    return [
        Departure(name, counted.along_path(values[:, None]), np.eye(1), not_beside=alike)
        for name, values in columns.items()
    ]


def _lag_departures(counted: CountedFrames) -> list[Departure]:
    """A first-order lag and a creep, each with a candidate for every time constant tau, of which one joins at most.
    lag: its value is the lag's time, s, its column what a lag adds to p over tau. creep: its value is a share, its
    column what a slow lag adds to p."""
    behind = counted.lag_columns(_LAGS_S + _CREEPS_S)
    lags, creeps = behind[:, : len(_LAGS_S)] / np.array(_LAGS_S), behind[:, len(_LAGS_S) :]
    found = []
    for kind, times_s, columns in (("lag", _LAGS_S, lags), ("creep", _CREEPS_S, creeps)):
        names = [f"{kind}.{tau:g}" for tau in times_s]
        for i, name in enumerate(names):
            column = counted.along_path(columns[:, [i]])
            found.append(Departure(name, column, np.eye(1), one_way=True, not_beside=frozenset(names)))
    return found


def _load_departure(counted: CountedFrames, load: Array) -> Departure:
    """An offset of p, a width and a gain that are proportional to the logged load (n,), in its standard deviations."""
    load = load / np.std(load)
    effects = np.column_stack([load, counted.by_width * load, (counted.p - counted.p.mean()) * load])
    return Departure("load", counted.along_path(effects), np.eye(3))


def _recording_departures(counted: CountedFrames, recordings: int) -> list[Departure]:
    """An offset of p and a share of B that differ between recordings, (recordings - 1) values each (`contrasts`)."""
    which, free = contrasts(recordings)[counted.recording], np.eye(recordings - 1)
    return [
        Departure("offset.recording", counted.along_path(which), free),
        Departure(
            "width.recording", counted.along_path(which * (counted.by_width * counted.width)[:, None]), free
        ),
    ]  # fmt: skip


def _image_departures(
    counted: CountedFrames, searched: SearchedParameters, slow: Sparse | None, by_stroke: Sparse
) -> list[Departure]:
    """The image's own motion against the instrument: slowly in time; on each stroke (or the tracker's error in its
    place); by direction; one shift, with which each place may move in its own way; one sine. slow (n, splines), None
    where the session is too short; by_stroke (n, strokes)."""
    channels = counted.slope.shape[1]
    found = []
    if slow is not None:
        found.append(Departure("image.time", counted.per_channel(slow), _smoothness_penalty(slow.shape[1], channels)))
    length_px = searched.tracker_length_px
    name, pieces = ("image.stroke", by_stroke) if length_px is None else ("tracker", _path_pieces(counted, length_px))
    found.append(Departure(name, counted.per_channel(pieces), np.eye(channels * pieces.shape[1])))
    found.append(Departure("image.side", counted.per_channel(counted.side[:, None]), np.eye(channels)))
    if searched.shift_s is not None:
        after = (counted.time_s >= searched.shift_s).astype(float)[:, None]
        shifted = counted.per_channel(after * _place_polynomials(counted))
        found.append(Departure("image.shift", shifted, np.eye(3 * channels), price=_SCAN))
    if searched.breath_hz is not None:
        angle = 2 * np.pi * searched.breath_hz * counted.time_s
        waves = np.column_stack([np.cos(angle), np.sin(angle)])
        found.append(Departure("image.breath", counted.per_channel(waves), np.eye(2 * channels), price=_SCAN))
    return found


# ---- the error of a marker's tracker


def tracker_error_length(counted: CountedFrames) -> float | None:
    """Length of the image's path, px, over which an error of the tracker stays alike before it begins anew, as behind a
    video codec that holds back what moves little; None if there is no such error. It shows in what neighbouring frames
    of a stroke share (autocovariance): that lies across the path as well as along it, as nothing of the tip does; it
    differs between both halves of a stroke, as no shift of the camera does; and it is no sine. The length is the
    image's way until neighbours share _HALF as much, and at least 1 / _PIECES of the way of all strokes."""
    if counted.slope.shape[1] < 2 or len(counted.p) < 4 * _LAGS:
        return None
    left = counted.residuals * counted.weight[:, None]
    direction = counted.slope / np.maximum(np.linalg.norm(counted.slope, axis=1), 1e-12)[:, None]
    along = np.sum(left * direction, axis=1)
    across = left[:, 0] * direction[:, 1] - left[:, 1] * direction[:, 0]

    def shared_at(values: Array, lag: int = 1) -> float:
        """Autocovariance of values (n,) at this lag, in frames, within strokes; in units of the noise squared."""
        same = counted.stroke[lag:] == counted.stroke[:-lag]
        return float(np.mean((values[lag:] * values[:-lag])[same])) if same.any() else 0.0

    near = shared_at(along) + shared_at(across)
    if near < _LASTS * float(np.mean(np.sum(left**2, axis=1))) or shared_at(across) < _ACROSS * shared_at(along):
        return None
    if _shared_by_halves(left, counted.stroke) > _CONSTANT * near or _share_of_sine(counted.time_s, left) > _SWAYS:
        return None
    place = _path_in_stroke(counted)
    # The first lag, in frames, at which _HALF is left; then the median way of the image in so many frames.
    fallen = (lag for lag in range(1, _LAGS) if shared_at(along, lag) + shared_at(across, lag) < _HALF * near)
    lag = next(fallen, _LAGS - 1)
    same = (counted.stroke[lag:] == counted.stroke[:-lag]) & counted.moving[lag:]
    gone = float(np.median((place[lag:] - place[:-lag])[same])) if same.any() else 0.0
    return max(gone, float(np.sum(np.maximum(np.diff(place), 0.0))) / _PIECES)


def _path_in_stroke(counted: CountedFrames) -> Array:
    """(n,) how far the image has gone along its path since the stroke began, px."""
    step = np.linalg.norm(counted.slope / counted.inverse[:, None], axis=1)[1:] * np.abs(np.diff(counted.p))
    gone = np.concatenate([[0.0], np.cumsum(step)])
    first = np.searchsorted(counted.stroke, counted.stroke, side="left")
    return np.asarray(gone - gone[first])


def _path_pieces(counted: CountedFrames, length_px: float) -> sparse.csr_matrix:
    """(n, nodes) piecewise linear basis over the image's path of each stroke, with a node every length_px from its
    begin; nodes that no frame is next to are left out."""
    place = _path_in_stroke(counted) / length_px
    spans = np.zeros(int(counted.stroke.max(initial=0)) + 1, dtype=np.intp)
    np.maximum.at(spans, counted.stroke, place.astype(np.intp) + 1)
    first = np.concatenate([[0], np.cumsum(spans + 1)])
    at = first[counted.stroke] + place.astype(np.intp)  # each frame's node before it, numbered on over all strokes
    share, n = place % 1.0, np.arange(len(place))
    seen, node = np.unique(np.concatenate([at, at + 1]), return_inverse=True)
    values = np.concatenate([1.0 - share, share]), (np.concatenate([n, n]), node)
    return sparse.csr_matrix(values, shape=(len(place), len(seen)))


def _shared_by_halves(left: Array, stroke: npt.NDArray[np.intp]) -> float:
    """Variance of the part of the residuals left (n, channels) that is constant over a stroke, summed over channels, in
    units of the noise's. It is the mean over strokes of m1 . m2, the mean residuals of a stroke's two halves: their
    noise is independent and adds nothing. stroke (n,): each frame's stroke number. 0 if all strokes have fewer than
    _HALVES frames."""
    begins = np.flatnonzero(np.diff(stroke, prepend=-1))
    ends = np.append(begins[1:], len(stroke))
    pairs = [
        (left[a : (a + b) // 2], left[(a + b) // 2 : b]) for a, b in zip(begins, ends, strict=True) if b - a >= _HALVES
    ]
    return float(np.mean([early.mean(axis=0) @ late.mean(axis=0) for early, late in pairs])) if pairs else 0.0


def _share_of_sine(t: Array, left: Array) -> float:
    """Share (0 to 1) of the variance of residuals left (n, channels) at times t (n,), s, that a sine of the best
    frequency explains; 0 where no frequency can be told."""
    rate = _sway_frequency(t, left)
    if rate is None:
        return 0.0
    angle = 2 * np.pi * rate * t
    waves = np.column_stack([np.cos(angle), np.sin(angle), np.ones_like(t)])
    rest = left - waves @ np.linalg.lstsq(waves, left, rcond=None)[0]
    return 1.0 - float(np.sum(rest**2)) / max(float(np.sum((left - left.mean(axis=0)) ** 2)), 1e-30)


# ---- columns and penalties


def contrasts(recordings: int) -> Array:
    """(recordings, recordings - 1) orthonormal contrasts (Helmert): what each recording differs by from the mean of
    all, which the nominal path and B already are."""
    return np.asarray(helmert(recordings).T)


def _same_places(counted: CountedFrames, recordings: int) -> bool:
    """Whether all recordings show much the same positions: the range that they share is more than _MUCH of the widest.
    If not, what differs between them may be the place."""
    spans = [counted.p[counted.recording == k] for k in range(recordings)]
    if any(len(span) == 0 for span in spans):
        return False
    shared = min(float(span.max()) for span in spans) - max(float(span.min()) for span in spans)
    return shared > _MUCH * max(float(np.ptp(span)) for span in spans)


def _place_polynomials(counted: CountedFrames) -> Array:
    """(n, 3) constant, linear and quadratic in p, scaled by its mean and standard deviation. With these columns an
    image motion may differ along the path, as a rigid motion moves each place in its own way."""
    x = (counted.p - counted.p.mean()) / max(float(np.std(counted.p)), 1e-12)
    return np.column_stack([np.ones_like(x), x, x**2 - 1])


def _hat_functions(x: Array, nodes: Array) -> sparse.csr_matrix:
    """(n, nodes) piecewise linear basis at x (n,); 0 beyond the last node."""
    n = np.flatnonzero(x < nodes[-1])
    at = np.clip(np.searchsorted(nodes, x[n], side="right") - 1, 0, len(nodes) - 2)
    share = (x[n] - nodes[at]) / (nodes[at + 1] - nodes[at])
    places = np.concatenate([n, n]), np.concatenate([at, at + 1])
    return sparse.csr_matrix((np.concatenate([1 - share, share]), places), shape=(len(x), len(nodes)))


def slow_basis(t: Array, spans: int) -> Sparse | None:
    """Cubic B-splines (n, spans + 3) at times t (n,) of the session, -1/2 to 1/2. None with fewer than 2 spans, as they
    would be no slower than the motion."""
    if spans < 2:
        return None
    knots = -0.5 + np.arange(-3, spans + 4) / spans
    return sparse.csr_matrix(BSpline.design_matrix(np.clip(t, -0.5, 0.5 - 1e-9), knots, 3))


def _smoothness_penalty(size: int, channels: int = 1) -> Array:
    """(channels * size, channels * size) penalty on the squared differences of neighbouring values, plus _PULL times
    the squared values, for each channel alike."""
    step = np.diff(np.eye(size), 1, axis=0)
    rough = step.T @ step + _PULL * np.eye(size)
    return np.asarray(np.kron(np.eye(channels), rough), dtype=float)


# ---- searches in the residuals


def _shift_time(t: Array, left: Array) -> float | None:
    """The time t, s, of the first frame after the step of the image that explains most of the residuals left (n,
    channels) at times t (n,). It has the largest CUSUM statistic |S_k|^2 n / (k (n - k)), S_k the sum of the first k
    residuals less their mean; k is at least _ENDS from either end. None with fewer than 3 _ENDS frames."""
    n = len(left)
    if n < 3 * _ENDS:
        return None
    total = np.cumsum(left - left.mean(axis=0), axis=0)[_ENDS:-_ENDS]
    k = np.arange(_ENDS, n - _ENDS) + 1.0  # frames before the step
    gain = np.sum(total**2, axis=1) * n / (k * (n - k))
    return float(t[int(np.argmax(gain)) + _ENDS + 1])


def _slip_time(counted: CountedFrames, left: Array) -> float | None:
    """The session time, s, of the first frame from which on an offset of p explains most of the residuals left (n,
    channels), beside an offset for the whole session; at least _ENDS frames from either end. None with fewer than 3
    _ENDS frames."""
    if len(left) < 3 * _ENDS:
        return None
    pull, power = np.sum(left * counted.slope, axis=1), np.sum(counted.slope**2, axis=1)
    share = np.cumsum(power) / max(float(power.sum()), 1e-30)
    inside = slice(_ENDS, -_ENDS)
    # The squares that such an offset explains, times the power of all frames: (S_k - a_k S)^2 / (a_k (1 - a_k)). S_k is
    # the sum of residual times slope until frame k, a_k the share of the slopes' power until there.
    gain = (np.cumsum(pull) - share * pull.sum())[inside] ** 2 / np.maximum(share * (1.0 - share), 1e-12)[inside]
    return float(counted.time_s[int(np.argmax(gain)) + _ENDS + 1])


def _sway_frequency(t: Array, left: Array) -> float | None:
    """The frequency, Hz, of the largest peak in the periodogram of residuals left (n, channels) at times t (n,), s,
    within _BREATHS_HZ, of which the session must hold more than _CYCLES. None with fewer than _WAVE_FEWEST frames, or
    in a session too short for any. The residuals are interpolated to even times: as many as there are frames, or more
    where long gaps part these, up to _A_CYCLE for a cycle of the fastest sway and never closer than the median of the
    frames."""
    if len(t) < _WAVE_FEWEST:
        return None
    lasts = t[-1] - t[0]
    closest = max(float(np.median(np.diff(t))), 1.0 / (_A_CYCLE * _BREATHS_HZ[1]))
    even = np.linspace(t[0], t[-1], max(len(t), min(int(lasts / closest), _MOST_SAMPLES)))
    step = even[1] - even[0]
    waves = [np.interp(even, t, channel) for channel in left.T]
    power = sum(np.abs(np.fft.rfft(wave - wave.mean(), _FINER * len(even))) ** 2 for wave in waves)
    rates = np.fft.rfftfreq(_FINER * len(even), step)
    inside = (rates > max(_BREATHS_HZ[0], _CYCLES / lasts)) & (rates < _BREATHS_HZ[1])
    return float(rates[inside][int(np.argmax(np.asarray(power)[inside]))]) if inside.any() else None
