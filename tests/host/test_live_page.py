"""The live page without a board: what is published, who is let in, and a recording that is played again."""

from __future__ import annotations

import http.client
import json
import re
import shutil
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import Taut
from reference_instrument import RIG, moved, saved_recording

from tautline.calibration.calibrate import calibrate
from tautline.calibration.coverage import gaps
from tautline.errors import TautError
from tautline.geometry import coarse_range_deg, pose, project
from tautline.live import page as page_package
from tautline.live.page import shown
from tautline.live.page.desk import READY, RESTING, RUNNING, Desk, Stopped
from tautline.live.page.replay import Played, replay
from tautline.live.page.server import LOOPBACK, PageServer, serving
from tautline.live.page.stream import Stream
from tautline.live.page.work import Replaying, attend
from tautline.live.rounds import Standing
from tautline.live.setup import Frame
from tautline.live.watch import View
from tautline.recording import Recording, load, save
from tautline.vision.marker import Sighting

PACE = 1e6  # as fast as it goes
WAIT_S = 20.0  # for what takes a fraction of a second on an idle machine


@pytest.fixture(scope="module")
def recording() -> Recording:
    return moved([-4.0, 1.0, -1.0, 3.0, 0.0, 4.0, -4.0, 4.0, -4.0], 4.0)


class Page:
    """What a browser does, by hand."""

    def __init__(self, server: PageServer) -> None:
        self.server, self.token = server, server.token

    def ask(
        self, path: str, method: str = "GET", body: str | None = None, **headers: str
    ) -> tuple[int, bytes, dict[str, str]]:
        line = http.client.HTTPConnection(LOOPBACK, self.server.server_address[1], timeout=WAIT_S)
        try:
            line.request(method, path, body, headers)
            answer = line.getresponse()
            return answer.status, answer.read(), dict(answer.getheaders())
        finally:
            line.close()

    def post(self, what: str, body: str = "{}") -> int:
        return self.ask(f"/{self.token}/{what}", "POST", body)[0]

    @contextmanager
    def open(self, awake: bool = True) -> Iterator[Callable[[str], Any]]:
        """The page is open inside, and says so where it is awake; gives the next document of a topic."""
        line = http.client.HTTPConnection(LOOPBACK, self.server.server_address[1], timeout=WAIT_S)
        line.request("GET", f"/{self.token}/events")
        answer = line.getresponse()
        assert answer.status == 200 and answer.getheader("Content-Type") == "text/event-stream"

        def following(topic: str) -> Any:
            while answer.readline().decode().strip() != f"event: {topic}":
                pass
            return json.loads(answer.readline().decode().removeprefix("data: "))

        gone = threading.Event()

        def here() -> None:
            while not gone.wait(0.02):
                self.post("here")

        posts = threading.Thread(target=here)
        if awake:
            posts.start()
        try:
            yield following
        finally:
            gone.set()
            if awake:
                posts.join()
            answer.close()
            line.close()


@contextmanager
def attended(recording: Recording, pace: float = PACE, unwatched_s: float = WAIT_S) -> Iterator[tuple[Page, Desk]]:
    work = Replaying(recording, RIG, pace)
    desk, over = Desk(RIG, work.about, unwatched_s), threading.Event()
    with serving(desk) as server:
        thread = threading.Thread(target=attend, args=(desk, work, lambda text: None, over.is_set))
        thread.start()
        try:
            yield Page(server), desk
        finally:
            over.set()
            desk.stop()
            thread.join(WAIT_S)
            assert not thread.is_alive()


def until(holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + WAIT_S
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def test_a_slow_reader_gets_the_newest_of_each_topic_and_nothing_twice() -> None:
    stream = Stream()
    for k in range(5):
        stream.publish("frame", k)
    stream.publish("state", "running")
    stream.publish("frame", 5)
    at, fresh = stream.newer(0, 0.0)
    assert list(fresh.items()) == [("state", "running"), ("frame", 5)]
    assert stream.newer(at, 0.0) == (at, {})
    stream.publish("fit", "b")
    assert stream.newer(at, 0.0)[1] == {"fit": "b"}


def test_a_reader_waits_for_what_is_new_and_is_let_go_at_the_end() -> None:
    stream, got = Stream(), []
    reader = threading.Thread(target=lambda: got.extend([stream.newer(0, WAIT_S)[1], stream.newer(1, WAIT_S)[1]]))
    reader.start()
    stream.publish("frame", 1)
    until(lambda: len(got) == 0 or got[0] == {"frame": 1})
    stream.close()
    reader.join(WAIT_S)
    assert got == [{"frame": 1}, {}]


def test_only_who_has_the_token_gets_anything_and_only_the_pages_own_files(
    recording: Recording, capsys: pytest.CaptureFixture[str]
) -> None:
    with attended(recording) as (page, desk):
        assert page.server.server_address[0] == "127.0.0.1"
        assert page.server.address == f"http://127.0.0.1:{page.server.server_address[1]}/{page.token}/"
        assert len(page.token) >= 20
        for name, kind in (("", "text/html"), ("page.js", "text/javascript"), ("page.css", "text/css")):
            status, body, headers = page.ask(f"/{page.token}/{name}")
            assert status == 200 and body and headers["Content-Type"].startswith(kind)
            assert "default-src 'none'" in headers["Content-Security-Policy"] and headers["Cache-Control"] == "no-store"
        for path in (
            "/", "/page.js", f"/{page.token}", f"/{page.token[:-1]}/", f"/{page.token}x/", "*", "//",
            f"/{page.token}/../desk.py", f"/{page.token}/desk.py", f"/{page.token}//etc/passwd",
            f"/{page.token}/%2e%2e/work.py",
        ):  # fmt: skip
            status, body, _ = page.ask(path)
            assert (status, body) == (404, b""), path
        assert page.ask("/wrong/start", "POST", "{}")[0] == 404 and desk.begun is False
        other = "rebound.example:80"
        assert page.ask(f"/{page.token}/", Host=other)[0] == 403
        assert page.ask(f"/{page.token}/start", "POST", "{}", Host=other)[0] == 403 and desk.begun is False
        assert page.ask(f"/{page.token}/", Host="[")[0] == 400 and page.ask("/wrong/", Host="[")[0] == 404
        assert page.ask("ftp://[/")[0] == 404
        assert page.ask(f"/{page.token}/picture?after=%C2%B2")[0] == 400
        assert page.ask(f"/{page.token}/start", "POST", **{"Content-Length": "\xb2"})[0] == 400 and desk.begun is False
        assert capsys.readouterr().err == ""
        assert page.ask(f"/{page.token}/", Host="localhost:1234")[0] == 200  # at the other end of a tunnel


@pytest.mark.parametrize(
    "body", ["[1]", "{", '{"u_px": "a", "v_px": 1}', '{"u_px": 1}', '{"u_px": 1, "v_px": 1' + " " * 300 + "}"]
)
def test_what_is_no_place_picks_nothing(recording: Recording, body: str) -> None:
    with attended(recording) as (page, desk):
        assert page.post("pick", body) == 400
        assert desk.take_pick() is None


def test_a_recording_is_played_to_the_calibration_that_it_gives(recording: Recording) -> None:
    with attended(recording) as (page, desk), page.open() as following:
        assert following("about") | {"title": "", "range": [], "c_range": []} == {
            "title": "", "live": False, "unit": "mm", "range": [], "c_range": [],
        }  # fmt: skip
        assert following("state")["state"] == READY
        assert page.post("start") == 200
        until(lambda: not desk.begun)
    latest = desk.events.newer(0, 0.0)[1]
    whole = calibrate([recording], RIG)
    fit, last = latest["fit"], latest["frame"]
    q = np.array(fit["q"])
    assert np.array_equal(fit["width"], np.interp(q, whole.model.q, whole.model.width))
    assert np.array_equal(fit["sigma"], np.interp(q, whole.model.q, whole.model.width_sigma))
    assert fit["verdict"] == whole.model.quality.verdict
    assert [o["width"] for o in fit["onsets"]] == [o.width for o in whole.onsets if np.isfinite(o.width)]
    assert recording.marker is not None and last["t_s"] == pytest.approx(recording.marker.t_s[-1], abs=1e-6)
    assert last["u_px"] == recording.marker.u_px[-1]
    assert "was played" in latest["state"]["says"]


def test_stop_ends_it_and_start_begins_again(recording: Recording) -> None:
    with attended(recording, pace=1.0) as (page, desk), page.open():
        page.post("start")
        until(lambda: "frame" in desk.events.newer(0, 0.0)[1])
        page.post("stop")
        until(lambda: not desk.begun)
        assert desk.events.newer(0, 0.0)[1]["state"] == {"state": READY, "says": "stopped"}
        before = desk.events.newer(0, 0.0)[1]["frame"]["t_s"]
        page.post("start")
        until(lambda: desk.events.newer(0, 0.0)[1]["frame"]["t_s"] < before)


def test_at_rest_no_frame_is_played_and_then_it_goes_on(recording: Recording) -> None:
    def now() -> dict[str, Any]:
        return desk.events.newer(0, 0.0)[1]

    with attended(recording, pace=1.0) as (page, desk), page.open():
        page.post("start")
        until(lambda: "frame" in now())
        page.post("rest")
        until(lambda: now().get("progress", {}).get("doing") == "at rest")
        at = now()["frame"]["t_s"]
        time.sleep(0.3)
        assert now()["frame"]["t_s"] == at and now()["state"]["state"] == RESTING
        page.post("start")
        until(lambda: now()["frame"]["t_s"] > at)


def test_where_the_last_page_is_gone_it_rests_until_start(recording: Recording) -> None:
    with attended(recording, pace=1.0, unwatched_s=0.4) as (page, desk):
        with page.open(), page.open():
            page.post("start")
            until(lambda: "frame" in desk.events.newer(0, 0.0)[1])
            time.sleep(0.6)
            assert desk.events.newer(0, 0.0)[1]["state"]["state"] == RUNNING
        until(lambda: desk.events.newer(0, 0.0)[1]["state"]["state"] == RESTING)
        with page.open() as following:
            assert "no page is open" in following("state")["says"]
            page.post("start")
            assert following("state")["state"] == RUNNING


def test_a_page_that_does_not_answer_is_none(recording: Recording) -> None:
    with attended(recording, pace=1.0, unwatched_s=0.1) as (page, desk), page.open(awake=False) as following:
        assert following("alive") == {}
        page.post("start")
        until(lambda: desk.events.newer(0, 0.0)[1]["state"]["state"] == RESTING)
        assert following("alive") == {}  # it is asked again


def test_a_stop_that_came_before_it_began_and_one_that_failed_are_not_lost(recording: Recording) -> None:
    ran: list[str] = []

    class Moving(Replaying):
        def run(self, desk: Desk) -> str:
            ran.append("run")
            return "ran"

    work = Moving(recording, RIG)
    desk, asked = Desk(RIG, work.about), []
    desk.start()
    desk.stop()
    attend(desk, work, over=lambda: not desk.begun)
    assert not ran and desk.events.newer(0, 0.0)[1]["state"] == {"state": READY, "says": "stopped"}
    desk.start()
    with desk.running(lambda: asked.append("let go")):
        desk.stop()
        desk.stop()
    assert asked == ["let go", "let go"]


def test_what_was_found_before_is_not_shown_of_what_runs() -> None:
    desk = Desk(RIG, {})
    desk.events.publish("fit", {"verdict": "reliable"})
    for _ in range(2):
        desk.start()
        with desk.running(lambda: None):
            at, fresh = desk.events.newer(0, 0.0)
            assert fresh["fit"] is None
            desk.show(View(-5.0, 5.0, "mm"))
            assert "progress" in desk.events.newer(at, 0.0)[1]


def test_stop_reaches_the_board_from_the_pages_thread_while_a_camera_hangs() -> None:
    desk, told = Desk(RIG, {}), threading.Event()
    desk.start()
    with desk.running(told.set):
        asked = threading.Thread(target=desk.stop)  # nothing looks at a frame meanwhile
        asked.start()
        asked.join(WAIT_S)
        assert told.is_set()
        with pytest.raises(Stopped):
            desk.show(View(-5.0, 5.0, "mm"))
    desk.start()
    desk.show(View(-5.0, 5.0, "mm"))  # the next one is not stopped by it


def test_a_board_that_is_gone_is_no_error_of_stops() -> None:
    def gone() -> None:
        raise TautError("the board is gone")

    desk = Desk(RIG, {})
    desk.start()
    with desk.running(gone):
        desk.stop()


def test_what_was_played_is_never_ahead_of_its_frame(recording: Recording) -> None:
    played = Played(recording, RIG)
    for k in range(played.frames - 1):
        frame = played.play(lambda t_s: None)
        part = played.recording_so_far()
        assert part.marker is not None and len(part.marker.t_s) == k + 1
        assert part.motor.t_s[-1] <= frame.t_us * 1e-6 + 1e-6 and len(part.motor.q) == len(part.motor.t_s)
    played.play(lambda t_s: None)
    assert played.recording_so_far() is recording


def test_a_recording_whose_motor_comes_later_is_played_too(recording: Recording) -> None:
    motor = recording.motor
    late = replace(recording, motor=replace(motor, t_s=motor.t_s[5000:], q=motor.q[5000:], q_cmd=None))
    view = replay(late, RIG, lambda view: None, lambda: False, PACE)
    assert view.calibration is not None and view.frames == len(late.marker.t_s if late.marker else ())


def test_the_last_calibration_is_shown_though_it_is_of_no_more_seconds(recording: Recording) -> None:
    first, last = calibrate([recording], RIG), calibrate([recording], RIG, naming=True)
    desk, view = Desk(RIG, {}), View(-5.0, 5.0, "mm", calibration=first, calibrated_s=9.0)
    desk.start()
    with desk.running(lambda: None):
        desk.show(view)
        at, _ = desk.events.newer(0, 0.0)
        desk.show(view)
        assert "fit" not in desk.events.newer(at, 0.0)[1]
        view.calibration = last
        desk.show(view)
        assert {"fit", "progress"} <= desk.events.newer(at, 0.0)[1].keys()


def test_pictures_are_those_of_their_frames(tmp_path: Path) -> None:
    """A video whose frames are numbered by their brightness, some of which have no time."""
    cv2 = pytest.importorskip("cv2")
    folder = saved_recording(tmp_path / "run")
    marker = load(folder).marker
    assert marker is not None
    writer = cv2.VideoWriter(str(folder / "video.mkv"), cv2.VideoWriter.fourcc(*"FFV1"), 25.0, (32, 32))
    for k in range(20):
        writer.write(np.full((32, 32, 3), 10 * k, np.uint8))
    writer.release()
    rows = [f"{k},{marker.t_s[k]:.6f}" for k in range(20) if k != 7]
    (folder / "frames.csv").write_text("\n".join(["frame,t_s", *rows]) + "\n")
    seen: list[int] = []

    def show(view: View) -> None:
        assert view.frame is not None and view.frame.picture is not None
        seen.append(int(view.frame.picture[16, 16, 1]))
        if len(seen) == 20:
            raise Stopped

    with pytest.raises(Stopped):
        replay(load(folder), RIG, show, lambda: False, PACE)
    assert seen == [10 * (k if k != 7 else 6) for k in range(20)]


def test_it_may_rest_before_its_first_frame(recording: Recording) -> None:
    asked: list[bool] = []
    shown_at_rest: list[View] = []

    def show(view: View) -> None:
        assert view.frame is not None and not view.frame.sighting.valid
        shown_at_rest.append(view)
        raise Stopped

    with pytest.raises(Stopped):
        replay(recording, RIG, show, lambda: not asked.append(True), PACE)
    assert len(asked) == 2 and shown_at_rest[0].doing == "at rest"


def test_what_is_missing_is_said() -> None:
    view = View(-5.0, 5.0, "mm", 3e-3)
    assert shown.missing_in_words(view) == ["seen in both directions over 0 % of the range"]
    view.rising[:, 0] = view.falling[:, 0] = 1
    view.falling[24:, :] = (0, 3)
    assert shown.missing_in_words(view) == [
        "seen in both directions over 50 % of the range",
        "the marker is mostly lost from 0 to 5 mm",
    ]


@pytest.mark.parametrize(
    ("nodes", "says"),
    [
        ((0.3, 0.7), ("from -5 to {0:.3g} mm", "from {1:.3g} to 5 mm")),
        ((0.0, 0.7), ("from {1:.3g} to 5 mm",)),
        (None, ("from -5 to 5 mm",)),
    ],
)
def test_what_is_not_measured_is_said(
    recording: Recording, nodes: tuple[float, float] | None, says: tuple[str, ...]
) -> None:
    """nodes: from which to which of q's nodes, as shares of them, B is measured; says: `{}` are the nodes beyond."""
    found = calibrate([recording], RIG)
    q = found.model.q
    first, last = (0, 1) if nodes is None else (int(nodes[0] * len(q)), int(nodes[1] * len(q)))
    measured = (0.0, 0.0) if nodes is None else (float(q[first]), float(q[last]))
    view = View(-5.0, 5.0, "mm", 3e-3)
    view.rising[:, 0] = view.falling[:, 0] = 1
    model = replace(found.model, measured=measured)
    view.standing = Standing.of(replace(found, model=model, gaps=gaps(model, None)), -5.0, 5.0, 3e-3)
    unmeasured = [said.split(":")[0] for said in shown.missing_in_words(view) if "not measured" in said]
    assert unmeasured == [f"B is not measured {each.format(q[first - 1], q[last + 1])}" for each in says]


def test_a_marker_that_is_lost_has_no_place_and_no_angle() -> None:
    lost = Frame(1_000_000, Sighting(np.nan, np.nan, np.nan, np.nan, "no marker of this colour"), None)
    assert shown.Bending(RIG).of(lost) is None
    document = shown.frame_document(lost, float("nan"), None)
    assert json.loads(json.dumps(document, allow_nan=False))["lost"] == "no marker of this colour"
    assert document["u_px"] is None and document["q"] is None


def test_the_angle_that_is_shown_is_that_of_the_pose() -> None:
    bending, rng = shown.Bending(RIG), np.random.default_rng(2)
    places = project(RIG, rng.uniform(*coarse_range_deg(RIG), 40)) + rng.normal(0.0, 1.0, (40, 2))
    frames = [Frame(0, Sighting(float(u), float(v), 0.05, 20.0), None) for u, v in places]
    assert [bending.of(frame) for frame in frames] == pytest.approx(pose(RIG, places)[0].tolist(), abs=2e-3)


def test_what_cannot_be_shown_is_told_before_a_page_is_served(taut: Taut, tmp_path: Path, recording: Recording) -> None:
    folder = tmp_path / "run"
    save(recording, folder)
    for words, says in (
        (["live"], "name a RECORDING to play"),
        (["live", folder, "--simulate"], "choose one of them"),
        (["live", "--simulate"], "--out"),
    ):
        done = taut(*words)
        assert done.code == 2 and says in done.err


@pytest.mark.skipif(shutil.which("node") is None, reason="JavaScript runs in a browser or in node")
@pytest.mark.parametrize(("status", "least", "most"), [(404, 1, 1), (204, 10, 1000)])
def test_a_page_that_is_refused_asks_once_a_second_and_one_that_waits_asks_again(
    status: int, least: int, most: int
) -> None:
    source = (Path(page_package.__file__).parent / "assets" / "page.js").read_text()
    pictures = re.search(r"^async function pictures\(\) \{.*?^\}", source, re.DOTALL | re.MULTILINE)
    assert pictures is not None
    script = f"""let asked = 0;
    globalThis.fetch = async () => {{
      asked++;
      await new Promise((resolve) => setTimeout(resolve, 1));
      return {{ status: {status}, ok: {status} < 300 }};
    }};
    {pictures[0]}
    pictures();
    setTimeout(() => {{ console.log(asked); process.exit(); }}, 300);"""
    done = subprocess.run(["node", "-e", script], capture_output=True, text=True, timeout=WAIT_S, check=True)
    assert least <= int(done.stdout) <= most
