"""RACER's Q-network on arrays: one decision after the other, with a cache (RACER 4.3, Eq. 12).

`interpreters.cql` trains the network; here its weights are played, without torch.
"""

from dataclasses import dataclass

import numpy as np

from data_module.layers_run import BlockDense, Floats, Norm, Tensors, attention, gelu
from interpreters.base import BlockFeatures, InterpreterDefaults, InterpreterSizes, Need, Scores
from interpreters.settings import QConfig

__all__ = ["LiteralQRunner", "QRunState", "QRunner"]

KeysAndValues = tuple[Floats, Floats]
"""Cached keys and values [tokens, C] of a layer."""


@dataclass(frozen=True)
class QRunState:
    """The pairs that the next decision attends to, and the speaker's one-hot [P]. Never changed in place.

    tokens: [2, n, C] audio and action tokens of the last n <= T decisions, without positions. past: keys and values of
    these tokens, layer by layer; None once the window slides.
    """

    speaker: Floats
    tokens: Floats
    past: tuple[KeysAndValues, ...] | None


class TwoStreamLayer:
    """x + attention(norm(x)), then x + feed-forward(norm(x))."""

    def __init__(self, tensors: Tensors, width: int, heads: int) -> None:
        self._heads = heads
        self._before_attention = Norm(tensors.within("before_attention"), width)
        self._project = tensors.dense("attention.project", width, 3 * width)
        self._out = tensors.dense("attention.out", width, width)
        self._before_feed = Norm(tensors.within("before_feed"), width)
        self._widen = tensors.dense("feed.0", width, 4 * width)
        self._narrow = tensors.dense("feed.2", 4 * width, width)

    def __call__(self, x: Floats, past: KeysAndValues | None, mask: Floats | None) -> tuple[Floats, KeysAndValues]:
        """[n, C] of tokens [n, C], and the keys and values of the `past` and these tokens."""
        query, key, value = np.split(self._project(self._before_attention(x)), 3, axis=-1)
        if past is not None:
            # Positions are in the tokens, so the order of the cache does not matter.
            key, value = np.concatenate([past[0], key]), np.concatenate([past[1], value])
        x = x + self._out(attention(query, key, value, self._heads, mask))
        return x + self._narrow(gelu(self._widen(self._before_feed(x)))), (key, value)


class QTrunk:
    """The transformer over audio and actions, up to the features of a decision."""

    def __init__(self, config: QConfig, sizes: InterpreterSizes, tensors: Tensors) -> None:
        width, speakers, frames = config.width, sizes.speakers, sizes.frames
        self._window, self._width, self._speakers = config.decisions, width, speakers
        self._use_speaker = config.use_speaker
        self._encode = BlockDense(tensors.within("encode_audio"), frames, sizes.high, config.audio_features,
                                  blocks=config.audio_blocks, bottleneck=config.audio_bottleneck)
        # One more input than audio and speaker: whether the block is silent.
        row = frames * config.audio_features + (speakers if config.use_speaker else 0) + 1
        self._audio_token = tensors.dense("audio_token", row, width)
        self._action_token = tensors.take("action_token.weight", len(sizes.lexemes), width)
        self._positions = tensors.take("positions", 2, config.decisions, width)
        self._layers = [TwoStreamLayer(tensors.within(f"layers.{number}"), width, config.heads)
                        for number in range(config.layers)]

    def start(self, speaker: int) -> QRunState:
        speakers = np.eye(self._speakers, dtype=np.float32)
        return QRunState(speakers[speaker], np.zeros((2, 0, self._width), np.float32), None)

    def step(self, state: QRunState, features: BlockFeatures, previous_lexeme: int) -> tuple[Floats, QRunState]:
        """[C] features of this block's decision, and the state after it."""
        parts = [self._encode(features.high).ravel(), np.array([features.silent], np.float32)]
        parts += [state.speaker] if self._use_speaker else []
        pair = np.stack([self._audio_token(np.concatenate(parts)), self._action_token[previous_lexeme]])[:, None]
        filled = state.tokens.shape[1]
        tokens = np.concatenate([state.tokens, pair], axis=1)[:, -self._window:]
        # Positions count from the start of the window. Once it slides, every token moves to another position, and
        # cached keys and values no longer hold.
        resumes = state.past is not None and filled < self._window
        new, first = (pair, filled) if resumes else (tokens, 0)
        count = new.shape[1]
        x = (new + self._positions[:, first:first + count]).reshape(2 * count, -1)
        # The next pair sees all before it; of a whole window each token sees those of its time and before (Eq. 12).
        mask = None if resumes else np.tile(np.triu(np.full((count, count), -np.inf, np.float32), 1), (2, 2))
        present = []
        for number, layer in enumerate(self._layers):
            x, keys_and_values = layer(x, state.past[number] if resumes and state.past else None, mask)
            present.append(keys_and_values)
        # A full window slides at the next step, which could not use the cache.
        keep = tuple(present) if tokens.shape[1] < self._window else None
        return x[-1], QRunState(state.speaker, tokens, keep)


class QRunner(InterpreterDefaults):
    """Q(s_i, .) over the lexicon for each decision i."""

    name = "cql"
    gives_values = True
    needs: frozenset[Need] = frozenset()

    def __init__(self, config: QConfig, sizes: InterpreterSizes, tensors: Tensors) -> None:
        self._trunk = QTrunk(config, sizes, tensors)
        self._norm = Norm(tensors.within("head.0"), config.width)
        self._values = tensors.dense("head.1", config.width, len(sizes.lexemes))

    def start(self, speaker: int, first_lexeme: int) -> QRunState:
        """The state before the first block; `first_lexeme`, a_0, is the previous lexeme in the first `step`."""
        return self._trunk.start(speaker)

    def step(self, state: QRunState, features: BlockFeatures, previous_lexeme: int) -> tuple[Scores, QRunState]:
        """Q values [S] of this block's lexeme, and the state after it. The silent mask is applied by the caller."""
        row, after = self._trunk.step(state, features, previous_lexeme)
        return self._values(self._norm(row)).astype(np.float64), after


class LiteralQRunner(QRunner):
    """The Q-network as published: trained on recorded lexemes only, and the lexeme of the highest value is taken."""

    name = "cql-literal"
