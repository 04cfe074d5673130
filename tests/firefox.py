"""A Firefox for the tests of the page, spoken to by WebDriver BiDi (https://w3c.github.io/webdriver-bidi/)."""

from __future__ import annotations

import base64
import itertools
import json
import os
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

NAMES = ("firefox-esr", "firefox")
PREFERENCES = {"media.autoplay.default": 0, "webgl.force-enabled": True, "ui.prefersReducedMotion": 1,
               "datareporting.policy.dataSubmissionEnabled": False, "app.update.disabledForTesting": True,
               "browser.shell.checkDefaultBrowser": False, "network.captive-portal-service.enabled": False,
               "network.connectivity-service.enabled": False, "extensions.update.enabled": False}
KEYS = {"Control": "\ue009", "Shift": "\ue008", "Tab": "\ue004", "Escape": "\ue00c", "Enter": "\ue007",
        "ArrowUp": "\ue013"}
_STARTS = 120.0
"""Seconds in which it must be there."""


class FirefoxPage:
    """A page in it. complaints: errors of scripts, and what they wrote as errors."""

    def __init__(self, socket: Any) -> None:
        self._socket, self._numbers = socket, itertools.count(1)
        self.complaints: list[str] = []
        self._call("session.new", {"capabilities": {}})
        self._call("session.subscribe", {"events": ["log.entryAdded"]})
        self.context = self._call("browsingContext.getTree", {})["contexts"][0]["context"]

    def _call(self, method: str, given: dict[str, Any]) -> dict[str, Any]:
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": given}))
        while True:
            said = json.loads(self._socket.recv(timeout=180.0))
            if said.get("method") == "log.entryAdded" and said["params"]["level"] == "error":
                self.complaints.append(str(said["params"]["text"]))
            if said.get("id") == number:
                assert said["type"] == "success", said
                return dict(said["result"])

    def open(self, address: str, width: int, height: int) -> None:
        self._call("browsingContext.setViewport", {"context": self.context,
                                                   "viewport": {"width": width, "height": height}})
        self._call("browsingContext.navigate", {"context": self.context, "url": address, "wait": "complete"})
        self.wait("document.body.dataset.ready === 'true'")

    def evaluate(self, expression: str) -> Any:
        """The value of an expression, by way of JSON."""
        made = self._call("script.evaluate", {
            "expression": f"(async () => JSON.stringify((await ({expression})) ?? null))()",
            "target": {"context": self.context}, "awaitPromise": True})
        assert made["type"] == "success", made
        return json.loads(made["result"]["value"])

    def wait(self, condition: str, seconds: float = 120.0) -> None:
        """Wait until a condition holds."""
        end = time.monotonic() + seconds
        while not self.evaluate(f"Boolean({condition})"):
            assert time.monotonic() < end, condition
            time.sleep(0.1)

    def _act(self, *sources: dict[str, Any]) -> None:
        self._call("input.performActions", {"context": self.context, "actions": list(sources)})

    def press(self, *keys: str) -> None:
        """Press keys together."""
        values = [KEYS.get(key, key) for key in keys]
        self._act({"type": "key", "id": "keys", "actions": [
            *({"type": "keyDown", "value": value} for value in values),
            *({"type": "keyUp", "value": value} for value in reversed(values))]})

    def drag(self, *places: Sequence[float]) -> None:
        """Press the pointer at the first place, move it over the others, and let go; one place is a click."""
        moves = [{"type": "pointerMove", "x": round(x), "y": round(y), "duration": 20} for x, y in places]
        self._act({"type": "pointer", "id": "mouse", "actions": [
            moves[0], {"type": "pointerDown", "button": 0}, *moves[1:], {"type": "pointerUp", "button": 0}]})

    def middle(self, selector: str) -> tuple[float, float]:
        """The middle of an element."""
        x, y = self.evaluate(f"(() => {{ const b = document.querySelector({json.dumps(selector)})"
                             ".getBoundingClientRect(); return [b.x + b.width / 2, b.y + b.height / 2]; })()")
        return float(x), float(y)

    def click(self, selector: str) -> None:
        self.evaluate(f"document.querySelector({json.dumps(selector)}).scrollIntoView({{ block: 'nearest' }})")
        self.drag(self.middle(selector))

    def screenshot(self, path: Path) -> None:
        path.write_bytes(base64.b64decode(self._call("browsingContext.captureScreenshot",
                                                     {"context": self.context})["data"]))


@contextmanager
def _screen() -> Iterator[dict[str, str]]:
    """The variables of a virtual screen, where there is a program for one: without a screen Firefox has no WebGL."""
    program = shutil.which("Xvfb")
    if program is None:
        yield {"MOZ_HEADLESS": "1"}
        return
    with subprocess.Popen([program, "-displayfd", "1", "-screen", "0", "1400x1000x24", "-nolisten", "tcp"],
                          stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as screen:
        try:
            assert screen.stdout is not None
            yield {"DISPLAY": f":{screen.stdout.readline().strip()}"}
        finally:
            screen.terminate()


@contextmanager
def firefox() -> Iterator[FirefoxPage]:
    """A browser with one page; the test is skipped, with the reason, where there is none."""
    client = pytest.importorskip("websockets.sync.client", reason="websockets is not installed")
    program = os.environ.get("FIREFOX") or next(filter(None, map(shutil.which, NAMES)), None)
    if not program:
        pytest.skip("no Firefox on this machine")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder, _screen() as variables:
        (Path(folder) / "user.js").write_text("".join(
            f"user_pref({json.dumps(name)}, {json.dumps(value)});\n" for name, value in PREFERENCES.items()))
        said = Path(folder) / "said.txt"
        with said.open("w") as out:
            started = subprocess.Popen(
                [program, "--no-remote", "--profile", folder, "--remote-debugging-port", "0"], stdout=out, stderr=out,
                env={**os.environ, "LIBGL_ALWAYS_SOFTWARE": "1", "HOME": folder, **variables})
        try:
            end, found = time.monotonic() + _STARTS, None
            while found is None:
                assert started.poll() is None and time.monotonic() < end, said.read_text()
                time.sleep(0.2)
                found = re.search(r"WebDriver BiDi listening on (ws://\S+)", said.read_text())
            with client.connect(found[1] + "/session", max_size=None, open_timeout=60, ping_interval=None) as socket:
                yield FirefoxPage(socket)
        finally:
            started.terminate()
            try:
                started.wait(20)
            except subprocess.TimeoutExpired:
                started.kill()
                started.wait()
