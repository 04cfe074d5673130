"""The performer's motion: in time with its plan, at rest in silence, hands that act apart, styles that can be heard."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from gesticulator_performer import plan, text, voices
from gesticulator_performer.joints import FPS
from gesticulator_performer.plan import Manner
from gesticulator_performer.play import Played
from gesticulator_performer.strokes import LEFT, RIGHT, StrokeSet, held_out_keys, load_strokes
from gesticulator_performer.syllables import Phrase, Spoken, Syllable
from procedural import PERFORMER, planned, procedural_strokes, said
from procedural import played as perform_by

from data_module.motion import kinematics, rotation
from data_module.motion.motion_beats import acting_positions, acting_speed, beats_of_speed
from data_module.types import Array, Speech, Word
from eval.metrics.eye.body import common_body
from eval.metrics.eye.trunk import figures

MANNER = Manner(both=0.4, dominant=0.7, switch=0.7, hanging=0.5, falling=0.1, gain=1.15, hold=1.3, drift=0.6,
                small_beats=0.2, eagerness=0.2, trunk=1.0)


@pytest.fixture(scope="module")
def strokes() -> StrokeSet:
    return procedural_strokes()


@pytest.fixture(scope="module")
def talk() -> Spoken:
    """Syllables of 0.22 s through phrases; every third is stressed; loudness is 8 dB of effort."""
    rng = np.random.default_rng(0)
    words = ["table", "you", "river", "not", "stone", "all", "window", "left", "music", "me"]
    phrases = [(1.0, 4.0, 0.2), (4.4, 8.0, -0.5), (8.4, 12.0, 0.7), (16.0, 20.0, 0.0), (20.4, 25.0, -0.8)]
    syllables, spoken = [], []
    for start, end, effort in phrases:
        for k, time in enumerate(np.arange(start, end - 0.22, 0.22).tolist()):
            stress = k % 3 == 1
            loud = 8.0 * effort + (2.0 if stress else -1.0) + float(rng.normal(0.0, 0.5))
            spoken.append(Word(words[len(spoken) % len(words)], time, time + 0.22))
            syllables.append(Syllable(time, time + 0.06, time + 0.22, len(spoken) - 1, loud, 0.0,
                                      1.0 if stress else -0.8))
    return Spoken(Speech(np.zeros(28 * 16000, dtype=np.float32), 16000, tuple(spoken)), tuple(syllables),
                  tuple(Phrase(*p) for p in phrases), "en")


@pytest.fixture(scope="module")
def played(talk: Spoken, strokes: StrokeSet) -> Played:
    return perform_by(talk, strokes, 1)


def _places(played: Played, *joints: str) -> Array:
    """[T, n, 3] metres from the hips."""
    positions = kinematics.positions_of(played.motion) - played.motion.root_positions[:, None]
    return positions[:, [played.motion.skeleton.index(joint) for joint in joints]]


def test_strokes_are_in_order_and_near_their_syllables(played: Played, talk: Spoken) -> None:
    vowels = np.array([s.vowel for s in talk.syllables])
    beats = [s.beat for s in played.strokes]
    assert beats == sorted(beats)
    for stroke in played.strokes:
        assert stroke.start < stroke.beat <= stroke.hold_end <= stroke.end
        assert stroke.beat - stroke.start >= 0.3 - 1e-9
        assert np.abs(vowels - stroke.syllable).min() < 1e-9
        assert abs(stroke.beat - stroke.syllable) <= 0.13
    for hand in ("left", "right"):
        acting = [s for s in played.strokes if s.stroke.hand in (hand, "both")]
        assert all(a.hold_end <= b.start + 1e-9 for a, b in zip(acting, acting[1:], strict=False))


def test_long_pause_is_rest_and_home_is_reached_before_speech(played: Played, strokes: StrokeSet) -> None:
    motion = played.motion
    pause = slice(int(13.8 * 60), int(15.0 * 60))
    speed = np.linalg.norm(np.diff(_places(played, "LeftHand", "RightHand"), axis=0), axis=-1) * motion.fps
    # The trunk of a living person sways, and the hanging hands with it.
    assert np.percentile(speed[pause], 95) < 0.1
    arms = [motion.skeleton.index(side + part) for side in ("Left", "Right") for part in ("Arm", "ForeArm")]
    away = rotation.angle_between(strokes.figures[PERFORMER].rest[arms], motion.rotations[:, arms])
    assert away[pause].max() < np.radians(6.0)
    # Speech resumes at 16 s with one arm at least before the body.
    assert away[int(15.95 * 60)].max() > np.radians(20.0)
    assert speed[int(1.5 * 60):int(11.5 * 60)].mean() > 0.25


def test_same_seed_same_motion_other_seed_other_motion(talk: Spoken, played: Played, strokes: StrokeSet) -> None:
    again, other = (perform_by(talk, strokes, seed) for seed in (1, 2))
    assert np.array_equal(again.motion.rotations, played.motion.rotations)
    assert [p.beat for p in other.strokes] != [p.beat for p in played.strokes] == [p.beat for p in again.strokes]


def test_meaningful_words_take_their_strokes_and_held_out_ones_play_in_test_alone(strokes: StrokeSet) -> None:
    spoken = said("stone river you table lamp wood", 6)
    words = spoken.speech.words or ()
    train, test = ([p for seed in range(6) for p in planned(spoken, strokes, seed, split)] for split in
                   ("train", "test"))
    of_you = [p for p in train if words[p.word].text == "you"]
    assert sum(p.stroke.lexeme == "You" for p in of_you) > 5
    assert not any(p.stroke.lexeme == "You" for p in train if words[p.word].text != "you")
    assert {p.stroke.held_out for p in train} == {False} and {p.stroke.held_out for p in test} == {True, False}


def test_held_out_share_is_per_person_and_blind_to_order() -> None:
    keys = [("a", f"clip{k}") for k in range(40)] + [("b", f"clip{k}") for k in range(20)]
    kept = held_out_keys(keys)
    assert kept == held_out_keys(reversed(keys))
    assert sum(p == "a" for p, _ in kept) == 6 and sum(p == "b" for p, _ in kept) == 3


def test_phrases_are_given_to_the_hands_as_the_manner_says() -> None:
    phrases = [Phrase(2.0 * k, 2.0 * k + 1.5, 0.0) for k in range(4000)]
    drawn = plan.hands_of_phrases(phrases, MANNER, RIGHT, np.random.default_rng(0))
    shares = [np.mean([p.acting == acting for p in drawn]) for acting in ((LEFT,), (RIGHT,), (LEFT, RIGHT))]
    assert shares == pytest.approx([0.6 * 0.3, 0.6 * 0.7, 0.4], abs=0.03)
    assert np.mean([p.idle == plan.HANG for p in drawn]) == pytest.approx(0.5, abs=0.03)
    kept = np.mean([a.acting == b.acting for a, b in zip(drawn, drawn[1:], strict=False)])
    again = 0.7 * sum(share ** 2 for share in shares) + 0.3
    assert kept == pytest.approx(again, abs=0.03)


def test_hands_act_apart_and_no_hand_freezes(talk: Spoken, strokes: StrokeSet) -> None:
    places = _places(perform_by(talk, strokes, 1, MANNER), "Head", "LeftHand", "RightHand")
    assert np.corrcoef(places[:, 1:, 1].T)[0, 1] < 0.5
    speed = np.linalg.norm(np.gradient(places, 1.0 / FPS, axis=0), axis=-1).max(axis=1)
    moves = np.convolve(speed > 0.02, np.ones(60), "valid")
    assert moves.min() > 0, "no second in which head and hands stand still"


def test_amplitude_and_tempo_can_be_heard() -> None:
    def styled(*style: float) -> Spoken:
        track = voices.StyleTrack(np.array([0.0]), np.array([style]))
        written = text.compose(np.random.default_rng(9), 12.0, "train")
        return voices.styled_speech(written, "rms", track, np.random.default_rng(2))

    def brightness(spoken: Spoken) -> float:
        power = np.abs(np.fft.rfft(spoken.speech.samples)) ** 2
        hertz = np.fft.rfftfreq(len(spoken.speech.samples), 1 / 16000)
        return float(10 * np.log10(power[hertz > 1500].sum() / power[hertz < 1000].sum()))

    neutral, bright, quick = styled(0, 0), styled(1, 0), styled(0, 1)
    assert quick.speech.duration < 0.85 * neutral.speech.duration
    assert np.mean([p.effort for p in bright.phrases]) > np.mean([p.effort for p in neutral.phrases]) + 0.4
    assert brightness(bright) > brightness(neutral) + 2.0


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
    positions = acting_positions(out.motion)
    joints = {"right": [0, 1], "left": [2, 3], "both": [0, 1, 2, 3]}
    beats = {hand: beats_of_speed(acting_speed(positions[:, acting], FPS), FPS) for hand, acting in joints.items()}
    misses = np.array([np.abs(beats[p.stroke.hand] - p.beat).min() for p in out.strokes])
    assert (misses < 0.02).mean() >= 0.95
    assert figures(common_body(out.motion))["eye_hand_in_torso"] < 0.5
    toes = kinematics.positions_of(out.motion)[:, out.motion.skeleton.index("LeftToeBase")]
    # Some clips turn a little on the spot, and the legs follow the hips.
    assert np.ptp(toes, axis=0).max() < 0.03
