"""What a batch takes on a cluster, by a model that is fitted to what is measured here.

    python benchmarks/cluster_model.py measure --out docs/results/cluster.json
    python benchmarks/cluster_model.py simulate --files 100000 --seconds 10 --cores 64
    python benchmarks/cluster_model.py table --out docs/results/cluster.md

A recording of s seconds takes `per_file + per_second * s` seconds of one core; a worker takes `start` before its first;
the driver takes `plan + read / readers` for each recording before the first begins, and `dispatch` for each that is
done, one after the other. The longest are given out first, one at a time to each worker, as `gesticulator infer --ray`
does.

Measured are seconds of processor time. Other work on the machine lengthens them by what it takes of the processor's
caches: measure on a quiet one (`load`: of the machine, before and in the end).
"""

from __future__ import annotations

import argparse
import heapq
import json
import os
import resource
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
CLIPS = (3.0, 10.0, 30.0, 60.0)
"""Seconds of the clips that are measured."""
FORMATS = (".bvh", ".glb")


# ---------------------------------------------------------------------------------------------------- the model

@dataclass(frozen=True)
class BatchCosts:
    """Seconds of a core. start: from a process's start until its models are loaded; per_second: for a second of sound;
    per_file: for a recording whatever its length; plan: of the driver for a recording, before the first begins and in
    the end (its name, its row in the manifest); read: of one of the driver's `readers` for a recording, before the
    first begins (its header and its hash); dispatch: of the driver for a recording that is done."""

    start: float
    per_second: float
    per_file: float
    plan: float = 0.0
    read: float = 0.0
    dispatch: float = 0.0
    readers: int = 8

    @property
    def before(self) -> float:
        """Of the driver for a recording, before the first begins."""
        return self.plan + self.read / self.readers

    def work(self, seconds: float) -> float:
        """Of a recording, for a worker."""
        return self.per_file + self.per_second * seconds


@dataclass(frozen=True)
class Workers:
    """count: one on each core. speeds: worker -> how fast it is, 1 where not told. lost: worker -> the second at which
    it dies; another takes its place, and what it was doing is done again."""

    count: int
    speeds: Mapping[int, float] = field(default_factory=dict)
    lost: Mapping[int, float] = field(default_factory=dict)


@dataclass(frozen=True)
class BatchTime:
    """wall: seconds until all is done; used: seconds of a core of speed 1 that the recordings ask for; driver: seconds
    that the driver worked; again: how often a recording was begun once more."""

    wall: float
    used: float
    driver: float
    again: int

    def efficiency(self, workers: int) -> float:
        """The share of the workers' time that the recordings ask for."""
        return self.used / (workers * self.wall)


def simulate(seconds: Sequence[float], costs: BatchCosts, workers: Workers) -> BatchTime:
    """The time of a batch of recordings of so many seconds of sound."""
    left = sorted(seconds)  # the longest is taken from the end
    driver = planned = costs.before * len(left)
    lost, names = dict(workers.lost), workers.count
    # (when, whether it dies then, worker, recording): the first recordings are given before models are loaded.
    events: list[tuple[float, bool, int, float]] = []

    def begin(worker: int, at: float, recording: float) -> None:
        end = at + costs.work(recording) / workers.speeds.get(worker, 1.0)
        dies = lost.get(worker, np.inf)
        heapq.heappush(events, (max(dies, planned), True, worker, recording) if dies < end
                       else (end, False, worker, recording))

    for worker in range(min(workers.count, len(left))):
        begin(worker, planned + costs.start / workers.speeds.get(worker, 1.0), left.pop())
    again = 0
    while events:
        when, died, worker, recording = heapq.heappop(events)
        driver = max(driver, when) + costs.dispatch
        if died:
            again += 1
            begin(names, driver + costs.start, recording)
            names += 1
            continue
        if left:
            begin(worker, driver, left.pop())
    worked = costs.before * len(seconds) + costs.dispatch * (len(seconds) + again)
    return BatchTime(driver, sum(map(costs.work, seconds)), worked, again)


def least(seconds: Sequence[float], costs: BatchCosts, count: int) -> float:
    """Seconds that no way of sharing out can beat: all work shared equally, or the longest recording alone."""
    works = [costs.work(one) for one in seconds]
    return costs.before * len(works) + costs.start + max(sum(works) / count, max(works))


# ---------------------------------------------------------------------------------------------------- what is measured

def clips(folder: Path, speech: Path, copies: int) -> dict[Path, float]:
    """Clips of each length, cut from a speech that goes on and on; file -> its seconds."""
    import soundfile

    samples, rate = soundfile.read(speech, dtype="int16")
    made: dict[Path, float] = {}
    for seconds in CLIPS:
        for copy in range(copies):
            path = folder / f"{seconds:g}s_{copy}.wav"
            # Each begins at another place.
            soundfile.write(path, np.resize(np.roll(samples, -7919 * len(made)), round(seconds * rate)), rate)
            made[path] = seconds
    return made


def clip_times(found: Mapping[Path, float], folder: Path) -> list[dict[str, float]]:
    """Processor seconds and bytes of each clip, in a process that has the models."""
    from data_module.speech.audio import load_speech
    from gesticulator.pipeline import Gesticulator

    system = Gesticulator.from_pretrained()
    rows = []
    system(load_speech(next(iter(found)))).save(folder / "first.bvh")  # what is loaded at first use
    for path, seconds in found.items():
        tries = [_clip_time(system, path, folder) for _ in range(2)]
        # The faster of two: what shares the processor's caches costs time, too.
        rows.append({"seconds": seconds, **{name: min(one[name] for one in tries) for name in tries[0]}})
    return rows


def _clip_time(system: Any, path: Path, folder: Path) -> dict[str, float]:
    from data_module.speech.audio import load_speech

    begin = time.process_time()
    made = system(load_speech(path))
    row: dict[str, float] = {"drawn": time.process_time() - begin}
    for suffix in FORMATS:
        begin = time.process_time()
        target = made.save(folder / f"out{suffix}")
        row[f"time{suffix}"], row[f"bytes{suffix}"] = time.process_time() - begin, target.stat().st_size
    return row


def line(seconds: Sequence[float], times: Sequence[float]) -> tuple[float, float]:
    """The offset and the slope, none below 0, of the line with the least squares of errors relative to each time: a
    long clip has no more weight than a short one."""
    from scipy.optimize import nnls

    x, y = np.asarray(seconds, np.float64), np.asarray(times, np.float64)
    offset, slope = nnls(np.stack([1 / y, x / y], axis=1), np.ones(len(y)))[0]
    return float(offset), float(slope)


def fresh_process(clip: Path, out: Path) -> float:
    """Processor seconds of the command with one recording."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-m", "gesticulator.infer", str(clip), "-o", str(out), "--quiet"], check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def driver_times(clip: Path, folder: Path, count: int) -> tuple[dict[str, float], float]:
    """Processor seconds of the driver for a recording, without Ray, as `BatchCosts` has them; and bytes of the manifest
    for it."""
    from gesticulator.batch import READERS, BatchTask, TaskOutcome, estimated_seconds, file_hash, run_batch
    from gesticulator.jobs import jobs_for

    for number in range(count):
        (folder / "many").mkdir(exist_ok=True)
        # Its last samples differ, as its hash does: equal ones take no room in a manifest.
        (folder / "many" / f"clip_{number:06d}.wav").write_bytes(clip.read_bytes()[:-4] + struct.pack("<I", number))
    noted = 0.0

    def outcomes(numbers: Sequence[int]) -> Any:
        nonlocal noted
        begin = time.process_time()
        for number in numbers:
            yield TaskOutcome(number, 10.0, "", 0.6 + number / 7, "machine:12345")
        noted = time.process_time() - begin

    begin = time.process_time()
    jobs = jobs_for([str(folder / "many")], {".bvh": str(folder / "out") + "/"}, None)
    tasks = [BatchTask(number, job.source, job.targets, ("0.1.0", "0" * 64, "0" * 64))
             for number, job in enumerate(jobs) if job.source is not None]
    run_batch(tasks, folder / "manifest.parquet", outcomes, quiet=True)
    spent = time.process_time() - begin
    begin = time.process_time()
    for task in tasks:
        estimated_seconds(task.source)
        file_hash(task.source)
    read = time.process_time() - begin
    times = {"plan": (spent - noted - read) / count, "read": read / count, "dispatch": noted / count}
    return {**times, "readers": READERS}, (folder / "manifest.parquet").stat().st_size / count


def measure(asked: argparse.Namespace) -> None:
    """Measure here and write the costs."""
    from realtime import processor

    before = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "clips").mkdir()
        found = clips(folder / "clips", asked.speech, asked.copies)
        rows = clip_times(found, folder)
        lengths = [row["seconds"] for row in rows]
        per_file, per_second = line(lengths, [row["drawn"] + row["time.bvh"] for row in rows])
        clip = next(path for path, seconds in found.items() if seconds == 10.0)
        start = min(fresh_process(clip, folder / "cold.bvh") for _ in range(3)) - per_file - 10 * per_second
        driver, manifest_bytes = driver_times(clip, folder, 2000)
    hourly = {suffix: 3600 * line(lengths, [row[f"bytes{suffix}"] for row in rows])[1] for suffix in FORMATS}
    written = {suffix: line(lengths, [row[f"time{suffix}"] for row in rows]) for suffix in FORMATS}
    costs = BatchCosts(*(float(f"{value:.4g}") for value in (start, per_second, per_file)), **{
        name: float(f"{value:.4g}") for name, value in driver.items() if name != "readers"},
        readers=int(driver["readers"]))
    report = {
        "processor": processor(), "python": sys.version.split()[0],
        "load": [round(one, 1) for one in (before, os.getloadavg()[1])],
        "clips": {f"{s:g}": asked.copies for s in CLIPS},
        "costs": asdict(costs),
        "writing": {suffix: {"per_file": round(a, 5), "per_second": round(b, 5)} for suffix, (a, b) in written.items()},
        "bytes_per_hour": {suffix: round(size) for suffix, size in hourly.items()},
        "manifest_bytes_per_file": round(manifest_bytes, 1),
        "residual": round(float(np.max(np.abs([costs.work(row["seconds"]) / (row["drawn"] + row["time.bvh"]) - 1
                                               for row in rows]))), 3),
    }
    print(json.dumps(report, indent=1))
    if asked.out is not None:
        asked.out.write_text(json.dumps(report, indent=1) + "\n")


# ---------------------------------------------------------------------------------------------------- the table

GIGABIT = 117e6
"""Bytes a second of files through a link of 1 Gbit/s."""
SOUND_BYTES = 32_000
"""Of a second of sound: 16 bits at 16 kHz, not compressed."""
CLUSTER = 64
"""Cores of the cluster that is planned for."""
GOAL_FILES, GOAL_SECONDS, GOAL_MINUTES = 100_000, 10.0, 15.0
"""The goal: so many recordings of so many seconds, within so many minutes on `CLUSTER` cores."""


def allowed(costs: BatchCosts) -> float:
    """Seconds of a core for a second of sound with which the goal is just met, all else as it is."""
    left = 60 * GOAL_MINUTES - costs.start - costs.before * GOAL_FILES
    rounds = -(-GOAL_FILES // CLUSTER)
    return (left / rounds - costs.per_file - costs.dispatch) / GOAL_SECONDS


def link_cores(costs: BatchCosts, bytes_per_hour: float) -> float:
    """How many cores together write as much as a link of 1 Gbit/s carries."""
    return GIGABIT / (bytes_per_hour / 3600 / costs.per_second)


def table(report: Mapping[str, Any]) -> str:
    """What was measured and what follows from it, as Markdown."""
    costs = BatchCosts(**report["costs"])
    lines = ["# A batch on a cluster", "", "Measured by `python benchmarks/cluster_model.py measure` "
             f"({report['processor']}, load of the machine {report['load'][0]:g} to {report['load'][1]:g}, "
             "[data](cluster.json)); the rest is computed by its model.", "",
             "| seconds of a core | |", "|---|---|"]
    lines += [f"| {about} | {value:.4g} |" for about, value in (
        ("a worker's start: Python, torch, models", costs.start), ("a second of sound, to BVH", costs.per_second),
        ("a recording, whatever its length", costs.per_file),
        ("of the driver, a recording: its name, and its row in the manifest", costs.plan),
        (f"of each of its {costs.readers} readers, a recording: header and hash", costs.read),
        ("of the driver, a recording that is done: its line in the journal", costs.dispatch))]
    lines += ["", f"## {GOAL_FILES:,} recordings of {GOAL_SECONDS:g} s", "", _HEAD, _RULE]
    goal = [GOAL_SECONDS] * GOAL_FILES
    lines += [_row(_cores(count), goal, costs, Workers(count)) for count in (1, 8, 64, 256, 1024)]
    network = SOUND_BYTES * GOAL_SECONDS / GIGABIT
    for name, other, workers in (
            ("64, the driver reads at 1 Gbit/s", replace(costs, plan=costs.plan + network), Workers(CLUSTER)),
            ("64, one reader", replace(costs, readers=1), Workers(CLUSTER)),
            ("64, 8 of them ten times slower", costs, Workers(CLUSTER, dict.fromkeys(range(8), 0.1))),
            ("64, 8 of them lost after 5 minutes", costs, Workers(CLUSTER, {}, dict.fromkeys(range(8), 300.0)))):
        lines.append(_row(name, goal, other, workers))
    lines += ["", f"{GOAL_MINUTES:g} minutes on {CLUSTER} cores allow {allowed(costs):.4f} s of a core for a second of "
              "sound.",
              "", "## A thousand hours", "", _HEAD, _RULE]
    for name, seconds in (("360,000 of 10 s", 10.0), ("6,000 of 10 minutes", 600.0), ("1,000 of an hour", 3600.0)):
        sound = [seconds] * round(3.6e6 / seconds)
        lines += [_row(f"{name}, {count} cores", sound, costs, Workers(count)) for count in (64, 256, 1024)]
    lines += ["", "| what | on the disk, a thousand hours | MB/s that 64 cores write | cores that fill 1 Gbit/s |",
              "|---|---|---|---|"]
    for suffix, size in report["bytes_per_hour"].items():
        rate = size / 3600 / costs.per_second
        lines.append(f"| `{suffix}` | {size / 1e6:.0f} GB | {CLUSTER * rate / 1e6:.0f} | "
                     f"{link_cores(costs, size):.0f} |")
    lines += [f"| the sound, 16 bits at 16 kHz | {SOUND_BYTES * 3.6e6 / 1e9:.0f} GB | | "
              f"{link_cores(costs, SOUND_BYTES * 3600):.0f} |",
              f"| the manifest, 360,000 rows | {report['manifest_bytes_per_file'] * 0.36:.0f} MB | | |"]
    return "\n".join(lines) + "\n"


_HEAD = "| | minutes | hours of sound an hour | workers busy | driver busy | core hours |"
_RULE = "|---|---|---|---|---|---|"


def _cores(count: int) -> str:
    return f"{count} core" + "s" * (count > 1)


def _row(name: str, seconds: Sequence[float], costs: BatchCosts, workers: Workers) -> str:
    made, hours = simulate(seconds, costs, workers), sum(seconds) / 3600
    return (f"| {name} | {made.wall / 60:.1f} | {hours / made.wall * 3600:.0f} | {made.efficiency(workers.count):.0%} "
            f"| {made.driver / made.wall:.0%} | {workers.count * made.wall / 3600:.1f} |")


def write_table(asked: argparse.Namespace) -> None:
    """Write the table, or print it."""
    text = table(json.loads(asked.costs.read_text()))
    if asked.out is not None:
        asked.out.write_text(text)
    else:
        print(text)


# ---------------------------------------------------------------------------------------------------- the command

def show(asked: argparse.Namespace) -> None:
    """Print a row for each number of cores."""
    told = json.loads(asked.costs.read_text())["costs"]
    given = {name: getattr(asked, name) for name in told if getattr(asked, name) is not None}
    costs = replace(BatchCosts(**told), **given)
    seconds = [asked.seconds] * asked.files
    hours = sum(seconds) / 3600
    print(f"{asked.files} recordings of {asked.seconds:g} s ({hours:.0f} h), {costs}")
    print(f"{_HEAD}\n{_RULE}")
    for count in asked.cores:
        speeds = dict.fromkeys(range(asked.slow), 0.1)
        lost = dict.fromkeys(range(asked.lost), asked.lost_at)
        print(_row(_cores(count), seconds, costs, Workers(count, speeds, lost)))


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = p.add_subparsers(required=True)
    one = verbs.add_parser("measure", help="measure the costs on this machine")
    one.add_argument("--speech", type=Path, default=ROOT / "examples" / "speech.flac")
    one.add_argument("--copies", type=int, default=3, help="clips of each length")
    one.add_argument("--out", type=Path, metavar="FILE.json")
    one.set_defaults(run=measure)
    one = verbs.add_parser("simulate", help="what a batch takes")
    one.add_argument("--costs", type=Path, default=ROOT / "docs" / "results" / "cluster.json")
    one.add_argument("--files", type=int, default=100_000)
    one.add_argument("--seconds", type=float, default=10.0, help="of each recording")
    one.add_argument("--cores", type=int, nargs="+", default=[1, 8, 64, 256])
    one.add_argument("--slow", type=int, default=0, help="how many of them are ten times slower")
    one.add_argument("--lost", type=int, default=0, help="how many of them are lost")
    one.add_argument("--lost-at", type=float, default=300.0, help="second at which they are lost")
    for name in BatchCosts.__dataclass_fields__:
        one.add_argument(f"--{name.replace('_', '-')}", type=float, help=f"{name} instead of what was measured")
    one.set_defaults(run=show)
    one = verbs.add_parser("table", help="what was measured and what follows from it, as Markdown")
    one.add_argument("--costs", type=Path, default=ROOT / "docs" / "results" / "cluster.json")
    one.add_argument("--out", type=Path, metavar="FILE.md")
    one.set_defaults(run=write_table)
    asked = p.parse_args()
    asked.run(asked)


if __name__ == "__main__":
    main()
