"""From speech to a performance in Python: which path is taken, and what each option does to the blocks."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from untrained import PLAIN, SILENT, untrained

from data_module.controls import Controls, Curve
from data_module.errors import InputError
from data_module.types import Speech, Word
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.config import with_settings
from gesticulator.gesticulator import Gesticulator
from gesticulator.performance import Performance
from gesticulator.systems.paper import approach_rest

RATE = 16000
WORDS = (Word("heavy", 0.2, 0.6), Word("bread", 0.6, 1.1), Word("rises", 3.3, 3.8), Word("slowly", 3.8, 4.4))


@pytest.fixture(scope="module")
def plain() -> Gesticulator:
    """One that knows nothing of text, gate and style editing."""
    return Gesticulator(untrained(*PLAIN))


def sound(seconds: float = 4.6) -> np.ndarray:
    """Voice with a pause from 1.2 to 3.2 s."""
    rng = np.random.default_rng(0)
    t = np.arange(round(seconds * RATE)) / RATE
    voice = np.sign(np.sin(2 * np.pi * 130 * t)) * np.clip(np.sin(2 * np.pi * 3.1 * t), 0, 1) ** 2
    voice[(t > 1.2) & (t < 3.2)] = 0
    return (0.2 * voice + 0.001 * rng.normal(size=len(t))).astype(np.float32)


SPEECH = Speech(sound(), RATE)


def same(one: Performance, two: Performance) -> bool:
    return (np.array_equal(one.motion.rotations, two.motion.rotations) and np.array_equal(one.scores, two.scores)
            and np.array_equal(one.lexemes, two.lexemes))


def without(bundle: Bundle, *parts: str) -> Bundle:
    kept = dataclasses.replace(bundle, text=None) if "text" in parts else bundle
    return kept.with_parts(**dict.fromkeys(set(parts) - {"text"}))


def test_a_rest_closes_half_of_the_way_with_every_block_and_never_swings() -> None:
    last = np.array([1.0, -2.0], np.float32)
    # Generated: a swing about (3, 0), the same in every block.
    swing = np.array([[4.0, 1.0], [2.0, -1.0], [4.0, 1.0], [2.0, -1.0]], np.float32)
    first = approach_rest(last, swing, 0.5)
    np.testing.assert_allclose(first, [[1.25, -1.75], [1.5, -1.5], [1.75, -1.25], [2.0, -1.0]])
    for _ in range(12):
        last = approach_rest(last, swing, 0.5)[-1]
    np.testing.assert_allclose(last, [3.0, 0.0], atol=2e-3)


def test_without_words_the_ear_alone_decides(g: Gesticulator) -> None:
    bundle = g.bundle
    assert g.bundle.interpreter_named("lstm") is bundle.runners["interpreter"]
    assert g.bundle.interpreter_named("lstm", text=True) is bundle.runners["interpreter_text"]
    heard = g(SPEECH)
    deaf_to_text = Gesticulator(without(bundle, "interpreter_text", "style_text", "text"))
    assert same(heard, deaf_to_text(SPEECH)), "the same as a bundle that cannot read"
    unread = deaf_to_text(dataclasses.replace(SPEECH, words=WORDS), meaning="off")
    assert same(unread, heard), "and such a bundle reads no words"
    read = g(dataclasses.replace(SPEECH, words=WORDS))
    assert not np.array_equal(read.scores, heard.scores) and not np.array_equal(read.codes, heard.codes)
    half_deaf = Gesticulator(without(bundle, "style_text"))(dataclasses.replace(SPEECH, words=WORDS))
    assert np.array_equal(read.scores[0], half_deaf.scores[0]) and not np.array_equal(read.codes[0], half_deaf.codes[0])
    assert heard.decided.notes == () and read.decided.notes == ()


def test_the_words_themselves_matter_and_when_they_are_said(g: Gesticulator) -> None:
    def scores(words: tuple[Word, ...]) -> np.ndarray:
        return g(dataclasses.replace(SPEECH, words=words)).scores

    other = tuple(dataclasses.replace(word, text="thunder") for word in WORDS)
    later = tuple(dataclasses.replace(word, start=word.start + 0.1, end=word.end + 0.1) for word in WORDS)
    assert not np.array_equal(scores(WORDS), scores(other)) and not np.array_equal(scores(WORDS), scores(later))


@pytest.mark.parametrize(("options", "said"), [
    ({"text": "heavy bread"}, "text"), ({"activity": 0.5}, "gate"), ({"controls": Controls(speed=0.3)}, "use_control")])
def test_what_a_plain_bundle_cannot_do_is_refused(options: dict[str, Any], said: str, plain: Gesticulator) -> None:
    with pytest.raises(InputError, match=said):
        plain(SPEECH, **options)


def test_a_plain_bundle_takes_spoken_words_and_free_hands_in_its_stride(plain: Gesticulator) -> None:
    assert same(plain(SPEECH), plain(dataclasses.replace(SPEECH, words=WORDS), meaning="off"))
    assert same(plain(SPEECH), plain(SPEECH, controls=Controls()))


def test_another_word_encoder_than_the_one_of_training_is_refused(g: Gesticulator) -> None:
    assert g.bundle.text is not None
    other = dataclasses.replace(g.bundle, text=dataclasses.replace(g.bundle.text, width=301))
    with pytest.raises(InputError, match="minilm"):
        _ = Gesticulator(other).word_encoder


def test_activity_is_the_gates_threshold_and_the_gate_hears_no_lexemes(g: Gesticulator) -> None:
    assert all(block.gate is None for block in g(SPEECH).decided.blocks), "the gate is not asked"
    gate = np.array([block.gate for block in g(SPEECH, activity=0.4).decided.blocks])
    assert ((gate >= 0) & (gate <= 1)).all()
    middle = float(np.median(gate))
    second = g(SPEECH, activity=1 - middle, temperature=2.0, seed=3)
    assert [block.gate for block in second.decided.blocks] == gate.tolist()
    closed = gate < middle
    assert closed.any() and not closed.all()
    assert set(second.lexemes[closed].tolist()) <= set(SILENT)
    # The open blocks choose freely: drawn hot from all twelve, some are not silent.
    assert not set(second.lexemes[~closed & ~second.blocks.silent].tolist()) <= set(SILENT)


def test_what_is_asked_of_the_hands_is_heard_and_nothing_asked_is_free(g: Gesticulator) -> None:
    free = g(SPEECH)
    assert same(free, g(SPEECH, controls=Controls()))
    made = [g(SPEECH, controls=Controls(**{name: value}))
            for name, value in (("height", 0.3), ("height", -0.1), ("speed", 0.8), ("radius", 0.4))]
    for i, one in enumerate(made):
        assert not np.array_equal(one.motion.rotations, free.motion.rotations)
        assert not any(np.array_equal(one.motion.rotations, two.motion.rotations) for two in made[:i])
        assert not np.array_equal(one.scores, free.scores), "the lexeme interpreter hears it too"


def test_a_curve_changes_nothing_before_its_time(g: Gesticulator) -> None:
    steady = g(SPEECH, controls=Controls(height=0.1))
    rising = g(SPEECH, controls=Controls(height=Curve((0.0, 3.3, 3.4), (0.1, 0.1, 0.4))))
    before = steady.blocks.edges[1:] <= 3.3
    assert before.any() and not before.all()
    np.testing.assert_array_equal(steady.scores[before], rising.scores[before])
    assert not np.array_equal(steady.scores[~before], rising.scores[~before])


def test_silence_has_silent_lexemes_unless_the_settings_let_it_go(g: Gesticulator) -> None:
    free = Gesticulator(dataclasses.replace(g.bundle, config=with_settings(g.bundle.config,
                                                                           ["silence.mask=false"])))
    for own, masks in ((g, True), (free, False)):
        made = [own(SPEECH, temperature=5.0, seed=seed) for seed in range(2)]
        silent = made[0].blocks.silent
        assert silent.any() and not silent.all()
        played = {int(lexeme) for one in made for lexeme in one.lexemes[silent]}
        assert (played <= set(SILENT)) == masks


def test_joints_that_no_data_moved_stay_where_the_mean_has_them(g: Gesticulator) -> None:
    bounds = g.bundle.statistics.bounds.copy()
    bounds[:, 6:9] = 0.0
    statistics = dataclasses.replace(g.bundle.statistics, bounds=bounds)
    bundle = dataclasses.replace(g.bundle, statistics=statistics)
    made = Gesticulator(bundle)(SPEECH, fps=20)
    poses = made.motion.rotations[:, 2]
    # The seed is the rest pose; after the first block it is the mean pose to the end.
    np.testing.assert_allclose(poses[20:], np.broadcast_to(poses[20], poses[20:].shape), atol=1e-6)
    assert np.ptp(made.motion.rotations[20:, 3], axis=0).max() > 1e-3
