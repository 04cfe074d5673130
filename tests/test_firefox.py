"""The editor's session in Firefox: the same page, with real clicks, drags and keys."""

from __future__ import annotations

import base64
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from firefox import FirefoxPage, firefox
from test_story import first, served  # noqa: F401

from gesticulator.export import html
from gesticulator.plan.plan_file import parse_plan
from gesticulator.serve.edits import LivePlans
from gesticulator.serve.page_server import PageServer

PICTURES = Path(os.environ["PICTURES"]) if "PICTURES" in os.environ else None


def _rendered(page: FirefoxPage) -> None:
    page.wait("preview.session.plan === preview.session.lane.rendered && "
              "document.getElementById('status').dataset.state === 'same'")


def _rotations(page: FirefoxPage) -> Any:
    text = page.evaluate("""(() => {
        const r = Int16Array.from(preview.session.take.rotations, (v) => Math.round(v * 32767));
        let s = ""; for (const b of new Uint8Array(r.buffer)) s += String.fromCharCode(b); return btoa(s); })()""")
    return np.frombuffer(base64.b64decode(text), "<i2")


def _plan(page: FirefoxPage) -> dict[str, Any]:
    return dict(page.evaluate("preview.session.plan"))


def _is(page: FirefoxPage, plans: LivePlans) -> None:
    made = html.describe_motion(plans.render(parse_plan(json.dumps(_plan(page)))).scene())
    np.testing.assert_array_equal(_rotations(page), np.frombuffer(base64.b64decode(made["rotations"]), "<i2"))


def test_the_page_is_edited_in_firefox(served: tuple[PageServer, LivePlans, Path]) -> None:  # noqa: F811
    server, plans, folder = served
    with firefox() as page:
        page.open(server.url, 1280, 800)
        page.evaluate("preview.clock.seek(3.004)")
        page.wait("Math.abs(Number(document.getElementById('timeline').getAttribute('aria-valuenow')) - 3.004) < 0.02")
        drawn = page.evaluate("preview.stage !== null")
        before = _rotations(page)
        # A lexeme by key, and a beat dragged.
        page.press("2")
        _rendered(page)
        assert _plan(page)["blocks"][8]["lexeme"] == _plan(page)["blocks"][8]["alternatives"][1]["lexeme"]
        left, top, x, y = page.evaluate("""(() => {
            const { timeline } = preview, b = timeline.canvas.getBoundingClientRect();
            return [b.x, b.y, timeline.x(preview.session.plan.blocks[10].start),
                timeline.rows.beats.top + timeline.rows.beats.tall / 2]; })()""")
        page.drag((left + x, top + y), (left + x + 6, top + y), (left + x + 10, top + y))
        _rendered(page)
        assert _plan(page)["blocks"][9]["flag"] == "edited"
        _is(page, plans)
        # The palette: searched, tried, taken.
        page.press("p")
        page.wait("document.querySelectorAll('#palette-figures li').length > 250")
        for letter in "far":
            page.press(letter)
        page.wait("document.querySelectorAll('#palette-figures li:not([hidden])').length < 150")
        page.click("#palette-figures li:not([hidden]) .figure[aria-pressed='false']")
        _rendered(page)
        _is(page, plans)
        page.click("#palette-close")
        assert page.evaluate("document.getElementById('stage-message').hidden") == drawn, "without WebGL it says so"
        if drawn:  # Firefox needs a screen and a driver for WebGL, such as Xvfb and Mesa
            # A hand is pinned.
            page.press("f")
            page.press("g")
            page.wait("document.querySelector('.handle').getBoundingClientRect().width > 0")
            at = page.middle('.handle[data-joint="LeftHand"]')
            page.drag(at, (at[0] + 10, at[1] - 20), (at[0] + 20, at[1] - 45))
            _rendered(page)
            assert [one["joint"] for one in _plan(page)["pins"]] == ["LeftHand"]
            _is(page, plans)
        page.screenshot((PICTURES or folder) / "firefox.png")
        # It is there again after the page was loaded anew; all is undone with keys.
        edited = _plan(page)["blocks"]
        page.wait("Object.keys(localStorage).some((key) => key.startsWith('gesticulator edits'))")
        page.open(server.url, 1280, 800)
        _rendered(page)
        assert [one["lexeme"] for one in _plan(page)["blocks"]] == [one["lexeme"] for one in edited]
        page.press("Control", "z")
        _rendered(page)
        np.testing.assert_array_equal(_rotations(page), before)
        assert [one for one in page.complaints if "WebGL" not in one] == []
