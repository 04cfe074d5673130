"""G, E_M, E_A and the style codes (RG 5.2, 5.3), with silent augmentation (RG 6.4.1)."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import torch

from data_module.layers import freeze
from generator.model import BlockInputs, Generator
from gesticulator import fit as fitting
from gesticulator import models
from gesticulator.stages.base import Figures, Run, Stage
from gesticulator.stages.features import CORPUS
from gesticulator.stages.labels import LABELS, model_sizes
from gesticulator.stages.lexicon import LEXICON
from gesticulator.stages.windows import Windows, sequences, validation, with_silence


def _train(run: Run, model: Generator, folder: Path) -> Figures:
    config, corpus, labelled = run.config, run.get(CORPUS), run.get(LABELS)
    parts = sequences(corpus, labelled.labels, "train", labelled.style_numbers)
    if config.silence.augmentation > 0:
        parts = with_silence(parts, corpus, labelled.nearest, config.silence.augmentation,
                             config.silence.longest_insert, np.random.default_rng([run.seed(GENERATOR), 7]))
    windows = Windows(corpus, parts, config.window, control=config.control if config.generator.use_control else None)
    lexicon = copy.deepcopy(run.get(LEXICON)).to(run.device)
    freeze(lexicon)
    checks = validation(corpus, labelled.labels, config.window)

    def with_vectors(batch: fitting.Batch) -> fitting.Batch:
        return {**batch, "lexeme": lexicon.vectors[batch["lexeme_index"].to(run.device)]}

    @torch.no_grad()
    def validate() -> Figures:
        totals = []
        for batch in checks:
            b = {key: value.to(run.device) for key, value in with_vectors(batch).items()}
            zero = torch.zeros(*b["style"][:, 1:].shape, config.generator.style_width, device=run.device)
            made, _ = model.roll_out(b["motion"][:, 0], BlockInputs(b["audio"][:, 1:], b["lexeme"][:, 1:], zero))
            true = b["motion"][:, 1:]
            totals.append(((made - true).pow(2).mean(), (lexicon.encode(made.flatten(0, 1))
                                                         - lexicon.encode(true.flatten(0, 1))).pow(2).mean()))
        return {"reconstruction": float(sum(t[0] for t in totals)) / len(totals),
                "perceptual": float(sum(t[1] for t in totals)) / len(totals)}

    task = fitting.Task(lambda rng: with_vectors(windows.sample(rng, run.schedule(GENERATOR).batch)),
                        lambda batch, progress: model.losses(batch, progress, lexicon.encode), validate)
    return run.fit(GENERATOR, model, task, folder)


GENERATOR: Stage[Generator] = Stage(
    "generator", settings=("generator", "window", "control", "silence.augmentation", "silence.longest_insert"),
    needs=lambda config: (CORPUS, LEXICON, LABELS), schedule="generator",
    wanted=lambda config: config.tokens == "lexicon", part="generator",
    build=lambda run: models.generator(model_sizes(run, training=True)), train=_train)
