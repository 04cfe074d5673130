"""Fewer keys for the same motion: frames that interpolation between other frames restores are left out.

Players interpolate between keys: rotations along the shortest arc (slerp), translations along the line. A frame may be
left out if what is interpolated there differs by no more than a bound. For every track, keys are first added where the
error is greatest until all errors are within the bound (Ramer, Douglas and Peucker), then keys that became superfluous
are removed; each step is checked against all frames, so the bound is guaranteed, not estimated.

Every `SPAN` frames all tracks have a key, and spans are reduced one by one, in bounded memory.
"""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from data_module.motion.skeletons import LEG_JOINTS
from data_module.types import Array

STEADY = frozenset({"Hips", *LEG_JOINTS})
"""Our joints whose errors add up at the feet."""
SPAN = 512
"""Frames between the keys that all tracks have: 9 s at 60 frames per second."""
METRES_PER_DEGREE = 0.005
"""Bound on the error of a translation, metres per degree of the bound on rotations: half a millimetre for 0.1 degree,
a tenth of what is visible on a planted foot."""
STEADY_SHARE = 0.25
"""Share of the bound that holds for hips and legs, whose errors add up at the feet, where sliding is seen first."""
_ROUNDS = 8
"""Passes that remove keys; later ones find next to none."""
_ROUNDING = 1e-6
"""Radians and metres kept in reserve for float32."""

Error: TypeAlias = Callable[[Array, Array, Array, Array], Array]
"""(values, before, after, share) -> [...] the distance of values [..., C] from what is interpolated between keys."""


def rotation_errors(turns: Array, before: Array, after: Array, share: Array) -> Array:
    """[...] radians between unit quaternions [..., 4] and the shortest arc from `before` to `after` at `share`."""
    # q and -q are the same rotation: take the nearer one, as players do.
    cosine = np.sum(before * after, axis=-1)
    after = np.where(cosine[..., None] < 0.0, -after, after)
    angle = np.arccos(np.minimum(np.abs(cosine), 1.0))
    sine = np.sin(angle)
    # For nearly equal keys slerp divides 0 by 0: interpolate linearly.
    straight = sine < 1e-9
    sine = np.where(straight, 1.0, sine)
    first = np.where(straight, 1.0 - share, np.sin((1.0 - share) * angle) / sine)
    second = np.where(straight, share, np.sin(share * angle) / sine)
    between = first[..., None] * before + second[..., None] * after
    # The chord, as the arc cosine of a product near 1 has no accuracy left for small angles.
    chord = np.minimum(np.linalg.norm(turns - between, axis=-1), np.linalg.norm(turns + between, axis=-1))
    return np.asarray(4.0 * np.arcsin(np.minimum(chord / 2.0, 1.0)))


def place_errors(places: Array, before: Array, after: Array, share: Array) -> Array:
    """[...] distance of places [..., 3] from the line from `before` to `after` at `share`."""
    return np.asarray(np.linalg.norm(places - before - share[..., None] * (after - before), axis=-1))


def kept_frames(values: Array, bounds: Array, errors: Error) -> NDArray[np.bool_]:
    """[T, N] the frames of N tracks [T, N, C] that need a key so that no frame is off by more than its track's bound
    [N]; the first and the last always."""
    frames = len(values)
    has_key = np.zeros(values.shape[:2], dtype=bool)
    for first in range(0, max(frames - 1, 1), SPAN):
        span = slice(first, min(first + SPAN, frames - 1) + 1)
        has_key[span] |= _kept_in_span(values[span], bounds - _ROUNDING, errors)
    return has_key


def _kept_in_span(values: Array, bounds: Array, errors: Error) -> NDArray[np.bool_]:
    has_key = np.zeros(values.shape[:2], dtype=bool)
    has_key[[0, -1]] = True
    if len(values) < 3:
        return has_key
    todo = np.arange(values.shape[1])
    while len(todo):  # each round adds a key to every track that is left, of which there are finitely many
        off, worst = _off(values[:, todo], has_key[:, todo], errors)
        bad = off > bounds[todo]
        # Of each segment between two keys the worst frame becomes a key, in all tracks at once.
        has_key[:, todo] |= bad & (off == worst)
        # Tracks within their bound are done.
        todo = todo[bad.any(axis=0)]
    for _ in range(_ROUNDS):
        removed = [_thin(values, has_key, bounds, errors, parity) for parity in (0, 1)]
        if not any(removed):
            break
    return has_key


def _off(values: Array, has_key: NDArray[np.bool_], errors: Error) -> tuple[Array, Array]:
    """[T, N] error of every frame between its keys, 0 at a key, and [T, N] the greatest of those between its keys."""
    rows = np.arange(len(values))[:, None]
    before = np.maximum.accumulate(np.where(has_key, rows, 0), axis=0)
    after = np.minimum.accumulate(np.where(has_key, rows, len(values) - 1)[::-1], axis=0)[::-1]
    share = (rows - before) / np.maximum(after - before, 1)
    tracks = np.broadcast_to(np.arange(values.shape[1]), before.shape)
    off = np.where(has_key, 0.0, errors(values, values[before, tracks], values[after, tracks], share))
    worst = np.zeros_like(off)
    np.maximum.at(worst, (before, tracks), off)
    return off, worst[before, tracks]


def _thin(values: Array, has_key: NDArray[np.bool_], bounds: Array, errors: Error, parity: int) -> bool:
    """Remove every second inner key, starting with the first or the second, where the frames between its neighbours
    stay within the bound; whether any was removed. Neighbours stay, so one removal cannot spoil another."""
    number = np.cumsum(has_key, axis=0)  # of the key at or before a frame, from 1
    trial = has_key & ((number % 2 == parity) | (number == 1) | (number == number[-1]))
    _, worst = _off(values, trial, errors)
    removed = has_key & ~trial & (worst <= bounds)
    has_key &= ~removed
    return bool(removed.any())


def kept_places(places: Array, degrees: float) -> NDArray[np.bool_]:
    """[T] the frames of a translation [T, 3] that need a key, for a bound on rotations in degrees."""
    return kept_frames(places[:, None], np.array([METRES_PER_DEGREE * degrees]), place_errors)[:, 0]
