"""Motion for a clip: mirrored, repeated without a seam, of the upper body alone, additive.

**Loops**: the last frame of a clip is followed by its first. Their difference in pose and velocity is taken out on
both sides of the seam by corrections that fade over `REACH` seconds, so that the rest of the clip and its duration
stay as they are. With u the deviation of a joint from the pose at the seam, a = u and b = L u' at the seam and s the
share of the fade of L seconds that has passed, the correction is a (1 - 10 s^3 + 15 s^4 - 6 s^5) + b (s - 6 s^3 + 8
s^4 - 3 s^5), the polynomial of degree 5 that starts with value a, slope b and no curvature and ends with none of the
three.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.motion import rotation
from data_module.motion.kinematics import global_rotations, positions_of
from data_module.motion.skeletons import LEG_JOINTS, SIDES, has_legs
from data_module.motion.standing_legs import bent_leg, leg_lengths
from data_module.types import Array, Motion

REACH = 1.5
"""Seconds to both sides of the seam over which it fades: half a metre of difference then takes 0.6 m/s."""
_LEAST = 8
"""Fewest frames that can be looped: velocities at both ends and a fade between."""
_LEGS = ("Left", "Right")
_FORWARD = np.array([0.0, 0.0, 1.0])


def exchanged_joints(names: tuple[str, ...]) -> NDArray[np.int64]:
    """[J] index of each joint's counterpart on the other side."""
    other = dict(zip(SIDES, reversed(SIDES), strict=True))
    opposite = [next((other[side] + name[len(side):] for side in SIDES if name.startswith(side)), name)
                for name in names]
    return np.array([names.index(name) for name in opposite])


def mirrored_motion(motion: Motion) -> Motion:
    """The motion with left and right exchanged, exactly: mirroring twice gives the motion back."""
    swapped = exchanged_joints(motion.skeleton.names)
    return replace(motion, rotations=motion.rotations[:, swapped] * np.array([1.0, 1.0, -1.0, -1.0]),
                   root_positions=motion.root_positions * np.array([-1.0, 1.0, 1.0]))


def looped(motion: Motion) -> Motion:
    """The motion with one frame more, the first again, reached with the velocity with which it is left.

    Feet stay planted if they stand in the same place at both ends, else they slide there. `InputError` for a motion
    that is too short.
    """
    if len(motion) < _LEAST:
        raise InputError("--loop", f"needs {_LEAST} frames, and there are {len(motion)}", "give a longer recording")
    turns = _looped_turns(motion.rotations, motion.fps)
    out = replace(motion, rotations=turns, root_positions=_looped_values(motion.root_positions, motion.fps))
    if not has_legs(motion):
        return out
    ankles, feet = feet_of(motion)
    return replanted(out, _looped_values(ankles.reshape(len(motion), -1), motion.fps).reshape(-1, 2, 3),
                     _looped_turns(feet, motion.fps))


def _looped_turns(turns: Array, fps: float) -> Array:
    """[T + 1, J, 4] rotations [T, J, 4] that end as they begin."""
    # One frame beyond the end, extrapolated, is where the first frame must be met.
    turns = rotation.continuous(turns)
    ahead = rotation.multiply(turns[-1], rotation.multiply(rotation.conjugate(turns[-2]), turns[-1]))
    seam = rotation.interpolate(rotation.continuous(np.stack([ahead, turns[0]])), np.array([0.5]))[0]
    # Deviations from the pose at the seam are small near it, on the same branch of the logarithm on both sides.
    whole = np.concatenate([turns, ahead[None]])
    away = rotation.to_exponential_map(rotation.multiply(rotation.conjugate(seam), whole))
    begins, ends = rotation.unroll(away), rotation.unroll(away[::-1])[::-1]
    out = rotation.multiply(seam, rotation.from_exponential_map(_without_seam(begins, ends, np.zeros(3), fps)))
    out[-1] = out[0]
    # The middle is copied: the logarithm and back would change its last bits.
    near = _reach(len(turns), fps)
    out[near:len(turns) - near] = turns[near:len(turns) - near]
    return rotation.continuous(rotation.normalise(out))


def _looped_values(values: Array, fps: float) -> Array:
    """[T + 1, D] values [T, D] that end as they begin."""
    ahead = 2.0 * values[-1] - values[-2]
    whole = np.concatenate([values, ahead[None]])
    out = _without_seam(whole, whole, (ahead + values[0]) / 2.0, fps)
    out[-1] = out[0]
    return out


def _reach(frames: int, fps: float) -> int:
    """Frames on each side over which the seam fades."""
    return min(round(REACH * fps), frames // 2)


def _without_seam(begins: Array, ends: Array, seam: Array, fps: float) -> Array:
    """[T + 1, ...] values whose ends meet at `seam` with a common slope. begins, ends: [T + 1, ...] the same values, on
    the branches of the logarithm that are right at the first and at the last frame."""
    frames = len(begins) - 1
    near = _reach(frames, fps)
    leaving, coming = begins[1] - begins[0], ends[-1] - ends[-2]
    # Both ends leave the seam with the mean of their velocities.
    slope = (leaving + coming) / 2.0
    s = (np.arange(near + 1) / near).reshape(-1, *(1,) * (begins.ndim - 1))
    offset = 1.0 - 10.0 * s ** 3 + 15.0 * s ** 4 - 6.0 * s ** 5
    tilt = s - 6.0 * s ** 3 + 8.0 * s ** 4 - 3.0 * s ** 5
    out = begins.copy()
    out[-near - 1:] = ends[-near - 1:]
    out[:near + 1] += (seam - begins[0]) * offset + near * (slope - leaving) * tilt
    out[-near - 1:] += (seam - ends[-1]) * offset[::-1] - near * (slope - coming) * tilt[::-1]
    return out


def feet_of(motion: Motion) -> tuple[Array, Array]:
    """[T, 2, 3] positions of the ankles, metres, and [T, 2, 4] world rotations of the feet, left and right."""
    feet = [motion.skeleton.index(side + "Foot") for side in _LEGS]
    return positions_of(motion)[:, feet], global_rotations(motion.skeleton, motion.rotations)[:, feet]


def replanted(motion: Motion, ankles: Array, feet: Array) -> Motion:
    """The motion with legs bent so that the feet are at `ankles` [T, 2, 3] with the world rotations `feet` [T, 2, 4].

    Knees point where the toes do. A leg that is too short stretches towards its ankle.
    """
    skeleton, rotations = motion.skeleton, motion.rotations.copy()
    hips, root = rotations[:, 0], motion.root_positions
    for number, side in enumerate(_LEGS):
        places = [skeleton.index(side + part) for part in ("UpLeg", "Leg", "Foot")]
        socket = root + rotation.rotate(hips, skeleton.offsets[places[0]])
        thigh, shin = bent_leg(ankles[:, number] - socket, rotation.rotate(feet[:, number], _FORWARD),
                               leg_lengths(skeleton, side))
        # World rotations to local ones, from the hip down.
        above = hips
        for place, turn in zip(places, (thigh, shin, feet[:, number]), strict=True):
            rotations[:, place] = rotation.multiply(rotation.conjugate(above), turn)
            above = turn
    return replace(motion, rotations=rotation.continuous(rotations))


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
