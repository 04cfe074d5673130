"""Rest begins with a real pause, stops without a jump, sinks slowly, wakes without a jump; phrases follow activity."""

from __future__ import annotations

import math

import numpy as np
import pytest

from data_module.motion.kinematics import positions_of
from data_module.motion.representation import ROTATIONS
from data_module.motion.skeletons import CHARACTER, from_vector
from data_module.types import Array
from gesticulator.body.rest import HOLD, LEAD, LONGEST_STOP, SEEN, SINKING, Pauses, Phrases, Rest
from gesticulator.bundle.features import Normaliser, Span, Statistics

K, D = 10, 3 * len(CHARACTER)
HANDS = [CHARACTER.index(side + "Hand") for side in ("Right", "Left")]
ARM, FOREARM = 3 * CHARACTER.index("RightArm"), 3 * CHARACTER.index("RightForeArm")


def statistics() -> Statistics:
    rest = np.zeros(D)
    rest[ARM + 2], rest[3 * CHARACTER.index("LeftArm") + 2] = math.radians(70), -math.radians(70)
    width = Normaliser(np.zeros(3), np.ones(3))
    return Statistics(("ann",), np.zeros((1, D)), rest[None], np.full(D, 0.1),
                      np.stack([np.full(D, -25.0), np.full(D, 25.0)]), width, width)


def spans(quiet: list[tuple[float, float]], seconds: float, duration: float = 0.4, frames: int = K) -> list[Span]:
    """Even blocks of a recording that is quiet in these stretches."""
    count = round(seconds / duration)
    flags = []
    for i in range(count):
        times = (i + np.arange(1, frames + 1) / frames) * duration
        flags.append(sum(((times > a + 1e-9) & (times <= b + 1e-9) for a, b in quiet), np.zeros(frames, bool)))
    return [Span(i * duration, duration, flags[i], *((flags[i + 1], duration) if i + 1 < count else ()))
            for i in range(count)]


def gestures(times: Array) -> Array:
    """[T, D_m] an arm that swings at up to 1.3 m/s, normalised."""
    own = statistics()
    poses = np.repeat(own.rest_pose, len(times), axis=0)
    poses[:, ARM + 2] -= 0.9 + 0.5 * np.sin(2 * np.pi * 0.7 * times)
    poses[:, FOREARM + 1] += 0.8 + 0.4 * np.sin(2 * np.pi * 0.9 * times + 1)
    return own.normalise(poses, 0)


def performed(quiet: list[tuple[float, float]], seconds: float, activity: float = 1.0, alive: bool = False,
              frames: int = K) -> tuple[Array, Array]:
    """times [T], poses [T, D_m]: the swing, which heeds nothing that was shown, with rest."""
    rest = Rest(statistics(), ROTATIONS, 0, activity, seed=1)
    shown = []
    asked = spans(quiet, seconds, frames=frames)
    for span in asked:
        rest.analyse(span)
        block = rest.step(gestures(span.times))
        shown.append(rest.alive(block) if alive else block)
    return np.concatenate([span.times for span in asked]), np.concatenate(shown)


def hand_speed(times: Array, features: Array) -> Array:
    """[T - 1] m/s of the faster hand."""
    at = positions_of(from_vector(statistics().denormalise(features, 0), 25.0))[:, HANDS]
    return np.linalg.norm(np.diff(at, axis=0), axis=-1).max(axis=1) / np.diff(times)


# ---------------------------------------------------------------------------------------------------- pauses

def rested(quiet: list[tuple[float, float]], seconds: float = 8.0, duration: float = 0.4) -> list[tuple[float, float]]:
    """Stretches of rest, seconds."""
    watch = Pauses()
    asked = spans(quiet, seconds, duration)
    rests = np.concatenate([[False], *(watch.step(span) for span in asked), [False]]).astype(int)
    times = np.concatenate([[0.0], *(span.times for span in asked)])
    return [(round(float(times[a]), 2), round(float(times[b]), 2))
            for a, b in zip(np.flatnonzero(np.diff(rests) > 0), np.flatnonzero(np.diff(rests) < 0), strict=True)]


def test_a_pause_is_rested_from_its_start_until_the_preparation_before_the_voice() -> None:
    assert rested([(2.0, 4.0)]) == [(2.0, round(4.0 - LEAD, 2))]
    # With one block of 0.4 s ahead, a pause that begins in the middle of a block is certain in the next one, and the
    # voice is not seen more than a block ahead.
    assert rested([(2.2, 4.28), (6.0, 7.2)]) == [(2.4, 4.0), (6.0, 6.8)]


def test_a_short_pause_is_no_rest_and_a_click_does_not_end_one() -> None:
    assert rested([(2.0, 2.0 + SEEN - 0.05)]) == []
    assert rested([(2.0, 3.0), (3.12, 5.0)]) == [(2.0, 4.6)]
    assert rested([(0.0, 8.0)]) == [(0.0, 8.0)]


def test_a_noise_that_flickers_every_tenth_of_a_second_is_one_rest() -> None:
    flicker = [(0.16 * i, 0.16 * i + 0.08) for i in range(50)]
    assert rested(flicker) == [(0.0, 8.0)]
    late = [(3.0, 4.2), *((4.2 + 0.16 * i, 4.28 + 0.16 * i) for i in range(1, 20))]
    assert rested(late)[0] == (3.0, 8.0) or len(rested(late)) <= 2


def test_how_long_blocks_are_hardly_matters() -> None:
    for duration in (0.2, 0.25, 0.3, 0.5):
        (begin, end), = rested([(2.0, 5.0)], duration=duration)
        assert 2.0 <= begin <= 2.0 + max(SEEN - duration, 0.0) + 1e-9, "as soon as enough silence is known"
        assert 5.0 - LEAD - 0.06 <= end <= 5.0 - 0.14, "0.2 s of the voice are known a block before"


# ---------------------------------------------------------------------------------------------------- phrases

def share(activity: float, score: Array, seed: int = 0) -> tuple[float, float]:
    """Share of the time that is gestured, and the mean score of what is, of phrases of 1.2 s with 0.8 s between."""
    phrases = Phrases(activity, seed)
    quiet, loud = np.ones(K, bool), np.zeros(K, bool)
    opened = []
    for number, one in enumerate(score):
        for block in range(5):
            rests = quiet if block > 2 else loud
            own = phrases.step(Span(2.0 * number + 0.4 * block, 0.4, rests), rests, float(one))
            if block < 3:
                opened.append(own)
            else:
                assert not own
    kept = np.repeat(score, 3)[np.array(opened)]
    assert all(len(set(opened[i:i + 3])) == 1 for i in range(0, len(opened), 3)), "a phrase is decided once"
    return float(np.mean(opened)), float(kept.mean()) if len(kept) else math.nan


@pytest.mark.parametrize("activity", [0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0])
@pytest.mark.parametrize("scores", ["none", "even", "equal"])
def test_the_share_of_gesture_is_what_was_asked(activity: float, scores: str) -> None:
    rng = np.random.default_rng(0)
    score = {"none": np.full(100, np.nan), "even": rng.random(100), "equal": np.full(100, 0.84)}[scores]
    found, _ = share(activity, score)
    assert found == pytest.approx(activity, abs=0.0 if activity in (0, 1) else 0.04)


def test_the_likeliest_phrases_are_kept() -> None:
    score = np.random.default_rng(3).random(200)
    assert share(0.3, score)[1] > 0.65 and share(0.3, -score)[1] > -0.35
    blind = share(0.3, np.full(200, np.nan))[0]
    assert blind == pytest.approx(0.3, abs=0.04)


def test_the_dice_are_keyed_by_the_seed() -> None:
    score = np.full(40, np.nan)

    def pattern(seed: int) -> list[bool]:
        phrases = Phrases(0.5, seed)
        loud = np.zeros(K, bool)
        return [phrases.step(Span(4.0 * i, 4.0, loud), loud, float(s)) for i, s in enumerate(score)]

    assert pattern(1) == pattern(1) and pattern(1) != pattern(2)


# ---------------------------------------------------------------------------------------------------- the body

def test_in_a_pause_the_hands_stop_hold_retract_and_rest() -> None:
    times, shown = performed([(4.0, 16.0)], 20.0)
    speed = hand_speed(times, shown)
    begin = np.searchsorted(times, 4.0 + 1e-6)
    assert speed[:begin].max() > 1.0, "the swing is fast"
    since = times[:-1] - 4.0
    held, resting = (since >= LONGEST_STOP + 0.05) & (since < HOLD - 0.05), since < 11.4
    assert speed[held].max() < 1e-6, "they stop, and are held"
    assert 0.7 * SINKING < speed[(since >= HOLD) & resting].max() < 1.02 * SINKING, "they retract"
    assert speed[(since >= 3.5) & resting].max() < 1e-6, "and rest"
    rest = statistics().normalise(statistics().rest_pose[0], 0)
    at_rest = shown[(times > 15.0) & (times < 15.4)]
    np.testing.assert_allclose(at_rest, np.broadcast_to(rest, at_rest.shape), atol=1e-6)


@pytest.mark.parametrize("begin", [4.0, 4.12, 4.2, 4.36])
def test_neither_stopping_nor_waking_jumps_in_place_or_speed(begin: float) -> None:
    # Where place and velocity go on, twice as many frames halve the step of the place and that of the velocity.
    steps, bends = [], []
    for frames in (100, 200, 400):
        times, shown = performed([(begin, begin + 1.3), (0.0, 1.0)], 8.0, frames=frames)
        velocity = np.diff(shown, axis=0) / (times[1] - times[0])
        steps.append(np.abs(np.diff(shown, axis=0)).max())
        bends.append(np.abs(np.diff(velocity, axis=0)).max())
    assert steps[2] < 0.3 * steps[0] and bends[2] < 0.35 * bends[0]


def raised(speed: float) -> tuple[Array, Array]:
    """times [T], heights of the right hand [T] of an arm that stands level and turns at so many radians a second, up
    where it is positive, until a pause begins at 2 s."""
    own = statistics()
    rest = Rest(own, ROTATIONS, 0, 1.0, seed=1)
    shown, asked = [], spans([(2.0, 8.0)], 8.0)
    for span in asked:
        rest.analyse(span)
        poses = np.repeat(own.rest_pose, K, axis=0)
        poses[:, ARM + 2] = -speed * (span.times - 2.0)
        shown.append(rest.step(own.normalise(poses, 0)))
    features = np.concatenate(shown)
    return np.concatenate([span.times for span in asked]), positions_of(
        from_vector(own.denormalise(features, 0), 25.0))[:, HANDS[0], 1]


def test_a_hand_that_rises_goes_on_a_little_and_one_that_comes_down_comes_down() -> None:
    arm = 0.53  # metres from the shoulder to the hand
    times, up = raised(1.2)
    begin = np.searchsorted(times, 2.0 - 1e-6)
    stop = up[(times > 2.45) & (times < 2.0 + HOLD - 0.02)]
    # x + v T / 3 with the T that stops within 0.12 m, at most 0.42 s.
    assert np.ptp(stop) < 1e-9 and stop[0] - up[begin] == pytest.approx(arm * 1.2 * 0.42 / 3, abs=0.02)
    assert (np.diff(up[begin - 3:begin + 12]) > -1e-9).all(), "it does not turn back"
    times, down = raised(-1.2)
    lower = down[(times > 2.45) & (times < 2.0 + HOLD - 0.02)]
    assert np.ptp(lower) < 1e-9 and down[begin] - lower[0] > 0.15
    assert (np.diff(down[begin - 3:begin + 12]) < 1e-9).all()


def test_outside_of_pauses_nothing_is_touched() -> None:
    times, shown = performed([(4.0, 6.0)], 12.0)
    own = gestures(times)
    np.testing.assert_allclose(shown[(times > 0.42) & (times <= 4.0)], own[(times > 0.42) & (times <= 4.0)])
    np.testing.assert_allclose(shown[times > 6.41], own[times > 6.41])


def test_what_rests_in_a_phrase_is_the_body_and_the_head_goes_on() -> None:
    rest = Rest(statistics(), ROTATIONS, 0, 0.0, seed=0)
    neck = 3 * CHARACTER.index("Neck")
    for span in spans([], 4.0):
        assert rest.analyse(span)
        drawn = gestures(span.times)
        drawn[:, neck] = np.sin(span.times)
        shown = rest.step(drawn)
        resting = statistics().normalise(statistics().rest_pose[0], 0)
        np.testing.assert_array_equal(np.delete(shown, np.s_[neck:neck + 9], axis=1),
                                      np.broadcast_to(np.delete(resting, np.s_[neck:neck + 9]), (K, D - 9)))
    np.testing.assert_array_equal(shown[:, neck], drawn[:, neck])


def test_the_same_twice_and_a_later_sound_changes_nothing_earlier() -> None:
    times, one = performed([(4.0, 7.0)], 12.0, alive=True)
    _, two = performed([(4.0, 7.0)], 12.0, alive=True)
    np.testing.assert_array_equal(one, two)
    # What comes more than the next block later is not known.
    _, other = performed([(4.0, 7.0), (8.0, 10.0)], 12.0, alive=True)
    np.testing.assert_array_equal(one[times <= 7.2], other[times <= 7.2])
    assert not np.array_equal(one, other)


def test_life_is_laid_on_without_a_jump_and_keeps_the_hands_slow() -> None:
    times, shown = performed([(4.0, 16.0)], 20.0, alive=True)
    _, base = performed([(4.0, 16.0)], 20.0)
    life = shown - base
    assert np.abs(life[0]).max() < 0.02 and np.abs(np.diff(life, axis=0)).max() < 0.12
    speed = hand_speed(times, shown)
    still = (times[:-1] > 7.5) & (times[:-1] < 15.4)
    assert speed[still].min() > 1e-4 and speed[still].max() < 0.12


def test_absent_joints_stay_absent() -> None:
    own = statistics()
    bounds = own.bounds.copy()
    spine = np.s_[3 * CHARACTER.index("Spine3"):3 * CHARACTER.index("Spine3") + 3]
    bounds[:, spine] = 0.0
    rest = Rest(Statistics(own.speakers, own.mean_pose, own.rest_pose, own.deviation, bounds, own.low, own.high),
                ROTATIONS, 0, 1.0, seed=0)
    for span in spans([(0.0, 2.0)], 4.0):
        rest.analyse(span)
        assert not rest.alive(rest.step(gestures(span.times)))[:, spine].any()


@pytest.mark.parametrize("held", [True, False])
def test_a_hold_keeps_the_arms_about_where_they_stopped_and_leaves_the_trunk_alone(held: bool) -> None:
    rest, spine = Rest(statistics(), ROTATIONS, 0, 1.0, seed=1), 3 * CHARACTER.index("Spine")
    last, shown, asked = np.zeros(D), [], spans([], 4.0)
    for span in asked:
        rest.analyse(span, still=np.ones(K, bool) if span.start >= 1.99 else None, held=held)
        # A generator continues from what was shown.
        path = gestures(np.concatenate([[span.start], span.times]))
        path[:, spine] = np.sin(np.concatenate([[span.start], span.times]))
        shown.append(rest.step(last + path[1:] - path[0]))
        last = shown[-1][-1]
    times, poses = np.concatenate([span.times for span in asked]), np.concatenate(shown)
    awake = times > 0.41
    assert poses[awake, spine] == pytest.approx(np.sin(times[awake]), abs=0.1), "the trunk goes on"
    poses[:, spine], stopped = 0.0, (times > 2.0 + LONGEST_STOP) & (times < 3.5)
    at = positions_of(from_vector(statistics().denormalise(poses, 0), 25.0))[stopped][:, HANDS[0]]
    free = positions_of(from_vector(statistics().denormalise(gestures(times), 0), 25.0))[stopped][:, HANDS[0]]
    drifts = np.linalg.norm(np.ptp(at, axis=0))
    if held:
        assert 0.05 < drifts / np.linalg.norm(np.ptp(free, axis=0)) < 0.5
    else:
        assert drifts < 1e-9, "hands that are asked to be still are"
