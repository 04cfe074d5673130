"""Does the contrastive reward rank? Retrieval, time shift, domain gap and single actions (RACER 4.2, Eq. 6 to 8).

    gesticulator probe rewards --data STORE [--bundle DIR] [--work DIR]

Both reward models of a bundle, the one that teaches (`reward`) and the one that judges (`judge`), on the test split.
Motion is `captured` or `decoded`, the latter as the lexicon shows the performer's own lexemes. It is played in the
durations of the audio's blocks, as the lexemes of a policy are, wherever it is not called "own durations". Windows that
are silent throughout are left out. Intervals are bootstrap 95 % over recordings, differences are paired.

Retrieval: what share of windows finds its counterpart first, or among the first five. Rivals of the same recording are
the honest ones, as neither voice nor performer tells them apart. What fools it: a model that is given the duration of
every block on both sides can match durations and never look at the pose. `durations alone` shows how far that goes (the
motion is the mean pose throughout); `decoded` leaves no durations to match.

Single actions: the reward of every lexeme after the performer's own, in blocks that are not silent. What fools it: a
reward may prefer some lexemes strongly and for no reason. Where two models that were trained on different recordings
do not agree, what either says of an action is noise.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module.errors import InputError
from data_module.types import Array
from eval.context import EvalContext
from eval.stats import Interval, mean_interval
from eval.table import Cell, Column, Table
from gesticulator import bundle as bundles
from gesticulator.stages.corpus import Corpus
from gesticulator.stages.lexicon import decoded_blocks, token_labels
from gesticulator.stages.q_network import takes_of
from gesticulator.stages.reward import block_audio, reward_table
from interpreters.episodes import Demonstration
from interpreters.reward import RewardModel, RewardTable

Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]
Score = Callable[[Integers, Integers], Array]
"""Windows of motion [B, W] and of audio [B, W], as block numbers, to rewards [B]."""

SHIFTS = (0, 1, 2, 4, 8, 16)
"""Blocks by which motion is moved against audio, 0 the matched pair."""
AGAINST_RANDOM = (4, 16)
"""Shifts that are held against random motion: one that shares half of its blocks, and one that shares none."""
FIRST = (1, 5)
OTHERS = 3
"""Other recordings whose motion each recording is tried with."""
MOTIONS = ("captured", "decoded")
MODELS = ("reward", "judge")
SEED = 0


# ------------------------------------------------------------------------------- quantities: arrays in, numbers out

def windows(blocks: Integers, length: int, step: int = 1) -> Integers:
    """Windows [n, W] of `length` blocks of a recording, `step` apart; none of a recording that is shorter."""
    if len(blocks) < length:
        return np.empty((0, length), dtype=np.int64)
    return np.lib.stride_tricks.sliding_window_view(blocks, length)[::step].copy()


def places(scores: Array, rivals: Mask) -> Integers:
    """[n] the place of each row's own column (1 the first) among itself and its rivals, both [n, n].

    A tie counts as lost: scores that are all the same find nothing.
    """
    rivals = rivals & ~np.eye(len(rivals), dtype=bool)
    beaten = (scores < np.diagonal(scores)[:, None]) & rivals
    return np.asarray(1 + rivals.sum(axis=1) - beaten.sum(axis=1), dtype=np.int64)


def retrieval(scores: Array, rivals: Mask) -> dict[str, Array]:
    """Percent of hits for each window [n], NaN for one without a rival; scores [n, n]: motion (rows) against audio.

    motion_r1, motion_r5: audio sought for a motion; audio_r1, audio_r5: motion sought for an audio; chance_r1,
    chance_r5: blind guessing. rivals: [n, n], symmetric.
    """
    count = (rivals & ~np.eye(len(rivals), dtype=bool)).sum(axis=1)
    out = {}
    for first in FIRST:
        for name, table in (("motion", scores), ("audio", scores.T)):
            out[f"{name}_r{first}"] = np.where(count > 0, 100.0 * (places(table, rivals) <= first), np.nan)
        out[f"chance_r{first}"] = np.where(count > 0, 100.0 * np.minimum(1.0, first / (count + 1)), np.nan)
    return out


def shifted(score: Score, own: Integers, shift: int) -> Array:
    """[n] the reward of each audio window with the motion `shift` blocks earlier and later, the mean of both.

    own: [n, W] all windows of a recording, one block apart. Only the one where the other is out of the recording, NaN
    where both are.
    """
    at, total, found = np.arange(len(own)), np.zeros(len(own)), np.zeros(len(own))
    for way in {-shift, shift}:
        there = at[(at + way >= 0) & (at + way < len(own))]
        if len(there):
            total[there] += score(own[there + way], own[there])
            found[there] += 1
    return np.divide(total, found, out=np.full(len(own), np.nan), where=found > 0)


def by_recording(values: Array, owner: Integers, count: int) -> tuple[Array, Array]:
    """Means [R] of the values [n] of each of `count` recordings, and how many they are, [R]; NaN is left out."""
    kept = np.isfinite(values)
    weights = np.bincount(owner[kept], minlength=count).astype(np.float64)
    totals = np.bincount(owner[kept], values[kept], minlength=count)
    return np.divide(totals, weights, out=np.full(count, np.nan), where=weights > 0), weights


def mean_of(values: Array, owner: Integers, count: int) -> Interval:
    """Mean over values [n] with its interval over recordings."""
    return mean_interval(*by_recording(values, owner, count), seed=SEED)


def true_rank(rewards: Array, true: Integers) -> Array:
    """[n] the rank of the true action among rewards [n, S], 1 the highest; chance is (S + 1) / 2.

    Equal rewards share the mean of their ranks, so a constant reward has the rank of chance.
    """
    own = np.take_along_axis(rewards, true[:, None], axis=1)
    return np.asarray(1.0 + (rewards > own).sum(axis=1) + ((rewards == own).sum(axis=1) - 1) / 2.0)


def share_of_range(rewards: Array, true: Integers) -> tuple[Array, Array]:
    """[n] where the reward of the true action lies between the least (0) and the most (1), and where the mean of all
    actions does, which is what guessing has; rewards: [n, S]. NaN where all actions have one reward."""
    least, most = rewards.min(axis=1), rewards.max(axis=1)
    own = np.take_along_axis(rewards, true[:, None], axis=1)[:, 0]
    width = np.where(most > least, most - least, np.nan)
    return (own - least) / width, (rewards.mean(axis=1) - least) / width


def spreads(rewards: Array) -> tuple[float, float]:
    """Standard deviations of rewards [n, S] of one recording: over actions (root mean square over states), and over
    states (of the mean over actions). The second is what no choice of one action can change."""
    return float(np.sqrt(rewards.var(axis=1).mean())), float(rewards.mean(axis=1).std())


def agreement(first: Array, second: Array) -> Array:
    """[n] Pearson correlation over actions of two models' rewards [n, S]; NaN where either is constant."""
    one, other = (rows - rows.mean(axis=1, keepdims=True) for rows in (first, second))
    norm = np.sqrt((one ** 2).sum(axis=1) * (other ** 2).sum(axis=1))
    return np.divide((one * other).sum(axis=1), norm, out=np.full(len(first), np.nan), where=norm > 0)


# ------------------------------------------------------------------------------------------------- a model is asked

@dataclass(frozen=True)
class RewardProbe:
    """A reward model over a corpus, all blocks read once. motion: tokens [N, C] by the kind of motion, without the
    duration of the block; audio: [N, C]; tempo: [N, C] what a block's duration adds to the motion played in it."""

    model: RewardModel
    table: RewardTable
    motion: dict[str, Tensor]
    audio: Tensor
    tempo: Tensor

    @classmethod
    @torch.no_grad()
    def of(cls, model: RewardModel, bundle: bundles.Bundle, corpus: Corpus, labels: Integers) -> RewardProbe:
        """labels: [N] the lexeme of every block."""
        shown = {"captured": corpus.motion, "decoded": decoded_blocks(bundle.lexicon, labels, corpus)}
        shown["durations alone"] = torch.zeros_like(corpus.motion)
        no_duration = torch.zeros(len(corpus.motion))
        return cls(model, reward_table(model, bundle.lexicon, corpus),
                   {name: model.block_motion(motion, no_duration) for name, motion in shown.items()},
                   model.block_audio(block_audio(corpus).float()),
                   model.tempo(torch.as_tensor(np.log(corpus.durations)).float()))

    @torch.no_grad()
    def score(self, kind: str, motion: Integers, audio: Integers) -> Array:
        """[B] the reward of motion blocks [B, W] that are played on audio blocks [B, W], in their durations."""
        heard = torch.as_tensor(audio)
        vectors = self._motion(self.motion[kind][torch.as_tensor(motion)] + self.tempo[heard])
        return _numbers((vectors * self._audio(heard)).sum(-1))

    @torch.no_grad()
    def pairs(self, kind: str, own: Integers, retimed: bool) -> Array:
        """[n, n] rewards of the motion of each window (rows) of own [n, W] with the audio of each.

        retimed: in the durations of that audio; else in its own, which tell the true pair by themselves.
        """
        at = torch.as_tensor(own)
        tokens, heard = self.motion[kind][at], self._audio(at)
        if not retimed:
            return _numbers(self._motion(tokens + self.tempo[at]) @ heard.T)
        return np.stack([_numbers(self._motion(tokens + self.tempo[there]) @ vector)
                         for there, vector in zip(at, heard, strict=True)], axis=1)

    def played(self, lexemes: Integers, audio: Integers) -> Array:
        """[B] the reward of lexemes [B, W] on audio blocks [B, W]."""
        heard = torch.as_tensor(audio)
        return _numbers(self.table.rewards(torch.as_tensor(lexemes), heard, torch.ones(heard.shape)))

    def every(self, take: Demonstration) -> Array:
        """[M - 1, S] the reward of each lexeme at each block of a take but the first, after the true ones."""
        return _numbers(self.table.sequence_every(torch.as_tensor(take.lexemes), torch.as_tensor(take.blocks))[1:])

    def _motion(self, tokens: Tensor) -> Tensor:
        return self.model.embed_motion(tokens, torch.ones(tokens.shape[:2]))

    def _audio(self, blocks: Tensor) -> Tensor:
        return self.model.embed_audio(self.audio[blocks], torch.ones(blocks.shape))


def _numbers(values: Tensor) -> Array:
    return values.double().numpy()


# ------------------------------------------------------------------------------------------------------- the tables

def audible(own: Integers, silent: Mask) -> Mask:
    """[n] which windows [n, W] hold a block that is not silent; silent: [N] of the corpus."""
    return np.asarray(~silent[own].all(axis=1))


def retrieved(probe: RewardProbe, takes: Sequence[Demonstration], silent: Mask) -> dict[str, Any]:
    """Retrieval figures by the kind of motion and the kind of rivals; windows of all takes, one window apart."""
    length = probe.model.config.window
    every = [windows(take.blocks, length, length) for take in takes]
    owner = np.repeat(np.arange(len(takes)), [len(own) for own in every])
    own = np.concatenate(every)
    kept = audible(own, silent)
    own, owner = own[kept], owner[kept]
    same = owner[:, None] == owner
    out: dict[str, Any] = {}
    for name, kind, retimed in (("captured, own durations", "captured", False),
                                ("decoded, own durations", "decoded", False),
                                ("durations alone", "durations alone", False), ("decoded", "decoded", True)):
        scores = probe.pairs(kind, own, retimed)
        out[name] = {against: {key: mean_of(hits, owner, len(takes)) for key, hits in retrieval(scores, rivals).items()}
                     for against, rivals in (("same recording", same), ("other recordings", ~same))}
    return {"windows": len(own), "rows": out}


def shift_values(probe: RewardProbe, kind: str, takes: Sequence[Demonstration], place: int) -> dict[str, Array]:
    """Rewards [n] of every window of a take: by shift in blocks, with other recordings' motion, and with random motion:
    captured blocks of any take, or any lexemes, each drawn by itself."""
    take, length = takes[place], probe.model.config.window
    own = windows(take.blocks, length)
    out = {str(shift): shifted(lambda motion, audio: probe.score(kind, motion, audio), own, shift) for shift in SHIFTS}
    others = [own_windows for on in range(1, len(takes))
              if len(own_windows := windows(takes[(place + on) % len(takes)].blocks, length))][:OTHERS]
    trials = [probe.score(kind, np.resize(other, own.shape), own) for other in others]
    out["another recording"] = np.mean(trials, axis=0) if trials else np.full(len(own), np.nan)
    rng = np.random.default_rng([SEED, take.recording])
    if kind == "decoded":
        out["random"] = probe.played(rng.integers(probe.table.size, size=own.shape), own)
    else:
        out["random"] = probe.score(kind, rng.choice(np.concatenate([t.blocks for t in takes]), own.shape), own)
    return out


def by_shift(probe: RewardProbe, takes: Sequence[Demonstration], silent: Mask) -> dict[str, dict[str, Array]]:
    """Rewards [n] of all windows that are not silent, by kind of motion and shift; "owner": which take each is of."""
    length = probe.model.config.window
    kept = [audible(windows(take.blocks, length), silent) for take in takes]
    owner = np.repeat(np.arange(len(takes)), [int(own.sum()) for own in kept])
    out = {}
    for kind in MOTIONS:
        each = [shift_values(probe, kind, takes, place) for place in range(len(takes))]
        out[kind] = {name: np.concatenate([values[name][own] for values, own in zip(each, kept, strict=True)])
                     for name in each[0]} | {"owner": owner}
    return out


def compared(values: dict[str, Array], count: int) -> dict[str, Any]:
    """Intervals of the rewards under each shift, of matched less each, of each shift less the next ("falls", by the
    greater of the two), and of two shifts less random; values: rewards [n] by shift, and "owner" [n]."""
    owner = values["owner"].astype(np.int64)
    names = [name for name in values if name != "owner"]
    matched = names[0]
    return {"mean": {name: mean_of(values[name], owner, count) for name in names},
            "matched - shifted": {name: mean_of(values[matched] - values[name], owner, count) for name in names[1:]},
            "falls": {str(further): mean_of(values[str(shift)] - values[str(further)], owner, count)
                      for shift, further in zip(SHIFTS, SHIFTS[1:], strict=False)},
            "shifted - random": {str(shift): mean_of(values[str(shift)] - values["random"], owner, count)
                                 for shift in AGAINST_RANDOM}}


def domain_gap(captured: Array, decoded: Array, random: Array, owner: Integers, count: int) -> dict[str, Any]:
    """gap: captured - decoded; reach: decoded - random lexemes, both over windows [n]; ratio: |gap| / reach, which has
    to be small (NaN where random lexemes have no less)."""
    gap, reach = mean_of(captured - decoded, owner, count), mean_of(decoded - random, owner, count)
    return {"gap": gap, "reach": reach,
            "ratio": abs(gap.mean) / reach.mean if reach.mean > 0 else float("nan")}


def spoken(takes: Sequence[Demonstration]) -> list[Mask]:
    """[M - 1] of each take: which decisions are not in a silent block; the first block is no decision."""
    return [~take.silent[1:] for take in takes]


def of_actions(every: Sequence[Array], takes: Sequence[Demonstration]) -> dict[str, Any]:
    """What rewards [M - 1, S] of each take say of single actions."""
    kept = spoken(takes)
    rewards = [values[own] for values, own in zip(every, kept, strict=True)]
    true = [take.lexemes[1:][own] for take, own in zip(takes, kept, strict=True)]
    owner = np.repeat(np.arange(len(takes)), [len(own) for own in true])
    ranks, (share, guessed) = (each(np.concatenate(rewards), np.concatenate(true))
                               for each in (true_rank, share_of_range))
    spread = np.array([spreads(own) if len(own) > 1 else (np.nan, np.nan) for own in rewards])
    medians = [float(np.median(ranks[owner == k])) if (owner == k).any() else np.nan for k in range(len(takes))]
    sizes = [len(own) for own in true]
    return {"actions": int(every[0].shape[1]), "decisions": len(ranks),
            "median_rank": float(np.median(ranks)), "chance_rank": (every[0].shape[1] + 1) / 2,
            "median_rank_of_recordings": mean_interval(medians, sizes, seed=SEED),
            "share_of_range": mean_of(share, owner, len(takes)), "guessed_share": mean_of(guessed, owner, len(takes)),
            "spread_actions": mean_interval(spread[:, 0], sizes, seed=SEED),
            "spread_states": mean_interval(spread[:, 1], sizes, seed=SEED)}


def agreed(first: Sequence[Array], second: Sequence[Array], takes: Sequence[Demonstration]) -> Interval:
    """Correlation over actions of two models' rewards [M - 1, S] of each take, the mean over decisions in speech."""
    kept = spoken(takes)
    owner = np.repeat(np.arange(len(takes)), [int(own.sum()) for own in kept])
    one, other = (np.concatenate([rows[own] for rows, own in zip(model, kept, strict=True)])
                  for model in (first, second))
    return mean_of(agreement(one, other), owner, len(takes))


def acceptance(result: dict[str, Any], window: int) -> dict[str, bool]:
    """Whether a model's figures are what a reward must have. A claim holds if the whole interval bears it; only the
    domain gap goes by means. A shift of more than `window` blocks shares no block, and need not fall any further."""
    rows, shifts = result["retrieval"]["rows"]["decoded"], result["shift"]
    chance = rows["same recording"]["chance_r1"].mean
    out = {"retrieval above chance, same recording, both ways": all(
        rows["same recording"][f"{way}_r1"].above(chance) for way in ("motion", "audio"))}
    for kind in MOTIONS:
        own = shifts[kind]
        out |= {f"{kind}: matched > shifted": all(row.above() for row in own["matched - shifted"].values()),
                **{f"{kind}: shifted by {shift} > random": row.above()
                   for shift, row in own["shifted - random"].items()},
                f"{kind}: falls with every shift inside the window": all(
                    row.above() for shift, row in own["falls"].items() if int(shift) <= window)}
    gap, actions = result["domain_gap"], result["actions"]
    return out | {"domain gap below a quarter of the reach": bool(gap["ratio"] < 0.25),
                  "true lexeme above chance": actions["median_rank_of_recordings"].below(actions["chance_rank"])}


def figures(probe: RewardProbe, takes: Sequence[Demonstration], silent: Mask, every: Sequence[Array]) -> dict[str, Any]:
    """All figures of one model; every: [M - 1, S] of each take, as `RewardProbe.every` gives it."""
    shifts = by_shift(probe, takes, silent)
    captured, decoded = (shifts[kind][str(SHIFTS[0])] for kind in MOTIONS)
    out: dict[str, Any] = {
        "retrieval": retrieved(probe, takes, silent),
        "shift": {kind: compared(values, len(takes)) for kind, values in shifts.items()},
        "domain_gap": domain_gap(captured, decoded, shifts["decoded"]["random"],
                                 shifts["decoded"]["owner"].astype(np.int64), len(takes)),
        "actions": of_actions(every, takes)}
    return out | {"acceptance": acceptance(out, probe.model.config.window)}


def rewards(context: EvalContext) -> dict[str, Any]:
    """Everything that the tables show. InputError for a bundle without both reward models, and for a store without a
    test recording that is as long as a reward looks back."""
    bundle, store = context.bundle, context.store
    if bundle.reward is None or bundle.reward_judge is None:
        raise InputError("the bundle", "lacks one of the two reward models",
                         "train it with schedules.reward.steps above 0")
    corpus = context.corpus
    labels = token_labels(bundle.lexicon, corpus)
    longest = bundle.reward.config.window
    takes = [take for take in takes_of(corpus, labels, "test") if len(take.blocks) >= longest][:context.limit]
    if not any(audible(windows(take.blocks, longest), corpus.silent).any() for take in takes):
        raise InputError(store.path, f"has no test recording of {longest} blocks with speech", "build the store again")
    probes = {name: RewardProbe.of(model, bundle, corpus, labels)
              for name, model in zip(MODELS, (bundle.reward, bundle.reward_judge), strict=True)}
    every = {name: [own.every(take) for take in takes] for name, own in probes.items()}
    return {"store": {"name": store.corpus, "fingerprint": store.fingerprint, "test_recordings": len(takes),
                      "blocks": sum(len(take.blocks) for take in takes)},
            "settings": {"window": longest, "others": OTHERS, "seed": SEED},
            "models": {name: figures(own, takes, corpus.silent, every[name]) for name, own in probes.items()},
            "agreement": agreed(every[MODELS[0]], every[MODELS[1]], takes)}


# ---------------------------------------------------------------------------------------------------------- tables

_RETRIEVAL = {f"{way}_r{first}": Column(f"{title}R@{first}", "%", 1) for way, title in (
    ("motion", "audio for motion "), ("audio", "motion for audio "), ("chance", "chance ")) for first in FIRST}
_ACTIONS = {"median_rank_of_recordings": Column("median rank of the true lexeme", digits=1),
            "share_of_range": Column("its share of the range of rewards", digits=3),
            "guessed_share": Column("the same of any lexeme", digits=3),
            "spread_actions": Column("spread over actions", digits=3),
            "spread_states": Column("spread over states", digits=3)}


def tables(result: dict[str, Any]) -> list[Table]:
    """Retrieval, rewards by shift, single actions, and what a reward must have."""
    told, models = result["store"], result["models"]
    about = (f"Test split: {told['test_recordings']} recordings, {told['blocks']} blocks, windows of "
             f"{result['settings']['window']} blocks.")
    found = {f"{name}: {row}, rivals of {against}": hits for name, own in models.items()
             for row, by_rivals in own["retrieval"]["rows"].items() for against, hits in by_rivals.items()}
    kinds = {f"{name}: {kind}": models[name]["shift"][kind] for name in models for kind in MOTIONS}
    by_kind = {key: Column(key, digits=3) for key in kinds}
    one = next(iter(kinds.values()))
    parts = {"mean": "{}", "matched - shifted": "matched - {}", "shifted - random": "{} - random"}
    shifts = {title.format(shift): {key: own[part][shift] for key, own in kinds.items()}
              for part, title in parts.items() for shift in one[part]}
    single = {name: {"gap": own["domain_gap"]["gap"], "reach": own["domain_gap"]["reach"],
                     "ratio": own["domain_gap"]["ratio"], **{key: own["actions"][key] for key in _ACTIONS}}
              for name, own in models.items()}
    gap = {"gap": Column("captured - decoded", digits=3), "reach": Column("decoded - random lexemes", digits=3),
           "ratio": Column("their ratio")}
    first = models[MODELS[0]]
    accepted: dict[str, dict[str, Cell]] = {
        claim: {name: "yes" if own["acceptance"][claim] else "no" for name, own in models.items()}
        for claim in first["acceptance"]}
    return [
        Table("Retrieval", _RETRIEVAL, found, "model, motion, rivals", [about],
              {"store": told, "settings": result["settings"]}),
        Table("Mean reward by shift, blocks", by_kind, shifts, "shift"),
        Table("Domain gap and single actions", gap | _ACTIONS, single, "model", [
            f"A rank of {first['actions']['chance_rank']:.1f} among {first['actions']['actions']} lexemes is chance. "
            f"Over actions the rewards of the two models correlate by {result['agreement'].text(3)}."]),
        Table("Asked of a reward", {name: Column(name) for name in models}, accepted, "claim")]


def arguments(parser: argparse.ArgumentParser) -> None:
    """A store and a bundle."""
    EvalContext.arguments(parser)


def run(arguments: argparse.Namespace) -> list[Table]:
    """Every table."""
    return tables(rewards(EvalContext.of(arguments)))
