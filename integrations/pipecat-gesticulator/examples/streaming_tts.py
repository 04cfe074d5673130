"""Have a text spoken by a synthesiser that streams its sound over HTTP, with gestures while it comes.

    gesticulator serve
    OPENAI_API_KEY=... python streaming_tts.py "It was this big." speech.wav speech.npz

The synthesiser takes JSON and answers with raw 16-bit mono sound at 24 kHz, in chunks, as OpenAI's `/v1/audio/speech`
does with the format "pcm"; `--synthesiser` names another one. Frame k of the poses is shown at k / fps seconds of the
WAV.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import urllib.request
from collections.abc import AsyncIterator
from pathlib import Path

from pipecat_gesticulator import Hello, Poses, connect
from realtime_agent import RATE, Recorder

CHUNK = 4800
"""Bytes that are read at most at a time: 0.1 s."""


async def spoken(url: str, text: str) -> AsyncIterator[bytes]:
    """Pieces of sound as they come, of whole samples."""
    headers = {"Content-Type": "application/json"}
    if key := os.environ.get("OPENAI_API_KEY"):
        headers["Authorization"] = f"Bearer {key}"
    body = {"model": "gpt-4o-mini-tts", "voice": "alloy", "input": text, "response_format": "pcm"}
    asked = urllib.request.Request(url, json.dumps(body).encode(), headers)
    with await asyncio.to_thread(urllib.request.urlopen, asked, timeout=60) as answer:
        rest = b""
        while chunk := await asyncio.to_thread(answer.read1, CHUNK):
            sound = rest + chunk
            whole = len(sound) // 2 * 2  # a chunk may end within a sample
            rest = sound[whole:]
            yield sound[:whole]


async def speak(synthesiser: str, gestures: str, text: str, recorder: Recorder) -> float:
    """Speak a text; returns the frames per second."""
    async with connect(gestures, Hello(RATE)) as stream:
        async def send() -> None:
            sent = 0
            try:
                async for sound in spoken(synthesiser, text):
                    recorder.play(sound, sent / RATE)
                    sent += len(sound) // 2
                    await stream.send(sound)
            finally:
                await stream.finish()

        sending = asyncio.create_task(send())
        async for message in stream:
            if isinstance(message, Poses):
                recorder.show(message)
        await sending
        return stream.welcome.fps


def main(arguments: list[str] | None = None) -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("text")
    p.add_argument("sound", type=Path, help="WAV to write")
    p.add_argument("poses", type=Path, help="NPZ to write")
    p.add_argument("--synthesiser", default="https://api.openai.com/v1/audio/speech")
    p.add_argument("--gestures", default="ws://127.0.0.1:8765/stream")
    a = p.parse_args(arguments)
    recorder = Recorder()
    fps = asyncio.run(speak(a.synthesiser, a.gestures, a.text, recorder))
    recorder.write(a.sound, a.poses, fps)
    print(f"{len(recorder.poses)} frames at {fps:g} per second, {len(recorder.sound) / RATE:.1f} s of sound")


if __name__ == "__main__":
    main()
