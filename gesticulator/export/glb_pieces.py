"""`.glb` of a motion whose frames arrive in pieces: identical bytes, in bounded memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from data_module.files import new_file
from data_module.motion import rotation
from data_module.motion.skeletons import standing
from data_module.types import Motion, Skeleton
from gesticulator.export.glb import ANIMATION, skeleton_document
from gesticulator.export.gltf import LARGEST, ROTATION, TRANSLATION, as_gltf, too_large
from gesticulator.export.nodes import NodeMotion, of_motion
from gesticulator.export.number_file import NumberFile

_NOT_MOTION = 1 << 17
"""Bytes (128 KiB) reserved for the figure and the JSON: 95 kB with 54 joints."""


class GlbFile:
    """A .glb file. Times, root positions and each joint's rotations are buffered in separate temporary files."""

    def __init__(self, path: Path, skeleton: Skeleton, fps: float) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._path, self._fps = path, fps
        self._rest: NodeMotion | None = None
        self._continuous = rotation.Continuous()
        self._times, self._places = NumberFile(path.parent), NumberFile(path.parent, (3,))
        self._turns = [NumberFile(path.parent, (4,)) for _ in range(len(skeleton))]

    def expect(self, frames: int) -> None:
        size = frames * 4 * (1 + 3 + 4 * len(self._turns)) + _NOT_MOTION
        if size > LARGEST:
            raise too_large(size)

    def add(self, motion: Motion) -> None:
        begin = len(self._times)
        self.expect(begin + len(motion))
        nodes = of_motion(standing(motion), self._continuous)
        self._rest = self._rest or nodes
        self._times.add(np.arange(begin, begin + len(motion)) / self._fps)
        self._places.add(nodes.shifts[0])
        for node, turns in enumerate(self._turns):
            turns.add(as_gltf(nodes.turns[:, node]))

    def finish(self) -> None:
        if self._rest is None:
            raise ValueError("a motion needs at least one frame")
        gltf = skeleton_document(self._rest)
        gltf.add_animation(ANIMATION, self._times, [(0, TRANSLATION, self._places), *(
            (node, ROTATION, turns) for node, turns in enumerate(self._turns))])
        with new_file(self._path) as out:
            gltf.write(out)

    def close(self) -> None:
        for numbers in (self._times, self._places, *self._turns):
            numbers.close()
