"""A server for one page and one user: it listens on this machine only, and renders the plans sent by its page.

`GET /` is the page; `POST /render` takes `{"plan": ...}` and answers with the data of a take or with `{"error": ...}`.
Any page open in a browser can send requests to a local server; so a request must name this server as its host (which a
foreign name resolved to this machine does not), and a rendering must come from its own page and carry the page's token.
"""

from __future__ import annotations

import hmac
import json
import secrets
import sys
import threading
import traceback
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from data_module.errors import InputError, one_line
from data_module.files import parse_json

HOST = "127.0.0.1"
TOKEN_HEADER = "X-Gesticulator-Token"
MOST_BYTES = 16 << 20
"""Largest request, bytes: the plan of an hour is about 10 million."""
MOST_CONNECTIONS = 16
"""Concurrent connections; a browser opens up to 6."""
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

Render = Callable[[dict[str, Any]], dict[str, Any]]
"""A plan as JSON -> the page's data of its take; `InputError` for an invalid plan."""


class PageServer(ThreadingHTTPServer):
    """Serves a page until `shutdown`. Page and renderer are set after the port has been opened."""

    daemon_threads = True
    block_on_close = False
    page: bytes = b""
    render: Render | None = None
    queue = 20.0
    """Seconds that a plan waits for another rendering before it is refused."""

    def __init__(self, port: int = 0) -> None:
        """port: 0 for any free one. `InputError` if it is taken or not allowed."""
        try:
            super().__init__((HOST, port), _PageHandler)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or "no such port"
            raise InputError(f"--port {port}", f"cannot be used ({reason})",
                             "choose another, or leave it out") from None
        self.token = secrets.token_urlsafe(24)
        self.rendering = threading.Lock()
        self._connections = threading.BoundedSemaphore(MOST_CONNECTIONS)

    @property
    def url(self) -> str:
        """URL of the page."""
        return f"http://{HOST}:{self.server_port}/"

    @property
    def hosts(self) -> tuple[str, ...]:
        """Accepted values of the Host header."""
        return f"{HOST}:{self.server_port}", f"localhost:{self.server_port}"

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a connection in a new thread; close excess connections."""
        if not self._connections.acquire(blocking=False):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._connections.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore browsers that disconnect early."""
        if not isinstance(sys.exc_info()[1], ConnectionError | TimeoutError):
            super().handle_error(request, client_address)


class _PageHandler(BaseHTTPRequestHandler):
    server: PageServer
    protocol_version = "HTTP/1.1"
    server_version = "gesticulator"
    sys_version = ""
    timeout = PATIENCE

    def do_GET(self) -> None:
        if not self._is_ours():
            return
        if self.path.partition("?")[0] != "/":
            self._refuse(HTTPStatus.NOT_FOUND, "there is nothing here")
            return
        self._answer(HTTPStatus.OK, self.server.page, "text/html; charset=utf-8")

    def do_POST(self) -> None:
        # An unread body would be parsed as the next request.
        self.close_connection = True
        if not self._is_ours() or not self._is_from_page():
            return
        if self.path != "/render":
            self._refuse(HTTPStatus.NOT_FOUND, "there is nothing here")
            return
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or len(length) > 18 or "Transfer-Encoding" in self.headers:
            self._refuse(HTTPStatus.LENGTH_REQUIRED, "the request does not tell its length")
        elif int(length) > MOST_BYTES:
            self._refuse(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"the plan has more than {MOST_BYTES >> 20} MB")
        else:
            self._render(self.rfile.read(int(length)))

    def _is_ours(self) -> bool:
        if self.headers.get("Host") in self.server.hosts:
            return True
        self._refuse(HTTPStatus.FORBIDDEN, "this server goes by another name")
        return False

    def _is_from_page(self) -> bool:
        token = self.headers.get(TOKEN_HEADER, "").encode()
        known = hmac.compare_digest(token, self.server.token.encode())
        if self.headers.get("Origin") != f"http://{self.headers['Host']}" or not known:
            self._refuse(HTTPStatus.FORBIDDEN, "the request is not from this server's page: load the page again")
            return False
        if self.headers.get_content_type() != "application/json":
            self._refuse(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "a plan is application/json")
            return False
        return True

    def _render(self, body: bytes) -> None:
        try:
            request = parse_json(body, "the request", "")
        except InputError as error:
            self._refuse(HTTPStatus.BAD_REQUEST, str(error))
            return
        plan = request.get("plan") if isinstance(request, dict) else None
        if not isinstance(plan, dict) or self.server.render is None:
            self._refuse(HTTPStatus.BAD_REQUEST, "the request holds no plan")
            return
        if not self.server.rendering.acquire(timeout=self.server.queue):
            self._refuse(HTTPStatus.SERVICE_UNAVAILABLE, "another plan is being rendered")
            return
        try:
            take = self.server.render(plan)
        except (InputError, OSError) as error:
            self._refuse(HTTPStatus.BAD_REQUEST, one_line(error))
        except Exception as error:  # noqa: BLE001 - one plan that fails must not end the session
            traceback.print_exc()
            self._refuse(HTTPStatus.INTERNAL_SERVER_ERROR, f"rendering failed ({type(error).__name__}); the terminal "
                         "tells more")
        else:
            self._answer(HTTPStatus.OK, json.dumps(take, allow_nan=False).encode(), "application/json")
        finally:
            self.server.rendering.release()

    def _refuse(self, status: HTTPStatus, why: str) -> None:
        self.close_connection = True
        self._answer(status, json.dumps({"error": why}).encode(), "application/json")

    def _answer(self, status: HTTPStatus, body: bytes, kind: str) -> None:
        self.send_response(status)
        for name, value in HEADERS.items():
            self.send_header(name, value)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Do not log requests."""

