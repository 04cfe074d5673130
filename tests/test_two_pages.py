"""Two pages of one recording in one browser, a gesture that is stretched, and two takes over each other."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from browser import OpenedPage, chromium, opened_page
from test_story import _is, _rendered, _rotations, first, served  # noqa: F401

from gesticulator.serve.edits import LivePlans
from gesticulator.serve.page_server import PageServer

PICTURES = Path(os.environ["PICTURES"]) if "PICTURES" in os.environ else None


class _Window:
    """Pages of one window, which share its storage, as tabs do."""

    def __init__(self, browser: Any) -> None:
        self._context = browser.new_context(viewport={"width": 1100, "height": 720}, reduced_motion="reduce")

    def new_page(self, **_: Any) -> Any:
        return self._context.new_page()


def _has(page: OpenedPage, blocks: list[dict[str, Any]]) -> None:
    page.page.wait_for_function("(lexemes) => preview.session.plan.blocks.map((one) => one.lexeme).join() === lexemes",
                                arg=",".join(str(one["lexeme"]) for one in blocks), timeout=30_000)


def test_two_tabs_of_one_recording_agree(served: tuple[PageServer, LivePlans, Path]) -> None:  # noqa: F811
    server, plans, _ = served
    with chromium() as browser:
        window = _Window(browser)
        one, other = OpenedPage(window, server.url), OpenedPage(window, server.url)
        before = _rotations(other.page)
        one.go_to(2.1)
        other.go_to(4.9)
        one.page.keyboard.press("2")
        _rendered(one.page)
        # The other tab shows the edit, with its own playhead where it was, and plays the same frames.
        _has(other, one.plan()["blocks"])
        _rendered(other.page)
        np.testing.assert_array_equal(_rotations(other.page), _rotations(one.page))
        assert other.time() > 4.8
        # An edit there comes back here, on top of the first one.
        other.page.keyboard.press("3")
        _rendered(other.page)
        _has(one, other.plan()["blocks"])
        _rendered(one.page)
        _is(one.page, plans, one.plan())
        np.testing.assert_array_equal(_rotations(other.page), _rotations(one.page))
        # Each undoes, and both are back at the beginning.
        one.page.keyboard.press("Control+z")
        one.page.keyboard.press("Control+z")
        _rendered(one.page)
        _has(other, one.plan()["blocks"])
        _rendered(other.page)
        np.testing.assert_array_equal(_rotations(one.page), before)
        np.testing.assert_array_equal(_rotations(other.page), before)
        # A tab that is closed, and a reload, lose nothing.
        other.page.keyboard.press("2")
        _rendered(other.page)
        edited = other.plan()["blocks"]
        _has(one, edited)
        other.page.close()
        one.page.reload()
        one.page.wait_for_function("() => document.body.dataset.ready === 'true'")
        _has(one, edited)
        one.check_quiet(server.url)


def test_the_height_of_the_hands_is_a_slider_and_a_curve(
        served: tuple[PageServer, LivePlans, Path]) -> None:  # noqa: F811
    server, plans, folder = served
    with opened_page(server.url, 1280, 900) as opened:
        page = opened.page
        before = _rotations(page)
        assert page.locator("#hand-height-is").inner_text() == "free" and page.locator("#hands-free").is_hidden()
        page.focus("#hand-height")
        page.keyboard.press("End")
        _rendered(page)
        (curve,) = opened.plan()["curves"]
        assert curve["knob"] == "height" and curve["times"] == [0] and curve["values"][0] > 0.3
        assert page.locator("#hand-height-is").inner_text() == f"{curve['values'][0]:.2f}"
        _is(page, plans, opened.plan())
        # As a curve on the timeline: a second point, lower and later.
        page.select_option("#curve-knob", "height")
        box = page.locator("#timeline").bounding_box()
        row = page.evaluate("() => preview.timeline.rows.curve")
        x = page.evaluate("() => preview.timeline.x(4)")
        page.mouse.click(box["x"] + x, box["y"] + row["top"] + row["tall"] - 8)
        _rendered(page)
        (curve,) = opened.plan()["curves"]
        assert len(curve["times"]) == 2 and curve["values"][1] < 0.1
        assert page.locator("#hand-height-is").inner_text() == "curve"
        _is(page, plans, opened.plan())
        page.screenshot(path=(PICTURES or folder) / "curve.png")
        page.click("#hands-free")
        _rendered(page)
        assert "curves" not in opened.plan()
        np.testing.assert_array_equal(_rotations(page), before)
        opened.check_quiet(server.url)


def test_activity_and_energy_are_curves_too(
        served: tuple[PageServer, LivePlans, Path]) -> None:  # noqa: F811
    server, plans, _ = served
    with opened_page(server.url, 1280, 900) as opened:
        page = opened.page
        before = _rotations(page)
        assert page.locator("#curve-knob option").all_inner_texts()[:3] == ["size", "activity", "energy"]
        for knob, most in (("activity", 1), ("energy", 2)):
            page.select_option("#curve-knob", knob)
            box = page.locator("#timeline").bounding_box()
            row = page.evaluate("() => preview.timeline.rows.curve")
            for second, share in ((2, 0), (3, 1)):  # at the top of the row, then at its foot
                x = page.evaluate("(at) => preview.timeline.x(at)", second)
                page.mouse.click(box["x"] + x, box["y"] + row["top"] + 3 + share * (row["tall"] - 6))
                _rendered(page)
            curve = opened.plan()["curves"][-1]
            assert curve["knob"] == knob and curve["values"] == [most, 0]
            _is(page, plans, opened.plan())
        now = _rotations(page)
        assert (now[-60:] != before[-60:]).any()
        opened.check_quiet(server.url)


def test_a_gesture_is_stretched_and_the_take_before_is_seen_through(
        served: tuple[PageServer, LivePlans, Path]) -> None:  # noqa: F811
    server, plans, folder = served
    with opened_page(server.url, 1280, 800) as opened:
        page = opened.page
        opened.go_to(2.1)
        page.keyboard.press("y")
        page.wait_for_function("() => preview.stage.performers.length === 2")
        places = page.evaluate("() => preview.stage.performers.map((one) => one.group.position.toArray())")
        assert places[0] == places[1]
        solid = page.evaluate("() => preview.stage.performers.map((one) => one.figure.materials.shirt.opacity)")
        assert solid[0] == 1 and 0.2 < solid[1] < 0.6
        # Four blocks are selected, and the edge of the selection is dragged: all are longer by the same share.
        before = opened.plan()["blocks"]
        page.evaluate("() => preview.session.select(4, 7)")
        box = page.locator("#timeline").bounding_box()
        x, row = page.evaluate("""() => [preview.timeline.x(preview.session.plan.blocks[7].end),
            preview.timeline.rows.blocks.top + preview.timeline.rows.blocks.tall / 2]""")
        page.mouse.move(box["x"] + x, box["y"] + row)
        page.mouse.down()
        page.mouse.move(box["x"] + x + 42, box["y"] + row, steps=4)
        page.mouse.up()
        _rendered(page)
        after = opened.plan()["blocks"]
        assert len(after) == len(before) and after[3] == before[3]
        assert [one["start"] for one in after[9:]] == [one["start"] for one in before[9:]]
        shares = [(now["end"] - now["start"]) / (was["end"] - was["start"])
                  for now, was in zip(after[4:8], before[4:8], strict=True)]
        assert shares[0] > 1.05 and max(shares) - min(shares) < 0.02
        assert after[8]["start"] == after[7]["end"] > before[7]["end"]
        _is(page, plans, opened.plan())
        opened.go_to(2.75)
        page.screenshot(path=(PICTURES or folder) / "ghost.png")
        # It gives way no further than blocks may; the keys do the same; one undo takes the whole drag back.
        for _ in range(40):
            page.keyboard.press(".")
        _rendered(page)
        lengths = [one["end"] - one["start"] for one in opened.plan()["blocks"]]
        assert min(lengths) >= 0.1 - 1e-6 and max(lengths) <= 1.0 + 1e-6
        page.keyboard.press("Control+z")
        page.keyboard.press("Control+z")
        _rendered(page)
        assert [one["end"] for one in opened.plan()["blocks"]] == [one["end"] for one in before]
        page.keyboard.press("d")
        page.wait_for_function("() => preview.stage.performers[0].group.position.x < -0.5")
        assert page.evaluate("() => preview.stage.performers[1].figure.materials.shirt.opacity") == 1
        page.keyboard.press("d")
        page.wait_for_function("() => preview.stage.performers.length === 1")
        opened.check_quiet(server.url)
