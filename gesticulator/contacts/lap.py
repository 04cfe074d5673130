"""Thighs of the default character while it sits, above which its hands are kept (`default_body`).

The models know no legs: a hand that hangs or sweeps low would pass through the thighs. Seen from a thigh, its surface
is a height field: above the line from hip to knee, with s along it and w across, the tangents of its slice of the
radius r(s) at angles a (0 to the left and pi / 2 up) leave

    H(s, w) = min over a of (r(s) - w cos a) / sin a,   40 to 140 degrees,

the upper side of the slice, which falls beside it and beyond its ends with a slope of at most 1.2. A hand is moved
along the upward normal of the thigh alone: a direction out of a closed shape would turn round at its middle, and a hand
that passes through a thigh would jump. Its displacement changes at most 1.2 times as fast as the hand moves.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from data_module.motion import rotation
from data_module.motion.skeletons import SIDES, WHOLE_BODY
from data_module.types import Array, Motion
from gesticulator.contacts.limbs import FINGERTIPS, Pose, pose_of, soft

RADII = (0.076, 0.056)
"""Metres around the line from hip to knee of the default character, at its ends: as pages draw them."""
SEAT_SPREAD = 7.0
"""Degrees by which a seated thigh points outward."""
_MARGINS = np.array([0.024, 0.018, *(0.008 for _ in FINGERTIPS)])[:, None]
"""Metres by which wrist, knuckles and fingertips are above a thigh: half their thickness."""
_LEVEL = 0.7
"""Cosine between thighs and straight down below which a body sits: 45 degrees."""
_TANGENTS = np.radians(np.arange(40.0, 150.0, 10.0))
"""Directions of tangents, of which the flattest has a slope of 1.2."""
_STEEPEST, _ROUND = 1.2, 0.05
"""Slope beyond the ends of a thigh, and metres over which it begins."""
_SOFT = 0.02
"""Metres above and below the thighs over which a hand is slowed."""


@dataclass(frozen=True)
class Thigh:
    """A thigh over T frames: hip, knee [T, 3] or [1, 3] metres from the middle of the hips."""

    hip: Array
    knee: Array

    def depth(self, points: Array) -> tuple[Array, Array]:
        """[..., T] metres by which points [..., T, 3] are under the surface, and [T, 3] the way up."""
        bone = self.knee - self.hip
        length = np.linalg.norm(bone, axis=-1)
        along = bone / np.maximum(length, 1e-9)[..., None]
        # Level and not the bone's own left: a thigh that rolls keeps its upper side up.
        left = np.cross([0.0, 1.0, 0.0], along)
        left = left / np.maximum(np.linalg.norm(left, axis=-1, keepdims=True), 1e-9)
        up = np.cross(along, left)
        across, height, far = (np.sum((points - self.hip) * axis, axis=-1) for axis in (left, up, along))
        radius = np.interp(far / np.maximum(length, 1e-9), [0.0, 1.0], RADII)
        # The height field of the module: the lowest of the tangents over this place across.
        tangents = [(radius - across * np.cos(angle)) / np.sin(angle) for angle in _TANGENTS]
        # Beyond hip and knee it falls, rounded so that a hand gliding off has no kink in its path.
        beyond = np.maximum(np.maximum(-far, far - length), 0.0)
        top = np.min(tangents, axis=0) - _STEEPEST * (np.hypot(beyond, _ROUND) - _ROUND)
        return top - height, up

    def push(self, points: Array) -> Array:
        """[..., P, T, 3] the displacement of wrist, knuckles and fingertips [..., P, T, 3] that are in the thigh."""
        depth, up = self.depth(points)
        return np.asarray(soft(depth + _MARGINS[:depth.shape[-2]], _SOFT)[..., None] * up)


def is_seated(motion: Motion) -> bool:
    """True if a motion on the default skeleton has legs, and they sit."""
    if "LeftUpLeg" not in motion.skeleton.names or not len(motion):
        return False
    thighs = thighs_of(pose_of(replace(motion, rotations=motion.rotations[:1], root_positions=np.zeros((1, 3)))))
    ways = np.concatenate([thigh.knee - thigh.hip for thigh in thighs])
    return bool((-ways[:, 1] < _LEVEL * np.linalg.norm(ways, axis=-1)).all())


def thighs_of(pose: Pose) -> tuple[Thigh, ...]:
    """Those of a pose that sits or is about to, with its hips at the origin."""
    if "LeftUpLeg" in pose.places:
        return tuple(Thigh(pose.places[side + "UpLeg"], pose.places[side + "Leg"]) for side in SIDES)
    # The upper body keeps its pose when it is seated, and the hips are turned under it.
    spine = WHOLE_BODY.offsets[WHOLE_BODY.index("Spine")]
    shift = pose.turns["Hips"] @ spine - spine
    return tuple(Thigh(hip + shift, knee + shift) for hip, knee in _seat())


@cache
def _seat() -> tuple[tuple[Array, Array], ...]:
    """Hip and knee [3] of the default character on its seat, that of `gesticulator.body.legs.seated`."""
    ends = []
    for side, out in zip(SIDES, (SEAT_SPREAD, -SEAT_SPREAD), strict=True):
        hip, bone = (WHOLE_BODY.offsets[WHOLE_BODY.index(side + part)] for part in ("UpLeg", "Leg"))
        ends.append((hip, hip + rotation.rotate(rotation.from_euler(np.radians([out, -90.0]), "YX"), bone)))
    return tuple(ends)
