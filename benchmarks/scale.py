"""Memory and speed of `gesticulator infer` as recordings grow: `python benchmarks/scale.py memory --minutes 5 60`.
With `--suffix .bvh,.glb` both files are written by one run.

`python benchmarks/scale.py ray --clips 24`: what Ray adds, and how two workers share. Clips of ten seconds are done by
one process, then by one worker and by two; cpu: seconds of processor time of all processes, Ray's own included, so that
other work on the machine counts little. Then tasks that sleep, whose time does not depend on other work: of no length,
for what a task costs; of a quarter of a second by one worker and two; and of three seconds with one worker of two ten
times slower.

load: of the machine, before and in the end (mean of five minutes); walls are of use where it is below 1.

The recording is a speech over and over (`--speech`), at its own rate. Each length is done by a process of its own;
seconds: of its processor time; peak: MB that it held at most, the interpreter, torch and the models included.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import soundfile

CHILD = """
import resource, sys
from gesticulator.infer import main
code = main(sys.argv[1:])
used = resource.getrusage(resource.RUSAGE_SELF)
print(used.ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e6, used.ru_utime + used.ru_stime)
sys.exit(code)
"""


def recording(path: Path, speech: Path, minutes: float) -> None:
    """Write a recording of that length."""
    samples, rate = soundfile.read(speech, dtype="int16", always_2d=True)
    left = round(minutes * 60 * rate)
    with soundfile.SoundFile(path, "w", rate, samples.shape[1], "PCM_16") as out:
        while left > 0:
            out.write(samples[:left])
            left -= len(samples)


def measured(command: list[str]) -> tuple[float, float]:
    """The two numbers that a command says; what it says on standard error is shown."""
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        sys.exit(f"scale.py: exit code {done.returncode} of {' '.join(command[3:])}")
    first, second = map(float, done.stdout.split())
    return first, second


def one(speech: Path, minutes: float, suffix: str, asked: list[str]) -> dict[str, Any]:
    """A row: what a recording of so many minutes takes."""
    with tempfile.TemporaryDirectory() as folder:
        sound, outputs = Path(folder, "speech.flac"), [Path(folder, f"out{one}") for one in suffix.split(",")]
        recording(sound, speech, minutes)
        named = [word for out in outputs for word in ("-o", str(out))]
        peak, seconds = measured([sys.executable, "-c", CHILD, str(sound), *named, "--quiet", "--any-length", *asked])
        size = sum(out.stat().st_size for out in outputs)
        return {"minutes": minutes, "format": suffix, "peak_mb": round(peak), "seconds": round(seconds, 1),
                "real_time_factor": round(seconds / minutes / 60, 4), "output_mb": round(size / 1e6, 1)}


# ------------------------------------------------------------------------------------------------------------------ Ray

COUNTED = """
import ctypes, os, pathlib, subprocess, sys, time
ctypes.CDLL(None).prctl(36, 1)  # whose parent has ended becomes ours (PR_SET_CHILD_SUBREAPER), so that it is counted
used = {}
def count():
    parents, times = {}, {}
    for file in pathlib.Path('/proc').glob('[0-9]*/stat'):
        try:
            words = file.read_text().rpartition(')')[2].split()
        except OSError:
            continue
        parents[int(file.parent.name)], times[int(file.parent.name)] = int(words[1]), int(words[11]) + int(words[12])
    for pid in times:
        above = pid
        while above in parents and above != os.getpid():
            above = parents[above]
        if above == os.getpid() != pid:
            used[pid] = times[pid]
began = time.monotonic()
running = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
while running.poll() is None:
    count()
    time.sleep(0.2)
print(time.monotonic() - began, sum(used.values()) / os.sysconf('SC_CLK_TCK'))
sys.exit(running.returncode)
"""
"""Runs a command and counts the processor time of all processes that come of it, but for the last fifth of a second of
each: Ray does not wait for its workers, so that no parent has their time."""
SLOWER = 10.0
"""How much slower the slow worker is."""


def clips_on_ray(speech: Path, count: int, where: str | None) -> dict[str, Any]:
    """A row: so many clips of ten seconds by one process, or on Ray."""
    with tempfile.TemporaryDirectory() as folder:
        clips = Path(folder, "clips")
        clips.mkdir()
        recording(clips / "0.flac", speech, 10 / 60)
        for number in range(1, count):
            (clips / f"{number}.flac").write_bytes((clips / "0.flac").read_bytes())
        more = ["--ray", where] if where else ["--manifest", str(Path(folder, "m.jsonl"))]
        wall, cpu = measured([sys.executable, "-c", COUNTED, sys.executable, "-m", "gesticulator", "infer", str(clips),
                              "-o", f"{folder}/out/", "--quiet", *more])
        return {"tasks": "clips", "workers": where or "one process", "count": count, "wall": round(wall, 1),
                "cpu": round(cpu, 1)}


def sleep_for(seconds: float, folder: str | None, number: int) -> float:
    """A task that takes so long; ten times as long in the first process that comes to the folder."""
    slow = False
    if folder is not None:
        mark = Path(folder, "slow")
        with contextlib.suppress(FileExistsError), mark.open("x") as file:
            file.write(str(os.getpid()))
        slow = mark.read_text() == str(os.getpid())
    time.sleep(seconds * (SLOWER if slow else 1.0))
    return seconds


def sleeper(seconds: float, folder: str | None) -> Any:
    """What does the tasks of a worker."""
    return partial(sleep_for, seconds, folder)


def sleeping(workers: int, count: int, seconds: float, slow: bool = False, doubles: bool = True) -> dict[str, Any]:
    """A row: tasks that sleep, on a cluster that runs; wall: without the start of the workers."""
    import ray

    from gesticulator import ray_pool

    with tempfile.TemporaryDirectory() as folder:
        stream = ray_pool.done_on_ray(f"local:{workers}", partial(sleeper, seconds, folder if slow else None),
                                      range(count + workers), doubles=doubles)
        used, began = 0.0, 0.0
        for place, _ in enumerate(stream):
            if place == (0 if slow else workers - 1):  # all of them have begun, or nearly
                began, used = time.monotonic(), time.process_time()
        wall = time.monotonic() - began
    ideal = count * seconds / (1 + (workers - 1) * (1 / SLOWER if slow else 1))
    assert ray.is_initialized()
    return {"tasks": f"sleep {seconds:g} s", "workers": workers, "count": count, "slow worker": slow,
            "done again": doubles, "wall": round(wall, 2), "shared ideally": round(ideal, 2),
            "driver, ms a task": round(1000 * (time.process_time() - used) / count, 2)}


def ray_rows(speech: Path, clips: int) -> list[dict[str, Any]]:
    """All that is measured of Ray."""
    import ray

    rows = [clips_on_ray(speech, clips, where) for where in (None, "local:1", "local:2")]
    told = {"PYTHONPATH": f"{Path(__file__).parent}:{Path(__file__).parents[1]}"}
    ray.init(address="local", num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="ERROR",
             runtime_env={"env_vars": told})
    rows += [sleeping(1, 1000, 0.0), sleeping(1, 40, 0.25), sleeping(2, 80, 0.25)]
    from gesticulator import ray_pool

    ray_pool.SLOW_SECONDS = 1.0  # as tasks are short
    rows += [sleeping(2, 6, 3.0, slow=True, doubles=doubles) for doubles in (False, True)]
    ray.shutdown()
    return rows


def main() -> None:
    """Measure, print a row for each length and, with --out, write them."""
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("what", choices=("memory", "ray"))
    p.add_argument("--speech", type=Path, default=Path(__file__).parent.parent / "examples" / "speech.flac")
    p.add_argument("--minutes", type=float, nargs="+", default=[5, 60])
    p.add_argument("--suffix", nargs="+", default=[".bvh"])
    p.add_argument("--legs", action="store_true")
    p.add_argument("--clips", type=int, default=24, help="ray: how many")
    p.add_argument("--out", type=Path, metavar="FILE.json")
    p.add_argument("--add", action="store_true", help="memory: keep what the file has of other lengths and formats")
    asked = p.parse_args()
    rows: list[dict[str, Any]] = []
    before = os.getloadavg()[0]
    if asked.what == "ray":
        rows = ray_rows(asked.speech, asked.clips)
        print("\n".join(map(json.dumps, rows)), flush=True)
    for suffix in asked.suffix if asked.what == "memory" else ():
        for minutes in asked.minutes:
            rows.append(one(asked.speech, minutes, suffix, ["--legs"] if asked.legs else []))
            print(json.dumps(rows[-1]), flush=True)
    if asked.out is not None:
        if asked.add and asked.out.exists():
            new = {(row["minutes"], row["format"]) for row in rows}
            known = json.loads(asked.out.read_text())["rows"]
            rows = sorted([row for row in known if (row["minutes"], row["format"]) not in new] + rows,
                          key=lambda row: (row["format"], row["minutes"]))
        found = {"machine": platform.processor() or platform.machine(), "python": platform.python_version(),
                 "numpy": np.__version__, "load": [round(one, 1) for one in (before, os.getloadavg()[1])],
                 "what": asked.what, "rows": rows}
        asked.out.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
