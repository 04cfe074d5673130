"""The settings of a bundle: one tree of the parts' settings, each with its range and its reason."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Annotated, Any

from data_module.blocks import BlockSettings
from data_module.controls import FEATURES
from data_module.errors import InputError
from data_module.settings import (
    Count,
    Natural,
    NotNegative,
    Positive,
    SettingChoice,
    SettingRange,
    Share,
    Steps,
    Width,
    check,
    digest,
    from_dict,
    to_dict,
    with_settings,
)
from data_module.speech.beats import BeatSettings
from data_module.speech.speech_encoder import EncoderConfig
from generator.model import GeneratorConfig
from interpreters import entries
from interpreters.settings import (
    CriticConfig,
    EpisodeConfig,
    GateConfig,
    LstmConfig,
    QConfig,
    RewardConfig,
    StatisticalConfig,
    StyleConfig,
)
from lexicon.settings import FRAMES, LexiconConfig, RacerConfig

__all__ = ["BeatSettings", "BlockSettings", "Config", "ControlConfig", "CriticConfig", "EncoderConfig",
           "EpisodeConfig", "FitSettings", "FrontEndConfig", "GateConfig", "GeneratorConfig", "LexiconConfig",
           "LstmConfig", "MotionConfig", "QConfig", "RacerConfig", "RewardConfig", "Schedules", "SelectionConfig",
           "SilenceConfig", "StatisticalConfig", "StyleConfig", "TextConfig", "digest", "from_dict", "section",
           "to_dict", "with_settings"]


@dataclass(frozen=True)
class FitSettings:
    """How long and how a stage is trained."""

    steps: Steps
    """Updates of the weights; 0 leaves the stage out where it can be left out."""
    batch: Count
    """Windows (or blocks) a step."""
    rate: Positive = 3e-4
    """Learning rate of Adam at its highest; 3e-4 is the papers' (RG 7.1.2)."""
    betas: Annotated[tuple[float, float], SettingRange(0.0, 0.9999)] = (0.9, 0.999)
    """Of Adam: how slowly the mean and the square of the gradient are forgotten."""
    schedule: Annotated[str, SettingChoice(("constant", "cosine"))] = "constant"
    """"constant", or "cosine": a warm-up of 2 % of the steps, then a fall to 1 % of the rate."""
    clip: NotNegative = 1.0
    """Largest gradient norm; 0 leaves gradients alone."""
    weight_decay: Share = 0.0
    """Of AdamW; 0 is Adam."""
    validations: Count = 10
    """How often the stage is validated along the way, the end included."""
    patience: Natural = 0
    """Validations in a row without a better figure after which training stops; the weights of the best one are kept.
    0 trains to the end and keeps the last. For stages that have a figure to watch: interpreters, style and gate."""


@dataclass(frozen=True)
class FrontEndConfig:
    """Which audio front end, and its size."""

    name: str = "mel"
    """"mel"; "vqwav2vec", the stack that the speech stages train; "fairseq:PATH", a published checkpoint of it;
    "hf:NAME", hidden layers of a speech model of transformers."""
    bands: Width = 80
    """Mel bands, of "mel" alone."""
    layers: Annotated[tuple[int, ...], SettingRange(0, 1000)] = ()
    """Which layers are the low and the high level; empty for the front end's own (2 and 8 of the stack)."""


@dataclass(frozen=True)
class TextConfig:
    """What is read of the words."""

    encoder: str = ""
    """The word encoder: "minilm", any BERT by name or folder, or nothing: then every path is audio-only."""
    bridge: NotNegative = 0.15
    """Seconds: a shorter gap between words belongs to the nearer one."""


@dataclass(frozen=True)
class ControlConfig:
    """Style editing: one generator for all features, taught with whole and single features left out (RG 7.2.1)."""

    window: Positive = 4.0
    """Seconds over which a feature is averaged."""
    free: Share = 0.4
    """Share of training windows where nothing is asked."""
    asked: Share = 0.5
    """Chance of each feature to be asked for in the others."""
    features: Annotated[tuple[str, ...], SettingChoice(FEATURES)] = ("height", "speed", "radius")
    """Those that may be asked for; one alone is the paper's form."""


@dataclass(frozen=True)
class MotionConfig:
    """How motion is brought to numbers."""

    least_deviation: Positive = 0.05
    """Radians (or metres): a dimension that varies less is scaled by this instead, so stillness is not blown up."""
    representation: Annotated[str, SettingChoice(("rotations", "positions"))] = "rotations"
    """"rotations": exponential maps of the joints; "positions": ten joints in space, as TED has them."""
    joints: Annotated[int, SettingChoice((16, 46))] = 16
    """Of "rotations": the papers' upper body of 16 joints, or 46 with those of the fingers."""
    smoothing: Annotated[float, SettingRange(0.0, 10.0)] = 0.05
    """Seconds, the standard deviation of the Gaussian over the finished motion: one frame at 20 fps, cut off at two
    frames either side (kernel size 5, RG 7.1.2)."""


@dataclass(frozen=True)
class SilenceConfig:
    """The silent period hint and the silent augmentation (RG 6.4.1)."""

    hint: bool = True
    """Teach the lexeme interpreter the silent lexeme nearest to a silent block's own."""
    augmentation: Annotated[float, SettingRange(0.0, 0.9)] = 0.05
    """Share of inserted silent blocks in the generator's training set; 0 turns it off."""
    longest_insert: Count = 10
    """Blocks of the longest run of silence that is inserted (5 s at most)."""
    mask: bool = True
    """At inference let silent blocks choose among silent lexemes only."""
    rest_decay: Share = 0.5
    """At inference, from the third quiet block in a row on, the share of the way to the block's mean pose that a block
    goes; the small swings that the generator would repeat in every block of a rest are left out. 0 leaves them in."""
    lexemes: Annotated[tuple[int, ...], SettingRange(0, 65535)] = ()
    """The silent lexemes by hand; empty finds them."""
    rest: Annotated[str, SettingChoice(("decay", "life"))] = "decay"
    """At inference: "decay", what `rest_decay` says and a gate that opens block by block; "life", rest is decided at
    the first frame of a real pause and phrase by phrase, and the body that rests lives (`gesticulator.body.rest`)."""


NOT_TRAINED = FitSettings(steps=0, batch=1)


@dataclass(frozen=True)
class Schedules:
    """How long each stage is trained."""

    lexicon: FitSettings
    """The lexicon, or RACER's own codec."""
    generator: FitSettings
    interpreter: FitSettings
    """The lexeme interpreter that hears alone."""
    style: FitSettings
    speech: FitSettings = NOT_TRAINED
    """Contrastive predictive coding on speech alone."""
    contrast: FitSettings = NOT_TRAINED
    """Eq. 1 on speech with text."""
    gate: FitSettings = NOT_TRAINED
    """Whether to gesture at all on a block; without steps there is no gate."""
    interpreter_text: FitSettings = NOT_TRAINED
    """The lexeme interpreter that reads the words, when it begins as the audio-only one; without steps it is trained
    from nothing, as the audio-only one is."""
    reward: FitSettings = NOT_TRAINED
    """Each of RACER's two reward models."""
    cql: FitSettings = NOT_TRAINED
    """RACER's Q-network; without steps there are no reward models either."""
    advantage: FitSettings = NOT_TRAINED
    """The critics of the advantage interpreter."""
    others: dict[str, dict[str, Any]] = field(default_factory=dict, hash=False)
    """By stage, what differs from the stage's own schedule, for stages that this tree does not name."""


UNTOLD = -1.0
"""Guidance on the lexeme at which it is left out."""


@dataclass(frozen=True)
class SelectionConfig:
    """How a lexeme is chosen from an interpreter's scores when the command does not say."""

    temperature: NotNegative = 0.0
    """0 takes the best (the paper); above, one is drawn from softmax(scores / temperature)."""
    q_temperature: NotNegative = 0.0
    """The same for the Q-network, whose scores are Q values: 0 is RACER's own greedy choice."""
    beta: Annotated[float, SettingRange(0.0, 20.0)] = 1.0
    """Of `--interpreter advantage`: how far lexemes are drawn to what they are worth. One that is worth a standard
    deviation more than the behaviour policy's mean is e^beta times as likely; 0 is the behaviour policy itself. Chosen
    on the validation split by the judge, not by the reward that taught (`gesticulator probe racer --split val`)."""
    top: Natural = 0
    """Draw among the best `top` only; 0 for all."""
    guidance: Annotated[float, SettingRange(0.0, 100.0)] = 5.0
    """How far what is asked of the style is followed: 1 takes what the models make of it, more goes on in the direction
    from what they would do unasked to what they do asked (they were taught both)."""
    audio_guidance: Annotated[float, SettingRange(0.0, 20.0)] = 1.5
    """Of the flow head: how far to go on in the direction from what it would draw unheard to what it draws; 0 draws
    what it draws."""
    interpreter_guidance: Annotated[float, SettingRange(0.0, 20.0)] = 0.0
    """How far the scores of lexemes go beyond those without sound, s + g (s - s without sound), where the interpreter
    was taught with sound left out (`interpreter.audio_dropout`)."""
    lexeme_guidance: Annotated[float, SettingRange(UNTOLD, 20.0)] = 0.5
    """The same for the lexeme; at -1 (`UNTOLD`) nothing of it is told."""
    history: Share = 1.0
    """Of the flow head: how far it goes by how the body moved before, from v without it (0) to v (1), where it was
    taught without (`generator.history_dropout`)."""
    trunk_guidance: Share = 1.0
    """What part of any guidance torso and head follow: guidance makes large turns of them larger than people's."""
    noise: Annotated[float, SettingRange(0.0, 2.0)] = 0.95
    """Of the flow head: deviation of the noise that drawing starts from; below 1 is calmer."""
    trunk_noise: Annotated[float, SettingRange(0.0, 2.0)] = 1.0
    """What the noise of torso and head is multiplied by."""
    flow_steps: Annotated[int, SettingRange(1, 100)] = 4
    """Of Heun's method, from noise to a block."""
    candidates: Annotated[int, SettingRange(1, 64)] = 4
    """Blocks that the flow head draws at once, of which one that shows the lexeme is kept, or else one that comes
    nearest to showing it; of several the one most in time (`timing`), or the first."""
    timing: NotNegative = 0.0
    """Of the candidates that show the lexeme: how much it counts that the hands brake at the onsets of the sound; 0
    does not look (`gesticulator.drawing.candidates`)."""
    seam: NotNegative = 0.0
    """How much it counts beside `timing` that a candidate joins on to the block before without a jolt."""
    as_asked: NotNegative = 0.0
    """How much it counts, beside `timing`, that a candidate does what is asked of the hands, a spread of training each;
    it then need only be among the five lexemes nearest to it."""
    activity: Share = 1.0
    """How readily the gate lets a block gesture: 1 always, 0 never. With silence.rest=life, the share of the time of
    speech that is gestured."""


@dataclass(frozen=True)
class Config:
    """Everything that shapes a bundle."""

    name: str
    schedules: Schedules
    rhythm: BlockSettings = field(default_factory=BlockSettings)
    front_end: FrontEndConfig = field(default_factory=FrontEndConfig)
    encoder: EncoderConfig = field(default_factory=EncoderConfig)
    text: TextConfig = field(default_factory=TextConfig)
    control: ControlConfig = field(default_factory=ControlConfig)
    motion: MotionConfig = field(default_factory=MotionConfig)
    lexicon: LexiconConfig = field(default_factory=LexiconConfig)
    generator: GeneratorConfig = field(default_factory=GeneratorConfig)
    interpreter: LstmConfig = field(default_factory=LstmConfig)
    statistical: StatisticalConfig = field(default_factory=StatisticalConfig)
    style: StyleConfig = field(default_factory=StyleConfig)
    gate: GateConfig = field(default_factory=GateConfig)
    reward: RewardConfig = field(default_factory=RewardConfig)
    """The reward that teaches a policy."""
    judge: RewardConfig = field(default_factory=RewardConfig)
    """The reward that judges one: other recordings, seeds and sizes."""
    episodes: EpisodeConfig = field(default_factory=EpisodeConfig)
    cql: QConfig = field(default_factory=QConfig)
    advantage: CriticConfig = field(default_factory=CriticConfig)
    tokens: Annotated[str, SettingChoice(("lexicon", "racer"))] = "lexicon"
    """What names gestures: "lexicon", block by block at the beat, and a generator draws them; or "racer", RACER's own
    codec at a fixed rate, which decodes them itself."""
    racer: RacerConfig = field(default_factory=RacerConfig)
    silence: SilenceConfig = field(default_factory=SilenceConfig)
    selection: SelectionConfig = field(default_factory=SelectionConfig)
    others: dict[str, Any] = field(default_factory=dict, hash=False)
    """Settings of trained interpreters that this tree does not name, by section: others.NAME={} has one trained with
    its defaults, others.NAME.width=64 changes one of them."""
    default_speaker: str = ""
    """Whose habits are taken when nobody is named; the first performer when empty or unknown."""
    window: Width = 8
    """Generated blocks in a training window: 4 s at 8 blocks of 0.5 s (RG 7.1.2)."""
    seed: Annotated[int, SettingRange(0, 2**31 - 1)] = 1
    """Every stage draws its own seed from this one and its name, so a stage more changes no other."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "others", {name: _other(name, value) for name, value in self.others.items()})
        check(self)
        if not self.lexicon.widths:
            raise InputError("lexicon.widths", "is empty", "give the channels of one convolution at least")
        if self.silence.rest == "life" and self.motion.representation != "rotations":
            raise InputError("silence.rest=life", "turns joints",
                             "use motion.representation=rotations, or silence.rest=decay")
        if self.tokens == "racer" and (self.rhythm.beats.rule != "even" or self.rhythm.frames != FRAMES):
            raise InputError("tokens=racer", "needs blocks of eight frames at a fixed rate",
                             "start from --preset racer-native, racer-trinity or racer-chinese")


def section(config: Config, name: str) -> Any:
    """The settings of one interpreter, by the name of its section; None where these settings have none."""
    return getattr(config, name) if name in {own.name for own in fields(config)} else config.others.get(name)


def _other(name: str, value: Any) -> Any:
    """The settings of an interpreter of `Config.others`, of its own class; InputError for one that is not known."""
    kinds = {entry.settings: entry for entry in entries().values()
             if entry.part and entry.settings not in {own.name for own in fields(Config)}}
    if name not in kinds:
        raise InputError(f"others.{name}", "is no interpreter with settings of its own",
                         f"known here: {', '.join(kinds) or 'none'}")
    kind = kinds[name].load_model().Settings
    settings = from_dict(kind, value) if isinstance(value, Mapping) else value
    if not isinstance(settings, kind):
        raise InputError(f"others.{name}", f"is {value!r:.40}", "give a group of settings")
    check(settings, f"others.{name}")
    return settings
