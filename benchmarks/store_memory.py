"""Peak memory of `gesticulator train` as the store grows: `python benchmarks/store_memory.py --hours 1 64`.

The store is made up: the blocks and features of a small one, over and over, written once as a recording of six minutes
and linked under as many names as the hours need (nothing is cut or heard again). What is real is the training: the
corpus is written to the work folder, statistics, the lexicon (predictors and k-means), labels, steps of interpreter,
gate and generator, and the bundle. Each row is a process of its own; peak: MB that it held at most, the interpreter and
torch included.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import platform
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from data_module.store import Store
from gesticulator.bundle.config import Config, with_settings
from gesticulator.training.presets import preset
from gesticulator.training.stages.caches import blocks_folder, cut, encode_all, features_folder, read_arrays

CHILD = """
import resource, sys
from gesticulator.training.command import main
code = main(sys.argv[1:])
used = resource.getrusage(resource.RUSAGE_SELF)
print(used.ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e6, used.ru_utime + used.ru_stime)
sys.exit(code)
"""
LONG = 1000
"""Blocks of a made-up recording, some six minutes."""
HELD = 5
"""Every fifth recording is of the validation split."""


def settings(steps: int) -> list[str]:
    """The preset `default` narrowed, so that the corpus and not the models are what counts; RACER's stages left out,
    which hold the corpus in memory."""
    short = ("generator", "interpreter", "gate")
    return [*(f"schedules.{stage}.{asked}" for stage in short for asked in (f"steps={steps}", "batch=32")),
            "schedules.interpreter_text.steps=0", "schedules.cql.steps=0", "schedules.reward.steps=0",
            "schedules.advantage.steps=0", "text.encoder=", "interpreter.text_head=0", "motion.joints=16",
            "lexicon.size=128", "lexicon.levels=[16]", "front_end.bands=16", "generator.hidden=64",
            "generator.context=64", "generator.flow_width=64", "interpreter.width=64", "gate.width=32"]


def made_up(base: Store, config: Config, folder: Path, hours: float) -> tuple[Path, Path, float]:
    """A store of so many hours and its work folder; and the hours there are."""
    seed = folder / "seed"
    parts = {}
    if not (seed / "done").exists():
        files = cut(base, config, seed, progress=False)
        heard = encode_all(files, config, progress=False)
        for kind, kept in (("blocks", files), ("features", heard)):
            rows = [read_arrays(file) for file in kept]
            each = {key: np.concatenate([own[key] for own in rows]) for key in ("motion", "silent", "control", "low")
                    if key in rows[0]}
            if kind == "blocks":
                each["durations"] = np.concatenate([np.diff(own["edges"]) for own in rows])
            long = {key: np.resize(value, (LONG, *value.shape[1:])) for key, value in each.items()}
            if kind == "blocks":
                long["edges"] = np.concatenate([[0.0], np.cumsum(long.pop("durations"))])
                long |= {key: rows[0][key] for key in ("first", "mask")}
            np.savez(seed / f"{kind}.npz", **long)
        (seed / "done").touch()
    length = float(read_arrays(seed / "blocks.npz", only=("edges",))["edges"][-1])
    count = max(HELD, round(hours * 3600 / length))
    store = folder / f"store-{hours:g}"
    (store / "recordings").mkdir(parents=True)
    like = json.loads((base.path / "store.json").read_text())
    entries = []
    for number in range(count):
        name = f"made_up_{number:05d}"
        entries.append({**like["recordings"][0], "name": name, "group": name,
                        "split": "train" if number % HELD else "val"})
        for suffix in ("flac", "npz"):
            os.link(next(base.path.glob(f"recordings/*.{suffix}")), store / "recordings" / f"{name}.{suffix}")
    fingerprint = hashlib.sha256(json.dumps(entries, sort_keys=True).encode()).hexdigest()
    (store / "store.json").write_text(json.dumps({**like, "fingerprint": fingerprint, "recordings": entries}))
    work = folder / f"bundle-{hours:g}h.work"
    parts["blocks"] = blocks_folder(Store.open(store), config, work)
    parts["features"] = features_folder(parts["blocks"], config)
    for kind, place in parts.items():
        place.mkdir(parents=True)
        for entry in entries:
            os.link(seed / f"{kind}.npz", place / f"{entry['name']}.npz")
    return store, work, count * length / 3600


def one(base: Store, asked: list[str], folder: Path, hours: float, memory: float) -> dict[str, Any]:
    """A row: what a store of so many hours takes."""
    store, work, there = made_up(base, with_settings(preset("default"), asked), folder, hours)
    done = subprocess.run([sys.executable, "-c", CHILD, "--data", str(store), "--out", str(work.with_suffix("")),
                           "--preset", "default", "--threads", "1", "--quiet", "--corpus-memory", str(memory),
                           *(part for setting in asked for part in ("--set", setting))],
                          check=True, capture_output=True, text=True)
    peak, seconds = map(float, done.stdout.split()[-2:])
    size = sum(file.stat().st_size for file in work.glob("corpus-*/*.npy"))
    return {"hours": round(there, 1), "corpus_memory_gb": memory, "peak_mb": round(peak), "seconds": round(seconds),
            "corpus_mb": round(size / 1e6)}


def main() -> None:
    """Measure, print a row for each size and, with --out, write them."""
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("--store", type=Path, required=True, help="a small store, as build folder makes it of tests/toy.py")
    p.add_argument("--hours", type=float, nargs="+", default=[1, 4, 16, 64])
    p.add_argument("--memory", type=float, default=0.0, help="--corpus-memory of the training, GB")
    p.add_argument("--steps", type=int, default=30)
    p.add_argument("--folder", type=Path, help="where to work: 30 MB an hour of store (default: a temporary folder)")
    p.add_argument("--out", type=Path)
    asked = p.parse_args()
    rows = []
    with tempfile.TemporaryDirectory(dir=asked.folder) as folder:
        for hours in asked.hours:
            rows.append(one(Store.open(asked.store), settings(asked.steps), Path(folder), hours, asked.memory))
            print(json.dumps(rows[-1]), flush=True)
    if asked.out:
        rows.sort(key=lambda row: float(row["hours"]))
        asked.out.write_text(json.dumps({"machine": platform.machine(), "python": platform.python_version(),
                                         "steps": asked.steps, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
