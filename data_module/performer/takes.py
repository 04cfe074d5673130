"""Continuous motion of real people, adapted to a speaker who stands and faces the listener.

Takes of many people (conversations, stories, traffic directions, lessons, presentations) lose turning and walking;
leaning and looking about are reduced, hands stay below the shoulders, and idle stretches are cut. `chaining` joins the
remaining stretches to talks.
"""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from data_module.errors import InputError
from data_module.motion import kinematics, rotation, skeletons
from data_module.motion.bvh import read_bvh
from data_module.motion.motion_beats import ACTING, acting_speed
from data_module.motion.relaxed_hands import with_relaxed_hands
from data_module.motion.skeletons import CHARACTER, FINGERED
from data_module.performer.clips import read_clips
from data_module.performer.strokes import arm_joints
from data_module.store import Split
from data_module.types import Array

FPS = 60.0
GROUPS: dict[str, tuple[str, ...]] = {
    "conversation": ("cmu_18_", "cmu_19_"),
    "story": ("cmu_138_",),
    "traffic": ("cmu_13_", "cmu_14_"),
    "lesson": ("cmu_80_",),
    "presenter": ("f_gestic_presentation", "m_gestic_presentation", "m_idle_angry", "m_idle_nervous", "f_invite"),
}
"""Activity in a take -> prefixes of its file names."""
IDLING = ("gestic_listen", "idle_neutral", "idle_breathe", "idle_look_around")
"""Parts of the file names of takes of people who stand and listen or wait."""
_HANGING = ("idle_neutral", "idle_breathe")
_TWINS = frozenset({"f_gestic_listen_sad_01"})
"""Duplicates of other takes."""
TEST_SHARE, VALIDATION_SHARE = 0.2, 0.1
"""Shares of the takes of each group."""

ARMS = tuple(j for j, name in enumerate(CHARACTER.names) if name.startswith(("Left", "Right")))
ARM_SIDES = arm_joints(CHARACTER)
HIPS = (CHARACTER.index("Hips"),)
SPINE = tuple(CHARACTER.index(name) for name in ("Spine", "Spine1", "Spine2", "Spine3"))
SKULL = tuple(CHARACTER.index(name) for name in ("Neck", "Neck1", "Head"))
WRISTS = tuple(CHARACTER.index(name) for name in ("LeftHand", "RightHand"))
_ACTING = tuple(CHARACTER.index(name) for name in ACTING)
_SWAPPED = tuple(FINGERED.index(name.replace("Left", "?").replace("Right", "Left").replace("?", "Right"))
                 for name in FINGERED.names)
MIRROR = np.array([1.0, -1.0, -1.0])
"""A reflection in x = 0 keeps the x of a log rotation and negates y and z."""

_SLOW_YAW = 0.8
"""Standard deviation, seconds, of the low pass of the hips' yaw, which is subtracted."""
_LIMITS = ((HIPS, 6.0, 0.5, (1.0, 0.6, 0.4)), (SPINE, 18.0, 0.7, (1.0, 0.6, 0.6)), (SKULL, 34.0, 0.8, (1.0, 0.6, 0.75)))
"""Joints that bend together, the soft limit of their bend in degrees, its gain, and gains of lean, yaw and roll: some
takes are pantomime, with leans of 40 degrees."""
_ELBOW_SHARE = 0.15
"""Share of the shoulder's reduction that is applied to elbow and wrist: scaling a log rotation at the elbow straightens
the arm, so nearly all of it stays."""
_CENTRE_SHARE = 0.15
"""The point that the arms are scaled about, from hanging (0) to their mean pose (1)."""
_HIGH_PERCENTILE, _TOO_HIGH = 93.0, 0.16
"""Percentage of frames in which hands must be under the limit; metres over the limit at which frames are cut out."""
_GAINS = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5)
_IDLE_SPEED, _IDLE_SECONDS, _IDLE_MARGIN = 0.25, 1.2, 0.5
"""Speed of both arms together, m/s, below which they idle; seconds for which they may; seconds left at either end."""
_LEAST_STRETCH = 2.2
"""Shortest stretch that is used, seconds."""
TORSO_RADIUS, ELBOW_RADIUS = 0.115, 0.13
"""Radius of the capsule from hips to chest that a hand (half the depth of an adult's chest) or an elbow may not enter,
metres."""
_GRAZE = 0.01
"""Depth inside the torso, metres, beyond which a frame is cut out."""


@dataclass(frozen=True)
class RealTake:
    """A real take on the character with fingers at 60 fps.

    name: the file's stem; person: the performer; group: a key of `GROUPS`, or "idling"; licence: of the recording.
    logs: [T, 46, 3] log rotations against the hanging pose of `Library.rest`, without slow yaw; for the trunk less the
    person's mean. filled: joints that were not recorded and have synthetic motion (`with_relaxed_hands`).
    """

    name: str
    person: str
    group: str
    licence: str
    logs: Array
    filled: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.logs)


@dataclass(frozen=True)
class Library:
    """All takes. rest: [46, 4] the pose with hanging arms that the logs are relative to; centre: [8, 3] mean logs of
    the joints of the arms."""

    takes: tuple[RealTake, ...]
    rest: Array
    centre: Array

    def talks(self) -> tuple[RealTake, ...]:
        return tuple(take for take in self.takes if take.group in GROUPS)

    def rotations(self, logs: Array) -> Array:
        turned = rotation.multiply(self.rest[None], rotation.from_exponential_map(logs))
        return rotation.continuous(rotation.normalise(turned))


@dataclass(frozen=True)
class MotionRange:
    """Range of a speaker's motion. height: metres over the hips that the hands rarely exceed; trunk: factor on the
    trunk's motion."""

    height: float
    trunk: float


def load_takes(folder: str | Path) -> Library:
    return library_of([_read(take, file) for take, file in list_takes(folder)])


def list_takes(folder: str | Path) -> list[tuple[RealTake, Path]]:
    """The usable takes of `manifest.csv`, without their motion, and their files."""
    listed: list[tuple[RealTake, Path]] = []
    for _, row in read_clips(folder, {"file", "person", "licence"}):
        stem = Path(row["file"]).stem
        group = group_of(stem)
        if group and stem not in _TWINS:
            take = RealTake(stem, row["person"], group, row["licence"], np.zeros((0, len(FINGERED), 3)))
            listed.append((take, Path(folder) / row["file"]))
    if not any(any(part in take.name for part in _HANGING) for take, _ in listed):
        raise InputError(Path(folder) / "manifest.csv", "names no take of a standing person",
                         "take the manifest that came with the clips")
    return listed


def group_of(stem: str) -> str:
    """The group of a file by its stem: a key of `GROUPS`, "idling", or "" for a file that is not used."""
    for group, beginnings in GROUPS.items():
        if stem.startswith(beginnings):
            return group
    return "idling" if any(part in stem for part in IDLING) else ""


def library_of(read: Sequence[tuple[RealTake, Array]]) -> Library:
    """A library of takes with their rotations [T, 46, 4]; the rest pose is the mean of people who stand and wait."""
    standing = [q[::10] for take, q in read if any(part in take.name for part in _HANGING)] or [q for _, q in read]
    rest = _mean_rotation(np.concatenate(standing))
    logs = [rotation.unroll(rotation.to_exponential_map(rotation.multiply(rotation.conjugate(rest)[None], q)))
            for _, q in read]
    trunk = [j for j in range(len(CHARACTER)) if j not in ARMS]
    means: dict[str, list[Array]] = defaultdict(list)
    for (take, _), rotations in zip(read, logs, strict=True):
        means[take.person].append(rotations[:, trunk].mean(axis=0))
    takes = []
    for (take, _), rotations in zip(read, logs, strict=True):
        rotations[:, trunk] -= np.mean(means[take.person], axis=0)
        takes.append(replace(take, logs=rotations))
    acting = [take.logs[:, list(ARMS)].mean(axis=0) for take in takes if take.group in GROUPS]
    centre = np.mean(acting, axis=0) if acting else np.zeros((len(ARMS), 3))
    return Library(tuple(takes), rest, centre)


def _read(take: RealTake, file: Path) -> tuple[RealTake, Array]:
    motion = kinematics.resample(skeletons.to_character(read_bvh(file, unit=1.0), skeleton=FINGERED), FPS)
    motion = with_relaxed_hands(motion)
    rotations = rotation.continuous(rotation.normalise(motion.rotations))
    yaw = rotation.continuous(rotation.yaw_of(rotations[:, 0])[:, None])[:, 0]
    slow = gaussian_filter1d(np.unwrap(2.0 * np.arctan2(yaw[:, 2], yaw[:, 0])), _SLOW_YAW * FPS, mode="nearest")
    back = np.stack([np.cos(slow / 2), 0.0 * slow, -np.sin(slow / 2), 0.0 * slow], axis=-1)
    rotations[:, 0] = rotation.multiply(back, rotations[:, 0])
    return replace(take, filled=motion.filled), rotations


def _mean_rotation(rotations: Array) -> Array:
    """[J, 4] the mean of [T, J, 4]: the eigenvector of the largest eigenvalue of the sum of outer products."""
    outer = np.einsum("tji,tjk->jik", rotations, rotations)
    return np.linalg.eigh(outer)[1][..., -1]


def split_of_takes(takes: Iterable[RealTake]) -> dict[str, Split]:
    """Name -> "train", "val" or "test": of each group the takes with the smallest hashes are held out, always the same.
    Everything made from a take stays in its split, so that no test motion occurs in training."""
    groups: dict[str, list[str]] = defaultdict(list)
    for take in takes:
        groups[take.group].append(take.name)
    out: dict[str, Split] = {}
    for names in groups.values():
        order = sorted(names, key=lambda name: hashlib.sha256(name.encode()).hexdigest())
        test, val = round(TEST_SHARE * len(order)), round(VALIDATION_SHARE * len(order))
        for rank, name in enumerate(order):
            out[name] = "test" if rank < test else "val" if rank < test + val else "train"
    return out


def mirrored(logs: Array) -> Array:
    return logs[:, list(_SWAPPED[:logs.shape[1]])] * MIRROR


def soft_limit(vectors: Array, limit: float) -> Array:
    """Shorten vectors [..., 3] below `limit`: length l becomes limit tanh(l / limit)."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors * limit * np.tanh(length / limit) / np.maximum(length, 1e-9)


def calmed(library: Library, take: RealTake, gain: float, trunk: float) -> Array:
    """Logs [T, 46, 3] of a take with the shoulders' excursion times `gain`, and the trunk's within its limits."""
    out = take.logs.copy()
    for joints, degrees, part_gain, axes in _LIMITS:
        bend = take.logs[:, list(joints)].sum(axis=1) * part_gain * trunk * np.array(axes)
        out[:, list(joints)] = (soft_limit(bend, np.radians(degrees)) / len(joints))[:, None]
    centre = _CENTRE_SHARE * library.centre
    shares = np.array([1.0 - _ELBOW_SHARE * (1.0 - gain) if CHARACTER.names[j].endswith(("ForeArm", "Hand")) else gain
                       for j in ARMS])
    out[:, list(ARMS)] = centre + shares[:, None] * (take.logs[:, list(ARMS)] - centre)
    return out


def stretches(library: Library, take: RealTake, limits: MotionRange) -> list[Array]:
    """The usable stretches [T, 46, 3] of a take: hands in range and outside the torso, without long idling."""
    for gain in _GAINS:
        logs = calmed(library, take, gain, limits.trunk)
        places = facing_positions(library.rotations(logs))
        high = places[:, list(WRISTS), 1].max(axis=1)
        if np.percentile(high, _HIGH_PERCENTILE) <= limits.height:
            break
    bad = (high > limits.height + _TOO_HIGH) | (torso_depth(places) > _GRAZE) | idling(places)
    bad = gaussian_filter1d(bad.astype(float), 0.1 * FPS) > 0.35
    return [logs[a:b] for a, b in runs(~bad) if b - a >= _LEAST_STRETCH * FPS]


def facing_positions(rotations: Array) -> Array:
    """Joint positions [T, 16, 3] in metres from the hips, in the facing frame, of rotations [T, 16 or more, 4]."""
    faced = rotations[:, :len(CHARACTER)].copy()
    faced[:, 0] = rotation.remove_yaw(faced[:, 0])
    return kinematics.joint_positions(CHARACTER, faced)


def arms_speed(places: Array) -> Array:
    return acting_speed(places[:, list(_ACTING)], FPS)


def idling(places: Array) -> NDArray[np.bool_]:
    """[T] True in the inner part of stretches in which the arms idle for longer than they may."""
    quiet = gaussian_filter1d(arms_speed(places), 0.33 * FPS) < _IDLE_SPEED
    out = np.zeros(len(quiet), dtype=bool)
    margin = round(_IDLE_MARGIN * FPS)
    for first, last in runs(quiet):
        if last - first > _IDLE_SECONDS * FPS:
            out[first + margin:last - margin] = True
    return out


def torso_depth(places: Array) -> Array:
    """[T] depth of the deepest wrist or elbow inside the torso (a capsule from hips to chest), metres, 0 outside."""
    chest = places[:, CHARACTER.index("Spine3")]
    hips = np.zeros_like(chest)
    return np.maximum.reduce([
        capsule_depth(places[:, CHARACTER.index(side + name)], hips, chest, radius)
        for name, radius in (("Hand", TORSO_RADIUS), ("ForeArm", ELBOW_RADIUS)) for side in ("Left", "Right")])


def capsule_depth(point: Array, low: Array, high: Array, radius: float) -> Array:
    """[T] depth in metres of points [T, 3] inside a capsule between two points [T, 3], 0 outside."""
    axis = high - low
    share = np.clip(np.sum((point - low) * axis, axis=-1) / np.sum(axis * axis, axis=-1), 0.0, 1.0)
    return np.maximum(0.0, radius - np.linalg.norm(point - low - share[:, None] * axis, axis=-1))


def runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
