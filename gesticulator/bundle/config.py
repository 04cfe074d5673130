"""The settings of a bundle: a tree of the settings of its parts, each with its range and its reason.

`Config.system` names the system that they belong to, one file in `gesticulator.systems`.
"""

from dataclasses import dataclass, field
from typing import Annotated

from data_module.blocks import BlockSettings
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
from data_module.speech.front_ends import EncoderConfig
from generator.settings import GeneratorConfig
from interpreters.settings import (
    EpisodeConfig,
    GateConfig,
    LstmConfig,
    PlannerConfig,
    QConfig,
    RewardConfig,
    StyleConfig,
)
from lexicon.settings import FRAMES, LexiconConfig, RacerConfig

__all__ = ["BeatSettings", "BlockSettings", "Config", "ControlConfig", "EncoderConfig",
           "EpisodeConfig", "FitSettings", "FrontEndConfig", "GateConfig", "GeneratorConfig", "LexiconConfig",
           "LstmConfig", "MotionConfig", "QConfig", "RacerConfig", "RewardConfig", "Schedules", "SelectionConfig",
           "SilenceConfig", "StyleConfig", "TextConfig", "digest", "from_dict", "to_dict", "with_settings"]


@dataclass(frozen=True)
class FitSettings:
    """Training length and optimiser of a stage."""

    steps: Steps
    """Number of weight updates; 0 omits an optional stage."""
    batch: Count
    """Windows (or blocks) per step."""
    rate: Positive = 3e-4
    """Peak learning rate of Adam; 3e-4 is that of the papers (RG 7.1.2)."""
    betas: Annotated[tuple[float, float], SettingRange(0.0, 0.9999)] = (0.9, 0.999)
    """Adam's decay rates of the running mean and square of the gradient."""
    schedule: Annotated[str, SettingChoice(("constant", "cosine"))] = "constant"
    """"constant", or "cosine": warm-up over 2 % of the steps, then decay to 1 % of the rate."""
    weight_decay: Share = 0.0
    """Weight decay of AdamW; 0 is Adam."""
    validations: Count = 10
    """Number of validations during training, including one at the end."""
    patience: Natural = 0
    """Validations in a row without improvement after which training stops; the best weights are kept. 0 trains to the
    end and keeps the last. For stages with a validation figure to watch: interpreters, style and gate."""


@dataclass(frozen=True)
class FrontEndConfig:
    """The audio front end and its size."""

    name: str = "mel"
    """"mel"; or "vqwav2vec", the model trained by the speech stages."""
    bands: Width = 80
    """Number of mel bands, for "mel" only."""
    robust: bool = False
    """Whether resampling, compression and faint noise hardly change the features (`MelFrontEnd`)."""
    layers: Annotated[tuple[int, ...], SettingRange(0, 1000)] = ()
    """Layers used as the low and the high level; empty for the front end's default (2 and 8 of "vqwav2vec")."""


@dataclass(frozen=True)
class TextConfig:
    """Encoding of the words."""

    encoder: str = ""
    """Word encoder: "minilm", a folder with a BERT in the format of transformers, or empty for audio only."""


@dataclass(frozen=True)
class ControlConfig:
    """Style editing: one generator for all style features, trained with all or some of them omitted (RG 7.2.1)."""

    free: Share = 0.4
    """Share of training windows without any control."""


@dataclass(frozen=True)
class MotionConfig:
    """Representation of motion as numbers."""

    least_deviation: Positive = 0.05
    """Smallest scale of a dimension, radians (or metres), so that the noise of still joints is not amplified."""
    representation: Annotated[str, SettingChoice(("rotations", "positions"))] = "rotations"
    """"rotations": exponential maps of the joints; "positions": positions of ten joints, as in the TED data set."""
    joints: Annotated[int, SettingChoice((16, 46))] = 16
    """For "rotations": the upper body of 16 joints used in the papers, or 46 with fingers."""
    smoothing: Annotated[float, SettingRange(0.0, 10.0)] = 0.05
    """Standard deviation of the Gaussian that smooths the finished motion, seconds: one frame at 20 fps, truncated at
    two frames on either side (kernel size 5, RG 7.1.2)."""


@dataclass(frozen=True)
class SilenceConfig:
    """The silent period hint and the silent augmentation (RG 6.4.1)."""

    hint: bool = True
    """In silent blocks, train the lexeme interpreter on the silent lexeme nearest to the block's own."""
    augmentation: Annotated[float, SettingRange(0.0, 0.9)] = 0.05
    """Share of inserted silent blocks in the generator's training set; 0 inserts none."""
    mask: bool = True
    """At inference, silent blocks choose among silent lexemes only."""
    rest_decay: Share = 0.5
    """At inference, from the third quiet block in a row, how far each block is pulled to its mean pose (0 to 1). It
    removes small swings that the generator would repeat during rest; 0 keeps them."""
    lexemes: Annotated[tuple[int, ...], SettingRange(0, 65535)] = ()
    """Silent lexemes given by hand; empty detects them."""
    rest: Annotated[str, SettingChoice(("decay", "life"))] = "decay"
    """At inference: "decay" uses `rest_decay` (system paper) and gates block by block; "life" decides rest at the first
    frame of a pause and phrase by phrase, and adds idle motion (`gesticulator.body.rest`)."""


# Zero steps leave a stage out; a batch of 0 would be refused by its range.
NOT_TRAINED = FitSettings(steps=0, batch=1)


@dataclass(frozen=True)
class Schedules:
    """Training schedule of each stage."""

    lexicon: FitSettings
    """The lexicon, or RACER's codec."""
    generator: FitSettings
    interpreter: FitSettings
    """The audio-only lexeme interpreter."""
    style: FitSettings
    speech: FitSettings = NOT_TRAINED
    """Contrastive predictive coding on audio only."""
    contrast: FitSettings = NOT_TRAINED
    """The contrastive loss between audio and text (RG Eq. 1)."""
    gate: FitSettings = NOT_TRAINED
    """The gate, which decides whether a block is gestured; 0 steps: no gate."""
    planner: FitSettings = NOT_TRAINED
    """The planner of gesture units; 0 steps: no planner."""
    interpreter_text: FitSettings = NOT_TRAINED
    """The lexeme interpreter with text, if initialised from the audio-only one; 0 steps: trained from scratch like that
    one."""
    reward: FitSettings = NOT_TRAINED
    """Each of RACER's two reward models."""
    cql: FitSettings = NOT_TRAINED
    """RACER's Q-network; 0 steps: no reward models either."""
    cql_literal: FitSettings = NOT_TRAINED
    """A second Q-network as published (`Config.cql_literal`), beside the first."""


@dataclass(frozen=True)
class SelectionConfig:
    """Sampling of lexemes, for all systems, and of motion, for the system `movement`: its further constants stand in
    `gesticulator.systems.movement`."""

    temperature: NotNegative = 0.0
    """0 takes the best lexeme (as in the paper); otherwise one is sampled from softmax(scores / temperature)."""
    q_temperature: NotNegative = 0.0
    """Temperature for the Q-network, whose scores are Q values: 0 is RACER's greedy choice, which on its own past
    repeats a few lexemes."""
    activity: Share = 1.0
    """How readily the gate lets a block gesture: 1 always, 0 never. With rest by phrases, the share of speech time that
    is gestured."""
    guidance: Annotated[float, SettingRange(0.0, 100.0)] = 5.0
    """Guidance on the style controls: 1 is the conditional prediction, more extrapolates from the unconditional
    prediction through it (the models are trained on both)."""
    interpreter_guidance: Annotated[float, SettingRange(0.0, 20.0)] = 0.0
    """Guidance g of lexeme scores, s + g (s - s without audio), for interpreters trained with audio dropout
    (`interpreter.audio_dropout`)."""
    words_so_far: bool = False
    """Whether each word is read after those before it alone, without the rest of its sentence: a word that is changed
    then changes nothing before it. Models are trained on whole sentences (RG 4.1.2)."""
    contrast: Annotated[float, SettingRange(0.0, 4.0)] = 2.0
    """Movement: how much of the style in the voice is taken from the style code of the prediction that the guidance
    on units leads away from: 0 nothing, so that styles are not guided; 1 all of it; 2 gives it the opposite style."""
    reach: Annotated[float, SettingRange(-2.5, 2.5)] = 1.6
    """Movement: added to the style codes' reach, deviations of the training data: above 0 the hands are farther from
    the body, and from each other. Style controls take its place."""


@dataclass(frozen=True)
class Config:
    """All settings of a bundle."""

    name: str
    # Without a default: how long a model is trained is the choice of a preset.
    schedules: Schedules
    system: Annotated[str, SettingChoice(("paper", "movement", "racer"))] = "paper"
    """Which of the three systems (`gesticulator.systems`): "paper", Rhythmic Gesticulator; "movement", the default,
    with lexemes of movements and a flow generator; "racer", RACER's codec at a fixed rate with its Q-network."""
    rhythm: BlockSettings = field(default_factory=BlockSettings)
    front_end: FrontEndConfig = field(default_factory=FrontEndConfig)
    encoder: EncoderConfig = field(default_factory=EncoderConfig)
    text: TextConfig = field(default_factory=TextConfig)
    control: ControlConfig = field(default_factory=ControlConfig)
    motion: MotionConfig = field(default_factory=MotionConfig)
    lexicon: LexiconConfig = field(default_factory=LexiconConfig)
    generator: GeneratorConfig = field(default_factory=GeneratorConfig)
    interpreter: LstmConfig = field(default_factory=LstmConfig)
    style: StyleConfig = field(default_factory=StyleConfig)
    gate: GateConfig = field(default_factory=GateConfig)
    planner: PlannerConfig = field(default_factory=PlannerConfig)
    reward: RewardConfig = field(default_factory=RewardConfig)
    """The reward that trains a policy."""
    judge: RewardConfig = field(default_factory=RewardConfig)
    """The reward that evaluates one: other recordings, seeds and sizes."""
    episodes: EpisodeConfig = field(default_factory=EpisodeConfig)
    cql: QConfig = field(default_factory=QConfig)
    cql_literal: QConfig = field(default_factory=lambda: QConfig(conservative=1.0))
    """The Q-network as published, on recorded lexemes only: no discount but the paper's and no warm-up. RACER gives no
    alpha; 1 weighs the two terms of its Eq. 11 equally."""
    racer: RacerConfig = field(default_factory=RacerConfig)
    silence: SilenceConfig = field(default_factory=SilenceConfig)
    selection: SelectionConfig = field(default_factory=SelectionConfig)
    default_speaker: str = ""
    """Speaker used if none is given; the first performer if empty or unknown."""
    window: Width = 8
    """Blocks per training window: 4 s at 8 blocks of 0.5 s (RG 7.1.2)."""
    seed: Annotated[int, SettingRange(0, 2**31 - 1)] = 1
    """Each stage derives its seed from this one and its name, so adding a stage changes no other."""

    def __post_init__(self) -> None:
        check(self)
        # The types of the fields hold ranges of single values; these are conditions between several.
        if not self.lexicon.widths:
            raise InputError("lexicon.widths", "is empty", "give the channels of one convolution at least")
        if self.rests_by_phrase and self.motion.representation != "rotations":
            raise InputError("silence.rest=life", "needs joint rotations",
                             "use motion.representation=rotations, or silence.rest=decay")
        if self.system == "racer" and (self.rhythm.beats.rule != "even" or self.rhythm.frames != FRAMES):
            raise InputError("system=racer", "needs blocks of eight frames at a fixed rate",
                             "start from --preset racer-native, racer-trinity or racer-chinese")

    @property
    def ignores_foreseen(self) -> bool:
        """Whether the models take nothing of the sound of a next block that is not known yet."""
        return bool(self.generator.after_dropout and self.interpreter.after_dropout)

    @property
    def rests_by_phrase(self) -> bool:
        """Whether rest is decided phrase by phrase, with idle motion (`gesticulator.body.rest`)."""
        # RACER decodes all codes together, so no block can be replaced by rest afterwards.
        return self.silence.rest == "life" and self.system != "racer"
