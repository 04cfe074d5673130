"""The runner of the lexeme interpreter (`interpreters.lstm`), with and without words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from data_module import layers_run as layers
from data_module.layers_run import BlockDense, Floats, gelu, side_by_side
from interpreters import base
from interpreters.base import BlockFeatures, InterpreterByEar, Need, Scores
from interpreters.settings import HALF_BLOCKS, LstmConfig

__all__ = ["LstmRunner"]


@dataclass(frozen=True)
class LstmRunState:
    """The state of the LSTM (with limited memory, the rows [1, m, n, W] of the last blocks) and the speaker [P],
    one-hot."""

    hidden: tuple[Floats, Floats] | None
    speaker: Floats
    rows: Floats | None = None


class LstmRunner(base.InterpreterDefaults):
    """P_s: previous lexeme, three blocks of high-level audio, text and the speaker to scores over the lexicon."""

    name = "lstm"

    def __init__(self, config: LstmConfig, sizes: base.InterpreterSizes, tensors: layers.Tensors) -> None:
        self.config, self._sizes, frames, size = config, sizes, sizes.frames, len(sizes.lexemes)
        vectors = tensors.take("lexemes", *sizes.lexemes.shape)
        self._encode_audio = BlockDense(tensors.within("encode_audio"), frames, sizes.high, config.audio_features,
                                        bottleneck=config.audio_bottleneck)
        self._encode_text = BlockDense(tensors.within("encode_text"), frames, sizes.text, config.text_features,
                                       blocks=1, bottleneck=config.text_bottleneck) if config.text_features else None
        self._encode_pose = tensors.dense("encode_pose", 3 * sizes.motion, config.pose_features
                                          ) if config.pose_features else None
        self._vectors = tensors.take("learned.weight", size, config.lexeme_features
                                     ) if config.lexeme_features else vectors
        self._text_head = _TextHead(config, sizes, self._vectors.shape[1], tensors.within("text_head")
                                    ) if config.text_head else None
        self._control_width = sizes.control if config.use_control else 0
        self._by_block = config.reads_by == "block"
        count = frames if self._by_block else 1
        width = count * (config.audio_features + config.text_features + self._control_width) + self._vectors.shape[1]
        width += config.pose_features + (sizes.speakers if config.use_speaker else 0)
        self._enter = tensors.dense("enter", width, config.width) if self._by_block else None
        self._lstm = layers.Lstm(tensors.within("lstm"), config.width if self._by_block else width, config.width)
        self._classify = tensors.dense("classify", (2 if self._by_block else 1) * config.width, size)

    @property
    def needs(self) -> frozenset[Need]:
        reads: dict[Need, bool] = {"text": self.config.reads, "control": bool(self._control_width),
                                   "pose": self._encode_pose is not None, "durations": self._encode_pose is not None}
        return frozenset(need for need, needed in reads.items() if needed)

    def guided(self, guidance: float) -> LstmRunner | InterpreterByEar:
        return InterpreterByEar(self, guidance) if guidance and self.config.audio_dropout > 0 else self

    def start(self, speaker: int, first_lexeme: int) -> LstmRunState:
        return LstmRunState(None, np.eye(self._sizes.speakers, dtype=np.float32)[speaker])

    def step(self, state: LstmRunState, features: BlockFeatures, previous_lexeme: int) -> tuple[Scores, LstmRunState]:
        return self._steps([state], features.high[None], features, previous_lexeme)[0]

    def step_with_and_without_sound(self, states: tuple[LstmRunState, LstmRunState], features: BlockFeatures,
                                    previous_lexeme: int) -> list[tuple[Scores, LstmRunState]]:
        """The result of `step` for the first state, and for the second with zeros as audio."""
        audio = np.stack([features.high, np.zeros_like(features.high)])
        return self._steps(states, audio, features, previous_lexeme)

    def _steps(self, states: Sequence[LstmRunState], audio: Floats, features: BlockFeatures, previous_lexeme: int
               ) -> list[tuple[Scores, LstmRunState]]:
        """`step` for B states of equal age, with separate audio [B, 3K, d] and all else the same."""
        rows, memory, hidden = self._rows(states[0].speaker, audio, features, previous_lexeme), self.config.memory, None
        if memory:
            # With limited memory the state is the input rows themselves: the LSTM reads them again from a zero state at
            # every block, as in training.
            before = [state.rows for state in states if state.rows is not None]
            rows = (np.concatenate([np.concatenate(before), rows], 1) if before else rows)[:, -memory:]
        else:
            known = [state.hidden for state in states if state.hidden is not None]
            hidden = (np.concatenate([h for h, _ in known], 1), np.concatenate([c for _, c in known], 1)
                      ) if known else None
        out, (h, c) = self._lstm(rows.reshape(len(rows), -1, rows.shape[-1]), hidden)
        last = np.concatenate([out[:, -1], rows[:, -1, -1]], -1) if self._by_block else out[:, -1]
        logits = self._classify(last)
        if self._text_head is not None:
            assert features.text is not None
            logits = logits + self._text_head(features.text, self._vectors[previous_lexeme], states[0].speaker)
        scores = layers.log_softmax(logits.astype(np.float64))
        return [(scores[i], LstmRunState(None, state.speaker, rows[i:i + 1]) if memory else
                 LstmRunState((h[:, i:i + 1], c[:, i:i + 1]), state.speaker)) for i, state in enumerate(states)]

    def _rows(self, speaker: Floats, audio: Floats, features: BlockFeatures, previous_lexeme: int) -> Floats:
        """[B, 1, n, W] the input rows of the LSTM: n = K, or 1 if it reads by block. ValueError without needed text or
        pose."""
        if self.config.reads and features.text is None:
            raise ValueError("this interpreter needs text; use the audio-only one")
        frames = self._sizes.frames
        parts = [self._encode_audio(audio), self._vectors[previous_lexeme][None]]  # of frames, or of the block
        if self._encode_text is not None and features.text is not None:
            parts.append(self._encode_text(features.text))
        if self._control_width:
            # Zeros are targets of value 0 whose flag says that they are not set.
            parts.append(np.zeros((frames, self._control_width), np.float32) if features.control is None
                         else features.control)
        if self.config.use_speaker:
            parts.append(speaker[None])
        if self._encode_pose is not None:
            if features.past is None:
                raise ValueError("this interpreter needs the pose; give it the previous block")
            parts.append(gelu(self._encode_pose(np.concatenate(base.pose_of(features.past, features.durations))))[None])
        if self._enter is None:
            return side_by_side(parts)[:, None]
        row = side_by_side([parts[0].reshape(len(audio), -1), *(part.ravel() for part in parts[1:])])
        return gelu(self._enter(row))[:, None, None]


class _TextHead:
    """The scores from the words (`interpreters.text_head.TextHead`)."""

    def __init__(self, config: LstmConfig, sizes: base.InterpreterSizes, lexeme_width: int, tensors: layers.Tensors
                 ) -> None:
        bottleneck, width = config.text_bottleneck or sizes.text, config.text_head
        self._narrow, self._hidden, self._weigh, self._out = (
            tensors.dense(name, width_in, out) for name, width_in, out in (
                ("narrow", sizes.text, bottleneck), ("hidden", HALF_BLOCKS * bottleneck, width),
                ("weigh", lexeme_width + sizes.speakers, width), ("out", width, len(sizes.lexemes))))

    def __call__(self, text: Floats, previous: Floats, speaker: Floats) -> Floats:
        """[S] from text [3K, d_t + 1], the vector of the previous lexeme [D] and the speaker [P], one-hot."""
        # Part i of 6 is the mean of the rows that it touches, from floor(i T / 6) to ceil((i + 1) T / 6).
        count = len(text)
        parts = [text[i * count // HALF_BLOCKS:-(-(i + 1) * count // HALF_BLOCKS)].mean(0) for i in range(HALF_BLOCKS)]
        words = gelu(self._hidden(self._narrow(np.stack(parts)).ravel()))
        return self._out(words * layers.sigmoid(self._weigh(np.concatenate([previous, speaker]))))
