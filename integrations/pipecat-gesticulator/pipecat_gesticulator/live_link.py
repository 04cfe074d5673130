"""Poses for the Live Link of Unreal Engine, as its plug-in JSONLiveLink receives them.

    gesticulator serve
    python -m pipecat_gesticulator.live_link speech.wav --to 127.0.0.1:54321

A frame is a JSON object in one UDP datagram: the name of the subject, and a list of its bones, parents first, each with
Name, Parent (its place in the list, -1 for the root), Location in centimetres, Rotation (x, y, z, w) and Scale, all in
the frame of the parent. Unreal's axes are left-handed: Z up, the character faces +Y with its left at +X, as a GLB of
ours does that Unreal has imported. They are ours with Y and Z exchanged.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import socket
import wave
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipecat_gesticulator.client import connect
from pipecat_gesticulator.player import PosePlayer
from pipecat_gesticulator.protocol import Hello, Poses, Welcome

PORT = 54321
"""At which the plug-in listens."""
SUBJECT = "gesticulator"


class LiveLink:
    """Sends poses of a stream (output "joints") to Unreal. welcome: the server's, whose joints are the bones."""

    def __init__(self, welcome: Welcome, host: str = "127.0.0.1", port: int = PORT, subject: str = SUBJECT) -> None:
        self.subject, self._bones = subject, [
            {"Name": joint.name, "Parent": joint.parent, "Location": _centimetres(np.array(joint.offset)),
             "Rotation": [0.0, 0.0, 0.0, 1.0], "Scale": [1, 1, 1]} for joint in welcome.joints]
        family, _, _, _, self._address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        self._socket = socket.socket(family, socket.SOCK_DGRAM)

    def packet(self, rotations: NDArray[np.float32], root_position: NDArray[np.float32]) -> bytes:
        """The datagram of a pose: rotations [J, 4], w first; root_position [3] in metres."""
        # The exchange of two axes is a reflection: it also turns the sense of every rotation.
        turns = (rotations[:, [1, 3, 2, 0]] * np.array([-1, -1, -1, 1])).round(5).tolist()
        bones = [{**bone, "Rotation": turn} for bone, turn in zip(self._bones, turns, strict=True)]
        bones[0]["Location"] = _centimetres(root_position)
        return json.dumps({self.subject: bones}, separators=(",", ":")).encode("ascii")

    def send(self, rotations: NDArray[np.float32], root_position: NDArray[np.float32]) -> None:
        """Send a pose, such as `PosePlayer.pose_at` gives it; it is no error if no program receives it."""
        self._socket.sendto(self.packet(rotations, root_position), self._address)

    def close(self) -> None:
        """Let go of the socket."""
        self._socket.close()


def _centimetres(place: NDArray[np.floating]) -> list[float]:
    """[3] in Unreal's axes, from metres in ours."""
    return [round(100.0 * float(place[axis]), 3) for axis in (0, 2, 1)]


async def play(sound: bytes, rate: int, url: str, host: str, port: int) -> int:
    """Perform mono 16-bit sound in real time; how many frames were sent. Those that are late are left out."""
    player = PosePlayer()
    async with connect(url, Hello(rate, options={"legs": True})) as stream:
        await stream.send(sound)
        await stream.finish()
        async for message in stream:
            if isinstance(message, Poses):
                player.add(message)
    link, clock, count = LiveLink(stream.welcome, host, port), asyncio.get_running_loop().time, 0
    begin = clock()
    while (time := clock() - begin) < player.end:
        pose = player.pose_at(time)
        assert pose is not None
        link.send(*pose)
        count += 1
        await asyncio.sleep(1 / stream.welcome.fps - (clock() - begin) % (1 / stream.welcome.fps))
    link.close()
    return count


def main(arguments: list[str] | None = None) -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description="Perform a recording in Unreal Engine, by Live Link.")
    p.add_argument("sound", type=Path, help="16-bit mono WAV")
    p.add_argument("--to", default=f"127.0.0.1:{PORT}", metavar="HOST:PORT", help="where Unreal listens (%(default)s)")
    p.add_argument("--gestures", default="ws://127.0.0.1:8765/stream", help="server (%(default)s)")
    a = p.parse_args(arguments)
    host, _, port = a.to.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        p.error(f"--to {a.to}: give HOST:PORT, such as 127.0.0.1:{PORT}")
    try:
        with wave.open(str(a.sound), "rb") as file:
            if (file.getnchannels(), file.getsampwidth()) != (1, 2):
                raise wave.Error("it is not a 16-bit mono WAV")
            rate, sound = file.getframerate(), file.readframes(file.getnframes())
        print(f"{asyncio.run(play(sound, rate, a.gestures, host.strip('[]'), int(port)))} frames")
    except (OSError, EOFError, wave.Error) as error:
        p.error(f"{a.sound}: {error}")


if __name__ == "__main__":
    main()
