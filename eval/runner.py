"""One row of an ablation at one seed: trained, played, measured, kept as a cell (see `eval.ablate`).

What comes first is shared: all rows of all seeds hear through the same speech encoder, and rows with the same lexicon
settings have the same lexicon; seeds differ in what is trained on top. Every stage is kept in the work folder under the
hash of its settings, so a row trains what its settings change and nothing else, and a work folder of the training
command serves its finished stages.

A row plays the performer's speech in the performer's habits. Beside the rows stand cells without a seed, measured by
the same code (`eval.judge`): the performer (whose motion is the truth), a real take, motion that is known to be wrong
(`eval.baselines`), and what other systems made of the same speech. The motion itself stays in the work folder: its
beats, onsets, block edges, latents and lexemes in played/ROW-SEED.npz, for the figures, and for the first seed a BVH of
each clip in played/ROW-SEED, to be looked at or given to `gesticulator score`.
"""

from __future__ import annotations

import hashlib
import io
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from torch import nn
from tqdm import tqdm

from data_module.errors import InputError
from data_module.files import lock, write_bytes
from data_module.motion.bvh import write_bvh
from data_module.motion.kinematics import resample
from data_module.speech.audio import SAMPLE_RATE
from data_module.speech.audio import resample as resample_speech
from data_module.store import Recording, Store
from data_module.types import Array, Motion
from eval import baselines, policy_training
from eval.cells import Cell, CellStore, family
from eval.clip import real_take
from eval.foreign import find_motions, read_folder
from eval.judge import ClipSpeech, Judge, JudgedClip, PlayedClip, features_of
from eval.metrics import fgd, gesture_features
from eval.policy import Decisions, accuracy
from eval.policy_training import RacerContext
from eval.rows import CONTROLS, FLOOR, REAL_TAKE, REFERENCES, ROWS, STILL, racer
from gesticulator import bundle as bundles
from gesticulator import config as configs
from gesticulator.config import Config
from gesticulator.features import SpeechFeatures
from gesticulator.fit import late_gain
from gesticulator.pipeline import FPS, Gesticulator
from gesticulator.stages import (
    BLOCKS,
    CORPUS,
    ENCODER,
    LABELS,
    LEXICON,
    STAGES,
    Corpus,
    Node,
    Run,
    Stage,
    assemble,
    wanted,
)
from gesticulator.stages.caches import weights_hash
from gesticulator.stages.q_network import takes_of

VERSION = 2
"""Raised when the same settings would no longer give the same figures."""
SHORTEST = 20.0
"""Seconds; a shorter clip has too few beats for a figure of its own."""
SHOWN_SEED = 1
"""The seed whose motion is kept as BVH and drawn."""
FLOOR_DRAWS = 20
"""Ways to halve the performer's clips."""
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
    def racer(self) -> RacerContext:
        """What RACER's rows stand on."""
        if self.bundle:
            bundle = bundles.load(self.bundle)
        else:
            bundle, run = self.trained("q-network", 1)
            bundle = bundle.with_parts(**{name: run.get(STAGES[name]) for name in bundles.JUDGES})
        return RacerContext.of(self.store, bundle, self.first.work, racer.PRESETS[self.first.config.name], self.limit,
                               self.first.progress)

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

    def played(self, name: str, seed: int = SHOWN_SEED) -> PlayedStore:
        """Where the motion of a row or of a reference is."""
        if name in ROWS:
            return PlayedStore.of(self, f"{name}-{seed}", self.key(name, seed))
        return PlayedStore.of(self, f"{name}-0", reference_key(self, name, "test"))


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


# --------------------------------------------------------------------------------------------------------------- cells

def original(context: AblationContext, name: str) -> str:
    """The row whose cell a row is a copy of: of RACER's rows that are one network, the first; else itself."""
    return racer.twins(context.racer.run.config)[name] if family(name) == "racer" else name


def cell(context: AblationContext, name: str, seed: int) -> Cell:
    """One row at one seed: read if it was finished under the same key, else trained, played, measured and kept."""
    made: Callable[[], Mapping[str, Any]]
    if family(name) == "racer":
        same = original(context, name)
        key = context.key(same, seed)
        made = ((lambda: policy_training.measured(context.racer, name, seed, context.by)) if same == name else
                (lambda: {**cell(context, same, seed), "run_as": same}))
    else:
        key = context.key(name, seed)
        made = lambda: row_figures(context, name, seed, PlayedStore.of(context, f"{name}-{seed}", key))  # noqa: E731
    row = ROWS[name]
    found = _kept(context, (name, seed, key), made, kind="row", question=row.question, settings=list(row.settings),
                  split=row.split)
    assert found is not None
    return found


def _kept(context: AblationContext, at: tuple[str, int, str], make: Callable[[], Mapping[str, Any] | None],
          **about: Any) -> Cell | None:
    """The cell of a row, a seed and a key, made and written where it is not there; None where none can be made."""
    name, seed, key = at
    known = context.cells.finished(name, seed, key)
    if known is not None:
        return known
    found = make()
    if not found:
        return None
    made = {**found, "row": name, "seed": seed, "key": key, "shared": context.shared(family(name)), **about}
    context.cells.add(made)
    return made


def row_figures(context: AblationContext, name: str, seed: int, place: PlayedStore) -> dict[str, Any]:
    """"clips", "sets" and "seconds" of a row's cell."""
    began, row = time.monotonic(), ROWS[name]
    bundle, run = context.trained(name, seed)
    place.begin()
    clips = played(context, name, bundle, seed, place)
    place.write(clips)
    trained = sum(seconds for stage, seconds in run.seconds.items() if stage != "lexicon")
    return {"stages": run.seconds, "late_gains": run.late_gains, "seconds": {"training": round(trained, 1),
                                               "in_all": round(time.monotonic() - began, 1)},
            **context.judge.summary(clips, context.real(row.split))}


def played(context: AblationContext, name: str, bundle: bundles.Bundle, seed: int, place: PlayedStore
           ) -> list[JudgedClip]:
    """A row's motion for the split's speech, shown at the first seed, and measured."""
    row, corpus = ROWS[name], context.corpus
    over_judge = context.runs(name, seed)[0].key(LEXICON) == context.first.key(LEXICON)
    if row.style == "random":
        style = baselines.RandomStyle(bundle.config.generator.style_width, seed)
        bundle = bundle.with_parts(style=cast(Any, style), style_text=None)
    system, out = Gesticulator(bundle), []
    for k, number in enumerate(tqdm(context.recordings(row.split), desc=f"{name}, seed {seed}",
                                    disable=not context.first.progress)):
        recording = context.loaded(number)
        made = system(recording.speech, speaker=recording.info.speaker, interpreter=row.interpreter, seed=seed,
                      encoded=context.encoded(system, recording),
                      temperature=1.0 if row.interpreter == "statistical" else None)
        if seed == SHOWN_SEED:
            write_bvh(place.folder / f"{corpus.names[number]}.bvh", made.motion)
        values = accuracies(context, system, row.interpreter, number) if over_judge else {}
        out.append(context.judge.clip(PlayedClip(
            corpus.names[number], made.motion, context.speech(recording), recording.motion, recording.info.speaker,
            values, made.lexemes if over_judge else None, made.blocks.edges), k))
    return out


def accuracies(context: AblationContext, system: Gesticulator, interpreter: str, number: int) -> dict[str, float]:
    """Free-running and teacher-forced (RG Table 6), of a recording and a row over the judge's lexicon."""
    labelled, config = context.first.get(LABELS), system.bundle.config
    takes = [take for take in takes_of(context.corpus, labelled.hinted, context.corpus.splits[number])
             if take.recording == number]
    size = len(context.judge.lexicon.vectors)
    decisions = Decisions(context.corpus, takes, labelled.silent, config.silence.mask, size)
    chooser = system.interpreter(interpreter, bool(context.corpus.has_text[number]))
    return {column: accuracy(chooser, decisions, takes[0], teacher)
            for column, teacher in (("accuracy", False), ("teacher_forced", True))}


# ------------------------------------------------------------------------------------------------ cells without a seed

def reference_key(context: AblationContext, name: str, split: str) -> str:
    """Hash of everything that shapes the cell of a reference or a control."""
    return configs.digest(context.shared("rg"), name, split, context.names(split))


def reference(context: AblationContext, name: str, split: str) -> Cell | None:
    """The cell of a reference or a control; None where it cannot be made (no real take, too few recordings)."""
    shown, key = name if split == "test" else f"{name}-{split}", reference_key(context, name, split)
    makers: dict[str, Callable[[], Mapping[str, Any] | None]] = {
        FLOOR: lambda: floor(context, split), REAL_TAKE: lambda: taken(context, split)}
    return _kept(context, (shown, 0, key), makers.get(name, lambda: moved(
        context, name, split, PlayedStore.of(context, f"{shown}-0", key))),
        kind="reference" if name in REFERENCES else "control", question={**REFERENCES, **CONTROLS}[name], settings=[],
        split=split)


def taken(context: AblationContext, split: str) -> dict[str, Any] | None:
    """A real person's take, measured as a row's motion is; None where it is not to be had."""
    take = real_take(FPS)
    return take and context.judge.summary([context.judge.clip(PlayedClip(
        "take", take[0], ClipSpeech.of(take[1], context.first.config.rhythm)), 0)], context.real(split), paired=False)


def moved(context: AblationContext, name: str, split: str, place: PlayedStore) -> dict[str, Any] | None:
    """The performer's own motion, or one made of it, measured as a row's is; None where none can be made."""
    recordings = [context.loaded(number) for number in context.recordings(split)]
    motions = [recording.motion for recording in recordings]
    if name == STILL:
        motions = baselines.mean_pose(motions)
    elif name in baselines.CONTROLS:
        try:
            motions = (baselines.shuffled(motions, 0, context.groups(split)) if name == "shuffled"
                       else baselines.CONTROLS[name](motions, 0))
        except ValueError:
            return None
    return context.judge.summary(judged(context, recordings, motions, place), context.real(split))


def judged(context: AblationContext, recordings: Sequence[Recording], motions: Sequence[Motion], place: PlayedStore
           ) -> list[JudgedClip]:
    """Motions for the speech of recordings, measured and kept."""
    clips = [context.judge.clip(PlayedClip(
        recording.info.name, motion, context.speech(recording).lasting(motion.duration, context.first.config.rhythm),
        recording.motion, recording.info.speaker), k)
        for k, (recording, motion) in enumerate(zip(recordings, motions, strict=True))]
    place.begin()
    place.write(clips)
    return clips


def floor(context: AblationContext, split: str) -> dict[str, Any] | None:
    """FGD between halves of the performer's clips, halved in several ways: no skill gets below it."""
    motions = [context.loaded(number).motion for number in context.recordings(split)]
    place, real = {id(motion): k for k, motion in enumerate(motions)}, context.real(split)
    clips = []
    for seed in range(FLOOR_DRAWS if context.by else 0):
        try:
            halves = baselines.split_halves(motions, seed, context.groups(split))
        except ValueError:
            return None
        one, other = (np.concatenate([real[place[id(motion)]][0] for motion in half]) for half in halves)
        if min(len(one), len(other)) > 1:
            clips.append({"name": f"halving {seed}", "fgd": fgd.distance(one, other)})
    return {"clips": clips, "sets": {}} if clips else None


def system(context: AblationContext, name: str, folder: Path) -> Cell:
    """The cell of another system: its motion for the test speech, a file (`eval.foreign`) named as each recording is.

    InputError when none is.
    """
    files, _ = find_motions(folder)
    numbers = {clip: k for k, clip in enumerate(context.names("test"))}
    theirs = {clip: file for clip, file in files.items() if clip in numbers}
    if not theirs:
        raise InputError(folder, "holds no motion for a test recording", f"name files {next(iter(numbers))}.bvh and so "
                         "on, one for each")
    sums = [[clip, hashlib.sha256(file.read_bytes()).hexdigest()] for clip, file in theirs.items()]
    key = configs.digest(context.shared("rg"), name, sums)

    def made() -> dict[str, Any]:
        recordings, motions = [], []
        for clip, own in read_folder(folder, only=list(theirs))[0].items():
            recordings.append(context.loaded(context.recordings("test")[numbers[clip]]))
            motion = resample(own.motion, recordings[-1].motion.fps)
            motions.append(motion.crop(0, min(len(motion), len(recordings[-1].motion))))
        clips = judged(context, recordings, motions, PlayedStore.of(context, f"{name}-0", key))
        return context.judge.summary(clips, [context.real("test")[numbers[clip.name]] for clip in clips])

    found = _kept(context, (name, 0, key), made, kind="system", settings=[], split="test",
                  question=f"another system's motion, {len(theirs)} clips")
    assert found is not None
    return found
