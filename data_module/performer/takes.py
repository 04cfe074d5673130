"""Continuous motion of real people, made fit for a speaker who stands and faces her listener.

Takes of many people and purposes (conversations, told stories, traffic directions, lessons, presentations) lose their
turning and walking, lean and look about less, keep their hands below the shoulders, and lose stretches in which nothing
happens. What is left are stretches that `chaining` joins to talks.
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
"""What somebody does in a take -> how the names of its files begin."""
IDLING = ("gestic_listen", "idle_neutral", "idle_breathe", "idle_look_around")
"""Parts of the names of takes in which somebody stands and listens or waits."""
_HANGING = ("idle_neutral", "idle_breathe")
_TWINS = frozenset({"f_gestic_listen_sad_01"})
"""Takes that show what another one shows already."""
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
_MIRROR = np.array([1.0, -1.0, -1.0])
"""A reflection in x = 0 keeps the x of an axis times angle and turns y and z round."""

_SLOW_YAW = 0.8
"""Seconds: standard deviation of the low pass whose turning is taken off the hips."""
_LIMITS = ((HIPS, 6.0, 0.5, (1.0, 0.6, 0.4)), (SPINE, 18.0, 0.7, (1.0, 0.6, 0.6)), (SKULL, 34.0, 0.8, (1.0, 0.6, 0.75)))
"""Joints that bend together, the degrees that their bend tends to, its gain, and gains of lean, yaw and roll: some
takes are pantomime, with leans of 40 degrees."""
_ELBOW_SHARE = 0.15
"""Of what the shoulder's gain takes off, the share that the elbow and the wrist lose: a log rotation scaled at the
elbow straightens the arm, so they keep nearly all of theirs."""
_CENTRE_SHARE = 0.15
"""The point that the arms are scaled about, from hanging (0) to their mean pose (1)."""
_HIGH_PERCENTILE, _TOO_HIGH = 93.0, 0.16
"""Hands stay under a limit in this share of the frames; frames this many metres over the limit are cut out."""
_GAINS = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5)
_IDLE_SPEED, _IDLE_SECONDS, _IDLE_KEPT = 0.25, 1.2, 0.5
"""m/s of both arms together below which nothing happens; how long that may last; seconds kept at either end of it."""
_LEAST_STRETCH = 2.2
"""Seconds: shorter stretches are not used."""
TORSO_RADIUS, ELBOW_RADIUS = 0.115, 0.13
"""Metres from the line from hips to chest within which a hand, or an elbow, is inside the torso."""
_GRAZE = 0.01
"""Metres deeper than which a frame is cut out."""


@dataclass(frozen=True)
class RealTake:
    """A real take on the character with fingers at 60 fps.

    name: the file's stem; person: who moved; group: a key of `GROUPS`, or "idling"; licence: of the recording.
    logs: [T, 46, 3] log rotations against the hanging pose of `Library.rest`, without slow yaw; for the trunk less the
    person's mean. filled: joints that were not recorded, whose motion is made up (`with_relaxed_hands`).
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
    """All takes.

    rest: [46, 4] the pose with hanging arms that the logs are against; centre: [8, 3] mean logs of the arms' joints.
    """

    takes: tuple[RealTake, ...]
    rest: Array
    centre: Array

    def talks(self) -> tuple[RealTake, ...]:
        """The takes in which somebody gestures."""
        return tuple(take for take in self.takes if take.group in GROUPS)

    def rotations(self, logs: Array) -> Array:
        """Local rotations [T, 46, 4] of logs [T, 46, 3]."""
        turned = rotation.multiply(self.rest[None], rotation.from_exponential_map(logs))
        return rotation.continuous(rotation.normalise(turned))


@dataclass(frozen=True)
class MotionRange:
    """How large a speaker moves: hands under `height` (metres over the hips) nearly always; trunk times `trunk`."""

    height: float
    trunk: float


def load_takes(folder: str | Path) -> Library:
    """Read `manifest.csv` and the takes beside it that somebody gestures or idles in; `InputError` without them."""
    return library_of([_read(take, file) for take, file in list_takes(folder)])


def list_takes(folder: str | Path) -> list[tuple[RealTake, Path]]:
    """The takes that `manifest.csv` names and that are used, without their motion, and their files."""
    listed: list[tuple[RealTake, Path]] = []
    for _, row in read_clips(folder, {"file", "person", "licence"}):
        stem = Path(row["file"]).stem
        group = group_of(stem)
        if group and stem not in _TWINS:
            take = RealTake(stem, row["person"], group, row["licence"], np.zeros((0, len(FINGERED), 3)))
            listed.append((take, Path(folder) / row["file"]))
    if not any(any(part in take.name for part in _HANGING) for take, _ in listed):
        raise InputError(Path(folder) / "manifest.csv", "names no take of somebody standing",
                         "take the manifest that came with the clips")
    return listed


def group_of(stem: str) -> str:
    """The group of a file by its stem: a key of `GROUPS`, "idling", or "" for what is not used."""
    for group, beginnings in GROUPS.items():
        if stem.startswith(beginnings):
            return group
    return "idling" if any(part in stem for part in IDLING) else ""


def library_of(read: Sequence[tuple[RealTake, Array]]) -> Library:
    """A library of takes with their rotations [T, 46, 4]; hanging is the mean pose of those that stand and wait."""
    standing = [q[::10] for take, q in read if any(part in take.name for part in _HANGING)] or [q for _, q in read]
    rest = _mean_rotation(np.concatenate(standing))
    logs = [rotation.unroll(rotation.to_exponential_map(rotation.multiply(rotation.conjugate(rest)[None], q)))
            for _, q in read]
    trunk = [j for j in range(len(CHARACTER)) if j not in ARMS]
    means: dict[str, list[Array]] = defaultdict(list)
    for (take, _), own in zip(read, logs, strict=True):
        means[take.person].append(own[:, trunk].mean(axis=0))
    takes = []
    for (take, _), own in zip(read, logs, strict=True):
        own[:, trunk] -= np.mean(means[take.person], axis=0)
        takes.append(replace(take, logs=own))
    acting = [take.logs[:, list(ARMS)].mean(axis=0) for take in takes if take.group in GROUPS]
    centre = np.mean(acting, axis=0) if acting else np.zeros((len(ARMS), 3))
    return Library(tuple(takes), rest, centre)


def _read(take: RealTake, file: Path) -> tuple[RealTake, Array]:
    """The take, and [T, 46, 4] of its file at 60 fps, without the slow part of the hips' yaw."""
    motion = kinematics.resample(skeletons.to_character(read_bvh(file, unit=1.0), skeleton=FINGERED), FPS)
    motion = with_relaxed_hands(motion)
    rotations = rotation.continuous(rotation.normalise(motion.rotations))
    yaw = rotation.continuous(rotation.yaw_of(rotations[:, 0])[:, None])[:, 0]
    slow = gaussian_filter1d(np.unwrap(2.0 * np.arctan2(yaw[:, 2], yaw[:, 0])), _SLOW_YAW * FPS, mode="nearest")
    back = np.stack([np.cos(slow / 2), 0.0 * slow, -np.sin(slow / 2), 0.0 * slow], axis=-1)
    rotations[:, 0] = rotation.multiply(back, rotations[:, 0])
    return replace(take, filled=motion.filled), rotations


def _mean_rotation(rotations: Array) -> Array:
    """[J, 4] of [T, J, 4]: the eigenvector of the largest eigenvalue of the sum of outer products."""
    outer = np.einsum("tji,tjk->jik", rotations, rotations)
    return np.linalg.eigh(outer)[1][..., -1]


def split_of_takes(takes: Iterable[RealTake]) -> dict[str, Split]:
    """Name -> "train", "val" or "test": of each group the takes with the smallest hashes are kept, the same every time.

    Whatever is made of a take stays on its side, so that no motion of the test split was ever trained on.
    """
    groups: dict[str, list[str]] = defaultdict(list)
    for take in takes:
        groups[take.group].append(take.name)
    out: dict[str, Split] = {}
    for names in groups.values():
        order = sorted(names, key=lambda name: hashlib.sha256(name.encode()).hexdigest())
        test, held = round(TEST_SHARE * len(order)), round(VALIDATION_SHARE * len(order))
        for rank, name in enumerate(order):
            out[name] = "test" if rank < test else "val" if rank < test + held else "train"
    return out


def mirrored(logs: Array) -> Array:
    """Logs [T, J, 3] as seen in a mirror: left and right change places."""
    return logs[:, list(_SWAPPED[:logs.shape[1]])] * _MIRROR


def soft_limit(vectors: Array, limit: float) -> Array:
    """Vectors [..., 3] shortened so that none is longer than `limit`: length l becomes limit tanh(l / limit)."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors * limit * np.tanh(length / limit) / np.maximum(length, 1e-9)


def calmed(library: Library, take: RealTake, gain: float, trunk: float) -> Array:
    """Logs [T, 46, 3] of a take with the shoulders' excursion times `gain`, and the trunk's within its limits."""
    out = take.logs.copy()
    for joints, degrees, own, axes in _LIMITS:
        bend = take.logs[:, list(joints)].sum(axis=1) * own * trunk * np.array(axes)
        out[:, list(joints)] = (soft_limit(bend, np.radians(degrees)) / len(joints))[:, None]
    centre = _CENTRE_SHARE * library.centre
    shares = np.array([1.0 - _ELBOW_SHARE * (1.0 - gain) if CHARACTER.names[j].endswith(("ForeArm", "Hand")) else gain
                       for j in ARMS])
    out[:, list(ARMS)] = centre + shares[:, None] * (take.logs[:, list(ARMS)] - centre)
    return out


def stretches(library: Library, take: RealTake, limits: MotionRange) -> list[Array]:
    """The usable stretches [T, 46, 3] of a take: hands in range and outside the torso, no long idling in them."""
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
    """[T, 16, 3] metres from the hips, in the frame of their facing, of rotations [T, 16 or more, 4]."""
    faced = rotations[:, :len(CHARACTER)].copy()
    faced[:, 0] = rotation.remove_yaw(faced[:, 0])
    return kinematics.joint_positions(CHARACTER, faced)


def arms_speed(places: Array) -> Array:
    """[T] m/s: the summed speed of wrists and elbows of positions [T, 16, 3], as motion beats are found in."""
    return acting_speed(places[:, list(_ACTING)], FPS)


def idling(places: Array) -> NDArray[np.bool_]:
    """[T] the inner part of stretches in which the arms hardly move for longer than they may."""
    quiet = gaussian_filter1d(arms_speed(places), 0.33 * FPS) < _IDLE_SPEED
    out = np.zeros(len(quiet), dtype=bool)
    kept = round(_IDLE_KEPT * FPS)
    for first, last in runs(quiet):
        if last - first > _IDLE_SECONDS * FPS:
            out[first + kept:last - kept] = True
    return out


def torso_depth(places: Array) -> Array:
    """[T] metres that the deepest wrist or elbow lies within the torso (a capsule from hips to chest), 0 outside."""
    chest, depth = places[:, CHARACTER.index("Spine3")], np.zeros(len(places))
    for name, radius in (("Hand", TORSO_RADIUS), ("ForeArm", ELBOW_RADIUS)):
        for side in ("Left", "Right"):
            point = places[:, CHARACTER.index(side + name)]
            share = np.clip(np.sum(point * chest, axis=-1) / np.sum(chest * chest, axis=-1), 0.0, 1.0)
            depth = np.maximum(depth, radius - np.linalg.norm(point - share[:, None] * chest, axis=-1))
    return depth


def runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """[(first, last + 1)] of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
