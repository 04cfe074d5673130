"""What words call for: cue phrases and their guards, the budget, and the gestures in files, plans and streams."""

import json
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from performances import example, system

from data_module.types import Speech, Word
from gesticulator.directing.cues import TimedCue
from gesticulator.directing.meaning_cues import CalledGesture, cue_pattern, meaning_cues, spoken_text
from gesticulator.directing.meanings import AGAIN, LEVELS, Called, Level, MeaningTrack, chosen
from gesticulator.directing.named_gestures import span_of_gesture
from gesticulator.performance import Performance
from gesticulator.plan.gestures import ALIASES, GESTURES, REPERTOIRE
from gesticulator.plan.plan import GestureCue
from gesticulator.plan.plan_file import parse_plan


def labels(text: str, language: str = "en", score: float = 0.7) -> dict[str, str]:
    """Label -> the word that carries it."""
    words = text.split()
    return {one.label: words[one.word] for one in meaning_cues(language).called(words) if one.score >= score}


# ------------------------------------------------------------------------------------------------------- patterns

@pytest.mark.parametrize(("pattern", "text", "stroke"), [
    ("do not *know", "Well, I don't know.", "know"),
    ("a|the *cat", "here is THE cat!", "cat"),
    ("^ *stop", "Wait. Stop it", "stop"),
    ("*stop $", "stop it now, stop", "stop"),
    ("so? *tired", "I am tired", "tired"),
    ("keep _ing *on", "they keep going on", "on"),
    ("*increas~", "it increased", "increased"),
    ("*have_to go", "we have to go", "have"),
    ("no *way", "There's no\u2019 way", "way"),
])
def test_a_pattern_marks_the_word_that_carries_the_stroke(pattern: str, text: str, stroke: str) -> None:
    spoken = spoken_text(text.split())
    *_, last = cue_pattern(pattern).regex.finditer(spoken.text)
    assert last["stroke"].split()[0] == stroke


@pytest.mark.parametrize(("pattern", "text"), [
    ("^ *stop", "do stop"), ("*stop $", "stop it"), ("no *idea", "no good idea"), ("*cat", "concat cats"),
    ("*right ?", "right, he said"),
])
def test_a_pattern_does_not_match_across_other_words(pattern: str, text: str) -> None:
    assert not cue_pattern(pattern).regex.search(spoken_text(text.split()).text)


def test_a_pause_is_a_boundary_where_there_are_no_marks() -> None:
    words = ["so", "we", "stop", "then", "go"]
    pattern = cue_pattern("*stop $")
    assert not pattern.regex.search(spoken_text(words).text)
    assert pattern.regex.search(spoken_text(words, [0.0, 0.0, 0.6, 0.0, 0.0]).text)


def test_a_pattern_without_a_word_is_refused() -> None:
    with pytest.raises(ValueError, match="no word"):
        cue_pattern("^ _ $")


@given(st.lists(st.text(min_size=0, max_size=8), max_size=30))
def test_any_words_are_read_and_every_call_lies_within_them(words: list[str]) -> None:
    for one in meaning_cues("en").called(words):
        assert 0 <= one.first <= one.word <= one.last < len(words)
        assert 0.0 < one.score <= 1.0


# ------------------------------------------------------------------------------------------------------- meanings

@pytest.mark.parametrize(("text", "label", "word"), [
    ("I honestly have no idea.", "shrug", "idea."),
    ("There are three reasons for it.", "number_three", "three"),
    ("Not a single one came.", "sweep_no", "single"),
    ("It changed the whole thing.", "surround", "whole"),
    ("Hold on, let me check.", "stop_palm", "on,"),
    ("Thank you so much for coming.", "hands_over_heart", "Thank"),
    ("But nobody asked me.", "contrast_flip", "But"),
    ("On the other hand it is slow.", "weigh_options", "hand"),
    ("We cannot go back.", "head_shake", "cannot"), ("It is a very different plan.", "contrast_flip", "different"),
    ("They met in the past three years.", "point_back", "years."), ("Is it here? No. They went.", "head_shake", "No."),
    ("And that is personal.", "hands_over_heart", "personal."), ("It costs far more in the end.", "increase", "more"),
    ("We will move America forward.", "point_ahead", "forward."), ("Two of them, so much to do.", "big_spread", "much"),
    ("It did not help, prices grow.", "increase", "grow."),  # a negation ends with its clause
])
def test_what_is_said_calls_for_its_meaning_at_its_word(text: str, label: str, word: str) -> None:
    assert labels(text).get(label) == word


@pytest.mark.parametrize(("text", "label"), [
    ("Feel free to stop by.", "stop_palm"), ("She hates small talk.", "small_pinch"),
    ("I don't love it.", "hands_over_heart"), ("We did not grow this year.", "increase"),
    ("The stock exchange is closed.", "exchange"), ("I will let you know.", "shrug"),
    ("He left his keys on the left-handed shelf.", "point_left"), ("It did not work at all.", "surround"),
    ("It did not grow.", "increase"),
])
def test_idioms_homonyms_and_negations_do_not_call(text: str, label: str) -> None:
    assert label not in labels(text)


def test_prose_that_was_written_to_be_read_gets_fewer() -> None:
    cue = "however, the growth of the port was the same."
    prose = ("the duties of the collector of the port of the city, upon which the amount of the revenue depends, and "
             "the state of the law by which the sum of the fees of the office is fixed, are of such weight")
    talk = ("you know what I think, we just really do not get what you want, so let me look at that, okay, you and I "
            "know what this is and why we do it, thank you")
    assert len(labels(f"{talk}. {cue} {talk}")) > len(labels(f"{prose}. {cue} {prose}"))


@pytest.mark.parametrize("part", ["tuning", "held_out"])
def test_meant_words_fire_and_the_same_words_elsewhere_do_not(part: str) -> None:
    kinds = json.loads((Path(__file__).parent / "data" / "meant_words.json").read_text(encoding="utf-8"))[part]
    assert sum(bool(labels(text).keys() & set(meant)) for text, meant in kinds["hits"]) >= 24
    assert sum(bool(labels(text)) for text in kinds["traps"]) <= 3
    assert sum(bool(labels(text)) for text in kinds["neutral"]) <= 1


def test_every_meaning_has_a_gesture_that_offends_nobody() -> None:
    rows = {language: meaning_cues(language).gestures for language in ("en", "de", "es")}
    assert all(set(gestures) <= set(rows["en"]) for gestures in rows.values())
    names = {name for gestures in rows.values() for name in gestures.values()}
    assert len(names - set(GESTURES)) <= 5, names - set(GESTURES)
    assert not [name for name in names & set(GESTURES) if REPERTOIRE[ALIASES.get(name, name)].offensive]


# --------------------------------------------------------------------------------------------------------- budget

def call(at: float, score: float = 0.75, label: str = "nod") -> Called:
    return Called(CalledGesture(0, 0, 0, label, "nod", score), Word("yes", at, at + 0.3),
                  TimedCue(GestureCue("nod", time=at), at))


calls = st.lists(st.builds(call, st.floats(0.0, 120.0), st.sampled_from([0.6, 0.7, 0.8, 0.9]),
                           st.sampled_from(["nod", "shrug", "stop_palm"])), max_size=40)


@given(calls, st.lists(st.floats(0.0, 120.0), max_size=4), st.sampled_from([LEVELS["few"], LEVELS["normal"]]))
def test_the_budget_keeps_its_distances(found: list[Called], taken: list[float], level: Level) -> None:
    out = chosen(found, level, taken=taken, begin=1.0)
    assert all(b.cue.time - a.cue.time >= level.apart for a, b in zip(out, out[1:], strict=False))
    for n, one in enumerate(out):
        assert one.gesture.score >= level.score and one.cue.span[0] >= 1.0
        assert all(abs(one.cue.time - other) >= level.apart for other in taken)
        assert not any(other.gesture.label == one.gesture.label and one.cue.time - other.cue.time < AGAIN
                       for other in out[:n])


def test_a_better_one_near_wins_and_a_worse_one_does_not() -> None:
    assert [one.cue.time for one in chosen([call(5.0, 0.7), call(6.0, 0.9, "shrug")], LEVELS["normal"])] == [6.0]
    assert [one.cue.time for one in chosen([call(5.0, 0.9), call(6.0, 0.7, "shrug")], LEVELS["normal"])] == [5.0]


@pytest.mark.parametrize(("language", "called", "label", "guarded"), [
    ("de", "Warum tust du das?", "palms_question", "Ich weiß, warum du das tust."),
    ("de", "Genau, so ist es.", "nod", "Genau wie damals war es."),
    ("de", "Wir kommen zusammen.", "join_hands", "Das hängt mit der Frage zusammen."),
    ("de", "Es gibt nur eine Frage.", "number_one", "Es ist nur ein bisschen kalt."),
    ("es", "No tengo nada.", "sweep_no", "Eso, nada más."),
    ("es", "Lo perdí todo.", "surround", "Vino a pesar de todo."),
    ("es", "Lo haremos mañana.", "point_ahead", "Canta por la mañana."),
])
def test_german_and_spanish_have_guards_of_their_own(language: str, called: str, label: str, guarded: str) -> None:
    assert label in labels(called, language) and label not in labels(guarded, language)


def spread(text: str) -> tuple[Word, ...]:
    """Two words a second from 1 s on, without pauses that count."""
    return tuple(Word(word, 1.0 + 0.5 * n, 1.4 + 0.5 * n) for n, word in enumerate(text.split()))


IDEA = "well and I have no idea"
"""The last word begins at 3.5 s."""
TEXT = (f"{IDEA} about it and then he came in and said stop! and then I said yes, of course, we went on and so it was "
        "and all of them had seen it and nobody knew what to do and who knows. and then he left")


@given(st.lists(st.integers(1, 6), min_size=1, max_size=12))
def test_words_that_come_in_pieces_well_ahead_give_the_gestures_of_a_file(pieces: list[int]) -> None:
    words = spread(TEXT)
    whole = MeaningTrack("normal")
    whole.add(words)
    expected = [(one.cue.gesture, one.time) for one in whole.cues(100.0)]
    track, now = MeaningTrack("normal"), 0.0
    track.add(words)
    for step in pieces * 20:
        now += step / 4
        track.cues(now)
    assert [(one.cue.gesture, one.time) for one in track.cues(100.0)] == expected
    assert {name for name, _ in expected} >= {"shrug", "nod"}


def test_words_that_come_too_late_are_left_out() -> None:
    track = MeaningTrack("normal")
    track.cues(30.0)
    track.add(spread(TEXT))
    assert all(one.time > 30.0 for one in track.cues(100.0))


@pytest.mark.parametrize(("marks", "cues", "still"), [
    ({5: "none"}, (), ()), ({5: "wave"}, (), ()), ({3: "wave"}, (), ()), ({}, (6.0,), ()), ({}, (), ((3.2, 3.4),))],
    ids=["none asked", "mark", "mark before", "cue", "hands rest"])
def test_cues_marks_and_rest_outrank_what_the_words_call_for(
        marks: dict[int, str], cues: tuple[float, ...], still: tuple[tuple[float, float], ...]) -> None:
    free, bound = MeaningTrack("normal"), MeaningTrack("normal", list(cues), still=list(still))
    free.add(spread(IDEA))
    bound.add([replace(word, marks=(marks[at],) if at in marks else ()) for at, word in enumerate(spread(IDEA))])
    assert [meaning.gesture for meaning in free.meanings()] == ["shrug"] and not bound.meanings()


def test_an_interruption_breaks_off_what_has_begun_and_drops_the_rest() -> None:
    track = MeaningTrack("normal")
    track.add(spread(TEXT))
    begun = track.cues(3.6)
    assert [one.cue.gesture for one in begun] == ["shrug"]
    track.forget(3.7)
    assert [(one.cue.gesture, one.broken_off) for one in track.cues(100.0)] == [("shrug", 3.7)]


# ------------------------------------------------------------------------------------- files, plans and streams

@lru_cache(maxsize=1)
def spoken() -> Speech:
    """Eight seconds in which "idea" is said at 3.5 s."""
    return replace(example(8.0), words=spread(IDEA))


@lru_cache(maxsize=2)
def take(level: str) -> Performance:
    return system()(spoken(), meaning=level)


def test_words_move_the_body_at_their_gesture_and_nowhere_else() -> None:
    plain, shown = take("off").rotations, take("normal").rotations
    moved = np.flatnonzero((plain != shown).any(axis=(1, 2))) / 60.0
    entry, = take("normal").plan().meanings
    before, after = span_of_gesture("shrug")
    assert entry.source == "words" and (entry.kind, entry.gesture, entry.word) == ("shrug", "shrug", "idea")
    assert entry.time is not None and 3.3 <= entry.time <= 3.85
    assert entry.time - before - 0.5 <= moved[0] <= entry.time and moved[-1] <= entry.time + after + 0.5
    assert not take("off").plan().meanings


def test_a_plan_replays_its_meanings_and_what_is_deleted_is_left_out() -> None:
    plan = parse_plan(take("normal").plan().to_json())
    assert plan == take("normal").plan()
    assert np.array_equal(system()(spoken(), plan=plan).rotations, take("normal").rotations)
    assert np.array_equal(system()(spoken(), plan=replace(plan, meanings=())).rotations, take("off").rotations)
    assert np.array_equal(system()(spoken(), plan=plan, meaning="off").rotations, take("off").rotations)


def test_a_stream_whose_words_come_first_shows_what_a_file_shows() -> None:
    stream = system().stream(text=True)
    stream.add_words(spoken().words or ())
    parts = [stream.feed(piece) for piece in np.array_split(spoken().samples, 50)]
    made = np.concatenate([part.rotations for part in (*parts, stream.finish())])
    # The gesture begins before its word is heard, so that the times of the word place it and its size is the plain one.
    words_alone = MeaningTrack("normal")
    words_alone.add(spoken().words or ())
    assert np.array_equal(made, system()(spoken(), plan=replace(
        take("normal").plan(), meanings=words_alone.meanings())).rotations)
    heard, unheard = take("normal").plan().meanings, words_alone.meanings()
    assert [one.gesture for one in heard] == [one.gesture for one in unheard]
    assert all(abs((a.time or 0.0) - (b.time or 0.0)) < 0.25 for a, b in zip(heard, unheard, strict=True))
