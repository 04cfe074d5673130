"""The style interpreter, with text (RG 6.2) or audio-only: trained on the generator's learned style codes, or, with a
flow head, on those measured on gesture units (`unit_styles`)."""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import Any

import torch

from generator.model import Generator
from gesticulator.bundle import models
from gesticulator.bundle.config import Config
from gesticulator.systems import system_of
from gesticulator.training import fit as fitting
from gesticulator.training.stages.base import Figures, Node, Run, Stage
from gesticulator.training.stages.features import CORPUS
from gesticulator.training.stages.generator import GENERATOR
from gesticulator.training.stages.labels import LABELS, model_sizes
from gesticulator.training.stages.lexicon import LEXICON
from gesticulator.training.stages.planner import UNITS
from gesticulator.training.stages.unit_styles import UNIT_CODES, train_interpreter
from gesticulator.training.stages.windows import AT_ONCE, VALIDATED, Windows, sequences
from interpreters.lstm import StyleInterpreter
from interpreters.planner import UnitStyleInterpreter

_HELD = 10
"""One in this many training recordings is held back for validation, since only training blocks have style codes."""


def _train(run: Run, model: StyleInterpreter | UnitStyleInterpreter, folder: Path, stage: Stage[Any], text: bool
           ) -> Figures:
    if isinstance(model, UnitStyleInterpreter):
        return train_interpreter(run, model, folder, stage)
    config, corpus, labelled = run.config, run.get(CORPUS), run.get(LABELS)
    generator = run.get(GENERATOR)
    assert isinstance(generator, Generator) and generator.styles is not None
    codes = generator.styles
    table = codes.table.weight.detach()
    parts = sequences(corpus, labelled.labels, "train", labelled.style_numbers, text)
    held = parts[::_HELD] if len(parts) >= _HELD else []
    windows = Windows(corpus, [p for i, p in enumerate(parts) if not held or i % _HELD], config.window, text=text)
    checks = list(islice(Windows(corpus, held or parts, config.window, text=text).tiled(AT_ONCE), VALIDATED))

    def with_codes(batch: fitting.Batch) -> fitting.Batch:
        return {**batch, "lexeme": batch["lexeme_index"], "code": table[batch["style"]]}

    @torch.no_grad()
    def validate() -> Figures:
        batches = [{key: value.to(run.device) for key, value in with_codes(b).items()} for b in checks]
        error = sum(float(model.losses(b)["code"]) for b in batches) / len(batches)
        return {"code_error": error, "code_variance": float(table[1:].var(0).mean())}

    task = fitting.Task(lambda rng: with_codes(windows.sample(rng, run.schedule(stage).batch)), validate=validate,
                        watch="code_error")
    return run.fit(stage, model, task, folder)


def _needs(config: Config) -> tuple[Node[Any], ...]:
    codes = (UNITS, UNIT_CODES) if system_of(config).VARIES else (GENERATOR,)
    return CORPUS, LEXICON, LABELS, *codes


STYLE: Stage[StyleInterpreter | UnitStyleInterpreter] = Stage(
    "style", settings=(lambda config: config.style.without_text(), "window"), needs=_needs, schedule="style",
    wanted=lambda config: config.generator.styled, part="style",
    build=lambda run: models.build("style", model_sizes(run)),
    train=lambda run, model, folder: _train(run, model, folder, STYLE, False))
STYLE_TEXT: Stage[StyleInterpreter] = Stage(
    "style_text", settings=("style", "window", "text"), needs=lambda config: (CORPUS, LEXICON, LABELS, GENERATOR),
    schedule="style", part="style_text", build=lambda run: models.build("style_text", model_sizes(run)),
    wanted=lambda config: config.generator.styled and bool(config.text.encoder) and config.style.text_features > 0,
    train=lambda run, model, folder: _train(run, model, folder, STYLE_TEXT, True))
