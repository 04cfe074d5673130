"""A complete training: all required stages from a store to a bundle, resumable."""

import contextlib
import sys
import time
from pathlib import Path
from typing import Any

from data_module.files import lock
from gesticulator.bundle.bundle import Bundle, save
from gesticulator.bundle.card import model_card
from gesticulator.training import distributed
from gesticulator.training.stages import BLOCKS, CORPUS, Run, assemble, wanted


def train(run: Run, out: Path) -> Bundle:
    """Run all unfinished stages and write the bundle; several processes run it together
    (`gesticulator.training.distributed.joined`).

    InputError if settings and store do not match, or if another training has locked the work folder.
    """
    began = time.monotonic()
    with contextlib.ExitStack() as held:
        with distributed.first():
            if not distributed.rank():
                held.enter_context(lock(run.work, "a training"))
        run.get(BLOCKS)  # report problems of the store before hours of training
        plan = wanted(run.config)
        for place, stage in enumerate(plan):
            if run.progress:
                state = "finished before" if run.finished(stage) else f"{run.schedule(stage).steps} steps"
                # What is left of a stage its bar tells; a step of the next may take fifty times as long, or a fiftieth.
                so_far = f"; {(time.monotonic() - began) / 60:.1f} minutes so far" if place else ""
                print(f"stage {place + 1} of {len(plan)}: {stage.name}, {state}{so_far}", file=sys.stderr)
            run.get(stage)
        trained = assemble(run, provenance(run))
        if not distributed.rank():
            save(trained, out, model_card(trained))
        return trained


def provenance(run: Run) -> dict[str, Any]:
    """The training data, in plain values."""
    store, corpus = run.store, run.get(CORPUS)
    hours = {split: round(float(corpus.durations[corpus.select(split)].sum()) / 3600, 3)
             for split in ("train", "val", "test")}
    return {"store": store.corpus, "fingerprint": store.fingerprint, "licence": store.licence, "seed": store.seed,
            "hours": hours, "blocks": len(corpus.silent)}
