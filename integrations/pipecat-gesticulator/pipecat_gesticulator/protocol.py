"""What travels between a client and the server; `protocol.json` beside this file is the published schema."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass, field
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

SCHEMA: dict[str, Any] = json.loads((resources.files(__package__) / "protocol.json").read_text(encoding="utf-8"))
"""The schema of every message (JSON Schema 2020-12), with the codes that a connection is closed with."""
VERSION: int = SCHEMA["version"]
SUBPROTOCOL: str = SCHEMA["subprotocol"]
CLOSE_CODES: dict[int, str] = {int(code): meaning for code, meaning in SCHEMA["close_codes"].items()}
SMPLX_JOINTS = 55


@dataclass(frozen=True)
class Hello:
    """What a client asks for.

    sample_rate: hertz of the sound that will be sent, mono. format: "pcm16" or "float32", little endian. fps: frames
    per second of the poses. output: "joints" or "smplx". options: as in the schema, such as {"activity": 0.6}.
    """

    sample_rate: int
    format: str = "pcm16"
    fps: float = 60.0
    seed: int = 0
    output: str = "joints"
    options: dict[str, Any] = field(default_factory=dict)
    token: str | None = None

    def text(self) -> str:
        """The message."""
        said: dict[str, Any] = {"type": "hello", "protocol": VERSION, "sample_rate": self.sample_rate,
                                "format": self.format, "fps": self.fps, "seed": self.seed, "output": self.output}
        if self.options:
            said["options"] = self.options
        if self.token is not None:
            said["token"] = self.token
        return json.dumps(said)


@dataclass(frozen=True)
class Joint:
    """A joint of the skeleton. parent: index of the joint above, -1 for the root. offset: metres from it at rest."""

    name: str
    parent: int
    offset: tuple[float, float, float]


@dataclass(frozen=True)
class Welcome:
    """What the server answers to a hello.

    fps: frames per second. look_ahead: seconds of sound that a pose waits for, at most. joints: parents before
    children. limits: as in the schema.
    """

    stream: str
    fps: float
    output: str
    look_ahead: float
    joints: tuple[Joint, ...]
    limits: dict[str, float]

    @classmethod
    def read(cls, text: str) -> Welcome:
        """From the message; ValueError where it is none."""
        said = json.loads(text)
        if said.get("type") != "hello" or said.get("protocol") != VERSION:
            raise ValueError(f"the server does not speak protocol {VERSION}: {text[:200]}")
        try:
            joints = tuple(Joint(one["name"], one["parent"], tuple(one["offset"])) for one in said["joints"])
            return cls(said["stream"], said["fps"], said["output"], said["look_ahead"], joints, said["limits"])
        except (KeyError, TypeError) as error:
            raise ValueError(f"the server's hello lacks a field: {text[:200]}") from error


@dataclass(frozen=True)
class Poses:
    """Some frames that follow each other; frame k of the stream is the pose at k / fps seconds of its media time.

    first: number of the first frame. rotations: [count, J, 4] quaternions, w first, local to the parent; for SMPL-X
    [count, 55, 3], axis times angle in radians. root_positions: [count, 3] metres. state: "idle", "speaking",
    "listening" or "thinking". received: seconds of sound that the server had taken in when it made them. face: [count,
    20] with the option "face" (the schema lists the values). source: number of the connection that they are of, in a
    `ResumingStream`: where it changes, poses do not join.
    """

    first: int
    fps: float
    rotations: NDArray[np.float32]
    root_positions: NDArray[np.float32]
    state: str
    received: float
    source: int = 0
    face: NDArray[np.float32] | None = None

    def __len__(self) -> int:
        return len(self.rotations)

    @property
    def time(self) -> float:
        """Media time of the first frame, seconds."""
        return self.first / self.fps

    @classmethod
    def unpack(cls, packet: bytes) -> Poses:
        """From a binary message; ValueError where it is none."""
        if len(packet) < 4:
            raise ValueError("a packet of poses has a header")
        (length,) = struct.unpack_from("<I", packet)
        if 4 + length > len(packet):
            raise ValueError("a packet of poses is cut off in its header")
        header = json.loads(packet[4:4 + length])
        if header.get("type") != "poses":
            raise ValueError(f"a packet of {header.get('type')!r} is none of poses")
        count, joints = header["count"], header["joints"]
        width = 3 if joints == SMPLX_JOINTS else 4
        numbers = np.frombuffer(packet, "<f4", offset=4 + length)
        face = header.get("face", 0)
        if len(numbers) != count * (joints * width + 3 + face):
            raise ValueError(f"a packet of {count} poses of {joints} joints has {len(numbers)} numbers")
        rotations, root, values = np.split(numbers, [count * joints * width, count * (joints * width + 3)])
        return cls(header["first"], header["fps"], rotations.reshape(count, joints, width), root.reshape(count, 3),
                   header["state"], header["received"], face=values.reshape(count, face) if face else None)
