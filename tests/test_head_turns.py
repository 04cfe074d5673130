"""Turns of a head between utterances: where it looks, that it starts and stops without a jolt, and when it nods."""

import numpy as np
import pytest

from data_module.speech.audio import SAMPLE_RATE
from gesticulator.body.head_turns import HeadTurns
from gesticulator.body.life import LOOKED

JOINTS = ("Hips", *LOOKED)
RNG = np.random.default_rng(2)


def degrees(turns: HeadTurns, times: np.ndarray) -> np.ndarray:
    """[T, 3] what all joints together turn the face by: down, to the left, aside."""
    turned = turns(times)
    assert turned is not None
    joints = turned.reshape(len(times), len(JOINTS), 3)
    assert not joints[:, 0].any(), "hips do not look"
    return np.degrees(joints.sum(axis=1))


def test_looking_away_goes_to_a_side_and_up_along_a_quintic_and_back() -> None:
    """10 s^3 - 15 s^4 + 6 s^5 at quarters of half a second; it holds until it is released."""
    turns = HeadTurns(1, JOINTS)
    turns.look_away(2.0)
    way = np.array([0.0, 0.103515625, 0.5, 0.896484375, 1.0, 1.0])
    looked = degrees(turns, 2.0 + np.array([0.0, 0.125, 0.25, 0.375, 0.5, 3.0]))
    side = np.sign(looked[-1, 1])
    np.testing.assert_allclose(looked, way[:, None] * [-6.0, 13.0 * side, 0.0], atol=1e-9)
    turns.release(6.0)
    back = degrees(turns, 6.0 + np.array([0.0, 0.125, 0.25, 0.375]))
    np.testing.assert_allclose(back[:, 0], -6.0 * (1 - way[:4]), atol=1e-9)
    assert turns(np.array([6.6])) is None


def test_nothing_jumps_in_speed() -> None:
    turns = HeadTurns(1, JOINTS)
    turns.look_away(1.0)
    turns.release(1.8)
    path = degrees(turns, np.arange(0.5, 3.0, 0.001))[:, 1]
    assert np.abs(np.diff(path, n=2)).max() < 13.0 * 5.78 / 0.5**2 * 0.001**2, "the quintic's greatest acceleration"


def test_a_listener_nods_after_a_phrase_and_not_within_it() -> None:
    turns = HeadTurns(1, JOINTS)
    hiss = (1e-3 * RNG.normal(size=SAMPLE_RATE)).astype(np.float32)
    voice = hiss.repeat(2)[:2 * SAMPLE_RATE] + np.sin(np.arange(2 * SAMPLE_RATE) * 0.2).astype(np.float32) * 0.2
    turns.listen(hiss, 0.0)
    turns.listen(voice.astype(np.float32), 1.0)
    assert turns(np.array([3.0])) is None
    turns.listen(hiss, 3.0)
    down = degrees(turns, np.arange(3.0, 5.0, 0.01))
    assert down[:, 0].max() == pytest.approx(6.5, abs=0.3) and not down[:, 1:].any()
    assert 3.3 < np.arange(3.0, 5.0, 0.01)[down[:, 0].argmax()] < 3.8
