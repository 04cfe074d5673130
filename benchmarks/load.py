"""Load for a server that runs somewhere: `python benchmarks/load.py ws://127.0.0.1:8765/stream --clients 50 --ramp 30`.

Clients speak the server's protocol by the reference client. They come one after the other within --ramp seconds; each
sends --seconds of speech 20 ms at a time, --pace times as fast as it is spoken (0: all at once), reads its poses, and
goes. The report has

    answer    seconds from when a sound was sent until the pose of its time came, for each packet of poses
    hello     seconds from connecting to the server's hello
    dropped   streams that were refused or closed before they were done, by code
    missing   frames that did not come in streams that were done
"""

from __future__ import annotations

import argparse
import asyncio
import json
import math
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "integrations" / "pipecat-gesticulator"))

from pipecat_gesticulator import GestureStream, Hello, Poses, connect  # noqa: E402
from websockets.exceptions import ConnectionClosed, InvalidHandshake  # noqa: E402

RATE = 16000
PIECE_SECONDS = 0.02
"""As a microphone's driver delivers."""
REFUSED = "refused"
"""In place of a close code: there was no connection, or the hello was answered by an error."""
QUANTILES = (50, 95, 99)


@dataclass(frozen=True)
class LoadPlan:
    """url: of the stream; clients: how many; ramp: seconds in which they come; pace: times real time, 0 for all at
    once; hello: the first message of each, but for its seed."""

    url: str
    clients: int
    ramp: float
    pace: float = 1.0
    hello: Hello = field(default_factory=lambda: Hello(RATE))


@dataclass
class LoadFigures:
    """Measured by the clients. Times are seconds; closed: code (or `REFUSED`) -> how many streams."""

    answers: list[float] = field(default_factory=list)
    hellos: list[float] = field(default_factory=list)
    closed: Counter[str] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    done: int = 0
    frames: int = 0
    missing: int = 0
    sent_bytes: int = 0
    received_bytes: int = 0
    paces: int = 0

    def report(self, plan: LoadPlan, seconds: float, wall: float) -> dict[str, Any]:
        """Ready for JSON."""
        return {"clients": plan.clients, "pace": plan.pace, "ramp": plan.ramp, "sound_seconds": seconds,
                "wall_seconds": round(wall, 2), "done": self.done, "dropped": dict(self.closed),
                "reasons": dict(self.reasons.most_common(5)), "missing_frames": self.missing, "frames": self.frames,
                "hello": quantiles(self.hellos), "answer": quantiles(self.answers),
                "sent_bytes": self.sent_bytes, "received_bytes": self.received_bytes, "pace_changes": self.paces,
                "sound_per_second": round(self.done * seconds / wall, 2)}


def quantiles(times: Sequence[float]) -> dict[str, float]:
    """p50, p95, p99 and the longest, seconds; nothing where there are no times."""
    if not len(times):
        return {}
    values = np.quantile(times, [one / 100 for one in QUANTILES])
    return {**{f"p{name}": round(float(value), 4) for name, value in zip(QUANTILES, values, strict=True)},
            "longest": round(float(max(times)), 4)}


class Voice:
    """Sends a sound piece by piece and knows when each moment of it was sent."""

    def __init__(self, sound: bytes, pace: float) -> None:
        self._sound, self._pace = sound, pace
        self._step = round(PIECE_SECONDS * RATE) * 2 if pace else len(sound)
        self.sent_at: list[float] = []

    @property
    def sent_bytes(self) -> int:
        """How much of it went."""
        return min(len(self._sound), len(self.sent_at) * self._step)

    async def send(self, stream: GestureStream) -> None:
        """Send it from the beginning."""
        begin = time.monotonic()
        for number, start in enumerate(range(0, len(self._sound), self._step)):
            if self._pace:
                # A piece can be sent once it was spoken to its end.
                due = begin + (number + 1) * PIECE_SECONDS / self._pace
                await asyncio.sleep(max(0.0, due - time.monotonic()))
            self.sent_at.append(time.monotonic())
            await stream.send(self._sound[start:start + self._step])

    def since(self, moment: float) -> float | None:
        """Seconds since the sound of a moment of media time was sent; None where it was not."""
        piece = int(moment * RATE * 2 / self._step)
        return time.monotonic() - self.sent_at[piece] if piece < len(self.sent_at) else None


async def run_client(plan: LoadPlan, hello: Hello, sound: bytes, seen: LoadFigures) -> None:
    """One stream from its hello to its end."""
    voice, begin, frames = Voice(sound, plan.pace), time.monotonic(), 0
    code, reason = REFUSED, ""
    try:
        async with connect(plan.url, hello) as stream:
            seen.hellos.append(time.monotonic() - begin)
            sending = asyncio.create_task(_all(voice, stream))
            code, reason = "ended", "the server ended the stream before it was done"
            try:
                async for message in stream:
                    if isinstance(message, Poses):
                        frames += len(message)
                        seen.received_bytes += message.rotations.nbytes + message.root_positions.nbytes
                        since = voice.since(message.time)
                        if since is not None:
                            seen.answers.append(since)
                    elif message.get("type") == "pace":
                        seen.paces += 1
                    elif message.get("type") == "done":
                        code = "1000"
                    elif message.get("type") == "error":
                        code, reason = str(message["code"]), str(message["message"])
            finally:
                sending.cancel()
                await asyncio.gather(sending, return_exceptions=True)
    except ConnectionClosed as error:
        # An error message may have told it before.
        if code in ("ended", REFUSED):
            reason = error.rcvd.reason if error.rcvd else "cut"
        if code == "ended":
            code = str(error.rcvd.code if error.rcvd else 1006)
    except (OSError, InvalidHandshake, TimeoutError, ValueError) as error:
        reason = " ".join(str(error).split())[:100] or type(error).__name__
    seen.sent_bytes += voice.sent_bytes
    seen.frames += frames
    if code == "1000":
        seen.done += 1
        seen.missing += max(0, math.floor(len(sound) / 2 / RATE * hello.fps + 1e-6) - frames)
    else:
        seen.closed[code] += 1
        seen.reasons[reason] += 1


async def _all(voice: Voice, stream: GestureStream) -> None:
    await voice.send(stream)
    await stream.finish()


async def load(plan: LoadPlan, sound: bytes) -> dict[str, Any]:
    """Run the clients and report their figures. sound: PCM of 16 bits at `RATE`."""
    seen, begin = LoadFigures(), time.monotonic()

    async def client(number: int) -> None:
        await asyncio.sleep(plan.ramp * number / plan.clients)
        # Each begins at another place, so that their blocks do not fall due together.
        shifted = np.roll(np.frombuffer(sound, "<i2"), -7919 * number).tobytes()
        await run_client(plan, replace(plan.hello, seed=number), shifted, seen)

    await asyncio.gather(*map(client, range(plan.clients)))
    return seen.report(plan, len(sound) / 2 / RATE, time.monotonic() - begin)


def voice_of(path: Path, seconds: float) -> bytes:
    """A recording over and over, as PCM of 16 bits at `RATE`."""
    from data_module.speech.audio import load_speech, resample

    samples = resample(load_speech(path), RATE).samples
    return np.resize((samples * 32767).astype("<i2"), int(seconds * RATE)).tobytes()


def main() -> None:
    """Entry point; exit code 1 where a stream was dropped."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("url", help="such as ws://127.0.0.1:8765/stream")
    p.add_argument("--clients", type=int, default=8)
    p.add_argument("--ramp", type=float, default=5.0, help="seconds in which they come (default 5)")
    p.add_argument("--seconds", type=float, default=20.0, help="of speech that each sends (default 20)")
    p.add_argument("--pace", type=float, default=1.0, help="times real time; 0 sends all at once (default 1)")
    p.add_argument("--latency", choices=("low", "full"), default="low")
    p.add_argument("--fps", type=float, default=60.0)
    p.add_argument("--token-file", type=Path, help="a file with the server's token")
    p.add_argument("--speech", type=Path, default=ROOT / "examples" / "speech.flac")
    p.add_argument("--out", type=Path, metavar="FILE.json")
    a = p.parse_args()
    token = a.token_file.read_text().strip() if a.token_file else None
    hello = Hello(RATE, fps=a.fps, options={"latency": a.latency}, token=token)
    plan = LoadPlan(a.url, a.clients, a.ramp, a.pace, hello)
    report = asyncio.run(load(plan, voice_of(a.speech, a.seconds)))
    print(json.dumps(report, indent=1))
    if a.out is not None:
        a.out.write_text(json.dumps(report, indent=1) + "\n")
    sys.exit(report["done"] < report["clients"])


if __name__ == "__main__":
    main()
