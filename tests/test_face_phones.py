"""The mouth by the words: pronunciations, and their phones placed in what the lips network hears."""

import warnings

import numpy as np
import pytest
from face_samples import RATE as SAMPLE_RATE
from face_samples import VisemeSpan, spoken
from hypothesis import given, settings
from hypothesis import strategies as st

from data_module.types import Word
from gesticulator.face.lips import Lips
from gesticulator.face.phones import SLACK, PhonedWord, PhonesWarning, pronunciations, spoken_weights, with_phones
from gesticulator.face.track import face_of
from gesticulator.face.visemes import CLOSED, RATE, SILENT, VISEMES, opening
from gesticulator.options import InferenceOptions

AA, IH, E, DD, RR, SS = (VISEMES.index(name) for name in ("aa", "ih", "E", "DD", "RR", "SS"))


def _weights(visemes: list[int], sure: float = 0.5) -> np.ndarray:
    """[T, 15] with one viseme more likely than the others in each frame."""
    out = np.full((len(visemes), 15), (1.0 - sure) / 14)
    out[np.arange(len(visemes)), visemes] = sure
    return out


def test_phones_are_placed_where_they_are_heard() -> None:
    # "mama": the second m is drowned, and one frame of it is heard as likely as the vowel
    heard = [SILENT] * 10 + [CLOSED] * 4 + [AA] * 6 + [AA] * 4 + [AA] * 6 + [SILENT] * 10
    weights = _weights(heard)
    weights[21, CLOSED], weights[21, AA] = 0.4, 0.2
    mama = PhonedWord(0.2, 0.6, ((CLOSED, AA, CLOSED, AA),))
    found = with_phones(weights, [mama])
    assert found is not None
    best = found.argmax(axis=1)
    runs = [int(best[0]), *(int(b) for a, b in zip(best, best[1:], strict=False) if a != b)]
    assert runs == [SILENT, CLOSED, AA, CLOSED, AA, SILENT]
    shut = np.flatnonzero(best == CLOSED)
    assert shut[:4].tolist() == [10, 11, 12, 13] and 21 in shut and len(shut) == 6
    assert (found[shut, CLOSED] == 1.0).all() and not found[np.setdiff1d(np.arange(5, 35), shut), CLOSED].any()


@pytest.mark.parametrize(("vowel", "told"), [(E, E), (IH, IH)])
def test_the_sound_chooses_among_the_ways_to_say_a_word(vowel: int, told: int) -> None:
    read = PhonedWord(0.1, 0.4, ((RR, E, DD), (RR, IH, DD)))
    found = with_phones(_weights([SILENT] * 5 + [RR] * 4 + [vowel] * 7 + [DD] * 4 + [SILENT] * 5), [read])
    assert found is not None and (found[9:16].argmax(axis=1) == told).all()


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.lists(st.tuples(st.floats(0, 0.5), st.floats(0.01, 0.8),
                                                     st.lists(st.integers(1, 14), max_size=8)), max_size=6))
def test_any_words_leave_weights_and_what_is_far_from_words(seed: int, parts: list[tuple[float, float, list[int]]]
                                                           ) -> None:
    weights = np.random.default_rng(seed).dirichlet(np.full(15, 0.3), 150)
    words, at = [], 0.5
    for gap, length, way in parts:
        words.append(PhonedWord(at + gap, at + gap + length, (tuple(way),) if way else ()))
        at += gap + length
    found = with_phones(weights, words)
    if found is None:
        return
    assert found.shape == weights.shape and found.min() >= 0.0
    np.testing.assert_allclose(found.sum(axis=1), 1.0)
    assert np.array_equal(found[:int((0.5 - SLACK) * RATE)], weights[:int((0.5 - SLACK) * RATE)])
    assert np.array_equal(found[int((at + SLACK) * RATE) + 2:], weights[int((at + SLACK) * RATE) + 2:])


def test_speech_without_a_pause_is_cut_into_paths_that_follow_it() -> None:
    heard = ([CLOSED] * 5 + [AA] * 10) * 200
    words = [PhonedWord(0.3 * at, 0.3 * at + 0.3, ((CLOSED, AA),)) for at in range(200)]
    found = with_phones(_weights(heard), words)
    assert found is not None and (found.argmax(axis=1) == heard).mean() > 0.98


def test_words_of_other_speech_are_left_to_the_sound() -> None:
    weights = _weights([SILENT] * 10 + [SS] * 40 + [SILENT] * 10, 0.9)
    assert with_phones(weights, [PhonedWord(0.2, 1.0, ((CLOSED, AA, CLOSED, AA),))]) is None
    with pytest.warns(PhonesWarning, match="not heard"):
        assert spoken_weights(weights, [Word("mama", 0.2, 1.0)]) is weights


def test_pronunciations_are_those_of_the_dictionary() -> None:
    pytest.importorskip("pocketsphinx")
    ways = pronunciations(["The", "quick", "map", "was", "read", "..."])
    assert ways is not None and ways[-1] == ()
    assert ways[2] == ((CLOSED, AA, CLOSED),)
    assert {way[1] for way in ways[4]} == {E, IH}


@pytest.mark.parametrize("text", ["Der Baum ist nicht die Mappe", "Ça déjà été à où"])
def test_without_a_source_the_lips_follow_the_sound(text: str) -> None:
    weights = _weights([SILENT] * 50)
    words = [Word(word, 0.1 * at, 0.1 * at + 0.1) for at, word in enumerate(text.split())]
    with pytest.warns(PhonesWarning, match="no pronunciations"):
        assert spoken_weights(weights, words) is weights


def _spoken_words(track: list[VisemeSpan]) -> list[Word]:
    """The words of `face_samples.spoken`, with the times of their phones."""
    sounding = [span for span in track if span.viseme != SILENT]
    parts = np.split(np.arange(len(sounding)), [at + 1 for at, (a, b) in enumerate(zip(sounding, sounding[1:],
                                                strict=False)) if b.start - a.end > 0.3])
    assert len(parts) == 3
    return [Word(text, sounding[part[0]].start, sounding[part[-1]].end)
            for text, part in zip(("mama", "oh-no", "fish"), parts, strict=True)]


def test_closures_are_sure_with_the_words_of_speech() -> None:
    pytest.importorskip("pocketsphinx")
    made, track = spoken()
    sound = made.speech.samples
    lips = Lips()
    lips.feed(sound)
    lips.finish()
    alone = lips.weights
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        lips.follow(_spoken_words(track))
    count = len(sound) * RATE // SAMPLE_RATE
    truth, times = np.full(count, SILENT), (np.arange(count) + 0.5) / RATE
    for span in track:
        truth[(times >= span.start) & (times < span.end)] = span.viseme
    right = [(found[:count].argmax(axis=1) == truth)[truth > SILENT].mean() for found in (lips.weights, alone)]
    assert right[0] > 0.75 and right[0] >= right[1]
    mouth = opening(lips.rows(0, count))
    closures = [(span.start + span.end) / 2 for span in track if span.viseme == CLOSED]
    assert len(closures) == 2
    for middle in closures:
        at = round(middle * RATE - 0.5)
        assert mouth[at - 2:at + 3].min() < 0.05
    again = [face_of(InferenceOptions(face="lips"), sound, (), made.motion, _spoken_words(track)).visemes
             for _ in range(2)]
    assert made.face is not None and not np.array_equal(again[0], made.face.visemes)
    assert np.array_equal(again[0], again[1])
