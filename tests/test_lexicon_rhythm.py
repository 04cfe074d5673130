"""Do lexemes carry the rhythm: the linear probe on lexemes that say everything, and on some that say nothing."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch

from eval.commands import PROBE
from eval.probes import lexicon_rhythm
from eval.table import load

BLOCKS, FRAMES, WIDTH, SIZE = 60, 5, 3, 4


def corpus(labels: np.ndarray) -> Any:
    """One recording whose every block is what its lexeme says, however the pose was before."""
    shapes = np.random.default_rng(0).normal(size=(SIZE, FRAMES, WIDTH))
    return SimpleNamespace(motion=torch.as_tensor(shapes[labels]), recording=np.zeros(BLOCKS, dtype=np.int64),
                           first=torch.zeros(1, WIDTH), select=lambda split: np.arange(BLOCKS),
                           blocks_of=lambda recording: np.arange(BLOCKS))


def test_lexemes_that_say_everything_are_rolled_out_and_random_ones_are_not() -> None:
    rng = np.random.default_rng(1)
    labels = rng.integers(SIZE, size=BLOCKS)
    own = corpus(labels)
    errors = []
    for said in (labels, rng.permutation(labels)):
        weights = lexicon_rhythm.regression(own, said, SIZE)
        made = lexicon_rhythm.roll_out(weights, own, said, 0, SIZE)
        assert made.shape == (BLOCKS, FRAMES, WIDTH)
        errors.append(float(np.abs(made - own.motion.numpy()).mean()))
    assert errors[0] < 0.5 * errors[1]


def test_the_command_gives_a_row_for_each_variant(tiny_store: Path, tmp_path: Path) -> None:
    out = tmp_path / "rhythm.json"
    assert PROBE.main("gesticulator probe", [
        "lexicon-rhythm", "--data", str(tiny_store), "--work", str(tmp_path / "work"), "--preset", "tiny",
        "--split", "test", "--variant", "schedules.lexicon.steps=5", "--variant", "schedules.lexicon.steps=6",
        "--out", str(out)]) == 0
    rows: Any = load(out)[0].rows
    first, second = rows.values()
    assert list(rows) == ["tiny schedules.lexicon.steps=5", "tiny schedules.lexicon.steps=6"]
    assert first["performer"] == second["performer"] and first["performer"].above(10.0)
    assert first["lexemes"].mean < first["performer"].mean
