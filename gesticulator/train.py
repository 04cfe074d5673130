"""`python -m gesticulator.train --data STORE --out BUNDLE`: every stage, resumable, from a store to a bundle."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from data_module.errors import InputError, one_line_errors
from data_module.files import write_text
from data_module.store import Store
from gesticulator import bundle as bundles
from gesticulator.card import model_card
from gesticulator.config import Config, with_settings
from gesticulator.presets import PRESETS, preset
from gesticulator.stages import BLOCKS, CORPUS, STAGES, Run, assemble, closure, wanted


@dataclass(frozen=True)
class TrainOptions:
    """How a run is made. speech: folders of more sound for the predictive coding of the speech encoder. redo: stages
    to train again. only: the stage to stop after, with what it needs."""

    device: str = "cpu"
    workers: int = 1
    progress: bool = True
    speech: tuple[Path, ...] = ()
    redo: tuple[str, ...] = ()
    only: str | None = None


def train(config: Config, store: Store, out: Path, work: Path, options: TrainOptions | None = None
          ) -> bundles.Bundle | None:
    """Run every stage that is not finished and write the bundle; None when `only` stops before the last stage."""
    options = options or TrainOptions()
    stages = wanted(config)
    if options.only is not None:
        if STAGES[options.only] not in stages:
            raise InputError(f"--stage {options.only}", "is not part of these settings",
                             "see text, gate and front_end in --set")
        stages = [STAGES[options.only]]
    work.mkdir(parents=True, exist_ok=True)
    _claim(work, store)
    run = Run(config, store, work, options.device, options.progress, options.speech, options.workers)
    for name in options.redo:
        run.redo(STAGES[name])
    run.get(BLOCKS)  # what is wrong with the store is said before hours of training
    plan = list(closure(stages, config))
    for number, stage in enumerate(plan, 1):
        if options.progress:
            state = "finished before" if run.finished(stage) else f"{run.schedule(stage).steps} steps"
            print(f"stage {number} of {len(plan)}: {stage.name} ({state})", file=sys.stderr)
        run.get(stage)
    if options.only is not None:
        return None
    trained = assemble(run, provenance(run))
    bundles.save(trained, out, model_card(trained))
    return trained


def _claim(work: Path, store: Store) -> None:
    """A work folder belongs to one store."""
    record = work / "store.json"
    known = None
    if record.exists():
        with contextlib.suppress(ValueError, AttributeError):  # cut short by a crash: written again
            known = json.loads(record.read_text()).get("fingerprint")
    if known not in (None, store.fingerprint):
        raise InputError(store.path, f"is not the store that {work} was started with (its settings or contents "
                         "differ)", "give another --work folder or delete that one")
    if known is None:
        write_text(record, json.dumps({"fingerprint": store.fingerprint}))


def provenance(run: Run) -> dict[str, Any]:
    """What the weights are trained on, in plain values."""
    store, corpus = run.store, run.get(CORPUS)
    hours = {split: round(float(corpus.durations[corpus.select(split)].sum()) / 3600, 3)
             for split in ("train", "val", "test")}
    return {"store": store.corpus, "fingerprint": store.fingerprint, "licence": store.licence, "seed": store.seed,
            "hours": hours, "blocks": len(corpus.silent), "more_speech": [folder.name for folder in run.speech]}


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser("gesticulator.train", description="Train a bundle from a store.")
    p.add_argument("--data", required=True, metavar="STORE", help="a store made by python -m data_module.build")
    p.add_argument("--out", required=True, metavar="BUNDLE", help="the folder to write the bundle to")
    p.add_argument("--preset", default="default", help=", ".join(PRESETS))
    p.add_argument("--speech", action="append", default=[], metavar="DIR",
                   help="a folder of more sound (no motion, no text) for the speech encoder's first stage")
    p.add_argument("--set", action="append", default=[], metavar="PATH=VALUE", dest="settings",
                   help="change a setting of the preset, for example generator.lstm_width=320")
    p.add_argument("--work", metavar="DIR", help="where stages are kept (default: BUNDLE.work); resumed when there")
    p.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    p.add_argument("--threads", type=int, default=os.cpu_count() or 1, help="threads of torch (default: all cores)")
    p.add_argument("--stage", choices=STAGES, help="train this stage (and what it needs) and stop")
    p.add_argument("--redo", action="append", default=[], choices=STAGES, help="train this stage again")
    p.add_argument("--seed", type=int, help="the seed of the run")
    p.add_argument("--quiet", action="store_true", help="no progress bars")
    return p


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    arguments = parser().parse_args(argv)
    with one_line_errors("gesticulator.train"):
        if arguments.device == "cuda" and not torch.cuda.is_available():
            raise InputError("--device cuda", "there is no CUDA device", "use --device cpu")
        torch.set_num_threads(max(1, arguments.threads))
        config = with_settings(preset(arguments.preset), arguments.settings)
        if arguments.seed is not None:
            config = dataclasses.replace(config, seed=arguments.seed)
        out = Path(arguments.out)
        work = Path(arguments.work) if arguments.work else out.with_name(out.name + ".work")
        options = TrainOptions(arguments.device, arguments.threads, not arguments.quiet,
                               tuple(Path(folder) for folder in arguments.speech), tuple(arguments.redo),
                               arguments.stage)
        made = train(config, Store.open(arguments.data), out, work, options)
        if made is not None:
            print(f"{out}: trained on {made.provenance['hours']['train']} h; "
                  + "; ".join(f"{stage} " + ", ".join(f"{k} {v:.4g}" for k, v in own.items())
                              for stage, own in made.figures.items()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
