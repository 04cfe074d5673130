"""A complete training: all required stages from a store to a bundle, resumable."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from data_module.errors import InputError
from data_module.files import lock, read_object, write_text
from data_module.store import Store
from gesticulator.bundle.bundle import Bundle, save
from gesticulator.bundle.card import model_card
from gesticulator.training import distributed
from gesticulator.training.stages import BLOCKS, CORPUS, STAGES, Run, assemble, closure, wanted


def train(run: Run, out: Path, redo: Sequence[str] = (), only: str | None = None) -> Bundle | None:
    """Run all unfinished stages and write the bundle; None if `only` is given: stop after this stage and those that it
    needs. redo: stages to train again. Several processes run it together (`gesticulator.training.distributed.joined`).

    InputError if settings and store do not match, or another training has locked the work folder.
    """
    stages, config = wanted(run.config), run.config
    if only is not None:
        if STAGES[only] not in stages:
            raise InputError(f"--stage {only}", "is not part of these settings",
                             "see text, gate and front_end in --set")
        stages = [STAGES[only]]
    with contextlib.ExitStack() as held:
        with distributed.first():
            if not distributed.rank():
                held.enter_context(lock(run.work, "a training"))
                claim(run.work, run.store)
                for name in redo:
                    run.redo(STAGES[name])
        run.get(BLOCKS)  # report problems of the store before hours of training
        plan = list(closure(stages, config))
        for place, stage in enumerate(plan):
            if run.progress:
                state = "finished before" if run.finished(stage) else f"{run.schedule(stage).steps} steps"
                print(f"stage {place + 1} of {len(plan)}: {stage.name}, {state}", file=sys.stderr)
            run.get(stage)
        if only is not None:
            return None
        trained = assemble(run, provenance(run))
        if not distributed.rank():
            save(trained, out, model_card(trained))
        return trained


def claim(work: Path, store: Store) -> None:
    """Assign a work folder to a store; InputError if it belongs to another."""
    record, known = work / "store.json", None
    if record.exists():
        with contextlib.suppress(InputError):  # truncated by a crash: write again
            known = read_object(record, "delete it").get("fingerprint")
    if known not in (None, store.fingerprint):
        raise InputError(store.path, f"is not the store that {work} was started with (its settings or contents "
                         "differ)", "give another --work folder or delete that one")
    if known is None:
        write_text(record, json.dumps({"fingerprint": store.fingerprint}))


def provenance(run: Run) -> dict[str, Any]:
    """The training data, in plain values."""
    store, corpus = run.store, run.get(CORPUS)
    hours = {split: round(float(corpus.durations[corpus.select(split)].sum()) / 3600, 3)
             for split in ("train", "val", "test")}
    return {"store": store.corpus, "fingerprint": store.fingerprint, "licence": store.licence, "seed": store.seed,
            "hours": hours, "blocks": len(corpus.silent)}
