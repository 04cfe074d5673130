"""Two-bone inverse kinematics for all frames at once."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from data_module.motion import rotation
from data_module.types import Array

_STRETCHED = 0.9995
"""Largest share of a limb's length used: a fully stretched knee jumps."""


class Limbs(Protocol):
    """A body that computes the positions of its nodes."""

    def place(self, turns: Mapping[int, Array], node: int) -> Array:
        """[T, 3] position of a node relative to the hips, metres; turns: node -> [T, 3, 3] its axes to ours."""


def bend(turns: dict[int, Array], body: Limbs, chain: tuple[int, int, int], goal: Array, pole: Array,
         where: NDArray[np.bool_] | None = None) -> None:
    """Rotate the first two nodes of a chain so that the third reaches `goal` [T, 3].

    The middle joint stays in the plane in which it bends; that of a straight limb bends towards `pole` [3]. Positions
    are relative to the hips; the third node keeps its world rotation if it is in `turns`. where: [T] the frames to
    change; default all.
    """
    top, middle, _ = chain
    socket, hinge, tip = (body.place(turns, node) for node in chain)
    upper, lower = hinge - socket, tip - hinge
    for node, before, after in zip((top, middle), (upper, lower), bent(upper, lower, goal - socket, pole), strict=True):
        turned = swing(before, after) @ turns[node]
        turns[node] = turned if where is None else np.where(where[:, None, None], turned, turns[node])


def bent(upper: Array, lower: Array, way: Array, pole: Array) -> tuple[Array, Array]:
    """The two bones [T, 3] of a limb that reaches `way` [T, 3] from its first joint; see `bend`."""
    first, second, far = length(upper), length(lower), length(way)
    along = way / np.maximum(far, 1e-9)
    far = np.clip(far, np.abs(first - second) / _STRETCHED + 1e-9, _STRETCHED * (first + second))
    # Law of cosines: the middle joint's distance along the direction to the goal, and beside it.
    share = (first ** 2 + far ** 2 - second ** 2) / (2.0 * far)
    beside = np.sqrt(np.maximum(first ** 2 - share ** 2, 0.0))
    out = upper - np.sum(upper * along, axis=-1, keepdims=True) * along
    straight = length(out) < 1e-4 * first
    out = np.where(straight, pole - (along @ pole)[:, None] * along, out)
    new_upper = share * along + beside * (out / np.maximum(length(out), 1e-9))
    return new_upper, far * along - new_upper


def swivel(turns: dict[int, Array], body: Limbs, chain: tuple[int, int, int], shift: Array) -> None:
    """Rotate the first two nodes of a chain so that the second moves by about `shift` [T, 3], as far as the places of
    the first and the third let it; the third keeps its world rotation if it is in `turns`.

    One that is opposite to where it should go could leave to either side. It is moved the less, the nearer it is to
    there: at an angle a from that direction, by cos(a / 2) of the shift, so that no small difference grows to a jump.
    """
    top, middle, _ = chain
    socket, hinge, tip = (body.place(turns, node) for node in chain)
    upper, lower = hinge - socket, tip - hinge
    moved = swivelled(upper, lower, shift)
    turns[top] = swing(upper, moved) @ turns[top]
    turns[middle] = swing(lower, tip - socket - moved) @ turns[middle]


def swivelled(upper: Array, lower: Array, shift: Array) -> Array:
    """[T, 3] the first bone of a limb of two bones [T, 3] whose middle joint moves by about `shift` [T, 3]; see
    `swivel`."""
    way = upper + lower
    along = way / np.maximum(length(way), 1e-9)
    centre = np.sum(upper * along, axis=-1, keepdims=True) * along
    beside = upper - centre
    size = length(beside)
    shift = shift - np.sum(shift * along, axis=-1, keepdims=True) * along
    cosine = np.sum(shift * beside, axis=-1, keepdims=True) / np.maximum(length(shift) * size, 1e-9)
    moved = beside + shift * np.sqrt(np.maximum(1.0 + cosine, 0.0) / 2.0)
    far = length(moved)
    return centre + np.where(far > 1e-6, moved / np.maximum(far, 1e-9) * size, beside)


def length(vectors: Array) -> Array:
    """[..., 1] lengths of vectors [..., 3]; `numpy.linalg.norm` takes three times as long for few of them."""
    return np.asarray(np.sqrt(np.sum(vectors * vectors, axis=-1, keepdims=True)))


def swing(a: Array, b: Array) -> Array:
    """[T, 3, 3] the shortest rotations from directions a [T, 3] to b."""
    a = a / length(a)
    b = b / length(b)
    q = np.concatenate([1.0 + np.sum(a * b, axis=-1, keepdims=True), rotation.cross(a, b)], axis=-1)
    return rotation.to_matrix(rotation.normalise(q))
