"""Negative controls: motion that is known to be wrong, or right, to see what a metric says of it.

A metric is worth what it makes of these (mir_eval's rule that perfect input gives a perfect score, turned round):

- `split_halves`: one half of the real clips against the other. A distance between sets cannot be lower than that by
  skill: it is the floor.
- `shuffled`: each speech with the motion of another clip. Real motion, wrong speech: the chance level of what claims
  to see synchrony or meaning. A distance between sets does not move at all.
- `reversed_in_time`: real poses, played backwards: strokes recoil and retractions strike. What takes no notice of it
  sees poses, not movement.
- `jittered`: every joint 2 cm off, anew in each frame. Hardly a change of pose, and no person moves so; a metric that
  improves by it rewards noise (the beat consistency of the BEAT family does: 0.48 clean, 0.81 with jitter).

- `mean_pose`: each clip held still. MAJE and MAD praise it.
- `mirrored`: the left arm does what the right arm does, at the same moment. What looks at one hand, or at the mean of
  both, cannot see it; to the eye it is the first sign of a machine.
- `bobbing`: the mean pose whose forearms go up and down in turn and stop at each onset of the sound. What rewards
  timing alone takes it for the best gesturer of all.

What is blind to speech is not controlled by `shuffled`, which it takes for perfect: a distance between sets must order
rising doses of damage instead (`DAMAGES`).

Each takes clips and gives clips; the same seed gives the same clips. ValueError where there is nothing to choose from.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from data_module.motion import kinematics, rotation
from data_module.types import Array, Motion, Skeleton
from gesticulator.bundle.features import SpeechFeatures

JITTER = 0.02
"""Metres: the standard deviation along each axis."""
BOB = 0.5
"""Radians of an elbow: about 12 cm at the wrist."""
_BOB_LASTS, _BOB_APART = 0.2, 0.25
"""Seconds of one movement, and between two."""
_EPS = 1e-9

TRUNK = ("Spine", "Spine1", "Spine2", "Spine3", "Neck", "Neck1", "Head")
Clips = Sequence[Motion]


def split_halves(clips: Clips, groups: Sequence[str], seed: int) -> tuple[list[int], list[int]]:
    """The numbers of the clips in two halves, drawn at random; a group (a name for each clip) stays together.

    Halves are as equal in seconds as one pass allows: the groups, in random order, go each to the shorter half. Clips
    of one sound or text must share a group, or the halves are no strangers and the floor is too low.
    """
    # Groups, not clips: clips of one sound in both halves would make the halves alike.
    order = np.random.default_rng(seed).permutation(np.unique(groups))
    if len(order) < 2:
        raise ValueError("a split needs two groups of clips at least")
    halves: tuple[list[int], list[int]] = ([], [])
    for name in order:
        # The next group goes to the shorter half, so that both have about as many windows.
        shorter = min(halves, key=lambda half: sum(clips[k].duration for k in half))
        shorter.extend(k for k, group in enumerate(groups) if group == name)
    return sorted(halves[0]), sorted(halves[1])


def donors(groups: Sequence[str], seed: int) -> NDArray[np.int64]:
    """[clips] whose motion each speech gets in `shuffled`: each clip gives once, and never to its own group."""
    rng = np.random.default_rng(seed)
    names, (kinds, counts) = np.array(groups), np.unique(groups, return_counts=True)
    largest = int(counts.max(initial=0))
    if len(names) < 2 or 2 * largest > len(names):
        raise ValueError(f"{len(names)} clips, {largest} of them of one group, cannot all have another's motion")
    # Groups side by side in a circle: a step as wide as the largest of them leaves every group.
    order = np.concatenate([rng.permutation(np.flatnonzero(names == kind)) for kind in rng.permutation(kinds)])
    giver = np.empty(len(names), dtype=np.int64)
    giver[order] = np.roll(order, -largest)
    return giver


def shuffled(clips: Clips, groups: Sequence[str], seed: int) -> list[Motion]:
    """Each clip with the motion of another one (see `donors`), cut to its own length; a shorter donor ends early."""
    return [clips[giver].crop(0, len(clip)) for clip, giver in zip(clips, donors(groups, seed), strict=True)]


def reversed_in_time(clips: Clips) -> list[Motion]:
    """Each clip played backwards."""
    return [replace(clip, rotations=clip.rotations[::-1].copy(), root_positions=clip.root_positions[::-1].copy())
            for clip in clips]


def jittered(clips: Clips, seed: int, metres: float = JITTER) -> list[Motion]:
    """Each joint moved by white Gaussian noise of `metres` along each axis, as far as bones of fixed length allow.

    Bones turn towards where the noise puts their ends, from the root outwards, so what would stretch a bone is lost:
    the joints are off by about `metres` along an axis, and errors do not add up along an arm. Where several bones leave
    a joint the first with a length leads. The root, and so what hangs on it, stays as it is: metrics look from there,
    and with a root that shakes the whole body would. A joint where nothing begins keeps its rotation in the world.
    """
    rng = np.random.default_rng(seed)
    return [_jittered(clip, rng, metres) for clip in clips]


def mean_pose(clips: Clips) -> list[Motion]:
    """Each clip held still in its mean pose (the rotation nearest to all of a joint's)."""
    out = []
    for clip in clips:
        turns = np.stack([rotation.mean(joint) for joint in clip.rotations.swapaxes(0, 1)])
        out.append(replace(clip, rotations=np.tile(turns, (len(clip), 1, 1)),
                           root_positions=np.tile(clip.root_positions.mean(axis=0), (len(clip), 1))))
    return out


def mirrored(clips: Clips) -> list[Motion]:
    """Each clip of the 16-joint character with the right arm's motion, mirrored, on the left arm as well."""
    out = []
    for clip in clips:
        turns = clip.rotations.copy()
        for left, name in enumerate(clip.skeleton.names):
            if name.startswith("Left"):
                right = clip.rotations[:, clip.skeleton.index("Right" + name.removeprefix("Left"))]
                # A mirror at the plane of symmetry keeps the turn about X and reverses those about Y and Z.
                turns[:, left] = right * np.array([1.0, 1.0, -1.0, -1.0])
        out.append(replace(clip, rotations=turns))
    return out


def towards(clips: Clips, other: Callable[[Clips], Clips], share: float, joints: Sequence[str] = ()) -> list[Motion]:
    """Each clip's joints (all, without `joints`) turned by a share of the way towards what `other` makes of it; a
    negative share turns them away from that, so that -1 and the mean pose double every movement."""
    out = []
    for clip, aim in zip(clips, other(clips), strict=True):
        way = rotation.to_exponential_map(rotation.multiply(rotation.conjugate(clip.rotations), aim.rotations))
        turned = rotation.multiply(clip.rotations, rotation.from_exponential_map(share * way))
        named = np.isin(clip.skeleton.names, joints or clip.skeleton.names)
        out.append(replace(clip, rotations=np.where(named[:, None], turned, clip.rotations)))
    return out


DAMAGES: Mapping[str, Sequence[Callable[[Clips], list[Motion]]]] = {
    "jitter": [partial(jittered, seed=0, metres=metres) for metres in (0.01, 0.02, 0.04)],
    "smaller": [partial(towards, other=mean_pose, share=share) for share in (0.25, 0.5)],
    "larger": [partial(towards, other=mean_pose, share=-share) for share in (0.5, 1.0)],
    "frozen-trunk": [partial(towards, other=mean_pose, share=share, joints=TRUNK) for share in (0.5, 1.0)],
    "mirrored": [partial(towards, other=mirrored, share=share) for share in (0.5, 1.0)]}
"""Rising doses of damage by kind: noise in each joint, movements of 3/4 and 1/2 their size, of 3/2 and twice it, a
trunk that moves half as much and not at all, a left arm that is half and wholly like the right one."""


def bobbing(clips: Clips, onsets: Sequence[Array]) -> list[Motion]:
    """Each clip's mean pose whose elbows go up and down in turn, and stop at onsets [n] (seconds) of the sound.

    Onsets closer than `_BOB_APART` to the one before are left out: the arm could not follow.
    """
    out = []
    for clip, times in zip(mean_pose(clips), onsets, strict=True):
        at = np.arange(len(clip)) / clip.fps
        # Arms go up at one onset and down at the next, so that they never leave their range.
        raised = np.zeros(len(clip))
        last, sign = -math.inf, 1.0
        for onset in np.sort(np.asarray(times)):
            if onset - last < _BOB_APART:
                continue
            # A minimum-jerk movement brakes hardest when four fifths of it are done: that falls on the onset.
            u = np.clip((at - onset) / _BOB_LASTS + 0.8, 0.0, 1.0)
            raised += sign * kinematics.minimum_jerk(u)
            last, sign = onset, -sign
        turns = clip.rotations.copy()
        for side, outward in (("Right", 1.0), ("Left", -1.0)):
            joint = clip.skeleton.index(side + "ForeArm")
            turn = rotation.from_exponential_map(BOB * raised[:, None] * np.array([0.0, outward, 0.0]))
            turns[:, joint] = rotation.multiply(turns[:, joint], turn)
        out.append(replace(clip, rotations=turns))
    return out


CONTROLS: Mapping[str, Callable[[Clips, Sequence[str], int], list[Motion]]] = {
    "shuffled": shuffled, "reversed": lambda clips, groups, seed: reversed_in_time(clips),
    "jitter": lambda clips, groups, seed: jittered(clips, seed),
    "mirrored": lambda clips, groups, seed: mirrored(clips)}
"""Those that make one set of clips of another, by the name they have in a table."""


def _jittered(clip: Motion, rng: np.random.Generator, metres: float) -> Motion:
    skeleton = clip.skeleton
    world = kinematics.global_rotations(skeleton, clip.rotations)
    wanted = kinematics.positions_of(clip)
    wanted = wanted + rng.normal(0.0, metres, wanted.shape)
    leads = _leading_children(skeleton)
    places, turned = np.empty_like(wanted), np.empty_like(world)
    for joint, parent in enumerate(skeleton.parents):
        places[:, joint] = clip.root_positions if parent < 0 else (
            places[:, parent] + rotation.rotate(turned[:, parent], skeleton.offsets[joint]))
        # What a source lacks follows its parent: it holds the identity, as everywhere.
        lacking = parent >= 0 and skeleton.names[joint] in clip.absent
        turned[:, joint] = turned[:, parent] if lacking else world[:, joint]
        if parent >= 0 and joint in leads and not lacking:
            bone = rotation.rotate(world[:, joint], skeleton.offsets[leads[joint]])
            turn = _shortest(bone, wanted[:, leads[joint]] - places[:, joint])
            turned[:, joint] = rotation.multiply(turn, world[:, joint])
    # From the root outwards the parents are known, so that the local turns follow at the end.
    local = rotation.continuous(rotation.normalise(kinematics.local_rotations(skeleton, turned)))
    # Not only but for rounding.
    local[:, [skeleton.index(name) for name in clip.absent]] = (1.0, 0.0, 0.0, 0.0)
    return replace(clip, rotations=local)


def _leading_children(skeleton: Skeleton) -> dict[int, int]:
    """Joint -> its first child that is some way off."""
    leads: dict[int, int] = {}
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0 and float(np.linalg.norm(skeleton.offsets[joint])) > _EPS:
            leads.setdefault(parent, joint)
    return leads


def _shortest(begin: Array, end: Array) -> Array:
    """[T, 4] the shortest rotations of directions [T, 3] onto others; the identity where they are opposite or none."""
    lengths = np.linalg.norm(begin, axis=-1) * np.linalg.norm(end, axis=-1)
    # The half-angle form: (1 + cos, axis sin), normalised below, needs no inverse cosine.
    real = lengths + np.sum(begin * end, axis=-1)
    turn = np.concatenate([real[:, None], np.cross(begin, end)], axis=-1)
    return rotation.normalise(np.where(real[:, None] > _EPS ** 2, turn, np.array([1.0, 0.0, 0.0, 0.0])))


ROLLED = 60
"""Blocks, some 20 s: by then no word, phrase or loudness is what it was."""


def rolled(encoded: SpeechFeatures, by: int = ROLLED) -> SpeechFeatures:
    """Shift the speech features `by` blocks (at most half the recording), wrapped around; the grid stays.

    A system that follows the voice loses its timing by that; one that only moves on its grid keeps it. Durations
    belong to the grid, so the tempo in the last column of the features stays, too.
    """
    # Half of a short recording is as far as a wrapped shift can go.
    by = min(by, len(encoded.blocks) // 2)
    blocks = replace(encoded.blocks, silent=np.roll(encoded.blocks.silent, by))

    def late(features: NDArray[np.float32]) -> NDArray[np.float32]:
        moved = np.roll(features, by, axis=0)
        # The last column is the tempo of the grid, which stays.
        moved[..., -1] = features[..., -1]
        return moved

    text = None if encoded.text is None else np.roll(encoded.text, by, axis=0)
    return replace(encoded, blocks=blocks, low=late(encoded.low), high=late(encoded.high), text=text,
                   onsets=_onsets_late(encoded, by))


def _onsets_late(encoded: SpeechFeatures, by: int) -> tuple[Array, ...] | None:
    """The onsets within the blocks that stood `by` blocks before, where they lie on the grid of the blocks' own."""
    if encoded.onsets is None:
        return None
    edges, lengths = encoded.blocks.edges, np.diff(encoded.blocks.edges)
    source = np.roll(np.arange(len(encoded)), by)
    # An onset keeps its share of the block, however long the block is that it moves to.
    return tuple(edges[block] + (encoded.onsets[k] - edges[k]) / lengths[k] * lengths[block]
                 for block, k in enumerate(source))
