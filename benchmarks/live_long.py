"""What a server does for long: `python benchmarks/live_long.py carry|hour [--out docs/results/live-long.json]`.

`carry`: so many microphones at once, in real time, for so many seconds. `delay` is the time from when the last sound
that a packet of poses needed was spoken to when the packet came: what the server adds, beyond the look-ahead. It
should stay below a block (0.33 s in the mean). `hurried` and `passed` are the shares of the sound that were drawn at
less cost, or not at all.

`hour`: sessions of an hour, sent as fast as they are answered: a conversation (speech, another's voice, thought,
idling, interruptions) and silence. Memory is the server's, at every tenth of the way.

The figures of a job are put under its name into the file; those of the other job stay.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
from live import PIECE, RATE, ROOT, Server
from pipecat_gesticulator import GestureStream, Hello, Poses, connect
from realtime import processor

from data_module.speech.audio import load_speech, resample

AHEAD = 30.0
"""Seconds of media time that are asked for before their answers: what a server takes at once is 120 s of sound."""


async def microphone(url: str, sound: np.ndarray, seconds: float, begin: float, latency: str
                     ) -> list[tuple[float, float]]:
    """Of each packet, in seconds: what the server added, and from the time that its first pose belongs to until it
    came. sound: repeated."""
    found: list[tuple[float, float]] = []
    async with connect(url, Hello(RATE, options={"latency": latency, "keep_up": True})) as stream:
        start = time.monotonic() + begin
        sending = asyncio.create_task(_speak(stream, sound, seconds, start))
        async for message in stream:
            if isinstance(message, Poses) and not sending.done():
                now = time.monotonic() - start
                found.append((now - message.received, now - message.time))
        await sending
    return found


async def _speak(stream: GestureStream, sound: np.ndarray, seconds: float, start: float) -> None:
    for k in range(round(seconds * RATE / PIECE)):
        await asyncio.sleep(max(0.0, start + (k + 1) * PIECE / RATE - time.monotonic()))
        at = k * PIECE % (len(sound) - PIECE)
        await stream.send(sound[at:at + PIECE].tobytes())
    await stream.finish()


def counted(server: Server, name: str) -> float:
    """A counter of the server."""
    return float(server.figures().split(f"\ngesticulator_{name}{{")[1].split()[1])


async def carry(server: Server, voice: np.ndarray, count: int, seconds: float, latency: str) -> dict[str, Any]:
    """So many microphones for so long, in a latency mode."""
    names = ("hurried_seconds_total", "passed_seconds_total", "sound_seconds_total")
    before = [counted(server, name) for name in names]
    spent, clock, memory = server.processor_seconds(), time.monotonic(), []

    async def watch() -> None:
        while True:
            memory.append(server.memory())
            await asyncio.sleep(max(seconds / 10, 1.0))

    watching = asyncio.create_task(watch())
    every = await asyncio.gather(*(microphone(server.url, np.roll(voice, k * 79190), seconds, PIECE / RATE * k / count,
                                              latency)
                                   for k in range(count)))
    watching.cancel()
    took = time.monotonic() - clock
    hurried, passed, sound = (counted(server, name) - old for name, old in zip(names, before, strict=True))
    packets = np.array([one for stream in every for one in stream])

    def quantiles(values: np.ndarray) -> dict[str, float]:
        return {f"p{round(q * 100)}": round(float(np.quantile(values, q)), 4) for q in (0.5, 0.95, 0.99)}

    return {"streams": count, "latency_mode": latency, "seconds": seconds, "packets": len(packets),
            "delay": quantiles(packets[:, 0]), "latency": quantiles(packets[:, 1]),
            "hurried": round(hurried / sound, 4), "passed": round(passed / sound, 4),
            "core_share": round((server.processor_seconds() - spent) / took, 3),
            "memory": memory, "load": round(os.getloadavg()[0], 1)}


class _Session:
    """One client that asks for media time as fast as it is answered."""

    def __init__(self, server: Server, stream: GestureStream) -> None:
        self.server, self.stream, self.time, self.frames, self.gaps = server, stream, 0.0, 0, 0
        self.memory: list[float] = []
        self._reading = asyncio.create_task(self._read())
        self._moved = asyncio.Event()

    async def _read(self) -> None:
        async for message in self.stream:
            if isinstance(message, Poses):
                self.gaps += message.first > self.frames
                self.frames = message.first + len(message)
                self._moved.set()

    async def room(self, ahead: float = AHEAD) -> None:
        """Wait until the poses are so near to the media time that was asked for, seconds."""
        while self.time - self.frames / 60 > ahead:
            self._moved.clear()
            await self._moved.wait()

    async def turn(self, voice: np.ndarray, interrupted: bool) -> None:
        """She speaks for 6 s, or is interrupted 2 s before their end, listens for 4 s, thinks, waits."""
        await self.stream.speak()
        await self.stream.send(voice[:6 * RATE].tobytes())
        self.time += 6.0
        if interrupted:
            await self.stream.idle(0.0)
            await self.room(0.02)
            self.time -= 2.0
            await self.stream.interrupt(self.time)
            self.frames = round(self.time * 60)  # what was played; the others are made once more
        await self.stream.listen()
        await self.stream.send(voice[6 * RATE:10 * RATE].tobytes())
        await self.stream.think(0.5)
        await self.stream.idle(1.5)
        self.time += 6.0

    async def end(self) -> None:
        await self.stream.finish()
        await self._reading


async def hour(server: Server, voice: np.ndarray, kind: str, seconds: float) -> dict[str, Any]:
    """One session of so many seconds of media time."""
    spent, clock = server.processor_seconds(), time.monotonic()
    async with connect(server.url, Hello(RATE)) as stream:
        session, turn = _Session(server, stream), 0
        while session.time < seconds:
            if len(session.memory) <= 10 * session.time / seconds:
                session.memory.append(server.memory())
            if kind == "silence":
                await stream.send(bytes(2 * RATE * 10))
                session.time += 10.0
            else:
                await session.turn(np.roll(voice, turn * 79190), interrupted=turn % 4 == 3)
            turn += 1
            await session.room()
        await session.end()
        session.memory.append(server.memory())
    return {"seconds": round(session.time, 2), "frames": session.frames, "gaps": session.gaps,
            "took": round(time.monotonic() - clock, 1), "memory": session.memory,
            "core_share": round((server.processor_seconds() - spent) / session.time, 4)}


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("job", choices=("carry", "hour"))
    p.add_argument("--streams", type=int, nargs="*", default=[16], help="of carry")
    p.add_argument("--latency", choices=("low", "full"), default="low", help="of carry")
    p.add_argument("--seconds", type=float, nargs="*", help="of each run (default 600, or 3600)")
    p.add_argument("--speech", default=str(ROOT / "examples" / "speech.flac"))
    p.add_argument("--out", type=Path)
    a = p.parse_args()
    samples = resample(load_speech(a.speech), RATE).samples
    voice = (samples * 32767).astype("<i2")
    server = Server()
    report: dict[str, Any] = {"processor": processor(), "cores": os.cpu_count(), "threads": 1}
    if a.job == "carry":
        seconds = a.seconds or [600.0]
        report["runs"] = []
        for count, length in zip(a.streams, np.resize(seconds, len(a.streams)), strict=True):
            report["runs"].append(asyncio.run(carry(server, voice, count, float(length), a.latency)))
            print(report["runs"][-1], flush=True)
    else:
        for kind in ("conversation", "silence"):
            report[kind] = asyncio.run(hour(server, voice, kind, (a.seconds or [3600.0])[0]))
            print(kind, report[kind], flush=True)
    report["exit_code"] = server.stop()
    if a.out:
        stored = json.loads(a.out.read_text()) if a.out.exists() else {}
        a.out.write_text(json.dumps({**stored, a.job: report}, indent=1) + "\n")


if __name__ == "__main__":
    main()
