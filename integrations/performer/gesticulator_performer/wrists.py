"""Wrists for takes whose wrists were not recorded: loose hands on moving forearms.

A relaxed hand lags: it bends against the way it is moved, and when the forearm brakes it swings on. With n the normal
of the palm and t the direction of the thumb, v the velocity of the wrist and a its acceleration (low-passed),

    flexion   = p - D v.n - G a.n,    deviation = D' v.t,

where the posture p is a little flexion of a hanging hand and an extension of a raised one whose palm is down. Both are
limited softly to what a wrist can do without effort. The accelerations of a stroke (5 m/s^2) bend it by 20 degrees.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from data_module.motion import kinematics, rotation
from data_module.motion.skeletons import CHARACTER
from data_module.types import Array
from gesticulator_performer.torso import FPS, facing_positions

# Degrees of flexion of a hanging hand, and of a raised one with the palm down.
_HANGING, _RAISED = 8.0, -10.0
# Degrees of flexion for 1 m/s along the normal of the palm and for 1 m/s^2; of deviation for 1 m/s along the thumb.
_DRAG, _SWING, _ASIDE = 20.0, 4.0, 10.0
# Soft limits, degrees.
_BENT, _EXTENDED, _DEVIATED = 45.0, 50.0, 18.0
# Height over the hips of a hand that is half raised, and the scale of the transition, metres.
_LIFTED, _LIFT_WIDTH = 0.1, 0.07
# Standard deviation of the low pass of velocity and acceleration, seconds.
_SMOOTH = 0.07


def with_loose_wrists(rotations: Array) -> Array:
    """Local rotations [T, J, 4] (60 fps) with bent wrists, in the place of stiff ones."""
    out = rotations.copy()
    places = facing_positions(rotations)
    faced = rotations[:, :len(CHARACTER)].copy()
    faced[:, 0] = rotation.remove_yaw(faced[:, 0])
    world = kinematics.global_rotations(CHARACTER, faced)
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        hand = CHARACTER.index(side + "Hand")
        flexion, deviation = bends(places[:, hand], world[:, hand])
        turn = np.stack([0.0 * flexion, sign * deviation, -sign * flexion], axis=-1)
        out[:, hand] = rotation.multiply(rotations[:, hand], rotation.from_exponential_map(np.radians(turn)))
    return out


def bends(wrist: Array, hand: Array) -> tuple[Array, Array]:
    """Flexion and deviation (towards the little finger) [T] in degrees, from places [T, 3] of the wrist and world
    rotations [T, 4] of a stiff hand."""
    smooth = gaussian_filter1d(wrist, _SMOOTH * FPS, axis=0, mode="nearest")
    velocity = np.gradient(smooth, 1.0 / FPS, axis=0) if len(wrist) > 1 else np.zeros_like(wrist)
    acceleration = np.gradient(velocity, 1.0 / FPS, axis=0) if len(wrist) > 1 else velocity
    palm, thumb = (rotation.rotate(hand, np.array(axis)) for axis in ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0)))
    lifted = 1.0 / (1.0 + np.exp(-(smooth[:, 1] - _LIFTED) / _LIFT_WIDTH))
    down = np.clip(-palm[:, 1], 0.0, 1.0)
    posture = gaussian_filter1d(_HANGING * (1.0 - lifted) + _RAISED * lifted * down, _SMOOTH * FPS, mode="nearest")
    flexion = posture - _DRAG * (velocity * palm).sum(axis=1) - _SWING * (acceleration * palm).sum(axis=1)
    flexion = np.where(flexion > 0.0, _BENT * np.tanh(flexion / _BENT), _EXTENDED * np.tanh(flexion / _EXTENDED))
    aside = _ASIDE * (velocity * thumb).sum(axis=1)
    return flexion, _DEVIATED * np.tanh(aside / _DEVIATED)
