"""Lifelike motion of trunk, head and fingers: real people's leaning, turning and nodding, selected phrase by phrase.

Bends are log rotations [T, 3 parts, 3] of the hips, of the whole spine and of neck and head together, so that they fit
every skeleton. Segments of real takes in which the head moves on the stresses of the speech are joined by quintics and
calmed in pauses; postures that change about every ten seconds are added.

How high and how far out the hands are carried, by what is heard: vocal effort and pitch range of each phrase.

Without it a unit's height and reach depend on which strokes come, and on the manner of the talk, neither of which can
be heard: the gain of a stroke scales its rotations against the hanging arm, which bends the elbow as much as it raises
the hand. Here the arms are turned about the pose in front of the body so that the hands go straight up, or straight
out, by centimetres.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from data_module.motion import kinematics, rotation
from data_module.motion.kinematics import fade_weights, minimum_jerk
from data_module.types import Array
from gesticulator_performer.joints import FPS, MIRROR, SIDES
from gesticulator_performer.strokes import PerformerBody
from gesticulator_performer.syllables import Phrase, Spoken, Syllable
from gesticulator_performer.takes import ARM_SIDES, GROUPS, HIPS, SKULL, SPINE, Library, soft_limit

_PARTS = (HIPS, SPINE, SKULL)
_LIMITS = np.radians([8.0, 16.0, 38.0])
# Gains of lean, yaw and roll of each part.
_AXES = np.array([[1.0, 0.75, 0.75], [1.0, 0.75, 0.75], [1.0, 1.0, 0.8]])
# Gains of the three parts, on another person's body and speech.
_GAINS = np.array([0.5, 0.8, 0.72])
# Gain of the head's yaw, and the share of the spine's yaw that it undoes to keep the eyes on the listener.
_HEAD_YAW, _EYES = 0.65, 0.35
_LEAST_WINDOW = 0.85
_TRIES = 24
_RECENT = 8
# Least prominence of a stressed syllable, on which the head should move.
_STRESSED = 0.4
_FADE = 0.7
# Share of the trunk's fast motion that remains in a pause, and the low pass that separates it, seconds.
_CALM, _CALMER_SPAN = 0.7, 1.5
# Factors on the fast part of the trunk's motion while the hands are still and while they move.
_WITHOUT_HANDS, _WITH_HANDS = 0.45, 1.35
_POSTURE = (9.0, 16.0)
# Seconds that a posture lasts, and seconds of the transition to the next one.
_SHIFT = 1.6
# Soft limit of the fidgets of a hanging arm's joints, radians, and seconds of the transition between takes.
_FIDGET, _IDLE_FADE = np.radians(12.0), 1.0
# Lean of a standing body as its weight circles, radians, and the period of the circle, seconds.
_SWAY, _SWAY_SECONDS = np.radians(1.7), 3.2
# Turn of the chest per semitone of an accent's pitch above the voice's middle, radians, and the semitones that count
# most.
_ACCENT, _ACCENT_MOST = np.radians(0.5), 6.0
# Seconds before the middle of an accented vowel in which the chest turns, and after it in which it comes back: its
# speed follows the pitch at once.
_ACCENT_RISE, _ACCENT_FALL = 0.22, 0.5
# Yaw of the head in the room (the sum of its joints' yaws), radians, that 95 % of the frames stay within.
_MOST_YAW = np.radians(20.0)
# Soft limit of the bend of a joint against the hanging hand: bends of overlapping strokes add up.
_FARTHEST_FINGER = np.radians(95.0)
# Standard deviation of the low pass, seconds: in some clips the fingers jump from frame to frame.
_SMOOTH_FINGERS = 0.05
# Amplitude (radians) and period (seconds) with which a finger closes and opens at rest.
_FINGER_FIDGET, _FINGER_SECONDS = np.radians(2.0), 5.3
# What the middle joint of each finger, the thumb first, is bent more: a relaxed hand closes towards the little finger.
_CASCADE = np.radians([0.0, -4.0, 1.0, 6.0, 10.0])
# Axes about which the fingers of the left and the right hand close.
_CLOSING = (np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 1.0]))
# Metres by which a hand is carried higher and farther out at full drive. Over phrases a drive has a deviation of about
# a half. Reach is averaged over both hands and the whole unit, and so needs as much as height.
_HIGHER, _FARTHER = 0.11, 0.11
# Shares of effort and of pitch range in the drives of height and reach.
_DRIVES = np.array([[0.55, 0.45], [0.8, 0.2]])
# Semitones by which the deviation of a phrase's pitch may exceed the recording's until its drive is saturated.
_RANGE = 1.2
# Voiced syllables that tell a phrase's pitch range.
_FEWEST = 3
# Standard deviation of the low pass, seconds: the hands change their place between strokes, not with each one.
_SETTLES = 0.45
# Joints of an arm that are turned: upper arm and forearm.
_TURNED = (1, 2)
_STEP = 1e-4


@dataclass(frozen=True)
class Segment:
    """The trunk of a take, and its arms relative to their mean. bends: [T, 3, 3]; arms: [2, T, 12] log rotations of
    shoulder, upper arm, forearm and hand, left and right; quiet: the person listens or waits."""

    name: str
    bends: Array
    arms: Array
    quiet: bool


def trunk_segments(library: Library, splits: Mapping[str, str], split: str) -> tuple[Segment, ...]:
    """The trunks of the takes of a split, each with its mirror image; story tellers act too much and are left out."""
    out = []
    for take in library.takes:
        if splits[take.name] != split or take.group == "story" or len(take) < _LEAST_WINDOW * FPS:
            continue
        bends = np.stack([take.logs[:, list(joints)].sum(axis=1) for joints in _PARTS], axis=1)
        bends = bends - 0.5 * bends.mean(axis=0)
        bends = np.stack([soft_limit(bends[:, k], limit) for k, limit in enumerate(_LIMITS)], axis=1) * _AXES
        quiet = take.group not in GROUPS
        arms = np.stack([take.logs[:, list(side)] - take.logs[:, list(side)].mean(axis=0) for side in ARM_SIDES])
        arms = soft_limit(arms, _FIDGET)
        out += [Segment(take.name, bends, arms.reshape(2, len(take), -1), quiet),
                Segment(take.name, bends * MIRROR, (arms[::-1] * MIRROR).reshape(2, len(take), -1), quiet)]
    return tuple(out)


def trunk_track(segments: tuple[Segment, ...], spoken: Spoken, speaking: Array, gain: float,
                rng: np.random.Generator) -> Array:
    """Bends [T, 3, 3] for a talk. speaking: [T] 0 in pauses, 1 in speech, with soft edges; gain: a factor on the
    motion."""
    frames = len(speaking)
    stressed = np.array([s.vowel * FPS for s in spoken.syllables if s.prominence > _STRESSED])
    out = np.zeros((frames, 3, 3))
    recent: list[str] = []
    cuts = _windows(spoken, frames)
    for first, last in zip(cuts, cuts[1:], strict=False):
        name, piece = _fitting(segments, out[:first], last - first, float(speaking[first:last].mean()) < 0.3,
                               stressed - first, recent, rng)
        recent = [*recent, name][-_RECENT:]
        out[first:last] = piece
    effort = np.zeros(frames)
    for phrase in spoken.phrases:
        effort[round(phrase.start * FPS):round(phrase.end * FPS)] = phrase.effort
    vigour = np.exp(0.35 * gaussian_filter1d(effort, 0.4 * FPS))
    return gain * _GAINS[:, None] * calm(out, speaking, vigour)


def quintic_offset(before: Array, target: Array, times: Array, fade: float, fps: float) -> Array:
    """[M, D] the offset to add to the new motion at `times`: the gap to the old motion, its velocity and acceleration
    fade to zero (`fade_weights`).

    before: [3, D] the last frames of the old motion; target: [3, D] the new motion at the same three frames. times: [M]
    seconds of the new frames, the first one frame after `before`. fade: seconds until the offset is zero. Zeros if
    `before` holds fewer than three frames.
    """
    if len(before) < 3:
        return np.zeros((len(times), target.shape[1]))
    gap = before - target
    v, a = (gap[2] - gap[1]) * fps, (gap[2] - 2.0 * gap[1] + gap[0]) * fps * fps
    place, velocity, acceleration = fade_weights(np.clip((times - times[0] + 1.0 / fps) / fade, 0.0, 1.0)[:, None])
    return gap[2] * place + v * fade * velocity + a * fade * fade * acceleration


def idle_arms(segments: tuple[Segment, ...], frames: int, rng: np.random.Generator) -> Array:
    """[2, T, 12] log rotations of hanging arms about their mean: joined fidgets of people who listen or wait."""
    quiet = [s for s in segments if s.quiet and s.arms.shape[1] > 3 * FPS]
    out = np.zeros((0 if quiet else frames, 24))
    while len(out) < frames:
        arms = quiet[int(rng.integers(len(quiet)))].arms
        piece = np.concatenate([arms[0], arms[1]], axis=1)
        offset = quintic_offset(out[-3:], piece[:3], np.arange(len(piece) - 3) / FPS, _IDLE_FADE, FPS)
        out = np.concatenate([out, piece[3:] + offset])
    return np.stack([out[:frames, :12], out[:frames, 12:]])


def sway(frames: int, rng: np.random.Generator) -> Array:
    """[T, 3] log rotations of the spine of a swaying body: lean and roll, a quarter period apart. The speed on a circle
    is never zero, so the body never freezes; the pace drifts."""
    pace = 2.0 * np.pi / _SWAY_SECONDS * np.exp(rng.normal(0.0, 0.2, frames // round(2 * FPS) + 2))
    turned = np.interp(np.arange(frames) / (2 * FPS), np.arange(len(pace)), pace)
    angle = rng.uniform(0.0, 2.0 * np.pi) + np.cumsum(turned) / FPS * (1.0 if rng.random() < 0.5 else -1.0)
    return _SWAY * np.stack([np.sin(angle), 0.0 * angle, np.cos(angle)], axis=-1)


def pitch_accents(syllables: Sequence[Syllable], frames: int, rng: np.random.Generator) -> Array:
    """[T, 3] log rotations of the spine that go with the pitch: the higher an accented syllable, the farther the chest
    leans or turns with it."""
    out, times = np.zeros((frames, 3)), np.arange(frames) / FPS
    turns = rng.normal(0.0, 1.0, (len(syllables), 3)) * [1.0, 1.2, 0.6]
    for syllable, turn in zip(syllables, turns, strict=True):
        height = min(syllable.pitch, _ACCENT_MOST)
        if height <= 0.0 or syllable.prominence <= 0.0:
            continue
        top = 0.5 * (syllable.vowel + syllable.end)
        first, last = (int(np.clip(np.ceil(at * FPS), 0, frames)) for at in (top - _ACCENT_RISE, top + _ACCENT_FALL))
        near = times[first:last] - top
        rises = minimum_jerk(np.clip(near / _ACCENT_RISE + 1.0, 0.0, 1.0))
        falls = minimum_jerk(np.clip(near / _ACCENT_FALL, 0.0, 1.0))
        out[first:last] += (_ACCENT * height * (rises - falls))[:, None] * turn
    return out


def yaw_scale(yaws: Array) -> float:
    """Factor on the yaws [T] (radians, of the head in the room) that keeps 95 % of them within 20 degrees."""
    return min(1.0, _MOST_YAW / max(float(np.percentile(np.abs(yaws), 95)), 1e-9))


def _windows(spoken: Spoken, frames: int) -> list[int]:
    least = round(_LEAST_WINDOW * FPS)
    cuts = [0]
    for phrase in sorted(spoken.phrases, key=lambda p: p.start):
        for frame in (round(phrase.start * FPS) - 6, round(phrase.end * FPS) + 10):
            if cuts[-1] + least < frame < frames - least:
                cuts.append(frame)
    return [*cuts, frames]


def _fitting(segments: tuple[Segment, ...], before: Array, count: int, quiet: bool, stressed: Array,
             recent: list[str], rng: np.random.Generator) -> tuple[str, Array]:
    """The best of `_TRIES` random pieces of `count` frames: it continues the last one and its head moves on stresses.
    """
    long = [s for s in segments if len(s.bends) > count + 8]
    able = [s for s in long if s.quiet == quiet and s.name not in recent] or long
    if not able:
        able = [max(segments, key=lambda s: len(s.bends))]
    stressed = stressed[(stressed > 8) & (stressed < count - 8)].astype(int)
    best: tuple[float, str, Array] | None = None
    for _ in range(_TRIES):
        segment = able[int(rng.integers(len(able)))]
        at = int(rng.integers(3, max(4, len(segment.bends) - count)))
        # From three frames before; the last frame is repeated if the segment is too short.
        piece = segment.bends[np.minimum(np.arange(at - 3, at + count), len(segment.bends) - 1)]
        cost = _accent_cost(piece[3:, 2], stressed)
        if len(before) >= 3:
            cost += 4.0 * float(np.abs(piece[3] - before[-1]).sum())
            cost += 18.0 * float(np.abs((piece[4] - piece[3]) - (before[-1] - before[-2])).sum())
        if best is None or cost < best[0]:
            best = cost, segment.name, piece
    assert best is not None
    piece = best[2][3:]
    if len(before) >= 3:
        old, new = before[-3:].reshape(3, -1), best[2][:3].reshape(3, -1)
        offset = quintic_offset(old, new, np.arange(count) / FPS, _FADE, FPS)
        piece = piece + offset.reshape(piece.shape)
    return best[1], piece


def _accent_cost(head: Array, stressed: Array) -> float:
    """A cost that is lower if the head [T, 3] moves fast at the stresses and dips towards them."""
    if not len(stressed) or len(head) < 20:
        return 0.0
    speed = gaussian_filter1d(np.linalg.norm(np.gradient(head, axis=0), axis=-1), 3)
    dip = head[stressed, 0] - head[np.maximum(stressed - 10, 0), 0]
    return float(-speed[stressed].mean() / (speed.mean() + 1e-4) - 0.6 * dip.mean() / (head[:, 0].std() + 1e-3))


def calm(bends: Array, speaking: Array, vigour: Array | float = 1.0) -> Array:
    """Scale the fast part of bends [T, ...]: smaller in pauses, larger in vigorous phrases."""
    return _quickened(bends, (_CALM + (1.0 - _CALM) * gaussian_filter1d(speaking, 0.35 * FPS, mode="nearest")) * vigour)


def with_activity(bends: Array, activity: Array) -> Array:
    """Bends [T, ...] whose fast part is larger where the hands are active ([T], 0 to 1): trunk and head move with them.
    """
    return _quickened(bends, _WITHOUT_HANDS + (_WITH_HANDS - _WITHOUT_HANDS) * activity)


def _quickened(bends: Array, share: Array) -> Array:
    """Bends [T, ...] whose fast part is scaled by a share [T]."""
    slow = gaussian_filter1d(bends, _CALMER_SPAN * FPS, axis=0, mode="nearest")
    return slow + (bends - slow) * share.reshape(-1, *[1] * (bends.ndim - 1))


def postures(frames: int, rng: np.random.Generator) -> Array:
    """[T, 2, 3] bends of spine and head that last 9 to 16 s: a constant lean, and changes of a few degrees."""
    seconds = frames / FPS
    times = np.arange(0.0, seconds + 40.0, rng.uniform(*_POSTURE))
    lean = np.radians([rng.normal(5.0, 5.0), rng.normal(0.0, 2.5), rng.normal(0.0, 1.5)])
    spine = lean + np.radians(rng.normal(size=(len(times), 3)) * [3.5, 3.0, 1.8])
    tilt = np.radians([rng.normal(0.0, 5.0), 0.0, 0.0])
    head = tilt + np.radians(rng.normal(size=(len(times), 3)) * [4.0, 4.0, 3.0]) - 0.5 * spine
    return np.stack([_held(times, spine, frames), _held(times, head, frames)], axis=1)


def _held(times: Array, values: Array, frames: int) -> Array:
    """[T, 3] piecewise constant values [K, 3], with a smooth transition in the last `_SHIFT` seconds of each."""
    ends = np.append(times[1:] - _SHIFT, times[-1] + 5.0)
    knots = np.stack([times, ends], axis=1).ravel()
    return PchipInterpolator(knots, np.repeat(values, 2, axis=0))(np.arange(frames) / FPS)


def spread(bends: Array, counts: tuple[int, int, int]) -> tuple[Array, Array, Array]:
    """Log rotations [T, 3] for one joint of each part, given the joints per part; the eyes stay on the listener."""
    head = bends[:, 2] * [1.0, _HEAD_YAW, 1.0] - bends[:, 1] * [0.0, _EYES, 0.0]
    return bends[:, 0] / counts[0], bends[:, 1] / counts[1], head / counts[2]


def living_fingers(logs: Array, side: int) -> Array:
    """Log rotations [T, F, 3] (60 fps) of one hand's finger joints, limited, smoothed and with a slow fidget. side: 0
    left, 1 right."""
    joints = np.arange(logs.shape[1])
    times = np.arange(len(logs))[:, None] / FPS
    # The three joints of a finger move in phase; the fingers and the hands do not.
    period = _FINGER_SECONDS * (1.0 + 0.13 * (joints // 3))
    phase = 2.0 * np.pi * (times / period + 0.21 * (joints // 3) + 0.37 * side)
    smooth = gaussian_filter1d(soft_limit(logs, _FARTHEST_FINGER), _SMOOTH_FINGERS * FPS, axis=0, mode="nearest")
    more = np.where(joints % 3 == 1, _CASCADE[joints // 3], 0.0)
    return smooth + (more + _FINGER_FIDGET * np.sin(phase))[..., None] * _CLOSING[side]


def phrase_drives(phrases: Sequence[Phrase], syllables: Sequence[Syllable]) -> Array:
    """[phrases, 2] drives of height and reach, -1 to 1, from the effort and the pitch range of each phrase."""
    out = np.zeros((len(phrases), 2))
    voiced = [(s.vowel, s.pitch) for s in syllables if s.pitch != 0.0]
    if not len(phrases):
        return out
    times, pitch = np.array(voiced).reshape(-1, 2).T
    wide = np.full(len(phrases), np.nan)
    for k, phrase in enumerate(phrases):
        inside = pitch[(times >= phrase.start) & (times < phrase.end)]
        if len(inside) >= _FEWEST:
            wide[k] = inside.std()
    usual = np.nanmedian(wide) if np.isfinite(wide).any() else 0.0
    heard = np.clip((np.nan_to_num(wide, nan=usual) - usual) / _RANGE, -1.0, 1.0)
    effort = np.clip([phrase.effort for phrase in phrases], -1.0, 1.0)
    return np.clip(np.column_stack([effort, heard]) @ _DRIVES.T, -1.0, 1.0)


def carriage(figure: PerformerBody, phrases: Sequence[Phrase], syllables: Sequence[Syllable], frames: int, fps: float
             ) -> Array:
    """[2, T, A, 3] log rotations added to those of each arm while it is raised, at full strength."""
    out = np.zeros((2, frames, len(figure.arms[0]), 3))
    if not len(phrases):
        return out
    order = sorted(range(len(phrases)), key=lambda k: phrases[k].start)
    drives = phrase_drives(phrases, syllables)[order]
    middles = [0.5 * (phrases[k].start + phrases[k].end) for k in order]
    # Each frame takes the drive of the nearest phrase; the low pass leads from one to the next.
    edges = 0.5 * (np.array(middles[1:]) + np.array(middles[:-1]))
    nearest = np.searchsorted(edges, np.arange(frames) / fps)
    track = gaussian_filter1d(drives[nearest], _SETTLES * fps, axis=0, mode="nearest")
    for side in (0, 1):
        ways = _ways(figure, side)
        out[side][:, list(_TURNED)] = np.einsum("td,djk->tjk", track * [_HIGHER, _FARTHER], ways)
    return out


def _ways(figure: PerformerBody, side: int) -> Array:
    """[2, 2, 3] radians by which upper arm and forearm turn for each metre that the hand is to go up and out from the
    hips: of all such turns, the smallest."""
    joints = [figure.arms[side][k] for k in _TURNED]
    logs = np.repeat(figure.home[side][None], 1 + 3 * len(joints), axis=0)
    for k in range(3 * len(joints)):
        logs[1 + k, _TURNED[k // 3], k % 3] += _STEP
    rotations = np.repeat(figure.rest[None], len(logs), axis=0)
    arm = list(figure.arms[side])
    rotations[:, arm] = rotation.multiply(rotations[:, arm], rotation.from_exponential_map(logs))
    hand = kinematics.joint_positions(figure.skeleton, rotations)[:, figure.skeleton.index(SIDES[side] + "Hand")]
    change = (hand[1:] - hand[0]).T / _STEP
    outward = hand[0] * [1.0, 0.0, 1.0]
    wanted = np.stack([[0.0, 1.0, 0.0], outward / np.linalg.norm(outward)], axis=1)
    return (np.linalg.pinv(change, rcond=0.05) @ wanted).T.reshape(2, len(joints), 3)
