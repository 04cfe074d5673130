"""Files of gesture plans: reading returns what was written, errors name the place, and the schema agrees."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_module.errors import InputError
from gesticulator.plan import plan as plans
from gesticulator.plan.plan import Block, DrawnBlocks, GesturePhase, GestureUnit, LexemeChoice, PlanKnobs
from gesticulator.plan.plan_file import parse_plan, plan_from, schema

SCHEMA = Path(__file__).resolve().parent.parent / "docs" / "schema" / "plan.schema.json"
NAMES = ("both hands up", "right hand out", "rest")


def a_plan(count: int = 4, seed: int = 7) -> plans.GesturePlan:
    rng = np.random.default_rng(seed)
    edges = tuple(np.round(np.concatenate([[0.0], np.cumsum(rng.uniform(0.2, 0.5, count))]), 3).tolist())
    lexemes = tuple(rng.integers(0, 3, count).tolist())
    flags = (*("onset",) * (count - 1), "boundary")
    blocks = tuple(Block(edges[i], edges[i + 1], lexemes[i], i == 0, plans.BlockDraw(seed, 0, i), flags[i],
                         NAMES[lexemes[i]], alternatives=(LexemeChoice(1, NAMES[1], -0.5),)) for i in range(count))
    return plans.GesturePlan(
        plans.FORMAT, plans.VERSION, {"gesticulator": "0", "settings": {"temperature": 1.0}},
        plans.PlanSound("a.wav", edges[-1], 16000, "00"),
        seed, 0, "ann", "lstm", DrawnBlocks(edges, flags, (True, *(False,) * (count - 1)), lexemes, PlanKnobs()),
        blocks,
        cues=(plans.GestureCue("wave", "Hello"), plans.GestureCue("nod", time=0.5, mirror=True)),
        words=(plans.PlanWord("Hello", 0.1, 0.4), plans.PlanWord('<"there">&', 0.4, 0.6)),
        lexicon=tuple(plans.LexemeName(n, name, n == 2) for n, name in enumerate(NAMES)),
        gestures=(plans.GestureName("wave", "waves"),), notes=("one",))


@given(st.integers(1, 12), st.integers(0, 99))
def test_a_plan_is_read_as_it_was_written(count: int, seed: int) -> None:
    plan = a_plan(count, seed)
    plan = replace(plan, cues=plan.cues[:1])
    assert parse_plan(plan.to_json()) == plan and parse_plan(plan.to_json()).to_json() == plan.to_json()
    assert not any(plans.edited_blocks(plan))


def test_the_published_schema_is_that_of_the_classes_and_takes_a_plan() -> None:
    published = json.loads(SCHEMA.read_text())
    assert published == schema(), "write it anew: gesticulator plan schema > docs/schema/plan.schema.json"
    jsonschema.Draft202012Validator.check_schema(published)
    jsonschema.validate(json.loads(a_plan().to_json()), published)


BROKEN: list[tuple[tuple[str | int, ...], Any]] = [
    (("seed",), -1), (("seed",), 1.5), (("seed",), True), (("speaker",), 3), (("blocks", 1, "intensity"), 2.01),
    (("blocks", 1, "mirror"), 1), (("blocks", 1, "lexeme"), "up"), (("blocks", 1, "flag"), "loud"),
    (("blocks", 1, "draw"), None), (("blocks", 1, "extra"), 1), (("knobs", "energy"), "wild"),
    (("knobs", "hold_still"), [[1.0]]), (("words", 0, "start"), -0.1),
    (("cues", 0, "occurrence"), 0), (("drawn", "lexemes", 0), None), (("lexicon", 0, "silent"), "no"),
    (("blocks",), {}),
]


@pytest.mark.parametrize(("place", "value"), BROKEN)
def test_what_the_schema_refuses_is_refused_with_its_place(place: tuple[str | int, ...], value: Any) -> None:
    plain = json.loads(a_plan().to_json())
    part = plain
    for step in place[:-1]:
        part = part[step]
    part[place[-1]] = value
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(plain, json.loads(SCHEMA.read_text()))
    with pytest.raises(InputError, match=r"^plan: ") as error:
        plan_from(plain)
    assert plans.place_of(place) in str(error.value) and error.value.advice


@pytest.mark.parametrize(("old", "new", "message"), [
    ('"seed": 7,', '"seed": 7,,', "line 6: is not valid JSON"), ('"seed": 7,', '"seed": NaN,', "not valid JSON"),
    ('"seed": 7,', '"seed": 1e999,', "is not valid JSON"),
    ('"seed": 7,', f'"seed": {2**64},', "seed is 18446744073709551616"),
    ('"version": 2', '"version": 3', "this version reads 2"), (plans.FORMAT, "other", "--plan-out"),
    ('"wave"', '"wavy"', "did you mean wave"), ('"word": "Hello"', '"word": null', "a word or a time"),
    ('"time": 0.5', '"time": 99', "0 to "),
    ('"word": "Hello"', '"word": "Hullo"', "spoken 0 times"),
    ('"lexeme": 1, "silent": true', '"lexeme": 9, "silent": true', "0 to 2"),
    ('"intensity": 1.0', '"size": 1.0', "size is unknown; allowed here: "), ("Hello", "\\ud800", "is not valid JSON"),
])
def test_mistakes_are_reported_with_what_is_allowed(old: str, new: str, message: str) -> None:
    text = replace(a_plan(), blocks=(replace(a_plan().blocks[0], lexeme=1), *a_plan().blocks[1:])).to_json()
    assert old in text
    with pytest.raises(InputError, match=message) as error:
        parse_plan(text.replace(old, new, 1), "mine.json")
    assert str(error.value).startswith("mine.json: ")


def test_a_plan_that_lacks_a_part_or_is_too_deep_is_refused() -> None:
    whole = json.loads(a_plan().to_json())
    with pytest.raises(InputError, match="seed"):
        plan_from({name: value for name, value in whole.items() if name != "seed"})
    deep = "[" * 3000 + "]" * 3000
    with pytest.raises(InputError, match="nested"):
        parse_plan(a_plan().to_json().replace('"settings": {', f'"settings": {{"x": {deep}, ', 1))


def test_what_would_have_no_effect_or_no_end_is_refused() -> None:
    plan = a_plan()
    with pytest.raises(InputError, match=r"cues\[100\] is one of 20000; give 100 at most"):
        parse_plan(replace(plan, cues=(plans.GestureCue("nod", time=0.5),) * 20_000).to_json())
    curve = replace(plan, curves=(plans.KnobCurve("intensity", (0.0, 1.0), (1.0, 2.5)),))
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
                           ((b[0], replace(b[1], draw=plans.BlockDraw(7, 1, 1)), *b[2:]), [False, True, False, False]),
                           (moved, [True, True, False, False]),
                           ((replace(b[0], end=b[1].end), *b[2:]), [True, False, False]),
                           ((replace(b[0], intensity=0.5, mirror=True), *b[1:]), [False] * 4)):
        assert list(plans.edited_blocks(replace(plan, blocks=blocks))) == wanted
    locked = (replace(b[0], locked=True), *b[1:])
    calm = PlanKnobs(energy="calm")
    assert list(plans.edited_blocks(replace(plan, blocks=locked, knobs=calm))) == [False, True, True, True]
    assert not any(plans.edited_blocks(replace(plan, knobs=PlanKnobs(intensity=0.3, mirror=True))))
    still = PlanKnobs(hold_still=((b[3].start + 0.5, b[3].end + 1.0),))
    assert list(plans.edited_blocks(replace(plan, knobs=still)))[:2] == [False, False]


SECTIONS: dict[str, Any] = {
    "units": (GestureUnit(0.1, 0.6, (GesturePhase("preparation", 0.1, 0.3), GesturePhase("stroke", 0.3, 0.5)), "left",
                          1.5), GestureUnit(0.6, 0.8)),
    "meanings": (plans.PlanMeaning(0.1, 0.4, "negation", "not at all", 0.75), plans.PlanMeaning(0.4, 0.4, "size")),
    "pins": (plans.PosePin(0.5, "RightHand", position=(0.1, 1.2, 0.3)),
             plans.PosePin(0.6, "Head", (0.6, 0.8, 0.0, 0.0), hold=0.25)),
    "curves": (plans.KnobCurve("intensity", (0.0, 0.5), (1.0, 0.25)), plans.KnobCurve("height", (0.2,), (-0.1,))),
}


def test_sections_stand_in_the_file_only_where_there_are_any_and_come_back_as_they_were() -> None:
    plain = a_plan().to_dict()
    assert not set(SECTIONS) & set(plain)
    for names in ([name] for name in SECTIONS), ([*SECTIONS],):
        for some in names:
            plan = replace(a_plan(), **{name: SECTIONS[name] for name in some})
            text = plan.to_json()
            assert set(SECTIONS) & set(json.loads(text)) == set(some)
            assert parse_plan(text) == plan
            jsonschema.validate(json.loads(text), json.loads(SCHEMA.read_text()))


@pytest.mark.parametrize(("section", "wrong", "told"), [
    ("units", (GestureUnit(0.1, 0.6, (GesturePhase("shrug", 0.0, 0.2),)),), "units\\[0\\].phases\\[0\\].kind"),  # type: ignore[arg-type]
    ("meanings", (plans.PlanMeaning(0.4, 0.5, "size", certainty=1.5),), "<= 1.0"),
    ("pins", (plans.PosePin(0.5, "Head", (1.0, 1.0, 0.0, 0.0)),), "not a unit quaternion"),
    ("curves", (plans.KnobCurve("intensity", (0.0, 1.0), (1.0,)),), "1 entries for 2 times"),
    ("curves", (plans.KnobCurve("intensity", (1.0, 1.0), (1.0, 1.0)),), "do not rise"),
    ("curves", (plans.KnobCurve("intensity", (), ()),), "at least one"),
    ("curves", (plans.KnobCurve("intensity", (1.0,), (1.0,)),) * 2, "one curve per knob"),
    ("fingerprint", "AAAAAAA=", "fingerprint: Expected"),
])
def test_sections_that_make_no_sense_are_refused_with_their_place(section: str, wrong: Any, told: str) -> None:
    text = replace(a_plan(), **{section: wrong}).to_json()
    with pytest.raises(InputError, match=told) as error:
        parse_plan(text)
    assert f"{section}" in str(error.value)


@pytest.mark.parametrize("numbers", [(0, 1, 2), (0, 1, 2, 2), (0, 1, 2, -1)])
def test_numbers_of_the_first_generation_are_one_for_each_block(numbers: tuple[int, ...]) -> None:
    plan = a_plan()
    with pytest.raises(InputError, match=r"drawn\.numbers"):
        parse_plan(replace(plan, drawn=replace(plan.drawn, numbers=numbers)).to_json())
    other = replace(plan, drawn=replace(plan.drawn, numbers=(0, 1, 9, 3)))
    assert parse_plan(other.to_json()) == other and plans.edited_blocks(other) == (False, False, True, False)


@pytest.mark.parametrize("version", [0, 1, 3, True, "2", None, [1], {"a": 1}, 1.5])
def test_other_versions_are_refused(version: Any) -> None:
    with pytest.raises(InputError, match="this version reads"):
        parse_plan(json.dumps({**a_plan().to_dict(), "version": version}))
