"""The rhythm of the shoulder: the clavicle rises with the arm and goes forward with its reach.

Of the elevation of an arm over 30 degrees the shoulder girdle does a third (scapulohumeral rhythm, Inman 1944); it
rises a little with every hand that is raised, and goes forward with one that reaches. Of elevation e, and of height y
and reach z of the hand from the shoulder, in metres,

    lift = (e - 30) / 3 over 30 degrees + 18 (y + 0.5),    protraction = 15 (z - 0.1)    degrees,

which is what SmartBody's `brad` and Rocketbox's man show (0.37 of the elevation, 19 to 36 degrees a metre; 11 to 25
forward). The upper arm keeps its direction, so the hand goes along by what the shoulder goes, under 7 cm.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from data_module.motion import rotation
from data_module.types import Array, Skeleton

# Elevation from which the shoulder takes part, degrees; its share; degrees over which that sets in.
_SETTING, _THIRD, _ROUND = 30.0, 1.0 / 3.0, 6.0
# Degrees for a metre of the hand's height; height of a hanging hand under the shoulder, metres.
_RISE, _HANGS = 18.0, -0.5
# Degrees for a metre of reach; reach of a hanging hand, metres.
_FORWARD, _NEAR = 15.0, 0.1
# Soft limits of lift and protraction, degrees.
_MOST = (22.0, 12.0)
# Standard deviation of the low pass, seconds.
_SMOOTH = 0.05


def with_rhythm(skeleton: Skeleton, rotations: Array, fps: float, share: float = 1.0) -> Array:
    """Local rotations [T, J, 4] with the clavicles turned by `share` of the rhythm."""
    out = rotations.copy()
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        collar, arm = skeleton.index(side + "Shoulder"), skeleton.index(side + "Arm")
        lift, forward = (share * np.radians(gaussian_filter1d(angle, _SMOOTH * fps, mode="nearest"))
                         for angle in rhythm(skeleton, rotations, side))
        zero = np.zeros_like(lift)
        turn = rotation.from_exponential_map(np.stack([zero, -sign * forward, sign * lift], axis=-1))
        raised = rotation.multiply(turn, rotations[:, collar])
        kept = rotation.multiply(rotations[:, collar], rotations[:, arm])
        out[:, collar], out[:, arm] = raised, rotation.multiply(rotation.conjugate(raised), kept)
    return out


def rhythm(skeleton: Skeleton, rotations: Array, side: str) -> tuple[Array, Array]:
    """Lift and protraction [T] of a clavicle in degrees, as seen from the chest."""
    turned = rotations[:, skeleton.index(side + "Shoulder")]
    bones = []
    for joint, tip in (("Arm", "ForeArm"), ("ForeArm", "Hand")):
        turned = rotation.multiply(turned, rotations[:, skeleton.index(side + joint)])
        bones.append(rotation.rotate(turned, skeleton.offsets[skeleton.index(side + tip)]))
    down = -bones[0][:, 1] / np.linalg.norm(bones[0], axis=-1)
    elevation = np.degrees(np.arccos(np.clip(down, -1.0, 1.0)))
    hand = bones[0] + bones[1]
    over = _ROUND * np.logaddexp(0.0, (elevation - _SETTING) / _ROUND)
    lift = _THIRD * over + _RISE * (hand[:, 1] - _HANGS)
    forward = _FORWARD * (hand[:, 2] - _NEAR)
    return _MOST[0] * np.tanh(lift / _MOST[0]), _MOST[1] * np.tanh(forward / _MOST[1])
