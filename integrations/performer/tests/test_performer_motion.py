"""The performer's motion: in time with its plan, at rest in silence, as large as the voice is loud."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from gesticulator_performer.play import Played
from gesticulator_performer.strokes import (
    LEFT,
    RIGHT,
    StrokeSet,
    held_out_keys,
    load_strokes,
    mirror,
)
from gesticulator_performer.torso import FPS
from gesticulator_performer.types import Phrase, Spoken, Syllable
from procedural import planned as planned_by
from procedural import played as perform_by
from procedural import procedural_strokes

from data_module.motion import kinematics, rotation
from data_module.motion.motion_beats import acting_positions, acting_speed, beats_of_speed
from data_module.types import Array, Motion, Speech, Word
from eval.metrics.eye.body import common_body
from eval.metrics.eye.trunk import figures

PUPPET = "puppet"


@pytest.fixture(scope="module")
def strokes() -> StrokeSet:
    return procedural_strokes()


def _spoken(phrases: list[tuple[float, float, float]], duration: float, seed: int = 0, words: str = "table") -> Spoken:
    """Syllables of 0.22 s through phrases (start, end, effort); every third is stressed; loudness is 8 dB of effort."""
    rng = np.random.default_rng(seed)
    said, syllables, own = words.split(), [], []
    for start, end, effort in phrases:
        for k, time in enumerate(np.arange(start, end - 0.22, 0.22)):
            stress = k % 3 == 1
            loud = 8.0 * effort + (2.0 if stress else -1.0) + float(rng.normal(0.0, 0.5))
            own.append(Word(said[len(own) % len(said)], float(time), float(time) + 0.22))
            syllables.append(Syllable(float(time), float(time) + 0.06, float(time) + 0.22, len(own) - 1, loud, 0.0,
                                      1.0 if stress else -0.8))
    samples = np.zeros(int(duration * 16000), dtype=np.float32)
    return Spoken(Speech(samples, 16000, tuple(own)), tuple(syllables),
                  tuple(Phrase(*p) for p in phrases), "en")


_TALK = [(1.0, 4.0, 0.2), (4.4, 8.0, -0.5), (8.4, 12.0, 0.7), (16.0, 20.0, 0.0), (20.4, 25.0, -0.8)]


@pytest.fixture(scope="module")
def talk() -> Spoken:
    return _spoken(_TALK, 28.0, words="table you river not stone all window left music me")


@pytest.fixture(scope="module")
def played(talk: Spoken, strokes: StrokeSet) -> Played:
    return perform_by(talk, strokes, 1)


def _hand_speed(motion: Motion) -> Array:
    positions = kinematics.positions_of(motion)
    hands = positions[:, [motion.skeleton.index("LeftHand"), motion.skeleton.index("RightHand")]]
    return np.linalg.norm(np.diff(hands, axis=0), axis=-1) * motion.fps


def _misses(played: Played, shift: float = 0.0) -> Array:
    """Seconds from each planned beat (plus `shift`) to the nearest motion beat of its acting arms, [strokes]."""
    positions = acting_positions(played.motion)
    joints = {"right": [0, 1], "left": [2, 3], "both": [0, 1, 2, 3]}
    beats = {hand: beats_of_speed(acting_speed(positions[:, acting], FPS), FPS) for hand, acting in joints.items()}
    return np.array([np.abs(beats[p.stroke.hand] - p.beat - shift).min() for p in played.strokes])


def test_the_truth_is_in_order_and_near_its_syllables(played: Played, talk: Spoken) -> None:
    vowels = np.array([s.vowel for s in talk.syllables])
    beats = [s.beat for s in played.strokes]
    assert beats == sorted(beats)
    for stroke in played.strokes:
        assert stroke.start < stroke.beat <= stroke.hold_end <= stroke.end
        assert stroke.beat - stroke.start >= 0.3 - 1e-9
        assert np.abs(vowels - stroke.syllable).min() < 1e-9
        assert abs(stroke.beat - stroke.syllable) <= 0.13
    for hand in ("left", "right"):
        own = [s for s in played.strokes if s.stroke.hand in (hand, "both")]
        assert all(a.hold_end <= b.start + 1e-9 for a, b in zip(own, own[1:], strict=False))


def test_long_pause_is_rest_and_home_is_reached_before_speech(played: Played, strokes: StrokeSet) -> None:
    motion = played.motion
    figure = strokes.figures[PUPPET]
    pause = slice(int(13.8 * 60), int(15.0 * 60))
    # The trunk of a living person sways, and the hanging hands with it.
    assert np.percentile(_hand_speed(motion)[pause], 95) < 0.1
    arms = [motion.skeleton.index(side + part) for side in ("Left", "Right") for part in ("Arm", "ForeArm")]
    away = rotation.angle_between(figure.rest[arms], motion.rotations[:, arms])
    assert away[pause].max() < np.radians(6.0)
    # Speech resumes at 16 s with one arm at least before the body.
    assert away[int(15.95 * 60)].max() > np.radians(20.0)
    assert _hand_speed(motion)[int(1.5 * 60):int(11.5 * 60)].mean() > 0.25


def test_same_seed_same_motion_other_seed_other_motion(talk: Spoken, played: Played, strokes: StrokeSet) -> None:
    again = perform_by(talk, strokes, 1)
    assert np.array_equal(again.motion.rotations, played.motion.rotations)
    assert [p.beat for p in again.strokes] == [p.beat for p in played.strokes]
    other = perform_by(talk, strokes, 2)
    assert [p.beat for p in other.strokes] != [p.beat for p in played.strokes]


def test_held_out_strokes_play_in_test_alone(talk: Spoken, strokes: StrokeSet) -> None:
    train = [p for seed in range(6) for p in planned_by(talk, strokes, seed, "train")]
    test = [p for seed in range(6) for p in planned_by(talk, strokes, seed, "test")]
    assert not any(p.stroke.held_out for p in train)
    assert {p.stroke.held_out for p in test} == {True, False}


def test_meaningful_words_take_their_strokes(strokes: StrokeSet) -> None:
    spoken = _spoken([(0.5, 30.0, 0.0)], 31.0, words="stone river you table lamp wood")
    planned = planned_by(spoken, strokes, 0)
    words = {s.vowel: spoken.speech.words[s.word].text for s in spoken.syllables}  # type: ignore[index]
    of_you = [p for p in planned if words[p.syllable] == "you"]
    assert sum(p.stroke.lexeme == "You" for p in of_you) > 5
    assert not any(p.stroke.lexeme == "You" for p in planned if words[p.syllable] != "you")


def test_mirror_twice_is_the_stroke_and_once_swaps_the_hands(strokes: StrokeSet) -> None:
    one = next(s for s in strokes.strokes if s.lexeme == "Left")
    other = mirror(one)
    assert (other.lexeme, other.hand) == ("Right", "right")
    figure = strokes.figures[PUPPET]

    def hand_path(stroke_arms: Array, side: int) -> Array:
        frames = stroke_arms.shape[1]
        rotations = np.repeat(figure.rest[None], frames, axis=0)
        joints = list(figure.arms[side])
        rotations[:, joints] = rotation.multiply(figure.rest[joints],
                                                 rotation.from_exponential_map(stroke_arms[side]))
        return kinematics.joint_positions(figure.skeleton, rotations)[:, joints[3]]

    assert np.allclose(hand_path(other.arms, RIGHT), hand_path(one.arms, LEFT) * [-1.0, 1.0, 1.0], atol=1e-6)
    assert np.allclose(mirror(other).arms, one.arms)


def test_held_out_share_is_per_person_and_blind_to_order() -> None:
    keys = [("a", f"clip{k}") for k in range(40)] + [("b", f"clip{k}") for k in range(20)]
    kept = held_out_keys(keys)
    assert kept == held_out_keys(reversed(keys))
    assert sum(p == "a" for p, _ in kept) == 6 and sum(p == "b" for p, _ in kept) == 3


# --- The recorded strokes


@pytest.fixture(scope="module")
def recorded(outside_data: Path) -> StrokeSet:
    return load_strokes(outside_data / "strokes")


def test_retargeted_clips_stay_on_one_side_of_the_split(recorded: StrokeSet) -> None:
    sides: dict[str, set[bool]] = {}
    for stroke in recorded.strokes:
        if stroke.speaker.startswith("brad"):
            sides.setdefault(stroke.base.split("_", 1)[1], set()).add(stroke.held_out)
    assert all(len(side) == 1 for side in sides.values())
    share = np.mean([s.held_out for s in recorded.strokes])
    assert 0.1 < share < 0.2


def test_recorded_strokes_play_in_time_and_out_of_the_body(recorded: StrokeSet, talk: Spoken) -> None:
    out = perform_by(talk, recorded, 0, performer="connor")
    assert (_misses(out) < 0.02).mean() >= 0.95
    assert figures(common_body(out.motion))["eye_hand_in_torso"] < 0.5
    table = {name: k for k, name in enumerate(out.motion.skeleton.names)}
    toes = kinematics.positions_of(out.motion)[:, table["LeftToeBase"]]
    # Some clips turn a little on the spot, and the legs follow the hips.
    assert np.ptp(toes, axis=0).max() < 0.03
