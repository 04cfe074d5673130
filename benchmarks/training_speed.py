"""Seconds a step of every stage of training takes, on the processor and on a GPU, and whether both learn the same.

    python benchmarks/training_speed.py --data STORE --work DIR [--ways cpu cuda bfloat16] [--presets default paper]
                                        [--steps 60] [--only STAGE ...] [--out docs/results/training_speed.json]

Each stage is trained for the first `--steps` of its steps, each way in a work folder of its own, in the order of a
training; what it takes is the median of the steps after the fifth, without validation. Blocks, features and words are
computed once. The size of the store hardly matters: a step reads a batch. "loss" is the mean of the last twenty of the
steps, over that of the processor: random numbers of a GPU are others, so that 1 is met within their noise alone.

A stage that fails is reported with its error, and the others go on: exit code 1.
"""

from __future__ import annotations

import argparse
import json
import shlex
import statistics
import sys
import time
import traceback
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from torch import nn

from data_module.store import Store
from eval.table import Cell, Column, Provenance, Table, load_with_provenance, publish
from gesticulator.training import fit as fitting
from gesticulator.training.presets import preset
from gesticulator.training.stages import STAGES, Run, Stage, closure, wanted
from gesticulator.training.stages.base import Figures
from gesticulator.training.stages.training import claim

WAYS = {"cpu": ("cpu", "float32"), "cuda": ("cuda", "float32"), "bfloat16": ("cuda", "bfloat16")}
"""How training is told of each: --device, --precision."""
FIRST = 5
"""Steps that are not counted: memory is taken and kernels are chosen in them."""
LAST = 20
"""Steps whose loss is compared."""
COLUMNS = {"steps": Column("steps of the preset"), "cpu": Column("processor", "ms a step", 0, "low"),
           "cuda": Column("GPU", "ms a step", 0, "low"), "bfloat16": Column("GPU, bfloat16", "ms a step", 0, "low"),
           "loss": Column("loss, GPU over processor", "", 3, "near"),
           "loss_bfloat16": Column("loss, bfloat16 over processor", "", 3, "near"),
           "memory": Column("memory of the GPU", "MB", 0)}


@dataclass
class ShortRun(Run):
    """A run that stops each stage early and notes when its steps began."""

    most: int = 60
    began: dict[str, list[float]] = field(default_factory=dict)
    losses: dict[str, float] = field(default_factory=dict)

    def fit(self, stage: Stage[Any], model: nn.Module, task: fitting.Task, folder: Path) -> Figures:
        """See `Run.fit`."""
        began = self.began.setdefault(stage.name, [])

        def noted(step: int) -> None:
            began.append(time.perf_counter())
            if task.before_step is not None:
                task.before_step(step)

        schedule = replace(self.schedule(stage), validations=1)
        figures = fitting.fit(stage.name, model, replace(task, before_step=noted), schedule, folder, fitting.FitOptions(
            self.seed(stage), self.device, progress=False, stop_after=self.most, precision=self.precision))
        log = folder / f"{stage.name}.jsonl"
        if log.is_file():
            losses = [json.loads(line)["loss"] for line in log.read_text().splitlines()]
            self.losses[stage.name] = statistics.fmean(losses[-LAST:]) if losses else float("nan")
        return figures

    def milliseconds(self, stage: Stage[Any]) -> float | None:
        """Median time of a step; None if it has too few."""
        began = self.began.get(stage.name, [])[FIRST:]
        took = [later - earlier for earlier, later in zip(began, began[1:], strict=False)]
        return 1e3 * statistics.median(took) if len(took) > 2 else None


def measure(name: str, way: str, a: argparse.Namespace) -> tuple[dict[str, dict[str, float | None]], list[str]]:
    """Stage -> its figures of one way, and the errors."""
    device, precision = WAYS[way]
    config, store, work = preset(name), Store.open(a.data), Path(a.work) / way
    work.mkdir(parents=True, exist_ok=True)
    claim(work, store)
    for shared in Path(a.work).glob("*-*"):  # blocks, features and words are no matter of the way
        if not (work / shared.name).exists():
            (work / shared.name).symlink_to(shared.resolve())
    run = ShortRun(config, store, work, device, progress=False, workers=a.workers, precision=precision, most=a.steps)
    out: dict[str, dict[str, float | None]] = {}
    errors: list[str] = []
    for stage in closure(wanted(config), config):
        if a.only and stage.name not in a.only:
            continue
        if device == "cuda":
            torch.cuda.reset_peak_memory_stats()
        try:
            run.get(stage)
        except Exception as error:  # noqa: BLE001 - all stages are tried
            traceback.print_exc()
            errors.append(f"{name}: {stage.name}, {way}: {type(error).__name__}: {error}"[:300])
            continue
        out[stage.name] = {"steps": run.schedule(stage).steps, "ms": run.milliseconds(stage),
                           "loss": run.losses.get(stage.name),
                           "memory": torch.cuda.max_memory_allocated() / 1e6 if device == "cuda" else None}
        print(f"{name}: {stage.name}, {way}: {out[stage.name]}", file=sys.stderr, flush=True)
    return out, errors


def table(name: str, of: dict[str, dict[str, dict[str, Any]]], notes: list[str]) -> Table:
    """One preset's stages. of: way -> stage -> figures."""
    rows: dict[str, dict[str, Cell]] = {}
    for stage in STAGES:
        figures = {way: own[stage] for way, own in of.items() if stage in own}
        if not figures:
            continue
        row: dict[str, Cell] = {"steps": str(next(iter(figures.values()))["steps"])}
        row |= {way: one["ms"] for way, one in figures.items()}
        base = figures.get("cpu", {}).get("loss")
        for way, key in (("cuda", "loss"), ("bfloat16", "loss_bfloat16")):
            if base and way in figures and figures[way]["loss"] is not None:
                row[key] = figures[way]["loss"] / base
        if "cuda" in figures:
            row["memory"] = figures["cuda"]["memory"]
        rows[stage] = row
    for way in of:
        rows.setdefault("all, minutes", {})[way] = sum(
            one["steps"] * (one["ms"] or 0.0) for one in of[way].values()) / 6e4
    return Table(f"Training steps of the preset {name}", COLUMNS, rows, "stage", notes=notes, facts={"ways": of})


def known(out: str | None) -> dict[str, Any]:
    """Preset -> way -> stage -> figures of a file of results."""
    if not out or not Path(out).is_file():
        return {}
    return {one.title.rpartition(" ")[2]: dict(one.facts["ways"]) for one in load_with_provenance(out)[0]}


def main() -> int:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--data", required=True, metavar="STORE")
    p.add_argument("--work", required=True, metavar="DIR")
    p.add_argument("--ways", nargs="+", default=list(WAYS), choices=WAYS)
    p.add_argument("--presets", nargs="+", default=["default", "paper"])
    p.add_argument("--only", nargs="+", default=[], metavar="STAGE")
    p.add_argument("--steps", type=int, default=60, metavar="N")
    p.add_argument("--threads", type=int, default=2, metavar="N")
    p.add_argument("--workers", type=int, default=2, metavar="N", help="processes that cut and encode recordings")
    p.add_argument("--out", metavar="FILE.json", help="results are added to it; a .md is written beside it")
    a = p.parse_args()
    torch.set_num_threads(a.threads)
    results, errors = known(a.out), []
    gpu = torch.cuda.get_device_name() if torch.cuda.is_available() else "none"
    for name in a.presets:
        for way in a.ways:
            results.setdefault(name, {})[way], failed = measure(name, way, a)
            errors += failed
    notes = [f"The processor: {a.threads} threads. The GPU: {gpu}. The first {a.steps} steps of each stage."]
    tables = [table(name, of, notes) for name, of in results.items()]
    publish(tables, a.out, Provenance.now(shlex.join(["python", "benchmarks/training_speed.py", *sys.argv[1:]])))
    print("\n".join(errors), file=sys.stderr)
    return 1 if errors else 0


if __name__ == "__main__":
    sys.exit(main())
