"""Between the page and the session: what the person asked for, and what there is to show.

The page's side is called from the server's threads, the session's from the one thread that drives board and camera.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from tautline.calibration.result import Calibration
from tautline.errors import TautError
from tautline.geometry import coarse_range_deg
from tautline.live.page import shown
from tautline.live.page.stream import Stream
from tautline.live.setup import Frame
from tautline.live.watch import View
from tautline.rig import Rig

READY, RUNNING, RESTING, STOPPING = "ready", "running", "resting", "stopping"
_PROGRESS_S = 0.2  # between two looks at coverage and what is missing; q and c go out with every frame
_REST_S = 0.02  # between two frames at rest: where time is virtual nothing else holds them back
_UNWATCHED_S = 3.0  # without any page: a page that is loaded again takes less


class Stopped(KeyboardInterrupt):
    """The page's stop: what runs takes it as it takes Ctrl-C, the axis comes to rest and the recording stays."""


@dataclass(frozen=True)
class Picture:
    """A frame for the page."""

    number: int  # of the frames so far, from 1 on
    pixels: Any  # BGR (height, width, 3) uint8
    seen: dict[str, Any]  # what was seen in it: shown.frame_document


class Desk:
    """The state of one session (READY, RUNNING, RESTING, STOPPING), what was asked of it, and what it publishes."""

    def __init__(self, rig: Rig, about: dict[str, Any], unwatched_s: float = _UNWATCHED_S) -> None:
        """about: what the page shows as its title and whether it may rest (Work.about), as topic "about";
        unwatched_s: time without an open page after which the session rests."""
        self.events, self.pictures = Stream(), Stream()
        self._rig, self._unwatched_s = rig, unwatched_s
        self._rests = about.get("rests", True)
        self._changed = threading.Condition()
        self._state, self._stop, self._says = READY, False, ""
        self._picked: tuple[float, float] | None = None
        self._nearby = 0  # pages of this process
        self._heard_s = time.monotonic()
        self._let_go: Callable[[], None] = lambda: None
        self._shown_s = float("-inf")
        self._calibration: Calibration | None = None  # that the page shows
        self._frames = 0
        self._picture: Any = None
        ranges = {"range": list(rig.actuator.range), "c_range": list(coarse_range_deg(rig))}
        self.events.publish("about", about | ranges | {"unit": rig.actuator.unit})
        self._publish_state()

    @cached_property
    def _bending(self) -> shown.Bending:
        """What finds the bending angle in a frame; built when the first one comes."""
        return shown.Bending(self._rig)

    # -- the page's side ---------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start was pressed: begins, or goes on after a rest."""
        with self._changed:
            if self._state in (READY, RESTING):
                self._set_state(RUNNING)

    def rest(self) -> None:
        """Rest was pressed: asks for a rest, if what runs can rest and go on afterwards."""
        with self._changed:
            if self._state == RUNNING and self._rests:
                self._set_state(RESTING)

    def stop(self) -> None:
        """Stop was pressed: ends what runs. A real board is told at once, from this thread, and again at every call, as
        it may have missed the first."""
        with self._changed:
            if self._state == READY:
                return
            self._stop = True
            self._set_state(STOPPING)
            let_go = self._let_go
        with suppress(TautError):  # gone or faulted: the session's thread says so
            let_go()

    def pick(self, u_px: float, v_px: float) -> None:
        """The marker was clicked in the latest picture, at (u, v) px; ignored while something runs."""
        with self._changed:
            if self._state == READY:
                self._picked = (u_px, v_px)

    def note_open_page(self) -> None:
        """Notes that a page is open. Open pages say so again and again; a page that sleeps, or has lost its connection,
        does not, and counts as closed after unwatched_s."""
        with self._changed:
            self._heard_s = time.monotonic()

    @contextmanager
    def watched(self) -> Iterator[None]:
        """A context within which a page in this process (not in a browser) counts as open."""
        with self._changed:
            self._nearby += 1
        try:
            yield
        finally:
            with self._changed:
                self._nearby -= 1
                self._heard_s = time.monotonic()

    # -- the session's side ------------------------------------------------------------------------------------------

    @property
    def begun(self) -> bool:
        """Whether something runs, or was asked for and is about to begin."""
        return self._state != READY

    @contextmanager
    def running(self, let_go: Callable[[], None]) -> Iterator[None]:
        """A context within which what was started runs; the pages' calibration is cleared before, and the state is
        READY afterwards. let_go: brings the board to rest; `stop` calls it from another thread."""
        with self._changed:
            self._let_go, self._calibration, self._shown_s = let_go, None, float("-inf")
        self.events.publish("fit", None)  # of an earlier run
        try:
            yield
        finally:
            with self._changed:
                self._let_go, self._stop = lambda: None, False
                self._set_state(READY)

    @property
    def unwatched(self) -> bool:
        """Whether no page is open, and none was for unwatched_s."""
        with self._changed:
            return self._nearby == 0 and time.monotonic() - self._heard_s > self._unwatched_s

    def resting(self) -> bool:
        """Returns whether the axis shall stand still: a rest was asked for, or no page is open on which somebody could
        press Stop, which then becomes a rest. Returns False at once, True after a wait of at most _REST_S, so that it
        can be asked in a loop."""
        with self._changed:
            if self.unwatched and self._state == RUNNING:
                self._set_state(RESTING, "no page is open: it rests until Start")
            if self._state != RESTING:
                return False
            self._changed.wait(_REST_S)
            return True

    def take_pick(self) -> tuple[float, float] | None:
        """Returns, once, the place (u, v), px, that was clicked since the last call; None where there was none."""
        with self._changed:
            place, self._picked = self._picked, None
            return place

    def say(self, text: str) -> None:
        """Shows a text on the page, a result or an error, until another replaces it."""
        with self._changed:
            self._says = text
            self._publish_state()

    def show(self, view: View) -> None:
        """Publishes what a live calibration knows: the frame, every _PROGRESS_S the progress, and a calibration when it
        is new. Raises Stopped if stop was pressed."""
        if view.frame is not None:
            self.show_frame(view.frame, view.q)
        now = time.monotonic()
        fresh = view.calibration is not self._calibration
        if now - self._shown_s >= _PROGRESS_S or fresh:
            self._shown_s = now
            self.events.publish("progress", shown.progress_document(view))
        if view.calibration is not None and fresh:
            self._calibration = view.calibration
            self.events.publish("fit", shown.calibration_document(view.calibration, view.calibrated_s))
        self.check_stop()

    def show_doing(self, share: float, text: str) -> None:
        """Publishes what is being done, in words, and the share of it that is done, 0 to 1. Raises Stopped if stop was
        pressed."""
        self.events.publish("doing", {"doing": text, "share": share})
        self.check_stop()

    def check_stop(self) -> None:
        """Raises Stopped if stop was pressed."""
        if self._stop:
            raise Stopped

    def show_frame(self, frame: Frame, q: float) -> None:
        """Publishes a frame with the motor's position q at its scene, the rig's unit. Its picture is compressed only
        when a page asks for it."""
        self._frames += 1
        seen = shown.frame_document(frame, q, self._bending.of(frame))
        self.events.publish("frame", seen)
        if frame.picture is not None:
            self._picture = frame.picture
            self.pictures.publish("picture", Picture(self._frames, frame.picture, seen))

    @property
    def picture(self) -> Any:
        """The latest frame, BGR (height, width, 3) uint8, None before there is any."""
        return self._picture

    def close(self) -> None:
        """Ends both streams, so that the pages' threads end."""
        self.events.close()
        self.pictures.close()

    def _set_state(self, state: str, says: str = "") -> None:
        """Changes the state and publishes it, for RUNNING and RESTING with the text `says`. The caller holds the
        lock."""
        self._state = state
        self._changed.notify_all()
        if state in (RUNNING, RESTING):
            self._says = says
        self._publish_state()

    def _publish_state(self) -> None:
        """Publishes the state and the text that the page shows with it."""
        self.events.publish("state", {"state": self._state, "says": self._says})
