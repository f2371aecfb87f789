"""The live page over a board: a whole calibration by start, rest and stop, a marker that is picked by a click, a
diagnosis."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_calibration import live_on, off

from conftest import Bench
from tautline import trajectory
from tautline.calibration.calibrate import calibrate
from tautline.diagnosis import narration
from tautline.live.page.desk import RUNNING, Desk
from tautline.live.page.work import Calibrating, Diagnosing, Watching, attend
from tautline.live.setup import Frame, Live, open_live
from tautline.live.until import Goal, calibrate_until
from tautline.live.watch import View
from tautline.model import Effect, Model
from tautline.recording import load
from tautline.simulated.instrument import Corrected, preset, reference_rig
from tautline.simulated.simulate import simulate
from tautline.vision.colour import MarkerColour

pytestmark = pytest.mark.minutes


class Person(Desk):
    """Asks for what `does` says, frame by frame, instead of a page."""

    def __init__(self, work: Calibrating, does: Callable[[Person, View], None]) -> None:
        super().__init__(work.rig, work.about)
        self.does, self.open = does, self.watched()

    def show(self, view: View) -> None:
        self.does(self, view)
        super().show(view)

    def says(self) -> str:
        return str(self.events.newer(0, 0.0)[1]["state"]["says"])


def calibrating(live: Live, folder: Path) -> Calibrating:
    return Calibrating(live, folder / "model", lambda: folder / "rec")


def run(person: Person, work: Calibrating) -> None:
    """Started, until it has ended."""
    with person.open:
        person.start()
        attend(person, work, over=lambda: not person.begun)


def test_a_rest_in_the_middle_changes_nothing_but_the_time(bench: Bench, tmp_path: Path) -> None:
    """It rests for 4 s of board time in the first round, which is then made whole; B is as good as without."""
    instrument = preset("davinci", seed=2)
    rested: list[tuple[float, float]] = []  # board time and q at rest
    between: list[int] = []  # the board's onsets that were shown while no calibration came
    last = [0.0, 0.0]

    def does(person: Person, view: View) -> None:
        assert view.frame is not None or view.frames == 0
        if view.calibrated_s == last[0]:
            between.append(len(view.onsets) - int(last[1]))
        last[:] = view.calibrated_s, len(view.onsets)
        if view.doing.startswith("round 1") and view.seconds > 6.0 and not rested:
            person.rest()
        elif view.doing == "at rest":
            assert view.frame is not None
            rested.append((view.frame.t_us * 1e-6, live.board.status(0).q))
            if rested[-1][0] - rested[0][0] > 4.0:
                person.start()

    with live_on(bench, instrument) as live:
        work = calibrating(live, tmp_path)
        person = Person(work, does)
        run(person, work)
        assert off(live.board) and person.says().startswith("done")
    found = person.events.newer(0, 0.0)[1]["progress"]["onsets"]
    assert sum(between) > 3
    assert found and all(abs(o["width"] - instrument.backlash(o["q"])) < 0.25 for o in found if o["used"])
    t_s, q = np.array(rested).T
    assert t_s[-1] - t_s[0] > 4.0 and np.ptp(q) < 4.0  # counts
    model = Model.load(tmp_path / "model")
    inside = (model.q >= model.measured[0]) & (model.q <= model.measured[1])
    z = (model.width - instrument.backlash(model.q))[inside] / model.width_sigma[inside]
    assert model.width_sigma[inside].max() <= 3e-3 and np.sqrt(np.mean(z**2)) < 2.0
    recording = load(tmp_path / "rec")
    assert recording.marker is not None
    gap = np.flatnonzero(np.diff(recording.marker.t_s) > 3.5)
    again = calibrate(
        [recording], live.rig
    ).model  # as the command would, from the recording, which ends a little later
    assert (np.abs(again.width - model.width) / model.width_sigma).max() < 1e-3
    assert len(gap) == 1 and np.diff(recording.motor.t_s).max() > 3.5  # the rest is not recorded


@pytest.mark.long
def test_a_rest_takes_nothing_of_the_time_that_a_calibration_may_last(bench: Bench, tmp_path: Path) -> None:
    began: list[float] = []

    def resting() -> bool:
        assert live.plant is not None
        now = live.plant.now_s
        if now > 8.0:
            began.append(now)
        return bool(began) and now - began[0] < 60.0

    with live_on(bench, preset("davinci", seed=2)) as live:
        _, made = calibrate_until(live, tmp_path / "rec", Goal(at_most_s=40.0), resting=resting)
    assert made.reached and made.motion.seconds > 60.0


def test_a_rest_that_is_asked_for_while_it_is_checked_begins_no_round(bench: Bench, tmp_path: Path) -> None:
    done: list[str] = []

    def does(person: Person, view: View) -> None:
        done.append(view.doing)
        if view.doing.startswith("checking"):
            person.rest()
        else:
            person.stop()

    with live_on(bench, preset("davinci", seed=2)) as live:
        work = calibrating(live, tmp_path)
        run(Person(work, does), work)
        assert off(live.board)
    assert done[0].startswith("checking") and done[-1] == "at rest" and len(set(done)) == 2


@pytest.mark.parametrize("when", ["checking", "round 1", "at rest", "round 2"])
def test_stop_brings_the_axis_to_rest_whatever_it_does(bench: Bench, tmp_path: Path, when: str) -> None:
    def does(person: Person, view: View) -> None:
        if when == "at rest" and view.doing.startswith("round 1"):
            person.rest()
        if view.doing.startswith(when) and (view.seconds > 1.0):
            person.stop()

    with live_on(bench, preset("davinci", seed=2)) as live:
        work = calibrating(live, tmp_path)
        person = Person(work, does)
        run(person, work)
        assert off(live.board) and live.board.status(0).fault == 0
        q = live.board.status(0).q
        live.wait(0.5)
        assert live.board.status(0).q == pytest.approx(q, abs=1.0)
    assert "the axis is at rest" in person.says() and "taut calibrate" in person.says()
    assert not (tmp_path / "model").exists() and len(load(tmp_path / "rec").motor.t_s) > 100


@pytest.mark.parametrize("scale", [1.0, 1.3])
def test_while_it_watches_the_page_says_whether_the_model_still_holds(bench: Bench, scale: float) -> None:
    """The instrument has `scale` times the model's backlash."""
    instrument = preset("davinci", seed=2)
    q = np.linspace(-5.0, 5.0, 101)
    width = instrument.backlash(q) / scale
    model = Model(instrument.rig, q, width, np.full_like(q, 2e-3), instrument.bend(q), 0.08, (-4.5, 4.5))
    states: list[str] = []
    with live_on(bench, instrument) as live:
        work = Watching(live, model, "smooth", speed=4.0, duration_s=20.0)
        desk = Desk(work.rig, work.about)
        with desk.watched():
            desk.start()
            publish = desk.events.publish

            def published(topic: str, what: Any) -> None:
                if topic == "holds":
                    states.append(what["state"])
                publish(topic, what)

            desk.events.publish = published  # type: ignore[method-assign]
            attend(desk, work, over=lambda: not desk.begun)
        latest = desk.events.newer(0, 0.0)[1]
        assert off(live.board)
    assert len(states) > 400 and latest["frame"]["q"] is not None
    assert latest["holds"]["scale"] == pytest.approx(scale, abs=0.05)
    assert (set(states) == {"trusted"}) == (scale == 1.0), set(states)
    assert latest["fit"]["width"][80] == pytest.approx(float(np.interp(latest["fit"]["q"][80], q, width)))
    assert "watched" in latest["state"]["says"]


def test_stop_ends_watching_with_the_axis_at_rest(bench: Bench) -> None:
    instrument = preset("davinci", seed=2)
    q = np.linspace(-5.0, 5.0, 101)
    model = Model(
        instrument.rig, q, instrument.backlash(q), np.full_like(q, 2e-3), instrument.bend(q), 0.08, (-4.5, 4.5)
    )
    with live_on(bench, instrument) as live:
        work = Watching(live, model, "smooth", speed=4.0)
        desk = Desk(work.rig, work.about)
        publish, count = desk.events.publish, [0]

        def published(topic: str, what: Any) -> None:
            publish(topic, what)
            count[0] += topic == "holds"
            if topic == "holds" and count[0] == 50:
                desk.stop()

        desk.events.publish = published  # type: ignore[method-assign]
        with desk.watched():
            desk.start()
            attend(desk, work, over=lambda: not desk.begun)
        assert off(live.board) and 50 <= count[0] <= 52


def test_a_motion_that_is_watched_ends_where_no_page_is_open(bench: Bench) -> None:
    instrument = preset("davinci", seed=2)
    q = np.linspace(-5.0, 5.0, 101)
    model = Model(
        instrument.rig, q, instrument.backlash(q), np.full_like(q, 2e-3), instrument.bend(q), 0.08, (-4.5, 4.5)
    )
    with live_on(bench, instrument) as live:
        work = Watching(live, model, "smooth", speed=4.0)
        desk = Desk(work.rig, work.about, unwatched_s=0.2)
        desk.start()
        desk.rest()
        assert desk.events.newer(0, 0.0)[1]["state"]["state"] == RUNNING  # nothing could go on after it
        attend(desk, work, over=lambda: not desk.begun)
        assert off(live.board) and 0 < desk.events.newer(0, 0.0)[1]["holds"]["t_s"] < 55.0


@contextmanager
def drawn() -> Iterator[tuple[Live, Calibrating, Desk]]:
    with open_live(simulate="reference") as live:
        work = Calibrating(live, Path("none"), lambda: Path("none"))
        yield live, work, Desk(work.rig, work.about)


def test_a_click_picks_the_marker_and_keeps_its_colour(tmp_path: Path) -> None:
    with drawn() as (live, work, desk):
        work.colour_file = tmp_path / "marker.toml"
        work.idle(desk)
        seen = desk.events.newer(0, 0.0)[1]["frame"]
        assert live.marker_source is not None
        tissue = MarkerColour((0.0, 0.0, 0.0), 0.0, (0.0, 0.0, 0.0), 20.0)
        live.marker_source.use(tissue)  # that is found nowhere
        work.idle(desk)
        assert desk.events.newer(0, 0.0)[1]["frame"]["lost"]
        desk.pick(3.0, 3.0)
        work.idle(desk)
        assert "no blob" in desk.events.newer(0, 0.0)[1]["state"]["says"] and not work.colour_file.exists()
        desk.pick(seen["u_px"] + 3.0, seen["v_px"] - 2.0)
        work.idle(desk)
        found = desk.events.newer(0, 0.0)[1]["frame"]
        assert found["u_px"] == pytest.approx(seen["u_px"], abs=0.5)
        assert MarkerColour.load(work.colour_file).diameter_px == pytest.approx(seen["diameter_px"], rel=0.3)


def test_what_is_clicked_while_it_runs_is_not_picked() -> None:
    with drawn() as (_, work, desk):
        work.idle(desk)
        desk.start()
        desk.pick(10.0, 10.0)
        assert desk.take_pick() is None and desk.events.newer(0, 0.0)[1]["state"]["state"] == RUNNING


def test_the_board_is_told_from_another_thread_though_nobody_looks(bench: Bench) -> None:
    """As with a real board: a reader takes in what it says, and the one that drives it hangs."""
    with live_on(bench, preset("davinci")) as live, live.board.reading():
        live.board.switch_on(0, lambda seconds: bench.sim.ask(f"advance {round(seconds * 1e6)}"))
        live.plant = None
        asked = threading.Thread(target=live.let_go)
        asked.start()
        asked.join(10.0)
        for _ in range(50):
            bench.sim.ask("advance 20000")
        assert off(live.board)


def diagnosing(bench: Bench, folder: Path, lag_s: float) -> AbstractContextManager[Diagnosing]:
    """A lag that came after the calibration."""
    rig = reference_rig()
    calibration = simulate(
        rig, preset("reference", rig), trajectory.back_and_forth(rig.actuator, [0.8], 2.0, 12, 6.0), seed=3
    )
    found = calibrate([calibration], rig)
    late = Effect("transmission.lag", {"lag": lag_s, "lag_second": 0.0})
    lagging = Corrected(replace(found.model, effects=(late,)), "lagging")

    @contextmanager
    def opened() -> Iterator[Diagnosing]:
        with live_on(bench, lagging, rig) as live:
            yield Diagnosing(live, found, [calibration], folder / "diagnosis", lambda: folder / "recordings", most=1)

    return opened()


class Onlooker(Desk):
    """A page that is closed, or says stop, at a frame; and what was seen of the motor while it rested."""

    def __init__(self, work: Diagnosing, at: int, does: Callable[[Onlooker], None]) -> None:
        super().__init__(work.rig, work.about, unwatched_s=0.0)
        self.live, self.at, self.does, self.page = work.live, at, does, ExitStack()
        self.frames, self.rested = 0, []

    def show_frame(self, frame: Frame, q: float) -> None:
        super().show_frame(frame, q)
        self.frames += 1
        if self.frames == self.at:
            self.does(self)

    def resting(self) -> bool:
        rests = super().resting()
        if rests:
            self.rested.append(off(self.live.board))
            self.stop()
        return rests

    def run(self, work: Diagnosing) -> dict[str, Any]:
        with self.page:
            self.page.enter_context(self.watched())
            self.start()
            attend(self, work, over=lambda: not self.begun)
        return self.events.newer(0, 0.0)[1]


def test_a_diagnosis_by_the_page(bench: Bench, tmp_path: Path) -> None:
    with diagnosing(bench, tmp_path, 0.12) as work:
        latest = Onlooker(work, 0, lambda page: None).run(work)
        assert off(work.live.board) and work.found is not None
    told, document = latest["diagnosis"], work.found.diagnosis.document
    assert told["answers"][0]["id"] == document["effects"][0]["id"] == "transmission.lag"
    assert told["says"] == narration.sentence(document) and told["led"] == [str(work.found.answers[0])]
    assert told["why"] and told["next"] == "" and latest["state"]["says"].startswith(told["why"])
    assert json.loads(json.dumps(latest["diagnosis"], allow_nan=False)) == told
    assert (tmp_path / "diagnosis" / "report.html").is_file()
    assert load(tmp_path / "recordings" / "test-1").marker is not None
    assert latest["fit"]["onsets"] and latest["doing"]["share"] == 1.0


def test_stop_ends_a_diagnosis_and_no_motion_follows(bench: Bench, tmp_path: Path) -> None:
    with diagnosing(bench, tmp_path, 0.12) as work:
        page = Onlooker(work, 40, Desk.stop)
        latest = page.run(work)
        assert off(work.live.board)
    assert latest["state"]["says"] == "stopped" and page.frames == 40 and work.found is None
    assert len(load(tmp_path / "recordings" / "test-1").marker.t_s) == 40


def test_a_motion_without_a_page_ends_and_the_next_waits_for_one(bench: Bench, tmp_path: Path) -> None:
    """A lag of 6 ms may be a delay: one motion leaves that open."""
    with diagnosing(bench, tmp_path, 0.006) as work:
        work.most = 2
        page = Onlooker(work, 300, lambda page: page.page.close())
        latest = page.run(work)
        assert off(work.live.board)
    assert page.rested == [True] and page.frames == 300, latest
    assert latest["diagnosis"]["next"] and not (tmp_path / "recordings" / "test-2").exists()
