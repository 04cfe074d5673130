"""Memory and speed of `gesticulator infer` as recordings grow: `python benchmarks/scale.py --minutes 5 60`.
With `--suffix .bvh,.glb` both files are written by one run.

The recording is the example over and over, at its own rate. Each length is done by a process of its own;
seconds: of its processor time; peak: MB that it held at most, the interpreter and the models included.
"""

import argparse
import json
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


def recording(path: Path, minutes: float) -> None:
    """Write a recording of that length."""
    speech = Path(__file__).parent.parent / "examples" / "speech.flac"
    samples, rate = soundfile.read(speech, dtype="int16")
    soundfile.write(path, np.resize(samples, round(minutes * 60 * rate)), rate, "PCM_16")


def row_of(minutes: float, suffix: str) -> dict[str, Any]:
    """A row: what a recording of so many minutes takes."""
    with tempfile.TemporaryDirectory() as folder:
        sound, outputs = Path(folder, "speech.flac"), [Path(folder, f"out{one}") for one in suffix.split(",")]
        recording(sound, minutes)
        named = [word for out in outputs for word in ("-o", str(out))]
        command = [sys.executable, "-c", CHILD, str(sound), *named, "--quiet"]
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
        peak, seconds = map(float, done.stdout.split())
        size = sum(out.stat().st_size for out in outputs)
        return {"minutes": minutes, "format": suffix, "peak_mb": round(peak), "seconds": round(seconds, 1),
                "real_time_factor": round(seconds / minutes / 60, 4), "output_mb": round(size / 1e6, 1)}


def main() -> None:
    """Measure, print a row for each length and, with --out, write them."""
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("--minutes", type=float, nargs="+", default=[5, 60])
    p.add_argument("--suffix", default=".bvh")
    p.add_argument("--out", type=Path, metavar="FILE.json")
    a = p.parse_args()
    rows: list[dict[str, Any]] = []
    for minutes in a.minutes:
        rows.append(row_of(minutes, a.suffix))
        print(json.dumps(rows[-1]), flush=True)
    if a.out is not None:
        result = {"machine": platform.processor() or platform.machine(), "python": platform.python_version(),
                  "rows": rows}
        a.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
