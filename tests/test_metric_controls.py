"""The controls are what they say: real clips put to the wrong use, each in one known way."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_module.motion import rotation
from data_module.motion.kinematics import positions_of
from data_module.motion.skeletons import CHARACTER, facing
from data_module.speech.audio import load_speech
from data_module.types import Motion
from eval.ablate.rows import DOSES
from eval.baselines import controls
from gesticulator.gesticulator import Gesticulator

EXAMPLE = Path(__file__).parents[1] / "examples" / "speech.flac"


def clip(frames: int, seed: int, fps: float = 20.0) -> Motion:
    rng = np.random.default_rng(seed)
    walk = np.cumsum(0.02 * rng.normal(size=(frames, len(CHARACTER), 3)), axis=0) + 0.2 * rng.normal(
        size=(len(CHARACTER), 3))
    return Motion(CHARACTER, rotation.continuous(rotation.from_exponential_map(walk)), rng.normal(size=(frames, 3)),
                  fps)


CLIPS = [clip(frames, seed) for seed, frames in enumerate((30, 50, 41, 36, 60, 25))]


@pytest.mark.parametrize("name", sorted(controls.CONTROLS))
def test_the_seed_decides_and_the_clips_stay_as_they_were(name: str) -> None:
    before = [own.rotations.copy() for own in CLIPS]
    first, second = controls.CONTROLS[name](CLIPS, NAMES, 4), controls.CONTROLS[name](CLIPS, NAMES, 4)
    assert len(first) == len(CLIPS)
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.rotations, b.rotations)
        np.testing.assert_array_equal(a.root_positions, b.root_positions)
        assert a.fps == 20.0 and a.skeleton is CHARACTER
    for own, kept in zip(CLIPS, before, strict=True):
        np.testing.assert_array_equal(own.rotations, kept)


NAMES = [str(number) for number in range(len(CLIPS))]


@pytest.mark.parametrize(("kind", "doses"), sorted(DOSES.items()))
def test_each_dose_of_damage_is_further_from_the_clips_than_the_one_before(kind: str, doses: int) -> None:
    assert len(controls.DAMAGES[kind]) == doses and set(controls.DAMAGES) == set(DOSES)
    away = [0.0, *(np.mean([np.abs(positions_of(one) - positions_of(other)).mean() for one, other in
                            zip(CLIPS, damage(CLIPS), strict=True)]) for damage in controls.DAMAGES[kind])]
    assert all(more > less + 1e-3 for less, more in itertools.pairwise(away))


def test_damage_halves_and_doubles_the_angle_from_the_mean_pose_and_stills_the_trunk() -> None:
    def angle(clip: Motion, joint: str) -> np.ndarray:
        k = CHARACTER.index(joint)
        return rotation.angle_between(clip.rotations[:, k], mean.rotations[:, k])

    mean, = controls.mean_pose(CLIPS[:1])
    for kind, factor in (("smaller", 0.5), ("larger", 2.0)):
        moved, = controls.DAMAGES[kind][-1](CLIPS[:1])
        np.testing.assert_allclose(angle(moved, "RightArm"), factor * angle(CLIPS[0], "RightArm"), atol=1e-6)
    frozen, = controls.DAMAGES["frozen-trunk"][-1](CLIPS[:1])
    assert angle(frozen, "Spine1").max() < 1e-6
    np.testing.assert_allclose(angle(frozen, "RightArm"), angle(CLIPS[0], "RightArm"), atol=1e-9)


def test_halves_are_all_clips_once_and_about_as_long() -> None:
    first, second = controls.split_halves(CLIPS, NAMES, 0)
    assert sorted(first + second) == list(range(len(CLIPS)))
    seconds = [sum(CLIPS[k].duration for k in half) for half in (first, second)]
    assert abs(seconds[0] - seconds[1]) <= max(own.duration for own in CLIPS)
    assert any(controls.split_halves(CLIPS, NAMES, seed)[0] != first for seed in range(1, 6))


def test_a_group_is_never_split() -> None:
    groups = ["a", "a", "b", "c", "b", "c"]
    for seed in range(10):
        first, second = controls.split_halves(CLIPS, groups, seed)
        assert first and second and not {groups[k] for k in first} & {groups[k] for k in second}
    with pytest.raises(ValueError):
        controls.split_halves(CLIPS, ["a"] * 6, 0)


@given(sizes=st.lists(st.integers(1, 4), min_size=2, max_size=6), seed=st.integers(0, 99))
def test_every_speech_gets_the_motion_of_another_group_and_every_motion_is_given_once(sizes: list[int], seed: int
                                                                                      ) -> None:
    groups = [str(k) for k, size in enumerate(sizes) for _ in range(size)]
    if 2 * max(sizes) > len(groups):
        with pytest.raises(ValueError):
            controls.donors(groups, seed)
        return
    giver = controls.donors(groups, seed)
    assert sorted(giver) == list(range(len(groups)))
    assert all(groups[k] != groups[giver[k]] for k in range(len(groups)))


def test_shuffled_clips_are_cut_to_the_speech() -> None:
    giver = controls.donors(NAMES, 0)
    for k, own in enumerate(controls.shuffled(CLIPS, NAMES, 0)):
        assert giver[k] != k and len(own) == min(len(CLIPS[k]), len(CLIPS[giver[k]]))
        np.testing.assert_array_equal(own.rotations, CLIPS[giver[k]].rotations[:len(own)])
    with pytest.raises(ValueError):
        controls.shuffled(CLIPS[:1], ["a"], 0)


def test_reversed_twice_is_the_clip() -> None:
    once = controls.reversed_in_time(CLIPS)
    np.testing.assert_array_equal(once[1].rotations[0], CLIPS[1].rotations[-1])
    np.testing.assert_array_equal(once[1].root_positions[-1], CLIPS[1].root_positions[0])
    for own, twice in zip(CLIPS, controls.reversed_in_time(once), strict=True):
        np.testing.assert_array_equal(own.rotations, twice.rotations)


def test_jitter_is_two_centimetres_at_every_joint_and_does_not_add_up() -> None:
    long = clip(600, 3)
    off = positions_of(controls.jittered([long], 0)[0]) - positions_of(long)
    deviation = off.reshape(-1, len(CHARACTER), 3).std(axis=(0, 2))
    assert (deviation[:2] < 1e-12).all()  # the root, and the joint that hangs on it
    assert (deviation[2:] > 0.8 * controls.JITTER).all() and (deviation[2:] < 1.2 * controls.JITTER).all()
    # nor does it grow where metrics look from the facing hips
    faced = positions_of(facing(controls.jittered([long], 0)[0])) - positions_of(facing(long))
    np.testing.assert_allclose(faced.reshape(-1, len(CHARACTER), 3).std(axis=(0, 2)), deviation, rtol=0.1, atol=1e-9)
    # white: what it is in one frame says nothing of the next
    hands = off[:, CHARACTER.index("LeftHand"), 0]
    assert abs(np.corrcoef(hands[1:], hands[:-1])[0, 1]) < 0.15


def test_jitter_keeps_the_bones_and_what_is_absent() -> None:
    np.testing.assert_allclose(positions_of(controls.jittered(CLIPS[:1], 0, 0.0)[0]), positions_of(CLIPS[0]), atol=1e-9)
    lacking = replace(CLIPS[1], rotations=CLIPS[1].rotations.copy(), absent=("Spine3",))
    lacking.rotations[:, CHARACTER.index("Spine3")] = (1.0, 0.0, 0.0, 0.0)
    got = controls.jittered([lacking], 1)[0]
    np.testing.assert_array_equal(got.rotations[:, CHARACTER.index("Spine3")], lacking.rotations[:, 4])
    assert got.absent == ("Spine3",)
    places = positions_of(got)
    off = (places - positions_of(lacking))[:, [CHARACTER.index(name) for name in ("LeftHand", "RightHand", "Head")]]
    assert 0.8 * controls.JITTER < off.std() < 1.4 * controls.JITTER
    for joint, parent in enumerate(CHARACTER.parents):
        if parent >= 0:
            np.testing.assert_allclose(np.linalg.norm(places[:, joint] - places[:, parent], axis=-1),
                                       np.linalg.norm(CHARACTER.offsets[joint]), atol=1e-9)


def test_rolled_speech_is_that_of_other_blocks_on_the_same_grid(system: Gesticulator) -> None:
    encoded = system.encode_speech(load_speech(EXAMPLE))
    rolled, source = controls.rolled(encoded, 10), np.roll(np.arange(len(encoded)), 10)
    np.testing.assert_array_equal(rolled.blocks.edges, encoded.blocks.edges)
    np.testing.assert_array_equal(rolled.low[..., :-1], encoded.low[source][..., :-1])
    np.testing.assert_array_equal(rolled.low[..., -1], encoded.low[..., -1], "the tempo belongs to the grid")
    np.testing.assert_array_equal(rolled.blocks.silent, encoded.blocks.silent[source])
    assert encoded.onsets is not None and rolled.onsets is not None
    for block, k in enumerate(source):
        start, end = encoded.blocks.edges[[block, block + 1]]
        assert len(rolled.onsets[block]) == len(encoded.onsets[k])
        assert ((rolled.onsets[block] >= start - 1e-9) & (rolled.onsets[block] <= end + 1e-9)).all()
