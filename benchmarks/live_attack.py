"""What rude clients cost the good ones: `python benchmarks/live_attack.py [--out FILE.json]`.

It takes 12 minutes, on a machine that does nothing else; `--seconds 10 --pairs 1` takes four, and its p99 is one of 60
packets or so a microphone.

A server is started on this machine, as a process with one thread; all connections are to the loopback address, those
of the attackers from another one of it (Linux has many), and bounded in number and time. So many good microphones in
low-latency mode speak, in pairs of runs one after the other, without and beside one kind of attack, so that what else
the machine does falls on both. `delay` is the time from when the last sound that a packet of poses needed was spoken to
when the packet came; `ratio` is p99 beside the attack over p99 without.

    idle       one client that sends 60 messages of a minute's idle time, again whenever it is closed
    patient    one client that always waits for as much idle time as the server lets it, without being closed
    garbage    clients that say hello, and then what is no message
    silent     40 WebSockets that say nothing
    halfopen   40 TCP connections that say nothing, and 40 that send half a request
    slow       clients that send sound and never read
    storm      30 connections a second that go at once
    guesses    30 wrong tokens a second
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import shlex
import sys
import time
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path

import numpy as np
from live import PIECE, RATE, ROOT, Server
from pipecat_gesticulator import Hello, Poses, connect
from realtime import processor
from websockets.asyncio.client import connect as open_socket
from websockets.exceptions import WebSocketException

from data_module.speech.audio import load_speech, resample
from eval.table import Cell, Column, Provenance, Table, load_with_provenance, publish

COLUMNS = {"pairs": Column("pairs of runs"), "quiet_p50": Column("p50 without", "s", 3, "low"),
           "quiet_p99": Column("p99 without", "s", 3, "low"), "loud_p50": Column("p50 beside it", "s", 3, "low"),
           "loud_p99": Column("p99 beside it", "s", 3, "low"), "ratio": Column("p99 beside over without", "", 2, "low"),
           "load": Column("load", "", 1)}
STRANGER = ("127.0.0.2", 0)
"""Where attacks come from: a server counts by addresses."""
_ENDS = (WebSocketException, OSError, TimeoutError, ValueError)


async def microphone(url: str, sound: np.ndarray, seconds: float, begin: float) -> list[float]:
    """Of each packet, what the server added, seconds."""
    found: list[float] = []
    async with connect(url, Hello(RATE, options={"latency": "low"})) as stream:
        start = time.monotonic() + begin

        async def speak() -> None:
            for k in range(round(seconds * RATE / PIECE)):
                await asyncio.sleep(max(0.0, start + (k + 1) * PIECE / RATE - time.monotonic()))
                at = k * PIECE % (len(sound) - PIECE)
                await stream.send(sound[at:at + PIECE].tobytes())
            await stream.finish()

        sending = asyncio.create_task(speak())
        found += [time.monotonic() - start - message.received async for message in stream
                  if isinstance(message, Poses) and not sending.done()]
        await sending
    return found


async def idle(url: str, port: int) -> None:
    while True:
        with contextlib.suppress(*_ENDS):
            async with open_socket(url, max_size=None, compression=None, local_addr=STRANGER) as ws:
                await ws.send(Hello(RATE).text())
                for _ in range(60):
                    await ws.send('{"type":"idle","seconds":60}')
                async for _ in ws:
                    pass
        await asyncio.sleep(0.1)


async def patient(url: str, port: int) -> None:
    """As `idle`, within what may wait: as much idle time as the server takes, without being closed."""
    with contextlib.suppress(*_ENDS):
        async with connect(url, Hello(RATE), local_addr=STRANGER) as stream:
            frames, asked = 0, 0.0
            await stream.idle(60.0)
            await stream.idle(50.0)
            asked = 110.0
            async for message in stream:
                if isinstance(message, Poses):
                    frames = message.first + len(message)
                    if asked - frames / 60 < 60:
                        await stream.idle(50.0)
                        asked += 50.0


async def garbage(url: str, port: int) -> None:
    while True:
        with contextlib.suppress(*_ENDS):
            async with connect(url, Hello(RATE), local_addr=STRANGER) as stream:
                await stream.send(b"\0")
                async for _ in stream:
                    pass
        await asyncio.sleep(0.05)


async def silent(url: str, port: int) -> None:
    async with contextlib.AsyncExitStack() as opened:
        for _ in range(40):
            with contextlib.suppress(*_ENDS):
                await opened.enter_async_context(open_socket(
                    url, compression=None, ping_interval=None, local_addr=STRANGER))
        await asyncio.sleep(3600)


async def halfopen(url: str, port: int) -> None:
    writers = []
    for number in range(80):
        with contextlib.suppress(OSError):
            _, writer = await asyncio.open_connection("127.0.0.1", port, local_addr=STRANGER)
            if number % 2:
                writer.write(b"GET /stream HTTP/1.1\r\nHost: loc")
            writers.append(writer)
    try:
        await asyncio.sleep(3600)
    finally:
        for writer in writers:
            writer.transport.abort()


async def slow(url: str, port: int) -> None:
    async def one() -> None:
        with contextlib.suppress(*_ENDS):
            async with connect(url, Hello(RATE, fps=240), local_addr=STRANGER) as stream:
                stream._socket.transport.pause_reading()
                try:
                    for _ in range(50):
                        await stream.send(bytes(2 * RATE))
                    await asyncio.sleep(3600)
                finally:
                    stream._socket.transport.abort()

    await asyncio.gather(one(), one())


async def storm(url: str, port: int) -> None:
    while True:
        with contextlib.suppress(*_ENDS):
            async with asyncio.timeout(1), connect(url, Hello(RATE), local_addr=STRANGER) as stream:
                stream._socket.transport.abort()
        await asyncio.sleep(1 / 30)


async def guesses(url: str, port: int) -> None:
    while True:
        with contextlib.suppress(*_ENDS):
            async with asyncio.timeout(1), open_socket(url, compression=None, local_addr=STRANGER) as ws:
                await ws.send(Hello(RATE, token=os.urandom(8).hex()).text())
                await ws.recv()
        await asyncio.sleep(1 / 30)


ATTACKS: dict[str, Callable[[str, int], Awaitable[None]]] = {
    "idle": idle, "patient": patient, "garbage": garbage, "silent": silent, "halfopen": halfopen, "slow": slow,
    "storm": storm, "guesses": guesses}


async def measured(server: Server, voice: np.ndarray, good: int, seconds: float, attack: str | None) -> list[float]:
    """Delays of the good clients' packets."""
    attacking = None if attack is None else asyncio.create_task(ATTACKS[attack](server.url, server.port))
    if attacking is not None:
        await asyncio.sleep(0.5)
    try:
        every = await asyncio.gather(*(microphone(server.url, np.roll(voice, k * 79190), seconds, 0.02 * k / good)
                                       for k in range(good)))
    finally:
        if attacking is not None:
            attacking.cancel()
            await asyncio.gather(attacking, return_exceptions=True)
    return [one for stream in every for one in stream]


def row(pairs: int, without: list[float], beside: list[float]) -> dict[str, Cell]:
    """Of one attack: quantiles of the good clients' delays in the runs of either kind."""
    quiet, loud = np.quantile(without, (0.5, 0.99)), np.quantile(beside, (0.5, 0.99))
    return {"pairs": str(pairs), "quiet_p50": float(quiet[0]), "quiet_p99": float(quiet[1]),
            "loud_p50": float(loud[0]), "loud_p99": float(loud[1]), "ratio": float(loud[1] / quiet[1]),
            "load": os.getloadavg()[0]}


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--good", type=int, default=4, help="microphones (default 4)")
    p.add_argument("--seconds", type=float, default=20.0, help="of each run (default 20)")
    p.add_argument("--pairs", type=int, default=2, help="of runs per attack (default 2)")
    p.add_argument("--attacks", nargs="*", choices=list(ATTACKS), default=list(ATTACKS))
    p.add_argument("--out", type=Path, metavar="FILE.json", help="a .md is written beside it; other attacks stay")
    a = p.parse_args()
    samples = resample(load_speech(ROOT / "examples" / "speech.flac"), RATE).samples
    voice = (samples * 32767).astype("<i2")
    rows: dict[str, Mapping[str, Cell]] = {}
    if a.out and a.out.exists():
        rows |= load_with_provenance(a.out)[0][0].rows
    server = Server()
    for attack in a.attacks:
        without: list[float] = []
        beside: list[float] = []
        for _ in range(a.pairs):
            without += asyncio.run(measured(server, voice, a.good, a.seconds, None))
            beside += asyncio.run(measured(server, voice, a.good, a.seconds, attack))
        rows[attack] = row(a.pairs, without, beside)
        print(attack, rows[attack], flush=True)
    ended = server.stop()
    notes = [f"{a.good} good microphones in low-latency mode, runs of {a.seconds:g} s; {processor()}. The load is that "
             "of the whole machine when a row was done: with other work on it, a ratio says little."]
    publish([Table("Attacks on the server", COLUMNS, rows, "beside", notes, {"exit_code": ended})], a.out,
            Provenance.now(shlex.join(["python", "benchmarks/live_attack.py", *sys.argv[1:]])))


if __name__ == "__main__":
    main()
