"""What is each part for? Every row of the papers' ablations, trained, played and measured alike.

    python -m eval.ablate --data STORE --work DIR [--only ROW ...] [--preset ablation|tiny] [--seeds 3]
                          [--budget SECONDS] [--out docs/results/ablation] [--list]

The rows are those of `eval.ablations` (`--list`). What comes first is shared: all rows of all seeds hear through the
same speech encoder, and rows with the same lexicon settings have the same lexicon; seeds differ in what is trained on
top. Every stage is kept in the work folder under the hash of its settings (`gesticulator.train.Run.key`), so a row
trains what its settings change and nothing else, a work folder of the training command serves its finished stages, and
a stopped command goes on. A finished (row, seed) is written at once as ROW-SEED.json.

What is judged is the motion on the split's recordings: each row plays the performer's speech in the performer's
habits. Lexemes of the motion are those of one lexicon, that of `ours`, so that rows without a lexicon, or with
another, can be compared. Figures of a set (FGD, diversity, motion variance) have no value for a clip; each clip gets
the jackknife's: n times the figure of all less n - 1 times the figure without it. So one paired test serves all
(`eval.claims`), and small sets are freed of the greater part of their bias.

What fools it: a row trained as long as the others may need longer; MAJE and MAD praise stillness (eval/joint_error.py);
PMB at 0.2 s is what the papers print and near its chance level, so read the share above chance at 0.1 s. The paper's
figures stand beside ours for their order alone: other data, other skeleton, another network for FGD.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from statistics import median
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from tqdm import tqdm

from data_module.blocks import cut, normalise_motion
from data_module.errors import InputError, one_line_errors
from data_module.files import write_text
from data_module.layers import freeze
from data_module.speech_encoder import SpeechEncoder
from data_module.store import Recording, Store
from data_module.types import Array, Motion, Speech
from eval import fgd, gesture_features, pmb, policies
from eval.ablations import PERFORMER, PRESETS, REAL_TAKE, REFERENCES, ROWS, TABLES, configured, listing
from eval.diversity import diversity, motion_variance
from eval.figures import Clip, measure, real_take
from eval.racer_ablation import interval_over
from eval.results import keep
from gesticulator import bundle as bundles
from gesticulator import config as configs
from gesticulator import fit as fitting
from gesticulator.config import Config
from gesticulator.pipeline import Gesticulator
from gesticulator.prepare import Corpus, Statistics, prepare, representation_of, weights_hash
from gesticulator.racer import train_q_network, train_reward
from gesticulator.train import (
    Labelled,
    Run,
    label,
    train_encoder,
    train_generator,
    train_interpreter,
    train_lexicon,
    train_style,
)
from interpreters import BlockFeatures, LexemeInterpreter, LstmInterpreter, select
from interpreters.style import StyleInterpreter
from lexicon.autoencoder import Lexicon

VERSION = 1
"""Raised when the same settings would no longer give the same figures."""
SEEDS = 3
DECIDED = 3
"""Fewer seeds decide nothing."""
TRIAL = 4
"""Steps that are made to count what a stage costs, after one that does not count."""
PAPERS_DELTA = 0.2

Lexemes = NDArray[np.int64]
Values = dict[str, float]


@dataclass(frozen=True)
class Column:
    """A figure of a table: its heading, its digits, and the key of the paper's figures that stand beside it."""

    title: str
    digits: int
    paper: str = ""


COLUMNS: dict[str, Column] = {
    "maje": Column("MAJE, mm", 1, "maje"), "mad": Column("MAD, mm/s^2", 0, "mad"), "fgd": Column("FGD", 2, "fgd"),
    "pmb": Column(f"PMB at {PAPERS_DELTA} s, %", 1, "pmb"),
    "pmb_above_chance": Column(f"PMB at {pmb.DELTA} s above chance, %", 1),
    "diversity": Column("diversity, nats", 2, "diversity"),
    "variance": Column("motion variance", 3, "variance"),
    "accuracy": Column("right, free-running, %", 1, "accuracy"),
    "teacher_forced": Column("right, teacher-forced, %", 1),
    "speech_speed": Column("hands in speech, m/s", 3), "silence_speed": Column("hands in silence, m/s", 3),
}
"""One value a clip."""


# ---------------------------------------------------------------------------------------------------------- training

@dataclass
class RowRun(Run):
    """The run of a row. others: keys of a speech encoder and a lexicon that are not those of its own settings, if it
    stands on such; they then shape its stages too."""

    others: tuple[str, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)
    """What each stage took; 0 where it was there."""

    def key(self, stage: str) -> str:
        """As the training command's; another one where this run stands on what that command would not have."""
        plain = super().key(stage)
        return configs.digest(plain, list(self.others)) if self.others else plain

    def finished(self, stage: str) -> bool:
        """Whether the work folder has the stage."""
        return (self.work / f"{stage}-{self.key(stage)}" / "figures.json").exists()

    def stage(self, name: str, model: nn.Module, train: Callable[[Path], dict[str, float]]) -> dict[str, float]:
        """See `Run.stage`; the seconds are noted."""
        began, there = time.monotonic(), self.finished(name)
        figures = super().stage(name, model, train)
        self.seconds[name] = 0.0 if there else round(time.monotonic() - began, 1)
        return figures


@dataclass
class Trial(RowRun):
    """A run that makes a few steps of each stage that is not finished and notes what all of them would take.

    The steps are the first ones: an interpreter that later hears its own past costs up to half as much again.
    """

    kept: Path = Path()
    """The work folder of the row; nothing is written there."""

    def finished(self, stage: str) -> bool:
        """Whether the row's work folder has the stage."""
        return (self.kept / f"{stage}-{self.key(stage)}" / "figures.json").exists()

    def stage(self, name: str, model: nn.Module, train: Callable[[Path], dict[str, float]]) -> dict[str, float]:
        """The model as it begins, after a few steps."""
        self.seconds.setdefault(name, 0.0)
        if not self.finished(name):
            folder = self.work / name
            folder.mkdir(exist_ok=True)
            train(folder)
        freeze(model)
        return {}

    def fit(self, stage: str, model: nn.Module, make_batch: fitting.MakeBatch, losses: fitting.Losses, folder: Path,
            validate: fitting.Validate, before_step: Callable[[int], None] | None = None) -> dict[str, float]:
        """Times a few steps; nothing is validated."""
        schedule, times = self.schedule(stage), []

        def timed(step: int) -> None:
            if before_step is not None:
                before_step(step)
            times.append(time.monotonic())

        fitting.fit(stage, model, make_batch, losses, schedule, folder, seed=self.seed(stage), before_step=timed,
                    checkpoint_seconds=float("inf"), progress=False, stop_after=TRIAL + 1)
        steps = np.diff(times)[1:] if len(times) > 2 else np.diff(times)
        self.seconds[stage] = round(schedule.steps * float(median(steps)), 1) if len(steps) else 0.0
        return {}


def fitted(run: RowRun, lexicon: Lexicon, labelled: Labelled, encoder: SpeechEncoder | None) -> bundles.Bundle:
    """Every stage after the lexicon that the settings ask for, as a bundle to play with."""
    config, text = run.config, bool(run.config.text.encoder) and run.corpus.words is not None
    lstm, _ = train_interpreter(run, lexicon, labelled)
    reads = text and config.interpreter.reads
    read = train_interpreter(run, lexicon, labelled, text=True)[0] if reads else None
    generator, _ = train_generator(run, lexicon, labelled)
    style, _ = train_style(run, lexicon, generator, labelled)
    style_read = None
    if text and config.style.text_features:
        style_read, _ = train_style(run, lexicon, generator, labelled, text=True)
    acted: dict[str, Any] = {}
    if config.schedules.cql.steps:
        acted["reward"], _ = train_reward(run, lexicon, labelled)
        acted["q_network"], _ = train_q_network(run, lexicon, labelled, acted["reward"], lstm)
    return bundles.Bundle(
        config, run.corpus.statistics, lexicon, generator, lstm, style, labelled.inventory, labelled.silent, {}, {},
        encoder=encoder, interpreter_text=read, style_text=style_read,
        text=bundles.TextSource.of(config, run.corpus.text_width), **acted)


class RandomStyle:
    """Style codes that know nothing: z from N(0, I) anew on each block, as L_z would have the learned (RG Table 2)."""

    def __init__(self, code_width: int, seed: int) -> None:
        self.code_width, self._seed = code_width, seed

    def start(self, speaker: int) -> np.random.Generator:
        """The state is what is drawn from, the same in each recording."""
        return np.random.default_rng([self._seed, speaker])

    def step(self, state: np.random.Generator, features: BlockFeatures, lexeme: int
             ) -> tuple[Tensor, np.random.Generator]:
        """A code [1, d_z]."""
        return torch.as_tensor(state.standard_normal((1, self.code_width)), dtype=torch.float32), state


# ---------------------------------------------------------------------------------------------- what all rows share

@dataclass
class Bench:
    """What all rows stand on. first: the run of the preset as it is; encoder: the ears of all rows; by: what the
    Frechet distance is measured in, the first of which the tables show; limit: recordings of a split at most."""

    first: Run
    encoder: SpeechEncoder | None
    by: Sequence[gesture_features.Features]
    limit: int | None = None
    workers: int = 1
    _corpora: dict[str, Corpus] = field(default_factory=dict)
    _real: dict[str, list[list[Array]]] = field(default_factory=dict)

    @classmethod
    def of(cls, store: Store, base: Config, work: Path, by: Sequence[gesture_features.Features], *,
           limit: int | None = None, speech: Sequence[Path] = (), workers: int = 1, progress: bool = True) -> Bench:
        """The ears are trained here, where the work folder has none of these settings."""
        if not any(info.split == "test" for info in store.recordings):
            raise InputError(store.path, "has no test split", "build the store again")
        first = Run(base, store, work, progress=progress, speech=tuple(speech))
        first.corpus = prepare(store, base, work, workers=workers, progress=progress)
        encoder = train_encoder(first)[0] if base.front_end.name == "vqwav2vec" else None
        bench = cls(first, encoder, by, limit, workers)
        first.corpus = bench.corpus(base)
        return bench

    def corpus(self, config: Config) -> Corpus:
        """The store as these settings cut it; that of the preset and the last other one stay in memory."""
        key = configs.digest(config.rhythm, config.motion, config.control, config.text, config.front_end)
        if key not in self._corpora:
            while len(self._corpora) > 1:
                self._corpora.pop(list(self._corpora)[-1])
            self._corpora[key] = prepare(self.first.store, config, self.first.work, self.encoder, workers=self.workers,
                                         progress=self.first.progress)
        return self._corpora[key]

    @cached_property
    def judge(self) -> tuple[Lexicon, Labelled]:
        """The lexicon of the preset as it is, and the corpus as it reads it: all motion is judged by it."""
        lexicon, _ = train_lexicon(self.first)
        return lexicon, label(self.first, lexicon)

    @property
    def shared(self) -> str:
        """Hash of what all rows share; figures of one folder must agree in it."""
        return configs.digest(VERSION, self.first.store.fingerprint, self.first.config, self.first.key("lexicon"),
                              weights_hash(self.encoder) if self.encoder else "", [one.sha256 for one in self.by],
                              [[one.name, one.frames] for one in self.by], self.limit)

    def runs(self, name: str, seed: int) -> tuple[Run, RowRun]:
        """The run that makes a row's lexicon, and the one that does the rest; without the corpus (see `cut`)."""
        base = self.first
        config = configured(base.config, name)
        before = Run(config, base.store, base.work, base.device, base.progress, base.speech)
        own = RowRun(replace(config, seed=seed), base.store, base.work, base.device, base.progress, base.speech)
        made = (base.key("contrast"), before.key("lexicon"))
        if made != (own.key("contrast"), own.key("lexicon")):
            own.others = made
        return before, own

    def cut(self, before: Run, own: RowRun) -> None:
        """Give both runs of a row the store as their settings cut it."""
        before.corpus = own.corpus = self.corpus(own.config)

    def recordings(self, split: str) -> list[int]:
        """Recordings of a split, `limit` at most."""
        own = self.first.corpus.recordings(split)[:self.limit]
        if not own:
            raise InputError(self.first.store.path, f"has no recording in its {split} split", "build the store again")
        return own

    def loaded(self, number: int) -> Recording:
        """A recording with its sound and motion."""
        return self.first.store.load(self.first.corpus.names[number])

    def real(self, split: str) -> list[list[Array]]:
        """For each recording of a split the performer's features, one of each network."""
        if split not in self._real:
            self._real[split] = [_features(self.loaded(number).motion, self.by) for number in self.recordings(split)]
        return self._real[split]


def counted(bench: Bench, name: str, seed: int) -> dict[str, float]:
    """Seconds that each stage of a row would take, 0 where it is finished; found by a few steps of each."""
    before, run = bench.runs(name, seed)
    bench.cut(before, run)
    with tempfile.TemporaryDirectory() as folder:
        first, rest = (Trial(own.config, own.store, Path(folder), own.device, False, own.speech, others, kept=own.work)
                       for own, others in ((before, ()), (run, run.others)))
        first.corpus = rest.corpus = run.corpus
        there = first.finished("lexicon")
        lexicon, _ = train_lexicon(before if there else first)
        if not there:  # what is labelled must use the lexemes, or none of them could be found silent
            lexicon.start_codebook(run.corpus.motion[torch.as_tensor(run.corpus.select("train"))], 0)
        fitted(rest, lexicon, label(rest, lexicon), bench.encoder)
        return {"lexicon": first.seconds.get("lexicon", 0.0), **rest.seconds}


# --------------------------------------------------------------------------------------------------------- measuring

@dataclass(frozen=True)
class Seen:
    """What is measured on one clip. latents: [N, D] and lexemes: [N] of its blocks, by the judging lexicon; features:
    [n, E] of each network; pmb_curve: PMB for each delta."""

    name: str
    values: Values
    latents: Array
    lexemes: Lexemes
    features: list[Array]
    pmb_curve: Array


def pseudo_values(of: Callable[[list[int]], float], count: int) -> Array:
    """[n] n f(all) - (n - 1) f(all but k): what clip k adds to a figure of a set (Tukey's jackknife).

    of: the figure of the clips with these numbers. Their mean is the figure less the greater part of its bias, and
    their spread is the figure's, as if it were a mean.
    """
    every = list(range(count))
    whole = of(every)
    if count < 2:
        return np.full(count, whole)
    return np.array([count * whole - (count - 1) * of([k for k in every if k != left]) for left in every])


def rhythm_values(clip: Clip) -> Values:
    """PMB as the papers print it, in percent."""
    return {"pmb": pmb.pmb(clip.beats, clip.onsets, PAPERS_DELTA)}


def _features(motion: Motion, by: Sequence[gesture_features.Features]) -> list[Array]:
    return [gesture_features.pooled([motion], one)[0] for one in by]


def blocks_of(motion: Motion, speech: Speech, config: Config, statistics: Statistics, speaker: int | None) -> Tensor:
    """[N, K, D_m] a motion as the judging lexicon reads it; without a speaker it is centred on its own mean pose."""
    poses = normalise_motion(motion, cut(speech, config.rhythm), representation_of(config))
    normalised = (statistics.normalise(poses, speaker) if speaker is not None
                  else (poses - poses.mean(axis=(0, 1))) / statistics.deviation)
    return torch.as_tensor(normalised, dtype=torch.float32)


def seen(bench: Bench, name: str, motion: Motion, speech: Speech, truth: Motion | None, speaker: int | None,
         values: Values, place: int, lexemes: Lexemes | None = None, edges: Array | None = None) -> Seen:
    """Everything that is measured on a clip. truth: the performer's motion, None where there is none; lexemes: those
    that the motion was made of, where they are the judge's."""
    lexicon, _ = bench.judge
    first = bench.first
    clip = measure(motion, speech, edges)
    own = policies.motion_values(clip, motion, motion if truth is None else truth, seed=place)
    if truth is None:
        own |= {"maje": float("nan"), "mad": float("nan")}
    blocks = blocks_of(motion, speech, first.config, first.corpus.statistics, speaker)
    latents = lexicon.latents(blocks)
    nearest = lexicon.quantizer.labels(latents).numpy()
    fits = lexemes is not None and len(lexemes) == len(nearest)
    found = {**dict.fromkeys(COLUMNS, float("nan")), **own, **rhythm_values(clip), **values}
    return Seen(name, {**found, "conditioned": float(fits)}, latents.double().numpy(),
                cast(Lexemes, lexemes) if fits else nearest, _features(motion, bench.by),
                pmb.delta_curve(clip.beats, clip.onsets).percent)


def summary(bench: Bench, clips: Sequence[Seen], real: Sequence[Sequence[Array]]) -> dict[str, Any]:
    """The cell of a row: values of each clip, those of the whole set among them by the jackknife.

    real: for each clip the performer's features, one of each network. Diversity is of the motion's own lexemes, read
    from it again; the variance is about the lexemes that it was made of, where those are the judge's (RG 7.4.2).
    """
    lexicon, _ = bench.judge
    vectors = lexicon.vectors.double().numpy()
    read = [lexicon.quantizer.labels(torch.as_tensor(clip.latents, dtype=torch.float32)).numpy() for clip in clips]

    def distance(which: int, chosen: list[int]) -> float:
        ours, theirs = ([one[k][which] for k in chosen if len(one[k][which])]
                        for one in ([clip.features for clip in clips], real))
        if min(sum(map(len, ours)), sum(map(len, theirs))) < 2:
            return float("nan")
        return fgd.distance(np.concatenate(ours), np.concatenate(theirs))

    def variety(chosen: list[int]) -> float:
        return diversity(np.concatenate([read[k] for k in chosen]), len(vectors)).nats

    def variance(chosen: list[int]) -> float:
        return motion_variance(np.concatenate([clips[k].latents for k in chosen]),
                               np.concatenate([clips[k].lexemes for k in chosen]), vectors).mean

    every, count = list(range(len(clips))), len(clips)
    # A set that is not the performer's own speech has no pairs with it.
    paired = len(real) == count
    added = {"diversity": pseudo_values(variety, count), "variance": pseudo_values(variance, count),
             "fgd": pseudo_values(lambda k: distance(0, k), count) if paired and bench.by else np.full(count, np.nan)}
    return {
        "clips": [{"name": clip.name, **clip.values, **{key: float(values[k]) for key, values in added.items()}}
                  for k, clip in enumerate(clips)],
        "sets": {"diversity": variety(every), "variance": variance(every),
                 "fgd": [fgd.measure([clip.features[w] for clip in clips], [one[w] for one in real], network,
                                     paired=True).to_dict() for w, network in enumerate(bench.by) if paired],
                 "pmb_curve": {"deltas": list(pmb.DELTAS),
                               "percent": np.mean([clip.pmb_curve for clip in clips], axis=0).tolist()}}}


@torch.inference_mode()
def right(system: LexemeInterpreter, corpus: Corpus, hinted: Lexemes, silent: Lexemes, recording: int,
          teacher: bool) -> float:
    """Percent of a recording's blocks whose best lexeme is the performer's (with the silent hint, under the silent
    mask), block 0 given; teacher: the performer's past is heard and not its own (RG Table 6)."""
    own = corpus.blocks_of(recording)
    previous, hits = int(hinted[own[0]]), 0
    state = system.start(int(corpus.speaker_of[recording]), previous)
    reads = isinstance(system, LstmInterpreter) and system.config.reads
    for block in own[1:]:
        quiet = bool(corpus.silent[block])
        text = corpus.text(np.array([block]))[0] if reads else None
        heard = BlockFeatures(corpus.low[block].float(), corpus.high[block].float(), quiet, text)
        scores, state = system.step(state, heard, previous)
        chosen = select(scores, allowed=silent if quiet else None)
        hits += chosen == hinted[block]
        previous = int(hinted[block]) if teacher else chosen
    return 100.0 * hits / (len(own) - 1) if len(own) > 1 else float("nan")


def accuracy(bench: Bench, system: Gesticulator, interpreter: str, recording: int) -> Values:
    """Free-running and teacher-forced; only of a row over the judge's lexicon."""
    corpus, (_, labelled) = bench.first.corpus, bench.judge
    chooser = system.interpreter(interpreter, bool(corpus.has_text[recording]))
    free, forced = (right(chooser, corpus, labelled.hinted, labelled.silent, recording, teacher)
                    for teacher in (False, True))
    return {"accuracy": free, "teacher_forced": forced}


def played(bench: Bench, name: str, bundle: bundles.Bundle, over_judge: bool, seed: int) -> list[Seen]:
    """A row's motion for the split's speech, measured. over_judge: the row has the judge's lexicon."""
    row, corpus = ROWS[name], bench.first.corpus
    if row.style == "random":
        width = bundle.config.generator.style_width
        bundle = replace(bundle, style=cast(StyleInterpreter, RandomStyle(width, seed)), style_text=None)
    system = Gesticulator(bundle)
    out = []
    for k, number in enumerate(tqdm(bench.recordings(row.split), desc=f"{name}, seed {seed}",
                                    disable=not bench.first.progress)):
        recording = bench.loaded(number)
        made = system(recording.speech, speaker=recording.info.speaker, interpreter=row.interpreter, seed=seed,
                      temperature=1.0 if row.interpreter == "statistical" else None)
        right_ones = accuracy(bench, system, row.interpreter, number) if over_judge else {}
        out.append(seen(bench, corpus.names[number], made.motion, recording.speech, recording.motion,
                        int(corpus.speaker_of[number]), right_ones, k, made.lexemes if over_judge else None,
                        made.blocks.edges))
    return out


# -------------------------------------------------------------------------------------------------------------- cells

def file_of(out: Path, name: str, seed: int) -> Path:
    """Where a cell is kept."""
    return out / f"{name}-{seed}.json"


def finished(file: Path, key: str | None = None) -> dict[str, Any] | None:
    """What a file holds; None where it is missing, cut short, or of other settings than `key`."""
    try:
        known: dict[str, Any] = json.loads(file.read_text())
    except (FileNotFoundError, ValueError):
        return None
    return known if key in (None, known.get("key")) else None


def row_key(bench: Bench, name: str, seed: int) -> str:
    """Hash of everything that shapes a cell."""
    row, (before, run) = ROWS[name], bench.runs(name, seed)
    stages = ("interpreter", "interpreter_text", "generator", "style", "style_text", "reward", "cql")
    config = run.config
    return configs.digest(bench.shared, before.key("lexicon"), [run.key(stage) for stage in stages], row.interpreter,
                          row.style, config.selection, config.silence, config.statistical, config.motion,
                          [bench.first.corpus.names[number] for number in bench.recordings(row.split)])


def cell(bench: Bench, name: str, seed: int, out: Path) -> dict[str, Any]:
    """One row at one seed: read from `out` if it was finished under the same key, else trained, played, written."""
    key = row_key(bench, name, seed)
    known = finished(file_of(out, name, seed), key)
    if known is not None:
        return known
    began, row = time.monotonic(), ROWS[name]
    before, run = bench.runs(name, seed)
    bench.cut(before, run)
    lexicon, _ = train_lexicon(before)
    trained = time.monotonic()
    bundle = fitted(run, lexicon, label(run, lexicon), bench.encoder)
    fitted_in = time.monotonic() - trained
    over_judge = before.key("lexicon") == bench.first.key("lexicon")
    clips = played(bench, name, bundle, over_judge, seed)
    result = {"row": name, "seed": seed, "key": key, "shared": bench.shared, "question": row.question,
              "settings": list(row.settings), "interpreter": row.interpreter, "style": row.style, "split": row.split,
              "stages": run.seconds, "seconds": {"lexicon": round(trained - began, 1), "training": round(fitted_in, 1),
                                                 "in_all": round(time.monotonic() - began, 1)},
              **summary(bench, clips, bench.real(row.split))}
    write_text(file_of(out, name, seed), json.dumps(result) + "\n")
    return result


def reference(bench: Bench, name: str, split: str, out: Path) -> dict[str, Any] | None:
    """The cell of the performer or of the real take, on no seed; None where there is no real take."""
    shown = name if split == "test" else f"{name}-{split}"
    key = configs.digest(bench.shared, name, split, [bench.first.corpus.names[k] for k in bench.recordings(split)])
    known = finished(file_of(out, shown, 0), key)
    if known is not None:
        return known
    corpus, real = bench.first.corpus, list[list[Array]]()
    if name == PERFORMER:
        clips = []
        for k, number in enumerate(bench.recordings(split)):
            recording = bench.loaded(number)
            clips.append(seen(bench, recording.info.name, recording.motion, recording.speech, recording.motion,
                              int(corpus.speaker_of[number]), {}, k))
        real = [clip.features for clip in clips]
    else:
        take = real_take()
        if take is None:
            return None
        clips = [seen(bench, "take", take[0], take[1], None, None, {}, 0)]
    result = {"row": shown, "seed": 0, "key": key, "shared": bench.shared, "question": REFERENCES[name],
              "settings": [], "split": split, **summary(bench, clips, real)}
    write_text(file_of(out, shown, 0), json.dumps(result) + "\n")
    return result


# ---------------------------------------------------------------------------------------------------------- the table

Cells = dict[str, dict[int, dict[str, Any]]]
"""By row and seed; what has no seed is at 0."""


def read_cells(folder: Path, shared: str | None = None) -> Cells:
    """The finished cells of a folder; InputError when they do not stand on the same."""
    cells: Cells = {}
    stands = set()
    for file in sorted(folder.glob("*-*.json")):
        known = finished(file)
        if known is None or "shared" not in known or shared not in (None, known["shared"]):
            continue
        stands.add(known["shared"])
        cells.setdefault(known["row"], {})[int(known["seed"])] = known
    if len(stands) > 1:
        raise InputError(folder, "holds figures of different presets, stores or versions", "keep them in two folders")
    return cells


def values_of(cells: Sequence[Mapping[str, Any]], key: str) -> Array:
    """[seeds, clips] of one column."""
    return np.array([[clip.get(key, float("nan")) for clip in one["clips"]] for one in cells], dtype=np.float64)


def tabled(cells: Cells) -> dict[str, Any]:
    """Every row's figures with their intervals over seeds and clips."""
    rows = {}
    for name, by_seed in cells.items():
        own = [by_seed[seed] for seed in sorted(by_seed)]
        rows[name] = {
            "settings": own[0]["settings"], "question": own[0]["question"], "seeds": sorted(by_seed),
            "decided": name.startswith(tuple(REFERENCES)) or len(by_seed) >= DECIDED,
            "seconds": [one["seconds"]["training"] for one in own if "seconds" in one],
            "pmb_curve": np.mean([one["sets"]["pmb_curve"]["percent"] for one in own], axis=0).tolist(),
            "fgd": [one["sets"]["fgd"] for one in own],
            "figures": {key: interval_over(values_of(own, key), np.ones(len(own[0]["clips"]))).to_dict()
                        for key in COLUMNS}}
    return rows


def _cell(value: Mapping[str, float], digits: int) -> str:
    if not np.isfinite(value["mean"]):
        return "-"
    return f"{value['mean']:.{digits}f} [{value['low']:.{digits}f}, {value['high']:.{digits}f}]"


def _paper(pair: tuple[float | None, float | None] | None) -> str:
    return "" if pair is None else " / ".join("-" if one is None else f"{one:g}" for one in pair)


def table_lines(title: str, rows: Mapping[str, Any], refused: Mapping[str, str]) -> list[str]:
    """One table of the paper as Markdown: our figure, and the paper's in a column beside it where it has one."""
    table = TABLES[title]
    suffix = "" if table.split == "test" else f"-{table.split}"
    stands = [(line.label, line.row + (suffix if line.row in REFERENCES else ""), line.paper) for line in table.lines]
    stands += [(about, name + suffix, {}) for name, about in REFERENCES.items()
               if name + suffix not in {row for _, row, _ in stands}]
    heads = [f"{title} ({table.split})"]
    for key in table.columns:
        heads.append(COLUMNS[key].title)
        if COLUMNS[key].paper and any(COLUMNS[key].paper in paper for _, _, paper in stands):
            heads.append("the paper's, Trinity / TED")
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for text, name, paper in stands:
        row: Mapping[str, Any] | None = rows.get(name)
        if row is None and name.startswith(REAL_TAKE):
            continue
        if row is None:
            text += f" ({refused.get(name, 'not run')})"
        elif not row["decided"]:
            text += f" (undecided: {len(row['seeds'])} of {DECIDED} seeds)"
        cells = [text]
        for key in table.columns:
            cells.append("-" if row is None else _cell(row["figures"][key], COLUMNS[key].digits))
            if COLUMNS[key].paper and any(COLUMNS[key].paper in own for _, _, own in stands):
                cells.append(_paper(paper.get(COLUMNS[key].paper)))
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def markdown(result: Mapping[str, Any]) -> str:
    """All tables for a reader."""
    rows, told = result["rows"], result["store"]
    lines = [f"Preset {result['preset']}; test split: {told['test_recordings']} recordings. Means over seeds and clips "
             "with bootstrap 95 % intervals, both drawn anew. The paper's figures are of other data, another skeleton "
             "and another network for FGD: compare the order, not the values. FGD, diversity and motion variance "
             "are means of the jackknife's values, so less biased than the figures of the sets (in the JSON).", ""]
    for title in TABLES:
        lines += [*table_lines(title, rows, result["refused"]), ""]
    deltas = [f"{delta:g}" for delta in pmb.DELTAS]
    lines += ["| PMB, %, by delta in s (RG Fig. 11) | " + " | ".join(deltas) + " |", "|---" * (len(deltas) + 1) + "|"]
    lines += [f"| {name} | " + " | ".join(f"{value:.1f}" for value in row["pmb_curve"]) + " |"
              for name, row in rows.items()]
    lines += ["", "| row | settings | seconds of training, by seed |", "|---|---|---|"]
    lines += [f"| {name} | {' '.join(row['settings'])} | {', '.join(f'{s:.0f}' for s in row['seconds'])} |"
              for name, row in rows.items()]
    lines += ["", *(f"Not run: {name}: {why}." for name, why in result["refused"].items()),
              *(f"Unavailable: {name}: {row.unavailable}." for name, row in ROWS.items() if row.unavailable)]
    return "\n".join(lines) + "\n"


# ------------------------------------------------------------------------------------------------------- the command

def ablate(bench: Bench, out: Path, *, only: Sequence[str] = (), seeds: int = SEEDS, budget: float | None = None
           ) -> dict[str, Any]:
    """Run what is asked for and is not finished; all rows that are finished, as plain values.

    budget: seconds of training that a row may take at one seed; one that would take more is refused, not shortened,
    since a row trained for fewer steps than the others would be compared with them.
    """
    out.mkdir(parents=True, exist_ok=True)
    names = list(only) or [name for name, row in ROWS.items() if not row.unavailable]
    refused: dict[str, str] = {}
    jobs = [(name, seed) for seed in range(1, seeds + 1) for name in names]
    bar = tqdm(jobs, desc="rows", disable=not bench.first.progress)
    for name, seed in bar:
        bar.set_postfix_str(f"{name}, seed {seed}")
        if name in refused:
            continue
        if budget is not None and finished(file_of(out, name, seed), row_key(bench, name, seed)) is None:
            cost = counted(bench, name, seed)
            if sum(cost.values()) > budget:
                refused[name] = (f"{sum(cost.values()):.0f} s of training counted at seed {seed}, {budget:g} s allowed "
                                 f"({', '.join(f'{stage} {s:.0f}' for stage, s in cost.items() if s)})")
                continue
        cell(bench, name, seed, out)
    for split in dict.fromkeys(ROWS[name].split for name in names):
        for name in REFERENCES:
            reference(bench, name, split, out)
    cells = {name: {seed: own for seed, own in by_seed.items()
                    if name not in ROWS or own["key"] == row_key(bench, name, seed)}
             for name, by_seed in read_cells(out, bench.shared).items()}
    return {"preset": bench.first.config.name, "shared": bench.shared, "refused": refused,
            "store": {"name": bench.first.store.corpus, "fingerprint": bench.first.store.fingerprint,
                      "test_recordings": len(bench.recordings("test"))},
            "rows": tabled({name: own for name, own in cells.items() if own})}


def networks(store: Store, work: Path, preset: str) -> Sequence[gesture_features.Features]:
    """What FGD is measured in: our own networks and the papers' where it is; for a first look, raw directions."""
    if preset == "tiny":
        return [gesture_features.RawFeatures(34, count=1)]
    return policies.networks(store, work)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser("eval.ablate", description="The ablations of the papers.")
    p.add_argument("--data", metavar="STORE", help="needed, except with --list")
    p.add_argument("--work", metavar="DIR", help="where stages are kept (needed likewise)")
    p.add_argument("--only", nargs="+", default=[], metavar="ROW", help="rows to run; tables have all finished ones")
    p.add_argument("--preset", default="ablation", choices=tuple(PRESETS))
    p.add_argument("--set", action="append", default=[], metavar="PATH=VALUE", dest="settings",
                   help="change a setting of the preset, for every row alike")
    p.add_argument("--seeds", type=int, default=SEEDS, metavar="N", help=f"seeds 1 to N ({SEEDS})")
    p.add_argument("--budget", type=float, metavar="SECONDS", help="refuse a row that would train longer at one seed")
    p.add_argument("--limit", type=int, metavar="N", help="the first N recordings of a split only")
    p.add_argument("--workers", type=int, default=os.cpu_count() or 1, metavar="N", help="processes that cut and hear")
    p.add_argument("--speech", action="append", default=[], metavar="DIR",
                   help="a folder of more sound, where the speech encoder was trained with it")
    p.add_argument("--out", default="docs/results/ablation", metavar="DIR", help="for ROW-SEED.json, table.json, .md")
    p.add_argument("--list", action="store_true", help="show the rows and stop")
    p.add_argument("--quiet", action="store_true", help="no progress bars")
    return p


def _checked(arguments: argparse.Namespace) -> None:
    for name in ("seeds", "budget", "limit", "workers"):
        value = getattr(arguments, name)
        if value is not None and value <= 0:
            raise InputError(f"--{name} {value}", "is too little", "choose more than 0")
    unknown = [name for name in arguments.only if name not in ROWS]
    if unknown:
        raise InputError(f"--only {' '.join(unknown)}", "is no row", f"choose among {', '.join(ROWS)}")
    for name in arguments.only:
        if ROWS[name].unavailable:
            raise InputError(f"--only {name}", f"is unavailable: {ROWS[name].unavailable}", "see --list")
    if arguments.data is None or arguments.work is None:
        raise InputError("--data and --work", "are needed", "give a store and a folder to keep things in")


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    arguments = parser().parse_args(argv)
    if arguments.list:
        print(listing())
        return 0
    with one_line_errors("eval.ablate"):
        _checked(arguments)
        torch.set_num_threads(1)
        store, work, out = Store.open(arguments.data), Path(arguments.work), Path(arguments.out)
        work.mkdir(parents=True, exist_ok=True)
        base = configs.with_settings(PRESETS[arguments.preset](), arguments.settings)
        bench = Bench.of(store, base, work, networks(store, work, arguments.preset), limit=arguments.limit,
                         speech=[Path(folder) for folder in arguments.speech], workers=arguments.workers,
                         progress=not arguments.quiet)
        result = ablate(bench, out, only=arguments.only, seeds=arguments.seeds, budget=arguments.budget)
        keep(result, markdown(result), out / "table.json")
        print(markdown(result))
    return 0


if __name__ == "__main__":
    sys.exit(main())
