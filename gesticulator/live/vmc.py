"""Sends poses by the Virtual Motion Capture protocol (OSC over UDP), which avatar programs receive.

Each frame is some OSC bundles, each small enough for one packet of a network: the model's availability, the sender's
time, the root, and every bone of the VRM humanoid under its Unity name, with position and rotation in the parent bone's
frame. Unity's axes are left-handed: Y up, the character faces +Z, and its left is -X. Ours are their mirror image in X.
Frames are sent from the server's event loop, which shares Python's lock with the compute thread, so frames are late by
some milliseconds beside many streams; each is sent at most once, and late ones are skipped.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import socket
import struct
import time
from bisect import bisect_right
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from data_module.errors import InputError
from data_module.motion.skeletons import standing
from data_module.registry import Requirement
from data_module.settings import whole_number

if TYPE_CHECKING:
    from data_module.types import Array, Motion
    from gesticulator.export.nodes import NodeMotion
    from gesticulator.face.motion import FaceMotion
    from gesticulator.stream import StreamFrames

RATE = 60.0
"""Hertz at which the output looks for a first frame."""
PORT = 39539
"""Usual port of receivers."""
LATEST = 0.25
"""Delay of frames in seconds above which the playback clock is reset; smaller delays are caught up."""
MOST_SECONDS = 600.0
"""Most motion waiting to be played, seconds."""
DATAGRAM = 1400
"""Bytes of a datagram at most: a larger one is cut into parts on the way, and lost with any of them."""
_BUNDLE = b"#bundle\0" + struct.pack(">Q", 1)
"""Header of a bundle for immediate use."""
_THUMB = {"Metacarpal": "Proximal", "Proximal": "Intermediate", "Distal": "Distal"}
"""Thumb bones of VRM 1.0 -> Unity, which names them like those of a finger."""


def read_target(text: str) -> tuple[str, int]:
    """Host and port of "HOST:PORT"; `InputError` for anything else."""
    host, _, port = text.rpartition(":")
    number = whole_number(port, 65535)
    if not host or not number:
        raise InputError(f"--vmc {text[:80]}", "is not HOST:PORT", f"such as 127.0.0.1:{PORT}")
    Requirement("pythonosc", "python-osc", "live").check("--vmc")
    return host.strip("[]"), number


def unity_bone(vrm: str) -> str:
    """Unity's name (HumanBodyBones) of a bone of VRM 1.0: "leftThumbMetacarpal" is "LeftThumbProximal"."""
    side, thumb, place = vrm.partition("Thumb")
    name = side + thumb + _THUMB[place] if thumb else vrm
    return name[0].upper() + name[1:]


def mirrored_place(place: Array) -> Array:
    """[..., 3] a position in our axes converted to Unity's, or back."""
    return place * np.array([-1.0, 1.0, 1.0])


def mirrored_turn(turn: Array) -> Array:
    """[..., 4] (x, y, z, w) a rotation in Unity's axes from [..., 4] (w, x, y, z) in ours."""
    return turn[..., [1, 2, 3, 0]] * np.array([1.0, -1.0, -1.0, 1.0])


class VmcFrames:
    """A motion as OSC bundles."""

    def __init__(self, motion: Motion, face: FaceMotion | None = None) -> None:
        """face: of the same frames; sent as blend shapes of VRM 0.x, which receivers know, and as eye bones."""
        from gesticulator.export.vrma import humanoid

        nodes = humanoid(standing(motion))
        self.fps = motion.fps
        self._root = _head("/VMC/Ext/Root/Pos", "root", 7) + struct.pack(">7f", 0, 0, 0, 0, 0, 0, 1)
        self._heads = [_head("/VMC/Ext/Bone/Pos", unity_bone(name), 7) for name in nodes.names]
        # All numbers of all frames at once, so that a frame costs only the assembly of bytes.
        self._numbers = self._poses(nodes)
        self._faces = [] if face is None else face_messages(face)

    @staticmethod
    def _poses(nodes: NodeMotion) -> Array:
        """[T, N, 7] of every bone: position (x, y, z) in the parent's frame, rotation (x, y, z, w)."""
        places = np.broadcast_to(nodes.translations, (len(nodes), *nodes.translations.shape)).copy()
        for node, path in nodes.shifts.items():
            places[:, node] = path
        return np.concatenate([mirrored_place(places), mirrored_turn(nodes.turns)], axis=-1)

    def bundles(self, frame: int, seconds: float) -> list[bytes]:
        """A frame as bundles of at most `DATAGRAM` bytes; seconds: the sender's time."""
        # Receivers that join later learn from each frame that there is a model.
        messages = [*_available(1, seconds), self._root]
        numbers = self._numbers[frame].astype(">f4").tobytes()
        # Seven big-endian floats of 4 bytes for each bone.
        messages += [head + numbers[28 * bone:28 * bone + 28] for bone, head in enumerate(self._heads)]
        return packed([*messages, *(self._faces[frame] if self._faces else ())])


_BLENDS = {"aa": "A", "ih": "I", "ou": "U", "ee": "E", "oh": "O", "blink": "Blink", "happy": "Joy", "sad": "Sorrow"}
"""Expression of VRM 1.0 -> the name that receivers know."""
_EYE = (0.03, 0.06, 0.07)
"""Place of the left eye in the head, metres; receivers use its rotation."""


def face_messages(face: FaceMotion) -> list[list[bytes]]:
    """For each frame the messages of a face: a value per blend shape, the eyes as bones, and that they are complete."""
    from gesticulator.export.face import eye_turns
    from gesticulator.face.shapes import vrm

    blends = {name: curve for expression, curve in vrm(face).items() if (name := _BLENDS.get(expression))
              and not (face.lips_only and len(name) > 1)}
    parts = [(_head("/VMC/Ext/Blend/Val", name, 1), curve[:, None]) for name, curve in blends.items()]
    complete = _message("/VMC/Ext/Blend/Apply")
    if not face.lips_only:
        turns = mirrored_turn(eye_turns(face))
        for name, side in (("LeftEye", 1.0), ("RightEye", -1.0)):
            place = np.broadcast_to(mirrored_place(np.array([side * _EYE[0], *_EYE[1:]])), (len(face), 3))
            parts.append((_head("/VMC/Ext/Bone/Pos", name, 7), np.concatenate([place, turns], axis=-1)))
    return [[*(head + values[frame].astype(">f4").tobytes() for head, values in parts), complete]
            for frame in range(len(face))]


def _message(address: str, *arguments: str | int | float) -> bytes:
    from pythonosc.osc_message_builder import OscMessageBuilder

    builder = OscMessageBuilder(address)
    for argument in arguments:
        builder.add_arg(argument)
    return bytes(builder.build().dgram)


def _head(address: str, name: str, count: int) -> bytes:
    """The start of an OSC message of a name and `count` floats, up to the floats. Building each message anew would take
    a third of a core at 60 frames per second."""
    return _message(address, name, *[0.0] * count)[:-4 * count]


def _available(loaded: int, seconds: float) -> list[bytes]:
    """Whether the model is available, and the sender's time."""
    return [_message("/VMC/Ext/OK", loaded), _message("/VMC/Ext/T", seconds)]


def packed(messages: list[bytes]) -> list[bytes]:
    """OSC messages as bundles of at most `DATAGRAM` bytes, in their order."""
    # In their order, and each packet by itself complete: packets may be lost or overtake each other.
    parts: list[list[bytes]] = [[]]
    size = len(_BUNDLE)
    for message in messages:
        if size + 4 + len(message) > DATAGRAM:
            parts.append([])
            size = len(_BUNDLE)
        parts[-1].append(message)
        size += 4 + len(message)
    return [_bundled(part) for part in parts]


def _bundled(messages: list[bytes]) -> bytes:
    return b"".join((_BUNDLE, *(part for message in messages for part in (struct.pack(">i", len(message)), message))))


class _Part:
    """Frames of a stream that were not sent yet."""

    def __init__(self, frames: StreamFrames) -> None:
        self.first, self.fps, self.count = frames.first, frames.fps, len(frames)
        self._frames = frames

    @cached_property
    def bundles(self) -> VmcFrames:
        """The frames as they are sent. Converted when the first of them is due: many are replaced before that."""
        return VmcFrames(self._frames.motion(), self._frames.face)


class VmcOutput:
    """Plays the frames of one stream at their times, each once: poses may arrive long before they are due.

    The first stream with frames has the output until it ends. A frame that is sent again replaces the earlier one. All
    methods are for the thread of the event loop.
    """

    def __init__(self, target: str) -> None:
        """target: "HOST:PORT"; `InputError` for anything else."""
        self.host, self.port = read_target(target)
        self.stream: str | None = None
        self._parts: list[_Part] = []
        self._start = time.monotonic()
        self._zero = 0.0
        """time.monotonic() of frame 0."""
        try:
            family, _, _, _, address = socket.getaddrinfo(self.host, self.port, type=socket.SOCK_DGRAM)[0]
        except OSError as error:
            raise InputError(f"--vmc {target}", f"cannot be resolved ({error.strerror})",
                             "name an address") from None
        self._address = address
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def take(self, stream: str, frames: StreamFrames) -> None:
        """Add at least one frame of a stream."""
        if self.stream not in (None, stream):
            return
        due, now = frames.first / frames.fps, time.monotonic()
        # A new stream, or one that fell behind: its first frame is due now.
        if self.stream is None or now > self._zero + due + LATEST:
            self._zero = now - due
        self.stream = stream
        # Frames from `first` on are replaced: an interruption generates them again.
        self._parts = [part for part in self._parts if part.first < frames.first]
        if due < now - self._zero + MOST_SECONDS:
            self._parts.append(_Part(frames))

    def leave(self, stream: str) -> None:
        """End a stream. Its remaining frames are played unless another stream adds frames."""
        if self.stream == stream:
            self.stream = None

    def due(self, now: float) -> list[bytes] | None:
        """The bundles of the frame due at a time of time.monotonic(), or of the last frame."""
        if not self._parts:
            return None
        # The frame whose time is now; skipped ones are never sent late.
        frame = int((now - self._zero) * self._parts[0].fps)
        place = max(bisect_right([part.first for part in self._parts], frame) - 1, 0)
        del self._parts[:place]
        part = self._parts[0]
        end = self._parts[1].first if len(self._parts) > 1 else part.first + part.count
        number = min(max(frame, part.first), end - 1) - part.first
        return part.bundles.bundles(min(number, part.count - 1), now - self._start)

    async def play(self) -> None:
        """Send the bundles of each frame when it is due, until cancelled."""
        last_notice = -math.inf
        with self._socket:
            while True:
                now = time.monotonic()
                bundles = self.due(now)
                if bundles is None and now - last_notice >= 1.0:  # no model yet: said once a second
                    bundles, last_notice = [_bundled(_available(0, now - self._start))], now
                for bundle in bundles or ():
                    # A missing receiver or a congested network must not end anything.
                    with contextlib.suppress(OSError):
                        self._socket.sendto(bundle, self._address)
                period = 1 / self._parts[0].fps if self._parts else 1 / RATE
                await asyncio.sleep(period - (time.monotonic() - self._zero) % period)
