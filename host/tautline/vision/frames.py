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
    """Calls `look` with every picture of a video. Returns arrival times (n,) s, NaN where frames.csv does not name one;
    what `look` returned; the pictures' size (width, height) px, None without a picture."""
    size: tuple[int, int] | None = None
    t_s: list[float] = []
    seen: list[Seen] = []
    with VideoCamera(video.path) as camera:
        total = camera.frames or 0
        while (read := camera.read()) is not None:
            picture, own_s = read
            size = size or (picture.shape[1], picture.shape[0])
            k = len(t_s)
            known = video.arrival_s is None or k < len(video.arrival_s)
            t_s.append(own_s if video.arrival_s is None else float(video.arrival_s[k]) if known else np.nan)
            seen.append(look(picture))
            if progress and k % 25 == 0:
                progress(min(1.0, k / total) if total else 0.0, f"tracking {video.path.name}")
    if video.arrival_s is None and np.any(np.diff(t_s) <= 0):
        raise TautError(
            f"{video.path}: its frames' times do not rise: give their arrival times in a frames.csv beside it"
        )
    return np.array(t_s), seen, size


def half(progress: Progress | None, begins: float) -> Progress:
    """The progress of one of two passes over a video: from the share `begins` of the whole on, half of it."""
    return lambda share, text: progress(begins + 0.5 * share, text) if progress else None
