"""Pose pins in a real browser: a hand is dragged to a place, by mouse and by keys, held, refused, undone."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from browser import opened_page
from test_story import _is, _rendered, _rotations, first, served  # noqa: F401

from gesticulator.serve.edits import LivePlans
from gesticulator.serve.page_server import PageServer

PICTURES = Path(os.environ["PICTURES"]) if "PICTURES" in os.environ else None


def _middle(page: Any, selector: str) -> tuple[float, float]:
    box = page.locator(selector).bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def _drag(page: Any, joint: str, right: float, down: float, release: bool = True) -> None:
    x, y = _middle(page, f'.handle[data-joint="{joint}"]')
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + right / 2, y + down / 2)
    page.mouse.move(x + right, y + down)
    if release:
        page.mouse.up()


def test_hands_and_head_are_pinned_by_mouse_and_keys(
        served: tuple[PageServer, LivePlans, Path]) -> None:  # noqa: F811
    server, plans, folder = served
    with opened_page(server.url, 1280, 800) as opened:
        page = opened.page
        page.keyboard.press("f")
        opened.go_to(3.004)
        first = _rotations(page)
        assert page.locator("#handles").is_hidden()
        page.keyboard.press("g")
        page.wait_for_selector(".handle", state="visible")
        names = list(page.evaluate("() => preview.session.take.skeleton.names"))
        before = opened.joints()[names.index("LeftHand")]
        # The handles stand on the joints; the arm follows the pointer before anything is rendered.
        _drag(page, "LeftHand", 30, -70, release=False)
        page.wait_for_function("(y) => preview.stage.performers[0].figure.bone('LeftHand').matrixWorld.elements[13] > "
                               "y + 0.1", arg=before[1])
        shown = opened.joints()[names.index("LeftHand")]
        page.screenshot(path=(PICTURES or folder) / "pose_drag.png")
        page.mouse.up()
        _rendered(page)
        (pin,) = opened.plan()["pins"]
        assert pin["joint"] == "LeftHand" and abs(pin["time"] - 3.0) < 1e-3
        page.evaluate("() => preview.stage.draw(3.0)")  # until the next frame it is where the pointer had it
        np.testing.assert_allclose(opened.joints()[names.index("LeftHand")], pin["position"], atol=3e-3)
        np.testing.assert_allclose(shown, pin["position"], atol=5e-3)
        assert pin["position"][1] > before[1] + 0.1 and pin["position"][0] > before[0]
        changed = np.flatnonzero((_rotations(page) != first).reshape(-1, len(names) * 4).any(axis=1))
        assert changed[0] > 2.4 * 60 - 1 and changed[-1] < 3.6 * 60 + 1, "local"
        _is(page, plans, opened.plan())
        if PICTURES:
            page.evaluate("() => document.getElementById('inspector').scrollTo(0, 500)")
        page.screenshot(path=(PICTURES or folder) / "pose.png")
        # It holds for a while; the head by keys; another drag moves the same pin.
        page.fill("#pins input", "0.5")
        page.keyboard.press("Enter")
        _rendered(page)
        assert opened.plan()["pins"][0]["hold"] == 0.5
        opened.go_to(3.3)
        page.focus('.handle[data-joint="Head"]')
        for key in ("ArrowRight", "ArrowRight", "PageDown"):
            page.keyboard.press(key)
        _rendered(page)
        assert [one["joint"] for one in opened.plan()["pins"]] == ["LeftHand", "Head"]
        _drag(page, "LeftHand", -25, 0)
        _rendered(page)
        assert [one["joint"] for one in opened.plan()["pins"]] == ["LeftHand", "Head"]
        _is(page, plans, opened.plan())
        page.screenshot(path=(PICTURES or folder) / "pose_held.png")
        # On the timeline the head's pin goes to another moment.
        box = page.locator("#timeline").bounding_box()
        row = page.evaluate("() => preview.timeline.rows.pins.top + preview.timeline.rows.pins.tall / 2")
        x = page.evaluate("() => preview.timeline.x(preview.session.plan.pins[1].time)")
        page.mouse.move(box["x"] + x, box["y"] + row)
        page.mouse.down()
        page.mouse.move(box["x"] + x + 60, box["y"] + row, steps=3)
        page.mouse.up()
        _rendered(page)
        assert [one["joint"] for one in opened.plan()["pins"]] == ["LeftHand", "Head"]
        assert opened.plan()["pins"][0]["time"] < 3.01 and opened.plan()["pins"][1]["time"] > 3.4
        _is(page, plans, opened.plan())
        # Too far, and inside the body: a line, and nothing changes.
        kept = opened.plan()["pins"]
        _drag(page, "RightHand", -300, -100)
        page.wait_for_function("() => document.getElementById('notice').textContent.includes('The right arm reaches')")
        assert opened.plan()["pins"] == kept
        page.click("#notice")
        page.evaluate("""() => { const { session, pins } = preview, { plan } = session;
            pins.last = null;
            session.edit({ ...plan, pins: [...plan.pins, { time: 1, joint: "RightHand", position: [0, 1.2, -0.02] }] });
            pins.last = session.plan; }""")
        page.wait_for_function("() => document.getElementById('notice').textContent.includes('inside the body')",
                               timeout=60_000)
        _rendered(page)
        assert opened.plan()["pins"] == kept
        page.click("#notice")
        # Away with one from the list, undo with the keyboard, back to the beginning.
        page.locator("#pins li").first.get_by_role("button", name="Remove").click()
        _rendered(page)
        assert [one["joint"] for one in opened.plan()["pins"]] == ["Head"]
        while page.locator("#undo").is_enabled():
            page.click("#undo")
        _rendered(page)
        assert not opened.plan().get("pins")
        np.testing.assert_array_equal(_rotations(page), first)
        page.keyboard.press("g")
        assert page.locator("#handles").is_hidden()
        assert [one for one in opened.complaints if "400" not in one] == []
