"""Load for a server that runs somewhere: `python benchmarks/load.py ws://127.0.0.1:8765/stream --clients 50 --ramp 30`.

Clients speak the server's protocol by the reference client. They come one after the other within --ramp seconds; each
sends --seconds of speech as it is spoken, 20 ms at a time, reads its poses, and goes. The report has

    answer    seconds from when a sound was sent until the pose of its time came, for each packet of poses
    dropped   streams that were refused or closed before they were done, by code
    missing   frames that did not come in streams that were done
    passed    seconds of sound, over all streams, that the server only idled to because it was late
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


@dataclass
class LoadFigures:
    """Measured by the clients. Times are seconds; closed: code (or `REFUSED`) -> how many streams."""

    answers: list[float] = field(default_factory=list)
    closed: Counter[str] = field(default_factory=Counter)
    done: int = 0
    missing: int = 0
    passed: float = 0.0

    def report(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {"done": self.done, "dropped": dict(self.closed), "missing_frames": self.missing,
                "passed_seconds": round(self.passed, 1), "answer": percentiles(self.answers)}


def percentiles(times: Sequence[float]) -> dict[str, float]:
    """p50, p95, p99 and the longest, seconds; nothing where there are no times."""
    values = np.percentile(times, [50, 95, 99, 100]) if times else []
    return {name: round(float(value), 4) for name, value in zip(("p50", "p95", "p99", "longest"), values, strict=False)}


class Voice:
    """Sends a sound piece by piece and knows when each moment of it was sent."""

    def __init__(self, sound: bytes) -> None:
        self._sound, self._step = sound, round(PIECE_SECONDS * RATE) * 2
        self.sent_at: list[float] = []

    async def send(self, stream: GestureStream) -> None:
        """Send it from its beginning to its end."""
        begin = time.monotonic()
        for number, start in enumerate(range(0, len(self._sound), self._step)):
            # A piece can be sent once it was spoken to its end.
            due = begin + (number + 1) * PIECE_SECONDS
            await asyncio.sleep(max(0.0, due - time.monotonic()))
            self.sent_at.append(time.monotonic())
            await stream.send(self._sound[start:start + self._step])
        await stream.finish()

    def since(self, moment: float) -> float | None:
        """Seconds since the sound of a moment of media time was sent; None where it was not."""
        piece = int(moment * RATE * 2 / self._step)
        return time.monotonic() - self.sent_at[piece] if piece < len(self.sent_at) else None


async def run_client(url: str, hello: Hello, sound: bytes, figures: LoadFigures) -> None:
    """One stream from its hello to its end."""
    voice, frames, code, passed = Voice(sound), 0, REFUSED, 0.0
    try:
        async with connect(url, hello) as stream:
            sending = asyncio.create_task(voice.send(stream))
            code = "ended"
            try:
                async for message in stream:
                    if isinstance(message, Poses):
                        frames += len(message)
                        since = voice.since(message.time)
                        if since is not None:
                            figures.answers.append(since)
                    elif message.get("type") == "pace":
                        passed = float(message["passed"])
                    elif message.get("type") == "done":
                        code = "1000"
                    elif message.get("type") == "error":
                        code = str(message["code"])
            finally:
                sending.cancel()
                await asyncio.gather(sending, return_exceptions=True)
    except ConnectionClosed as error:
        # An error message may have told it before.
        if code == "ended":
            code = str(error.rcvd.code if error.rcvd else 1006)
    except (OSError, InvalidHandshake, TimeoutError, ValueError) as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
    figures.passed += passed
    if code == "1000":
        figures.done += 1
        figures.missing += max(0, math.floor(len(sound) / 2 / RATE * hello.fps + 1e-6) - frames)
    else:
        figures.closed[code] += 1


async def load(url: str, clients: int, ramp: float, hello: Hello, sound: bytes) -> LoadFigures:
    """Run the clients. hello: the first message of each, but for its seed; sound: PCM of 16 bits at `RATE`."""
    figures = LoadFigures()

    async def client(number: int) -> None:
        await asyncio.sleep(ramp * number / clients)
        # Each begins at another place, so that their blocks do not fall due together.
        shifted = np.roll(np.frombuffer(sound, "<i2"), -7919 * number).tobytes()
        await run_client(url, replace(hello, seed=number), shifted, figures)

    await asyncio.gather(*map(client, range(clients)))
    return figures


def example_voice(seconds: float) -> bytes:
    """The example over and over, as PCM of 16 bits at `RATE`."""
    from data_module.speech.audio import load_speech, resample

    samples = resample(load_speech(ROOT / "examples" / "speech.flac"), RATE).samples
    return np.resize((samples * 32767).astype("<i2"), int(seconds * RATE)).tobytes()


def main() -> None:
    """Entry point; exit code 1 where a stream was dropped."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("url", help="such as ws://127.0.0.1:8765/stream")
    p.add_argument("--clients", type=int, default=8)
    p.add_argument("--ramp", type=float, default=5.0, help="seconds in which they come (default 5)")
    p.add_argument("--seconds", type=float, default=20.0, help="of speech that each sends (default 20)")
    a = p.parse_args()
    hello = Hello(RATE, fps=60.0, options={"latency": "low"})
    figures = asyncio.run(load(a.url, a.clients, a.ramp, hello, example_voice(a.seconds)))
    print(json.dumps(figures.report(), indent=1))
    sys.exit(figures.done < a.clients)


if __name__ == "__main__":
    main()
