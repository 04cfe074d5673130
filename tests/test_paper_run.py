"""The runners of the paper's system give what its torch modules give, block by block, for any sizes and for the shipped
bundles."""

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from runners import sizes_for, tensors_of
from torch import nn

from data_module.layers_run import Floats
from data_module.speech.speech_encoder import SpeechEncoder
from data_module.speech.speech_encoder_run import SpeechEncoderRunner
from generator.model import BlockInputs, Generator
from generator.model_run import GeneratorRunner
from generator.settings import GeneratorConfig, GeneratorWidths
from gesticulator.bundle.bundle import Bundle, load
from gesticulator.bundle.files import NAMED
from gesticulator.bundle.models import interpreter_sizes
from interpreters.base import BlockFeatures
from interpreters.cql import QNetwork
from interpreters.cql_run import QRunner
from interpreters.lstm import StyleInterpreter
from interpreters.settings import QConfig, StyleConfig
from interpreters.style_run import StyleRunner
from lexicon.autoencoder import Lexicon
from lexicon.autoencoder_run import LexiconRunner
from lexicon.settings import LexiconConfig

BLOCKS, FRAMES, AUDIO, MOTION, CODE, TEXT, SPEAKERS, LEXEMES = 30, 5, 7, 6, 9, 4, 3, 11
SEEDS = st.integers(0, 999)
SIZES = sizes_for(FRAMES, AUDIO, np.zeros((LEXEMES, CODE)), SPEAKERS)
EVERY = settings(deadline=None, max_examples=15)


def filled(module: nn.Module, seed: int) -> nn.Module:
    """The module in evaluation with random weights, variances and counts."""
    generator = torch.Generator().manual_seed(seed)
    for name, value in module.state_dict().items():
        if value.is_floating_point():
            value.copy_(torch.rand(value.shape, generator=generator) + 0.5 if "var" in name else
                        torch.randn(value.shape, generator=generator) * 0.3)
    return module.eval()


def floats(seed: int, *shape: int) -> Floats:
    return np.random.default_rng(seed).standard_normal(shape).astype(np.float32)


def features(low: Floats, silent: bool = False, text: Floats | None = None) -> BlockFeatures:
    return BlockFeatures(low, low, silent, text)  # type: ignore[arg-type]


def close(found: object, wanted: torch.Tensor) -> None:
    np.testing.assert_allclose(np.asarray(found), wanted.detach().numpy(), atol=1e-4, rtol=1e-5)


# --------------------------------------------------------------------------------------------------------- generator

def same_motion(module: Generator, runner: GeneratorRunner, seed: int, audio: int, lexeme: int, control: int) -> None:
    """Thirty blocks in sequence, each from the block before."""
    frames, motion, style = module.frames, len(module.present), module.config.style_width
    sound, names, codes = (floats(seed, 1, BLOCKS, *shape) for shape in ((3 * frames, audio), (lexeme,), (style,)))
    controls, past = floats(seed, 1, BLOCKS, frames, control), floats(seed, 1, frames, motion)
    given_ = BlockInputs(*map(torch.as_tensor, (sound, names, codes)), torch.as_tensor(controls) if control else None)
    with torch.no_grad():
        wanted, _ = module.roll_out(torch.as_tensor(past), given_)
    state, before, blocks = runner.start(past[0, -1], names[0, 0]), past[0], []
    for n in range(BLOCKS):
        before, state = runner.step(before, runner.encode_audio(sound[0, n]), names[0, n], codes[0, n], state,
                                    controls[0, n] if control else None)
        blocks.append(before)
    close(np.stack(blocks), wanted[0])


@EVERY
@given(st.integers(1, 3), st.sampled_from([0, 4]), st.sampled_from([0, 6]), st.booleans(), SEEDS)
def test_thirty_blocks_of_the_generator(layers: int, width: int, position: int, control: bool, seed: int) -> None:
    config = GeneratorConfig(motion_features=8, audio_features=6, audio_bottleneck=width, style_width=width,
                             position_width=position, hidden=24, groups=4, classes=8, lstm_width=24,
                             lstm_layers=layers, use_control=control)
    widths = GeneratorWidths(FRAMES, MOTION, AUDIO, CODE, 4)
    present = torch.tensor([1.0, 0, 1, 1, 1, 0])
    module = filled(Generator(config, widths, 0, present), seed)
    tensors = tensors_of(module)
    runner = GeneratorRunner(config, widths, present.numpy(), tensors)
    tensors.finish()
    same_motion(module, runner, seed, AUDIO, CODE, 4 if control else 0)


@EVERY
@given(st.sampled_from([0, 3]), st.sampled_from([0, 5]), st.booleans(), SEEDS)
def test_thirty_codes_of_the_style_interpreter(text: int, bottleneck: int, speaker: bool, seed: int) -> None:
    config = StyleConfig(audio_features=6, audio_bottleneck=bottleneck, width=13, text_features=text,
                         text_bottleneck=bottleneck if text else 0, use_speaker=speaker)
    module = filled(StyleInterpreter(config, FRAMES, AUDIO, torch.randn(LEXEMES, CODE), 8, SPEAKERS, TEXT), seed)
    tensors = tensors_of(module)
    runner = StyleRunner(config, sizes_for(FRAMES, AUDIO, np.zeros((LEXEMES, CODE)), SPEAKERS, TEXT), 8, tensors)
    tensors.finish()
    same_codes(module, runner, seed)


def same_codes(module: StyleInterpreter, runner: StyleRunner, seed: int) -> None:
    encode = module.encode_audio.narrow or module.encode_audio.linear
    width = encode.in_features // (1 if module.encode_audio.narrow else 3 * module.frames)
    audio, words = floats(seed, BLOCKS, 3 * module.frames, width), floats(seed + 1, BLOCKS, 3 * module.frames, TEXT)
    one_hot = nn.functional.one_hot(torch.tensor([1]), module.speakers).float()
    state, hidden, code = runner.start(1), None, torch.zeros(1, 1, module.code_width)
    for n in range(BLOCKS):
        with torch.no_grad():
            code, hidden = module.codes(code, torch.tensor([[n % 11]]), torch.as_tensor(audio[None, None, n]), one_hot,
                                        hidden, torch.as_tensor(words[None, None, n]))
        found, state = runner.step(state, features(audio[n], text=words[n]), n % 11)
        close(found, code[0, 0])


@EVERY
@given(st.lists(st.integers(1, 9), min_size=1, max_size=4), SEEDS)
def test_every_lexeme_is_decoded(widths: list[int], seed: int) -> None:
    config, present = LexiconConfig(size=LEXEMES, code_width=CODE, widths=tuple(widths)), torch.ones(MOTION)
    module = filled(Lexicon(config, FRAMES, MOTION, present), seed)
    tensors = tensors_of(module)
    runner = LexiconRunner(config, FRAMES, present.numpy(), tensors)
    tensors.finish()
    close(runner.shown(), module.shown())


@EVERY
@given(st.integers(1, 24), st.integers(1, 4), st.integers(465, 4000), SEEDS)
def test_levels_of_the_speech_encoder(width: int, frames: int, length: int, seed: int) -> None:
    module = filled(SpeechEncoder(width), seed)
    tensors = tensors_of(module)
    runner = SpeechEncoderRunner(width, tensors)
    tensors.finish()
    sound = floats(seed, 2, length)
    with torch.no_grad():
        wanted = module.levels(torch.as_tensor(sound), frames, range(1, 9))
    for found, level in zip(runner.levels(sound, frames, range(1, 9)), wanted, strict=True):
        close(found, level)


# ------------------------------------------------------------------------------------------------- Q-network, critics

def q_inputs(seed: int, lexemes: int, speakers: int, frames: int, audio: int) -> tuple[torch.Tensor, ...]:
    """Previous lexemes, audio windows, a speaker and silence of thirty decisions."""
    rng = np.random.default_rng(seed)
    one_hot = nn.functional.one_hot(torch.tensor([speakers - 1]), speakers).float()
    return (torch.as_tensor(rng.integers(lexemes, size=(1, BLOCKS))),
            torch.as_tensor(floats(seed, 1, BLOCKS, 3 * frames, audio)), one_hot,
            torch.as_tensor(rng.random((1, BLOCKS)) < 0.3))


@EVERY
@given(st.integers(1, 40), st.integers(1, 3), st.sampled_from([1, 3]), st.booleans(), SEEDS)
def test_thirty_decisions_of_the_q_network_before_and_after_its_window_slides(
        decisions: int, layers: int, blocks: int, speaker: bool, seed: int) -> None:
    config = QConfig(width=12, heads=3, layers=layers, decisions=decisions, audio_features=4, audio_blocks=blocks,
                     audio_bottleneck=5, use_speaker=speaker)
    module = filled(QNetwork(config, FRAMES, AUDIO, LEXEMES, SPEAKERS), seed)
    tensors = tensors_of(module)
    runner = QRunner(config, SIZES, tensors)
    tensors.finish()
    same_values(module, runner, q_inputs(seed, LEXEMES, SPEAKERS, FRAMES, AUDIO))


def same_values(module: QNetwork, runner: QRunner, inputs: tuple[torch.Tensor, ...]) -> None:
    previous, audio, one_hot, silent = inputs
    with torch.no_grad():
        wanted = module.values(*inputs)[0]
    state = runner.start(one_hot.shape[1] - 1, 0)
    for n in range(BLOCKS):
        found, state = runner.step(state, features(audio[0, n].numpy(), bool(silent[0, n])), int(previous[0, n]))
        close(found, wanted[n])


# --------------------------------------------------------------------------------------------------- shipped bundles

def test_the_parts_of_the_shipped_bundles() -> None:
    paper, default = load(NAMED["paper"]), load(NAMED["default"])
    config, frames = paper.config, paper.frames
    low, lexemes = len(paper.statistics.low.mean), paper.vectors.shape
    generator, style, lexicon, encoder = paper.generator, paper.style, paper.lexicon, paper.encoder
    assert isinstance(generator, Generator) and isinstance(style, StyleInterpreter) and isinstance(lexicon, Lexicon)
    widths = GeneratorWidths(frames, generator.to_motion.out_features, low, lexemes[1], 0)
    runner = GeneratorRunner(config.generator, widths, generator.present.numpy(), tensors_of(generator))
    same_motion(generator, runner, 1, low, lexemes[1], 0)
    assert encoder is not None
    sound = 0.1 * floats(2, 2, 3 * frames * 800)
    for found, wanted in zip(SpeechEncoderRunner(encoder.width, tensors_of(encoder)).levels(sound, 3 * frames),
                             encoder.levels(torch.as_tensor(sound), 3 * frames), strict=True):
        close(found, wanted)
    close(LexiconRunner(config.lexicon, frames, lexicon.present.numpy(), tensors_of(lexicon)).shown(), lexicon.shown())
    for bundle, name, settings_ in ((paper, "q_network", config.cql), (paper, "q_network_literal", config.cql_literal),
                                    (default, "q_network", default.config.cql)):
        module = bundle.trained(name)
        assert isinstance(module, QNetwork)
        same_values(module, QRunner(settings_, interpreter_sizes(bundle.sizes), tensors_of(module)), inputs_of(bundle))
    sizes = interpreter_sizes(paper.sizes)
    same_codes(style, StyleRunner(config.style, sizes, style.code_width, tensors_of(style)), 5)


def sizes_of(bundle: Bundle) -> tuple[int, int, int, int]:
    """Frames, width of the audio, lexemes and speakers."""
    return bundle.frames, len(bundle.statistics.high.mean), len(bundle.vectors), len(bundle.speakers)


def inputs_of(bundle: Bundle) -> tuple[torch.Tensor, ...]:
    frames, audio, lexemes, speakers = sizes_of(bundle)
    return q_inputs(3, lexemes, speakers, frames, audio)
