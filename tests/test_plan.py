"""The file of a gesture plan: it is read as it was written, mistakes are told with their line, the schema agrees."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.parsers import expat

import jsonschema
import numpy as np
import pytest
from counted import counted_calls
from hypothesis import given
from hypothesis import strategies as st

from data_module.errors import InputError
from gesticulator.page.plan_reader import PlanReader
from gesticulator.plan.bml import bml_of, parse_bml
from gesticulator.plan.json_lines import parse
from gesticulator.plan.plan import (
    FORMAT,
    VERSION,
    Block,
    BlockDraw,
    DrawnBlocks,
    GestureCue,
    GestureName,
    GesturePhase,
    GesturePlan,
    GestureUnit,
    KnobCurve,
    LexemeChoice,
    LexemeName,
    PlanKnobs,
    PlanMeaning,
    PlanSound,
    PlanWord,
    PosePin,
    SoundAlignment,
    edited_blocks,
)
from gesticulator.plan.plan_file import UPGRADES, parse_plan, schema

SCHEMA = Path(__file__).resolve().parent.parent / "docs" / "schema" / "plan.schema.json"
VERSION_1 = Path(__file__).resolve().parent / "data" / "plans" / "version_1.json"
NAMES = ("both hands up", "right hand out", "rest")


def a_plan(count: int = 4, seed: int = 7) -> GesturePlan:
    rng = np.random.default_rng(seed)
    edges = tuple(np.round(np.concatenate([[0.0], np.cumsum(rng.uniform(0.2, 0.5, count))]), 3).tolist())
    lexemes = tuple(rng.integers(0, 3, count).tolist())
    flags = (*("onset",) * (count - 1), "boundary")
    blocks = tuple(Block(edges[i], edges[i + 1], lexemes[i], i == 0, BlockDraw(seed, 0, i), flags[i],
                         NAMES[lexemes[i]], alternatives=(LexemeChoice(1, NAMES[1], -0.5),)) for i in range(count))
    return GesturePlan(
        FORMAT, VERSION, {"gesticulator": "0", "settings": {"temperature": 1.0}},
        PlanSound("a.wav", edges[-1], 16000, "00"),
        seed, 0, "ann", "lstm", DrawnBlocks(edges, flags, (True, *(False,) * (count - 1)), lexemes, PlanKnobs()),
        blocks,
        cues=(GestureCue("wave", "Hello"), GestureCue("nod", time=0.5, mirror=True)),
        words=(PlanWord("Hello", 0.1, 0.4), PlanWord('<"there">&', 0.4, 0.6)),
        lexicon=tuple(LexemeName(n, name, n == 2) for n, name in enumerate(NAMES)),
        gestures=(GestureName("wave", "waves"),), notes=("one",))


@given(st.integers(1, 12), st.integers(0, 99))
def test_what_is_written_is_read_as_json_and_as_bml(count: int, seed: int) -> None:
    plan = a_plan(count, seed)
    plan = replace(plan, cues=plan.cues[:1])
    assert parse_plan(plan.to_json()) == plan and parse_plan(plan.to_json()).to_json() == plan.to_json()
    assert parse_bml(bml_of(plan).encode()) == plan
    assert not any(edited_blocks(plan))


def test_the_published_schema_is_that_of_the_classes_and_takes_a_plan() -> None:
    published = json.loads(SCHEMA.read_text())
    assert published == schema(), "write it anew: gesticulator plan schema > docs/schema/plan.schema.json"
    jsonschema.Draft202012Validator.check_schema(published)
    jsonschema.validate(json.loads(a_plan().to_json()), published)


BROKEN: list[tuple[tuple[str | int, ...], Any]] = [
    (("seed",), -1), (("seed",), 1.5), (("seed",), True), (("speaker",), 3), (("blocks", 1, "intensity"), 2.01),
    (("blocks", 1, "mirror"), 1), (("blocks", 1, "lexeme"), "up"), (("blocks", 1, "flag"), "loud"),
    (("blocks", 1, "draw"), None), (("blocks", 1, "extra"), 1), (("knobs", "energy"), "wild"),
    (("knobs", "hold_still"), [[1.0]]), (("knobs", "handedness"), "none"), (("words", 0, "start"), -0.1),
    (("cues", 0, "occurrence"), 0), (("drawn", "lexemes", 0), None), (("lexicon", 0, "silent"), "no"),
    (("blocks",), {}),
]


@pytest.mark.parametrize(("place", "value"), BROKEN)
def test_what_the_schema_refuses_is_refused_with_its_line(place: tuple[str | int, ...], value: Any) -> None:
    plain = json.loads(a_plan().to_json())
    part = plain
    for step in place[:-1]:
        part = part[step]
    part[place[-1]] = value
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(plain, json.loads(SCHEMA.read_text()))
    text = json.dumps(plain, indent=1)
    # The line on which the value stands, found by a mark that is put in its place.
    part[place[-1]] = "M\N{WHITE HEAVY CHECK MARK}"
    marked = json.dumps(plain, indent=1, ensure_ascii=False).split("\n")
    line = next(n for n, row in enumerate(marked, 1) if "\N{WHITE HEAVY CHECK MARK}" in row)
    with pytest.raises(InputError, match="plan, line") as told:
        parse_plan(text)
    # What is wrong within a value may stand a few lines below where it begins.
    assert abs(int(str(told.value).split("line ")[1].split(":")[0]) - line) <= 2 and told.value.advice


@pytest.mark.parametrize(("old", "new", "told"), [
    ('"seed": 7,', '"seed": 7,,', "lacks a name"), ('"seed": 7,', '"seed": 7 "x": 1,', "lacks a comma"),
    ('"seed": 7,', '"seed": 7, "seed": 8,', "twice"), ('"seed": 7,', '"seed": NaN,', "not JSON"),
    ('"seed": 7,', '"seed" 7,', "lacks the colon"), ('"seed": 7,', '"seed": 07,', "lacks a comma"),
    ('"version": 2', '"version": 3', "this version reads 1 and 2"), (FORMAT, "other", "--plan-out"),
    ('"wave"', '"wavy"', "did you mean wave"), ('"word": "Hello"', '"word": null', "a word or a time"),
    ('"time": 0.5', '"time": 99', "0 to "),
    ('"word": "Hello"', '"word": "Hullo"', "spoken 0 times"),
    ('"lexeme": 1, "silent": true', '"lexeme": 9, "silent": true', "0 to 2"),
])
def test_mistakes_are_told_with_what_is_allowed(old: str, new: str, told: str) -> None:
    text = replace(a_plan(), blocks=(replace(a_plan().blocks[0], lexeme=1), *a_plan().blocks[1:])).to_json()
    assert old in text
    line = text[:text.index(old)].count("\n") + 1
    with pytest.raises(InputError, match=told) as error:
        parse_plan(text.replace(old, new, 1), "mine.json")
    assert str(error.value).startswith(f"mine.json, line {line}:")


def test_what_would_have_no_effect_or_no_end_is_refused() -> None:
    plan = a_plan()
    other = next(name for name in NAMES if name != plan.blocks[2].name)
    renamed = replace(plan, blocks=(*plan.blocks[:2], replace(plan.blocks[2], name=other), *plan.blocks[3:]))
    with pytest.raises(InputError, match=r"blocks\[2\].name is .*edit `lexeme`"):
        parse_plan(renamed.to_json())
    # Who edits the number by hand leaves the name of the one before.
    lexeme = (plan.blocks[2].lexeme + 1) % 3  # type: ignore[operator]
    edited = replace(plan, blocks=(*plan.blocks[:2], replace(plan.blocks[2], lexeme=lexeme), *plan.blocks[3:]))
    assert parse_plan(edited.to_json()) == edited
    with pytest.raises(InputError, match=r"cues\[100\] is one of 20000; give 100 at most"):
        parse_plan(replace(plan, cues=(GestureCue("nod", time=0.5),) * 20_000).to_json())
    curve = replace(plan, curves=(KnobCurve("intensity", (0.0, 1.0), (1.0, 2.5)),))
    with pytest.raises(InputError, match=r"hold 2\.5; give 0 to 2"):
        parse_plan(curve.to_json())


def test_blocks_must_tile_the_sound_and_last_as_long_as_blocks_may() -> None:
    plan = a_plan()
    one, two, *more = plan.blocks
    for blocks, told in (((one, replace(two, start=two.start + 0.01), *more), "where the block before ends"),
                         ((replace(one, end=0.05), replace(two, start=0.05), *more), "seconds"),
                         (plan.blocks[:-1], "the end of the sound"), ((), "is empty")):
        with pytest.raises(InputError, match=told):
            parse_plan(replace(plan, blocks=blocks).to_json())


def test_what_is_edited_is_found_and_a_lock_keeps_knobs_away() -> None:
    plan = a_plan()
    b = plan.blocks
    moved = (replace(b[0], end=b[0].end + 0.02), replace(b[1], start=b[0].end + 0.02), *b[2:])
    for blocks, wanted in (((replace(b[0], silent=False), *b[1:]), [True, False, False, False]),
                           ((b[0], replace(b[1], lexeme=None), *b[2:]), [False, True, False, False]),
                           ((b[0], replace(b[1], draw=BlockDraw(7, 1, 1)), *b[2:]), [False, True, False, False]),
                           (moved, [True, True, False, False]),
                           ((replace(b[0], end=b[1].end), *b[2:]), [True, False, False]),
                           ((replace(b[0], intensity=0.5, mirror=True), *b[1:]), [False] * 4)):
        assert list(edited_blocks(replace(plan, blocks=blocks))) == wanted
    locked = (replace(b[0], locked=True), *b[1:])
    calm = PlanKnobs(energy="calm")
    assert list(edited_blocks(replace(plan, blocks=locked, knobs=calm))) == [False, True, True, True]
    assert not any(edited_blocks(replace(plan, knobs=PlanKnobs(intensity=0.3, mirror=True))))
    still = PlanKnobs(hold_still=((b[3].start + 0.5, b[3].end + 1.0),))
    assert list(edited_blocks(replace(plan, knobs=still)))[:2] == [False, False]


def test_bml_is_read_with_lines_and_without_documents_of_their_own() -> None:
    text = bml_of(a_plan())
    row = next(line for line in text.split("\n") if 'id="b2"' in line)
    for new, told in ((row.replace("<gesture", "<gestur", 1).replace("/>", ">", 1), "not XML"),
                      (row.replace('start="', 'start="x', 1), "start of a gesture"),
                      (row.replace('lexeme="', 'lexeme="q', 1), "a name of the lexicon"),
                      (row.replace('g:mirror="false"', 'g:mirror="3"'), "true or false")):
        with pytest.raises(InputError, match=told) as error:
            parse_bml(text.replace(row, new).encode(), "my.bml")
        assert str(error.value).startswith("my.bml, line ")
    with pytest.raises(InputError, match="document type"):
        parse_bml(b'<!DOCTYPE bml [<!ENTITY a "b">]><bml/>')
    with pytest.raises(InputError, match="not BML"):
        parse_bml(b"<bml/>")


def test_a_lexeme_is_changed_by_its_name_in_bml() -> None:
    plan = a_plan()
    other = NAMES[(int(plan.blocks[2].lexeme or 0) + 1) % 3]
    lines = bml_of(plan).split("\n")
    at = next(n for n, line in enumerate(lines) if 'id="b2"' in line)
    lines[at] = lines[at].replace(f'lexeme="{plan.blocks[2].name}"', f'lexeme="{other}"', 1)
    assert parse_bml("\n".join(lines).encode()).blocks[2].lexeme == NAMES.index(other)


JSON = st.recursive(st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False)
                    | st.text(), lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner), max_leaves=20)


@given(JSON, st.sampled_from([None, 1, 3]))
def test_our_reader_of_json_reads_what_pythons_does(value: Any, indent: int | None) -> None:
    text = json.dumps(value, indent=indent)
    assert parse(text, "t").value == json.loads(text)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    return dict(pairs) if len(dict(pairs)) == len(pairs) else 1 / 0  # type: ignore[return-value]


@given(st.text(alphabet='{}[]",:0123456789.-+eEtruefalsn \n\\u', max_size=40))
def test_our_reader_of_json_refuses_what_pythons_does(text: str) -> None:
    try:
        wanted = json.loads(text, object_pairs_hook=_once)
    except (ValueError, ZeroDivisionError, RecursionError):
        with pytest.raises(InputError):
            parse(text, "t")
    else:
        assert parse(text, "t").value == wanted


_BML = '<bml xmlns="http://www.bml-initiative.org/bml/bml-1.0" xmlns:g="urn:gesticulator:plan:1">'


@pytest.mark.parametrize("text", [
    '<?xml version="1.0" encoding="klingon"?><bml/>', '<?xml version="1.0" encoding="utf-7"?><bml/>',
    f"{_BML}<g:plan>{{}}</g:plan></bml>", f'{_BML}<g:plan>{{"blocks": [1]}}</g:plan></bml>',
    f'{_BML}<g:plan>{{"blocks": [], "lexicon": 5}}</g:plan></bml>',
    f'{_BML}<g:plan>{{"blocks": [], "lexicon": [{{"name": []}}]}}</g:plan></bml>',
    f'{_BML}<g:plan>{{"blocks": []}}</g:plan><gesture start="[1]" end="2"/><gesture start="1" end="2"/></bml>',
    f'{_BML}<g:plan>{{"blocks": []}}</g:plan><gesture start="null" end="2"/><gesture start="1" end="2"/></bml>',
    f"{_BML}<g:plan>{'[' * 5000}</g:plan></bml>", f"{_BML}<g:plan>{'9' * 5000}</g:plan></bml>",
    "<a>" * 100_000, f"{_BML}{'<gesture/>' * 100_001}</bml>",
])
def test_bml_of_no_plan_is_one_line(text: str) -> None:
    with pytest.raises(InputError) as error:
        parse_bml(text.encode())
    assert len(str(error.value)) < 300


class _Piece(str):
    """Text of an XML parser that counts the characters that `+` copies."""

    copied = 0

    def __add__(self, other: str) -> _Piece:
        _Piece.copied += len(self) + len(other)
        return _Piece(str(self) + str(other))

    def __radd__(self, other: str) -> _Piece:
        return _Piece(other) + self


class _PieceParser:
    """The parser of expat, which gives text as `_Piece`."""

    def __init__(self, **settings: Any) -> None:
        vars(self)["real"] = _create_parser(**settings)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.real, name)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(self.real, name, (lambda data: value(_Piece(data))) if name == "CharacterDataHandler" else value)


_create_parser = expat.ParserCreate


def _bml_work(entities: int, monkeypatch: pytest.MonkeyPatch) -> tuple[int, int]:
    """Characters of text that `+` copies, and calls, while a BML text of so many entities is read."""
    _Piece.copied = 0
    text = f'{_BML}<g:plan>{{"blocks": [], "a": "{"x&amp;" * entities}"}}</g:plan></bml>'.encode()
    monkeypatch.setattr(expat, "ParserCreate", _PieceParser)
    with counted_calls() as calls, pytest.raises(InputError):
        parse_bml(text)
    return _Piece.copied, calls.count


def test_the_work_of_reading_bml_grows_as_its_size(monkeypatch: pytest.MonkeyPatch) -> None:
    """A text comes from the XML parser in pieces: they are joined once, not each to all before it."""
    (copied, calls), (copied_twice, calls_twice) = (_bml_work(entities, monkeypatch) for entities in (50_000, 100_000))
    assert copied <= 2 * 50_000 and copied_twice <= 2 * 100_000, "characters of the text"
    assert calls < calls_twice <= 2 * calls


def test_a_plan_of_millions_of_values_is_refused_before_it_takes_gigabytes() -> None:
    with pytest.raises(InputError, match="more than 1,048,576 values"):
        parse("[" + "0," * (1 << 20) + "0]", "a")
    with pytest.raises(InputError, match="half a character"):
        parse('["\\ud800"]', "a")


def test_the_reader_of_a_page_reads_what_files_hold_and_keeps_unchanged_parts() -> None:
    reader, plan = PlanReader(), a_plan()
    first = reader.read(json.loads(plan.to_json()))
    assert first == plan
    edited = json.loads(plan.to_json())
    edited["blocks"][2]["intensity"] = 0.5
    second = reader.read(edited)
    assert second == parse_plan(json.dumps(edited))
    assert [a is b for a, b in zip(second.blocks, first.blocks, strict=True)] == [True, True, False, True]
    assert second.drawn is first.drawn and second.words is first.words
    edited["blocks"][1]["lexeme"] += 1  # values that were read may be changed
    assert reader.read(json.loads(plan.to_json())) == plan


@pytest.mark.parametrize(("place", "value"), [
    *BROKEN, (("blocks", 1, "silent"), 0), (("blocks", 1, "chosen"), {"prior": float("nan")}),
    (("made_by", "settings", "temperature"), float("inf")), (("format",), "other"), (("version",), 7), (("more",), 1),
    (("blocks",), None), (("blocks", 0), 3), (("drawn",), []), (("cues", 0, "word"), "\ud800"),
    (("made_by", "bundle"), ["\udfff"]),
])
def test_the_reader_of_a_page_refuses_what_the_reader_of_files_refuses_with_the_same_words(place: tuple[str | int, ...],
                                                                                  value: Any) -> None:
    reader, plain = PlanReader(), json.loads(a_plan().to_json())
    reader.read(plain)  # a value that is equal in Python, such as 0 and false, is not the same
    part = plain
    for step in place[:-1]:
        part = part[step]
    part[place[-1]] = value
    with pytest.raises(InputError) as of_file:
        parse_plan(json.dumps(plain, indent=1))
    with pytest.raises(InputError) as of_page:
        reader.read(plain)
    assert str(of_page.value).split(": ")[0] == str(of_file.value).split(": ")[0], "the same line"
    if value == value and value != float("inf"):
        assert str(of_page.value) == str(of_file.value)


def test_the_reader_of_a_page_refuses_plans_that_lack_a_part_hold_a_block_twice_or_are_too_deep() -> None:
    reader, whole = PlanReader(), json.loads(a_plan().to_json())
    reader.read(whole)
    with pytest.raises(InputError, match="lacks seed"):
        reader.read({name: value for name, value in whole.items() if name != "seed"})
    with pytest.raises(InputError, match="where the block before ends"):
        reader.read({**whole, "blocks": [whole["blocks"][0], *whole["blocks"]]})
    deep: list[Any] = []
    for _ in range(3000):
        deep = [deep]
    for place in ({"made_by": {"settings": deep}}, {"blocks": deep}, {"knobs": deep}):
        with pytest.raises(InputError):
            reader.read({**whole, **place})


SECTIONS: dict[str, Any] = {
    "units": (GestureUnit(0.1, 0.6, (GesturePhase("preparation", 0.1, 0.3), GesturePhase("stroke", 0.3, 0.5)), "left",
                          1.5), GestureUnit(0.6, 0.8)),
    "meanings": (PlanMeaning(0.1, 0.4, "negation", "not at all", 0.75), PlanMeaning(0.4, 0.4, "size")),
    "pins": (PosePin(0.5, "RightHand", position=(0.1, 1.2, 0.3)),
             PosePin(0.6, "Head", (0.6, 0.8, 0.0, 0.0), hold=0.25)),
    "curves": (KnobCurve("intensity", (0.0, 0.5), (1.0, 0.25)), KnobCurve("height", (0.2,), (-0.1,))),
    "alignment": SoundAlignment("ff", 2.5, (0.0, 0.5, 1.0), (0.0, 0.75, 1.25)),
}


def test_sections_stand_in_the_file_only_where_there_are_any_and_come_back_as_they_were() -> None:
    plain = a_plan().to_dict()
    assert not set(SECTIONS) & set(plain)
    for names in ([name] for name in SECTIONS), ([*SECTIONS],):
        for some in names:
            plan = replace(a_plan(), **{name: SECTIONS[name] for name in some})
            text = plan.to_json()
            assert set(SECTIONS) & set(json.loads(text)) == set(some)
            assert parse_plan(text) == plan and parse_bml(bml_of(plan).encode()) == plan
            assert PlanReader().read(json.loads(text)).to_dict() == json.loads(text)
            jsonschema.validate(json.loads(text), json.loads(SCHEMA.read_text()))


@pytest.mark.parametrize(("section", "wrong", "told"), [
    ("units", (GestureUnit(0.5, 0.5),), "units\\[0\\].start"),
    ("units", (GestureUnit(0.1, 0.6), GestureUnit(0.5, 0.9)), "give 0.6 or more"),
    ("units", (GestureUnit(0.1, 0.6, (GesturePhase("stroke", 0.0, 0.2),)),), "within 0.1 to 0.6"),
    ("units", (GestureUnit(0.1, 0.6, (GesturePhase("throw", 0.2, 0.3),)),), "one of preparation"),
    ("units", (GestureUnit(0.1, 0.6, hand="third"),), "one of left, right, both"),
    ("meanings", (PlanMeaning(0.5, 0.4, "size"),), "the smaller first"),
    ("meanings", (PlanMeaning(0.4, 0.5, "size", certainty=1.5),), "0 to 1"),
    ("pins", (PosePin(0.5, "Head"),), "neither a rotation nor a position"),
    ("pins", (PosePin(0.5, "Head", (1.0, 1.0, 0.0, 0.0)),), "not a unit quaternion"),
    ("curves", (KnobCurve("intensity", (0.0, 1.0), (1.0,)),), "1 entries for 2 times"),
    ("curves", (KnobCurve("intensity", (1.0, 1.0), (1.0, 1.0)),), "do not rise"),
    ("curves", (KnobCurve("intensity", (), ()),), "at least one"),
    ("curves", (KnobCurve("intensity", (1.0,), (1.0,)),) * 2, "one curve per knob"),
    ("alignment", SoundAlignment("ff", 2.0, (0.0, 1.0), (1.0, 1.0)), "there do not rise"),
    ("alignment", SoundAlignment("ff", 0.0, (0.0,), (0.0,)), "duration"),
    ("fingerprint", "AAAAAAA=", "is not that of the sound"),
    ("fingerprint", "AAAAAAAA" * 500, "is not that of the sound"),
])
def test_sections_that_make_no_sense_are_refused_with_their_place(section: str, wrong: Any, told: str) -> None:
    text = replace(a_plan(), **{section: wrong}).to_json()
    with pytest.raises(InputError, match=told) as error:
        parse_plan(text)
    assert f"{section}" in str(error.value)


def test_a_plan_of_version_1_is_read_as_one_of_this_version() -> None:
    text = VERSION_1.read_text(encoding="utf-8")
    plain = json.loads(text)
    assert plain["version"] == 1
    plan = parse_plan(text)
    assert plan.version == VERSION and plan.to_dict() == {**plain, "version": VERSION}
    assert PlanReader().read(plain) == plan and plain["version"] == 1, "what was given is left alone"
    assert plan.blocks[2].locked and plan.cues[0].gesture == "nod" and plan.knobs.intensity == 1.2
    old = bml_of(plan).replace(f'"version": {VERSION}', '"version": 1')
    assert parse_bml(old.encode()) == plan


@pytest.mark.parametrize("numbers", [(0, 1, 2), (0, 1, 2, 2), (0, 1, 2, -1)])
def test_numbers_of_the_first_generation_are_one_for_each_block(numbers: tuple[int, ...]) -> None:
    plan = a_plan()
    with pytest.raises(InputError, match=r"drawn\.numbers"):
        parse_plan(replace(plan, drawn=replace(plan.drawn, numbers=numbers)).to_json())
    other = replace(plan, drawn=replace(plan.drawn, numbers=(0, 1, 9, 3)))
    assert parse_plan(other.to_json()) == other and edited_blocks(other) == (False, False, True, False)


def test_every_version_up_to_this_one_can_be_upgraded() -> None:
    assert set(UPGRADES) == set(range(1, VERSION))


@pytest.mark.parametrize("version", [0, 3, True, "2", None, [1], {"a": 1}, 1.5])
def test_other_versions_are_refused(version: Any) -> None:
    with pytest.raises(InputError, match="this version reads"):
        parse_plan(json.dumps({**a_plan().to_dict(), "version": version}))
