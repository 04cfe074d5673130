"""SMPL-X motion files (`.npz`: axis-angle poses, translation, frame rate), read and written.

Only rotations and the path of the pelvis are read; body shape and face are written as zeros. The template of the body
has a separate licence and is not included: the offsets below are those of our character in SMPL-X's joints, in a
T-pose, Y up, facing +Z, the character's left at +X, which is also SMPL-X's rest pose.
"""

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.arrays import as_floats, read_npz
from data_module.errors import InputError
from data_module.motion import kinematics, rotation
from data_module.motion.bvh import FRAME_RATE_ADVICE
from data_module.motion.skeletons import FINGERED, NAME_TABLES
from data_module.types import Motion, Skeleton

# Name, parent, offset in metres: the first 22 of SMPL-X's 55 joints, in its order.
_BODY = [
    ("pelvis", None, (0.0, 0.0, 0.0)),
    ("left_hip", "pelvis", (0.060, -0.090, 0.0)),
    ("right_hip", "pelvis", (-0.060, -0.090, 0.0)),
    ("spine1", "pelvis", (0.0, 0.110, -0.025)),
    ("left_knee", "left_hip", (0.040, -0.380, 0.0)),
    ("right_knee", "right_hip", (-0.040, -0.380, 0.0)),
    ("spine2", "spine1", (0.0, 0.130, -0.005)),
    ("left_ankle", "left_knee", (0.0, -0.400, -0.030)),
    ("right_ankle", "right_knee", (0.0, -0.400, -0.030)),
    ("spine3", "spine2", (0.0, 0.060, 0.020)),
    ("left_foot", "left_ankle", (0.020, -0.060, 0.120)),
    ("right_foot", "right_ankle", (-0.020, -0.060, 0.120)),
    ("neck", "spine3", (0.0, 0.170, -0.020)),
    ("left_collar", "spine3", (0.050, 0.090, -0.010)),
    ("right_collar", "spine3", (-0.050, 0.090, -0.010)),
    ("head", "neck", (0.0, 0.080, 0.020)),
    ("left_shoulder", "left_collar", (0.120, 0.0, 0.0)),
    ("right_shoulder", "right_collar", (-0.120, 0.0, 0.0)),
    ("left_elbow", "left_shoulder", (0.280, 0.0, 0.0)),
    ("right_elbow", "right_shoulder", (-0.280, 0.0, 0.0)),
    ("left_wrist", "left_elbow", (0.250, 0.0, 0.0)),
    ("right_wrist", "right_elbow", (-0.250, 0.0, 0.0)),
]
_TIPS = {"head": (0.0, 0.170, 0.020), "left_wrist": (0.160, 0.0, 0.0), "right_wrist": (-0.160, 0.0, 0.0)}
# Column of the first finger joint in a pose: SMPL-X has a jaw and two eyes before it, SMPL-H does not.
_FINGERS_AT = {55: 25, 52: 22}
_FINGERS = ("index", "middle", "pinky", "ring", "thumb")
JOINTS = 55
# Numbers of parameters of body shape and face in BEAT2.
_BETAS, _EXPRESSIONS = 300, 100
# Metres from the origin of the body, about the breastbone, whose position is `trans`, to the pelvis, our root.
_PELVIS_BELOW_ORIGIN = 0.35

_RATES = ("mocap_frame_rate", "mocap_framerate")
# Largest angle, radians (160 turns); larger ones are not accurate.
_MOST_TURN = 1e3
# Largest distance from the origin, metres; beyond it single precision is coarser than millimetres.
_FARTHEST = 1e6


def _build() -> Skeleton:
    """The body, then both hands in SMPL-X's order, with the character's fingers."""
    rows = [(name, parent, np.array(offset)) for name, parent, offset in _BODY]
    tips = {name: np.array(tip) for name, tip in _TIPS.items() if not name.endswith("wrist")}
    for side in ("left", "right"):
        for finger in _FINGERS:
            for place in (1, 2, 3):
                source = FINGERED.index(f"{side.title()}Hand{finger.title()}{place}")
                name, above = f"{side}_{finger}{place}", f"{side}_{finger}{place - 1}" if place > 1 else f"{side}_wrist"
                rows.append((name, above, FINGERED.offsets[source]))
                if place == 3:
                    tips[name] = FINGERED.end_sites[source]
    names = tuple(name for name, _, _ in rows)
    parents = tuple(-1 if parent is None else names.index(parent) for _, parent, _ in rows)
    return Skeleton(names, parents, np.array([offset for _, _, offset in rows]),
                    {names.index(name): tip for name, tip in tips.items()})


SKELETON: Skeleton = _build()
# SMPL-X's joint -> the character's joints whose world rotation it takes.
_SOURCES: dict[str, tuple[str, ...]] = {
    joint: (source,) for joint in SKELETON.names for source, name in NAME_TABLES["smplx"].items() if name == joint
} | {"spine2": ("Spine1", "Spine2"), "spine3": ("Spine3",)}


def read_smplx(path: str | os.PathLike[str], *, fps: float | None = None) -> Motion:
    """Read `poses` [T, 165] or [T, 66 or more], `trans` [T, 3] and `mocap_frame_rate` of an SMPL-X `.npz`.

    Poses of 165 numbers, or of SMPL-H's 156, include fingers, as rotations against a flat hand; with fewer they are
    absent. fps: the frame rate, if that of the file is missing or wrong. InputError names a missing or invalid file.
    Nothing is unpickled.
    """
    arrays = read_npz(path, ("poses", "trans", *_RATES), "fetch it again")
    for name in ("poses", "trans"):
        if name not in arrays or arrays[name].dtype.kind not in "fiu":
            raise InputError(path, f"has no numbers called {name}", "SMPL-X files have poses and trans")
    poses, trans = arrays["poses"], arrays["trans"]
    frames, joints = len(poses) if poses.ndim else 0, len(_BODY)
    if poses.ndim < 2 or frames == 0 or poses.reshape(frames, -1).shape[1] < joints * 3:
        raise InputError(path, f"has poses of shape {poses.shape}", f"SMPL-X has [T, {JOINTS * 3}]")
    if trans.shape != (frames, 3):
        raise InputError(path, f"has trans of shape {trans.shape} for {frames} poses", "it should be [T, 3]")
    rate = fps if fps is not None else _rate(arrays)
    if rate is None or not 0 < rate < 1000:
        raise InputError(path, "has no usable mocap_frame_rate", FRAME_RATE_ADVICE)
    flat = poses.reshape(frames, -1)
    hands = _FINGERS_AT.get(flat.shape[1] // 3) if flat.shape[1] % 3 == 0 else None
    fingers = 3 * (len(SKELETON) - joints)
    values = as_floats(np.concatenate([flat[:, :3 * joints], flat[:, 3 * hands:3 * hands + fingers] if hands else
                                       np.zeros((frames, fingers))], axis=1))
    root = as_floats(trans)
    if not (np.abs(values).max() <= _MOST_TURN and np.abs(root).max() <= _FARTHEST):  # also NaN
        raise InputError(path, "has poses that are not angles, or a body far away", "export it in radians and metres")
    turns = rotation.continuous(rotation.from_exponential_map(values.reshape(frames, len(SKELETON), 3)))
    return Motion(SKELETON, turns, root - np.array([0.0, _PELVIS_BELOW_ORIGIN, 0.0]), rate,
                  () if hands else SKELETON.names[joints:])


def smplx_arrays(motion: Motion) -> dict[str, NDArray[Any]]:
    """A motion of the character, standing on the floor, as the arrays of an SMPL-X file; the inverse of `read_smplx`.

    They are those of BEAT2 and its leaderboard, float32: poses [T, 165] (axis times angle, radians, in SMPL-X's order:
    22 of the body, jaw, eyes, 15 of each hand), trans [T, 3] metres, betas [300] and expressions [T, 100] (zeros: the
    mean body and a still face), mocap_frame_rate, model and gender. Hands are rotations against a flat hand. World
    rotations are copied: SMPL-X has three joints in the spine for the character's four, and one in the neck for two.
    Joints that the motion lacks stay at rest relative to their parent.
    """
    there = set(motion.skeleton.names) - set(motion.absent)
    sources = {joint: names for joint, names in _SOURCES.items() if set(names) <= there}
    parents = {joint: None if parent < 0 else SKELETON.names[parent]
               for joint, parent in zip(SKELETON.names, SKELETON.parents, strict=True)}
    turns = kinematics.copied_rotations(motion, sources, parents)
    poses = np.zeros((len(motion), JOINTS, 3))
    for joint, turned in turns.items():
        index = SKELETON.index(joint)
        column = index if index < len(_BODY) else index - len(_BODY) + _FINGERS_AT[JOINTS]
        poses[:, column] = rotation.unroll(rotation.to_exponential_map(turned))
    trans = motion.root_positions + np.array([0.0, _PELVIS_BELOW_ORIGIN, 0.0])
    return {
        "betas": np.zeros(_BETAS, np.float32),
        "poses": poses.reshape(len(motion), -1).astype(np.float32),
        "expressions": np.zeros((len(motion), _EXPRESSIONS), np.float32),
        "trans": trans.astype(np.float32),
        "model": np.array("smplx2020"),
        "gender": np.array("neutral"),
        "mocap_frame_rate": np.array(int(motion.fps) if float(motion.fps).is_integer() else motion.fps),
    }


def _rate(arrays: Mapping[str, NDArray[Any]]) -> float | None:
    rate = next((arrays[name] for name in _RATES if name in arrays), None)
    return float(rate.ravel()[0]) if rate is not None and rate.size == 1 and rate.dtype.kind in "fiu" else None
