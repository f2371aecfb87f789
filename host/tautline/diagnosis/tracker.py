"""What the marker's tracker errs by in videos, as the calibration's passes over each place show it.

Shading, a glint, glare and a codec move the marker in the picture alike whenever it is there. Across its path nothing
that moves the tip along it can be the cause: what the calibration sees there is taken off all recordings, and what it
leaves is the noise of a moving marker. Where it leaves much more than elsewhere no recording is scored.
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

_PLACE_PX, _HOLE_PX = 4.0, 12.0  # tolerance: along the path: told apart at least; where no frame shows the marker
_FEWEST, _PLACES = 6, 20  # tolerance: frames that tell of a place, places that tell of a tracker
# A calibration does not hold where so large a share of frames is so many noises off, or where they scatter so much.
_FAR, _SEVERAL, _WILD = 6.0, 0.1, 2.0  # tolerance: noises, share of a place's frames, times the usual scatter
_PARTS = 8  # tolerance: of a calibration, by turns
_STEP_DEG = 0.05
_BEYOND_DEG = 5.0


@dataclass(frozen=True)
class TrackerError:
    segments: list[Segment]
    noise: float  # px rms per coordinate of a moving marker
    doubt: float  # of its power's logarithm: how far it may be off, as more or less of it is counted as the places'
    unsteady: float  # standard deviation of its power's logarithm between blocks
    left_out: float  # share of the frames, where the calibration does not hold

    def to_json(self) -> dict[str, float]:
        return {"noise": self.noise, "left_out": self.left_out}


def without_tracker_error(model: Model, segments: Sequence[Segment], load_reference: float) -> TrackerError | None:
    """Recordings of videos (the calibration first) less the tracker's error at each place along the marker's path, with
    what is left as noise. None where other axes move the path, or the calibration shows too few places."""
    moved = (column for s in segments for column in (s.motor.translation_mm, s.motor.rotation_deg))
    if segments[0].unit != "px" or any(column is not None and np.ptp(column) > 0.0 for column in moved):
        return None
    path = _Path.of(model)
    views = [path.view(s.observed, s.predict(model, {}, load_reference)[1]) for s in segments]
    places = _Places.of(views[0], segments[0].scored)
    if places is None:
        return None
    corrected, scored = [], 0
    for segment, view in zip(segments, views, strict=True):
        observed = segment.observed - places.across(view.seen)[:, None] * path.normal[view.at]
        holds = places.holds(view.seen) & places.holds(view.expected)
        corrected.append(replace(segment, observed=observed).part(holds))
        scored += int(segment.scored.sum())
    kept = sum(int(segment.scored.sum()) for segment in corrected)
    if not all(segment.scored.any() for segment in corrected):
        return None
    first = corrected[0].scored
    own = gap.rms([(views[0].across - places.across(views[0].seen))[first]])
    left = _cross_validated_error(views[0], first, places)
    others = max(gap.rms([left]), own)
    # The noise is between the two: their geometric mean, in doubt by their distance.
    noise, doubt = float(np.sqrt(own * others)), float(np.log(others / own))
    return TrackerError(
        corrected, noise, doubt, _spread_of_log_power(left, gap.blocks(corrected[0])), 1.0 - kept / scored
    )


def of_videos(
    model: Model, segments: Sequence[Segment], load_reference: float, recordings: Sequence[Recording]
) -> TrackerError | None:
    """`without_tracker_error`, if all recordings are videos tracked here; else None."""
    if any(recording.video is None for recording in recordings):
        return None
    return without_tracker_error(model, segments, load_reference)


def _cross_validated_error(view: _View, scored: Mask, places: _Places) -> Array:
    """(scored,) px across the path, each frame less the error that the other half of the calibration shows at its place
    (all of it, where that half does not): an error of one pass, as a codec makes it, is not the place's."""
    part = np.arange(len(scored)) * _PARTS // len(scored) % 2
    left = view.across - places.across(view.seen)
    for own in (part == 0, part == 1):
        others = _Places.of(view, scored & ~own)
        if others is not None:
            known = own & others.holds(view.seen) & others.reaches(view.seen)
            left = np.where(known, view.across - others.across(view.seen), left)
    return np.asarray(left[scored])


def _spread_of_log_power(left: Array, block: npt.NDArray[np.int64]) -> float:
    """Standard deviation between blocks of the natural logarithm of their mean square. left, block: (scored,)."""
    frames = np.bincount(block)
    power = np.bincount(block, left**2)[frames > 0] / frames[frames > 0]
    return float(np.std(np.log(power)))


@dataclass(frozen=True)
class _View:
    """A recording's frames beside the path. (n,), px but `at`."""

    at: npt.NDArray[np.intp]  # the path's point that is nearest to what was seen
    seen: Array  # along the path: where the marker was seen
    expected: Array  # and where the model has it
    across: Array
    along: Array


@dataclass(frozen=True)
class _Path:
    """Where the marker can be seen, by the model: (m, 2) px."""

    point: Array
    normal: Array
    length: Array  # (m,)

    @classmethod
    def of(cls, model: Model) -> _Path:
        """The marker's path in the image over the model's angles, and _BEYOND_DEG farther."""
        low, high = float(np.min(model.c_deg)) - _BEYOND_DEG, float(np.max(model.c_deg)) + _BEYOND_DEG
        point = project(model.rig, np.arange(low, high, _STEP_DEG))
        step = np.gradient(point, axis=0)
        way = step / np.maximum(np.linalg.norm(step, axis=1), 1e-12)[:, None]
        lengths = np.linalg.norm(np.diff(point, axis=0), axis=1)
        return cls(point, np.column_stack([-way[:, 1], way[:, 0]]), np.concatenate([[0.0], np.cumsum(lengths)]))

    def view(self, observed: Array, predicted: Array) -> _View:
        """A recording's frames in coordinates along and across the path. observed, predicted: (n, 2) px."""
        tree = KDTree(self.point)
        at, expected = (np.asarray(tree.query(where)[1], dtype=np.intp) for where in (observed, predicted))
        normal = self.normal[at]
        way = np.column_stack([normal[:, 1], -normal[:, 0]])  # as c rises
        across = np.sum((observed - self.point[at]) * normal, axis=1)
        along = np.sum((observed - predicted) * way, axis=1)
        return _View(at, self.length[at], self.length[expected], across, along)


def _stretch_edges(seen: Array) -> Array:
    """Edges, px along the path, of stretches with at least _FEWEST frames and _PLACE_PX; a hole without frames becomes
    a stretch of its own. seen: sorted positions along the path."""
    edges = [seen[0]]
    frames = 0
    for last, at in pairwise(seen):
        frames += 1
        if at - last > _HOLE_PX:
            edges += [last, at]
            frames = 0
        elif frames >= _FEWEST and at - edges[-1] >= _PLACE_PX:
            edges.append(at)
            frames = 0
    return np.unique([*edges, seen[-1] + 1e-9])


@dataclass(frozen=True)
class _Places:
    """Stretches of the path, as the calibration saw them."""

    edges: Array
    wrong: Mask  # (places,)
    middle: Array  # of those that are right, px along the path
    error: Array  # across it there

    @classmethod
    def of(cls, view: _View, scored: Mask) -> _Places | None:
        """From the calibration's scored frames: the median error of each stretch, smoothed along the path, and which
        stretches are wrong (many far frames or a large scatter, or beside such a one). None where fewer than _PLACES
        are right."""
        edges = _stretch_edges(np.sort(view.seen[scored]))
        count = len(edges) - 1
        place = np.clip(np.digitize(view.seen, edges) - 1, 0, count - 1)
        frames = np.bincount(place[scored], minlength=count)
        told = frames >= _FEWEST
        if told.sum() < _PLACES:
            return None
        across, along, scatter = np.full((3, count), np.nan)
        for k in np.flatnonzero(told):
            here = scored & (place == k)
            across[k], along[k] = np.median(view.across[here]), np.median(view.along[here])
            off = np.abs(view.across[here] - across[k]) + np.abs(view.along[here] - along[k])
            scatter[k] = 0.5 * spread.deviation(off)
        noise = float(np.nanmedian(scatter))
        off = np.hypot(view.across - float(np.nanmedian(across)), view.along)
        far = np.bincount(place[scored & (off > _FAR * noise)], minlength=count)
        wrong = (far >= _SEVERAL * frames) | (scatter > _WILD * noise)  # or nothing was seen there
        wrong = wrong | np.append(False, wrong[:-1]) | np.append(wrong[1:], False)
        right = told & ~wrong
        if right.sum() < _PLACES:
            return None
        middle = 0.5 * (edges[:-1] + edges[1:])[right]
        smooth = make_smoothing_spline(middle, across[right], frames[right].astype(float))
        return cls(edges, wrong, middle, np.asarray(smooth(middle)))

    def across(self, at: Array) -> Array:
        """px across the path, by which the marker is seen off at these positions along it."""
        return np.interp(at, self.middle, self.error)

    def reaches(self, at: Array) -> Mask:
        """Whether these positions lie between the first and the last stretch that is right."""
        reaches: Mask = (at >= self.middle[0]) & (at <= self.middle[-1])
        return reaches

    def holds(self, at: Array) -> Mask:
        """Whether these positions, px along the path, are in no wrong stretch; true beyond all stretches."""
        place = np.digitize(at, self.edges) - 1
        inside = (place >= 0) & (place < len(self.wrong))
        holds: Mask = ~(inside & self.wrong[np.clip(place, 0, len(self.wrong) - 1)])
        return holds
