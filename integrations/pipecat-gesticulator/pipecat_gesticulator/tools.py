"""Gestures as tools that a language model calls: `make_gesture(name, when)` and `set_mood(style)`.

The schemas are given in the form of OpenAI's and Anthropic's interfaces. `GestureCalls` carries the calls out by marks
in the words that are spoken next, as a model could write them itself (`marks.py`), so a stream with the option "text"
makes them. No package of an interface is needed.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

NAMES = (
    "point self", "point you", "we all", "they over there", "point here", "point there", "point left", "point right",
    "point up", "point back", "point ahead", "now press", "look at this", "open offer", "palms question", "shrug",
    "sweep no", "cut off", "stop palm", "calm down", "wait finger", "thumbs up", "nod", "head shake", "so so",
    "wave hello", "wave goodbye", "throw away", "hands over heart", "number one", "number two", "number three",
    "big spread", "small pinch", "surround", "increase", "decrease", "join hands", "weigh options", "contrast flip",
    "equal level", "chop point", "step by step", "air quotes")
"""Gestures that talk often calls for; a server knows more (`gesticulator gestures`)."""
STYLES = ("happy", "sad", "neutral")
"""Moods of a face; a stream shows them with the option "face": "full"."""
MOST_WAITING = 8
"""Calls that may wait for words; a further one is refused."""
TOOLS: tuple[Mapping[str, Any], ...] = (
    {"name": "make_gesture",
     "description": "Let your body make a gesture while you speak. Call it before the sentence it belongs to, once in "
                    "two or three sentences at most, and do not announce it in words.",
     "properties": {
         "name": {"type": "string", "enum": list(NAMES), "description": "The gesture."},
         "when": {"type": "string", "maxLength": 40, "description": "\"now\": with the first word of what you say "
                  "next; or a single word of it, at which the gesture is made."}},
     "required": ["name", "when"]},
    {"name": "set_mood",
     "description": "Set the mood of your face, from what you say next on until another mood.",
     "properties": {"style": {"type": "string", "enum": list(STYLES), "description": "The mood."}},
     "required": ["style"]})
"""Name, description, properties and required properties of each tool."""


def parameters(tool: Mapping[str, Any]) -> dict[str, Any]:
    """The JSON Schema of a tool's arguments."""
    return {"type": "object", "properties": tool["properties"], "required": tool["required"],
            "additionalProperties": False}


def openai_tools(flat: bool = False) -> list[dict[str, Any]]:
    """`tools` of OpenAI's Chat Completions; flat: of its Responses and Realtime interfaces."""
    functions = [{"name": tool["name"], "description": tool["description"], "parameters": parameters(tool)}
                 for tool in TOOLS]
    return [{"type": "function", **function} if flat else {"type": "function", "function": function}
            for function in functions]


def anthropic_tools() -> list[dict[str, Any]]:
    """`tools` of Anthropic's Messages."""
    return [{"name": tool["name"], "description": tool["description"], "input_schema": parameters(tool)}
            for tool in TOOLS]


class GestureCalls:
    """The calls of a model that wait for their words.

    >>> calls = GestureCalls()
    >>> calls.call("make_gesture", {"name": "shrug", "when": "idea"})
    'shrug will be made at "idea"'
    >>> calls.marked("I have no idea.")
    'I have no [shrug] idea.'
    """

    def __init__(self) -> None:
        self._waiting: list[tuple[str, str]] = []

    def call(self, name: str, arguments: str | Mapping[str, Any]) -> str:
        """Take a call; what to answer to the model, also where it is refused. arguments: JSON text, as OpenAI gives
        them, or an object, as Anthropic does."""
        try:
            given = json.loads(arguments) if isinstance(arguments, str) else arguments
        except ValueError:
            given = None
        if not isinstance(given, Mapping):
            return "The arguments are no object; nothing was done."
        if len(self._waiting) >= MOST_WAITING:
            return "Too many gestures wait for your words; speak first."
        if name == "make_gesture" and given.get("name") in NAMES:
            when = str(given.get("when") or "now").strip()
            self._waiting.append((str(given["name"]), "" if when.lower() == "now" else when))
            return f'{given["name"]} will be made at {json.dumps(when) if self._waiting[-1][1] else "your next word"}'
        if name == "set_mood" and given.get("style") in STYLES:
            self._waiting.append((f"mood:{given['style']}", ""))
            return f"The face will be {given['style']} with your next word."
        return f"There is no such tool, gesture or mood; gestures: {', '.join(NAMES)}; moods: {', '.join(STYLES)}."

    def marked(self, text: str) -> str:
        """A text that is spoken next with the marks of the waiting calls. A gesture whose word is not in it waits."""
        waiting, self._waiting = self._waiting, []
        first = ""
        for mark, word in waiting:
            place = re.search(rf"(?<!\w){re.escape(word)}(?!\w)", text, re.IGNORECASE) if word else None
            if place is not None:
                text = f"{text[:place.start()]}[{mark}] {text[place.start():]}"
            elif word or not text.strip():
                self._waiting.append((mark, word))
            else:
                first += f"[{mark}] "
        return first + text

    def forget(self) -> None:
        """The answer was interrupted: what waits is not made."""
        self._waiting = []
