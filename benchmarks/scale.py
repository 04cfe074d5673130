"""Memory and speed of `gesticulator infer` as recordings grow: `python benchmarks/scale.py --minutes 5 60`.
With `--suffix .bvh,.glb` both files are written by one run.

The recording is a speech over and over (`--speech`), at its own rate. Each length is done by a process of its own;
seconds: of its processor time; peak: MB that it held at most, the interpreter, torch and the models included.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
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


def main() -> None:
    """Measure, print a row for each length and, with --out, write them."""
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("--speech", type=Path, default=Path(__file__).parent.parent / "examples" / "speech.flac")
    p.add_argument("--minutes", type=float, nargs="+", default=[5, 60])
    p.add_argument("--suffix", nargs="+", default=[".bvh"])
    p.add_argument("--legs", action="store_true")
    p.add_argument("--out", type=Path, metavar="FILE.json")
    asked = p.parse_args()
    rows: list[dict[str, Any]] = []
    before = os.getloadavg()[0]
    for suffix in asked.suffix:
        for minutes in asked.minutes:
            rows.append(one(asked.speech, minutes, suffix, ["--legs"] if asked.legs else []))
            print(json.dumps(rows[-1]), flush=True)
    if asked.out is not None:
        found = {"machine": platform.processor() or platform.machine(), "python": platform.python_version(),
                 "numpy": np.__version__, "load": [round(one, 1) for one in (before, os.getloadavg()[1])],
                 "rows": rows}
        asked.out.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
