"""Trunk and head of the default character as elliptic columns, around which named gestures are led."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from data_module.motion.skeletons import SIDES
from data_module.types import Array, Motion, Skeleton
from gesticulator.contacts.limbs import MARGIN, OURS, POLE_OF_ELBOW, Pose, bend, pose_of

_STEPS = 5
"""Iterations of pushing a hand outwards; each corrects the direction of the one before."""


@dataclass(frozen=True)
class Trunk:
    """An elliptic column from the hips to the neck.

    steps: [H] heights along it, 0 at the hips and 1 at the neck; width, depth: [H] half width and half depth, metres;
    ahead: [H] metres by which the middle of the body lies ahead of the line of the bones.
    """

    steps: Array
    width: Array
    depth: Array
    ahead: Array

    def distance(self, points: Array, hips: Array, neck: Array, chest: Array) -> tuple[Array, Array]:
        """[..., T] metres from the surface (negative inside) and [..., T, 3] the outward direction, for points
        [..., T, 3].

        hips, neck: [T, 3] the ends of the column; chest: [T, 3, 3] the character's axes there (columns left, up,
        ahead). The ends of the column are rounded.
        """
        axis = neck - hips
        length = np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-9)
        up = axis / length
        left = chest[..., 0] - np.sum(chest[..., 0] * up, axis=-1, keepdims=True) * up
        left = left / np.maximum(np.linalg.norm(left, axis=-1, keepdims=True), 1e-9)
        fore = np.cross(left, up)
        local = points - hips
        along = np.sum(local * up, axis=-1)
        nearest = np.clip(along, 0.0, length[:, 0])
        share = nearest / length[:, 0]
        width, depth, ahead = (np.interp(share, self.steps, column) for column in (self.width, self.depth, self.ahead))
        x, z = np.sum(local * left, axis=-1), np.sum(local * fore, axis=-1) - ahead
        # Exactly 0 between the ends: a rounding error (1e-17 m) would count as above the column, where the distance is
        # never negative, and a hand deep inside would seem to be on the surface.
        beyond = np.abs(along - nearest)
        radius = np.hypot(x, z)
        # The ellipse's radius in the direction of the point.
        angle = np.arctan2(z, x)
        surface = width * depth / np.hypot(depth * np.cos(angle), width * np.sin(angle))
        out = np.cos(angle)[..., None] * left + np.sin(angle)[..., None] * fore
        return np.where(beyond > 0.0, np.hypot(np.maximum(radius - surface, 0.0), beyond), radius - surface), out


def plain_trunk(width: float, depth: float) -> Trunk:
    """A column of constant half width and half depth, metres."""
    return Trunk(np.array([0.0, 1.0]), np.full(2, width), np.full(2, depth), np.zeros(2))


OUR_HEAD = Trunk(np.array([0.0, 0.2, 0.5, 0.8, 1.0]), np.array([0.04, 0.066, 0.078, 0.068, 0.035]),
                 np.array([0.06, 0.088, 0.1, 0.086, 0.045]), np.zeros(5))
"""The head of the default character, from chin to crown: that of an adult, 0.22 m high."""
_CHIN, _CROWN = np.array([0.0, -0.025, 0.02]), np.array([0.0, 0.195, 0.02])
"""From the joint of the head, metres."""
_PALM = ("Hand", "HandMiddle1")
_HAND = (*_PALM, *(f"Hand{finger}{joint}" for finger in ("Thumb", "Index", "Middle", "Pinky") for joint in (2, 3)))
"""Joints of a hand that are kept out of the trunk, and of the head."""


def trunk_distances(ours: Pose) -> dict[str, Array]:
    """Side -> [T] metres from the default character's trunk to the nearer of wrist and knuckles; negative inside."""
    trunk = plain_trunk(*OURS)
    column = ours.places["Hips"], ours.places["Neck"], ours.turns["Spine3"]
    return {side: trunk.distance(_places(ours, side, _PALM), *column)[0].min(axis=0) for side in SIDES}


def _places(ours: Pose, side: str, parts: Sequence[str]) -> Array:
    """[P, T, 3] metres, the places of those parts of a side that the body has."""
    return np.stack([ours.places[side + part] for part in parts if side + part in ours.places])


def push_out(turns: dict[int, Array], limbs: OurLimbs, chain: tuple[int, int, int], points: Sequence[int],
             wanted: Array, column: tuple[Trunk, Array, Array, Array]) -> None:
    """Bend an arm in `turns` where one of its points is nearer to the trunk than `wanted` [T] metres.

    chain: shoulder, elbow, wrist; column: the trunk and the arguments of `Trunk.distance`.
    """
    trunk, *place = column
    for _ in range(_STEPS):
        push = np.zeros_like(place[0])
        most = np.zeros(len(wanted))
        for gap, out in zip(*trunk.distance(limbs.places(turns, points), *place), strict=True):
            depth = np.maximum(wanted - gap, 0.0)
            push = np.where((depth > most)[:, None], depth[:, None] * out, push)
            most = np.maximum(most, depth)
        if most.max() < 1e-5:
            break
        bend(turns, limbs, chain, limbs.place(turns, chain[2]) + push, POLE_OF_ELBOW, most > 1e-5)


class OurLimbs:
    """The default skeleton as `Limbs`: its nodes are its joints."""

    def __init__(self, skeleton: Skeleton) -> None:
        self.skeleton = skeleton

    def place(self, turns: Mapping[int, Array], node: int) -> Array:
        """[T, 3] position of a joint relative to the hips; turns: joint -> [T, 3, 3] its world rotation."""
        return self._place(turns, node, self._fixed())

    def places(self, turns: Mapping[int, Array], nodes: Sequence[int]) -> Array:
        """[P, T, 3] positions of joints as `place` gives them; those above them are computed once."""
        known = self._fixed()
        return np.stack([self._place(turns, node, known) for node in nodes])

    def _fixed(self) -> dict[int, Array]:
        """The joint from which the others are placed, and its position [T, 3]."""
        return {0: np.zeros((1, 3))}

    def _place(self, turns: Mapping[int, Array], node: int, known: dict[int, Array]) -> Array:
        if node not in known:
            above = self.skeleton.parents[node]
            known[node] = self._place(turns, above, known) + turns[above] @ self.skeleton.offsets[node]
        return known[node]


def kept_out_of_us(motion: Motion, near: Mapping[str, Array]) -> Motion:
    """A motion on the default skeleton, root at the origin, with hands kept at the distances `near` from the trunk.

    near: side -> [T] metres, as from `trunk_distances`; beyond `MARGIN` a hand is free. Frames that need no correction
    are unchanged bit for bit.
    """
    pose = pose_of(motion)
    column = plain_trunk(*OURS), pose.places["Hips"], pose.places["Neck"], pose.turns["Spine3"]
    return _kept_out(motion, pose, {side: (trunk_distances(pose)[side], near[side]) for side in SIDES}, _PALM, column)


def head_distances(ours: Pose) -> dict[str, Array]:
    """Side -> [T] metres from the default character's head to the nearest of wrist, knuckles and fingertips; negative
    inside."""
    head = _head_of(ours)
    return {side: OUR_HEAD.distance(_places(ours, side, _HAND), *head)[0].min(axis=0) for side in SIDES}


def kept_off_our_head(motion: Motion, near: Mapping[str, Array]) -> Motion:
    """As `kept_out_of_us`, with hands and fingers kept at the distances `near` (`head_distances`) from the head."""
    pose = pose_of(motion)
    return _kept_out(motion, pose, {side: (head_distances(pose)[side], near[side]) for side in SIDES}, _HAND,
                     (OUR_HEAD, *_head_of(pose)))


def _head_of(ours: Pose) -> tuple[Array, Array, Array]:
    """[T, 3] chin and crown, and [T, 3, 3] the axes of the head."""
    turns, place = ours.turns["Head"], ours.places["Head"]
    return place + turns @ _CHIN, place + turns @ _CROWN, turns


def _kept_out(motion: Motion, pose: Pose, gaps: Mapping[str, tuple[Array, Array]], parts: Sequence[str],
              column: tuple[Trunk, Array, Array, Array]) -> Motion:
    """A motion with the parts of the hands pushed out of a column. gaps: side -> [T] metres from it, and those that are
    wanted; beyond `MARGIN` a hand is free."""
    names = motion.skeleton.index
    turns = {joint: pose.turns[name] for joint, name in enumerate(motion.skeleton.names)}
    limbs, rotations = OurLimbs(motion.skeleton), motion.rotations.copy()
    for side in SIDES:
        wanted = np.minimum(gaps[side][1], MARGIN)
        touched = gaps[side][0] < wanted - 1e-5
        if not touched.any():
            continue
        chain = (names(side + "Arm"), names(side + "ForeArm"), names(side + "Hand"))
        points = [names(side + part) for part in parts if side + part in motion.skeleton.names]
        push_out(turns, limbs, chain, points, np.where(touched, wanted, -np.inf), column)
        for joint in chain:
            local = np.swapaxes(turns[motion.skeleton.parents[joint]], -1, -2) @ turns[joint]
            rotations[touched, joint] = Rotation.from_matrix(local[touched]).as_quat(scalar_first=True)
    return replace(motion, rotations=rotations)
