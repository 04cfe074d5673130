"""Pose pins: the motion goes through the place, smoothly, and is the same elsewhere."""

import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from performances import perform
from test_editing import Plain

from data_module.errors import InputError
from data_module.motion import rotation
from data_module.motion.kinematics import positions_of
from data_module.motion.skeletons import CHARACTER, HIP_HEIGHT, standing
from data_module.types import Array, Motion
from gesticulator.body.clips import mirrored_motion
from gesticulator.body.pins import REACH, pinned
from gesticulator.plan.plan import GesturePlan, PosePin
from gesticulator.plan.plan_file import parse_plan

FPS, FRAMES = 60.0, 360
LEFT = (0.30, 1.30, 0.32)


def _swinging(fps: float = FPS) -> Motion:
    """Six seconds of arms that swing before the chest, both in a manner of their own, and of a trunk that sways."""
    times = np.arange(round(FRAMES / FPS * fps)) / fps
    vectors = np.zeros((len(times), len(CHARACTER), 3))
    for side, sign, rate in (("Left", 1.0, 0.9), ("Right", -1.0, 0.7)):
        vectors[:, CHARACTER.index(side + "Arm"), 2] = sign * (-0.9 + 0.15 * np.sin(6.0 * rate * times))
        vectors[:, CHARACTER.index(side + "Arm"), 1] = sign * -0.5
        vectors[:, CHARACTER.index(side + "ForeArm"), 1] = sign * (-1.3 + 0.3 * np.cos(5.0 * rate * times))
    vectors[:, CHARACTER.index("Spine1"), 0] = 0.05 * np.sin(2.0 * times)
    return Motion(CHARACTER, rotation.from_exponential_map(vectors), np.zeros((len(times), 3)), fps)


PLAN = perform(seconds=6.0).plan()


def _with(*pins: PosePin) -> GesturePlan:
    return replace(PLAN, pins=pins)


def _places(motion: Motion, joint: str) -> Array:
    """[T, 3] of a joint, the floor at 0."""
    return positions_of(standing(motion))[:, motion.skeleton.index(joint)]


def _changed(before: Motion, after: Motion) -> Any:
    return np.flatnonzero((before.rotations != after.rotations).any(axis=(1, 2)))


def _faults(before: Motion, after: Motion, joint: str) -> tuple[float, float]:
    """By how much the greatest speed and acceleration of a joint rose, m/s and m/s^2."""
    greatest = [[float(np.linalg.norm(np.diff(_places(one, joint), order, axis=0), axis=-1).max() * one.fps ** order)
                 for order in (1, 2)] for one in (before, after)]
    return greatest[1][0] - greatest[0][0], greatest[1][1] - greatest[0][1]


@settings(max_examples=25)
@given(st.floats(0.0, 5.98), st.floats(-0.5, 0.9), st.floats(-0.9, 0.7), st.floats(0.25, 0.48),
       st.sampled_from([0.0, 0.0, 0.3, 1.0]), st.sampled_from(["Left", "Right"]))
def test_a_hand_goes_through_its_place_and_nothing_else_changes(time: float, out: float, up: float, far: float,
                                                                hold: float, side: str) -> None:
    motion, sign = _swinging(), 1.0 if side == "Left" else -1.0
    begins, ends = (min(round(at * FPS), FRAMES - 1) for at in (time, time + hold))
    shoulder = _places(motion, side + "Arm")[begins]
    way = np.array([sign * np.sin(out) * np.cos(up), np.sin(up), np.cos(out) * np.cos(up)])
    goal = shoulder + far * way
    made = pinned(motion, _with(PosePin(time, side + "Hand", position=tuple(goal), hold=hold)))
    path, before = _places(made, side + "Hand"), _places(motion, side + "Hand")
    # Beside the body a hand is slowed, by a centimetre at most.
    near = 0.0126 if goal[2] < 0.25 or abs(goal[1] - HIP_HEIGHT) > 0.5 else 1e-9
    assert np.linalg.norm(path[begins:ends + 1] - goal, axis=-1).max() <= near
    changed = _changed(motion, made)
    assert len(changed) and changed[0] > begins - REACH * FPS and changed[-1] < ends + REACH * FPS
    arm = [CHARACTER.index(side + part) for part in ("Arm", "ForeArm", "Hand")]
    assert (np.delete(made.rotations, arm, axis=1) == np.delete(motion.rotations, arm, axis=1)).all()
    assert (np.sum(made.rotations[1:] * made.rotations[:-1], axis=-1) > 0.9).all(), "no jump"
    # The difference rises as w does, whose greatest slope is 15 / 8, and bends less than 5.8 / REACH^2.
    away = float(np.linalg.norm(before[begins:ends + 1] - goal, axis=-1).max()) + 0.1
    faster, harder = _faults(motion, made, side + "Hand")
    assert faster < 1.9 * away / REACH + 0.1 and harder < 5.8 * away / REACH ** 2 + 12.0


def test_a_hand_is_still_while_its_pin_holds_and_two_pins_are_one_way() -> None:
    motion = _swinging()
    made = pinned(motion, _with(PosePin(2.0, "LeftHand", position=LEFT, hold=0.5),
                                PosePin(2.8, "LeftHand", position=(0.1, 1.3, 0.38))))
    path = _places(made, "LeftHand")
    np.testing.assert_allclose(path[120:151], np.broadcast_to(LEFT, (31, 3)), atol=1e-9)
    np.testing.assert_allclose(path[168], (0.1, 1.3, 0.38), atol=1e-9)
    # Between them it takes the short way: no further from the line than its own movement.
    line = np.array((0.1, 1.3, 0.38)) - LEFT
    beside = np.linalg.norm(np.cross(path[150:169] - LEFT, line), axis=-1) / np.linalg.norm(line)
    assert beside.max() < 0.1
    speed = np.linalg.norm(np.diff(path, axis=0), axis=-1) * FPS
    assert speed[119] < 0.08 and speed[150] < 0.08, "it comes to a stop before, and leaves slowly"
    changed = _changed(motion, made)
    assert changed[0] > 120 - 36 and changed[-1] < 168 + 36


def test_the_mirrored_pin_gives_the_mirrored_motion() -> None:
    motion = _swinging()
    left = pinned(motion, _with(PosePin(3.0, "LeftHand", position=LEFT, hold=0.2),
                                PosePin(3.5, "Head", position=(0.05, 1.555, 0.06))))
    right = pinned(mirrored_motion(motion), _with(PosePin(3.0, "RightHand", position=(-LEFT[0], *LEFT[1:]), hold=0.2),
                                                  PosePin(3.5, "Head", position=(-0.05, 1.555, 0.06))))
    np.testing.assert_allclose(mirrored_motion(right).rotations, left.rotations, atol=1e-9)


def test_the_head_leans_as_far_as_a_spine_bends_and_looks_where_it_did() -> None:
    motion = _swinging()
    before = _places(motion, "Head")[180]
    spine = _places(motion, "Spine")[180]
    # On the curve that a spine of this length can reach, a hand's breadth to the side and ahead.
    goal = before + np.array([0.06, 0.0, 0.07])
    goal = spine + (goal - spine) * np.linalg.norm(before - spine) / np.linalg.norm(goal - spine)
    made = pinned(motion, _with(PosePin(3.0, "Head", position=tuple(goal))))
    assert np.linalg.norm(_places(made, "Head")[180] - goal) < 0.01
    gaze = [np.asarray(rotation.rotate(_world(one, "Head")[180], np.array([0.0, 0.0, 1.0]))) for one in (motion, made)]
    np.testing.assert_allclose(gaze[0], gaze[1], atol=1e-9)
    with pytest.raises(InputError, match="out of the head's reach"):
        pinned(motion, _with(PosePin(3.0, "Head", position=(0.0, 1.2, 0.6))))


def _world(motion: Motion, joint: str) -> Array:
    from data_module.motion.kinematics import global_rotations

    return global_rotations(motion.skeleton, motion.rotations)[:, motion.skeleton.index(joint)]


def test_a_joint_turns_as_it_is_pinned() -> None:
    motion, turned = _swinging(), (0.8, 0.6, 0.0, 0.0)
    made = pinned(motion, _with(PosePin(1.0, "RightHand", turned), PosePin(3.0, "Neck", turned, hold=0.5)))
    hand, neck = (CHARACTER.index(name) for name in ("RightHand", "Neck"))
    np.testing.assert_allclose(made.rotations[60, hand], turned, atol=1e-12)
    np.testing.assert_allclose(made.rotations[180:211, neck], np.broadcast_to(turned, (31, 4)), atol=1e-9)
    assert set(_changed(motion, made)) <= {*range(60 - 35, 60 + 36), *range(180 - 35, 210 + 36)}


def test_the_place_does_not_depend_on_the_rate_of_frames() -> None:
    for fps in (24.0, 30.0, 120.0):
        made = pinned(_swinging(fps), _with(PosePin(2.5, "LeftHand", position=LEFT)))
        np.testing.assert_allclose(_places(made, "LeftHand")[round(2.5 * fps)], LEFT, atol=1e-9)


@pytest.mark.parametrize(("pins", "told"), [
    ((PosePin(2.0, "LeftHand", position=(0.9, 1.4, 0.3)),), "and a wrist gets 0.20 to 0.51 m from it"),
    ((PosePin(2.0, "RightHand", position=(-0.2, 1.45, 0.08)),), "and a wrist gets 0.20 to 0.51 m from it"),
    ((PosePin(2.0, "LeftHand", position=(0.0, 1.2, -0.02)),), "is inside the body at 2.00 s"),
    ((PosePin(2.0, "LeftTail", (1.0, 0.0, 0.0, 0.0)),), "which the skeleton does not have"),
    ((PosePin(2.0, "LeftHand", position=LEFT, hold=1.0), PosePin(2.5, "LeftHand", position=LEFT)),
     "another pin of LeftHand holds"),
])
def test_what_cannot_be_reached_is_refused_in_a_line(pins: Sequence[PosePin], told: str) -> None:
    with pytest.raises(InputError, match=told) as got:
        pinned(_swinging(), _with(*pins))
    assert "\n" not in str(got.value) and f"pins[{len(pins) - 1}]" in str(got.value)


@pytest.mark.parametrize(("pin", "told"), [
    ({"time": 1.0, "joint": "LeftArm", "position": [0.2, 1.4, 0.3]}, "cannot be pinned to a place"),
    ({"time": 1e3, "joint": "LeftHand", "position": [0.2, 1.4, 0.3]}, "give 0 to"),
    ({"time": 1.0, "joint": "LeftHand", "position": [0.2, 1.4]}, "position"),
    ({"time": 1.0, "joint": "LeftHand"}, "neither a rotation nor a position"),
])
def test_pins_are_checked_where_the_plan_is_read(pin: Plain, told: str) -> None:
    plain = json.loads(PLAN.to_json())
    with pytest.raises(InputError, match=told):
        parse_plan(json.dumps({**plain, "pins": [pin]}))
    with pytest.raises(InputError, match="one of"):
        parse_plan(json.dumps({**plain, "pins": [{"time": 1.0, "joint": "Neck", "rotation": [1, 0, 0, 0]}] * 500}))
