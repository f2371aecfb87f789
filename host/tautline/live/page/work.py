"""What the page starts: a calibration of what is connected, a diagnosis of it, a model in use, or a recording played
again. One thread runs it all."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from tautline.calibration.result import Calibration
from tautline.diagnosis.diagnose import Diagnosis
from tautline.diagnosis.folder import save
from tautline.errors import TautError
from tautline.live.asking import Asked, Leading, diagnose_live
from tautline.live.page import shown
from tautline.live.page.desk import Desk, Stopped
from tautline.live.page.replay import replay
from tautline.live.rounds import in_words
from tautline.live.setup import Frame, Live
from tautline.live.tracking import watch
from tautline.live.until import Goal, calibrate_until
from tautline.model import Model
from tautline.recording import Recording, load, shifted
from tautline.reports import pages
from tautline.rig import Rig
from tautline.tracking import Row
from tautline.vision.colour import pick

_POLL_S = 0.02


class Work(Protocol):
    """What a page can start."""

    @property
    def rig(self) -> Rig:
        """The rig of the set-up or of the recording."""

    @property
    def about(self) -> dict[str, Any]:
        """What the page shows of it: `title`, whether it is `live`, and optionally `watch`, `diagnose`, and whether it
        `rests` (default yes)."""

    def idle(self, desk: Desk) -> None:
        """Is called again and again while nothing runs: shows a frame."""

    def run(self, desk: Desk) -> str:
        """Does the work, publishing on the desk; returns what came of it in a sentence. TautError where it failed,
        Stopped where it was stopped. The axis then rests."""

    def let_go(self) -> None:
        """Brings the motor to rest; may be called from any thread."""


@dataclass
class _OnSetUp:
    """What every work on a live set-up has in common."""

    live: Live

    @property
    def rig(self) -> Rig:
        """The rig of the set-up."""
        return self.live.rig

    def idle(self, desk: Desk) -> None:
        """Shows a frame; where time is virtual, at the camera's real pace."""
        began_s = time.monotonic()
        frame = self.live.look()
        desk.show_frame(frame, self.live.motor_position())
        if self.live.virtual and self.rig.camera is not None:
            time.sleep(max(began_s + 1.0 / self.rig.camera.frame_rate_hz - time.monotonic(), 0.0))

    def let_go(self) -> None:
        """Switches the motor off."""
        self.live.let_go()


@dataclass
class Calibrating(_OnSetUp):
    """`taut live`: live calibrations, each with a recording of its own; the last one's model is in `out`."""

    out: Path
    recording: Callable[[], Path]  # a folder that is not there yet
    goal: Goal = field(default_factory=Goal)
    colour_file: Path | None = None  # that keeps what was picked
    found: Calibration | None = None  # by the last run

    @property
    def about(self) -> dict[str, Any]:
        """Title of a live calibration (see Work)."""
        what = self.rig.actuator.instrument or "an instrument"
        simulated = ", simulated" if self.live.virtual else ""
        return {"title": f"Calibrate {what} on axis {self.live.axis}{simulated}", "live": True}

    def idle(self, desk: Desk) -> None:
        """Shows a frame; where the picture was clicked, picks the marker's colour there."""
        if (place := desk.take_pick()) is not None:
            self._pick(desk, place)
        super().idle(desk)

    def run(self, desk: Desk) -> str:
        """Calibrates until the goal is reached or out of reach, and writes MODEL and report to `out`."""
        folder = self.recording()
        found, reached = calibrate_until(self.live, folder, self.goal, show=desk.show, resting=desk.resting)
        self.found = found
        recordings = shifted([load(folder, found.model.rig)], found.offsets)
        pages.save_model(found.model, recordings, self.out)
        unit = self.live.rig.actuator.unit
        worst = in_words(reached.standing.worst, unit)
        if reached.why:
            return f"B(q) is not known to {in_words(reached.until, unit)} everywhere: {reached.why}"
        return f"done: sigma of B(q) is {worst} at most; {self.out / pages.FILE} shows it"

    def _pick(self, desk: Desk, place: tuple[float, float]) -> None:
        """Picks the marker's colour at a place (u, v), px, of the latest picture, uses it from now on and keeps it in
        colour_file; the page says what came of it."""
        if desk.picture is None or self.live.marker_source is None:
            return
        try:
            colour = pick(desk.picture, place)
        except TautError as error:
            desk.say(str(error))
            return
        self.live.marker_source.use(colour)
        kept = ""
        if self.colour_file is not None:
            colour.save(self.colour_file)
            kept = f", {self.colour_file} holds its colour"
        desk.say(f"the marker is {colour.diameter_px:.0f} px wide at {place[0]:.0f}, {place[1]:.0f}{kept}")


@dataclass
class Watching(_OnSetUp):
    """`taut live --watch`: keeps a model in use calibrated, as `taut watch`; nothing is moved unless `motion` says so.
    A motion ends where no page is open on which somebody could press Stop."""

    model: Model
    motion: str = "none"
    speed: float | None = None
    duration_s: float | None = None
    seed: int = 0

    @property
    def about(self) -> dict[str, Any]:
        """Title of a model that is watched (see Work)."""
        title = f"Watch a model in use on axis {self.live.axis}"
        return {"title": title, "live": True, "watch": True, "rests": False}

    def run(self, desk: Desk) -> str:
        """Keeps the model calibrated until stopped, or for duration_s."""
        desk.events.publish("fit", shown.backlash_document(self.model))

        def show_row(row: Row, t_s: float) -> None:
            """Publishes a row of the tracker."""
            desk.events.publish("holds", shown.row_document(row, t_s))

        def on_frame(frame: Frame, q: float) -> None:
            """Publishes a frame. Raises Stopped where stop was pressed, or the motor follows a motion and no page is
            open."""
            desk.show_frame(frame, q)
            desk.check_stop()
            if self.motion != "none" and desk.unwatched:
                raise Stopped

        result = watch(
            self.live, self.model, self.motion, speed=self.speed, duration_s=self.duration_s, seed=self.seed,
            on_row=show_row, shown=on_frame,
        )  # fmt: skip
        return f"watched {result['seconds']:.1f} s, {result['frames']} frames: {result['state'] or 'none was tracked'}"


@dataclass
class Diagnosing(_OnSetUp):
    """`taut live --diagnose`: a live diagnosis, as `taut diagnose --live`. A motion ends where no page is open on which
    somebody could press Stop; the next one waits for a page."""

    calibration: Calibration
    recorded: Sequence[Recording]  # on the motor's clock: that of the calibration, then tests that were made before
    out: Path
    recordings: Callable[[], Path]  # a folder that is not there yet
    most: int = 5
    found: Asked | None = None

    @property
    def about(self) -> dict[str, Any]:
        """Title of a live diagnosis (see Work)."""
        title = f"Diagnose {self.rig.actuator.instrument or 'an instrument'} on axis {self.live.axis}"
        return {"title": title, "live": True, "diagnose": True, "rests": False}

    def run(self, desk: Desk) -> str:
        """Diagnoses, recording the motions that this asks for, and writes the diagnosis to `out`."""
        answers: list[Leading] = []
        desk.events.publish("fit", shown.calibration_document(self.calibration, None))
        desk.events.publish("diagnosis", None)

        def on_frame(frame: Frame) -> None:
            """Publishes a frame. Raises Stopped where stop was pressed, or no page is open."""
            desk.show_frame(frame, self.live.motor_position())
            desk.check_stop()
            if desk.unwatched:
                raise Stopped

        def on_answer(diagnosis: Diagnosis, leading: Leading, why: str) -> None:
            """Publishes a diagnosis and the likeliest answers so far. why: why the diagnosis ends; "" while another
            motion follows: it then waits until a page is open, and raises Stopped if stop is pressed meanwhile."""
            answers.append(leading)
            desk.events.publish("diagnosis", shown.diagnosis_document(diagnosis.document, answers, why))
            while not why and desk.resting():
                desk.check_stop()

        asked = diagnose_live(
            self.live, self.calibration, self.recorded[0], self.recorded[1:], self.recordings(), self.most,
            progress=desk.show_doing, seen=on_frame, answered=on_answer,
        )  # fmt: skip
        save(asked.diagnosis, self.out)
        self.found = asked
        return f"{asked.why}; {self.out / pages.FILE} shows it"


@dataclass
class Replaying:
    """`taut live RECORDING`: plays a recording, from its beginning each time."""

    recording: Recording
    rig: Rig
    pace: float = 1.0  # times its own speed

    @property
    def about(self) -> dict[str, Any]:
        """Title of a replay (see Work)."""
        return {"title": f"Replay of {self.recording.name}", "live": False}

    def idle(self, desk: Desk) -> None:
        """Waits: there is no frame to show yet."""
        time.sleep(_POLL_S)

    def run(self, desk: Desk) -> str:
        """Plays the recording from its beginning."""
        view = replay(self.recording, self.rig, desk.show, desk.resting, self.pace)
        assert view.calibration is not None  # settled
        return f"all of {self.recording.name} was played"

    def let_go(self) -> None:
        """Does nothing: nothing moves."""


def attend(
    desk: Desk,
    work: Work,
    say: Callable[[str], None] = lambda text: None,
    over: Callable[[], bool] = lambda: False,
) -> None:
    """Runs the session's main loop: the work whenever the page asks for it, else its `idle`; until `over()` is true, or
    Ctrl-C comes while nothing runs. What came of each run goes to the page and to `say`."""
    try:
        while not over():
            if desk.begun:
                with desk.running(work.let_go):
                    says = _run_once(desk, work)
                    desk.say(says)
                say(says)
            else:
                work.idle(desk)
    except KeyboardInterrupt:
        return


def _run_once(desk: Desk, work: Work) -> str:
    """Runs the work once. Returns what came of it, in words: the work's own result, "stopped", or the text of a
    TautError."""
    try:
        desk.check_stop()  # that came before it began
        return work.run(desk)
    except KeyboardInterrupt:
        return "stopped"
    except TautError as error:
        return str(error)
