"""The server behind the page: who may ask it, for what, and how much."""

import http.client
import json
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from performances import perform

from data_module.errors import InputError
from gesticulator.page.server import MOST_BYTES, TOKEN_HEADER, PageServer, message

SECONDS = 3.0


class Renderer:
    """Answers each plan with one message, when it may; lexeme 999 is a fault of the program."""

    def __init__(self) -> None:
        self.begun = threading.Event()
        self.plan: dict[str, Any] = perform(SECONDS, seed=3).plan().to_dict()

    def __call__(self, request: dict[str, Any], abandoned: Callable[[], bool], report: Callable[[bytes], object]
                 ) -> bytes:
        plan = request["plan"]
        self.begun.set()
        if "blocks" not in plan:
            raise InputError("plan", "has no blocks", "give it some")
        if any(block["lexeme"] == 999 for block in plan["blocks"]):
            raise RuntimeError("nobody thought of this")
        return message({"kind": "done", "rendering": 1, "plan": plan})


@pytest.fixture
def served() -> Iterator[tuple[PageServer, Renderer]]:
    server, renderer = PageServer(), Renderer()
    server.page = b"<!doctype html>"
    server.render = renderer
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    yield server, renderer
    server.shutdown()
    server.server_close()
    thread.join(10)


def _ask(server: PageServer, method: str = "POST", path: str = "render", body: bytes | None = None,
         **changed: str | None) -> tuple[int, dict[str, Any] | bytes]:
    """The status and the answer. changed: headers other than those of the page, None for none."""
    headers = {"Host": f"127.0.0.1:{server.server_port}", "Content-Type": "application/json",
               "Origin": f"http://127.0.0.1:{server.server_port}", TOKEN_HEADER: server.token}
    headers |= {name.replace("_", "-"): value for name, value in changed.items()}  # type: ignore[dict-item]
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=20)
    path = path if path.startswith("/") else f"/{server.secret}/{path}"
    connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
    body = b"" if body is None else body
    for name, value in {"Content-Length": str(len(body)), **headers}.items():
        if value is not None:
            connection.putheader(name, value)
    connection.endheaders()
    connection.send(body)
    answer = connection.getresponse()
    read = answer.read()
    assert answer.headers["X-Content-Type-Options"] == "nosniff"
    assert "Access-Control-Allow-Origin" not in answer.headers
    connection.close()
    return answer.status, json.loads(read) if answer.headers["Content-Type"] == "application/json" else read


def _plan(renderer: Renderer) -> bytes:
    return json.dumps({"plan": renderer.plan}).encode()


def test_who_may_ask_and_for_what(served: tuple[PageServer, Renderer]) -> None:
    server, renderer = served
    plan = _plan(renderer)
    assert server.server_address[0] == "127.0.0.1"
    status, page = _ask(server, "GET", "")
    assert status == 200 and page == server.page
    for name in ("evil.example", f"evil.example:{server.server_port}", "127.0.0.1", None):
        assert _ask(server, "GET", "", Host=name)[0] == 403
    other = server.secret[:-1] + ("y" if server.secret.endswith("x") else "x")
    for path in ("/", "/render", "../etc/passwd", "render", f"/{server.secret}", f"/{other}/", "//"):
        assert _ask(server, "GET", path)[0] == 404, path
    assert _ask(server, path="/render", body=plan)[0] == 404, "the token alone is not enough"
    for changed in ({"Origin": "http://evil.example"}, {"Origin": "null"}, {"Origin": None}, {TOKEN_HEADER: "x"},
                    {TOKEN_HEADER: None}, {TOKEN_HEADER: "\xe9"}):
        status, told = _ask(server, body=plan, **changed)
        assert status == 403 and "this server's page" in told["error"]  # type: ignore[index]
    assert _ask(server, body=plan, Content_Length=None)[0] == 411
    assert _ask(server, Content_Length=str(MOST_BYTES + 1))[0] == 413
    assert _ask(server, "POST", "other", body=plan)[0] == 404
    assert not renderer.begun.is_set(), "nothing of this was rendered"
    assert _ask(server, body=plan)[0] == 200


def test_what_is_wrong_is_told_and_ends_nothing(served: tuple[PageServer, Renderer],
                                                capfd: pytest.CaptureFixture[str]) -> None:
    server, renderer = served
    for body in (b"", b"{", b"[]", b'{"plan": 3}', b"[" * 100_000, b"\xff"):
        assert _ask(server, body=body)[0] == 400
    assert _ask(server, body=b'{"plan": {}}') == (400, {"error": "plan: has no blocks; give it some"})
    wild = json.loads(_plan(renderer))
    wild["plan"]["blocks"][0]["lexeme"] = 999
    status, told = _ask(server, body=json.dumps(wild).encode())
    assert status == 500 and "RuntimeError" in told["error"]  # type: ignore[index]
    assert "nobody thought of this" in capfd.readouterr().err


def test_a_port_that_is_taken_is_told(served: tuple[PageServer, Renderer]) -> None:
    server, _ = served
    with pytest.raises(InputError, match=f"--port {server.server_port}: cannot be used"):
        PageServer(server.server_port)
