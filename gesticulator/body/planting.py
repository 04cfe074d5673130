"""The lower body of a clip: feet that stay where they are under other hips, hips that stay in place, none at all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from data_module.motion import rotation
from data_module.motion.kinematics import global_rotations, positions_of
from data_module.motion.skeletons import LEG_JOINTS, has_legs
from data_module.motion.standing_legs import bent_leg, leg_lengths
from data_module.types import Array, Motion

SIDES = ("Left", "Right")
_FORWARD = np.array([0.0, 0.0, 1.0])


def feet_of(motion: Motion) -> tuple[Array, Array]:
    """[T, 2, 3] positions of the ankles, metres, and [T, 2, 4] world rotations of the feet, left and right."""
    feet = [motion.skeleton.index(side + "Foot") for side in SIDES]
    return positions_of(motion)[:, feet], global_rotations(motion.skeleton, motion.rotations)[:, feet]


def replanted(motion: Motion, ankles: Array, feet: Array) -> Motion:
    """The motion with legs bent so that the feet are at `ankles` [T, 2, 3] with the world rotations `feet` [T, 2, 4].

    Knees point where the toes do. A leg that is too short stretches towards its ankle.
    """
    skeleton, rotations = motion.skeleton, motion.rotations.copy()
    hips, root = rotations[:, 0], motion.root_positions
    for number, side in enumerate(SIDES):
        places = [skeleton.index(side + part) for part in ("UpLeg", "Leg", "Foot")]
        socket = root + rotation.rotate(hips, skeleton.offsets[places[0]])
        thigh, shin = bent_leg(ankles[:, number] - socket, rotation.rotate(feet[:, number], _FORWARD),
                               leg_lengths(skeleton, side))
        above = hips
        for place, turn in zip(places, (thigh, shin, feet[:, number]), strict=True):
            rotations[:, place] = rotation.multiply(rotation.conjugate(above), turn)
            above = turn
    return replace(motion, rotations=rotation.continuous(rotations))


def in_place(motion: Motion) -> Motion:
    """The motion with the hips at the middle of their path; the feet stay where they were."""
    still = replace(motion, root_positions=np.tile(motion.root_positions.mean(axis=0), (len(motion), 1)))
    return replanted(still, *feet_of(motion)) if has_legs(motion) else still


def upper_alone(motion: Motion) -> Motion:
    """The motion with hips and legs at rest; the spine takes the rotation of the hips, so that the upper body keeps its
    pose."""
    rotations = motion.rotations.copy()
    spine = motion.skeleton.index("Spine")
    rotations[:, spine] = rotation.multiply(rotations[:, 0], rotations[:, spine])
    still = [0, *(motion.skeleton.index(name) for name in LEG_JOINTS if name in motion.skeleton.names)]
    rotations[:, still] = [1.0, 0.0, 0.0, 0.0]
    root = np.tile(motion.root_positions.mean(axis=0) * [0.0, 1.0, 0.0], (len(motion), 1))
    return replace(motion, rotations=rotations, root_positions=root)


def added_to_rest(motion: Motion, rest: Motion) -> Motion:
    """The motion relative to the single pose of `rest`: local rotations D with pose = rest D.

    A player that multiplies the local rotations of another clip by D from the right adds the gestures to that clip.
    """
    turns = rotation.multiply(rotation.conjugate(rest.rotations), motion.rotations)
    return replace(motion, rotations=rotation.continuous(turns))
