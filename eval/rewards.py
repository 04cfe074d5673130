"""Does the contrastive reward rank? Retrieval, time shift, domain gap and single actions (RACER 4.2, Eq. 6 to 8).

    python -m eval.rewards --data STORE --work DIR [--bundle DIR] [--out docs/results/rewards.json]

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
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module.errors import InputError, one_line_errors
from data_module.store import Store
from data_module.types import Array
from eval.bootstrap import interval
from eval.results import publish
from gesticulator import bundle as bundles
from gesticulator.stages.corpus import Corpus, prepare
from gesticulator.stages.lexicon import decoded_blocks, token_labels
from gesticulator.stages.q_network import takes_of
from gesticulator.stages.reward import block_audio, reward_table
from interpreters.episodes import Take
from interpreters.reward import RewardModel, RewardTable

Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]
Score = Callable[[Integers, Integers], Array]
"""Windows of motion [B, W] and of audio [B, W], as block numbers, to rewards [B]."""

SHIFTS = (0, 1, 2, 4, 8, 16)
AGAINST_RANDOM = (4, 16)
"""Shifts that are held against random motion: one that shares half of its blocks, and one that shares none."""
"""Blocks by which motion is moved against audio, 0 the matched pair."""
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


def mean_of(values: Array, owner: Integers, count: int) -> dict[str, float]:
    """Mean over values [n] with its interval over recordings."""
    return interval(*by_recording(values, owner, count), seed=SEED).to_dict()


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
class Asked:
    """A reward model over a corpus, all blocks read once. motion: tokens [N, C] by the kind of motion, without the
    duration of the block; audio: [N, C]; tempo: [N, C] what a block's duration adds to the motion played in it."""

    model: RewardModel
    table: RewardTable
    motion: dict[str, Tensor]
    audio: Tensor
    tempo: Tensor

    @classmethod
    @torch.no_grad()
    def of(cls, model: RewardModel, bundle: bundles.Bundle, corpus: Corpus, labels: Integers) -> Asked:
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

    def every(self, take: Take) -> Array:
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


def retrieved(asked: Asked, takes: Sequence[Take], silent: Mask) -> dict[str, Any]:
    """Retrieval figures by the kind of motion and the kind of rivals; windows of all takes, one window apart."""
    length = asked.model.config.window
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
        scores = asked.pairs(kind, own, retimed)
        out[name] = {against: {key: mean_of(hits, owner, len(takes)) for key, hits in retrieval(scores, rivals).items()}
                     for against, rivals in (("same recording", same), ("other recordings", ~same))}
    return {"windows": len(own), "rows": out}


def shift_values(asked: Asked, kind: str, takes: Sequence[Take], place: int) -> dict[str, Array]:
    """Rewards [n] of every window of a take: by shift in blocks, with other recordings' motion, and with random motion:
    captured blocks of any take, or any lexemes, each drawn by itself."""
    take, length = takes[place], asked.model.config.window
    own = windows(take.blocks, length)
    out = {str(shift): shifted(lambda motion, audio: asked.score(kind, motion, audio), own, shift) for shift in SHIFTS}
    others = [own_windows for on in range(1, len(takes))
              if len(own_windows := windows(takes[(place + on) % len(takes)].blocks, length))][:OTHERS]
    trials = [asked.score(kind, np.resize(other, own.shape), own) for other in others]
    out["another recording"] = np.mean(trials, axis=0) if trials else np.full(len(own), np.nan)
    rng = np.random.default_rng([SEED, take.recording])
    if kind == "decoded":
        out["random"] = asked.played(rng.integers(asked.table.size, size=own.shape), own)
    else:
        out["random"] = asked.score(kind, rng.choice(np.concatenate([t.blocks for t in takes]), own.shape), own)
    return out


def by_shift(asked: Asked, takes: Sequence[Take], silent: Mask) -> dict[str, dict[str, Array]]:
    """Rewards [n] of all windows that are not silent, by kind of motion and shift; "owner": which take each is of."""
    length = asked.model.config.window
    kept = [audible(windows(take.blocks, length), silent) for take in takes]
    owner = np.repeat(np.arange(len(takes)), [int(own.sum()) for own in kept])
    out = {}
    for kind in MOTIONS:
        each = [shift_values(asked, kind, takes, place) for place in range(len(takes))]
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
            "ratio": abs(gap["mean"]) / reach["mean"] if reach["mean"] > 0 else float("nan")}


def spoken(takes: Sequence[Take]) -> list[Mask]:
    """[M - 1] of each take: which decisions are not in a silent block; the first block is no decision."""
    return [~take.silent[1:] for take in takes]


def of_actions(every: Sequence[Array], takes: Sequence[Take]) -> dict[str, Any]:
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
            "median_rank_of_recordings": interval(medians, sizes, seed=SEED).to_dict(),
            "share_of_range": mean_of(share, owner, len(takes)), "guessed_share": mean_of(guessed, owner, len(takes)),
            "spread_actions": interval(spread[:, 0], sizes, seed=SEED).to_dict(),
            "spread_states": interval(spread[:, 1], sizes, seed=SEED).to_dict()}


def agreed(first: Sequence[Array], second: Sequence[Array], takes: Sequence[Take]) -> dict[str, float]:
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
    chance = rows["same recording"]["chance_r1"]["mean"]
    out = {"retrieval above chance, same recording, both ways": all(
        rows["same recording"][f"{way}_r1"]["low"] > chance for way in ("motion", "audio"))}
    for kind in MOTIONS:
        own = shifts[kind]
        out |= {f"{kind}: matched > shifted": all(row["low"] > 0 for row in own["matched - shifted"].values()),
                **{f"{kind}: shifted by {shift} > random": row["low"] > 0
                   for shift, row in own["shifted - random"].items()},
                f"{kind}: falls with every shift inside the window": all(
                    row["low"] > 0 for shift, row in own["falls"].items() if int(shift) <= window)}
    gap, actions = result["domain_gap"], result["actions"]
    return out | {"domain gap below a quarter of the reach": bool(gap["ratio"] < 0.25),
                  "true lexeme above chance": actions["median_rank_of_recordings"]["high"] < actions["chance_rank"]}


def figures(asked: Asked, takes: Sequence[Take], silent: Mask, every: Sequence[Array]) -> dict[str, Any]:
    """All figures of one model; every: [M - 1, S] of each take, as `Asked.every` gives it."""
    shifts = by_shift(asked, takes, silent)
    captured, decoded = (shifts[kind][str(SHIFTS[0])] for kind in MOTIONS)
    out: dict[str, Any] = {
        "retrieval": retrieved(asked, takes, silent),
        "shift": {kind: compared(values, len(takes)) for kind, values in shifts.items()},
        "domain_gap": domain_gap(captured, decoded, shifts["decoded"]["random"],
                                 shifts["decoded"]["owner"].astype(np.int64), len(takes)),
        "actions": of_actions(every, takes)}
    return out | {"acceptance": acceptance(out, asked.model.config.window)}


def rewards(store: Store, bundle: bundles.Bundle, work: Path, *, progress: bool = True) -> dict[str, Any]:
    """Every table, as plain values. InputError for a bundle without both reward models, and for a store without a test
    recording that is as long as a reward looks back."""
    if bundle.reward is None or bundle.reward_judge is None:
        raise InputError("the bundle", "lacks one of the two reward models",
                         "train it with schedules.reward.steps above 0")
    corpus = prepare(store, bundle.config, work, bundle.encoder, workers=os.cpu_count() or 1, progress=progress)
    labels = token_labels(bundle.lexicon, corpus)
    longest = bundle.reward.config.window
    takes = [take for take in takes_of(corpus, labels, "test") if len(take.blocks) >= longest]
    if not any(audible(windows(take.blocks, longest), corpus.silent).any() for take in takes):
        raise InputError(store.path, f"has no test recording of {longest} blocks with speech", "build the store again")
    asked = {name: Asked.of(model, bundle, corpus, labels)
             for name, model in zip(MODELS, (bundle.reward, bundle.reward_judge), strict=True)}
    every = {name: [own.every(take) for take in takes] for name, own in asked.items()}
    return {"store": {"name": store.corpus, "fingerprint": store.fingerprint, "test_recordings": len(takes),
                      "blocks": sum(len(take.blocks) for take in takes)},
            "settings": {"window": longest, "others": OTHERS, "seed": SEED},
            "models": {name: figures(own, takes, corpus.silent, every[name]) for name, own in asked.items()},
            "agreement": agreed(every[MODELS[0]], every[MODELS[1]], takes)}


# ------------------------------------------------------------------------------------------------------- for readers

def _cell(value: dict[str, float], digits: int) -> str:
    return f"{value['mean']:.{digits}f} [{value['low']:.{digits}f}, {value['high']:.{digits}f}]"


def _retrieval_table(models: dict[str, Any]) -> list[str]:
    lines = ["| retrieval, % | rivals | audio for motion R@1 | R@5 | motion for audio R@1 | R@5 | chance R@1 | R@5 |",
             "|---" * 8 + "|"]
    for name, own in models.items():
        for row, by_rivals in own["retrieval"]["rows"].items():
            for against, hits in by_rivals.items():
                cells = [_cell(hits[f"{way}_r{first}"], 1) for way in ("motion", "audio") for first in FIRST]
                cells += [f"{hits[f'chance_r{first}']['mean']:.1f}" for first in FIRST]
                lines.append(f"| {name}: {row} | {against} | " + " | ".join(cells) + " |")
    return [*lines, ""]


def _shift_table(models: dict[str, Any]) -> list[str]:
    titles = [f"{name}: {kind}" for name in models for kind in MOTIONS]
    own = [models[name]["shift"][kind] for name in models for kind in MOTIONS]
    lines = ["| mean reward by shift, blocks | " + " | ".join(titles) + " |", "|---" * (len(titles) + 1) + "|"]
    lines += [f"| {shift} | " + " | ".join(_cell(part["mean"][shift], 3) for part in own) + " |"
              for shift in own[0]["mean"]]
    lines += [f"| matched - {shift} | " + " | ".join(_cell(part["matched - shifted"][shift], 3) for part in own) + " |"
              for shift in own[0]["matched - shifted"]]
    lines += [f"| {shift} - random | " + " | ".join(_cell(part["shifted - random"][shift], 3) for part in own) + " |"
              for shift in own[0]["shifted - random"]]
    return [*lines, ""]


def _action_table(result: dict[str, Any]) -> list[str]:
    models = result["models"]
    titles = {"median_rank_of_recordings": ("median rank of the true lexeme", 1),
              "share_of_range": ("its share of the range of rewards", 3),
              "guessed_share": ("the same of any lexeme", 3), "spread_actions": ("spread over actions", 3),
              "spread_states": ("spread over states", 3)}
    lines = ["| gap and actions | " + " | ".join(models) + " |", "|---" * (len(models) + 1) + "|"]
    for key, title in (("gap", "captured - decoded"), ("reach", "decoded - random lexemes")):
        lines.append(f"| {title} | " + " | ".join(_cell(own["domain_gap"][key], 3) for own in models.values()) + " |")
    lines.append("| their ratio | " + " | ".join(f"{own['domain_gap']['ratio']:.2f}" for own in models.values()) + " |")
    for key, (title, digits) in titles.items():
        lines.append(f"| {title} | " + " | ".join(_cell(own["actions"][key], digits) for own in models.values()) + " |")
    told = models[MODELS[0]]["actions"]
    return [*lines, "", f"A rank of {told['chance_rank']:.1f} among {told['actions']} lexemes is chance. Over actions "
            f"the rewards of the two models correlate by {_cell(result['agreement'], 3)}.", ""]


def markdown(result: dict[str, Any]) -> str:
    """The tables for a reader."""
    told, models = result["store"], result["models"]
    lines = [f"Test split: {told['test_recordings']} recordings, {told['blocks']} blocks, windows of "
             f"{result['settings']['window']} blocks. Means with bootstrap 95 % intervals over recordings; differences "
             "are paired.", ""]
    lines += [*_retrieval_table(models), *_shift_table(models), *_action_table(result)]
    lines += ["| asked of a reward | " + " | ".join(models) + " |", "|---" * (len(models) + 1) + "|"]
    lines += [f"| {claim} | " + " | ".join("yes" if own["acceptance"][claim] else "no" for own in models.values())
              + " |"
              for claim in models[MODELS[0]]["acceptance"]]
    return "\n".join(lines) + "\n"


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    p = argparse.ArgumentParser("eval.rewards", description="Does the contrastive reward rank?")
    p.add_argument("--data", required=True, metavar="STORE")
    p.add_argument("--work", required=True, metavar="DIR", help="where blocks are kept")
    p.add_argument("--bundle", metavar="DIR", help="default: the shipped one")
    p.add_argument("--out", default="docs/results/rewards.json", metavar="FILE.json", help="a .md is written beside it")
    arguments = p.parse_args(argv)
    with one_line_errors("eval.rewards"):
        torch.set_num_threads(1)
        store, work = Store.open(arguments.data), Path(arguments.work)
        work.mkdir(parents=True, exist_ok=True)
        result = rewards(store, bundles.load(arguments.bundle or bundles.SHIPPED), work)
        publish(result, markdown(result), arguments.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
