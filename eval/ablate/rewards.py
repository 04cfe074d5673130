"""Does the contrastive reward rank? Retrieval, shifts in time and single actions (RACER 4.2, Eq. 6 to 8).

Both reward models of a bundle, the one that teaches (`reward`) and the one that judges (`judge`), on the test split.
Motion is `captured` or `decoded`, the latter as the lexicon shows the performer's own lexemes. Intervals are bootstrap
95 % over recordings; windows that are silent throughout are left out.

- Retrieval: what share of windows finds its counterpart first. Rivals are of the same recording, so neither voice nor
  performer tells them apart.
- Shifts: the reward of motion moved by so many blocks against its audio, of another recording's and of random motion.
- Single actions: the rank of the performer's own lexeme among all, in blocks that are not silent. What fools it: a
  reward may prefer some lexemes for no reason. Where two models that were trained on different recordings do not
  agree, what either says of an action is noise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module.errors import InputError
from data_module.types import Array
from eval.context import EvalContext
from eval.stats import Interval, mean_interval, paired
from eval.table import Cell, Column, Table
from gesticulator.bundle.bundle import Bundle
from gesticulator.training.stages.corpus import Corpus
from gesticulator.training.stages.lexicon import decoded_blocks, token_labels
from gesticulator.training.stages.q_network import takes_of
from gesticulator.training.stages.reward import block_audio, reward_table
from interpreters.episodes import Demonstration
from interpreters.reward import RewardEnsemble, RewardModel
from interpreters.reward_table import EnsembleReward

Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]
Score = Callable[[Integers, Integers], Array]
"""Windows of motion [B, W] and of audio [B, W], as block numbers, to rewards [B]."""

SHIFTS = (0, 1, 2, 4, 8, 16)
"""Blocks by which motion is moved against audio, 0 the matched pair."""
KINDS = ("captured", "decoded")
MODELS = ("reward", "judge")
SEED = 0
MOST = 24
"""Recordings in which windows are sought, evenly spread: the pairs grow with the square of the windows."""
_AT_ONCE = 2048
"""Windows that are scored at a time, to bound memory."""


# ---------------------------------------------------------------------------------------------------------- the model

@dataclass(frozen=True)
class RewardProbe:
    """A reward model or an ensemble over a corpus; rewards are the members' mean.

    blocks: [N, K, D_m] by the kind of motion; audio: [N, C] tokens for each member.
    """

    model: RewardModel | RewardEnsemble
    table: EnsembleReward
    blocks: dict[str, Tensor]
    audio: list[Tensor]

    @classmethod
    @torch.no_grad()
    def of(cls, model: RewardModel | RewardEnsemble, bundle: Bundle, corpus: Corpus, labels: Integers) -> RewardProbe:
        """labels: [N] the lexeme of every block."""
        blocks = {"captured": corpus.motion, "decoded": decoded_blocks(bundle.lexicon, labels, corpus)}
        audio = block_audio(corpus).float()
        return cls(model, reward_table(model, bundle.lexicon, corpus, literal=True), blocks,
                   [member.block_audio(audio) for member in model.models])

    @torch.no_grad()
    def score(self, kind: str, motion: Integers, audio: Integers) -> Array:
        """[B] the reward of motion blocks [B, W] that are played on audio blocks [B, W]."""
        return np.concatenate([self._score(kind, torch.as_tensor(motion[first:first + _AT_ONCE]),
                                           torch.as_tensor(audio[first:first + _AT_ONCE]))
                               for first in range(0, len(motion), _AT_ONCE)] or [np.zeros(0)])

    def _score(self, kind: str, at: Tensor, audio: Tensor) -> Array:
        blocks = self.blocks[kind][at].float()
        return _numbers(torch.stack([
            (_motion_embedding(member, blocks) * _audio_embedding(member, sound[audio])).sum(-1)
            for member, sound in self._members()]).mean(0))

    @torch.no_grad()
    def pairs(self, kind: str, windows: Integers) -> Array:
        """[n, n] rewards of the motion of each window (rows) of [n, W] with the audio of each."""
        at = torch.as_tensor(windows)
        blocks = self.blocks[kind][at].float()
        return np.mean([_numbers(_motion_embedding(member, blocks) @ _audio_embedding(member, sound[at]).T)
                        for member, sound in self._members()], axis=0)

    def played(self, lexemes: Integers, audio: Integers) -> Array:
        """[B] the reward of lexemes [B, W] on audio blocks [B, W]."""
        blocks = torch.as_tensor(audio)
        return _numbers(self.table.rewards(torch.as_tensor(lexemes), blocks, torch.ones(blocks.shape)))

    def every(self, take: Demonstration) -> Array:
        """[n, S] the reward of each lexeme at each block of a take but the first and the silent ones, after the true
        ones."""
        each = self.table.sequence_every(torch.as_tensor(take.lexemes), torch.as_tensor(take.blocks))[1:]
        return _numbers(each)[~take.silent[1:]]

    def _members(self) -> Iterator[tuple[RewardModel, Tensor]]:
        return zip(self.model.models, self.audio, strict=True)


def _motion_embedding(model: RewardModel, motion: Tensor) -> Tensor:
    """[B, P] of windows [B, W, K, D_m]."""
    return model.embed_motion(model.block_motion(motion), torch.ones(motion.shape[:2]))


def _audio_embedding(model: RewardModel, tokens: Tensor) -> Tensor:
    return model.embed_audio(tokens, torch.ones(tokens.shape[:2]))


def _numbers(values: Tensor) -> Array:
    return values.double().numpy()


# ------------------------------------------------------------------------------------------------------- quantities

def windows(takes: Sequence[Demonstration], length: int, step: int = 1) -> tuple[Integers, Integers]:
    """Windows [n, W] of `length` blocks of the takes, `step` apart; and which take each is of, [n]."""
    each = [np.lib.stride_tricks.sliding_window_view(take.blocks, length)[::step] for take in takes]
    return np.concatenate(each), np.repeat(np.arange(len(takes)), [len(of) for of in each])


def retrieval(scores: Array, rivals: Mask) -> dict[str, Array]:
    """Percent of hits for each window [n], NaN for one without a rival; scores [n, n]: motion (rows) against audio.

    motion_r1: audio sought for a motion; audio_r1: motion sought for an audio; chance_r1: blind guessing. rivals:
    [n, n], symmetric. A tie is lost, so that a constant score finds nothing.
    """
    # A window is no rival of itself.
    rivals = rivals & ~np.eye(len(rivals), dtype=bool)
    count = rivals.sum(axis=1)
    out = {"chance_r1": np.where(count > 0, 100.0 / (count + 1), np.nan)}
    for name, table in (("motion", scores), ("audio", scores.T)):
        beaten = ((table < np.diagonal(table)[:, None]) & rivals).sum(axis=1)
        out[f"{name}_r1"] = np.where(count > 0, 100.0 * (beaten == count), np.nan)
    return out


def true_rank(rewards: Array, true: Integers) -> Array:
    """[n] the rank of the true action among rewards [n, S], 1 the highest; chance is (S + 1) / 2. Equal rewards share
    the mean of their ranks."""
    value = np.take_along_axis(rewards, true[:, None], axis=1)
    return np.asarray(1.0 + (rewards > value).sum(axis=1) + ((rewards == value).sum(axis=1) - 1) / 2.0)


def agreement(first: Array, second: Array) -> Array:
    """[n] Pearson correlation over actions of two models' rewards [n, S]; NaN where either is constant."""
    first_centred, second_centred = (rows - rows.mean(axis=1, keepdims=True) for rows in (first, second))
    norm = np.sqrt((first_centred ** 2).sum(axis=1) * (second_centred ** 2).sum(axis=1))
    products = (first_centred * second_centred).sum(axis=1)
    return np.divide(products, norm, out=np.full(len(first), np.nan), where=norm > 0)


def shifted(score: Score, each: Integers, owner: Integers, shift: int) -> Array:
    """[n] the reward of each audio window with the motion `shift` blocks earlier and later, the mean of both.

    each: [n, W] windows one block apart, owner: [n] of which take. Only the one where the other is out of the take,
    NaN where both are.
    """
    at, tries = np.arange(len(each)), np.full((2, len(each)), np.nan)
    for row, way in zip(tries, (-shift, shift), strict=True):
        there = at[(at + way >= 0) & (at + way < len(each))]
        there = there[owner[there + way] == owner[there]]
        if len(there):
            row[there] = score(each[there + way], each[there])
    return np.where(np.isnan(tries[0]), tries[1], np.where(np.isnan(tries[1]), tries[0], tries.mean(axis=0)))


def by_shift(probe: RewardProbe, kind: str, takes: Sequence[Demonstration]) -> dict[str, Array]:
    """Rewards [n] of every window of the takes: by shift in blocks, with the next recording's motion, and with random
    motion: captured blocks of any take, or any lexemes, each drawn by itself."""
    each, owner = windows(takes, probe.model.config.window)
    out = {str(shift): shifted(partial(probe.score, kind), each, owner, shift) for shift in SHIFTS}
    anything, others, random = np.concatenate([take.blocks for take in takes]), [], []
    for place, take in enumerate(takes):
        audio, rng = each[owner == place], np.random.default_rng([SEED, take.recording])
        # The next recording's windows, repeated where it is shorter.
        donor = np.resize(each[owner == (place + 1) % len(takes)], audio.shape)
        others.append(probe.score(kind, donor, audio) if len(takes) > 1 else np.full(len(audio), np.nan))
        random.append(probe.played(rng.integers(probe.table.size, size=audio.shape), audio) if kind == "decoded"
                      else probe.score(kind, rng.choice(anything, audio.shape), audio))
    return out | {"another recording": np.concatenate(others), "random": np.concatenate(random)}


# ------------------------------------------------------------------------------------------------------------- tables

_RETRIEVAL = {"motion_r1": Column("audio for motion", "% first", 1),
              "audio_r1": Column("motion for audio", "% first", 1),
              "chance_r1": Column("chance", "%", 1)}


def retrieved(probe: RewardProbe, takes: Sequence[Demonstration], silent: Mask) -> dict[str, dict[str, Cell]]:
    """Retrieval among windows of one recording, by the kind of motion; of `MOST` takes, one window apart."""
    spread = np.unique(np.linspace(0, len(takes) - 1, min(MOST, len(takes))).round().astype(int))
    length = probe.model.config.window
    each, owner = windows([takes[k] for k in spread], length, length)
    audible = ~silent[each].all(axis=1)
    each, owner = each[audible], owner[audible]
    return {kind: {key: mean_interval(hits, groups=owner) for key, hits in retrieval(
        probe.pairs(kind, each), owner[:, None] == owner).items()} for kind in KINDS}


def shifts(probe: RewardProbe, takes: Sequence[Demonstration], silent: Mask) -> dict[str, dict[str, Cell]]:
    """By the kind of motion mean rewards by shift, and the matched pairs' less each, paired over windows."""
    each, owner = windows(takes, probe.model.config.window)
    audible = ~silent[each].all(axis=1)
    out = {}
    for kind in KINDS:
        values = {name: rewards[audible] for name, rewards in by_shift(probe, kind, takes).items()}
        groups = owner[audible]
        cells: dict[str, Cell] = {name: mean_interval(rewards, groups=groups) for name, rewards in values.items()}
        out[kind] = cells | {f"matched - {name}": paired(values["0"], rewards, groups=groups)
                             for name, rewards in values.items() if name != "0"}
    return out


def rewards(context: EvalContext) -> list[Table]:
    """Retrieval, rewards by shift and single actions. InputError for a bundle without both reward models, and for a
    store without a test recording that is as long as a reward looks back."""
    bundle, store = context.bundle, context.store
    if bundle.reward is None or bundle.reward_judge is None:
        raise InputError(context.work, "lacks one of the two reward models of the bundle's training",
                         "give the work folder of its training, with schedules.reward.steps above 0")
    corpus, length = context.corpus, bundle.reward.config.window
    labels = token_labels(bundle.lexicon, corpus)
    takes = [take for take in takes_of(corpus, labels, "test") if len(take.blocks) >= length][:context.limit]
    if all(corpus.silent[take.blocks].all() for take in takes):
        raise InputError(store.path, f"has no test recording of {length} blocks with speech", "build the store again")
    probes = {name: RewardProbe.of(model, bundle, corpus, labels)
              for name, model in zip(MODELS, (bundle.reward, bundle.reward_judge), strict=True)}
    each = {name: np.concatenate([probe.every(take) for take in takes]) for name, probe in probes.items()}
    true = np.concatenate([take.lexemes[1:][~take.silent[1:]] for take in takes])
    owner = np.repeat(np.arange(len(takes)), [int((~take.silent[1:]).sum()) for take in takes])
    ranks = {name: true_rank(values, true) for name, values in each.items()}
    agreed, size = mean_interval(agreement(*each.values()), groups=owner), each["reward"].shape[1]
    single: Mapping[str, dict[str, Any]] = {name: {"rank": _median(rank, owner)} for name, rank in ranks.items()}
    moved = {f"{name}: {kind}": cells for name, probe in probes.items()
             for kind, cells in shifts(probe, takes, corpus.silent).items()}
    return [
        Table("Retrieval", _RETRIEVAL, {f"{name}: {kind}": hits for name, probe in probes.items()
                                        for kind, hits in retrieved(probe, takes, corpus.silent).items()},
              "model, motion", [f"Test split: {len(takes)} recordings, windows of {length} blocks."],
              {"store": {"name": store.corpus, "fingerprint": store.fingerprint, "test_recordings": len(takes)}}),
        Table("Mean reward by shift, blocks", {key: Column(key, digits=3) for key in moved}, {
            row: {key: cells[row] for key, cells in moved.items()} for row in next(iter(moved.values()))}, "shift"),
        Table("Single actions", {"rank": Column("median rank of the performer's lexeme", digits=1)}, single, "model", [
            f"A rank of {(size + 1) / 2:.1f} among {size} lexemes is chance. Over actions the rewards of the two "
            f"models correlate by {agreed.text(3)}."])]


def _median(ranks: Array, owner: Integers) -> Interval:
    """The mean over recordings of the median rank."""
    numbers, sizes = np.unique(owner, return_counts=True)
    return mean_interval([np.median(ranks[owner == k]) for k in numbers], sizes)
