"""The trunk of a character, measured on its mesh, and its hands kept out of it (`contacts.other_bodies`)."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from data_module.motion.skeletons import SIDES
from data_module.types import Array
from gesticulator.characters.shape import bind_matrices
from gesticulator.contacts.limbs import OURS, Pose, bend, trunk_axes
from gesticulator.contacts.other_bodies import ANGLES, Outline, Trunk, displacement, ellipse, spread

if TYPE_CHECKING:
    from gesticulator.characters.frames import Body
    from gesticulator.characters.rig import Skin

_STEPS = np.asarray((np.arange(-6, 12) + 0.5) / 12.0)
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
_SHOULDERS, _TRUNK = 0.36, 0.62
"""Distances from shoulder to shoulder and from hips to head of the default character, metres."""
_ARM_LENGTH = 0.53
"""Length of the default character's upper arm and forearm, metres."""
_LEAST = 1e-5
"""Metres below which a hand is not moved."""


def keep_hands_out(turns: dict[int, Array], body: Body, default: Pose, fps: float) -> None:
    """Bend the arms in `turns` where a hand would be nearer to the character's trunk than on the default character.
    default: its pose; fps: frames per second."""
    joints, chest, origin = body.mapping.joints, default.turns["Spine3"], default.places["Hips"]
    neck = body.place(turns, body.mapping.neck[0] if body.mapping.neck else joints["Head"])
    theirs, outline = trunk_axes(neck, chest), outline_of(body)
    ours = trunk_axes(default.places["Neck"] - origin, chest)
    for side in SIDES:
        chain = (joints[side + "Arm"], joints[side + "ForeArm"], joints[side + "Hand"])
        arm = float(sum(np.linalg.norm(body.place({}, below) - body.place({}, above))
                        for above, below in pairwise(chain)))
        trunk = Trunk(theirs, outline, arm / _ARM_LENGTH)
        limits = [trunk.limit(ours.local(default.places[side + part] - origin), body.place(turns, joints[side + part]))
                  for part in ("Hand", "HandMiddle1") if side + part in joints]
        shoulder, wrist = body.place(turns, chain[0]), body.place(turns, chain[2])
        push = displacement(limits, wrist - shoulder, arm)
        if (np.linalg.norm(push, axis=-1) > _LEAST).any():
            push = spread(push, limits, trunk, (wrist - shoulder, arm), fps)
        moved = np.linalg.norm(push, axis=-1) > _LEAST
        if moved.any():
            bend(turns, body, chain, wrist + push, np.array([0.0, -1.0, -0.5]), moved)


def outline_of(body: Body) -> Outline:
    """The trunk of a character: measured on its mesh, else the default one, scaled by the width of the shoulders and
    the length of the trunk."""
    joints, places = body.mapping.joints, body.rest_places
    shoulders = float(np.linalg.norm(places[joints["LeftArm"]] - places[joints["RightArm"]]))
    trunk = float(np.linalg.norm(places[joints["Head"]] - places[joints["Hips"]]))
    scale = float(np.sqrt(shoulders / _SHOULDERS * trunk / _TRUNK))
    return _measured_trunk(body) or ellipse(OURS[0] * scale, OURS[1] * scale)


def _measured_trunk(body: Body) -> Outline | None:
    """The outline of the vertices that move with the trunk or with hanging thighs; None if there are too few."""
    mapping, standing = body.mapping, _stands(body)
    limbs = {node for name, node in mapping.joints.items()
             if name != "Hips" and not (standing and name.endswith("UpLeg"))}
    moving = body.character.under([mapping.joints["Hips"], *mapping.spine], limbs | set(mapping.neck))
    ends = mapping.joints["Hips"], mapping.neck[0] if mapping.neck else mapping.joints["Head"]
    character = body.character
    points = character.flesh[moving[character.flesh_nodes]]
    if len(points) < SPARSE and len(character.flesh):  # the corners of a figure of blocks leave its middle out
        points = np.concatenate([points, surface_of(character.skin, moving)])
    if len(points) < FEWEST:
        return None
    low, high = (bind_matrices(character)[node, :3, 3] @ body.bind_axes.T * body.unit for node in ends)
    length = float(np.linalg.norm(high - low))
    along = (high - low) / length
    left = np.array([1.0, 0.0, 0.0]) - along[0] * along
    left = left / np.linalg.norm(left)
    places = points @ body.bind_axes.T * body.unit - low
    flat = np.stack([places @ left, places @ np.cross(left, along)])
    out = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1) @ flat  # [36, V]
    inside = np.abs(places @ along / length - _STEPS[:, None]) < 1.0 / 12.0
    full = inside.sum(axis=1) >= FEWEST_IN_SLICE
    if not full.any():
        return None
    steps, reach = _STEPS[full], np.array([np.percentile(out[:, some], OUTER, axis=1) for some in inside[full]])
    ahead = np.maximum(np.sin(ANGLES), 0.0) * (FLEXED * length if standing else 0.0)
    return Outline(steps, reach + np.maximum(-steps, 0.0)[:, None] * ahead)


def surface_of(skin: Skin, trunk: NDArray[np.bool_]) -> Array:
    """[V, 3] points evenly over the triangles of a skin, where the nodes of the trunk [N] have half of the weight."""
    share = (skin.weights * trunk[skin.joints]).sum(axis=1)
    triangles = skin.triangles[(share[skin.triangles] >= 0.5).any(axis=1)]
    steps = np.array([(a, b, _FINE - a - b) for a in range(_FINE + 1) for b in range(_FINE + 1 - a)]) / _FINE
    moved = share[triangles] @ steps.T >= 0.5 - 1e-9
    return np.asarray(np.einsum("sk,fki->fsi", steps, skin.points[triangles])[moved])


def _stands(body: Body) -> bool:
    """True if the thighs hang down in the bind pose."""
    joints = body.mapping.joints
    if not body.mapping.legs:
        return False
    bind = body.rest_places if body.character.bind is None else body.character.bind[:, :3, 3] @ body.bind_axes.T
    thighs = [bind[joints[side + "Leg"]] - bind[joints[side + "UpLeg"]] for side in SIDES]
    return all(-thigh[1] > _STANDS * np.linalg.norm(thigh) for thigh in thighs)
