"""Settings of the interpreters, the gate, the reward models, the Q-network, and their training data."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

from data_module.errors import InputError
from data_module.settings import (
    Count,
    Depth,
    Natural,
    NotNegative,
    SettingChoice,
    SettingRange,
    Share,
    Width,
    WidthOrNone,
    Widths,
    check,
)

BEHAVIOURS = ("truth", "sampled", "statistical", "perturbed")
"""Source of a lexeme: the person, the trained interpreter, the frequencies, or the person with random errors."""
HALF_BLOCKS = 6
"""Over which a text head averages the words of three blocks: a gesture starts before its word and outlasts it."""
REWARDS = ("contrastive", "distance")

Dropout = Annotated[float, SettingRange(0.0, 0.99)]
TextBlocks = Annotated[int, SettingRange(1, 3)]


@dataclass(frozen=True)
class LstmConfig:
    """Sizes of the lexeme interpreter."""

    audio_features: Width = 128
    """d_A~, width of E_A^lex."""
    audio_bottleneck: WidthOrNone = 0
    """Width of a projection of each row of audio before E_A^lex; 0 for none (the paper)."""
    width: Width = 512
    text_features: WidthOrNone = 0
    """d_t~, width of the FC on word vectors; 0 for the audio-only interpreter (RG 6.3)."""
    text_bottleneck: WidthOrNone = 0
    """Width of a projection of word vectors before the FC; 0 for none (the paper)."""
    text_head: WidthOrNone = 0
    """Width of a head for the words of three blocks that adds to the scores of the LSTM; 0 (the paper) makes
    `text_features` an input of the LSTM instead."""
    use_control: bool = False
    """Use the style control (C_i of RG 7.2.1) as input."""
    use_speaker: bool = True
    """Use the one-hot I of Eq. 16 as input."""
    dropout: Dropout = 0.1
    """Dropout of the input and the output of the LSTM."""
    own_past_most: Share = 0.5
    """The share of previous lexemes that are predictions rises from 0 to this value until `lstm.OWN_PAST_UNTIL` of
    the run (scheduled sampling in two passes)."""
    pose_features: WidthOrNone = 0
    """Width of the embedding of last pose, velocity and acceleration; 0 (the paper) for no pose input, so that the
    position of the hands must be inferred from the previous lexeme."""
    pose_noise: NotNegative = 0.0
    """Standard deviation of noise on the pose input in training, in normalised units, because generated poses differ
    from captured ones."""
    memory: Natural = 0
    """Blocks that a score depends on, including the current one, starting from a zero state as in training windows. 0
    (the paper) carries the state on without limit, longer than in training."""
    reads_by: Annotated[str, SettingChoice(("frame", "block"))] = "frame"
    """Step of the LSTM: "frame" (the paper), K steps before a block is scored; or "block", through an input layer,
    which costs a K-th; the score then depends on the LSTM and that layer."""
    lexeme_features: WidthOrNone = 0
    """Width of a learned embedding of lexemes; 0 (the paper) uses the codebook."""
    history_dropout: Share = 0.0
    """Probability in training that a previous lexeme is replaced by a random one, against repetition."""
    audio_dropout: Share = 0.0
    """Share of training windows without audio (zeros, the mean of all audio), for guidance."""
    after_dropout: Share = 0.0
    """Share of training windows without the next block (zeros), so that a stream need not wait for it."""

    @property
    def reads(self) -> bool:
        return self.text_features > 0 or self.text_head > 0

    def without_text(self) -> LstmConfig:
        return replace(self, text_features=0, text_bottleneck=0, text_head=0)


@dataclass(frozen=True)
class StyleConfig:
    """Sizes of the style interpreter."""

    audio_features: Width = 128
    """Width of the FC on three blocks of low-level audio."""
    audio_bottleneck: WidthOrNone = 0
    """Width of a projection of each row of audio before that FC; 0 for none (the paper)."""
    width: Width = 256
    text_features: WidthOrNone = 0
    """d_t~ of Eq. 19; 0 for no text (RG 6.3, Table 3)."""
    text_bottleneck: WidthOrNone = 0
    """Width of a projection of word vectors before the FC; 0 for none (the paper)."""
    use_speaker: bool = False
    """Use the speaker's one-hot as input; Eq. 19 has no I."""
    dropout: Dropout = 0.1
    """Dropout of the input of the LSTM (of a GRU's input and output with a flow head)."""

    def without_text(self) -> StyleConfig:
        return replace(self, text_features=0, text_bottleneck=0)


@dataclass(frozen=True)
class GateConfig:
    """Sizes of the activity gate."""

    audio_features: Width = 32
    """Width of the FC on three blocks of low-level audio: loudness and intonation, not meaning."""
    audio_bottleneck: WidthOrNone = 0
    """Width of a projection of each row of audio before that FC; 0 for none."""
    width: Width = 64


@dataclass(frozen=True)
class PlannerConfig:
    """Sizes of the planner of gesture units, and how strongly it is obeyed."""

    audio_features: Width = 8
    """Width of each frame's row from three blocks of low-level audio."""
    audio_bottleneck: WidthOrNone = 24
    """Width of a projection of each row of audio before that; 0 for none."""
    embedding: Width = 12
    """Width of the embedding of each decision."""
    width: Width = 96
    """Width of the GRU."""


@dataclass(frozen=True)
class QConfig:
    """Sizes of the Q-network and how it learns. The paper: width 768, heads 12, decisions 15."""

    width: Width = 128
    """C."""
    heads: Width = 4
    layers: Depth = 4
    """Layers; the paper does not say how many, but more than 3, since its actor-critic splits off the last 3."""
    decisions: Width = 15
    """T, the pairs of audio and action that a decision attends to: a_0 and 15 decisions are 16 lexemes."""
    audio_features: Width = 64
    """Width of the FC on three blocks of audio, for each of the K frames."""
    audio_bottleneck: WidthOrNone = 48
    """Width of a projection of each row of audio before that FC; 0 for none."""
    audio_blocks: TextBlocks = 3
    """Blocks of audio in the input of a decision: 3, with the previous and the next (RG Eq. 17), or 1 (the paper)."""
    use_speaker: bool = True
    """Use the speaker's one-hot as input of every block."""
    conservative: NotNegative = 0.1
    """alpha of RACER Eq. 11. A large value inflates the values of the data's lexemes, and with them the target."""
    temporal: NotNegative = 1.0
    """Weight of the temporal difference. With 0 the loss is a cross-entropy: the paper's "Supervised Learning"."""
    warm_up: Share = 0.0
    """Share of the run with supervised learning only (the conservative term), so that a short run need not learn the
    data's actions through values. The paper has 0."""
    gamma: Share = 0.99
    """Discount per block."""
    copy_every: Count = 500
    """Steps between two copies of the network to its target."""
    double: bool = True
    """The online network selects the next action and the target values it (Double DQN); else the target does both."""


@dataclass(frozen=True)
class RewardConfig:
    """Sizes of the reward model, and the sampling of its training windows."""

    width: Width = 96
    """C, the width of a block's token and of every layer."""
    projection: Width = 64
    """P, the width of the shared space of motion and audio."""
    kernel: Width = 3
    """Taps of a convolution, in blocks."""
    dilations: Widths = (1, 2, 4)
    """One residual layer each; together with the kernel they reach 15 blocks, more than `longest`."""
    window: Width = 8
    """W, the blocks that a reward depends on, including the current one."""
    longest: Width = 12
    """Blocks of the longest training window."""
    rivals: Natural = 4
    """H, additional negatives of each decoded window: the window with some of its last lexemes replaced. Without them
    a single lexeme hardly changes the reward, and not towards the right one."""
    choice: NotNegative = 0.0
    """Weight of a second loss over a lexicon of movements: classify the last lexeme of a decoded window among all S,
    given its odds after the previous one, so that only the audio adds information. It has the effect of `rivals` for
    every lexeme at the cost of one."""
    members: Width = 1
    """Models of an ensemble, which learn in turns; the paper has 1."""
    caution: NotNegative = 0.0
    """c: the reward is the members' mean less c times their standard deviation."""
    centred: bool = False
    """Subtract the reward of a motion under the mean audio: m . (u - mean u). The paper does not."""

    def __post_init__(self) -> None:
        if self.window > self.longest:
            raise ValueError("windows need window <= longest")


@dataclass(frozen=True)
class EpisodeConfig:
    """The behaviours in the data set, and their reward. The paper has `truth=1` and 0 for the other shares and the
    baseline."""

    truth: Share = 0.65
    """Share of the recorded lexemes: every recording once. The other shares are relative to it, in decisions."""
    sampled: Share = 0.15
    """Share of roll-outs of the supervised interpreter."""
    statistical: Share = 0.10
    """Share of roll-outs of the statistical interpreter."""
    perturbed: Share = 0.10
    """Share of recordings with some lexemes replaced."""
    prefix: Count = 8
    """Recorded lexemes before another behaviour takes over."""
    reward: Annotated[str, SettingChoice(REWARDS)] = "contrastive"
    """"contrastive" (RACER Eq. 8), or "distance" to the recorded motion (the paper's ablation)."""
    baseline: Natural = 8
    """Random sequences of lexemes whose mean reward on the same audio is subtracted from the contrastive reward; 0 for
    none (the paper). It changes no choice, but the Q-network need not learn the effect of the audio alone."""

    def __post_init__(self) -> None:
        check(self, "episodes")
        if abs(sum(self.shares.values()) - 1) > 1e-6:
            raise InputError("episodes", f"has shares {self.shares}", "give four that are not negative and sum to 1")

    @property
    def shares(self) -> dict[str, float]:
        return {name: float(getattr(self, name)) for name in BEHAVIOURS}
