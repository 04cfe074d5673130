"""The runner of the flow generator (`generator.flow`), and the place of a block in speech."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module import layers_run as layers
from data_module.layers_run import Floats
from data_module.motion.movement_run import PAST, BasisRunner, state_before
from generator.settings import BLEND, GROUP_WIDTH, GeneratorConfig, GeneratorWidths, positional_block

__all__ = ["Circumstances", "FlowConditions", "FlowRunner", "alone"]

CIRCUMSTANCES = 8
"""Numbers that describe a block's place in speech: see `Circumstances.step`."""
LAYERS = 3
"""Residual blocks of the head."""
FREQUENCIES = 8
"""F, frequencies of the sines and cosines that tell the head the time t."""
MOST = 8.0
"""Largest argument of sinh, beyond any coefficient in the data."""
_TEMPO = 0.3
"""Typical duration of a block, seconds."""


@dataclass(frozen=True)
class Circumstances:
    """How long the silence, or the speech, has lasted before a block, in blocks."""

    quiet: int = 0
    speech: int = 0

    def step(self, durations: Sequence[float], silent: Sequence[bool]) -> tuple[Floats, Circumstances]:
        """[8] the place of a block in speech, from the previous, current and next block (durations in s, silent or
        not): the logarithms of the durations over 0.3 s; whether each is silent; log(1 + n) of the n blocks that the
        silence, and the speech, have lasted. And the state after the block."""
        quiet, speech = (self.quiet + 1, 0) if silent[1] else (0, self.speech + 1)
        # In single precision, as the durations in the training data.
        logs = [math.log(np.float32(np.float32(seconds) / np.float32(_TEMPO))) for seconds in durations]
        place = np.array([*logs, *map(float, silent), math.log1p(quiet), math.log1p(speech) / 3], np.float32)
        return place, Circumstances(quiet, speech)


@dataclass(frozen=True)
class FlowConditions:
    """The inputs of one block under B conditions, of which each leaves something out. audio: [3K, d]; without_audio:
    [B]; lexeme: [B] (S for none); before: [K, D_m] the previous block, with the ratio of durations []; added: [n] u of
    the previous block; place: [8]; speaker: [P] one-hot; control: [B, K, 2 F], unit: [B, U] and style: [B, d_z], None
    without."""

    audio: Floats
    without_audio: NDArray[np.bool_]
    lexeme: NDArray[np.int64]
    before: Floats
    ratio: Floats
    added: Floats
    place: Floats
    speaker: Floats
    control: Floats | None = None
    unit: Floats | None = None
    style: Floats | None = None


class FlowRunner:
    """`FlowGenerator` in evaluation: `contexts` of a block, and samples of it (`sample`)."""

    def __init__(self, config: GeneratorConfig, widths: GeneratorWidths, present: Floats, basis: BasisRunner,
                 tensors: layers.Tensors) -> None:
        """present: [D_m] 1 for the dimensions in the data."""
        c, frames = config, widths.frames
        self.config, self.frames, self.lexemes, self.present = config, frames, widths.lexemes, present
        self.basis = basis
        self._position, n = positional_block(frames, c.position_width), self.basis.width
        self._deviation = tensors.take("deviation", n)
        self._centres = tensors.take("centres", widths.lexemes + 1, n)
        self._control_width = widths.control if c.use_control else 0
        self.unit_width, self._style_width = widths.units if c.units else 0, c.style_width
        self._encode_motion = layers.Convolutions(tensors.within("encode_motion"),
                                           (widths.motion, *[c.motion_features] * 3), norm=False)
        self._encode_audio = layers.BlockDense(tensors.within("encode_audio"), frames, widths.audio, c.audio_features,
                                        bottleneck=c.audio_bottleneck)
        self._bypassed = c.hears_through == "both"
        self._hear = tensors.dense("hear.0", frames * c.audio_features, c.lexeme_width) if self._bypassed else None
        self._unheard = tensors.take("unheard", frames, c.audio_features)
        self._name = tensors.take("name.weight", widths.lexemes + 1, c.lexeme_width)
        rows = c.motion_features + c.audio_features + c.lexeme_width + c.position_width + self._control_width
        self._mlp = tensors.dense("mlp.0", rows, c.hidden)
        self._classes = tensors.dense("codes.logits", c.hidden, c.groups * c.classes)
        self._vectors = tensors.take("codes.vectors", c.groups, c.classes, GROUP_WIDTH)
        beside = c.lexeme_width if self._bypassed else 0
        known = 2 * beside + c.groups * GROUP_WIDTH + 3 * widths.motion + n + CIRCUMSTANCES + widths.speakers
        self._gather = tensors.dense("gather.0", known + self._control_width + self.unit_width
                                + self._style_width, c.context)
        self._lstm = layers.Lstm(tensors.within("lstm"), c.context, c.context, c.lstm_layers)
        self._to_context = tensors.dense("to_context.0", 2 * c.context + beside, c.context)
        self._head = _Head(tensors.within("head"), n, c.context + (n if self._bypassed else 0), c.flow_width)

    def squeeze(self, coefficients: Floats) -> Floats:
        """y [..., n] to u = asinh(b y / sd) / sd_u."""
        return np.arcsinh(self.config.bend * coefficients / self.basis.scale) / self._deviation

    def stretch(self, squeezed: Floats) -> Floats:
        """The inverse of `squeeze`, clipped to the range of the training data."""
        y = np.sinh(np.clip(squeezed * self._deviation, -MOST, MOST)) / self.config.bend * self.basis.scale
        return np.clip(y, *self.basis.limits)

    def contexts(self, given: FlowConditions, state: tuple[Floats, Floats] | None = None
                 ) -> tuple[Floats, tuple[Floats, Floats]]:
        """h [B, C + n] of the block under each condition (C, if audio and lexeme have no way past the code) and the
        LSTM's state after it."""
        count = len(given.lexeme)
        audio = np.where(given.without_audio[:, None, None], self._unheard, self._encode_audio(given.audio))
        name = self._name[given.lexeme]
        rows = [self._encode_motion(given.before), audio, name[:, None], self._position]
        pose, velocity, acceleration = state_before(given.before[-PAST:], given.ratio)
        beside = [] if self._hear is None else [layers.gelu(self._hear(audio.reshape(count, -1))), name]
        known = [*beside, pose, 4.0 * velocity, 6.0 * acceleration, given.added, given.place, given.speaker]
        if self._control_width:
            rows.append(np.zeros((self.frames, self._control_width), np.float32) if given.control is None
                        else given.control)
            known.append(rows[-1].mean(-2) if given.control is not None else rows[-1][0])
        for width, row in ((self.unit_width, given.unit), (self._style_width, given.style)):
            known.append(np.zeros(width, np.float32) if row is None else row)
        gathered = layers.gelu(self._gather(layers.side_by_side([*known, self._code(layers.side_by_side(rows))])))
        out, state = self._lstm(gathered[:, None], state)
        context = layers.gelu(self._to_context(layers.side_by_side([out[:, 0], gathered, *beside[1:]])))
        return (layers.side_by_side([context, self._centres[given.lexeme]]) if self._bypassed else context), state

    def _code(self, rows: Floats) -> Floats:
        """[B, H * 8] the vectors of the blended classes (`GumbelCodes.best`), mean over the frames of rows [B, K, W].
        """
        groups, classes, width = self._vectors.shape
        logits = self._classes(layers.leaky_relu(self._mlp(rows))).reshape(*rows.shape[:2], groups, classes)
        shares = layers.softmax(logits / BLEND).mean(1)
        return (shares.swapaxes(0, 1) @ self._vectors).swapaxes(0, 1).reshape(len(rows), groups * width)

    def sample(self, contexts: Floats, gains: Floats, noise: Floats, steps: int, shared: bool = False) -> Floats:
        """Coefficients [M, n] from noise [M, n] by `steps` steps of the Adams method of second order. contexts: [1 + G,
        C] with all inputs, and with one input left out each; gains: [G, n] of the classifier-free guidance away from
        the latter. shared: add the guidance of the first row to every row, which is enough for rows that differ little
        and costs M + G predictions instead of M (1 + G).

        A step from u to u' is predicted by Adams and Bashforth, u + d (3 v - v_before) / 2 (the first one by Euler, u +
        d v), and corrected by Adams and Moulton, u' = u + d (v + v') / 2, where v' is taken at the predicted u'. One
        evaluation a step and one more: four steps of Heun's method take eight, and their error is not smaller than that
        of five of these, which take six."""
        rows = len(noise)
        guided = 1 if shared else rows
        # Row -> context: every sample with all inputs, then the guided rows once for each left-out input.
        of = np.repeat(np.arange(len(contexts)), [rows, *[guided] * (len(contexts) - 1)])
        conditions = self._head.conditions(contexts, of)
        u, step, before = noise, 1.0 / steps, None
        v = self._head(u, 0.0, conditions, gains, guided)
        for i in range(1, steps + 1):
            predicted = u + step * (v if before is None else (np.float32(3.0) * v - before) / np.float32(2.0))
            after = self._head(predicted, i * step, conditions, gains, guided)
            u, before, v = u + step * (v + after) / np.float32(2.0), v, after
        return self.stretch(u)


class _Head:
    """v of a `FlowHead` with guidance. Work shared by the contexts is done once, and the part that depends on time
    alone is a cached bias."""

    def __init__(self, tensors: layers.Tensors, width: int, context: int, hidden: int) -> None:
        weight = tensors.take("enter.weight", hidden, width + 2 * FREQUENCIES)
        self._enter, self._waves = layers.Dense(weight[:, :width]), weight[:, width:]
        self._bias, self._hidden = tensors.take("enter.bias", hidden), hidden
        self._condition, self._inner, self._outer = (
            [tensors.dense(f"{name}.{layer}", width_in, out) for layer in range(LAYERS)]
            for name, width_in, out in (("condition", context, 2 * hidden), ("inner", hidden, hidden),
                                        ("outer", hidden, hidden)))
        self._leave = tensors.dense("leave", hidden, width)
        self._times: dict[float, tuple[Floats, float, float]] = {}

    def conditions(self, contexts: Floats, of: NDArray[np.int64]) -> list[tuple[Floats, Floats]]:
        """Scale and shift [R, W] of every layer for R rows; of: [R] their contexts, among [B, C]."""
        both = (layer(contexts)[of] for layer in self._condition)
        return [(1 + each[:, :self._hidden], each[:, self._hidden:]) for each in both]

    def __call__(self, noisy: Floats, time: float, conditions: list[tuple[Floats, Floats]], gains: Floats,
                 guided: int) -> Floats:
        """[M, n] v of u [M, n] at a time between 0 and 1, guided: v + sum of gains * (v - v without an input).
        conditions: scale and shift of each layer, [M + G guided, W]: of the M rows with all inputs, then of the guided
        ones without the first input, and so on. gains: [G, n]."""
        bias, inverse, share = self._times.get(time) or self._at(time)
        rows, count = len(noisy), len(gains)
        # The input of the first layer is the same for all contexts.
        x = self._enter(noisy * inverse) + bias
        if count:
            x = np.concatenate([x, *[x[:guided]] * count])
        for (scale, shift), inner, outer in zip(conditions, self._inner, self._outer, strict=True):
            x = x + outer(layers.gelu(inner(layers.normed(x) * scale + shift)))
        end = self._leave(x)
        v = end[:rows]
        if count:
            v = v + (gains[:, None] * (end[:guided] - end[rows:].reshape(count, guided, -1))).sum(0)
        # The share of u is the same for all contexts.
        return v * inverse + noisy * share

    def _at(self, time: float) -> tuple[Floats, float, float]:
        """The constants of this time: bias of the first layer [W], 1 / sqrt(s), and (2 t - 1) / s."""
        angles, variance = time * rates(), time ** 2 + (1 - time) ** 2
        waves = np.concatenate([np.sin(angles), np.cos(angles)])
        constants = self._waves @ waves + self._bias, 1.0 / math.sqrt(variance), (2 * time - 1) / variance
        self._times[time] = constants
        return constants


def alone(place: Any) -> Any:
    """Circumstances [..., 8], an array or a tensor, with the current block in place of the next one."""
    return place[..., [0, 1, 1, 3, 4, 4, 6, 7]]


def rates() -> Floats:
    """[F] angular frequencies of the waves that tell the head the time."""
    return np.float32(1.5) * np.float32(2.0) ** (np.float32(0.5) * np.arange(FREQUENCIES, dtype=np.float32))
