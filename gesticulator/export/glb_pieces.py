"""`.glb` of a motion whose frames arrive in pieces: identical bytes, in bounded memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data_module.files import new_file
from data_module.motion import rotation
from data_module.motion.skeletons import standing
from data_module.types import Motion, Skeleton
from gesticulator.export.clip import ClipLayout
from gesticulator.export.glb import skeleton_document, steady_nodes
from gesticulator.export.gltf import LARGEST, ROTATION, TRANSLATION, Track, as_gltf, too_large
from gesticulator.export.key_reduction import SPAN, kept_frames, kept_places, rotation_errors, track_bounds
from gesticulator.export.nodes import NodeMotion, of_motion
from gesticulator.export.number_file import NumberFile

_NOT_MOTION = 1 << 17
"""Bytes (128 KiB) reserved for the figure and the JSON: 95 kB with 54 joints."""
_REDUCED = 0.5
"""Share of the frames that reduced keys are assumed to take before they are known: twice what they usually take."""


class _Keys:
    """The keys of one track, on disk."""

    def __init__(self, folder: Path, width: int, times: NumberFile | None) -> None:
        """times: of another track, if all tracks have the same keys."""
        self.times = NumberFile(folder) if times is None else times
        self.values, self._shares = NumberFile(folder, (width,)), times is not None

    @property
    def size(self) -> int:
        return self.values.size + (0 if self._shares else self.times.size)

    def add(self, times: NDArray[np.floating], values: NDArray[np.floating]) -> None:
        if len(times) and not self._shares:
            self.times.add(times)
        if len(values):
            self.values.add(values)

    def close(self) -> None:
        self.times.close()
        self.values.close()


class GlbFile:
    """A .glb file. Keys of each joint are buffered in separate temporary files."""

    def __init__(self, path: Path, skeleton: Skeleton, fps: float, clip: ClipLayout) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._path, self._fps, self._clip = path, fps, clip
        self._rest: NodeMotion | None = None
        self._continuous = rotation.Continuous()
        self._places = _Keys(path.parent, 3, None)
        shared = None if clip.keys else self._places.times
        self._turns = [_Keys(path.parent, 4, shared) for _ in range(len(skeleton))]
        self._begin, self._joints = 0, len(skeleton)
        self._waiting: tuple[NDArray[np.float64], NDArray[np.float64]] = (np.zeros((0, 3)),
                                                                          np.zeros((0, len(skeleton), 4)))

    def expect(self, frames: int) -> None:
        size = frames * 4 * (1 + 3 + 4 * self._joints)
        if self._clip.keys:
            size = round(size * _REDUCED)
        self._check(size)

    def _check(self, size: int) -> None:
        if size + _NOT_MOTION > LARGEST:
            raise too_large(size + _NOT_MOTION)

    def add(self, motion: Motion) -> None:
        nodes = of_motion(standing(motion), self._continuous)
        self._rest = self._rest or nodes
        places, turns = self._waiting
        places, turns = np.concatenate([places, nodes.shifts[0]]), np.concatenate([turns, nodes.turns])
        while len(turns) > SPAN:  # a span ends with the frame with which the next one begins
            self._add_span(places[:SPAN + 1], turns[:SPAN + 1], SPAN)
            places, turns = places[SPAN:], turns[SPAN:]
        self._waiting = places, turns
        left = 4 * len(turns) * (1 + 3 + 4 * self._joints)
        self._check(sum(keys.size for keys in (self._places, *self._turns))
                    + round(left * (_REDUCED if self._clip.keys else 1.0)))

    def _add_span(self, places: NDArray[np.float64], turns: NDArray[np.float64], count: int) -> None:
        """Write the keys among the first `count` frames of a span."""
        rest, keys = self._rest, self._clip.keys
        assert rest is not None
        times = np.arange(self._begin, self._begin + count) / self._fps
        moved = np.ones(len(places), dtype=bool)
        turned = np.ones(turns.shape[:2], dtype=bool)
        if keys:
            moved = kept_places(places, keys)
            turned = kept_frames(turns, track_bounds(range(self._joints), keys, steady_nodes(rest)), rotation_errors)
        moved, turned = moved[:count], turned[:count]
        self._places.add(times[moved], places[:count][moved])
        for node, track in enumerate(self._turns):
            track.add(times[turned[:, node]], as_gltf(turns[:count, node][turned[:, node]]))
        self._begin += count

    def finish(self) -> None:
        if self._rest is None:
            raise ValueError("a motion needs at least one frame")
        places, turns = self._waiting
        self._add_span(places, turns, len(turns))
        gltf = skeleton_document(self._rest)
        tracks: list[Track] = [(0, TRANSLATION, self._places.times, self._places.values)]
        tracks += [(node, ROTATION, track.times, track.values) for node, track in enumerate(self._turns)]
        gltf.add_animation(self._clip.name, tracks)
        with new_file(self._path) as out:
            gltf.write(out)

    def close(self) -> None:
        for keys in (self._places, *self._turns):
            keys.close()
