"""The example of every chapter holds, and figures of lexemes know a statue."""

import doctest
import importlib
import pkgutil
from typing import Any

import numpy as np
import pytest
from bursts import turned

from data_module.types import Speech
from eval import metrics
from eval.clip.clip_set import common_clips
from eval.clip.foreign import Clip
from eval.context import EvalContext
from eval.metrics.gesture_features import RawFeatures
from eval.score import command as score
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.files import NAMED

SECONDS, FPS, RATE = 12.0, 20.0, 16000
NETWORK = "raw directions of 2 frames, 12 frames"
CONTROLS = ("still", "shuffled", "reversed", "jitter")
NO_EXAMPLE = {f"eval.metrics.{name}" for name in ("encode", "eye", "eye.body", "eye.sample")}


def clip(seed: int) -> Clip:
    """Arms that swing, faster and faster up to each beat, where they stop, with a click of the sound at each beat."""
    rng = np.random.default_rng(seed)
    beats = np.cumsum(rng.uniform(0.45, 1.1, 40))
    beats = beats[beats < SECONDS - 0.3]
    time = np.arange(round(SECONDS * FPS)) / FPS
    edges = np.concatenate([[0.0], beats, [SECONDS]])
    stroke = np.clip(np.searchsorted(edges, time, side="right") - 1, 0, len(edges) - 2)
    done = (time - edges[stroke]) / np.diff(edges)[stroke]
    speed = np.resize([1.0, -1.0], len(edges))[stroke] * rng.uniform(2.0, 5.0, len(edges))[stroke] * done
    angle = np.cumsum(speed) / FPS
    maps = {"RightArm": np.outer(angle, [0, 0, 1.0]), "LeftArm": np.outer(angle, [0, 0, -0.9]),
            "Spine": np.outer(np.sin(time), [0.05, 0, 0])}
    samples = np.zeros(round(SECONDS * RATE), np.float32)
    for beat in beats:
        samples[int(beat * RATE):int(beat * RATE) + 800] = 0.4 * rng.normal(size=800).clip(-2, 2)
    return Clip(f"clip{seed}", turned(len(time), FPS, maps), Speech(samples, RATE), f"clip{seed}")


@pytest.fixture(scope="module")
def rows() -> dict[str, Any]:
    """metric -> figure, by row: the truth, the same again, and every control."""
    truth = {f"clip{seed}": clip(seed) for seed in range(6)}
    context = EvalContext(models=bundles.load(NAMED["default"]), networks={NETWORK: RawFeatures(12)})
    figures = score.score(context, common_clips({"truth": truth, "same": truth})).figures
    return {row: {("fgd" if key == NETWORK else key): score.mean_of(figures, row, key) for key in cells}
            for row, cells in figures.items()}


@pytest.mark.parametrize("chapter", [module.name for module in pkgutil.walk_packages(metrics.__path__, "eval.metrics.")
                                     if module.name not in NO_EXAMPLE])
def test_the_example_of_every_chapter_holds(chapter: str) -> None:
    found = doctest.testmod(importlib.import_module(chapter))
    assert found.attempted > 0 and found.failed == 0


def test_figures_of_lexemes_know_a_statue_and_a_stranger(rows: dict[str, Any]) -> None:
    truth = rows["truth"]
    assert rows["same"]["lexeme_accuracy"] == truth["lexeme_accuracy"] == 100.0
    assert all(rows[control]["lexeme_accuracy"] < 100.0 for control in CONTROLS)
    assert rows["still"]["diversity"] < truth["diversity"]
    assert all(np.isfinite([rows[row][name] for row in ("truth", *CONTROLS)]).all()
               for name in ("diversity", "motion_variance"))
