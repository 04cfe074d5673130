"""The default system: lexemes of movements, a planner of gesture units, and a flow generator that samples.

It keeps RG's structure (blocks at the beat, lexemes, style codes, one block after the other). Four things differ:

- A lexeme stands for the movement that a block adds to its past, not for a pose, so that it ties no arm to a place.
- A planner decides which blocks form one gesture: the phase of each block, the hand, the size and the time of the
  stroke. A lexeme that is chosen block by block begins a new movement each time, and the hands pump.
- The generator samples a continuation (conditional flow matching, `generator.flow`); a regression gives the mean of
  all, and the mean of a gesture to the left and one to the right is no gesture.
- The hands rest by pauses and phrases (`gesticulator.body.rest`), not block by block. Without that
  (`silence.rest=decay`) the bare output of the generator is shown, for evaluation.

The file goes on in the order of a block: models, speech to decisions, decisions to motion. The constants without
another source were chosen on the validation split: nearest to the corpus by the distance of motion windows and the
speed of the hands, then by timing and smooth joins.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module.motion.kinematics import fade_weights
from data_module.motion.movement import Pasts
from data_module.motion.movement_run import PAST
from data_module.motion.skeletons import CHARACTERS
from data_module.types import Array
from generator.flow import FlowGenerator, FlowInputs
from generator.flow_run import Circumstances, alone
from gesticulator.body.life import SIDES
from gesticulator.bundle.features import CONTROL_WIDTH, Flags, SpeechBlock, body_columns
from gesticulator.sampling.candidates import CandidateChooser, CandidateMotion
from gesticulator.sampling.loop import (
    CONTIGUOUS,
    BlockMotion,
    Keys,
    Request,
    Scores,
    Setup,
    State,
    at_rest,
    choose,
    decided,
    features_of,
    resting,
    scores_of,
    shown,
    tensor,
)
from interpreters.base import BlockFeatures
from interpreters.planner import UnitStyleInterpreter
from interpreters.units import CLASSES, PHASES, UnitDecision
from lexicon.movement import MovementLexicon, MovementVqVae, basis_for, code_width

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from gesticulator.bundle.bundle import Bundle
    from gesticulator.bundle.config import Config, LexiconConfig
    from gesticulator.bundle.features import Sizes
    from interpreters.planner import PlannerState, UnitStyleState

NAME = "movement"
PARTS = ("generator", "interpreter")
CODEBOOK = "vectors"
BLOCKS = IN_CONTEXT = SILENCE = VARIES = True
STAGES = ("speech", "contrast", "lexicon", "interpreter", "interpreter_text", "gate", "planner", "reward",
          "reward_judge", "q_network", "q_network_literal", "advantage", "generator", "style")

# ------------------------------------------------------------------------------------------------------------- models

def codebook_shape(config: Config) -> tuple[int, int]:
    """(S, D_s) of the lexicon."""
    with torch.device("meta"):
        width = basis_for(config.lexicon, config.rhythm.frames, body_columns(config)).width
    return config.lexicon.size, code_width(config.lexicon, width)


def lexicon(sizes: Sizes) -> MovementLexicon:
    """The lexicon of movements: a VQ-VAE, or k-means, over the coefficients that a block adds to its past."""
    return movement_lexicon(sizes.config.lexicon, sizes.frames, body_columns(sizes.config))


def movement_lexicon(settings: LexiconConfig, frames: int, parts: Mapping[str, tuple[int, ...]]) -> MovementLexicon:
    """The lexicon of movements of these settings; arguments as of `MovementLexicon`."""
    if settings.quantizer == "vq-vae":
        return MovementVqVae(settings, frames, parts)
    return MovementLexicon(settings, frames, parts)


def generator(sizes: Sizes) -> FlowGenerator:
    """The generator of RG 5.2 with a head that samples by conditional flow matching (`generator.flow`)."""
    from generator.settings import GeneratorWidths

    config = sizes.config
    widths = GeneratorWidths(sizes.frames, sizes.motion, sizes.low, codebook_shape(config)[1], CONTROL_WIDTH,
                             config.lexicon.size, sizes.speakers, sum(CLASSES) if config.generator.units else 0)
    basis = basis_for(config.lexicon, sizes.frames, body_columns(config))
    return FlowGenerator(config.generator, widths, basis, sizes.present)


def style(sizes: Sizes, reads: bool) -> UnitStyleInterpreter:
    """The style interpreter of gesture units, which takes no words."""
    return UnitStyleInterpreter(sizes.config.style, sizes.frames, sizes.low, sizes.speakers,
                                sizes.config.generator.style_width)


# ----------------------------------------------------------------------------------------------------- one block

def begin(bundle: Bundle, setup: Setup, text: bool, keys: Keys) -> State:
    """The state before the first block: the body at rest, nothing planned, nothing sampled."""
    state = at_rest(bundle, setup, text, keys)
    sampler = FlowSampler(bundle, setup.speaker)
    style_state = None if sampler.style is None else sampler.style.start(setup.speaker)
    return replace(state, planner=None if bundle.planner is None else bundle.planner.start(setup.speaker),
                   generator=FlowState(sampler, style=style_state))


def step(bundle: Bundle, setup: Setup, state: State, request: Request) -> tuple[BlockMotion, State]:
    """The next block, and the state after it."""
    speech = request.speech
    if abs(speech.start - state.until) > CONTIGUOUS:  # an offset does not fade while nothing is seen
        state = replace(state, generated=state.past, offset=None)
    features = features_of(bundle, request, state.generated[0])

    # 1. The planner: what the hands do in this block.
    unit, planner = decide_unit(bundle, setup, state.planner, speech, features)
    state = replace(state, planner=planner)
    if request.keys is None and sets_out(state, speech, unit):
        state = set_out(bundle, setup, state, speech)
        features = replace(features, past=state.generated[0])

    # 2. Rest: whether they move at all.
    rested = resting(bundle, setup, state, request, features, still_frames(bundle, state, request, unit))
    rest = rested.rest

    # 3. The lexeme: which movement, given the phase.
    scores, interpreter, unguided = scores_of(bundle, setup, state, features)
    scores = within_phase(bundle, scores, unit)
    quiet = rested.closed or (features.silent and bundle.config.silence.mask)
    lexeme = choose(setup, request, scores, bundle.silent if quiet else None)

    # 4. The motion: candidates from the flow generator, of which one is kept.
    keys = request.keys or state.keys
    offset = None if state.offset is None else state.offset.at(speech.span.times)
    shift = None if offset is None else torch.cat([(state.past - state.generated)[0], offset])
    block, code, generator = state.generator.sampler.sample(
        state.generator, BlockToSample(speech, features, lexeme, unit, keys, shift, request.fast,
                                       rest is not None and rest.rests_wholly),
        state.generated)

    # 5. What is shown: rest, idle motion, and the offset that joins it to what was shown before.
    past, motion = shown(bundle, rest, block, offset)
    faded = state.offset is None or state.offset.over(speech.end)
    record = decided(speech, lexeme, scores, keys, rested.probability)
    after = replace(state, lexeme=lexeme, past=past, generated=past if offset is None else past - offset,
                    interpreter=interpreter, unguided=unguided, generator=generator, gate=rested.gate, unit=unit,
                    rest=rest, until=speech.end, offset=None if faded else state.offset)
    return BlockMotion(record, lexeme, motion, code[0].cpu().numpy(), unit), after


def motion_of(bundle: Bundle, setup: Setup, blocks: Sequence[BlockMotion]) -> NDArray[np.float32]:
    """[N, K, D_m] motion of all blocks of a performance."""
    return np.stack([block.motion for block in blocks])


# ----------------------------------------------------------------------------------------- the planner of gesture units

HOLD = 1.2
"""Added to the logit of a hold after a stroke: what is generated holds less than people do."""
GOES_ON_PAUSING = 0.5
"""Added to the logit of a hold in a pause that goes on: people hold at the ends of phrases."""
VOICE_RETURNS = 4.0
"""Added to the logit of a preparation in a pause that ends in the next block: people prepare before they speak."""


def phrasing(speech: SpeechBlock) -> Scores:
    """[5] what is added to the planner's logits of the phases."""
    bias = np.zeros(len(PHASES))
    bias[PHASES.index("hold")] = HOLD
    if speech.quiet.mean() >= 0.5 and speech.ahead is not None:
        if speech.ahead.all():
            bias[PHASES.index("hold")] += GOES_ON_PAUSING
        else:
            bias[PHASES.index("preparation")] = VOICE_RETURNS
    return bias


def decide_unit(bundle: Bundle, setup: Setup, planner: PlannerState | None, speech: SpeechBlock,
                features: BlockFeatures) -> tuple[UnitDecision | None, PlannerState | None]:
    """The planner's decision for a block, and its state after it; None without a planner. Its noise is keyed by the
    seed and the time of the block, so that a difference elsewhere in the recording does not change it."""
    if bundle.planner is None or planner is None:
        return None, None
    noise = Keys(setup.seed).plan(speech.keyed_at, bundle.planner.choices)
    # Where the best lexeme is taken instead of a sample, so is the best phase.
    temperature = float(setup.temperature > 0)
    return bundle.planner.step(planner, features, noise, temperature, phrasing(speech))


def within_phase(bundle: Bundle, scores: Scores, unit: UnitDecision | None) -> Scores:
    """Scores [S] plus what each lexeme is worth in the planner's phase, with the sum of probabilities as before."""
    if unit is None or bundle.planner is None:
        return scores
    within = scores + bundle.planner.bias(unit)
    return within - (np.logaddexp.reduce(within) - np.logaddexp.reduce(scores))


def still_frames(bundle: Bundle, state: State, request: Request, unit: UnitDecision | None) -> Flags | None:
    """[K] frames in which the hands hold still, by the request or by the planner; None for none. A requested gesture is
    shown whatever the phase: only silent lexemes can be held."""
    holds = unit is not None and unit.holds and state.rest is not None
    if holds and (request.lexeme is None or request.lexeme in bundle.silent):
        return np.ones(bundle.frames, bool)
    return request.still


# ------------------------------------------------------------------------------------------------- each gesture afresh

# People decide stroke by stroke: a preparation begins where the hand happens to be, but what is prepared does not
# depend on how the hand came there. So where the planner lets the hands set out, the block is generated as the first of
# a performance, from a pose h that is keyed by seed and time. Two performances of nearly the same sound that parted are
# one again T seconds after the hands set out next. What is shown is the generated motion g plus an offset that fades
# from the difference of the pose p and the velocity v last shown (inertialisation, as in games):
#
#     x(t) = g(t) + (p - h) a(s) + v T b(s),   s = (t - t_0) / T
#
# a and b have no jump in value, speed or acceleration at either end (`data_module.motion.kinematics`).

FADES = 0.6
"""T, seconds: as long as a preparation takes."""
AFRESH = 1.6
"""Seconds of strokes after which the next one is prepared anew."""
_LOWEST, _HIGHEST = 0.55, -0.45
"""How far towards the resting pose an arm's first pose may be, as a share of the way from the mean pose."""


@dataclass(frozen=True)
class Offset:
    """The fading offset from `begin` seconds. pose: [D_m] p - h; velocity: [D_m] v, a second."""

    begin: float
    pose: Tensor
    velocity: Tensor

    def at(self, times: Array) -> Tensor:
        """[K, D_m] at times [K], seconds."""
        s = np.clip((np.asarray(times) - self.begin) / FADES, 0.0, 1.0)
        sinks, coasts, _ = fade_weights(s)
        weights = torch.as_tensor(np.stack([sinks, FADES * coasts]), dtype=self.pose.dtype, device=self.pose.device)
        return weights[0][:, None] * self.pose + weights[1][:, None] * self.velocity

    def over(self, time: float) -> bool:
        """Whether it has faded at `time` seconds."""
        return time >= self.begin + FADES


def first_pose(keys: Keys, names: Sequence[str], rest: Array, time: float) -> NDArray[np.float32]:
    """[D_m] h of a preparation that begins at `time` seconds, normalised: each arm is somewhere between the mean and
    the resting pose, or a little above the mean pose. names: of the J joints; rest: [D_m] the normalised resting pose,
    three numbers a joint; 0 is the mean pose."""
    pose = np.zeros_like(rest)
    arms = [np.repeat([name.startswith(side) for name in names], 3) for side in SIDES]
    for columns, chance in zip(arms, keys.uniform(time, len(arms)), strict=True):
        pose[columns] = (_HIGHEST + (_LOWEST - _HIGHEST) * chance) * rest[columns]
    return pose.astype(np.float32)


def sets_out(state: State, speech: SpeechBlock, unit: UnitDecision | None) -> bool:
    """Whether what was before is forgotten: the hands set out, or one stroke has followed another for long."""
    if unit is None or state.rest is None:
        return False
    return unit.begins_after(state.unit) or (unit.follows(state.unit)
                                             and speech.start - state.generator.set_out >= AFRESH)


def set_out(bundle: Bundle, setup: Setup, state: State, speech: SpeechBlock) -> State:
    """The state in which the block is generated as the first of a performance."""
    statistics, speaker, past = bundle.statistics, setup.speaker, state.past[0]
    velocity = (past[-1] - past[-2]) * (past.shape[0] / speech.durations[0])
    rest, names = statistics.rest_pose[speaker], CHARACTERS[bundle.config.motion.joints].names
    low, high = tensor(bundle, statistics.bounds)
    pose = first_pose(state.keys, names, statistics.normalise(rest, speaker), speech.keyed_at)
    first = torch.clamp(tensor(bundle, pose), low, high)
    lexeme = bundle.rest_lexeme(speaker)
    interpreter = setup.interpreter.start(speaker, lexeme)
    return replace(state, offset=Offset(speech.start, past[-1] - first, velocity),
                   generated=first.expand_as(past)[None], lexeme=lexeme, interpreter=interpreter, unguided=interpreter,
                   planner=None if state.planner is None else state.planner.begins(),
                   # Without the blocks before, but for how long speech or silence has lasted.
                   generator=replace(state.generator, lstm=None, past=None, base=None, set_out=speech.start))


# --------------------------------------------------------------------------------------------------- the flow generator

AUDIO_GUIDANCE, LEXEME_GUIDANCE, UNIT_GUIDANCE = 0.7, 0.4, 0.5
"""Guidance on the audio, the lexeme and the planner's decision: extrapolation from the prediction without each."""
NOISE = 0.76
"""Standard deviation of the initial noise; below 1 is calmer."""
FLOW_STEPS = 3
"""Steps of the Adams method from noise to a block."""
CANDIDATES = 4
"""Candidates sampled for a block, of which the best is kept (`gesticulator.sampling.candidates`)."""
TRUNK_GUIDANCE = 0.3
"""Share of all guidance that torso and head get: full guidance makes their large turns larger than people's."""
TRUNK_NOISE, FINGER_NOISE = 0.94, 1.75
"""Factors on the noise of torso and head, and of the fingers."""
LIVELY_NOISE = 0.08
"""How much more noise the arms have the livelier the style code is: its natural logarithm, per unit of liveliness."""
WAXING = 0.8
"""Deviation of the style codes' own rise and fall over seconds."""
LIVELINESS = (1.0, 0.5, 0.5, 0.0)
"""The direction of a style code (`interpreters.units.CODE`) in which gestures become livelier."""
_OUTWARDS = (0.0, 0.0, 0.0, 1.0)
"""The direction of a style code in which hands are farther from the body."""
FAST_STEPS = 2
"""Steps of the Adams method for a block at lower cost; a single step would give the mean instead of a sample."""
_CALM = 0.5
"""Factor on the noise of further candidates, where arms are too fast in all."""
_NEAREST = 1e-6
"""Least distance of a candidate to a lexeme, so that the ratio of two is finite."""


@dataclass(frozen=True)
class BlockToSample:
    """What one block is sampled for. keys: of its noise; shift: [2 K, D_m] what will be added to the past and to the
    block where they are shown, or None; fast: at lower cost; hidden: rest will take its place."""

    speech: SpeechBlock
    features: BlockFeatures
    lexeme: int
    unit: UnitDecision | None
    keys: Keys
    shift: Tensor | None = None
    fast: bool = False
    hidden: bool = False


class _Style(NamedTuple):
    """code: [1, d_z] the style code of a block; against: that without the planner's decision (`selection.contrast`)."""

    code: Tensor
    against: Tensor


@dataclass(frozen=True)
class FlowState:
    """The state of the sampler between two blocks. lstm: of the generator; past: the frames before the last block;
    base: [1, K, D_m] the extrapolation of them, to which its coefficients were added; all three None after a fresh
    start. place: how long speech or silence has lasted. style: of the style interpreter, None without one. set_out:
    seconds at which the hands last set out."""

    sampler: FlowSampler
    lstm: tuple[Tensor, Tensor] | None = None
    past: Pasts | None = None
    base: Tensor | None = None
    place: Circumstances = field(default_factory=Circumstances)
    style: UnitStyleState | None = None
    set_out: float = 0.0


class FlowSampler:
    """Samples blocks of one speaker from the flow generator. It has no state of its own."""

    def __init__(self, bundle: Bundle, speaker: int) -> None:
        self.generator = cast(FlowGenerator, bundle.generator)
        self.lexicon = cast(MovementLexicon, bundle.lexicon)
        self.style = cast("UnitStyleInterpreter | None", bundle.style)
        self.chooser = CandidateChooser(bundle, speaker)
        self.settings, self.device = bundle.config.selection, bundle.vectors.device
        self.speaker = torch.nn.functional.one_hot(torch.tensor([speaker], device=self.device),
                                                   len(bundle.speakers)).float()
        self.share = self._by_part(TRUNK_GUIDANCE)
        self.trunk = self._by_part(0.0, 1.0) == 0.0
        self.deviation = NOISE * self._by_part(TRUNK_NOISE, FINGER_NOISE)

    def _by_part(self, trunk: float, fingers: float = 1.0) -> Tensor:
        """[n] factors on the coefficients: `trunk` for torso and head, `fingers` for fingers, 1 for the arms."""
        basis = self.generator.basis
        factors = [trunk if name in ("torso", "head") else fingers if "finger" in name else 1.0 for name in basis.parts]
        return torch.cat([torch.full((width,), factor)
                          for factor, width in zip(factors, basis.widths, strict=True)]).to(self.device)

    def sample(self, state: FlowState, block: BlockToSample, past: Tensor) -> tuple[Tensor, Tensor, FlowState]:
        """A block [1, K, D_m] after the motion past [1, K, D_m], its style code [1, d_z], and the state after it."""
        speech, basis = block.speech, self.generator.basis
        added = past.new_zeros(1, basis.width)
        if state.past is not None and state.base is not None:  # the motion may differ from what was sampled: rest
            added = self.generator.squeeze(basis.project(past - state.base))
        before, duration, _ = torch.tensor(speech.durations, dtype=torch.float32, device=self.device)
        pasts = Pasts(past[:, -PAST:], (duration / before)[None])
        base = basis.base(pasts)
        at, place = state.place.step(speech.durations, speech.silent)
        where = torch.as_tensor(at, device=self.device)
        if speech.foreseen and self.generator.config.after_dropout:
            where = alone(where)
        style, style_state = self._style(state.style, block)
        inputs, gains = self._inputs(where, block, past, pasts, style)
        context, lstm = self.generator.contexts(inputs, added[None], state.lstm)
        after = replace(state, lstm=lstm, past=pasts, base=base, place=place, style=style_state)
        if block.hidden:  # the state had to advance, but no block is needed
            return base * self.generator.present, style.code, after
        return self._sampled(block, past, base, context, gains, style.code), style.code, after

    def _sampled(self, block: BlockToSample, past: Tensor, base: Tensor, context: Tensor, gains: list[float],
                 code: Tensor) -> Tensor:
        """[1, K, D_m] the best of several candidates, moved in time to the onsets of the sound."""
        speech, steps = block.speech, FLOW_STEPS
        pull = torch.tensor(gains, device=self.device)[:, None] * self.share
        if block.fast:
            # One candidate, few steps, no guidance.
            context, pull, steps = context[:1], pull[:0], FAST_STEPS
            _, only = self._drawn(base, context, pull, steps, self._noise(block, 1, code))
            if not self.chooser.too_fast(speech, self._motion(past, only, block.shift)):
                return only
        # What is requested of the hands can only be followed by a choice among different arms; otherwise all candidates
        # share the arms of the first. A choice of arms would turn every small change of sound into another gesture.
        same = block.features.control is None
        noise = self._noise(block, CANDIDATES, code)
        coefficients, blocks = self._drawn(base, context, pull, steps, noise, same)
        motion = self._motion(past, blocks, block.shift)
        if self.chooser.too_fast(speech, motion) or self.chooser.before_face(motion):
            # Guidance extrapolates, now and then beyond anything in the data; so does the noise.
            further = [self._drawn(base, context[:1], pull[:0], steps, _CALM * noise, same)]
            if same and not block.fast:  # other arms
                further.append(self._drawn(base, context, pull, steps, noise.roll(-1, 0), same))
            coefficients = torch.cat([coefficients, *(each for each, _ in further)])
            blocks = torch.cat([blocks, *(each for _, each in further)])
            motion = motion.joined(self._motion(past, blocks[len(motion):], block.shift))
        distances = self.lexicon.distances(coefficients)
        apart = distances[:, block.lexeme] / distances.amin(-1).clamp_min(_NEAREST)
        control = block.features.control
        best = self.chooser.choose(speech, motion, _array(apart), None if control is None else _array(control))
        return torch.as_tensor(self.chooser.retimed(speech, _array(past[0]), _array(blocks[best])),
                               device=self.device)[None]

    def _drawn(self, base: Tensor, context: Tensor, pull: Tensor, steps: int, noise: Tensor, same: bool = False
               ) -> tuple[Tensor, Tensor]:
        """Coefficients [C, n] of candidates with noise [C, n], and the blocks [C, K, D_m] that they give over the base
        [1, K, D_m]. context: [1 + G, 1, C]; pull: [G, n] of the guidance; same: all with the arms of the first."""
        noise = torch.where(self.trunk, noise, noise[:1]) if same else noise
        # The arms of the first are guided by their own predictions; the trunks, which are hardly guided, by the same.
        coefficients = self.generator.draw(context[:, 0], pull, noise, steps, same)
        if same:
            coefficients = torch.where(self.trunk, coefficients, coefficients[:1])
        return coefficients, (base + self.generator.basis.expand(coefficients)) * self.generator.present

    def _motion(self, past: Tensor, blocks: Tensor, shift: Tensor | None) -> CandidateMotion:
        return self.chooser.motion(_array(past[0]), _array(blocks), None if shift is None else _array(shift))

    def _style(self, state: UnitStyleState | None, block: BlockToSample) -> tuple[_Style, UnitStyleState | None]:
        """The style code of the block's unit: as the voice has it, as activity waxes and wanes by itself, and as far
        out as the settings say; empty without a style interpreter."""
        if self.style is None or state is None:
            none = torch.zeros(1, 0, device=self.device)
            return _Style(none, none), None
        voiced, state = self.style.step(state, block.features, block.unit is not None and block.unit.rests)
        waxing = WAXING * block.keys.activity(block.speech.keyed_at)
        code = voiced + waxing * voiced.new_tensor(LIVELINESS)
        if block.features.control is None:  # controls say how far out the hands are
            code = code + self.settings.reach * code.new_tensor(_OUTWARDS)
        return _Style(code, code - self.settings.contrast * voiced), state

    def _noise(self, block: BlockToSample, candidates: int, code: Tensor) -> Tensor:
        """[C, n] the noise of C candidates of a block. code: [1, d_z] the style code."""
        keyed = block.keys.noise(block.speech.keyed_at, (candidates, self.generator.basis.width))
        noise = torch.as_tensor(keyed, device=self.device) * self.deviation
        if self.style is None:
            return noise
        direction = code.new_tensor(LIVELINESS)
        liveliness = code[0] @ direction / (direction @ direction)
        return torch.where(self.trunk, noise, noise * torch.exp(LIVELY_NOISE * liveliness))

    def _inputs(self, where: Tensor, block: BlockToSample, past: Tensor, pasts: Pasts, style: _Style
                ) -> tuple[FlowInputs, list[float]]:
        """[1 + G] inputs of the flow head: the full ones, and one without each of the G guiding conditions; and the
        guidance weights [G]. where: [8] the block's place in speech."""
        features, none = block.features, self.generator.lexemes
        control = features.control
        gains = {"audio": AUDIO_GUIDANCE, "lexeme": LEXEME_GUIDANCE}
        row = None if block.unit is None or not self.generator.unit_width else torch.as_tensor(block.unit.row)
        if row is not None:
            gains["unit"] = UNIT_GUIDANCE
        if control is not None:
            gains["control"] = self.settings.guidance - 1.0
        gains = {condition: gain for condition, gain in gains.items() if gain}
        left_out = ["", *gains]
        if control is not None:
            control = control.expand(len(left_out), 1, -1, -1).clone()
            if left_out[-1] == "control":
                control[-1] = 0.0
        lexemes = torch.tensor([[none if condition == "lexeme" else block.lexeme] for condition in left_out],
                               device=self.device)
        if row is not None:
            row = torch.stack([row * (condition != "unit") for condition in left_out])[:, None]
        codes = None if self.style is None else torch.stack([
            style.against if condition == "unit" else style.code for condition in left_out])
        return FlowInputs(
            features.low[None, None], lexemes, past[:, None], pasts.ratio[None], where[None, None], self.speaker,
            control, torch.tensor([condition == "audio" for condition in left_out], device=self.device), None, row,
            codes), list(gains.values())


def _array(values: Tensor) -> Array:
    return values.cpu().numpy()
