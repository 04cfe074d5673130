"""The rows of Rhythmic Gesticulator's tables: trained, played on the test speech and measured, one seed at a time.

A row plays the performer's speech in the performer's habits. Beside the rows stand cells without a seed, measured by
the same code (`eval.runner.judge`): the performer (whose motion is the truth), a real take, motion that is known to
be wrong (`eval.baselines`), and what other systems made of the same speech. The motion itself stays in the work
folder: its beats, onsets, block edges, latents and lexemes in played/ROW-SEED.npz, for the figures, and for the first
seed a BVH of each clip in played/ROW-SEED, to be looked at or given to `gesticulator score`.

What comes first is shared: all rows of all seeds hear through the same speech encoder, and rows with the same lexicon
settings have the same lexicon; seeds differ in what is trained on top. Every stage is kept in the work folder under the
hash of its settings, so a row trains what its settings change and nothing else, and a work folder of the training
command serves its finished stages.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from torch import nn
from tqdm import tqdm

from data_module.errors import InputError
from data_module.files import lock
from data_module.motion.bvh import read_bvh, write_bvh
from data_module.motion.kinematics import resample
from data_module.speech.audio import SAMPLE_RATE
from data_module.speech.audio import resample as resample_speech
from data_module.store import Recording
from data_module.types import Array, Motion
from eval.ablate.policy import Decisions, accuracy
from eval.baselines import controls as baselines
from eval.baselines.interpreters import RandomStyle
from eval.clip.foreign import find_motions, read_folder
from eval.clip.measure import real_take
from eval.context import EvalContext
from eval.metrics import fgd
from eval.metrics.gesture_features import Features
from eval.rows import FLOOR, PERFORMER, REAL_TAKE, ROWS, STILL
from eval.runner.judge import ClipSpeech, Judge, JudgedClip, PlayedClip, PlayedStore, features_of, identity
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle import config as configs
from gesticulator.bundle.config import Config
from gesticulator.bundle.features import SpeechFeatures
from gesticulator.options import FPS
from gesticulator.pipeline import Gesticulator
from gesticulator.training.fit import late_gain
from gesticulator.training.stages import BLOCKS, CORPUS, ENCODER, LABELS, LEXICON, Node, Run, Stage, assemble, wanted
from gesticulator.training.stages.q_network import takes_of

VERSION = 2
"""Raised when the same settings would no longer give the same figures."""
SHORTEST = 20.0
"""Seconds; a shorter clip has too few beats for a figure of its own."""
SHOWN_SEED = 1
"""The seed whose motion is kept as BVH and drawn."""
FLOOR_DRAWS = 20
"""Ways to halve the performer's clips."""

T = TypeVar("T")


# ------------------------------------------------------------------------------------------------------------ training

def configured(base: Config, row: str) -> Config:
    """The settings of a row; InputError where a preset lacks one of them."""
    return configs.with_settings(base, ROWS[row].settings)


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


# ------------------------------------------------------------------------------------------------------------ the rows

@dataclass
class RgRows:
    """The rows over the preset whose run the context holds; what they share is made at its first use."""

    context: EvalContext
    _corpora: dict[str, Run] = field(default_factory=dict, init=False)
    _real: dict[str, list[list[Array]]] = field(default_factory=dict, init=False)
    _encoded: dict[str, dict[str, SpeechFeatures]] = field(default_factory=dict, init=False)
    _speech: dict[str, ClipSpeech] = field(default_factory=dict, init=False)

    @property
    def first(self) -> Run:
        """The run of the preset as it is."""
        return self.context.run

    @property
    def by(self) -> list[Features]:
        """What the Frechet distance is measured in, the first of which the tables show."""
        return list(self.context.networks.values())

    @cached_property
    def judge(self) -> Judge:
        """The lexicon of the preset as it is: all motion is judged by it."""
        return Judge(self.first.config, self.context.corpus.statistics, self.first.get(LEXICON), self.by)

    @cached_property
    def shared(self) -> str:
        """Hash of what the rows share; figures that are compared must agree in it."""
        return configs.digest(VERSION, self.first.store.fingerprint, self.first.config, self.first.key(LEXICON),
                              self.first.key(CORPUS), identity(self.by), self.context.limit)

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
        every = [info for info in self.first.store.recordings if info.split == split]
        found = [info.name for info in every if info.seconds >= SHORTEST] or [info.name for info in every]
        if not found:
            raise InputError(self.first.store.path, f"has no recording in its {split} split", "build the store again")
        return found[:self.context.limit]

    def recordings(self, split: str) -> Iterator[Recording]:
        """The same with sound and motion, one at a time."""
        return (self.context.loaded(self.context.corpus.names.index(name)) for name in self.names(split))

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
        known = {info.name: info.group or info.name for info in self.first.store.recordings}
        return [known[name] for name in self.names(split)]

    def real(self, split: str) -> list[list[Array]]:
        """For each recording of a split the performer's features, one of each network."""
        if split not in self._real:
            self._real[split] = [features_of(recording.motion, self.by) for recording in self.recordings(split)]
        return self._real[split]

    def original(self, name: str) -> str:
        """The row whose cell a row is a copy of: itself."""
        return name

    def cell_key(self, name: str, seed: int) -> str:
        """Hash of everything that shapes a row's cell."""
        row, (_, run) = ROWS[name], self.runs(name, seed)
        config = run.config
        return configs.digest(self.shared, run.key(LEXICON), [run.key(stage) for stage in wanted(config)],
                              row.interpreter, row.style, config.selection, config.silence, config.statistical,
                              config.motion, self.names(row.split))

    def reference_key(self, name: str, split: str) -> str:
        """Hash of everything that shapes the cell of a reference or a control."""
        return configs.digest(self.shared, name, split, self.names(split))

    def place(self, name: str, seed: int = SHOWN_SEED) -> PlayedStore:
        """Where the motion of a row, or (on the test split) of a reference is."""
        if name in ROWS:
            return self._place(f"{name}-{seed}", self.cell_key(name, seed))
        return self._place(f"{name}-0", self.reference_key(name, "test"))

    def _place(self, name: str, key: str) -> PlayedStore:
        return PlayedStore(self.first.work / "played" / name, key)

    def clips(self, name: str) -> list[dict[str, NDArray[Any]]]:
        """What was kept of the motion of a row or reference, clip by clip."""
        return self.place(name).read()

    @cached_property
    def shown(self) -> Recording:
        """The first test recording, of which figures show the motion."""
        return next(self.recordings("test"))

    def motion(self, name: str) -> Motion:
        """The motion of a row, or of the performer, for it."""
        if name == PERFORMER:
            return self.shown.motion
        return read_bvh(self.place(name).folder / f"{self.shown.info.name}.bvh")

    # ------------------------------------------------------------------------------------------------ what is measured

    def measured(self, name: str, seed: int) -> dict[str, Any]:
        """"clips", "sets" and "seconds" of a row's cell."""
        began, row, place = time.monotonic(), ROWS[name], self.place(name, seed)
        bundle, run = self.trained(name, seed)
        place.begin()
        clips = self.played(name, bundle, seed, place)
        place.write(clips)
        trained = sum(seconds for stage, seconds in run.seconds.items() if stage != "lexicon")
        return {"stages": run.seconds, "late_gains": run.late_gains,
                "seconds": {"training": round(trained, 1), "in_all": round(time.monotonic() - began, 1)},
                **self.judge.summary(clips, self.real(row.split))}

    def played(self, name: str, bundle: bundles.Bundle, seed: int, place: PlayedStore) -> list[JudgedClip]:
        """A row's motion for the split's speech, shown at the first seed, and measured."""
        row = ROWS[name]
        over_judge = self.runs(name, seed)[0].key(LEXICON) == self.first.key(LEXICON)
        if row.style == "random":
            style = RandomStyle(bundle.config.generator.style_width, seed)
            bundle = bundle.with_parts(style=cast(Any, style), style_text=None)
        system, out = Gesticulator(bundle), []
        for k, recording in enumerate(tqdm(self.recordings(row.split), desc=f"{name}, seed {seed}",
                                           total=len(self.names(row.split)), disable=not self.context.progress)):
            made = system(recording.speech, speaker=recording.info.speaker, interpreter=row.interpreter, seed=seed,
                          encoded=self.encoded(system, recording),
                          temperature=1.0 if row.interpreter == "statistical" else None)
            if seed == SHOWN_SEED:
                write_bvh(place.folder / f"{recording.info.name}.bvh", made.motion)
            values = self.accuracies(system, row.interpreter, recording.info.name) if over_judge else {}
            out.append(self.judge.clip(PlayedClip(
                recording.info.name, made.motion, self.speech(recording), recording.motion, recording.info.speaker,
                values, made.lexemes if over_judge else None, made.blocks.edges), k))
        return out

    def accuracies(self, system: Gesticulator, interpreter: str, name: str) -> dict[str, float]:
        """Free-running and teacher-forced (RG Table 6), of a recording and a row over the judge's lexicon."""
        corpus, labelled = self.context.corpus, self.first.get(LABELS)
        number = corpus.names.index(name)
        takes = [take for take in takes_of(corpus, labelled.hinted, corpus.splits[number]) if take.recording == number]
        decisions = Decisions(corpus, takes, labelled.silent, system.bundle.config.silence.mask,
                              len(self.judge.lexicon.vectors))
        chooser = system.interpreter(interpreter, bool(corpus.has_text[number]))
        return {column: accuracy(chooser, decisions, takes[0], teacher)
                for column, teacher in (("accuracy", False), ("teacher_forced", True))}

    # -------------------------------------------------------------------------------------------- cells without a seed

    def reference(self, name: str, split: str) -> dict[str, Any] | None:
        """What is measured of a reference or a control; None where it cannot be made (no real take, too few
        recordings)."""
        if name == FLOOR:
            return self._floor(split)
        if name == REAL_TAKE:
            return self._taken(split)
        return self._moved(name, split)

    def _taken(self, split: str) -> dict[str, Any] | None:
        """A real person's take, measured as a row's motion is; None where it is not to be had."""
        take = real_take(FPS)
        return take and self.judge.summary([self.judge.clip(PlayedClip(
            "take", take[0], ClipSpeech.of(take[1], self.first.config.rhythm)), 0)], self.real(split), paired=False)

    def _moved(self, name: str, split: str) -> dict[str, Any] | None:
        """The performer's own motion, or one made of it, measured as a row's is; None where none can be made."""
        recordings = list(self.recordings(split))
        motions = [recording.motion for recording in recordings]
        if name == STILL:
            motions = baselines.mean_pose(motions)
        elif name in baselines.CONTROLS:
            try:
                motions = (baselines.shuffled(motions, 0, self.groups(split)) if name == "shuffled"
                           else baselines.CONTROLS[name](motions, 0))
            except ValueError:
                return None
        shown = name if split == "test" else f"{name}-{split}"
        place = self._place(f"{shown}-0", self.reference_key(name, split))
        return self.judge.summary(self._judged(recordings, motions, place), self.real(split))

    def _judged(self, recordings: Sequence[Recording], motions: Sequence[Motion], place: PlayedStore
                ) -> list[JudgedClip]:
        """Motions for the speech of recordings, measured and kept."""
        clips = [self.judge.clip(PlayedClip(
            recording.info.name, motion, self.speech(recording).lasting(motion.duration, self.first.config.rhythm),
            recording.motion, recording.info.speaker), k)
            for k, (recording, motion) in enumerate(zip(recordings, motions, strict=True))]
        place.begin()
        place.write(clips)
        return clips

    def _floor(self, split: str) -> dict[str, Any] | None:
        """FGD between halves of the performer's clips, halved in several ways: no skill gets below it."""
        motions = [recording.motion for recording in self.recordings(split)]
        place, real = {id(motion): k for k, motion in enumerate(motions)}, self.real(split)
        clips = []
        for seed in range(FLOOR_DRAWS if self.by else 0):
            try:
                halves = baselines.split_halves(motions, seed, self.groups(split))
            except ValueError:
                return None
            one, other = (np.concatenate([real[place[id(motion)]][0] for motion in half]) for half in halves)
            if min(len(one), len(other)) > 1:
                clips.append({"name": f"halving {seed}", "fgd": fgd.distance(one, other)})
        return {"clips": clips, "sets": {}} if clips else None

    def foreign(self, name: str, folder: Path) -> ForeignMotion:
        """Another system's motion for the test speech, a file named as each recording is.

        InputError when none is.
        """
        files, _ = find_motions(folder)
        numbers = {clip: k for k, clip in enumerate(self.names("test"))}
        theirs = {clip: file for clip, file in files.items() if clip in numbers}
        if not theirs:
            raise InputError(folder, "holds no motion for a test recording", f"name files {next(iter(numbers))}.bvh "
                             "and so on, one for each")
        sums = [[clip, hashlib.sha256(file.read_bytes()).hexdigest()] for clip, file in theirs.items()]
        key = configs.digest(self.shared, name, sums)

        def measured() -> dict[str, Any]:
            known = {recording.info.name: recording for recording in self.recordings("test")}
            recordings, motions = [], []
            for clip, own in read_folder(folder, only=list(theirs))[0].items():
                recordings.append(known[clip])
                motion = resample(own.motion, known[clip].motion.fps)
                motions.append(motion.crop(0, min(len(motion), len(known[clip].motion))))
            clips = self._judged(recordings, motions, self._place(f"{name}-0", key))
            return self.judge.summary(clips, [self.real("test")[numbers[clip.name]] for clip in clips])

        return ForeignMotion(key, len(theirs), measured)


@dataclass(frozen=True)
class ForeignMotion:
    """Another system's motion. key: of the files; clips: how many there are; measured: "clips" and "sets" of its
    cell."""

    key: str
    clips: int
    measured: Callable[[], dict[str, Any]]


def _latest(known: dict[str, T], key: str, most: int, make: Callable[[], T]) -> T:
    """What is known by a key, made where it is not; of `most` others the last one goes."""
    if key not in known:
        while len(known) >= most:
            known.popitem()
        known[key] = make()
    return known[key]
