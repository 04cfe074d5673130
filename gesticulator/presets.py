"""The presets: settings that belong together, each with the reason where it differs from what is published.

A value without a comment is the paper's, or is said on its field (`gesticulator.config` and the `settings` of the
models).
"""

from __future__ import annotations

import dataclasses

from data_module.errors import InputError
from gesticulator.config import (
    NOT_TRAINED,
    BeatSettings,
    BlockSettings,
    Config,
    EncoderConfig,
    EpisodeConfig,
    FitSettings,
    FrontEndConfig,
    GateConfig,
    GeneratorConfig,
    LexiconConfig,
    LstmConfig,
    MotionConfig,
    QConfig,
    RacerConfig,
    RewardConfig,
    Schedules,
    SelectionConfig,
    StyleConfig,
    TextConfig,
)

LITERAL = EpisodeConfig(truth=1.0, sampled=0.0, statistical=0.0, perturbed=0.0, baseline=0)
"""RACER's own data set: what was really done, and nothing else."""


def paper_trinity() -> Config:
    """Rhythmic Gesticulator's numbers for Trinity (RG 7.1.2), for a GPU.

    400 windows of 8 blocks a step, 7,000 generator steps of 3.7 TFLOP (forward and backward, LSTM 2 x 1024, 8,192
    logits a frame): 26 PFLOP, a quarter of an hour at 30 TFLOP/s, days on two CPU cores. 600 epochs of 4,700 windows.
    The speech encoder is 512 wide: 12 GFLOP a window of 1.5 s forward and backward, 64 windows a step, 15 PFLOP in
    20,000 steps.
    The gate is ours (the paper names its lack as a limitation).
    """
    return Config(
        name="paper-trinity",
        schedules=Schedules(lexicon=FitSettings(steps=12_000, batch=3000),
                            generator=FitSettings(steps=7_000, batch=400),
                            interpreter=FitSettings(steps=7_000, batch=500),
                            style=FitSettings(steps=7_000, batch=500),
                            speech=FitSettings(steps=20_000, batch=64),
                            contrast=FitSettings(steps=10_000, batch=64),
                            gate=FitSettings(steps=2_000, batch=500)),
        rhythm=BlockSettings(beats=BeatSettings(d_min=0.2, d_max=0.5), fps=20.0),
        front_end=FrontEndConfig(name="vqwav2vec"), encoder=EncoderConfig(width=512),
        text=TextConfig(encoder="bert-base-uncased"),
        interpreter=LstmConfig(text_features=128), style=StyleConfig(text_features=128),
    )


def paper_chinese() -> Config:
    """As `paper_trinity`, with the intervals of the Chinese data set: [0.3, 0.6] s, K = 12, and a Chinese BERT."""
    return dataclasses.replace(paper_trinity(), name="paper-chinese", text=TextConfig(encoder="bert-base-chinese"),
                               rhythm=BlockSettings(beats=BeatSettings(d_min=0.3, d_max=0.6), fps=20.0))


def paper_ted() -> Config:
    """As `paper_trinity`, in TED's representation: positions of ten joints, 15 fps, K = 8, 100 lexemes (RG 7.1)."""
    trinity = paper_trinity()
    return dataclasses.replace(
        trinity, name="paper-ted", motion=MotionConfig(representation="positions", least_deviation=0.01),
        lexicon=dataclasses.replace(trinity.lexicon, size=100),
        rhythm=BlockSettings(beats=BeatSettings(d_min=0.2, d_max=0.5), fps=15.0))


def default() -> Config:
    """The shipped bundle, for two CPU cores: smaller than `paper_trinity`, with fewer steps to match.

    Size: a speech encoder 128 wide for 512, a 384-d word encoder for 768; rows of audio and of text brought to 48 and
    32 before their FC; lexicon convolutions 32, 64, 96, 128 wide; E_M 48 and E_A 32 wide; MLP 192; 16 groups of 32
    classes; LSTM 2 x 192; interpreters 192 and 128 wide; batches of 64 windows. Training to match: a cosine fall of a
    higher rate, since there are 35 epochs and not 600, and for the same reason 5e-2 for the style codes; a quarter of
    the blocks in the lexeme loss; scheduled sampling complete after 40 % of the run.
    Beyond size: the interpreter that reads is the audio-only one with a head beside it that reads the words of three
    blocks and adds to its scores, since four hours hold too few words to learn both at once; the style interpreter
    reads none (Table 3 finds little in them); the generator is taught frame differences, the three features of style
    at once, and to do without a style code in three windows of ten, since the codes of unheard speech are guesses;
    there are 100 lexemes, as TED has; the trunk's small turns count less (least deviation 0.1), so that lexemes tell
    arms apart. Lexemes are drawn (temperature 0.7) and not taken by arg max, which from sound alone settles on few: a
    rule that gestures by chance cannot be predicted block by block, only its manner can.
    The Q-network looks ten blocks ahead (gamma 0.9), a little further than a reward looks back, and its target follows
    every 25 steps: 800 steps would not bring values of a hundred blocks (gamma 0.99) to rest; for half of them it
    learns what people do, before it learns what that is worth. alpha is 1: of those tried on the validation split (0.1
    to 10) lower ones left the data for lexemes that the judging reward thinks little of.
    """
    return Config(
        name="default", default_speaker="connor",
        schedules=Schedules(
            lexicon=FitSettings(steps=2_500, batch=512, rate=1e-3, schedule="cosine"),
            generator=FitSettings(steps=3_000, batch=64, rate=2e-3, schedule="cosine"),
            interpreter=FitSettings(steps=500, batch=64, rate=1e-3, schedule="cosine", weight_decay=0.01),
            interpreter_text=FitSettings(steps=2_000, batch=64, rate=2e-3, schedule="cosine", weight_decay=0.1),
            style=FitSettings(steps=1_500, batch=64, rate=1e-3, schedule="cosine", weight_decay=0.01),
            speech=FitSettings(steps=1_000, batch=8, rate=1e-3, schedule="cosine"),
            contrast=FitSettings(steps=500, batch=16, rate=3e-4, schedule="cosine"),
            gate=FitSettings(steps=600, batch=64, rate=1e-3, schedule="cosine", weight_decay=0.01),
            reward=FitSettings(steps=1_000, batch=128, rate=1e-3, schedule="cosine", weight_decay=0.05),
            cql=FitSettings(steps=800, batch=64, rate=1e-3, betas=(0.5, 0.999), schedule="cosine",
                            weight_decay=0.01)),
        front_end=FrontEndConfig(name="vqwav2vec"), encoder=EncoderConfig(width=128),
        text=TextConfig(encoder="minilm"),
        motion=MotionConfig(least_deviation=0.1), lexicon=LexiconConfig(size=100, widths=(32, 64, 96, 128)),
        selection=SelectionConfig(temperature=0.7),
        generator=GeneratorConfig(motion_features=48, audio_features=32, audio_bottleneck=48, hidden=192, groups=16,
                                  classes=32, lstm_width=192, own_past_until=0.4, swap_share=0.25, style_rate=5e-2,
                                  use_control=True, velocity=10.0, style_dropout=0.3),
        interpreter=LstmConfig(audio_features=32, audio_bottleneck=48, text_head=256, text_bottleneck=64,
                               use_control=True, width=192, dropout=0.2),
        style=StyleConfig(audio_features=32, audio_bottleneck=48, width=128),
        gate=GateConfig(audio_features=16, audio_bottleneck=32, width=64),
        cql=QConfig(conservative=1.0, gamma=0.9, copy_every=25, warm_up=0.5),
    )


def tiny() -> Config:
    """Everything at toy width, for tests and a first look: a minute on one core."""
    return Config(
        name="tiny",
        schedules=Schedules(
            lexicon=FitSettings(steps=200, batch=64, rate=2e-3, schedule="cosine"),
            generator=FitSettings(steps=120, batch=8, rate=3e-3, schedule="cosine"),
            interpreter=FitSettings(steps=80, batch=8, rate=3e-3, schedule="cosine"),
            style=FitSettings(steps=60, batch=8, rate=3e-3, schedule="cosine"),
            speech=FitSettings(steps=20, batch=4, rate=1e-3), contrast=FitSettings(steps=20, batch=8, rate=1e-3),
            gate=FitSettings(steps=40, batch=8, rate=3e-3), reward=FitSettings(steps=40, batch=16, rate=3e-3),
            cql=FitSettings(steps=30, batch=8, rate=3e-3, betas=(0.5, 0.999))),
        front_end=FrontEndConfig(name="vqwav2vec"), encoder=EncoderConfig(width=16), text=TextConfig(encoder="minilm"),
        lexicon=LexiconConfig(size=12, code_width=32, widths=(16, 24, 32, 32), revive_below=0.2),
        generator=GeneratorConfig(motion_features=16, audio_features=8, audio_bottleneck=8, style_width=8,
                                  position_width=8, hidden=48, groups=4, classes=8, lstm_width=48, lstm_layers=1,
                                  style_rate=5e-2, swap_share=0.25, use_control=True),
        interpreter=LstmConfig(audio_features=8, audio_bottleneck=8, text_features=8, text_bottleneck=8,
                               use_control=True, width=48),
        style=StyleConfig(audio_features=8, audio_bottleneck=8, text_features=4, text_bottleneck=8, width=32),
        gate=GateConfig(audio_features=4, audio_bottleneck=8, width=16),
        reward=RewardConfig(width=16, projection=8, window=4, longest=6), episodes=EpisodeConfig(prefix=2),
        cql=QConfig(width=16, heads=2, layers=2, decisions=6, audio_features=4, audio_bottleneck=8, copy_every=10),
    )


_FIXED_RATE = BlockSettings(beats=BeatSettings(d_min=0.2, d_max=0.4, rule="even"), fps=20.0)
"""Eight frames at 20 fps, whatever is heard: RACER cuts speech at no beats."""


def racer_trinity() -> Config:
    """RACER as published (RACER 5.1, 5.2), for a GPU: its own codec, no lexicon of beats, no generator.

    Codec: 512 wide, 512 codes, 6 s windows of 15 codes, batch 64, 500 epochs of 221 minutes: 17,000 steps of 0.5
    TFLOP. Q-network: 768 wide, 12 heads, 12 layers (the paper does not say how many; 86 M weights), batch 256, 1,500
    epochs: 13,000 steps. A pass over a batch of 256 windows of 30 tokens costs 1.3 TFLOP, a step about seven of them
    (forward and backward, two target windows, two for the double choice): 120 PFLOP, an hour at 30 TFLOP/s, weeks on
    two CPU cores. The data set is what was really done, as in the paper; mel and onset are heard, eight frames of them.
    """
    learn = FitSettings(steps=17_000, batch=64, rate=3e-5)
    return Config(
        name="racer-trinity", tokens="racer", rhythm=_FIXED_RATE,
        schedules=Schedules(
            lexicon=learn, generator=NOT_TRAINED, interpreter=NOT_TRAINED, style=NOT_TRAINED, reward=learn,
            cql=FitSettings(steps=13_000, batch=256, rate=1e-4, betas=(0.5, 0.999), schedule="cosine")),
        front_end=FrontEndConfig(name="mel", bands=128), episodes=LITERAL,
        reward=RewardConfig(width=256, projection=128, window=15, longest=15),
        cql=QConfig(width=768, heads=12, layers=12, audio_blocks=1, audio_bottleneck=0, audio_features=128,
                    use_speaker=False))


def racer_chinese() -> Config:
    """As `racer_trinity`, for an hour of speech: 400 epochs of the codec, 1,200 of the Q-network (RACER 5.2)."""
    trinity = racer_trinity()
    learn = dataclasses.replace(trinity.schedules.lexicon, steps=3_800)
    return dataclasses.replace(trinity, name="racer-chinese", schedules=dataclasses.replace(
        trinity.schedules, lexicon=learn, reward=learn, cql=dataclasses.replace(trinity.schedules.cql, steps=2_800)))


def racer_native() -> Config:
    """RACER's own form a quarter as wide, for two CPU cores: codec 128 wide, Q-network 192 wide with 3 heads.

    Beyond width: 4 layers for 12, batches of 32 in the Q-network, far fewer steps at a higher rate, the mixture of
    behaviours for the paper's ground truth alone (without the supervised interpreter, of which there is none over
    these codes), 256 codes for 512 since four hours use no more, the performers told apart; as in `default` alpha 1,
    ten decisions of foresight and a target that follows every 25 steps, most of the run supervised; codes are drawn
    (temperature 1), since the greedy choice of so short a training is one resting code.
    """
    trinity = racer_trinity()
    return dataclasses.replace(
        trinity, name="racer-native", default_speaker="connor", front_end=FrontEndConfig(name="mel", bands=32),
        motion=MotionConfig(least_deviation=0.1),
        schedules=dataclasses.replace(
            trinity.schedules,
            lexicon=FitSettings(steps=800, batch=32, rate=1e-3, schedule="cosine"),
            reward=FitSettings(steps=600, batch=64, rate=1e-3, schedule="cosine", weight_decay=0.05),
            cql=FitSettings(steps=500, batch=32, rate=1e-3, betas=(0.5, 0.999), schedule="cosine",
                            weight_decay=0.01)),
        selection=SelectionConfig(q_temperature=1.0),
        episodes=EpisodeConfig(truth=0.7, sampled=0.0, statistical=0.15, perturbed=0.15, baseline=0),
        racer=RacerConfig(width=128, size=256, revive_below=0.2),
        reward=RewardConfig(window=8, longest=15),
        cql=QConfig(width=192, heads=3, layers=4, audio_blocks=1, audio_bottleneck=0, audio_features=32,
                    use_speaker=True, conservative=1.0, gamma=0.9, copy_every=25, warm_up=0.8))


PRESETS = {"default": default, "paper-trinity": paper_trinity, "paper-chinese": paper_chinese, "paper-ted": paper_ted,
           "racer-trinity": racer_trinity, "racer-chinese": racer_chinese, "racer-native": racer_native, "tiny": tiny}


def preset(name: str) -> Config:
    """The preset of that name; InputError lists those there are."""
    if name not in PRESETS:
        raise InputError(name, "is not a preset", f"choose among {', '.join(PRESETS)}")
    return PRESETS[name]()
