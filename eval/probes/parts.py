"""What a part of the lexeme interpreter bought: text, the right text, the learned speech levels. With and without.

Every row reads the same test recordings over the same lexicon, with the true lexeme before each block (teacher
forcing), so that two rows differ by the part alone; differences are paired over recordings. Accuracy is the share of
blocks whose best score is the performer's lexeme. Sampled is the share of right lexemes when they are sampled as the
product samples them, at the bundle's temperature: the mean probability of the performer's lexeme. NLL is the mean
negative log-probability of that lexeme in nats (less is better).

Rows: `text` reads the right words; `wrong text` is the same interpreter on the words of other recordings, which is
what a transcript without meaning would give (the mean over five of them); `audio only` is the interpreter that never
reads. `mel` is the audio-only interpreter on mel bands instead of the learned levels: it is trained here (and kept in
the work folder) with the same settings.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from eval import stats
from eval.context import EvalContext, Lexemes
from eval.table import Cell, Column, Table
from gesticulator import config as configs
from gesticulator.stages import CORPUS, INTERPRETER, LEXICON, TOKENS, Corpus, Run
from gesticulator.stages.caches import weights_hash
from gesticulator.stages.interpreter import teacher_logits
from interpreters.lstm import LstmInterpreter

Scores = dict[str, NDArray[np.float64]]
COLUMNS = {"accuracy": Column("accuracy", "%", 1), "sampled": Column("sampled", "%", 1),
           "nll": Column("NLL", "nats", 3, "low")}
WRONG_TEXTS = 5
"""Whose words are read instead: enough that the mean over them is steady."""
_MEL = ("front_end.name=mel", "front_end.bands=32")


def arguments(parser: argparse.ArgumentParser) -> None:
    """A store and a bundle."""
    EvalContext.arguments(parser)


def run(arguments: argparse.Namespace) -> Sequence[Table]:
    """"Text" on the test recordings that have words, "speech levels" on all."""
    return parts(EvalContext.of(arguments))


def parts(context: EvalContext) -> list[Table]:
    """A table for each part that the bundle has."""
    bundle, corpus, labels = context.bundle, context.corpus, context.labels
    temperature, found = bundle.config.selection.temperature or 1.0, []
    audio, read = bundle.block_models.interpreter, bundle.interpreter_text
    if read is not None:
        spoken = context.numbers(with_text=True)
        found.append(table("Text", {
            "text": teacher_forced(read, corpus, labels, spoken, temperature=temperature),
            "wrong text": wrongly_read(read, corpus, labels, spoken, temperature),
            "audio only": teacher_forced(audio, corpus, labels, spoken, temperature=temperature)},
            (("text", "wrong text"), ("text", "audio only")), [len(corpus.blocks_of(r)) - 1 for r in spoken]))
    if bundle.encoder is not None:
        every = context.numbers()
        mel, mel_corpus = _on_mel(context)
        found.append(table("Speech levels", {
            "vqwav2vec": teacher_forced(audio, corpus, labels, every, temperature=temperature),
            "mel": teacher_forced(mel, mel_corpus, labels, every, temperature=temperature)},
            (("vqwav2vec", "mel"),), [len(corpus.blocks_of(r)) - 1 for r in every]))
    return found


@torch.inference_mode()
def teacher_forced(model: LstmInterpreter, corpus: Corpus, labels: Lexemes, recordings: Sequence[int],
                   words_of: Sequence[int] | None = None, temperature: float = 1.0) -> Scores:
    """Accuracy and sampled (percent) and NLL (nats a block) on each recording; block 0 is given.

    words_of: for each recording, the one whose words are read instead of its own, block by block. temperature: at
    which lexemes are sampled.
    """
    accuracy, sampled, nll = [], [], []
    for place, recording in enumerate(recordings):
        blocks = corpus.blocks_of(recording)
        words = None if words_of is None else np.resize(corpus.blocks_of(words_of[place]), len(blocks))
        logits = teacher_logits(model, corpus, blocks, labels[blocks], words)
        right = torch.as_tensor(labels[blocks[1:]])
        accuracy.append(100 * float((logits.argmax(-1) == right).float().mean()))
        chances = torch.softmax(logits / temperature, -1).gather(-1, right[..., None])
        sampled.append(100 * float(chances.mean()))
        nll.append(float(torch.nn.functional.cross_entropy(logits, right)))
    return {"accuracy": np.array(accuracy), "sampled": np.array(sampled), "nll": np.array(nll)}


def another(recordings: Sequence[int], on: int = 1) -> list[int]:
    """For each recording the one that is `on` places further, so that nobody reads their own; ValueError for one alone
    or for a whole turn."""
    if on % max(len(recordings), 1) == 0:
        raise ValueError("a wrong text takes two recordings with words")
    return [recordings[(place + on) % len(recordings)] for place in range(len(recordings))]


def wrongly_read(model: LstmInterpreter, corpus: Corpus, labels: Lexemes, recordings: Sequence[int],
                 temperature: float = 1.0, most: int = WRONG_TEXTS) -> Scores:
    """As `teacher_forced`, the mean over up to `most` wrong texts."""
    turns = range(1, max(2, min(most + 1, len(recordings))))
    every = [teacher_forced(model, corpus, labels, recordings, another(recordings, on), temperature) for on in turns]
    return {key: np.mean([scores[key] for scores in every], axis=0) for key in every[0]}


def table(title: str, rows: Mapping[str, Scores], pairs: Sequence[tuple[str, str]], sizes: Sequence[int]) -> Table:
    """Intervals of each row and of the paired differences (first minus second); sizes: blocks of each recording."""
    body: dict[str, dict[str, Cell]] = {
        name: {key: stats.mean_interval(values, sizes) for key, values in scores.items()}
        for name, scores in rows.items()}
    body |= {f"{a} - {b}": {key: stats.paired(rows[a][key], rows[b][key], sizes) for key in rows[a]} for a, b in pairs}
    return Table(title, COLUMNS, body, "interpreter")


def _on_mel(context: EvalContext) -> tuple[LstmInterpreter, Corpus]:
    bundle = context.bundle
    # The same silent lexemes as the bundle's, by hand or found, so that both rows are taught the same labels.
    config = configs.with_settings(bundle.config, [*_MEL, f"silence.lexemes={bundle.silent.tolist()}"])
    run = Run(config, context.store, context.work, progress=context.progress, workers=os.cpu_count() or 1)
    lexicon = bundle.block_models.lexicon
    for node in (LEXICON, TOKENS):
        run.provide(node, lexicon, weights_hash(lexicon))
    return run.get(INTERPRETER), run.get(CORPUS)
