"""The style codes of gesture units, measured on the corpus' motion, and their interpreter (RG 6.3)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module.types import Array
from gesticulator.training import fit as fitting
from gesticulator.training.stages.base import Figures, Node, Run, Stage
from gesticulator.training.stages.corpus import BLOCKS
from gesticulator.training.stages.features import CORPUS
from gesticulator.training.stages.labels import LABELS
from gesticulator.training.stages.planner import RATE, UNITS, edges_of, hands_of
from gesticulator.training.stages.windows import Windows, sequences, validation
from interpreters.planner import CODE, PHASES, UnitStyleInterpreter

_LONGEST = 14
"""Blocks of a unit, at most; a longer one is cut, since the style of a talk changes within seconds."""
_STILL = 0.02
"""m/s and m under the logarithms."""
_MOST = 2.5
_FEWEST = 20
"""Units from which on a speaker's own mean and deviation are used."""


def spans(acting: NDArray[np.bool_], longest: int = _LONGEST) -> list[tuple[int, int]]:
    """(first, last) blocks of the units in acting [M], last excluded; long runs are cut into equal parts."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], acting, [False]]).astype(int)))
    out = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        parts = -(-(last - first) // longest)
        cuts = np.linspace(first, last, parts + 1).round().astype(int)
        out += list(zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True))
    return out


def style_of(hands: Array) -> Array:
    """[4] speed, range, height and reach (`interpreters.planner.CODE`) of hands [T, 2, 3] over the hips at `RATE`,
    logarithms of m/s and m, and m."""
    speed = np.linalg.norm(np.diff(hands, axis=0), axis=-1).mean() * RATE if len(hands) > 1 else 0.0
    spread = np.sqrt(hands.var(axis=0).sum(axis=-1)).max()
    reach = np.linalg.norm(hands[..., [0, 2]], axis=-1)
    return np.array([np.log(speed + _STILL), np.log(spread + _STILL), hands[..., 1].max(axis=1).mean(), reach.mean()])


def unit_codes(run: Run) -> NDArray[np.float32]:
    """[N, d_z] the style code of each block's unit, standardised per speaker on the training split; 0 at rest."""
    corpus, units = run.get(BLOCKS), run.get(UNITS)
    acting = units[:, 0] != PHASES.index("rest")
    rows: list[tuple[int, NDArray[np.int64], Array]] = []
    for recording in range(len(corpus.names)):
        blocks = corpus.blocks_of(recording)
        hands, edges = hands_of(corpus, run.config, recording), edges_of(corpus, recording)
        for first, last in spans(acting[blocks]):
            own = hands[round(edges[first] * RATE):max(round(edges[last] * RATE), round(edges[first] * RATE) + 2)]
            if len(own):
                rows.append((recording, blocks[first:last], style_of(own)))
    codes = np.zeros((len(units), len(CODE)), dtype=np.float32)
    if not rows:
        return codes
    values = np.stack([row[2] for row in rows])
    who = corpus.speaker_of[[row[0] for row in rows]]
    train = np.array([corpus.splits[row[0]] == "train" for row in rows])
    everyone = values[train] if train.any() else values
    for speaker in np.unique(who):
        known = values[train & (who == speaker)]
        known = known if len(known) >= _FEWEST else everyone
        deviation = np.maximum(known.std(axis=0), 1e-3)
        values[who == speaker] = (values[who == speaker] - known.mean(axis=0)) / deviation
    for (_, blocks, _), code in zip(rows, np.clip(values, -_MOST, _MOST), strict=True):
        codes[blocks] = code
    return codes


UNIT_CODES: Node[NDArray[np.float32]] = Node(
    "unit_codes", settings=(), needs=lambda config: (BLOCKS, UNITS), make=unit_codes)
"""[N, d_z] the style codes of the blocks' units."""


def train_interpreter(run: Run, model: UnitStyleInterpreter, folder: Path, stage: Stage[Any]) -> Figures:
    """Train on the codes of the training split, then set the gain on those of the validation split."""
    config, corpus, labelled = run.config, run.get(CORPUS), run.get(LABELS)
    codes = torch.as_tensor(run.get(UNIT_CODES))
    acting = torch.as_tensor(run.get(UNITS)[:, 0] != PHASES.index("rest")).float()
    windows = Windows(corpus, sequences(corpus, labelled.labels, "train", labelled.style_numbers), config.window)

    def with_codes(batch: fitting.Batch) -> fitting.Batch:
        return {**batch, "code": codes[batch["block"]], "acting": acting[batch["block"]]}

    checks = [with_codes(batch) for batch in validation(corpus, labelled.labels, config.window)]

    @torch.no_grad()
    def compared() -> tuple[Tensor, Tensor]:
        """Predictions and measured codes [n, d_z] of the blocks of units in the validation split."""
        rows = []
        for batch in checks:
            predicted, _ = model.predict(batch["audio_low"].to(run.device), batch["speaker"].to(run.device))
            there = (batch["valid"] * batch["acting"]) > 0
            rows.append((predicted.cpu()[there], batch["code"][there]))
        return torch.cat([row[0] for row in rows]), torch.cat([row[1] for row in rows])

    def validate() -> Figures:
        predicted, measured = compared()
        model.calibrate(predicted, measured)
        left = (predicted - measured).pow(2).mean(0) / measured.var(0).clamp_min(1e-6)
        return {"code_error": float((predicted - measured).pow(2).mean()),
                **{f"explained_{name}": float(1 - share) for name, share in zip(CODE, left, strict=True)}}

    task = fitting.Task(lambda rng: with_codes(windows.sample(rng, run.schedule(stage).batch)), validate=validate,
                        watch="code_error")
    return run.fit(stage, model, task, folder)
