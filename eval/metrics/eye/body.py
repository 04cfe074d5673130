"""The body that the eye's figures are measured on: any upper body, at 60 Hz, with one size and one heading.

Theory: people differ in size and stand where they like; how they gesture should not depend on it. So every motion is
brought to 60 frames a second and to one common body: hips at the origin, facing +Z in every frame (their heading is
taken off, not their tilt), 40 cm from hips to chest, 21.5 cm from chest to head, upper arms of 28 cm and forearms of
25 cm. The trunk follows the world rotations of the source's spine, whose bones share the 40 cm as they share the
source's length; the arms follow the directions of the source's bones. The chest is the joint that both arms hang on.

What fools it: a source whose rest pose is not upright has no common body (ValueError). A turn of the whole
speaker that is in the spine and not in the hips counts as movement of the chest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from data_module.motion import kinematics, rotation
from data_module.motion.skeletons import axes_of, find_table, rest_positions
from data_module.types import Array, Motion, Skeleton
from gesticulator.characters.mapping import ancestors

HZ = 60.0
"""Frames per second of every figure."""
SIDES = ("Right", "Left")
_TO_CHEST, _TO_NECK, _TO_HEAD = 0.40, 0.135, 0.08
"""Metres: hips to chest, chest to neck, neck to head."""
_WAIST = 0.75
"""Share of the way from the hips to the chest where the waist is."""
_COLLAR, _SHOULDER = np.array([0.03, 0.09, 0.02]), np.array([0.15, 0.0, -0.03])
"""Metres: from the chest to the left collar bone, and along it; mirrored on the right."""
_UPPER_ARM, _FOREARM = 0.28, 0.25
_UPRIGHT, _LEVEL = 0.8, 0.4
"""Cosines: a rest pose is upright where its trunk is this vertical and its shoulders are no steeper."""
_EPS = 1e-9


@dataclass(frozen=True)
class CommonBody:
    """points: name -> [T, 3] metres of Chest, Waist, Neck, Head, and of both sides' Arm, ForeArm and Hand; chest, head:
    [T, 4] world rotations from the rest pose; finger_speed: [T - 1] degrees a second of the fastest finger joint, None
    where there are no fingers; wrists: [T, 2] degrees between the forearm and the line to the first joint of the middle
    finger, the right first, None without such joints; finger_bends: side and finger -> [T, n] degrees at its joints.
    All at `HZ`."""

    points: dict[str, Array]
    chest: Array
    head: Array
    finger_speed: Array | None = None
    wrists: Array | None = None
    finger_bends: dict[tuple[str, str], Array] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.chest)

    @property
    def duration(self) -> float:
        """Seconds."""
        return len(self) / HZ

    @property
    def hands(self) -> Array:
        """[T, 2, 3] both wrists, the right first."""
        return np.stack([self.points[side + "Hand"] for side in SIDES], axis=1)

    @property
    def hand_speed(self) -> Array:
        """[T - 1, 2] m/s of both wrists as seen from the hips."""
        speed: Array = np.linalg.norm(np.diff(self.hands, axis=0), axis=-1) * HZ
        return speed

    def crop(self, start: int, stop: int) -> CommonBody:
        """The frames start..stop-1."""
        # Speeds lie between frames, so a crop of n frames has n - 1 of them.
        fingers = None if self.finger_speed is None else self.finger_speed[start:max(stop - 1, start)]
        return replace(self, points={name: place[start:stop] for name, place in self.points.items()},
                       chest=self.chest[start:stop], head=self.head[start:stop], finger_speed=fingers,
                       wrists=None if self.wrists is None else self.wrists[start:stop],
                       finger_bends={name: angles[start:stop] for name, angles in self.finger_bends.items()})


def common_body(motion: Motion) -> CommonBody:
    """Any upper body as the common one. InputError where its joints are not known, ValueError where its rest pose is
    not upright."""
    skeleton = motion.skeleton
    joints = dict(find_table(skeleton.names))
    joints["Chest"] = _chest(skeleton.parents, skeleton.names, joints)
    # First the rate, as smoothing and thresholds below are in frames of 60 Hz.
    resampled = kinematics.resample(motion, HZ)
    world, places = kinematics.global_rotations(skeleton, resampled.rotations), kinematics.positions_of(resampled)
    change = _axes(skeleton, joints)
    world = rotation.multiply(rotation.multiply(change, world), rotation.conjugate(change))
    # Seen from the hips in every frame: a speaker who walks gestures alike.
    places = rotation.rotate(change, places - places[:, joints["Hips"], None])
    # The heading of every frame is taken off: a speaker who turns to someone else gestures alike.
    back = _heading(world[:, joints["Hips"]])
    world, places = rotation.multiply(back[:, None], world), rotation.rotate(back[:, None], places)
    points = _trunk(motion, joints, world)
    for side, sign in zip(SIDES, (-1.0, 1.0), strict=True):
        _arm(points, side, sign, joints, skeleton.parents, world, places)
    wrists, bends = _hand_angles(resampled, joints, places)
    return CommonBody(points, world[:, joints["Chest"]], world[:, joints["Head"]],
                      _finger_speed(resampled, [joints[side + "Hand"] for side in SIDES]), wrists, bends)


def _chain(parents: Sequence[int], top: int, end: int) -> list[int]:
    """The joints from `top` down to `end`; ValueError where `end` does not hang on `top`."""
    above = [end, *ancestors(parents, end)]
    if top not in above:
        raise ValueError("the head and the arms do not hang on the hips")
    return above[:above.index(top) + 1][::-1]


def _chest(parents: Sequence[int], names: Sequence[str], joints: dict[str, int]) -> int:
    """The lowest joint that carries both arms; never the neck."""
    right = set(ancestors(parents, joints["RightArm"]))
    chest = next(joint for joint in ancestors(parents, joints["LeftArm"]) if joint in right)
    if "neck" in names[chest].lower() and parents[chest] >= 0:
        chest = parents[chest]
    # Arms that hang on the hips (rigs in pieces): the spine is the chest.
    return joints.get("Spine2", joints["Spine"]) if chest == joints["Hips"] else chest


def _axes(skeleton: Skeleton, joints: dict[str, int]) -> Array:
    """[4] the rotation that brings the source's axes onto ours (Y up, left +X); ValueError for a rest pose that is not
    upright."""
    rest = rest_positions(skeleton)
    change = axes_of(rest, joints)
    trunk, across = rotation.rotate(change, np.stack([unit(rest[joints[end]] - rest[joints[start]]) for start, end in (
        ("Hips", "Head"), ("RightArm", "LeftArm"))]))
    if trunk[1] <= _UPRIGHT or abs(across[1]) >= _LEVEL:
        raise ValueError("the rest pose is not upright, so there is no common body")
    return change


def unit(vectors: Array) -> Array:
    """[..., 3] scaled to length 1; what has no length stays at zero."""
    lengths: Array = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.maximum(lengths, _EPS)


def bend(first: Array, second: Array) -> Array:
    """[T] degrees between vectors [T, 3]."""
    return np.asarray(np.degrees(np.arccos(np.clip((unit(first) * unit(second)).sum(axis=-1), -1.0, 1.0))))


def chest_left(body: CommonBody) -> Array:
    """[T, 3] the chest's own left."""
    return rotation.rotate(body.chest, np.array([1.0, 0.0, 0.0]))


def _heading(hips: Array) -> Array:
    """[T, 4] the turns about Y that bring the hips [T, 4] to face +Z."""
    ahead = rotation.rotate(hips, np.array([0.0, 0.0, 1.0]))
    # A quaternion holds half of the angle.
    half = -0.5 * np.arctan2(ahead[:, 0], ahead[:, 2])
    return np.stack([np.cos(half), np.zeros_like(half), np.sin(half), np.zeros_like(half)], axis=-1)


def _trunk(motion: Motion, joints: dict[str, int], world: Array) -> dict[str, Array]:
    """Waist, chest, neck and head: the spine's own turns, its bones upright at rest and of common lengths."""
    skeleton = motion.skeleton
    # Rigs differ in the number of spine joints, so the bones share the common length as they share their own.
    lengths = np.linalg.norm(skeleton.offsets, axis=1)
    spine = _chain(skeleton.parents, joints["Hips"], joints["Chest"])
    throat = _chain(skeleton.parents, joints["Chest"], joints["Head"])
    origin = np.zeros((len(world), 3))
    points = {"Chest": _along(spine, origin, lengths, world, _TO_CHEST),
              "Waist": _along(spine, origin, lengths, world, _TO_CHEST, _WAIST)}
    # The neck may be the chest itself, where the head is its child; then there is no neck to bend.
    at = throat.index(joints["Neck"]) if joints["Neck"] in throat else None
    if at is None:
        points["Head"] = points["Neck"] = _along(throat, points["Chest"], lengths, world, _TO_NECK + _TO_HEAD)
    else:
        points["Neck"] = _along(throat[:at + 1], points["Chest"], lengths, world, _TO_NECK)
        points["Head"] = _along(throat[at:], points["Neck"], lengths, world, _TO_HEAD)
    return points


def _along(chain: Sequence[int], start: Array, lengths: Array, world: Array, total: float, part: float = 1.0) -> Array:
    """[T, 3] the place `part` of the way along a chain that is `total` metres long and upright at rest."""
    bones = np.array([lengths[joint] for joint in chain[1:]])
    place, left = start, part * total
    for joint, length in zip(chain[:-1], bones * total / max(float(bones.sum()), _EPS), strict=True):
        place = place + rotation.rotate(world[:, joint], np.array([0.0, min(float(length), left), 0.0]))
        left = max(left - float(length), 0.0)
    return place


def _arm(points: dict[str, Array], side: str, sign: float, joints: dict[str, int], parents: Sequence[int],
         world: Array, places: Array) -> None:
    """Shoulder, elbow and wrist of a side; sign: +1 on the left."""
    chain = _chain(parents, joints["Chest"], joints[side + "Arm"])
    collar = chain[1] if len(chain) > 2 else joints["Chest"]
    # The shoulder is that of the common body: sources differ in where they set their clavicles.
    mirror = np.array([sign, 1.0, 1.0])
    points[side + "Arm"] = (points["Chest"] + rotation.rotate(world[:, joints["Chest"]], mirror * _COLLAR)
                            + rotation.rotate(world[:, collar], mirror * _SHOULDER))
    for bone, tip, length in (("Arm", "ForeArm", _UPPER_ARM), ("ForeArm", "Hand", _FOREARM)):
        way = places[:, joints[side + tip]] - places[:, joints[side + bone]]
        points[side + tip] = points[side + bone] + length * unit(way)


def _finger_speed(motion: Motion, hands: Sequence[int]) -> Array | None:
    """[T - 1] degrees a second of the fastest joint below the wrists; None without such joints, or of one frame."""
    parents = motion.skeleton.parents
    fingers = [joint for joint, name in enumerate(motion.skeleton.names)
               if {*hands} & {*ancestors(parents, joint)} and name not in motion.absent]
    if not fingers or len(motion) < 2:
        return None
    # The fastest joint, not the mean: a hand that points moves one finger.
    turns = motion.rotations[:, fingers]
    speed: Array = np.degrees(rotation.angle_between(turns[:-1], turns[1:])).max(axis=1) * HZ
    return speed


FINGERS = ("thumb", "index", "middle", "ring", "pinky")


def _hand_angles(motion: Motion, joints: dict[str, int], places: Array
                 ) -> tuple[Array | None, dict[tuple[str, str], Array]]:
    """[T, 2] bend of the wrists, and side and finger -> [T, n] bend of its joints, degrees, from joint places."""
    skeleton, parents = motion.skeleton, motion.skeleton.parents
    # Rigs call the fifth finger pinky, pinkie or little.
    names = [name.rsplit(":", 1)[-1].lower().replace("pinkie", "pinky").replace("little", "pinky")
             for name in skeleton.names]
    wrists, bends = [], {}
    for side in SIDES:
        hand, elbow = joints[side + "Hand"], joints[side + "ForeArm"]
        below = [joint for joint in range(len(parents)) if hand in ancestors(parents, joint)
                 and skeleton.names[joint] not in motion.absent]
        tip = next((joint for name in ("middle", "index") for joint in below if name in names[joint]), None)
        if tip is not None:
            wrists.append(_angle(places[:, hand] - places[:, elbow], places[:, tip] - places[:, hand]))
        for finger in FINGERS:
            angles = [_angle(places[:, parents[joint]] - places[:, parents[parents[joint]]],
                             places[:, joint] - places[:, parents[joint]])
                      for joint in below if finger in names[joint] and finger in names[parents[joint]]]
            known = [angle for angle in angles if angle is not None]
            if known:
                bends[side, finger] = np.stack(known, axis=1)
    known = [angle for angle in wrists if angle is not None]
    return (np.stack(known, axis=1) if len(known) == len(SIDES) else None), bends


def _angle(first: Array, second: Array) -> Array | None:
    """[T] degrees between vectors [T, 3]; None where one has no length."""
    # A bone that shrinks to nothing in some frame has no direction there.
    if min(float(np.linalg.norm(way, axis=-1).min()) for way in (first, second)) <= 1e-6:
        return None
    return bend(first, second)
