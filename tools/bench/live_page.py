"""The live page's server beside the tracking of rendered frames: pictures a second that a client gets, and what the
tracking pays for it. The browser's own work is not in it: the client reads and throws away."""

from __future__ import annotations

import http.client
import threading
import time
from contextlib import closing
from urllib.parse import urlsplit

import numpy as np

from tautline.geometry import coarse_range_deg, project
from tautline.live.page.desk import Desk
from tautline.live.page.server import serving
from tautline.live.setup import Frame
from tautline.simulated.endoscope import Endoscope
from tautline.simulated.instrument import reference_rig
from tautline.vision.colour import pick
from tautline.vision.marker import MarkerTracker

_SECONDS = 8.0
_PICTURES = 40  # rendered before the clock runs


def run() -> list[tuple[str, float, str]]:
    rig = reference_rig()
    endoscope = Endoscope(rig)
    low, high = coarse_range_deg(rig)
    angles = np.linspace(0.5 * low, 0.5 * high, _PICTURES)
    pictures = [endoscope.frame(c, 0.0, 0.0) for c in angles]
    spot = project(rig, angles[0])[0]
    tracker = MarkerTracker(pick(pictures[0], (float(spot[0]), float(spot[1]))))
    assert rig.camera is not None
    frame_s = 1.0 / rig.camera.frame_rate_hz

    def tracked(desk: Desk) -> tuple[int, int, float]:
        """Frames at the camera's rate; how many came late, and what a frame took, s."""
        began, late, busy = time.monotonic(), 0, []
        for k in range(round(_SECONDS / frame_s)):
            due = began + k * frame_s
            time.sleep(max(due - time.monotonic(), 0.0))
            at = time.monotonic()
            late += at - due > 0.5 * frame_s
            picture = pictures[k % _PICTURES]
            desk.show_frame(Frame(round(at * 1e6), tracker.track(picture), picture.copy()), 0.0)
            busy.append(time.monotonic() - at)
        return len(busy), late, float(np.median(busy))

    desk = Desk(rig, {})
    _, _, alone_s = tracked(desk)
    with serving(desk) as server:
        over, got, size = threading.Event(), [0], [0]
        address = urlsplit(server.address)

        def watch() -> None:
            after = "0"
            with closing(http.client.HTTPConnection(address.netloc, timeout=10.0)) as line:
                while not over.is_set():
                    line.request("GET", f"{address.path}picture?after={after}")
                    answer = line.getresponse()
                    body = answer.read()
                    if answer.status == 200:
                        after = answer.headers["Taut-Number"]
                        got[0], size[0] = got[0] + 1, size[0] + len(body)

        def listen() -> None:
            with closing(http.client.HTTPConnection(address.netloc, timeout=10.0)) as line:
                line.request("GET", f"{address.path}events")
                with line.getresponse() as answer:
                    while not over.is_set() and answer.readline():
                        pass

        readers = [threading.Thread(target=reader, daemon=True) for reader in (watch, listen)]
        for reader in readers:
            reader.start()
        frames, late, beside_s = tracked(desk)
        over.set()
        readers[0].join()
    readers[1].join()  # it reads to the end of the events
    return [
        ("camera", frames / _SECONDS, "frames/s"),
        ("pictures that a page gets beside the tracking", got[0] / _SECONDS, "frames/s"),
        ("a picture", size[0] / max(got[0], 1) / 1e3, "kB"),
        ("frames that the tracking took late", float(late), f"of {frames}"),
        ("tracking and publishing a frame, nobody looks", 1e3 * alone_s, "ms"),
        ("tracking and publishing a frame, a page looks", 1e3 * beside_s, "ms"),
    ]
