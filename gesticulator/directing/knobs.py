"""Knobs, curves and named gestures over time, applied to the generated poses of a performance."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.types import Array, Word
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import representation_of
from gesticulator.directing.cues import TimedCue, cues_at
from gesticulator.directing.lexeme_names import lexeme_names
from gesticulator.directing.shaping import (
    FADE,
    MIRROR_FADE,
    OTHER_HAND,
    REST_FADE,
    ShapeLevels,
    Shaper,
    eased_levels,
    levels_at,
    nearest_turn,
    rest_share,
)
from gesticulator.directing.strokes import smooth_step
from gesticulator.options import InferenceOptions
from gesticulator.plan.plan import PlanKnobs

MeantCues = Callable[[float], Sequence[TimedCue]]
"""Gives the gestures that the words call for, or that are marked in them, and that begin up to a time."""
LONGEST_GESTURE = 4.0
"""Seconds from the start of a named gesture to its apex, or from there to its end, at most (a test measures it)."""
_BROKEN_OFF = 1.2
"""Seconds in which a gesture ends that an interruption breaks off: so long the hands take to hang."""


class Shaping:
    """Applies intensity, mirroring and named gestures to generated poses [M, D_m] at rising seconds [M]."""

    def __init__(self, bundle: Bundle, options: InferenceOptions, speaker: int, words: Sequence[Word], edges: Array,
                 meant: MeantCues | None = None) -> None:
        """edges: [N + 1] seconds of the blocks; without a plan, the start and the end (infinity for a stream) are
        enough. meant: called with the last of the seconds."""
        representation = representation_of(bundle.config)
        if representation.name != "rotations":
            raise InputError("intensity, energy, handedness, cues and plans", "need a bundle of joint rotations, and "
                             "this one has joint positions", "leave them out")
        self._edges, self._meant, self._seed = edges, meant, options.seed or 0
        self._sizes, self._both, self._mirrored, self._locked = _levels(options, len(edges) - 1)
        self._curve = None if options.plan is None else options.plan.curve("intensity")
        self._shares = [eased_levels(edges, rest_share(side), REST_FADE, self._locked) for side in self._sizes.T]
        cues = cues_at(options.cues, words, float(edges[-1]), lambda: lexeme_names(bundle))
        self._cues = sorted((cue for cue in cues if cue.lexeme is None), key=_TIME)
        self._shaper = Shaper(bundle.statistics, representation, speaker)

    def levels(self, times: Array) -> ShapeLevels:
        """The levels at `times` [M]."""
        edges, locked = self._edges, self._locked
        intensity = np.stack([levels_at(edges, side, times, FADE, locked) for side in self._sizes.T], axis=1)
        share = np.stack([levels_at(edges, side, times, REST_FADE, locked) for side in self._shares], axis=1)
        if self._curve is not None:
            factor = np.interp(times, self._curve.times, self._curve.values)
            # Locked blocks keep the size of the first generation, which had no curves.
            factor = 1.0 + (factor - 1.0) * levels_at(edges, 1.0 - locked, times, FADE, locked)
            intensity = np.minimum(intensity * factor[:, None], 2.0)
            share = share * rest_share(np.minimum(factor, 1.0))[:, None]
        return ShapeLevels(intensity, share, levels_at(edges, self._both, times, REST_FADE, locked),
                           levels_at(edges, self._mirrored, times, MIRROR_FADE, locked))

    def named(self, times: Array) -> list[TimedCue]:
        """The gestures that may be made within `times`, by the times of their strokes."""
        if not len(times):
            return []
        # A stroke outside of these times may still reach into them with its preparation or its hold.
        begin, end = float(times[0]) - LONGEST_GESTURE, float(times[-1]) + LONGEST_GESTURE
        cues = self._cues[bisect_left(self._cues, begin, key=_TIME):bisect_right(self._cues, end, key=_TIME)]
        called = self._meant(float(times[-1])) if self._meant else ()
        return sorted([*cues, *(cue for cue in called if begin <= cue.time <= end)], key=_TIME)

    def __call__(self, poses: Array, times: Array) -> Array:
        """The next poses."""
        poses = self._shaper.shaped(poses, times, self.levels(times))
        return _with_gestures(poses, times, self.named(times), self._seed)


def gestures_over(meant: MeantCues, seed: int) -> Callable[[Array, Array], Array]:
    """A function that lays named gestures over generated poses [M, 3 J] at seconds [M] and changes nothing else.

    meant: called with the last of the seconds, gives the gestures; seed: of their variation.
    """
    def shape(poses: Array, times: Array) -> Array:
        return _with_gestures(poses, times, meant(float(times[-1])), seed) if len(times) else poses

    return shape


_TIME = attrgetter("time")


def _with_gestures(poses: Array, times: Array, cues: Sequence[TimedCue], seed: int) -> Array:
    """Poses [M, D] at seconds [M] with named gestures, and with those that were broken off as they end; seed: of their
    variation."""
    if not cues:
        return poses
    from gesticulator.directing.named_gestures import laid_over

    for cue in cues:
        if cue.broken_off is None:
            continue
        whole = laid_over(poses, times, [(cue.cue, cue.time)], seed)
        share = smooth_step((times - cue.broken_off) / _BROKEN_OFF)[:, None]
        # Between two turns of the same joint, the nearer representation: the other would whirl the arm around.
        target = nearest_turn(poses.reshape(len(poses), -1, 3), whole.reshape(len(poses), -1, 3)).reshape(poses.shape)
        poses = np.where(share == 1.0, poses, np.where(share == 0.0, whole, whole + share * (target - whole)))
    played = sorted((cue for cue in cues if cue.broken_off is None), key=_TIME)
    return laid_over(poses, times, [(cue.cue, cue.time) for cue in played], seed)


def _levels(options: InferenceOptions, count: int) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Of N blocks: [N, 2] intensities of the left and the right hand; [N] 1.0 where each hand joins in the other's
    strokes; [N] 1.0 where the block is mirrored; [N] whether it is locked."""
    # Without a plan all blocks are alike, and a stream has no blocks yet.
    if options.plan is None:
        both = np.full(count, float(options.handedness == "both"))
        return np.array([_hands(options.knobs)] * count), both, np.zeros(count), np.zeros(count, bool)
    blocks, now, first = options.plan.blocks, options.plan.knobs, options.plan.drawn.knobs
    locked = np.array([block.locked for block in blocks])
    hands = np.where(locked[:, None], _hands(first), _hands(now))
    sizes = np.minimum(np.array([block.intensity for block in blocks])[:, None] * hands, 2.0)
    # Where the whole motion is mirrored at the end, the knob has been seen to already.
    whole = options.mirrored
    mirrored = [block.mirror != (not whole and (first if block.locked else now).mirror) for block in blocks]
    both = np.where(locked, float(first.handedness == "both"), float(now.handedness == "both"))
    return sizes, both, np.array(mirrored, dtype=np.float64), locked


def _hands(knobs: PlanKnobs) -> tuple[float, float]:
    """Intensities of the left and the right hand."""
    return (knobs.size * (OTHER_HAND if knobs.handedness == "right" else 1.0),
            knobs.size * (OTHER_HAND if knobs.handedness == "left" else 1.0))
