"""Talks of a real person's motion, joined where pose and velocity agree best, with speech synthesised for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks

from data_module.motion import rotation
from data_module.motion.kinematics import minimum_jerk
from data_module.motion.skeletons import CHARACTER, CHARACTERS, FINGERED, HIP_HEIGHT
from data_module.types import Array, Motion
from gesticulator_performer import inverse
from gesticulator_performer import takes as real
from gesticulator_performer.inverse import Pool
from gesticulator_performer.joints import FPS, facing_positions
from gesticulator_performer.syllables import Spoken
from gesticulator_performer.takes import Library, MotionRange, RealTake
from gesticulator_performer.trunk import calm, pitch_accents, postures, quintic_offset, sway, yaw_scale

# Seconds: a difference in velocity costs as much as the difference in pose that it makes in this time.
_VELOCITY = 0.12
# Frames between the candidate places at which a stretch may be left or entered.
_STEP = 3
# A stretch is left in the last 35 % and entered in the first 40 % of its length.
_LEAVE, _ENTER = 0.35, 0.4
# Least seconds of a stretch that are played.
_LEAST = 2.0
# The next stretch is drawn at random from this many with the lowest cost.
_BEST = 3
# Seconds over which the offset at a seam fades, for close poses and for distant ones.
_FADE, _LONGEST_FADE = 0.45, 0.9
# Square root of the cost at which the longest fade is used (weighted radians).
_FAR = 3.0
# Weights of the joints in the cost of a seam.
_WEIGHTS = np.array([{"Hips": 0.7, "LeftArm": 2.0, "RightArm": 2.0, "LeftForeArm": 1.5, "RightForeArm": 1.5,
                      "LeftHand": 0.3, "RightHand": 0.3}.get(name, 1.0) for name in CHARACTER.names])
# Ranges drawn per talk: the highest position of the hands (metres over the hips), the gain of the trunk, and the factor
# by which the motion is slowed down.
_HEIGHTS, _TRUNKS, _SLOWER = (0.40, 0.66), (0.9, 1.3), (1.0, 1.3)
# Share of the stretches whose hands do the same that are played with one hand; the correlation of the hands' heights
# from which they do; and the share of its motion that remains in the arm that rests.
_ONE_HANDED, _ALIKE, _RESTING = 0.2, 0.6, 0.4
# A group whose motion is slow enough already.
_SLOW_GROUP = "lesson"
# Stretches that a talk draws on; those of its group first.
_STRETCHES = 14
# Most chains that are tried, and the ratio of the acceleration at the seams to that elsewhere that is good enough.
_CHAINS, _ROUGHEST = 8, 1.15
# Share of the stressed vowels on which the head dips, and the range of the dip in degrees.
_DIP_SHARE, _DIPS = 0.6, (2.0, 5.0)
# Seconds from the start to the deepest point of a dip, from there to its end, and from the vowel to the deepest point.
_DIP_RISE, _DIP_FALL, _DIP_LATE = 0.24, 0.4, 0.03
# Share of the moments in which a raised hand is slow that become holds; seconds that a hold takes with its edges; and
# the seconds of motion that are shown in them.
_HOLD_SHARE, _HOLD_SECONDS, _HOLD_OF = 0.3, (0.5, 0.9), 0.24
# Seconds between such moments at least; the speed below which a hand may be held, m/s; metres over the hips.
_HOLDS_APART, _HELD_FROM, _RAISED = 0.9, 0.45, 0.06
# Point near the chest that a hand moves to for "me", metres from the hips.
_HEART = np.array([0.0, 0.38, 0.12])
# Least height over the hips, metres, of a hand that counts as raised.
_GESTURING = 0.05


@dataclass(frozen=True)
class Chain:
    """A talk made of stretches. logs: [T, J, 3]; edges: [K + 1] seconds at which stretches begin, and the end;
    used: [K] indices of the stretches."""

    logs: Array
    edges: Array
    used: tuple[int, ...]


def chain(stretches: Sequence[Array], seconds: float, rng: np.random.Generator, recent: int = 6) -> Chain:
    """Join stretches [T, J, 3] at 60 fps until `seconds` are filled, without repeating any of the last `recent`. Each
    seam is at the two places where pose and velocity are nearest; the remaining offset fades by a quintic. ValueError
    with fewer than two stretches."""
    if len(stretches) < 2:
        raise ValueError("a chain needs two stretches at least")
    recent = min(recent, len(stretches) - 1)
    features = [_features(logs) for logs in stretches]
    now, start = int(rng.integers(len(stretches))), 3
    out = np.zeros((0, *stretches[0].shape[1:]))
    used, edges, fade = [now], [0.0], 0.0
    while True:
        leave, following, enter, cost = _next(stretches, features, used[-recent:], now, start, rng)
        out = _joined(out, stretches[now], start, leave, fade)
        if len(out) >= seconds * FPS:
            break
        edges.append(len(out) / FPS)
        used.append(following)
        now, start = following, enter
        fade = _FADE + (_LONGEST_FADE - _FADE) * min(1.0, float(np.sqrt(cost)) / _FAR)
    frames = round(seconds * FPS)
    return Chain(out[:frames], np.array([*edges, frames / FPS]), tuple(used))


def _features(logs: Array) -> Array:
    """[T, 96] weighted poses and velocities, fingers left out; the cost of a seam is the squared distance of two rows.
    """
    logs = logs[:, :len(_WEIGHTS)]
    velocity = np.gradient(logs, 1.0 / FPS, axis=0) * _VELOCITY
    both = np.concatenate([logs * _WEIGHTS[:, None], velocity * _WEIGHTS[:, None]], axis=1)
    return both.reshape(len(logs), -1)


def _next(stretches: Sequence[Array], features: Sequence[Array], recent: Sequence[int], now: int, start: int,
          rng: np.random.Generator) -> tuple[int, int, int, float]:
    """(frame at which to leave `now`, next stretch, frame at which to enter it, cost of the seam)."""
    length = len(stretches[now])
    first = min(max(start + round(_LEAST * FPS), round(length * (1.0 - _LEAVE))), length - 2)
    ends = np.arange(first, length - 1, _STEP)
    options: list[tuple[float, int, int, int]] = []
    for k, logs in enumerate(stretches):
        if k in recent:
            continue
        last = max(4, min(round(len(logs) * _ENTER), len(logs) - round(_LEAST * FPS) - 10))
        starts = np.arange(3, last, _STEP)
        gap = features[now][ends][:, None] - features[k][starts][None]
        cost = np.einsum("ijk,ijk->ij", gap, gap)
        a, b = np.unravel_index(int(cost.argmin()), cost.shape)
        options.append((float(cost[a, b]), k, int(ends[a]), int(starts[b])))
    options.sort()
    cost_of, k, leave, enter = options[int(rng.integers(min(_BEST, len(options))))]
    return leave, k, enter, cost_of


def _joined(out: Array, logs: Array, start: int, leave: int, fade: float) -> Array:
    piece = logs[start:leave + 1].copy()
    if len(out) >= 3:
        times = np.arange(len(piece)) / FPS
        offset = quintic_offset(out[-3:].reshape(3, -1), logs[start - 3:start].reshape(3, -1), times, fade, FPS)
        piece += offset.reshape(piece.shape)
    return np.concatenate([out, piece])


def seam_ratio(hands: Array, edges: Array) -> float:
    """Mean acceleration of the faster hand within two frames of the inner edges (seconds), divided by that elsewhere.
    hands: [T, 2, 3] metres at 60 fps. 1 without an inner edge."""
    acceleration = np.linalg.norm(np.diff(hands, 2, axis=0), axis=-1).max(axis=1)
    at = np.round(edges[1:-1] * FPS).astype(int)
    at = at[(at > 2) & (at < len(acceleration) - 3)]
    near = np.zeros(len(acceleration), dtype=bool)
    near[(at[:, None] + np.arange(-2, 2)).ravel()] = True
    if not near.any() or near.all():
        return 1.0
    return float(acceleration[near].mean() / max(acceleration[~near].mean(), 1e-9))


def talk_for_motion(group: str, seconds: float, library: Library, takes: Sequence[RealTake], pool: Pool,
                    rng: np.random.Generator) -> tuple[Motion, Spoken, tuple[str, ...]]:
    """A talk from the given takes alone, with speech for it from `pool`, and the names of the takes used. group: its
    manner, a key of `takes.GROUPS`."""
    limits = MotionRange(float(rng.uniform(*_HEIGHTS)), float(rng.uniform(*_TRUNKS)))
    slower = 1.0 if group == _SLOW_GROUP else float(rng.uniform(*_SLOWER))
    named = _named_stretches(library, takes, group, limits, rng)
    mixed, flip = rng.random() < 1.0 / 3.0, rng.random() < 0.5
    pieces = []
    for _, logs in named:
        turned = bool(rng.random() < 0.5) if mixed else flip
        pieces.append(_slowed(_one_handed(library, real.mirrored(logs) if turned else logs, rng), slower))
    joined, places = _smoothest(library, pieces, seconds, rng)
    spoken = inverse.speech_for(places, pool, features_of(places), rng)
    logs = with_life(joined.logs, spoken, rng)
    rotations = library.rotations(logs)
    root = np.tile([0.0, HIP_HEIGHT, 0.0], (len(rotations), 1))
    used = tuple(sorted({named[k][0] for k in joined.used}))
    lacking = {joint for take in takes if take.name in used for joint in take.filled}
    motion = Motion(CHARACTERS[rotations.shape[1]], rotations, root, FPS,
                    filled=tuple(joint for joint in FINGERED.names if joint in lacking))
    return motion, spoken, used


def features_of(places: Array) -> Array:
    """[T, 7] z-scores, clipped to [-2, 2.5], of the features in `cues.MOVEMENTS`, from facing positions [T, 16, 3].
    """
    left, right = (places[:, wrist] for wrist in real.WRISTS)
    apart = np.linalg.norm(right - left, axis=1)
    up = np.maximum(left[:, 1], right[:, 1]) > _GESTURING
    near = -np.minimum(np.linalg.norm(left - _HEART, axis=1), np.linalg.norm(right - _HEART, axis=1))
    ahead = np.maximum(left[:, 2], right[:, 2])
    side = 0.5 * (left[:, 0] + right[:, 0])
    across = sum(np.abs(np.gradient(gaussian_filter1d(hand[:, 0], 0.05 * FPS))) for hand in (left, right))
    sideways = gaussian_filter1d(across, 0.17 * FPS)
    raw = np.stack([apart * up, -apart * up, near, ahead, side, -side, sideways], axis=1)
    return np.clip((raw - raw.mean(axis=0)) / (raw.std(axis=0) + 1e-6), -2.0, 2.5)


def _smoothest(library: Library, pieces: Sequence[Array], seconds: float,
               rng: np.random.Generator) -> tuple[Chain, Array]:
    """The first chain, with holds, whose seams are smooth enough, or the smoothest, and its joint positions
    [T, 16, 3]."""
    best: tuple[float, Chain, Array] | None = None
    for _ in range(_CHAINS):
        joined = chain(pieces, seconds, rng, recent=len(pieces))
        joined, places = _held(library, joined, facing_positions(library.rotations(joined.logs)), rng)
        ratio = seam_ratio(places[:, list(real.WRISTS)], joined.edges)
        if best is None or ratio < best[0]:
            best = ratio, joined, places
        if ratio <= _ROUGHEST:
            break
    assert best is not None
    return best[1:]


def _held(library: Library, joined: Chain, places: Array, rng: np.random.Generator) -> tuple[Chain, Array]:
    """A chain of the same length with holds: at some of the moments at which a raised hand is slowest, time stands."""
    source = hold_times(places, rng)[:len(joined.logs)]
    logs = rotation.unroll(rotation.to_exponential_map(
        rotation.interpolate(rotation.from_exponential_map(joined.logs), source)))
    edges = np.interp(joined.edges * FPS, source, np.arange(len(source))) / FPS
    edges = np.append(np.unique(edges[edges < (len(source) - 1) / FPS]), len(source) / FPS)
    return Chain(logs, edges, joined.used), facing_positions(library.rotations(logs))


def hold_times(places: Array, rng: np.random.Generator) -> Array:
    """[T'] the frame of a motion with joint positions [T, 16, 3] that is shown in each frame when holds are inserted.

    A hold begins where the speed of a raised hand has a minimum. For D seconds the pace is 1 - c h(u) at the share u
    of them, with h rising and falling as sin^2 over a quarter each and c such that D seconds show `_HOLD_OF`.
    """
    hands = gaussian_filter1d(places[:, list(real.WRISTS)], 0.05 * FPS, axis=0, mode="nearest")
    speed = np.linalg.norm(np.gradient(hands, 1.0 / FPS, axis=0), axis=-1).max(axis=1)
    minima = find_peaks(-speed, distance=round(_HOLDS_APART * FPS), prominence=0.1)[0]
    raised = hands[minima, :, 1].max(axis=1) >= _RAISED
    chosen = minima[raised & (speed[minima] < _HELD_FROM) & (rng.random(len(minima)) < _HOLD_SHARE)]
    pieces, now, half = [], 0.0, 0.5 * _HOLD_OF * FPS
    for frame, seconds in zip(chosen.tolist(), rng.uniform(*_HOLD_SECONDS, len(chosen)), strict=True):
        if frame - half <= now or frame + half >= len(places) - 1:
            continue
        pieces.append(np.arange(now, frame - half))
        u = np.linspace(0.0, 1.0, max(2, round(seconds * FPS)), endpoint=False)
        dip = np.sin(0.5 * np.pi * np.clip(4.0 * np.minimum(u, 1.0 - u), 0.0, 1.0)) ** 2
        pace = 1.0 - (1.0 - _HOLD_OF / seconds) / dip.mean() * dip
        start = pieces[-1][-1] + 1.0
        pieces.append(start + np.concatenate([[0.0], np.cumsum(pace)[:-1]]))
        now = float(pieces[-1][-1] + pace[-1])
    pieces.append(np.arange(now, len(places) - 1))
    return np.concatenate(pieces)


def _named_stretches(library: Library, takes: Sequence[RealTake], group: str, limits: MotionRange,
                     rng: np.random.Generator) -> list[tuple[str, Array]]:
    """(take, stretch) of takes of the group in random order, filled up with other takes."""
    order = [takes[k] for k in rng.permutation(len(takes))]
    out: list[tuple[str, Array]] = []
    for take in sorted(order, key=lambda t: t.group != group):
        if len(out) >= _STRETCHES:
            break
        out += [(take.name, logs) for logs in real.stretches(library, take, limits)]
    return out


def _one_handed(library: Library, logs: Array, rng: np.random.Generator) -> Array:
    """A stretch whose hands do the same, now and then with one of them resting; any other as it is."""
    side, draw = real.ARM_SIDES[int(rng.random() < 0.5)], rng.random()
    heights = facing_positions(library.rotations(logs))[:, list(real.WRISTS), 1]
    alike = np.asarray(np.corrcoef(heights.T))[0, 1] if heights.std(axis=0).min() > 1e-6 else 0.0
    if draw >= _ONE_HANDED or alike < _ALIKE:
        return logs
    out = logs.copy()
    out[:, list(side)] *= _RESTING
    return out


def _slowed(logs: Array, times: float) -> Array:
    at = np.arange(0.0, len(logs) - 1, 1.0 / times)
    return rotation.unroll(rotation.to_exponential_map(rotation.interpolate(rotation.from_exponential_map(logs), at)))


def with_life(logs: Array, spoken: Spoken, rng: np.random.Generator) -> Array:
    """Add life to logs [T, J, 3]: the head dips on stresses, the trunk calms in pauses, and postures change. The
    recorded head motion is not tied to the new speech, real heads are. The yaw of the head stays within 20 degrees in
    95 % of the frames. The body sways, so that held poses do not freeze."""
    out, frames = logs.copy(), len(logs)
    speaking = np.zeros(frames)
    for phrase in spoken.phrases:
        speaking[round(phrase.start * FPS):round(phrase.end * FPS)] = 1.0
    out[:, list(real.SKULL)] = calm(out[:, list(real.SKULL)], speaking)
    out[:, list(real.SKULL), 0] += (_dips(spoken, frames, rng) / len(real.SKULL))[:, None]
    posture = postures(frames, rng)
    weight = sway(frames, rng) + pitch_accents(spoken.syllables, frames, rng)
    for joints, bends in ((real.SPINE, posture[:, 0] + weight), (real.SKULL, posture[:, 1])):
        out[:, list(joints)] += (bends / len(joints))[:, None]
    trunk = [*real.HIPS, *real.SPINE, *real.SKULL]
    out[:, trunk, 1] *= yaw_scale(out[:, trunk, 1].sum(axis=1))
    return out


def _dips(spoken: Spoken, frames: int, rng: np.random.Generator) -> Array:
    track, times = np.zeros(frames), np.arange(frames) / FPS
    for syllable in spoken.syllables:
        if syllable.prominence > 0.3 and rng.random() < _DIP_SHARE:
            peak = syllable.vowel + _DIP_LATE
            size = np.radians(rng.uniform(*_DIPS))
            rising = np.clip((times - peak + _DIP_RISE) / _DIP_RISE, 0.0, 1.0)
            falling = np.clip((times - peak) / _DIP_FALL, 0.0, 1.0)
            track += size * (minimum_jerk(rising) - minimum_jerk(falling))
    return track
