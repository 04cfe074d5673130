"""Blocks: speech and motion cut at beats and normalised to one length, and the inverse (RG 4.2.2).

Block i covers (b_{i-1}, b_i]; its K-th frame lies on the beat b_i. In normalised time every block lasts d_max seconds.
Sound is stretched with its pitch kept; motion is interpolated as rotations.
"""

import itertools
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.motion.representation import ROTATIONS, Representation
from data_module.speech.beats import BeatSettings, find_beats
from data_module.speech.silence import silent_blocks
from data_module.types import Array, Blocks, Motion, Samples, Speech

__all__ = ["BlockSettings", "cut", "denormalise", "normalise_motion", "stretch_speech"]

SMOOTHING = 0.05
"""Standard deviation of the final Gaussian, seconds (one frame at 20 fps, RG 7.1.2)."""

CONTEXT = 0.032
"""Sound before and after a block that is included when it is stretched, seconds."""

_WINDOW, _HOP, _TOLERANCE = 0.032, 0.016, 0.008  # seconds: 512, 256 and 128 samples at 16 kHz
_LONGEST_STRETCH = 3.0
_REACH = 2.0


@dataclass(frozen=True)
class BlockSettings:
    """Settings of the cut. fps: frames per second of normalised time; a block has K = ceil(d_max x fps) frames."""

    beats: BeatSettings = field(default_factory=BeatSettings)
    fps: float = 20.0

    def __post_init__(self) -> None:
        if not 0 < self.fps < np.inf or self.frames < 2:
            raise InputError("fps", f"is {self.fps}, too few frames for a block of {self.beats.d_max} s", "give 20")

    @property
    def frames(self) -> int:
        """K, frames per block: no block is downsampled, because none is longer than d_max."""
        return math.ceil(self.beats.d_max * self.fps - 1e-9)


def cut(speech: Speech, settings: BlockSettings | None = None) -> Blocks:
    """Find the beats of a speech and cut it into blocks there."""
    settings = settings or BlockSettings()
    beats = find_beats(speech, settings.beats)
    return Blocks(beats.times, beats.flags[1:], silent_blocks(speech, beats.times), settings.frames, settings.fps)


def samples_per_frame(sample_rate: int, fps: float) -> int:
    return round(sample_rate / fps)


def stretch_speech(speech: Speech, blocks: Blocks) -> Samples:
    """Each block's sound stretched to one length with its pitch kept, float32 [N, K * samples_per_frame].

    Every block is stretched separately, with 32 ms of its neighbours (or of zeros) on both sides, so that its ends are
    exactly at the beats and a stream gives the same samples. Digital silence stays exactly zero.
    """
    rate = speech.sample_rate
    length = blocks.frames * samples_per_frame(rate, blocks.fps)
    context = round(CONTEXT * rate)
    padded = np.pad(speech.samples, (context, context + 1))
    # Rounding at the last edge must not reach past the end of the samples.
    edges = np.minimum(np.round(blocks.edges * rate).astype(int), len(speech.samples))
    return np.stack([stretch_piece(padded[start:max(stop, start + 1) + 2 * context], length, rate)
                     for start, stop in itertools.pairwise(edges)])


def stretch_piece(piece: Samples, length: int, rate: int) -> Samples:
    """One block's sound, with `CONTEXT` seconds on both sides, stretched to [length] samples; see `stretch_speech`."""
    context = round(CONTEXT * rate)
    out, inside = np.zeros(length, np.float32), piece[context:-context]
    if inside.any():
        # WSOLA compares single samples, for which float32 is enough, in little more than half the time.
        out[:] = _stretched(piece, context, length, rate)
        _keep_zeros(inside, out, round(_WINDOW * rate))
    return out


def _linear(x: Array, y: Array, fill_value: str) -> Callable[[Array], Array]:
    """scipy's `interp1d` as pytsmod calls it: the values at `x` are `y`, and beyond its ends the lines go on."""
    def at(new: Array) -> Array:
        high = np.clip(np.searchsorted(x, new), 1, len(x) - 1)
        slope = (y[high] - y[high - 1]) / (x[high] - x[high - 1])
        return slope * (new - x[high - 1]) + y[high - 1]

    return at


def _import_wsola() -> Callable[..., Array]:
    """`pytsmod.wsola` with `_linear` in place of scipy's linear interpolation, whose import would be an eighth of the
    time of a short recording and a third of its memory."""
    light = SimpleNamespace(interp1d=_linear, median_filter=None)
    used = ("scipy.interpolate", "scipy.ndimage", "pytsmod")
    whole = {name: sys.modules.pop(name) for name in [*sys.modules] if name.startswith(used)}
    sys.modules.update(dict.fromkeys(used[:2], light))  # type: ignore[arg-type]
    try:
        from pytsmod.wsolatsm import wsola
    finally:
        # Others that import these get them whole.
        for name in [name for name in sys.modules if name.startswith(used)]:
            del sys.modules[name]
        sys.modules.update(whole)
    return wsola


_WSOLA = _import_wsola()


def _stretched(piece: Array | Samples, context: int, length: int, rate: int) -> Array | Samples:
    inside = len(piece) - 2 * context
    if inside == length:  # at rate 1 WSOLA is not quite the identity
        return piece[context:-context]
    # One call is accurate up to a factor of 3; only a whole recording shorter than d_min needs more.
    step = min(length, math.ceil(inside * _LONGEST_STRETCH))
    # pytsmod needs strictly rising integers, from the first sample to the last.
    anchors = np.array([[0, context, context + inside, len(piece) - 1],
                        [0, context, context + step, step + 2 * context - 1]])
    window, hop, tolerance = (round(seconds * rate) for seconds in (_WINDOW, _HOP, _TOLERANCE))
    out = np.asarray(_WSOLA(piece, anchors, win_size=window, syn_hop_size=hop, tolerance=tolerance), np.float64)
    if step < length:
        return _stretched(out, context, length, rate)
    return out[context:context + length]


def _keep_zeros(inside: Samples, out: Samples, shortest: int) -> None:
    """Zero `out` where `inside` has at least `shortest` zeros in a row, which overlap-add smears."""
    if np.count_nonzero(inside) > len(inside) - shortest:
        return
    ends = np.flatnonzero(np.diff(inside == 0, prepend=False, append=False)).reshape(-1, 2)
    scale = len(out) / len(inside)
    for start, stop in ends[ends[:, 1] - ends[:, 0] >= shortest]:
        out[math.ceil(start * scale):math.floor(stop * scale)] = 0.0


def windows_of(stretched: Samples) -> Samples:
    """Previous, current and next block of each block, [N, 3 * L] for stretched speech [N, L]. Before the first block
    and after the last there are zeros. The result is a read-only view: it costs the memory of one copy of `stretched`,
    not of three."""
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
    velocity, and needs two knots on either side only, so a stream can follow. smooth_over: seconds, the deviation of
    the Gaussian that smooths the frames (RG 7.1.2: five taps at 20 fps); it ends at two deviations. Before the first
    frame the motion is mirrored in time, so that it begins at rest; after the last one in time and space, so that
    motion that is cut off does not stop. 0 leaves the cubic as it is.
    """
    if np.size(knots) != len(blocks) * blocks.frames * len(first):
        raise ValueError(f"{np.size(knots) // len(first)} knots for {len(blocks)} blocks of {blocks.frames} frames")
    # By block, as in a stream, so that a file and a stream give the same bits.
    # Knots are [N, K, D] from models and [N * K, D] from files.
    values = np.asarray(knots).reshape(len(blocks), blocks.frames, -1)
    path = KnotPath(first, fps, smooth_over)
    times = blocks.knot_times.reshape(len(blocks), -1) - blocks.edges[0]
    parts = [path.push(at, block) for at, block in zip(times, values, strict=True)]
    return np.concatenate([*parts, path.finish(float(blocks.edges[-1] - blocks.edges[0]))])


class KnotPath:
    """Streaming `denormalise`, block by block. A frame is returned when it no longer depends on future knots: two knots
    and half the smoothing kernel beyond it are known. With `prompt` the slope at the newest knot is that of the line to
    it, so that one knot is sufficient. `prompt` may change between knots: no frame is repeated or left out, and the
    path and its slope stay continuous."""

    def __init__(self, first: Array, fps: float, smooth_over: float = SMOOTHING, prompt: bool = False) -> None:
        """first: [D] the pose at time 0; fps, smooth_over: see `denormalise`."""
        self.fps, self.prompt = fps, prompt
        self.next = 0
        """Number of the next frame to return."""
        self._sigma, self._half = smooth_over, half_of(fps, smooth_over)
        self._times, self._values = np.zeros(1), np.array(first, dtype=np.float64)[None]
        self._slopes = np.zeros_like(self._values)
        self._settled = prompt
        """Whether the slope at the newest knot is final, because frames up to it were returned."""

    @property
    def reach(self) -> float:
        """Half of the smoothing kernel, seconds."""
        return self._half / self.fps

    def push(self, times: Array, values: Array, until: int | None = None) -> Array:
        """[T, D] the frames that are certain after more knots [K, D] at rising `times` [K], seconds, up to number
        `until`."""
        known = len(self._times)
        self._times, self._values = np.concatenate([self._times, times]), np.concatenate([self._values, values])
        # The slope at the last knot was that of the line to it, without a knot beyond.
        keep = known if self._settled and known > 1 else known - 1
        self._settled = self.prompt
        near = max(keep - 1, 0)
        more = slopes(self._times[near:], self._values[near:])[keep - near:]
        self._slopes = np.concatenate([self._slopes[:keep], more])
        if len(self._times) < 2:
            return self._values[:0]
        # The slope at the newest knot depends on the next one, so the path is certain up to the knot before.
        limit = self._times[-1] if self.prompt else self._times[-2]
        # Frames before the limit and the last knot, at which the recording may end, less what later knots reach.
        certain = min(math.ceil(float(limit) * self.fps - 1e-9), round(float(self._times[-1]) * self.fps))
        certain -= round(self.reach * self.fps)
        return self._given(max(certain if until is None else min(certain, until), self.next))

    def finish(self, duration: float) -> Array:
        """[T, D] the remaining frames of a recording of `duration` seconds."""
        count = max(1, round(duration * self.fps))
        return self._given(count, count)

    def frames(self, first: int, last: int, count: int | None = None) -> Array:
        """[T, D] the frames from `first` to before `last` again, if the knots around them are still stored. count: of
        all frames, where that is known."""
        return self._frames(np.arange(first, last), count)

    def rewind(self, times: Array, values: Array, first: int) -> None:
        """Go back to frame `first`: `values` are the knots [M, D], at least two, up to the one after which the path
        changes, whose position is unchanged."""
        self._times, self._values, self.next = times, np.array(values, dtype=np.float64), first
        self._slopes, self._settled = slopes(self._times, self._values), self.prompt

    def _given(self, until: int, count: int | None = None) -> Array:
        out = self._frames(np.arange(self.next, until), count)
        self.next = max(until, self.next)
        # Keep two knots before the first one in reach of the next frame's kernel, and some for a longer one.
        old = int(np.searchsorted(self._times, (self.next - self._half) / self.fps, side="right")) - 12
        if old > 0:
            self._times, self._values, self._slopes = self._times[old:], self._values[old:], self._slopes[old:]
        return out

    def _frames(self, numbers: NDArray[np.int64], count: int | None = None) -> Array:
        if len(numbers) == 0:
            return self._values[:0]
        half = 0 if count == 1 else self._half
        at = np.arange(numbers[0] - half, numbers[-1] + half + 1)
        frames = hermite(self._times, self._values, (np.abs(at) if count is None else _mirrored(at, count)) / self.fps,
                         self._slopes)
        if count is not None and at[-1] >= count:
            last = hermite(self._times, self._values, np.array([(count - 1) / self.fps]), self._slopes)
            frames[at >= count] = 2.0 * last - frames[at >= count]
        return smooth(frames, self.fps, self._sigma)[half:len(at) - half] if half else frames


def slopes(times: Array, values: Array) -> Array:
    """[M, D] slopes at knots [M, D]: of the parabola through a knot and its neighbours (of the line at the ends); zero
    for a single knot."""
    if len(times) < 2:
        return np.zeros_like(values)
    steps = np.diff(times)[:, None]
    lines = np.diff(values, axis=0) / steps
    return np.concatenate([
        lines[:1], (lines[:-1] * steps[1:] + lines[1:] * steps[:-1]) / (steps[1:] + steps[:-1]), lines[-1:]])


def hermite(times: Array, values: Array, at: Array, slope: Array | None = None) -> Array:
    """Cubic Hermite interpolation of values [M, D] at rising times [M], at the times `at` [T] (clamped): [T, D]. slope:
    [M, D] at the knots; without it those of `slopes`: local, exact for parabolas, right for uneven knots."""
    if len(times) == 1:
        return np.repeat(values, len(at), axis=0)
    slope = slopes(times, values) if slope is None else slope
    # Clamped, because a cubic runs away beyond its knots.
    x = np.clip(at, times[0], times[-1])
    left = np.clip(np.searchsorted(times, x, side="right") - 1, 0, len(times) - 2)
    width = np.diff(times)[left][:, None]
    u = (x[:, None] - times[left][:, None]) / width
    rest = 1.0 - u
    return (rest * rest * (1.0 + 2.0 * u) * values[left] + u * u * (3.0 - 2.0 * u) * values[left + 1]
            + width * u * rest * (rest * slope[left] - u * slope[left + 1]))


def _mirrored(at: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Numbers of frames `at` [T], mirrored at the first and the last of `count` frames."""
    # A triangle wave of period 2 (count - 1), so that it also holds for kernels longer than the motion.
    return at * 0 if count == 1 else np.abs((at + count - 1) % (2 * (count - 1)) - (count - 1))


def half_of(fps: float, sigma: float) -> int:
    """Frames of the kernel on either side."""
    return int(_REACH * sigma * fps + 1e-9)


def smooth(frames: Array, fps: float, sigma: float) -> Array:
    """Frames [T, D], mirrored at their ends, after a Gaussian of `sigma` seconds that ends at two of them."""
    half, count = half_of(fps, sigma), len(frames)
    # Normalised after it is cut off at two sigma, so that a constant pose stays as it is.
    weights = np.exp(-0.5 * (np.arange(-half, half + 1) / (sigma * fps)) ** 2)
    weights /= weights.sum()
    near = frames[_mirrored(np.arange(-half, count + half), count)]
    out = frames * weights[half]
    for step in range(half, 0, -1):
        out += (near[half - step:half - step + count] + near[half + step:half + step + count]) * weights[half + step]
    return out
