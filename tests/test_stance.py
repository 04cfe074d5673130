"""Legs that stand: feet that do not slide, knees that bend forward, hips over the feet; and legs that sit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from data_module.motion import kinematics, rotation
from data_module.motion.bvh import read_bvh
from data_module.motion.skeletons import FINGERED, HIP_HEIGHT, LEG_JOINTS, WHOLE_BODY, has_legs, resized, standing
from data_module.types import Array, Motion
from gesticulator.body.legs import CROSSES, SIDES, Stance, seated, with_legs
from gesticulator.body.life import noise, weight_shifts
from tests.performances import perform

SEEDS = range(4)
ANKLE, BALL = 0.080, 0.020
"""Metres over the floor of a foot that stands flat."""


_KNOWN: list[tuple[Motion, Array]] = []
"""Places of the motion that was asked for last."""


def drawn(seed: int = 0, seconds: float = 60.0, fps: float = 30.0, size: float = 1.0) -> Motion:
    """A body as models draw it: hips and spine that turn by some degrees, smoothly, without yaw of the hips."""
    times = np.arange(round(seconds * fps)) / fps
    maps = np.zeros((len(times), 46, 3))
    for number, (name, degrees) in enumerate((("Hips", (2.5, 0.0, 2.5)), ("Spine", (3.0, 4.0, 3.0)),
                                              ("Spine2", (3.0, 3.0, 2.0)), ("LeftArm", (20.0, 20.0, 20.0)))):
        channels = 5000 + 3 * number + np.arange(3)
        maps[:, FINGERED.index(name)] = size * np.radians(degrees) * noise(seed, channels, times, np.ones(3))
    maps[:, 0, 2] += np.radians(2.0) * size  # as a performer has it who stands on one leg
    turns = rotation.continuous(rotation.from_exponential_map(maps))
    turns[:, 0] = rotation.remove_yaw(turns[:, 0])
    return Motion(FINGERED, turns, np.zeros((len(times), 3)), fps)


def still(seconds: float = 60.0, fps: float = 30.0) -> Motion:
    return drawn(seconds=seconds, fps=fps, size=0.0)


def at(motion: Motion, name: str) -> Array:
    """[T, 3] metres."""
    if not (_KNOWN and _KNOWN[-1][0] is motion):
        _KNOWN[:] = [*_KNOWN[-1:], (motion, kinematics.positions_of(motion))]
    return _KNOWN[-1][1][:, motion.skeleton.index(name)]


def runs(mask: Array) -> list[tuple[int, int]]:
    """Begin and end of every run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def planted(motion: Motion, side: str) -> Array:
    """[T] whether the foot stands flat, to a millimetre."""
    return (at(motion, side + "Foot")[:, 1] < ANKLE + 1e-3) & (at(motion, side + "ToeBase")[:, 1] < BALL + 1e-3)


def knee_angles(motion: Motion, side: str) -> Array:
    """[T] degrees by which the knee is bent, from places alone."""
    hip, knee, ankle = (at(motion, side + part) for part in ("UpLeg", "Leg", "Foot"))
    thigh, shin = hip - knee, ankle - knee
    cosine = np.sum(thigh * shin, -1) / np.linalg.norm(thigh, axis=-1) / np.linalg.norm(shin, axis=-1)
    return 180.0 - np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def outside(point: Array, corners: Array) -> float:
    """Metres by which a point [2] lies outside the hull of corners [N, 2]; below 0 inside."""
    return float((ConvexHull(corners).equations @ np.append(point, 1.0)).max())


def sole(motion: Motion, side: str) -> Array:
    """[T, 4, 2] the corners of a shoe, X and Z: 5.5 cm behind the ankle to the toes, 9 cm wide."""
    ankle, ball = at(motion, side + "Foot")[:, [0, 2]], at(motion, side + "ToeBase")[:, [0, 2]]
    ahead = (ball - ankle) / np.linalg.norm(ball - ankle, axis=-1, keepdims=True)
    beside = 0.045 * np.stack([ahead[:, 1], -ahead[:, 0]], axis=-1)
    heel, toes = ankle - 0.055 * ahead, ball + 0.07 * ahead
    return np.stack([heel + beside, heel - beside, toes + beside, toes - beside], axis=1)


@pytest.mark.parametrize("seed", SEEDS)
def test_planted_feet_stay_where_they_are(seed: int) -> None:
    out = with_legs(drawn(seed), seed)
    for side, _ in SIDES:
        ankle, ball = at(out, side + "Foot"), at(out, side + "ToeBase")
        assert ankle[:, 1].min() > ANKLE - 1e-6 and ball[:, 1].min() > BALL - 1e-6, "nothing under the floor"
        flat = planted(out, side)
        assert flat.mean() > 0.9
        for a, b in runs(flat):
            assert max(np.ptp(ankle[a:b], axis=0).max(), np.ptp(ball[a:b], axis=0).max()) < 5e-3
        for a, b in runs(ball[:, 1] < BALL + 1e-3):  # also while the heel rises
            assert np.ptp(ball[a:b], axis=0).max() < 5e-3
    assert (planted(out, "Left") | planted(out, "Right")).all(), "one foot stands at any time"


def test_feet_are_set_down_elsewhere_now_and_then() -> None:
    lifts, ways = 0, []
    for seed in SEEDS:
        out = with_legs(drawn(seed, seconds=120.0), seed)
        for side, sign in SIDES:
            stands = runs(planted(out, side))
            lifts += len(stands) - 1
            places = np.array([at(out, side + "Foot")[(a + b) // 2] for a, b in stands])
            ways += np.linalg.norm(np.diff(places, axis=0), axis=-1).tolist()
            assert (sign * at(out, side + "Foot")[:, 0] > 0.05).all(), "each on its own side"
            for (_, a), (b, _) in zip(stands[:-1], stands[1:], strict=True):
                assert at(out, side + "ToeBase")[a:b, 1].max() > BALL + 0.02, "lifted, not dragged"
    assert 4 <= lifts <= 32, "in eight minutes"
    assert min(ways) > 0.02 and max(ways) < 0.1


@pytest.mark.parametrize("seed", SEEDS)
def test_knees_bend_forward_and_never_snap(seed: int) -> None:
    out = with_legs(drawn(seed), seed)
    for side, _ in SIDES:
        angle = knee_angles(out, side)
        assert angle.min() > 5.0 and angle.max() < 70.0
        hip, knee, ankle = (at(out, side + part) for part in ("UpLeg", "Leg", "Foot"))
        toes = at(out, side + "ToeBase") - ankle
        before = knee - (hip + ankle) / 2.0
        assert (np.sum(before[:, [0, 2]] * toes[:, [0, 2]], axis=-1) > 0).all(), "to where the toes point"
        assert np.abs(np.diff(angle)).max() * out.fps < 260.0
        # A foot in the air bends its knee fast; one that stands does not.
        flat = planted(out, side)
        assert np.abs(np.diff(angle))[flat[1:] & flat[:-1]].max() * out.fps < 200.0
        np.testing.assert_allclose(np.linalg.norm(knee - hip, axis=-1), 0.420, atol=1e-9)
        np.testing.assert_allclose(np.linalg.norm(ankle - knee, axis=-1), 0.405, atol=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_hips_are_over_the_feet_that_stand(seed: int) -> None:
    out = with_legs(drawn(seed), seed)
    hips = at(out, "Hips")[:, [0, 2]]
    soles = {side: sole(out, side) for side, _ in SIDES}
    stands = {side: planted(out, side) for side, _ in SIDES}
    for t in range(0, len(out), 5):
        assert outside(hips[t], np.concatenate([soles[side][t] for side in soles if stands[side][t]])) < 0.0


def test_nothing_jumps() -> None:
    # Where the acceleration is continuous, its change from frame to frame halves when there are twice as many.
    change = []
    for fps in (120.0, 240.0):
        out = with_legs(drawn(2, seconds=25.0, fps=fps), 2)
        places = np.stack([at(out, name) for name in ("Hips", "LeftLeg", "RightLeg", "LeftFoot", "RightFoot")], axis=1)
        change.append(np.abs(np.diff(places, n=3, axis=0)).max(axis=(0, 2)) * fps**2)
        # m/s and m/s^2: people who stand and talk move their hips by 0.05 to 0.25 m/s at most.
        assert np.linalg.norm(np.diff(places[:, 0], axis=0), axis=-1).max() * fps < 0.35
        assert np.linalg.norm(np.diff(places[:, 0], n=2, axis=0), axis=-1).max() * fps**2 < 3.0
    assert (change[1] < 0.6 * change[0] + 1e-6).all()


def test_the_upper_body_turns_as_it_was_drawn_and_travels_with_the_hips() -> None:
    motion = drawn(1)
    out = with_legs(motion, 1)
    before = kinematics.global_rotations(FINGERED, motion.rotations)[:, 1:]
    after = kinematics.global_rotations(WHOLE_BODY, out.rotations)[:, 1:46]
    assert np.degrees(rotation.angle_between(before, after)).max() < 1e-5
    assert np.degrees(rotation.angle_between(motion.rotations[:, 0], out.rotations[:, 0])).max() < 20.0
    for name in ("Head", "LeftHand"):
        moved = (at(out, name) - at(motion, name)) - out.root_positions
        assert np.linalg.norm(moved, axis=-1).max() < 0.015, "but for the turn of the hips under the spine"


def test_the_weight_follows_the_marked_shifts_of_the_idle_motion() -> None:
    changes = 0
    for seed in SEEDS:
        out, shifts = with_legs(still(seconds=120.0), seed), weight_shifts(seed)
        across = at(out, "Hips")[:, 0] - (at(out, "LeftFoot") + at(out, "RightFoot"))[:, 0] / 2.0
        side, n = 0.0, 0
        while (end := float(shifts.begins(np.array([n + 1]))[0])) < 120.0:
            roll = float(shifts.posture(n)[0])
            changes += bool(side) and side * roll < 0 and abs(roll) > CROSSES
            side = float(np.sign(roll)) if abs(roll) > CROSSES else side
            if side and planted(out, "Left")[round(30 * end)] and planted(out, "Right")[round(30 * end)]:
                assert side * across[round(30 * end) - 1] > 0.005, "at the end of each shift over that leg"
            n += 1
        rise = (at(out, "LeftUpLeg") - at(out, "RightUpLeg"))[:, 1]
        bent = knee_angles(out, "Right") - knee_angles(out, "Left")
        assert np.corrcoef(rise, bent)[0, 1] > 0.8, "the knee under the lower side of the pelvis is bent"
        assert np.corrcoef(across, rise)[0, 1] > 0.6, "which is the side that the hips are not over"
        assert np.abs(bent).mean() > 6.0, "people do not stand on two straight legs"
    assert 12 <= changes <= 48, "one to six a minute"


def test_hips_turn_with_the_chest_which_keeps_its_place() -> None:
    motion, times = still(seconds=20.0), np.arange(600) / 30.0
    yaw = np.radians(15.0) * np.sin(2.0 * np.pi * 0.3 * times)
    motion.rotations[:, FINGERED.index("Spine1")] = np.stack(
        [np.cos(yaw / 2.0), np.zeros(600), np.sin(yaw / 2.0), np.zeros(600)], axis=-1)
    out = with_legs(motion, 2)
    line = at(out, "LeftUpLeg") - at(out, "RightUpLeg")
    hips = np.arctan2(-line[:, 2], line[:, 0])
    wave = np.exp(-2.0j * np.pi * 0.3 * times[100:500])  # four periods
    response = 2.0 * np.mean(hips[100:500] * wave) / (2.0 * np.mean(yaw[100:500] * wave))
    assert abs(response) == pytest.approx(0.5, abs=0.08), "a share of what people do"
    assert -0.5 < np.angle(response) < 0.0, "a little later"


def test_knees_give_under_strokes() -> None:
    motion, times = still(seconds=30.0), np.arange(900) / 30.0
    shakes = np.radians(35.0) * np.sin(2.0 * np.pi * 1.2 * times) * (times > 10.0) * (times < 20.0)
    for joint in ("LeftArm", "RightArm"):
        maps = np.zeros((900, 3))
        maps[:, 2] = shakes
        motion.rotations[:, FINGERED.index(joint)] = rotation.from_exponential_map(maps)
    sunk = at(with_legs(still(seconds=30.0), 3), "Hips")[:, 1] - at(with_legs(motion, 3), "Hips")[:, 1]
    assert np.abs(sunk[:300]).max() < 1e-12, "not before"
    assert 0.001 < sunk[330:600].mean() < 0.006
    assert np.abs(sunk[-150:]).max() < 1e-3, "and not long after"


def test_a_small_change_of_the_motion_is_forgotten() -> None:
    motion = drawn(4, seconds=60.0)
    changed = replace(motion, rotations=motion.rotations.copy())
    turn = np.radians(8.0) * np.exp(-((np.arange(len(motion)) / motion.fps - 15.0) / 0.5) ** 2)
    changed.rotations[:, FINGERED.index("Spine2")] = rotation.multiply(
        np.stack([np.cos(turn / 2.0), 0.0 * turn, 0.0 * turn, np.sin(turn / 2.0)], axis=-1),
        changed.rotations[:, FINGERED.index("Spine2")])
    apart = np.linalg.norm(at(with_legs(motion, 4), "Hips") - at(with_legs(changed, 4), "Hips"), axis=-1)
    assert apart.max() < 0.03 and apart[-600:].max() < 2e-4


def test_weight_goes_to_where_the_drawn_hips_are_high() -> None:
    across = []
    for degrees in (-5.0, 5.0):
        motion = still()
        motion.rotations[600:, 0] = rotation.from_exponential_map(np.radians([0.0, 0.0, degrees]))
        across.append(at(with_legs(motion, 0), "Hips")[:, 0])
    assert np.allclose(across[0][:600], across[1][:600])
    gap = across[1] - across[0]
    assert gap[630:690].min() > 0.02, "left side up: on the left leg, which is at +X"
    assert np.abs(gap[-300:]).max() < 0.6 * gap.max(), "a roll that stays is a habit"


def test_who_does_nothing_is_never_quite_still() -> None:
    hips = at(with_legs(still(seconds=30.0), 5), "Hips")
    speed = np.linalg.norm(np.diff(hips, axis=0), axis=-1) * 30.0
    assert np.median(speed) > 0.003 and max((b - a for a, b in runs(speed < 1e-3)), default=0) < 30
    assert np.ptp(hips[:, 1]) < 0.03


def test_a_stream_stands_like_a_file() -> None:
    motion = drawn(3, seconds=40.0)
    whole, stance = with_legs(motion, 3), Stance(3, motion.fps)
    cuts = [0, 1, 2, 30, 500, 501, 1000, len(motion)]
    parts = [stance.step(motion.crop(a, b)) for a, b in zip(cuts[:-1], cuts[1:], strict=True)]
    np.testing.assert_allclose(np.concatenate([part.rotations for part in parts]), whole.rotations, atol=1e-12)
    np.testing.assert_allclose(np.concatenate([part.root_positions for part in parts]), whole.root_positions,
                               atol=1e-12)
    assert not np.allclose(with_legs(motion, 4).root_positions, whole.root_positions, atol=1e-3), "seeds differ"


def test_who_sits_sits_still() -> None:
    motion = drawn(1, seconds=5.0)
    out = seated(motion)
    for side, _ in SIDES:
        hip, knee, ankle, ball = (at(out, side + part) for part in ("UpLeg", "Leg", "Foot", "ToeBase"))
        np.testing.assert_allclose(hip[:, 1], knee[:, 1], atol=1e-9)
        np.testing.assert_allclose(ankle[:, [0, 2]], knee[:, [0, 2]], atol=1e-9)
        np.testing.assert_allclose([ankle[:, 1].mean(), ball[:, 1].mean()], [ANKLE, BALL], atol=1e-9)
        assert (knee[:, 2] > hip[:, 2] + 0.4).all(), "the thighs point ahead"
        assert max(np.ptp(place, axis=0).max() for place in (hip, knee, ankle, ball)) < 1e-9
    assert np.degrees(rotation.angle_between(out.rotations[:, 0], out.rotations[:1, 0])).max() < 1e-6
    before = kinematics.global_rotations(FINGERED, motion.rotations)[:, 1:]
    after = kinematics.global_rotations(WHOLE_BODY, out.rotations)[:, 1:46]
    assert np.degrees(rotation.angle_between(before, after)).max() < 1e-5


def test_one_frame_and_sixteen_joints_stand() -> None:
    out = with_legs(resized(still().crop(0, 1), WHOLE_BODY), 0)
    assert len(out) == 1 and out.filled == LEG_JOINTS and planted(out, "Left").all()
    assert not has_legs(still()) and not has_legs(resized(still(), WHOLE_BODY)) and has_legs(out)


def test_legs_stay_on_their_floor_in_what_is_written(tmp_path: Path) -> None:
    performance = perform(seconds=3.0, skeleton=FINGERED)
    for make in (lambda motion: with_legs(motion, 0), seated):
        made = replace(performance, motion=make(performance.motion))
        assert np.array_equal(standing(made.motion).root_positions, made.motion.root_positions)
        read = read_bvh(made.save(tmp_path / "legs.bvh"))
        order = [read.skeleton.index(name) for name in WHOLE_BODY.names]
        np.testing.assert_allclose(kinematics.positions_of(read)[:, order], made.positions(), atol=1e-4)
        assert made.positions()[:, WHOLE_BODY.index("LeftFoot"), 1].min() == pytest.approx(ANKLE, abs=1e-6)
    assert np.median(performance.positions()[:, 0, 1]) == pytest.approx(HIP_HEIGHT), "without legs as ever"
