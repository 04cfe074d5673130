"""Sizes and training of the interpreters, the gate, the reward models and the Q-network, and what they learn from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

from data_module.errors import InputError
from data_module.settings import (
    Count,
    Depth,
    Natural,
    NotNegative,
    Positive,
    SettingChoice,
    SettingRange,
    Share,
    Width,
    WidthOrNone,
    Widths,
    check,
)

BEHAVIOURS = ("truth", "sampled", "statistical", "perturbed")
"""Who chose a lexeme: the person, the trained interpreter, the frequencies, or the person with errors put in."""
REWARDS = ("contrastive", "distance")
SCHEMES = ("window", "prefix", "terminal", "difference")
LEAST_TEMPERATURE = 0.01
"""tau of the contrastive loss never falls below this; beyond it one pair of a batch would decide the gradient."""

Dropout = Annotated[float, SettingRange(0.0, 0.99)]
TextBlocks = Annotated[int, SettingRange(1, 3)]


@dataclass(frozen=True)
class LstmConfig:
    """Sizes of the lexeme interpreter."""

    audio_features: Width = 128
    """d_A~, width of E_A^lex."""
    audio_bottleneck: WidthOrNone = 0
    """Width that each row of audio is brought to before E_A^lex; 0 for none (the paper)."""
    width: Width = 512
    """Units of each layer of the LSTM."""
    layers: Depth = 1
    """Layers of the LSTM."""
    text_features: WidthOrNone = 0
    """d_t~, width of the FC on word vectors; 0 is the audio-only interpreter (RG 6.3)."""
    text_blocks: TextBlocks = 1
    """Blocks of text that are read: 1 (the paper), or 3, the one before and the one after too."""
    text_bottleneck: WidthOrNone = 0
    """Width that a word vector is brought to before the FC; 0 for none (the paper)."""
    text_head: WidthOrNone = 0
    """Width of a head that reads the words of three blocks beside the LSTM and adds to its scores; 0 (the paper) takes
    `text_features` into the LSTM instead."""
    text_head_dropout: Dropout = 0.5
    """In that head: a few hours hold few words, which are soon known by heart."""
    use_control: bool = False
    """Hear what is asked of the style (C_i of RG 7.2.1)."""
    use_speaker: bool = True
    """The one-hot I of Eq. 16."""
    dropout: Dropout = 0.1
    """On the rows that the LSTM reads and on what is classified."""
    label_smoothing: Dropout = 0.0
    """Share of the target that is spread over all lexemes."""
    own_past_until: Share = 0.5
    """Share of the run after which scheduled sampling is complete."""
    own_past_most: Share = 0.5
    """The share of previous lexemes that are its own predictions rises from 0 to `own_past_most` by this share of the
    run (scheduled sampling in two passes)."""
    pose_features: WidthOrNone = 0
    """Width that the last pose, its velocity and its acceleration are brought to; 0 (the paper) does not see the body,
    and must guess from the lexeme before where the hands are and where they go."""
    pose_noise: NotNegative = 0.0
    """Standard deviation of noise on what is seen of the body in training, in normalised units: what is drawn is not
    what was captured."""
    memory: Natural = 0
    """Blocks that a score is made of, this one included, from a state of zero: as windows of training are. 0 (the
    paper) carries the state on for ever, further than it was ever taught."""
    reads_by: Annotated[str, SettingChoice(("frame", "block"))] = "frame"
    """What a step of the LSTM is: a frame of a block (the paper), all K of them before the block is scored; or a block,
    through a layer of its own, which costs a K-th and is scored from the LSTM and that layer together."""
    lexeme_features: WidthOrNone = 0
    """Width of a vector that is learned for each lexeme; 0 (the paper) takes the codebook's."""
    history_dropout: Share = 0.0
    """Chance in training that a previous lexeme is any one instead: who leans on the lexeme before says it again."""
    audio_dropout: Share = 0.0
    """Share of training windows that hear nothing (zeros, the mean of all sound), for guidance."""
    after_dropout: Share = 0.0
    """Share of training windows that do not hear the block after a block (zeros), so that a stream need not wait for
    it."""

    @property
    def reads(self) -> bool:
        """Words are read, in one way or the other."""
        return self.text_features > 0 or self.text_head > 0

    def without_text(self) -> LstmConfig:
        """The settings of the audio-only twin (RG 6.3)."""
        return replace(self, text_features=0, text_blocks=1, text_bottleneck=0, text_head=0)


@dataclass(frozen=True)
class StyleConfig:
    """Sizes of the style interpreter."""

    audio_features: Width = 128
    """Width of the FC on three blocks of low-level audio."""
    audio_bottleneck: WidthOrNone = 0
    """Width that each row of audio is brought to before that FC; 0 for none (the paper)."""
    width: Width = 256
    """Units of each layer of the LSTM."""
    layers: Depth = 1
    """Layers of the LSTM."""
    text_features: WidthOrNone = 0
    """d_t~ of Eq. 19; 0 leaves the text out (RG 6.3, Table 3)."""
    text_blocks: TextBlocks = 1
    """Blocks of text that are read: 1 (the paper), or 3."""
    text_bottleneck: WidthOrNone = 0
    """Width that a word vector is brought to before the FC; 0 for none (the paper)."""
    use_speaker: bool = False
    """Eq. 19 has no I."""
    dropout: Dropout = 0.1
    """On the rows that the LSTM reads."""

    def without_text(self) -> StyleConfig:
        """The settings of the audio-only twin (RG 6.3)."""
        return replace(self, text_features=0, text_blocks=1, text_bottleneck=0)


@dataclass(frozen=True)
class GateConfig:
    """Sizes of the activity gate."""

    audio_features: Width = 32
    """Width of the FC on three blocks of low-level audio: loudness and intonation, not meaning."""
    audio_bottleneck: WidthOrNone = 0
    """Width that each row of audio is brought to before that FC; 0 for none."""
    width: Width = 64
    """Units of each layer of the LSTM."""
    layers: Depth = 1
    """Layers of the LSTM."""
    dropout: Dropout = 0.1
    """On the rows that the LSTM reads and on what is classified."""
    use_speaker: bool = True
    """Performers differ most of all in how often they gesture."""


@dataclass(frozen=True)
class StatisticalConfig:
    """The statistical interpreter (RG Eq. 24)."""

    gain: NotNegative = 1.0
    """Multiplies f^I - f_t inside the softmax; 1 is the literal Eq. 24."""
    condition_on_current: bool = False
    """Multiply by the transition row of the lexeme just shown, instead of averaging over all rows."""


@dataclass(frozen=True)
class QConfig:
    """Sizes of the Q-network and how it learns. The paper: width 768, heads 12, dropout 0.1, decisions 15."""

    width: Width = 128
    """C."""
    heads: Width = 4
    """Of each attention layer."""
    layers: Depth = 4
    """Not told in the paper; more than 3, since its actor-critic variant splits off the last 3."""
    dropout: Dropout = 0.1
    """In every layer."""
    decisions: Width = 15
    """T, the pairs of audio and action that a decision sees: a_0 and 15 decisions are 16 lexemes."""
    audio_features: Width = 64
    """Width of the FC on three blocks of audio, for each of the K frames."""
    audio_bottleneck: WidthOrNone = 48
    """Width that each row of audio is brought to before that FC; 0 for none."""
    audio_blocks: TextBlocks = 3
    """Blocks of audio that a decision hears: 3, the one before and the one after too (RG Eq. 17), or 1 (the paper)."""
    lookahead: Annotated[int, SettingRange(0, 1)] = 1
    """1: the three blocks of a decision are the one before, its own and the one after; 0: the two before and its own,
    so that a stream need not wait for the next beat."""
    use_speaker: bool = True
    """Hear the one-hot of the speaker with every block."""
    conservative: NotNegative = 0.1
    """alpha of RACER Eq. 11. A large one makes the data's lexemes look ever better, and the target with them."""
    temporal: NotNegative = 1.0
    """Weight of the temporal difference. 0 leaves a cross-entropy: the paper's "Supervised Learning"."""
    warm_up: Share = 0.0
    """Share of the run that is supervised learning alone (the conservative term): a short run then need not learn what
    people do by way of values. 0 is the paper's."""
    gamma: Share = 0.99
    """What a reward one block later is worth now."""
    copy_every: Count = 500
    """Steps between two copies of the network to its target."""
    double: bool = True
    """The online network picks the next action and the target values it (Double DQN); else the target does both."""
    huber: NotNegative = 0.0
    """Where the squared error turns linear; 0 for never (the paper)."""
    freeze_dropout: bool = False
    """No dropout while training."""


@dataclass(frozen=True)
class CriticConfig:
    """Sizes of the critics of the advantage interpreter, and what they learn from."""

    width: Width = 64
    """C: a network of this width, taught every lexeme's reward, told them as well as wider ones did."""
    heads: Width = 4
    """Of each attention layer."""
    layers: Depth = 2
    """One block must cost less than 3 ms together with the behaviour policy."""
    dropout: Dropout = 0.1
    """In every layer."""
    decisions: Width = 10
    """Pairs of audio and lexeme that a decision sees: a little more than a reward looks back on."""
    audio_features: Width = 32
    """Width of the FC on three blocks of audio, for each of the K frames."""
    audio_bottleneck: WidthOrNone = 32
    """Width that each row of audio is brought to before that FC; 0 for none."""
    critics: Width = 2
    """J, of which the least advantage is taken."""
    heard: Share = 0.7
    """Chance of a recording to be among those that a critic learns from: who saw the same agrees for nothing."""
    value: NotNegative = 0.3
    """Weight of the error of the state's value, which no choice is made by."""
    gamma: Share = 0.9
    """What a reward one block later is worth now. A lexeme is heard by the rewards of `reward.window` blocks."""
    states: Count = 24_000
    """Decisions of the episodes in which every lexeme's reward is found."""
    tried: Share = 0.12
    """Share of them in which lexemes are put in the place of the one that was chosen, to see what follows."""
    swaps: Count = 6
    """Such lexemes of a decision: half of them drawn from the behaviour policy, half any."""

    @property
    def network(self) -> QConfig:
        """The trunk's settings."""
        return QConfig(width=self.width, heads=self.heads, layers=self.layers, dropout=self.dropout,
                       decisions=self.decisions, audio_features=self.audio_features,
                       audio_bottleneck=self.audio_bottleneck)


@dataclass(frozen=True)
class RewardConfig:
    """Sizes of the reward model, and how the windows it is trained on are drawn."""

    width: Width = 96
    """C, the width of a block's token and of every layer."""
    projection: Width = 64
    """P, the width of the space that motion and audio share."""
    kernel: Width = 3
    """Taps of a convolution, in blocks."""
    dilations: Widths = (1, 2, 4)
    """One residual layer each; together with the kernel they reach 15 blocks, more than `longest`."""
    dropout: Dropout = 0.1
    """In every layer."""
    temperature: Positive = 0.07
    """tau of RACER Eq. 7 at the start; it is learned and never falls below 0.01."""
    window: Width = 8
    """W, the blocks that a reward looks back on, this one included."""
    shortest: Width = 2
    """Blocks of the shortest training window: the first blocks of a recording have little to look back on."""
    longest: Width = 12
    """Blocks of the longest training window."""
    tempo: bool = False
    """Tell the motion side how long each block lasts. The audio side knows, so this gives the pair away: durations
    alone, without any motion, then find 9 pairs in 10, and a policy cannot change them."""
    rivals: Natural = 4
    """H, further negatives of each window that is shown decoded: itself with some of its last lexemes replaced. Without
    them a single lexeme hardly moves the reward, and not towards the right one."""
    choice: NotNegative = 0.0
    """Weight of a second loss over a lexicon of movements: the last lexeme of a window that is shown decoded is to be
    found among all S, with the odds that it follows the one before taken as given. What is left to tell it by is the
    sound. It does the work of `rivals` for every lexeme at the price of one."""
    members: Width = 1
    """Models of an ensemble, which learn in turns; 1 is the paper's."""
    caution: NotNegative = 0.0
    """c: the reward is the members' mean less c times their standard deviation."""
    centred: bool = False
    """Take off what a motion earns under any audio: m . (u - mean u). The paper does not."""
    decoded: Share = 0.5
    """Share of the motion blocks that are decoded from the lexicon in training, the others being captured. The policy's
    motion is always decoded; without any in training the reward would tell how decoded a motion looks."""

    def __post_init__(self) -> None:
        if not 1 <= self.shortest <= self.window <= self.longest:
            raise ValueError("windows need 1 <= shortest <= window <= longest")
        if self.temperature < LEAST_TEMPERATURE or not 0 <= self.decoded <= 1 or self.kernel < 1:
            raise ValueError(f"temperature must be {LEAST_TEMPERATURE} at least, decoded a share, kernel positive")


@dataclass(frozen=True)
class EpisodeConfig:
    """Who acts in the data set, and what is rewarded. The paper's own is `truth=1` and 0 for the other shares and the
    baseline."""

    truth: Share = 0.65
    """Share of what was really done: every recording, once. The other shares are in proportion to it, in decisions."""
    sampled: Share = 0.15
    """Share of roll-outs of the supervised interpreter."""
    statistical: Share = 0.10
    """Share of roll-outs of the statistical interpreter."""
    perturbed: Share = 0.10
    """Share of the truth with some lexemes replaced."""
    replace: Share = 0.2
    """Probability that a lexeme of the truth is replaced in the perturbed share."""
    nearest: Count = 3
    """Half of the replacements are among this many nearest lexemes, the other half are any."""
    temperature: NotNegative = 1.0
    """Of the roll-outs: lexemes are drawn from softmax(scores / temperature); 0 takes the best."""
    prefix: Count = 8
    """True lexemes before another behaviour takes over."""
    reward: Annotated[str, SettingChoice(REWARDS)] = "contrastive"
    """"contrastive" (RACER Eq. 8), or "distance" to the recorded motion (the paper's ablation)."""
    baseline: Natural = 8
    """Random sequences of lexemes whose mean reward on the same audio is taken off the contrastive reward; 0 for none
    (the paper). It changes no choice and spares the Q-network to learn what the audio alone earns."""
    scheme: Annotated[str, SettingChoice(SCHEMES)] = "window"
    """What a step earns: "window" the reward of the blocks that trail it; "prefix" that of all since the stretch began;
    "terminal" that of the whole stretch, at its end; "difference" what the step added to the prefix."""
    stretch: Count = 15
    """Decisions in a stretch, for every scheme but "window". Windows are then cut at stretches, and as long."""
    cloned: Share = 0.0
    """Weight of CQL's data term on what was not the person's choice; it is 1 on the truth."""

    def __post_init__(self) -> None:
        check(self, "episodes")
        if abs(sum(self.shares.values()) - 1) > 1e-6:
            raise InputError("episodes", f"has shares {self.shares}", "give four that are not negative and sum to 1")
        if self.reward == "distance" and self.scheme != "window":
            raise InputError("episodes.scheme", f"is {self.scheme!r}", "a distance is of one block: choose 'window'")

    @property
    def shares(self) -> dict[str, float]:
        """The mixture, keyed by behaviour."""
        return {name: float(getattr(self, name)) for name in BEHAVIOURS}
