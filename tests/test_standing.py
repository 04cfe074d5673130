"""A standing lower body: feet that stay, knees that bend forward, hips that balance."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_module.motion import kinematics, rotation, skeletons
from data_module.motion.skeletons import CHARACTER, WHOLE_BODY
from data_module.motion.standing_legs import with_standing_legs
from data_module.types import Array, Motion

FPS = 60.0
FEET = [WHOLE_BODY.index(side + part) for side in ("Left", "Right") for part in ("Foot", "ToeBase")]


def swaying(seed: int = 0, seconds: float = 6.0, hips: float = 6.0, spine: float = 12.0, yaw: float = 0.0) -> Motion:
    """Hips and spine that turn about all axes by so many degrees; the hips face `yaw` degrees to the left."""
    rng = np.random.default_rng(seed)
    times = np.arange(round(seconds * FPS))[:, None] / FPS
    maps = np.zeros((len(times), 16, 3))
    for joint, size in (("Hips", hips), ("Spine", spine)):
        wave = np.sin(2 * np.pi * rng.uniform(0.1, 0.7, (1, 3)) * times + rng.uniform(0, 6, (1, 3)))
        maps[:, CHARACTER.index(joint)] = np.radians(size) * wave
    turns = rotation.from_exponential_map(maps)
    facing = rotation.from_exponential_map(np.array([0.0, np.radians(yaw), 0.0]))
    turns[:, 0] = rotation.multiply(facing[None], turns[:, 0])
    return skeletons.resized(Motion(CHARACTER, turns, rng.normal(size=(len(times), 3)), FPS), WHOLE_BODY)


def places(motion: Motion) -> Array:
    return kinematics.positions_of(motion)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 1000), hips=st.floats(0, 10), spine=st.floats(0, 20), yaw=st.floats(-180, 180))
def test_feet_stay_within_a_millimetre_on_the_floor(seed: int, hips: float, spine: float, yaw: float) -> None:
    out = with_standing_legs(swaying(seed, hips=hips, spine=spine, yaw=yaw))
    feet = places(out)[:, FEET]
    assert np.ptp(feet, axis=0).max() < 1e-3
    world = kinematics.global_rotations(WHOLE_BODY, out.rotations)[:, FEET]
    assert np.degrees(rotation.angle_between(world, world[:1])).max() < 0.1, "nor do they turn"
    assert np.allclose(feet[0, :, 1], [0.08, 0.02, 0.08, 0.02], atol=1e-3), "flat: ankles at 8 cm, balls at 2"


def test_hips_turn_as_they_did_and_go_the_other_way_than_the_chest() -> None:
    motion = swaying(3)
    out = with_standing_legs(motion)
    upper = slice(0, 46)
    assert np.array_equal(out.rotations[:, upper], motion.rotations[:, upper])
    body = places(out)
    chest = body[:, WHOLE_BODY.index("Spine3")] - body[:, 0]
    for axis in (0, 2):
        assert np.corrcoef(body[60:-60, 0, axis], chest[60:-60, axis])[0, 1] < -0.8
        assert 0.005 < np.ptp(body[:, 0, axis]) < 0.08
    assert np.abs(body[:, 0, [0, 2]].mean(axis=0)).max() < 1e-6
    assert body[:, 0, 1].min() > skeletons.HIP_HEIGHT - 0.06 and body[:, 0, 1].max() <= skeletons.HIP_HEIGHT
    assert np.linalg.norm(np.diff(body[:, 0], axis=0), axis=-1).max() * FPS < 0.15, "no jump"


def test_knees_bend_forward_and_never_lock() -> None:
    out = with_standing_legs(swaying(5, hips=10.0, spine=20.0))
    body = places(out)
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        hip, knee, ankle = (body[:, WHOLE_BODY.index(side + part)] for part in ("UpLeg", "Leg", "Foot"))
        assert (knee[:, 2] > 0.5 * (hip[:, 2] + ankle[:, 2])).all(), "in front of the line from hip to ankle"
        bend = np.degrees(np.linalg.norm(rotation.to_exponential_map(
            out.rotations[:, WHOLE_BODY.index(side + "Leg")]), axis=-1))
        assert bend.min() > 2.0 and bend.max() < 60.0
        lengths = np.linalg.norm(knee - hip, axis=-1), np.linalg.norm(ankle - knee, axis=-1)
        assert np.allclose(lengths[0], 0.420) and np.allclose(lengths[1], 0.405)
        assert (sign * ankle[:, 0] > 0.08).all(), "feet side by side"
    speed = np.degrees(rotation.angle_between(out.rotations[1:, 46:], out.rotations[:-1, 46:])) * FPS
    assert speed.max() < 120.0


def test_feet_point_to_where_the_hips_do() -> None:
    for yaw in (0.0, 90.0, 179.0, -120.0):
        body = places(with_standing_legs(swaying(1, hips=1.0, yaw=yaw)))
        toes = np.mean([body[0, WHOLE_BODY.index(side + "ToeBase")] - body[0, WHOLE_BODY.index(side + "Foot")]
                        for side in ("Left", "Right")], axis=0)
        ahead = np.array([np.sin(np.radians(yaw)), np.cos(np.radians(yaw))])
        assert toes[[0, 2]] @ ahead / np.linalg.norm(toes[[0, 2]]) > 0.999


def test_what_was_made_up_is_said() -> None:
    motion = swaying()
    assert set(motion.absent) == {*skeletons.FINGER_JOINTS, *skeletons.LEG_JOINTS}
    out = with_standing_legs(motion)
    assert out.absent == skeletons.FINGER_JOINTS and out.filled == skeletons.LEG_JOINTS
    again = with_standing_legs(out)
    assert np.abs(again.rotations - out.rotations).max() < 1e-9 and again.filled == skeletons.LEG_JOINTS
    assert skeletons.to_character(out, skeleton=WHOLE_BODY).filled == skeletons.LEG_JOINTS


def test_one_frame_stands() -> None:
    still = Motion(CHARACTER, np.tile([1.0, 0, 0, 0], (1, 16, 1)), np.zeros((1, 3)), 30.0)
    out = with_standing_legs(skeletons.resized(still, WHOLE_BODY))
    assert out.root_positions[0].tolist() == pytest.approx([0.0, 0.913, 0.0], abs=0.04)
