"""Blocks: speech and motion cut at beats and brought to one length, and the way back (RG 4.2.2).

Block i covers (b_{i-1}, b_i]; its K-th frame lies on the beat b_i. In normalised time every block lasts d_max seconds.
Sound is stretched with its pitch kept; motion is interpolated as rotations.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field

import numpy as np

from data_module.errors import InputError
from data_module.motion.representation import ROTATIONS, Representation
from data_module.speech.beats import BeatSettings, find_beats
from data_module.speech.silence import silent_blocks
from data_module.types import Array, Blocks, Motion, Samples, Speech

METHODS = ("wsola", "phase_vocoder")
SMOOTHING = 0.05
"""Seconds: the standard deviation of the final Gaussian (one frame at 20 fps, RG 7.1.2)."""

_WINDOW, _HOP, _TOLERANCE = 0.032, 0.016, 0.008  # seconds: 512, 256 and 128 samples at 16 kHz
_CONTEXT = 0.032
_LONGEST_STRETCH = 3.0
_REACH = 2.0


@dataclass(frozen=True)
class BlockSettings:
    """How speech is cut. fps: frames per second of normalised time; a block has K = ceil(d_max x fps) of them."""

    beats: BeatSettings = field(default_factory=BeatSettings)
    fps: float = 20.0

    def __post_init__(self) -> None:
        if not 0 < self.fps < np.inf or self.frames < 2:
            raise InputError("fps", f"is {self.fps}, too few frames for a block of {self.beats.d_max} s", "give 20")

    @property
    def frames(self) -> int:
        """K, frames per block: no block is ever sampled down, because none lasts longer than d_max."""
        return math.ceil(self.beats.d_max * self.fps - 1e-9)


def cut(speech: Speech, settings: BlockSettings | None = None) -> Blocks:
    """Speech cut at its beats (RG 4.2.2)."""
    settings = settings or BlockSettings()
    beats = find_beats(speech, settings.beats)
    return Blocks(beats.times, beats.flags[1:], silent_blocks(speech, beats.times), settings.frames, settings.fps)


def samples_per_frame(sample_rate: int, fps: float) -> int:
    """Samples of stretched sound that belong to one normalised frame (800 at 16 kHz and 20 fps)."""
    return round(sample_rate / fps)


def stretch_speech(speech: Speech, blocks: Blocks, method: str = "wsola") -> Samples:
    """Each block's sound stretched to one length with its pitch kept, float32 [N, K * samples_per_frame].

    Every block is stretched by itself, with 32 ms of its neighbours on both sides, so its ends lie exactly on the
    beats and a stream gets the same samples; outside the recording there are zeros. Digital silence stays exactly
    zero. method: "wsola" or "phase_vocoder" (phases locked), both of pytsmod.
    """
    if method not in METHODS:
        raise InputError("method", f"is {method!r}", f"choose from {', '.join(METHODS)}")
    rate = speech.sample_rate
    length = blocks.frames * samples_per_frame(rate, blocks.fps)
    context = round(_CONTEXT * rate)
    padded = np.pad(speech.samples, (context, context + 1))
    edges = np.minimum(np.round(blocks.edges * rate).astype(int), len(speech.samples))
    out = np.zeros((len(blocks), length), np.float32)
    for block, (start, stop) in enumerate(itertools.pairwise(edges)):
        piece = padded[start:max(stop, start + 1) + 2 * context]
        inside = piece[context:-context]
        if inside.any():
            out[block] = _stretched(piece.astype(np.float64), context, length, rate, method)
            _keep_zeros(inside, out[block], round(_WINDOW * rate))
    return out


def _stretched(piece: Array, context: int, length: int, rate: int, method: str) -> Array:
    """The middle of `piece` (all but `context` samples at each end) brought to `length` samples."""
    inside = len(piece) - 2 * context
    if inside == length:  # at rate 1 WSOLA is not quite the identity
        return piece[context:-context]
    # One call stretches well up to about 3 times; only a whole recording shorter than d_min needs more.
    step = min(length, math.ceil(inside * _LONGEST_STRETCH))
    # pytsmod wants integers that rise strictly, from the first sample to the last.
    anchors = np.array([[0, context, context + inside, len(piece) - 1],
                        [0, context, context + step, step + 2 * context - 1]])
    out = _time_scale(piece, anchors, rate, method)
    if step < length:
        return _stretched(out, context, length, rate, method)
    return out[context:context + length]


def _time_scale(piece: Array, anchors: Array, rate: int, method: str) -> Array:
    import pytsmod

    window, hop = round(_WINDOW * rate), round(_HOP * rate)
    if method == "wsola":
        out = pytsmod.wsola(piece, anchors, win_size=window, syn_hop_size=hop, tolerance=round(_TOLERANCE * rate))
    else:
        out = pytsmod.phase_vocoder(piece, anchors, win_size=window, syn_hop_size=window // 4, phase_lock=True)
    return np.asarray(out, dtype=np.float64)


def _keep_zeros(inside: Samples, out: Samples, shortest: int) -> None:
    """Set to zero what `out` has where `inside` holds `shortest` or more zeros in a row: overlap-add smears them."""
    if np.count_nonzero(inside) > len(inside) - shortest:
        return
    ends = np.flatnonzero(np.diff(inside == 0, prepend=False, append=False)).reshape(-1, 2)
    scale = len(out) / len(inside)
    for start, stop in ends[ends[:, 1] - ends[:, 0] >= shortest]:
        out[math.ceil(start * scale):math.floor(stop * scale)] = 0.0


def windows_of(stretched: Samples) -> Samples:
    """Previous, current and next block of each block, [N, 3 * L] for stretched speech [N, L].

    Before the first block and after the last there are zeros. The result is a read-only view: it costs the memory of
    one copy of `stretched`, not of three.
    """
    count, length = stretched.shape
    flat = np.concatenate([np.zeros(length, stretched.dtype), stretched.ravel(), np.zeros(length, stretched.dtype)])
    return np.lib.stride_tricks.sliding_window_view(flat, 3 * length)[::length][:count]


def normalise_motion(motion: Motion, blocks: Blocks, representation: Representation = ROTATIONS) -> Array:
    """Motion of the character at the frames of the blocks, [N, K, D_m] in this representation.

    Yaw and translation of the root are removed and the motion is sampled at `Blocks.knot_times`. Rotations are
    interpolated on the sphere and unrolled over time, from the pose at time 0 on (`first_pose`); positions along
    straight lines. Past its end the motion holds its last pose.
    """
    vectors = representation.vectors(motion, np.concatenate([[0.0], blocks.knot_times]))
    return vectors[1:].reshape(len(blocks), blocks.frames, -1)


def first_pose(motion: Motion, representation: Representation = ROTATIONS) -> Array:
    """The pose at time 0, [D_m] in this representation: the knot before the first block."""
    return representation.vectors(motion, np.zeros(1))[0]


def denormalise(knots: Array, first: Array, blocks: Blocks, fps: float, smooth_over: float = SMOOTHING) -> Array:
    """Normalised frames back on the recording's clock at any rate: [T, D] with frame n at n / fps seconds.

    knots: [N, K, D] or [N * K, D], the inverse of `normalise_motion`; first: [D] the pose at time 0. There are
    T = max(1, round(duration x fps)) frames. Between knots runs a cubic that is exact at the knots, with a continuous
    velocity, and needs two knots on either side only, so a stream can follow. smooth_over: seconds, see `smooth`;
    0 leaves the cubic as it is.
    """
    values = np.concatenate([np.asarray(first)[None], np.asarray(knots).reshape(-1, len(first))])
    times = np.concatenate([[blocks.edges[0]], blocks.knot_times])
    if len(values) != len(times):
        raise ValueError(f"{len(values) - 1} knots for {len(blocks)} blocks of {blocks.frames} frames")
    count = max(1, round((blocks.edges[-1] - blocks.edges[0]) * fps))
    frames = hermite(times, values, blocks.edges[0] + np.arange(count) / fps)
    return smooth(frames, fps, smooth_over) if smooth_over > 0 else frames


def hermite(times: Array, values: Array, at: Array) -> Array:
    """Cubic Hermite interpolation of values [M, D] at rising times [M], at the times `at` [T] (clamped): [T, D].

    The slope at a knot is that of the parabola through it and its two neighbours (at the ends, of the line): local,
    exact for parabolas, right for uneven knots.
    """
    steps = np.diff(times)[:, None]
    lines = np.diff(values, axis=0) / steps
    slopes = np.concatenate([
        lines[:1], (lines[:-1] * steps[1:] + lines[1:] * steps[:-1]) / (steps[1:] + steps[:-1]), lines[-1:]])
    x = np.clip(at, times[0], times[-1])
    left = np.clip(np.searchsorted(times, x, side="right") - 1, 0, len(times) - 2)
    width = steps[left]
    u = (x[:, None] - times[left][:, None]) / width
    rest = 1.0 - u
    return (rest * rest * (1.0 + 2.0 * u) * values[left] + u * u * (3.0 - 2.0 * u) * values[left + 1]
            + width * u * rest * (rest * slopes[left] - u * slopes[left + 1]))


def smooth(frames: Array, fps: float, sigma: float = SMOOTHING) -> Array:
    """Gaussian smoothing along time of [T, D] (RG 7.1.2: five taps at 20 fps).

    sigma: seconds; the kernel ends at two sigma on both sides, whatever the rate. At the ends the motion is mirrored
    about its first and last frame.
    """
    from scipy.ndimage import correlate1d

    half = int(_REACH * sigma * fps + 1e-9)
    if half < 1 or len(frames) < 2:
        return np.array(frames)
    weights = np.exp(-0.5 * (np.arange(-half, half + 1) / (sigma * fps)) ** 2)
    return correlate1d(frames, weights / weights.sum(), axis=0, mode="mirror")
