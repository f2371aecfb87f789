"""The page's server: on loopback alone, behind a token in the address, with no file but the page's own three.

The standard library's server does: a handful of readers, one thread each.
"""

from __future__ import annotations

import hmac
import json
import secrets
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any
from urllib.parse import parse_qs, urlsplit

import cv2

from tautline.live.page.desk import Desk

LOOPBACK = "127.0.0.1"
_ASSETS = {
    "": ("page.html", "text/html; charset=utf-8"),
    "page.css": ("page.css", "text/css; charset=utf-8"),
    "page.js": ("page.js", "text/javascript; charset=utf-8"),
}
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
_ALIVE_S = 1.0  # between two questions whether the page is there
_PICTURE_S = 5.0  # that a request waits for the next picture
_QUALITY = 80  # of JPEG
_MOST_BYTES = 200  # of what a page may send


class PageServer(ThreadingHTTPServer):
    """An HTTP server on the loopback interface for the pages of one session."""

    daemon_threads = True

    def __init__(self, desk: Desk) -> None:
        """Binds a free port, and draws the token without which nothing is answered."""
        super().__init__((LOOPBACK, 0), _Handler)
        self.desk = desk
        self.token = secrets.token_urlsafe(16)

    @property
    def address(self) -> str:
        """The page's address (URL), with the token."""
        return f"http://{LOOPBACK}:{self.server_address[1]}/{self.token}/"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignores that a page goes away in the middle of an answer; prints other errors as its base class does."""
        if not isinstance(sys.exc_info()[1], OSError):
            super().handle_error(request, client_address)


@contextmanager
def serving(desk: Desk) -> Iterator[PageServer]:
    """A context within which a server answers the pages of a desk, on threads of its own."""
    with PageServer(desk) as server:
        thread = threading.Thread(target=server.serve_forever, name="page", daemon=True, args=(0.05,))
        thread.start()
        try:
            yield server
        finally:
            desk.close()
            server.shutdown()
            thread.join()


class _Handler(BaseHTTPRequestHandler):
    """Answers the requests of one connection."""

    server: PageServer
    protocol_version = "HTTP/1.1"
    timeout = 30.0
    disable_nagle_algorithm = True

    def log_message(self, format: str, *args: Any) -> None:
        """Logs nothing: the terminal belongs to the session."""

    def do_GET(self) -> None:
        """Answers GET: one of the page's files, its events or a picture."""
        name = self._authorised_path()
        if name is None:
            return
        if name in _ASSETS:
            file, kind = _ASSETS[name]
            self._answer((files(__package__) / "assets" / file).read_bytes(), kind)
        elif name == "events":
            self._send_events()
        elif name == "picture":
            self._send_picture()
        else:
            self._refuse(HTTPStatus.NOT_FOUND)

    def do_POST(self) -> None:
        """Answers POST: hands what the page asks for (start, rest, stop, here, pick) to the desk. Any of them shows
        that the page is open."""
        name = self._authorised_path()
        if name is None:
            return
        desk = self.server.desk
        orders: dict[str, Callable[[], None]] = {
            "start": desk.start, "rest": desk.rest, "stop": desk.stop, "here": desk.note_open_page,
        }  # fmt: skip
        desk.note_open_page()
        sent = self._json_body()
        if sent is None:
            self._refuse(HTTPStatus.BAD_REQUEST)
        elif name in orders:
            orders[name]()
            self._answer(b"{}", "application/json")
        elif name == "pick" and all(isinstance(sent.get(key), int | float) for key in ("u_px", "v_px")):
            desk.pick(float(sent["u_px"]), float(sent["v_px"]))
            self._answer(b"{}", "application/json")
        else:
            self._refuse(HTTPStatus.BAD_REQUEST if name == "pick" else HTTPStatus.NOT_FOUND)

    def _authorised_path(self) -> str | None:
        """Returns the part of the request's path after the token. None, after refusing the request, where the token is
        wrong, or the request was for another host name than this machine's (against DNS rebinding)."""
        _, _, behind = self.path.partition("?")[0].partition("/")
        token, slash, name = behind.partition("/")
        if not hmac.compare_digest(token.encode(), self.server.token.encode()) or not slash:
            self._refuse(HTTPStatus.NOT_FOUND)
            return None
        try:
            host = urlsplit(f"//{self.headers.get('Host', '')}").hostname
        except ValueError:
            self._refuse(HTTPStatus.BAD_REQUEST)
            return None
        if host not in (LOOPBACK, "localhost"):
            self._refuse(HTTPStatus.FORBIDDEN)
            return None
        return name

    def _json_body(self) -> dict[str, Any] | None:
        """Reads the JSON object in a request's body, {} where there is no body; None for anything else, or a body of
        more than _MOST_BYTES."""
        length = _parse_count(self.headers.get("Content-Length", "0"))
        if length is None or length > _MOST_BYTES:
            return None
        try:
            sent = json.loads(self.rfile.read(length) or b"{}")
        except ValueError:
            return None
        return sent if isinstance(sent, dict) else None

    def _send_events(self) -> None:
        """Sends server-sent events as long as the page is there: the latest of each topic, then what is new. Every
        _ALIVE_S it sends `alive`, which the page answers by `here`, as a write to a page that sleeps fails only minutes
        later."""
        self._send_head(HTTPStatus.OK, {"Content-Type": "text/event-stream", "Connection": "close"})
        self.close_connection = True
        events, at, due_s = self.server.desk.events, 0, 0.0
        self.server.desk.note_open_page()
        with suppress(OSError):
            while not events.closed:
                at, fresh = events.newer(at, max(due_s - time.monotonic(), 0.0))
                text = "".join(map(_event_text, fresh, fresh.values()))
                if time.monotonic() >= due_s:
                    text, due_s = text + _event_text("alive", {}), time.monotonic() + _ALIVE_S
                self.wfile.write(text.encode())

    def _send_picture(self) -> None:
        """Sends, as JPEG, the latest picture that is newer than the one which the page has (?after=NUMBER), waiting for
        it up to _PICTURE_S; without one it answers 204, to a malformed number 400. A slow page so gets fewer
        pictures."""
        after = _parse_count(parse_qs(self.path.partition("?")[2]).get("after", ["0"])[0])
        if after is None:
            self._refuse(HTTPStatus.BAD_REQUEST)
            return
        at, fresh = self.server.desk.pictures.newer(after, _PICTURE_S)
        if not fresh:
            self._answer(b"", "image/jpeg", HTTPStatus.NO_CONTENT)
            return
        picture = fresh["picture"]
        _, coded = cv2.imencode(".jpg", picture.pixels, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
        about = {"Taut-Number": str(at), "Taut-Seen": json.dumps(picture.seen, allow_nan=False)}
        self._answer(coded.tobytes(), "image/jpeg", headers=about)

    def _answer(
        self, body: bytes, kind: str, status: HTTPStatus = HTTPStatus.OK, headers: dict[str, str] | None = None
    ) -> None:
        """Sends a whole answer. kind: its content type."""
        self._send_head(status, {"Content-Type": kind, "Content-Length": str(len(body)), **(headers or {})})
        self.wfile.write(body)

    def _refuse(self, status: HTTPStatus) -> None:
        """Answers with a bare status and closes the connection, as an unread body may follow."""
        self.close_connection = True
        self._answer(b"", "text/plain", status, {"Connection": "close"})

    def _send_head(self, status: HTTPStatus, headers: dict[str, str]) -> None:
        """Sends an answer's status and headers, with those that every answer has (_HEADERS)."""
        self.send_response_only(status)
        for key, value in {**_HEADERS, **headers}.items():
            self.send_header(key, value)
        self.end_headers()


def _parse_count(text: str) -> int | None:
    """Returns the number in a text of 1 to 9 decimal digits, None for any other text."""
    return int(text) if text.isascii() and text.isdecimal() and len(text) < 10 else None


def _event_text(topic: str, what: Any) -> str:
    """Returns the text of a server-sent event of this topic whose data are `what`, as JSON."""
    return f"event: {topic}\ndata: {json.dumps(what, allow_nan=False)}\n\n"
