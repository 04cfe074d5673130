"""Hands that act apart, a trunk that lives, styles that can be heard: what the performer does with a manner."""

from __future__ import annotations

import numpy as np
import pytest
from gesticulator_performer import hands, styles, text, voices
from gesticulator_performer.hands import Manner
from gesticulator_performer.play import Played
from gesticulator_performer.strokes import LEFT, RIGHT, StrokeSet
from gesticulator_performer.torso import FPS
from gesticulator_performer.types import Phrase, Spoken
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


def test_hands_act_apart_and_no_hand_freezes(played: Played) -> None:
    assert np.corrcoef(_hands(played)[..., 1].T)[0, 1] < 0.5
    joints = [played.motion.skeleton.index(name) for name in ("Head", "LeftHand", "RightHand")]
    positions = kinematics.positions_of(played.motion) - played.motion.root_positions[:, None]
    speed = np.linalg.norm(np.gradient(positions[:, joints], 1.0 / FPS, axis=0), axis=-1).max(axis=1)
    moves = np.convolve(speed > 0.02, np.ones(60), "valid")
    assert moves.min() > 0, "no second in which head and hands stand still"


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
