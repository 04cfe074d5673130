"""Do lexemes carry the rhythm? `gesticulator probe lexicon-rhythm --data STORE --work DIR [--variant "A=B C=D" ...]`

A lexicon that names poses is of no use to the beat. The probe is linear, so it says what is in the lexemes and not how
well a network was trained: each block is regressed (ridge, training split) on the last pose of the block before and
the one-hot lexeme, rolled out over held-out talks with their true lexemes, and its motion beats are set against the
onsets. DIR is a work folder of `gesticulator train`, where the lexicon of those settings is trained unless it lies
there. Each variant, settings as after --set, is a row.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from data_module.blocks import cut, denormalise
from data_module.motion.motion_beats import motion_beats
from data_module.motion.skeletons import from_vector
from data_module.speech.onsets import detect_onsets
from data_module.store import Store
from data_module.types import Array
from eval.clip import rhythm
from eval.stats import Interval, mean_interval
from eval.table import Column, Table
from gesticulator import config as configs
from gesticulator import presets
from gesticulator.pipeline import FPS
from gesticulator.stages import BLOCKS, LEXICON, Run
from gesticulator.stages.corpus import Corpus
from gesticulator.stages.lexicon import token_labels

RIDGE = 10.0
"""Weight of the ridge: poses are of variance 1, and a lexeme that occurs ten times counts for half."""
COLUMNS = {"performer": Column("performer", "% above chance", 1), "lexemes": Column("lexemes", "% above chance", 1)}
Labels = NDArray[np.int64]


def regression(corpus: Corpus, labels: Labels, size: int) -> Array:
    """[D_m + S + 1, K * D_m] weights from (last pose before, one-hot lexeme, 1) to the block."""
    motion = corpus.motion.numpy().astype(np.float64)
    before = np.concatenate([motion[:1, -1], motion[:-1, -1]])
    begins = np.flatnonzero(np.diff(corpus.recording, prepend=-1))
    before[begins] = corpus.first.numpy()[corpus.recording[begins]]
    rows = np.concatenate([before, np.eye(size)[labels], np.ones((len(motion), 1))], axis=1)[corpus.select("train")]
    wanted = motion[corpus.select("train")].reshape(len(rows), -1)
    return np.asarray(np.linalg.solve(rows.T @ rows + RIDGE * np.eye(rows.shape[1]), rows.T @ wanted))


def roll_out(weights: Array, corpus: Corpus, labels: Labels, recording: int, size: int) -> Array:
    """[N, K, D_m] of a recording, each block from what was made before it."""
    pose, made = corpus.first.numpy()[recording].astype(np.float64), []
    for block in corpus.blocks_of(recording):
        row = np.concatenate([pose, np.eye(size)[labels[block]], [1.0]])
        made.append((row @ weights).reshape(corpus.motion.shape[1:]))
        pose = made[-1][-1]
    return np.stack(made)


def measured(config: configs.Config, store: Store, work: Path, split: str) -> dict[str, Interval]:
    """PMB above chance of the performer and of the roll-out, percent, over the talks of a split."""
    stages = Run(config, store, work, progress=False)
    corpus, lexicon = stages.get(BLOCKS), stages.get(LEXICON)
    labels, size = token_labels(lexicon, corpus), config.lexicon.size
    weights, statistics = regression(corpus, labels, size), corpus.statistics
    above: dict[str, list[float]] = {"performer": [], "lexemes": []}
    for recording in corpus.recordings(split):
        if not corpus.names[recording].startswith("talk"):
            continue
        speech = store.load(corpus.names[recording]).speech
        blocks, onsets = cut(speech, config.rhythm), detect_onsets(speech.samples, speech.sample_rate)
        speaker = int(corpus.speaker_of[recording])
        for name, features in (("performer", corpus.motion[torch.as_tensor(corpus.blocks_of(recording))].numpy()),
                               ("lexemes", roll_out(weights, corpus, labels, recording, size))):
            poses = statistics.denormalise(features.astype(np.float64), speaker)
            motion = from_vector(denormalise(poses, statistics.rest_pose[speaker], blocks, FPS), FPS)
            above[name].append(rhythm(motion_beats(motion), onsets, speech.duration).above_chance)
    return {name: mean_interval(values) for name, values in above.items()}


def arguments(parser: argparse.ArgumentParser) -> None:
    """A store, a work folder and settings."""
    parser.add_argument("--data", required=True, metavar="STORE")
    parser.add_argument("--work", required=True, type=Path, metavar="DIR")
    parser.add_argument("--preset", default="default")
    parser.add_argument("--split", default="val", choices=("val", "test"), help="choices are made on val")
    parser.add_argument("--variant", action="append", metavar="SETTINGS", help="settings with spaces between them")


def run(arguments: argparse.Namespace) -> list[Table]:
    """A row for each variant."""
    store, rows = Store.open(arguments.data), {}
    for variant in arguments.variant or [""]:
        config = configs.with_settings(presets.preset(arguments.preset), variant.split())
        rows[f"{arguments.preset} {variant}".strip()] = measured(config, store, arguments.work, arguments.split)
    return [table(rows)]


def table(rows: dict[str, dict[str, Interval]]) -> Table:
    """What is shown."""
    return Table("PMB at 0.1 s above chance of a linear roll-out", COLUMNS, rows, "settings")
