"""The loop over blocks, the same for a file, a stream and an edited plan (RG 6, Eq. 15; RACER 4.3).

A state is a value: `step` takes one and returns the motion of the next block and the state after it, and leaves the
given state as it was. To go back to an earlier block, or to try another way, take an older state.

    state = begin(bundle, setup)
    for i in range(len(encoded)):
        block, state = step(bundle, setup, state, Request(encoded.block(i)))

What a step does is the system's: `gesticulator.systems.paper`, `.movement` and `.racer`. The parts of a step that they
share are below.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from data_module.controls import Controls, Levels
from data_module.layers_run import Floats
from data_module.motion.skeletons import CHARACTERS
from data_module.types import Array, Blocks
from gesticulator.body import roles as arm_roles
from gesticulator.body.life import SIDES, VOICE_BITS, normal
from gesticulator.body.rest import Rest, RestKnots
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import Flags, Span, SpeechBlock, SpeechFeatures, control_rows, representation_of
from gesticulator.plan.plan import Block, BlockDraw, Flag, LexemeChoice
from interpreters.base import BlockFeatures, Interpreter, select

if TYPE_CHECKING:
    from gesticulator.sampling.cutter import BlockCutter
    from interpreters.planner_run import UnitDecision

OnBlock = Callable[[int, int], None]
"""Called after each block with the number of finished blocks and the total."""
ControlRows = NDArray[np.float32]
"""[K, 2 F] or [N, K, 2 F]: standardised control features, and whether each is given (`control_rows`)."""
Scores = NDArray[np.float64]
"""[S] log-probabilities or Q values of the lexemes."""

BEST = 5
"""Number of alternative lexemes stored for a block."""
CONTIGUOUS = 1e-3
"""Most seconds between two blocks without a gap."""
_MILLISECONDS = 100
"""Milliseconds between independent numbers: half of the shortest block."""
_MOTION, _CHOICE = 0, 1
_POSE, _PLAN, _ACTIVITY, _POSTURE, _VOICE = range(1 << 20, (1 << 20) + 5)
"""Kinds of numbers: of motion, choice of lexemes, first poses, planner, activity, posture and what sound decides."""
_WAXES, _LEANS = 3000, 4000
"""Milliseconds between independent numbers of activity and of posture: both wax and wane over a few seconds."""
ELBOW = np.radians((6.0, 140.0, 10.0))
"""Least and greatest bend of an elbow, and the last part of either, in which it is slowed, radians."""
_VOICES = 64
"""Patterns that voices are told apart by: with more, the same sound as an MP3 is more often taken for another."""
_CHANNELS = 1 << 32
"""The first channel of `life.mixed` here; the idle motion and the choice of phrases use lower ones."""


@dataclass(frozen=True)
class Keys:
    """Keys of the random numbers of blocks, besides their time: seed and variation of the performance.

    No generator of random numbers runs along: each number is a function of its keys, so a file, a stream and an edited
    plan sample alike, and so do two recordings that differ somewhere else. The numbers change gradually with time: with
    g_k independent and standard normal, one for each 0.1 s of media time,

        z(t) = cos(a) g_k + sin(a) g_{k + 1},   k = floor(t / 0.1),   a = (t / 0.1 - k) pi / 2,

    which is standard normal at every t, independent for blocks that begin 0.2 s or more apart, and nearly the same
    (r = .99) for one that begins 10 ms later because a beat was detected later.

    voice: what the first words sound like (`of_voice`), 0 until somebody has spoken; else two recordings would show the
    same gestures at the same second, and their trunks would lean alike.
    """

    seed: int
    variation: int = 0
    voice: int = 0

    def noise(self, time: float, shape: tuple[int, int]) -> NDArray[np.float32]:
        """Standard normal noise of the motion of the block that begins at `time` seconds, of this shape."""
        # Row by row, so that the first candidate is the same for any number of them.
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
        return np.exp(_log_normal(self._normal(_POSE, time, count)))

    def activity(self, time: float) -> float:
        """A standard normal number that changes over seconds: how lively the gestures are at `time`."""
        return float(self._normal(_ACTIVITY, time, 1, _WAXES)[0])

    def posture(self, time: float) -> Array:
        """[3] standard normal numbers that change over seconds: how the trunk leans, turns and tilts at `time`."""
        return self._normal(_POSTURE, time, 3, _LEANS)

    def of_voice(self, spectrum: Array) -> int:
        """1 to 64, which of as many random patterns the shape of a spectrum [B] in decibels or the like is nearest to.
        An MP3 of a sound has nearly always the number of the sound itself (r = .999), another voice or word (r < .8)
        seldom; the level does not matter."""
        patterns = Keys(self.seed)._normal(_VOICE, 0.0, _VOICES * len(spectrum)).reshape(_VOICES, -1)
        return 1 + int((patterns @ (spectrum - spectrum.mean())).argmax())

    def _normal(self, kind: int, time: float, count: int, apart: int = _MILLISECONDS) -> Array:
        """[count] standard normal numbers at a time in seconds; times within a millisecond are the same. apart:
        milliseconds between independent numbers."""
        cell, rest = divmod(round(time * 1000), apart)
        numbers = cell * count + np.arange(2 * count)
        both = normal(self.seed, _CHANNELS + 2 * self.variation + kind + (self.voice << VOICE_BITS), numbers)
        angle = 0.5 * math.pi * rest / apart
        return math.cos(angle) * both[:count] + math.sin(angle) * both[count:]


def _gumbel(normal_numbers: Array) -> Array:
    return -np.log(-_log_normal(normal_numbers))


def _log_normal(numbers: Array) -> Array:
    """[M] the logarithm of the standard normal distribution function."""
    # The smaller of the two tails, so that no digit is lost; the import of scipy.special takes twice numpy's time.
    tails = 0.5 * np.array(list(map(math.erfc, (np.abs(numbers) * math.sqrt(0.5)).tolist())))
    return np.where(numbers > 0.0, np.log1p(-tails), np.log(tails))


@dataclass(frozen=True)
class Setup:
    """All about a performance that was resolved and checked once, before its first block. speaker: index.
    temperature: of the choice of lexemes, 0 takes the best. seed: of the random numbers; variation: selects other
    motion for the same lexemes. activity: share of the speaking time with gestures, 0 to 1. text: words are read."""

    interpreter: Interpreter
    speaker: int
    temperature: float
    seed: int
    activity: float = 1.0
    controls: Controls = field(default_factory=Controls)
    variation: int = 0
    text: bool = False

    @property
    def score_is(self) -> str:
        """The kind of the interpreter's scores."""
        return "Q value" if self.interpreter.gives_values else "log-probability"


@dataclass(frozen=True)
class Request:
    """Everything that a block depends on, apart from the blocks before it. control: rows [K, 2 F], or None. lexeme: the
    lexeme to show; None lets the interpreter choose. keys: of the noise and the choice of an edited block; None for
    those of the performance. still: [K] frames in which the hands are to rest, or None. fast: sample at lower cost, if
    the system can. wanted: the lexeme is not the interpreter's but somebody's wish, so both arms must show it."""

    speech: SpeechBlock
    control: ControlRows | None = None
    lexeme: int | None = None
    keys: Keys | None = None
    still: Flags | None = None
    fast: bool = False
    wanted: bool = False


@dataclass(frozen=True)
class State:
    """The state of a performance between two blocks. keys: of the noise of its motion. text: whether the blocks come
    with words. lexeme: of the block before. past: [K, D_m] the motion last shown, without idle motion; generated:
    [K, D_m] the same as the generator sees it; offset: what lies between the two and fades, or None. interpreter,
    unguided, generator, planner, gate: states of the models; unguided is that of the interpreter without the style
    control. unit: the planner's decision for the block before. rest: decides when and how the hands rest; never
    changed, only copied. roles: of the arms, or None. quiet: number of quiet blocks in a row. until: seconds, end of
    the block before. varied: the state of the variation whose motion is shown, if it is another than this one."""

    keys: Keys
    text: bool
    lexeme: int
    past: Floats
    generated: Floats
    interpreter: Any
    unguided: Any
    offset: Any = None
    generator: Any = None
    planner: Any = None
    gate: Any = None
    unit: UnitDecision | None = None
    rest: Rest | None = None
    roles: arm_roles.Roles | None = None
    quiet: int = 0
    until: float = 0.0
    varied: State | None = None


@dataclass(frozen=True)
class BlockMotion:
    """A generated block. block: the block of the plan, without names of lexemes (`plan.named`). lexeme: the
    one that is shown; where the hands are to rest, an edited plan may hold another. motion: [K, D_m] features with rest
    and idle motion. code: [d_z] style code. unit: the decision of the planner of gesture units; None without one."""

    block: Block
    lexeme: int
    motion: NDArray[np.float32]
    code: NDArray[np.float32]
    unit: UnitDecision | None = None


@dataclass(frozen=True)
class GeneratedMotion:
    """A recording's N generated blocks and their normalised motion [N, K, D_m]. cut: the N blocks of its speech."""

    cut: Blocks
    blocks: Sequence[BlockMotion]
    motion: NDArray[np.float32]


@dataclass(frozen=True)
class Generation:
    """A generated recording from which edits start. speech: its features; blocks: its N blocks; states: [N + 1] the
    state before each of them, and after the last; cutters: copies of the cutter of its speech
    (`gesticulator.editing.render.Recutter`)."""

    speech: SpeechFeatures
    blocks: Sequence[BlockMotion]
    states: Sequence[State]
    cutters: Sequence[BlockCutter] = ()


# ------------------------------------------------------------------------------------------------------------ the loop

def begin(bundle: Bundle, setup: Setup, text: bool = False, keys: Keys | None = None) -> State:
    """The state before the first block, at rest. text: the blocks come with words. keys: of the noise, if not those of
    the setup. A setup with a variation chooses its lexemes as without one, and shows the motion of a second state."""
    # A variation runs beside the plain performance, whose lexemes it shows.
    start: Callable[..., State] = bundle.system.begin
    if setup.variation:
        varied = start(bundle, setup, text, Keys(setup.seed, setup.variation))
        return replace(start(bundle, setup, text, Keys(setup.seed)), varied=varied)
    return start(bundle, setup, text, keys or Keys(setup.seed))


def step(bundle: Bundle, setup: Setup, state: State, request: Request) -> tuple[BlockMotion, State]:
    """The next block, and the state after it."""
    block, after = bundle.system.step(bundle, setup, state, request)
    if state.varied is None:
        return block, after
    # The lexeme is given, so both states hear the same decisions and move otherwise.
    varied, varied_after = bundle.system.step(bundle, setup, state.varied, replace(request, lexeme=block.lexeme))
    return varied, replace(after, varied=varied_after)


def idle(bundle: Bundle, state: State, start: float, seconds: float, knots: int) -> tuple[NDArray[np.float32], State]:
    """[knots, D_m] frames of rest at intervals of `seconds`, the first one interval after `start`, and the state after
    them; of a bundle that rests by phrases."""
    assert state.rest is not None
    rest = state.rest.fork()
    # All frames are silent: the same rules of rest as in a pause of speech.
    rest.rest(Span(start, seconds * knots, np.ones(knots, bool)))
    past, motion = shown(bundle, rest, np.repeat(state.past[-1:], knots, axis=0), roles=state.roles)
    past = np.concatenate([state.past, past])[-len(state.past):]
    varied = state.varied
    if varied is not None:
        motion, varied = idle(bundle, varied, start, seconds, knots)
    return motion, replace(state, past=past, generated=past, offset=None, rest=rest, varied=varied)


def break_off(state: State, knots: RestKnots, time: float) -> State:
    """Back at these knots (K or more), going to rest from there at once; time: of the interruption, seconds."""
    assert state.rest is not None
    frames = len(state.past)
    # The generator needs a whole block of past; before the first knot the pose stands still.
    before = np.repeat(knots.poses[:1], max(frames - len(knots.poses), 0), axis=0)
    past = np.concatenate([before, knots.poses[-frames:]]).astype(np.float32)
    rest = state.rest.fork()
    rest.break_off(knots, time)
    varied = None if state.varied is None else break_off(state.varied, knots, time)
    return replace(state, past=past, generated=past, offset=None, rest=rest, varied=varied)


def knots_of(state: State, times: Array) -> RestKnots:
    """The frames last shown, without idle motion, as knots at `times` [M] seconds, the times of the last M of them."""
    state = state.varied or state
    assert state.rest is not None
    return RestKnots(times, state.past[-len(times):], state.rest.gains)


def controls_at(levels: Levels | None, controls: Controls, times: Array) -> ControlRows | None:
    """[K, 2 F] rows of the controls at `times` [K] seconds; None without controls."""
    if levels is None or controls == Controls():
        return None
    # Controls are read at the frames, so a curve changes within a block.
    values, given = controls.at(times)
    return control_rows(levels, values, np.broadcast_to(given, values.shape))


# ------------------------------------------------------------------------------------------------- parts of the systems

def at_rest(bundle: Bundle, setup: Setup, text: bool, keys: Keys) -> State:
    """The state before the first block, without those of generator and planner."""
    speaker, config = setup.speaker, bundle.config
    # The first choice is conditioned on rest (a_0, s_0), as in the papers.
    lexeme = bundle.rest_lexeme(speaker)
    past = np.repeat(bundle.rest_feature(speaker)[None], bundle.frames, axis=0)
    interpreter = setup.interpreter.start(speaker, lexeme)
    # Its weights are opened here, which a run at full activity does not need.
    gate = bundle.runners["gate"].start(speaker) if setup.activity < 1 and "gate" in bundle.parts else None
    rest = Rest(bundle.statistics, representation_of(config), speaker, setup.activity,
                setup.seed) if bundle.config.rests_by_phrase else None
    return State(keys, text, lexeme, past, past, interpreter, interpreter, gate=gate, rest=rest)


def features_of(bundle: Bundle, request: Request, past: Floats | None = None) -> BlockFeatures:
    """The models' inputs of a block; past: [K, D_m] the motion before it."""
    s, config, speech = bundle.statistics, bundle.config, request.speech
    low, high = s.low.apply(speech.low).astype(np.float32), s.high.apply(speech.high).astype(np.float32)
    if speech.foreseen:  # a model trained with dropout of the next block gets none rather than an incomplete one
        after = 2 * bundle.frames
        if config.generator.after_dropout:
            low[after:] = 0.0
        if config.interpreter.after_dropout:
            high[after:] = 0.0
    return BlockFeatures(low, high, speech.silent[1], speech.text, request.control, past, speech.durations[:2])


@dataclass(frozen=True)
class Resting:
    """Whether the hands rest in a block. closed: in half of it or more; probability: of the gate that they gesture, NaN
    without a gate; gate, rest: the states after the decision."""

    closed: bool
    probability: float
    gate: Any
    rest: Rest | None


def resting(bundle: Bundle, setup: Setup, state: State, request: Request, features: BlockFeatures, held: bool = False
            ) -> Resting:
    """Decide whether the hands rest: by the gate, by pauses and phrases, and where it is requested; held: they hold a
    gesture throughout."""
    closed, probability, gate = setup.activity == 0, math.nan, state.gate
    still = np.ones(bundle.frames, bool) if held else request.still
    if gate is not None:
        probability, gate = bundle.runners["gate"].step(gate, features)
        closed = closed or probability < 1 - setup.activity
    if state.rest is None:
        return Resting(closed or (still is not None and bool(still.mean() >= 0.5)), probability, gate, None)
    rest = state.rest.fork()
    return Resting(rest.analyse(request.speech.span, probability, still, held), probability, gate, rest)


def scores_of(bundle: Bundle, setup: Setup, state: State, features: BlockFeatures) -> tuple[Scores, Any, Any]:
    """[S] scores of the interpreter, and its states after the block, with and without the style control. With a control
    the scores are extrapolated from those without it (classifier-free guidance)."""
    interpreter = setup.interpreter
    scores, after = interpreter.step(state.interpreter, features, state.lexeme)
    if features.control is None or "control" not in interpreter.needs:
        return scores, after, state.unguided
    # A second state without the control, because guidance needs both predictions at each step.
    free, unguided = interpreter.step(state.unguided, replace(features, control=None), state.lexeme)
    return free + bundle.config.selection.guidance * (scores - free), after, unguided


def choose(setup: Setup, request: Request, scores: Scores, allowed: NDArray[np.int64] | None = None, voice: int = 0
           ) -> int:
    """The lexeme of a block: the requested one, or one sampled from scores [S], among `allowed`, if given. voice: of
    its `Keys`."""
    if request.lexeme is not None:
        return request.lexeme
    # A variation has the lexemes of the first performance, unless the block was edited.
    keys = replace(request.keys or Keys(setup.seed), voice=voice)
    return select(scores, allowed=allowed, temperature=setup.temperature,
                  noise=keys.gumbel(request.speech.keyed_at, len(scores)))


def shown(bundle: Bundle, rest: Rest | None, block: Floats, offset: Floats | None = None,
          roles: arm_roles.Roles | None = None, control: ControlRows | None = None) -> tuple[Floats, Floats]:
    """The motion [K, D_m] that becomes the past of the next block, and the frames [K, D_m] to show, of a generated
    block [K, D_m]; offset: [K, D_m] to add to it, or None; roles: of the arms, or None; control: rows [K, 2 F], or
    None. `rest`, which heard the block, goes on."""
    # Stay within the training data: the models' input must not drift away from it, pose by pose.
    block = np.clip(block, *bundle.statistics.bounds.astype(np.float32))
    if rest is None:
        return block, block
    if offset is not None:
        block = block + offset
    block = _hinged(bundle, rest.speaker, block)
    # Rest shapes what the generator continues from; idle motion is only laid over what is shown.
    past = rest.step(block).astype(np.float32)
    displayed = past
    if roles is not None:
        # The generator goes on from what it drew: roles are laid over it, so they never add up.
        height = 0.0 if control is None else control[:, 0].astype(np.float64)
        displayed = _hinged(bundle, rest.speaker, arm_roles.shown(
            roles, bundle.statistics, rest.speaker, CHARACTERS[bundle.config.motion.joints].names, rest.times,
            past.astype(np.float64), height).astype(np.float32))
    return past, rest.alive(displayed).astype(np.float32)


def _hinged(bundle: Bundle, speaker: int, block: Floats) -> Floats:
    """A block [K, D_m] whose elbows bend as people's do: neither backwards nor until the hand is at the shoulder."""
    statistics, columns = bundle.statistics, _hinges(bundle.config.motion.joints)
    signs, scale, mean = np.array([1.0, -1.0]), statistics.deviation[columns], statistics.mean_pose[speaker][columns]
    bends = signs * (block[:, columns] * scale + mean)
    low, high, ease = ELBOW
    inside, out = np.clip(bends, low + ease, high - ease), block.copy()
    out[:, columns] = (signs * (inside + ease * np.tanh((bends - inside) / ease)) - mean) / scale
    return out


@cache
def _hinges(joints: int) -> list[int]:
    """The columns of the bends of both elbows."""
    return [3 * CHARACTERS[joints].names.index(side + "ForeArm") + 1 for side in SIDES]


def decided(speech: SpeechBlock, lexeme: int, scores: Scores, keys: Keys, gate: float = math.nan) -> Block:
    """The block of a plan that records the choice of a lexeme. scores: [S] of the interpreter; alternatives are ordered
    by score, equal ones by number; gate: the gate's probability, NaN without a gate."""
    # Stable, so equal scores come in the order of their numbers on every machine.
    best = np.argsort(-scores, kind="stable")[:BEST].tolist()
    draw = BlockDraw(keys.seed, keys.variation, speech.number)
    block = Block(speech.start, speech.end, lexeme, speech.silent[1], draw, cast(Flag, speech.flag.name.lower()),
                  gate=None if math.isnan(gate) else gate,
                  alternatives=tuple(LexemeChoice(n, "", float(scores[n])) for n in best))
    # An edit may ask for a lexeme that the interpreter rules out.
    return replace(block, score=float(scores[lexeme]), rank=int(np.sum(scores >= scores[lexeme]))) \
        if np.isfinite(scores[lexeme]) else block
