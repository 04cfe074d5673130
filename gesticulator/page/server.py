"""A server for one page and one user: it listens on this machine only, and renders the plans sent by its page.

`GET /SECRET/` is the page, or one that waits for it; that asks for `GET /SECRET/progress`. `GET /SECRET/figures` gives
the figures of the palette, and `GET /SECRET/plan/N` the state of the edits, with the plan if there is one after
revision N. `POST /SECRET/render` takes the page's request and answers with
the messages of `gesticulator.page.session`, with `{"error": ...}`, or with the state where edits of another page came
before. Other users of this machine can find the port, so the address holds a secret. Any page open in a browser can
send requests to a local server; so a request must name this server as its host (which a foreign name resolved to this
machine does not), and a rendering must come from its own page and carry the page's token.
"""

import hmac
import json
import secrets
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from typing import Any

from data_module.errors import InputError, one_line
from data_module.files import parse_json
from gesticulator.page.edits import Edits, StaleError

HOST = "127.0.0.1"
TOKEN_HEADER = "X-Gesticulator-Token"
MOST_BYTES = 16 << 20
"""Largest request, bytes: the plan of an hour is about 10 million."""
PATIENCE = 30.0
"""Idle timeout of a connection, seconds."""
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",  # cannot be set by the policy in the page
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}

Render = Callable[[dict[str, Any], Callable[[], bool], Callable[[bytes], object]], bytes]
"""A request with a plan, whether it has been abandoned, and what sends a first part of the answer -> the rest of it;
`InputError` for an invalid request, `AbandonedError` for an abandoned one."""


def message(header: Mapping[str, Any], data: bytes = b"") -> bytes:
    """A message of an answer: the length of a header (4 bytes, little-endian), the header as JSON with the number of
    `bytes` of the data, and the data."""
    text = json.dumps({**header, "bytes": len(data)}, allow_nan=False).encode()
    return len(text).to_bytes(4, "little") + text + data


class AbandonedError(Exception):
    """The page has asked for something else."""


class PageServer(ThreadingHTTPServer):
    """Serves a page until `shutdown`. The page and then its renderer are set after the port has been opened; until then
    a page shows `progress`."""

    daemon_threads = True
    block_on_close = False

    def __init__(self, port: int = 0) -> None:
        """port: 0 for any free one. `InputError` if it is taken or not allowed."""
        try:
            super().__init__((HOST, port), _PageHandler)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or "no such port"
            raise InputError(f"--port {port}", f"cannot be used ({reason})",
                             "choose another, or leave it out") from None
        self.page = (resources.files("gesticulator") / "assets" / "waiting.html").read_bytes()
        self.progress: dict[str, Any] = {}
        """What is done until the page is there: `name` of the recording, what it is `doing`, the `share` that is done,
        or the line with which it `failed`."""
        self.told = threading.Event()  # a page has asked after it failed
        self.edits = Edits()
        self.figures: Callable[[], bytes] = lambda: b"{}"
        """Makes the figures of the palette as JSON."""
        self.render: Render | None = None
        """Answers requests with a plan, one at a time."""
        self.token, self.secret = secrets.token_urlsafe(24), secrets.token_urlsafe(24)
        self.rendering = threading.Lock()
        self._latest: dict[str, int] = {}  # page -> its last request

    @property
    def url(self) -> str:
        """URL of the page, with the secret."""
        return f"http://{HOST}:{self.server_port}/{self.secret}/"

    @contextmanager
    def in_background(self) -> Iterator[None]:
        """Serve in a thread of its own meanwhile."""
        threading.Thread(target=self.serve_forever, daemon=True).start()
        try:
            yield
        finally:
            self.shutdown()

    def abandons(self, page: str, number: int) -> Callable[[], bool]:
        """Note the latest request of a page; returns whether a later one has come."""
        self._latest[page] = max(number, self._latest.get(page, 0))
        return lambda: self._latest[page] > number

    def service_actions(self) -> None:
        """Between requests: what could not be saved is tried again."""
        self.edits.save()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore browsers that disconnect early."""
        if not isinstance(sys.exc_info()[1], ConnectionError | TimeoutError):
            super().handle_error(request, client_address)


class _PageHandler(BaseHTTPRequestHandler):
    server: PageServer
    server_version = "gesticulator"
    # The version of Python is not told to everyone who asks.
    sys_version = ""
    timeout = PATIENCE
    _begun = False
    """Whether a part of an answer was sent (`_part`)."""

    def do_GET(self) -> None:
        if not self._is_ours():
            return
        place = self._place()
        what, _, since = (place or "").partition("/")
        # To read, the secret is enough: another origin cannot see the answer.
        if what == "plan" and since.isdecimal() and len(since) < 18:
            self._answer(HTTPStatus.OK, self.server.edits.state(int(since)), "application/json")
        elif place == "progress":
            progress = {**self.server.progress, "ready": self.server.render is not None}
            self._answer(HTTPStatus.OK, json.dumps(progress).encode(), "application/json")
            if "failed" in progress:
                self.server.told.set()
        elif place == "figures":
            self._answer(HTTPStatus.OK, self.server.figures(), "application/json")
        elif place == "":
            self._answer(HTTPStatus.OK, self.server.page, "text/html; charset=utf-8")
        else:
            self._refuse(HTTPStatus.NOT_FOUND, "there is nothing here")

    def do_POST(self) -> None:
        if not self._is_ours() or not self._is_from_page():
            return
        place = self._place()
        if place != "render" or self.server.render is None:
            self._refuse(HTTPStatus.NOT_FOUND, "there is nothing here")
            return
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or len(length) > 18 or "Transfer-Encoding" in self.headers:
            self._refuse(HTTPStatus.LENGTH_REQUIRED, "the request does not tell its length")
        elif int(length) > MOST_BYTES:
            self._refuse(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"the plan has more than {MOST_BYTES >> 20} MB")
        else:
            self._render(self.rfile.read(int(length)), self.server.render)

    def _place(self) -> str | None:
        """The path below the secret one; None elsewhere."""
        # In constant time: the time of a plain comparison tells how much of a guess is right.
        secret, _, place = self.path.partition("?")[0].removeprefix("/").partition("/")
        if not hmac.compare_digest(secret.encode("utf-8", "replace"), self.server.secret.encode()):
            return None
        return place if self.path.startswith(f"/{secret}/") else None

    def _is_ours(self) -> bool:
        known = self.headers.get("Host") in [f"{host}:{self.server.server_port}" for host in (HOST, "localhost")]
        if not known:
            self._refuse(HTTPStatus.FORBIDDEN, "this server goes by another name")
        return known

    def _is_from_page(self) -> bool:
        token = self.headers.get(TOKEN_HEADER, "").encode()
        known = hmac.compare_digest(token, self.server.token.encode())
        # The origin tells other pages off; the token tells off what sends no origin and guesses it.
        if self.headers.get("Origin") != f"http://{self.headers['Host']}" or not known:
            self._refuse(HTTPStatus.FORBIDDEN, "the request is not from this server's page: load the page again")
            return False
        return True

    def _render(self, body: bytes, render: Render) -> None:
        try:
            request = parse_json(body, "the request", "")
        except InputError as error:
            self._refuse(HTTPStatus.BAD_REQUEST, str(error))
            return
        request = request if isinstance(request, dict) else {}
        if not isinstance(request.get("plan"), dict):
            self._refuse(HTTPStatus.BAD_REQUEST, "the request holds no plan")
            return
        # A request without them counts as the first of a page of its own.
        page, number = request.get("page"), request.get("number")
        abandoned = self.server.abandons(page if isinstance(page, str) else "",
                                         number if isinstance(number, int) else 0)
        try:
            # One at a time: the models hold all cores, and the renderer remembers what it sampled.
            with self.server.rendering:
                self._part(render(request, abandoned, self._part))
        except StaleError:
            self._answer(HTTPStatus.PRECONDITION_FAILED, self.server.edits.state(-1), "application/json")
        except AbandonedError:
            self._refuse(HTTPStatus.CONFLICT, "the page has asked for something else")
        except (InputError, OSError) as error:
            self._refuse(HTTPStatus.BAD_REQUEST, one_line(error))
        except Exception as error:  # noqa: BLE001 - one plan that fails must not end the session
            traceback.print_exc()
            self._refuse(HTTPStatus.INTERNAL_SERVER_ERROR, f"rendering failed ({type(error).__name__}); the terminal "
                         "tells more")

    def _part(self, part: bytes) -> None:
        """Send a part of an answer: parts come while they are made."""
        if not self._begun:
            self._head(HTTPStatus.OK, "application/octet-stream")
            self._begun = True
        self.wfile.write(part)

    def _refuse(self, status: HTTPStatus, why: str) -> None:
        if not self._begun:
            self._answer(status, json.dumps({"error": why}).encode(), "application/json")
        elif status != HTTPStatus.CONFLICT:  # the answer has begun with messages of progress
            self.wfile.write(message({"kind": "failed", "error": why}))

    def _answer(self, status: HTTPStatus, body: bytes, kind: str) -> None:
        self._head(status, kind)
        self.wfile.write(body)

    def _head(self, status: HTTPStatus, kind: str) -> None:
        """The head of an answer, which ends with the connection."""
        self.send_response(status)
        for name, value in HEADERS.items():
            self.send_header(name, value)
        self.send_header("Content-Type", kind)
        self.end_headers()

    def log_message(self, format: str, *args: Any) -> None:
        """Do not log requests."""
