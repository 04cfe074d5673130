"""An editor's story in a real browser: look, try, drag, search, undo, shape, pin, export, close the page and go on."""

import base64
import gc
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from browser import PATIENCE, OpenedPage, chromium
from performances import write_example

from gesticulator.export import html
from gesticulator.jobs import run_settings_of
from gesticulator.page.command import COMMAND, _job, _prepare
from gesticulator.page.server import PageServer
from gesticulator.page.session import EditSession
from gesticulator.plan.plan_file import parse_plan, read_plan


def _rotations(page: Any) -> np.ndarray:
    """The frames that are shown, as the numbers that were sent."""
    text = page.evaluate("""() => {
        const r = Int16Array.from(preview.session.take.rotations, (v) => Math.round(v * 32767));
        let s = ""; for (const b of new Uint8Array(r.buffer)) s += String.fromCharCode(b); return btoa(s); }""")
    return np.frombuffer(base64.b64decode(text), "<i2")


def _rendered(page: Any) -> None:
    page.wait_for_function("() => preview.session.plan === preview.session.lane.rendered && "
                           "document.getElementById('status').dataset.state === 'same'", timeout=PATIENCE)


def _is(page: Any, plans: EditSession, plan: dict[str, Any]) -> None:
    made = html.describe(plans.perform(parse_plan(json.dumps(plan))).scene())
    np.testing.assert_array_equal(_rotations(page), np.frombuffer(base64.b64decode(made["rotations"]), "<i2"))


@contextmanager
def _viewing(sound: Path, *words: str) -> Iterator[tuple[PageServer, EditSession]]:
    """What `gesticulator view SOUND` does from the command to Ctrl C, without a window of its own."""
    args = COMMAND.parser("gesticulator view").parse_args([str(sound), "--no-browser", *words])
    with PageServer() as server:
        _prepare(server, _job(args), run_settings_of(args))
        gc.unfreeze()  # more is done in this process after it
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        try:
            yield server, server.render.__self__  # type: ignore[union-attr]
        finally:
            server.shutdown()
            thread.join(10)


def _look(page: Any) -> int:
    """Search the palette with the keyboard; the block that is meant."""
    page.keyboard.press("p")
    page.wait_for_selector("#palette-figures li", timeout=PATIENCE)
    assert page.locator("#palette-figures li:not([hidden])").count() > 250
    assert page.locator("#palette-figures canvas").first.bounding_box()["height"] > 20, "small moving figures"
    playing = page.evaluate("() => preview.session.plan.blocks[preview.inspector.stretch[0]].lexeme")
    assert page.locator('#palette .figure[aria-pressed="true"]').inner_text().startswith(f"{playing} ·")
    page.keyboard.type("both hands")
    page.select_option("#palette-size", "far")
    few = page.locator("#palette-figures li:not([hidden])")
    assert 0 < few.count() < 150
    names = few.locator(".called").all_inner_texts()
    lexemes = [name for name in names if " · " in name]
    assert all("both hands" in name or ("right hand" in name and "left hand" in name) for name in lexemes)
    assert len(lexemes) < len(names), "gestures, too"
    return int(page.evaluate("() => preview.inspector.stretch[0]"))


def _draw_curve(page: Any) -> None:
    """A curve of the size on the timeline: two clicks, and the second point is dragged down."""
    page.click("#curve")
    box = page.locator("#timeline").bounding_box()
    row = page.evaluate("() => preview.timeline.rows.curve")
    for second, share in ((1.0, 0.5), (3.0, 0.3)):
        x = page.evaluate("(at) => preview.timeline.x(at)", second)
        page.mouse.click(box["x"] + x, box["y"] + row["top"] + share * row["tall"])
    page.mouse.move(box["x"] + x, box["y"] + row["top"] + 0.3 * row["tall"])
    page.wait_for_timeout(500)  # a second click at once would remove the point
    page.mouse.down()
    page.mouse.move(box["x"] + x, box["y"] + row["top"] + 0.8 * row["tall"], steps=4)
    page.mouse.up()


def _pin(page: Any) -> None:
    """The left hand of the figure, taken with the mouse and put higher."""
    page.keyboard.press("g")
    page.wait_for_selector('.handle[data-joint="LeftHand"]', state="visible")
    box = page.locator('.handle[data-joint="LeftHand"]').bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 15, y - 35)
    page.mouse.move(x + 30, y - 70)
    page.mouse.up()


def test_gestures_are_seen_tried_taken_dragged_shaped_pinned_and_there_again_tomorrow(tmp_path: Path) -> None:
    sound, said = write_example(tmp_path / "talk.wav", 6.0, "FLOAT"), tmp_path / "talk.srt"
    said.write_text("1\n00:00:00,200 --> 00:00:04,200\nhello, and welcome this is a voice that was never recorded\n")
    with chromium() as browser:
        with _viewing(sound, "--text", str(said)) as (server, plans):
            opened = OpenedPage(browser, server.url, 1280, 900)
            page = opened.page
            page.set_default_timeout(PATIENCE)
            opened.go_to(1.0)
            first, original = _rotations(page), opened.plan()
            # The phrases are a row of gestures: a click on one selects its blocks, a second one those of its unit.
            unit = max(original["units"], key=lambda one: one["end"] - one["start"])
            box = page.locator("#timeline").bounding_box()
            x, row = page.evaluate("(at) => [preview.timeline.x(at), preview.timeline.rows.units]",
                                   (unit["start"] + unit["end"]) / 2)
            for _ in range(2):
                page.mouse.click(box["x"] + x, box["y"] + row["top"] + row["tall"] / 2)
            begin, end = page.evaluate("() => preview.session.selection")
            assert end > begin and original["blocks"][begin]["start"] <= unit["start"] + 0.01
            page.keyboard.press("Escape")
            speaks = next(one for one in original["blocks"] if one["start"] > 1.0 and not one["silent"])
            opened.go_to((speaks["start"] + speaks["end"]) / 2)
            # Another gesture is played in its place under the pointer, and taken back when that leaves.
            block = _look(page)
            playing = opened.plan()["blocks"][block]["lexeme"]
            few = page.locator("#palette-figures li:not([hidden])")
            choice = few.locator('.figure[aria-pressed="false"]').first
            lexeme = int(choice.locator(".called").inner_text().split(" ·")[0])
            choice.hover()
            page.wait_for_function("() => document.getElementById('status').textContent.startsWith('a try')",
                                   timeout=PATIENCE)
            assert (_rotations(page) != first).any()
            assert opened.plan()["blocks"][block]["lexeme"] == playing, "nothing is taken"
            page.mouse.move(700, 300)
            page.wait_for_function("() => !document.getElementById('status').textContent.startsWith('a try')")
            np.testing.assert_array_equal(_rotations(page), first)
            # It is dragged onto the next word.
            word = next(one for one in original["words"] if one["start"] > original["blocks"][block]["end"] + 0.3)
            x = page.evaluate("(at) => preview.timeline.x(at)", (word["start"] + word["end"]) / 2)
            choice.drag_to(page.locator("#timeline"), target_position={"x": x, "y": 60})
            _rendered(page)
            changed = [at for at, (now, was) in enumerate(zip(opened.plan()["blocks"], original["blocks"], strict=True))
                       if now["lexeme"] != was["lexeme"]]
            (at,) = changed
            assert opened.plan()["blocks"][at]["lexeme"] == lexeme and at > block
            assert original["blocks"][at]["start"] < word["end"] and original["blocks"][at]["end"] > word["start"]
            # A named gesture by the search, a favourite, and back with the keyboard.
            page.select_option("#palette-size", "")
            page.fill("#palette-search", "shrug")
            page.select_option("#palette-kind", "gesture")
            few.locator(".star").first.click()
            few.locator(".figure").first.click()
            _rendered(page)
            assert opened.plan()["cues"][0]["gesture"].startswith("shrug")
            page.fill("#palette-search", "")
            page.click("#palette-favourites")
            assert few.count() == 1
            page.click("#palette-close")
            for keys in ("Control+z", "Control+z", "Control+Shift+z"):
                page.keyboard.press(keys)
            _rendered(page)
            assert not opened.plan().get("cues") and opened.plan()["blocks"][at]["lexeme"] == lexeme
            _is(page, plans, opened.plan())
            # A curve of the size, and a pinned pose.
            _draw_curve(page)
            _rendered(page)
            (curve,) = opened.plan()["curves"]
            assert curve["knob"] == "intensity" and len(curve["times"]) == 2 and curve["values"][0] > curve["values"][1]
            page.keyboard.press("f")
            opened.go_to(2.004)
            _pin(page)
            _rendered(page)
            (pin,) = opened.plan()["pins"]
            assert pin["joint"] == "LeftHand" and abs(pin["time"] - 2.0) < 1e-3
            page.keyboard.press("g")
            _is(page, plans, opened.plan())
            edited, there = opened.plan(), _rotations(page)
            opened.check_quiet(server.url)
            page.close()
        # Tomorrow, in another browser's memory: what was saved beside the sound.
        assert read_plan(tmp_path / "talk.wav.edits.plan.json").blocks[at].lexeme == lexeme
        with _viewing(sound) as (server, plans):
            opened = OpenedPage(browser, server.url, 1280, 900)
            page = opened.page
            page.set_default_timeout(PATIENCE)
            now = opened.plan()
            assert [now[name] for name in ("curves", "words")] == [edited[name] for name in ("curves", "words")]
            assert now["pins"] == [{"hold": 0, **pin}], "a file says what the page leaves out"
            assert [one["lexeme"] for one in now["blocks"]] == [one["lexeme"] for one in edited["blocks"]]
            np.testing.assert_array_equal(_rotations(page), there)
            opened.go_to(5.3)
            page.keyboard.press("2")
            _rendered(page)
            assert (_rotations(page) != there).any()
            _is(page, plans, opened.plan())
            page.keyboard.press("Control+z")
            _rendered(page)
            np.testing.assert_array_equal(_rotations(page), there)
            opened.check_quiet(server.url)
