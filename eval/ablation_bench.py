"""What all rows of an ablation stand on, and how a row is trained (see `eval.ablate`).

What comes first is shared: all rows of all seeds hear through the same speech encoder, and rows with the same lexicon
settings have the same lexicon; seeds differ in what is trained on top. Every stage is kept in the work folder under the
hash of its settings (`gesticulator.train.Run.key`), so a row trains what its settings change and nothing else, and a
work folder of the training command serves its finished stages.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import torch
from torch import nn

from data_module.blocks import BlockSettings, cut
from data_module.errors import InputError
from data_module.layers import freeze
from data_module.speech.audio import SAMPLE_RATE, resample
from data_module.speech.beats import detect_onsets
from data_module.speech.speech_encoder import SpeechEncoder
from data_module.store import Recording, Store
from data_module.types import Array, Blocks, Motion, Speech
from eval.ablations import configured
from eval.metrics import gesture_features
from gesticulator import bundle as bundles
from gesticulator import config as configs
from gesticulator import fit as fitting
from gesticulator.config import Config
from gesticulator.pipeline import Gesticulator
from gesticulator.prepare import Corpus, prepare, weights_hash
from gesticulator.racer import train_q_network, train_reward
from gesticulator.speech_features import SpeechFeatures
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
from lexicon.autoencoder import Lexicon

VERSION = 1
"""Raised when the same settings would no longer give the same figures."""
SHORTEST = 20.0
"""Seconds; a shorter clip has too few beats for a figure of its own."""
TRIAL = 4
"""Steps that are made to count what a stage costs, after one that does not count."""

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


# -------------------------------------------------------------------------------------------------- what all rows share

@dataclass(frozen=True)
class Said:
    """A speech, its onsets in seconds, and the blocks of the preset as it is."""

    speech: Speech
    onsets: Array
    blocks: Blocks

    @classmethod
    def of(cls, speech: Speech, settings: BlockSettings) -> Said:
        """Listened to."""
        return cls(speech, detect_onsets(speech.samples, speech.sample_rate), cut(speech, settings))

    def lasting(self, seconds: float, settings: BlockSettings) -> Said:
        """Cut to what there is motion for."""
        samples = max(1, round(seconds * self.speech.sample_rate))
        if samples >= len(self.speech.samples):
            return self
        return Said.of(replace(self.speech, samples=self.speech.samples[:samples], words=None), settings)


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
    _heard: dict[str, dict[str, SpeechFeatures]] = field(default_factory=dict)
    _said: dict[str, Said] = field(default_factory=dict)

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
        """Recordings of a split that are long enough for shares and speeds (all, where none is), `limit` at most."""
        seconds = {info.name: info.seconds for info in self.first.store.recordings}
        own = self.first.corpus.recordings(split)
        own = ([number for number in own if seconds[self.first.corpus.names[number]] >= SHORTEST] or own)[:self.limit]
        if not own:
            raise InputError(self.first.store.path, f"has no recording in its {split} split", "build the store again")
        return own

    def loaded(self, number: int) -> Recording:
        """A recording with its sound and motion."""
        return self.first.store.load(self.first.corpus.names[number])

    def heard(self, system: Gesticulator, recording: Recording) -> SpeechFeatures:
        """What a system hears of a recording; kept for the preset's own way of hearing and for the last other one."""
        config = system.bundle.config
        key = configs.digest(config.rhythm, config.text, config.front_end, system.reads_text)
        if key not in self._heard:
            while len(self._heard) > 1:
                self._heard.pop(list(self._heard)[-1])
            self._heard[key] = {}
        known = self._heard[key]
        if recording.info.name not in known:
            known[recording.info.name] = system.encode_speech(resample(recording.speech, SAMPLE_RATE))
        return known[recording.info.name]

    def said(self, recording: Recording) -> Said:
        """A recording's speech as all motion for it is judged by."""
        name = recording.info.name
        if name not in self._said:
            self._said[name] = Said.of(recording.speech, self.first.config.rhythm)
        return self._said[name]

    def speaker(self, recording: Recording) -> int:
        """The performer's number."""
        return int(self.first.corpus.speaker_of[self.first.corpus.names.index(recording.info.name)])

    def groups(self, split: str) -> list[str]:
        """For each recording of a split which others share its sound or text."""
        known = {info.name: info.group or info.name for info in self.first.store.recordings}
        return [known[self.first.corpus.names[number]] for number in self.recordings(split)]

    def real(self, split: str) -> list[list[Array]]:
        """For each recording of a split the performer's features, one of each network."""
        if split not in self._real:
            self._real[split] = [features_of(self.loaded(number).motion, self.by) for number in self.recordings(split)]
        return self._real[split]


def features_of(motion: Motion, by: Sequence[gesture_features.Features]) -> list[Array]:
    """[n, E] of a motion, for each network."""
    return [gesture_features.pooled([motion], one)[0] for one in by]


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
