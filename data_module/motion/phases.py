"""Gesture units and their phases, measured on the motion of a hand.

A gesture unit goes from rest to rest (Kendon 2004). A hand rests where it is under 0.15 m/s for 0.4 s within 10 cm of
its home (the 10 % quantile of its own height), or for 0.8 s anywhere. Within a unit the hand moves between minima of
its speed. A movement that is followed at once by a harder stop is the preparation of that one; the others are strokes,
and the last movement, if it leads down to the rest, is the retraction. The apex of a stroke is its hardest
deceleration. A hold is a raised hand under 0.15 m/s for 0.25 s between two movements.
"""

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks

from data_module.motion import kinematics
from data_module.types import Array, Motion

SLOW = 0.15
"""m/s: a slower hand rests or is held."""
FAST = 0.3
"""m/s: the least peak of a movement."""
RAISED = 0.06
"""Metres over the hips at and above which a still hand is held, not hanging."""
# Seconds of rest near home, of rest anywhere, and of a hold, at least.
_AT_HOME, _ANYWHERE, _HOLD = 0.4, 0.8, 0.25
# Metres over the 10 % quantile of its height within which a hand is at home.
_HOME = 0.10
# M/s by which a minimum of speed lies under its surroundings to end a movement.
_PROMINENCE = 0.12
# Standard deviation of the smoothing of the positions, seconds, as for motion beats.
_SMOOTHING = 0.05
# A stop is harder than another if its deceleration is greater by this factor.
_HARDER = 1.1


def hand_places(motion: Motion, rate: float, times: Array | None = None, count: int | None = None) -> Array:
    """[count, 2, 3] places of the left and the right hand over the hips, metres, at `rate`. times: [T] seconds of the
    frames; those of the motion's frame rate by default. count: frames; up to the last time by default."""
    places = kinematics.positions_of_some(motion, [0, *(motion.skeleton.index(f"{side}Hand")
                                                        for side in ("Left", "Right"))])
    hands = (places[:, 1:] - places[:, :1]).reshape(len(places), -1)
    seconds = np.arange(len(places)) / motion.fps if times is None else times
    even = np.arange(int(seconds[-1] * rate) if count is None else count) / rate
    return np.stack([np.interp(even, seconds, column) for column in hands.T], axis=1).reshape(len(even), 2, 3)


class Phase(IntEnum):
    """The phases of a gesture unit, in the order of a simple one."""

    REST = 0
    PREPARATION = 1
    STROKE = 2
    HOLD = 3
    RETRACTION = 4


@dataclass(frozen=True)
class Movement:
    """A movement of a hand between two minima of its speed. first, last: frames, `last` excluded; apex: the frame of
    its hardest deceleration; force: that deceleration, m/s^2; size: metres from its start to its end; phase."""

    first: int
    last: int
    apex: int
    force: float
    size: float
    phase: Phase


@dataclass(frozen=True)
class HandPhases:
    """The phases of one hand. labels: [T] `Phase` of each frame; units: (first, last) frames of each gesture unit, last
    excluded; movements: in order of time, of all units."""

    labels: NDArray[np.int8]
    units: tuple[tuple[int, int], ...]
    movements: tuple[Movement, ...]

    @property
    def strokes(self) -> tuple[Movement, ...]:
        return tuple(movement for movement in self.movements if movement.phase == Phase.STROKE)


def phases_of(places: Array, fps: float) -> HandPhases:
    """Units and phases of a hand from its places [T, 3] in metres, the hips at the origin and y upwards."""
    frames = len(places)
    labels = np.full(frames, Phase.REST, dtype=np.int8)
    if frames < 4:
        return HandPhases(labels, (), ())
    smooth = gaussian_filter1d(places, _SMOOTHING * fps, axis=0, mode="nearest")
    speed = np.linalg.norm(np.gradient(smooth, 1.0 / fps, axis=0), axis=-1)
    units = gesture_units(smooth[:, 1], speed, fps)
    movements: list[Movement] = []
    for first, last in units:
        of_unit = _movements(smooth, speed, first, last, fps)
        movements += of_unit
        for movement in of_unit:
            labels[movement.first:movement.last] = movement.phase
    _label_between(labels, smooth[:, 1], speed, units, fps)
    return HandPhases(labels, units, tuple(movements))


def lasting(mask: NDArray[np.bool_], frames: float) -> NDArray[np.bool_]:
    """[T] True in the runs of a mask [T] that last `frames` or longer."""
    out = np.zeros(len(mask), dtype=bool)
    for first, last in runs(mask):
        out[first:last] = last - first >= round(frames)
    return out


def runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """(first, last) of each run of True in a mask [T], last excluded."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def gesture_units(height: Array, speed: Array, fps: float) -> tuple[tuple[int, int], ...]:
    """(first, last) frames of the units of a hand with height [T] metres and speed [T] m/s, last excluded."""
    slow = speed < SLOW
    at_home = slow & (height < np.percentile(height, 10) + _HOME)
    # Away from home a pause may be a hold, so it must last longer to end a unit.
    rests = lasting(at_home, _AT_HOME * fps) | lasting(slow, _ANYWHERE * fps)
    return tuple((first, last) for first, last in runs(~rests) if speed[first:last].max() > FAST)


def _movements(places: Array, speed: Array, first: int, last: int, fps: float) -> list[Movement]:
    """The movements of a unit, with their phases."""
    inner = speed[first:last]
    minima = find_peaks(-inner, prominence=_PROMINENCE)[0]
    bounds = [0, *minima.tolist(), last - first]
    # Deceleration in m/s^2: speed per frame times frames per second.
    force = -np.gradient(inner) * fps
    out: list[Movement] = []
    for a, b in zip(bounds[:-1], bounds[1:], strict=True):
        moving = np.flatnonzero(inner[a:b] >= SLOW) + a
        if not len(moving) or inner[a:b].max() <= FAST:
            continue
        a, b = int(moving[0]), int(moving[-1]) + 1
        apex = a + int(force[a:b].argmax())
        size = float(np.linalg.norm(places[first + b - 1] - places[first + a]))
        out.append(Movement(first + a, first + b, first + apex, float(force[apex]), size, Phase.STROKE))
    return _named(out, places[:, 1], last, fps)


def _named(movements: list[Movement], height: Array, last: int, fps: float) -> list[Movement]:
    """The movements of a unit that ends at frame `last`, as preparations, strokes and a retraction."""
    phases = [Phase.STROKE] * len(movements)
    for k, (movement, following) in enumerate(zip(movements, movements[1:], strict=False)):
        at_once = following.first - movement.last < _HOLD * fps
        prepares = following.force > _HARDER * movement.force and (k == 0 or phases[k - 1] != Phase.PREPARATION)
        if at_once and prepares:
            phases[k] = Phase.PREPARATION
    final = movements[-1] if len(movements) > 1 else None
    # Much of its way is downwards, and the hand stays there: the unit ends with it.
    if final is not None and last - final.last < _HOLD * fps and \
            height[final.first] - height[final.last - 1] > 0.4 * final.size:
        phases[-1] = Phase.RETRACTION
        # Nothing prepares a retraction.
        if phases[-2] == Phase.PREPARATION:
            phases[-2] = Phase.STROKE
    return [replace(movement, phase=phase) for movement, phase in zip(movements, phases, strict=True)]


def _label_between(labels: NDArray[np.int8], height: Array, speed: Array, units: tuple[tuple[int, int], ...],
                   fps: float) -> None:
    """Label the frames of units that belong to no movement: holds, or what the next movement begins with."""
    for first, last in units:
        inside = labels[first:last] == Phase.REST
        held = lasting(inside & (speed[first:last] < SLOW) & (height[first:last] >= RAISED), _HOLD * fps)
        labels[first:last][held] = Phase.HOLD
        for a, b in runs(inside & ~held):
            before, after = labels[first:first + a], labels[first + b:last]
            # Between two phases, the way into what follows; but nothing prepares a hold.
            if len(before) == 0 or (len(after) and after[0] == Phase.STROKE):
                fill = Phase.PREPARATION
            else:
                fill = before[-1] if len(after) == 0 or after[0] == Phase.HOLD else after[0]
            labels[first + a:first + b] = fill
