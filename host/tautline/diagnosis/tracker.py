"""The error of the marker's tracker in videos as a function of the place in the image, from the calibration's frames.

Shading, a glint, glare and a codec shift the marker alike whenever it is at the same place. Nothing that moves the tip
along its path shifts the marker across it: so the median that the calibration shows across the path at each place is
taken off all recordings, and what that leaves is the noise of a moving marker. Places where the calibration scatters
much more than elsewhere are scored in no recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.interpolate import make_smoothing_spline
from scipy.spatial import KDTree

from tautline import spread
from tautline.diagnosis import gap
from tautline.diagnosis.segment import Segment
from tautline.geometry import project
from tautline.model import Model
from tautline.recording import Recording

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_PLACE_PX = 4.0  # tolerance: px along the path: shortest stretch that is a place of its own
_HOLE_PX = 12.0  # tolerance: px along the path: a longer stretch without the marker is a hole
_FEWEST, _PLACES = 6, 20  # tolerance: frames from which a place is known, places from which a tracker is
# A place is wrong if a share _SEVERAL of its frames is _FAR off, or its scatter is _WILD times the usual one.
_FAR, _SEVERAL, _WILD = 6.0, 0.1, 2.0  # tolerance: usual scatters, share of a place's frames, usual scatters
_PARTS = 8  # tolerance: contiguous parts of a calibration, whose alternate ones predict the others
_STEP_DEG = 0.05  # tolerance: deg between points of the path
_BEYOND_DEG = 5.0  # tolerance: deg by which the path goes beyond the model's angles


@dataclass(frozen=True)
class TrackerError:
    """Recordings with the tracker's error taken off, and the noise that is left."""

    segments: list[Segment]  # observations corrected, places that are wrong not scored
    noise: float  # px, one standard deviation per coordinate of a moving marker
    doubt: float  # of the logarithm of its power: how far it may be off, as more or less of it is an error by place
    unsteady: float  # standard deviation of the logarithm of its power between blocks
    left_out: float  # share of the frames that are not scored as their place is wrong

    def to_json(self) -> dict[str, float]:
        """The object `tracker` of diagnosis.json; it has only the noise and the share of frames that are left out."""
        return {"noise": self.noise, "left_out": self.left_out}


def without_tracker_error(model: Model, segments: Sequence[Segment], load_reference: float) -> TrackerError | None:
    """Takes the tracker's error off recordings of videos, the calibration first, and estimates the noise of a moving
    marker. None where the observations are no pixels, other axes move (and so the marker's path), the calibration shows
    too few places, or a recording would be left without a scored frame. load_reference: mNm at which the model's tables
    hold."""
    other_axes = (column for s in segments for column in (s.motor.translation_mm, s.motor.rotation_deg))
    if segments[0].unit != "px" or any(column is not None and np.ptp(column) > 0.0 for column in other_axes):
        return None
    path = _Path.of(model)
    views = [path.view(s.observed, s.predict(model, {}, load_reference)[1]) for s in segments]
    places = _Places.of(views[0], segments[0].scored)
    if places is None:
        return None
    corrected, scored = [], 0
    for segment, view in zip(segments, views, strict=True):
        observed = segment.observed - places.across(view.seen)[:, None] * path.normal[view.at]
        right = places.are_right(view.seen) & places.are_right(view.expected)
        corrected.append(replace(segment, observed=observed).part(right))
        scored += int(segment.scored.sum())
    kept = sum(int(segment.scored.sum()) for segment in corrected)
    if not all(segment.scored.any() for segment in corrected):
        return None
    in_calibration = corrected[0].scored
    in_sample = gap.rms([(views[0].across - places.across(views[0].seen))[in_calibration]])
    held_out = _cross_validated_error(views[0], in_calibration, places)
    out_of_sample = max(gap.rms([held_out]), in_sample)
    # The noise is between the two: their geometric mean, in doubt by their distance.
    noise, doubt = float(np.sqrt(in_sample * out_of_sample)), float(np.log(out_of_sample / in_sample))
    unsteady = _spread_of_log_power(held_out, gap.blocks(corrected[0]))
    return TrackerError(corrected, noise, doubt, unsteady, 1.0 - kept / scored)


def of_videos(
    model: Model, segments: Sequence[Segment], load_reference: float, recordings: Sequence[Recording]
) -> TrackerError | None:
    """As `without_tracker_error`, if every recording has a video that was tracked here; else None."""
    if any(recording.video is None for recording in recordings):
        return None
    return without_tracker_error(model, segments, load_reference)


def _cross_validated_error(view: _View, scored: Mask, places: _Places) -> Array:
    """(scored,) px across the path: what is left of each of the calibration's frames by the error that the other half
    of the calibration shows at its place. The halves are alternate ones of _PARTS parts, as an error of a single pass,
    such as a codec's, is no error of the place. At places that are wrong by the other half, or beyond its first and
    last right one, and where the other half tells too few places, the error by the whole calibration is taken."""
    half = np.arange(len(scored)) * _PARTS // len(scored) % 2
    residual = view.across - places.across(view.seen)
    for tested in (half == 0, half == 1):
        others = _Places.of(view, scored & ~tested)
        if others is not None:
            known = tested & others.are_right(view.seen) & others.reach(view.seen)
            residual = np.where(known, view.across - others.across(view.seen), residual)
    return np.asarray(residual[scored])


def _spread_of_log_power(residual: Array, block: npt.NDArray[np.int64]) -> float:
    """Standard deviation, between blocks, of the natural log of a block's mean square. residual, block (its number):
    (scored,)."""
    frames = np.bincount(block)
    power = np.bincount(block, residual**2)[frames > 0] / frames[frames > 0]
    return float(np.std(np.log(power)))


@dataclass(frozen=True)
class _View:
    """The n frames of a recording in coordinates along and across the marker's path, px."""

    at: npt.NDArray[np.intp]  # (n,) index of the path's point that is nearest to the observed marker
    seen: Array  # (n,) length along the path to that point
    expected: Array  # (n,) length along the path to the point nearest to the predicted marker
    across: Array  # (n,) observed marker across the path
    along: Array  # (n,) observed less predicted marker along the path


@dataclass(frozen=True)
class _Path:
    """The marker's path in the image as the model predicts it: m points."""

    point: Array  # (m, 2) px
    normal: Array  # (m, 2) unit vectors across the path
    length: Array  # (m,) px along the path from its first point

    @classmethod
    def of(cls, model: Model) -> _Path:
        """The path over the model's bending angles, extended by _BEYOND_DEG at either end."""
        low, high = float(np.min(model.c_deg)) - _BEYOND_DEG, float(np.max(model.c_deg)) + _BEYOND_DEG
        point = project(model.rig, np.arange(low, high, _STEP_DEG))
        step = np.gradient(point, axis=0)
        tangent = step / np.maximum(np.linalg.norm(step, axis=1), 1e-12)[:, None]
        normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
        lengths = np.linalg.norm(np.diff(point, axis=0), axis=1)
        return cls(point, normal, np.concatenate([[0.0], np.cumsum(lengths)]))

    def view(self, observed: Array, predicted: Array) -> _View:
        """The frames of a recording in coordinates along and across the path, each relative to the nearest point of the
        path. observed, predicted: marker, (n, 2) px."""
        tree = KDTree(self.point)
        at, expected = (np.asarray(tree.query(positions)[1], dtype=np.intp) for positions in (observed, predicted))
        normal = self.normal[at]
        tangent = np.column_stack([normal[:, 1], -normal[:, 0]])  # as c rises
        across = np.sum((observed - self.point[at]) * normal, axis=1)
        along = np.sum((observed - predicted) * tangent, axis=1)
        return _View(at, self.length[at], self.length[expected], across, along)


def _stretch_edges(seen: Array) -> Array:
    """Edges, px along the path, of stretches that each have at least _FEWEST frames and a length of _PLACE_PX. Where
    the marker was not seen for more than _HOLE_PX, the hole is a stretch of its own. seen: sorted positions (n,) of the
    marker, px along the path."""
    edges = [seen[0]]
    frames = 0
    for before, position in pairwise(seen):
        frames += 1
        if position - before > _HOLE_PX:
            edges += [before, position]
            frames = 0
        elif frames >= _FEWEST and position - edges[-1] >= _PLACE_PX:
            edges.append(position)
            frames = 0
    return np.unique([*edges, seen[-1] + 1e-9])


def _medians_by_place(view: _View, scored: Mask, place: npt.NDArray[np.intp], known: Mask) -> tuple[Array, Array]:
    """((places,) median across the path of a place's scored frames, (places,) their scatter, one standard deviation in
    one direction), px; NaN for places that are not `known`. place (n,): index of each frame's place."""
    across, scatter = np.full((2, len(known)), np.nan)
    for k in np.flatnonzero(known):
        at_place = scored & (place == k)
        across[k], along = np.median(view.across[at_place]), np.median(view.along[at_place])
        off = np.abs(view.across[at_place] - across[k]) + np.abs(view.along[at_place] - along)
        scatter[k] = 0.5 * spread.deviation(off)  # of one direction: `off` adds two
    return across, scatter


@dataclass(frozen=True)
class _Places:
    """The tracker's error at stretches of the path (places), estimated from the calibration's frames."""

    edges: Array  # (places + 1,) px along the path
    wrong: Mask  # (places,) at which it cannot be trusted
    middle: Array  # (right places,) px along the path
    error: Array  # (right places,) px across the path

    @classmethod
    def of(cls, view: _View, scored: Mask) -> _Places | None:
        """Estimates the error from the calibration's scored frames: the median across the path at each place, smoothed
        along it. A place is wrong if many of its frames are far off, if its scatter is large, or if it is next to such
        a place. None where fewer than _PLACES places have enough frames, or are right."""
        if not scored.any():
            return None
        edges = _stretch_edges(np.sort(view.seen[scored]))
        count = len(edges) - 1
        place = np.clip(np.digitize(view.seen, edges) - 1, 0, count - 1)
        frames = np.bincount(place[scored], minlength=count)
        known = frames >= _FEWEST
        if known.sum() < _PLACES:
            return None
        across, scatter = _medians_by_place(view, scored, place, known)
        usual = float(np.nanmedian(scatter))
        distance = np.hypot(view.across - float(np.nanmedian(across)), view.along)
        far = np.bincount(place[scored & (distance > _FAR * usual)], minlength=count)
        wrong = (far >= _SEVERAL * frames) | (scatter > _WILD * usual)  # a place without frames too: 0 >= 0
        wrong = wrong | np.append(False, wrong[:-1]) | np.append(wrong[1:], False)
        right = known & ~wrong
        if right.sum() < _PLACES:
            return None
        middle = 0.5 * (edges[:-1] + edges[1:])[right]
        smooth = make_smoothing_spline(middle, across[right], frames[right].astype(float))
        return cls(edges, wrong, middle, np.asarray(smooth(middle)))

    def across(self, along: Array) -> Array:
        """(n,) The tracker's error, px across the path, at the positions `along` (n,), px along it; beyond the right
        places that of the last one."""
        return np.interp(along, self.middle, self.error)

    def reach(self, along: Array) -> Mask:
        """(n,) Whether the positions `along` (n,), px along the path, lie between the first and the last right
        place."""
        reached: Mask = (along >= self.middle[0]) & (along <= self.middle[-1])
        return reached

    def are_right(self, along: Array) -> Mask:
        """(n,) Whether the positions `along` (n,), px along the path, are at no wrong place; True also beyond all
        places."""
        place = np.digitize(along, self.edges) - 1
        inside = (place >= 0) & (place < len(self.wrong))
        right: Mask = ~(inside & self.wrong[np.clip(place, 0, len(self.wrong) - 1)])
        return right
