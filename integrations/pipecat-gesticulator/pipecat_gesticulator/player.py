"""Which pose to show when: poses are kept by their number and read by the clock of the sound that is heard."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipecat_gesticulator.protocol import Poses


class PosePlayer:
    """Holds the poses that have come and not been shown.

    A packet that begins at a frame that is there already replaces it and all later ones, as after an interruption.
    """

    def __init__(self) -> None:
        self._packets: list[Poses] = []

    def add(self, poses: Poses) -> None:
        """Take a packet."""
        kept = []
        for old in self._packets:
            length = min(len(old), poses.first - old.first)
            if length == len(old):
                kept.append(old)
            elif length > 0:
                kept.append(replace(old, rotations=old.rotations[:length], root_positions=old.root_positions[:length],
                                    face=None if old.face is None else old.face[:length]))
        self._packets = [*kept, poses]

    @property
    def end(self) -> float:
        """Media time up to which there are poses, seconds."""
        return (self._packets[-1].first + len(self._packets[-1])) / self._packets[-1].fps if self._packets else 0.0

    def packet_at(self, time: float) -> Poses | None:
        """The packet that holds the pose of a media time; None where there is none. Earlier ones are let go of."""
        if not self._packets:
            return None
        frame = int(time * self._packets[0].fps + 1e-6)
        place = bisect_right([packet.first for packet in self._packets], frame) - 1
        if place < 0:
            return None
        del self._packets[:place]
        packet = self._packets[0]
        return packet if frame < packet.first + len(packet) else None

    def pose_at(self, time: float) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
        """Rotations [J, 4] and root position [3] at a media time; the last there is beyond the end, None before any.

        What is before that time is let go of: time only moves on.
        """
        if not self._packets:
            return None
        frame = max(int(time * self._packets[0].fps + 1e-6), self._packets[0].first)
        place = bisect_right([packet.first for packet in self._packets], frame) - 1
        del self._packets[:place]
        packet = self._packets[0]
        at = min(frame - packet.first, len(packet) - 1)
        return packet.rotations[at], packet.root_positions[at]
