"""What the table of `eval.score` says of one clip: each metric's number, and why where there is none.

With a bundle, a motion is also read as blocks at the beat of its speech, whoever made it:

- the reward is the mean cosine between the motion and the speech in the windows that end with each block, by the
  model that judges, which no policy was trained to please (RACER Eq. 8). No unit, from -1 to 1, more is better. Windows
  that are silent throughout are left out. What fools it: a model hears what its training taught it to hear, so motion
  of another style, or of joints that it never saw, gets less for that alone, and random motion far more than 0. Look at
  the distance from the row `shuffled`, not at the value.
- lexeme accuracy is the share of blocks that read as the same lexeme as the speaker's own motion, percent, more is
  better. What fools it: many gestures suit a word, so a good system may have little of it; lexemes of rest are common,
  so standing still may have much. `shuffled` is its chance level as well.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module import blocks as block_module
from data_module.motion.motion_beats import MODES, motion_beats
from data_module.speech.beats import detect_onsets
from data_module.types import Array, Blocks, Motion, Speech
from eval import pmb
from eval.beat_consistency import consistency, mean_score, motion_joint_beats
from eval.joint_error import motion_error
from eval.mismatch import wrapped
from eval.smoothness import motion_smoothness
from gesticulator.speech_features import encode_speech, front_end_for
from gesticulator.statistics import representation_of

if TYPE_CHECKING:
    from gesticulator.bundle import Bundle

WIDE = 0.2
"""Seconds: the delta that the papers print."""


@dataclass(frozen=True)
class Metric:
    """A column. good: "low", "high", "near" (the speaker's own value), or "" for a figure that is no judgement."""

    title: str
    digits: int
    part: str
    good: str


METRICS: dict[str, Metric] = {
    "maje": Metric("MAJE, mm, mean of coordinates", 1, "joints", "low"),
    "maje_length": Metric("MAJE, mm, length", 1, "joints", "low"),
    "mad": Metric("MAD, mm/s^2, length", 0, "joints", "low"),
    "mad_per_frame": Metric("MAD, mm/frame^2, length", 2, "joints", "low"),
    "mad_coordinate_per_frame": Metric("MAD, mm/frame^2, coordinates", 2, "joints", "low"),
    "pmb_A": Metric("PMB A, 0.1 s, %", 1, "beats", "high"),
    "chance_A": Metric("chance of PMB A, %", 1, "beats", ""),
    "above_A": Metric("PMB A above chance, %", 1, "beats", "high"),
    "pmb_A_wide": Metric("PMB A, 0.2 s, %", 1, "beats", "high"),
    "area_A": Metric("area of the delta curve A, %", 1, "beats", "high"),
    "pmb_B": Metric("PMB B, 0.1 s, %", 1, "beats", "high"),
    "chance_B": Metric("chance of PMB B, %", 1, "beats", ""),
    "above_B": Metric("PMB B above chance, %", 1, "beats", "high"),
    "consistency": Metric("beat consistency", 3, "consistency", "high"),
    "consistency_chance": Metric("chance of consistency", 3, "consistency", ""),
    "consistency_above": Metric("consistency above chance", 3, "consistency", "high"),
    "beats_per_second": Metric("motion beats A a second", 2, "consistency", "near"),
    "speed_hands": Metric("hand speed, m/s", 3, "vigour", "near"),
    "acceleration_hands": Metric("hand acceleration, m/s^2", 2, "vigour", "near"),
    "acceleration": Metric("joint acceleration, m/s^2", 2, "vigour", "near"),
    "jerk_hands": Metric("hand jerk, m/s^3", 1, "vigour", "near"),
    "jerk": Metric("joint jerk, m/s^3", 1, "vigour", "near"),
}
"""The metrics that have a value for each clip."""
LEXEME_METRICS: dict[str, Metric] = {
    "reward": Metric("reward of the judging model, cosine", 3, "lexemes", "high"),
    "lexeme_accuracy": Metric("lexemes like the speaker's own, %", 1, "lexemes", "high"),
}
"""Those that take a bundle."""
SYNCHRONY = ("pmb_A", "pmb_B", "consistency")
"""Those that the mismatch test tries."""
_PAIR = tuple(name for name, metric in METRICS.items() if metric.part == "joints")
_SOUND = tuple(name for name, metric in METRICS.items()
               if metric.part in ("beats", "consistency") and name != "beats_per_second")


@dataclass(frozen=True)
class Heard:
    """The onsets of a clip's speech, seconds, and how long it lasts."""

    onsets: Array
    duration: float

    @classmethod
    def of(cls, speech: Speech) -> Heard:
        """By `detect_onsets`."""
        return cls(detect_onsets(speech.samples, speech.sample_rate), speech.duration)

    def lasting(self, duration: float) -> Heard:
        """As if it lasted this long: cut, or said again."""
        return Heard(wrapped(self.onsets, self.duration, duration), duration)


@dataclass(frozen=True)
class Moved:
    """The beats of a clip's motion, seconds: by the mode of `motion_beats`, and of each joint by BEAT's rule."""

    modes: dict[str, Array]
    joints: list[Array]
    duration: float

    @classmethod
    def of(cls, motion: Motion) -> Moved:
        """Both kinds."""
        return cls({mode: motion_beats(motion, mode) for mode in MODES}, motion_joint_beats(motion), motion.duration)


@dataclass
class Values:
    """The numbers of a clip by metric, and the reason of each that is NaN."""

    numbers: dict[str, float] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)

    def put(self, name: str, number: float, reason: str) -> None:
        """Keep a number; the reason only where it is undefined."""
        self.numbers[name] = float(number)
        if not np.isfinite(number):
            self.reasons[name] = reason or "it is not defined for this clip"


def clip_values(motion: Motion, truth: Motion, moved: Moved, heard: Heard | None, seed: int) -> Values:
    """Every one of `METRICS` for a motion beside the speaker's own of the same length, and what was said."""
    out = Values()
    error = motion_error(motion, truth)
    for name in _PAIR:
        out.put(name, getattr(error, name), error.reason)
    smooth = motion_smoothness(motion)
    for name in ("speed_hands", "acceleration_hands", "acceleration", "jerk_hands", "jerk"):
        out.put(name, getattr(smooth, name), smooth.reason)
    out.put("beats_per_second", len(moved.modes["A"]) / motion.duration, "")
    if heard is None:
        for name in _SOUND:
            out.put(name, float("nan"), "its speech is not known")
        return out
    _sound_values(out, moved, heard.lasting(moved.duration), seed)
    return out


def _sound_values(out: Values, moved: Moved, heard: Heard, seed: int) -> None:
    for mode in MODES:
        beats, still = moved.modes[mode], "the motion has no beat"
        percent = pmb.pmb(beats, heard.onsets)
        chance = pmb.chance(beats, heard.onsets, heard.duration, seed=seed)
        out.put(f"pmb_{mode}", percent, still)
        out.put(f"chance_{mode}", chance.mean, still)
        out.put(f"above_{mode}", 100.0 * pmb.above_chance(percent, chance.mean),
                "chance leaves no room" if len(beats) else still)
    out.put("pmb_A_wide", pmb.pmb(moved.modes["A"], heard.onsets, WIDE), "the motion has no beat")
    out.put("area_A", pmb.delta_curve(moved.modes["A"], heard.onsets).area, "the motion has no beat")
    found = consistency(moved.joints, heard.onsets, heard.duration, seed=seed)
    out.put("consistency", found.score, found.reason)
    out.put("consistency_chance", found.chance, found.reason)
    out.put("consistency_above", found.above_chance, found.reason)


def curve(moved: Moved, heard: Heard, mode: str) -> Array:
    """[deltas] PMB at each of `pmb.DELTAS`, percent."""
    return pmb.delta_curve(moved.modes[mode], heard.lasting(moved.duration).onsets).percent


def synchrony(name: str, moved: Moved, heard: Heard) -> float:
    """One of `SYNCHRONY` of a motion with any speech, which is cut or said again to last as long."""
    onsets = heard.lasting(moved.duration).onsets
    if name == "consistency":
        return mean_score(moved.joints, onsets)
    return pmb.pmb(moved.modes[name.removeprefix("pmb_")], onsets)


# ------------------------------------------------------------------------------------------- as a bundle reads it

@dataclass(frozen=True)
class Spoken:
    """A clip's speech as a bundle hears it: its N blocks, and audio [N, K, d] for the reward (None without one)."""

    blocks: Blocks
    audio: Tensor | None
    speaker: str

    @classmethod
    def of(cls, bundle: Bundle, speech: Speech) -> Spoken:
        """Cut and, where there is a model that judges, encoded as its training data was."""
        own = speech.speaker or ""
        if bundle.reward_judge is None:
            return cls(block_module.cut(speech, bundle.config.rhythm), None, own)
        heard = encode_speech(speech, bundle.config, front_end_for(bundle.config, bundle.encoder))
        frames, statistics = bundle.config.rhythm.frames, bundle.statistics
        low = _middle(statistics.low.apply(heard.low), frames)
        if heard.high is heard.low:
            return cls(heard.blocks, low, own)
        high = _middle(statistics.high.apply(heard.high), frames)
        return cls(heard.blocks, torch.cat([low[..., :-1], high], dim=-1), own)


def _middle(windows: NDArray[np.floating], frames: int) -> Tensor:
    """[N, K, d] the block itself of windows of three, in the half precision that corpora are kept in."""
    return torch.as_tensor(windows[:, frames:2 * frames].astype(np.float16)).float()


@dataclass(frozen=True)
class Told:
    """A motion as a bundle reads it. latents: [N, D]; labels: [N] nearest lexemes; reward: NaN without a model."""

    latents: Array
    labels: NDArray[np.int64]
    reward: float


@torch.no_grad()
def told(bundle: Bundle, motion: Motion, spoken: Spoken) -> Told:
    """A motion in the blocks of its speech. Of a performer unknown to the bundle, poses are told from the clip's own
    mean; joints that the source lacks are at rest."""
    poses = block_module.normalise_motion(motion, spoken.blocks, representation_of(bundle.config))
    if spoken.speaker in bundle.speakers:
        features = bundle.statistics.normalise(poses, bundle.speakers.index(spoken.speaker))
    else:
        features = (poses - poses.mean(axis=(0, 1))) / bundle.statistics.deviation
    seen = torch.as_tensor(features, dtype=torch.float32)
    latents = bundle.block_models.lexicon.latents(seen)
    return Told(latents.double().numpy(), bundle.lexicon.quantizer.labels(latents).numpy(),
                _reward(bundle, seen, spoken))


def _reward(bundle: Bundle, seen: Tensor, spoken: Spoken) -> float:
    """The mean reward of motion [N, K, D_m] over the windows that end with each block and are not all silent."""
    model = bundle.reward_judge
    if model is None or spoken.audio is None:
        return float("nan")
    at = torch.arange(len(seen))[:, None] + torch.arange(1 - model.config.window, 1)
    valid, at = (at >= 0).float(), at.clamp_min(0)
    motion = model.block_motion(seen, torch.as_tensor(np.log(spoken.blocks.durations)).float())
    cosines = (model.embed_motion(motion[at], valid) * model.embed_audio(model.block_audio(spoken.audio)[at], valid)
               ).sum(-1)
    heard = ((valid > 0) & ~torch.as_tensor(spoken.blocks.silent)[at]).any(dim=1)
    return float(cosines[heard].double().mean()) if heard.any() else float("nan")


def lexeme_values(own: Told | None, truth: Told | None, judged: bool) -> Values:
    """Both of `LEXEME_METRICS` of a motion beside the speaker's own; None where there is no speech. judged: whether the
    bundle has a model that judges."""
    out, nan = Values(), float("nan")
    if own is None or truth is None:
        for name in LEXEME_METRICS:
            out.put(name, nan, "its speech is not known")
        return out
    out.put("reward", own.reward, "nothing is said" if judged else "the bundle has no judging reward model")
    out.put("lexeme_accuracy", 100.0 * float((own.labels == truth.labels).mean()), "")
    return out
