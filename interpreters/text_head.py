"""A head that reads the words beside a lexeme interpreter and adds to its scores.

Four hours of speech hold too few words to learn hearing and reading in one network: what the words say drowns in what
the voice says. So the voice speaks first, and this head learns only what the voice leaves open. It has no memory: the
words of three blocks, the previous lexeme and the speaker are all that it sees.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

_PARTS = 6
"""The words of three blocks are averaged over half blocks: a gesture sets out before its word and outlasts it."""


class TextHead(nn.Module):
    """Word vectors of three blocks, the previous lexeme and the speaker to what is added to the scores [..., S].

    What the words ask for is weighed by what the hands do now and whose hands they are.
    """

    def __init__(self, text_width: int, width: int, bottleneck: int, lexeme_width: int, speakers: int, size: int,
                 dropout: float = 0.5) -> None:
        """text_width: d_t + 1; width: of the hidden layer; bottleneck: width that a word vector is brought to; size:
        S. At first nothing is added."""
        super().__init__()
        self.dropout = nn.Dropout(dropout)
        self.narrow = nn.Linear(text_width, bottleneck)
        self.hidden = nn.Linear(_PARTS * bottleneck, width)
        self.weigh = nn.Linear(lexeme_width + speakers, width)
        self.out = nn.Linear(width, size)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(self, text: Tensor, previous: Tensor, speaker: Tensor) -> Tensor:
        """[B, N, S] from text [B, N, 3K, d_t + 1], vectors of the previous lexemes [B, N, D] and speaker one-hot
        [B, speakers]."""
        rows = text.flatten(0, 1).transpose(1, 2)
        parts = functional.adaptive_avg_pool1d(rows, _PARTS).transpose(1, 2).unflatten(0, text.shape[:2])
        said = functional.gelu(self.hidden(self.dropout(self.narrow(self.dropout(parts)).flatten(-2))))
        whose = speaker[:, None].expand(-1, previous.shape[1], -1)
        weight = torch.sigmoid(self.weigh(torch.cat([previous, whose], dim=-1)))
        added: Tensor = self.out(self.dropout(said) * weight)
        return added
