"""The gate, which decides whether a block is gestured (RG 8, third limitation)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from gesticulator.bundle import models
from gesticulator.training import fit as fitting
from gesticulator.training.stages.base import Figures, Run, Stage
from gesticulator.training.stages.features import CORPUS
from gesticulator.training.stages.labels import LABELS, model_sizes
from gesticulator.training.stages.windows import Windows, sequences, validation
from interpreters.gate import ActivityGate


def _train(run: Run, model: ActivityGate, folder: Path) -> Figures:
    config, corpus, labelled = run.config, run.get(CORPUS), run.get(LABELS)
    windows = Windows(corpus, sequences(corpus, labelled.labels, "train", labelled.style_numbers), config.window)
    active = torch.as_tensor(labelled.active.astype(np.float32))

    def with_activity(batch: fitting.Batch) -> fitting.Batch:
        return {**batch, "active": active[batch["block"]]}

    checks = [with_activity(b) for b in validation(corpus, labelled.labels, config.window)]

    @torch.no_grad()
    def validate() -> Figures:
        batches = [{key: value.to(run.device) for key, value in b.items()} for b in checks]
        return {"nll": sum(float(model.losses(b)["activity"]) for b in batches) / len(batches),
                "active": float(active[torch.as_tensor(corpus.select("train"))].mean())}

    task = fitting.Task(lambda rng: with_activity(windows.sample(rng, run.schedule(GATE).batch)), validate=validate,
                        watch="nll")
    return run.fit(GATE, model, task, folder)


GATE: Stage[ActivityGate] = Stage(
    "gate", settings=("gate", "window"), needs=lambda config: (CORPUS, LABELS), schedule="gate",
    wanted=lambda config: config.schedules.gate.steps > 0, part="gate",
    build=lambda run: models.gate(model_sizes(run)), train=_train)
