"""Plans in BML 1.0 (Behavior Markup Language), lossless in both directions.

Each block is a `<gesture>` with the name of its lexeme, its start, and its beat as stroke and end. Each cue is a
`<gesture>` whose stroke is a time or a sync point in the `<speech>`. Fields without an equivalent in BML, such as
locks, are attributes in our namespace, which other programs ignore. Everything that is not meant to be edited is JSON
in one element `<plan>` of our namespace. Blocks are identified by their id; a gesture with an unknown id is a new one.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from xml.parsers import expat
from xml.sax.saxutils import escape, quoteattr

from data_module.errors import InputError, shown
from data_module.files import parse_json, read_bytes
from gesticulator.plan.checks import check_plan
from gesticulator.plan.json_lines import LinedJson
from gesticulator.plan.json_lines import Path as Place
from gesticulator.plan.plan import GesturePlan
from gesticulator.plan.plan_file import read_plan, upgraded
from gesticulator.plan.schema import read_as

__all__ = ["bml_of", "parse_bml", "read_any_plan"]

NAMESPACE = "http://www.bml-initiative.org/bml/bml-1.0"
OURS = "urn:gesticulator:plan:1"
_PLAN, _GESTURE = f"{OURS} plan", f"{NAMESPACE} gesture"
_READ = (_PLAN, _GESTURE)
_ATTRIBUTES = ("silent", "locked", "intensity", "mirror", "draw", "flag")
"""Fields of a block that are attributes in our namespace, besides `lexeme`, its number."""
_MOST_BYTES = 32 << 20
"""Size limit of a file, bytes (32 MiB); an hour of blocks takes 6 MiB."""
_MOST_GESTURES = 100_000
"""Limit of blocks and cues of a plan: those of six hours."""
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def bml_of(plan: GesturePlan) -> str:
    """The text of a plan in BML."""
    plain = plan.to_dict()
    names = {entry.lexeme: entry.name for entry in plan.lexicon}
    lines = ['<?xml version="1.0" encoding="UTF-8"?>',
             f'<bml xmlns="{NAMESPACE}" xmlns:g="{OURS}" id="plan" characterId={quoteattr(plan.speaker or "speaker")}>']
    if plan.words:
        text = " ".join(f'<sync id="w{at}"/>{escape(_plain(word.text))}' for at, word in enumerate(plan.words))
        lines += [' <speech id="speech" start="0">', f"  <text>{text}</text>", " </speech>"]
    for at, block in enumerate(plan.blocks):
        lexeme = "" if block.lexeme is None else names.get(block.lexeme, f"lexeme {block.lexeme}")
        values = {"id": f"b{at}", "lexeme": lexeme, "start": block.start, "stroke": block.end, "end": block.end}
        row = plain["blocks"][at]
        values |= {f"g:{name}": row[name] for name in ("lexeme", *_ATTRIBUTES)}
        lines.append(f" <gesture {_attributes(values)}/>")
    for at, cue in enumerate(plan.cues):
        stroke: str | float = cue.time if cue.time is not None else _sync(plan, cue.word or "", cue.occurrence)
        values = {"id": f"cue{at}", "lexeme": cue.gesture, "stroke": stroke}
        values |= {f"g:{name}": value for name, value in plain["cues"][at].items() if name not in ("gesture", "time")}
        lines.append(f" <gesture {_attributes(values)}/>")
    rest = {name: value for name, value in plain.items() if name not in ("blocks", "cues")}
    written = (*_ATTRIBUTES, "lexeme", "start", "end")
    rest["blocks"] = [{name: value for name, value in row.items() if name not in written} for row in plain["blocks"]]
    lines += [f" <g:plan>{escape(json.dumps(rest))}</g:plan>", "</bml>"]
    return "\n".join(lines) + "\n"


def _attributes(values: dict[str, Any]) -> str:
    return " ".join(f"{name}={quoteattr(_plain(value) if isinstance(value, str) else json.dumps(value))}"
                    for name, value in values.items())


def _plain(text: str) -> str:
    """The text with characters that XML 1.0 does not allow replaced."""
    return _NOT_XML.sub("\N{REPLACEMENT CHARACTER}", text)


def _sync(plan: GesturePlan, word: str, occurrence: int) -> str:
    matches = [at for at, spoken in enumerate(plan.words) if spoken.text.casefold() == word.casefold()]
    return f"speech:w{matches[occurrence - 1]}" if len(matches) >= occurrence else "speech:start"


# ------------------------------------------------------------------------------------------------------ reading

@dataclass
class _Element:
    """An element of XML. tag: namespace, a space and the name; line: from 1; texts: pieces of its text."""

    tag: str
    attributes: dict[str, str]
    line: int
    texts: list[str] = field(default_factory=list)
    children: list[_Element] = field(default_factory=list)


def read_any_plan(path: str | os.PathLike[str]) -> GesturePlan:
    """Read a plan from a file in BML (suffix .bml or .xml) or JSON (any other); `InputError` with the line."""
    if Path(path).suffix.lower() not in (".bml", ".xml"):
        return read_plan(path)
    return parse_bml(read_bytes(path, "give a file that was written with -o FILE.bml", _MOST_BYTES), str(path))


def parse_bml(data: bytes, source: str = "plan.bml") -> GesturePlan:
    """Parse a plan in BML; `InputError` with the line and the allowed values if it is invalid."""
    root = _tree(data, source)
    if root.tag != f"{NAMESPACE} bml":
        raise InputError(f"{source}, line {root.line}", "is not BML 1.0", f'begin with <bml xmlns="{NAMESPACE}">')
    plans = [child for child in root.children if child.tag == _PLAN]
    if len(plans) != 1:
        raise InputError(f"{source}, line {root.line}", f"must have one element <plan> of the namespace {OURS}",
                         "edit a file that was written with -o FILE.bml")
    line = plans[0].line
    value = _json("".join(plans[0].texts), source, line)
    if not isinstance(value, dict) or not all(
            isinstance(rows, list) and all(isinstance(row, dict) for row in rows)
            for rows in (value.get("blocks"), value.get("lexicon", []))):
        raise InputError(f"{source}, line {line}", "holds no plan", "leave <g:plan> as it was written")
    return _assembled(value, [child for child in root.children if child.tag == _GESTURE], source, line)


def _assembled(value: dict[str, Any], gestures: list[_Element], source: str, line: int) -> GesturePlan:
    """The plan of the JSON `value`, at this line, with the blocks and cues of the elements."""
    rows = {f"b{at}": row for at, row in enumerate(value["blocks"])}
    numbers = {entry["name"]: entry.get("lexeme") for entry in value.get("lexicon", [])
               if isinstance(entry.get("name"), str)}
    blocks, cues = [], []
    for gesture in gestures:
        if "start" in gesture.attributes:
            blocks.append((gesture, _block(gesture, dict(rows.get(gesture.attributes.get("id", ""), {})), numbers,
                                           source)))
        else:
            cues.append((gesture, _cue(gesture, source)))
    blocks.sort(key=lambda pair: pair[1]["start"])
    lines: dict[Place, int] = {(): line}
    for at, (gesture, row) in enumerate(blocks):
        row.setdefault("draw", {"seed": value.get("seed", 0), "variation": value.get("variation", 0), "block": at})
        lines["blocks", at] = gesture.line
    lines |= {("cues", at): gesture.line for at, (gesture, _) in enumerate(cues)}
    value = {**value, "blocks": [row for _, row in blocks], "cues": [cue for _, cue in cues]}
    lined = upgraded(LinedJson(source, value, lines))
    plan = replace(read_as(GesturePlan, lined), source=lined)
    check_plan(plan)
    return plan


def _block(gesture: _Element, row: dict[str, Any], numbers: dict[Any, Any], source: str) -> dict[str, Any]:
    attributes = gesture.attributes
    for name in ("start", "end"):
        row[name] = _seconds(attributes.get(name, ""), source, gesture.line, f"{name} of a gesture")
    row |= _our_values(gesture, ("lexeme", *_ATTRIBUTES), source)
    row.setdefault("silent", False)
    name = attributes.get("lexeme", "")
    numbered = next((name for name, number in numbers.items() if number == row.get("lexeme")), None)
    if name in numbers and name != numbered:  # the name was edited: it takes precedence over the number
        row["lexeme"], row["name"] = numbers[name], name
    elif name not in ("", numbered) and numbered is not None:
        raise InputError(f"{source}, line {gesture.line}", f"lexeme is {shown(name)}",
                         "give a name of the lexicon, or leave it empty")
    row.setdefault("lexeme", None)
    return row


def _cue(gesture: _Element, source: str) -> dict[str, Any]:
    cue: dict[str, Any] = {"gesture": gesture.attributes.get("lexeme", "")}
    cue |= _our_values(gesture, ("word", "occurrence", "intensity", "mirror", "source"), source)
    if "word" not in cue:
        cue["time"] = _seconds(gesture.attributes.get("stroke", ""), source, gesture.line, "stroke of a gesture")
    return cue


def _our_values(gesture: _Element, names: Sequence[str], source: str) -> dict[str, Any]:
    """The values of the attributes in our namespace, of those with these names."""
    texts = {name: gesture.attributes[f"{OURS} {name}"] for name in names if f"{OURS} {name}" in gesture.attributes}
    return {name: text if name in ("flag", "word", "source") else _json(text, source, gesture.line, name)
            for name, text in texts.items()}


def _seconds(text: str, source: str, line: int, name: str) -> float:
    value = _json(text, source, line, name)
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise InputError(f"{source}, line {line}", f"{name} is {shown(text)}", "give seconds")
    return value


def _json(text: str, source: str, line: int, name: str = "<plan>") -> Any:
    try:
        return parse_json(text, source, "")
    except InputError:
        raise InputError(f"{source}, line {line}", f"{name} is {shown(text)}",
                         "give a number, or leave it as it was written") from None


def _tree(data: bytes, source: str) -> _Element:
    """The root element of a document, with its children of `_READ` and their text. Deeper elements are ignored;
    entities and document type declarations are refused."""
    parser = expat.ParserCreate(namespace_separator=" ")
    top = _Element("", {}, 1)
    depth, plan = 0, False

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, plan
        depth += 1
        if depth == 1:
            top.children.append(_Element(tag, attributes, parser.CurrentLineNumber))
        elif depth == 2:
            rows, plan = top.children[0].children, tag == _PLAN
            if tag in _READ:
                rows.append(_Element(tag, attributes, parser.CurrentLineNumber))
            if len(rows) > _MOST_GESTURES:
                raise InputError(source, f"has more than {_MOST_GESTURES:,} gestures", "cut the recording in parts")

    def end(_: str) -> None:
        nonlocal depth
        depth -= 1

    def text(data: str) -> None:
        if depth == 2 and plan:
            top.children[0].children[-1].texts.append(data)

    def refuse(*_: object) -> None:
        raise InputError(f"{source}, line {parser.CurrentLineNumber}", "has a document type declaration", "remove it")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = text, refuse
    parser.buffer_text = True
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise InputError(f"{source}, line {error.lineno}", f"is not XML ({expat.errors.messages[error.code]})",
                         "check its tags") from None
    except (LookupError, ValueError) as error:  # an encoding that is unknown or not supported by expat
        raise InputError(source, f"is not XML ({error})", "save it in UTF-8") from None
    return top.children[0]
