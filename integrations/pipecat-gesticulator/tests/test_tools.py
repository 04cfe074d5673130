"""Gestures that a language model calls: schemas, where marks fall, and whole agents with a scripted model."""

from __future__ import annotations

import asyncio
import importlib
import json
import shutil
import wave
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pipecat_gesticulator import Hello, connect
from pipecat_gesticulator.marks import timed_words
from pipecat_gesticulator.tools import MOST_WAITING, GestureCalls, anthropic_tools, openai_tools

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
AGENTS = [name for name, module in (("pipecat_tools", "pipecat"), ("livekit_tools", "livekit")) if find_spec(module)]
"""Examples whose framework is installed."""
READERS = [(module, name, tools) for module, name, tools in (
    ("openai.types.chat", "ChatCompletionFunctionToolParam", openai_tools()),
    ("openai.types.responses", "FunctionToolParam", openai_tools(flat=True)),
    ("anthropic.types", "ToolParam", anthropic_tools())) if find_spec(module.partition(".")[0])]
"""Types of the interfaces' packages, where they are installed."""


@pytest.mark.parametrize(("module", "name", "tools"), READERS)
def test_the_interfaces_packages_take_the_schemas(module: str, name: str, tools: list[dict[str, Any]]) -> None:
    from pydantic import TypeAdapter

    read = TypeAdapter(getattr(importlib.import_module(module), name))
    for tool in tools:
        given = {**tool, "strict": None} if name == "FunctionToolParam" else tool
        assert {key: read.validate_python(given)[key] for key in tool} == tool


def test_arguments_are_checked_by_the_schema_and_by_the_call_alike() -> None:
    jsonschema = pytest.importorskip("jsonschema")
    for tool, arguments, good in (
            ("make_gesture", {"name": "shrug", "when": "now"}, True),
            ("make_gesture", {"name": "fly", "when": ""}, False), ("make_gesture", {}, False),
            ("set_mood", {"style": "sad"}, True), ("set_mood", {"style": "rich"}, False)):
        schema = next(one["input_schema"] for one in anthropic_tools() if one["name"] == tool)
        assert jsonschema.Draft202012Validator(schema).is_valid(arguments) == good
        for given in (arguments, json.dumps(arguments)):
            calls = GestureCalls()
            assert ("no such" not in calls.call(tool, given)) == good and ("[" in calls.marked("So it is.")) == good


def test_marks_stand_before_their_words() -> None:
    calls = GestureCalls()
    for arguments in ({"name": "nod", "when": "now"}, {"name": "shrug", "when": "Idea"},
                      {"name": "wave hello", "when": "goodbye"}):
        calls.call("make_gesture", arguments)
    calls.call("set_mood", '{"style": "happy"}')
    assert calls.marked("I have no idea; an ideal.") == "[nod] [mood:happy] I have no [shrug] idea; an ideal."
    assert calls.marked("Well, goodbye.") == "Well, [wave hello] goodbye.", "it waited for its word"
    assert calls.marked("Goodbye.") == "Goodbye."
    answers = [calls.call("make_gesture", {"name": "nod", "when": "now"}) for _ in range(MOST_WAITING + 1)]
    assert "Too many" in answers[-1] and "Too many" not in answers[-2]
    calls.forget()
    assert calls.marked("Goodbye.") == "Goodbye."
    assert calls.call("make_gesture", "{") == "The arguments are no object; nothing was done."
    times = timed_words("[nod] I do", 2.0, 0.1)
    assert times[0] == ("[nod]", 2.0, 2.0) and times[1][:2] == ("I", 2.0)


@pytest.mark.parametrize("name", AGENTS)
def test_an_agent_whose_model_calls_a_gesture_makes_it(name: str, url: str, tmp_path: Path,
                                                       monkeypatch: pytest.MonkeyPatch) -> None:
    if shutil.which("espeak-ng") is None:
        pytest.skip("espeak-ng is not installed")
    monkeypatch.syspath_prepend(str(EXAMPLES))
    example = importlib.import_module(name)
    # Without gestures of its own, so that what the shoulders do is what was called for.
    monkeypatch.setitem(example.OPTIONS, "activity", 0.0)

    async def joints() -> list[str]:
        async with connect(url, Hello(16000)) as stream:
            return [joint.name for joint in stream.welcome.joints]

    shoulders = [asyncio.run(joints()).index(f"{side}Shoulder") for side in ("Left", "Right")]
    rises, begins = [], []
    for calls in (example.CALLS, example.CALLS[1:]):
        monkeypatch.setattr(example, "CALLS", calls)
        example.main([str(tmp_path / "a.wav"), str(tmp_path / "a.npz"), "--gestures", url])
        turns = np.load(tmp_path / "a.npz")["rotations"][:, shoulders]
        rises.append((np.degrees(2 * np.arctan2(turns[..., 3], turns[..., 0])) * (1, -1)).min(axis=1))
        with wave.open(str(tmp_path / "a.wav")) as sound:
            loud = np.abs(np.frombuffer(sound.readframes(10**8), "<i2").astype(np.int32)) > 1000
            begins.append(30 * loud.argmax() / sound.getframerate())
    assert rises[0].max() > rises[1].max() + 8, "both shoulders rise by 13 degrees in a shrug"
    # "rain" is spoken 2.3 seconds after the voice begins, for which a busy machine takes its time.
    assert 45 < rises[0].argmax() - begins[0] < 120
