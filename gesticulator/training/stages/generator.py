"""G, E_M, E_A and the style codes (RG 5.2, 5.3), with silent augmentation (RG 6.4.1)."""

import copy
from typing import Any, cast

import numpy as np
import torch

from data_module.layers import freeze
from generator.flow import FlowGenerator
from generator.model import BlockInputs, Generator
from gesticulator.bundle import models
from gesticulator.bundle.config import Config
from gesticulator.bundle.models import system_of
from gesticulator.training import fit as fitting
from gesticulator.training.stages.base import Figures, Node, Run, Stage
from gesticulator.training.stages.heads import UNIT_CODES, UNITS
from gesticulator.training.stages.lexicon import LABELS, LEXICON, model_sizes
from gesticulator.training.stages.speech import CORPUS
from gesticulator.training.stages.windows import Windows, sequences, task_of, validation, with_silence
from interpreters.planner import one_hot
from lexicon.autoencoder import Lexicon
from lexicon.movement import MovementLexicon

_NOTHING = (0.0, 0.0, 0.0, 0.0)
"""No input is left out, as in use."""
LONGEST_INSERT = 10
"""Longest inserted run of silence, in blocks (5 s at most)."""


def _flow_task(run: Run, model: FlowGenerator) -> fitting.Task:
    config, corpus, labelled = run.config, run.get(CORPUS), run.get(LABELS)
    parts = sequences(corpus, labelled.labels, "train", labelled.style_numbers)
    control = config.control if config.generator.use_control else None
    windows = Windows(corpus, parts, config.generator.blocks, control=control, moving=True)
    tables = {}
    if config.generator.units:
        tables["unit"] = one_hot(torch.as_tensor(run.get(UNITS)))
    if config.generator.styled:
        tables["code"] = torch.as_tensor(run.get(UNIT_CODES))
    # A copy: the lexicon of the run stays on the CPU, where other stages use it.
    lexicon = copy.deepcopy(_movements(run)).to(run.device)

    def validate(batches: list[fitting.Batch]) -> Figures:
        torch.manual_seed(run.seed(GENERATOR))  # the same times and noise for comparable figures
        return {"flow": sum(float(model.losses(b, 1.0, lexicon.nearest, _NOTHING)["flow"]) for b in batches)
                / len(batches)}

    checks = validation(corpus, labelled.labels, config.generator.blocks, moving=True)
    return task_of(run, windows, checks, validate, tables, "flow",
                   lambda batch, progress: model.losses(batch, progress, lexicon.nearest))


def _movements(run: Run) -> MovementLexicon:
    lexicon = run.get(LEXICON)
    return cast(MovementLexicon, lexicon)


def _build(run: Run) -> Generator | FlowGenerator:
    model = models.build("generator", model_sizes(run, training=not system_of(run.config).VARIES))
    # The flow generates coefficients of the lexicon's basis, so it takes over basis and scale.
    if isinstance(model, FlowGenerator):
        lexicon, corpus = _movements(run), run.get(CORPUS)
        known = torch.as_tensor(corpus.some("train"))
        model.adopt(lexicon.basis, lexicon.basis.coefficients(corpus.motion[known], corpus.pasts[known]),
                    lexicon.added(torch.arange(lexicon.size)))
    return model


def _regression_task(run: Run, model: Generator) -> fitting.Task:
    config, corpus, labelled = run.config, run.get(CORPUS), run.get(LABELS)
    parts = sequences(corpus, labelled.labels, "train", labelled.style_numbers)
    if config.silence.augmentation > 0:
        # A random generator of its own (7), so that augmentation changes no other random number.
        parts = with_silence(parts, corpus, labelled.nearest, config.silence.augmentation,
                             LONGEST_INSERT, np.random.default_rng([run.seed(GENERATOR), 7]))
    windows = Windows(corpus, parts, config.window, control=config.control if config.generator.use_control else None)
    lexicon = copy.deepcopy(cast(Lexicon, run.get(LEXICON))).to(run.device)
    freeze(lexicon)

    def vectors(batch: fitting.Batch) -> torch.Tensor:
        return lexicon.vectors[batch["lexeme"]]

    def validate(batches: list[fitting.Batch]) -> Figures:
        totals = []
        for b in batches:
            # With the zero code, since validation blocks have none of their own.
            zero = torch.zeros(*b["style"][:, 1:].shape, config.generator.style_width, device=run.device)
            generated, _ = model.roll_out(b["motion"][:, 0], BlockInputs(b["audio"][:, 1:], vectors(b)[:, 1:], zero))
            true = b["motion"][:, 1:]
            totals.append(((generated - true).pow(2).mean(), (lexicon.encode(generated.flatten(0, 1))
                                                              - lexicon.encode(true.flatten(0, 1))).pow(2).mean()))
        return {"reconstruction": float(sum(t[0] for t in totals)) / len(totals),
                "perceptual": float(sum(t[1] for t in totals)) / len(totals)}

    return task_of(run, windows, validation(corpus, labelled.labels, config.window), validate,
                   losses=lambda batch, progress: model.losses({**batch, "lexeme": vectors(batch)}, progress,
                                                               lexicon.encode))


def _unit_nodes(config: Config) -> tuple[Node[Any], ...]:
    samples = system_of(config).VARIES
    return (*((UNITS,) if samples and config.generator.units else ()),
            *((UNIT_CODES,) if samples and config.generator.styled else ()))


GENERATOR: Stage[Generator | FlowGenerator] = Stage(
    "generator",
    settings=("system", "generator", "window", "control", "silence.augmentation"),
    needs=lambda config: (CORPUS, LEXICON, LABELS, *_unit_nodes(config)), schedule="generator", part="generator",
    build=_build,
    train=lambda run, model: (_flow_task if isinstance(model, FlowGenerator) else _regression_task)(run, model))
