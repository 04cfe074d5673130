"""The preview page: what is in it, and how it behaves in a real browser."""

from __future__ import annotations

import base64
import hashlib
import json
import os
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from performances import perform

from data_module.motion import kinematics, rotation
from data_module.motion.skeletons import CHARACTER, FINGER_JOINTS, FINGERED, standing
from gesticulator.export import html
from gesticulator.performance import write

ASSETS = Path(html.__file__).parent.parent / "assets"
FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
         "--disable-background-networking", "--disable-component-update", "--use-angle=swiftshader",
         "--enable-unsafe-swiftshader", "--autoplay-policy=no-user-gesture-required"]


class _Elements(HTMLParser):
    """Every element's attributes, and the text of every script by its id."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=False)
        self.attributes: list[tuple[str, str, str]] = []
        self.scripts: dict[str, str] = {}
        self._script: str | None = None
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.attributes += [(tag, name, value or "") for name, value in attrs]
        if tag == "script":
            self._script = dict(attrs).get("id") or "main"

    def handle_endtag(self, tag: str) -> None:
        if tag == "script":
            self._script = None

    def handle_data(self, data: str) -> None:
        if self._script is not None:
            self.scripts[self._script] = self.scripts.get(self._script, "") + data


def _data(page: str) -> dict[str, Any]:
    return json.loads(_Elements(page).scripts["performance"])


def test_page_loads_nothing_from_outside() -> None:
    page = html.page(perform(), "talk")
    parsed = _Elements(page)
    loads = [(tag, name, value) for tag, name, value in parsed.attributes if name in ("src", "href", "srcset", "data")]
    assert loads == [("link", "href", "data:,")]
    # The one address in it is the name of a namespace, which is not fetched.
    assert set(re.findall(r"https?://[^\s\"'<>)]+", page)) == {"http://www.w3.org/1999/xhtml"}
    assert not re.search(r"@import|url\(|\bfetch\(|XMLHttpRequest|sendBeacon|new WebSocket",
                         page.replace(parsed.scripts["three"], ""))
    assert "default-src 'none'" in page and "connect-src 'none'" in page


def test_three_is_unmodified_and_its_notice_is_in_the_page() -> None:
    library = (ASSETS / "three.module.min.js").read_bytes()
    assert hashlib.sha256(library).hexdigest() in (ASSETS / "README.md").read_text()
    assert f'="{html.THREE_VERSION.split(".")[1]}"'.encode() in library[:400]
    page = html.page(perform(), "talk")
    assert _Elements(page).scripts["three"].strip() == library.decode().strip()
    assert (ASSETS / "three.LICENSE.txt").read_text().strip() in unescape(page)
    assert "three.js authors" in page.split("<script")[0], "the notice must be visible text, not script"


def test_motion_decodes_to_the_quaternions() -> None:
    performance = perform(fps=60.0)
    told = _data(html.page(performance, "talk"))
    steps = np.frombuffer(base64.b64decode(told["rotations"]), "<i2").reshape(told["frames"], len(CHARACTER), 4)
    decoded = rotation.normalise(steps / told["steps"])
    assert rotation.angle_between(decoded, performance.motion.rotations).max() < 2e-4
    root = np.frombuffer(base64.b64decode(told["root"]), "<f4").reshape(-1, 3)
    np.testing.assert_allclose(root, standing(performance.motion).root_positions[:1], atol=1e-6)
    np.testing.assert_allclose(told["blocks"]["edges"], performance.blocks.edges, atol=1e-5)
    assert told["fps"] == 60.0


def test_words_and_names_cannot_break_out() -> None:
    page = html.page(perform(), 'a "<img src=x>" & {{three}}')
    told = _data(page)
    assert told["words"][0][0] == "</script><b>"
    assert "<img" not in page
    assert "<title>a &quot;&lt;img src=x&gt;&quot; &amp; {{three}} " in page


def test_a_long_recording_is_one_page_with_fewer_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    performance = perform(fps=60.0)
    whole = _data(html.page(performance, "talk"))
    monkeypatch.setattr(html, "LONG", 2.0)
    assert write(tmp_path / "talk.html", performance) == tmp_path / "talk.html"
    assert [path.name for path in tmp_path.iterdir()] == ["talk.html"]
    told = _data((tmp_path / "talk.html").read_text())
    assert told["fps"] == 30.0 and told["duration"] == whole["duration"] and told["sound"] == whole["sound"]

    def poses(page: dict[str, Any]) -> np.ndarray:
        steps = np.frombuffer(base64.b64decode(page["rotations"]), "<i2").reshape(page["frames"], len(CHARACTER), 4)
        return rotation.normalise(steps / page["steps"])

    assert rotation.angle_between(poses(told), poses(whole)[::2]).max() < 2e-4, "every second frame, at its own time"


def test_a_name_of_bytes_that_are_no_text_is_written(tmp_path: Path) -> None:
    target = tmp_path / os.fsdecode(b"caf\xe9 \xc3\xa9.html")
    write(target, perform())
    assert "<title>caf\ufffd \u00e9 " in target.read_text(encoding="utf-8")


def test_the_page_tells_what_a_score_is() -> None:
    told = _data(html.page(replace(perform(), score_is="Q value"), "talk"))
    assert told["scoreIs"] == "Q value"


# ---------------------------------------------------------------- in a browser


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A headless Chromium; the test is skipped, with the reason, where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    names = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
    program = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, names)), None)
    if not program:
        pytest.skip("no chromium on this machine")
    with playwright.sync_playwright() as driver:
        window = driver.chromium.launch(executable_path=program, args=FLAGS)
        yield window
        window.close()


class _Opened:
    """A page in the browser, with what it complained about and what it asked for."""

    def __init__(self, browser: Any, path: Path) -> None:
        self.complaints: list[str] = []
        self.requests: list[str] = []
        self.page = browser.new_page(viewport={"width": 640, "height": 500}, reduced_motion="reduce")
        self.page.on("console", self._said)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.goto(path.as_uri())
        self.page.wait_for_selector("body[data-ready=true]", timeout=60_000)
        self.page.wait_for_function("() => preview.clock.audible", timeout=20_000)

    def _said(self, message: Any) -> None:
        if message.type == "error":
            self.complaints.append(message.text)

    def time(self) -> float:
        return float(self.page.get_attribute("#timeline", "aria-valuenow"))

    def settle(self, seconds: float, near: float = 0.02) -> None:
        self.page.wait_for_function("([t, d]) => Math.abs(Number(document.getElementById('timeline')"
                                    ".getAttribute('aria-valuenow')) - t) < d", arg=[seconds, near], timeout=20_000)

    def joints(self) -> list[float]:
        return self.page.evaluate("""() => {
            const figure = preview.stage.figure;
            figure.group.updateMatrixWorld(true);
            return figure.bones.map((bone) => [...bone.matrixWorld.elements.slice(12, 15)]);
        }""")


@pytest.fixture(scope="module")
def shown(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[_Opened]:
    page = _Opened(browser, write(tmp_path_factory.mktemp("preview") / "talk.html", perform(seconds=4.0)))
    yield page
    page.page.close()


@pytest.fixture
def opened(shown: _Opened) -> _Opened:
    """The page at the start of the recording, with nothing focused."""
    shown.page.evaluate("() => { document.activeElement.blur(); preview.clock.pause(); preview.clock.seek(0); }")
    shown.settle(0.0)
    return shown


def _drawn(page: _Opened, joint: str) -> int:
    """How many meshes hang on a bone."""
    bone = f"preview.stage.figure.bone('{joint}')"
    return int(page.page.evaluate(f"() => {bone}.children.filter((c) => c.isMesh).length"))


def test_fingers_are_drawn_where_the_motion_has_them(browser: Any, opened: _Opened, tmp_path: Path) -> None:
    performance = perform(skeleton=FINGERED)
    page = _Opened(browser, write(tmp_path / "fingers.html", performance))
    page.page.evaluate("() => preview.clock.seek(1.0)")
    page.settle(1.0)
    motion = standing(performance.motion)
    truth = kinematics.positions_of(motion)[25]
    assert np.abs(np.array(page.joints()) - truth).max() < 2e-3, "every finger is where the motion puts it"
    assert all(_drawn(page, joint) == 1 for joint in FINGER_JOINTS)
    # The other page has hands of one piece, with fingers that do not move: more of them than a wrist and a palm.
    assert _drawn(page, "LeftHand") == 7 and _drawn(opened, "LeftHand") == 0
    assert not page.complaints
    page.page.close()


def test_playing_moves_time_and_figure(opened: _Opened) -> None:
    assert opened.time() == 0
    before = np.array(opened.joints())
    opened.page.keyboard.press("Space")
    opened.page.wait_for_function("() => preview.clock.time > 0.6", timeout=20_000)
    opened.page.keyboard.press("Space")
    stopped = opened.page.evaluate("preview.clock.time")
    opened.settle(stopped)
    assert np.abs(np.array(opened.joints()) - before).max() > 0.01
    opened.page.wait_for_timeout(250)
    assert opened.page.evaluate("preview.clock.time") == stopped
    assert opened.complaints == []
    assert [url for url in opened.requests if not url.startswith(("file:", "data:", "blob:"))] == []
    assert len([url for url in opened.requests if url.startswith("file:")]) == 1


def test_dragging_on_the_timeline_sets_the_time(opened: _Opened) -> None:
    # A recording that fits shows whole: the middle of the timeline is the middle of the sound.
    box = opened.page.locator("#timeline").bounding_box()
    opened.page.mouse.move(box["x"] + 5, box["y"] + 60)
    opened.page.mouse.down()
    opened.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 60, steps=3)
    opened.page.mouse.up()
    opened.settle(2.0)
    assert opened.complaints == []


def test_figure_stands_where_kinematics_says(opened: _Opened) -> None:
    """The page's scene graph and our forward kinematics agree on every joint of a frame reached by the arrow keys."""
    motion = standing(perform(seconds=4.0).motion)
    for _ in range(10):
        opened.page.keyboard.press("ArrowRight")
    opened.settle(10 / motion.fps, near=0.003)
    assert "frame 10" in opened.page.inner_text("#clock")
    shown = np.array(opened.joints())
    told = kinematics.positions_of(motion)[10]
    np.testing.assert_allclose(shown, told, atol=4e-3)
    opened.page.keyboard.press("ArrowLeft")
    opened.settle(9 / motion.fps, near=0.003)


def test_buttons_and_keys(opened: _Opened) -> None:
    page = opened.page
    page.keyboard.press("End")
    opened.settle(4.0)
    page.keyboard.press("Home")
    opened.settle(0.0)
    page.click("[data-view=side]")
    page.wait_for_function("() => Math.abs(preview.stage.view.yaw - Math.PI / 2) < 0.01", timeout=20_000)
    page.click("#trails")
    assert page.get_attribute("#trails", "aria-pressed") == "false"
    page.select_option("#speed", "0.25")
    assert page.evaluate("preview.clock.sound.playbackRate") == 0.25
    unnamed = page.evaluate("() => [...document.querySelectorAll('button')].filter((b) => "
                            "!(b.getAttribute('aria-label') || b.textContent.trim())).length")
    assert unnamed == 0
    assert opened.complaints == []


def test_the_score_is_named_under_its_bars(opened: _Opened) -> None:
    assert opened.page.text_content("#score-is") == "score: log-probability"


def test_a_long_recordings_page_plays_from_the_disk(browser: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
                                                    ) -> None:
    monkeypatch.setattr(html, "LONG", 2.0)
    shown = _Opened(browser, write(tmp_path / "talk.html", perform(seconds=4.0)))
    shown.page.click("#play")
    shown.page.wait_for_function("() => preview.clock.time > 0.3", timeout=20_000)
    assert shown.complaints == []
    assert [url for url in shown.requests if not url.startswith(("file:", "data:", "blob:"))] == []
    shown.page.close()
