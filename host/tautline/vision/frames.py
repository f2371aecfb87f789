"""Every frame of a recorded video, one after the other, with the time of its arrival."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from tautline.errors import TautError
from tautline.recording import Video
from tautline.vision.camera import VideoCamera

Array = np.ndarray
Progress = Callable[[float, str], None]
Seen = TypeVar("Seen")


def every_frame(
    video: Video, look: Callable[[Array], Seen], progress: Progress | None = None
) -> tuple[Array, list[Seen], tuple[int, int] | None]:
    """Calls `look` with every picture of a video, BGR (height, width, 3) uint8. Returns the arrival times (n,), s
    (those of frames.csv, NaN for frames that it does not list; without one, the container's), what `look` returned (n),
    and the pictures' size (width, height) px, None if there was none. progress: gets the share done, 0 to 1, and a
    text. TautError where the container's times are used and do not rise."""
    size: tuple[int, int] | None = None
    t_s: list[float] = []
    seen: list[Seen] = []
    with VideoCamera(video.path) as camera:
        total = camera.frames or 0
        while (read := camera.read()) is not None:
            picture, container_s = read
            size = size or (picture.shape[1], picture.shape[0])
            k = len(t_s)
            if video.arrival_s is None:
                t_s.append(container_s)
            else:
                t_s.append(float(video.arrival_s[k]) if k < len(video.arrival_s) else np.nan)
            seen.append(look(picture))
            if progress and k % 25 == 0:
                progress(min(1.0, k / total) if total else 0.0, f"tracking {video.path.name}")
    if video.arrival_s is None and np.any(np.diff(t_s) <= 0):
        raise TautError(
            f"{video.path}: its frames' times do not rise: give their arrival times in a frames.csv beside it"
        )
    return np.array(t_s), seen, size


def half_progress(progress: Progress | None, begins: float) -> Progress:
    """Returns the progress to hand to one of two passes over a video: a share 0 to 1 of the pass is told to `progress`
    as `begins` to `begins` + 0.5 of the whole. It does nothing where progress is None."""
    return lambda share, text: progress(begins + 0.5 * share, text) if progress else None
