"""The planner of gesture units, trained on phases that are measured on the corpus' motion."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from data_module.motion.phases import HandPhases, Phase, hand_places, phases_of
from data_module.types import Array
from gesticulator.bundle import models
from gesticulator.bundle.config import Config
from gesticulator.bundle.features import Statistics, representation_of
from gesticulator.training import fit as fitting
from gesticulator.training.stages.base import Figures, Node, Run, Stage
from gesticulator.training.stages.corpus import BLOCKS, Corpus
from gesticulator.training.stages.features import CORPUS
from gesticulator.training.stages.labels import LABELS, model_sizes
from gesticulator.training.stages.windows import Windows, sequences, validation
from interpreters.planner import APEXES, HANDS, SIZES, UnitPlanner

RATE = 30.0
"""Frames per second at which phases are measured."""
_SMALL, _LARGE = 0.15, 0.3
"""Bounds of a medium stroke, metres."""


def block_units(corpus: Corpus, config: Config) -> NDArray[np.int64]:
    """[N, 4] the decision of `interpreters.planner` that each block of a corpus shows."""
    out = [units_of(hands_of(corpus, config, recording), edges_of(corpus, recording))
           for recording in range(len(corpus.names))]
    return np.concatenate(out) if out else np.zeros((0, 4), np.int64)


def edges_of(corpus: Corpus, recording: int) -> Array:
    """[M + 1] seconds of the edges of a recording's blocks."""
    return np.concatenate([[0.0], np.cumsum(corpus.durations[corpus.blocks_of(recording)])])


def hands_of(corpus: Corpus, config: Config, recording: int) -> Array:
    """[T, 2, 3] places of the left and the right hand over the hips, metres, at `RATE`."""
    rows = corpus.motion[torch.as_tensor(corpus.blocks_of(recording))].double().numpy()
    return hands_of_blocks(rows, corpus.statistics, int(corpus.speaker_of[recording]), config,
                           edges_of(corpus, recording))


def hands_of_blocks(rows: Array, statistics: Statistics, speaker: int, config: Config, edges: Array) -> Array:
    """[T, 2, 3] places of the hands, as `hands_of`, of blocks [M, K, D_m] with edges [M + 1] seconds, normalised by the
    statistics of a speaker."""
    poses = statistics.denormalise(rows.reshape(-1, rows.shape[-1]), speaker)
    motion = representation_of(config).motion(poses, config.rhythm.fps)
    frames = rows.shape[1]
    shares = np.arange(1, frames + 1) / frames
    times = (edges[:-1, None] + np.diff(edges)[:, None] * shares).ravel()
    return hand_places(motion, RATE, times, max(2, int(edges[-1] * RATE)))


def units_of(hands: Array, edges: Array) -> NDArray[np.int64]:
    """[M, 4] the decision that each of M blocks with edges [M + 1] seconds shows, from the places [T, 2, 3] of the left
    and the right hand at `RATE`: the phase of the hand that moves more."""
    found = [phases_of(hands[:, side], RATE) for side in (0, 1)]
    speeds = np.linalg.norm(np.gradient(hands, axis=0), axis=-1)
    frames = np.minimum(np.round(edges * RATE).astype(int), len(hands))
    out = np.zeros((len(edges) - 1, 4), dtype=np.int64)
    for k, (first, last) in enumerate(zip(frames[:-1], frames[1:], strict=True)):
        last = max(last, first + 1)
        phases = [_phase(side.labels[first:last]) for side in found]
        acting = [phase != Phase.REST for phase in phases]
        if not any(acting):
            continue
        leading = max((0, 1), key=lambda side: (acting[side], speeds[first:last, side].mean()))
        out[k] = phases[leading], HANDS.index(_name(acting)), *_stroke(found[leading], phases[leading], first, last)
    return out


def _phase(labels: NDArray[np.int8]) -> int:
    """The most frequent phase of a block, the stroke where its apex region takes a third of it."""
    counts = np.bincount(labels, minlength=len(Phase))
    return int(Phase.STROKE) if 3 * counts[Phase.STROKE] >= counts.sum() else int(counts.argmax())


def _name(acting: Sequence[bool]) -> str:
    return "both" if all(acting) else "left" if acting[0] else "right"


def _stroke(hand: HandPhases, phase: int, first: int, last: int) -> tuple[int, int]:
    """Size and time of the stroke that a block prepares or makes."""
    if phase not in (Phase.PREPARATION, Phase.STROKE):
        return 0, 0
    coming = next((stroke for stroke in hand.strokes if stroke.apex >= first), None)
    if coming is None:
        return 0, 0
    size = "small" if coming.size < _SMALL else "large" if coming.size > _LARGE else "medium"
    apex = "now" if coming.apex < last else "next" if coming.apex < 2 * last - first else "later"
    return SIZES.index(size), APEXES.index(apex)


UNITS: Node[NDArray[np.int64]] = Node(
    "units", settings=(), needs=lambda config: (BLOCKS,), make=lambda run: block_units(run.get(BLOCKS), run.config))
"""[N, 4] the decisions that the blocks show."""


def _train(run: Run, model: UnitPlanner, folder: Path) -> Figures:
    config, corpus, labelled, units = run.config, run.get(CORPUS), run.get(LABELS), run.get(UNITS)
    train = corpus.select("train")
    model.count(labelled.hinted[train], units[train])
    windows = Windows(corpus, sequences(corpus, labelled.labels, "train", labelled.style_numbers), config.window)
    rows = torch.as_tensor(units)

    def with_units(batch: fitting.Batch) -> fitting.Batch:
        return {**batch, "units": rows[batch["block"]]}

    checks = [with_units(batch) for batch in validation(corpus, labelled.labels, config.window)]

    @torch.no_grad()
    def validate() -> Figures:
        batches = [{key: value.to(run.device) for key, value in batch.items()} for batch in checks]
        each = [model.losses(batch) for batch in batches]
        means = {name: sum(float(losses[name]) for losses in each) / len(each) for name in each[0]}
        return {"nll": sum(means.values()), **means}

    task = fitting.Task(lambda rng: with_units(windows.sample(rng, run.schedule(PLANNER).batch)), validate=validate,
                        watch="nll")
    return run.fit(PLANNER, model, task, folder)


PLANNER: Stage[UnitPlanner] = Stage(
    "planner", settings=("planner", "window"), needs=lambda config: (CORPUS, LABELS, UNITS), schedule="planner",
    wanted=lambda config: config.schedules.planner.steps > 0, part="planner",
    build=lambda run: models.planner(model_sizes(run)), train=_train)
