"""How far the bones of a character point from ours, and how far feet are from where they should be."""

import numpy as np

from data_module.motion import kinematics, rotation
from data_module.motion.skeletons import FINGER_JOINTS, WHOLE_BODY
from data_module.types import Motion
from gesticulator.characters.rig import CharacterMotion
from tests.rigs import Rig

LIMITS = {"bones": 1.0, "palms": 5.0, "fingers": 5.0, "feet": 1.0, "trunk": 1.0, "slide": 0.005}
"""What is accepted: degrees, and metres by which an ankle may be off the place where ours is, in the scale of her legs.
"""


def places_of(rig: Rig, moved: CharacterMotion) -> np.ndarray:
    """[T, N, 3] metres in our axes, by the file's own transforms."""
    return np.asarray(moved.world_matrices()[..., :3, 3] @ rig.axes.T * rig.unit)


def degrees(a: np.ndarray, b: np.ndarray) -> float:
    """The largest angle between directions [T, 3]."""
    a, b = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (a, b))
    return float(np.degrees(2.0 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2.0, 0.0, 1.0))).max())


def worst(rig: Rig, motion: Motion, moved: CharacterMotion) -> dict[str, float]:
    """Degrees by which bones, palms, fingers, feet and trunk point elsewhere, and metres by which feet move."""
    ours, theirs = kinematics.positions_of(motion), places_of(rig, moved)
    at, names = rig.truth, WHOLE_BODY.names
    world = kinematics.global_rotations(WHOLE_BODY, motion.rotations)

    def bone(name: str, below: str) -> tuple[np.ndarray, np.ndarray]:
        return (ours[:, names.index(below)] - ours[:, names.index(name)], theirs[:, at[below]] - theirs[:, at[name]])

    out = {"bones": 0.0, "palms": 0.0, "fingers": 0.0, "feet": 0.0, "trunk": 0.0, "slide": 0.0}
    for side in ("Left", "Right"):
        for above, below in (("Arm", "ForeArm"), ("ForeArm", "Hand"), ("UpLeg", "Leg"), ("Leg", "Foot")):
            out["bones"] = max(out["bones"], degrees(*bone(side + above, side + below)))
        if side + "HandIndex1" in at:
            out["bones"] = max(out["bones"], degrees(*bone(side + "Hand", side + "HandMiddle1")))
            index, pinky = (bone(side + "Hand", f"{side}Hand{finger}1") for finger in ("Index", "Pinky"))
            out["palms"] = max(out["palms"], degrees(*(np.cross(a, b) for a, b in zip(index, pinky, strict=True))))
            for name in FINGER_JOINTS:
                if name.startswith(side) and not name.endswith("3"):
                    out["fingers"] = max(out["fingers"], degrees(*bone(name, name[:-1] + str(int(name[-1]) + 1))))
        level = np.array([1.0, 0.0, 1.0])
        out["feet"] = max(out["feet"], degrees(*(way * level for way in bone(side + "Foot", side + "ToeBase"))))
        # What is up in the foot's own axes at rest is up in ours: soles are level where ours are.
        turns = moved.world_matrices()[:, at[side + "Foot"], :3, :3]
        own = np.linalg.inv(rig.bound()[at[side + "Foot"], :3, :3]) @ rig.axes[1]
        up = rotation.rotate(world[:, names.index(side + "Foot")], np.array([0.0, 1.0, 0.0]))
        out["feet"] = max(out["feet"], degrees(turns @ own @ rig.axes.T, up))
        length = sum(float(np.linalg.norm(bone(side + a, side + b)[1][0]))
                     for a, b in (("UpLeg", "Leg"), ("Leg", "Foot")))
        here, there = ours[:, names.index(side + "Foot")], theirs[:, at[side + "Foot"]]
        travel = (here - here.mean(axis=0)) * length / 0.825
        out["slide"] = max(out["slide"], float(np.linalg.norm(there - there.mean(axis=0) - travel, axis=-1).max()))
    chest, head = rig.spine[-1], at["Head"]
    for node, name in ((chest, "Spine3"), (head, "Head")):
        rest = rig.bound()[node, :3, :3]
        for axis in np.eye(3):
            own = np.linalg.inv(rest) @ rig.axes.T @ axis
            there = moved.world_matrices()[:, node, :3, :3] @ own @ rig.axes.T
            out["trunk"] = max(out["trunk"], degrees(there, rotation.rotate(world[:, names.index(name)], axis)))
    return out


def inside(rig: Rig, moved: CharacterMotion, torso: tuple[float, float]) -> np.ndarray:
    """[T] how deep the wrists and knuckles are in an elliptic column from hips to neck: 1 at its axis, 0 outside."""
    places, turns = places_of(rig, moved), moved.world_matrices()[:, rig.spine[-1], :3, :3]
    rest = rig.character.world_matrices()[rig.spine[-1], :3, :3]
    left = turns @ np.linalg.inv(rest) @ rig.axes[0] @ rig.axes.T
    hips, neck = places[:, rig.truth["Hips"]], places[:, rig.neck[0]]
    names = [side + part for side in ("Left", "Right") for part in ("Hand", "HandMiddle1")]
    return np.max([depth_in_column(places[:, rig.truth[name]], hips, neck, left, torso) for name in names], axis=0)


def depth_in_column(point: np.ndarray, hips: np.ndarray, neck: np.ndarray, left: np.ndarray,
                    torso: tuple[float, float]) -> np.ndarray:
    """[T] how deep points [T, 3] are in an elliptic column from hips to neck: 1 at its axis, 0 outside."""
    axis = neck - hips
    height = np.linalg.norm(axis, axis=-1, keepdims=True)
    axis = axis / height
    left = left - np.sum(left * axis, axis=-1, keepdims=True) * axis
    left = left / np.linalg.norm(left, axis=-1, keepdims=True)
    own = point - hips
    x, y, z = (np.sum(own * way, axis=-1) for way in (left, axis, np.cross(left, axis)))
    within = (y > 0) & (y < height[:, 0])
    return np.where(within, np.maximum(1.0 - np.hypot(x / torso[0], z / torso[1]), 0.0), 0.0)
