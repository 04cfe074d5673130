"""A server for long, with everything that goes wrong: `python benchmarks/soak.py [--minutes 80] [--streams 8]
[--out docs/results/soak]`.

A server with two workers serves mixed streams: microphones in both modes, synthesisers that send an answer at once
and the next one when it was played, conversations with another's voice, thought, waits and interruptions, streams with
faces and of SMPL-X. Sound is sent in pieces of any length, from one sample to ten seconds. Each client resumes its
stream by the reference client, and opens the next one when it is over. Meanwhile, as long as the run lasts:

    attackers  each attack of `live_attack.py` in turn, for 20 s of every minute (`--attack-every`), in a process of its
               own, from another address and with a key of its own
    kills      a client's connection is cut (a few a minute), and one of the two workers is killed (`--kills` times)
    full disk  for a minute in every six no file may grow (RLIMIT_FSIZE of the server's processes), as on a disk that is
               full: metrics and the log cannot be written

What must hold: **nothing lost** (each stream has every frame of its media time, after what was interrupted, and none
fails), **nothing twice** (each one once, and at the end at most the frame in which the sound ends),
**memory** of every process at no time more than 5 % above that after its first ten minutes with streams, no
**descriptor** more after the last stream than before the first one, and the server ends with exit code 0. The exit
code is 1 where it does not. A client never sends more than the server answers within `AHEAD` seconds, so a slow machine
makes the run thinner and not wrong; latency is not measured here. Sound that the server processed at lower cost, since
the machine was short of time, is in the table, as is the processor's time.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import math
import os
import re
import resource
import secrets
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections import deque
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import live_attack
import numpy as np
from live import RATE, ROOT
from pipecat_gesticulator import Hello, Poses, connect_resuming
from pipecat_gesticulator.resuming import ResumingStream
from realtime import processor

from data_module.files import write_text
from data_module.speech.audio import load_speech, resample

SETTLED = 600.0
"""Seconds after which a process's memory is the one that it may not exceed by more than `GROWTH`."""
GROWTH = 0.05
AHEAD = 12.0
"""Seconds of media time that a client asks for before they are answered."""
LONGEST_SILENCE = 120.0
"""Seconds without a frame that is due, after which a stream has failed."""
FULL_EVERY, FULL_FOR = 360.0, 60.0
"""Seconds from one full disk to the next, and that it lasts."""
CUT_EVERY = 20.0
"""Seconds between two connections that are cut."""
ATTACK_SECONDS = 20.0
LESSER = {"shortened_seconds_total": "seconds of sound processed with low look-ahead in place of full",
          "hurried_seconds_total": "seconds of sound processed in a hurry",
          "passed_seconds_total": "seconds of sound passed over",
          "resumed_total": "streams that a client came back to, by the server's count",
          "wrong_tokens_total": "wrong tokens", "closed_total": "connections that the server closed",
          "refused_total": "requests that the server refused"}
"""Counters of the server -> what the table calls them."""
KINDS: dict[str, dict[str, Any]] = {
    "microphone": {"options": {"latency": "low"}},
    "full microphone": {"options": {"keep_up": True}},
    "synthesiser": {},
    "conversation": {},
    "interrupted": {},
    "face": {"options": {"face": "full", "latency": "low"}},
    "smplx": {"output": "smplx", "fps": 30.0},
    "24 kHz": {"sample_rate": 24000},
}


class Processes:
    """The server and its workers, started with two tenants' keys."""

    def __init__(self, folder: Path, workers: int) -> None:
        self.good, self.rude = secrets.token_hex(16), secrets.token_hex(16)
        keys, self.log = folder / "keys.txt", folder / "server.log"
        keys.write_text(f"good {self.good} priority=1\nrude {self.rude} streams=4\n")
        command = "from gesticulator.serve.command import COMMAND as C; import sys; sys.exit(C.main('s', sys.argv[1:]))"
        self.process = subprocess.Popen(
            [sys.executable, "-c", command, "--port", "0", "--workers", str(workers), "--streams", "64",
             "--core-share", "100", "--address-opens", "4", "--keys-file", str(keys), "--drain-seconds", "2",
             "--metrics-port", "0"], cwd=ROOT,
            stderr=self.log.open("w"), env={**os.environ, "TMPDIR": str(folder)})
        self.port = 0
        try:
            while (text := self.log.read_text()).count("is ready") < workers:
                if self.process.poll() is not None:
                    raise RuntimeError(text)
                time.sleep(0.5)
        except BaseException:
            self.process.terminate()
            raise
        self.port = int(re.findall(r"ws://127.0.0.1:(\d+)/", text)[0])
        self.figures = re.findall(r"metrics at (http://\S+)", text)[0]

    @property
    def url(self) -> str:
        return f"ws://127.0.0.1:{self.port}/stream"

    def workers(self) -> list[int]:
        """Process ids, the youngest last."""
        found = []
        for one in Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split():
            with contextlib.suppress(OSError):
                if b"spawn_main" in Path(f"/proc/{one}/cmdline").read_bytes():
                    found.append((_born(int(one)), int(one)))
        return [number for _, number in sorted(found)]

    def all(self) -> list[int]:
        return [self.process.pid, *self.workers()]

    def fill_disk(self, full: bool) -> None:
        """No file of theirs may grow, or any may again."""
        for pid in self.all():
            with contextlib.suppress(ProcessLookupError):
                _, hard = resource.prlimit(pid, resource.RLIMIT_FSIZE)
                resource.prlimit(pid, resource.RLIMIT_FSIZE, (1 if full else hard, hard))

    def counters(self) -> dict[tuple[str, str], float]:
        """Of each of `LESSER` and worker, what it counted since it started; empty where no worker answers."""
        found: dict[tuple[str, str], float] = {}
        with contextlib.suppress(OSError), urllib.request.urlopen(self.figures, timeout=5) as answer:
            for name, worker, value in re.findall(r'^gesticulator_(\w+)\{worker="(\d+)".*\} (\S+)$',
                                                  answer.read().decode(), re.M):
                if name in LESSER:
                    found[name, worker] = found.get((name, worker), 0.0) + float(value)
        return found

    def stop(self) -> int:
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(120)


def _born(pid: int) -> int:
    """Clock ticks from the machine's start to that of a process."""
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[19])


def memory_of(pid: int) -> float:
    """Resident memory of a process, MB."""
    return round(int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6, 1)


def seconds_of(pid: int) -> float:
    """Processor time of a process so far, seconds."""
    return sum(map(int, Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13])) / os.sysconf(
        "SC_CLK_TCK")


def descriptors_of(pid: int) -> int:
    """Open descriptors of a process."""
    return sum(1 for _ in Path(f"/proc/{pid}/fd").iterdir())


@dataclass
class Count:
    """What happened. frames: that came, those taken back not counted; lost: that did not come; doubled: that came
    twice; pieces: of sound; came_back, replayed: connections that went on, with the session and without."""

    streams: int = 0
    pieces: int = 0
    seconds: float = 0.0
    frames: int = 0
    lost: int = 0
    doubled: int = 0
    interruptions: int = 0
    came_back: int = 0
    replayed: int = 0
    cut: int = 0
    killed: int = 0
    full_disks: int = 0
    attacks: int = 0
    failures: list[str] = field(default_factory=list)
    oddities: list[str] = field(default_factory=list)
    """Where frames were lost or came twice: the stream, the frame and what had just happened."""


class Client:
    """One good client: stream after stream, until the time is over."""

    def __init__(self, kind: str, processes: Processes, voice: np.ndarray, count: Count, seed: int) -> None:
        self.kind, self.processes, self.count, self.rng = kind, processes, count, np.random.default_rng(seed)
        self.hello = Hello(**{"sample_rate": RATE, **KINDS[kind], "token": processes.good, "seed": seed})
        self.voice = voice
        self.stream: ResumingStream | None = None
        self.next, self._moved, self._source = 0, asyncio.Event(), 0
        self._replaced: int | None = None
        """The frame from which an interruption replaces frames, until its packet comes."""
        self._happened: deque[str] = deque(maxlen=4)

    async def run(self, until: float) -> None:
        """Streams of 20 s to five minutes of media time, one after the other."""
        while time.monotonic() < until:
            seconds = float(self.rng.uniform(20, 300)) if self.rng.random() < 0.5 else 20.0
            try:
                await self._one(min(seconds, max(until - time.monotonic(), 5.0)))
                self.count.streams += 1
            except Exception as error:  # noqa: BLE001 - whatever ends a good stream is a failure
                self.count.failures.append(f"{self.kind}: {type(error).__name__}: {error}"[:300])
                await asyncio.sleep(1.0)

    async def _one(self, seconds: float) -> None:
        self.next, self._replaced, self._source = 0, None, 0
        self._happened.clear()
        async with connect_resuming(self.processes.url, self.hello, patience=600.0) as stream:
            self.stream = stream
            reading = asyncio.create_task(self._read(stream))
            begin = time.monotonic()
            try:
                while stream.time < seconds:
                    await self._turn(stream, seconds - stream.time)
                    await self._room(stream, begin, reading)
                await stream.finish()
                await reading
            finally:
                reading.cancel()
                self.stream = None
        wanted = math.floor(stream.time * self.hello.fps + 1e-6)
        # What ends within a frame may have it or not: the end is rounded.
        self._compare(max(wanted - 1, min(self.next, wanted + 1)), "at the end")
        self.count.frames += self.next
        self.count.seconds += stream.time

    async def _read(self, stream: ResumingStream) -> None:
        async for message in stream:
            if isinstance(message, Poses):
                self._source = message.source
                if self._replaced not in (None, message.first):
                    continue  # it was on its way when the interruption was sent
                self._replaced = None
                self._compare(message.first, f"in session {message.source}")
                self.next = message.first + len(message)
                self._moved.set()
            elif message["type"] == "back":
                self._happened.append(f"back at {self.next}, {'resumed' if message['resumed'] else 'anew'}")
                self.count.came_back += message["resumed"]
                self.count.replayed += not message["resumed"]

    def _compare(self, frame: int, where: str) -> None:
        """Count what was lost or came twice, where another frame than the next one came."""
        if frame == self.next:
            return
        self.count.lost += max(0, frame - self.next)
        self.count.doubled += max(0, self.next - frame)
        self.count.oddities.append(f"{self.kind}: frame {frame} for {self.next} {where}; before it: "
                                   + ", ".join(self._happened))

    async def _room(self, stream: ResumingStream, begin: float, reading: asyncio.Task[None]) -> None:
        """No turn begins before the last one was spoken or played, nor while too little is answered."""
        while stream.time - self.next / self.hello.fps > AHEAD:
            self._moved.clear()
            moved = asyncio.create_task(self._moved.wait())
            done, _ = await asyncio.wait({moved, reading}, timeout=LONGEST_SILENCE, return_when=asyncio.FIRST_COMPLETED)
            moved.cancel()
            if not done:
                raise RuntimeError(f"no frame came for {LONGEST_SILENCE:g} s "
                                   f"({'connected' if stream.connected else 'not connected'})")
            if reading.done():
                reading.result()
                raise RuntimeError("the stream ended before it was finished")
        await asyncio.sleep(max(0.0, begin + stream.time - time.monotonic()))

    async def _turn(self, stream: ResumingStream, left: float) -> None:
        chance = self.rng.random()
        if self.kind == "synthesiser":
            await self._send(stream, min(left, float(self.rng.uniform(1, 10))), 10.0)
            await stream.idle(min(1.0, left))
        elif self.kind == "conversation" and chance < 0.3:
            await stream.listen()
            await self._send(stream, min(left, 2.0), 0.3)
            await stream.speak()
            await stream.think(0.5)
            await stream.idle(0.7)
        elif self.kind == "interrupted" and chance < 0.2 and self.next > 1 and stream.connected \
                and self._source == stream._source and self._replaced is None:
            # Only what was played is interrupted: never while an interruption is not answered, nor before the first
            # packet of a session. One after the other would go back farther than the server remembers.
            at = self.next / self.hello.fps
            await stream.interrupt(at - min(0.5, at / 2))
            self.next = self._replaced = min(self.next, math.ceil(stream.time * self.hello.fps - 1e-6))
            self.count.interruptions += 1
            self._happened.append(f"interrupted at {self.next}, {stream.time:.4f} s")
            await stream.idle(0.8)
        else:
            await self._send(stream, min(left, 1.0), (0.02, 0.1, 1.0)[int(3 * chance)])

    async def _send(self, stream: ResumingStream, seconds: float, longest: float) -> None:
        """Sound in pieces from one sample to `longest` seconds; a few of one sample, since each is a message."""
        left, at = max(1, round(seconds * self.hello.sample_rate)), int(self.rng.integers(len(self.voice)))
        while left:
            size = max(1, int(longest * self.hello.sample_rate * self.rng.random()))
            size = min(1 if self.rng.random() < 0.03 else size, left)
            await stream.send(np.take(self.voice, range(at, at + size), mode="wrap").tobytes())
            at, left = at + size, left - size
            self.count.pieces += 1


async def disturb(processes: Processes, clients: list[Client], count: Count, until: float, a: argparse.Namespace
                  ) -> None:
    """Cut connections, kill the youngest worker, fill the disk, and attack, each at its times."""
    rng, start = np.random.default_rng(1), time.monotonic()
    kill_at = [start + (until - start) * (k + 0.5) / a.kills for k in range(a.kills)]
    cut, attack, full = start + CUT_EVERY, None, False
    attack_at = start
    names = list(live_attack.ATTACKS)
    try:
        while (now := time.monotonic()) < until:
            if now >= cut:
                cut = now + CUT_EVERY * float(rng.uniform(0.5, 1.5))
                open_ones = [one.stream for one in clients if one.stream is not None and one.stream.connected]
                if open_ones:
                    socket = open_ones[int(rng.integers(len(open_ones)))]._socket
                    if socket is not None:
                        socket.transport.abort()
                        count.cut += 1
            if kill_at and now >= kill_at[0] and len(processes.workers()) > 1:
                del kill_at[0]
                os.kill(processes.workers()[-1], signal.SIGKILL)
                count.killed += 1
            want = FULL_EVERY / 2 <= (now - start) % FULL_EVERY < FULL_EVERY / 2 + FULL_FOR
            if want != full:
                full = want
                processes.fill_disk(full)
                count.full_disks += full
            if now >= attack_at and (attack is None or attack.poll() is not None):
                attack_at = now + a.attack_every
                attack = _attacker(processes, names[count.attacks % len(names)])
                count.attacks += 1
            await asyncio.sleep(1.0)
    finally:
        processes.fill_disk(False)
        if attack is not None:
            attack.kill()
            attack.wait()


def _attacker(processes: Processes, name: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, __file__, "--attack", name, "--port", str(processes.port)],
                            env={**os.environ, "SOAK_KEY": processes.rude}, stderr=subprocess.DEVNULL)


async def attack(name: str, port: int) -> None:
    """One attack for `ATTACK_SECONDS`."""
    live_attack.Hello = partial(Hello, token=os.environ["SOAK_KEY"])  # type: ignore[assignment, misc]
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(ATTACK_SECONDS):
            await live_attack.ATTACKS[name](f"ws://127.0.0.1:{port}/stream", port)


@dataclass
class Watch:
    """Memory and descriptors of each process, a row every `step` seconds."""

    step: float
    rows: list[dict[str, Any]] = field(default_factory=list)
    spent: dict[int, float] = field(default_factory=dict)
    """Process -> its processor time, seconds."""
    counted: dict[str, float] = field(default_factory=lambda: dict.fromkeys(LESSER, 0.0))
    _last: dict[tuple[str, str], float] = field(default_factory=dict)

    async def counters(self, processes: Processes) -> None:
        """Add what the workers counted since the last time; a worker that was killed begins again at 0."""
        for key, value in (await asyncio.to_thread(processes.counters)).items():
            last = self._last.get(key, 0.0)
            self.counted[key[0]] += value - last if value >= last else value
            self._last[key] = value

    async def run(self, processes: Processes, count: Count) -> None:
        start = time.monotonic()
        while True:
            row: dict[str, Any] = {"seconds": round(time.monotonic() - start, 1), "frames": count.frames,
                                   "streams": count.streams, "load": round(os.getloadavg()[0], 1), "processes": {}}
            await self.counters(processes)
            for pid in processes.all():
                with contextlib.suppress(OSError):
                    self.spent[pid] = seconds_of(pid)
                    row["processes"][str(pid)] = {"memory": memory_of(pid), "descriptors": descriptors_of(pid)}
            self.rows.append(row)
            print(json.dumps({**asdict(count), **self.counted, "spent": sum(self.spent.values()), **row}),
                  file=sys.stderr, flush=True)
            await asyncio.sleep(self.step)

    def growth(self) -> dict[str, dict[str, float]]:
        """Of each process that lived longer than `SETTLED`: its memory then, and the most and the last of it after."""
        found: dict[str, dict[str, float]] = {}
        for pid in {pid for row in self.rows for pid in row["processes"]}:
            lived = [(row["seconds"], row["processes"][pid]["memory"]) for row in self.rows if pid in row["processes"]]
            later = [memory for seconds, memory in lived if seconds >= lived[0][0] + SETTLED]
            if later:
                found[pid] = {"settled": later[0], "most": max(later), "last": later[-1],
                              "growth": round(max(later) / later[0] - 1, 4),
                              "minutes": round((lived[-1][0] - lived[0][0]) / 60, 1)}
        return found


async def soak(processes: Processes, voice: np.ndarray, a: argparse.Namespace) -> dict[str, Any]:
    """Run it; returns the report."""
    count, watch, kinds = Count(), Watch(a.step), list(KINDS)
    before = {str(pid): descriptors_of(pid) for pid in processes.all()}
    until = time.monotonic() + 60 * a.minutes
    clients = [Client(kinds[k % len(kinds)], processes, np.roll(voice, k * 79190), count, k) for k in range(a.streams)]
    watching = asyncio.create_task(watch.run(processes, count))
    disturbing = asyncio.create_task(disturb(processes, clients, count, until, a))
    await asyncio.gather(*(one.run(until) for one in clients))
    await disturbing
    await asyncio.sleep(a.grace)
    watching.cancel()
    after = {str(pid): descriptors_of(pid) for pid in processes.all()}
    leaked = {pid: after[pid] - before[pid] for pid in after if pid in before}
    return {**asdict(count), "descriptors": {pid: [before[pid], after[pid]] for pid in leaked},
            "counted": watch.counted, "server_seconds": round(sum(watch.spent.values()), 1),
            "client_seconds": round(time.process_time(), 1), "memory": watch.growth(), "rows": watch.rows}


def holds(report: dict[str, Any]) -> dict[str, bool]:
    """What must hold -> whether it does."""
    memory, descriptors = report["memory"].values(), report["descriptors"].values()
    return {"nothing lost": not (report["lost"] or report["failures"]), "nothing came twice": not report["doubled"],
            **({"memory flat": all(one["growth"] <= GROWTH for one in memory)} if memory else {}),
            "no descriptor leaked": all(last <= first for first, last in descriptors),
            "ended well": report["exit_code"] == 0}


def table(pieces: list[dict[str, Any]]) -> str:
    """The reports of runs as Markdown, a column each."""
    lines = ["# Soak", ""]
    for number, one in enumerate(pieces, 1):
        loads = [row["load"] for row in one["rows"]]
        lines.append(f"Piece {number}: `{one['command']}`, {one['date']}, commit {one['commit']}; {one['processor']}, "
                     f"{one['cores']} cores, which did other work at the same time (load {min(loads):g} to "
                     f"{max(loads):g}).\n")
    heads = [f"piece {number}" for number in range(1, len(pieces) + 1)]
    lines += _rows(["", *heads], [
        ("minutes", [f"{one['minutes']:g}" for one in pieces]),
        ("streams at a time", [f"{one['concurrent']}" for one in pieces]),
        *((label, [f"{one[name]:,.0f}" for one in pieces]) for name, label in (
            ("streams", "streams that were finished"), ("pieces", "pieces of sound"),
            ("seconds", "seconds of media time"), ("frames", "frames"), ("lost", "frames lost"),
            ("doubled", "frames that came twice"), ("interruptions", "interruptions"), ("cut", "connections cut"),
            ("killed", "workers killed"), ("came_back", "connections that went on with their session"),
            ("replayed", "connections whose session was gone, replayed"),
            ("full_disks", "minutes with a full disk"), ("attacks", "attacks, each of 20 s"))),
        *((label, [f"{one['counted'][name]:,.0f}" for one in pieces]) for name, label in LESSER.items()),
        ("processor time of the server, s", [f"{one['server_seconds']:,.0f}" for one in pieces]),
        ("processor time of the clients, s", [f"{one['client_seconds']:,.0f}" for one in pieces]),
        ("streams that failed", [f"{len(one['failures'])}" for one in pieces]),
        ("exit code", [f"{one['exit_code']}" for one in pieces]),
        *((name, ["yes" if holds(one)[name] else "**no**" for one in pieces]) for name in holds(pieces[0]))])
    lines += ["", *_rows(
        ["process", "alive for, min", "memory after ten minutes, MB", "most after that", "last", "growth",
         "descriptors before the first stream and after the last"],
        [(f"piece {number}, " + (f"worker {place}" if place else "parent"),
          [*(f"{held[name]:g}" for name in ("minutes", "settled", "most", "last")), f"{100 * held['growth']:.1f} %",
           " and ".join(map(str, one["descriptors"].get(pid, ["killed or born meanwhile"])))])
         for number, one in enumerate(pieces, 1)
         for place, (pid, held) in enumerate(sorted(one["memory"].items(), key=lambda pair: pair[1]["settled"]))])]
    odd = [f"- Piece {number}: {text}" for number, one in enumerate(pieces, 1) for text in one.get("oddities", ())]
    return "\n".join([*lines, "", *([*odd, ""] if odd else [])])


def _rows(heads: list[str], rows: list[tuple[str, list[str]]]) -> list[str]:
    """A table's lines."""
    return [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads),
            *(f"| {label} | {' | '.join(values)} |" for label, values in rows)]


def main() -> int:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--minutes", type=float, default=80.0)
    p.add_argument("--streams", type=int, default=8, help="at a time (default 8)")
    p.add_argument("--kills", type=int, default=3, help="of a worker (default 3); none with one worker")
    p.add_argument("--attack-every", type=float, default=60.0, help="seconds from one attack to the next (default 60)")
    p.add_argument("--workers", type=int, default=2, help="of the server (default 2)")
    p.add_argument("--grace", type=float, default=70.0, help="seconds after the last stream (default 70: the server "
                   "keeps lost streams for a minute)")
    p.add_argument("--step", type=float, default=30.0, help="seconds between rows (default 30)")
    p.add_argument("--out", type=Path, help="path of the report, without .json and .md; added to its pieces")
    p.add_argument("--anew", action="store_true", help="begin the report anew")
    p.add_argument("--attack", choices=list(live_attack.ATTACKS), help=argparse.SUPPRESS)
    p.add_argument("--port", type=int, help=argparse.SUPPRESS)
    a = p.parse_args()
    if a.attack:
        asyncio.run(attack(a.attack, a.port))
        return 0
    samples = resample(load_speech(ROOT / "examples" / "speech.flac"), RATE).samples
    voice = (samples * 32767).astype("<i2")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that the server is stopped, too
    with tempfile.TemporaryDirectory() as folder:
        processes = Processes(Path(folder), a.workers)
        try:
            report = asyncio.run(soak(processes, voice, a))
        finally:
            code = processes.stop()
            warnings = [line for line in processes.log.read_text(errors="replace").splitlines()
                        if " ERROR " in line or "Traceback" in line]
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True).stdout
    report = {"command": f"python benchmarks/soak.py --minutes {a.minutes:g} --streams {a.streams}",
              "date": time.strftime("%Y-%m-%d"), "commit": commit.strip(), "processor": processor(),
              "cores": os.cpu_count(), "minutes": a.minutes, "concurrent": a.streams, "exit_code": code,
              "errors_in_log": warnings[:20], **report}
    print(table([report]))
    print("\n".join([*report["failures"][:20], *warnings[:20]]))
    if a.out:
        kept = a.out.with_suffix(".json")
        pieces = json.loads(kept.read_text())["pieces"] if kept.exists() and not a.anew else []
        write_text(kept, json.dumps({"pieces": [*pieces, report]}, indent=1) + "\n")
        write_text(a.out.with_suffix(".md"), table([*pieces, report]))
    return int(not all(holds(report).values()))


if __name__ == "__main__":
    sys.exit(main())
