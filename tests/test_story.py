"""An editor's session in a real browser: look, try, take, drag, search, undo, close the page and go on."""

from __future__ import annotations

import base64
import json
import os
import threading
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
from browser import OpenedPage, chromium

from data_module.types import Speech
from gesticulator import Gesticulator
from gesticulator.directing.moving_figures import moving_figures
from gesticulator.export import html
from gesticulator.performance import Performance
from gesticulator.plan.plan_file import parse_plan, read_plan
from gesticulator.serve.edits import LivePlans, directions_of, levels_of
from gesticulator.serve.page_server import PageServer
from gesticulator.serve.saved_edits import SavedEdits

PICTURES = Path(os.environ["PICTURES"]) if "PICTURES" in os.environ else None
"""The folder to keep the pictures in; those of docs/viewer.md are made so."""
SPEECH = Path(__file__).resolve().parent.parent / "examples" / "speech.flac"


@pytest.fixture(scope="module")
def first() -> tuple[Gesticulator, Performance]:
    samples, rate = soundfile.read(SPEECH, frames=6 * 16000, dtype="float32")
    system = Gesticulator.from_pretrained()
    system.keeps_drawings = True
    return system, system(Speech(samples, rate), seed=1).labelled("talk.wav")


@pytest.fixture
def served(first: tuple[Gesticulator, Performance], tmp_path: Path) -> Iterator[tuple[PageServer, LivePlans, Path]]:
    system, performance = first
    server, plans = PageServer(), LivePlans(system, performance)
    scene = performance.scene()
    number = plans.opened(performance, html.describe(scene)["plan"])
    live = {"token": server.token, "renderings": [number], "levels": levels_of(system.bundle),
            "directions": directions_of(system)}
    server.page = html.page({"lstm": scene}, "talk", more={"live": live}).encode()
    saved = server.saved = SavedEdits(tmp_path / "talk.edits.plan.json", after=0.1)
    plans.on_edit = lambda request, plan: None if request.get("trial") else saved.keep(lambda: plan)
    server.render = plans.answer
    server.figures = cache(lambda: json.dumps(moving_figures(system.bundle, 0)).encode())
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    yield server, plans, tmp_path
    server.shutdown()
    server.server_close()
    thread.join(10)


def _rotations(page: Any) -> np.ndarray:
    """The frames that are shown, as the numbers that were sent."""
    text = page.evaluate("""() => {
        const r = Int16Array.from(preview.session.take.rotations, (v) => Math.round(v * 32767));
        let s = ""; for (const b of new Uint8Array(r.buffer)) s += String.fromCharCode(b); return btoa(s); }""")
    return np.frombuffer(base64.b64decode(text), "<i2")


def _rendered(page: Any) -> None:
    page.wait_for_function("() => preview.session.plan === preview.session.lane.rendered && "
                           "document.getElementById('status').dataset.state === 'same'", timeout=60_000)


def _is(page: Any, plans: LivePlans, plan: dict[str, Any]) -> None:
    made = html.describe_motion(plans.render(parse_plan(json.dumps(plan))).scene())
    np.testing.assert_array_equal(_rotations(page), np.frombuffer(base64.b64decode(made["rotations"]), "<i2"))


def test_gestures_are_seen_tried_taken_dragged_and_there_again_tomorrow(
        served: tuple[PageServer, LivePlans, Path]) -> None:
    server, plans, folder = served
    with chromium() as browser:
        opened = OpenedPage(browser, server.url, 1280, 800)
        page = opened.page
        opened.go_to(2.0)
        first = _rotations(page)
        # Look: the palette opens with the keyboard, and its figures can be searched and filtered.
        page.keyboard.press("p")
        page.wait_for_selector("#palette-figures li", timeout=60_000)
        assert page.locator("#palette-figures li:not([hidden])").count() > 250
        playing = page.evaluate("() => preview.session.plan.blocks[preview.inspector.stretch[0]].lexeme")
        assert page.locator('#palette .figure[aria-pressed="true"]').inner_text().startswith(f"{playing} ·")
        page.keyboard.type("both hands")
        page.select_option("#palette-size", "far")
        few = page.locator("#palette-figures li:not([hidden])")
        assert 0 < few.count() < 150
        names = few.locator(".called").all_inner_texts()
        assert all("both hands" in name or ("right hand" in name and "left hand" in name) for name in names)
        # Try: hovering plays it in its place, and leaving takes it back.
        block = page.evaluate("() => preview.inspector.stretch[0]")
        choice = few.locator('.figure[aria-pressed="false"]').first
        lexeme = int(choice.locator(".called").inner_text().split(" ·")[0])
        choice.hover()
        page.wait_for_function("() => document.getElementById('status').textContent.startsWith('a try')",
                               timeout=60_000)
        assert (_rotations(page) != first).any()
        assert opened.plan()["blocks"][block]["lexeme"] == playing, "nothing is taken"
        page.screenshot(path=PICTURES / "palette.png" if PICTURES else folder / "palette.png")
        page.mouse.move(700, 300)
        page.wait_for_function("() => !document.getElementById('status').textContent.startsWith('a try')")
        np.testing.assert_array_equal(_rotations(page), first)
        # Take it; drag another one onto a later moment; a shrug at the playhead; a favourite.
        choice.click()
        _rendered(page)
        assert opened.plan()["blocks"][block]["lexeme"] == lexeme
        _is(page, plans, opened.plan())
        other = few.locator('.figure[aria-pressed="false"]').nth(1)
        dragged = int(other.locator(".called").inner_text().split(" ·")[0])
        box = page.locator("#timeline").bounding_box()
        other.drag_to(page.locator("#timeline"), target_position={"x": box["width"] * 0.8, "y": 60})
        _rendered(page)
        at = page.evaluate("() => preview.session.plan.blocks.findIndex((b) => b.end > preview.clock.time)")
        assert opened.plan()["blocks"][at]["lexeme"] == dragged and at != block
        page.select_option("#palette-size", "")
        page.fill("#palette-search", "shrug")
        page.select_option("#palette-kind", "gesture")
        page.locator("#palette-figures li:not([hidden]) .star").first.click()
        page.locator("#palette-figures li:not([hidden]) .figure").first.click()
        _rendered(page)
        assert opened.plan()["cues"][0]["gesture"].startswith("shrug")
        page.fill("#palette-search", "")
        page.click("#palette-favourites")
        assert page.locator("#palette-figures li:not([hidden])").count() == 1
        page.click("#palette-close")
        _is(page, plans, opened.plan())
        # Undo with the keyboard, and again.
        edited = opened.plan()
        for _ in range(3):
            page.keyboard.press("Control+z")
        _rendered(page)
        np.testing.assert_array_equal(_rotations(page), first)
        for _ in range(3):
            page.keyboard.press("Control+Shift+z")
        _rendered(page)
        assert opened.plan()["cues"] == edited["cues"]
        # The page is loaded again, and goes on; the plan file beside the sound has it too.
        page.wait_for_timeout(600)
        page.reload()
        page.wait_for_function("() => document.body.dataset.ready === 'true'")
        _rendered(page)
        assert opened.plan()["blocks"][block]["lexeme"] == lexeme
        _is(page, plans, opened.plan())
        server.saved.save()  # type: ignore[union-attr]
        assert read_plan(folder / "talk.edits.plan.json").blocks[block].lexeme == lexeme
        opened.check_quiet(server.url)
