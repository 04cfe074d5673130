"""What a lexeme interpreter gives on a recording when everything before each block is as it was performed."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from gesticulator.stages import Corpus
from interpreters.lstm import LstmInterpreter
from interpreters.pose import pose_of

Numbers = NDArray[np.int64]


@torch.inference_mode()
def teacher_logits(model: LstmInterpreter, corpus: Corpus, blocks: Numbers, lexemes: Numbers,
                   words: Numbers | None = None) -> Tensor:
    """[M - 1, S] scores of blocks [M] of a recording but the first, after lexemes [M] and the performer's motion.

    words: block numbers [M] whose words are read; those of the blocks themselves where None.
    """
    own, previous = torch.as_tensor(blocks[1:]), torch.as_tensor(lexemes[:-1])[None]
    text = corpus.text((blocks if words is None else words)[1:])[None] if model.config.reads else None
    pose = pose_of(*corpus.before(blocks[1:]))[None] if model.config.pose_features else None
    who = torch.tensor([int(corpus.speaker_of[corpus.recording[blocks[0]]])])
    speaker = functional.one_hot(who, model.speakers).float()
    logits, _ = model.scores(previous, corpus.high[own].float()[None], speaker, None, text, pose=pose)
    return logits[0]
