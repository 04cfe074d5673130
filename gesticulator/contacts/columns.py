"""Trunk and head of the default character as elliptic columns, around which named gestures are led."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from data_module.motion.skeletons import SIDES
from data_module.types import Array, Motion
from gesticulator.contacts.limbs import (
    MARGIN,
    OURS,
    POLE_OF_ELBOW,
    BelowShoulder,
    Pose,
    bend,
    pose_of,
    trunk_axes,
    write_turns,
)

_STEPS = 5
"""Iterations of pushing a hand outwards; each corrects the direction of the one before."""
_LEAST = 1e-5
"""Metres below which a hand is not moved."""


@dataclass(frozen=True)
class Column:
    """An elliptic column in the default character that hands are kept out of.

    steps: [H] heights along it, from 0 to 1; width, depth: [H] half width and half depth, metres. ends: of a pose,
    [T, 3] the ends of the column and [T, 3, 3] the character's axes there (columns left, up, ahead). points: joints of
    a hand that are kept out.
    """

    steps: Array
    width: Array
    depth: Array
    ends: Callable[[Pose], tuple[Array, Array, Array]]
    points: tuple[str, ...] = ("Hand", "HandMiddle1")

    def distance(self, points: Array, low: Array, high: Array, turns: Array) -> tuple[Array, Array]:
        """[..., T] metres from the surface (negative inside) and [..., T, 3] the outward direction, for points
        [..., T, 3]; low, high, turns: of `ends`, which are rounded."""
        axes = trunk_axes(high - low, turns)
        left, up, fore = np.moveaxis(axes.axes, -2, 0)
        local = points - low
        along = np.sum(local * up, axis=-1)
        nearest = np.clip(along, 0.0, axes.length)
        width, depth = (np.interp(nearest / axes.length, self.steps, column) for column in (self.width, self.depth))
        x, z = np.sum(local * left, axis=-1), np.sum(local * fore, axis=-1)
        # Exactly 0 between the ends: a rounding error (1e-17 m) would count as above the column, where the distance is
        # never negative, and a hand deep inside would seem to be on the surface.
        beyond = np.abs(along - nearest)
        # The ellipse's radius in the direction of the point.
        radius, angle = np.hypot(x, z), np.arctan2(z, x)
        surface = width * depth / np.hypot(depth * np.cos(angle), width * np.sin(angle))
        out = np.cos(angle)[..., None] * left + np.sin(angle)[..., None] * fore
        return np.where(beyond > 0.0, np.hypot(np.maximum(radius - surface, 0.0), beyond), radius - surface), out

    def distances(self, pose: Pose) -> dict[str, Array]:
        """Side -> [T] metres from the surface to the nearest point of a hand; negative inside."""
        ends = self.ends(pose)
        return {side: np.min([self.distance(pose.places[side + point], *ends)[0] for point in self.points
                              if side + point in pose.places], axis=0) for side in SIDES}

    def kept_out(self, motion: Motion, near: Mapping[str, Array]) -> Motion:
        """A motion on the default skeleton, root at the origin, with hands kept at the distances `near`.

        near: side -> [T] metres, as from `distances`; beyond `MARGIN` a hand is free. Frames that need no correction
        are unchanged bit for bit.
        """
        pose, skeleton, rotations = pose_of(motion), motion.skeleton, motion.rotations.copy()
        turns = {skeleton.index(joint): turn for joint, turn in pose.turns.items()}
        gaps, ends = self.distances(pose), self.ends(pose)
        for side in SIDES:
            wanted = np.minimum(near[side], MARGIN)
            touched = gaps[side] < wanted - _LEAST
            if not touched.any():
                continue
            chain = skeleton.index(side + "Arm"), skeleton.index(side + "ForeArm"), skeleton.index(side + "Hand")
            limbs = BelowShoulder(skeleton, chain[0], pose.places[side + "Arm"])
            points = [skeleton.index(side + point) for point in self.points if side + point in pose.places]
            for _ in range(_STEPS):
                push, most = np.zeros_like(ends[0]), np.zeros(len(motion))
                # The point that is the deepest moves the hand.
                for point in points:
                    gap, out = self.distance(limbs.place(turns, point), *ends)
                    depth = np.where(touched, np.maximum(wanted - gap, 0.0), 0.0)
                    push = np.where((depth > most)[:, None], depth[:, None] * out, push)
                    most = np.maximum(most, depth)
                if most.max() < _LEAST:
                    break
                bend(turns, limbs, chain, limbs.place(turns, chain[2]) + push, POLE_OF_ELBOW, most > _LEAST)
            at = np.flatnonzero(touched)
            write_turns(rotations, skeleton, {joint: turn[at] for joint, turn in turns.items()}, chain, at)
        return replace(motion, rotations=rotations)


_CHIN, _CROWN = np.array([0.0, -0.025, 0.02]), np.array([0.0, 0.195, 0.02])
"""From the joint of the head, metres."""
_FINGERS = tuple(f"Hand{finger}{joint}" for finger in ("Thumb", "Index", "Middle", "Pinky") for joint in (2, 3))
TRUNK = Column(np.array([0.0, 1.0]), np.full(2, OURS[0]), np.full(2, OURS[1]),
               lambda pose: (pose.places["Hips"], pose.places["Neck"], pose.turns["Spine3"]))
HEAD = Column(
    np.array([0.0, 0.2, 0.5, 0.8, 1.0]), np.array([0.04, 0.066, 0.078, 0.068, 0.035]),
    np.array([0.06, 0.088, 0.1, 0.086, 0.045]),
    lambda pose: (pose.places["Head"] + pose.turns["Head"] @ _CHIN, pose.places["Head"] + pose.turns["Head"] @ _CROWN,
                  pose.turns["Head"]), (*TRUNK.points, *_FINGERS))
"""From chin to crown: that of an adult, 0.22 m high. Fingers are kept out of it, too."""
