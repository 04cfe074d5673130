"""Real takes: mirrored, calmed, cut, split, and chained without seams."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from gesticulator_performer import takes
from gesticulator_performer.joints import FPS, facing_positions
from gesticulator_performer.takes import HIPS, SKULL, SPINE, Library, MotionRange, RealTake
from gesticulator_performer.talks import chain, seam_ratio

from data_module.motion import kinematics, rotation
from data_module.motion.skeletons import CHARACTER, FINGER_JOINTS, FINGERED
from data_module.types import Array

LEFT_ARM, RIGHT_ARM = CHARACTER.index("LeftArm"), CHARACTER.index("RightArm")


def hanging() -> Array:
    """[16, 4] arms down from the T-pose."""
    rest = np.tile([1.0, 0.0, 0.0, 0.0], (16, 1))
    rest[LEFT_ARM] = rotation.from_exponential_map(np.array([0.0, 0.0, -1.4]))
    rest[RIGHT_ARM] = rotation.from_exponential_map(np.array([0.0, 0.0, 1.4]))
    return rest


def moving(seconds: float, seed: int, size: float = 0.8) -> Array:
    """Logs [T, 16, 3] of arms that swing ahead and up, each in its own time, and a trunk that turns."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * FPS)) / FPS
    logs = np.zeros((len(time), 16, 3))
    for arm in (LEFT_ARM, RIGHT_ARM, LEFT_ARM + 1, RIGHT_ARM + 1):
        for axis in range(3):
            waves = sum(np.sin(2 * np.pi * f * time + rng.uniform(0, 6.3)) / 3 for f in rng.uniform(0.3, 1.1, 3))
            logs[:, arm, axis] = size * 0.6 * waves
        # Turned about its own y a hanging left arm comes forward at negative, a right one at positive angles.
        logs[:, arm, 1] += (-1.1 if CHARACTER.names[arm].startswith("Left") else 1.1) * size
    for joint in (*HIPS, *SPINE, *SKULL):
        logs[:, joint] = 0.1 * np.sin(2 * np.pi * rng.uniform(0.1, 0.3, 3) * time[:, None] + rng.uniform(0, 6.3, 3))
    return logs


def library(count: int) -> Library:
    own = tuple(RealTake(f"take_{k}", "ann", "conversation", "none", moving(8.0, k)) for k in range(count))
    return Library(own, hanging(), np.zeros((8, 3)))


def test_a_mirror_image_swaps_the_hands_and_twice_is_nothing() -> None:
    lib, logs = library(1), moving(1.0, 3)
    assert np.allclose(takes.mirrored(takes.mirrored(logs)), logs)
    first = facing_positions(lib.rotations(logs))
    second = facing_positions(lib.rotations(takes.mirrored(logs)))
    left, right = takes.WRISTS
    assert np.allclose(first[:, left] * [-1, 1, 1], second[:, right], atol=1e-9)


def test_idling_and_hands_too_high_are_cut_out() -> None:
    lib = library(1)
    logs = moving(12.0, 5)
    logs[240:480] = logs[240]
    still = RealTake("still", "ann", "conversation", "none", logs)
    parts = takes.stretches(lib, still, MotionRange(0.9, 1.0))
    assert len(parts) == 2
    kept = sum(map(len, parts)) / FPS
    assert 8.5 < kept < 10.0, "4 s of idling, half a second kept at either end"
    high = RealTake("high", "ann", "conversation", "none", logs.copy())
    high.logs[540:660, LEFT_ARM] = [0.0, 0.0, 2.6]
    low = takes.stretches(lib, high, MotionRange(0.45, 1.0))
    places = facing_positions(lib.rotations(np.concatenate(low)))
    assert places[:, list(takes.WRISTS), 1].max() < 0.45 + 0.16 + 0.1


def test_splits_by_take_hold_whoever_else_is_there() -> None:
    many = [RealTake(f"cmu_138_{k}", "a", "story", "", np.zeros((0, 16, 3))) for k in range(40)]
    few = [RealTake(f"cmu_80_{k}", "b", "lesson", "", np.zeros((0, 16, 3))) for k in range(2)]
    splits = takes.split_of_takes([*many, *few])
    assert [list(splits.values()).count(s) for s in ("train", "val", "test")] == [30, 4, 8]
    assert takes.split_of_takes(many) == {name: split for name, split in splits.items() if "138" in name}
    assert takes.split_of_takes(reversed([*many, *few])) == splits


def test_seams_of_a_chain_cannot_be_told_from_the_rest() -> None:
    lib = library(8)
    pieces = [take.logs for take in lib.takes]
    ratios = []
    for seed in range(4):
        out = chain(pieces, 40.0, np.random.default_rng(seed), recent=3)
        hands = facing_positions(lib.rotations(out.logs))[:, list(takes.WRISTS)]
        ratios.append(seam_ratio(hands, out.edges))
        assert len(out.logs) == 40 * FPS and out.edges[-1] == 40.0 and (np.diff(out.edges)[:-1] > 1.5).all()
        assert all(out.used[k] not in out.used[max(0, k - 3):k] for k in range(1, len(out.used)))
        # The same takes cut together without care jump at every seam.
        hard = np.concatenate([pieces[k][:int((b - a) * FPS)] for k, a, b in
                               zip(out.used, out.edges, out.edges[1:], strict=False)])
        cut = facing_positions(lib.rotations(hard))[:, list(takes.WRISTS)]
        assert seam_ratio(cut, out.edges) > 3.0
    assert max(ratios) < 1.35


def test_takes_as_published_lose_their_turning(outside_data: Path) -> None:
    folder = outside_data / "free_motion"
    if not (folder / "manifest.csv").is_file():
        pytest.skip("the outside data has no free_motion")
    lib = takes.load_takes(folder)
    talks = lib.talks()
    assert 60 <= len(talks) <= 70 and 10.0 < sum(map(len, talks)) / 3600 < 11.5
    places = kinematics.joint_positions(CHARACTER, lib.rest[None])[0]
    for wrist, side in zip(takes.WRISTS, (1.0, -1.0), strict=True):
        assert places[wrist, 1] < 0.06 and 0.1 < side * places[wrist, 0] < 0.4, "the rest pose hangs"
    # Whose fingers were recorded keeps them; the others' hands open and close with their arms.
    fingers = [FINGERED.index(joint) for joint in FINGER_JOINTS]
    for take in talks:
        assert take.filled == (FINGER_JOINTS if take.name.startswith("cmu") else ()), take.name
        assert take.logs.shape[1] == 46 and (take.logs[:, fingers].std(axis=0).max(axis=1) > 0.005).mean() > 0.8
        assert np.degrees(np.linalg.norm(take.logs[:, fingers], axis=-1)).max() < 180.0
    # Slow turning is gone, and hands stay in range.
    for take in talks[:12]:
        for logs in takes.stretches(lib, take, MotionRange(0.5, 1.0)):
            q = lib.rotations(logs)
            yaw = rotation.yaw_of(q[:, 0])
            assert np.degrees(2.0 * np.arctan2(np.abs(yaw[:, 2]), np.abs(yaw[:, 0]))).max() < 15.0
            assert facing_positions(q)[:, list(takes.WRISTS), 1].max() < 0.5 + 0.2
