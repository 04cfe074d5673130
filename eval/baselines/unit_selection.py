"""Unit selection: pieces of the training motion, chosen by ear and joined. The baseline that a model has to beat.

Every block of the training split is a unit: its motion in normalised time, how long it lasted, whether it was silent,
and its contour of loudness. For a new recording, cut at its own beats, the sequence of units is found by dynamic
programming (Hunt and Black 1996): each block pays for a unit that sounds unlike it (target cost), and each pair of
neighbours for a jump in pose and speed (join cost), which is nothing where the second followed the first in the
training data. At a join the new piece starts from the pose that the old one ended in, and the difference fades out.

It has real poses, real strokes and real trunks by construction, and no idea of anything but loudness, so whatever a
model is praised for must be more than this. What it is worse at: joins, and timing inside a long phrase.

The same seed, store and recording give the same motion. Memory: 20 MB for an hour of training data, and a table of
`CANDIDATES` squared while it searches.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data_module.blocks import BlockSettings, cut, denormalise, normalise_motion
from data_module.errors import InputError
from data_module.files import write_bytes
from data_module.motion import rotation
from data_module.motion.skeletons import CHARACTER, from_vector
from data_module.speech.audio import SAMPLE_RATE, resample
from data_module.speech.silence import FRAME, frame_levels
from data_module.store import Store
from data_module.types import Array, Blocks, Motion, Speech

NAME = "unit selection"
"""Of its row in a table."""
CANDIDATES = 250
"""Units that are tried for each block; the followers of as many of the block before are tried as well."""
NOISE = 0.25
"""Scale of the Gumbel noise on target costs, so that another seed gives another manner."""
SILENCE, TEMPO, LOUDNESS = 3.0, 1.0 / 0.3, 0.12
"""Target costs: of a silent unit for a spoken block or the reverse; of each unit of log duration; of each dB between
the contours (root mean square)."""
JOIN, POSE, SPEED = 1.2, 4.0, 10.0
"""Join costs: of any jump; of each radian between the poses (root mean square, arms counted three times); of each
radian per frame between their speeds."""
ARMS = 3.0
FADE = 18
"""Frames of normalised time (0.05 s) over which the difference at a join fades out."""
SMOOTHING = 0.02
"""Seconds: the Gaussian of the result."""
_PARTS = 4
"""Pieces of a block whose loudness is told apart; the means of the blocks before and after stand beside them."""
_QUIETEST = -40.0
"""dB under the recording's loud speech: what is fainter is silence."""

Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Sounds:
    """The sound of blocks: silent [N]; durations [N] s; contour [N, 6] dB under the recording's loud speech."""

    silent: NDArray[np.bool_]
    durations: Array
    contour: Array

    @classmethod
    def of(cls, speech: Speech, blocks: Blocks) -> Sounds:
        """Of a recording cut into blocks."""
        resampled = resample(speech, SAMPLE_RATE)
        levels = frame_levels(resampled.samples, resampled.sample_rate)
        # Relative to the recording's loud speech, so that the gain of a microphone does not choose the units.
        levels = np.maximum(levels - np.percentile(levels, 90), _QUIETEST)
        edges = np.concatenate([np.interp(np.arange(len(blocks) * _PARTS) / _PARTS, np.arange(len(blocks) + 1),
                                          blocks.edges), blocks.edges[-1:]])
        # Means of stretches by cumulative sums: blocks are many and short.
        first = np.clip(np.round(edges / FRAME).astype(int), 0, len(levels) - 1)
        sums = np.concatenate([[0.0], np.cumsum(levels)])
        last = np.maximum(first[1:], first[:-1] + 1)
        parts = ((sums[last] - sums[first[:-1]]) / (last - first[:-1])).reshape(len(blocks), _PARTS)
        means = np.concatenate([parts[:1].mean(axis=1), parts.mean(axis=1), parts[-1:].mean(axis=1)])
        return cls(blocks.silent, blocks.durations, np.column_stack([means[:-2], parts, means[2:]]))

    def rolled(self, by: int) -> Sounds:
        """Every block with what was heard `by` blocks before; the grid stays."""
        return Sounds(np.roll(self.silent, by), self.durations, np.roll(self.contour, by, axis=0))


@dataclass(frozen=True)
class UnitDatabase:
    """Units of a training split. poses: [N, K, 48] float32 exponential maps; sounds: of each; follower: [N] the unit
    that came next in its recording, -1 at the end; settings: how recordings were cut."""

    poses: NDArray[np.float32]
    sounds: Sounds
    follower: Indices
    settings: BlockSettings

    def __len__(self) -> int:
        return len(self.poses)

    @classmethod
    def of(cls, store: Store, settings: BlockSettings | None = None, work: Path | None = None) -> UnitDatabase:
        """The units of a store's training split, cached in `work` if given. InputError for a store without one."""
        chosen = settings or BlockSettings()
        if not store.of_split("train"):
            raise InputError(store.path, "has no training split", "build the store again")
        key = hashlib.sha256(json.dumps([store.fingerprint, asdict(chosen), _PARTS]).encode()).hexdigest()[:16]
        cache = None if work is None else work / f"units.{key}.npz"
        if cache is not None and cache.is_file():
            with np.load(cache, allow_pickle=False) as held:
                sounds = Sounds(held["silent"], held["durations"], held["contour"])
                return cls(held["poses"], sounds, held["follower"], chosen)
        database = cls._gathered(store, chosen)
        if cache is not None:
            cache.parent.mkdir(parents=True, exist_ok=True)
            packed = io.BytesIO()
            np.savez(packed, poses=database.poses, follower=database.follower, **asdict(database.sounds))
            # Written whole or not at all, so what is there can be read.
            write_bytes(cache, packed.getvalue())
        return database

    @classmethod
    def _gathered(cls, store: Store, settings: BlockSettings) -> UnitDatabase:
        poses, sounds, follower, count = [], [], [], 0
        for info in store.of_split("train"):
            recording = store.load(info.name)
            blocks = cut(recording.speech, settings)
            # In normalised time, so that a unit fits a block of any length.
            vectors = normalise_motion(recording.motion, blocks)
            # Every turn the short way round, so that units of two recordings compare.
            turns = rotation.from_exponential_map(vectors.reshape(*vectors.shape[:2], len(CHARACTER), 3))
            poses.append(rotation.to_exponential_map(turns).reshape(vectors.shape).astype(np.float32))
            sounds.append(Sounds.of(recording.speech, blocks))
            follower.append(np.append(np.arange(1, len(blocks)) + count, -1))
            count += len(blocks)
        every = Sounds(*(np.concatenate([getattr(sound, name) for sound in sounds])
                         for name in ("silent", "durations", "contour")))
        return cls(np.concatenate(poses), every, np.concatenate(follower).astype(np.int64), settings)


@dataclass(frozen=True)
class UnitPerformance:
    """motion: of the 16-joint character; blocks: of the recording; units: [N] which unit each block plays."""

    motion: Motion
    blocks: Blocks
    units: Indices


class UnitSelection:
    """Speech to motion by units; `database` is what it knows."""

    def __init__(self, database: UnitDatabase) -> None:
        self.database = database
        weight = np.ones(3 * len(CHARACTER), np.float32)
        arms = [name.startswith(("Left", "Right")) for name in CHARACTER.names]
        # A jump of an arm is seen at once, one of the spine hardly.
        weight[np.repeat(arms, 3)] = ARMS
        poses = database.poses
        self._weight = weight
        first_step, last_step = poses[:, 1] - poses[:, 0], poses[:, -1] - poses[:, -2]
        # What a unit expects to come from, and what it leaves behind: pose, and pose per frame.
        self._from = np.concatenate([POSE * (poses[:, 0] - first_step) * weight, SPEED * first_step * weight], axis=1)
        self._leaves = np.concatenate([POSE * poses[:, -1] * weight, SPEED * last_step * weight], axis=1)

    def __call__(self, speech: Speech, *, seed: int = 0, fps: float = 60.0, rolled: int = 0) -> UnitPerformance:
        """Motion for a recording. rolled: blocks by which what is heard comes late, on the same grid: the control of
        timing. The same arguments give the same motion."""
        # Cut as the units were: a block of other settings would be compared with none of its kind.
        blocks = cut(resample(speech, SAMPLE_RATE), self.database.settings)
        units = self.select(Sounds.of(speech, blocks).rolled(rolled), seed)
        jumps = self.database.follower[units[:-1]] != units[1:]
        vectors = joined(self.database.poses[units], jumps)
        frames = denormalise(vectors, vectors[0, 0], blocks, fps, SMOOTHING)
        return UnitPerformance(from_vector(frames, fps), blocks, units)

    def select(self, sounds: Sounds, seed: int = 0) -> Indices:
        """[N] the units of the cheapest sequence."""
        # Viterbi over the cheapest candidates of each block.
        steps: list[tuple[Indices, Indices]] = []
        tried, total = np.zeros(0, np.int64), np.zeros(0)
        for index, cost in enumerate(self._target_costs(sounds, seed)):
            now = np.argpartition(cost, min(CANDIDATES, len(cost) - 1))[:CANDIDATES]
            if index == 0:
                tried, total = np.sort(now), cost[np.sort(now)]
                continue
            best = tried[np.argsort(total, kind="stable")[:CANDIDATES]]
            # Followers of the best paths may be dear by themselves and are free to join.
            follows = self.database.follower[best]
            now = np.union1d(now, follows[follows >= 0])
            reach = total[:, None] + self._join_costs(tried, now)
            came = reach.argmin(axis=0)
            steps.append((tried, came))
            tried, total = now, reach[came, np.arange(len(now))] + cost[now]
        place = int(total.argmin())
        path = [int(tried[place])]
        for units, came in reversed(steps):
            place = int(came[place])
            path.append(int(units[place]))
        return np.array(path[::-1], dtype=np.int64)

    def _target_costs(self, sounds: Sounds, seed: int) -> Iterator[Array]:
        """For each block [units]: how ill each unit fits what is heard."""
        sounds_of_units = self.database.sounds
        for index in range(len(sounds.silent)):
            apart = sounds_of_units.contour - sounds.contour[index]
            yield (SILENCE * (sounds_of_units.silent != sounds.silent[index])
                   + TEMPO * np.abs(np.log(sounds_of_units.durations / sounds.durations[index]))
                   + LOUDNESS * np.sqrt((apart ** 2).mean(axis=1))
                   + np.random.default_rng([seed, index]).gumbel(0.0, NOISE, len(sounds_of_units.silent)))

    def _join_costs(self, before: Indices, after: Indices) -> Array:
        """[before, after] what each transition costs; nothing where it is the training data's own."""
        # |a - b|^2 by the scalar product: the differences would be a table of CANDIDATES^2 vectors.
        a, b = self._leaves[before], self._from[after]
        apart = (a ** 2).sum(axis=1)[:, None] + (b ** 2).sum(axis=1) - 2.0 * a @ b.T
        cost = JOIN + np.sqrt(np.maximum(apart, 0.0) / len(self._weight))
        # What followed in the recording needs no join at all.
        cost[self.database.follower[before][:, None] == after] = 0.0
        return np.asarray(cost, dtype=np.float64)


def joined(pieces: NDArray[np.float32], jumps: NDArray[np.bool_]) -> Array:
    """[N, K, 48] pieces of exponential maps as one motion, unrolled; jumps: [N - 1] where a piece must be joined.

    A piece that is joined begins a frame after the pose that was, and the rotation between both fades out over `FADE`
    frames.
    """
    count, frames = pieces.shape[:2]
    turns = rotation.from_exponential_map(pieces.astype(np.float64).reshape(count, frames, len(CHARACTER), 3))
    out = np.empty_like(turns)
    apart, since = np.zeros((len(CHARACTER), 3)), FADE
    for index, piece in enumerate(turns):
        if index and jumps[index - 1]:
            # One frame before the piece, at the speed that it begins with.
            back = rotation.multiply(piece[0], rotation.conjugate(piece[1]))
            expected = rotation.multiply(back, piece[0])
            apart = rotation.to_exponential_map(
                rotation.multiply(out[index - 1, -1], rotation.conjugate(expected)))
            since = 1
        u = np.clip((since + np.arange(frames)) / FADE, 0.0, 1.0)
        # 1 at the join and 0 after `FADE` frames, with no speed and no acceleration at either end.
        left = (1.0 - u) ** 3 * (1.0 + 3.0 * u + 6.0 * u ** 2)
        out[index] = rotation.multiply(rotation.from_exponential_map(left[:, None, None] * apart), piece)
        since += frames
    maps = rotation.to_exponential_map(rotation.continuous(out.reshape(-1, len(CHARACTER), 4)))
    return rotation.unroll(maps).reshape(count, frames, -1)
