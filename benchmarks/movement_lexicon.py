"""The lexicon of movements by a VQ-VAE and by k-means: `python benchmarks/movement_lexicon.py STORE [--out FILE.json]`.

Both are trained on the training split with the settings of the preset `default`, once for each seed, and measured on
the recordings of the test split, every block after the true frames before it. Figures are means over the seeds with
bootstrap 95 % intervals over recordings, and the last row is their paired difference.

- movement explained: 1 - |x - x'|^2 / |x|^2, of what a block adds to the prediction from its past, in the weighted
  coefficients (`lexicon.movement`), by the lexeme alone and with the residual levels.
- error: mean squared error of the normalised features, as `gesticulator probe quality` has it.
- hands, arms: distance of both wrists, and angle of the rotations of shoulder, upper arm, forearm and hand, at the end
  of the block, from the truth.
- within-block and displacement R2 of strokes (`eval.acceptance.lexicon`), by the lexeme alone.
- next lexeme: cross-entropy given the lexeme before, with the transitions of the training split, and by how much it
  lies below that of the frequencies alone.
- phase, stroke, word: what the lexeme tells of the planned phase (rest, stroke, hold, retraction), of the name of the
  stroke and of the word at the middle of the block: mean log p(c | lexeme) / p(c), estimated on the training split; for
  the phase also the share of blocks of the phase that is most frequent with their lexeme.
- kept under noise: share of blocks whose lexeme stays when independent noise of 2 % of each dimension's deviation is
  added to every frame.
"""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module.blocks import cut
from data_module.motion import rotation
from data_module.motion.kinematics import positions_of
from data_module.motion.movement import pasts_of
from data_module.motion.skeletons import CHARACTER
from data_module.store import Recording, Store
from data_module.truth import Truth
from data_module.types import Array
from eval import stats
from eval.acceptance.lexicon import HeldOut, fit_of
from eval.context import opened
from eval.table import Column, Provenance, Table, publish
from gesticulator.bundle.config import with_settings
from gesticulator.bundle.features import representation_of
from gesticulator.training.presets import default
from gesticulator.training.stages import Run
from gesticulator.training.stages.corpus import BLOCKS, Corpus
from gesticulator.training.stages.lexicon import LEXICON, token_labels
from lexicon.inventory import count
from lexicon.movement import MovementLexicon

QUANTIZERS = ("vq-vae", "k-means")
NOISE = 0.02
"""Deviations of the noise on every frame."""
PHASES = ("rest", "stroke", "hold", "retraction")
LEAST = 20
"""Blocks of the training split that a stroke or word must have, to be counted."""
SMOOTHING = 1.0
"""Blocks for each class, of the overall distribution, that are added to those of a lexeme."""
Figure = Callable[[NDArray[np.int64]], float]
"""Of the test recordings with these indices."""
Labels = NDArray[np.int64]

COLUMNS = {
    "explained": Column("movement explained by the lexeme", "%", 1, "high"),
    "levels": Column("and by its levels", "%", 1, "high"),
    "error": Column("error of the lexeme alone", "normalised features squared", 4, "low"),
    "hands": Column("hands at the end", "mm", 1, "low"),
    "hands_levels": Column("the same with levels", "mm", 1, "low"),
    "arms": Column("arms at the end", "degrees", 2, "low"),
    "within": Column("within-block R2, strokes", "", 3, "high"),
    "displaced": Column("displacement R2, strokes", "", 3, "high"),
    "perplexity": Column("perplexity", "", 1),
    "used": Column("lexemes in use", "%", 1),
    "next": Column("next lexeme", "nats", 3, "low"),
    "gain": Column("information from the one before", "nats", 3, "high"),
    "phase": Column("information about the phase", "nats", 3, "high"),
    "pure": Column("phase as most often", "%", 1, "high"),
    "stroke": Column("information about the stroke's name", "nats", 3, "high"),
    "word": Column("information about the word", "nats", 3, "high"),
    "kept": Column("kept under noise", "%", 1, "high"),
}


@dataclass(frozen=True)
class Truths:
    """What is known of every block [N] beside its motion; -1 where nothing is: phase, stroke and word by number."""

    phase: Labels
    stroke: Labels
    word: Labels


@dataclass(frozen=True)
class TestSet:
    """The test split. rows: the blocks of each recording; noisy: its motion with noise."""

    recordings: Sequence[HeldOut]
    rows: Sequence[Labels]
    noisy: Sequence[Tensor]


# --------------------------------------------------------------------------------------------------------------- data

def phase_at(truth: Truth, time: float) -> int:
    """The planned phase at a time by its number in `PHASES`; the later of two strokes counts."""
    for stroke in reversed(truth.strokes):
        if stroke.start <= time < stroke.end:
            return 1 if time < stroke.beat else 2 if time < stroke.hold_end else 3
    return 0


def named(names: Sequence[str], train: Labels) -> Labels:
    """[N] numbers of names, -1 for "" and for those that are rare among the rows `train`."""
    counts = Counter(names[row] for row in train)
    numbers = {name: k for k, name in enumerate(sorted(n for n, c in counts.items() if n and c >= LEAST))}
    return np.array([numbers.get(name, -1) for name in names])


def facts_of(recording: Recording, middles: Array) -> list[tuple[int, str, str]]:
    """Phase, stroke and word at each time [n]; -1 and "" where there is none."""
    truth, words = recording.truth, recording.speech.words or ()
    out = []
    for time_ in middles.tolist():
        phase, stroke = -1, ""
        if truth is not None and truth.strokes:
            phase = phase_at(truth, time_)
            stroke = next((s.lexeme for s in reversed(truth.strokes) if s.start <= time_ < s.end), "")
        out.append((phase, stroke, next((w.text.lower().strip(".,?!;:") for w in words
                                         if w.start <= time_ < w.end), "")))
    return out


def truths_of(store: Store, corpus: Corpus, run: Run) -> Truths:
    """Of all blocks of a corpus."""
    rows: list[tuple[int, str, str]] = []
    for name in corpus.names:
        recording = store.load(name, run.config.motion.joints)
        edges = cut(recording.speech, run.config.rhythm).edges
        rows += facts_of(recording, (edges[1:] + edges[:-1]) / 2)
    phase, stroke, word = zip(*rows, strict=True)
    train = corpus.select("train")
    return Truths(np.array(phase), named(stroke, train), named(word, train))


def test_set(corpus: Corpus, run: Run) -> TestSet:
    """The test recordings of a corpus, and the same with noise."""
    representation, statistics = representation_of(run.config), corpus.statistics
    generator = torch.Generator().manual_seed(0)
    held, rows, noisy = [], [], []

    for number in corpus.recordings("test"):
        own = corpus.blocks_of(number)
        motion = corpus.motion[torch.as_tensor(own)]
        mean = statistics.mean_pose[corpus.speaker_of[number]]

        def positions(blocks: Tensor, mean: Array = mean) -> Array:
            poses = blocks.double().numpy() * statistics.deviation + mean
            moved = representation.motion(poses.reshape(-1, poses.shape[-1]), 1.0)
            joints = [moved.skeleton.index(joint) for joint in CHARACTER.names]
            return positions_of(moved)[:, joints].reshape(*poses.shape[:2], len(joints), 3)

        held.append(HeldOut(corpus.names[number], motion, torch.as_tensor(corpus.durations[own]), corpus.first[number],
                            positions))
        rows.append(own)
        noisy.append(motion + NOISE * torch.randn(motion.shape, generator=generator))
    return TestSet(held, rows, noisy)


# ------------------------------------------------------------------------------------------------------------ figures

def ratio(sums: Array, scale: float = 1.0, less: float = 0.0) -> Figure:
    """less + scale * the sum of the first over the sum of the second of sums [R, 2]."""
    return lambda chosen: float(less + scale * np.divide(*sums[chosen].sum(axis=0)))


def information_about(
    classes: Labels, labels: Labels, size: int, train: Labels, rows: Sequence[Labels]
) -> tuple[Array, Array]:
    """[R, 2] sums and counts over recordings: log p(c | lexeme) / p(c), and whether c is the lexeme's most frequent."""
    known = train[classes[train] >= 0]
    table = np.zeros((size, classes.max() + 1))
    np.add.at(table, (labels[known], classes[known]), 1.0)
    overall = table.sum(axis=0) / table.sum()
    given = table + SMOOTHING * table.shape[1] * overall
    given /= given.sum(axis=1, keepdims=True)
    nats, right = [], []
    for own in rows:
        own = own[classes[own] >= 0]
        found, lexeme = classes[own], labels[own]
        nats.append((np.log(given[lexeme, found] / overall[found]).sum(), len(own)))
        right.append(((given[lexeme].argmax(axis=1) == found).sum(), len(own)))
    return np.array(nats, dtype=np.float64), np.array(right, dtype=np.float64)


def of_labels(labels: Labels, size: int, corpus: Corpus, truths: Truths, rows: Sequence[Labels]) -> dict[str, Figure]:
    """The figures of the lexemes [N] of all blocks."""
    train = corpus.select("train")
    found = count((("", labels[corpus.blocks_of(r)]) for r in corpus.recordings("train")), size)
    frequencies = np.maximum(found.frequencies[""], 1e-6)
    uses = np.stack([np.bincount(labels[own], minlength=size) for own in rows]).astype(np.float64)
    nexts = np.array([(-np.log(found.transitions[labels[own[:-1]], labels[own[1:]]]).sum(), len(own) - 1)
                      for own in rows])
    plain = np.array([-np.log(frequencies[labels[own[1:]]]).sum() for own in rows])
    phase, pure = information_about(truths.phase, labels, size, train, rows)
    out = {
        "perplexity": lambda chosen: perplexity(uses[chosen].sum(axis=0)),
        "used": lambda chosen: 100 * float((uses[chosen].sum(axis=0) > 0).mean()),
        "next": ratio(nexts), "gain": ratio(np.stack([plain - nexts[:, 0], nexts[:, 1]], axis=1)),
        "phase": ratio(phase), "pure": ratio(pure, 100.0)}
    for name, classes in (("stroke", truths.stroke), ("word", truths.word)):
        out[name] = ratio(information_about(classes, labels, size, train, rows)[0])
    return out


def perplexity(uses: Array) -> float:
    """exp of the entropy of counts [S]."""
    share = uses[uses > 0] / uses.sum()
    return float(np.exp(-(share * np.log(share)).sum()))


@torch.no_grad()
def of_motion(lexicon: MovementLexicon, tests: TestSet, corpus: Corpus) -> dict[str, Figure]:
    """The figures of decoded test blocks, by the lexeme alone and with its levels."""
    sums: dict[str, list[Sequence[float]]] = {}
    wrists = [CHARACTER.index(side + "Hand") for side in ("Right", "Left")]
    arms = [CHARACTER.index(side + joint) for side in ("Right", "Left")
            for joint in ("Shoulder", "Arm", "ForeArm", "Hand")]
    for held, noisy in zip(tests.recordings, tests.noisy, strict=True):
        past = held.pasts()
        y = lexicon.basis.coefficients(held.motion, past)
        x, truth = y * lexicon.basis.weight, held.positions(held.motion[:, -1:])[:, 0, wrists]
        row: dict[str, Sequence[float]] = {}
        for levels, share, hands in ((0, "explained", "hands"), (None, "levels", "hands_levels")):
            decoded = lexicon.quantised(y, levels)
            blocks = lexicon.basis.compose(decoded, past)
            row[share] = float((decoded * lexicon.basis.weight - x).pow(2).sum()), float(x.pow(2).sum())
            away = np.linalg.norm(held.positions(blocks[:, -1:])[:, 0, wrists] - truth, axis=-1)
            row[hands] = away.sum(), away.size
            if levels == 0:
                angle = rotation.angle_between(*(ended(own, held, corpus)[:, arms] for own in (blocks, held.motion)))
                row["error"] = float((blocks - held.motion).pow(2).sum()), held.motion.numel()
                row["arms"] = angle.sum(), angle.size
                fit = fit_of(held, blocks)
                row["within"], row["displaced"] = fit.within, fit.displaced
        again = pasts_of(noisy, held.durations, held.first)
        same = lexicon.label(held.motion, past) == lexicon.label(noisy, again)
        row["kept"] = float(same.sum()), len(same)
        for key, value in row.items():
            sums.setdefault(key, []).append(value)
    scales = {"explained": (-100.0, 100.0), "levels": (-100.0, 100.0), "error": (1.0, 0.0), "hands": (1000.0, 0.0),
              "hands_levels": (1000.0, 0.0), "arms": (180 / np.pi, 0.0), "within": (-1.0, 1.0),
              "displaced": (-1.0, 1.0), "kept": (100.0, 0.0)}
    return {key: ratio(np.array(sums[key], dtype=np.float64), *scale) for key, scale in scales.items()}


def ended(blocks: Tensor, held: HeldOut, corpus: Corpus) -> Array:
    """[N, J, 4] rotations at the ends of blocks."""
    mean = corpus.statistics.mean_pose[corpus.speaker_of[corpus.names.index(held.name)]]
    poses = blocks[:, -1].double().numpy() * corpus.statistics.deviation + mean
    return rotation.from_exponential_map(poses.reshape(len(poses), -1, 3))


# -------------------------------------------------------------------------------------------------------------- table

def rows_of(figures: Mapping[str, Sequence[Mapping[str, Figure]]], recordings: int
            ) -> dict[str, dict[str, stats.Interval]]:
    """Each quantiser's figures, means over the seeds, and the difference of the first two, with intervals."""
    def mean(name: str, key: str) -> Figure:
        return lambda chosen: float(np.mean([own[key](chosen) for own in figures[name]]))

    one, other = list(figures)[:2]
    out = {name: {key: stats.of_set(mean(name, key), recordings, basic=False) for key in COLUMNS} for name in figures}
    out[f"{one} less {other}"] = {key: stats.of_set(
        lambda chosen, key=key: mean(one, key)(chosen) - mean(other, key)(chosen), recordings, basic=False)
        for key in COLUMNS}
    return out


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("store", help="a store built by `gesticulator build`")
    p.add_argument("--work", help="work folder of trainings (default: STORE.work)")
    p.add_argument("--seeds", type=int, default=3)
    p.add_argument("--set", action="append", default=[], metavar="PATH=VALUE", help="change a setting of both")
    p.add_argument("--out")
    a = p.parse_args()
    store, work = opened(a.store, a.work)
    first = Run(with_settings(default(), a.set), store, work, progress=False)
    corpus = first.get(BLOCKS)
    tests, truths = test_set(corpus, first), truths_of(store, corpus, first)
    figures: dict[str, list[dict[str, Figure]]] = {}
    seconds: dict[str, list[float]] = {}
    for quantizer in QUANTIZERS:
        for seed in range(1, a.seeds + 1):
            run = Run(with_settings(first.config, [f"lexicon.quantizer={quantizer}", f"seed={seed}"]), store, work,
                      progress=False)
            run.provide(BLOCKS, corpus)
            begin = time.process_time()
            lexicon = run.get(LEXICON)
            seconds.setdefault(quantizer, []).append(round(time.process_time() - begin, 1))
            assert isinstance(lexicon, MovementLexicon)
            labels = token_labels(lexicon, corpus)
            figures.setdefault(quantizer, []).append({
                **of_motion(lexicon, tests, corpus), **of_labels(labels, lexicon.size, corpus, truths, tests.rows)})
    publish([table(rows_of(figures, len(tests.rows)), store, a.seeds, seconds)], a.out,
            Provenance.now(shlex.join(["python", "benchmarks/movement_lexicon.py", *sys.argv[1:]])))


def table(rows: Mapping[str, Mapping[str, stats.Interval]], store: Store, seeds: int,
          seconds: Mapping[str, Sequence[float]]) -> Table:
    """What is shown."""
    number = sum(info.split == "test" for info in store.recordings)
    return Table("The lexicon of movements, by a VQ-VAE and by k-means", COLUMNS, rows, "lexemes by", [
        f"{number} test recordings, {seeds} seeds of the lexicon; means with bootstrap 95 % intervals over recordings, "
        "the difference is paired.",
        "A redrawn set has fewer different recordings, and so a lower perplexity and use."],
        {"store": store.fingerprint, "seconds": dict(seconds)})


if __name__ == "__main__":
    main()
