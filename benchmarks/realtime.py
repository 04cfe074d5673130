"""How fast inference is: `python benchmarks/realtime.py examples/speech.flac [--out docs/results/realtime.json]`.

Real-time factor = seconds of computing / seconds of sound, decoding and features included. Cold: a fresh process, from
the command to the file, imports and loading included. Warm: a second call in a process that has the bundle loaded.
With a transcript beside the recording (same name, .txt) both are also measured with text, aligned and read.
"""

from __future__ import annotations

import argparse
import json
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from data_module.speech.audio import load_speech
from gesticulator.export.writers import write
from gesticulator.gesticulator import Gesticulator


def processor() -> str:
    """The processor's name, as the system tells it."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.processor() or platform.machine())


def warm(system: Gesticulator, source: Path, target: Path, interpreter: str, text: Path | None = None) -> float:
    """Seconds from a sound file to a BVH file, the second time."""
    for _ in range(2):
        begin = time.perf_counter()
        write(target, system(load_speech(source), interpreter=interpreter, text=text).scene())
    return time.perf_counter() - begin


def cold(arguments: list[str]) -> float:
    """Seconds of a fresh process."""
    begin = time.perf_counter()
    subprocess.run([sys.executable, "-m", "gesticulator.infer", *arguments, "--quiet"], check=True)
    return time.perf_counter() - begin


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("speech", nargs="+")
    p.add_argument("--out")
    a = p.parse_args()
    threadpool_limits(1)
    system = Gesticulator.from_pretrained()
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "o.bvh"
        for name in a.speech:
            seconds = load_speech(name).duration
            command = [name, "-o", str(target), "--threads", "1"]
            row: dict[str, Any] = {"file": Path(name).name, "seconds": round(seconds, 2)}
            row["cold"] = round(cold(command) / seconds, 4)
            for interpreter in system.bundle.interpreters:
                row[f"warm_{interpreter}"] = round(warm(system, Path(name), target, interpreter) / seconds, 4)
            words = Path(name).with_suffix(".txt")
            if words.exists():
                row["cold_with_text"] = round(cold([*command, "--text", str(words)]) / seconds, 4)
                row["warm_with_text"] = round(warm(system, Path(name), target, "lstm", words) / seconds, 4)
            rows.append(row)
            print(row)
    if a.out:
        result = {"processor": processor(), "threads": 1, "python": platform.python_version(),
                  "numpy": np.__version__, "real_time_factor": rows}
        Path(a.out).write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
