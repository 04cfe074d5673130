"""Distances of hands from the default character's trunk and head, taken as elliptic columns: a measure of their own,
beside the height fields that `gesticulator.contacts.default_body` keeps hands out of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from data_module.motion.skeletons import SIDES
from data_module.types import Array
from gesticulator.contacts.limbs import OURS, Pose


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


HEAD = Trunk(np.array([0.0, 0.2, 0.5, 0.8, 1.0]), np.array([0.04, 0.066, 0.078, 0.068, 0.035]),
                 np.array([0.06, 0.088, 0.1, 0.086, 0.045]), np.zeros(5))
"""The head of the default character, from chin to crown: that of an adult, 0.22 m high."""
_CHIN, _CROWN = np.array([0.0, -0.025, 0.02]), np.array([0.0, 0.195, 0.02])
"""From the joint of the head, metres."""
_PALM = ("Hand", "HandMiddle1")
_HAND = (*_PALM, *(f"Hand{finger}{joint}" for finger in ("Thumb", "Index", "Middle", "Pinky") for joint in (2, 3)))
"""Joints of a hand that are measured from the trunk, and from the head."""


def trunk_distances(pose: Pose) -> dict[str, Array]:
    """Side -> [T] metres from the default character's trunk to the nearer of wrist and knuckles; negative inside."""
    trunk = plain_trunk(*OURS)
    column = pose.places["Hips"], pose.places["Neck"], pose.turns["Spine3"]
    return {side: trunk.distance(_places(pose, side, _PALM), *column)[0].min(axis=0) for side in SIDES}


def _places(pose: Pose, side: str, parts: Sequence[str]) -> Array:
    """[P, T, 3] metres, the places of those parts of a side that the body has."""
    return np.stack([pose.places[side + part] for part in parts if side + part in pose.places])


def head_distances(pose: Pose) -> dict[str, Array]:
    """Side -> [T] metres from the default character's head to the nearest of wrist, knuckles and fingertips; negative
    inside."""
    head = _head_of(pose)
    return {side: HEAD.distance(_places(pose, side, _HAND), *head)[0].min(axis=0) for side in SIDES}


def _head_of(pose: Pose) -> tuple[Array, Array, Array]:
    """[T, 3] chin and crown, and [T, 3, 3] the axes of the head."""
    turns, place = pose.turns["Head"], pose.places["Head"]
    return place + turns @ _CHIN, place + turns @ _CROWN, turns
