"""The 16-joint character, the names other sources give its joints, and how any motion is brought onto it.

(16 upper-body joints including the rotational root, RG 4.1.1; names as in the Trinity data set.)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from data_module.errors import InputError
from data_module.motion import kinematics, rotation
from data_module.types import Array, Motion, Skeleton

# Name, parent, offset in metres at rest: a standing adult with level arms (T-pose) and a 25 cm forearm.
_CHARACTER = [
    ("Hips", None, (0.0, 0.0, 0.0)),
    ("Spine", "Hips", (0.0, 0.070, -0.015)),
    ("Spine1", "Spine", (0.0, 0.115, -0.012)),
    ("Spine2", "Spine1", (0.0, 0.115, -0.003)),
    ("Spine3", "Spine2", (0.0, 0.100, 0.005)),
    ("Neck", "Spine3", (0.0, 0.135, 0.005)),
    ("Neck1", "Neck", (0.0, 0.040, 0.008)),
    ("Head", "Neck1", (0.0, 0.040, 0.008)),
    ("RightShoulder", "Spine3", (-0.030, 0.090, 0.020)),
    ("RightArm", "RightShoulder", (-0.150, 0.0, -0.030)),
    ("RightForeArm", "RightArm", (-0.280, 0.0, 0.0)),
    ("RightHand", "RightForeArm", (-0.250, 0.0, 0.0)),
    ("LeftShoulder", "Spine3", (0.030, 0.090, 0.020)),
    ("LeftArm", "LeftShoulder", (0.150, 0.0, -0.030)),
    ("LeftForeArm", "LeftArm", (0.280, 0.0, 0.0)),
    ("LeftHand", "LeftForeArm", (0.250, 0.0, 0.0)),
]
_TIPS = {"Head": (0.0, 0.17, 0.02), "RightHand": (-0.16, 0.0, 0.0), "LeftHand": (0.16, 0.0, 0.0)}


def _build() -> Skeleton:
    names = tuple(row[0] for row in _CHARACTER)
    parents = tuple(-1 if row[1] is None else names.index(row[1]) for row in _CHARACTER)
    return Skeleton(names, parents, np.array([row[2] for row in _CHARACTER]),
                    {names.index(name): np.array(tip) for name, tip in _TIPS.items()})


CHARACTER: Skeleton = _build()
JOINTS = CHARACTER.names
HIP_HEIGHT = 0.95
"""Metres from the floor to the root, used where a picture or a file needs a standing character."""

# One row per source: our joint -> its name there. A joint that a source lacks is left out of its row.
_TRINITY = {name: name for name in JOINTS}
_SIDES = ("Right", "Left")


def _sided(pattern: str, parts: Sequence[str], sides: Sequence[str] = _SIDES) -> dict[str, str]:
    ours = ("Shoulder", "Arm", "ForeArm", "Hand")
    return {side + joint: pattern.format(side=theirs, part=part)
            for side, theirs in zip(_SIDES, sides, strict=True) for joint, part in zip(ours, parts, strict=True)}


NAME_TABLES: dict[str, dict[str, str]] = {
    "trinity": _TRINITY,  # also BEAT, ZeroEGGS and MOCCA
    "smartbody": {ours: name for ours, name in _TRINITY.items() if ours != "Spine3"},
    "mixamo": {"Hips": "Hips", "Spine": "Spine", "Spine1": "Spine1", "Spine2": "Spine2", "Neck": "Neck",
               "Head": "Head", **_sided("{side}{part}", ("Shoulder", "Arm", "ForeArm", "Hand"))},
    "cmu": {"Hips": "Hips", "Spine": "LowerBack", "Spine1": "Spine", "Spine2": "Spine1", "Neck": "Neck",
            "Neck1": "Neck1", "Head": "Head", **_sided("{side}{part}", ("Shoulder", "Arm", "ForeArm", "Hand"))},
    "smplx": {"Hips": "pelvis", "Spine": "spine1", "Spine1": "spine2", "Spine2": "spine3", "Neck": "neck",
              "Head": "head", **_sided("{side}_{part}", ("collar", "shoulder", "elbow", "wrist"), ("right", "left"))},
    "unreal": {"Hips": "pelvis", "Spine": "spine_01", "Spine1": "spine_02", "Spine2": "spine_03", "Neck": "neck_01",
               "Head": "head", **_sided("{part}_{side}", ("clavicle", "upperarm", "lowerarm", "hand"), ("r", "l"))},
    "unity": {"Hips": "Hips", "Spine": "Spine", "Spine1": "Chest", "Spine2": "UpperChest", "Neck": "Neck",
              "Head": "Head", **_sided("{side}{part}", ("Shoulder", "UpperArm", "LowerArm", "Hand"))},
    "vrm": {"Hips": "J_Bip_C_Hips", "Spine": "J_Bip_C_Spine", "Spine1": "J_Bip_C_Chest",
            "Spine2": "J_Bip_C_UpperChest", "Neck": "J_Bip_C_Neck", "Head": "J_Bip_C_Head",
            **_sided("J_Bip_{side}_{part}", ("Shoulder", "UpperArm", "LowerArm", "Hand"), ("R", "L"))},
}
"""What each family of skeletons calls our joints; prefixes up to a colon ("mixamorig:") are ignored."""

REQUIRED = ("Hips", "Spine", "Neck", "Head",
            *(side + part for side in _SIDES for part in ("Arm", "ForeArm", "Hand")))
"""Without these a source is not an upper body; the others may be absent."""


def find_table(names: Sequence[str]) -> Mapping[str, int]:
    """Our joints -> index into `names`, by the table that fits best; InputError when none covers `REQUIRED`."""
    plain = {name.rsplit(":", 1)[-1].lower(): index for index, name in reversed(list(enumerate(names)))}
    best: dict[str, int] = {}
    for table in NAME_TABLES.values():
        found = {ours: plain[theirs.lower()] for ours, theirs in table.items() if theirs.lower() in plain}
        if len(found) > len(best):
            best = found
    lacking = [ours for ours in REQUIRED if ours not in best]
    if lacking:
        unknown = [name for index, name in enumerate(names) if index not in best.values()]
        raise InputError("skeleton", f"has no joint known as {', '.join(lacking)}; its unknown names are "
                         f"{', '.join(unknown) or 'none'}", "rename them or give a joint table")
    return best


def guess_unit(skeleton: Skeleton, table: Mapping[str, int]) -> float:
    """Metres per unit of the skeleton's offsets: 1, 0.01 or 0.001, whichever makes hips to head most like 0.6 m."""
    ancestors, joint = [], table["Head"]
    while joint > 0 and joint != table["Hips"]:
        ancestors.append(joint)
        joint = skeleton.parents[joint]
    length = float(np.linalg.norm(skeleton.offsets[ancestors], axis=1).sum())
    if length <= 0:
        raise InputError("skeleton", "has no length from hips to head", "check its offsets")
    return min((1.0, 0.01, 0.001), key=lambda unit: abs(np.log(length * unit / 0.6)))


def scaled(motion: Motion, unit: float) -> Motion:
    """The motion with all lengths multiplied by `unit` (metres per unit)."""
    skeleton = replace(motion.skeleton, offsets=motion.skeleton.offsets * unit,
                       end_sites={j: tip * unit for j, tip in motion.skeleton.end_sites.items()})
    return replace(motion, skeleton=skeleton, root_positions=motion.root_positions * unit)


_EPS = 1e-9
"""Metres: what is closer is in one place."""
_NEEDED_BONES = (("Hips", "Head"), ("RightArm", "LeftArm"), *((side + bone, side + tip) for side in _SIDES
                 for bone, tip in (("Arm", "ForeArm"), ("ForeArm", "Hand"))))


def _rest_positions(skeleton: Skeleton) -> Array:
    identity = np.zeros((len(skeleton), 4))
    identity[:, 0] = 1.0
    return kinematics.joint_positions(skeleton, identity)


def _axes(rest: Array, table: Mapping[str, int]) -> Array:
    """[4] the rotation that brings a source's axes onto ours (Y up, left +X), from its rest pose."""
    def dominant(v: Array) -> Array:
        out = np.zeros(3)
        out[np.argmax(np.abs(v))] = np.sign(v[np.argmax(np.abs(v))])
        return out

    up = dominant(rest[table["Head"]] - rest[table["Hips"]])
    across = rest[table["LeftArm"]] - rest[table["RightArm"]]
    across = across - (across @ up) * up
    if np.linalg.norm(across) < _EPS:
        raise InputError("skeleton", "has one arm above the other", "check its offsets")
    left = dominant(across)
    matrix = np.stack([left, up, np.cross(left, up)])
    return Rotation.from_matrix(matrix).as_quat(scalar_first=True)


def to_character(motion: Motion, table: Mapping[str, int] | None = None) -> Motion:
    """Any upper body on the 16-joint character, by the copying of world rotations (RG 4.1.1).

    Each bone's world rotation relative to its rest is copied. The arms are also corrected for the rest pose: the
    shortest turn between the source's resting bone and ours is taken off, so an A-pose and a T-pose agree. A joint
    that the source lacks follows its parent and is listed in `absent`. The root keeps its place, in metres.
    """
    source, table = motion.skeleton, table or find_table(motion.skeleton.names)
    rest = _rest_positions(source)
    for bone, tip in _NEEDED_BONES:
        if np.linalg.norm(rest[table[tip]] - rest[table[bone]]) < _EPS:
            raise InputError("skeleton", f"has {bone} and {tip} in one place", "check its offsets")
    ours_rest = _rest_positions(CHARACTER)
    change = _axes(rest, table)
    world = kinematics.global_rotations(source, motion.rotations)
    frames = len(motion)
    out = np.zeros((frames, len(CHARACTER), 4))
    out[..., 0] = 1.0
    corrections: dict[str, Array] = {}
    for side in _SIDES:
        for bone, tip in (("Arm", "ForeArm"), ("ForeArm", "Hand")):
            theirs = rotation.rotate(change, rest[table[side + tip]] - rest[table[side + bone]])
            ours = ours_rest[CHARACTER.index(side + tip)] - ours_rest[CHARACTER.index(side + bone)]
            corrections[side + bone] = rotation.between(ours, theirs)
        corrections[side + "Hand"] = corrections[side + "ForeArm"]
    for joint, name in enumerate(JOINTS):
        if name in table:
            own = rotation.multiply(rotation.multiply(change, world[:, table[name]]), rotation.conjugate(change))
            out[:, joint] = rotation.multiply(own, corrections[name]) if name in corrections else own
        else:
            out[:, joint] = out[:, CHARACTER.parents[joint]]
    local = rotation.normalise(kinematics.local_rotations(CHARACTER, out))
    local = rotation.continuous(local)
    root = rotation.rotate(change, kinematics.positions_of(motion)[:, table["Hips"]])
    absent = tuple(name for name in JOINTS if name not in table or source.names[table[name]] in motion.absent)
    return Motion(CHARACTER, local, root, motion.fps, absent)


def facing(motion: Motion) -> Motion:
    """The motion in its own facing frame: yaw of the root removed, the root at the origin (RG 4.1.1)."""
    rotations = motion.rotations.copy()
    rotations[:, 0] = rotation.remove_yaw(rotations[:, 0])
    return replace(motion, rotations=rotations, root_positions=np.zeros_like(motion.root_positions))


def standing(motion: Motion) -> Motion:
    """The motion lifted (or lowered) so that the root's median height is `HIP_HEIGHT`; doing it twice changes nothing.

    Models work with the root at the origin; a viewer's floor is at zero.
    """
    lift = np.array([0.0, HIP_HEIGHT - float(np.median(motion.root_positions[:, 1])), 0.0])
    return replace(motion, root_positions=motion.root_positions + lift)


def to_vector(motion: Motion) -> Array:
    """The motion as the models see it, [T, J * 3]: exponential maps unrolled over time, yaw and translation removed."""
    faced = facing(motion)
    return rotation.unroll(rotation.to_exponential_map(faced.rotations)).reshape(len(motion), -1)


def from_vector(vectors: Array, fps: float) -> Motion:
    """The inverse of `to_vector` on the 16-joint character (yaw and translation stay zero)."""
    frames = len(vectors)
    rotations = rotation.continuous(rotation.from_exponential_map(vectors.reshape(frames, len(CHARACTER), 3)))
    return Motion(CHARACTER, rotations, np.zeros((frames, 3)), fps)
