"""A performance with rest and life: what a stream would give, by seed, and alive in silence and noise."""

import numpy as np
import pytest

from data_module.errors import InputError
from data_module.types import Array, Speech
from eval.metrics.eye.body import common_body
from eval.metrics.eye.trunk import longest, smoothed_speed
from gesticulator.bundle.config import with_settings
from gesticulator.gesticulator import Gesticulator
from gesticulator.performance import Performance
from gesticulator.training.presets import PRESETS, preset
from tests.untrained import PLAIN, SILENT, untrained

RATE = 16000


@pytest.fixture(scope="module")
def system() -> Gesticulator:
    return Gesticulator(untrained("silence.rest=life"))


@pytest.fixture(scope="module")
def plain() -> Gesticulator:
    return Gesticulator(untrained("silence.rest=life", *PLAIN))


def voice(*stretches: tuple[float, float], seed: int = 0) -> Speech:
    """Syllables for so long, silence for so long, and so on (seconds)."""
    rng = np.random.default_rng(seed)
    parts = []
    for loud, quiet in stretches:
        time = np.arange(round(loud * RATE)) / RATE
        parts += [0.2 * rng.normal(size=len(time)) * np.maximum(np.sin(2 * np.pi * 2.3 * time), 0.15),
                  1e-5 * rng.normal(size=round(quiet * RATE))]
    return Speech(np.concatenate(parts).astype(np.float32), RATE)


TALK = voice((3.0, 4.0), (2.5, 0.4), (2.0, 1.2), (1.5, 3.0))


def still(made: Performance) -> tuple[Array, Array]:
    """Speeds [T] of the faster hand and of the head, m/s, as the eye's figures take them."""
    body = common_body(made.motion)
    speed = smoothed_speed(np.concatenate([body.hands, body.points["Head"][:, None]], axis=1))
    return speed[:, :2].max(axis=1), speed[:, 2]


def test_the_presets_that_are_papers_keep_their_rest_and_the_default_lives() -> None:
    living = {name for name in PRESETS if preset(name).silence.rest == "life"}
    assert living == {"default"}
    with pytest.raises(InputError, match=r"silence\.rest"):
        with_settings(preset("paper-ted"), ["silence.rest=life"])


def test_in_a_long_pause_the_hands_rest_and_the_head_lives(system: Gesticulator) -> None:
    made = system(TALK, seed=2)
    hands, head = still(made)
    time = np.arange(len(hands)) / made.fps
    pause = (time > 5.4) & (time < 6.6)
    assert hands[pause].max() < 0.12
    assert hands.min() > 0 and longest(head < 0.02) < 1.0


@pytest.mark.parametrize("kind", ["zeros", "hiss", "noise", "loud noise"])
def test_what_is_no_speech_is_rested_through(system: Gesticulator, kind: str) -> None:
    level = {"zeros": 0.0, "hiss": 1e-3, "noise": 0.03, "loud noise": 0.3}[kind]
    sound = (level * np.random.default_rng(1).normal(size=12 * RATE)).astype(np.float32)
    made = system(Speech(np.clip(sound, -1, 1), RATE), temperature=1.0)
    hands, head = still(made)
    assert set(made.lexemes.tolist()) <= set(SILENT)
    assert hands.max() < 0.12 and hands.min() > 0 and longest(head < 0.02) < 1.0


def test_activity_shares_the_speech_out_with_and_without_a_gate(system: Gesticulator, plain: Gesticulator) -> None:
    talk = voice(*[(2.2, 0.8)] * 14)
    for own in (system, plain):
        found = np.zeros(4)
        for seed in (3, 4, 5):
            for level, activity in enumerate((0.0, 0.3, 0.7, 1.0)):
                made = own(talk, activity=activity, seed=seed, temperature=100.0)  # any lexeme, where any may be taken
                moves = ~np.isin(made.lexemes, SILENT) & ~made.blocks.silent
                found[level] += float((moves * made.blocks.durations).sum())
        assert found[0] == 0 and found[3] > 45
        np.testing.assert_allclose(found[1:3], np.array([0.3, 0.7]) * found[3], atol=0.12 * found[3])
    assert "gate" not in plain.bundle.parts and "gate" in system.bundle.parts
