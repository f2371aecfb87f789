"""One picture of what the camera saw, with the marker's way drawn into it, for a person to look at first."""

from __future__ import annotations

import cv2
import numpy as np

from tautline.errors import TautError
from tautline.recording import Recording
from tautline.vision.camera import sample_video

Array = np.ndarray
_LOOKED_AT = 3  # frames of a video, of which the middle one is shown
_WAY, _RING = (178, 111, 31), (44, 32, 179)  # BGR: the reports' blue and red


def snapshot(recording: Recording) -> Array | None:
    """Returns a picture for a report: a frame of the recording, BGR (height, width, 3) uint8, with the marker's places
    drawn into it and a box around nearly all of them (99 % of each coordinate, and 20 px more). None where the
    recording has no frame."""
    picture = _kept_or_middle_frame(recording)
    if picture is None:
        return None
    marker = recording.marker
    if marker is None or not marker.valid.any():
        return picture
    places = np.column_stack([marker.u_px, marker.v_px])[marker.valid]
    shown = picture.copy()
    for u, v in np.rint(places).astype(int):
        cv2.circle(shown, (int(u), int(v)), 1, _WAY, -1, cv2.LINE_AA)
    low, high = (np.percentile(places, share, axis=0) for share in (0.5, 99.5))
    corner, other = (tuple(int(x) for x in np.rint(place)) for place in (low - 20, high + 20))
    cv2.rectangle(shown, corner, other, _RING, 1, cv2.LINE_AA)
    return shown


def _kept_or_middle_frame(recording: Recording) -> Array | None:
    """Returns the picture that the recording keeps, else a frame from the middle of its video, BGR (height, width, 3)
    uint8. None where there is neither, or it cannot be read."""
    if recording.picture is not None:
        picture = cv2.imread(str(recording.picture), cv2.IMREAD_COLOR)
        return None if picture is None else np.asarray(picture)
    if recording.video is None:
        return None
    try:
        pictures = sample_video(recording.video.path, _LOOKED_AT)
    except TautError:
        return None
    return pictures[len(pictures) // 2]
