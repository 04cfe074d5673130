"""Does the gate know when people gesture, and what does it do? `gesticulator probe gate --data STORE [--bundle DIR]`

Theory: the gate (RG 8, third limitation) says how likely a gesture is on each block. The truth is the performer: a
block is active when its own motion has a lexeme that is not silent. Two things are asked of the probability. Does it
rank? The area under the ROC curve (AUC, Hanley and McNeil 1982) is the chance that an active block gets a higher one
than a still block: 0.5 is blind, 1 is perfect. Does it mean what it says? Of the blocks with probability 0.7, seven in
ten should be active: the calibration error is the mean gap over ten bins (0 is perfect), the Brier score the mean
squared error, to be set beside that of always saying the base rate.

What fools it: people gesture little in pauses, so silence alone has an AUC above 0.5, and so has loudness; the gate
must beat both. Performers differ in how often they gesture, so knowing who it is helps over all recordings together
(the row "performer alone"); the AUC within recordings leaves that out. The truth is read through the lexicon and its
list of silent lexemes: another list is another truth.

Then the gate is used: for each `activity`, how many blocks gesture, how fast the hands are, and how slow they are in
the blocks that it closed, each beside the same blocks of the same speech without the gate.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from sklearn.metrics import roc_auc_score
from tqdm import tqdm

from data_module.blocks import cut
from data_module.errors import InputError
from data_module.speech.silence import FRAME, frame_levels
from data_module.store import SPLITS, Recording, Store
from data_module.types import Array, Speech
from eval import stats
from eval.draw.lexicon_map import block_of_frames, evenly
from eval.encode import encode_motion
from eval.metrics.smoothness import hand_speeds
from eval.stats import Interval, mean_interval
from eval.table import Column, Table
from gesticulator.bundle import Bundle
from gesticulator.features import encode_speech, front_end_for
from gesticulator.pipeline import Gesticulator
from interpreters.base import BlockFeatures

GATE, LOUDNESS, SILENCE, PERFORMER = "gate", "loudness alone", "detected silence alone", "performer alone"
ACTIVITIES = (0.0, 0.25, 0.5, 0.75, 1.0)
BINS, DRAWS = 10, 500
Flags = NDArray[np.bool_]


# ------------------------------------------------------------------------------------------------ known when?

@dataclass(frozen=True)
class GateScores:
    """One recording. active: [N] the performer gestures on the block; scores: by name, [N], higher for likelier, those
    of the gate being probabilities; group: recordings of one group share their speech."""

    group: str
    active: Flags
    scores: Mapping[str, Array]


def auc(active: Flags, scores: Array, weights: Array | None = None) -> float:
    """Area under the ROC curve for [N] truths and scores; NaN where only one kind of block is there."""
    kept = np.ones(len(active), bool) if weights is None else weights > 0
    if len(np.unique(active[kept])) < 2:
        return float("nan")
    return float(roc_auc_score(active, scores, sample_weight=weights))


@dataclass(frozen=True)
class Bin:
    """Blocks whose probability lies in [low, high): how many, what was said on average, how many were active."""

    low: float
    high: float
    blocks: int
    said: float
    happened: float


def calibration(active: Flags, probability: Array, bins: int = BINS) -> list[Bin]:
    """What was said beside what happened, in bins of equal width that hold any of the [N] blocks."""
    own = np.minimum((probability * bins).astype(int), bins - 1)
    return [Bin(i / bins, (i + 1) / bins, int((own == i).sum()), float(probability[own == i].mean()),
                float(active[own == i].mean())) for i in np.unique(own).tolist()]


def calibration_error(active: Flags, probability: Array, weights: Array | None = None, bins: int = BINS) -> float:
    """Mean gap between what was said and what happened over the bins, weighted by their blocks."""
    weight = np.ones(len(active)) if weights is None else weights
    own = np.minimum((probability * bins).astype(int), bins - 1)
    gaps = np.abs(np.bincount(own, weight * (probability - active)))
    return float(gaps.sum() / weight.sum())


def brier(active: Flags, probability: Array | float, weights: Array | None = None) -> float:
    """Mean squared difference between probability and truth."""
    return float(np.average((probability - active.astype(np.float64)) ** 2, weights=weights))


def resampled(owner: NDArray[np.int64], statistic: Callable[[Array], float], draws: int = DRAWS) -> Interval:
    """A statistic of pooled blocks with its bootstrap interval, groups of recordings being what is drawn.

    owner: [N] the group of each block, 0 to G - 1; statistic(weights [N]) counts a block as often as its group was
    drawn.
    """
    groups = int(owner.max()) + 1
    return stats.of_set(lambda chosen: statistic(np.bincount(chosen, minlength=groups)[owner].astype(np.float64)),
                        groups, draws=draws, basic=False)


def knowledge(judged: Sequence[GateScores], draws: int = DRAWS) -> dict[str, Any]:
    """AUC of every score over all blocks and within recordings, the gate's lead over each, and its calibration."""
    groups = sorted({own.group for own in judged})
    owner = np.concatenate([np.full(len(own.active), groups.index(own.group)) for own in judged])
    active = np.concatenate([own.active for own in judged])
    scores = {name: np.concatenate([own.scores[name] for own in judged]) for name in judged[0].scores}
    said = scores[GATE]

    def area(score: Array) -> Callable[[Array], float]:
        return lambda weights: auc(active, score, weights)

    def lead(score: Array) -> Callable[[Array], float]:
        return lambda weights: auc(active, said, weights) - auc(active, score, weights)

    rows: dict[str, Any] = {}
    for name, score in scores.items():
        inside = [[auc(own.active, own.scores[name]) for own in judged if own.group == group] for group in groups]
        rows[name] = {
            "auc": resampled(owner, area(score), draws=draws),
            "auc_within_recordings": mean_interval([_mean(values) for values in inside],
                                              np.bincount(owner, minlength=len(groups)))}
        if name != GATE:
            rows[name]["gate_leads_by"] = resampled(owner, lead(score), draws=draws)
    return {
        "recordings": len(judged), "groups": len(groups), "blocks": len(active), "active": float(active.mean()),
        "auc": rows,
        "calibration": {
            "error": resampled(owner, lambda w: calibration_error(active, said, w), draws=draws),
            "brier": resampled(owner, lambda w: brier(active, said, w), draws=draws),
            "brier_of_the_base_rate": brier(active, float(active.mean())),
            "bins": calibration(active, said)},
    }


def _mean(values: Sequence[float]) -> float:
    kept = [value for value in values if np.isfinite(value)]
    return float(np.mean(kept)) if kept else float("nan")


def loudness(speech: Speech, edges: Array) -> Array:
    """[N] mean level of each block, dB over the recording's median (recordings differ in level)."""
    levels = frame_levels(speech.samples, speech.sample_rate)
    total = np.concatenate([[0.0], np.cumsum(levels)])
    at = np.clip(np.round(edges / FRAME).astype(int), 0, len(levels))
    return np.diff(total[at]) / np.maximum(np.diff(at), 1) - float(np.median(levels))


@torch.no_grad()
def judge(system: Gesticulator, recording: Recording) -> GateScores:
    """The gate and its controls on one recording, block by block as in use."""
    bundle, speech = system.bundle, recording.speech
    gate = gate_of(bundle, "--bundle")
    encoded = encode_speech(speech, bundle.config, front_end_for(bundle.config, bundle.encoder))
    read = encode_motion(bundle, recording.motion, encoded.blocks, recording.info.speaker)
    known = recording.info.speaker in bundle.speakers
    who = system.speaker_index(recording.info.speaker if known else None)
    state, said = gate.start(who), np.empty(len(encoded.blocks))
    for i, window in enumerate(encoded.low):
        low = torch.as_tensor(bundle.statistics.low.apply(window), dtype=torch.float32)
        said[i], state = gate.step(state, BlockFeatures(low, low))
    habit = 1.0 - float(bundle.frequencies[who][bundle.silent].sum())
    quiet = encoded.blocks.silent
    return GateScores(recording.info.group or recording.info.name, ~np.isin(read.labels, bundle.silent), {
        GATE: said, LOUDNESS: loudness(speech, encoded.blocks.edges), SILENCE: (~quiet).astype(np.float64),
        PERFORMER: np.full(len(said), habit)})


def gate_of(bundle: Bundle, subject: str) -> Any:
    """The bundle's gate; InputError when it has none."""
    if bundle.gate is None:
        raise InputError(subject, "has no gate", "train one: schedules.gate.steps above 0")
    return bundle.gate


# ---------------------------------------------------------------------------------------------------- in use

@dataclass(frozen=True)
class GatedMotion:
    """One performance. edges: [N + 1] s; gesturing: [N] the lexeme is not silent; closed: [N] the gate shut the block;
    speed: [T - 1] mean of both hands between frames, m/s, at `fps`."""

    edges: Array
    gesturing: Flags
    closed: Flags
    speed: Array
    fps: float


def within(played: GatedMotion, blocks: Flags) -> Flags:
    """[T - 1] the frames of the chosen blocks [N]."""
    return blocks[block_of_frames(played.edges, len(played.speed), played.fps)]


def row(played: Sequence[GatedMotion], ungated: Sequence[GatedMotion]) -> dict[str, Any]:
    """Figures of one activity, each with its difference from the same recordings without the gate.

    Speeds in closed blocks are medians over frames; beside them the median in the same blocks without the gate.
    """
    sizes = [len(own.gesturing) for own in played]
    share = np.array([own.gesturing.mean() for own in played])
    mean = np.array([own.speed.mean() for own in played])
    pairs = [(_median(own.speed[within(own, own.closed)]), _median(other.speed[within(other, own.closed)]))
             for own, other in zip(played, ungated, strict=True)]
    still, same = np.array(pairs).T
    shut = [int(own.closed.sum()) for own in played]
    return {
        "gesturing": mean_interval(share, sizes),
        "gesturing_change": mean_interval(share - [own.gesturing.mean() for own in ungated], sizes),
        "hand_speed": mean_interval(mean, sizes),
        "hand_speed_change": mean_interval(mean - [own.speed.mean() for own in ungated], sizes),
        "closed_blocks": sum(shut),
        "closed_speed": mean_interval(still, shut),
        "closed_speed_without": mean_interval(same, shut),
        "closed_speed_change": mean_interval(still - same, shut),
    }


def _median(values: Array) -> float:
    return float(np.median(values)) if len(values) else float("nan")


def play(system: Gesticulator, recording: Recording, activity: float) -> GatedMotion:
    """One recording at one activity, in the habits of its performer where the bundle knows them."""
    who = recording.info.speaker if recording.info.speaker in system.speakers else None
    made = system(recording.speech, speaker=who, activity=activity)
    gesturing = ~np.isin(made.lexemes, system.bundle.silent)
    if activity >= 1 or made.gate is None:
        closed = np.zeros(len(gesturing), bool)
    else:
        closed = np.ones(len(gesturing), bool) if activity <= 0 else made.gate < 1 - activity
    return GatedMotion(made.blocks.edges, gesturing, closed, hand_speeds(made.motion).mean(axis=1), made.motion.fps)


def performed(bundle: Bundle, recording: Recording) -> GatedMotion:
    """The performer's own motion, whose still blocks count as closed."""
    blocks = cut(recording.speech, bundle.config.rhythm)
    read = encode_motion(bundle, recording.motion, blocks, recording.info.speaker)
    gesturing = ~np.isin(read.labels, bundle.silent)
    return GatedMotion(read.blocks.edges, gesturing, ~gesturing, hand_speeds(recording.motion).mean(axis=1),
                  recording.motion.fps)


# ---------------------------------------------------------------------------------------------------- tables

def figures(system: Gesticulator, recordings: Sequence[Recording], progress: bool = True) -> dict[str, Any]:
    """Everything that the tables show."""
    judged = [judge(system, recording) for recording in tqdm(recordings, desc="gate", disable=not progress)]
    played = {activity: [play(system, recording, activity) for recording in
                         tqdm(recordings, desc=f"activity {activity:g}", disable=not progress)]
              for activity in ACTIVITIES}
    own = [performed(system.bundle, recording) for recording in recordings]
    return {"seconds": round(sum(r.speech.duration for r in recordings), 1), "knowledge": knowledge(judged),
            "activity": {"performer": row(own, own),
                         **{f"{activity:g}": row(made, played[1.0]) for activity, made in played.items()}}}


KNOWS = {"auc": Column("AUC", digits=3, good="high"), "auc_within_recordings": Column("in one recording", digits=3),
         "gate_leads_by": Column("the gate leads by", digits=3)}
BINS_SHOWN = {"blocks": Column("blocks"), "said": Column("said, mean"), "happened": Column("active")}
USE = {"gesturing": Column("blocks gesturing", "share", 3), "gesturing_change": Column("against no gate", digits=3),
       "hand_speed": Column("hands", "m/s"), "hand_speed_change": Column("against no gate", "m/s"),
       "closed_blocks": Column("closed blocks"), "closed_speed": Column("hands there, median", "m/s", 3),
       "closed_speed_without": Column("there without the gate", "m/s", 3),
       "closed_speed_change": Column("difference", "m/s", 3)}
_UNPAIRED = ("gesturing_change", "hand_speed_change", "closed_speed_without", "closed_speed_change")
"""Columns that compare with playing without the gate, which the performer has no part in."""


def tables(result: Mapping[str, Any], facts: Mapping[str, Any]) -> list[Table]:
    """What the gate knows, whether it is calibrated, and what it does."""
    known = result["knowledge"]
    error, brier_score = (known["calibration"][key].text(3) for key in ("error", "brier"))
    about = (f"{known['recordings']} recordings ({known['groups']} with speech of their own), {result['seconds']:.0f} "
             f"s, {known['blocks']} blocks, {100 * known['active']:.0f} % with a gesture by the performer.")
    calibrated = (f"Calibration error {error}; Brier score {brier_score}, and "
                  f"{known['calibration']['brier_of_the_base_rate']:.3f} for always saying the base rate.")
    bins = {f"{own.low:.1f} to {own.high:.1f}": {key: getattr(own, key) for key in BINS_SHOWN}
            for own in known["calibration"]["bins"]}
    use = {name: {key: value for key, value in own.items() if name != "performer" or key not in _UNPAIRED}
           for name, own in result["activity"].items()}
    return [Table("What tells gesture from stillness", KNOWS, known["auc"], "score", [about], facts),
            Table("Calibration", BINS_SHOWN, bins, "probability said", [calibrated]),
            Table("The gate in use", USE, use, "activity")]


def arguments(parser: argparse.ArgumentParser) -> None:
    """A store, a bundle and which recordings."""
    parser.add_argument("--bundle", metavar="DIR", help="default: the shipped one")
    parser.add_argument("--data", required=True, metavar="STORE")
    parser.add_argument("--split", default="test", choices=SPLITS)
    parser.add_argument("--limit", type=int, metavar="N", help="that many recordings, evenly chosen (all)")


def run(arguments: argparse.Namespace) -> list[Table]:
    """Judge a bundle's gate; InputError when it has none."""
    torch.set_num_threads(1)
    store = Store.open(arguments.data)
    system = Gesticulator.from_pretrained(arguments.bundle)
    gate_of(system.bundle, arguments.bundle or "the shipped bundle")
    result = figures(system, [store.load(info.name) for info in evenly(store, arguments.split, arguments.limit)])
    return tables(result, {"store": {"name": store.corpus, "fingerprint": store.fingerprint,
                                     "split": arguments.split}})
