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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tqdm import tqdm

from data_module.errors import InputError
from data_module.speech.silence import FRAME, frame_levels
from data_module.store import Recording, Store
from data_module.types import Array, Motion, Speech
from eval.clip.excerpts import block_of_frames, evenly
from eval.metrics.calibration import auc, brier, calibration, calibration_error
from eval.metrics.encode import encode_motion
from eval.metrics.smoothness import hand_speeds
from eval.stats import mean_interval, of_groups, paired
from eval.table import Cell, Column, Table
from gesticulator.performance import Performance
from gesticulator.pipeline import Gesticulator

GATE, LOUDNESS, SILENCE, PERFORMER = "gate", "loudness alone", "detected silence alone", "performer alone"
ACTIVITIES = (0.0, 0.25, 0.5, 0.75, 1.0)
ASKED = 0.5
"""The activity whose performance tells what the gate said: at 0 and 1 it is not asked."""
DRAWS = 500
Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class GateScores:
    """One recording. active: [N] the performer gestures on the block; scores: by name, [N], higher for likelier, those
    of the gate being probabilities; group: recordings of one group share their speech."""

    group: str
    active: Flags
    scores: Mapping[str, Array]


def knowledge(judged: Sequence[GateScores], facts: Mapping[str, Any], draws: int = DRAWS) -> list[Table]:
    """AUC of every score over all blocks and within recordings, the gate's lead over each; and its calibration."""
    names, number = np.unique([own.group for own in judged], return_inverse=True)
    owner = np.repeat(number, [len(own.active) for own in judged])
    active = np.concatenate([own.active for own in judged])
    scores = {name: np.concatenate([own.scores[name] for own in judged]) for name in judged[0].scores}
    said, sizes = scores[GATE], np.bincount(owner)

    pooled = partial(of_groups, owner=owner, draws=draws)

    def lead(score: Array, weights: Array) -> float:
        return auc(active, said, weights) - auc(active, score, weights)

    rows: dict[str, dict[str, Cell]] = {}
    for name, score in scores.items():
        inside = np.array([auc(own.active, own.scores[name]) for own in judged])
        there = [inside[(number == k) & np.isfinite(inside)] for k in range(len(names))]
        rows[name] = {
            "auc": pooled(partial(auc, active, score)),
            "auc_within_recordings": mean_interval([own.mean() if len(own) else np.nan for own in there], sizes)}
        if name != GATE:
            rows[name]["gate_leads_by"] = pooled(partial(lead, score))
    about = (f"{len(judged)} recordings ({len(names)} with speech of their own), {facts['seconds']:.0f} s, "
             f"{len(active)} blocks, {100 * active.mean():.0f} % with a gesture by the performer.")
    error, square = (pooled(partial(figure, active, said)).text(3) for figure in (calibration_error, brier))
    calibrated = (f"Calibration error {error}; Brier score {square}, and {brier(active, active.mean()):.3f} for always "
                  "saying the base rate.")
    return [Table("What tells gesture from stillness", KNOWS, rows, "score", [about], facts),
            Table("Calibration", BINS, calibration(active, said), "probability said", [calibrated])]


def loudness(speech: Speech, edges: Array) -> Array:
    """[N] mean level of each block, dB over the recording's median (recordings differ in level)."""
    levels = frame_levels(speech.samples, speech.sample_rate)
    total = np.concatenate([[0.0], np.cumsum(levels)])
    at = np.clip(np.round(edges / FRAME).astype(int), 0, len(levels))
    return np.diff(total[at]) / np.maximum(np.diff(at), 1) - float(np.median(levels))


@dataclass(frozen=True)
class GatedMotion:
    """One performance. gesturing: [N] the lexeme is not silent; closed: [N] the gate shut the block, or, where whole
    phrases rest (silence.rest=life), the block was left at rest; speed: [T - 1] mean of both hands between frames, m/s;
    block: [T - 1] the block that each lies in."""

    gesturing: Flags
    closed: Flags
    speed: Array
    block: NDArray[np.int64]

    def median_speed(self, blocks: Flags) -> float:
        """Median over the frames of the chosen blocks [N], m/s; NaN where there is none."""
        own = self.speed[blocks[self.block]]
        return float(np.median(own)) if len(own) else float("nan")


def gated(motion: Motion, edges: Array, gesturing: Flags, closed: Flags) -> GatedMotion:
    """From a motion and the edges [N + 1] of its blocks, s."""
    speed = hand_speeds(motion).mean(axis=1)
    return GatedMotion(gesturing, closed, speed, block_of_frames(edges, len(speed), motion.fps))


def play(system: Gesticulator, recording: Recording, activity: float) -> tuple[Performance, GatedMotion]:
    """One recording at one activity, in the habits of its performer where the bundle knows them."""
    who = recording.info.speaker if recording.info.speaker in system.speakers else None
    made = system(recording.speech, speaker=who, activity=activity)
    closed = np.full(len(made.lexemes), activity <= 0)
    if 0 < activity < 1 and made.gate is not None:
        by_phrase = system.bundle.system.lives
        closed = np.isin(made.lexemes, system.bundle.silent) if by_phrase else made.gate < 1 - activity
    return made, gated(made.motion, made.blocks.edges, ~np.isin(made.lexemes, system.bundle.silent), closed)


def judge(system: Gesticulator, recording: Recording, made: Performance) -> tuple[GateScores, GatedMotion]:
    """The gate and its controls on one recording, as in use: it was `made` at the activity `ASKED`.

    Beside them the performer's own motion, whose still blocks count as closed.
    """
    bundle, info, blocks = system.bundle, recording.info, made.blocks
    active = ~np.isin(encode_motion(bundle, recording.motion, blocks, info.speaker).labels, bundle.silent)
    who = system.speaker_index(info.speaker if info.speaker in bundle.speakers else None)
    habit = 1.0 - float(bundle.frequencies[who][bundle.silent].sum())
    return GateScores(info.group or info.name, active, {
        GATE: np.asarray(made.gate), LOUDNESS: loudness(recording.speech, blocks.edges),
        SILENCE: (~blocks.silent).astype(np.float64), PERFORMER: np.full(len(active), habit),
    }), gated(recording.motion, blocks.edges, active, ~active)


def row(played: Sequence[GatedMotion], ungated: Sequence[GatedMotion] | None = None) -> dict[str, Cell]:
    """Figures of one activity, each with its difference from the same recordings without the gate.

    Speeds in closed blocks are medians over frames; beside them the median in the same blocks without the gate.
    """
    sizes, shut = [len(own.closed) for own in played], [int(own.closed.sum()) for own in played]
    share, speed = np.array([(own.gesturing.mean(), own.speed.mean()) for own in played]).T
    still = np.array([own.median_speed(own.closed) for own in played])
    out: dict[str, Cell] = {"gesturing": mean_interval(share, sizes), "hand_speed": mean_interval(speed, sizes),
                            "closed_blocks": sum(shut), "closed_speed": mean_interval(still, shut)}
    if ungated is None:
        return out
    free_share, free_speed = np.array([(own.gesturing.mean(), own.speed.mean()) for own in ungated]).T
    free = np.array([other.median_speed(own.closed) for own, other in zip(played, ungated, strict=True)])
    return out | {
        "gesturing_change": paired(share, free_share, sizes), "hand_speed_change": paired(speed, free_speed, sizes),
        "closed_speed_without": mean_interval(free, shut), "closed_speed_change": paired(still, free, shut)}


KNOWS = {"auc": Column("AUC", digits=3, good="high"), "auc_within_recordings": Column("in one recording", digits=3),
         "gate_leads_by": Column("the gate leads by", digits=3)}
BINS = {"blocks": Column("blocks"), "said": Column("said, mean"), "happened": Column("active")}
USE = {"gesturing": Column("blocks gesturing", "share", 3), "gesturing_change": Column("against no gate", digits=3),
       "hand_speed": Column("hands", "m/s"), "hand_speed_change": Column("against no gate", "m/s"),
       "closed_blocks": Column("closed blocks"), "closed_speed": Column("hands there, median", "m/s", 3),
       "closed_speed_without": Column("there without the gate", "m/s", 3),
       "closed_speed_change": Column("difference", "m/s", 3)}


def arguments(parser: argparse.ArgumentParser) -> None:
    """A store, a bundle and which recordings."""
    parser.add_argument("--bundle", metavar="DIR", help="bundle (default: the shipped one)")
    parser.add_argument("--data", required=True, metavar="STORE")
    parser.add_argument("--limit", type=int, metavar="N",
                        help="number of test recordings, evenly chosen (default: all)")


def run(arguments: argparse.Namespace) -> list[Table]:
    """Judge a bundle's gate; InputError when it has none."""
    torch.set_num_threads(1)
    store, system = Store.open(arguments.data), Gesticulator.from_pretrained(arguments.bundle)
    if system.bundle.gate is None:
        raise InputError(arguments.bundle or "the shipped bundle", "has no gate",
                         "train one: schedules.gate.steps above 0")
    joints = system.bundle.config.motion.joints
    recordings = [store.load(info.name, joints) for info in evenly(store, "test", arguments.limit)]
    made = {activity: [play(system, recording, activity) for recording in tqdm(recordings, f"activity {activity:g}")]
            for activity in ACTIVITIES}
    judged = [judge(system, recording, own) for recording, (own, _) in zip(recordings, made[ASKED], strict=True)]
    played = {activity: [own for _, own in each] for activity, each in made.items()}
    use = {"performer": row([own for _, own in judged]),
           **{f"{activity:g}": row(own, played[1.0]) for activity, own in played.items()}}
    facts = {"store": {"name": store.corpus, "fingerprint": store.fingerprint, "split": "test"},
             "seconds": round(sum(recording.speech.duration for recording in recordings), 1)}
    return [*knowledge([scores for scores, _ in judged], facts), Table("The gate in use", USE, use, "activity")]
