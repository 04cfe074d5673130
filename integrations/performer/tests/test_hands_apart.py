"""Hands that act apart, a trunk that lives, styles that can be heard: what the performer does with a manner."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gesticulator_performer import hands, styles, text, voices
from gesticulator_performer.hands import HANGING_LEVEL, Manner, PhraseHands
from gesticulator_performer.strokes import LEFT, RIGHT, StrokeSet
from gesticulator_performer.torso import FPS
from gesticulator_performer.types import Phrase, Played, Spoken
from procedural import played as perform_by
from procedural import procedural_strokes

from data_module.motion import kinematics
from data_module.types import Array

MANNER = Manner(both=0.4, dominant=0.7, switch=0.7, hanging=0.5, falling=0.1, gain=1.15, hold=1.3, drift=0.6,
                small_beats=0.2, eagerness=0.2, trunk=1.0)


@pytest.fixture(scope="module")
def strokes() -> StrokeSet:
    return procedural_strokes()


@pytest.fixture(scope="module")
def spoken() -> Spoken:
    rng = np.random.default_rng(4)
    return voices.speak(text.compose(rng, 45.0, "train"), "rms", rng)


@pytest.fixture(scope="module")
def played(spoken: Spoken, strokes: StrokeSet) -> Played:
    return perform_by(spoken, strokes, 1, MANNER)


def _hands(played: Played) -> Array:
    positions = kinematics.positions_of(played.motion) - played.motion.root_positions[:, None]
    return positions[:, [played.motion.skeleton.index(side + "Hand") for side in ("Left", "Right")]]


def test_phrases_are_given_to_the_hands_as_the_manner_says() -> None:
    phrases = [Phrase(2.0 * k, 2.0 * k + 1.5, 0.0) for k in range(4000)]
    drawn = hands.hands_of_phrases(phrases, MANNER, RIGHT, np.random.default_rng(0))
    shares = [np.mean([p.acting == acting for p in drawn]) for acting in ((LEFT,), (RIGHT,), (LEFT, RIGHT))]
    assert shares == pytest.approx([0.6 * 0.3, 0.6 * 0.7, 0.4], abs=0.03)
    assert np.mean([p.idle == hands.HANG for p in drawn]) == pytest.approx(0.5, abs=0.03)
    kept = np.mean([a.acting == b.acting for a, b in zip(drawn, drawn[1:], strict=False)])
    again = 0.7 * sum(share ** 2 for share in shares) + 0.3
    assert kept == pytest.approx(again, abs=0.03)


def test_strokes_of_a_phrase_are_of_its_hand() -> None:
    order = (PhraseHands(0.0, 2.0, (LEFT,), hands.HANG), PhraseHands(2.5, 4.0, (LEFT, RIGHT), hands.STAY))
    left, right, both = hands.weights_at(order, 1.0)
    assert left > 5 * both and left > 20 * right
    left, right, both = hands.weights_at(order, 2.2)
    assert both > 5 * left == 5 * right, "a stroke sets out before its phrase"


def test_the_idle_hand_hangs_sits_low_or_stays() -> None:
    def levels(idle: str, seed: int = 0) -> list[tuple[float, float]]:
        order = [PhraseHands(1.0, 3.0, (LEFT, RIGHT), hands.STAY), PhraseHands(3.4, 5.0, (LEFT,), idle)]
        calm = replace(MANNER, falling=0.0)
        return hands.waiting_levels(order, [0.0, 0.0], [1.0], 0.7, calm, np.random.default_rng(seed))[RIGHT]

    assert len(levels(hands.STAY)) == 1
    assert levels(hands.HANG)[-1][1] == HANGING_LEVEL
    assert all(0.25 <= levels(hands.LOW, seed)[-1][1] <= 0.55 for seed in range(5))
    # Before a phrase after a long pause the hands rise earlier.
    first = np.mean([levels(hands.STAY, seed)[0][0] for seed in range(60)])
    assert first == pytest.approx(1.0 - 0.7, abs=0.05)


def test_hands_act_apart_and_no_hand_freezes(played: Played) -> None:
    assert np.corrcoef(_hands(played)[..., 1].T)[0, 1] < 0.5
    joints = [played.motion.skeleton.index(name) for name in ("Head", "LeftHand", "RightHand")]
    positions = kinematics.positions_of(played.motion) - played.motion.root_positions[:, None]
    speed = np.linalg.norm(np.gradient(positions[:, joints], 1.0 / FPS, axis=0), axis=-1).max(axis=1)
    moves = np.convolve(speed > 0.02, np.ones(60), "valid")
    assert moves.min() > 0, "no second in which head and hands stand still"


def test_holds_last_through_short_pauses(spoken: Spoken, strokes: StrokeSet, played: Played) -> None:
    order = sorted(spoken.phrases, key=lambda p: p.start)
    pauses = [(a.end, b.start) for a, b in zip(order, order[1:], strict=False) if 0.4 < b.start - a.end < 1.6]
    held = [stroke for stroke in played.strokes for a, b in pauses if a - 0.45 <= stroke.hold_end <= b]
    spans = [(s.hold_end, min((o.start for o in played.strokes if o.start > s.beat), default=99.0)) for s in held]
    assert all(end <= following + 1e-9 or end > 0 for end, following in spans)
    # What is held in a pause lasts to its end, or to the next stroke of the arm. A hold that was cut for a stroke which
    # could not be put in time, and was left out, is not extended again.
    starts = np.array([stroke.start for stroke in played.strokes])
    full = [stroke.hold_end >= min(end - 0.15, starts[starts >= stroke.hold_end - 1e-6].min(initial=np.inf)) - 1e-6
            for stroke in held for a, end in pauses if a - 0.45 <= stroke.hold_end <= end and stroke.beat < a + 0.1]
    assert len(full) >= 5 and np.mean(full) >= 0.8


# --- Styles


def _constant(amplitude: float, tempo: float) -> styles.StyleTrack:
    return styles.StyleTrack(np.array([0.0]), np.array([[amplitude, tempo]]))


def _said(style: styles.StyleTrack) -> Spoken:
    rng = np.random.default_rng(9)
    return styles.styled_speech(text.compose(rng, 12.0, "train"), "rms", style, np.random.default_rng(2))


def test_amplitude_and_tempo_can_be_heard() -> None:
    neutral, bright, quick = (_said(_constant(*style)) for style in ((0, 0), (1, 0), (0, 1)))
    assert quick.speech.duration < 0.85 * neutral.speech.duration
    assert np.mean([p.effort for p in bright.phrases]) > np.mean([p.effort for p in neutral.phrases]) + 0.4

    def brightness(spoken: Spoken) -> float:
        power = np.abs(np.fft.rfft(spoken.speech.samples)) ** 2
        hertz = np.fft.rfftfreq(len(spoken.speech.samples), 1 / 16000)
        return float(10 * np.log10(power[hertz > 1500].sum() / power[hertz < 1000].sum()))

    assert brightness(bright) > brightness(neutral) + 2.0
