"""Gestures that are dragged along the timeline or moved with keys, and the palette."""

import json
import re
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import PATIENCE, OpenedPage, chromium, opened_page
from performances import write_example
from test_story import _is, _rendered, _rotations, _viewing
from test_view import viewing

from gesticulator.page.server import PageServer
from gesticulator.page.session import EditSession
from gesticulator.plan.plan_file import read_plan

FLAT = "--disable-3d-apis"
"""A flag of a browser that draws no figure: nothing else here takes long."""


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[PageServer, EditSession]]:
    """The page of six seconds of the example, with its renderer."""
    with _viewing(write_example(tmp_path_factory.mktemp("view") / "talk.wav", 6.0, "FLOAT"), "--seed", "1") as viewed:
        yield viewed


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


def _silence(page: Any, block: int) -> None:
    page.evaluate("(k) => { preview.session.select(k); document.getElementById('silence').click(); }", block)


def _has(page: Any, **silent: bool) -> None:
    """Wait until a page shows which blocks are silent, and their motion."""
    page.wait_for_function("(wanted) => Object.entries(wanted).every(([name, silent]) => "
                           "preview.session.plan.blocks[Number(name.slice(1))].silent === silent)", arg=silent,
                           timeout=PATIENCE)
    _rendered(page)


def test_pages_open_with_the_present_plan_follow_each_other_and_lose_no_edit(tmp_path: Path) -> None:
    sound, place = write_example(tmp_path / "talk.wav", 4.0, "FLOAT"), tmp_path / "talk.wav.edits.plan.json"
    with chromium(FLAT) as browser, _viewing(sound) as (server, plans):
        first = OpenedPage(browser, server.url, 640, 420)
        count = len(first.plan()["blocks"])
        one, two, three, four = [at for at, block in enumerate(first.plan()["blocks"]) if not block["silent"]][:4]
        first.page.evaluate("(beat) => preview.session.selectBeat(beat)", count - 2)
        first.page.keyboard.press("Delete")
        _silence(first.page, one)
        _has(first.page, **{f"b{one}": True})
        # Another browser opens the address, and has what the first one has: its plan and its motion.
        second = OpenedPage(browser, server.url, 640, 420)
        _rendered(second.page)
        assert second.plan() == first.plan() and len(second.plan()["blocks"]) == count - 1
        np.testing.assert_array_equal(_rotations(second.page), _rotations(first.page))
        _silence(second.page, two)
        _has(first.page, **{f"b{one}": True, f"b{two}": True})
        _is(first.page, plans, first.plan())

        def at_once(second_block: int) -> None:
            """Both pages edit before the second one has asked for news: its edit is refused."""
            second.page.route("**/plan/*", lambda route: route.abort())
            _silence(first.page, three)
            _has(first.page, **{f"b{three}": True})
            _silence(second.page, second_block)
            second.page.wait_for_selector("#stale", timeout=PATIENCE)
            second.page.unroute("**/plan/*")

        at_once(four)
        assert not first.plan()["blocks"][four]["silent"] and read_plan(place).blocks[three].silent
        second.page.click("#stale-both")
        _has(second.page, **{f"b{three}": False, f"b{four}": True})
        _has(first.page, **{f"b{three}": False, f"b{four}": True})
        assert read_plan(place).blocks[four].silent and not read_plan(place).blocks[three].silent
        copy = place.with_name(place.name + ".old")
        assert read_plan(copy).blocks[three].silent and not read_plan(copy).blocks[four].silent
        second.page.wait_for_function("(name) => document.getElementById('notice').textContent.includes(name)",
                                      arg=copy.name)
        # The other way: the page goes on with the plan of the other one, and undo leads back to its edit.
        at_once(one)
        second.page.click("#stale-reload")
        _has(second.page, **{f"b{one}": True, f"b{three}": True})
        second.page.keyboard.press("Control+z")
        _has(first.page, **{f"b{one}": False, f"b{three}": False, f"b{four}": True})
        # A page that is loaded again can go back to the beginning. Nothing of it lies in the browser.
        second.page.reload()
        second.page.wait_for_function("() => document.body.dataset.ready === 'true'")
        assert second.plan()["blocks"][four]["silent"]
        second.page.keyboard.press("Control+z")
        assert len(second.plan()["blocks"]) == count
        assert first.page.evaluate("Object.keys(localStorage)") == []
        for opened in (first, second):
            assert all(re.search("412|ERR_FAILED|WebGL", text) for text in opened.complaints), opened.complaints


@pytest.mark.skipif(sys.platform != "linux", reason="limits the files of a running process")
def test_a_full_disk_and_a_program_that_ends_take_no_edit(tmp_path: Path) -> None:
    import resource

    sound, place = write_example(tmp_path / "talk.wav", 4.0, "FLOAT"), tmp_path / "talk.wav.edits.plan.json"
    with chromium(FLAT) as browser:
        with viewing(sound) as (process, url):
            page = (opened := OpenedPage(browser, url, 640, 420)).page
            # A disk without room is a limit on files: the write fails half-way, in the operating system.
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (2000, resource.RLIM_INFINITY))
            _silence(page, 3)
            page.wait_for_selector("#unsaved", timeout=PATIENCE)
            _rendered(page)
            assert "not saved" in page.inner_text("#notice") and opened.plan()["blocks"][3]["silent"]
            assert [path.name for path in tmp_path.iterdir() if "plan" in path.name] == [f".{place.name}.lock"]
            assert OpenedPage(browser, url, 400, 300).plan() == opened.plan(), "the program has it"
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
            page.wait_for_selector("#unsaved", state="hidden", timeout=PATIENCE)
            assert json.loads(place.read_text())["blocks"][3]["silent"]
            # It is ended before it has tried again: it saves first.
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (2000, resource.RLIM_INFINITY))
            _silence(page, 4)
            page.wait_for_selector("#unsaved", timeout=PATIENCE)
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
            process.send_signal(signal.SIGTERM)
            assert process.wait(60) == 0
            assert json.loads(place.read_text())["blocks"][4]["silent"]
            page.wait_for_function("() => document.getElementById('status').textContent.includes('does not answer')",
                                   timeout=PATIENCE)
            # What is edited now is in this page alone, which says so before it closes.
            page.click("#timeline")
            page.keyboard.press("m")
            assert not page.evaluate("dispatchEvent(new Event('beforeunload', { cancelable: true }))"), "it asks first"
        # Killed at once after an answer: what was rendered is there, and so is the address in a new program.
        with viewing(sound) as (process, url):
            opened = OpenedPage(browser, url, 640, 420)
            assert [opened.plan()["blocks"][at]["silent"] for at in (3, 4)] == [True, True]
            _silence(opened.page, 5)
            _rendered(opened.page)
            process.kill()
            assert json.loads(place.read_text())["blocks"][5]["silent"]
