"""What a batch takes on a cluster, by a model that is fitted to what is measured here.

    python benchmarks/cluster_model.py measure --out docs/results/cluster.json
    python benchmarks/cluster_model.py simulate --files 100000 --seconds 10 --cores 64

A recording of s seconds takes `per_file + per_second * s` seconds of one core; a worker takes `start` before its first;
the driver takes `plan` for each recording before the first begins, and `dispatch` for each that is done, one after the
other. The longest are given out first, one at a time to each worker, as `gesticulator infer --ray` does.

Measured are seconds of processor time, which other work on the machine changes little.
"""

from __future__ import annotations

import argparse
import heapq
import json
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
    per_file: for a recording whatever its length; plan: of the driver for a recording, before the first begins (its
    header, its hash, its row) and in the end (its row in the manifest); dispatch: of the driver for a recording that is
    done."""

    start: float
    per_second: float
    per_file: float
    plan: float = 0.0
    dispatch: float = 0.0

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
    driver = planned = costs.plan * len(left)
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
    worked = costs.plan * len(seconds) + costs.dispatch * (len(seconds) + again)
    return BatchTime(driver, sum(map(costs.work, seconds)), worked, again)


def least(seconds: Sequence[float], costs: BatchCosts, count: int) -> float:
    """Seconds that no way of sharing out can beat: all work shared equally, or the longest recording alone."""
    works = [costs.work(one) for one in seconds]
    return costs.plan * len(works) + costs.start + max(sum(works) / count, max(works))


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
        begin = time.process_time()
        made = system(load_speech(path))
        drawn = time.process_time() - begin
        row: dict[str, float] = {"seconds": seconds, "drawn": drawn}
        for suffix in FORMATS:
            begin = time.process_time()
            target = made.save(folder / f"out{suffix}")
            row[f"time{suffix}"], row[f"bytes{suffix}"] = time.process_time() - begin, target.stat().st_size
        rows.append(row)
    return rows


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


def driver_times(clip: Path, folder: Path, count: int) -> tuple[float, float, float]:
    """Processor seconds of the driver for a recording, without Ray: to plan it and note it in the end, and to note it
    when it is done; and bytes of the manifest for it."""
    from gesticulator.batch import BatchTask, TaskOutcome, run_batch
    from gesticulator.infer import plan

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
    jobs = plan([str(folder / "many")], {".bvh": str(folder / "out") + "/"}, None)
    tasks = [BatchTask(number, job.source, job.targets, ("0.1.0", "0" * 64, "0" * 64))
             for number, job in enumerate(jobs) if job.source is not None]
    run_batch(tasks, folder / "manifest.parquet", outcomes, quiet=True)
    spent = time.process_time() - begin
    return (spent - noted) / count, noted / count, (folder / "manifest.parquet").stat().st_size / count


def measure(asked: argparse.Namespace) -> None:
    """Measure here and write the costs."""
    from realtime import processor

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "clips").mkdir()
        found = clips(folder / "clips", asked.speech, asked.copies)
        rows = clip_times(found, folder)
        lengths = [row["seconds"] for row in rows]
        per_file, per_second = line(lengths, [row["drawn"] + row["time.bvh"] for row in rows])
        clip = next(path for path, seconds in found.items() if seconds == 10.0)
        start = min(fresh_process(clip, folder / "cold.bvh") for _ in range(3)) - per_file - 10 * per_second
        plan, noted, manifest_bytes = driver_times(clip, folder, 2000)
    hourly = {suffix: 3600 * line(lengths, [row[f"bytes{suffix}"] for row in rows])[1] for suffix in FORMATS}
    written = {suffix: line(lengths, [row[f"time{suffix}"] for row in rows]) for suffix in FORMATS}
    costs = BatchCosts(*(float(f"{value:.4g}") for value in (start, per_second, per_file, plan, noted)))
    report = {
        "processor": processor(), "python": sys.version.split()[0], "clips": {f"{s:g}": asked.copies for s in CLIPS},
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


# ---------------------------------------------------------------------------------------------------- the command

def show(asked: argparse.Namespace) -> None:
    """Print a row for each number of cores."""
    told = json.loads(asked.costs.read_text())["costs"]
    given = {name: getattr(asked, name) for name in told if getattr(asked, name) is not None}
    costs = replace(BatchCosts(**told), **given)
    seconds = [asked.seconds] * asked.files
    hours = sum(seconds) / 3600
    print(f"{asked.files} recordings of {asked.seconds:g} s ({hours:.0f} h), {costs}")
    print("| cores | minutes | hours of sound an hour | busy | driver busy | core hours |\n|---|---|---|---|---|---|")
    for count in asked.cores:
        speeds = dict.fromkeys(range(asked.slow), 0.1)
        lost = dict.fromkeys(range(asked.lost), asked.lost_at)
        made = simulate(seconds, costs, Workers(count, speeds, lost))
        print(f"| {count} | {made.wall / 60:.1f} | {hours / made.wall * 3600:.0f} | {made.efficiency(count):.0%} | "
              f"{made.driver / made.wall:.0%} | {count * made.wall / 3600:.1f} |")


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
    asked = p.parse_args()
    asked.run(asked)


if __name__ == "__main__":
    main()
