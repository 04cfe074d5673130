"""The lexeme interpreter with text (RG 6.1) or audio-only (RG 6.3), trained with the silent hint."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from gesticulator.bundle import models
from gesticulator.bundle.config import Config
from gesticulator.training import fit as fitting
from gesticulator.training.stages.base import Figures, Run, Stage
from gesticulator.training.stages.corpus import Corpus
from gesticulator.training.stages.features import CORPUS
from gesticulator.training.stages.labels import LABELS, model_sizes
from gesticulator.training.stages.lexicon import LEXICON
from gesticulator.training.stages.windows import Windows, sequences, validation
from interpreters.base import pose_of
from interpreters.lstm import LstmInterpreter


def _train(run: Run, model: LstmInterpreter, folder: Path, stage: Stage[LstmInterpreter], text: bool) -> Figures:
    config, corpus, labelled = run.config, run.get(CORPUS), run.get(LABELS)
    parts = sequences(corpus, labelled.hinted, "train", labelled.style_numbers, text)
    windows = Windows(corpus, parts, config.window, text=text,
                      control=config.control if config.interpreter.use_control else None)
    checks = validation(corpus, labelled.hinted, config.window, text)

    def as_labels(batch: fitting.Batch) -> fitting.Batch:
        return {**batch, "lexeme": batch["lexeme_index"]}

    @torch.no_grad()
    def validate() -> Figures:
        right, nll, count = 0.0, 0.0, 0.0
        for batch in checks:
            b = {key: value.to(run.device) for key, value in as_labels(batch).items()}
            logits, _ = model.scores(b["lexeme"][:, :-1], b["audio_high"][:, 1:], b["speaker"], None,
                                     b["text"][:, 1:] if text else None, None, model.poses(b))
            valid, wanted = b["valid"][:, 1:], b["lexeme"][:, 1:]
            right += float(((logits.argmax(-1) == wanted) * valid).sum())
            nll -= float((torch.log_softmax(logits, -1).gather(-1, wanted[..., None])[..., 0] * valid).sum())
            count += float(valid.sum())
        return {"accuracy": right / count, "nll": nll / count}

    task = fitting.Task(lambda rng: as_labels(windows.sample(rng, run.schedule(stage).batch)), validate=validate,
                        watch="nll")
    return run.fit(stage, model, task, folder)


_SHAPED_BY = ("window", "control", "silence.hint")

INTERPRETER: Stage[LstmInterpreter] = Stage(
    "interpreter", settings=(lambda config: config.interpreter.without_text(), *_SHAPED_BY),
    needs=lambda config: (CORPUS, LEXICON, LABELS), schedule="interpreter", part="interpreter",
    build=lambda run: models.build("interpreter", model_sizes(run)),
    train=lambda run, model, folder: _train(run, model, folder, INTERPRETER, False))


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
    train=lambda run, model, folder: _train(run, model, folder, INTERPRETER_TEXT, True))


@torch.inference_mode()
def teacher_logits(model: LstmInterpreter, corpus: Corpus, blocks: NDArray[np.int64], lexemes: NDArray[np.int64],
                   words: NDArray[np.int64] | None = None) -> Tensor:
    """[M - 1, S] scores of blocks [M] of a recording except the first, given lexemes [M] and the performer's motion.
    words: block numbers [M] whose words are read; default: the blocks themselves."""
    rows, previous = torch.as_tensor(blocks[1:]), torch.as_tensor(lexemes[:-1])[None]
    text = corpus.text((blocks if words is None else words)[1:])[None] if model.config.reads else None
    pose = pose_of(*corpus.before(blocks[1:]))[None] if model.config.pose_features else None
    who = torch.tensor([int(corpus.speaker_of[corpus.recording[blocks[0]]])])
    speaker = functional.one_hot(who, model.speakers).float()
    logits, _ = model.scores(previous, corpus.high[rows].float()[None], speaker, None, text, pose=pose)
    return logits[0]
