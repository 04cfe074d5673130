"""The corpus with the audio features of the trained speech encoder."""

from __future__ import annotations

from gesticulator.training.stages.base import Node, Run
from gesticulator.training.stages.corpus import BLOCKS, Corpus, prepare
from gesticulator.training.stages.speech import ENCODER


def _corpus(run: Run) -> Corpus:
    encoder = run.get(ENCODER)
    if encoder is None:
        return run.get(BLOCKS)
    return prepare(run.store, run.config, run.work, encoder, workers=run.workers, progress=run.progress,
                   memory=run.memory)


CORPUS: Node[Corpus] = Node("corpus", settings=("front_end",), needs=lambda config: (BLOCKS, ENCODER), make=_corpus)
