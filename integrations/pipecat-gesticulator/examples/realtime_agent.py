"""Ask an agent of OpenAI's Realtime API by a recording, and get its answer with gestures.

    gesticulator serve
    OPENAI_API_KEY=... python realtime_agent.py question.wav answer.wav answer.npz

The question is a 16-bit mono WAV at 24 kHz. The answer's sound and poses are on one time line: frame k of the poses is
shown at k / fps seconds of the WAV. `--agent` names another server with the same events.
"""

from __future__ import annotations

import argparse
import asyncio
import base64
import contextlib
import json
import os
import wave
from pathlib import Path

import numpy as np
from pipecat_gesticulator import Hello, Poses, connect_resuming
from pipecat_gesticulator.realtime import RATE, RealtimeGestures
from websockets.asyncio.client import ClientConnection
from websockets.asyncio.client import connect as open_socket

PIECE = RATE // 10
"""Samples of the question in a message: 0.1 s."""
SILENCE = 2.0
"""Seconds of silence after the question, by which the API knows that it is over."""


class Recorder:
    """Sound and poses of a conversation, by media time."""

    def __init__(self, rate: int = RATE) -> None:
        self.rate, self.sound = rate, np.zeros(0, np.int16)
        self.poses: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def play(self, sound: bytes, begin: float) -> None:
        """Sound at a media time; what was there is replaced."""
        at, samples = round(begin * self.rate), np.frombuffer(sound, "<i2")
        self.sound = np.concatenate([self.sound[:at], np.zeros(max(0, at - len(self.sound)), np.int16), samples])

    def show(self, poses: Poses) -> None:
        """A packet; later frames are replaced."""
        self.poses = {number: pose for number, pose in self.poses.items() if number < poses.first}
        for number, pose in enumerate(zip(poses.rotations, poses.root_positions, strict=True), poses.first):
            self.poses[number] = pose

    def write(self, sound: Path, poses: Path, fps: float) -> None:
        """Both files."""
        with wave.open(str(sound), "wb") as file:
            file.setnchannels(1)
            file.setsampwidth(2)
            file.setframerate(self.rate)
            file.writeframes(self.sound.astype("<i2").tobytes())
        rotations, root = zip(*(self.poses[number] for number in sorted(self.poses)), strict=True)
        np.savez(poses, rotations=np.array(rotations), root_positions=np.array(root), fps=fps)


def read_question(path: Path) -> bytes:
    """16-bit mono samples at 24 kHz; ValueError for another WAV."""
    with wave.open(str(path), "rb") as file:
        if (file.getnchannels(), file.getsampwidth(), file.getframerate()) != (1, 2, RATE):
            raise ValueError(f"{path} is not a 16-bit mono WAV at {RATE} Hz")
        return file.readframes(file.getnframes())


async def ask(agent: ClientConnection, gestures: RealtimeGestures, question: bytes) -> None:
    """Send the question as a microphone does, and silence from then on; media time goes on meanwhile."""
    sound = question + bytes(2 * round(SILENCE * RATE))
    at = 0
    while True:
        piece = sound[at:at + 2 * PIECE] or bytes(2 * PIECE)
        at += 2 * PIECE
        await agent.send(json.dumps({"type": "input_audio_buffer.append",
                                     "audio": base64.b64encode(piece).decode()}))
        await gestures.user_sound(piece)
        await gestures.tick()
        await asyncio.sleep(PIECE / RATE)


async def converse(agent_url: str, gestures_url: str, question: bytes, recorder: Recorder) -> float:
    """One question and its answer; returns the frames per second. `ConnectionError` for an error of the agent."""
    key = os.environ.get("OPENAI_API_KEY")
    headers = {"Authorization": f"Bearer {key}"} if key else {}
    async with open_socket(agent_url, additional_headers=headers, max_size=None) as agent, \
            connect_resuming(gestures_url, Hello(RATE, options={"keep_up": True})) as stream:
        audio = {"type": "audio/pcm", "rate": RATE}
        await agent.send(json.dumps({"type": "session.update", "session": {
            "type": "realtime", "output_modalities": ["audio"],
            "audio": {"input": {"format": audio, "turn_detection": {"type": "server_vad"}},
                      "output": {"format": audio}}}}))
        gestures = RealtimeGestures(stream, recorder.play)
        showing, asking = asyncio.create_task(_show(stream, recorder)), asyncio.create_task(
            ask(agent, gestures, question))
        try:
            async for text in agent:
                event = json.loads(text)
                for answer in await gestures.take(event):
                    await agent.send(json.dumps(answer))
                if event["type"] == "error":
                    raise ConnectionError(event["error"]["message"])
                if event["type"] == "response.done" and event["response"].get("status") == "completed":
                    break
        finally:
            asking.cancel()
            await asyncio.gather(asking, return_exceptions=True)
        await stream.finish()
        await showing
        return stream.welcome.fps


async def _show(stream, recorder: Recorder) -> None:  # type: ignore[no-untyped-def]
    async for message in stream:
        if isinstance(message, Poses):
            recorder.show(message)


def add_outputs(p: argparse.ArgumentParser) -> None:
    """Add the two files that are written, and the server that gestures."""
    p.add_argument("sound", type=Path, help="WAV to write")
    p.add_argument("poses", type=Path, help="NPZ to write")
    p.add_argument("--gestures", default="ws://127.0.0.1:8765/stream")


def main(arguments: list[str] | None = None) -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("question", type=Path)
    add_outputs(p)
    p.add_argument("--agent", default="wss://api.openai.com/v1/realtime?model=gpt-realtime")
    a = p.parse_args(arguments)
    recorder = Recorder()
    with contextlib.suppress(KeyboardInterrupt):
        fps = asyncio.run(converse(a.agent, a.gestures, read_question(a.question), recorder))
        recorder.write(a.sound, a.poses, fps)
        print(f"{len(recorder.poses)} frames at {fps:g} per second, {len(recorder.sound) / RATE:.1f} s of sound")


if __name__ == "__main__":
    main()
