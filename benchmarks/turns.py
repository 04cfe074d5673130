"""Whether turns of a forearm could be left out of a BVH file: `python benchmarks/turns.py [--stretches 540]`.

Random poses are laid over stretches of forearms and hands. Where the channels come back with whole turns, all ways are
searched that write the same rotations and end as the unedited channels do: two triples of angles for each frame, and
turns of each. Of these ways the one counts whose largest step within a frame is smallest. If that is a large part of a
turn, no continuous channels end there.
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path

import numpy as np
import soundfile

from data_module.motion import rotation
from data_module.motion.bvh import _order_of
from data_module.types import Array
from gesticulator import Gesticulator

ROOT = Path(__file__).resolve().parents[1]
JOINTS = ("LeftForeArm", "RightForeArm", "LeftHand", "RightHand")
FADE = 0.6
"""Seconds over which a pose comes, and goes."""
FARTHEST = 150.0
"""Degrees of a random pose from the one that is there."""
_TURN = 2.0 * np.pi
_TURNS = np.array(list(itertools.product((-1, 0, 1), repeat=3))) * _TURN


def laid_over(path: Array, rng: np.random.Generator) -> Array:
    """A path of rotations [T, 4] with a random pose in its middle."""
    share = 1.0 - np.abs(np.linspace(-1.0, 1.0, len(path)))
    share = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    axis = rng.normal(size=3)
    turn = np.radians(rng.uniform(0.0, FARTHEST)) * axis / np.linalg.norm(axis)
    return rotation.multiply(path, rotation.from_exponential_map(share[:, None] * turn))


def least_step(angles: Array, end: Array) -> float:
    """The smallest largest step, radians, of channels that write the same rotations as `angles` [T, 3], begin as these,
    and end at `end` [3]."""
    other = np.stack([angles[:, 0] + np.pi, np.pi - angles[:, 1], angles[:, 2] + np.pi], axis=-1)
    ways = np.stack([angles, other], axis=1)[:, :, None] + _TURNS
    ways = ways.reshape(len(angles), -1, 3)
    largest = np.where(np.abs(ways[0] - angles[0]).max(axis=-1) < 1e-6, 0.0, np.inf)
    for before, after in itertools.pairwise(ways):
        steps = np.abs(after[None] - before[:, None]).max(axis=-1)
        largest = np.maximum(steps, largest[:, None]).min(axis=0)
    there = np.abs(ways[-1] - end).max(axis=-1) < 1e-6
    return float(largest[there].min(initial=np.inf))


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    p.add_argument("--stretches", type=int, default=540)
    asked, rng = p.parse_args(), np.random.default_rng(0)
    samples, rate = soundfile.read(ROOT / "examples" / "speech.flac", dtype="float32")
    motion = Gesticulator.from_pretrained()(samples, rate, seed=1).motion
    length, found = round(2.0 * FADE * motion.fps), list[tuple[str, float, float]]()
    for number in range(asked.stretches):
        joint = JOINTS[number % len(JOINTS)]
        path = motion.rotations[:, motion.skeleton.index(joint)]
        first = int(rng.integers(1, len(path) - length - 1))
        order, part = _order_of(joint), path[first - 1:first + length]
        before = np.unwrap(rotation.to_euler(part, order), axis=0)
        after = np.unwrap(rotation.to_euler(np.concatenate([part[:1], laid_over(part[1:], rng)]), order), axis=0)
        if np.abs(after[-1] - before[-1]).max() > 1.0:
            found.append((joint, float(np.abs(np.diff(after, axis=0)).max()), least_step(after, before[-1])))
    print(f"{len(found)} of {asked.stretches} stretches come back with turns")
    print("\n| joint | cases | largest step as written, degrees | least step without turns, degrees |")
    print("|---|---|---|---|")
    for joint in JOINTS:
        rows = np.degrees([row[1:] for row in found if row[0] == joint]).reshape(-1, 2)
        if len(rows):
            written, without = (f"{column.min():.0f} to {column.max():.0f}" for column in rows.T)
            print(f"| {joint} | {len(rows)} | {written} | {without} |")


if __name__ == "__main__":
    main()
