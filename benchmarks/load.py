"""Load for a server that runs somewhere: `python benchmarks/load.py ws://127.0.0.1:8765/stream --clients 50 --ramp 30`.

Clients speak the server's protocol by the reference client. They come one after the other within --ramp seconds; each
sends --seconds of speech as it is spoken, 20 ms at a time, reads its poses, and goes. The report has

    answer    seconds from when a sound was sent until the pose of its time came, for each packet of poses
    dropped   streams that were refused or closed before they were done, by code
    missing   frames that did not come in streams that were done
    passed    seconds of sound, over all streams, that the server only idled to because it was late

With --beside there is one client, alone and then beside another that sends the largest valid message of a type as often
as it can, from a process of its own, and opens another stream where it is refused. Five such pairs for each type give
answers' p50 and p99, and the ratio of each; --out adds them to a file of JSON.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import math
import multiprocessing
import sys
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "integrations" / "pipecat-gesticulator"))

from pipecat_gesticulator import GestureStream, Hello, Poses, connect  # noqa: E402
from websockets.asyncio.client import connect as open_socket  # noqa: E402
from websockets.exceptions import ConnectionClosed, InvalidHandshake  # noqa: E402

RATE = 16000
PIECE_SECONDS = 0.02
"""As a microphone's driver delivers."""
BOUND = 1.3
"""Greatest ratio of the 99th percentiles of answers beside another client and alone."""
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
                "passed_seconds": round(self.passed, 1), "answer": dict(zip(
                    ("p50", "p95", "p99", "longest"), percentiles(self.answers, 50, 95, 99, 100), strict=True))}


def percentiles(times: Sequence[float], *percent: int) -> list[float]:
    """Percentiles, seconds; infinite where there are no times."""
    return np.percentile(times or [math.inf], percent).round(4).tolist()


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


HELLO = Hello(RATE, fps=60.0, options={"latency": "low"})
COSTLY = json.dumps({"type": "hello", "protocol": 1, "sample_rate": 8000, "fps": 240,
                     "options": {"text": True, "legs": True, "face": "full", "latency": "low"}})
MESSAGES: dict[str, dict[str, Any]] = {
    "hello": {}, "sound": {}, "idle": {"seconds": 60}, "think": {"seconds": 60}, "interrupt": {"time": 0.1234567890123},
    "listen": {}, "speak": {}, "finish": {}, "words": {"words": [
        {"text": f"{'[shrug]' if at < 100 else ''}{15 * 'extraordinary '}"[:200], "start": at / 4, "end": at / 4}
        for at in range(1000)]},
}
"""Type of message -> members of the largest valid one, in a stream that costs most; of the sound a minute at once."""


async def attack(url: str, kind: str) -> None:
    """Send messages of a type, and read the answers, without end."""
    message = example_voice(65.0) if kind == "sound" else json.dumps({"type": kind, **MESSAGES[kind]})
    # More than two minutes of sound or idling would be refused before they are computed.
    pause = 2.5 if kind in ("sound", "idle", "think") else 0.0
    while True:
        with suppress(OSError, InvalidHandshake, ConnectionClosed, AttributeError):  # the last: websockets' own
            async with open_socket(url, max_size=None, compression=None) as socket:
                await socket.send(COSTLY)
                await socket.recv()
                if kind != "hello":  # after which no other may come
                    await asyncio.gather(again(pause, socket.send, message), again(0.0, socket.recv))


async def again(pause: float, call: Callable[..., Awaitable[Any]], *arguments: Any) -> None:
    """Call it until it raises an exception, with pauses in seconds."""
    while True:
        await call(*arguments)
        await asyncio.sleep(pause)


def beside(url: str, kind: str, seconds: float, pairs: int) -> dict[str, Any]:
    """[p50, p99] of one client's answers and the seconds that it was passed over, alone and beside an attack, and the
    ratio of the answers: medians over the pairs."""
    sound, rows = example_voice(seconds), []
    for _ in range(pairs):
        for attacks in (False, True):
            other = multiprocessing.Process(target=lambda: asyncio.run(attack(url, kind)), daemon=True)
            if attacks:
                other.start()
                time.sleep(2.0)
            found = asyncio.run(load(url, 1, 0.0, HELLO, sound))
            rows.append([*percentiles(found.answers, 50, 99), found.passed])
            if attacks:
                other.kill()
                other.join()
        print(kind, *np.round(rows[-2:], 3).tolist(), flush=True)
    alone, attacked = np.array(rows[::2]), np.array(rows[1::2])
    return {name: np.median(values, axis=0).round(3).tolist() for name, values in (
        ("alone", alone), ("beside", attacked), ("ratio", attacked[:, :2] / alone[:, :2]))}


def main() -> None:
    """Entry point; exit code 1 where a stream was dropped, or another client took more than `BOUND`."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("url", help="such as ws://127.0.0.1:8765/stream")
    p.add_argument("--clients", type=int, default=8)
    p.add_argument("--ramp", type=float, default=5.0, help="seconds in which they come (default 5)")
    p.add_argument("--seconds", type=float, default=20.0, help="of speech that each sends (default 20)")
    p.add_argument("--beside", nargs="*", choices=MESSAGES, metavar="TYPE", help="types of messages (default: all)")
    p.add_argument("--pairs", type=int, default=5)
    p.add_argument("--out", type=Path, metavar="FILE.json")
    a = p.parse_args()
    if a.beside is not None:
        rows = {kind: beside(a.url, kind, a.seconds, a.pairs) for kind in a.beside or MESSAGES}
        print(json.dumps(rows, indent=1))
        if a.out:
            document = json.loads(a.out.read_text()) if a.out.is_file() else {}
            a.out.write_text(json.dumps({**document, "beside": rows}, indent=1) + "\n")
        sys.exit(any(row["ratio"][1] > BOUND for row in rows.values()))
    figures = asyncio.run(load(a.url, a.clients, a.ramp, HELLO, example_voice(a.seconds)))
    print(json.dumps(figures.report(), indent=1))
    sys.exit(figures.done < a.clients)


if __name__ == "__main__":
    main()
