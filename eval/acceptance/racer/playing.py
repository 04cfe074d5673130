"""Policies played: the motion that a bundle's generator makes of their lexemes, and what judges hear in it.

Rows: `performer` is the recording's own motion; `lstm` the bundle's default; `lstm, matched` the same at the
temperature at which it is as undecided as the advantage policy is (equal entropy), which is who it is compared with;
`advantage B` the policy at beta B; `cql` at arg max, as published, and at matched entropy; `random` and `majority`
know nothing.

A judge scores motion as it is played, block by block in its own windows, not lexemes. Nobody trained against it: it is
of other recordings, seeds and sizes than the reward that taught.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from data_module.types import Array
from eval import stats
from eval.ablate.policy import entropy_of, matched_temperature
from eval.baselines.interpreters import Majority, Random
from eval.clip.measure import measure
from eval.context import EvalContext
from eval.metrics import eye
from eval.metrics.encode import SpeechBlocks, encode_motion
from eval.renderings import AcceptanceVoice, BundleSystem, Rendering
from gesticulator.training.stages.interpreter import teacher_logits
from interpreters.base import LexemeInterpreter
from interpreters.reward import RewardEnsemble

PERFORMER, LSTM, MATCHED, CQL, CQL_MATCHED = "performer", "lstm", "lstm, matched", "cql, arg max", "cql, matched"
RANDOM, MAJORITY = "random", "majority"
SHIFT = 8
"""Blocks by which sound is moved against motion in the mismatch test: a window of the reward shares none then."""


def advantage_row(beta: float) -> str:
    """The name of the advantage policy's row at a beta."""
    return f"advantage {beta:g}"


@dataclass(frozen=True)
class PlayedPolicy:
    """Who chooses the lexemes, and how: what the pipeline is asked for. interpreter: a name, or a policy of ours."""

    interpreter: str | LexemeInterpreter
    temperature: float | None = None
    beta: float | None = None

    def options(self) -> dict[str, Any]:
        """For `Gesticulator`."""
        return {"interpreter": self.interpreter, "temperature": self.temperature, "beta": self.beta}

    @property
    def key(self) -> list[Any]:
        """In plain values."""
        name = self.interpreter if isinstance(self.interpreter, str) else type(self.interpreter).__name__
        return [name, self.temperature, self.beta]


# ------------------------------------------------------------------------------------------------ equal entropy

@dataclass(frozen=True)
class TeacherForced:
    """Scores [n, S] of all decisions of some recordings after the performer's lexemes."""

    prior: torch.Tensor
    worth: torch.Tensor
    q: torch.Tensor | None

    @classmethod
    @torch.no_grad()
    def of(cls, context: EvalContext, numbers: Sequence[int]) -> TeacherForced:
        """prior: log pi_b; worth: A in standard deviations; q: Q of the literal CQL, where the bundle has it."""
        parts: dict[str, list[torch.Tensor]] = {"prior": [], "worth": [], "q": []}
        bundle, corpus = context.bundle, context.corpus
        prior, critics, network = bundle.interpreter, bundle.advantage, bundle.q_network
        assert prior is not None and critics is not None
        for number in numbers:
            blocks = corpus.blocks_of(number)
            lexemes = context.labels[blocks]
            odds = teacher_logits(prior, corpus, blocks, lexemes).log_softmax(-1)
            heard = teacher_inputs(context, number)
            parts["prior"].append(odds)
            parts["worth"].append(critics.advantage(critics.values(*heard), odds[None])[0] / critics.spread)
            if network is not None:
                parts["q"].append(network.values(*heard)[0])
        return cls(torch.cat(parts["prior"]), torch.cat(parts["worth"]), torch.cat(parts["q"]) if parts["q"] else None)


def teacher_inputs(context: EvalContext, number: int
                   ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """previous, audio, speaker and silent of all decisions of a recording, as a Q-network takes them."""
    corpus = context.corpus
    blocks = corpus.blocks_of(number)
    who = torch.tensor([int(corpus.speaker_of[number])])
    return (torch.as_tensor(context.labels[blocks[:-1]])[None], corpus.high[torch.as_tensor(blocks[1:])].float()[None],
            functional.one_hot(who, len(corpus.statistics.speakers)).float(),
            torch.as_tensor(corpus.silent[blocks[1:]])[None])


def policies(context: EvalContext, betas: Sequence[float], chosen: float) -> tuple[dict[str, PlayedPolicy], Array]:
    """Every row but the performer's, and [rows of betas] the entropy in nats of each beta's policy on the validation
    split, teacher-forced: the temperatures that match are found there."""
    bundle, selection = context.bundle, context.bundle.config.selection
    forced = TeacherForced.of(context, context.numbers("val") or context.numbers("train")[:2])
    temperature = selection.temperature or 1.0
    nats = {beta: entropy_of(forced.prior / temperature + beta * forced.worth) for beta in {*betas, chosen}}
    rows = {LSTM: PlayedPolicy("lstm"),
            MATCHED: PlayedPolicy("lstm", matched_temperature(forced.prior, nats[chosen]))}
    rows |= {advantage_row(beta): PlayedPolicy("advantage", beta=beta) for beta in sorted({*betas, chosen}) if beta}
    if forced.q is not None:
        rows[CQL] = PlayedPolicy("cql", 0.0)
        rows[CQL_MATCHED] = PlayedPolicy("cql", matched_temperature(forced.q, nats[chosen]))
    rows[RANDOM] = PlayedPolicy(Random(len(bundle.vectors)), 1.0)
    rows[MAJORITY] = PlayedPolicy(Majority(bundle), 1.0)
    return rows, np.array([nats[beta] for beta in sorted(nats)])


# ------------------------------------------------------------------------------------------------------- playing

@dataclass(frozen=True)
class JudgedVoice:
    """A voice, in blocks as the judge hears it."""

    voice: AcceptanceVoice
    heard: SpeechBlocks

    @classmethod
    def of(cls, ours: BundleSystem, voice: AcceptanceVoice) -> JudgedVoice:
        """With its own performer where the bundle knows one, else the bundle's default."""
        known = ours.gesticulator.speakers
        speaker = ours.speaker(voice) or known[ours.gesticulator.speaker_index(None)]
        return cls(voice, SpeechBlocks.of(ours.bundle, replace(voice.speech, speaker=speaker)))

    def played(self, ours: BundleSystem, policy: PlayedPolicy, seed: int) -> Rendering:
        """A policy's motion for it, by the sound alone."""
        wordless = replace(self.voice, speech=replace(self.voice.speech, words=None))
        return ours.render(wordless, seed, named=policy.key, **policy.options())

    def own(self, ours: BundleSystem) -> Rendering:
        """What the performer did, in the blocks of the speech."""
        motion, blocks = self.voice.own, self.heard.blocks
        assert motion is not None
        read = encode_motion(ours.bundle, motion, blocks, self.heard.speaker)
        return Rendering(motion, blocks.edges, blocks.silent, read.labels, read.poses.numpy())


@dataclass
class PlayedFigures:
    """Of one row, by clip: values: column -> [clips], the mean over seeds; lexemes: [clips x seeds] what was played;
    motions: the same as motion; eyes: what the figures for the eye say of each clip."""

    values: dict[str, Array]
    lexemes: list[NDArray[np.int64]]
    motions: list[Any]
    eyes: dict[str, Array] = field(default_factory=dict)


@torch.no_grad()
def rewards_of(model: RewardEnsemble, drawn: torch.Tensor, heard: SpeechBlocks, shift: int = 0) -> Array:
    """[n] the reward of every whole window of blocks [N, K, D_m] that is not silent throughout, with its own sound or
    that `shift` blocks later; only windows that have both, so that the two are paired."""
    assert heard.audio is not None
    window = model.config.window
    count = min(len(drawn), len(heard.audio))
    ends = np.arange(window - 1, count - SHIFT)
    if len(ends) == 0:
        return np.zeros(0)
    at = torch.as_tensor(ends[:, None] + np.arange(1 - window, 1))
    audible = ~torch.as_tensor(heard.blocks.silent)[at].all(1)
    at = at[audible]
    times = torch.as_tensor(np.log(heard.blocks.durations)).float()
    rewards = model.window_rewards(drawn[at], times[at], heard.audio[at + shift], torch.ones(at.shape))
    return rewards.double().numpy()


def figures(ours: BundleSystem, voices: Sequence[JudgedVoice], policy: PlayedPolicy | None, seeds: int
            ) -> PlayedFigures:
    """Play a policy on every voice with every seed, and measure; None is the performer."""
    bundle, out = ours.bundle, PlayedFigures({}, [], [])
    rows: list[dict[str, float]] = []
    seen: list[dict[str, float]] = []
    for place, one in enumerate(voices):
        voice, heard = one.voice, one.heard
        each, looks = [], []
        for seed in range(1 if policy is None else seeds):
            made = one.own(ours) if policy is None else one.played(ours, policy, seed)
            clip = measure(made.motion, voice.speech)
            values = {"speech_speed": clip.speech_speed, "silence_speed": clip.silence_speed,
                      "pmb": clip.rhythm(seed=place).above_chance}
            drawn = torch.as_tensor(made.drawn)
            for name, model in (("reward", bundle.reward), ("judge", bundle.reward_judge)):
                assert model is not None
                values[name] = stats.mean(rewards_of(model, drawn, heard))
                values[f"{name}_shifted"] = stats.mean(rewards_of(model, drawn, heard, SHIFT))
            each.append(values)
            looks.append(eye.figures(made.motion, voice.heard, made.edges, None))
            out.lexemes.append(made.lexemes)
            out.motions.append(made.motion)
        rows.append({key: stats.mean(np.array([own[key] for own in each])) for key in each[0]})
        seen.append({key: stats.mean(np.array([own[key] for own in looks])) for key in looks[0]})
    out.values = {key: np.array([row[key] for row in rows]) for key in rows[0]}
    out.eyes = {key: np.array([row[key] for row in seen]) for key in seen[0]}
    return out
