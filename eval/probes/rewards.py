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
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.types import Array
from eval.context import EvalContext
from eval.metrics.ranking import agreement, retrieval, share_of_range, spreads, true_rank
from eval.metrics.reward_model import DURATIONS, RewardProbe
from eval.renderings import spread_evenly
from eval.stats import Interval, mean_interval, paired
from eval.table import Column, Table
from gesticulator.training.stages.lexicon import token_labels
from gesticulator.training.stages.q_network import takes_of
from interpreters.episodes import Demonstration

Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]
Score = Callable[[Integers, Integers], Array]
"""Windows of motion [B, W] and of audio [B, W], as block numbers, to rewards [B]."""

Cells = dict[str, Any]
"""Intervals and numbers of a row, or of a column, by key."""

SHIFTS = (0, 1, 2, 4, 8, 16)
"""Blocks by which motion is moved against audio, 0 the matched pair."""
AGAINST_RANDOM = (4, 16)
"""Shifts that are held against random motion: one that shares half of its blocks, and one that shares none."""
OTHERS = 3
"""Other recordings whose motion each recording is tried with."""
MOTIONS = ("captured", "decoded")
RETRIEVED = {"captured, own durations": ("captured", False), "decoded, own durations": ("decoded", False),
             DURATIONS: (DURATIONS, False), "decoded": ("decoded", True)}
"""Rows of retrieval: the kind of motion, and whether it is played in the durations of the audio's blocks."""
MODELS = ("reward", "judge")
SEED = 0
MOST = 24
"""Recordings in which windows are sought, evenly spread: the pairs grow with the square of the windows."""


def windows(takes: Sequence[Demonstration], length: int, step: int = 1) -> tuple[Integers, Integers]:
    """Windows [n, W] of `length` blocks of the takes, `step` apart; and which take each is of, [n]."""
    each = [np.lib.stride_tricks.sliding_window_view(take.blocks, length)[::step] for take in takes]
    return np.concatenate(each), np.repeat(np.arange(len(takes)), [len(own) for own in each])


def retrieved(probe: RewardProbe, takes: Sequence[Demonstration], silent: Mask) -> dict[str, Cells]:
    """Retrieval by the kind of motion and of rivals; windows of `MOST` takes, one window apart."""
    own, owner = windows(spread_evenly(takes, MOST), probe.model.config.window, probe.model.config.window)
    audible = ~silent[own].all(axis=1)
    own, owner = own[audible], owner[audible]
    same = owner[:, None] == owner
    out = {}
    for name, (kind, retimed) in RETRIEVED.items():
        scores = probe.pairs(kind, own, retimed)
        for against, rivals in (("same recording", same), ("other recordings", ~same)):
            out[f"{name}, rivals of {against}"] = {
                key: mean_interval(hits, groups=owner) for key, hits in retrieval(scores, rivals).items()}
    return out


def shifted(score: Score, own: Integers, owner: Integers, shift: int) -> Array:
    """[n] the reward of each audio window with the motion `shift` blocks earlier and later, the mean of both.

    own: [n, W] windows one block apart, owner: [n] of which take. Only the one where the other is out of the take, NaN
    where both are.
    """
    at, tries = np.arange(len(own)), np.full((2, len(own)), np.nan)
    for row, way in zip(tries, (-shift, shift), strict=True):
        there = at[(at + way >= 0) & (at + way < len(own))]
        there = there[owner[there + way] == owner[there]]
        if len(there):
            row[there] = score(own[there + way], own[there])
    return np.where(np.isnan(tries[0]), tries[1], np.where(np.isnan(tries[1]), tries[0], tries.mean(axis=0)))


def by_shift(probe: RewardProbe, kind: str, takes: Sequence[Demonstration]) -> dict[str, Array]:
    """Rewards [n] of every window of the takes: by shift in blocks, with other recordings' motion, and with random
    motion: captured blocks of any take, or any lexemes, each drawn by itself."""
    own, owner = windows(takes, probe.model.config.window)
    out = {str(shift): shifted(partial(probe.score, kind), own, owner, shift) for shift in SHIFTS}
    anything, others, random = np.concatenate([take.blocks for take in takes]), [], []
    for place, take in enumerate(takes):
        audio, rng = own[owner == place], np.random.default_rng([SEED, take.recording])
        trials = [probe.score(kind, np.resize(own[owner == (place + on) % len(takes)], audio.shape), audio)
                  for on in range(1, min(OTHERS + 1, len(takes)))]
        others.append(np.mean(trials, axis=0) if trials else np.full(len(audio), np.nan))
        random.append(probe.played(rng.integers(probe.table.size, size=audio.shape), audio) if kind == "decoded"
                      else probe.score(kind, rng.choice(anything, audio.shape), audio))
    return out | {"another recording": np.concatenate(others), "random": np.concatenate(random)}


def compared(values: Mapping[str, Array], owner: Integers, window: int) -> tuple[Cells, dict[str, bool]]:
    """Mean rewards [n] by shift, matched less each, two shifts less random; and what of it a reward must have.

    owner: [n] of which take. A claim holds if the whole interval bears it. A shift of more than `window` blocks shares
    none, and need not fall any further.
    """
    def apart(first: object, second: object) -> Interval:
        return paired(values[str(first)], values[str(second)], groups=owner)

    matched = {name: apart(0, name) for name in list(values)[1:]}
    random = {shift: apart(shift, "random") for shift in AGAINST_RANDOM}
    cells = {name: mean_interval(own, groups=owner) for name, own in values.items()}
    cells |= {f"matched - {name}": row for name, row in matched.items()}
    return cells | {f"{shift} - random": row for shift, row in random.items()}, {
        "matched > shifted": all(row.above() for row in matched.values()),
        **{f"shifted by {shift} > random": row.above() for shift, row in random.items()},
        "falls with every shift inside the window": all(
            apart(less, more).above() for less, more in pairwise(SHIFTS) if more <= window)}


def spoken(each: Sequence[NDArray[Any]], takes: Sequence[Demonstration]) -> NDArray[Any]:
    """Rows [M - 1, ...] of each take, one a decision, together; those in silent blocks are left out."""
    return np.concatenate([rows[~take.silent[1:]] for rows, take in zip(each, takes, strict=True)])


def single(rewards: Array, takes: Sequence[Demonstration]) -> Cells:
    """What rewards [n, S] of the decisions that are not in silent blocks say of single actions."""
    true = spoken([take.lexemes[1:] for take in takes], takes)
    owner = owner_of(takes)
    ranks, (share, guessed) = true_rank(rewards, true), share_of_range(rewards, true)
    numbers, sizes = np.unique(owner, return_counts=True)
    spread = np.array([spreads(rewards[owner == k]) for k in numbers])
    return {"median_rank_of_recordings": mean_interval([np.median(ranks[owner == k]) for k in numbers], sizes),
            "share_of_range": mean_interval(share, groups=owner), "guessed_share": mean_interval(guessed, groups=owner),
            "spread_actions": mean_interval(spread[:, 0], sizes), "spread_states": mean_interval(spread[:, 1], sizes)}


def owner_of(takes: Sequence[Demonstration]) -> Integers:
    """[n] which take each decision that is not in a silent block is of."""
    return np.repeat(np.arange(len(takes)), [int((~take.silent[1:]).sum()) for take in takes])


def domain_gap(captured: Array, decoded: Array, random: Array, owner: Integers) -> Cells:
    """gap: captured - decoded; reach: decoded - random lexemes, both over windows [n]; ratio: |gap| / reach, which has
    to be small (NaN where random lexemes have no less)."""
    gap, reach = paired(captured, decoded, groups=owner), paired(decoded, random, groups=owner)
    return {"gap": gap, "reach": reach, "ratio": abs(gap.mean) / reach.mean if reach.mean > 0 else float("nan")}


def figures(probe: RewardProbe, takes: Sequence[Demonstration], silent: Mask, rewards: Array
            ) -> tuple[dict[str, Cells], dict[str, Cells], Cells, dict[str, bool]]:
    """Of one model: retrieval, mean rewards by kind of motion and shift, single actions, and which claims hold.

    rewards: [n, S] of the decisions that are not in silent blocks.
    """
    found, (own, owner) = retrieved(probe, takes, silent), windows(takes, probe.model.config.window)
    audible = ~silent[own].all(axis=1)
    values = {kind: {name: every[audible] for name, every in by_shift(probe, kind, takes).items()} for kind in MOTIONS}
    shifts, hits = dict[str, Cells](), found["decoded, rivals of same recording"]
    claims = {"retrieval above chance, same recording, both ways": all(
        hits[f"{way}_r1"].above(hits["chance_r1"].mean) for way in ("motion", "audio"))}
    for kind in MOTIONS:
        shifts[kind], held = compared(values[kind], owner[audible], probe.model.config.window)
        claims |= {f"{kind}: {claim}": holds for claim, holds in held.items()}
    gap = domain_gap(values["captured"]["0"], values["decoded"]["0"], values["decoded"]["random"], owner[audible])
    actions = single(rewards, takes)
    claims["domain gap below a quarter of the reach"] = gap["ratio"] < 0.25
    claims["true lexeme above chance"] = actions["median_rank_of_recordings"].below((rewards.shape[1] + 1) / 2)
    return found, shifts, gap | actions, claims


def rewards(context: EvalContext) -> list[Table]:
    """Every table. InputError for a bundle without both reward models, and for a store without a test recording that is
    as long as a reward looks back."""
    bundle, store = context.bundle, context.store
    if bundle.reward is None or bundle.reward_judge is None:
        raise InputError(context.work, "lacks one of the two reward models of the bundle's training",
                         "give the work folder of its training, with schedules.reward.steps above 0")
    corpus, window = context.corpus, bundle.reward.config.window
    labels = token_labels(bundle.lexicon, corpus)
    takes = [take for take in takes_of(corpus, labels, "test") if len(take.blocks) >= window][:context.limit]
    if all(corpus.silent[take.blocks].all() for take in takes):
        raise InputError(store.path, f"has no test recording of {window} blocks with speech", "build the store again")
    probes = [RewardProbe.of(model, bundle, corpus, labels) for model in (bundle.reward, bundle.reward_judge)]
    every = [spoken([own.every(take) for take in takes], takes) for own in probes]
    told = {"name": store.corpus, "fingerprint": store.fingerprint, "test_recordings": len(takes),
            "blocks": sum(len(take.blocks) for take in takes)}
    lexemes, agreed = every[0].shape[1], mean_interval(agreement(*every), groups=owner_of(takes))
    note = (f"A rank of {(lexemes + 1) / 2:.1f} among {lexemes} lexemes is chance. Over actions the rewards of the two "
            f"models correlate by {agreed.text(3)}.")
    return tables([figures(own, takes, corpus.silent, each) for own, each in zip(probes, every, strict=True)],
                  note, {"store": told, "settings": {"window": window, "others": OTHERS, "seed": SEED}})


# ---------------------------------------------------------------------------------------------------------- tables

_RETRIEVAL = {f"{way}_r{first}": Column(f"{title}R@{first}", "%", 1) for way, title in (
    ("motion", "audio for motion "), ("audio", "motion for audio "), ("chance", "chance ")) for first in (1, 5)}
_SINGLE = {"gap": Column("captured - decoded", digits=3), "reach": Column("decoded - random lexemes", digits=3),
           "ratio": Column("their ratio"),
           "median_rank_of_recordings": Column("median rank of the true lexeme", digits=1),
           "share_of_range": Column("its share of the range of rewards", digits=3),
           "guessed_share": Column("the same of any lexeme", digits=3),
           "spread_actions": Column("spread over actions", digits=3),
           "spread_states": Column("spread over states", digits=3)}


def tables(models: Sequence[tuple[dict[str, Cells], dict[str, Cells], Cells, dict[str, bool]]], note: str,
           facts: Mapping[str, Any]) -> list[Table]:
    """Retrieval, rewards by shift, single actions, and what a reward must have, from the figures of `MODELS`."""
    found, kinds, actions, claims = (dict(zip(MODELS, part, strict=True)) for part in zip(*models, strict=True))
    shifts = {f"{name}: {kind}": cells for name, own in kinds.items() for kind, cells in own.items()}
    told = facts["store"]
    about = (f"Test split: {told['test_recordings']} recordings, {told['blocks']} blocks, windows of "
             f"{facts['settings']['window']} blocks; sought in {min(told['test_recordings'], MOST)} of the recordings.")
    return [
        Table("Retrieval", _RETRIEVAL, {f"{name}: {row}": hits for name, own in found.items()
                                        for row, hits in own.items()}, "model, motion, rivals", [about], facts),
        Table("Mean reward by shift, blocks", {key: Column(key, digits=3) for key in shifts}, turned(shifts), "shift"),
        Table("Domain gap and single actions", _SINGLE, actions, "model", [note]),
        Table("Asked of a reward", {name: Column(name) for name in MODELS}, turned({
            name: {claim: "yes" if holds else "no" for claim, holds in own.items()} for name, own in claims.items()}),
            "claim")]


def turned(columns: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Rows of what is held by column."""
    return {row: {name: own[row] for name, own in columns.items()} for row in next(iter(columns.values()))}


arguments = EvalContext.arguments


def run(arguments: argparse.Namespace) -> list[Table]:
    """Every table."""
    return rewards(EvalContext.of(arguments))
