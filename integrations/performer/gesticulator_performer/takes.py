"""Continuous motion of real people, adapted to a speaker who stands and faces the listener.

Takes of many people (conversations, stories, traffic directions, lessons, presentations) lose turning and walking;
leaning and looking about are reduced, hands stay below the shoulders, and idle stretches are cut. `talks` joins the
remaining stretches to talks.
"""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from data_module.errors import InputError
from data_module.motion import kinematics, rotation, skeletons
from data_module.motion.bvh import read_bvh
from data_module.motion.motion_beats import ACTING, acting_speed
from data_module.motion.phases import runs
from data_module.motion.relaxed_hands import with_relaxed_hands
from data_module.motion.skeletons import CHARACTER, FINGERED
from data_module.store import Split
from data_module.types import Array, Motion
from gesticulator_performer import idle
from gesticulator_performer import joints as anatomy
from gesticulator_performer.joints import FPS, MIRROR, facing_positions, torso_depth, with_loose_wrists, with_rhythm
from gesticulator_performer.strokes import arm_joints
from gesticulator_performer.tables import read_clips, table

_CLIPS = table("clips.toml")["takes"]
GROUPS: dict[str, tuple[str, ...]] = {group: tuple(beginnings) for group, beginnings in _CLIPS["groups"].items()}
"""Activity in a take -> prefixes of its file names."""
_HANGING = tuple(_CLIPS["standing"])
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

# Standard deviation, seconds, of the low pass of the hips' yaw, which is subtracted.
_SLOW_YAW = 0.8
# Joints that bend together, the soft limit of their bend in degrees, and gains of lean, yaw and roll: some takes are
# pantomime, with leans of 40 degrees.
_LIMITS = ((HIPS, 7.0, (1.0, 0.75, 0.75)), (SPINE, 16.0, (1.0, 0.85, 0.85)), (SKULL, 30.0, (1.0, 0.75, 0.9)))
# Cm/s of the chest, in the mean of a take, over which the trunk's motion is scaled down: real speakers have 4.5 to 5.
_CHEST_TRAVEL = 5.5
# Share of the shoulder's reduction that is applied to elbow and wrist: scaling a log rotation at the elbow straightens
# the arm, so nearly all of it stays.
_ELBOW_SHARE = 0.15
# The point that the arms are scaled about, from hanging (0) to their mean pose (1).
_CENTRE_SHARE = 0.15
# Percentage of frames in which hands must be under the limit; metres over the limit at which frames are cut out.
_HIGH_PERCENTILE, _TOO_HIGH = 93.0, 0.16
_GAINS = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5)
# Speed of both arms together, m/s, below which they idle; seconds for which they may; seconds left at either end.
_IDLE_SPEED, _IDLE_SECONDS, _IDLE_MARGIN = 0.25, 1.2, 0.5
# Metres over the hips below which a hand hangs; seconds for which both may, and seconds left at either end: people in
# conversation listen half of the time, a speaker does not.
_HANGING_HAND, _HANGING_SECONDS, _HANGING_MARGIN = 0.06, 0.7, 0.25
# Shortest stretch that is used, seconds.
_LEAST_STRETCH = 2.2
# Share of a take's frames in which arms may be wide before its arms are scaled down, and the share of a second of wide
# arms that is cut out.
_WIDE_SHARE, _WIDE_STAY = 0.10, 0.5
# Share of the shoulders' rhythm that is added to a take: Rocketbox has some of it, CMU's clavicles are rigid.
_RHYTHM = (0.7, 1.0)
# Depth inside the torso, metres, beyond which a frame is cut out.
_GRAZE = 0.01


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

    def logs(self, rotations: Array) -> Array:
        """The inverse of `rotations`."""
        return unrolled(rotation.multiply(rotation.conjugate(self.rest)[None], rotations))


@dataclass(frozen=True)
class MotionRange:
    """Range of a speaker's motion. height: metres over the hips that the hands rarely exceed; trunk: factor on the
    trunk's motion."""

    height: float
    trunk: float


def load_takes(source: Path) -> Library:
    return library_of([_read(take, motion()) for take, motion in list_takes(source)])


def list_takes(source: Path) -> list[tuple[RealTake, Callable[[], Motion]]]:
    """The usable takes in `free_motion` and `idle`, without their motion, and what reads it."""
    folder, none = source / "free_motion", np.zeros((0, len(FINGERED), 3))
    listed: list[tuple[RealTake, Callable[[], Motion]]] = []
    for row in read_clips(folder, {"file", "person", "licence"}):
        stem = Path(row["file"]).stem
        group = group_of(stem)
        if group and stem not in _CLIPS["twins"]:
            take = RealTake(stem, row["person"], group, row["licence"], none)
            listed.append((take, partial(on_character, folder / row["file"])))
    if not any(any(part in take.name for part in _HANGING) for take, _ in listed):
        raise InputError(folder / "manifest.csv", "names no take of a standing person",
                         "take the manifest that came with the clips")
    return listed + [(RealTake(name, person, "idling", "MIT", none), partial(idle.stretch, file, seconds))
                     for name, person, file, seconds in idle.stretches_of(source / "idle")]


def group_of(stem: str) -> str:
    """The group of a file by its stem: a key of `GROUPS`, "idling", or "" for a file that is not used."""
    for group, beginnings in GROUPS.items():
        if stem.startswith(beginnings):
            return group
    return "idling" if any(part in stem for part in (*_CLIPS["listening"], *_HANGING)) else ""


def library_of(read: Sequence[tuple[RealTake, Array]]) -> Library:
    """A library of takes with their rotations [T, 46, 4]; the rest pose is the mean of people who stand and wait."""
    standing = [q[::10] for take, q in read if any(part in take.name for part in _HANGING)] or [q for _, q in read]
    rest = _mean_rotation(np.concatenate(standing))
    logs = [unrolled(rotation.multiply(rotation.conjugate(rest)[None], q)) for _, q in read]
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


def on_character(file: Path) -> Motion:
    """A clip (BVH, metres) on the character with fingers, at 60 fps."""
    return kinematics.resample(skeletons.to_character(read_bvh(file, unit=1.0), skeleton=FINGERED), FPS)


def _read(take: RealTake, motion: Motion) -> tuple[RealTake, Array]:
    if anatomy.subject_of(take.name):
        motion = replace(motion, rotations=with_loose_wrists(anatomy.mended(take.name, motion.rotations)))
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
    """Name -> "train", "val" or "test", always the same: of each group the takes with the smallest hashes are held out,
    of ReActIdle the people that its table names. What is made from a take stays in its split, so that no test motion
    is in training."""
    groups: dict[str, list[str]] = defaultdict(list)
    out: dict[str, Split] = {}
    for take in takes:
        if take.person in idle.SPLITS:
            out[take.name] = idle.SPLITS[take.person]
        else:
            groups[take.group].append(take.name)
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


def unrolled(rotations: Array) -> Array:
    """Log rotations [T, ..., 3] of [T, ..., 4] without jumps by 2 pi; fast where there are none."""
    logs = rotation.to_exponential_map(rotations)
    jumps = np.abs(np.diff(logs, axis=0)).max(initial=0.0) > 1.5
    return rotation.unroll(logs) if jumps else logs


def calmed(library: Library, take: RealTake, gain: float, trunk: float) -> Array:
    """Logs [T, 46, 3] of a take with the shoulders' excursion times `gain`, and the trunk's within its limits times
    `trunk`. What an upper arm turns about its length is kept with the elbow's bend: without, forearms open outward."""
    out = take.logs.copy()
    for joints, degrees, axes in _LIMITS:
        bend = soft_limit(take.logs[:, list(joints)].sum(axis=1) * np.array(axes), np.radians(degrees))
        out[:, list(joints)] = (bend / len(joints))[:, None]
    factor = trunk * min(1.0, _CHEST_TRAVEL / max(_chest_travel(library, out), 1e-9))
    out[:, [*HIPS, *SPINE]] *= factor
    centre, kept = _CENTRE_SHARE * library.centre, 1.0 - _ELBOW_SHARE * (1.0 - gain)
    for place, j in enumerate(ARMS):
        name, own = CHARACTER.names[j], take.logs[:, j]
        if name.endswith(("ForeArm", "Hand")):
            out[:, j] = centre[place] + kept * (own - centre[place])
        elif name.endswith("Shoulder"):
            out[:, j] = centre[place] + gain * (own - centre[place])
        else:
            out[:, j] = _scaled_swing(own, centre[place], gain, kept)
    return out


def _scaled_swing(logs: Array, centre: Array, gain: float, kept: float) -> Array:
    """Logs [T, 3] of an upper arm with its swing about that of `centre` times `gain`, and its turn about its length (x)
    about that of `centre` times `kept`."""
    (swing, twist), (swing_at, twist_at) = (_swing_twist(v) for v in (logs, centre[None]))
    swing = swing_at + gain * (swing - swing_at)
    twist = twist_at + kept * (twist - twist_at)
    about = np.stack([twist, 0.0 * twist, 0.0 * twist], axis=-1)
    joined = rotation.multiply(rotation.from_exponential_map(swing), rotation.from_exponential_map(about))
    return unrolled(joined)


def _swing_twist(logs: Array) -> tuple[Array, Array]:
    """Log rotations [T, 3] as a swing [T, 3] and the turn about x before it, [T] radians."""
    whole = rotation.continuous(rotation.from_exponential_map(logs))
    twist = rotation.continuous(rotation.yaw_of(whole, axis=0))
    angle = np.unwrap(2.0 * np.arctan2(twist[:, 1], twist[:, 0]))
    return unrolled(rotation.multiply(whole, rotation.conjugate(twist))), angle


def _chest_travel(library: Library, logs: Array) -> float:
    """Mean speed of the chest over the hips, cm/s."""
    chest = facing_positions(library.rotations(logs))[:, SPINE[-1]]
    return 100.0 * float(np.linalg.norm(np.diff(chest, axis=0), axis=1).mean()) * FPS if len(chest) > 1 else 0.0


def stretches(library: Library, take: RealTake, limits: MotionRange) -> list[Array]:
    """The usable stretches [T, 46, 3] of a take: hands in range and outside the torso, without long idling."""
    for gain in _GAINS:
        rotations = anatomy.narrowed(library.rotations(calmed(library, take, gain, limits.trunk)))
        places, wide = facing_positions(rotations), anatomy.wide(rotations)
        high = places[:, list(WRISTS), 1].max(axis=1)
        if np.percentile(high, _HIGH_PERCENTILE) <= limits.height and wide.mean() <= _WIDE_SHARE:
            break
    bad = (high > limits.height + _TOO_HIGH) | (torso_depth(places) > _GRAZE) | idling(places) | hanging(places)
    bad |= gaussian_filter1d(wide.astype(float), 0.5 * FPS) > _WIDE_STAY
    bad = gaussian_filter1d(bad.astype(float), 0.1 * FPS) > 0.35
    share = _RHYTHM[bool(anatomy.subject_of(take.name))]
    logs = library.logs(with_rhythm(FINGERED if rotations.shape[1] > len(CHARACTER) else CHARACTER, rotations, FPS,
                                    share))
    return [logs[a:b] for a, b in runs(~bad) if b - a >= _LEAST_STRETCH * FPS]


def arms_speed(places: Array) -> Array:
    return acting_speed(places[:, list(_ACTING)], FPS)


def idling(places: Array) -> NDArray[np.bool_]:
    """[T] True in the inner part of stretches in which the arms idle for longer than they may."""
    quiet = gaussian_filter1d(arms_speed(places), 0.33 * FPS) < _IDLE_SPEED
    return _inner(quiet, _IDLE_SECONDS, _IDLE_MARGIN)


def hanging(places: Array) -> NDArray[np.bool_]:
    """[T] True in the inner part of stretches in which both hands hang for longer than they may."""
    return _inner(places[:, list(WRISTS), 1].max(axis=1) < _HANGING_HAND, _HANGING_SECONDS, _HANGING_MARGIN)


def _inner(mask: NDArray[np.bool_], seconds: float, margin: float) -> NDArray[np.bool_]:
    """[T] the runs of a mask [T] that last more than `seconds`, without `margin` seconds at either end."""
    out = np.zeros(len(mask), dtype=bool)
    for first, last in runs(mask):
        if last - first > seconds * FPS:
            out[first + round(margin * FPS):last - round(margin * FPS)] = True
    return out
