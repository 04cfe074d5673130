"""The paper's style interpreter on arrays (RG 6.2, Eq. 19). `interpreters.lstm` trains it."""

from dataclasses import dataclass

import numpy as np

from data_module.layers_run import BlockDense, Floats, Lstm, Tensors, side_by_side
from interpreters.base import BlockFeatures, InterpreterSizes
from interpreters.settings import StyleConfig

__all__ = ["StyleRunner"]


@dataclass(frozen=True)
class StyleRunState:
    """The state of the LSTM, None before the first block, the last code [d_z] and the speaker's one-hot [P]."""

    hidden: tuple[Floats, Floats] | None
    code: Floats
    speaker: Floats


class StyleRunner:
    """P_z: previous code, lexeme, three blocks of low-level audio and text to the code of the block, [d_z]."""

    def __init__(self, config: StyleConfig, sizes: InterpreterSizes, code: int, tensors: Tensors) -> None:
        """code: d_z."""
        self._config, self._speakers, self._code, frames = config, sizes.speakers, code, sizes.frames
        self._lexemes = tensors.take("lexemes", *sizes.lexemes.shape)
        self._encode_audio = BlockDense(tensors.within("encode_audio"), frames, sizes.low, config.audio_features,
                                        bottleneck=config.audio_bottleneck)
        self._encode_text = None
        if config.text_features:
            self._encode_text = BlockDense(tensors.within("encode_text"), frames, sizes.text, config.text_features,
                                           blocks=1, bottleneck=config.text_bottleneck)
        width = config.audio_features + sizes.lexemes.shape[1] + code + config.text_features
        width += sizes.speakers if config.use_speaker else 0
        self._lstm = Lstm(tensors.within("lstm"), width, config.width)
        self._to_code = tensors.dense("to_code", config.width, code)

    def start(self, speaker: int) -> StyleRunState:
        speakers = np.eye(self._speakers, dtype=np.float32)
        return StyleRunState(None, np.zeros(self._code, np.float32), speakers[speaker])

    def step(self, state: StyleRunState, features: BlockFeatures, lexeme: int) -> tuple[Floats, StyleRunState]:
        """The code [d_z] of this block, and the state after it. ValueError without needed text."""
        rows = [self._encode_audio(features.low), self._lexemes[lexeme][None], state.code[None]]
        if self._encode_text is not None:
            if features.text is None:
                raise ValueError("this interpreter needs text; use the audio-only one")
            rows.append(self._encode_text(features.text))
        if self._config.use_speaker:
            rows.append(state.speaker[None])
        out, hidden = self._lstm(side_by_side(rows)[None], state.hidden)
        code = self._to_code(out[0, -1])
        return code, StyleRunState(hidden, code, state.speaker)
