"""The paper's generator on arrays: one block after the other (RG 5.2, Eq. 15). `generator.model` trains it."""

import numpy as np

from data_module.layers_run import BlockDense, Convolutions, Floats, Lstm, Tensors, leaky_relu, side_by_side
from generator.settings import GROUP_WIDTH, GeneratorConfig, GeneratorWidths, positional_block

__all__ = ["GeneratorRunner"]

State = tuple[Floats, Floats]
"""Hidden and cell state of the decoder, [layers, 1, width] each."""


class GeneratorRunner:
    """G, E_M and E_A. Motion is in the lexicon's normalised features, [K, D_m]."""

    def __init__(self, config: GeneratorConfig, widths: GeneratorWidths, present: Floats, tensors: Tensors) -> None:
        """present: [D_m] 1 for the dimensions in the data; the output of the others is 0."""
        c, frames = config, widths.frames
        self._config, self._frames, self._present = config, frames, present
        self._encode_motion = Convolutions(tensors.within("encode_motion"),
                                           (widths.motion, *[c.motion_features] * 3), norm=False)
        self.encode_audio = BlockDense(tensors.within("encode_audio"), frames, widths.audio, c.audio_features,
                                        bottleneck=c.audio_bottleneck)
        self._position = positional_block(frames, c.position_width)
        self._fade = (np.arange(frames - 1, -1, -1, dtype=np.float32) / frames)[:, None]
        self._control_width = widths.control if c.use_control else 0
        width = c.motion_features + c.audio_features + widths.lexeme + c.style_width + c.position_width
        self._mlp = [tensors.dense("mlp.0", width + self._control_width, c.hidden),
                     tensors.dense("mlp.2", c.hidden, c.hidden)]
        self._logits = tensors.dense("codes.logits", c.hidden, c.groups * c.classes)
        self._vectors = tensors.take("codes.vectors", c.groups, c.classes, GROUP_WIDTH)
        self._lstm = Lstm(tensors.within("lstm"), c.groups * GROUP_WIDTH, c.lstm_width, c.lstm_layers)
        self._to_motion = tensors.dense("to_motion", c.lstm_width, widths.motion)
        self._start = [tensors.dense("start.0", widths.motion + widths.lexeme, c.hidden),
                       tensors.dense("start.2", c.hidden, 2 * c.lstm_layers * c.lstm_width)]

    def start(self, pose: Floats, lexeme: Floats) -> State:
        """The decoder's state before the first block, from the seed pose [D_m] and the first lexeme [D_s]."""
        first, second = self._start
        both = second(leaky_relu(first(np.concatenate([pose, lexeme]))))
        hidden, cell = both.reshape(2, self._config.lstm_layers, 1, -1)
        # The hidden state of an LSTM lies between -1 and 1, its cell state has no bounds.
        return np.tanh(hidden), cell

    def step(self, past: Floats, audio: Floats, lexeme: Floats, style: Floats, state: State,
             control: Floats | None = None) -> tuple[Floats, State]:
        """One block [K, D_m] and the state after it (RG Eq. 15). past: [K, D_m] the previous block; audio: [K,
        audio_features], `encode_audio` of the window [3K, d]; lexeme: [D_s]; style: [d_z]; control: [K, 2 F], None
        without."""
        parts = [self._encode_motion(past), audio, lexeme[None], style[None], self._position]
        if self._control_width:
            free = np.zeros((self._frames, self._control_width), np.float32)
            parts.append(free if control is None else control)
        hidden = side_by_side(parts)
        for dense in self._mlp:
            hidden = leaky_relu(dense(hidden))
        # The best class of each group, and the vectors behind them (RG 5.2).
        groups = np.arange(self._config.groups)
        choice = self._logits(hidden).reshape(self._frames, len(groups), -1).argmax(-1)
        hidden, state = self._lstm(self._vectors[groups, choice].reshape(1, self._frames, -1), state)
        # The last pose fades over the block. It closes the seams and cannot drift: every block ends on the output of
        # the network.
        return (self._to_motion(hidden[0]) + self._fade * past[-1]) * self._present, state
