"""Sampling of a block's motion: by the paper's generator with its style codes, or by the flow head with guidance and
candidates. The random numbers are keyed by seed, variation and media time.

No generator of random numbers runs along: each number is a function of its keys, so a file, a stream and an edited plan
sample alike, and so do two recordings that differ somewhere else. The numbers change gradually with time: with g_k
independent and standard normal, one for each 0.1 s of media time,

    z(t) = cos(a) g_k + sin(a) g_{k + 1},   k = floor(t / 0.1),   a = (t / 0.1 - k) pi / 2,

which is standard normal at every t, independent for blocks that begin 0.2 s or more apart, and nearly the same
(r = .99) for one that begins 10 ms later because a beat was detected later.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from math import cos, pi, sin
from typing import TYPE_CHECKING, NamedTuple, Protocol, cast, overload

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module.motion.movement import PAST, Pasts
from data_module.types import Array
from generator.flow import Circumstances, FlowGenerator, FlowInputs, alone
from gesticulator.body.life import normal
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.config import UNTOLD
from gesticulator.bundle.features import SpeechBlock
from gesticulator.drawing.candidates import CandidateChooser, CandidateMotion
from interpreters.base import BlockFeatures

if TYPE_CHECKING:
    from generator.model import Generator
    from interpreters.lstm import StyleInterpreter
    from interpreters.planner import UnitDecision, UnitStyleInterpreter
    from lexicon.movement import MovementLexicon


_MILLISECONDS = 100
"""Milliseconds between independent numbers: half of the shortest block."""
_MOTION, _CHOICE = 0, 1
_POSE, _PLAN, _ACTIVITY = 1 << 20, (1 << 20) + 1, (1 << 20) + 2
"""Kinds of numbers: of the motion, of the choice of lexemes, of first poses, of the planner and of activity."""
_WAXES = 3000
"""Milliseconds between independent numbers of activity: people's gestures wax and wane over a few seconds."""
_CHANNELS = 1 << 32
"""The first channel of `life.mixed` here; the idle motion and the choice of phrases use lower ones."""


@dataclass(frozen=True)
class Keys:
    """Keys of the random numbers of blocks, besides their time: seed and variation of the performance."""

    seed: int
    variation: int = 0

    def noise(self, time: float, shape: tuple[int, int]) -> NDArray[np.float32]:
        """Standard normal noise of the motion of the block that begins at `time` seconds, of this shape."""
        return self._normal(_MOTION, time, shape[0] * shape[1]).reshape(shape).astype(np.float32)

    def gumbel(self, time: float, count: int) -> Array:
        """[count] standard Gumbel noise, one for each lexeme, for the choice in the block that begins at `time`
        seconds. The arg max of log p_n + G_n has the distribution p (the Gumbel-max trick), and a small change of p
        rarely changes it."""
        return _gumbel(self._normal(_CHOICE, time, count))

    def plan(self, time: float, count: int) -> Array:
        """[count] standard Gumbel noise for the decision of the planner of gesture units."""
        return _gumbel(self._normal(_PLAN, time, count))

    def uniform(self, time: float, count: int) -> Array:
        """[count] numbers in (0, 1) for the preparation that begins at `time` seconds."""
        from scipy.special import ndtr

        return np.asarray(ndtr(self._normal(_POSE, time, count)))

    def activity(self, time: float) -> float:
        """A standard normal number that changes over seconds: how lively the gestures are at `time`."""
        return float(self._normal(_ACTIVITY, time, 1, _WAXES)[0])

    def _normal(self, kind: int, time: float, count: int, apart: int = _MILLISECONDS) -> Array:
        """[count] standard normal numbers at a time in seconds; times within a millisecond are the same. apart:
        milliseconds between independent numbers."""
        cell, rest = divmod(round(time * 1000), apart)
        numbers = cell * count + np.arange(2 * count)
        both = normal(self.seed, _CHANNELS + 2 * self.variation + kind, numbers)
        angle = 0.5 * pi * rest / apart
        return cos(angle) * both[:count] + sin(angle) * both[count:]


def _gumbel(normal_numbers: Array) -> Array:
    from scipy.special import log_ndtr

    return np.asarray(-np.log(-log_ndtr(normal_numbers)))


@dataclass(frozen=True)
class Direction:
    """Instructions for one block.

    lexeme: the lexeme to play; None lets the interpreter choose. keys: of the noise and the choice of an edited block;
    None for those of the performance. still: [K] frames in which the hands are to rest, or None. bias: [S] added to the
    interpreter's scores, or None. activity: share of the speaking time with gestures, where it changes from block to
    block; None for that of the performance.
    """

    lexeme: int | None = None
    keys: Keys | None = None
    still: NDArray[np.bool_] | None = None
    bias: NDArray[np.float64] | None = None
    activity: float | None = None

    def biased(self, scores: NDArray[np.float64]) -> NDArray[np.float64]:
        """Scores [S] with the bias added."""
        return scores if self.bias is None else scores + self.bias


FREE = Direction()
"""No instructions: the models decide everything."""

_CALM = 0.5
"""Factor on the noise of further candidates, where arms are too fast in all."""
_NEAREST = 1e-6
"""Least distance of a candidate to a lexeme, so that the ratio of two is finite."""
LIVELINESS = (1.0, 0.5, 0.5, 0.0)
"""The direction of a style code (`interpreters.planner.CODE`) in which gestures become livelier."""
_OUTWARDS = (0.0, 0.0, 0.0, 1.0)
"""The direction of a style code in which hands are farther from the body."""
HURRIED_STEPS = 2
"""Steps of the Adams method for a hurried block; a single step would give the mean instead of a sample."""


class Drawer(Protocol):
    """Samples the motion of one block after the other, with state between them. keys: of the next block's noise;
    hurried: sample at lower cost, if possible; unseen: the next block will be replaced by rest, so any motion will do;
    asked: its lexeme was chosen with a bias, so it should be seen."""

    keys: Keys
    hurried: bool
    unseen: bool
    asked: bool

    def fork(self) -> Drawer:
        """An independent copy with the same state."""

    def restart(self) -> None:
        """Forget the blocks before, but not for how long speech or silence has lasted."""

    def block(self, speech: SpeechBlock, features: BlockFeatures, lexeme: int, past: Tensor,
              unit: UnitDecision | None = None, shift: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """The next block [1, K, D_m] and its style code [1, d_z], after the motion past [1, K, D_m].

        speech: the block's timing and sound; features: its inputs of the models; unit: the planner's decision, or None;
        shift: [2 K, D_m] what will be added to the past and to the block where they are shown, or None.
        """


def drawer_for(bundle: Bundle, speaker: int, lexeme: int, keys: Keys, text: bool = False) -> Drawer:
    """The drawer for the bundle's generator; lexeme: the one before the first block; text: words are read."""
    kind: type[FlowDrawer | RegressionDrawer] = FlowDrawer if bundle.system.VARIES else RegressionDrawer
    return kind(bundle, speaker, lexeme, keys, text)


class RegressionDrawer:
    """The generator of RG 5.2, with the states of its decoder and of the style interpreter."""

    def __init__(self, bundle: Bundle, speaker: int, lexeme: int, keys: Keys, text: bool) -> None:
        self.bundle, self.keys = bundle, keys  # deterministic: the keys have no effect
        self.hurried = self.unseen = self.asked = False  # cheap: none has an effect
        self.generator = cast("Generator", bundle.generator)
        self.style = (bundle.style_text if text else None) or cast("StyleInterpreter | None", bundle.style)
        self._first = speaker, lexeme
        self.restart()

    def fork(self) -> RegressionDrawer:
        """See `Drawer.fork`."""
        return copy.copy(self)  # states are replaced, never modified

    def restart(self) -> None:
        """See `Drawer.restart`."""
        speaker, lexeme = self._first
        self.style_state = None if self.style is None else self.style.start(speaker)
        rest = self.bundle.rest_feature(speaker)
        self.state = self.free = self.generator.first_state(rest[None], self.bundle.vectors[[lexeme]])

    def block(self, speech: SpeechBlock, features: BlockFeatures, lexeme: int, past: Tensor,
              unit: UnitDecision | None = None, shift: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """See `Drawer.block`; this generator does not take the planner's decision."""
        code = past.new_zeros(1, self.bundle.config.generator.style_width)
        if self.style is not None:
            assert self.style_state is not None
            code, self.style_state = self.style.step(self.style_state, features, lexeme)
        audio, vector = self.generator.encode_audio(features.low[None]), self.bundle.vectors[[lexeme]]
        control = None if features.control is None else features.control[None]
        block, self.state, _ = self.generator.step(past, audio, vector, code, self.state, control=control)
        if control is not None:
            # Classifier-free guidance: extrapolate from the block without control through the block with control.
            free, self.free, _ = self.generator.step(past, audio, vector, code, self.free)
            block = free + self.bundle.config.selection.guidance * (block - free)
        return block, code


class _Style(NamedTuple):
    """code: [1, d_z] the style code of a block; against: [1, d_z] that of the prediction without the planner's decision
    (`selection.contrast`)."""

    code: Tensor
    against: Tensor


class FlowDrawer:
    """The flow head, with guidance by audio, lexeme, history and control, and several candidates per block."""

    def __init__(self, bundle: Bundle, speaker: int, lexeme: int, keys: Keys, text: bool) -> None:
        self.generator = cast(FlowGenerator, bundle.generator)
        self.lexicon = cast("MovementLexicon", bundle.lexicon)
        self.chooser = CandidateChooser(bundle, speaker)
        self.settings, self.keys, self.device = bundle.config.selection, keys, bundle.vectors.device
        self.place = Circumstances()
        self.speaker = torch.nn.functional.one_hot(torch.tensor([speaker], device=self.device),
                                                   len(bundle.speakers)).float()
        self.share = self._by_part(self.settings.trunk_guidance)
        self.trunk = self._by_part(0.0, 1.0) == 0.0
        self.noise = self.settings.noise * self._by_part(self.settings.trunk_noise, self.settings.finger_noise)
        self.state: tuple[Tensor, Tensor] | None = None
        self.past: Pasts | None = None
        self.base = torch.zeros(0)
        """[1, K, D_m] extrapolation of the motion before the last block, to which its coefficients were added."""
        self.hurried = self.unseen = self.asked = False
        self.style = cast("UnitStyleInterpreter | None", bundle.style)
        self.style_state = None if self.style is None else self.style.start(speaker)

    def fork(self) -> FlowDrawer:
        """See `Drawer.fork`."""
        twin = copy.copy(self)
        twin.place = copy.deepcopy(self.place)
        return twin

    def restart(self) -> None:
        """See `Drawer.restart`."""
        self.state = self.past = None

    def block(self, speech: SpeechBlock, features: BlockFeatures, lexeme: int, past: Tensor,
              unit: UnitDecision | None = None, shift: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """See `Drawer.block`."""
        added = past.new_zeros(1, self.generator.basis.width)
        if self.past is not None:  # the motion may differ from the sampled block: rest, clamping
            added = self.generator.squeeze(self.generator.basis.project(past - self.base))
        before, duration, _ = torch.tensor(speech.durations, dtype=torch.float32, device=self.device)
        self.past = Pasts(past[:, -PAST:], (duration / before)[None])
        self.base = self.generator.basis.base(self.past)
        place = self.place.step(speech.durations, speech.silent).to(self.device)
        if speech.foreseen and self.generator.config.after_dropout:
            place = alone(place)
        style = self._style(speech.keyed_at, features, unit)
        code = style.code
        inputs, gains = self._inputs(place, features, lexeme, past, unit, style)
        context, self.state = self.generator.contexts(inputs, added[None], self.state)
        if self.unseen:  # the state had to advance, but no block is needed
            return self.base * self.generator.present, code
        steps, pull = self.settings.flow_steps, torch.tensor(gains, device=self.device)[:, None] * self.share
        if self.hurried:
            # One candidate, few steps, no guidance. The guidance states above advance all the same, for later blocks.
            steps, context, pull = min(steps, HURRIED_STEPS), context[:1], pull[:0]
            _, block = self._sample(self._noise(speech.keyed_at, 1, code), context, pull, steps)
            if not self.chooser.too_fast(speech, self._motion(past, block, shift)):
                return block, code
        # What is asked of the hands can only be followed by a choice among ways of the arms.
        same = self.settings.same_arms and features.control is None and not self.asked
        noise = self._noise(speech.keyed_at, self.settings.candidates, code)
        coefficients, blocks = self._sample(noise, context, pull, steps, same)
        motion = self._motion(past, blocks, shift)
        if self.settings.careful and (self.chooser.too_fast(speech, motion) or self.chooser.before_face(motion)):
            # Guidance extrapolates, now and then beyond anything in the data; so does the noise.
            further = [self._sample(_CALM * noise, context[:1], pull[:0], steps, same)]
            if same and len(noise) > 1 and not self.hurried:
                further.append(self._sample(noise.roll(-1, 0), context, pull, steps, same))  # other arms
            coefficients = torch.cat([coefficients, *(each for each, _ in further)])
            blocks = torch.cat([blocks, *(each for _, each in further)])
            motion = motion.joined(self._motion(past, blocks[len(motion):], shift))
        distances = self.lexicon.distances(coefficients)
        apart = distances[:, lexeme] / distances.amin(-1).clamp_min(_NEAREST)
        best = self.chooser.choose(speech, motion, _array(apart), _array(features.control),
                                   None if self.style is None else _array(code[0]))
        block = blocks[best:best + 1]
        if self.settings.retiming:
            block = torch.as_tensor(self.chooser.retimed(speech, _array(past[0]), _array(block[0])),
                                    device=self.device)[None]
        return block, code

    def _motion(self, past: Tensor, blocks: Tensor, shift: Tensor | None) -> CandidateMotion:
        return self.chooser.motion(_array(past[0]), _array(blocks), _array(shift))

    def _style(self, time: float, features: BlockFeatures, unit: UnitDecision | None) -> _Style:
        """The style code of the block's unit, as heard, as activity waxes and wanes by itself, and as far out as the
        settings say; empty without a style interpreter. time: seconds that key the activity."""
        if self.style is None or self.style_state is None:
            none = torch.zeros(1, 0, device=self.device)
            return _Style(none, none)
        code, self.style_state = self.style.step(self.style_state, features, unit is not None and unit.rests)
        waxing = self.settings.waxing * self.keys.activity(time) if self.settings.waxing else 0.0
        heard = self.settings.style * code
        code = heard + waxing * code.new_tensor(LIVELINESS)
        if features.control is None:  # controls say how far out the hands are
            code = code + self.settings.reach * code.new_tensor(_OUTWARDS)
        return _Style(code, code - self.settings.contrast * heard)

    def _noise(self, time: float, candidates: int, code: Tensor) -> Tensor:
        """[C, n] the noise of C candidates at this time. code: [1, d_z] the style code."""
        keyed = self.keys.noise(time, (candidates, self.generator.basis.width))
        noise = torch.as_tensor(keyed, device=self.device) * self.noise
        if not self.settings.lively_noise or self.style is None:
            return noise
        direction = code.new_tensor(LIVELINESS)
        liveliness = code[0] @ direction / (direction @ direction)
        return torch.where(self.trunk, noise, noise * torch.exp(self.settings.lively_noise * liveliness))

    def _sample(self, noise: Tensor, context: Tensor, pull: Tensor, steps: int, same: bool = False
                ) -> tuple[Tensor, Tensor]:
        """Coefficients [C, n] of candidates with this noise [C, n], and the blocks [C, K, D_m] that they give. same:
        all with the arms of the first."""
        if same:
            noise = torch.where(self.trunk, noise, noise[:1])
        # The arms of the first are guided by their own predictions; the trunks, which are hardly guided, by the same.
        coefficients = self.generator.draw(context[:, 0], pull, noise, steps, same)
        if same:
            coefficients = torch.where(self.trunk, coefficients, coefficients[:1])
        return coefficients, (self.base + self.generator.basis.expand(coefficients)) * self.generator.present

    def _by_part(self, trunk: float, fingers: float = 1.0) -> Tensor:
        """[n] factors on the coefficients: `trunk` for torso and head, `fingers` for fingers, 1 for the arms."""
        basis = self.generator.basis
        factors = [trunk if name in ("torso", "head") else fingers if "finger" in name else 1.0 for name in basis.parts]
        return torch.cat([torch.full((width,), factor)
                          for factor, width in zip(factors, basis.widths, strict=True)]).to(self.device)

    def _inputs(self, place: Tensor, features: BlockFeatures, lexeme: int, past: Tensor, unit: UnitDecision | None,
                style: _Style) -> tuple[FlowInputs, list[float]]:
        """[1 + G] inputs of the flow head: the full ones, and one without each of the G guiding conditions; and the
        guidance weights [G]. place: [8] the block's circumstances; unit: the planner's decision, or None."""
        settings, none = self.settings, self.generator.lexemes
        control = features.control
        without_lexeme = settings.lexeme_guidance == UNTOLD
        gains = {"audio": settings.audio_guidance, "lexeme": 0.0 if without_lexeme else settings.lexeme_guidance,
                 "history": settings.history - 1.0}
        row = None if unit is None or not self.generator.unit_width else unit.row.to(self.device)
        if row is not None:
            gains["unit"] = settings.unit_guidance
        if control is not None:
            gains["control"] = settings.guidance - 1.0
        gains = {condition: gain for condition, gain in gains.items() if gain}
        left_out = ["", *gains]
        if control is not None:
            control = control.expand(len(left_out), 1, -1, -1).clone()
            if left_out[-1] == "control":
                control[-1] = 0.0
        lexemes = torch.tensor([[none if without_lexeme or condition == "lexeme" else lexeme]
                                for condition in left_out], device=self.device)
        if row is not None:
            row = torch.stack([row * (condition != "unit") for condition in left_out])[:, None]
        return FlowInputs(
            features.low[None, None], lexemes, past[:, None], cast(Pasts, self.past).ratio[None], place[None, None],
            self.speaker, control, torch.tensor([condition == "audio" for condition in left_out], device=self.device),
            torch.tensor([condition == "history" for condition in left_out], device=self.device), row,
            None if self.style is None else torch.stack([
                style.against if condition == "unit" else style.code for condition in left_out])), list(gains.values())


@overload
def _array(values: Tensor) -> Array: ...


@overload
def _array(values: None) -> None: ...


def _array(values: Tensor | None) -> Array | None:
    return None if values is None else values.cpu().numpy()
