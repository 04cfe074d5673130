"""Directions of the whole take in a real browser: performer, interpreter, variation and legs; what is seen while all of
it is drawn; and the page on a telephone that lies on its side."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import OpenedPage, chromium, opened_page
from test_story import _is, _rendered, _rotations, first, served  # noqa: F401

from gesticulator.serve.edits import LivePlans
from gesticulator.serve.page_server import PageServer

PICTURES = Path(os.environ["PICTURES"]) if "PICTURES" in os.environ else None


def _lexemes(opened: OpenedPage) -> list[int]:
    return [block["lexeme"] for block in opened.plan()["blocks"]]


def test_performer_interpreter_variation_and_legs_are_chosen_undone_and_kept(
        served: tuple[PageServer, LivePlans, Path]) -> None:  # noqa: F811
    server, plans, folder = served
    with opened_page(server.url, 1280, 900) as opened:
        page = opened.page
        opened.go_to(2.0)
        before, lexemes, speaker = _rotations(page), _lexemes(opened), page.input_value("#direction-speaker")
        assert speaker == opened.plan()["speaker"] and page.input_value("#direction-interpreter") == "lstm"

        def choose(what: str, value: str) -> None:
            page.select_option(f"#direction-{what}", value)
            _rendered(page)
            _is(page, plans, opened.plan())

        choose("speaker", "garza")
        assert (_rotations(page) != before).any() and _lexemes(opened) == lexemes
        choose("variation", "3")
        assert opened.plan()["variation"] == 3 and _lexemes(opened) == lexemes
        choose("interpreter", "statistical")
        assert _lexemes(opened) != lexemes
        choose("legs", "standing")
        assert "LeftFoot" in page.evaluate("() => preview.session.take.skeleton.names")
        page.screenshot(path=(PICTURES or folder) / "directions.png")
        directed = opened.plan()
        # The page is loaded again, and goes on.
        page.wait_for_timeout(600)
        page.reload()
        page.wait_for_function("() => document.body.dataset.ready === 'true'")
        _rendered(page)
        assert opened.plan()["blocks"] == directed["blocks"]
        assert [page.input_value(f"#direction-{what}") for what in ("speaker", "variation", "interpreter", "legs")] == [
            "garza", "3", "statistical", "standing"]
        choose("legs", "")
        choose("interpreter", "lstm")
        choose("variation", "0")
        choose("speaker", speaker)
        assert "LeftFoot" not in page.evaluate("() => preview.session.take.skeleton.names")
        for _ in range(5):
            page.keyboard.press("Control+z")
        _rendered(page)
        assert _lexemes(opened) == lexemes
        np.testing.assert_array_equal(_rotations(page), before)
        opened.check_quiet(server.url)


def test_the_visible_stretch_is_seen_first_and_the_rest_as_it_is_drawn(
        served: tuple[PageServer, LivePlans, Path], monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: F811
    monkeypatch.setattr("gesticulator.serve.edits.FIRST_SHOWN", 2)
    monkeypatch.setattr("gesticulator.serve.edits.STRETCH", 3)
    server, plans, _ = served
    with opened_page(server.url, 1280, 800) as opened:
        page = opened.page
        opened.go_to(3.0)
        for _ in range(10):  # as near as it goes
            page.keyboard.press("+")
        left, span = page.evaluate("() => [preview.timeline.left, preview.timeline.span]")
        assert span < 3.0
        page.evaluate("""() => {
            const before = preview.session.take.rotations, size = preview.session.take.joints * 4;
            window.seen = [];
            preview.session.on("takes", () => {
                const now = preview.session.take.rotations, changed = [];
                for (let t = 0; t < now.length / size; t++) {
                    const there = now.subarray(t * size, (t + 1) * size);
                    if (there.some((value, k) => value !== before[t * size + k])) changed.push(t);
                }
                seen.push([changed[0] / 60, changed.at(-1) / 60, changed.length]);
            });
        }""")
        page.focus("#knob-intensity")
        page.keyboard.press("End")
        _rendered(page)
        seen: list[Any] = page.evaluate("() => window.seen")
        assert len(seen) >= 4, "in stretches"
        assert left - 1.0 < seen[0][0] and seen[0][1] < left + span + 1.0, "the visible one first"
        counts = [count for _, _, count in seen]
        assert counts == sorted(counts) and counts[0] < counts[-1] * 0.7
        _is(page, plans, opened.plan())
        # Each press of a key ends the drawing of the one before; the last one is what stays.
        for _ in range(6):
            page.keyboard.press("ArrowLeft")
        _rendered(page)
        assert opened.plan()["knobs"]["intensity"] == pytest.approx(1.4)
        _is(page, plans, opened.plan())
        opened.check_quiet(server.url)


def test_a_telephone_on_its_side_shows_the_figure_the_timeline_and_the_panel(
        served: tuple[PageServer, LivePlans, Path]) -> None:  # noqa: F811
    server, _, folder = served
    with chromium() as browser:
        opened = OpenedPage(browser, server.url, 844, 390, has_touch=True, is_mobile=True, device_scale_factor=2)
        page = opened.page
        opened.go_to(2.0)
        page.screenshot(path=(PICTURES or folder) / "sideways.png")
        stage, desk = page.locator("#figure").bounding_box(), page.locator("#timeline").bounding_box()
        assert stage["height"] > 120 and stage["width"] > 300, "the figure has room"
        buttons = page.evaluate("""() => [...document.querySelectorAll(".views button")].filter(
            (one) => one.getClientRects().length).map((one) => one.getBoundingClientRect().toJSON())""")
        middle = stage["x"] + stage["width"] / 2
        assert all(box["right"] < middle - 40 for box in buttons), "no head is hidden"
        assert all(box["bottom"] <= stage["y"] + stage["height"] for box in buttons)
        assert desk["width"] > 400 and desk["y"] + 60 < 390, "so has the timeline"
        assert page.evaluate("() => document.documentElement.scrollWidth") <= 844
        # It plays by a tap, and a block is silenced in the panel.
        page.tap("#play")
        page.wait_for_function("() => preview.clock.playing")
        page.tap("#play")
        page.wait_for_function("() => !preview.clock.playing")  # a tap can come in after `tap` has returned
        opened.go_to(2.2)
        at = page.evaluate("() => preview.inspector.stretch[0]")
        page.tap("#silence")
        _rendered(page)
        assert opened.plan()["blocks"][at]["silent"]
        page.screenshot(path=(PICTURES or folder) / "sideways_panel.png")
        opened.check_quiet(server.url)
