"""A plan as BML 1.0 (Behavior Markup Language), and back without loss.

Each block is a `<gesture>` with the lexeme's name, its start, and its beat as the stroke and the end; each cue is a
`<gesture>` whose stroke is a time or a sync point in the `<speech>`. What BML has no word for (draws, locks, sizes) are
attributes of our namespace, which other programs skip, and what is not edited stands as JSON in one `<plan>` of ours.
A block is known again by its id; a gesture without one of ours is a new block.
"""

from __future__ import annotations

import json
import os
import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from xml.parsers import expat
from xml.sax.saxutils import escape, quoteattr

from data_module.errors import InputError, shown
from data_module.files import read_bytes
from data_module.json_files import parse_json
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
"""Of a block, in our namespace; `lexeme` (a number), too, which counts where its name is not that of the attribute."""
_MOST_BYTES = 32 << 20
"""Bytes (32 MiB) of a file: an hour of blocks takes 6."""
_MOST_GESTURES = 100_000
"""Blocks and cues of a plan: six hours of blocks."""
_NO_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def bml_of(plan: GesturePlan) -> str:
    """A plan as BML."""
    plain = plan.to_dict()
    names = {one.lexeme: one.name for one in plan.lexicon}
    lines = ['<?xml version="1.0" encoding="UTF-8"?>',
             f'<bml xmlns="{NAMESPACE}" xmlns:g="{OURS}" id="plan" characterId={quoteattr(plan.speaker or "speaker")}>']
    if plan.words:
        said = " ".join(f'<sync id="w{at}"/>{escape(_plain(word.text))}' for at, word in enumerate(plan.words))
        lines += [' <speech id="speech" start="0">', f"  <text>{said}</text>", " </speech>"]
    for at, block in enumerate(plan.blocks):
        lexeme = "" if block.lexeme is None else names.get(block.lexeme, f"lexeme {block.lexeme}")
        own = {"id": f"b{at}", "lexeme": lexeme, "start": block.start, "stroke": block.end, "end": block.end}
        row = plain["blocks"][at]
        own |= {f"g:{name}": row[name] for name in ("lexeme", *_ATTRIBUTES)}
        lines.append(f" <gesture {_attributes(own)}/>")
    for at, cue in enumerate(plan.cues):
        stroke: str | float = cue.time if cue.time is not None else _sync(plan, cue.word or "", cue.occurrence)
        own = {"id": f"cue{at}", "lexeme": cue.gesture, "stroke": stroke}
        own |= {f"g:{name}": value for name, value in plain["cues"][at].items() if name not in ("gesture", "time")}
        lines.append(f" <gesture {_attributes(own)}/>")
    left = {name: value for name, value in plain.items() if name not in ("blocks", "cues")}
    edited = (*_ATTRIBUTES, "lexeme", "start", "end")
    left["blocks"] = [{name: value for name, value in row.items() if name not in edited} for row in plain["blocks"]]
    lines += [f" <g:plan>{escape(json.dumps(left))}</g:plan>", "</bml>"]
    return "\n".join(lines) + "\n"


def _attributes(values: dict[str, Any]) -> str:
    return " ".join(f"{name}={quoteattr(_plain(value) if isinstance(value, str) else json.dumps(value))}"
                    for name, value in values.items())


def _plain(text: str) -> str:
    """Without the characters that XML 1.0 cannot hold."""
    return _NO_XML.sub("\N{REPLACEMENT CHARACTER}", text)


def _sync(plan: GesturePlan, word: str, occurrence: int) -> str:
    found = [at for at, one in enumerate(plan.words) if one.text.casefold() == word.casefold()]
    return f"speech:w{found[occurrence - 1]}" if len(found) >= occurrence else "speech:start"


# ------------------------------------------------------------------------------------------------------ reading

@dataclass
class _Element:
    """tag: with its namespace and a space before it; line: from 1; texts: its text in pieces."""

    tag: str
    attributes: dict[str, str]
    line: int
    texts: list[str] = field(default_factory=list)
    children: list[_Element] = field(default_factory=list)


def read_any_plan(path: str | os.PathLike[str]) -> GesturePlan:
    """A plan from a file of JSON or, with the suffix .bml or .xml, of BML; `InputError` with the line."""
    if Path(path).suffix.lower() not in (".bml", ".xml"):
        return read_plan(path)
    return parse_bml(read_bytes(path, "give the file that was written", _MOST_BYTES), str(path))


def parse_bml(data: bytes, source: str = "plan.bml") -> GesturePlan:
    """A plan from BML; `InputError` with the line and what is allowed."""
    root = _tree(data, source)
    if root.tag != f"{NAMESPACE} bml":
        raise InputError(f"{source}, line {root.line}", "is no BML 1.0", f'begin with <bml xmlns="{NAMESPACE}">')
    left = [child for child in root.children if child.tag == _PLAN]
    if len(left) != 1:
        raise InputError(f"{source}, line {root.line}", "lacks the <plan> of our namespace",
                         "edit a file that was written with -o FILE.bml")
    value = _json("".join(left[0].texts), source, left[0].line)
    if not isinstance(value, dict) or not all(
            isinstance(rows, list) and all(isinstance(row, dict) for row in rows)
            for rows in (value.get("blocks"), value.get("lexicon", []))):
        raise InputError(f"{source}, line {left[0].line}", "holds no plan", "leave <g:plan> as it was written")
    return _assembled(value, [child for child in root.children if child.tag == _GESTURE], source,
                      left[0].line)


def _assembled(value: dict[str, Any], gestures: list[_Element], source: str, line: int) -> GesturePlan:
    rows = {f"b{at}": row for at, row in enumerate(value["blocks"])}
    numbers = {one["name"]: one.get("lexeme") for one in value.get("lexicon", []) if isinstance(one.get("name"), str)}
    blocks, cues = [], []
    for gesture in gestures:
        if "start" in gesture.attributes:
            blocks.append((gesture, _block(gesture, dict(rows.get(gesture.attributes.get("id", ""), {})), numbers,
                                           source)))
        else:
            cues.append((gesture, _cue(gesture, source)))
    blocks.sort(key=lambda one: one[1]["start"])
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
    own, where = gesture.attributes, f"{source}, line {gesture.line}"
    for name in ("start", "end"):
        row[name] = _seconds(own.get(name, ""), source, gesture.line, f"{name} of a gesture")
    for name in ("lexeme", *_ATTRIBUTES):
        if f"{OURS} {name}" in own:
            text = own[f"{OURS} {name}"]
            row[name] = text if name == "flag" else _json(text, source, gesture.line, name)
    row.setdefault("silent", False)
    called = own.get("lexeme", "")
    given = next((name for name, number in numbers.items() if number == row.get("lexeme")), None)
    if called in numbers and called != given:  # another name was written: it counts
        row["lexeme"], row["name"] = numbers[called], called
    elif called not in ("", given) and given is not None:
        raise InputError(where, f"lexeme is {shown(called)}", "give a name of the lexicon, or leave it empty")
    row.setdefault("lexeme", None)
    return row


def _cue(gesture: _Element, source: str) -> dict[str, Any]:
    own = gesture.attributes
    cue: dict[str, Any] = {"gesture": own.get("lexeme", "")}
    for name in ("word", "occurrence", "intensity", "mirror"):
        if f"{OURS} {name}" in own:
            text = own[f"{OURS} {name}"]
            cue[name] = text if name == "word" else _json(text, source, gesture.line, name)
    if "word" not in cue:
        cue["time"] = _seconds(own.get("stroke", ""), source, gesture.line, "stroke of a gesture")
    return cue


def _seconds(text: str, source: str, line: int, what: str) -> float:
    value = _json(text, source, line, what)
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise InputError(f"{source}, line {line}", f"{what} is {shown(text)}", "give seconds")
    return value


def _json(text: str, source: str, line: int, what: str = "<plan>") -> Any:
    try:
        return parse_json(text, source, "")
    except InputError:
        raise InputError(f"{source}, line {line}", f"{what} is {shown(text)}", "give a number, or what was written") \
            from None


def _tree(data: bytes, source: str) -> _Element:
    """The first element of a document, with its children of `_READ` and their text; what lies deeper tells nothing of a
    plan. Entities and types of documents are refused."""
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
        raise InputError(f"{source}, line {parser.CurrentLineNumber}", "declares a type of document", "take it away")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = text, refuse
    parser.buffer_text = True
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise InputError(f"{source}, line {error.lineno}", f"is no XML ({expat.errors.messages[error.code]})",
                         "check its tags") from None
    except (LookupError, ValueError) as error:  # an encoding that is unknown, or is not read by expat
        raise InputError(source, f"is no XML ({error})", "save it in UTF-8") from None
    return top.children[0]
