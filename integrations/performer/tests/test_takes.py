"""Real takes: mirrored, calmed, cut, split, chained without seams, and with speech made for them.

Phrases are found in the motion, vowels put on beats, and sound stretched to meet them; arms that were turned outward
are turned back.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from gesticulator_performer import inverse, joints, takes
from gesticulator_performer.joints import FPS, facing_positions, torso_depth
from gesticulator_performer.sound import RATE
from gesticulator_performer.takes import HIPS, SKULL, SPINE, Library, MotionRange, RealTake, arms_speed
from gesticulator_performer.talks import chain, features_of, seam_ratio
from hypothesis import given, settings
from hypothesis import strategies as st

from data_module.motion import kinematics, rotation
from data_module.motion.motion_beats import beats_of_speed
from data_module.motion.skeletons import CHARACTER, FINGER_JOINTS, FINGERED
from data_module.types import Array, Motion
from eval.metrics.eye import posture
from eval.metrics.eye.body import common_body

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


@pytest.fixture(scope="module")
def captured(free_motion: Path) -> Library:
    return takes.load_takes(free_motion.parent)


def test_takes_as_published_lose_their_turning(captured: Library) -> None:
    talks = captured.talks()
    assert 60 <= len(talks) <= 70 and 10.0 < sum(map(len, talks)) / 3600 < 11.5
    places = kinematics.joint_positions(CHARACTER, captured.rest[None])[0]
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
        for logs in takes.stretches(captured, take, MotionRange(0.5, 1.0)):
            q = captured.rotations(logs)
            yaw = rotation.yaw_of(q[:, 0])
            assert np.degrees(2.0 * np.arctan2(np.abs(yaw[:, 2]), np.abs(yaw[:, 0]))).max() < 15.0
            assert facing_positions(q)[:, list(takes.WRISTS), 1].max() < 0.5 + 0.2


def test_phrases_of_motion_are_what_lies_between_its_rests(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inverse, "_MOVED_SHARE", 0.0)
    spans = [(0.6, 3.0), (3.8, 6.4), (7.4, 9.6), (10.3, 13.4)]
    # Arms that move at about 1 m/s, a stroke each 0.4 s, in the spans and rest elsewhere.
    time = np.arange(round(14.0 * FPS)) / FPS
    speed = np.full(len(time), 0.02)
    for a, b in spans:
        inside = (time >= a) & (time < b)
        speed[inside] += 1.0 + 0.5 * np.cos(2 * np.pi * (time[inside] - a) / 0.4)
    windows = inverse.phrase_windows(speed, np.random.default_rng(0))
    assert len(windows) == len(spans)
    for window, (a, b) in zip(windows, spans, strict=True):
        assert abs(window.start - a) < 0.3 and abs(window.end - b) < 0.3


@pytest.mark.parametrize(("vowels", "duration", "window", "beats"), [
    ([0.2, 0.7, 1.2, 1.7], 2.0, (5.0, 7.0), [5.2, 5.7, 6.2, 6.7]), ([0.2], 3.0, (5.0, 6.0), [5.2])])
def test_beats_are_met_at_the_voices_own_rate_and_what_is_too_long_is_refused(
        vowels: list[float], duration: float, window: tuple[float, float], beats: list[float]) -> None:
    count = len(vowels)
    phrase = inverse.Candidates(np.array([7]), np.array([duration]), np.array([vowels]), np.ones((1, count)))
    wanted = inverse.Wanted(inverse.Window(*window), np.array(beats), np.ones(count), np.zeros((count, 7)))
    match = inverse.assign(phrase, wanted, np.ones((1, count, count)))
    if duration > 2.0:
        assert match is None
    else:
        assert match is not None and match.phrase == 7 and match.beats == 4
        assert match.anchors[:, 1] - match.anchors[:, 0] == pytest.approx(5.0, abs=1e-9)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000))
def test_every_assignment_is_monotone_and_in_bounds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count, places = 12, 8
    vowels = np.cumsum(rng.uniform(0.12, 0.45, (count, places)), axis=1)
    lengths = rng.integers(3, places + 1, count)
    duration = vowels[np.arange(count), lengths - 1] + 0.2
    vowels[np.arange(places) >= lengths[:, None]] = inverse.NO_VOWEL
    candidates = inverse.Candidates(np.arange(count), duration, vowels, rng.normal(0.0, 1.0, (count, places)))
    beats = np.cumsum(rng.uniform(0.05, 0.7, 5)) + 1.0
    window = inverse.Window(1.0, float(beats[-1]) + 0.3)
    wanted = inverse.Wanted(window, beats, rng.uniform(0.4, 2.0, 5), np.zeros((5, 7)))
    match = inverse.assign(candidates, wanted, rng.uniform(0.0, 2.0, (count, places, 5)))
    if match is None:
        return
    steps = np.diff(match.anchors, axis=0)
    assert (steps > 0).all()
    assert (steps[:, 0] / steps[:, 1]).min() >= inverse.SLOWEST - 1e-9
    assert (steps[:, 0] / steps[:, 1]).max() <= inverse.FASTEST + 1e-9
    inner = match.anchors[1:-1]
    assert all(np.abs(vowels[match.phrase] - a).min() < 1e-9 and np.abs(beats - b).min() < 1e-9 for a, b in inner)
    assert len(inner) == match.beats


def test_speech_for_motion_stresses_its_beats_and_pauses_in_its_rests() -> None:
    pool = inverse.make_pool("rms", inverse.phrase_texts(np.random.default_rng(5), 220, "train", set()))
    lib = library(1)
    logs = moving(40.0, 11)
    # Rests: the arms slow down to nothing every four seconds.
    time = np.arange(len(logs)) / FPS
    clock = np.cumsum(np.clip(3.0 * np.abs(np.sin(np.pi * time / 4.0)), 0.0, 1.0)) / FPS
    at = clock / clock[-1] * (len(logs) - 1)
    logs = np.stack([np.interp(at, np.arange(len(logs)), column) for column in logs.reshape(len(logs), -1).T], axis=-1)
    places = facing_positions(lib.rotations(logs.reshape(-1, 16, 3)))
    made, again = (inverse.speech_for(places, pool, features_of(places),
                                      np.random.default_rng(3)) for _ in range(2))
    assert np.array_equal(made.speech.samples, again.speech.samples)
    assert len(made.speech.samples) == round(len(places) / FPS * RATE)
    speed = arms_speed(places)
    beats = beats_of_speed(speed, FPS)
    vowels = np.array([s.vowel for s in made.syllables])
    phrases = made.phrases
    assert len(phrases) >= 6
    assert all(a.end <= b.start for a, b in zip(phrases, phrases[1:], strict=False))
    spoken = np.array([b for b in beats if any(p.start < b < p.end for p in phrases)])
    off = np.abs(vowels[None] - spoken[:, None] - 0.038).min(axis=1)
    shifts = 0.31 + 0.9 * np.arange(20.0)
    chance = np.abs(vowels - (spoken[:, None, None] + shifts[:, None]) % 40.0 - 0.038).min(axis=-1)
    assert np.mean(off < 0.1) > np.mean(chance < 0.1) + 0.1
    words = made.speech.words
    assert words and all(w.end >= w.start for w in words)
    assert all(any(p.start - 0.05 <= w.start <= p.end + 0.05 for p in phrases) for w in words)


def test_a_hand_in_the_trunk_comes_out_of_it_and_other_hands_stay() -> None:
    rotations = np.tile(hanging(), (round(4.0 * FPS), 1, 1))
    bends = np.radians(75.0 + np.sin(np.arange(len(rotations)) / 40.0))
    left = CHARACTER.index("LeftArm")
    # The left elbow points inward.
    inward = rotation.from_exponential_map(np.array([np.radians(75.0), 0.0, 0.0]))
    rotations[:, left] = rotation.multiply(rotations[:, left], inward)
    rotations[:, left + 1] = rotation.from_exponential_map(bends[:, None] * np.array([0.0, -1.0, 0.0]))
    before, after = (facing_positions(q) for q in (rotations, joints.freed(rotations)))
    assert torso_depth(before).max() > 0.02 and torso_depth(after).max() < 1e-9
    wrist = CHARACTER.index("RightHand")
    assert np.allclose(before[:, wrist], after[:, wrist])


@pytest.mark.parametrize("subject", sorted(joints.SUBJECTS))
def test_every_subject_holds_arms_and_hands_as_speakers_do(captured: Library, subject: str) -> None:
    own = [take for take in captured.talks() if joints.subject_of(take.name) == subject]
    pieces = [logs for take in own for logs in takes.stretches(captured, take, MotionRange(0.5, 1.0))]
    motions = [Motion(FINGERED, captured.rotations(logs), np.zeros((len(logs), 3)), FPS) for logs in pieces]
    seconds = np.array([len(motion) for motion in motions])
    rows = [posture.figures(common_body(motion)) for motion in motions]

    def mean(name: str) -> float:
        values = np.array([row[name] for row in rows])
        known = np.isfinite(values)
        return float(np.average(values[known], weights=seconds[known]))

    assert seconds.sum() > 12 * FPS, "cmu_18 listens with hanging hands for most of the time"
    assert mean("eye_splay") <= 15.0 and -35.0 <= mean("eye_azimuth") <= 5.0 and 45.0 <= mean("eye_elbow") <= 100.0
    assert 0.45 <= mean("eye_shoulder") <= 1.1, "stretches of some seconds; whole talks have more"
    assert 25.0 <= mean("eye_wrist_95") <= 65.0
    assert 17.0 <= mean("eye_finger_bend") <= 35.0 and mean("eye_finger_between") >= 7.0
    assert mean("eye_thumb_index") <= 0.85
    assert all(torso_depth(facing_positions(motion.rotations)).max() < 0.01 for motion in motions)
