"""Gestures that are dragged along the timeline or moved with keys, and the palette."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from browser import PATIENCE, opened_page
from performances import example
from test_story import _is, _rendered, _rotations

from gesticulator import Gesticulator
from gesticulator.export import html
from gesticulator.page.palette import moving_figures
from gesticulator.page.server import PageServer
from gesticulator.page.session import EditSession, levels_of


@pytest.fixture(scope="module")
def served(system: Gesticulator) -> Iterator[tuple[PageServer, EditSession]]:
    """The page of six seconds of the example, with its renderer."""
    system.keeps_generations = True
    performance = system(example(6.0), seed=1)
    server, session = PageServer(), EditSession(system, performance)
    live = {"token": server.token, "renderings": [session.opened(performance)],
            "levels": levels_of(system.bundle), "speakers": list(system.bundle.speakers)}
    server.page = html.page({"lstm": performance.scene()}, "talk", more={"live": live}).encode()
    server.render = session.answer
    server.figures = lambda: json.dumps(moving_figures(system.bundle, 0)).encode()
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    yield server, session
    server.shutdown()
    server.server_close()
    thread.join(10)


def _at(page: Any, seconds: float, row: str) -> tuple[float, float]:
    """The place of a time in a row of the timeline."""
    box = page.locator("#timeline").bounding_box()
    x, y = page.evaluate("([at, row]) => [preview.timeline.x(at), preview.timeline.rows[row].top + "
                         "preview.timeline.rows[row].tall / 2]", [seconds, row])
    return box["x"] + x, box["y"] + y


def _drag(page: Any, begin: tuple[float, float], right: float) -> None:
    page.mouse.move(*begin)
    page.mouse.down()
    page.mouse.move(begin[0] + right / 2, begin[1])
    page.mouse.move(begin[0] + right, begin[1])
    page.mouse.up()


def _gestures(blocks: list[dict[str, Any]], begin: int, end: int) -> list[tuple[int, bool]]:
    return [(one["lexeme"], one["silent"]) for one in blocks[begin:end + 1]]


def test_a_gesture_is_dragged_to_another_beat_copied_slid_and_moved_with_keys(
        served: tuple[PageServer, EditSession]) -> None:
    server, plans = served
    with opened_page(server.url, 1280, 860) as opened:
        page = opened.page
        opened.go_to(1.0)
        before, frames = opened.plan()["blocks"], _rotations(page)
        # With keys: the gesture at the playhead is selected, and made longer or shorter by a block.
        unit = opened.plan()["units"][0]
        page.keyboard.press("u")
        begin, end = page.evaluate("() => preview.session.selection")
        assert before[begin]["end"] > unit["start"] and before[end]["end"] >= unit["end"] - 1e-2
        strokes = []
        for _ in range(2):
            page.keyboard.press("j")
            strokes.append(page.evaluate("() => preview.session.selection"))
        assert begin <= strokes[0][0] < strokes[1][0] <= end and strokes[0][1] < end, "its phrases, one by one"
        page.evaluate("() => preview.session.select(5, 6)")
        page.keyboard.press("Control+Shift+ArrowRight")
        assert page.evaluate("() => preview.session.selection") == [5, 7]
        page.keyboard.press("Control+Shift+ArrowLeft")
        assert page.evaluate("() => preview.session.selection") == [5, 6]
        # A click selects a phrase, a second one its unit. It is dragged to the beat two blocks later, and leaves rest.
        page.keyboard.press("Escape")
        stroke = next(one for one in unit["phases"] if one["kind"] == "stroke" and one["start"] > 1.0)
        handle = _at(page, (stroke["start"] + stroke["end"]) / 2, "units")
        whole = [begin, end]
        page.mouse.click(*handle)
        begin, end = page.evaluate("() => preview.session.selection")
        assert whole[0] <= begin and end <= whole[1] and end - begin < 8, "a phrase"
        page.mouse.click(*handle)
        assert page.evaluate("() => preview.session.selection") == whole
        page.mouse.click(*handle)
        wanted, count = _gestures(before, begin, end), end - begin + 1
        place = begin + 2 if end + 2 < len(before) else begin - 2
        scale = page.evaluate("() => preview.timeline.scale")
        far = (before[place]["start"] - before[begin]["start"]) * scale
        _drag(page, handle, far + 2)
        _rendered(page)
        after = opened.plan()["blocks"]
        assert _gestures(after, place, place + count - 1) == wanted
        left = {*range(begin, end + 1)} - {*range(place, place + count)}
        assert left and all(after[at]["silent"] for at in left)
        assert page.evaluate("() => preview.session.selection") == [place, place + count - 1]
        _is(page, plans, opened.plan())
        page.keyboard.press("Control+z")
        _rendered(page)
        np.testing.assert_array_equal(_rotations(page), frames)
        # What cannot be moved says why.
        page.keyboard.press("Control+a")
        _drag(page, handle, far + 2)
        assert "nowhere to move it" in page.inner_text("#notice") and opened.plan()["blocks"] == before
        # By less than half of a block it slides, and its neighbours give way.
        page.evaluate("([a, b]) => preview.session.select(a, b)", [5, 6])
        page.keyboard.press("Control+ArrowRight")
        _rendered(page)
        moved = opened.plan()["blocks"]
        assert _gestures(moved, 6, 7) == _gestures(before, 5, 6) and moved[5]["silent"]
        page.keyboard.press("Control+z")
        page.evaluate("""() => { const { session } = preview; session.select(5, 6); }""")
        page.keyboard.press("Control+.")
        _rendered(page)
        slid = opened.plan()["blocks"]
        assert slid[5]["start"] == pytest.approx(before[5]["start"] + 1 / 60, abs=2e-3)
        assert slid[4]["end"] == slid[5]["start"] and slid[5]["end"] == before[5]["end"]
        _is(page, plans, opened.plan())
        opened.check_quiet(server.url)


def test_what_plays_stands_among_the_scores_is_found_by_words_and_varied(
        served: tuple[PageServer, EditSession]) -> None:
    server, plans = served
    with opened_page(server.url, 1280, 900) as opened:
        page = opened.page
        page.set_default_timeout(PATIENCE)
        blocks, frames = opened.plan()["blocks"], _rotations(page)
        at = next(k for k, one in enumerate(blocks) if not one["silent"] and one["rank"] > 5)
        opened.go_to((blocks[at]["start"] + blocks[at]["end"]) / 2)
        playing = page.locator('#best button[aria-pressed="true"]')
        assert page.locator("#best li").count() == 6
        assert playing.locator(".id").inner_text() == str(blocks[at]["lexeme"])
        assert float(playing.locator(".value").inner_text()) == pytest.approx(blocks[at]["score"], rel=5e-3)
        page.keyboard.press("p")
        page.wait_for_selector("#palette-figures li")
        marked = page.locator('#palette .figure[aria-pressed="true"]')
        assert marked.locator(".value").inner_text().startswith(f"{blocks[at]['rank']}. ")
        page.fill("#palette-search", "both hands open")
        few = page.locator("#palette-figures li:not([hidden]) .called")
        found = few.all_inner_texts()
        assert {"shrug", "cut off"} <= set(found) and any(" · " in name for name in found), "gestures and lexemes"
        page.fill("#palette-search", "")
        page.select_option("#palette-kind", "gesture")
        page.select_option("#palette-hand", "left")
        page.select_option("#palette-height", "up")
        assert 0 < few.count() < 20 and "shrug" not in few.all_inner_texts(), "filters know gestures, too"
        page.evaluate("([a, b]) => preview.session.select(a, b)", [at, at + 1])
        page.keyboard.press("Escape")
        assert page.is_hidden("#palette") and page.evaluate("() => preview.session.selection") == [at, at + 1]
        # Three variations of a stretch: seen under the pointer, gone after it, taken with a click.
        page.evaluate("([a, b]) => preview.session.select(a, b)", [at, at + 1])
        seen = []
        for number in (1, 2, 3):
            page.hover(f"#variations button:nth-child({number})")
            page.wait_for_function("() => document.getElementById('status').textContent.startsWith('a try')")
            seen.append(_rotations(page).tobytes())
            page.mouse.move(600, 300)
            page.wait_for_function("() => !document.getElementById('status').textContent.startsWith('a try')")
        assert len({*seen, frames.tobytes()}) == 4
        np.testing.assert_array_equal(_rotations(page), frames)
        page.click("#variations button:nth-child(2)")
        _rendered(page)
        assert _rotations(page).tobytes() == seen[1]
        _is(page, plans, opened.plan())
        opened.check_quiet(server.url)
