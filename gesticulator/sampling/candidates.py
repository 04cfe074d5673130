"""Choice among several sampled candidates of a block: the one with the best sum of terms that change gradually, so that
a small change of pose or sound rarely changes the choice.

The terms are the distance of the movement to the lexeme to play, -2 log(d / d_0) with d_0 that to its nearest lexeme;
braking in time with the onsets (`in_time`); the seam (`jolt`); hands in the body (`depth`); a head that moves when the
hands do (`apart_from_hands`); a trunk that goes with the pitch (`with_pitch`); and the distance of height, speed and
radius of the hands from their controls, in standard deviations; and how far an arm goes beyond what people's do
(`beyond`).

Most candidates share the arms of the first (`systems.movement`); the choice is then of torso and head. What timing
loses by that is more than made up for by `retimings` of the block that was chosen. The onsets are those at which beats
are placed (`data_module.speech.onsets`); evaluation of timing uses two other detectors (`eval.metrics.eye`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from data_module import controls
from data_module.motion.kinematics import chains, places_of_some
from data_module.motion.rotation import cross, from_exponential_map
from data_module.motion.skeletons import CHARACTERS
from data_module.types import Array
from gesticulator.body.life import HEAD
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import SpeechBlock
from gesticulator.contacts.default_body import back_at, front_at
from gesticulator.contacts.limbs import lengths

Floating = NDArray[np.floating]

_NEAR = 0.05
"""Standard deviation of w, seconds: half the tolerance of the timing metrics."""
_STILL = 3.0
"""b0: summed braking of hands that hardly move, m/s^2 over a block's frames."""
FASTEST = 3.5
"""Speed limit of a hand or an elbow, m/s: in the real takes, hands stay under 3.1 in 99 of 100 seconds."""
_SWIVELS, _ACCELERATES = math.radians(230.0), (24.0, 12.5)
"""Rad/s of an elbow about its arm's line, and m/s^2 of a wrist and of an elbow: people exceed it in .1 % of frames."""
_BENT, _REACHES = 0.08, 0.2
"""Metres: an elbow nearer to that line, or a wrist nearer to its shoulder, has no swivel to speak of."""
_BEHIND = 0.03, 0.05
"""Metres that an arm may be behind the trunk, and those over which that becomes as bad as twice another limit."""
_SEAM = 0.02
"""Seconds at the start of a block in which braking does not count: a jolt at the seam is not a beat."""
_BEFORE = 4
"""Frames before a block that are needed for the speeds at its start."""
_RADII = 0.14, 0.15
"""Radius of the trunk for a wrist and an elbow, metres: half a chest's depth, and 2 cm of air."""
_FOLDED = 0.27
"""Radius about a shoulder that a wrist enters where the elbow is bent by more than about 120 degrees, metres."""
_FACE, _FACE_AT, _HAND = 0.22, (0.0, 0.09, 0.08), 0.36
"""Radius about the middle of the face that arms keep out of, and where that is from the joint of the head, metres; and
how far a hand reaches beyond the wrist, as a share of the forearm. Arms of people come within 18 cm of it in at most
1 % of the time."""
_BEFORE_FACE = 0.18
"""Metres from the middle of the face within which an arm is before it."""
_HEAD_TURNS, _HANDS_MOVE, _LEAST = 0.4, 0.5, 0.1
"""h_0, rad/s, and s_0, m/s; and what is added to a share of them, so that stillness has a logarithm."""
_TRUNK = "Spine", "Spine1", "Spine2", "Spine3", "Chest"
"""Joints from hips to chest, of those that a body may have."""
_TRUNK_TURNS = 0.25
"""s_0 of the trunk, rad/s."""
_SIDES = np.array([-1.0, 1.0, -1.0, 1.0])
"""Of wrists and elbows, the right one first: to the right the place across the trunk is negative."""
RETIMING = 0.08
"""Share of a block's length by which its middle may come earlier or later."""
_SHIFTS, _STAYS = np.linspace(-1.0, 1.0, 7), 0.1
"""Shares of the most shift of a block's middle that are tried; and what the whole of it must be worth in timing."""


LEXEME, SEAM, BODY, TOGETHER, PITCH, CONTROLS, NATURAL = 2.0, 0.25, 16.0, 1.0, 1.5, 2.0, 2.0
"""The weights of the terms, relative to timing; chosen on the validation split."""


@dataclass(frozen=True)
class CandidateMotion:
    """The motion of C candidates over T frames: the last `_BEFORE` before a block, and those of the block. poses: [C,
    T, 3 J] exponential maps of the J joints up to those of the places; places: [C, T, 8, 3] positions over the hips,
    metres, of hands, elbows and shoulders (the right one first), the chest and the head; times: [T] seconds; behind,
    to_face: `behind_trunk` and `_to_face` in the block; beyond: [C] `beyond` of the places with the shift that is
    shown."""

    poses: Array
    places: Array
    times: Array
    behind: Array
    to_face: Array
    beyond: Array


class CandidateChooser:
    """Chooses among the candidates of a block for one speaker."""

    def __init__(self, bundle: Bundle, speaker: int) -> None:
        self._levels, whole = bundle.statistics.levels, CHARACTERS[bundle.config.motion.joints]
        # The joint above the shoulders, by whatever name the skeleton has for it.
        chest = whole.parents[whole.index("RightShoulder")]
        # The chest stands on the way to a hand: it costs nothing more. The head is at the end of three joints.
        ends = [whole.index(side + part) for part in ("Hand", "ForeArm", "Arm") for side in ("Right", "Left")]
        ends += [chest, whole.index("Head")]
        # Local rotations are independent, and only a quarter of the joints moves the hands.
        self._skeleton, joints = chains(whole, ends)
        self._ends = [joints.index(joint) for joint in ends]
        self._columns = np.flatnonzero(np.repeat(np.isin(np.arange(len(whole)), joints), 3))
        self._deviation = bundle.statistics.deviation[self._columns]
        self._mean = bundle.statistics.mean_pose[speaker][self._columns]
        self._head, self._trunk = (np.flatnonzero(np.repeat([name in part for name in self._skeleton.names], 3))
                                   for part in (HEAD, _TRUNK))

    def motion(self, speech: SpeechBlock, past: Floating, blocks: Floating, shift: Floating | None = None
               ) -> CandidateMotion:
        """The motion of candidates. past: [P, D_m] features of the motion up to the block's start; blocks: [C, K, D_m]
        the candidates; shift: [P + K, D_m] that is added to what is shown (`systems.movement.Offset`), or None."""
        poses, times, count = self._poses(past, blocks, shift), self._times(speech, blocks.shape[1]), len(blocks)
        both = self._places(poses)
        places, shown = both[:count], both[-count:]
        behind = behind_trunk(places[:, _BEFORE:])
        return CandidateMotion(poses[:count], places, times, behind, _to_face(places[:, _BEFORE:]),
                               beyond(shown, times, behind if shift is None else None))

    def choose(self, speech: SpeechBlock, motion: CandidateMotion, apart: Floating, control: Floating | None = None
               ) -> int:
        """The index of the best candidate; the first of equals. motion: of C candidates; apart: [C] squared distance of
        each to the lexeme to play over that to its nearest lexeme; control: rows [K, 2 F], or None."""
        poses, places, times = motion.poses, motion.places, motion.times
        hands = places[:, :, :2]
        score = -LEXEME * np.log(apart.astype(np.float64))
        # Only this is about what is shown: by a shift, two takes that parted would choose differently while it fades.
        score -= NATURAL * motion.beyond
        score -= BODY * depth(places[:, _BEFORE:], motion.behind, motion.to_face)
        if len(speech.onsets) > 0:
            score += in_time(hands, times, speech.start, speech.onsets)
        score -= TOGETHER * apart_from_hands(poses[..., self._head], hands, times)
        if speech.pitch is not None:
            score += PITCH * with_pitch(poses[..., self._trunk], times, speech.pitch)
        # Bounded, because a block that begins at rest has a large ratio and nothing wrong.
        score -= SEAM * jolt(hands, times)
        if control is not None:
            score -= CONTROLS * self._control_error(hands, times, control)
        return int(score.argmax())

    def retimed(self, speech: SpeechBlock, past: Floating, block: Floating) -> Floating:
        """The block [K, D_m], earlier or later in its middle by up to `RETIMING` of its length, so that more
        of the hands' braking lies near the onsets; past: see `motion`. Its ends, and the speed there, stay."""
        if not len(speech.onsets):
            return block
        blocks = retimings(len(block), RETIMING) @ np.concatenate([past[-2:], block])
        hands = self._places(self._poses(past, blocks))[:, :, :2]
        worth = in_time(hands, self._times(speech, len(block)), speech.start, speech.onsets) - _STAYS * np.abs(_SHIFTS)
        return np.asarray(blocks[int(worth.argmax())], dtype=block.dtype)

    @staticmethod
    def natural(motion: CandidateMotion) -> bool:
        """Whether arms stay within what people do in some candidate, and are not before the face in one."""
        nearest = motion.to_face.min((1, 2))
        return bool(not motion.beyond.all() and (nearest >= _BEFORE_FACE).any())

    def _poses(self, past: Floating, blocks: Floating, shift: Floating | None = None) -> Array:
        """[C, T, 3 J] as of `CandidateMotion`, and with a shift those with it after them; see `motion` for the
        arguments."""
        before, within = past[-_BEFORE:, self._columns], blocks[..., self._columns]
        # Frames before the block give the speeds at its start.
        frames: Array = np.concatenate([np.repeat(before[None], len(blocks), axis=0), within], axis=1)
        if shift is not None:
            # As further candidates: kinematics of few frames cost by the call.
            frames = np.concatenate([frames, frames + shift[-frames.shape[1]:, self._columns]])
        return frames * self._deviation + self._mean

    def _places(self, frames: Array) -> Array:
        """[C, T, 8, 3] as of `CandidateMotion`, from poses [C, T, 3 J]."""
        rotations = from_exponential_map(frames.reshape(-1, len(self._skeleton), 3))
        return places_of_some(self._skeleton, rotations, self._ends).reshape(*frames.shape[:2], len(self._ends), 3)

    @staticmethod
    def _times(speech: SpeechBlock, frames: int) -> Array:
        """[T] times of the frames before a block and of the block, seconds."""
        before, duration, _ = speech.durations
        steps = np.arange(1, frames + 1) / frames
        return np.concatenate([speech.start - before / frames * np.arange(_BEFORE - 1, -1, -1),
                               speech.start + duration * steps])

    def _control_error(self, hands: Array, times: Array, control: Floating) -> Array:
        """[C] distance of each candidate's hands [C, T, 2, 3] from the controlled features, in standard deviations."""
        levels, width, inside = self._levels, len(controls.FEATURES), hands[:, _BEFORE:]
        assert levels is not None, "there are no controls without levels"
        # The same definition as of the training data (`data_module.controls`), mean over the block.
        steps = np.linalg.norm(_steps(hands[:, _BEFORE - 1:]), axis=-1).mean(-1)
        measured = np.stack([inside[:, :, 0, 1].mean(1), steps.sum(1) / (times[-1] - times[_BEFORE - 1]),
                             np.linalg.norm(inside[..., [0, 2]], axis=-1).mean((1, 2))], axis=-1)
        target, given = control[:, :width].mean(0), control[:, width:].mean(0)
        return np.asarray((np.abs((measured - levels.mean) / levels.spread - target) * given).sum(-1))


def beyond(places: Array, times: Array, behind: Array | None = None) -> Array:
    """[C] by how much the arms of each block go beyond people's, 0 for not: the sum of what speed, swivel of the elbow,
    accelerations of wrist and elbow, and place behind the trunk exceed their limits by.
    places: [C, T, 8, 3] as of `CandidateMotion`, at times [T] seconds; behind: `behind_trunk` in the block, if known.
    """
    velocity, acceleration = _speeds(places[:, :, :4], times)
    acceleration = lengths(acceleration)[:, _BEFORE - 2:]
    most = (acceleration / np.repeat(_ACCELERATES, 2)).max(1)
    behind = behind_trunk(places[:, _BEFORE:]) if behind is None else behind
    behind = (behind.max((1, 2)) - _BEHIND[0]) / _BEHIND[1]
    wrist, elbow, shoulder = (np.swapaxes(places[:, _BEFORE - 1:, k:k + 2], 1, 2) for k in (0, 2, 4))
    turns, off = swivel(shoulder, elbow, wrist)
    clear = (off > _BENT) & (lengths(wrist - shoulder) > _REACHES)
    turned = np.abs(turns) / (times[_BEFORE:] - times[_BEFORE - 1:-1]) * (clear[..., 1:] & clear[..., :-1])
    shares = [lengths(velocity[:, _BEFORE - 1:]).max((1, 2)) / FASTEST, 1.0 + behind,
              turned.max((1, 2)) / _SWIVELS, most[:, :2].max(1), most[:, 2:].max(1)]
    return np.asarray(sum(np.maximum(share - 1.0, 0.0) for share in shares))


def swivel(shoulder: Array, elbow: Array, wrist: Array) -> tuple[Array, Array]:
    """[..., T - 1] radians that an elbow turns about the line from its shoulder to its wrist from frame to frame, and
    [..., T] metres that it is off that line; places [..., T, 3]."""
    line, upper = wrist - shoulder, elbow - shoulder
    line = line / np.maximum(lengths(line), 1e-9)[..., None]
    out = upper - np.vecdot(upper, line)[..., None] * line
    one, other, before, after = line[..., :-1, :], line[..., 1:, :], out[..., :-1, :], out[..., 1:, :]
    # Carried along by the smallest rotation from line to line.
    axis, cosine = cross(one, other), np.vecdot(one, other)[..., None]
    carried = (cosine * before + cross(axis, before)
               + axis * np.vecdot(axis, before)[..., None] / np.maximum(1.0 + cosine, 1e-6))
    sine = np.vecdot(cross(carried, after), other)
    return np.arctan2(sine, np.vecdot(carried, after)), lengths(out)


def depth(places: Array, behind: Array | None = None, to_face: Array | None = None) -> Array:
    """[C] how deep wrists and elbows are in the trunk, wrists in the sphere of a folded arm, and forearms in that of
    the face, and how far arms are behind the trunk (`behind_trunk`), as shares of the radii, summed over the joints and
    averaged over the frames. places: as of `CandidateMotion`; behind, to_face: of these places, if known."""
    chest = places[:, :, 6:7]
    share = np.clip(np.vecdot(places[:, :, :4], chest) / np.maximum(np.vecdot(chest, chest), 1e-9), 0.0, 1.0)
    away = lengths(places[:, :, :4] - share[..., None] * chest)
    radii = np.repeat(_RADII, 2)
    # A wrist at its own shoulder is a pose that people hardly take.
    folded = 1.0 - lengths(places[:, :, :2] - places[:, :, 4:6]) / _FOLDED
    near_face = 1.0 - (_to_face(places) if to_face is None else to_face) / _FACE
    behind = behind_trunk(places) if behind is None else behind
    shares = [1.0 - away / radii, folded, near_face, behind / _RADII[0]]
    return np.asarray(sum(np.maximum(each, 0.0).sum(-1) for each in shares).mean(-1))


def behind_trunk(places: Array) -> Array:
    """[C, T, 4] metres by which each wrist is behind the front of the trunk and each elbow behind its back, negative
    ahead of them; places: as of `CandidateMotion`."""
    chest, right, left = places[:, :, 6], places[:, :, 4], places[:, :, 5]
    up = chest / np.maximum(lengths(chest), 1e-9)[..., None]
    across = left - right - np.vecdot(left - right, up)[..., None] * up
    across = across / np.maximum(lengths(across), 1e-9)[..., None]
    x, y, z = (np.vecdot(axis[:, :, None], places[:, :, :4]) for axis in (across, up, cross(across, up)))
    x, height = x * _SIDES, 0.5 * np.vecdot(left + right, up)[..., None]
    surfaces = np.concatenate([front_at(x[..., :2], y[..., :2], height), back_at(x[..., 2:], y[..., 2:], height)], -1)
    return np.asarray(surfaces - z)


def _to_face(places: Array) -> Array:
    """[C, T, 2] metres from the middle of the face to the nearest point of each forearm with its hand."""
    face = places[:, :, 7:] + np.array(_FACE_AT)
    hands, elbows = places[:, :, :2], places[:, :, 2:4]
    arms = (1.0 + _HAND) * (hands - elbows)
    along = np.vecdot(face - elbows, arms) / np.maximum(np.vecdot(arms, arms), 1e-9)
    return lengths(elbows + np.clip(along, 0.0, 1.0)[..., None] * arms - face)


@cache
def retimings(frames: int, most: float) -> Array:
    """[C, K, 2 + K] weights that move the middle of a block of K frames, after the two before it, by shares a of its
    length from -most to most, by splines of Catmull and Rom: frame t in (0, 1] takes the value at
    t + 16 a t^2 (1 - t)^2. The middle one is the block itself."""
    steps = np.arange(1, frames + 1) / frames
    moved = steps + most * _SHIFTS[:, None] * 16.0 * steps ** 2 * (1.0 - steps) ** 2
    at = frames * moved
    first = np.minimum(np.floor(at + 1e-9), frames - 1.0)
    x = at - first
    around = 0.5 * np.stack([-x + 2 * x ** 2 - x ** 3, 2 - 5 * x ** 2 + 3 * x ** 3, x + 4 * x ** 2 - 3 * x ** 3,
                             x ** 3 - x ** 2], axis=-1)
    weights = np.zeros((*at.shape, 2 + frames + 1))
    np.put_along_axis(weights, first[..., None].astype(int) + np.arange(4), around, -1)
    # Beyond the last frame it goes on as between the last two.
    weights[..., -2] += 2.0 * weights[..., -1]
    weights[..., -3] -= weights[..., -1]
    return weights[..., :-1]


def in_time(hands: Array, times: Array, start: float, onsets: Array) -> Array:
    """[C] share of the hands' braking from `start` on that lies near the onsets [n], seconds: sum b w / (sum b + b_0),
    b(t) = max(0, -ds/dt), s the summed speed of both hands [C, T, 2, 3], metres at times [T], and w(t) a Gaussian of
    the time to the nearest onset. b_0 keeps blocks that hardly move from scoring high."""
    seconds = times[1:] - times[:-1]
    speed = lengths(_steps(hands)).sum(-1) / seconds
    between = 0.5 * (times[1:] + times[:-1])
    braking = np.maximum(-_steps(speed) / (between[1:] - between[:-1]), 0.0)
    counts = times[1:-1] > start + _SEAM
    distance = np.abs(times[1:-1, None] - np.asarray(onsets)).min(axis=1)
    near = np.exp(-0.5 * (distance / _NEAR) ** 2)
    braking, near = braking[:, counts], near[counts]
    return np.asarray((braking * near).sum(1) / (braking.sum(1) + _STILL))


def apart_from_hands(head: Array, hands: Array, times: Array) -> Array:
    """[C] |log(h / h_0) - log(s / s_0)|: how far the head's turning speed h in each block is from what goes with the
    speed s of the hands. head: [C, T, 3 n] rotations of the joints of neck and head as exponential maps, whose sum
    turns as the head does while they are small; hands: [C, T, 2, 3]
    metres at times [T] seconds, the frames before the block and those of the block."""
    seconds = times[-1] - times[_BEFORE - 1]
    turns = head[:, _BEFORE - 1:].reshape(*head[:, _BEFORE - 1:].shape[:2], -1, 3).sum(2)
    turned = lengths(_steps(turns)).sum(1) / seconds
    moved = lengths(_steps(hands[:, _BEFORE - 1:])).mean(-1).sum(1) / seconds
    return np.asarray(np.abs(np.log(turned / _HEAD_TURNS + _LEAST) - np.log(moved / _HANDS_MOVE + _LEAST)))


def with_pitch(trunk: Array, times: Array, pitch: Array) -> Array:
    """[C] how far the trunk of each block turns faster than in the other blocks where the pitch [K] is high, and slower
    where it is low. trunk: [C, T, 3 n] rotations of the joints from hips to chest as exponential maps."""
    turns = trunk[:, _BEFORE - 1:].reshape(*trunk[:, _BEFORE - 1:].shape[:2], -1, 3).sum(2)
    speed = lengths(_steps(turns)) / (times[_BEFORE:] - times[_BEFORE - 1:-1])
    return np.asarray(((speed - speed.mean(0)) / _TRUNK_TURNS * pitch).mean(1))


def jolt(hands: Array, times: Array) -> Array:
    """[C] the hands' acceleration at the start of each block over the mean within it, at most 2; arguments as of
    `apart_from_hands`."""
    acceleration = lengths(_speeds(hands, times)[1]).sum(-1)
    at, inside = acceleration[:, _BEFORE - 2], acceleration[:, _BEFORE - 1:]
    return np.asarray(np.minimum(at / (inside.mean(1) + 1.0), 2.0))


def _steps(values: Array) -> Array:
    """[C, T - 1, ...] differences of values [C, T, ...] over time; `numpy.diff` takes twice as long for few of them."""
    return np.asarray(values[:, 1:] - values[:, :-1])


def _speeds(places: Array, times: Array) -> tuple[Array, Array]:
    """Velocities [C, T - 1, P, 3] and accelerations [C, T - 2, P, 3] of places [C, T, P, 3] at times [T] seconds."""
    velocity = _steps(places) / (times[1:] - times[:-1])[:, None, None]
    return velocity, _steps(velocity) / (0.5 * (times[2:] - times[:-2]))[:, None, None]
