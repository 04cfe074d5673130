"""The runner of the activity gate (`interpreters.gate`)."""

from dataclasses import dataclass

import numpy as np

from data_module.layers_run import BlockDense, Floats, Lstm, Tensors, side_by_side
from interpreters.base import BlockFeatures
from interpreters.settings import GateConfig

__all__ = ["GateRunner"]


@dataclass(frozen=True)
class GateState:
    """The LSTM's state and the speaker [P], one-hot."""

    hidden: tuple[Floats, Floats] | None
    speaker: Floats


class GateRunner:
    """Three blocks of low-level audio and the speaker to the probability that the block holds a gesture."""

    def __init__(self, config: GateConfig, frames: int, audio_width: int, speakers: int, tensors: Tensors) -> None:
        """Arguments as of `ActivityGate`."""
        self._speakers = speakers
        self._encode_audio = BlockDense(tensors.within("encode_audio"), frames, audio_width, config.audio_features,
                                        bottleneck=config.audio_bottleneck)
        self._lstm = Lstm(tensors.within("lstm"), config.audio_features + speakers, config.width)
        self._classify = tensors.dense("classify", config.width, 1)

    def start(self, speaker: int) -> GateState:
        return GateState(None, np.eye(self._speakers, dtype=np.float32)[speaker])

    def step(self, state: GateState, features: BlockFeatures) -> tuple[float, GateState]:
        """The probability of a gesture in the next block, and the state after it."""
        rows = side_by_side([self._encode_audio(features.low), state.speaker])
        out, hidden = self._lstm(rows[None], state.hidden)
        # In doubles, so that a probability near 1 still differs from 1.
        logit = float(self._classify(out[0, -1])[0])
        return float(0.5 + 0.5 * np.tanh(0.5 * logit)), GateState(hidden, state.speaker)
