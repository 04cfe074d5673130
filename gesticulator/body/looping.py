"""A motion that can be repeated without a seam, for idling.

The last frame of a clip is followed by its first. Their difference in pose and velocity is taken out on both sides of
the seam by corrections that fade over `REACH` seconds, so that the rest of the clip and its duration stay as they are.
With u the deviation of a joint from the pose at the seam, a = u and b = L u' at the seam and s the share of the fade
of L seconds that has passed, the correction is a (1 - 10 s^3 + 15 s^4 - 6 s^5) + b (s - 6 s^3 + 8 s^4 - 3 s^5), the
polynomial of degree 5 that starts with value a, slope b and no curvature and ends with none of the three.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from data_module.errors import InputError
from data_module.motion import rotation
from data_module.motion.skeletons import has_legs
from data_module.types import Array, Motion
from gesticulator.body.planting import feet_of, replanted

REACH = 1.5
"""Seconds to both sides of the seam over which it fades: half a metre of difference then takes 0.6 m/s."""
_LEAST = 8
"""Fewest frames that can be looped: velocities at both ends and a fade between."""


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
    turns = rotation.continuous(turns)
    ahead = rotation.multiply(turns[-1], rotation.multiply(rotation.conjugate(turns[-2]), turns[-1]))
    seam = rotation.interpolate(rotation.continuous(np.stack([ahead, turns[0]])), np.array([0.5]))[0]
    # Deviations from the pose at the seam are small near it, on the same branch of the logarithm on both sides.
    whole = np.concatenate([turns, ahead[None]])
    away = rotation.to_exponential_map(rotation.multiply(rotation.conjugate(seam), whole))
    begins, ends = rotation.unroll(away), rotation.unroll(away[::-1])[::-1]
    out = rotation.multiply(seam, rotation.from_exponential_map(_without_seam(begins, ends, np.zeros(3), fps)))
    out[-1] = out[0]
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
    slope = (leaving + coming) / 2.0
    s = (np.arange(near + 1) / near).reshape(-1, *(1,) * (begins.ndim - 1))
    offset = 1.0 - 10.0 * s ** 3 + 15.0 * s ** 4 - 6.0 * s ** 5
    tilt = s - 6.0 * s ** 3 + 8.0 * s ** 4 - 3.0 * s ** 5
    out = begins.copy()
    out[-near - 1:] = ends[-near - 1:]
    out[:near + 1] += (seam - begins[0]) * offset + near * (slope - leaving) * tilt
    out[-near - 1:] += (seam - ends[-1]) * offset[::-1] - near * (slope - coming) * tilt[::-1]
    return out
