"""A headless Chromium for the tests of the page, and a page in it with what it complained about and asked for."""

from __future__ import annotations

import mimetypes
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
         "--disable-background-networking", "--disable-component-update", "--use-angle=swiftshader",
         "--enable-unsafe-swiftshader", "--autoplay-policy=no-user-gesture-required"]
PATIENCE = 180_000
"""Milliseconds that a step may take: without a GPU, on a machine that others use, a picture takes seconds."""
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


@contextmanager
def chromium(*flags: str) -> Iterator[Any]:
    """A browser, with more flags; the test is skipped, with the reason, where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    program = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, NAMES)), None)
    if not program:
        pytest.skip("no chromium on this machine")
    with playwright.sync_playwright() as driver:
        window = driver.chromium.launch(executable_path=program, args=[*FLAGS, *flags])
        yield window
        window.close()


@contextmanager
def opened_page(url: str, width: int, height: int) -> Iterator[OpenedPage]:
    """A page at a url in a browser of its own."""
    with chromium() as browser:
        yield OpenedPage(browser, url, width, height)


SITE = "http://tests.invalid/"


@contextmanager
def package_page(browser: Any, name: str, package: Path, *folders: Path) -> Iterator[Any]:
    """A page of a browser that says when it is ready, of the first of the folders that has it; a package lies at
    `package/`. Playwright has one driver at a time in a process, so the pages of a module share a browser."""

    def serve(route: Any) -> None:
        asked = route.request.url.removeprefix(SITE)
        paths = [package / asked.removeprefix("package/")] if asked.startswith("package/") else [
            folder / asked for folder in folders]
        path = next(filter(Path.is_file, paths), None)
        if path is None:
            route.fulfill(status=404)
            return
        kind = mimetypes.guess_type(path.name)[0] or "application/octet-stream"
        route.fulfill(body=path.read_bytes(), content_type="text/javascript" if path.suffix == ".js" else kind)

    window = browser.new_page()
    window.set_default_timeout(120_000)
    window.route("**/*", serve)
    window.goto(SITE + name)
    window.wait_for_function("window.ready === true")
    yield window
    window.close()


class OpenedPage:
    """A page of ours in the browser."""

    def __init__(self, browser: Any, address: str, width: int = 800, height: int = 560, **context: Any) -> None:
        self.complaints: list[str] = []
        self.requests: list[str] = []
        self.page = browser.new_page(viewport={"width": width, "height": height}, reduced_motion="reduce", **context)
        self.page.set_default_timeout(20_000)
        self.page.on("console", self._said)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.goto(address, timeout=PATIENCE)  # a browser that has just begun, on a core that many share
        self.page.wait_for_selector("body[data-ready=true]", timeout=PATIENCE)
        self.page.wait_for_function("() => preview.clock.audible", timeout=PATIENCE)

    def _said(self, message: Any) -> None:
        if message.type == "error":
            self.complaints.append(message.text)

    def check_quiet(self, own: str = "file:") -> None:
        """Nothing went wrong, and nothing was asked for but the page itself and what it holds."""
        assert self.complaints == [], self.complaints
        assert [url for url in self.requests if not url.startswith((own, "data:", "blob:"))] == []

    def time(self) -> float:
        """Seconds, as the page tells."""
        return float(self.page.get_attribute("#timeline", "aria-valuenow"))

    def go_to(self, seconds: float) -> None:
        """Set the playhead and wait until it is drawn there."""
        self.page.evaluate("(t) => preview.clock.seek(t)", seconds)
        self.settle(seconds)

    def settle(self, seconds: float, near: float = 0.02) -> None:
        """Wait until a time is shown."""
        self.page.wait_for_function("([t, d]) => Math.abs(Number(document.getElementById('timeline')"
                                    ".getAttribute('aria-valuenow')) - t) < d", arg=[seconds, near])

    def joints(self) -> list[list[float]]:
        """Where the joints of our own figure are, metres."""
        return self.page.evaluate("""() => {
            const { figure, group } = preview.stage.performers[0];
            figure.group.updateWorldMatrix(true, true);
            const from = group.position.toArray();
            return figure.bones.map((bone) => bone.matrixWorld.elements.slice(12, 15).map((v, c) => v - from[c]));
        }""")

    def plan(self) -> dict[str, Any]:
        """The plan as it is edited now."""
        return self.page.evaluate("() => preview.session.plan")

    def saved(self, press: str) -> Path:
        """The file that a key, or a click on a selector, hands to the user."""
        with self.page.expect_download() as got:
            if press.startswith("#"):
                self.page.evaluate("(id) => document.querySelector(id).click()", press)
            else:
                self.page.keyboard.press(press)
        return Path(got.value.path())
