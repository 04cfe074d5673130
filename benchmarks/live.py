"""How many live streams a server carries: `python benchmarks/live.py [--seconds 20] [--out docs/results/live.json]`.

A server is started as a process with one thread. Streams send sound as a microphone does, 20 ms at a time in real
time; each reads its poses and notes how long after a sound its pose came: of the pose of each packet that waited
longest (p50, p95, p99), and of all poses (poses_p50 and so on). A stream more than a core can carry shows in the 99th
percentile. `core_share` is the server's processor time over the clock's; `other_load` the machine's load, of which a
quiet machine has none. Beside them: the server's memory before, with and after streams; a client that never reads; and
the poses of a synthesiser that delivers ten seconds in one.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import platform
import re
import signal
import subprocess
import sys
import threading
import time
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "integrations" / "pipecat-gesticulator"))

from pipecat_gesticulator import Hello, Poses, connect  # noqa: E402
from realtime import processor  # noqa: E402

from data_module.speech.audio import load_speech, resample  # noqa: E402

RATE = 16000
PIECE = RATE // 50
"""Samples in 20 ms, as a microphone's driver delivers them."""


class Server:
    """A server's process."""

    def __init__(self) -> None:
        command = "from gesticulator.serve.command import COMMAND as C; import sys; sys.exit(C.main('s', sys.argv[1:]))"
        self.process = subprocess.Popen([sys.executable, "-c", command, "--port", "0", "--streams", "256",
                                         "--core-share", "100", "--address-opens", "4"], cwd=ROOT,
                                        stderr=subprocess.PIPE, text=True)
        assert self.process.stderr is not None
        self.port = 0
        for line in self.process.stderr:
            found = re.search(r"ws://127.0.0.1:(\d+)/", line)
            self.port = int(found.group(1)) if found else self.port
            if "is ready" in line:
                break
        # The rest of the log is read, too: a full pipe would be part of what is measured.
        threading.Thread(target=self.process.stderr.read, daemon=True).start()

    @property
    def url(self) -> str:
        return f"ws://127.0.0.1:{self.port}/stream"

    def memory(self) -> float:
        """Resident memory, MB."""
        pages = int(Path(f"/proc/{self.process.pid}/statm").read_text().split()[1])
        return round(pages * os.sysconf("SC_PAGE_SIZE") / 1e6, 1)

    def processor_seconds(self) -> float:
        """Of user and system time."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def figures(self) -> str:
        with urllib.request.urlopen(f"http://127.0.0.1:{self.port}/metrics", timeout=10) as answer:
            return answer.read().decode()

    def stop(self) -> int:
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(60)


async def microphone(url: str, sound: np.ndarray, latency: str, begin: float) -> list[np.ndarray]:
    """Seconds from the time that a pose belongs to until it came, for the poses of each packet."""
    late: list[np.ndarray] = []
    async with connect(url, Hello(RATE, options={"latency": latency})) as stream:
        start = time.monotonic() + begin

        async def send() -> None:
            for k in range(0, len(sound), PIECE):
                await asyncio.sleep(max(0.0, start + (k + PIECE) / RATE - time.monotonic()))
                await stream.send(sound[k:k + PIECE].tobytes())
            await stream.finish()

        sending = asyncio.create_task(send())
        # Those after the last sound are no measure.
        late += [time.monotonic() - start - message.time - np.arange(len(message)) / message.fps
                 async for message in stream if isinstance(message, Poses) and not sending.done()]
        await sending
    return late


async def synthesiser(url: str, sound: np.ndarray) -> dict[str, float]:
    """Ten seconds at once: when the first pose is there, when the last, and how late a player would have been."""
    async with connect(url, Hello(RATE)) as stream:
        begin = time.monotonic()
        await stream.send(sound.tobytes())
        await stream.finish()
        first, late = 0.0, 0.0
        async for message in stream:
            if isinstance(message, Poses):
                first = first or time.monotonic() - begin
                late = max(late, time.monotonic() - begin - first - message.time)
        return {"first_pose": round(first, 4), "all_poses": round(time.monotonic() - begin, 4),
                "added_latency": round(max(0.0, late), 4)}


async def stall(url: str, sound: np.ndarray, seconds: float) -> None:
    """Send as much as is taken, and never read."""
    async with connect(url, Hello(RATE, fps=240)) as stream:
        stream._socket.transport.pause_reading()
        try:
            async with asyncio.timeout(seconds):
                while True:
                    await stream.send(sound.tobytes())
                    await asyncio.sleep(0.5)
        except Exception as error:  # noqa: BLE001 - it is meant to be closed
            print("stalled client:", type(error).__name__)
        stream._socket.transport.abort()


async def load(server: Server, sound: np.ndarray, count: int, latency: str) -> dict[str, Any]:
    """So many microphones at once."""
    spent, clock = server.processor_seconds(), time.monotonic()
    every = await asyncio.gather(*(microphone(server.url, np.roll(sound, k * 7919), latency, 0.02 * k / count)
                                   for k in range(count)))
    packets = [packet for one in every for packet in one]
    # The first pose of a packet has waited longest.
    waits = {"": [packet[0] for packet in packets], "poses_": np.concatenate(packets)}
    return {"streams": count, "latency_mode": latency,
            **{f"{name}p{share}": round(float(np.percentile(late, share)), 4)
               for name, late in waits.items() for share in (50, 95, 99)},
            "memory": server.memory(),
            "core_share": round((server.processor_seconds() - spent) / (time.monotonic() - clock), 3),
            "other_load": round(os.getloadavg()[0], 1)}


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("--seconds", type=float, default=20.0)
    p.add_argument("--streams", type=int, nargs="*", default=[1, 4, 8, 16])
    p.add_argument("--speech", default=str(ROOT / "examples" / "speech.flac"))
    p.add_argument("--out", type=Path)
    a = p.parse_args()
    samples = resample(load_speech(a.speech), RATE).samples
    voice = np.resize((samples * 32767).astype("<i2"), int(a.seconds * RATE))
    server = Server()
    report: dict[str, Any] = {"processor": processor(), "cores": os.cpu_count(), "threads": 1,
                              "python": platform.python_version(), "seconds": a.seconds,
                              "memory_before": server.memory()}
    report["synthesiser"] = asyncio.run(synthesiser(server.url, voice[:10 * RATE]))
    report["microphone"] = []
    for latency, counts in (("full", [1]), ("low", a.streams)):
        for count in counts:
            report["microphone"].append(asyncio.run(load(server, voice, count, latency)))
            print(report["microphone"][-1], flush=True)

    async def beside() -> dict[str, Any]:
        stalled = asyncio.create_task(stall(server.url, voice[:5 * RATE], a.seconds))
        row = await load(server, voice, 1, "low")
        await stalled
        return row

    report["beside_a_stalled_client"] = asyncio.run(beside())
    report["memory_after"] = server.memory()
    # By processor time, so that what else the machine does counts little.
    one = next(row for row in report["microphone"] if row["latency_mode"] == "low")
    report["streams_per_core"] = round(one["streams"] / one["core_share"], 1)
    report["compute"] = [line for line in server.figures().splitlines() if line.startswith("gesticulator_compute_")]
    report["exit_code"] = server.stop()
    print(json.dumps(report, indent=1))
    if a.out:
        a.out.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
