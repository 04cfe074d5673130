"""Which of several drawn blocks is kept: one that shows the lexeme, most in time, nearest to what is asked."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_module.types import Array
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import SpeechBlock, control_rows, representation_of
from gesticulator.sampling import candidates
from tests.untrained import MOVING, PLAIN, untrained

SHOULDERS = np.array([[-0.17, 0.6, 0.0], [0.17, 0.6, 0.0]])

RATE, FRAMES = 16000, 10


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Lexeme, timing and controls alone."""
    for name in ("SEAM", "BODY", "TOGETHER", "PITCH", "NATURAL"):
        monkeypatch.setattr(candidates, name, 0.0)
    return monkeypatch


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return untrained(*(setting for setting in PLAIN if "control" not in setting), *MOVING, "selection.temperature=1.0")


def swing(bundle: Bundle, stop: float) -> tuple[Array, Array]:
    """The arms swing out and come to a stop at a share of the block: the past [10, D_m] and the block [10, D_m]."""
    skeleton = representation_of(bundle.config).motion(bundle.statistics.rest_pose[:1], 1.0).skeleton
    time = np.arange(-FRAMES + 1, FRAMES + 1) / FRAMES
    poses = np.repeat(bundle.statistics.rest_pose[:1], len(time), axis=0)
    for side in ("LeftArm", "RightArm"):
        poses[:, 3 * skeleton.index(side)] += 1.2 * np.minimum(time, stop)
    made = bundle.statistics.normalise(poses, 0)
    return made[:FRAMES], made[FRAMES:]


def block_of(onsets: Array) -> SpeechBlock:
    nothing = np.zeros((3 * FRAMES, 2), np.float32)
    return SpeechBlock(4, 2.0, 2.5, (0.5, 0.5, 0.5), (False, False, False), nothing, nothing, None,
                       np.zeros(FRAMES, bool), onsets=onsets)


def choice(chooser: candidates.CandidateChooser, speech: SpeechBlock, past: Array, blocks: Array, apart: Array,
           control: Array | None = None, *, shift: Array | None = None) -> int:
    """The index of the candidate that is kept."""
    return chooser.choose(speech, chooser.motion(speech, past, blocks, shift), apart, control)


def test_of_those_that_show_the_lexeme_the_one_is_kept_that_stops_at_the_onset(
        bundle: Bundle, few: pytest.MonkeyPatch) -> None:
    chooser = candidates.CandidateChooser(bundle, 0)
    stops = (0.3, 0.5, 0.8)
    past = swing(bundle, 0.3)[0]
    blocks = np.stack([swing(bundle, stop)[1] for stop in stops])
    shown = np.ones(3)
    for best, stop in enumerate(stops):
        assert choice(chooser, block_of(np.array([2.0 + 0.5 * stop])), past, blocks, shown) == best
    assert choice(chooser, block_of(np.array([2.4])), past, blocks, np.array([1.0, 1.0, 3.0])) != 2
    assert choice(chooser, block_of(np.zeros(0)), past, blocks, np.array([2.0, 1.0, 1.2])) == 1, "no onset, no opinion"
    assert choice(chooser, block_of(np.array([2.4])), past, blocks[:1], np.array([7.0])) == 0


def test_a_hand_in_the_trunk_is_as_deep_as_it_is_and_the_candidate_without_is_kept(
        bundle: Bundle, few: pytest.MonkeyPatch) -> None:
    places = np.zeros((4, 2, 8, 3))
    places[:, :, 7, 1] = 9.0  # a head far from the arms
    places[:, :, 6, 1], places[:, :, :4, 0], places[:, :, 4:6] = 0.5, [-0.5, 0.5, -0.5, 0.5], SHOULDERS
    places[1, :, 0] = [0.0, 0.25, 0.07]  # half the radius from the middle of the trunk, 45 mm behind its front
    places[2, 0, 3] = [0.0, 0.7, 0.05]  # an elbow 20 cm over the chest
    places[3, 0, 1] = [0.44, 0.6, 0.0]  # at the edge of the shoulder's sphere
    places[3, 1, 1] = [0.305, 0.6, 0.0]  # half its radius from the shoulder, and outside the trunk
    np.testing.assert_allclose(candidates.depth(places), [0.0, 0.5 + 0.045 / 0.14, 0.0, 0.25], atol=1e-9)
    chooser = candidates.CandidateChooser(bundle, 0)
    past, wide = swing(bundle, 0.0)
    skeleton = representation_of(bundle.config).motion(bundle.statistics.rest_pose[:1], 1.0).skeleton
    poses = bundle.statistics.denormalise(wide, 0)
    outside = poses.copy()
    poses[:, 3 * skeleton.index("RightArm") + 2] += 2.0 * np.arange(1, FRAMES + 1) / FRAMES  # through the body
    blocks, shown = np.stack([bundle.statistics.normalise(poses, 0), wide]), np.array([1.0, 1.2])
    deep = candidates.depth(chooser._places(np.stack([poses, outside])))
    assert deep[0] > 0.1 and deep[1] == 0.0
    assert choice(chooser, block_of(np.zeros(0)), past, blocks, shown) == 0
    few.setattr(candidates, "BODY", 8.0)
    assert choice(chooser, block_of(np.zeros(0)), past, blocks, shown) == 1


def test_arms_behind_the_trunk_are_as_far_behind_as_they_are_and_not_beside_it_or_over_it() -> None:
    """The front of the trunk is 11.5 cm ahead of its middle and recedes by half a metre 20 cm above the shoulders; its
    back, for elbows, is 7 cm behind."""
    places = np.zeros((1, 5, 8, 3))
    places[..., 6, 1], places[..., 4:6, :], places[..., :4, :] = 0.5, SHOULDERS, [0.0, 0.3, 1.0]
    places[0, :, 0] = [0.0, 0.3, -0.1], [-0.5, 0.1, -0.1], [0.0, 0.8, -0.1], [0.0, 0.3, 0.2], [0.0, -0.2, -0.1]
    places[0, :, 3] = [0.1, 0.3, -0.17], [0.26, 0.3, -0.17], [0.1, 0.3, 0.0], [0.1, 0.8, -0.17], [0.1, 0.3, -0.07]
    behind = candidates.behind_trunk(places)
    np.testing.assert_allclose(behind[0, [0, 2, 3, 4], 0], [0.215, -0.285, -0.085, -0.285], atol=1e-9)
    assert behind[0, 1, 0] < -0.2, "a hand beside the trunk"
    np.testing.assert_allclose(behind[0, :, 3], [0.1, 0.02, -0.07, -0.4, 0.0], atol=1e-9)
    leaning = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    leaning *= np.sign(np.linalg.det(leaning))
    np.testing.assert_allclose(candidates.behind_trunk(places @ leaning.T), behind, atol=1e-9)


def test_an_arm_before_the_face_is_as_near_as_its_nearest_point() -> None:
    """The middle of the face is 9 cm over the joint of the head and 8 cm before it; the sphere has a radius of 22 cm,
    and a hand reaches 36 % of the forearm beyond the wrist."""
    places = np.zeros((4, 1, 8, 3))
    places[:, :, 7, 1], places[:, :, 6, 1] = 0.6, 0.4
    places[:, :, :4], places[:, :, 4:6, 1] = [[-0.6, 0.2, 0.0], [0.6, 0.2, 0.0]] * 2, -9.0
    places[:, :, 4:6, 0] = [-0.17, 0.17]
    places[1, :, 0], places[1, :, 2] = [-0.2, 0.69, 0.19], [0.2, 0.69, 0.19]  # a forearm 11 cm before it
    places[2, :, 0], places[2, :, 2] = [-0.186, 0.69, 0.08], [-0.436, 0.69, 0.08]  # the hand ends 9.6 cm beside it
    places[3, :, 0], places[3, :, 2] = [-0.31, 0.69, 0.08], [-0.56, 0.69, 0.08]  # 22 cm beside it
    np.testing.assert_allclose(candidates.depth(places), [0.0, 0.5, 1.0 - 0.096 / 0.22, 0.0], atol=1e-6)


def test_a_head_that_turns_with_the_hands_is_nearer_to_them_than_one_that_does_not() -> None:
    times = np.arange(-3, 11) * 0.05
    way = np.maximum(times, 0.0)[:, None, None] * np.array([1.0, 0.0, 0.0])  # both hands at 1 m/s
    hands = np.repeat(np.repeat(way, 2, axis=1)[None], 3, axis=0)
    head = np.zeros((3, len(times), 6))
    # Twice as fast as in speech, as the hands are: 0.8 rad/s, of two joints together.
    head[0, :, 0] = head[0, :, 3] = 0.4 * np.maximum(times, 0.0)
    head[1, :, 0] = 0.4 * np.maximum(times, 0.0)
    apart = candidates.apart_from_hands(head, hands, times)
    np.testing.assert_allclose(apart, [0.0, np.log(2.1 / 1.1), np.log(2.1 / 0.1)], atol=1e-9)
    np.testing.assert_allclose(candidates.apart_from_hands(0 * head, 0 * hands, times), 0.0, atol=1e-9)


def test_of_those_that_nearly_show_it_the_one_is_kept_that_does_what_is_asked(
        bundle: Bundle, few: pytest.MonkeyPatch) -> None:
    levels = bundle.statistics.levels
    assert levels is not None
    chooser = candidates.CandidateChooser(bundle, 0)
    past, still = swing(bundle, 0.0)
    fast = swing(bundle, 1.0)[1]
    blocks, speech = np.stack([still, fast]), block_of(np.zeros(0))

    def asked(speed: float) -> Array:
        given = np.array([False, True, False])
        return np.repeat(control_rows(levels, np.array([0.0, speed, 0.0]), given)[None], FRAMES, axis=0)

    assert choice(chooser, speech, past, blocks, np.array([1.2, 1.0]), asked(0.0)) == 0
    assert choice(chooser, speech, past, blocks, np.array([1.0, 1.2]), asked(1.5)) == 1
    assert choice(chooser, speech, past, blocks, np.array([99.0, 1.0]), asked(0.0)) == 1, "it shows another lexeme"


def test_arms_that_people_do_not_have_are_beyond_them_by_how_much_they_are() -> None:
    times = np.arange(-3, 11) * 0.05
    rest = np.array([[-0.2, 0.1, 0.3], [0.2, 0.1, 0.3], [-0.25, 0.2, 0.1], [0.25, 0.2, 0.1], [-0.2, 0.45, 0.0],
                     [0.2, 0.45, 0.0], [0.0, 0.4, 0.0], [0.0, 0.6, 0.0]])

    def moved(joints: slice, way: Array) -> float:
        places = np.repeat(rest[None], len(times), axis=0)
        places[:, joints, 2] += way[:, None]
        return float(candidates.beyond(places[None], times)[0])

    hands, elbow, late = slice(0, 2), slice(2, 3), np.maximum(times, 0.0)
    assert moved(hands, 0.0 * times) == 0 and moved(hands, 0.5 * late) == 0
    # From 0 to 2.4 m/s within a frame of .05 s is twice 24 m/s^2.
    assert moved(hands, 2.4 * late) == pytest.approx(1.0)
    assert moved(slice(0, 8), 7.0 * times) == pytest.approx(1.0), "twice the greatest speed"
    assert moved(elbow, 1.25 * late) >= 1.0, "25 m/s^2 of an elbow"
    turn = np.minimum(np.maximum(times, 0.0), 0.3)
    places = np.repeat(rest[None], len(times), axis=0)
    # About the line from shoulder to wrist, at 460 degrees a second, twice the limit.
    line = rest[0] - rest[4]
    spin = Rotation.from_rotvec(math.radians(460.0) * turn[:, None] * line / np.linalg.norm(line))
    places[:, 2] = rest[4] + spin.apply(rest[2] - rest[4])
    turns, _ = candidates.swivel(*(places[:, k] for k in (4, 2, 0)))
    assert np.abs(turns) == pytest.approx(np.diff(math.radians(460.0) * turn), abs=1e-6)
    assert candidates.beyond(places[None], times)[0] >= 1.0 - 1e-6


def test_an_onset_a_deviation_away_counts_as_a_gaussian_says() -> None:
    """One stop from 1 m/s of both hands: 40 m/s^2 at once, beside the 3 of hands that hardly move."""
    times = np.arange(-3, 11) * 0.05
    way = np.minimum(times, 0.2)
    hands = np.stack([np.stack([way, 0 * way, 0 * way], -1)] * 2, axis=1)[None]
    near = [float(candidates.in_time(hands, times, 0.0, np.array([0.2 + away]))[0]) for away in (0.0, 0.05, -0.1)]
    np.testing.assert_allclose(near, 40 / 43 * np.exp([0.0, -0.5, -2.0]), rtol=1e-6)


def test_a_retimed_block_is_earlier_or_later_in_its_middle_and_keeps_its_ends() -> None:
    steps = np.arange(-1, FRAMES + 1) / FRAMES
    early, *_, same, _, _, late = candidates.retimings(FRAMES, 0.1) @ np.stack([steps, steps ** 2], axis=1)
    t = steps[2:]
    np.testing.assert_array_equal(same, np.stack([t, t ** 2], axis=1))
    for made, shift in ((early, -0.1), (late, 0.1)):
        expected = t + shift * 16.0 * t ** 2 * (1.0 - t) ** 2
        np.testing.assert_allclose(made[:, 0], expected, atol=1e-12, err_msg="a straight way is another clock")
        inner = slice(1, -2)  # the spline of the last piece does not know what comes after it
        np.testing.assert_allclose(made[inner, 1], expected[inner] ** 2, atol=1e-12)
    assert late[4, 0] - t[4] == pytest.approx(0.1) and late[-1, 0] == 1.0, "by a tenth in the middle"
    assert (np.diff(candidates.retimings(FRAMES, 0.3)[:, :, :] @ steps, axis=1) > 0.0).all(), "time never goes back"
