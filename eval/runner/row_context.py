"""What the rows of an ablation stand on: the store, the runs that train them, where their cells and motion are kept.

What comes first is shared: all rows of all seeds hear through the same speech encoder, and rows with the same lexicon
settings have the same lexicon; seeds differ in what is trained on top. Every stage is kept in the work folder under the
hash of its settings, so a row trains what its settings change and nothing else, and a work folder of the training
command serves its finished stages.
"""

from __future__ import annotations

import io
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from torch import nn

from data_module.errors import InputError
from data_module.files import lock, write_bytes
from data_module.speech.audio import SAMPLE_RATE
from data_module.speech.audio import resample as resample_speech
from data_module.store import Recording, Store
from data_module.types import Array
from eval.metrics import gesture_features
from eval.rows import ROWS, racer
from eval.rows.cells import CellStore, family
from eval.runner import racer as policy_training
from eval.runner.context import EvalContext
from eval.runner.judge import ClipSpeech, Judge, JudgedClip, features_of
from eval.runner.racer import RacerRows
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle import config as configs
from gesticulator.bundle.config import Config
from gesticulator.bundle.features import SpeechFeatures
from gesticulator.bundle.parts import JUDGES
from gesticulator.pipeline import Gesticulator
from gesticulator.training.fit import late_gain
from gesticulator.training.stages import (
    BLOCKS,
    CORPUS,
    ENCODER,
    LEXICON,
    STAGES,
    Corpus,
    Node,
    Run,
    Stage,
    assemble,
    wanted,
)
from gesticulator.training.stages.caches import weights_hash

VERSION = 2
"""Raised when the same settings would no longer give the same figures."""
SHORTEST = 20.0
"""Seconds; a shorter clip has too few beats for a figure of its own."""
SHOWN_SEED = 1
"""The seed whose motion is kept as BVH and drawn."""
PLAYED_ARRAYS = ("latents", "lexemes", "beats", "onsets", "edges")
"""What is kept of each clip for the figures."""

T = TypeVar("T")


# ------------------------------------------------------------------------------------------------------------ training

@dataclass
class RowRun(Run):
    """The run of a row. taken: nodes that another run makes, by name, whose keys then shape this run's stages."""

    taken: Mapping[str, Run] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    """What each stage took; 0 where it was there."""
    late_gains: dict[str, float] = field(default_factory=dict)
    """By how much each stage's validation still became better in the last quarter of its training, as a share."""

    def get(self, node: Node[T]) -> T:
        """See `Run.get`; what another process is making is waited for."""
        if node.name in self.taken:
            return self.taken[node.name].get(node)
        if node.name in self._values or node.name not in (BLOCKS.name, CORPUS.name):
            return super().get(node)
        with lock(self.work / node.name, f"a row that makes {node.name}", beside=True, wait=True):
            return super().get(node)

    def key(self, node: Node[Any]) -> str:
        """See `Run.key`."""
        return self.taken[node.name].key(node) if node.name in self.taken else super().key(node)

    def train_stage(self, stage: Stage[Any], model: nn.Module) -> dict[str, float]:
        """See `Run.train_stage`; the seconds are noted."""
        with lock(self.folder(stage), f"a row that trains {stage.name}", beside=True, wait=True):
            began, there = time.monotonic(), self.finished(stage)
            figures = super().train_stage(stage, model)
        self.seconds[stage.name] = 0.0 if there else round(time.monotonic() - began, 1)
        log = self.folder(stage) / f"{stage.name}.jsonl"
        if log.is_file():
            self.late_gains[stage.name] = late_gain(log)
        return figures


# -------------------------------------------------------------------------------------------------- what all rows share

@dataclass
class AblationContext:
    """What all rows stand on. first: the run of the preset as it is; by: what the Frechet distance is measured in, the
    first of which the tables show; out: where the cells are; limit: recordings of a split at most; bundle: what RACER's
    rows stand on (the row "q-network" where none is given); alone: see `CellStore`. What is costly is made when it is
    asked for."""

    first: Run
    by: Sequence[gesture_features.Features]
    out: Path
    limit: int | None = None
    bundle: str | None = None
    alone: bool = True
    _corpora: dict[str, Run] = field(default_factory=dict)
    _real: dict[str, list[list[Array]]] = field(default_factory=dict)
    _encoded: dict[str, dict[str, SpeechFeatures]] = field(default_factory=dict)
    _speech: dict[str, ClipSpeech] = field(default_factory=dict)

    @property
    def cells(self) -> CellStore:
        """What is finished."""
        return CellStore(self.out, self.alone)

    @property
    def store(self) -> Store:
        """The data."""
        return self.first.store

    @cached_property
    def corpus(self) -> Corpus:
        """The store as the preset cuts it."""
        return self.first.get(CORPUS)

    @cached_property
    def judge(self) -> Judge:
        """The lexicon of the preset as it is: all motion is judged by it."""
        return Judge(self.first.config, self.corpus.statistics, self.first.get(LEXICON), self.by)

    @cached_property
    def racer(self) -> RacerRows:
        """What RACER's rows stand on."""
        if self.bundle:
            bundle = bundles.load(self.bundle)
        else:
            bundle, run = self.trained("q-network", 1)
            bundle = bundle.with_parts(**{name: run.get(STAGES[name]) for name in JUDGES})
        context = EvalContext(self.store, bundle, self.first.work, self.limit, self.first.progress)
        return RacerRows.of(context, racer.PRESETS[self.first.config.name])

    def shared(self, group: str) -> str:
        """Hash of what the rows of a family share; figures that are compared must agree in it."""
        judged_by = [[one.sha256, one.name, one.frames] for one in self.by]
        if group == "racer":
            parts = self.racer.bundle.block_models
            style = weights_hash(parts.style) if parts.style else ""
            return configs.digest(VERSION, self.racer.shapes, weights_hash(parts.generator), style, judged_by,
                                  self.limit, policy_training.MOTION)
        return configs.digest(VERSION, self.store.fingerprint, self.first.config, self.first.key(LEXICON),
                              self.first.key(CORPUS), judged_by, self.limit)

    def runs(self, name: str, seed: int) -> tuple[RowRun, RowRun]:
        """The run that makes a row's lexicon, at the preset's seed, and the one that does the rest."""
        first, config = self.first, configured(self.first.config, name)
        about = (first.store, first.work, first.device, first.progress, first.speech, first.workers)
        corpora = self._corpus_run(config)
        before = RowRun(config, *about, taken={ENCODER.name: first, BLOCKS.name: corpora, CORPUS.name: corpora})
        return before, RowRun(replace(config, seed=seed), *about, taken={**before.taken, LEXICON.name: before})

    def _corpus_run(self, config: Config) -> Run:
        """The run that cuts the store by these settings; that of the preset and the last other one stay in memory."""
        first = self.first
        key, own = (configs.digest(one.rhythm, one.motion, one.control, one.text, one.front_end)
                    for one in (config, first.config))
        return first if key == own else _latest(self._corpora, key, 1, lambda: RowRun(
            config, first.store, first.work, first.device, first.progress, first.speech, first.workers,
            taken={ENCODER.name: first}))

    def trained(self, name: str, seed: int) -> tuple[bundles.Bundle, RowRun]:
        """What a row plays with, and its run; what is not in the work folder is trained."""
        before, run = self.runs(name, seed)
        bundle = assemble(run)
        run.seconds["lexicon"] = before.seconds.get("lexicon", 0.0)
        return bundle, run

    def names(self, split: str) -> list[str]:
        """Recordings of a split that are long enough for shares and speeds (all, where none is), `limit` at most."""
        every = [info for info in self.store.recordings if info.split == split]
        found = [info.name for info in every if info.seconds >= SHORTEST] or [info.name for info in every]
        if not found:
            raise InputError(self.store.path, f"has no recording in its {split} split", "build the store again")
        return found[:self.limit]

    def recordings(self, split: str) -> list[int]:
        """The same by their number in the corpus."""
        return [self.corpus.names.index(name) for name in self.names(split)]

    def loaded(self, number: int) -> Recording:
        """A recording with its sound and motion."""
        return self.store.load(self.corpus.names[number], self.first.config.motion.joints)

    def encoded(self, system: Gesticulator, recording: Recording) -> SpeechFeatures:
        """A recording's speech as a system hears it; kept for the preset's own way and for the last other one."""
        config = system.bundle.config
        key = configs.digest(config.rhythm, config.text, config.front_end, system.reads_text)
        known = _latest(self._encoded, key, 2, dict)
        if recording.info.name not in known:
            known[recording.info.name] = system.encode_speech(resample_speech(recording.speech, SAMPLE_RATE))
        return known[recording.info.name]

    def speech(self, recording: Recording) -> ClipSpeech:
        """A recording's speech as all motion for it is judged by."""
        name = recording.info.name
        if name not in self._speech:
            self._speech[name] = ClipSpeech.of(recording.speech, self.first.config.rhythm)
        return self._speech[name]

    def groups(self, split: str) -> list[str]:
        """For each recording of a split which others share its sound or text."""
        known = {info.name: info.group or info.name for info in self.store.recordings}
        return [known[name] for name in self.names(split)]

    def real(self, split: str) -> list[list[Array]]:
        """For each recording of a split the performer's features, one of each network."""
        if split not in self._real:
            self._real[split] = [features_of(self.loaded(number).motion, self.by) for number in self.recordings(split)]
        return self._real[split]

    def key(self, name: str, seed: int) -> str:
        """Hash of everything that shapes a row's cell."""
        if family(name) == "racer":
            names = [self.racer.corpus.names[take.recording] for take in self.racer.judge.decisions.takes]
            return configs.digest(self.shared("racer"), self.racer.key(name, seed), names)
        row, (_, run) = ROWS[name], self.runs(name, seed)
        config = run.config
        return configs.digest(self.shared("rg"), run.key(LEXICON), [run.key(stage) for stage in wanted(config)],
                              row.interpreter, row.style, config.selection, config.silence, config.statistical,
                              config.motion, self.names(row.split))

    def reference_key(self, name: str, split: str) -> str:
        """Hash of everything that shapes the cell of a reference or a control."""
        return configs.digest(self.shared("rg"), name, split, self.names(split))

    def played(self, name: str, seed: int = SHOWN_SEED) -> PlayedStore:
        """Where the motion of a row or of a reference is."""
        if name in ROWS:
            return PlayedStore.of(self, f"{name}-{seed}", self.key(name, seed))
        return PlayedStore.of(self, f"{name}-0", self.reference_key(name, "test"))


def _latest(known: dict[str, T], key: str, most: int, make: Callable[[], T]) -> T:
    """What is known by a key, made where it is not; of `most` others the last one goes."""
    if key not in known:
        while len(known) >= most:
            known.popitem()
        known[key] = make()
    return known[key]


def configured(base: Config, row: str) -> Config:
    """The settings of a row; InputError where a preset lacks one of them."""
    return configs.with_settings(base, ROWS[row].settings)


@dataclass(frozen=True)
class PlayedStore:
    """Where the motion of a cell is kept in the work folder, with the key of the cell."""

    folder: Path
    key: str

    @classmethod
    def of(cls, context: AblationContext, name: str, key: str) -> PlayedStore:
        """By a cell's name."""
        return cls(context.first.work / "played" / name, key)

    @property
    def file(self) -> Path:
        """What was measured of the motion; beside the folder, in which all files are motion."""
        return self.folder.with_name(f"{self.folder.name}.npz")

    def begin(self) -> None:
        """An empty folder."""
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)

    def write(self, clips: Sequence[JudgedClip]) -> None:
        """The plain arrays of what was measured."""
        memory, arrays = io.BytesIO(), dict[str, Any]()
        for k, clip in enumerate(clips):
            arrays |= {f"{what}_{k}": np.asarray(getattr(clip, what)) for what in PLAYED_ARRAYS}
        np.savez_compressed(memory, key=np.array(self.key), names=np.array([clip.name for clip in clips]), **arrays)
        write_bytes(self.file, memory.getvalue())

    def read(self) -> list[dict[str, NDArray[Any]]]:
        """What was measured of each clip, by name; InputError when it is not there, or of other settings."""
        try:
            with np.load(self.file, allow_pickle=False) as held:
                if str(held["key"]) == self.key:
                    return [{"name": name, **{what: held[f"{what}_{k}"] for what in PLAYED_ARRAYS}}
                            for k, name in enumerate(held["names"])]
        except FileNotFoundError:
            pass
        raise InputError(self.folder, "does not hold the motion of this row", "remove its cell and run the row again")
