"""Sends poses by plain OSC over UDP, for programs without VMC, such as TouchDesigner and Unreal Engine's OSC plugin.

Each frame is some OSC bundles, each small enough for one packet of a network, of messages of floats only, so that a
program that makes a channel of each number needs no script. `ADDRESSES` lists them. Bones are those of the VRM humanoid
with a T-pose at rest; rotations are relative to the parent bone.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import numpy as np

from data_module.errors import InputError
from data_module.motion.skeletons import standing
from gesticulator.serve.vmc import VmcOutput, packed

if TYPE_CHECKING:
    from data_module.face import FaceMotion
    from data_module.types import Array, Motion
    from gesticulator.serve.vmc import SentFrames
    from gesticulator.stream import StreamFrames

OSC_PORT = 9000
"""Usual port of receivers."""
AXES = ("y-up", "unreal")
"""Axes of what is sent, see `placed` and `turned`."""
ADDRESSES = {
    "/gesticulator/time": "seconds of the sender's clock",
    "/gesticulator/hips": "x, y, z of the hips",
    "/gesticulator/bone/NAME": "x, y, z, w of the rotation of a bone, a unit quaternion",
    "/gesticulator/angles/NAME": "the same in degrees about x, then y, then z of the parent bone; with y-up axes only",
    "/gesticulator/face/NAME": "0 to 1, a preset expression of VRM 1.0; of streams with a face",
}
"""Address -> what its floats are."""


def placed(places: Array, axes: str) -> Array:
    """[..., 3] positions, from our metres (Y up, the character faces +Z, its left is +X). "y-up": the same; "unreal":
    centimetres, left-handed, Z up, the character faces +X, its right is +Y."""
    if axes == "y-up":
        return places
    return 100.0 * places[..., [2, 0, 1]] * np.array([1.0, -1.0, 1.0])


def turned(turns: Array, axes: str) -> Array:
    """[..., 4] rotations (x, y, z, w) in these axes from ours (w, x, y, z)."""
    if axes == "y-up":
        return turns[..., [1, 2, 3, 0]]
    # The axes of a rotation turn round once more where the handedness changes.
    return turns[..., [3, 1, 2, 0]] * np.array([-1.0, 1.0, -1.0, 1.0])


def angles(turns: Array) -> Array:
    """[..., 3] degrees about the fixed axes x, then y, then z, from rotations [..., 4] (w, x, y, z)."""
    w, x, y, z = np.moveaxis(turns, -1, 0)
    about = np.stack([np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
                      np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0)),
                      np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))], axis=-1)
    return np.asarray(np.degrees(about))


class OscFrames:
    """A motion as OSC bundles."""

    def __init__(self, motion: Motion, face: FaceMotion | None = None, axes: str = "y-up") -> None:
        """face: of the same frames; axes: one of `AXES`."""
        from gesticulator.export.vrma import humanoid

        nodes = humanoid(standing(motion))
        self.fps, self._count = motion.fps, len(nodes)
        hips = nodes.names.index("hips")
        rows: list[tuple[str, Array]] = [("/gesticulator/hips", placed(nodes.shifts[hips], axes))]
        for number, name in enumerate(nodes.names):
            rows.append((f"/gesticulator/bone/{name}", turned(nodes.turns[:, number], axes)))
            if axes == "y-up":
                rows.append((f"/gesticulator/angles/{name}", angles(nodes.turns[:, number])))
        if face is not None:
            from gesticulator.characters.face_shapes import vrm

            rows += [(f"/gesticulator/face/{name}", curve[:, None]) for name, curve in vrm(face).items()]
        self._rows = [(_head(address, values.shape[1]), np.ascontiguousarray(values, ">f4"))
                      for address, values in rows]

    def __len__(self) -> int:
        return self._count

    def bundles(self, frame: int, seconds: float) -> list[bytes]:
        """See `FrameBundles`."""
        return packed([_time(seconds), *(head + values[frame].tobytes() for head, values in self._rows)])


class OscOutput(VmcOutput):
    """As `VmcOutput`, by plain OSC."""

    option, usual_port = "--osc", OSC_PORT

    def __init__(self, target: str, axes: str = "y-up") -> None:
        """axes: one of `AXES`; `InputError` for another."""
        if axes not in AXES:
            raise InputError(f"--osc-axes {axes[:80]}", "is unknown", f"choose among {', '.join(AXES)}")
        self.axes = axes
        super().__init__(target)

    def bundles_of(self, frames: StreamFrames | SentFrames) -> OscFrames:
        """See `VmcOutput`."""
        return OscFrames(frames.motion(), frames.face, self.axes)

    def without_frames(self, seconds: float) -> list[bytes]:
        """See `VmcOutput`."""
        return packed([_time(seconds)])


def _head(address: str, floats: int) -> bytes:
    """The start of an OSC message of so many floats, up to the floats."""
    from pythonosc.osc_message_builder import OscMessageBuilder

    builder = OscMessageBuilder(address)
    for _ in range(floats):
        builder.add_arg(0.0, "f")
    return bytes(builder.build().dgram[:-4 * floats])


def _time(seconds: float) -> bytes:
    return _head("/gesticulator/time", 1) + struct.pack(">f", seconds)
