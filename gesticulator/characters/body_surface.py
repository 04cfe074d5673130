"""Trunk and thighs of a character, measured on its mesh, and its hands kept out of them (`contacts.other_bodies`)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from data_module.motion.skeletons import SIDES
from data_module.types import Array
from gesticulator.characters.shape import bind_matrices
from gesticulator.contacts.limbs import OURS, Pose, bend
from gesticulator.contacts.other_bodies import (
    HandLimit,
    HandPoint,
    Obstacle,
    displacement,
    spread,
    thigh_limits,
    thigh_margins,
)
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
    trunk_axes,
)

if TYPE_CHECKING:
    from gesticulator.characters.frames import Body
    from gesticulator.characters.rig import Skin

_STEPS = (np.arange(-6, 12) + 0.5) / 12.0
"""Heights of the slices, 0 at the hips and 1 at the neck: pelvis and thighs are below the hips."""
_THIGH_STEPS = (np.arange(-1, 9) + 0.5) / 8.0
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
            above = thigh_margins(self._thighs, self._our_thighs, our, size)
            limits.extend(thigh_limits(self._thighs, place, above))
            points.append(HandPoint(place, margins, above))
        return limits, points


def outline_of(body: Body) -> Outline:
    """The trunk of a character: given by the user, else measured on its mesh, else scaled by its skeleton."""
    if body.mapping.torso is not None:
        return ellipse(*body.mapping.torso)
    return _measured_trunk(body) or _scaled(body)


def _scaled(body: Body) -> Outline:
    """The default trunk scaled to the skeleton."""
    scale = scale_of(body)
    return ellipse(OURS[0] * scale, OURS[1] * scale)


def scale_of(body: Body) -> float:
    """The size of a character without a mesh relative to the default one: by the width of the shoulders and the length
    of the trunk."""
    joints, places = body.mapping.joints, body.rest_places
    shoulders = float(np.linalg.norm(places[joints["LeftArm"]] - places[joints["RightArm"]]))
    trunk = float(np.linalg.norm(places[joints["Head"]] - places[joints["Hips"]]))
    return float(np.sqrt(shoulders / _SHOULDERS * trunk / _TRUNK))


def _measured_trunk(body: Body) -> Outline | None:
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
    outline = _sliced(share, flat, np.asarray(_STEPS), 1.0 / 12.0)
    if outline is None:
        return None
    ahead = np.maximum(np.sin(ANGLES), 0.0) * (FLEXED * length if _stands(body) else 0.0)
    return Outline(outline.steps, outline.reach + np.maximum(-outline.steps, 0.0)[:, None] * ahead)


def _sliced(share: Array, flat: Array, steps: Array, half: float) -> Outline | None:
    """The outline of vertices at heights [V] and places [2, V] across; None if no slice has enough of them. steps: the
    middles of the slices; half: how far a slice reaches from its middle."""
    out = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1) @ flat  # [36, V]
    near = np.abs(share - steps[:, None]) < half
    full = near.sum(axis=1) >= FEWEST_IN_SLICE
    rows = [np.percentile(out[:, inside], OUTER, axis=1) for inside in near[full]]
    return Outline(steps[full], np.array(rows)) if rows else None


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
    """True if the thighs hang down at rest and in the bind pose."""
    joints = body.mapping.joints
    if not body.mapping.legs or body.sits:
        return False
    bind = body.rest_places if body.character.bind is None else body.character.bind[:, :3, 3] @ body.bind_axes.T
    thighs = [bind[joints[side + "Leg"]] - bind[joints[side + "UpLeg"]] for side in SIDES]
    return all(-thigh[1] > _STANDS * np.linalg.norm(thigh) for thigh in thighs)


def _bind_ends(body: Body) -> tuple[Array, Array]:
    """[3] hips and neck in the bind pose, in the file's units and axes."""
    places = bind_matrices(body.character)[:, :3, 3]
    top = body.mapping.neck[0] if body.mapping.neck else body.mapping.joints["Head"]
    return places[body.mapping.joints["Hips"]], places[top]


def seated_thighs(body: Body, turns: Mapping[int, Array]) -> tuple[Thigh, ...]:
    """The thighs of a character with these turns of its nodes; none where it does not sit."""
    joints = body.mapping.joints
    if not all(side + part in joints for side in SIDES for part in ("UpLeg", "Leg")):
        return ()
    hips, knees = ([body.place(turns, joints[side + part]) for side in SIDES] for part in ("UpLeg", "Leg"))
    if not is_level(hips, knees):
        return ()
    radii = [radius * scale_of(body) for radius in OUR_RADII]
    return tuple(Thigh(hip, knee, _measured_thigh(body, side) or tapering(*radii))
                 for side, hip, knee in zip(SIDES, hips, knees, strict=True))


def _measured_thigh(body: Body, side: str) -> Outline | None:
    """The outline of the vertices moved by a thigh; None if there are too few."""
    character, joints = body.character, body.mapping.joints
    thigh = np.zeros(len(character), dtype=bool)
    thigh[joints[side + "UpLeg"]] = True
    mapped = set(joints.values())
    for node, parent in enumerate(character.parents):  # twist bones move with it
        thigh[node] |= parent >= 0 and bool(thigh[parent]) and node not in mapped
    points = character.flesh[thigh[character.flesh_nodes]] if len(character.flesh) else np.zeros((0, 3))
    if len(points) < SPARSE and len(character.flesh):
        points = np.concatenate([points, surface_of(character.skin, thigh)])
    if len(points) < FEWEST:
        return None
    hip, knee = (bind_matrices(character)[joints[side + part], :3, 3] @ body.bind_axes.T * body.unit
                 for part in ("UpLeg", "Leg"))
    length = float(np.linalg.norm(knee - hip))
    along = (knee - hip) / length
    left = np.array([1.0, 0.0, 0.0]) - along[0] * along
    left = left / np.linalg.norm(left)
    places = points @ body.bind_axes.T * body.unit - hip
    flat = np.stack([places @ left, places @ np.cross(along, left)])
    return _sliced(places @ along / length, flat, np.asarray(_THIGH_STEPS), 1.0 / 8.0)
