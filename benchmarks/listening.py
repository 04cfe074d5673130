"""What the interpreters and the planner hear: `python benchmarks/listening.py STORE --work DIR [--preset NAME]`.

Both are trained twice, with the same settings and seeds: on the recordings, and on the same recordings with the sound
of each rolled by half its length, so that what can be heard there says nothing about the motion. Both are then judged
on the true sound of the test split, given the true past: nats by which they predict the lexeme, the beginning
of a gesture unit (of blocks after a rest), the phase, the hand and the size of a stroke. The statistical interpreter
(RG Eq. 24) stands beside them. Differences are paired over recordings.

Likewise the lexeme interpreter that reads words: trained on the words, and on words rolled by half of each recording,
and judged on the true words, in all blocks and in those of strokes that the corpus chose for the meaning of a word.

The links between speech and motion of our own corpus are planted by its rules (`gesticulator build performer --links`).
"""

from __future__ import annotations

import argparse
import dataclasses
import shlex
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from data_module.store import Recording
from data_module.types import Array
from eval import stats
from eval.context import opened
from eval.table import Column, Provenance, Table, publish
from gesticulator.training.presets import preset
from gesticulator.training.stages.base import Run
from gesticulator.training.stages.corpus import Corpus
from gesticulator.training.stages.features import CORPUS
from gesticulator.training.stages.interpreter import INTERPRETER, INTERPRETER_TEXT, teacher_logits
from gesticulator.training.stages.labels import LABELS
from gesticulator.training.stages.planner import PLANNER, UNITS
from interpreters.base import BlockFeatures
from interpreters.lstm import LstmInterpreter
from interpreters.planner import CLASSES, PHASES, UnitPlanner
from interpreters.statistical import StatisticalInterpreter

REST = PHASES.index("rest")
FIGURES = {"lexeme": "lexeme", "unit start": "beginning of a unit", "phase": "phase", "hand": "hand",
           "size": "size of a stroke"}


def half_way_on(corpus: Corpus) -> Tensor:
    """[N] block numbers, those of every recording rolled by half of its blocks."""
    return torch.as_tensor(np.concatenate([
        np.roll(corpus.blocks_of(recording), len(corpus.blocks_of(recording)) // 2)
        for recording in range(len(corpus.names))]))


def rolled(corpus: Corpus) -> Corpus:
    """The corpus with the sound of every recording rolled by half its blocks."""
    rows = half_way_on(corpus)
    low = corpus.low[rows]
    return dataclasses.replace(corpus, low=low, high=low if corpus.high is corpus.low else corpus.high[rows])


def reworded(corpus: Corpus) -> Corpus:
    """The corpus with the words of every recording rolled by half its blocks."""
    if corpus.word_at is None:
        raise ValueError("this corpus was prepared without text")
    return dataclasses.replace(corpus, word_at=corpus.word_at[half_way_on(corpus)])


def in_meant_strokes(recording: Recording, durations: Array) -> NDArray[np.bool_]:
    """[M] whether the middle of each block, of the given durations in seconds, lies in a stroke that was chosen for the
    meaning of a word."""
    middles = np.cumsum(durations) - durations / 2
    strokes = recording.truth.strokes if recording.truth else ()
    spans = [(stroke.start, stroke.end) for stroke in strokes if stroke.meaning]
    return np.array([any(start <= middle < end for start, end in spans) for middle in middles], dtype=bool)


def mean_where(values: Tensor, mask: Tensor) -> float:
    """The mean of values [n] where mask [n] holds; NaN where it never does."""
    return float(values[mask].mean()) if bool(mask.any()) else float("nan")


@torch.no_grad()
def of_planner(model: UnitPlanner, corpus: Corpus, units: NDArray[np.int64], blocks: NDArray[np.int64]
               ) -> dict[str, float]:
    """Nats per decision over a recording's blocks [M], given its true decisions before."""
    true, rows = torch.as_tensor(units[blocks])[None], torch.as_tensor(blocks)
    who = torch.tensor([int(corpus.speaker_of[corpus.recording[blocks[0]]])])
    first = torch.tensor(CLASSES)[None, None]
    state, _ = model.hear(corpus.low[rows].float()[None], functional.one_hot(who, model.speakers).float(),
                          torch.cat([first, true[:, :-1]], 1))
    logs = [torch.log_softmax(model.logits(state, level, true), -1)[0] for level in range(3)]
    nats = [-log.gather(-1, true[0, :, level, None])[:, 0] for level, log in enumerate(logs)]
    begins = true[0, :, 0] != REST
    after_rest = torch.cat([torch.ones(1, dtype=torch.bool), ~begins[:-1]])
    rests = logs[0][:, REST]
    start = -torch.where(begins, torch.log1p(-rests.exp().clamp(max=1 - 1e-6)), rests)
    return {"unit start": mean_where(start, after_rest), "phase": float(nats[0].mean()),
            "hand": mean_where(nats[1], begins), "size": mean_where(nats[2], true[0, :, 2] > 0)}


def of_lexemes(logits: Callable[[NDArray[np.int64]], Array], labels: NDArray[np.int64], blocks: NDArray[np.int64]
               ) -> Array:
    """[M - 1] nats of each lexeme of a recording but the first. logits: scores [M - 1, S] of its blocks [M]."""
    scores = logits(blocks)
    log = scores - np.logaddexp.reduce(scores, axis=1, keepdims=True)
    return np.asarray(-log[np.arange(len(log)), labels[blocks][1:]])


def deaf_logits(model: StatisticalInterpreter, corpus: Corpus, labels: NDArray[np.int64], blocks: NDArray[np.int64]
                ) -> Array:
    """[M - 1, S] scores of the statistical interpreter, given the true lexemes."""
    state, out = model.start(int(corpus.speaker_of[corpus.recording[blocks[0]]]), int(labels[blocks[0]])), []
    silence = torch.zeros(1)
    for lexeme in labels[blocks][:-1]:
        scores, state = model.step(state, BlockFeatures(silence, silence), int(lexeme))
        out.append(scores)
    return np.stack(out)


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("store", help="a store built by `gesticulator build`")
    p.add_argument("--work", metavar="DIR", help="work folder of a training run (default: STORE.work)")
    p.add_argument("--preset", default="default")
    p.add_argument("--split", default="test")
    p.add_argument("--out")
    a = p.parse_args()
    store, work = opened(a.store, a.work)
    config = preset(a.preset)
    hears = Run(config, store, work, progress=False)
    corpus, labelled, units = hears.get(CORPUS), hears.get(LABELS), hears.get(UNITS)
    deaf = Run(config, store, work, progress=False)
    deaf.provide(CORPUS, rolled(corpus), f"{hears.key(CORPUS)}-rolled")
    models: dict[str, tuple[LstmInterpreter, UnitPlanner]] = {
        "as shipped": (hears.get(INTERPRETER), hears.get(PLANNER)),
        "trained on rolled sound": (deaf.get(INTERPRETER), deaf.get(PLANNER))}
    frequencies = np.stack([labelled.inventory.frequencies[name] for name in corpus.statistics.speakers])
    statistical = StatisticalInterpreter(frequencies, labelled.inventory.transitions, config.statistical)
    rows: dict[str, dict[str, list[float]]] = {name: {key: [] for key in FIGURES}
                                               for name in (*models, "statistical")}
    labels = labelled.hinted
    for recording in corpus.recordings(a.split):
        blocks = corpus.blocks_of(recording)
        for name, (interpreter, planner) in models.items():
            one = of_planner(planner, corpus, units, blocks)
            one["lexeme"] = float(of_lexemes(
                lambda own, model=interpreter: np.asarray(  # type: ignore[misc]
                    teacher_logits(model, corpus, own, labels[own]).double().numpy()), labels, blocks).mean())
            for key, value in one.items():
                rows[name][key].append(value)
        rows["statistical"]["lexeme"].append(float(of_lexemes(
            lambda own: deaf_logits(statistical, corpus, labels, own), labels, blocks).mean()))
    publish([table(rows, a.split), words_table(hears, work, a.split)], a.out, Provenance.now(
        shlex.join(["python", "benchmarks/listening.py", *sys.argv[1:]])))


def words_table(reads: Run, work: Path, split: str) -> Table:
    """Nats of the interpreter that reads words and of one that was trained on the wrong ones, on the true words.

    reads: a run with the true words. Both start from its interpreter without text."""
    corpus, labels = reads.get(CORPUS), reads.get(LABELS).hinted
    wrong = Run(reads.config, reads.store, work, progress=False)
    wrong.provide(CORPUS, reworded(corpus), f"{reads.key(CORPUS)}-reworded")
    wrong.provide(LABELS, reads.get(LABELS), reads.key(LABELS))
    wrong.provide(INTERPRETER, reads.get(INTERPRETER), reads.key(INTERPRETER))
    models = {"right words": reads.get(INTERPRETER_TEXT), "trained on wrong words": wrong.get(INTERPRETER_TEXT),
              "no words": reads.get(INTERPRETER)}
    every: dict[str, list[float]] = {name: [] for name in models}
    meant: dict[str, list[float]] = {name: [] for name in models}
    count = 0
    for recording in corpus.recordings(split, with_text=True):
        blocks = corpus.blocks_of(recording)
        calls = in_meant_strokes(reads.store.load(corpus.names[recording]), corpus.durations[blocks])[1:]
        count += int(calls.sum())
        for name, model in models.items():
            nats = of_lexemes(
                lambda own, model=model: np.asarray(  # type: ignore[misc]
                    teacher_logits(model, corpus, own, labels[own]).double().numpy()), labels, blocks)
            every[name].append(float(nats.mean()))
            if calls.any():
                meant[name].append(float(nats[calls].mean()))
    columns = {name: Column(name, "nats", 3) for name in models}
    columns |= {f"{name} more": Column(f"{name}, more", "nats", 3) for name in models if name != "right words"}
    cells: dict[str, dict[str, stats.Interval]] = {}
    for title, figures in (("lexeme, all blocks", every), ("lexeme, in strokes chosen for a word", meant)):
        cells[title] = {name: stats.mean_interval(values) for name, values in figures.items()}
        cells[title] |= {f"{name} more": stats.paired(values, figures["right words"])
                         for name, values in figures.items() if name != "right words"}
    return Table("What the interpreter reads", columns, cells, "decision", [
        f"{len(every['no words'])} recordings with words of the {split} split, {count} blocks in strokes that were "
        f"chosen for a word, in {len(meant['no words'])} of them; bootstrap 95 % intervals over recordings, "
        "differences paired. The corpus places these strokes by its own rules; texts are unseen, cue words are not."])


def table(rows: dict[str, dict[str, list[float]]], split: str) -> Table:
    """Nats of each, and by how much those that cannot hear lie above."""
    first, columns = "as shipped", {}
    cells: dict[str, dict[str, stats.Interval]] = {title: {} for title in FIGURES.values()}
    for name, figures in rows.items():
        columns[name] = Column(name, "nats", 3)
        if name != first:
            columns[f"{name} more"] = Column(f"{name}, more", "nats", 3)
        for key, title in FIGURES.items():
            if figures[key]:
                cells[title][name] = stats.mean_interval(figures[key])
                if name != first:
                    cells[title][f"{name} more"] = stats.paired(figures[key], rows[first][key])
    count = len(rows[first]["lexeme"])
    return Table("What the interpreter and the planner hear", columns, cells, "decision", [
        f"{count} recordings of the {split} split; bootstrap 95 % intervals over recordings, differences paired. "
        "Links between speech and motion are planted by the corpus' rules, at full strength."])


if __name__ == "__main__":
    main()
