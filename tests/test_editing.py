"""Edits on the page: the frames that come back are those of the whole plan rendered, bit for bit, and few are sent."""

import base64
import contextlib
import copy
import json
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from performances import example

from data_module.errors import InputError
from data_module.types import Speech
from gesticulator import Gesticulator
from gesticulator.directing.named_gestures import span_of_gesture
from gesticulator.directing.shaping import LONGEST_GESTURE
from gesticulator.export.html import describe
from gesticulator.page.server import AbandonedError
from gesticulator.page.session import EditSession
from gesticulator.performance import Performance
from gesticulator.plan.gestures import GESTURES
from gesticulator.plan.plan_file import parse_plan
from gesticulator.sampling import loop

SECONDS, SEED = 6.0, 1
Plain = dict[str, Any]


@pytest.fixture(scope="module")
def system(system: Gesticulator) -> Gesticulator:
    system.keeps_generations = True
    return system


@pytest.fixture(scope="module")
def speech() -> Speech:
    return example(SECONDS)


@pytest.fixture(scope="module")
def first(system: Gesticulator, speech: Speech) -> Performance:
    return system(speech, seed=SEED)


def frames_of_take(performance: Performance) -> np.ndarray:
    told = describe(performance.scene())
    return np.frombuffer(base64.b64decode(told["rotations"]), "<i2").reshape(told["frames"], -1, 4)


def roots_of_take(performance: Performance) -> np.ndarray:
    return np.frombuffer(base64.b64decode(describe(performance.scene())["root"]), "<f4").reshape(-1, 3)


def messages(parts: Iterable[bytes]) -> list[tuple[Plain, bytes]]:
    data, out = b"".join(parts), []
    while data:
        start = 4 + int.from_bytes(data[:4], "little")
        header = json.loads(data[4:start])
        out.append((header, data[start:start + header["bytes"]]))
        data = data[start + header["bytes"]:]
    return out


class Page:
    """What the page does with the answers."""

    def __init__(self, system: Gesticulator, first: Performance) -> None:
        self.session = EditSession(system, first)
        self.plan: Plain = describe(first.scene())["plan"]
        self.frames, self.roots = frames_of_take(first).copy(), roots_of_take(first).copy()
        self.have = self.session.opened(first)
        self.sent, self.progress = 0, list[float]()

    def abandon(self, plan: Plain, checks: int) -> None:
        """Ask for a plan, and for something else when the renderer has looked for that some times."""
        calls = iter([False] * checks)
        with contextlib.suppress(AbandonedError):
            self.session.answer(self.request(plan), lambda: next(calls, True))

    def request(self, plan: Plain) -> Plain:
        return {"have": self.have, "plan": json.loads(json.dumps(plan))}  # what comes over the network is not shared

    def edit(self, plan: Plain) -> None:
        """Put the frames and the plan of an answer in the place of what was there."""
        parts = list[bytes]()
        answer = self.session.answer(self.request(plan), report=parts.append)
        *progress, (header, data) = messages([*parts, answer])
        self.progress = [told["share"] for told, _ in progress]
        if header["shape"]:
            joints = len(header["shape"]["skeleton"]["names"])
            self.frames = np.zeros((header["shape"]["frames"], joints, 4), np.int16)
        first, last = header["range"]
        tail = len(data) - header["root"]
        self.frames[first:last] = np.frombuffer(data[:tail], "<i2").reshape(-1, *self.frames.shape[1:])
        if header["root"]:
            self.roots = np.frombuffer(data[tail:], "<f4").reshape(-1, 3)
        self.sent, self.have, self.plan = last - first, header["rendering"], header["plan"]


def _halved(blocks: list[Plain], at: int) -> None:
    block = blocks[at]
    middle = (block["start"] + block["end"]) / 2
    if block["end"] - block["start"] > 0.21:
        second = {**copy.deepcopy(block), "start": middle}
        second["draw"]["variation"] += 1
        block.update(end=middle, flag="edited")
        blocks.insert(at + 1, second)


def _joined(blocks: list[Plain], at: int) -> None:
    if at + 1 < len(blocks) and blocks[at + 1]["end"] - blocks[at]["start"] < 1.0:
        blocks[at].update(end=blocks[at + 1]["end"], flag=blocks[at + 1]["flag"])
        del blocks[at + 1]


def _moved(blocks: list[Plain], at: int) -> None:
    block = blocks[at]
    time = (block["start"] + 2 * block["end"]) / 3
    if at + 1 < len(blocks) and time - block["start"] > 0.1 and blocks[at + 1]["end"] - time < 1.0:
        block.update(end=time, flag="edited")
        blocks[at + 1]["start"] = time


BLOCK = {
    "swap": lambda block, value: block.update(lexeme=value), "free": lambda block, _: block.update(lexeme=None),
    "silence": lambda block, _: block.update(silent=not block["silent"]),
    "again": lambda block, value: block["draw"].update(variation=value),
    "size": lambda block, value: block.update(intensity=(0.0, 0.4, 1.0, 1.6)[value % 4]),
    "mirror": lambda block, _: block.update(mirror=not block.get("mirror", False)),
    "lock": lambda block, _: block.update(locked=not block.get("locked", False)),
}
BEATS = {"halve": _halved, "join": _joined, "move": _moved}
KNOBS = {"intensity": (0.4, 1.0, 1.5), "activity": (0.5, 1.0), "energy": ("calm", "neutral", "lively"),
         "mirror": (True, False), "hold_still": ([], [[2.0, 3.5]])}


def edited(plan: Plain, what: str, at: int, value: int) -> Plain:
    plan = copy.deepcopy(plan)
    blocks = plan["blocks"]
    at %= len(blocks)
    if what in BLOCK:
        BLOCK[what](blocks[at], value % 200)
    elif what in BEATS:
        BEATS[what](blocks, at)
    elif what == "curve":
        begin = blocks[at]["start"]
        plan["curves"] = [{"knob": "intensity", "times": [begin, begin + 1.0, begin + 2.0],
                           "values": [1.0, (0.2, 1.8)[value % 2], 1.0]}][:value % 3]
    elif what == "cue":
        plan["cues"] = [*plan.get("cues", ()), {"gesture": ("wave", "shrug", "nod")[value % 3],
                                               "time": blocks[at]["start"]}]
    elif what == "pin":
        side, sign = (("Left", 1.0), ("Right", -1.0))[value % 2]
        plan["pins"] = [*plan.get("pins", ()), {"time": blocks[at]["start"] + 1e-3 * (value % 300),
                                                "joint": f"{side}Hand", "position": [sign * 0.25, 1.25, 0.3],
                                                "hold": (0.0, 0.4)[value // 2 % 2]}][:value % 4]
    elif what == "speaker":
        plan["speaker"] = ("brad2", "garza", "connor")[value % 3]
    elif what == "variation":
        plan["variation"] = value % 3
    elif what == "legs":
        settings = {**plan["made_by"]["settings"], "legs": (None, "standing", "seated")[value % 3]}
        plan["made_by"] = {**plan["made_by"], "settings": {name: one for name, one in settings.items() if one}}
    elif what == "hands":
        begin = blocks[at]["start"]
        plan["curves"] = [{"knob": ("height", "speed", "radius")[value % 3], "times": [begin, begin + 1.0],
                           "values": [0.1, 0.3]}]
    else:
        plan["knobs"][what] = KNOBS[what][value % len(KNOBS[what])]
    return plan


WHOLE = ("speaker", "variation", "hands", "legs")
EDITS = st.lists(st.tuples(st.sampled_from(
    ["undo", "cue", "curve", "pin", "pin", *BLOCK, *BLOCK, *BEATS, *KNOBS, *WHOLE]), st.integers(0, 30),
    st.integers(0, 10_000), st.integers(0, 40)), min_size=3, max_size=7)
"""What is edited, where, how, and after how many looks it is abandoned for the same again; 20 and more: never."""


@pytest.mark.parametrize("legs", [False, True])
@settings(max_examples=5, phases=[Phase.generate])  # an example that fails is short enough as it is
@given(EDITS)
def test_any_edits_give_the_frames_of_the_plan_rendered_anew(
        system: Gesticulator, speech: Speech, legs: bool, edits: list[tuple[str, int, int, int]]) -> None:
    """Before each edit whose last number is below 20, the page asks for it and abandons it."""
    page = Page(system, system(speech, seed=SEED, legs=legs))
    before = [page.plan]
    for what, at, value, abandoned in edits:
        wanted = before[value % len(before)] if what == "undo" else edited(page.plan, what, at, value)
        if abandoned < 20:
            page.abandon(wanted, abandoned)
        page.edit(wanted)
        before.append(page.plan)
    # Everything anew, by an object that remembers nothing.
    made = Gesticulator(system.bundle)(speech, plan=parse_plan(json.dumps(wanted)))
    np.testing.assert_array_equal(page.frames, frames_of_take(made))
    np.testing.assert_array_equal(page.roots, roots_of_take(made))
    again = parse_plan(json.dumps(page.plan))
    assert made.plan() == replace(again, sound=made.plan().sound)


@pytest.mark.parametrize(("fps", "legs"), [(60.0, False), (50.0, False), (60.0, True), (50.0, True)])
def test_a_long_recordings_edits_at_half_the_rate_are_those_of_the_plan_rendered_anew(
        system: Gesticulator, speech: Speech, monkeypatch: pytest.MonkeyPatch, fps: float, legs: bool) -> None:
    monkeypatch.setattr("gesticulator.export.html.LONG", 2.0)
    page = Page(system, system(speech, seed=SEED, fps=fps, legs=legs))
    assert len(page.frames) == 180, "the page has 30 frames a second"
    original, frames, roots = page.plan, page.frames.copy(), page.roots
    edits = [("swap", 9, 3), ("pin", 7, 2), ("move", 12, 0), ("intensity", 0, 2), ("mirror", 5, 0), ("join", 3, 0)]
    for what, at, value in edits:
        page.edit(edited(page.plan, what, at, value))
        made = page.session.perform(parse_plan(json.dumps(page.plan)))
        np.testing.assert_array_equal(page.frames, frames_of_take(made))
        np.testing.assert_array_equal(page.roots, roots_of_take(made))
    page.edit(original)
    np.testing.assert_array_equal(page.frames, frames)
    np.testing.assert_array_equal(page.roots, roots)


def test_renderings_in_memory_are_bounded_and_a_page_goes_on(system: Gesticulator, first: Performance,
                                                             monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gesticulator.page.session.MOST_RENDERINGS", 3)
    page = Page(system, first)
    opened, before, original = page.have, page.frames.copy(), page.plan
    for at in range(5):
        page.edit(edited(page.plan, "size", 9 + at % 2, at))
    page.have = opened  # which is forgotten, so that all frames are sent
    page.edit(original)
    assert page.sent == len(before)
    np.testing.assert_array_equal(page.frames, before)


def _counted(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Counts the blocks that are drawn from now on."""
    count, step = [0], loop.step

    def counted(*args: Any) -> Any:
        count[0] += 1
        return step(*args)

    monkeypatch.setattr(loop, "step", counted)
    return count


def test_an_edit_sends_its_stretch_and_undo_draws_nothing(system: Gesticulator, first: Performance,
                                                          monkeypatch: pytest.MonkeyPatch) -> None:
    page = Page(system, first)
    original, frames = page.plan, page.frames.copy()
    drawn = _counted(monkeypatch)
    page.edit(edited(original, "swap", 8, 77))
    assert drawn == [1], "the block, and not the recording: its generation was kept"
    swapped = page.plan
    assert 0 < page.sent < 60 * 3.5, "frames of the block, its blend, and the blocks beside them"
    page.edit(original)
    np.testing.assert_array_equal(page.frames, frames)
    page.edit(swapped)
    assert drawn == [1], "both are remembered"
    page.edit(edited(swapped, "activity", 0, 0))
    whole = drawn[0]
    assert whole >= len(original["blocks"])
    page.edit(edited(page.plan, "swap", 12, 33))
    assert drawn[0] <= whole + 1, "with other knobs too, an edit costs its block"
    page.edit(edited(page.plan, "join", 3, 0))
    assert drawn[0] <= whole + 3


def test_a_whole_take_reports_its_progress_and_goes_on_where_it_was_abandoned(
        system: Gesticulator, first: Performance, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gesticulator.page.session.REPORTS", 3)
    page, drawn = Page(system, first), _counted(monkeypatch)
    count, asked = len(page.plan["blocks"]), edited(page.plan, "activity", 0, 0)
    page.abandon(asked, 9)
    assert drawn == [10], "it ends with the block at which something else was asked for"
    page.edit(asked)
    assert drawn == [count], "what was sampled is known"
    assert page.progress == sorted(page.progress) and 0.3 < page.progress[0] < page.progress[-1] < 1.0
    with pytest.raises(InputError):
        page.edit({**asked, "blocks": asked["blocks"][:-1]})


def test_no_gesture_is_longer_than_what_is_looked_for() -> None:
    assert max(max(span_of_gesture(name)) for name in GESTURES) < LONGEST_GESTURE
