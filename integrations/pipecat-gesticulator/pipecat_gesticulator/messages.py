"""Poses as JSON messages, for a transport that has a data channel: the avatar is then shown where the voice is heard.

Each message is at most `LONGEST` bytes and complete in itself. `to_rtvi` puts one into the envelope of RTVI, in which
Pipecat's client libraries hand it to `onServerMessage`; `MessageStream` of gesticulator-client reads them in a browser.

    {"type": "gestures-hello", "fps", "look_ahead", "joints": J, "at": k, "part": [[name, parent, x, y, z], ...]}
    {"type": "gestures", "first", "count", "fps", "state", "source", "now", "turns", "roots", "face"}

turns: base64 of int16, little endian, [count, J, 4]: quaternions, w first, times 32767. roots: base64 of float32
[count, 3], metres. face: of float32 [count, 20], where there is one. now: media time that was played when the message
was sent, seconds. A message whose first frame was already sent replaces that frame and all later ones.
"""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipecat_gesticulator.protocol import Poses, Welcome

LONGEST = 3500
"""Bytes of a message in its envelope: less than what a data channel takes at once, 4 kB at the least."""
_AROUND = 350
"""Bytes of a message besides its numbers."""
_JOINTS_AT_ONCE = 30
_WHOLE = 32767


def hello_messages(welcome: Welcome) -> list[dict[str, Any]]:
    """The skeleton, in as many messages as it takes."""
    rows = [[joint.name, joint.parent, *(round(value, 5) for value in joint.offset)] for joint in welcome.joints]
    return [{"type": "gestures-hello", "fps": welcome.fps, "look_ahead": welcome.look_ahead, "joints": len(rows),
             "at": at, "part": rows[at:at + _JOINTS_AT_ONCE]} for at in range(0, len(rows), _JOINTS_AT_ONCE)]


def pose_messages(poses: Poses, now: float) -> Iterator[dict[str, Any]]:
    """A packet of poses of joints, in as many messages as it takes. now: media time that is played, seconds."""
    face = 0 if poses.face is None else poses.face.shape[1]
    size = 4 / 3 * (poses.rotations.shape[1] * 4 * 2 + 3 * 4 + face * 4)
    most = max(1, int((LONGEST - _AROUND) / size))
    for at in range(0, len(poses), most):
        turns, roots = poses.rotations[at:at + most], poses.root_positions[at:at + most]
        message = {"type": "gestures", "first": poses.first + at, "count": len(turns), "fps": poses.fps,
                   "state": poses.state, "source": poses.source, "now": round(now, 3),
                   "turns": _text(np.round(turns * _WHOLE).astype("<i2")), "roots": _text(roots.astype("<f4"))}
        if poses.face is not None:
            message["face"] = _text(poses.face[at:at + most].astype("<f4"))
        yield message


def to_rtvi(message: Mapping[str, Any]) -> dict[str, Any]:
    """The message as an RTVI server message."""
    return {"label": "rtvi-ai", "type": "server-message", "data": dict(message)}


def _text(numbers: NDArray[Any]) -> str:
    return base64.b64encode(numbers.tobytes()).decode("ascii")
