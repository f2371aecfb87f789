"""`taut watch`: the tracker of a replay on a board and its camera, fed as motor and frames come."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from typing import Any

from tautline.live.following import follow, motor_trajectory, step
from tautline.live.in_use import Following
from tautline.live.setup import Frame, Live
from tautline.model import Model
from tautline.shapes import Library
from tautline.tracking import Row

Progress = Callable[[float, str], None] | None


def watch(
    live: Live,
    model: Model,
    motion: str = "none",
    *,
    speed: float | None = None,
    duration_s: float | None = None,
    seed: int = 0,
    library: Library | None = None,
    on_row: Callable[[Row, float], None] = lambda row, t_s: None,
    progress: Progress = None,
    shown: Callable[[Frame, float], None] = lambda frame, q: None,
) -> dict[str, Any]:
    """Keeps a model calibrated by the camera while the motor follows `motion` (as in `record`; speed in unit/s), or
    with "none" whatever else drives it, until Ctrl-C or for duration_s. library: its shapes are recognised. on_row:
    gets each row of the tracker with its frame's arrival, s; shown: each frame with the motor position, unit of q, at
    its scene time; progress: the share that is done and a word. Returns Following.summary and `seconds`, how long it
    took."""
    with closing(Following(live, model, on_row, library=library, shown=shown)) as following, live.interruptible():
        plan = None if motion == "none" else motor_trajectory(live, motion, speed, duration_s or 60.0, seed)
        began = live.now_us()
        try:
            if plan is not None:
                follow(live, *plan, tip=False, seen=following.take, progress=progress)
            while plan is None:
                passed = (live.now_us() - began) * 1e-6
                if duration_s is not None and passed >= duration_s:
                    break
                step(live, following.take)
                if progress and duration_s:
                    progress(passed / duration_s, "watching")
        except KeyboardInterrupt:
            pass
    return following.summary() | {"seconds": (live.now_us() - began) * 1e-6}
