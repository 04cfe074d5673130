"""Hands of those who sit lie on their thighs and do not enter them: known answers, no jump."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from performances import example, turned

from data_module.motion import rotation
from data_module.motion.kinematics import positions_of
from data_module.motion.skeletons import CHARACTER, FINGERED, SIDES, WHOLE_BODY
from data_module.types import Array, Motion
from gesticulator import Gesticulator
from gesticulator.body.clips import mirrored_motion
from gesticulator.body.legs import seated, with_legs
from gesticulator.contacts.default_body import cleared
from gesticulator.contacts.lap import FINGERTIPS, RADII, Thigh, is_seated

FPS = 60.0
PARTS = ("Hand", "HandMiddle1", *FINGERTIPS)
WAY = 0.3 - 0.9 * np.cos(2.0 * np.pi * np.arange(120) / 120)
"""Radians by which an arm swings ahead and back in two seconds."""


def swung(ahead: Array, across: float = -1.75, elbow: float = 0.1) -> Motion:
    """A left arm that hangs over the thigh and is swung ahead by `ahead` [T], radians; on the fingered skeleton."""
    down = rotation.from_exponential_map(np.tile([0.0, 0.0, across], (len(ahead), 1)))
    swing = rotation.from_exponential_map(ahead[:, None] * [-1.0, 0.0, 0.0])
    return turned(FINGERED, len(ahead), LeftArm=rotation.multiply(swing, down),
                  LeftForeArm=np.array([0.0, -elbow, 0.0]), RightArm=np.array([0.0, 0.0, 0.6]))


def out_of_thighs(places: Array, at: dict[str, int]) -> Array:
    """[T] metres from tapering round thighs to the nearest joint of a hand: the distance from the line of the bone."""
    gaps = []
    for side in SIDES:
        hip, knee = places[:, at[side + "UpLeg"]], places[:, at[side + "Leg"]]
        bone = knee - hip
        for joint in [other + part for other in SIDES for part in PARTS if other + part in at]:
            way = places[:, at[joint]] - hip
            share = np.clip(np.sum(way * bone, axis=1) / np.sum(bone ** 2, axis=1), 0.0, 1.0)
            gaps.append(np.linalg.norm(way - share[:, None] * bone, axis=1) - np.interp(share, [0.0, 1.0], RADII))
    return np.min(gaps, axis=0)


def of_ours(motion: Motion) -> Array:
    """`out_of_thighs` of a motion on the whole skeleton."""
    return out_of_thighs(positions_of(motion), {name: joint for joint, name in enumerate(motion.skeleton.names)})


def test_the_surface_of_a_round_thigh_by_hand() -> None:
    radius = sum(RADII) / 2.0  # halfway to the knee
    thigh = Thigh(np.array([[0.1, -0.05, 0.0]]), np.array([[0.1, -0.05, 0.4]]))
    on_top, beside, ahead = (np.array([[x, radius - 0.05, z]]) for x, z in ((0.1, 0.2), (0.3, 0.2), (0.1, 0.6)))
    depth, up = thigh.depth(np.concatenate([on_top, on_top + np.array([0.0, 0.03, 0.0]), beside, ahead]))
    np.testing.assert_allclose(depth[:2], [0.0, -0.03], atol=1e-12)
    assert depth[2] < -0.15 and depth[3] < -0.15, "beside it and ahead of the knee a hand may hang"
    np.testing.assert_allclose(up, [[0.0, 1.0, 0.0]], atol=1e-12)
    across = np.linspace(-0.4, 0.4, 2001)
    top = thigh.depth(np.stack([0.1 + across, np.full(2001, -0.05), np.full(2001, 0.2)], axis=1))[0]
    inside = np.abs(across) < radius
    assert (top[inside] >= np.sqrt(radius ** 2 - across[inside] ** 2) - 1e-9).all(), "it covers the thigh"
    assert np.abs(np.diff(top) / np.diff(across)).max() <= 1.2, "and is nowhere steeper than stated"


def test_a_hand_that_swings_through_a_thigh_is_led_over_it_without_a_jump() -> None:
    motion = swung(WAY)
    before, free = seated(cleared(motion)), seated(cleared(motion, sits=True))
    assert of_ours(before).min() < -0.03, "it does go through"
    assert of_ours(free).min() > 0.0, "no joint of hand or finger is in a thigh"
    joints = [WHOLE_BODY.index(name) for name in ("LeftHand", "LeftForeArm")]
    steps = [np.linalg.norm(np.diff(positions_of(one)[:, joints], axis=0), axis=-1).max(axis=0)
             for one in (before, free)]
    assert (steps[1] < 2.0 * steps[0].max()).all()
    legs = [WHOLE_BODY.index(name) for name in ("Hips", "LeftUpLeg", "RightArm", "Head")]
    np.testing.assert_array_equal(free.rotations[:, legs], before.rotations[:, legs])


def test_a_hand_that_lies_on_a_thigh_stays_near_it() -> None:
    still = swung(np.full(3, 0.3))
    gap = of_ours(seated(cleared(still, sits=True)))
    assert of_ours(seated(cleared(still))).max() < 0.0
    assert gap.min() > 0.0 and gap.max() < 0.03, "a finger touches, within the thickness of a hand"


def test_hands_that_are_clear_of_the_thighs_stay_bit_for_bit() -> None:
    tee = turned(CHARACTER, 4)
    assert cleared(tee, sits=True) is tee, "16 joints, without knuckles"
    folded = swung(np.full(4, 1.4))
    assert cleared(folded, sits=True) is cleared(folded) or (
        cleared(folded, sits=True).rotations == cleared(folded).rotations).all()


def test_a_body_without_fingers_keeps_its_hands_off_its_thighs() -> None:
    fingered = swung(WAY)
    rows = [FINGERED.index(name) for name in CHARACTER.names]
    bare = Motion(CHARACTER, fingered.rotations[:, rows], fingered.root_positions, FPS)
    places = positions_of(seated(cleared(bare, sits=True)))
    at = {name: joint for joint, name in enumerate(WHOLE_BODY.names) if name.endswith(("Hand", "UpLeg", "Leg"))}
    assert out_of_thighs(places, at).min() > 0.02, "the wrist"
    assert out_of_thighs(positions_of(seated(cleared(bare))), at).min() < 0.0


def test_hips_that_are_turned_under_the_body_do_not_move_the_seat() -> None:
    """The upper body keeps its pose when it is seated, and the hips become level under it."""
    motion = swung(WAY)
    turns = motion.rotations.copy()
    lean = rotation.from_exponential_map(np.tile([0.25, 0.0, 0.1], (len(motion), 1)))
    turns[:, 0] = lean
    assert of_ours(seated(cleared(replace(motion, rotations=turns), sits=True))).min() > 0.0


def test_both_sides_are_mirror_images() -> None:
    motion = swung(WAY)
    other = mirrored_motion(cleared(mirrored_motion(motion), sits=True))
    assert rotation.angle_between(other.rotations, cleared(motion, sits=True).rotations).max() < 1e-6


@settings(max_examples=25)
@given(st.floats(-0.6, 1.2), st.floats(-1.9, -1.2), st.floats(0.0, 1.2), st.floats(-0.02, 0.02))
def test_a_small_step_of_the_arm_is_a_small_step_after_it(ahead: float, across: float, elbow: float,
                                                          step: float) -> None:
    pair = positions_of(cleared(swung(np.array([ahead, ahead + step]), across, elbow), sits=True))
    hand = pair[:, FINGERED.index("LeftHandMiddle1")]
    assert np.linalg.norm(hand[1] - hand[0]) < 0.003 + 3.0 * abs(step)


def test_whether_somebody_sits_is_seen_from_the_thighs() -> None:
    motion = swung(WAY[:3])
    assert is_seated(seated(motion)) and not is_seated(with_legs(motion, 0)) and not is_seated(motion)


def test_no_hand_of_a_performance_that_sits_is_in_a_thigh(system: Gesticulator) -> None:
    motion = system(example(10.0), seed=1, seated=True, activity=0.3, mirror=True).motion
    assert of_ours(motion).min() > -0.003
