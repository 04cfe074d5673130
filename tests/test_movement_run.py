"""The runners of the movement system give what its torch modules give, block by block, for any sizes and for the
shipped bundle."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from test_paper_run import EVERY, close, floats, tensors_of
from torch import nn

from data_module.layers_run import Floats
from data_module.motion.movement import Pasts
from data_module.motion.movement_run import PAST, BasisRunner
from generator.flow import FlowGenerator, FlowInputs, FlowTime
from generator.flow_run import FlowConditions, FlowRunner
from generator.settings import GeneratorConfig, GeneratorWidths
from gesticulator.bundle.bundle import Bundle, load
from gesticulator.bundle.features import CONTROL_WIDTH, body_columns
from gesticulator.bundle.files import NAMED
from interpreters.base import BlockFeatures, InterpreterSizes, pose_of
from interpreters.gate import ActivityGate
from interpreters.gate_run import GateRunner
from interpreters.lstm import InterpreterWidths, LstmInterpreter
from interpreters.lstm_run import LstmRunner
from interpreters.planner import UnitPlanner, UnitStyleInterpreter
from interpreters.planner_run import CLASSES, PlannerRunner, UnitStyleRunner
from interpreters.settings import GateConfig, LstmConfig, PlannerConfig, StyleConfig
from lexicon.movement import MovementLexicon, MovementVqVae, basis_for
from lexicon.movement_run import MovementLexiconRunner
from lexicon.settings import LexiconConfig

BLOCKS, FRAMES, AUDIO, MOTION, TEXT, SPEAKERS, LEXEMES = 30, 5, 7, 9, 4, 3, 11
PARTS = {"torso": (0, 4, 8), "left arm": (1, 2, 7), "right fingers": (3, 5, 6)}
SEEDS, COUNTS = st.integers(0, 999), st.integers(1, 20)


def filled(module: nn.Module, seed: int) -> nn.Module:
    """The module in evaluation with random weights; scales are positive, and limits wide."""
    generator = torch.Generator().manual_seed(seed)
    for name, value in module.state_dict().items():
        drawn = torch.randn(value.shape, generator=generator) * 0.3
        value.copy_(drawn.abs() + 0.3 if name.endswith(("scale", "deviation", "basis.weight")) else
                    torch.tensor([-50.0, 50.0])[:, None] + drawn if name.endswith("limits") else drawn)
    return module.eval()


@pytest.fixture(scope="module")
def shipped() -> Bundle:
    return load(NAMED["default"])


# ------------------------------------------------------------------------------------------------------------ lexicon

def same_lexicon(module: MovementLexicon, config: LexiconConfig, parts: dict[str, tuple[int, ...]], seed: int) -> None:
    tensors = tensors_of(module)
    runner = MovementLexiconRunner(config, module.frames, parts, tensors)
    tensors.finish()
    width = module.basis.motion_width
    motion, frames, ratio = (floats(seed, BLOCKS, *shape) for shape in ((module.frames, width), (PAST, width), ()))
    past = Pasts(torch.as_tensor(frames), torch.as_tensor(ratio))
    with torch.no_grad():
        base = runner.basis.base(frames, ratio)
        close(base, module.basis.base(past))
        found, wanted = runner.basis.project(motion - base), module.basis.coefficients(torch.as_tensor(motion), past)
        close(found, wanted)
        close(runner.basis.expand(found), module.basis.expand(wanted))
        wanted = module.distances(wanted)
        np.testing.assert_allclose(runner.distances(found), wanted.numpy(), atol=1e-4 * float(wanted.max()))
        close(runner.shown(), module.shown())


@EVERY
@given(st.sampled_from(("vq-vae", "k-means")), COUNTS, COUNTS, COUNTS, st.lists(COUNTS, max_size=2), SEEDS)
def test_the_lexicon(quantizer: str, size: int, code: int, components: int, levels: list[int], seed: int) -> None:
    config = LexiconConfig(quantizer=quantizer, size=size, code_width=code, hidden=8, levels=tuple(levels),
                           trunk_components=components, arm_components=components + 1, finger_components=2)
    kind = MovementVqVae if quantizer == "vq-vae" else MovementLexicon
    module = filled(kind(config, FRAMES, PARTS), seed)
    assert isinstance(module, MovementLexicon)
    same_lexicon(module, config, PARTS, seed)


def test_the_shipped_lexicon(shipped: Bundle) -> None:
    module = shipped.lexicon
    assert isinstance(module, MovementLexicon)
    same_lexicon(module, shipped.config.lexicon, body_columns(shipped.config), 1)


# ---------------------------------------------------------------------------------------------------------- generator

def same_flow(module: FlowGenerator, runner: FlowRunner, widths: GeneratorWidths, seed: int) -> None:
    """Thirty blocks under three conditions, from one state to the next, and samples of each."""
    rng, count, frames, width = np.random.default_rng(seed), 3, widths.frames, module.basis.width
    sound, before, place = (floats(seed, BLOCKS, *shape) for shape in ((3 * frames, widths.audio),
                                                                       (frames, widths.motion), (8,)))
    added, ratio = floats(seed, BLOCKS, width), np.exp(floats(seed, BLOCKS) / 4)
    lexemes, without = rng.integers(0, widths.lexemes + 1, (count, BLOCKS)), np.array([False, True, False])
    control, unit, style = (floats(seed, count, BLOCKS, *shape) for shape in (
        (frames, module.control_width), (module.unit_width,), (module.style_width,)))
    speaker, (gains, noise) = np.eye(widths.speakers, dtype=np.float32)[-1], (floats(seed, 2, width) for _ in range(2))
    each = dict.fromkeys(("control", "unit", "style"))
    each |= {name: values for name, values in (("control", control), ("unit", unit), ("style", style))
             if values.shape[-1] and rng.random() < 0.7}
    tensors = {name: None if values is None else torch.as_tensor(values) for name, values in each.items()}
    inputs = FlowInputs(torch.as_tensor(sound)[None], torch.as_tensor(lexemes), torch.as_tensor(before)[None],
                        torch.as_tensor(ratio)[None], torch.as_tensor(place)[None], torch.as_tensor(speaker)[None],
                        without_audio=torch.as_tensor(without), **tensors)
    with torch.no_grad():
        wanted, _ = module.contexts(inputs, torch.as_tensor(added)[None])
        state = None
        for n in range(BLOCKS):
            found, state = runner.contexts(FlowConditions(
                sound[n], without, lexemes[:, n], before[n], ratio[n], added[n], place[n], speaker,
                **{name: None if values is None else values[:, n] for name, values in each.items()}), state)
            close(found, wanted[:, n])
        same_samples(module, runner, found, gains, noise)


def same_samples(module: FlowGenerator, runner: FlowRunner, contexts: Floats, gains: Floats, noise: Floats) -> None:
    """The Adams method over `FlowHead` itself, context by context."""
    given, pull = torch.as_tensor(contexts), torch.as_tensor(gains)

    def v(u: torch.Tensor, time: float, shared: bool) -> torch.Tensor:
        at = FlowTime.of(torch.full((len(u), 1), time))
        one, *others = (module.head(u, at, module.head.conditions(row.expand(len(u), -1))) for row in given)
        away = sum(gain * (one - other) for gain, other in zip(pull, others, strict=True))
        return one + (away[:1] if shared else away)

    for shared in (False, True):
        u = torch.as_tensor(noise)
        slopes = [v(u, 0.0, shared)]
        for i in range(3):
            ahead = slopes[-1] if i == 0 else 1.5 * slopes[-1] - 0.5 * slopes[-2]
            slopes.append(v(u + ahead / 3, (i + 1) / 3, shared))
            u = u + (slopes[-2] + slopes[-1]) / 6
        wanted = module.stretch(u)
        np.testing.assert_allclose(runner.sample(contexts, gains, noise, 3, shared), wanted.numpy(),
                                   atol=1e-4, rtol=1e-3)
    close(runner.squeeze(wanted.numpy()), module.squeeze(wanted))


def flow_runner(module: FlowGenerator, lexicon: LexiconConfig, widths: GeneratorWidths) -> FlowRunner:
    parts, tensors = module.basis.parts, tensors_of(module)
    basis = BasisRunner(module.frames, parts, {name: lexicon.components_of(name) for name in parts},
                        tensors.within("basis"))
    runner = FlowRunner(module.config, widths, module.present.numpy(), basis, tensors)
    tensors.finish()
    return runner


@EVERY
@given(st.sampled_from(("both", "code")), st.booleans(), st.integers(0, 3), st.integers(0, 3), st.integers(1, 2),
       COUNTS, SEEDS)
def test_the_flow_generator(hears: str, control: bool, style: int, bottleneck: int, layers: int, size: int, seed: int
                            ) -> None:
    lexicon = LexiconConfig(trunk_components=4, arm_components=6, finger_components=3)
    config = GeneratorConfig(hears_through=hears, use_control=control, style_width=style, audio_bottleneck=bottleneck,
                             lstm_layers=layers, lexeme_width=size, context=size + 3, flow_width=2 * size, hidden=12,
                             motion_features=5, audio_features=4, position_width=2 * (seed % 3), groups=3, classes=4,
                             units=seed % 2 == 0, bend=4.0)
    widths = GeneratorWidths(FRAMES, MOTION, AUDIO, 1, CONTROL_WIDTH, LEXEMES, SPEAKERS, sum(CLASSES))
    module = filled(FlowGenerator(config, widths, basis_for(lexicon, FRAMES, PARTS)), seed)
    assert isinstance(module, FlowGenerator)
    same_flow(module, flow_runner(module, lexicon, widths), widths, seed)


def test_the_shipped_generator(shipped: Bundle) -> None:
    module = shipped.generator
    assert isinstance(module, FlowGenerator)
    widths = GeneratorWidths(module.frames, len(module.present), len(shipped.statistics.low.mean), 1, CONTROL_WIDTH,
                             module.lexemes, len(shipped.speakers), sum(CLASSES))
    same_flow(module, flow_runner(module, shipped.config.lexicon, widths), widths, 3)


# ------------------------------------------------------------------------------------------------------- interpreters

def features(low: Floats, **more: object) -> BlockFeatures:
    return BlockFeatures(low, low, **more)  # type: ignore[arg-type]


def same_interpreter(module: LstmInterpreter, sizes: InterpreterSizes, seed: int) -> None:
    """Thirty blocks with their words, control and pose, with sound and beside it without."""
    tensors, rng, frames = tensors_of(module), np.random.default_rng(seed), sizes.frames
    runner = LstmRunner(module.config, sizes, tensors)
    tensors.finish()
    previous = rng.integers(0, len(sizes.lexemes), BLOCKS)
    sound, text, control, past = (floats(seed, BLOCKS, *shape) for shape in (
        (3 * frames, sizes.high), (3 * frames, sizes.text), (frames, sizes.control), (frames, sizes.motion)))
    durations, speaker = rng.uniform(0.2, 0.5, (BLOCKS, 2)), sizes.speakers - 1
    who = torch.eye(sizes.speakers)[[speaker, speaker]]
    pose = torch.cat(pose_of(torch.as_tensor(past), torch.as_tensor(durations).float().T[..., None]), -1)
    with torch.no_grad():
        audio = torch.stack([torch.as_tensor(sound), torch.zeros(sound.shape)])
        logits, _ = module.scores(torch.as_tensor(previous).expand(2, -1), audio, who, None,
                                  *(torch.as_tensor(rows).expand(2, *rows.shape) for rows in (text, control)),
                                  pose.expand(2, *pose.shape))
    wanted = logits.double().log_softmax(-1)
    states = runner.start(speaker, 0), runner.start(speaker, 0)
    alone = states[0]
    for n in range(BLOCKS):
        given = features(sound[n], text=text[n], control=control[n], past=past[n],
                         durations=tuple(durations[n].tolist()))
        (with_sound, first), (without, second) = runner.step_with_and_without_sound(states, given, int(previous[n]))
        scores, alone = runner.step(alone, given, int(previous[n]))
        states = first, second
        close(with_sound, wanted[0, n])
        close(without, wanted[1, n])
        close(scores, wanted[0, n])


@EVERY
@given(st.sampled_from(("block", "frame")), st.integers(0, 4), st.integers(0, 3), st.integers(0, 3), st.booleans(),
       st.booleans(), COUNTS, SEEDS)
def test_the_lexeme_interpreter(by: str, memory: int, text: int, pose: int, speaker: bool, head: bool, width: int,
                                seed: int) -> None:
    config = LstmConfig(audio_features=5, width=width, reads_by=by, memory=memory, text_features=text,
                        text_bottleneck=seed % 3, text_head=6 if head else 0, pose_features=pose, use_speaker=speaker,
                        use_control=seed % 2 == 0, lexeme_features=seed % 4)
    sizes = InterpreterSizes(FRAMES, AUDIO, AUDIO, SPEAKERS, TEXT, CONTROL_WIDTH, MOTION, torch.zeros(LEXEMES, 6))
    module = filled(LstmInterpreter(config, sizes.lexemes, InterpreterWidths(
        FRAMES, AUDIO, SPEAKERS, TEXT, CONTROL_WIDTH, MOTION)), seed)
    assert isinstance(module, LstmInterpreter)
    same_interpreter(module, sizes, seed)


@pytest.mark.parametrize("part", ["interpreter", "interpreter_text"])
def test_the_shipped_interpreters(shipped: Bundle, part: str) -> None:
    module = shipped.trained(part)
    assert isinstance(module, LstmInterpreter) and shipped.text is not None
    width = len(shipped.statistics.high.mean)
    same_interpreter(module, InterpreterSizes(module.frames, width, width, len(shipped.speakers), shipped.text.width,
                                              CONTROL_WIDTH, len(shipped.statistics.deviation), module.lexemes), 5)


def same_heads(gate: ActivityGate, planner: UnitPlanner, style: UnitStyleInterpreter, width: int, seed: int) -> None:
    """Thirty blocks of the gate, of the planner with noise and a bias, and of style codes with rests between units."""
    rng, frames, speakers = np.random.default_rng(seed), gate.frames, gate.speakers
    sound, noise = floats(seed, BLOCKS, 3 * frames, width), rng.gumbel(size=(BLOCKS, sum(CLASSES)))
    bias, resting = rng.normal(size=CLASSES[0]), rng.random(BLOCKS) < 0.3
    audio, who = torch.as_tensor(sound)[None], torch.eye(speakers)[:1]
    groups = [tensors_of(module) for module in (gate, planner, style)]
    gates = GateRunner(gate.config, frames, width, speakers, groups[0])
    plans = PlannerRunner(planner.config, frames, width, speakers, len(planner.fit), groups[1])
    styles = UnitStyleRunner(style.config, frames, width, speakers, style.code_width, groups[2])
    for tensors in groups:
        tensors.finish()
    with torch.no_grad():
        opened, _ = gate.logits(audio, who)
        predicted, _ = style.predict(audio, who)
    gate_state, plan_state, style_state = gates.start(0), plans.start(0), styles.start(0)
    before, decided, unit = [CLASSES], list[tuple[int, ...]](), list[torch.Tensor]()
    for n in range(BLOCKS):
        probability, gate_state = gates.step(gate_state, features(sound[n]))
        close(probability, opened[0, n].sigmoid())
        decision, plan_state = plans.step(plan_state, features(sound[n], durations=(0.3, 0.7)), noise[n], 0.8, bias)
        decided.append((decision.phase, decision.hand, decision.size, decision.apex))
        before.append(decided[-1])
        close(plans.bias(decision), planner.fit[:, decision.phase * 4 + decision.hand])
        code, style_state = styles.step(style_state, features(sound[n]), bool(resting[n]))
        unit = [] if resting[n] else [*unit, predicted[0, n]]
        close(code, (style.gain * torch.stack(unit).mean(0)).clamp(-2.5, 2.5) if unit else 0 * style.gain)
    # The planner's decisions, given those before, are the best of its distribution plus noise.
    given, history = torch.tensor(decided)[None], torch.tensor(before[:-1])[None]
    with torch.no_grad():
        state, hidden = planner.encode_speech(audio, who, history)
        close(plan_state.hidden, hidden[0])
        at = 0
        for level, count in enumerate(CLASSES):
            scores = planner.logits(state, level, given)[0].double().numpy()
            if level == 0:
                raised = np.isin(history[0, :, 0], (2, 3))
                scores = scores + np.where(raised[:, None] | (np.arange(count) != 3), bias, 0.0)
            scores = scores / 0.8 + noise[:, at:at + count]
            chosen = np.take_along_axis(scores, np.array(decided)[:, level:level + 1], 1)[:, 0]
            assert (chosen >= scores.max(1) - 1e-4).all()
            at += count


@EVERY
@given(st.integers(0, 3), COUNTS, st.booleans(), SEEDS)
def test_gate_planner_and_style(bottleneck: int, width: int, speaker: bool, seed: int) -> None:
    gate = ActivityGate(GateConfig(audio_features=4, audio_bottleneck=bottleneck, width=width), FRAMES, AUDIO, SPEAKERS)
    planner = UnitPlanner(PlannerConfig(audio_features=4, audio_bottleneck=bottleneck, width=width, embedding=3),
                          FRAMES, AUDIO, SPEAKERS, LEXEMES)
    style = UnitStyleInterpreter(StyleConfig(audio_features=4, audio_bottleneck=bottleneck, width=width,
                                             use_speaker=speaker), FRAMES, AUDIO, SPEAKERS, 4)
    for module in (gate, planner, style):
        filled(module, seed)
    same_heads(gate, planner, style, AUDIO, seed)


def test_the_shipped_gate_planner_and_style(shipped: Bundle) -> None:
    gate, planner, style = (shipped.trained(name) for name in ("gate", "planner", "style"))
    same_heads(gate, planner, style, len(shipped.statistics.low.mean), 7)
