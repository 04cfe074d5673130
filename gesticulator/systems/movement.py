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

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from data_module.layers_run import Floats, Tensors
from data_module.motion.kinematics import fade_weights
from data_module.motion.movement_run import PAST, BasisRunner
from data_module.motion.skeletons import CHARACTERS
from data_module.types import Array
from generator.flow_run import Circumstances, FlowConditions, FlowRunner, alone
from generator.settings import GeneratorWidths
from gesticulator.body.life import SIDES
from gesticulator.body.roles import Roles
from gesticulator.bundle.features import CONTROL_WIDTH, SpeechBlock, body_columns
from gesticulator.sampling import loop
from gesticulator.sampling.candidates import CandidateChooser
from interpreters.base import BlockFeatures
from interpreters.planner_run import CLASSES, PHASES, PlannerRunner, UnitDecision, UnitStyleRunner
from lexicon.movement_run import MovementLexiconRunner

if TYPE_CHECKING:
    from collections.abc import Sequence

    from generator.flow import FlowGenerator
    from gesticulator.bundle.bundle import Bundle
    from gesticulator.bundle.config import Config
    from gesticulator.bundle.features import Sizes
    from interpreters.planner import UnitStyleInterpreter
    from interpreters.planner_run import PlannerState, UnitStyleState
    from lexicon.movement import MovementLexicon

NAME = "movement"
PARTS = ("generator", "interpreter")
CODEBOOK = "vectors"
BLOCKS = IN_CONTEXT = SILENCE = VARIES = True
STAGES = ("speech", "contrast", "lexicon", "interpreter", "interpreter_text", "gate", "planner", "reward",
          "reward_judge", "q_network", "q_network_literal", "generator", "style")

# ------------------------------------------------------------------------------------------------------------- models

def codebook_shape(config: Config) -> tuple[int, int]:
    """(S, D_s) of the lexicon."""
    settings, parts = config.lexicon, body_columns(config)
    # Without a learned code a lexeme is the coefficients of a movement.
    width = sum(min(settings.components_of(name), config.rhythm.frames * len(columns))
                for name, columns in parts.items())
    return settings.size, settings.code_width if settings.quantizer == "vq-vae" else width


def lexicon(sizes: Sizes) -> MovementLexicon:
    """The lexicon of movements: a VQ-VAE, or k-means, over the coefficients that a block adds to its past."""
    from lexicon.movement import MovementLexicon, MovementVqVae

    settings = sizes.config.lexicon
    chosen = MovementVqVae if settings.quantizer == "vq-vae" else MovementLexicon
    return chosen(settings, sizes.frames, body_columns(sizes.config))


def lexicon_runner(sizes: Sizes, tensors: Tensors) -> MovementLexiconRunner:
    return MovementLexiconRunner(sizes.config.lexicon, sizes.frames, body_columns(sizes.config), tensors)


def generator(sizes: Sizes) -> FlowGenerator:
    """The generator of RG 5.2 with a head that samples by conditional flow matching (`generator.flow`)."""
    import torch

    from generator.flow import FlowGenerator
    from lexicon.movement import basis_for

    config = sizes.config
    basis = basis_for(config.lexicon, sizes.frames, body_columns(config))
    return FlowGenerator(config.generator, _widths(sizes), basis, torch.as_tensor(sizes.present))


def generator_runner(sizes: Sizes, tensors: Tensors) -> FlowRunner:
    config, parts = sizes.config, body_columns(sizes.config)
    components = {name: config.lexicon.components_of(name) for name in parts}
    basis = BasisRunner(sizes.frames, parts, components, tensors.within("basis"))
    return FlowRunner(config.generator, _widths(sizes), sizes.present, basis, tensors)


def _widths(sizes: Sizes) -> GeneratorWidths:
    config = sizes.config
    return GeneratorWidths(sizes.frames, sizes.motion, sizes.low, codebook_shape(config)[1], CONTROL_WIDTH,
                           config.lexicon.size, sizes.speakers, sum(CLASSES) if config.generator.units else 0)


def style(sizes: Sizes, reads: bool) -> UnitStyleInterpreter:
    """The style interpreter of gesture units, which takes no words."""
    from interpreters.planner import UnitStyleInterpreter

    return UnitStyleInterpreter(sizes.config.style, sizes.frames, sizes.low, sizes.speakers,
                                sizes.config.generator.style_width)


def style_runner(sizes: Sizes, reads: bool, tensors: Tensors) -> UnitStyleRunner:
    return UnitStyleRunner(sizes.config.style, sizes.frames, sizes.low, sizes.speakers,
                           sizes.config.generator.style_width, tensors)


# ----------------------------------------------------------------------------------------------------- one block

def begin(bundle: Bundle, setup: loop.Setup, text: bool, keys: loop.Keys) -> loop.State:
    """The state before the first block: the body at rest, nothing planned, nothing sampled."""
    state = loop.at_rest(bundle, setup, text, keys)
    sampler = FlowSampler(bundle, setup.speaker)
    style_state = None if sampler.style is None else sampler.style.start(setup.speaker)
    planner = bundle.runners["planner"].start(setup.speaker) if "planner" in bundle.parts else None
    roles = None if state.rest is None else Roles(setup.seed, keys.variation)
    return replace(state, planner=planner, roles=roles, generator=FlowState(sampler, style=style_state))


def step(bundle: Bundle, setup: loop.Setup, state: loop.State, request: loop.Request
         ) -> tuple[loop.BlockMotion, loop.State]:
    """The next block, and the state after it."""
    speech = request.speech
    if abs(speech.start - state.until) > loop.CONTIGUOUS:  # an offset does not fade while nothing is seen
        state = replace(state, generated=state.past, offset=None)
    if not state.keys.voice and not speech.silent[1]:
        state = listened(bundle, state, speech)
    if speech.number == 0 and speech.start == 0.0 and state.rest and not state.rest.begins_at_rest(speech.span):
        state = begun(bundle, setup, state)
    features = loop.features_of(bundle, request, state.generated)

    # 1. The planner: what the hands do in this block.
    unit, planner = decide_unit(bundle, setup, state, speech, features)
    state = replace(state, planner=planner)
    if request.keys is None and sets_out(state, speech, unit):
        state = set_out(bundle, setup, state, speech)
        features = replace(features, past=state.generated)

    # 2. Rest: whether they move at all.
    # A requested gesture is shown whatever the phase: only silent lexemes can be held.
    held = unit is not None and unit.holds and (request.lexeme is None or request.lexeme in bundle.silent)
    rested = loop.resting(bundle, setup, state, request, features, held)
    rest = rested.rest

    # 3. The lexeme: which movement, given the phase.
    scores, interpreter, unguided = loop.scores_of(bundle, setup, state, features)
    scores = within_phase(bundle, scores, unit)
    quiet = rested.closed or (features.silent and bundle.config.silence.mask)
    lexeme = loop.choose(setup, request, scores, bundle.silent if quiet else None, state.keys.voice)

    # 4. The motion: candidates from the flow generator, of which one is kept.
    keys = state.keys if request.keys is None else replace(request.keys, voice=state.keys.voice)
    offset = None if state.offset is None else state.offset.at(speech.span.times)
    shift = None if offset is None else np.concatenate([state.past - state.generated, offset])
    block, code, generator = state.generator.sampler.sample(
        state.generator, BlockToSample(speech, features, lexeme, unit, keys, shift, request.fast,
                                       rest is not None and rest.rests_wholly),
        state.generated)

    # 5. What is shown: rest, roles of the arms, idle motion, and the offset that joins it to what was shown before.
    stays = rested.closed or held or (request.still is not None and bool(request.still.any()))
    roles = state.roles and state.roles.for_block(speech.start, request.wanted, stays)
    past, motion = loop.shown(bundle, rest, block, offset, roles, request.control)
    faded = state.offset is None or state.offset.over(speech.end)
    record = loop.decided(speech, lexeme, scores, keys, rested.probability)
    after = replace(state, lexeme=lexeme, past=past, generated=past if offset is None else past - offset,
                    interpreter=interpreter, unguided=unguided, generator=generator, gate=rested.gate, unit=unit,
                    rest=rest, roles=roles, until=speech.end, offset=None if faded else state.offset)
    return loop.BlockMotion(record, lexeme, motion, code, unit), after


def motion_of(bundle: Bundle, setup: loop.Setup, blocks: Sequence[loop.BlockMotion]) -> NDArray[np.float32]:
    """[N, K, D_m] motion of all blocks of a performance."""
    return np.stack([block.motion for block in blocks])


# ----------------------------------------------------------------------------------------- the planner of gesture units

HOLD = 1.2
"""Added to the logit of a hold after a stroke: what is generated holds less than people do."""
GOES_ON_PAUSING = 0.5
"""Added to the logit of a hold in a pause that goes on: people hold at the ends of phrases."""
VOICE_RETURNS = 4.0
"""Added to the logit of a preparation in a pause that ends in the next block: people prepare before they speak."""


def phrasing(speech: SpeechBlock) -> loop.Scores:
    """[5] what is added to the planner's logits of the phases."""
    bias = np.zeros(len(PHASES))
    bias[PHASES.index("hold")] = HOLD
    if speech.quiet.mean() >= 0.5 and speech.ahead is not None:
        if speech.ahead.all():
            bias[PHASES.index("hold")] += GOES_ON_PAUSING
        else:
            bias[PHASES.index("preparation")] = VOICE_RETURNS
    return bias


def decide_unit(bundle: Bundle, setup: loop.Setup, state: loop.State, speech: SpeechBlock,
                features: BlockFeatures) -> tuple[UnitDecision | None, PlannerState | None]:
    """The planner's decision for a block, and its state after it; None without a planner. Its noise is keyed by
    seed, voice and time, so that a difference elsewhere in the recording does not change it."""
    if state.planner is None:
        return None, None
    model: PlannerRunner = bundle.runners["planner"]
    noise = loop.Keys(setup.seed, voice=state.keys.voice).plan(speech.keyed_at, sum(CLASSES))
    # Where the best lexeme is taken instead of a sample, so is the best phase.
    temperature = float(setup.temperature > 0)
    return model.step(state.planner, features, noise, temperature, phrasing(speech))


def within_phase(bundle: Bundle, scores: loop.Scores, unit: UnitDecision | None) -> loop.Scores:
    """Scores [S] plus what each lexeme is worth in the planner's phase, with the sum of probabilities as before."""
    if unit is None:
        return scores
    within = scores + bundle.runners["planner"].bias(unit)
    return within - (np.logaddexp.reduce(within) - np.logaddexp.reduce(scores))


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
_BEGINS = 0.6
"""Deviation from there where a performance begins, in deviations of the arms' joints: people begin anywhere."""
_LOUDER = 2.0
"""How much more a loud frame counts in telling voices apart: with noise at -60 dB, 12 recordings of a hundred are taken
for another voice, without it 31."""
_POSTURE = 0.8
"""Deviation of the trunk's first pose in lean, turn and tilt, in deviations of each joint."""


@dataclass(frozen=True)
class Offset:
    """The fading offset from `begin` seconds. pose: [D_m] p - h; velocity: [D_m] v, a second."""

    begin: float
    pose: Floats
    velocity: Floats

    def at(self, times: Array) -> Floats:
        """[K, D_m] at times [K], seconds."""
        s = np.clip((np.asarray(times) - self.begin) / FADES, 0.0, 1.0)
        sinks, coasts, _ = fade_weights(s)
        weights = np.stack([sinks, FADES * coasts]).astype(self.pose.dtype)[..., None]
        return weights[0] * self.pose + weights[1] * self.velocity

    def over(self, time: float) -> bool:
        """Whether it has faded at `time` seconds."""
        return time >= self.begin + FADES


def first_pose(chances: Array, posture: Array, names: Sequence[str], rest: Array) -> NDArray[np.float32]:
    """[D_m] h of a preparation, normalised: each arm is somewhere between the mean and the resting pose, or a little
    above the mean pose, by the chances [2] from 0 to 1, and the trunk in a posture [3], deviations of lean, turn and
    tilt. names: of the J joints; rest: [D_m] the normalised resting pose, three numbers a joint; 0 is the mean pose."""
    pose = np.where([[name.startswith(("Hips", "Spine"))] for name in names], _POSTURE * posture, 0.0).ravel()
    arms = [np.repeat([name.startswith(side) for name in names], 3) for side in SIDES]
    for columns, chance in zip(arms, chances, strict=True):
        pose[columns] = (_HIGHEST + (_LOWEST - _HIGHEST) * chance) * rest[columns]
    return pose.astype(np.float32)


def _first_of(bundle: Bundle, setup: loop.Setup, chances: Array, posture: Array) -> Floats:
    """[D_m] `first_pose` of the speaker, within the training data."""
    names, rest = CHARACTERS[bundle.config.motion.joints].names, bundle.rest_feature(setup.speaker).astype(float)
    return np.clip(first_pose(chances, posture, names, rest), *bundle.statistics.bounds.astype(np.float32))


def listened(bundle: Bundle, state: loop.State, speech: SpeechBlock) -> loop.State:
    """The state before the first block in which somebody speaks: chance and roles depend on the voice from here on. The
    hands are at rest until then, so no role can be seen to change."""
    # The spectra of this block and, if it is known, the next one, without the energy in the last column.
    window = slice(bundle.frames, (2 if speech.foreseen else 3) * bundle.frames)
    spectra = bundle.statistics.low.apply(speech.low)[window, :-1]
    # Loud frames count most: a little noise changes faint ones.
    loudness = np.exp(_LOUDER * spectra.mean(1))
    voice = state.keys.of_voice(loudness @ spectra / loudness.sum())
    roles = state.roles and replace(state.roles, voice=voice)
    return replace(state, keys=replace(state.keys, voice=voice), roles=roles)


def begun(bundle: Bundle, setup: loop.Setup, state: loop.State) -> loop.State:
    """The state before a first block in which somebody speaks: in a pose that the voice decides."""
    assert state.rest is not None
    names = CHARACTERS[bundle.config.motion.joints].names
    arms = np.repeat([name.endswith("Arm") for name in names], 3)
    # At a time of its own, so that no preparation has the same numbers.
    numbers = state.keys.uniform(-1.0, 5 + arms.sum())
    deviations = math.sqrt(12.0) * (numbers[2:] - 0.5)
    pose = _first_of(bundle, setup, numbers[:2], deviations[:3])
    pose[arms] += _BEGINS * deviations[3:].astype(np.float32)
    rest = state.rest.fork()
    rest.begin_in(pose.astype(np.float64))
    past = np.repeat(pose[None], bundle.frames, axis=0)
    return replace(state, past=past, generated=past, rest=rest)


def sets_out(state: loop.State, speech: SpeechBlock, unit: UnitDecision | None) -> bool:
    """Whether what was before is forgotten: the hands set out, or one stroke has followed another for long."""
    if unit is None or state.rest is None:
        return False
    return unit.begins_after(state.unit) or (unit.follows(state.unit)
                                             and speech.start - state.generator.set_out >= AFRESH)


def set_out(bundle: Bundle, setup: loop.Setup, state: loop.State, speech: SpeechBlock) -> loop.State:
    """The state in which the block is generated as the first of a performance."""
    past, time = state.past, speech.keyed_at
    velocity = (past[-1] - past[-2]) * (len(past) / speech.durations[0])
    first = _first_of(bundle, setup, state.keys.uniform(time, len(SIDES)), state.keys.posture(time))
    lexeme = bundle.rest_lexeme(setup.speaker)
    interpreter = setup.interpreter.start(setup.speaker, lexeme)
    return replace(state, offset=Offset(speech.start, past[-1] - first, velocity),
                   generated=np.repeat(first[None], len(past), axis=0), lexeme=lexeme, interpreter=interpreter,
                   unguided=interpreter,
                   # Without the blocks before, as at the start of a training window, but for the last decision and for
                   # how long speech or silence has lasted.
                   planner=None if state.planner is None else replace(state.planner, hidden=None),
                   generator=replace(state.generator, lstm=None, base=None, set_out=speech.start))


# --------------------------------------------------------------------------------------------------- the flow generator

AUDIO_GUIDANCE, LEXEME_GUIDANCE, UNIT_GUIDANCE = 0.7, 0.4, 0.5
"""Guidance on the audio, the lexeme and the planner's decision: extrapolation from the prediction without each."""
NOISE = 0.84
"""Standard deviation of the initial noise; below 1 is calmer."""
FLOW_STEPS = 3
"""Steps of the Adams method from noise to a block."""
CANDIDATES = 4
"""Candidates sampled for a block, of which the best is kept (`gesticulator.sampling.candidates`)."""
TRUNK_GUIDANCE = 0.3
"""Share of all guidance that torso and head get: full guidance makes their large turns larger than people's."""
TRUNK_NOISE, FINGER_NOISE = 0.85, 1.58
"""Factors on the noise of torso and head, and of the fingers."""
LIVELY_NOISE = 0.08
"""How much more noise the arms have the livelier the style code is: its natural logarithm, per unit of liveliness."""
WAXING = 0.8
"""Deviation of the style codes' own rise and fall over seconds."""
LIVELINESS = (1.0, 0.5, 0.5, 0.0)
"""The direction of a style code (`interpreters.planner_run.CODE`) in which gestures become livelier."""
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
    keys: loop.Keys
    shift: Floats | None = None
    fast: bool = False
    hidden: bool = False


class _Style(NamedTuple):
    """code: [d_z] the style code of a block; against: that without the planner's decision (`selection.contrast`)."""

    code: Floats
    against: Floats


@dataclass(frozen=True)
class FlowState:
    """The state of the sampler between two blocks. lstm: of the generator; base: [K, D_m] the extrapolation of the
    frames before the last block, to which its coefficients were added; both None after a fresh start. place: how long
    speech or silence has lasted. style: of the style interpreter, None without one. set_out: seconds at which the hands
    last set out."""

    sampler: FlowSampler
    lstm: tuple[Floats, Floats] | None = None
    base: Floats | None = None
    place: Circumstances = field(default_factory=Circumstances)
    style: UnitStyleState | None = None
    set_out: float = 0.0


class FlowSampler:
    """Samples blocks of one speaker from the flow generator. It has no state of its own."""

    def __init__(self, bundle: Bundle, speaker: int) -> None:
        self.generator: FlowRunner = bundle.runners["generator"]
        self.lexicon: MovementLexiconRunner = bundle.runners["lexicon"]
        self.style: UnitStyleRunner | None = bundle.runners.get("style")
        self.chooser = CandidateChooser(bundle, speaker)
        self.settings = bundle.config.selection
        self.speaker = np.eye(len(bundle.speakers), dtype=np.float32)[speaker]
        self.share = self._by_part(TRUNK_GUIDANCE)
        self.trunk = self._by_part(0.0, 1.0) == 0.0
        self.deviation = np.float32(NOISE) * self._by_part(TRUNK_NOISE, FINGER_NOISE)

    def _by_part(self, trunk: float, fingers: float = 1.0) -> Floats:
        """[n] factors on the coefficients: `trunk` for torso and head, `fingers` for fingers, 1 for the arms."""
        basis = self.generator.basis
        factors = [trunk if name in ("torso", "head") else fingers if "finger" in name else 1.0 for name in basis.parts]
        return np.repeat(np.array(factors, np.float32), basis.widths)

    def sample(self, state: FlowState, block: BlockToSample, past: Floats) -> tuple[Floats, Floats, FlowState]:
        """A block [K, D_m] after the motion past [K, D_m], its style code [d_z], and the state after it."""
        speech, basis = block.speech, self.generator.basis
        added = np.zeros(basis.width, np.float32)
        if state.base is not None:  # the motion may differ from what was sampled: rest
            added = self.generator.squeeze(basis.project(past - state.base))
        before, duration, _ = np.array(speech.durations, np.float32)
        ratio = np.asarray(duration / before)
        base = basis.base(past[-PAST:], ratio)
        where, place = state.place.step(speech.durations, speech.silent)
        if speech.foreseen and self.generator.config.after_dropout:
            where = alone(where)
        style, style_state = self._style(state.style, block)
        conditions, gains = self._conditions(block, style)
        context, lstm = self.generator.contexts(FlowConditions(
            block.features.low, before=past, ratio=ratio, added=added, place=where, speaker=self.speaker,
            **conditions), state.lstm)
        after = replace(state, lstm=lstm, base=base, place=place, style=style_state)
        if block.hidden:  # the state had to advance, but no block is needed
            return base * self.generator.present, style.code, after
        return self._sampled(block, past, base, context, gains, style.code), style.code, after

    def _sampled(self, block: BlockToSample, past: Floats, base: Floats, context: Floats, gains: list[float],
                 code: Floats) -> Floats:
        """[K, D_m] the best of several candidates, moved in time to the onsets of the sound."""
        speech, steps = block.speech, FLOW_STEPS
        pull = np.array(gains, np.float32)[:, None] * self.share
        if block.fast:
            # One candidate, few steps, no guidance.
            context, pull, steps = context[:1], pull[:0], FAST_STEPS
            _, only = self._drawn(base, context, pull, steps, self._noise(block, 1, code))
            if self.chooser.natural(self.chooser.motion(speech, past, only, block.shift)):
                return only[0]
        # What is requested of the hands can only be followed by a choice among different arms; otherwise all candidates
        # share the arms of the first. A choice of arms would turn every small change of sound into another gesture.
        same = block.features.control is None
        noise = self._noise(block, CANDIDATES, code)
        coefficients, blocks = self._drawn(base, context, pull, steps, noise, same)
        motion = self.chooser.motion(speech, past, blocks, block.shift)
        if not self.chooser.natural(motion):
            # Guidance extrapolates, now and then beyond anything in the data; so does the noise.
            further = [self._drawn(base, context[:1], pull[:0], steps, np.float32(_CALM) * noise, same)]
            if same and not block.fast:  # other arms
                further.append(self._drawn(base, context, pull, steps, np.roll(noise, -1, 0), same))
            coefficients = np.concatenate([coefficients, *(each for each, _ in further)])
            blocks = np.concatenate([blocks, *(each for _, each in further)])
            motion = self.chooser.motion(speech, past, blocks, block.shift)
        distances = self.lexicon.distances(coefficients)
        apart = distances[:, block.lexeme] / np.maximum(distances.min(-1), np.float32(_NEAREST))
        best = self.chooser.choose(speech, motion, apart, block.features.control)
        return self.chooser.retimed(speech, past, blocks[best]).astype(np.float32)

    def _drawn(self, base: Floats, context: Floats, pull: Floats, steps: int, noise: Floats, same: bool = False
               ) -> tuple[Floats, Floats]:
        """Coefficients [C, n] of candidates with noise [C, n], and the blocks [C, K, D_m] that they give over the base
        [K, D_m]. context: [1 + G, C]; pull: [G, n] of the guidance; same: all with the arms of the first."""
        noise = np.where(self.trunk, noise, noise[:1]) if same else noise
        # The arms of the first are guided by their own predictions; the trunks, which are hardly guided, by the same.
        coefficients = self.generator.sample(context, pull, noise, steps, same)
        if same:
            coefficients = np.where(self.trunk, coefficients, coefficients[:1])
        return coefficients, (base + self.generator.basis.expand(coefficients)) * self.generator.present

    def _style(self, state: UnitStyleState | None, block: BlockToSample) -> tuple[_Style, UnitStyleState | None]:
        """The style code of the block's unit: as the voice has it, as activity waxes and wanes by itself, and as far
        out as the settings say; empty without a style interpreter."""
        if self.style is None or state is None:
            none = np.zeros(0, np.float32)
            return _Style(none, none), None
        voiced, state = self.style.step(state, block.features, block.unit is not None and block.unit.rests)
        waxing = WAXING * block.keys.activity(block.speech.keyed_at)
        code = voiced + waxing * np.array(LIVELINESS, np.float32)
        if block.features.control is None:  # controls say how far out the hands are
            code = code + self.settings.reach * np.array(_OUTWARDS, np.float32)
        return _Style(code, code - self.settings.contrast * voiced), state

    def _noise(self, block: BlockToSample, candidates: int, code: Floats) -> Floats:
        """[C, n] the noise of C candidates of a block. code: [d_z] the style code."""
        noise = block.keys.noise(block.speech.keyed_at, (candidates, self.generator.basis.width)) * self.deviation
        if self.style is None:
            return noise
        direction = np.array(LIVELINESS, np.float32)
        liveliness = code @ direction / (direction @ direction)
        return np.where(self.trunk, noise, noise * np.exp(LIVELY_NOISE * liveliness))

    def _conditions(self, block: BlockToSample, style: _Style) -> tuple[dict[str, Any], list[float]]:
        """The 1 + G conditions of the flow head that differ (`FlowConditions`): the full one, and one without each of
        the G guiding inputs; and the guidance weights [G]."""
        control, gains = block.features.control, {"audio": AUDIO_GUIDANCE, "lexeme": LEXEME_GUIDANCE}
        row = None if block.unit is None or not self.generator.unit_width else block.unit.row
        if row is not None:
            gains["unit"] = UNIT_GUIDANCE
        if control is not None:
            gains["control"] = self.settings.guidance - 1.0
        gains = {condition: gain for condition, gain in gains.items() if gain}
        left_out = np.array(["", *gains])
        return {
            "without_audio": left_out == "audio",
            "lexeme": np.where(left_out == "lexeme", self.generator.lexemes, block.lexeme),
            "control": None if control is None else control * (left_out != "control")[:, None, None],
            "unit": None if row is None else row * (left_out != "unit")[:, None],
            "style": None if self.style is None else np.stack([style.against if condition == "unit" else style.code
                                                               for condition in left_out]),
        }, list(gains.values())
