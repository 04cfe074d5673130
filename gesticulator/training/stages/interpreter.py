"""The interpreters with text or audio-only: of lexemes (RG 6.1, 6.3), trained with the silent hint, and of style.

The style interpreter (RG 6.2) is trained on the generator's learned style codes, or, with a flow head, on the codes
measured on gesture units (`gesticulator.training.stages.heads`).
"""

from itertools import islice
from typing import Any

import torch

from generator.model import Generator
from gesticulator.bundle import models
from gesticulator.bundle.config import Config
from gesticulator.bundle.models import system_of
from gesticulator.training import fit as fitting
from gesticulator.training.stages.base import Figures, Node, Run, Stage
from gesticulator.training.stages.generator import GENERATOR
from gesticulator.training.stages.heads import UNIT_CODES, UNITS, unit_style_task
from gesticulator.training.stages.lexicon import LABELS, LEXICON, model_sizes
from gesticulator.training.stages.speech import CORPUS
from gesticulator.training.stages.windows import AT_ONCE, VALIDATED, Windows, sequences, task_of, validation
from interpreters.lstm import LstmInterpreter, StyleInterpreter
from interpreters.planner import UnitStyleInterpreter


def _task(run: Run, model: LstmInterpreter, text: bool) -> fitting.Task:
    config, corpus, labelled = run.config, run.get(CORPUS), run.get(LABELS)
    parts = sequences(corpus, labelled.hinted, "train", labelled.style_numbers, text)
    windows = Windows(corpus, parts, config.window, text=text,
                      control=config.control if config.interpreter.use_control else None)

    def validate(batches: list[fitting.Batch]) -> Figures:
        right, nll, count = 0.0, 0.0, 0.0
        for b in batches:
            logits, _ = model.scores(b["lexeme"][:, :-1], b["audio_high"][:, 1:], b["speaker"], None,
                                     b["text"][:, 1:] if text else None, None, model.poses(b))
            valid, wanted = b["valid"][:, 1:], b["lexeme"][:, 1:]
            right += float(((logits.argmax(-1) == wanted) * valid).sum())
            # The sum over valid blocks, so that padded windows do not count.
            nll -= float((torch.log_softmax(logits, -1).gather(-1, wanted[..., None])[..., 0] * valid).sum())
            count += float(valid.sum())
        return {"accuracy": right / count, "nll": nll / count}

    return task_of(run, windows, validation(corpus, labelled.hinted, config.window, text), validate, watch="nll")


_SHAPED_BY = ("window", "control", "silence.hint")

INTERPRETER: Stage[LstmInterpreter] = Stage(
    "interpreter", settings=(lambda config: config.interpreter.without_text(), *_SHAPED_BY),
    needs=lambda config: (CORPUS, LEXICON, LABELS), schedule="interpreter", part="interpreter",
    build=lambda run: models.build("interpreter", model_sizes(run)),
    train=lambda run, model: _task(run, model, False))


def init_from_audio_only(config: Config) -> bool:
    """Whether the interpreter with text is initialised from the audio-only one and trained by its own schedule;
    otherwise it is trained from scratch like that one."""
    return config.schedules.interpreter_text.steps > 0


def _build_text(run: Run) -> LstmInterpreter:
    model: LstmInterpreter = models.build("interpreter_text", model_sizes(run))
    if init_from_audio_only(run.config):
        model.init_from_audio_only(run.get(INTERPRETER))
    return model


INTERPRETER_TEXT: Stage[LstmInterpreter] = Stage(
    "interpreter_text", settings=("interpreter", "text", *_SHAPED_BY),
    needs=lambda config: (CORPUS, LEXICON, LABELS, *((INTERPRETER,) if init_from_audio_only(config) else ())),
    schedule="interpreter_text", schedule_of=lambda config: (
        config.schedules.interpreter_text if init_from_audio_only(config) else config.schedules.interpreter),
    wanted=lambda config: bool(config.text.encoder) and config.interpreter.reads,
    part="interpreter_text", build=_build_text,
    train=lambda run, model: _task(run, model, True))


_HELD_OUT = 10
"""One in this many training recordings is held back for validation, since only training blocks have style codes."""


def _style_task(run: Run, model: StyleInterpreter | UnitStyleInterpreter, text: bool) -> fitting.Task:
    if isinstance(model, UnitStyleInterpreter):
        return unit_style_task(run, model)
    config, corpus, labelled = run.config, run.get(CORPUS), run.get(LABELS)
    generator = run.get(GENERATOR)
    assert isinstance(generator, Generator) and generator.styles is not None
    codes = generator.styles
    table = codes.table.weight.detach()
    parts = sequences(corpus, labelled.labels, "train", labelled.style_numbers, text)
    # A corpus of fewer than ten recordings validates on its training data.
    held = parts[::_HELD_OUT] if len(parts) >= _HELD_OUT else []
    windows = Windows(corpus, [p for i, p in enumerate(parts) if not held or i % _HELD_OUT], config.window, text=text)
    checks = list(islice(Windows(corpus, held or parts, config.window, text=text).tiled(AT_ONCE), VALIDATED))

    def validate(batches: list[fitting.Batch]) -> Figures:
        return {"code_error": sum(float(model.losses(b)["code"]) for b in batches) / len(batches)}

    # Codes by block: they are numbered by the training blocks, and all others have the code 0.
    of_blocks = {"code": table[torch.as_tensor(labelled.style_numbers)]}
    return task_of(run, windows, checks, validate, of_blocks, "code_error")


def _style_needs(config: Config) -> tuple[Node[Any], ...]:
    codes = (UNITS, UNIT_CODES) if system_of(config).VARIES else (GENERATOR,)
    return CORPUS, LEXICON, LABELS, *codes


STYLE: Stage[StyleInterpreter | UnitStyleInterpreter] = Stage(
    "style", settings=(lambda config: config.style.without_text(), "window"), needs=_style_needs, schedule="style",
    wanted=lambda config: config.generator.styled, part="style",
    build=lambda run: models.build("style", model_sizes(run)),
    train=lambda run, model: _style_task(run, model, False))
STYLE_TEXT: Stage[StyleInterpreter] = Stage(
    "style_text", settings=("style", "window", "text"), needs=lambda config: (CORPUS, LEXICON, LABELS, GENERATOR),
    schedule="style", part="style_text", build=lambda run: models.build("style_text", model_sizes(run)),
    wanted=lambda config: config.generator.styled and bool(config.text.encoder) and config.style.text_features > 0,
    train=lambda run, model: _style_task(run, model, True))
