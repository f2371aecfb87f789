"""The marker tracker: where a coloured marker is in each frame, to a few hundredths of a pixel, and how surely it is
known."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from math import sqrt

import cv2
import numpy as np
import numpy.typing as npt

from tautline._native import MARKER_CLIPPED, MARKER_CUT_OFF, MARKER_FOUND, MarkerExpected, marker_measure
from tautline.errors import TautError
from tautline.recording import COLOUR_FILE, REGION_FILE, Marker, Recording, Shown, Video
from tautline.rig import Rig
from tautline.vision.camera import sample_video
from tautline.vision.colour import MarkerColour, candidates, pick
from tautline.vision.frames import Progress, every_frame, half_progress
from tautline.vision.region import Region
from tautline.vision.scene import bending_by_scene
from tautline.vision.sighting import SURE_PX, Sighting, lost_sighting

Array = np.ndarray

_HALF_WAY = 0.5  # membership, half-way between the marker and what is around it
_FAINT = 0.3  # of the picked contrast: fainter is no marker
_LIKE = 0.92  # cosine between its colour and the picked one: 23 deg, which leaves room for glare
_SHRUNK, _GROWN = 0.5, 1.8  # tolerance: diameter against when it was seen last that is still the same marker
_FORGOTTEN = 50  # prior: frames after which what is found may be of any size again
_SMALLER, _LARGER = 0.3, 4.0  # diameter against the picked one
_KEPT = 0.3  # limit: share of the outline that must be seen
_UNSURE = 0.2  # limit: sigma against the radius: a place that is known worse is none
_RAGGED, _RAGGED_PX = 0.15, 0.5  # scatter of the edges against the radius, and px: more is no marker but a stain
_REGION = 0.6  # tolerance: of the diameter: half the side of the region around it, without the margin
_GROWS = 0.8  # tolerance: of the region before, that a larger one has beside that
_SAME_PLACE = 0.4  # of the diameter, within which two things are at one place
_NEAR = 4.0  # diameters from where the marker was last, at which another blob is half as likely
# Of the pictures in which a thing that is not the marker stays, and the marker is not there.
_STAYS, _ELSEWHERE = 0.6, 0.4
_LEAP, _FASTER = 0.5, 3.0  # diameters at once, and times its usual speed, that the marker may go while it is not seen
_WHOLE, _AROUND = 0.04, 12  # of its diameter in so many frames to either side: a marker of which nothing is hidden
_PALE = 0.8  # of its usual purity, below which a picked colour is not the marker's own
_AS_OFTEN = 0.9  # as the colour that was picked first, another one has to find the marker
_ALIKE_LIT = 1.5  # prior, diameters: over which light changes little
_LOOKED_AT, _COLOURS = 3, 6  # tolerance: pictures in which colours are looked for, colours in each
_SAMPLES = 24  # frames of a video that are looked at for its marker's colour
_MARGIN_PX = 8.0  # of the region around the marker: edges are compared with what lies 5.5 px beyond them


@dataclass(frozen=True)
class _Blob:
    """A coloured region of the picture that may be the marker, measured."""

    seen: Sighting
    score: float  # how like the marker it is, without unit
    cut: float  # membership half-way between it and what is around it
    after: MarkerExpected  # colour and outline that are expected in the next frame if it is the marker


class MarkerTracker:
    """Follows one marker from frame to frame. It looks around where the marker should be now, and over the whole frame
    when it is not there. About 70 us a frame while it follows a marker of 20 px, 1 to 7 ms where a part of it
    is hidden, 1 ms to search 720 x 576 px.
    """

    def __init__(self, colour: MarkerColour, decoys: Sequence[tuple[float, float]] = ()) -> None:
        """Begins with nothing known of where the marker is. colour: the marker's, as it was picked; decoys: places (u,
        v) px of things with the marker's colour and size that do not move (see `find_decoys`)."""
        self.colour = colour
        self._decoys = np.array(decoys, dtype=float).reshape(-1, 2)  # px
        self._weights = np.array([*colour.weights, colour.offset], dtype=np.float32)
        length = max(sqrt(sum(level * level for level in colour.colour)), 1.0)
        self._hue = tuple(level / length for level in colour.colour)  # unit vector of B, G, R
        self._smallest_px = _SMALLER * colour.diameter_px
        self.reset()

    def reset(self) -> None:
        """Forgets where the marker was: the next frame is searched as a whole."""
        self._last: Sighting | None = None  # of the frame before; None where it was not seen there
        self._last_seen: Sighting | None = None  # where it was seen last ...
        self._frames_unseen = 0  # ... and how many frames ago
        self._step_px = (0.0, 0.0)  # px from the frame before
        self._why_none = lost_sighting("no marker of this colour")  # why the last search found none
        self._cut = _HALF_WAY  # membership at its outline, by the frame before
        self._expected = MarkerExpected(self.colour.diameter_px)  # by the frames so far

    def track(self, picture: Array) -> Sighting:
        """Finds the marker in the next frame, BGR (height, width, 3) uint8: around where it should be if it was seen in
        the frame before, else, or if it is not there, in the whole frame. Lost, with the reason, where it is not
        found."""
        last = self._last
        if last is not None:
            sighting = self._follow(picture, last)
            if sighting.valid and not self._is_decoy(sighting):
                self._step_px = (sighting.u_px - last.u_px, sighting.v_px - last.v_px)
                self._last = self._last_seen = sighting
                return sighting
        self._frames_unseen += 1
        sighting = self._search(picture)
        self._step_px = (0.0, 0.0)
        self._last = sighting if sighting.valid else None
        if sighting.valid:
            self._last_seen, self._frames_unseen = sighting, 0
        return sighting

    def _is_decoy(self, sighting: Sighting) -> bool:
        """Whether a sighting is at the place of a decoy, within _SAME_PLACE of the sighting's diameter."""
        away = np.hypot(*(self._decoys - (sighting.u_px, sighting.v_px)).T)
        return bool((away < _SAME_PLACE * sighting.diameter_px).any())

    def _follow(self, picture: Array, last: Sighting) -> Sighting:
        """Looks for the marker in a BGR picture where it should be if it moves on from its `last` sighting by the same
        step as before. Lost, with the reason, where it is not there or its size jumps."""
        speed = max(abs(self._step_px[0]), abs(self._step_px[1]))
        u, v = last.u_px + self._step_px[0], last.v_px + self._step_px[1]
        sighting = self._measure(picture, u, v, last.diameter_px, slack=0.5 * speed)
        if sighting.valid and not self._has_its_size(sighting):
            return lost_sighting("its size jumped")
        return sighting

    def _has_its_size(self, sighting: Sighting) -> bool:
        """Whether a sighting is about as large as the marker was when it was seen last. True if it was never seen, or
        not for more than _FORGOTTEN frames."""
        if self._last_seen is None or self._frames_unseen > _FORGOTTEN:
            return True
        return _SHRUNK < sighting.diameter_px / self._last_seen.diameter_px < _GROWN

    def _measure(self, picture: Array, u: float, v: float, diameter: float, slack: float) -> Sighting:
        """Measures the marker by its outline in a BGR picture. Lost, with the reason, where no outline is like the
        marker's in contrast, colour, shape and size. u, v, diameter: where and how large it is expected, px; slack: px
        of room about that. If the outline goes on beyond the region that is looked at, a larger region is tried, twice
        at most. After a success, its colour and outline become what the next frame is compared with."""
        half_px = int(_REGION * diameter + _MARGIN_PX + slack)  # half the side of the region that is looked at
        for _ in range(3):
            status, outline = marker_measure(picture, self._weights, self._cut, u, v, diameter, half_px, self._expected)
            if status != MARKER_CLIPPED:
                break
            u, v, diameter = outline.u, outline.v, max(diameter, outline.diameter)
            half_px = int(_GROWS * half_px + _REGION * diameter + _MARGIN_PX)
        if status == MARKER_CUT_OFF:
            return lost_sighting("cut off by the picture's border")
        if status != MARKER_FOUND or outline.within - outline.around < _FAINT:
            return lost_sighting("no marker of this colour")
        (b, g, r), (own_b, own_g, own_r) = outline.colour, self._hue  # the cosine between them, however bright
        if b * own_b + g * own_g + r * own_r < _LIKE * sqrt(b * b + g * g + r * r):
            return lost_sighting("what is there has another colour")
        radius = 0.5 * outline.diameter
        unsure = outline.sigma > _UNSURE * radius
        if unsure or outline.kept < _KEPT or outline.scatter > max(_RAGGED * radius, _RAGGED_PX):
            return lost_sighting("its outline is broken")
        if not _SMALLER < outline.diameter / self.colour.diameter_px < _LARGER:
            return lost_sighting("nothing of its size")
        self._cut, self._expected = 0.5 * (outline.within + outline.around), outline.after
        lit_px = outline.lit_u, outline.lit_v
        return Sighting(outline.u, outline.v, max(outline.sigma, SURE_PX), outline.diameter, lit_px=lit_px)

    def _search(self, picture: Array) -> Sighting:
        """Looks for the marker in a whole BGR picture: the likeliest blob (see `_likeness`) of its size that is no
        decoy. Lost, with the reason, where there is none. Sets what the next frame is compared with."""
        blobs = self.blobs(picture)
        others = [blob for blob in blobs if not self._is_decoy(blob.seen)]
        alike = [blob for blob in others if self._has_its_size(blob.seen)]
        if not alike:
            self._cut = _HALF_WAY
            if others:
                return lost_sighting("its size jumped")
            return lost_sighting("what is there is alike but never moves") if blobs else self._why_none
        best = max(alike, key=self._likeness)
        self._cut, self._expected = best.cut, best.after
        return best.seen

    def _likeness(self, blob: _Blob) -> float:
        """How likely a blob is the marker, without unit: its score, reduced by its distance from where the marker was
        last seen, to a half at _NEAR picked diameters."""
        if self._last_seen is None:
            return blob.score
        away = float(np.hypot(blob.seen.u_px - self._last_seen.u_px, blob.seen.v_px - self._last_seen.v_px))
        return blob.score / (1.0 + (away / (_NEAR * self.colour.diameter_px)) ** 2)

    def blobs(self, picture: Array) -> list[_Blob]:
        """Measures the blobs of the marker's colour in a BGR picture, six at most. They are looked for in the picture
        shrunk as far as the smallest marker allows, at most four times; fainter ones only if there is no clear one."""
        shrink = 1
        while shrink < 4 and self._smallest_px / shrink > 2.0 and min(picture.shape[:2]) > 16 * shrink:
            shrink *= 2
        small = cv2.resize(picture, None, fx=1 / shrink, fy=1 / shrink, interpolation=cv2.INTER_AREA)
        y = self.colour.membership(small)
        # Fainter only when there is none: what is around a marker may come near it where the light is poor.
        for level in (_HALF_WAY, _FAINT):
            if above := self._blobs_above(picture, y, level, shrink):
                return above
        return []

    def _blobs_above(self, picture: Array, y: Array, level: float, shrink: int) -> list[_Blob]:
        """Measures the connected regions of membership above `level` with about the marker's area, six at most. y
        (height, width): membership (1 is the marker as picked) in the picture made `shrink` times smaller. A region's
        outline is cut at half of its own level, the 90 % quantile of its membership (`_cut`). Each is compared with
        what was expected before the search, which stays. Where one cannot be measured, the reason is kept in
        _why_none."""
        _, _, stats, centroids = cv2.connectedComponentsWithStats((y > level).astype(np.uint8), connectivity=4)
        usual_area = 0.25 * np.pi * (self.colour.diameter_px / shrink) ** 2  # of the disc, px of the small picture
        blobs, before = list[_Blob](), self._expected  # which `_measure` replaces
        self._why_none = lost_sighting("no marker of this colour")
        # Sorted by area, all larger ones alike; +1: label 0 is what is no blob.
        largest = np.argsort(-np.minimum(stats[1:, cv2.CC_STAT_AREA], usual_area))[:6] + 1
        for i in largest:
            x0, y0, width, height, area = stats[i]
            if not _SMALLER**2 < area / usual_area < _LARGER**2:
                continue
            u, v = (centroids[i] + 0.5) * shrink - 0.5  # whole numbers are the middles of pixels
            self._cut = max(level, float(np.percentile(y[y0 : y0 + height, x0 : x0 + width], 90))) / 2
            diameter = self.colour.diameter_px * float(np.sqrt(area / usual_area))
            self._expected = before
            sighting = self._measure(picture, float(u), float(v), diameter, slack=2.0 * shrink)
            if sighting.valid:  # again, now that its own level is known
                self._expected = before
                sighting = self._measure(picture, sighting.u_px, sighting.v_px, sighting.diameter_px, slack=0.0)
            if sighting.valid:
                ratio = sighting.diameter_px / self.colour.diameter_px
                score = min(ratio, 1.0 / ratio) * self._cut
                blobs.append(_Blob(sighting, score=score, cut=self._cut, after=self._expected))
            else:
                self._why_none = sighting
        self._expected = before
        return blobs


def find_colour(pictures: Sequence[Array]) -> MarkerColour | None:
    """Finds the marker's colour in BGR pictures of one scene that were taken some time apart: of the colours that stand
    out most, _COLOURS in each of _LOOKED_AT pictures, the one with the best `_moving_score`. Where it is pale, as in
    glare, beside the colour of median purity over all pictures, that colour is taken instead, if it finds the marker
    about as well. None where nothing stands out."""
    colours: list[MarkerColour] = []
    for picture in pictures[:: max(1, len(pictures) // _LOOKED_AT)][:_LOOKED_AT]:
        colours += [
            colour
            for colour in candidates(picture)[:_COLOURS]
            if not any(_same_colour_and_size(colour, other) for other in colours)
        ]
    scored = [(_moving_score(colour, pictures), -k, colour) for k, colour in enumerate(colours)]
    if not scored:
        return None
    score, _, best = max(scored, key=lambda entry: entry[:2])  # of equals the first
    usual = _colour_of_median_purity(best, pictures)
    pale = _purity(best) < _PALE * _purity(usual)
    return usual if pale and _moving_score(usual, pictures) >= _AS_OFTEN * score else best


def _purity(colour: MarkerColour) -> float:
    """Saturation of a marker's colour: 0 (grey) to 1 (a channel is dark)."""
    return 1.0 - min(colour.colour) / max(*colour.colour, 1.0)


def _colour_of_median_purity(colour: MarkerColour, pictures: Sequence[Array]) -> MarkerColour:
    """Picks the marker's colour anew in every picture that shows it, and returns the one of median purity: where it was
    picked first the marker may have been pale with light. `colour` itself where no picture shows it."""
    tracker = MarkerTracker(colour)
    picked = []
    for picture in pictures:
        tracker.reset()
        seen = tracker.track(picture)
        if seen.valid:
            with suppress(TautError):
                picked.append(pick(picture, (seen.u_px, seen.v_px)))
    picked.sort(key=_purity)
    return picked[len(picked) // 2] if picked else colour


def find_decoys(colour: MarkerColour, pictures: Sequence[Array]) -> list[tuple[float, float]]:
    """Finds the places (u, v) px of decoys: things of the marker's colour and size that rest in BGR pictures taken some
    time apart, while another one, the marker, moves. Empty where all of them move, or none does. The place with most
    blobs around it is a decoy's if enough pictures show it (_STAYS); then the next among the remaining blobs, until one
    is not."""
    tracker = MarkerTracker(colour)
    seen = [(k, b.seen.u_px, b.seen.v_px) for k, picture in enumerate(pictures) for b in tracker.blobs(picture)]
    owner, *places_uv = np.array(seen).reshape(-1, 3).T  # owner: (blobs,) index of the picture
    places = np.column_stack(places_uv)
    still: list[tuple[float, float]] = []
    remaining = np.ones(len(places), dtype=bool)
    while remaining.any():
        near = [  # (blobs,) bool for each place: what remains around it
            remaining & (np.hypot(*(places - place).T) < _SAME_PLACE * colour.diameter_px)
            for place in places[remaining]
        ]
        largest = max(near, key=np.count_nonzero)
        if len(np.unique(owner[largest])) < _STAYS * len(pictures):
            break
        still.append((float(np.median(places[largest, 0])), float(np.median(places[largest, 1]))))
        remaining &= ~largest
    pictures_with_another = len(np.unique(owner[remaining]))
    return still if pictures_with_another >= _ELSEWHERE * len(pictures) else []


def _same_colour_and_size(one: MarkerColour, other: MarkerColour) -> bool:
    """Whether two picked colours are of the same hue (less than 6 deg between them in B, G, R: cosine 0.995) and of
    about the same diameter (ratio 0.7 to 1.4)."""
    a, b = np.array(one.colour), np.array(other.colour)
    size = one.diameter_px / other.diameter_px
    return bool(a @ b > 0.995 * np.linalg.norm(a) * np.linalg.norm(b)) and 0.7 < size < 1.4


def _moving_score(colour: MarkerColour, pictures: Sequence[Array]) -> float:
    """How well `colour` finds a marker that moves in the pictures, 0 to 1: 0.1 share + 0.9 max(moved, 0.3 share min(1,
    sway / 2 px)). share: of pictures in which the marker is found. moved: the same share, but each picture counts by
    how little its place has the marker's colour in up to four pictures that show the marker elsewhere; a thing that
    stays counts 0. sway: how far the places go (10 % to 90 %), px, for a marker that moves by less than its size."""
    tracker = MarkerTracker(colour)
    places = []
    for picture in pictures:
        tracker.reset()
        seen = tracker.track(picture)
        places.append((seen.u_px, seen.v_px))
    place = np.array(places)
    moved = 0.0  # pictures
    for k in np.flatnonzero(np.isfinite(place[:, 0])):
        away = np.hypot(*(place - place[k]).T)
        others = np.flatnonzero(away > 1.5 * colour.diameter_px)  # NaN is not
        if len(others):
            column, row = np.rint(place[k]).astype(int)
            left = [colour.membership(pictures[j][row : row + 1, column : column + 1])[0, 0] for j in others[:4]]
            moved += 1.0 - float(np.clip(np.mean(left), 0.0, 1.0))
    seen_at = place[np.isfinite(place[:, 0])]
    share = len(seen_at) / len(pictures)
    if not len(seen_at):
        return 0.0
    sway = float(np.ptp(np.percentile(seen_at, [10, 90], axis=0), axis=0).max())  # of one that moves less than its size
    return 0.1 * share + 0.9 * max(moved / len(pictures), 0.3 * share * min(1.0, sway / 2.0))


def track_video(video: Video, colour: MarkerColour | None = None, progress: Progress | None = None) -> Marker:
    """Tracks the marker through every frame of a video. Returns what marker.csv would hold; rows where it is lost are
    not valid. colour: as picked with `taut marker`. Without it the place of a region.toml beside the video is followed;
    else the colour is that of a marker.toml beside it, or that of what stands out and moves. Times are those of
    frames.csv, or without one the container's with the first frame at 0; frames that frames.csv does not list give no
    row. TautError where no marker is found."""
    region = Region.beside(video.path) if colour is None else None
    if region is not None:
        return _track_region(video, region, progress)
    beside = video.path.parent / COLOUR_FILE
    samples = sample_video(video.path, _SAMPLES)
    if colour is None:
        colour = MarkerColour.load(beside) if beside.is_file() else find_colour(samples)
    if colour is None:
        raise TautError(
            f"{video.path}: no marker stands out: pick its colour with 'taut marker {video.path} --at U,V', or with "
            "--region U,V a place to follow where there is no marker"
        )
    tracker = MarkerTracker(colour, find_decoys(colour, samples))
    frames = _Frames(*every_frame(video, tracker.track, progress))
    if not any(s.valid for s in frames.seen):
        raise TautError(
            f"{video.path}: no marker is seen in any of its {len(frames.seen)} frames: "
            f"pick its colour with 'taut marker {video.path}', and --at U,V if it does not stand out"
        )
    sure = which_show_marker(frames.seen)
    return replace(frames, seen=smooth_light_correction(frames.seen, sure)).rows(sure)


def _track_region(video: Video, region: Region, progress: Progress | None) -> Marker:
    """Tracks a shown place, without a marker, through every frame of a video. The video is read twice: the first pass
    learns what the place looks like along its way, and what is background. TautError where the second one never finds
    it."""
    tracker = region.tracker()
    every_frame(video, tracker.track, half_progress(progress, 0.0))
    tracker.settle()
    frames = _Frames(*every_frame(video, tracker.track, half_progress(progress, 0.5)))
    if not any(s.valid for s in frames.seen):
        raise TautError(
            f"{video.path}: the place of {REGION_FILE} is found in none of its {len(frames.seen)} frames: show it in "
            f"this video with 'taut marker {video.path} --region U,V'"
        )
    marker = frames.rows(np.array([s.valid for s in frames.seen]))
    return replace(marker, shown=Shown(region.at, region.side_px))


@dataclass(frozen=True)
class _Frames:
    """What a tracker saw in the n frames of a video."""

    t_s: Array  # (n,) of arrival; NaN where frames.csv does not name the frame
    seen: list[Sighting]  # n
    size: tuple[int, int] | None  # width, height, px

    def rows(self, sure: npt.NDArray[np.bool_]) -> Marker:
        """Returns the frames that have a time, as marker.csv's rows. sure (n,): which sightings are the marker's; the
        others become NaN and not valid. Frames without a time are only counted, in `untimed`."""
        timed = np.isfinite(self.t_s)
        rows = np.array([(s.u_px, s.v_px, s.sigma_px) for s in self.seen])
        u, v, sigma = np.where(sure[:, None], rows, np.nan)[timed].T
        return Marker(self.t_s[timed], u, v, sure[timed], sigma, frame_px=self.size, untimed=int(np.sum(~timed)))


def with_marker(recording: Recording, rig: Rig, progress: Progress | None = None) -> Recording:
    """Tracks a recording's video, if that has not been done. Returns the recording with the marker's track, or with the
    bending angle if the tip's own camera took the video; the same recording where there is a table of it already, no
    video, or no camera in the rig. TautError where the video shows nothing that can be tracked."""
    if rig.sees_from_tip and recording.angle is None and recording.video is not None:
        return replace(recording, angle=bending_by_scene(recording.video, recording.motor, rig, progress))
    if recording.marker is not None or recording.video is None or not rig.has_camera:
        return recording
    return replace(recording, marker=track_video(recording.video, progress=progress))


def which_show_marker(seen: Sequence[Sighting]) -> npt.NDArray[np.bool_]:
    """(n,) Which of the sightings, of n frames in order, show the marker. Where one is too far from the one before for
    the marker's speed, something else was taken for it: the track is cut there, and of the stretches the chain with
    most frames is kept along which a marker could go. A sighting beside a lost frame is dropped if its size differs
    from the median of the frames around it, as the marker may be partly hidden. With fewer than three sightings all are
    kept."""
    valid = np.array([s.valid for s in seen])
    place = np.array([(s.u_px, s.v_px) for s in seen])
    size = np.array([s.diameter_px for s in seen])
    at = np.flatnonzero(valid)
    if len(at) < 3:
        return valid
    step = np.hypot(*np.diff(place[at], axis=0).T)
    gap = np.diff(at)
    speed = float(np.percentile(step[gap == 1], 95)) if (gap == 1).any() else 0.0  # px per frame
    usual = float(np.median(size[at]))

    def reach(frames: Array | int) -> Array | float:
        """How far the marker may go in so many frames, px."""
        return _LEAP * usual + _FASTER * speed * frames

    stretches = np.split(at, np.flatnonzero(step > reach(gap)) + 1)
    for k in _outside_best_chain(stretches, place, reach):
        valid[stretches[k]] = False
    beside_lost = np.zeros_like(valid)
    beside_lost[1:] |= ~valid[:-1]
    beside_lost[:-1] |= ~valid[1:]
    for k in np.flatnonzero(valid & beside_lost):
        near = slice(max(0, k - _AROUND), k + _AROUND + 1)
        valid[k] = abs(size[k] / np.median(size[near][valid[near]]) - 1.0) < _WHOLE
    return valid


def smooth_light_correction(seen: Sequence[Sighting], sure: npt.NDArray[np.bool_]) -> list[Sighting]:
    """Returns the sightings with their correction for light from one side (lit_px), which each frame tells with noise,
    smoothed over the marker's place in the image: at one place it is the same, whichever way the marker goes. sure
    (n,): which sightings are the marker's; the others stay as they are."""
    lit = np.array([s.lit_px for s in seen])
    at = np.flatnonzero(sure)  # also frames whose own correction is 0
    if not lit[at].any():
        return list(seen)
    place = np.array([(s.u_px, s.v_px) for s in seen])[at]
    change = np.zeros_like(lit)
    change[at] = _smooth_over(place, lit[at], float(np.median([seen[k].diameter_px for k in at]))) - lit[at]
    return [
        replace(
            s, u_px=s.u_px + float(u), v_px=s.v_px + float(v), lit_px=(s.lit_px[0] + float(u), s.lit_px[1] + float(v))
        )
        for s, (u, v) in zip(seen, change, strict=True)
    ]


def _smooth_over(place: Array, values: Array, diameter_px: float) -> Array:
    """Smooths values (n, 2) at places (n, 2) px by a locally linear fit; returns them, (n, 2). In each square cell of
    one diameter the values' median is taken. Through the medians around a cell a plane is fitted, weighted by frames
    and nearness (a Gaussian of _ALIKE_LIT diameters)."""
    alike_px = _ALIKE_LIT * diameter_px
    _, cell = np.unique(np.floor(place / diameter_px), axis=0, return_inverse=True)
    cells = [np.flatnonzero(cell.ravel() == k) for k in range(int(cell.max()) + 1)]
    middle = np.array([place[own].mean(axis=0) for own in cells])
    median = np.array([np.median(values[own], axis=0) for own in cells])
    smooth = np.empty_like(values)
    for own, centre in zip(cells, middle, strict=True):
        away = (middle - centre) / alike_px
        weight = np.array([len(each) for each in cells]) * np.exp(-0.5 * np.sum(away**2, axis=1))
        rows = np.column_stack([np.ones(len(cells)), away])
        held = np.diag([0.0, 1.0, 1.0])  # prior: slopes are 0, by one frame's weight
        plane = np.linalg.solve((rows.T * weight) @ rows + held, (rows.T * weight) @ median)
        smooth[own] = plane[0] + (place[own] - centre) / alike_px @ plane[1:]
    return smooth


def _outside_best_chain(stretches: Sequence[Array], place: Array, reach: Callable[[int], Array | float]) -> list[int]:
    """Indices of the stretches, each an array of frame indices, that are not in the best chain: the one with most
    frames in which every stretch begins within reach(frames between) px of the end of the one before. place: (n, 2) px,
    of all frames. By dynamic programming."""
    best = np.array([len(stretch) for stretch in stretches])  # frames of the best chain that ends with each stretch
    before = np.full(len(stretches), -1)  # the stretch before it in that chain
    for k, stretch in enumerate(stretches):
        for j in range(k):
            end, start = stretches[j][-1], stretch[0]
            near = np.hypot(*(place[start] - place[end])) <= reach(int(start - end))
            if near and best[j] + len(stretch) > best[k]:
                best[k], before[k] = best[j] + len(stretch), j
    chain, k = set(), int(np.argmax(best))
    while k >= 0:
        chain.add(k)
        k = int(before[k])
    return [k for k in range(len(stretches)) if k not in chain]
