"""What one edit of a plan costs: `python benchmarks/editing.py [--speech FILE --text FILE] [--seconds 7]`.

A page sends a whole plan after each edit (`LivePlans.answer`). The lexeme of one block after another is swapped; the
first edit, which makes the drawing that all start from, is left out. Calls do not depend on the machine: they are of
functions of this project, of the json module, and of everything (numpy, torch and built-in functions included).
"""

from __future__ import annotations

import argparse
import copy
import cProfile
import pstats
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import soundfile
import torch

from data_module.types import Speech
from gesticulator import Gesticulator
from gesticulator.serve.edits import LivePlans

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Calls:
    """Calls of functions: project: defined in this repository; json: of the json module; every: all of them, those of
    libraries and built-in ones too."""

    project: int
    json: int
    every: int


def calls_of(run: Callable[[], object]) -> Calls:
    """The calls that `run` makes."""
    profile = cProfile.Profile()
    profile.runcall(run)
    project = in_json = every = 0
    for (file, _, name), (_, count, *_) in pstats.Stats(profile).stats.items():  # type: ignore[attr-defined]
        every += count
        project += count * file.startswith(str(ROOT))
        in_json += count * ("/json/" in file or "_json" in name)
    return Calls(project, in_json, every)


def swapped(plan: dict[str, Any], at: int) -> dict[str, Any]:
    """The plan with the next best lexeme in one block."""
    edited = copy.deepcopy(plan)
    block = edited["blocks"][at]
    block["lexeme"] = next(one["lexeme"] for one in block["alternatives"] if one["lexeme"] != block["lexeme"])
    return edited


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    p.add_argument("--speech", type=Path, default=ROOT / "examples" / "speech.flac")
    p.add_argument("--text", type=Path, help="what is said; the text beside the example")
    p.add_argument("--seconds", type=float, help="of the recording; all of it")
    p.add_argument("--edits", type=int, default=10, metavar="N")
    asked = p.parse_args()
    torch.set_num_threads(1)
    samples, rate = soundfile.read(asked.speech, dtype="float32")
    count = len(samples) if asked.seconds is None else round(asked.seconds * rate)
    speech = Speech(samples[:count], rate)
    system = Gesticulator.from_pretrained()
    first = system(speech, text=asked.text, seed=1)
    plans, plan = LivePlans(system, first), first.explain()
    middle = len(plan["blocks"]) // 2
    plans.answer(swapped(plan, middle))
    edits = [swapped(plan, (middle + at) % len(plan["blocks"])) for at in range(asked.edits)]
    seconds = []
    for edit in edits:
        begin = time.process_time()
        plans.answer(edit)
        seconds.append(time.process_time() - begin)
    again = swapped(plan, middle)
    calls = calls_of(lambda: plans.answer(again))
    print("| recording, s | blocks | project's calls | json's calls | all calls | processor time, ms |")
    print("|---|---|---|---|---|---|")
    print(f"| {speech.duration:.1f} | {len(plan['blocks'])} | {calls.project:,} | {calls.json:,} | {calls.every:,} | "
          f"{1000 * statistics.median(seconds):.0f} |")


if __name__ == "__main__":
    main()
