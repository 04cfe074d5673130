"""Recordings made by rule: bursts of noise of different loudness, and slow paths of arms and head."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from data_module.motion import rotation
from data_module.motion.skeletons import CHARACTER
from data_module.store import Recording, RecordingInfo, Split
from data_module.types import Blocks, Motion, Skeleton, Speech

RATE, FPS = 16000, 60.0


def turned(frames: int, fps: float, joints: Mapping[str, ArrayLike], skeleton: Skeleton = CHARACTER,
           absent: tuple[str, ...] = ()) -> Motion:
    """A character at rest, but for some joints: their exponential maps, [T, 3] or [3]."""
    maps = np.zeros((frames, len(skeleton), 3))
    for name, turns in joints.items():
        maps[:, skeleton.index(name)] = turns
    rotations = rotation.continuous(rotation.from_exponential_map(maps))
    return Motion(skeleton, rotations, np.zeros((frames, 3)), fps, absent)


def waving(skeleton: Skeleton = CHARACTER, frames: int = 60, fps: float = 20.0, seed: int = 0, size: float = 0.5
           ) -> Motion:
    """Every joint turns slowly and smoothly about its own axes, by `size` radians at the most, and the body is anywhere
    in each frame."""
    rng = np.random.default_rng(seed)
    sizes, rates, phases = (rng.uniform(low, high, (1, len(skeleton), 3)) for low, high in (
        (0.0, size), (0.2, 1.0), (0.0, 2 * np.pi)))
    maps = sizes * np.sin(2 * np.pi * rates * np.arange(frames)[:, None, None] / fps + phases)
    return Motion(skeleton, rotation.from_exponential_map(maps), rng.normal(size=(frames, 3)), fps)


def blocks_of(edges: ArrayLike, frames: int = 4) -> Blocks:
    """Blocks between these edges, seconds, each begun by an onset; 20 frames a second where a block is not warped."""
    times = np.asarray(edges)
    count = len(times) - 1
    return Blocks(times, np.ones(count, np.int8), np.zeros(count, bool), frames, 20.0)


def recording(name: str, seed: int, seconds: float = 20.0, split: Split = "train") -> Recording:
    """Bursts of different loudness, and arms and a head on slow paths of their own."""
    rng = np.random.default_rng(seed)
    samples = 1e-4 * rng.normal(size=round(seconds * RATE))
    at = 0.3
    while at < seconds - 2.6:
        length = rng.uniform(0.15, 0.5)
        piece = slice(int(at * RATE), int((at + length) * RATE))
        samples[piece] += 10 ** rng.uniform(-1.6, -0.4) * rng.normal(size=piece.stop - piece.start)
        at += length + rng.choice([0.08, 0.2, 1.6], p=[0.5, 0.4, 0.1])
    time = np.arange(round(seconds * FPS)) / FPS
    maps = {}
    for joint in ("LeftArm", "RightArm", "LeftForeArm", "RightForeArm", "Head"):
        speed, phase, size = rng.uniform(0.3, 2.0, (3, 3)), rng.uniform(0, 6, (3, 3)), rng.normal(0, 0.3, (3, 3))
        maps[joint] = (size * np.sin(speed * time[:, None, None] + phase)).sum(axis=1)
    info = RecordingInfo(name, split, "anna", "voice", "en")
    return Recording(info, Speech(samples.clip(-1, 1).astype(np.float32), RATE), turned(len(time), FPS, maps))
