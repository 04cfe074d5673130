"""Trunk and thighs of a character, measured on its mesh, and its hands kept out of them (`contacts.other_bodies`)."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from data_module.motion.skeletons import SIDES
from data_module.types import Array
from gesticulator.characters.shape import bind_matrices
from gesticulator.contacts.limbs import OURS, Pose, bend, trunk_axes
from gesticulator.contacts.other_bodies import THICK, HandLimit, HandPoint, Obstacle, displacement, near, spread
from gesticulator.contacts.surfaces import (
    ANGLES,
    FINGERTIPS,
    OUR_RADII,
    Outline,
    Thigh,
    ellipse,
    is_level,
    our_thighs,
    tapering,
)

if TYPE_CHECKING:
    from gesticulator.characters.frames import Body
    from gesticulator.characters.rig import Skin

_STEPS = np.asarray((np.arange(-6, 12) + 0.5) / 12.0)
"""Heights of the slices, 0 at the hips and 1 at the neck: pelvis and thighs are below the hips."""
_THIGH_STEPS = np.asarray((np.arange(-1, 9) + 0.5) / 8.0)
"""Slices of a thigh that is measured, 0 at the hip and 1 at the knee."""
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
_SHOULDERS, _TRUNK = 0.36, 0.62
"""Distances from shoulder to shoulder and from hips to head of the default character, metres."""
_ARM_LENGTH = 0.53
"""Length of the default character's upper arm and forearm, metres."""
_LEAST = 1e-5
"""Metres below which a hand is not moved."""


def keep_hands_out(turns: dict[int, Array], body: Body, default: Pose, fps: float) -> None:
    """Bend the arms in `turns` where a hand would be nearer to the character's trunk, and to its thighs where it sits,
    than on the default character. default: its pose; fps: frames per second."""
    joints, bodies = body.mapping.joints, _Bodies(turns, body, default)
    for side in SIDES:
        chain = (joints[side + "Arm"], joints[side + "ForeArm"], joints[side + "Hand"])
        arm = float(sum(np.linalg.norm(body.place({}, below) - body.place({}, above))
                        for above, below in zip(chain, chain[1:], strict=False)))
        limits, points = bodies.limits(side, turns, arm / _ARM_LENGTH)
        shoulder, wrist = body.place(turns, chain[0]), body.place(turns, chain[2])
        push = displacement(limits, wrist - shoulder, arm)
        if (np.linalg.norm(push, axis=-1) > _LEAST).any():
            push = spread(push, points, bodies.obstacle(arm / _ARM_LENGTH), (wrist - shoulder, arm), fps)
        moved = np.linalg.norm(push, axis=-1) > _LEAST
        if moved.any():
            bend(turns, body, chain, wrist + push, np.array([0.0, -1.0, -0.5]), moved)


class _Bodies:
    """Trunk and thighs of a character and of the default character over T frames."""

    def __init__(self, turns: Mapping[int, Array], body: Body, default: Pose) -> None:
        self._body, self._pose = body, default
        joints, chest, self._origin = body.mapping.joints, default.turns["Spine3"], default.places["Hips"]
        neck = body.place(turns, body.mapping.neck[0] if body.mapping.neck else joints["Head"])
        # A trunk that does not move has one place for all frames.
        neck = np.broadcast_to(neck, default.places["Neck"].shape)
        self._outline = outline_of(body)
        self._theirs, self._default = (trunk_axes(neck, chest),
                                       trunk_axes(default.places["Neck"] - self._origin, chest))
        self._thighs, self._our_thighs = seated_thighs(body, turns), tuple[Thigh, ...]()
        if self._thighs:
            ends = [[default.places[side + part] - self._origin for side in SIDES] for part in ("UpLeg", "Leg")]
            # A character that sits in its file may be given the motion of someone who stands.
            self._our_thighs = our_thighs(*ends) if is_level(*ends) else ()

    def obstacle(self, size: float) -> Obstacle:
        """What the hands of an arm that is `size` times as long as ours are kept out of."""
        return Obstacle(self._theirs, self._outline, size, self._thighs)

    def limits(self, side: str, turns: Mapping[int, Array], size: float) -> tuple[list[HandLimit], list[HandPoint]]:
        """Where the points of a hand belong, and the points."""
        limits, points = [], []
        for part in ("Hand", "HandMiddle1", *(FINGERTIPS if self._thighs else ())):
            if (node := self._body.mapping.joints.get(side + part)) is None:
                continue
            place, our = self._body.place(turns, node), self._pose.places[side + part] - self._origin
            margins = np.full(len(place), -np.inf)  # of fingertips, which are kept above the thighs alone
            if part not in FINGERTIPS:
                limits.append(HandLimit.of(self._default.local(our), self._theirs.local(place),
                                           (self._theirs, self._outline), size))
                margins = limits[-1].margin
            # As far above the thighs as ours is, but no farther than `MARGIN`; half a hand where ours does not sit.
            above = [size * np.maximum(near(-thigh.depth(our)[0]), THICK) for thigh in self._our_thighs] or [
                np.full(len(place), size * THICK) for _ in self._thighs]
            for thigh, margin in zip(self._thighs, above, strict=True):
                depth, up = thigh.depth(place)
                limits.append(HandLimit(up, depth + margin, margin))
            points.append(HandPoint(place, margins, above))
        return limits, points


def outline_of(body: Body) -> Outline:
    """The trunk of a character: measured on its mesh, else the default one scaled to its skeleton."""
    scale = scale_of(body)
    return _measured_trunk(body) or ellipse(OURS[0] * scale, OURS[1] * scale)


def scale_of(body: Body) -> float:
    """The size of a character without a mesh relative to the default one: by the width of the shoulders and the length
    of the trunk."""
    joints, places = body.mapping.joints, body.rest_places
    shoulders = float(np.linalg.norm(places[joints["LeftArm"]] - places[joints["RightArm"]]))
    trunk = float(np.linalg.norm(places[joints["Head"]] - places[joints["Hips"]]))
    return float(np.sqrt(shoulders / _SHOULDERS * trunk / _TRUNK))


def _measured_trunk(body: Body) -> Outline | None:
    """The outline of the vertices that move most with hips, spine and chest, with what hangs on them, or with thighs
    that hang down; None if there are too few."""
    mapping, standing = body.mapping, _stands(body)
    limbs = {node for name, node in mapping.joints.items()
             if name != "Hips" and not (standing and name.endswith("UpLeg"))}
    moving = _moving(body, [mapping.joints["Hips"], *mapping.spine], limbs | set(mapping.neck))
    ends = mapping.joints["Hips"], mapping.neck[0] if mapping.neck else mapping.joints["Head"]
    outline, length = _measured(body, moving, ends, np.asarray(_STEPS), 1.0 / 12.0, 1.0)
    if outline is None:
        return None
    ahead = np.maximum(np.sin(ANGLES), 0.0) * (FLEXED * length if standing else 0.0)
    return Outline(outline.steps, outline.reach + np.maximum(-outline.steps, 0.0)[:, None] * ahead)


def _moving(body: Body, tops: Sequence[int], others: Collection[int]) -> NDArray[np.bool_]:
    """[N] the nodes `tops` and those below them that are not `others` or below these."""
    moving = np.zeros(len(body.character), dtype=bool)
    moving[list(tops)] = True
    for node, parent in enumerate(body.character.parents):
        moving[node] |= parent >= 0 and bool(moving[parent]) and node not in others
    return moving


def _measured(body: Body, moving: NDArray[np.bool_], ends: tuple[int, int], steps: Array, half: float, sign: float
              ) -> tuple[Outline | None, float]:
    """The outline of the vertices that move with nodes [N], None if there are too few, and its length in metres.

    ends: the nodes at heights 0 and 1; steps: the middles of the slices; half: how far a slice reaches from its middle;
    sign: 1 if the second direction of a slice, after left, is that of left x along, -1 if it is the opposite.
    """
    character = body.character
    points = character.flesh[moving[character.flesh_nodes]]
    if len(points) < SPARSE and len(character.flesh):  # the corners of a figure of blocks leave its middle out
        points = np.concatenate([points, surface_of(character.skin, moving)])
    low, high = (bind_matrices(character)[node, :3, 3] @ body.bind_axes.T * body.unit for node in ends)
    length = float(np.linalg.norm(high - low))
    if len(points) < FEWEST:
        return None, length
    along = (high - low) / length
    left = np.array([1.0, 0.0, 0.0]) - along[0] * along
    left = left / np.linalg.norm(left)
    places = points @ body.bind_axes.T * body.unit - low
    flat = np.stack([places @ left, places @ (sign * np.cross(left, along))])
    out = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1) @ flat  # [36, V]
    inside = np.abs(places @ along / length - steps[:, None]) < half
    full = inside.sum(axis=1) >= FEWEST_IN_SLICE
    rows = [np.percentile(out[:, some], OUTER, axis=1) for some in inside[full]]
    return Outline(steps[full], np.array(rows)) if rows else None, length


def surface_of(skin: Skin, trunk: NDArray[np.bool_]) -> Array:
    """[V, 3] points evenly over the triangles of a skin, where the nodes of the trunk [N] have half of the weight."""
    share = (skin.weights * trunk[skin.joints]).sum(axis=1)
    triangles = skin.triangles[(share[skin.triangles] >= 0.5).any(axis=1)]
    steps = np.array([(a, b, _FINE - a - b) for a in range(_FINE + 1) for b in range(_FINE + 1 - a)]) / _FINE
    moved = share[triangles] @ steps.T >= 0.5 - 1e-9
    return np.asarray(np.einsum("sk,fki->fsi", steps, skin.points[triangles])[moved])


def _stands(body: Body) -> bool:
    """True if the thighs hang down at rest and in the bind pose."""
    joints = body.mapping.joints
    if not body.mapping.legs or body.sits:
        return False
    bind = body.rest_places if body.character.bind is None else body.character.bind[:, :3, 3] @ body.bind_axes.T
    thighs = [bind[joints[side + "Leg"]] - bind[joints[side + "UpLeg"]] for side in SIDES]
    return all(-thigh[1] > _STANDS * np.linalg.norm(thigh) for thigh in thighs)


def seated_thighs(body: Body, turns: Mapping[int, Array]) -> tuple[Thigh, ...]:
    """The thighs of a character with these turns of its nodes; none where it does not sit."""
    joints = body.mapping.joints
    if not all(side + part in joints for side in SIDES for part in ("UpLeg", "Leg")):
        return ()
    hips, knees = ([body.place(turns, joints[side + part]) for side in SIDES] for part in ("UpLeg", "Leg"))
    if not is_level(hips, knees):
        return ()
    radii = [radius * scale_of(body) for radius in OUR_RADII]
    measured = []
    for side in SIDES:
        ends = joints[side + "UpLeg"], joints[side + "Leg"]
        # Twist bones move with a thigh, other joints do not.
        moving = _moving(body, ends[:1], set(joints.values()))
        measured.append(_measured(body, moving, ends, np.asarray(_THIGH_STEPS), 1.0 / 8.0, -1.0)[0] or tapering(*radii))
    return tuple(map(Thigh, hips, knees, measured))
