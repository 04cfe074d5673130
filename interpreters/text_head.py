"""A head that adds scores from the words to those of an audio-only lexeme interpreter.

Four hours of speech have too few words to train one network on audio and text: the audio dominates. The audio-only
interpreter is therefore trained first, and this head learns the remainder. It has no state; its inputs are the words of
three blocks, the previous lexeme and the speaker.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from interpreters.settings import HALF_BLOCKS


class TextHead(nn.Module):
    """Word vectors of three blocks, the previous lexeme and the speaker to additional scores [..., S]. Features of the
    words are gated by the previous lexeme and the speaker."""

    def __init__(self, text_width: int, width: int, bottleneck: int, lexeme_width: int, speakers: int, size: int,
                 dropout: float = 0.5) -> None:
        """text_width: d_t + 1; width: of the hidden layer; bottleneck: width of a projection of word vectors; size: S.
        The initial output is 0."""
        super().__init__()
        self.dropout = nn.Dropout(dropout)
        self.narrow = nn.Linear(text_width, bottleneck)
        self.hidden = nn.Linear(HALF_BLOCKS * bottleneck, width)
        self.weigh = nn.Linear(lexeme_width + speakers, width)
        self.out = nn.Linear(width, size)
        # Training starts from the scores of the audio-only interpreter.
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(self, text: Tensor, previous: Tensor, speaker: Tensor) -> Tensor:
        """[B, N, S] from text [B, N, 3K, d_t + 1], vectors of the previous lexemes [B, N, D] and speaker one-hot
        [B, speakers]."""
        # Averages over half blocks: where in a block a word begins is uncertain by a few frames anyway.
        rows = text.flatten(0, 1).transpose(1, 2)
        parts = functional.adaptive_avg_pool1d(rows, HALF_BLOCKS).transpose(1, 2).unflatten(0, text.shape[:2])
        words = functional.gelu(self.hidden(self.dropout(self.narrow(self.dropout(parts)).flatten(-2))))
        speakers = speaker[:, None].expand(-1, previous.shape[1], -1)
        # The gate depends on who speaks and on what the hands do, not on the words: it weighs features of words.
        weight = torch.sigmoid(self.weigh(torch.cat([previous, speakers], dim=-1)))
        scores: Tensor = self.out(self.dropout(words) * weight)
        return scores
