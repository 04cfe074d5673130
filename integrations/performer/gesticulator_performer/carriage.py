"""How high and how far out the hands are carried, by what is heard: vocal effort and pitch range of each phrase.

Without it a unit's height and reach depend on which strokes come, and on the manner of the talk, neither of which can
be heard: the gain of a stroke scales its rotations against the hanging arm, which bends the elbow as much as it raises
the hand. Here the arms are turned about the pose in front of the body so that the hands go straight up, or straight
out, by centimetres.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import gaussian_filter1d

from data_module.motion import kinematics, rotation
from data_module.types import Array
from gesticulator_performer.strokes import SIDES, PerformerBody
from gesticulator_performer.types import Phrase, Syllable

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
