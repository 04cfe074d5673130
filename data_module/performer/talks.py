"""Talks made the other way round: a real person's motion first, and speech for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from data_module.motion import rotation
from data_module.motion.skeletons import CHARACTER, CHARACTERS, FINGERED, HIP_HEIGHT
from data_module.performer import inverse, movements
from data_module.performer.chaining import Chain, chain, seam_ratio
from data_module.performer.sentence_pool import Pool
from data_module.performer.takes import (
    FPS,
    HIPS,
    SKULL,
    SPINE,
    WRISTS,
    Library,
    MotionRange,
    RealTake,
    facing_positions,
    mirrored,
    stretches,
)
from data_module.performer.trunk import calm, kept_ahead, postures, sway
from data_module.performer.types import Spoken
from data_module.types import Array, Motion

_HEIGHTS, _TRUNKS, _SLOWER = (0.40, 0.66), (0.9, 1.3), (1.0, 1.3)
"""Bounds of what is drawn per talk: the hands' highest place (metres over the hips), the trunk's gain, and how many
times slower than it was recorded the motion is played."""
_SLOW_GROUP = "lesson"
"""Whoever does this moves slowly enough."""
_STRETCHES = 14
"""Stretches that a talk draws on; those of its group first."""
_CHAINS, _ROUGHEST = 6, 1.2
"""Chains that are tried until the acceleration at the seams is at most so many times that elsewhere."""
_DIP_SHARE, _DIPS = 0.6, (2.0, 5.0)
"""The share of vowels on beats that the head dips on, and by how many degrees."""
_DIP_RISE, _DIP_FALL, _DIP_LATE = 0.24, 0.4, 0.03
"""Seconds before the dip's deepest point, after it, and from the vowel to it."""
_WRIST_DRAG, _MOST_WRIST = 0.16, 20.0
"""Seconds, and degrees: a wrist lags behind the forearm's turning by what it turns in this time, up to that angle.
Half of the sources have stiff wrists."""
ENERGY = inverse.Energy(0.41, 0.66)
"""Of the mean log speed of the stretches of all takes (`inverse.log_speed`), as measured; the spread with 0.2 added, so
that a talk's own range counts more."""


@dataclass(frozen=True)
class MadeTalk:
    """Motion with the speech made for it. edges: seconds at which stretches begin; takes: the names of those used."""

    motion: Motion
    made: inverse.Made
    edges: Array
    takes: tuple[str, ...]


def talk_for_motion(name: str, library: Library, takes: Sequence[RealTake], group: str, pool: Pool, seconds: float,
                    rng: np.random.Generator) -> MadeTalk:
    """A talk of `seconds` by somebody of `group`, from the given takes alone, and speech for it from `pool`."""
    limits = MotionRange(float(rng.uniform(*_HEIGHTS)), float(rng.uniform(*_TRUNKS)))
    slower = 1.0 if group == _SLOW_GROUP else float(rng.uniform(*_SLOWER))
    named = _drawn(library, takes, group, limits, rng)
    mixed, flip = rng.random() < 1.0 / 3.0, rng.random() < 0.5
    pieces = []
    for _, logs in named:
        turned = bool(rng.random() < 0.5) if mixed else flip
        pieces.append(_slowed(mirrored(logs) if turned else logs, slower))
    joined, places = _smoothest(library, pieces, seconds, rng)
    made = inverse.speech_for(name, places, pool, ENERGY, movements.features_of(places), rng)
    logs = with_wrists(with_life(joined.logs, made.spoken, rng))
    rotations = library.rotations(logs)
    root = np.tile([0.0, HIP_HEIGHT, 0.0], (len(rotations), 1))
    used = tuple(sorted({named[k][0] for k in joined.used}))
    lacking = {joint for take in takes if take.name in used for joint in take.filled}
    motion = Motion(CHARACTERS[rotations.shape[1]], rotations, root, FPS,
                    filled=tuple(joint for joint in FINGERED.names if joint in lacking))
    return MadeTalk(motion, made, joined.edges, used)


def _smoothest(library: Library, pieces: Sequence[Array], seconds: float,
               rng: np.random.Generator) -> tuple[Chain, Array]:
    """A chain whose seams cannot be told from the rest, or the best of some, and its joints' positions [T, 16, 3]."""
    best: tuple[float, Chain, Array] | None = None
    for _ in range(_CHAINS):
        joined = chain(pieces, seconds, rng, recent=len(pieces))
        places = facing_positions(library.rotations(joined.logs))
        ratio = seam_ratio(places[:, list(WRISTS)], joined.edges)
        if best is None or ratio < best[0]:
            best = ratio, joined, places
        if ratio <= _ROUGHEST:
            break
    assert best is not None
    return best[1:]


def _drawn(library: Library, takes: Sequence[RealTake], group: str, limits: MotionRange,
           rng: np.random.Generator) -> list[tuple[str, Array]]:
    """(take, stretch) of takes of the group, in a random order, filled up with other takes."""
    order = [takes[k] for k in rng.permutation(len(takes))]
    out: list[tuple[str, Array]] = []
    for take in sorted(order, key=lambda t: t.group != group):
        if len(out) >= _STRETCHES:
            break
        out += [(take.name, logs) for logs in stretches(library, take, limits)]
    return out


def _slowed(logs: Array, times: float) -> Array:
    """Logs [T, J, 3] played so many times slower."""
    at = np.arange(0.0, len(logs) - 1, 1.0 / times)
    return rotation.unroll(rotation.to_exponential_map(rotation.interpolate(rotation.from_exponential_map(logs), at)))


def with_life(logs: Array, spoken: Spoken, rng: np.random.Generator) -> Array:
    """Logs [T, J, 3] whose head dips on stresses and is calmer in pauses, in postures that change now and then.

    A head that was laid on other speech is not tied to the voice; real heads are. 95 % of its yaw stays within 20
    degrees. The weight goes round, as a held pose of a real take would freeze.
    """
    out, frames = logs.copy(), len(logs)
    speaking = np.zeros(frames)
    for phrase in spoken.phrases:
        speaking[round(phrase.start * FPS):round(phrase.end * FPS)] = 1.0
    out[:, list(SKULL)] = calm(out[:, list(SKULL)], speaking)
    out[:, list(SKULL), 0] += (_dips(spoken, frames, rng) / len(SKULL))[:, None]
    posture = postures(frames, rng)
    weight = sway(frames, rng)
    for joints, bends in ((SPINE, posture[:, 0] + weight), (SKULL, posture[:, 1])):
        out[:, list(joints)] += (bends / len(joints))[:, None]
    trunk = [*HIPS, *SPINE, *SKULL]
    out[:, trunk, 1] *= kept_ahead(out[:, trunk, 1].sum(axis=1))
    return out


def _dips(spoken: Spoken, frames: int, rng: np.random.Generator) -> Array:
    """[T] radians forward: the head dips on stressed vowels."""
    track, times = np.zeros(frames), np.arange(frames) / FPS
    for syllable in spoken.syllables:
        if syllable.prominence > 0.3 and rng.random() < _DIP_SHARE:
            peak = syllable.vowel + _DIP_LATE
            size = np.radians(rng.uniform(*_DIPS))
            rising = np.clip((times - peak + _DIP_RISE) / _DIP_RISE, 0.0, 1.0)
            falling = np.clip((times - peak) / _DIP_FALL, 0.0, 1.0)
            track += size * (_step(rising) - _step(falling))
    return track


def _step(s: Array) -> Array:
    """The minimum-jerk way from 0 to 1."""
    return s ** 3 * (10.0 - 15.0 * s + 6.0 * s * s)


def with_wrists(logs: Array) -> Array:
    """Logs [T, J, 3] whose hands lag behind the bending of their forearms (wrists that real takes lack)."""
    out = logs.copy()
    for side in ("Left", "Right"):
        fore, hand = CHARACTER.index(side + "ForeArm"), CHARACTER.index(side + "Hand")
        velocity = np.gradient(gaussian_filter1d(logs[:, fore], 0.06 * FPS, axis=0), 1.0 / FPS, axis=0)
        # About the forearm's own axis (x) the hand goes with it.
        drag = -_WRIST_DRAG * velocity * np.array([0.0, 1.0, 1.0])
        limit = np.radians(_MOST_WRIST)
        out[:, hand] += limit * np.tanh(drag / limit)
    return out
