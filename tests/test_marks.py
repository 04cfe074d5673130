"""Marks of gestures: never spoken, in any file, and each is a gesture at the word after it."""

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from performances import example
from pipecat_gesticulator.marks import timed_words, without_marks
from recogniser_samples import FILES, Words

from data_module.errors import InputError
from data_module.motion.rotation import angle_between, conjugate, multiply
from data_module.text.marks import mark_name, marked_text, marked_words
from data_module.text.transcript import read_transcript, with_transcript
from data_module.types import Speech, Word
from gesticulator.directing.cues import stroke_of_word
from gesticulator.directing.marks import (
    LATEST,
    SOURCE,
    MarkWarning,
    StreamMarks,
    gesture_of_mark,
    mark_cues,
    with_mark_cues,
)
from gesticulator.directing.named_gestures import span_of_gesture
from gesticulator.live.limits import ServerLimits
from gesticulator.live.protocol import StreamRequest
from gesticulator.live.session import session_opener
from gesticulator.options import InferenceOptions
from gesticulator.plan.gestures import GESTURES
from gesticulator.plan.plan import GestureCue

ROOT = Path(__file__).parents[1]
RATE = 16000
SPOKEN: Words = (("And", 0.0, 0.3), ("so,", 0.3, 0.55), ("my", 0.7, 0.9), ("fellow", 0.9, 1.4),
                 ("Americans,", 1.4, 2.1), ("ask", 2.6, 2.9), ("not", 3.0, 3.4))
SPELT = {
    "[shrug]": "shrug", "[Shrug]": "shrug", "[gesture:shrug]": "shrug", "[count:3]": "count 3",
    "[size:big]": "size big", "[point:left]": "point left", "[point_left]": "point left",
    "[thumbs up]": "thumbs up", "[none]": "none",
    '<mark name="gesture.shrug"/>': "shrug", "<mark name='gesture.open_palms' />": "open palms",
    "<bookmark mark='gesture.shrug'/>": "shrug", '<bookmark mark="gesture.count_3"/>': "count 3",
    "\N{SHRUG}": "shrug", "\N{SHRUG}\U0001f3fd\u200d\u2642\ufe0f": "shrug", "\N{RAISED HAND}\ufe0f": "stop",
}
"""How a mark may be written, and its name."""


@pytest.mark.parametrize(("mark", "name"), SPELT.items())
def test_every_spelling_of_a_mark(mark: str, name: str) -> None:
    assert marked_text(f"I have {mark} no idea") == ("I have no idea", ((7, name),))
    assert marked_text(f"I have {mark}no idea") == ("I have no idea", ((7, name),))
    assert marked_text(f"{mark} no idea") == ("no idea", ((0, name),))
    assert marked_text(f"yes.{mark}No") == ("yes. No", ((5, name),))


@pytest.mark.parametrize("text", ["see [1] and [2]", "a [link](page.html)", "[]", "[ shrug ]", "a < b > c",
                                  "[a" + "b" * 50 + "]", "3 <marker> x", "\N{PARTY POPPER} hi"])
def test_what_is_no_mark_stays(text: str) -> None:
    assert marked_text(text) == (text, ())


def test_notes_of_sounds_and_marks_of_others_are_left_out_in_silence() -> None:
    assert marked_text('so [Music] then <mark name="line2"/>go [BLANK_AUDIO]') == ("so then go ", ())


def test_a_mark_in_pieces() -> None:
    """Streams cut at spaces: "[thumbs up]" comes as two words, and a tag as three."""
    found, late = marked_words(["well", "[thumbs", "up]", "good", "<mark", 'name="gesture.shrug"', "/>then", "end",
                                "[nod]"])
    assert [(text, marks) for text, marks in found if text] == [
        ("well", ()), ("good", ("thumbs up",)), ("then", ("shrug",)), ("end", ())]
    assert late == ("nod",)


PIECE = st.sampled_from(["well", "so,", "no", "[1]", "x[y", "a]b", "<", "\N{PARTY POPPER}", "...", *SPELT])


@given(st.lists(PIECE, max_size=12), st.booleans())
def test_words_and_texts_agree(pieces: list[str], spaced: bool) -> None:
    """A text and the list of its words give the same words and the same marks, in the same order."""
    text, marks = marked_text((" " if spaced else "  ").join(pieces))
    words, late = marked_words(pieces)
    assert [part for word, _ in words for part in word.split()] == text.split()
    assert [name for _, named in words for name in named] + list(late) == [name for _, name in marks]
    assert all(at == 0 or text[at - 1].isspace() for at, _ in marks)


@given(st.lists(PIECE, max_size=12))
def test_the_clients_package_finds_the_same_marks(pieces: list[str]) -> None:
    """It cannot import ours: what it leaves out of the voice is what the server takes for marks."""
    text = " ".join(pieces)
    assert without_marks(text).split() == marked_text(text)[0].split()
    words = timed_words(text, 2.0, 0.1)
    found, late = marked_words([word for word, _, _ in words])
    joined, marks = marked_text(text)
    assert [part for word, _ in found for part in word.split()] == joined.split()
    assert [name for _, named in found for name in named] + list(late) == [name for _, name in marks]


# ------------------------------------------------------------------------------------------------------- files

def _with_marks(words: Words, places: list[tuple[int, str]]) -> Words:
    """Marks before words, as a writer of the text puts them there."""
    out = list(words)
    for at, mark in places:
        out[at] = (f"{mark} {out[at][0]}", *out[at][1:])
    return out


def _read(folder: Path, suffix: str, content: str, seconds: float = 4.0) -> tuple[Word, ...]:
    path = folder / f"a{suffix}"
    path.write_text(content, encoding="utf-8")
    speech = Speech((0.1 * np.random.default_rng(0).standard_normal(round(seconds * RATE))).astype(np.float32), RATE)
    return with_transcript(speech, read_transcript(path, speech))[0].words or ()


# The recogniser hears no mark: a mark in its output is a text that was synthesised, or edited. Its pieces are no words.
MARKED = sorted(set(FILES) - {"whisper.cpp", "whisper.cpp -ml 1", "vtt, rolling", "srt, highlighted", "srt, coloured",
                              "vtt, highlighted", "text", "ctm", "ttml", "ttml, words", "ttml, syllables"})
WRITTEN = {**FILES, "textgrid": (".TextGrid", lambda words: _textgrid(words))}


def _textgrid(words: Words) -> str:
    rows = "".join(f'{start}\n{end}\n"{word.replace(chr(34), chr(34) * 2)}"\n' for word, start, end in words)
    return ('File type = "ooTextFile"\nObject class = "TextGrid"\n\n0\n4\n<exists>\n1\n"IntervalTier"\n"words"\n0\n4\n'
            f"{len(words)}\n{rows}")


@pytest.mark.parametrize("name", [*MARKED, "textgrid"])
@settings(max_examples=6)
@given(places=st.lists(st.tuples(st.integers(0, len(SPOKEN) - 1), st.sampled_from(sorted(SPELT))), min_size=1,
                       max_size=3, unique_by=lambda place: place[0]))
def test_marks_are_never_in_the_words_of_any_file(name: str, tmp_path_factory: pytest.TempPathFactory,
                                                  places: list[tuple[int, str]]) -> None:
    """The words and times are those without the marks, and each mark is on the word after it."""
    suffix, write = WRITTEN[name]
    folder = tmp_path_factory.mktemp("marks")
    plain = _read(folder, suffix, write(SPOKEN))
    marked = _read(folder, suffix, write(_with_marks(SPOKEN, places)))
    assert [(w.text, w.start, w.end) for w in marked] == [(w.text, w.start, w.end) for w in plain]
    wanted = {at: (SPELT[mark],) for at, mark in places}
    assert [w.marks for w in marked] == [wanted.get(at, ()) for at in range(len(SPOKEN))]


@pytest.mark.parametrize("kind", [".srt", ".vtt"])
def test_subtitles_have_marks_and_no_other_brackets(kind: str, tmp_path: Path) -> None:
    head = "WEBVTT\n\n" if kind == ".vtt" else ""
    words = _read(tmp_path, kind, f"{head}1\n00:00:00.000 --> 00:00:01.000\n[Music] I have [1] <i>no</i>\n\n"
                  "2\n00:00:01.000 --> 00:00:02.000\n[shrug]\n\n3\n00:00:02.000 --> 00:00:04.000\nidea "
                  "<mark name='gesture.nod'/>at all [wave]\n")
    assert [(word.text, word.marks) for word in words] == [
        ("I", ()), ("have", ()), ("no", ()), ("idea", ("shrug",)), ("at", ("nod",)), ("all", ("wave",))]


# ------------------------------------------------------------------------------------------------------- gestures

def _marked(*marks: tuple[str, ...]) -> tuple[Word, ...]:
    return tuple(Word("no" if n % 2 else "Well,", 0.5 * n, 0.5 * n + 0.4, names) for n, names in enumerate(marks))


def test_each_mark_is_a_cue_at_its_word() -> None:
    cues = mark_cues(_marked((), ("shrug",), ("none",), ("gesture:nod", "wave"), ("what is this",)))
    assert cues == (GestureCue("shrug", "no", 1, source=SOURCE), GestureCue("nod", "no", 2, source=SOURCE),
                    GestureCue("wave", "no", 2, source=SOURCE))


def test_unknown_marks_are_warned_of_once() -> None:
    words = _marked(("shurg",), ("shurg", "nod"), ("none",), ("jump about",))
    with pytest.warns(MarkWarning) as given_:
        options = with_mark_cues(InferenceOptions(), words, 60.0)
    assert len(given_) == 1 and "[shurg], [jump about]" in str(given_[0].message)
    assert "did you mean [shrug]?" in str(given_[0].message)
    assert [cue.gesture for cue in options.cues] == ["nod"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert with_mark_cues(InferenceOptions(), (), 60.0) == InferenceOptions()


@given(st.sampled_from(sorted(GESTURES)), st.sampled_from(" _-:."), st.booleans())
def test_the_spelling_of_a_name_does_not_matter(gesture: str, between: str, capitals: bool) -> None:
    spelt = gesture.replace(" ", between)
    assert gesture_of_mark(f"gesture:{spelt.upper() if capitals else spelt}") == gesture
    assert mark_name(mark_name(spelt)) == mark_name(spelt)


# ------------------------------------------------------------------------------------------ a performance, a stream

def _sound(seconds: float = 6.0) -> Speech:
    return example(seconds)


def _words(**marks: str) -> tuple[Word, ...]:
    """Twelve words, marked by their number: w5="shrug"."""
    return tuple(Word(f"w{n}", 0.4 * n + 0.3, 0.4 * n + 0.6, (marks[f"w{n}"],) if f"w{n}" in marks else ())
                 for n in range(12))


def _texts(words: tuple[Word, ...]) -> list[Word]:
    """The same words with their marks written out."""
    return [Word("".join(f"[{name}] " for name in word.marks) + word.text, word.start, word.end) for word in words]


def _around(changed: np.ndarray, stroke: float) -> None:
    """A shrug changes the frames at these seconds, all round its stroke, but for what smoothing adds."""
    before, after = span_of_gesture("shrug")
    assert stroke - before - 0.2 < changed[0] < stroke - 0.2 and stroke + 0.2 < changed[-1] < stroke + after + 0.2


def test_a_mark_makes_the_gesture_of_a_cue(system: Any) -> None:
    speech = _sound()
    plain = system(Speech(speech.samples, RATE, _words()))
    marked = system(Speech(speech.samples, RATE, _words(w5="shrug", w8="none")))
    cued = system(Speech(speech.samples, RATE, _words()), cues=(GestureCue("shrug", "w5"),))
    np.testing.assert_array_equal(marked.rotations, cued.rotations)
    changed = np.flatnonzero((marked.rotations != plain.rotations).any((1, 2))) / 60
    _around(changed, stroke_of_word(_words()[5]))
    plan = marked.plan()
    assert plan.cues == (GestureCue("shrug", "w5", 1, source=SOURCE),)
    assert plan.to_dict()["cues"][0]["source"] == "mark"
    assert [word.text for word in plan.words] == [word.text for word in _words()]


def _streamed(system: Any, words: list[list[Word]], seconds: float = 6.0, when: float = 0.0) -> np.ndarray:
    """Frames of a stream that gets its words in these calls, once `when` seconds were fed."""
    stream = system.stream(RATE, text=True)
    samples = _sound(seconds).samples
    frames = []
    for at in range(0, len(samples), 1600):
        if at >= when * RATE and words:
            for call in words:
                stream.add_words(call)
            words = []
        frames.append(stream.feed(samples[at:at + 1600]).rotations)
    frames.append(stream.finish().rotations)
    return np.concatenate(frames)


def test_a_stream_makes_the_gestures_of_a_file(system: Any) -> None:
    words = _words(w5="shrug", w9="wave")
    file = system(Speech(_sound().samples, RATE, words))
    np.testing.assert_allclose(_streamed(system, [_texts(words)]), file.rotations, atol=1e-9)


def test_a_mark_waits_for_the_next_words(system: Any) -> None:
    words = _texts(_words())
    alone = [*words[:5], Word("[shrug]", 2.3, 2.3)]
    whole = [*words[:5], Word("[shrug] w5", words[5].start, words[5].end)]
    np.testing.assert_array_equal(_streamed(system, [alone, words[5:]]), _streamed(system, [whole, words[6:]]))


def test_a_stream_makes_four_marks_a_second_at_most_and_repeats_once() -> None:
    """Each costs computing time in every block around it, so a message full of them would hold up other streams."""
    marks, names = StreamMarks(rotations=True), ("shrug", "wave", "nod", "point you", "plea", "thumbs up")
    for number in range(100):
        word = "".join(f"[{name}] " * 3 for name in names[number % 6:])
        marks.take([Word(f"{word}no", 5.0 + 0.02 * number, 5.01 + 0.02 * number)], 0.0)
    times = np.array([cue.time for cue in marks.cues()])
    assert len(times) >= 8 and (times[4:] - times[:-4] >= 1.0).all()
    own = np.array([cue.time for cue in marks.cues() if cue.cue.gesture == "nod"])
    assert (np.diff(own) >= max(span_of_gesture("nod")[0], LATEST)).all()
    marks.interrupt(4.0)  # all are broken off or forgotten, and may be marked again
    marks.take([Word("[shrug] no", 5.0, 5.2)], 4.0)
    assert [cue.cue.gesture for cue in marks.cues() if cue.broken_off is None] == ["shrug"]


def test_no_more_marks_may_wait_than_a_plan_may_have() -> None:
    """One message with thousands of marks would hold up every other stream of a server for seconds."""
    marks = StreamMarks(rotations=True)
    marks.take([Word("[shrug]yes", 10.0 + number, 10.5 + number) for number in range(100)], 0.0)
    with pytest.raises(InputError, match="more than 100 wait"):
        marks.take([Word("[shrug]no", 200.0, 200.5)], 0.0)
    assert len(marks.cues()) == 100
    marks.take([Word("[shrug]no", 200.0, 200.5)], 50.0)  # half of the earlier ones are over


def _added(marked: np.ndarray, plain: np.ndarray) -> np.ndarray:
    """[T - 1] radians by which what a gesture adds to a joint changes from frame to frame, at most."""
    added = multiply(conjugate(plain), marked)
    dots = np.abs(np.sum(added[1:] * added[:-1], axis=-1)).clip(0, 1)
    turns: np.ndarray = 2 * np.arccos(dots).max(axis=1)
    return turns


@pytest.fixture(scope="module")
def whole(system: Any) -> float:
    """Radians per frame of a shrug that was known in time."""
    marked, plain = (_streamed(system, [_texts(words)]) for words in (_words(w5="shrug"), _words()))
    return float(_added(marked, plain).max())


@pytest.mark.parametrize("when", [1.5, 2.2, 2.6, 3.0, 4.0, 5.0])
def test_a_word_that_comes_late_makes_no_jump(system: Any, when: float, whole: float) -> None:
    """The gesture is whole and somewhat later, or there is none."""
    marked, plain = (_streamed(system, [_texts(words)], when=when) for words in (_words(w5="shrug"), _words()))
    changed = np.flatnonzero((marked != plain).any((1, 2))) / 60
    if when > 4:
        assert len(changed) == 0, "the word was over"
    if len(changed):
        assert changed[-1] - changed[0] > 1.2 and changed[0] < 2.4 + LATEST
        assert _added(marked, plain).max() < 1.3 * whole
    assert len(changed) or when > 2.0


def test_an_interruption_takes_the_gesture_back(system: Any) -> None:
    def frames(mark: bool) -> tuple[np.ndarray, int]:
        stream = system.stream(RATE, text=True)
        stream.add_words(_texts(_words(w2="shrug", w5="wave") if mark else _words()))
        made = stream.feed(_sound(5.0).samples).rotations
        cut = stream.interrupt(1.6)
        return np.concatenate([made[:cut.first], cut.rotations, stream.idle(3.0).rotations]), cut.first

    whole = _added(*(_streamed(system, [_texts(words)]) for words in (_words(w2="shrug"), _words()))).max()
    (marked, cut), (plain, _) = frames(True), frames(False)
    # What smoothing leaves of it for some frames more is under a thousandth of a degree.
    changed = np.flatnonzero(angle_between(marked, plain).max(axis=1) > np.radians(1e-3))
    assert changed[0] < cut < changed[-1] < cut + 80, "the shrug is blended out in 1.2 s, the wave is forgotten"
    assert _added(marked, plain)[cut - 2:].max() < 1.3 * whole


def test_the_server_makes_marks_and_echoes_words_without_them(system: Any) -> None:
    request = StreamRequest(RATE, options={"text": True})
    session = session_opener(system, ServerLimits())("one", request)
    words = [{"text": word.text, "start": word.start, "end": word.end}
             for word in [*_texts(_words(w3="shrug")), Word("[wave]", 5.1, 5.1)]]
    answers = [*session.obey({"type": "words", "words": words}), *session.feed(_sound().samples),
               *session.obey({"type": "finish"})]
    events = [json.loads(message) for answer in answers for message in answer.messages if isinstance(message, str)]
    assert [event["text"] for event in events if event["type"] == "word"] == [f"w{n}" for n in range(12)]
    made = np.concatenate([frames.rotations for answer in answers for frames in answer.frames])
    plain = _streamed(system, [list(_words())])
    changed = np.flatnonzero((made != plain).any((1, 2))) / 60
    _around(changed, stroke_of_word(_words()[3]))


def test_a_text_with_more_marks_than_a_plan_may_have_gives_a_plan_that_can_be_read() -> None:
    words = [Word(f"word{n}", 0.01 * n, 0.01 * n + 0.01, ("shrug",)) for n in range(201)]
    with pytest.warns(MarkWarning, match="202 gestures are asked for, and the first 100 are"):
        options = with_mark_cues(InferenceOptions(cues=(GestureCue("nod", time=0.1),)), words, 2.2)
    assert len(options.cues) == 100 and options.cues[0].gesture == "nod"
    assert len(with_mark_cues(InferenceOptions(), words[:150], 60.0).cues) == 150
