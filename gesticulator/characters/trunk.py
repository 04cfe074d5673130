"""Keeps hands out of a trunk of any shape.

The same bone directions bring hands to other places on other bodies: a hand that passes a slim waist at a hand's
breadth ends inside a stout one. There is no way out of a closed shape that is continuous everywhere: at its middle, it
turns round, and the hand jumps. The hands of the default character, however, are outside its trunk, so that they say on
which side of any trunk they belong. With a, b half the width and depth of the default trunk and (x, z) the place of its
hand across and ahead of it,

    n = (x / a^2, z / b^2) / |(x / a^2, z / b^2)|,   g = n (x, z) - |(a n_x, b n_z)|                              (1)

are the outward normal of the ellipse through the hand and the hand's distance from the tangent of the trunk. The hand
of the character at (X, Z) belongs beyond the tangent of its trunk with the same normal, at the same distance:

    n (X, Z) >= h(n) + s w(g)                                                                                     (2)

where h is the support function of a slice of its trunk (of the mesh, at the height of the hand), s the ratio of arm
lengths and w(g) a smooth minimum of g and `MARGIN`. What is lacking is added along n. The projection on a half-plane
moves no two points apart and n changes continuously with the pose, so a hand that passes the trunk is led around it
without a jump. A character with the trunk of the default one keeps its pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from data_module.motion.skeletons import SIDES
from data_module.types import Array
from gesticulator.characters.contacts import MARGIN, OURS

if TYPE_CHECKING:
    from gesticulator.characters.frames import Body
    from gesticulator.characters.rig import Skin

ANGLES = np.arange(36) * (2.0 * np.pi / 36)
"""Directions in which a slice is measured: between them the surface of a round one is at most 0.4 % farther out."""
_STEPS = (np.arange(-6, 12) + 0.5) / 12.0
"""Heights of the slices, 0 at the hips and 1 at the neck: pelvis and thighs are below the hips."""
_STANDS = 0.85
"""Cosine between thighs and straight down above which they are part of the column."""
FLEXED = 0.25
"""Radians by which thighs that stand may be ahead of where they hang in the bind pose: knees give, weight shifts."""
FEWEST, FEWEST_IN_SLICE = 30, 8
"""Vertices of a trunk and of a slice without which they are not measured."""
SPARSE, _FINE = 1000, 8
"""Vertices of a trunk below which its triangles are measured too, at points that divide their edges by so many."""
OUTER = 98.0
"""Percentile of the vertices of a slice taken as its surface, to ignore belt buckles."""
_SOFT = 0.05
"""Metres before and after the surface over which a hand is slowed, where the trunk is wider by as much."""
_CAP, _RECEDES = 0.20, 0.5
"""Metres above and below the trunk over which its surface recedes, and by how many."""
_SHOULDERS, _TRUNK = 0.36, 0.62
"""Distances from shoulder to shoulder and from hips to head of the default character, metres."""
_ROUNDS, _REACH = 12, 0.999
"""Rounds of projections on the limits of wrist, knuckles and arm; share of an arm's length that is used."""


@dataclass(frozen=True)
class Outline:
    """The support function of a trunk: steps [H] heights along it, 0 at the hips and 1 at the neck; reach: [H, 36]
    metres from the line of the bones to the tangents with normals every 10 degrees, from left by ahead."""

    steps: Array
    reach: Array

    def support(self, share: Array, angle: Array) -> Array:
        """[T] metres to the tangent with its normal at angles [T] (0 left, pi / 2 ahead) at heights [T]."""
        row = np.clip(np.interp(share, self.steps, np.arange(len(self.steps))), 0.0, len(self.steps) - 1.0)
        column = np.mod(angle, 2.0 * np.pi) / (2.0 * np.pi) * len(ANGLES)
        low, first = np.floor(row).astype(int), np.floor(column).astype(int)
        high, second = np.minimum(low + 1, len(self.steps) - 1), (first + 1) % len(ANGLES)
        first = first % len(ANGLES)
        up, on = row - low, column - np.floor(column)
        return np.asarray((1.0 - up) * ((1.0 - on) * self.reach[low, first] + on * self.reach[low, second])
                          + up * ((1.0 - on) * self.reach[high, first] + on * self.reach[high, second]))


def ellipse(width: float, depth: float) -> Outline:
    """The outline of a column of constant half width and half depth, metres."""
    return Outline(np.array([0.0, 1.0]), np.tile(np.hypot(width * np.cos(ANGLES), depth * np.sin(ANGLES)), (2, 1)))


def outline_of(body: Body) -> Outline:
    """The trunk of a character: given by the user, else measured on its mesh, else scaled by its skeleton."""
    if body.mapping.torso is not None:
        return ellipse(*body.mapping.torso)
    return _measured(body) or _scaled(body)


def _scaled(body: Body) -> Outline:
    """The default trunk scaled to the skeleton."""
    scale = scale_of(body)
    return ellipse(OURS[0] * scale, OURS[1] * scale)


def scale_of(body: Body) -> float:
    """How large a character without a mesh is taken to be, relative to ours: by the width of the shoulders and the
    length of the trunk."""
    joints, places = body.mapping.joints, body.rest_places
    shoulders = float(np.linalg.norm(places[joints["LeftArm"]] - places[joints["RightArm"]]))
    trunk = float(np.linalg.norm(places[joints["Head"]] - places[joints["Hips"]]))
    return float(np.sqrt(shoulders / _SHOULDERS * trunk / _TRUNK))


def _measured(body: Body) -> Outline | None:
    """The outline of the vertices moved by hips, spine and chest; None if there are too few."""
    points = _flesh(body)
    if len(points) < FEWEST:
        return None
    hips, neck = (places @ body.bind_axes.T * body.unit for places in _bind_ends(body))
    length = float(np.linalg.norm(neck - hips))
    up = (neck - hips) / length
    left = np.array([1.0, 0.0, 0.0]) - up[0] * up
    left = left / np.linalg.norm(left)
    share = (points - hips) @ up / length
    flat = np.stack([(points - hips) @ left, (points - hips) @ np.cross(left, up)])
    out = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1) @ flat  # [36, V]
    ahead = np.maximum(np.sin(ANGLES), 0.0) * (FLEXED * length if _stands(body) else 0.0)
    steps, rows = [], []
    for step in _STEPS:
        near = np.abs(share - step) < 1.0 / 12.0
        if near.sum() >= FEWEST_IN_SLICE:
            steps.append(step)
            rows.append(np.percentile(out[:, near], OUTER, axis=1) + max(-step, 0.0) * ahead)
    return Outline(np.array(steps), np.array(rows)) if rows else None


def _flesh(body: Body) -> Array:
    """[V, 3] metres in the bind pose, in our axes: the vertices that move most with the trunk, with what hangs on it,
    or with thighs that hang down."""
    character, mapping = body.character, body.mapping
    if not len(character.flesh):
        return np.zeros((0, 3))
    trunk = np.zeros(len(character), dtype=bool)
    trunk[[mapping.joints["Hips"], *mapping.spine]] = True
    standing = _stands(body)
    limbs = np.zeros(len(character), dtype=bool)
    limbs[[node for name, node in mapping.joints.items()
           if name != "Hips" and not (standing and name.endswith("UpLeg"))]] = True
    limbs[list(mapping.neck)] = True
    for node, parent in enumerate(character.parents):  # children of the trunk other than limbs move with it
        trunk[node] |= parent >= 0 and trunk[parent] and not limbs[node]
    points = character.flesh[trunk[character.flesh_nodes]]
    if len(points) < SPARSE:  # the corners of a figure of blocks leave its middle out
        points = np.concatenate([points, surface_of(character.skin, trunk)])
    return np.asarray(points @ body.bind_axes.T * body.unit)


def surface_of(skin: Skin, trunk: NDArray[np.bool_]) -> Array:
    """[V, 3] points evenly over the triangles of a skin, where the nodes of the trunk [N] have half of the weight."""
    share = (skin.weights * trunk[skin.joints]).sum(axis=1)
    triangles = skin.triangles[(share[skin.triangles] >= 0.5).any(axis=1)]
    steps = np.array([(a, b, _FINE - a - b) for a in range(_FINE + 1) for b in range(_FINE + 1 - a)]) / _FINE
    moved = share[triangles] @ steps.T >= 0.5 - 1e-9
    return np.asarray(np.einsum("sk,fki->fsi", steps, skin.points[triangles])[moved])


def _stands(body: Body) -> bool:
    """Whether the thighs hang down at rest and in the bind pose."""
    joints = body.mapping.joints
    if not body.mapping.legs or body.sits:
        return False
    bind = body.rest_places if body.character.bind is None else body.character.bind[:, :3, 3] @ body.bind_axes.T
    thighs = [bind[joints[side + "Leg"]] - bind[joints[side + "UpLeg"]] for side in SIDES]
    return all(-thigh[1] > _STANDS * np.linalg.norm(thigh) for thigh in thighs)


def _bind_ends(body: Body) -> tuple[Array, Array]:
    """[3] hips and neck in the bind pose, in the file's units and axes."""
    from gesticulator.characters.shape import bind_matrices

    places = bind_matrices(body.character)[:, :3, 3]
    top = body.mapping.neck[0] if body.mapping.neck else body.mapping.joints["Head"]
    return places[body.mapping.joints["Hips"]], places[top]


@dataclass(frozen=True)
class TrunkAxes:
    """The line from hips to neck over T frames: axes [T, 3, 3], rows left, up and ahead; length [T], metres."""

    axes: Array
    length: Array

    def local(self, points: Array) -> Array:
        """[3, T] metres left, up and ahead of the hips of points [T, 3] relative to the hips."""
        return np.einsum("tij,tj->it", self.axes, points)


def trunk_axes(neck: Array, chest: Array) -> TrunkAxes:
    """neck: [T, 3] relative to the hips; chest: [T, 3, 3] the character's axes there (columns left, up, ahead)."""
    length = np.maximum(np.linalg.norm(neck, axis=-1), 1e-9)
    up = neck / length[:, None]
    left = chest[..., 0] - np.sum(chest[..., 0] * up, axis=-1, keepdims=True) * up
    left = left / np.maximum(np.linalg.norm(left, axis=-1, keepdims=True), 1e-9)
    return TrunkAxes(np.stack([left, up, np.cross(left, up)], axis=-2), length)


def displacement(limits: list[HandLimit], reached: Array, arm: float) -> Array:
    """[T, 3] the displacement that brings a hand at `reached` [T, 3] from the shoulder within all limits and the reach
    of an arm, metres: by projections on them in turn, which move no two hands apart."""
    moved = reached
    for _ in range(_ROUNDS):
        for limit in limits:
            moved = moved + limit.lacking(moved - reached)
        moved = within_reach(moved, reached, arm)
    return moved - reached


def within_reach(moved: Array, reached: Array, arm: float) -> Array:
    """Places [T, 3] from the shoulder, brought within the reach of an arm that was at `reached` [T, 3], metres."""
    longest = np.maximum(np.linalg.norm(reached, axis=-1), _REACH * arm)
    far = np.maximum(np.linalg.norm(moved, axis=-1), 1e-9)
    return np.asarray(moved * np.minimum(longest / far, 1.0)[:, None])


@dataclass(frozen=True)
class HandLimit:
    """Half-spaces over T frames in which a point of the hand belongs: normals [T, 3]; lack: [T] metres by which the
    point is outside, softened; margin: [T] metres that it belongs outside of the trunk."""

    normal: Array
    lack: Array
    margin: Array

    @staticmethod
    def of(our: Array, their: Array, trunk: tuple[TrunkAxes, Outline], size: float) -> HandLimit:
        """our, their: [3, T] left, up, ahead of the hips: the point of the default character's hand, and of the
        character's; trunk: of the character; size: its arm's length relative to ours."""
        column, outline = trunk
        width, depth = OURS
        x, z = our[0] / width ** 2, our[2] / depth ** 2
        norm = np.maximum(np.hypot(x, z), 1e-9)
        x, z = x / norm, z / norm
        slim = np.hypot(width * x, depth * z)
        gap = x * our[0] + z * our[2] - slim
        reach = outline.support(their[1] / column.length, np.arctan2(z, x))
        margin = size * near(gap)
        lack = reach - receding(outline, column, their[1], size) + margin - (x * their[0] + z * their[2])
        soft = np.clip(reach - size * slim, 1e-6, _SOFT * size)
        lack = np.where(lack > soft, lack, np.clip(lack + soft, 0.0, 2.0 * soft) ** 2 / (4.0 * soft))
        return HandLimit(x[:, None] * column.axes[:, 0] + z[:, None] * column.axes[:, 2], lack, margin)

    def lacking(self, push: Array) -> Array:
        """[T, 3] what is to be added to a displacement [T, 3] of the hand."""
        return np.maximum(self.lack - np.sum(push * self.normal, axis=-1), 0.0)[:, None] * self.normal


def receding(outline: Outline, column: TrunkAxes, height: Array, size: float) -> Array:
    """[T] metres by which the surface recedes at heights [T] above or below the trunk, metres along it."""
    low, high = outline.steps[0] * column.length, column.length
    beyond = np.maximum(np.maximum(low - height, height - high), 0.0) / (_CAP * size)
    return np.asarray(size * _RECEDES * beyond ** 2)


def near(gap: Array) -> Array:
    """The smaller of a distance and `MARGIN`, metres, without a kink between them; 0 inside."""
    gap = np.clip(gap, 0.0, 2.0 * MARGIN)
    return np.asarray(gap - gap ** 2 / (4.0 * MARGIN))
