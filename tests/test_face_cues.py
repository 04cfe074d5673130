"""Expressions of the face at cues and marks, in files and streams; the body is the same with them and without."""

import argparse
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from face_samples import still
from hypothesis import given, settings
from hypothesis import strategies as st
from performances import example

from data_module.errors import InputError
from data_module.text.marks import marked_text
from data_module.types import Array, Speech, Word
from gesticulator import Gesticulator
from gesticulator.directing.cues import stroke_of_word
from gesticulator.directing.marks import MarkWarning, expression_of_mark, gesture_of_mark, mark_cues, warn_of_unknown
from gesticulator.face.motion import FaceMotion
from gesticulator.face.phones import PhonesWarning
from gesticulator.face.track import FaceCues, FaceTrack
from gesticulator.jobs import infer_arguments, settings_of
from gesticulator.options import InferenceOptions
from gesticulator.plan.gestures import EXPRESSIONS, GESTURES
from gesticulator.plan.plan import GestureCue

RATE = 16000
TIMES = np.arange(0, 10, 0.05)


def _at(curve: Array, time: float) -> float:
    return float(np.interp(time, TIMES, curve))


def _shown(*cues: tuple[float, str], mood: float = 0.0) -> tuple[Array, Array]:
    cued = FaceCues()
    for time, name in cues:
        cued.add(time, name)
    return cued.at(TIMES, mood)


def test_a_smile_comes_and_goes() -> None:
    mood, brows = _shown((2.0, "smile"), mood=-0.2)
    assert _at(mood, 1.95) == _at(mood, 5.0) == pytest.approx(-0.2) and _at(mood, 3.0) == pytest.approx(0.9)
    assert not brows.any() and np.abs(np.diff(mood)).max() < 0.25


def test_a_mood_lasts_until_the_next_and_a_smile_passes_over_it() -> None:
    mood, _ = _shown((1.0, "happy"), (3.0, "smile"), (7.0, "sad"), (8.5, "neutral"), mood=0.1)
    expected = {0.9: 0.1, 2.5: 0.7, 4.0: 0.9, 6.5: 0.7, 8.0: -0.7, 9.5: 0.1}
    assert {time: _at(mood, time) for time in expected} == pytest.approx(expected)


def test_brows_of_a_moment() -> None:
    assert _at(_shown((2.0, "raise brows"))[1], 2.4) == pytest.approx(1.0)
    assert _at(_shown((2.0, "frown"))[1], 2.5) == pytest.approx(-1.0)
    assert not _shown((2.0, "frown"))[1][TIMES > 4].any()


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(st.floats(0, 8), st.sampled_from(sorted(EXPRESSIONS))), max_size=8), st.floats(-1, 1),
       st.floats(1, 9))
def test_what_is_forgotten_no_longer_shows(cues: list[tuple[float, str]], base: float, now: float) -> None:
    whole, short = FaceCues(), FaceCues()
    for time, name in cues:
        whole.add(time, name)
        short.add(time, name)
    short.forget(now)
    times = now + np.arange(0, 5, 0.05)
    mood, brows = whole.at(times, base)
    np.testing.assert_allclose(short.at(times, base), (mood, brows), atol=1e-12)
    assert np.abs(mood).max() <= 1.0


def test_an_interruption_takes_back_marks_and_not_cues_of_the_user() -> None:
    for lasting, smiles in ((False, 0.0), (True, 0.9)):
        face = FaceTrack(InferenceOptions(face="full"))
        face.express(2.0, "smile", lasting)
        face.interrupt(1.0)
        assert face.frames(0, still(3.0)).smile.max() == pytest.approx(smiles, abs=1e-6)


@pytest.mark.parametrize(("mark", "name"), [("[smile]", "smile"), ("[mood:happy]", "happy"), ("[Mood: Sad]", "sad"),
                                            ("[raise_brows]", "raise brows"), ("[happy]", "happy"),
                                            ("[face:frown]", "frown"), ("[mood:neutral]", "neutral")])
def test_marks_of_a_face_are_not_spoken_and_are_no_gestures(mark: str, name: str) -> None:
    text, marks = marked_text(f"Well {mark} hello")
    assert text == "Well hello" and [expression_of_mark(found) for _, found in marks] == [name]
    assert gesture_of_mark(marks[0][1]) is None
    with warnings.catch_warnings():
        warnings.simplefilter("error", MarkWarning)
        warn_of_unknown(found for _, found in marks)


def test_gestures_and_expressions_have_different_names() -> None:
    assert not set(EXPRESSIONS) & set(GESTURES)
    assert [cue.gesture for cue in mark_cues([Word("hello", 0.0, 0.5, ("smile", "wave"))])] == ["wave", "smile"]


def test_a_cue_of_the_face_needs_one_on_the_command_line() -> None:
    parser = argparse.ArgumentParser()
    infer_arguments(parser)
    options = settings_of(parser.parse_args(["a.wav", "--cue", "1=smile", "--face", "full"])).options
    assert not options.directed and not options.shaped
    with pytest.raises(InputError, match="--face full"):
        settings_of(parser.parse_args(["a.wav", "--cue", "1=smile", "--face", "lips"]))


# ------------------------------------------------------------------------------------------ a performance, a stream

def _speech(*marks: str, words: bool = True) -> Speech:
    """Four seconds, the third word of which has the marks."""
    spoken = tuple(Word("well", 0.4 * n + 0.3, 0.4 * n + 0.6, marks if n == 2 else ()) for n in range(9))
    return replace(example(4.0), words=spoken if words else None)


def _streamed(system: Gesticulator, speech: Speech, **options: Any) -> tuple[Array, FaceMotion | None]:
    stream = system.stream(RATE, text=speech.words is not None, **options)
    if speech.words:
        stream.add_words([Word("".join(f"[{name}] " for name in word.marks) + word.text, word.start, word.end)
                          for word in speech.words])
    parts = [stream.feed(speech.samples[at:at + 1600]) for at in range(0, len(speech.samples), 1600)]
    parts.append(stream.finish())
    faces = [part.face for part in parts if part.face is not None]
    from gesticulator.face.motion import joined

    return np.concatenate([part.rotations for part in parts]), joined(faces) if faces else None


@pytest.mark.filterwarnings(f"ignore::{PhonesWarning.__module__}.PhonesWarning")
def test_a_marked_smile_in_a_file_and_a_stream(system: Gesticulator) -> None:
    file = system(_speech("smile"), face="full")
    rotations, face = _streamed(system, _speech("smile"), face="full")
    assert face is not None
    np.testing.assert_allclose(file.rotations, rotations, atol=1e-9)
    start = stroke_of_word(_speech().words[2])  # type: ignore[index]
    smile = file.face.smile
    assert not smile[:int(start * 60)].any() and smile[int((start + 0.5) * 60):int((start + 1.5) * 60)].min() > 0.4
    # The lips of a file follow the words, those of a stream the sound; a smile is smaller where the mouth is open.
    assert np.array_equal(face.smile > 0, smile > 0)
    cued = system(_speech(), face="full", cues=(GestureCue("smile", "well", 3),))
    np.testing.assert_array_equal(cued.face.smile, smile)
    again = system(_speech(), face="full", plan=file.plan())
    np.testing.assert_array_equal(again.face.values(), file.face.values())


@pytest.mark.filterwarnings(f"ignore::{PhonesWarning.__module__}.PhonesWarning")
@pytest.mark.parametrize(("words", "options"), [
    (True, {"face": "full", "mood": 0.5}), (False, {"face": "lips", "mouth": 2.0})])
def test_the_body_is_the_same_with_a_face_in_a_file_and_a_stream(system: Gesticulator, words: bool,
                                                                 options: dict[str, Any]) -> None:
    plain, marked = _speech(words=words), _speech(*(("smile",) if words else ()), words=words)
    made = system(marked, **options)
    assert made.face is not None and made.rotations.tobytes() == system(plain).rotations.tobytes()
    streamed, none = _streamed(system, plain)
    rotations, face = _streamed(system, marked, **options)
    assert none is None and face is not None and len(face) == len(rotations)
    assert rotations.tobytes() == streamed.tobytes()
