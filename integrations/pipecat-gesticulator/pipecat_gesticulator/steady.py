"""A pose for every moment: of the stream where it has come, of idling where it has not, and no jump between."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pipecat_gesticulator.player import PosePlayer
from pipecat_gesticulator.protocol import Poses, Welcome

Rotations = NDArray[np.float64]
Pose = tuple[Rotations, Rotations]
"""[J, 4] quaternions, w first, and [3] the root's position, metres."""
TO_REST, TO_STREAM = 3.0, 6.0
"""Rate (1/s) at which a difference from idling, or from the stream, goes away: 95 % of it within 1.6 and 0.8 s."""
BREATH_SECONDS, BREATH = 4.0, 0.012
"""Of a breath while idling: its time, and how far it turns the spine, radians."""
SPEEDS = 0.1
"""Longest step, seconds, over which the speed of what was shown is measured."""


class SteadyPlayer:
    """As `PosePlayer`, for a stream whose poses may be late or lost.

    Where there is no pose for a moment, the character comes to rest and breathes. Where the source changes (stream to
    idling and back, or to another connection of a `ResumingStream`), the difference in pose and in speed is carried
    over and decays as a critically damped spring, so that nothing jumps.
    """

    def __init__(self, welcome: Welcome) -> None:
        self._player = PosePlayer()
        names = [joint.name for joint in welcome.joints]
        self._spine = next((k for k, name in enumerate(names) if name in ("Spine1", "Spine2", "Spine")), None)
        self._rest: Pose | None = None
        self._shown: list[tuple[float, Pose]] = []
        """The last two poses that were shown, with their times."""
        self._source: int | None = None
        self._turns, self._turning = np.zeros((0, 3)), np.zeros((0, 3))
        self._shift, self._shifting = np.zeros(3), np.zeros(3)
        self._idle_since = 0.0

    def add(self, poses: Poses) -> None:
        """Take a packet."""
        if self._rest is None:
            self._rest = _as_pose(poses.rotations[0], poses.root_positions[0])
        self._player.add(poses)

    @property
    def end(self) -> float:
        """Media time up to which there are poses, seconds."""
        return self._player.end

    @property
    def idling(self) -> bool:
        """Whether the pose that was shown last was of idling for want of others."""
        return self._source == _IDLING

    def pose_at(self, time: float) -> Pose | None:
        """Rotations [J, 4] and root position [3] to be shown at a media time; None before the first packet. Time only
        moves on."""
        if self._rest is None:
            return None
        source, target, speed = self._target(time)
        if source != self._source:
            if source == _IDLING:
                self._idle_since = time
                source, target, speed = self._target(time)
            self._carry_over(time, target, speed)
            self._source = source
        self._decay(time, TO_REST if source == _IDLING else TO_STREAM)
        pose = _multiply(_exp(self._turns), target[0]), target[1] + self._shift
        self._shown = [*self._shown[-1:], (time, pose)]
        return pose

    def _target(self, time: float) -> tuple[int, Pose, Pose]:
        """Which source there is for a moment, its pose, and how fast that moves: [J, 3] radians and [3] metres per
        second."""
        packet = self._player.packet_at(time)
        if packet is None:
            pose = self._at_rest(time)
            return _IDLING, pose, _speed(self._at_rest(time - 0.02), pose, 0.02)
        frame = int(time * packet.fps + 1e-6) - packet.first
        pose = _as_pose(packet.rotations[frame], packet.root_positions[frame])
        after = min(frame + 1, len(packet) - 1)
        following = _as_pose(packet.rotations[after], packet.root_positions[after])
        return packet.source, pose, _speed(pose, following, 1 / packet.fps)

    def _at_rest(self, time: float) -> Pose:
        assert self._rest is not None
        rotations, root = self._rest[0].copy(), self._rest[1]
        if self._spine is not None:
            phase = 2 * math.pi * max(0.0, time - self._idle_since) / BREATH_SECONDS
            turn = _exp(np.array([[-0.5 * BREATH * (1 - math.cos(phase)), 0.0, 0.0]]))
            rotations[self._spine] = _multiply(rotations[self._spine][None], turn)[0]
        return rotations, root

    def _carry_over(self, time: float, target: Pose, speed: Pose) -> None:
        """Begin with the difference between what was shown and the new source, in pose and in speed."""
        joints = len(target[0])
        if not self._shown:
            self._turns, self._turning = np.zeros((joints, 3)), np.zeros((joints, 3))
            return
        when, last = self._shown[-1]
        moved = (np.zeros((joints, 3)), np.zeros(3))
        if len(self._shown) > 1 and 0 < when - self._shown[0][0] <= SPEEDS:
            moved = _speed(self._shown[0][1], last, when - self._shown[0][0])
        # Both at the time of the last pose; the source's own way since then is taken back.
        step = time - when if time - when <= SPEEDS else 0.0
        self._turns = _log(_multiply(last[0], _inverse(target[0]))) + step * speed[0]
        self._turning = moved[0] - speed[0]
        self._shift = last[1] - target[1] + step * speed[1]
        self._shifting = moved[1] - speed[1]

    def _decay(self, time: float, rate: float) -> None:
        if not self._shown:
            return
        step = max(0.0, time - self._shown[-1][0])
        left = math.exp(-rate * step)
        for offset, change in (("_turns", "_turning"), ("_shift", "_shifting")):
            x, v = getattr(self, offset), getattr(self, change)
            pull = v + rate * x
            setattr(self, offset, (x + pull * step) * left)
            setattr(self, change, (v - rate * pull * step) * left)


_IDLING = -1


def _as_pose(rotations: NDArray[np.float32], root: NDArray[np.float32]) -> Pose:
    return rotations.astype(np.float64), root.astype(np.float64)


def _speed(before: Pose, after: Pose, seconds: float) -> Pose:
    return _log(_multiply(after[0], _inverse(before[0]))) / seconds, (after[1] - before[1]) / seconds


def _multiply(a: Rotations, b: Rotations) -> Rotations:
    w, v, x, u = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    return np.concatenate([w * x - (v * u).sum(-1, keepdims=True), w * u + x * v + np.cross(v, u)], -1)


def _inverse(q: Rotations) -> Rotations:
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def _exp(turns: Rotations) -> Rotations:
    """[..., 3] axis times angle to quaternions."""
    angle = np.linalg.norm(turns, axis=-1, keepdims=True)
    return np.concatenate([np.cos(angle / 2), 0.5 * np.sinc(angle / (2 * np.pi)) * turns], -1)


def _log(q: Rotations) -> Rotations:
    """Quaternions to axis times angle, the shorter way."""
    q = np.where(q[..., :1] < 0, -q, q)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, q[..., :1])
    scale = np.where(sine > 1e-9, angle / np.maximum(sine, 1e-9), 2.0)
    found: Rotations = scale * q[..., 1:]
    return found
