"""Representations of motion: rotations (RG 4.1.1), or the positions of ten joints (RG 7.1.1, the TED data).

A representation converts the poses of a motion to vectors [T, D_m] and back; everything between (blocks, statistics,
models, interpolation, smoothing) is the same for all. Positions do not determine the twist of a limb. It is chosen
here: the elbow is a hinge, the head faces in the direction of the nose, and if neither is defined, as for a straight
arm, the previous twist is kept.
"""

import functools
import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from data_module.motion import kinematics, rotation, skeletons
from data_module.motion.skeletons import CHARACTER, CHARACTERS
from data_module.types import Array, Motion


class Representation(Protocol):
    """A representation of a pose of the character by `width` numbers (D_m)."""

    @property
    def name(self) -> str:
        """Name in the configuration."""

    @property
    def width(self) -> int:
        """D_m."""

    def vectors(self, motion: Motion, times: Array) -> Array:
        """[len(times), D_m] the poses of a motion of the character, in any of its sizes, at these seconds. Missing
        joints are at rest. Yaw and position of the root are removed (`skeletons.facing`). Before its start and after
        its end the motion has its first and last pose."""

    def motion(self, vectors: Array, fps: float) -> Motion:
        """A motion of the character from vectors [T, D_m], one each 1 / fps seconds."""

    def present(self, absent: tuple[str, ...]) -> NDArray[np.bool_]:
        """[D_m] True for the dimensions that are known if a source lacks these joints of the character."""


@dataclass(frozen=True)
class Rotations:
    """Exponential maps of all joints of the character, hierarchical, unrolled over time (RG 4.1.1). joints: how many, a
    size of `skeletons.CHARACTERS`: 16 make the papers' 48 numbers, 46 (with fingers) make 138."""

    joints: int = len(CHARACTER)
    name: str = "rotations"

    @property
    def width(self) -> int:
        return 3 * self.joints

    def vectors(self, motion: Motion, times: Array) -> Array:
        """See `Representation.vectors`: interpolated on the sphere, free of jumps from the first of `times` on."""
        motion = skeletons.resized(motion, CHARACTERS[self.joints])
        faced = skeletons.facing(motion)
        poses = rotation.interpolate(faced.rotations, np.asarray(times) * motion.fps)
        return rotation.unroll(rotation.to_exponential_map(poses)).reshape(len(poses), 3 * len(motion.skeleton))

    def motion(self, vectors: Array, fps: float) -> Motion:
        return skeletons.from_vector(vectors, fps)

    def present(self, absent: tuple[str, ...]) -> NDArray[np.bool_]:
        return np.repeat([joint not in absent for joint in CHARACTERS[self.joints].names], 3)


@dataclass(frozen=True)
class Positions:
    """TED's ten joints in metres from the first of them, the spine: 30 numbers (RG 7.1.1)."""

    name: str = "positions"
    width: int = 3 * 10

    def vectors(self, motion: Motion, times: Array) -> Array:
        """See `Representation.vectors`: interpolated along straight lines between the motion's own frames."""
        points = ted_positions(motion).reshape(len(motion), self.width)
        where = np.clip(np.asarray(times, dtype=np.float64) * motion.fps, 0, len(points) - 1)
        low = np.minimum(where.astype(int), max(len(points) - 2, 0))
        high = np.minimum(low + 1, len(points) - 1)
        share = (where - low)[:, None]
        return (1.0 - share) * points[low] + share * points[high]

    def motion(self, vectors: Array, fps: float) -> Motion:
        """See `Representation.motion`: only the directions of the bones count, see `rotations_from_positions`. The
        spine is the origin, whatever its three numbers say."""
        points = np.array(vectors, dtype=np.float64).reshape(len(vectors), len(TED_JOINTS), 3)
        points[:, 0] = 0.0
        return rotations_from_positions(points, fps)

    def present(self, absent: tuple[str, ...]) -> NDArray[np.bool_]:
        known = [index > 0 and not set(above) & set(absent) for index, above in enumerate(_CARRIED_BY)]
        return np.repeat(known, 3)


ROTATIONS, POSITIONS = Rotations(), Positions()
REPRESENTATIONS: dict[str, Representation] = {"rotations": ROTATIONS, "positions": POSITIONS}


def representation(name: str, joints: int) -> Representation:
    """The representation `name` (a key of `REPRESENTATIONS`); joints: for rotations."""
    return Rotations(joints) if name == ROTATIONS.name else REPRESENTATIONS[name]


TED_JOINTS = ("spine", "neck", "nose", "head", "left shoulder", "left elbow", "left wrist",
              "right shoulder", "right elbow", "right wrist")
"""Ten joints: the spine half way up the back, the neck between the shoulders, the tip of the nose (as deep as the one
of Human3.6M, which lies inside the face), the crown of the head, and both arms, the character's left (+X) first."""
TED_BONES = ((0, 1), (1, 2), (2, 3), (1, 4), (4, 5), (5, 6), (1, 7), (7, 8), (8, 9))
"""Nine bones as pairs of `TED_JOINTS`, parents before children."""
TED_ABSENT = ("Hips", "Spine3", "Neck1", "RightHand", "LeftHand")
"""Joints of the character that the ten points do not determine; they have the identity rotation."""

_SPINE, _NOSE, _HEAD = 0, 2, 3  # joints; the bones that follow are numbered by `TED_BONES`
_TO_NECK, _TO_NOSE, _TO_CROWN = 0, 1, 2
_SHOULDER_BONES = {"Left": 3, "Right": 6}

# In the frame of the head. With this nose the rest pose bends at the nose as TED's mean pose does (by 52 degrees).
NOSE_OFFSET = np.array([0.0, 0.078, 0.063])
CROWN_OFFSET = CHARACTER.end_sites[CHARACTER.index("Head")]
_NOTHING = np.zeros(3)
# For each of the ten: the joint of the character that carries it, and where in that joint's frame.
_POINTS = (("Spine2", _NOTHING), ("Neck", _NOTHING), ("Head", NOSE_OFFSET), ("Head", CROWN_OFFSET),
           *((side + joint, _NOTHING) for side in ("Left", "Right") for joint in ("Arm", "ForeArm", "Hand")))
# For each of the ten: the joints whose rotations determine its position.
_CARRIED_BY = ((), (), ("Head",), ("Head",), *((side + "Arm",) * (joint > 0) + (side + "ForeArm",) * (joint > 1)
                                               for side in ("Left", "Right") for joint in range(3)))

_LEFT, _UP = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
# At rest an elbow that closes turns the level forearm forward and a little up: by 12 degrees, measured on four people.
_HINGE = {side: sign * np.array([0.0, -math.cos(math.radians(12)), -math.sin(math.radians(12))])
          for side, sign in (("Left", 1.0), ("Right", -1.0))}
_UNSURE, _SURE = math.sin(math.radians(5)), math.sin(math.radians(25))
_FASTEST = 12.0  # radians per second that a limb may turn about its own length
_EPS = 1e-9


def ted_positions(motion: Motion) -> Array:
    """`TED_JOINTS` of a motion of the character, [T, 10, 3] metres from the spine, in the facing frame. Y is up, the
    hips face +Z and the left is +X (`skeletons.facing`). ValueError for a motion of something else."""
    faced = skeletons.facing(skeletons.resized(motion, CHARACTER))
    world = kinematics.global_rotations(faced.skeleton, faced.rotations)
    places = kinematics.positions_of(faced)
    carriers = [CHARACTER.index(joint) for joint, _ in _POINTS]
    points = places[:, carriers] + rotation.rotate(world[:, carriers], np.array([offset for _, offset in _POINTS]))
    return points - points[:, :1]


def bone_directions(positions: Array) -> Array:
    """Unit vectors [T, 9, 3] along `TED_BONES` of positions [T, 10, 3] in any unit. A bone without a length has the
    direction that it had before, or that of the rest pose where it had none yet."""
    points = np.asarray(positions, dtype=np.float64)
    if points.ndim != 3 or points.shape[1:] != (len(TED_JOINTS), 3):
        raise ValueError(f"positions must be [T, {len(TED_JOINTS)}, 3], not {points.shape}")
    if not np.isfinite(points).all():
        raise ValueError("positions must be finite")
    # Row 0 is the rest pose, for bones without a direction in the first frames.
    start, end = np.array(TED_BONES).T
    ways = np.concatenate([_rest_directions()[None], points[:, end] - points[:, start]])
    lengths = np.linalg.norm(ways, axis=-1)
    last = np.where(lengths > _EPS, np.arange(len(ways))[:, None], 0)
    last = np.maximum.accumulate(last, axis=0)
    bones = np.arange(len(TED_BONES))
    return (ways[last, bones] / lengths[last, bones][..., None])[1:]


def rotations_from_positions(positions: Array, fps: float) -> Motion:
    """A motion of the 16-joint character whose bones point as those of `TED_JOINTS` [T, 10, 3] do.

    Y is up, the speaker faces +Z, left is +X; origin, unit and bone lengths are ignored, and the character's own bone
    lengths are used. A turn of the whole speaker appears as a turn of the torso against the hips. `ted_positions` of
    the result has exactly the directions of the input, with one exception: between neck, nose and crown a head bends by
    10 to 118 degrees only. Outside this range, or if the head would have to spin, nose to crown takes the nearest
    possible direction.

    The torso turns with the shoulders, in equal parts over three joints of the spine; the collar bones take the rest;
    the plane of neck, nose and crown is fixed in the head; the elbow is a hinge; the wrist is straight. No limb twists
    faster than 12 rad/s, nor if the twist is not visible (a straight arm). A frame depends on previous frames only. The
    joints in `TED_ABSENT` have the identity. ValueError for another shape or numbers that are not finite.
    """
    bones = bone_directions(positions)
    world = np.zeros((len(bones), len(CHARACTER), 4))
    world[..., 0] = 1.0
    torso = _torso(bones, fps)
    # Unrolled first: a third of a turn that jumps by 2 pi would jump by 120 degrees.
    share = rotation.from_exponential_map(rotation.unroll(rotation.to_exponential_map(torso)) / 3.0)
    parts: dict[str, Array] = {"Spine": share, "Spine1": rotation.multiply(share, share), "Spine2": torso,
                               "Spine3": torso}
    parts["Neck"], parts["Head"] = _neck_and_head(bones, torso, fps)
    parts["Neck1"] = parts["Neck"]
    for side in _SHOULDER_BONES:
        parts[side + "Shoulder"] = _collar(bones, torso, side)
        parts[side + "Arm"], parts[side + "ForeArm"] = _arm(bones, torso, side, fps)
        parts[side + "Hand"] = parts[side + "ForeArm"]
    for joint, turn in parts.items():
        world[:, CHARACTER.index(joint)] = turn
    local = rotation.continuous(rotation.normalise(kinematics.local_rotations(CHARACTER, world)))
    # Exactly, without rounding errors, which would be scaled up by the tiny standard deviation of absent joints.
    local[:, [CHARACTER.index(joint) for joint in TED_ABSENT]] = (1.0, 0.0, 0.0, 0.0)
    return Motion(CHARACTER, local, np.zeros((len(bones), 3)), fps, TED_ABSENT)


def _torso(bones: Array, fps: float) -> Array:
    """[T, 4] the chest's rotation: up along spine to neck, sideways from shoulder to shoulder."""
    up, rest_up = bones[:, _TO_NECK], _rest_directions()[_TO_NECK]
    across = 0.5 * (bones[:, _SHOULDER_BONES["Left"]] - bones[:, _SHOULDER_BONES["Right"]])
    first = rotation.rotate(rotation.between(rest_up[None], up[:1], _LEFT[None])[0], _LEFT)
    return rotation.from_axes((rest_up, _LEFT), up, _followed(up, across, first, fps))


def _neck_and_head(bones: Array, torso: Array, fps: float) -> tuple[Array, Array]:
    """[T, 4] the rotations of neck and head for the directions of nose and crown from the neck."""
    to_nose, to_crown = bones[:, _TO_NOSE], bones[:, _TO_CROWN]
    rest = CROWN_OFFSET - NOSE_OFFSET
    rest = rest / np.linalg.norm(rest)
    start = rotation.between(rotation.rotate(torso[:1], rest), to_crown[:1], rotation.rotate(torso[:1], _LEFT))
    left = _followed(to_crown, np.cross(to_crown, to_nose), rotation.rotate(rotation.multiply(start, torso[:1]),
                                                                            _LEFT)[0], fps)
    head = rotation.from_axes((rest, _LEFT), to_crown, left)

    # The triangle of neck joint, head joint and nose has two known sides: the neck, and head joint to nose.
    neck = CHARACTER.offsets[CHARACTER.index("Neck1")] + CHARACTER.offsets[CHARACTER.index("Head")]
    neck_length, nose_length = float(np.linalg.norm(neck)), float(np.linalg.norm(NOSE_OFFSET))
    nose = rotation.rotate(head, NOSE_OFFSET)
    cosine = np.sum(to_nose * nose, axis=-1) / nose_length
    excess = np.arccos(np.clip(cosine, -1.0, 1.0)) - math.asin(neck_length / nose_length)
    normal = np.cross(nose, to_nose)
    size = np.linalg.norm(normal, axis=-1, keepdims=True)
    normal = np.where(size > _EPS, normal / np.maximum(size, _EPS), left)
    head = rotation.multiply(rotation.from_exponential_map(normal * np.maximum(excess, 0.0)[:, None]), head)
    nose = rotation.rotate(head, NOSE_OFFSET)
    along = _reach(to_nose, nose, neck_length)
    return rotation.multiply(rotation.between(rotation.rotate(torso, neck), along, left), torso), head


def _collar(bones: Array, torso: Array, side: str) -> Array:
    """[T, 4] the rotation of a collar bone for the direction of the shoulder from the neck."""
    spine = CHARACTER.offsets[CHARACTER.index("Neck")]
    begin = rotation.rotate(torso, CHARACTER.offsets[CHARACTER.index(side + "Shoulder")] - spine)
    bone = CHARACTER.offsets[CHARACTER.index(side + "Arm")]
    along = _reach(bones[:, _SHOULDER_BONES[side]], begin, float(np.linalg.norm(bone)))
    return rotation.multiply(rotation.between(rotation.rotate(torso, bone), along, rotation.rotate(torso, _UP)), torso)


def _reach(directions: Array, begin: Array, length: float) -> Array:
    """[T, 3] the vector of this length from `begin` to the farther point on the ray along `directions`."""
    along = np.sum(directions * begin, axis=-1)
    # Ray and sphere: the larger root is the farther point; without an intersection the nearest point of the ray.
    inside = along ** 2 - np.sum(begin * begin, axis=-1) + length ** 2
    return (along + np.sqrt(np.maximum(inside, 0.0)))[:, None] * directions - begin


def _arm(bones: Array, torso: Array, side: str, fps: float) -> tuple[Array, Array]:
    """[T, 4] the rotations of upper arm and forearm; the axis of the elbow is the normal of their plane."""
    upper, fore = bones[:, _SHOULDER_BONES[side] + 1], bones[:, _SHOULDER_BONES[side] + 2]
    outward = CHARACTER.offsets[CHARACTER.index(side + "ForeArm")]
    outward = outward / np.linalg.norm(outward)
    resting_hinge = rotation.rotate(torso[:1], _HINGE[side])
    start = rotation.between(rotation.rotate(torso[:1], outward), upper[:1], resting_hinge)
    hinge = _followed(upper, np.cross(upper, fore), rotation.rotate(start, resting_hinge)[0], fps)
    turn = rotation.from_axes((outward, _HINGE[side]), upper, hinge)
    return turn, rotation.multiply(rotation.between(upper, fore, hinge), turn)


def _followed(along: Array, sideways: Array, first: Array, fps: float) -> Array:
    """[T, 3] unit vectors perpendicular to the directions `along` that follow `sideways` [T, 3] without jumps.

    The length of `sideways` is its reliability, from 0 to 1. From frame to frame the vector is transported by the
    shortest rotation of `along` and then turns about `along` towards `sideways`, at most by `_FASTEST` times the
    reliability. first: [3] the initial vector.
    """
    perpendicular = sideways - np.sum(sideways * along, axis=-1, keepdims=True) * along
    trust = np.clip((np.linalg.norm(perpendicular, axis=-1) - _UNSURE) / (_SURE - _UNSURE), 0.0, 1.0)
    carried = _carried(along, first)
    across = np.cross(along, carried)
    wanted = np.arctan2(np.sum(perpendicular * across, axis=-1), np.sum(perpendicular * carried, axis=-1))
    angles = np.empty(len(along))
    now = 0.0
    for t, (goal, limit) in enumerate(zip(wanted.tolist(), (trust * _FASTEST / fps).tolist(), strict=True)):
        # The shorter way round, whatever number of turns `now` has.
        way = math.remainder(goal - now, math.tau)
        # The first frame may jump.
        now += way * trust[0] if t == 0 else max(-limit, min(limit, way))
        angles[t] = now
    return np.cos(angles)[:, None] * carried + np.sin(angles)[:, None] * across


def _carried(along: Array, first: Array) -> Array:
    """[T, 3] `first` transported by the shortest rotations between successive directions [T, 3]."""
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (len(along), 1))
    # Any perpendicular vector will do for a reversal of direction.
    sideways = np.cross(along, np.eye(3)[np.argmin(np.abs(along), axis=-1)])
    turns[1:] = rotation.between(along[:-1], along[1:], sideways[:-1])
    # The cumulative product of all rotations in log2(T) steps.
    reach = 1
    while reach < len(turns):
        turns[reach:] = rotation.multiply(turns[reach:], turns[:-reach])
        reach *= 2
    axes = rotation.rotate(rotation.normalise(turns), first)
    axes = axes - np.sum(axes * along, axis=-1, keepdims=True) * along
    return axes / np.linalg.norm(axes, axis=-1, keepdims=True)


@functools.cache
def _rest_directions() -> Array:
    """[9, 3] directions of `TED_BONES` of the character at rest."""
    identity = np.zeros((1, len(CHARACTER), 4))
    identity[..., 0] = 1.0
    points = ted_positions(Motion(CHARACTER, identity, np.zeros((1, 3)), 1.0))[0]
    ways: Array = np.array([points[end] - points[start] for start, end in TED_BONES])
    return ways / np.linalg.norm(ways, axis=-1, keepdims=True)


