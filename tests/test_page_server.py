"""The server behind the page: who may ask it, for what, how much; and an edit that comes back as motion."""

from __future__ import annotations

import http.client
import json
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from browser import OpenedPage, chromium
from performances import perform

from data_module.errors import InputError
from data_module.motion import kinematics
from data_module.motion.skeletons import standing
from gesticulator.export import html
from gesticulator.page.server import MOST_BYTES, TOKEN_HEADER, PageServer, message

SECONDS = 3.0


class Renderer:
    """Puts lexemes on a performance, and another motion where they are other ones."""

    def __init__(self) -> None:
        self.first, self.other = perform(SECONDS, seed=3), perform(SECONDS, seed=5)
        self.may_go_on = threading.Event()
        self.may_go_on.set()
        self.begun = threading.Event()
        self.plan: dict[str, Any] = html.describe(self.first.scene())["plan"]

    def __call__(self, request: dict[str, Any], abandoned: Callable[[], bool], report: Callable[[bytes], object]
                 ) -> bytes:
        plan = request["plan"]
        self.begun.set()
        assert self.may_go_on.wait(20)
        if "blocks" not in plan:
            raise InputError("plan", "has no blocks", "give it some")
        lexemes = np.array([block["lexeme"] for block in plan["blocks"]])
        if (lexemes == 999).any():
            raise RuntimeError("nobody thought of this")
        same = (lexemes == self.first.lexemes).all()
        made = replace(self.first, motion=(self.first if same else self.other).motion, lexemes=lexemes)
        self.plan = plan
        motion = html.shown(made.scene())
        frames, root = np.round(motion.rotations * html.QUATERNION_STEPS).astype("<i2"), html.root_path(motion)
        return message({"kind": "done", "rendering": 1, "shape": html.describe_shape(motion, SECONDS), "plan": plan,
                        "range": [0, len(frames)], "root": len(root)}, frames.tobytes() + root)


@pytest.fixture
def served() -> Iterator[tuple[PageServer, Renderer]]:
    server, renderer = PageServer(), Renderer()
    live = {"token": server.token, "renderings": [0]}
    server.page = html.page({"take": renderer.first.scene()}, "talk", more={"live": live}).encode()
    server.render = renderer
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    yield server, renderer
    renderer.may_go_on.set()
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
    return json.dumps({"plan": html.describe(renderer.first.scene())["plan"]}).encode()


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
    assert _ask(server, body=plan, Content_Type="text/plain")[0] == 415
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
    # One at a time: a second plan is refused where the first takes long, and taken after it.
    server.queue = 0.05
    renderer.may_go_on.clear()
    renderer.begun.clear()
    answers: list[int] = []
    first = threading.Thread(target=lambda: answers.append(_ask(server, body=_plan(renderer))[0]))
    first.start()
    assert renderer.begun.wait(20)
    status, told = _ask(server, body=_plan(renderer))
    assert status == 503 and "another plan" in told["error"]  # type: ignore[index]
    renderer.may_go_on.set()
    first.join(20)
    assert answers == [200] and _ask(server, body=_plan(renderer))[0] == 200


def test_a_port_that_is_taken_is_told(served: tuple[PageServer, Renderer]) -> None:
    server, _ = served
    with pytest.raises(InputError, match=f"--port {server.server_port}: cannot be used"):
        PageServer(server.server_port)
    with pytest.raises(InputError, match="cannot be used"):
        PageServer(70_000)


def test_an_edit_on_the_page_comes_back_as_motion(served: tuple[PageServer, Renderer]) -> None:
    server, renderer = served
    with chromium() as browser:
        opened = OpenedPage(browser, server.url)
        page = opened.page
        opened.go_to(1.0)

        def joints_are(performance: Any) -> None:
            page.wait_for_function("() => document.getElementById('status').dataset.state === 'same'")
            opened.go_to(1.0)
            page.evaluate("() => preview.stage.draw(1.0)")
            truth = kinematics.positions_of(standing(performance.motion))[25]
            np.testing.assert_allclose(opened.joints(), truth, atol=4e-3)

        joints_are(renderer.first)
        page.keyboard.press("2")
        page.wait_for_function("() => document.getElementById('status').textContent.startsWith('rendered in')")
        joints_are(renderer.other)
        # It stays beside what it was, and goes back.
        page.keyboard.press("d")
        assert page.locator("#labels span").all_text_contents() == ["take", "before"]
        page.keyboard.press("d")
        page.keyboard.press("Control+z")
        page.wait_for_function("() => preview.session.lane.rendered === preview.session.plan")
        joints_are(renderer.first)
        opened.check_quiet(server.url)
        # A plan that comes while another one is rendered is sent again.
        server.queue = 0.05
        server.rendering.acquire()
        page.keyboard.press("3")
        page.wait_for_function("() => document.getElementById('status').textContent.startsWith('waiting')")
        server.rendering.release()
        joints_are(renderer.other)
        page.keyboard.press("Control+z")
        joints_are(renderer.first)
        # What the renderer refuses is told on the page, which goes on.
        page.evaluate("""() => {
            const { session } = preview, [first, ...rest] = session.plan.blocks;
            session.edit({ ...session.plan, blocks: [{ ...first, lexeme: 999 }, ...rest] });
        }""")
        page.wait_for_function("() => document.getElementById('notice').textContent.includes('RuntimeError')")
        page.keyboard.press("Control+z")
        joints_are(renderer.first)
        assert [url for url in opened.requests if not url.startswith((server.url, "data:", "blob:"))] == []
