"""The rows of Rhythmic Gesticulator's tables: trained, played on the test speech and scored, one seed at a time.

A row plays the performer's speech in the performer's habits. It is measured by the functions of `gesticulator score`,
with the lexicon of the row `ours` for all rows, so that rows without a lexicon, or with another, can be compared.
Beside the rows stand cells without a seed, measured alike: the performer (whose motion is the truth), a real take,
motion that is known to be wrong (`eval.baselines`), and what other systems made of the same speech. The first seed's
motion stays in the work folder, a BVH of each clip in played/ROW, for the figures.

Figures of a set (FGD, diversity, motion variance) have no value for a clip; each clip gets the jackknife's: n times the
figure of all less n - 1 times the figure without it. So one paired test serves all (`eval.ablate.verdicts`), and small
sets are freed of the greater part of their bias.

A seed is lexicon, interpreter and generator together: each is trained anew, and rows of a seed with the same settings
of the lexicon share it. The speech encoder and the cut of the recordings are the same for all. Every stage is kept in
the work folder under the hash of its settings, so a row trains what its settings change and nothing else, and a work
folder of the training command serves its finished stages.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from tqdm import tqdm

from data_module.errors import InputError
from data_module.motion.bvh import read_bvh, write_bvh
from data_module.motion.kinematics import resample
from data_module.motion.skeletons import to_character
from data_module.store import Recording
from data_module.types import Array, Motion
from eval import stats
from eval.ablate.policy import Decisions, accuracy
from eval.ablate.rows import COLUMNS, FLOOR, OURS, PERFORMER, REAL_TAKE, ROWS
from eval.baselines.controls import DAMAGES, split_halves
from eval.baselines.interpreters import RandomStyle, ReplayInterpreter
from eval.clip.clip_set import TRUTH, ClipSet
from eval.clip.excerpts import real_take
from eval.clip.foreign import find_motions, read_folder
from eval.context import EvalContext, Lexemes
from eval.metrics import fgd, pmb
from eval.metrics.gesture_features import pooled
from eval.metrics.joint_error import motion_error
from eval.score.command import ScoredClips, control_rows
from gesticulator.bundle import config as configs
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.config import Config
from gesticulator.gesticulator import Gesticulator
from gesticulator.options import FPS
from gesticulator.training import stages
from gesticulator.training.stages.q_network import takes_of

VERSION = 4
"""Raised when the same settings would no longer give the same figures."""
SHORTEST = 20.0
"""Seconds; a shorter clip has too few beats for a figure of its own."""
SHOWN_SEED = 1
"""The seed whose motion is kept as BVH and drawn, and whose lexicon reads all motion."""
FLOOR_DRAWS = 20
"""Ways to halve the performer's clips."""
CODED = 6
"""Recordings of the positive control: each is played twice more."""

T = TypeVar("T")


# ------------------------------------------------------------------------------------------------------------ training

def configured(base: Config, row: str) -> Config:
    """The settings of a row; InputError where a preset lacks one of them."""
    return configs.with_settings(base, ROWS[row].set)


@dataclass
class RowRun(stages.Run):
    """The run of a row. taken: nodes that another run makes, by name, whose keys then shape this run's stages."""

    taken: Mapping[str, stages.Run] = field(default_factory=dict)

    def get(self, node: stages.Node[T]) -> T:
        """See `Run.get`."""
        return self.taken[node.name].get(node) if node.name in self.taken else super().get(node)

    def key(self, node: stages.Node[Any]) -> str:
        """See `Run.key`."""
        return self.taken[node.name].key(node) if node.name in self.taken else super().key(node)


def played(system: Gesticulator, recording: Recording, lexemes: Lexemes) -> Motion:
    """Motion that the generator makes for lexemes [M] on the speech of a recording, the gate open."""
    return system(replace(recording.speech, words=None), speaker=recording.info.speaker, temperature=0.0, activity=1.0,
                  interpreter=ReplayInterpreter([lexemes], len(system.bundle.vectors))).motion


def fitted(motion: Motion, truth: Motion) -> Motion:
    """A motion on the character, at the rate of the performer's and no longer than that: systems differ in all three.
    """
    return resample(to_character(motion), truth.fps).crop(0, len(truth))


# ------------------------------------------------------------------------------------------------------------ the rows

@dataclass
class RgRows:
    """The rows over the preset whose run the context holds; what they share is made at its first use."""

    context: EvalContext
    _corpora: dict[str, stages.Run] = field(default_factory=dict, init=False)
    _scored: dict[tuple[Any, ...], ScoredClips] = field(default_factory=dict, init=False)

    @property
    def first(self) -> stages.Run:
        """The run of the preset as it is."""
        return self.context.run

    @cached_property
    def shared(self) -> str:
        """Hash of what the rows share; figures that are compared must agree in it."""
        networks = [[network.sha256, network.name, network.frames] for network in self.context.networks.values()]
        return configs.digest(VERSION, self.first.store.fingerprint, self.first.config, self.first.key(stages.LEXICON),
                              self.first.key(stages.CORPUS), networks, self.context.limit)

    def run(self, name: str, seed: int) -> RowRun:
        """The run of a row at a seed, which trains all but the speech encoder."""
        config = configured(self.first.config, name)
        corpora = self._corpus_run(config)
        return self._row_run(replace(config, seed=seed), {
            stages.ENCODER.name: self.first, stages.BLOCKS.name: corpora, stages.CORPUS.name: corpora})

    def _row_run(self, config: Config, taken: Mapping[str, stages.Run]) -> RowRun:
        first = self.first
        return RowRun(config, first.store, first.work, first.device, first.progress, first.workers, taken=taken)

    def _corpus_run(self, config: Config) -> stages.Run:
        """The run that cuts the store by these settings; that of the preset and the last other one stay in memory."""
        first = self.first
        key, preset = (configs.digest(settings.rhythm, settings.motion, settings.control, settings.text,
                                      settings.front_end) for settings in (config, first.config))
        if key == preset:
            return first
        if key not in self._corpora:
            # One at a time: the blocks of five hours fill the memory.
            self._corpora = {key: self._row_run(config, {stages.ENCODER.name: first})}
        return self._corpora[key]

    def trained(self, name: str, seed: int) -> tuple[Bundle, RowRun]:
        """The bundle of a row, and its run; what is not in the work folder is trained."""
        run = self.run(name, seed)
        return stages.assemble(run), run

    def cell_key(self, name: str, seed: int) -> str:
        """Hash of everything that shapes a row's cell."""
        row, run = ROWS[name], self.run(name, seed)
        config = run.config
        # Beside the stages everything that is applied when they play: it changes the motion and no weights.
        trained = [run.key(stage) for stage in stages.wanted(config)]
        return configs.digest(self.shared, run.key(stages.LEXICON), trained, row.play, row.style, config.selection,
                              config.silence, config.motion, self.names(row.split))

    # ------------------------------------------------------------------------------------------------------ recordings

    def names(self, split: str) -> list[str]:
        """Recordings of a split that are long enough for shares and speeds (all, where none is), `limit` at most."""
        every = [info for info in self.first.store.recordings if info.split == split]
        # A store of short clips has none that is long enough; all of them are better than no table.
        long_enough = [info.name for info in every if info.seconds >= SHORTEST] or [info.name for info in every]
        if not long_enough:
            raise InputError(self.first.store.path, f"has no recording in its {split} split", "build the store again")
        return long_enough[:self.context.limit]

    def recording(self, name: str) -> Recording:
        """One with its sound and motion."""
        return self.context.loaded(self.context.corpus.names.index(name))

    # ------------------------------------------------------------------------------------------------ what is measured

    @cached_property
    def judge(self) -> Bundle:
        """The bundle whose lexicon reads the motion of all rows."""
        return self.trained(OURS, SHOWN_SEED)[0]

    def scored(self, names: Sequence[str], lexicon: bool = True) -> ScoredClips:
        """The recordings of these names as `gesticulator score` reads its truth; lexicon: with figures of lexemes."""
        key = (*names, lexicon)
        if key not in self._scored:
            recordings = [self.recording(name) for name in names]
            groups = [recording.info.group or recording.info.name for recording in recordings]
            speeches = [replace(recording.speech, speaker=recording.info.speaker) for recording in recordings]
            self._scored[key] = self._read(ClipSet(
                list(names), groups, [*speeches], {TRUTH: [recording.motion for recording in recordings]},
                recordings[0].motion.fps), lexicon)
        return self._scored[key]

    def _read(self, clips: ClipSet, lexicon: bool = True) -> ScoredClips:
        return ScoredClips.of(replace(self.context, models=self.judge if lexicon else None), clips)

    def summary(self, scored: ScoredClips, motions: Sequence[Motion]) -> dict[str, Any]:
        """"clips" and "sets" of a cell: the values of each clip, those of the whole set by the jackknife."""
        truth = scored.clips.motions[TRUTH]
        row = scored.row("", "system", list(map(fitted, motions, truth)))
        values = {key: row.values[column.metric] for key, column in COLUMNS.items() if column.metric in row.values}
        for key, column in COLUMNS.items():
            if column.metric in row.sets:
                values[key] = stats.jackknife(row.sets[column.metric], len(truth))
        values["fgd"] = self._distances(next(iter(row.features.values())), truth)
        # The curve of RG Fig. 11 is a mean over clips whose speech is known.
        percent = [pmb.delta_curve(beats.modes["A"], track.onsets)
                   for beats, track in zip(row.beats, scored.tracks, strict=True) if track is not None]
        return {"clips": [{"name": name, **{key: float(value[k]) for key, value in values.items()}}
                          for k, name in enumerate(scored.clips.names)],
                "sets": {"pmb_curve": {"percent": np.mean(percent, axis=0).tolist()}}}

    def _distances(self, features: Sequence[Array], truth: Sequence[Motion]) -> Array:
        """[clips] FGD of features in the first network by the jackknife; NaN for fewer than two windows."""
        real = pooled(list(truth), next(iter(self.context.networks.values())))
        return stats.jackknife(lambda chosen: fgd.of_clips([features[k] for k in chosen], [real[k] for k in chosen]),
                               len(truth))

    def measured(self, name: str, seed: int) -> dict[str, Any]:
        """"clips" and "sets" of a row's cell."""
        row, (bundle, run) = ROWS[name], self.trained(name, seed)
        recordings = [self.recording(clip) for clip in self.names(row.split)]
        # Codes of the right spread and no meaning: what the interpreter's choice of a code is worth.
        if row.style == "random":
            style = RandomStyle(bundle.config.generator.style_width, seed)
            bundle = bundle.with_parts(style=style, style_text=None)
        system = Gesticulator(bundle)
        # The arg max of the statistical interpreter never changes.
        temperature = 1.0 if row.play == "statistical" else None
        motions = [system(recording.speech, speaker=recording.info.speaker, interpreter=row.play, seed=seed,
                          temperature=temperature).motion
                   for recording in tqdm(recordings, desc=f"{name}, seed {seed}", disable=not self.context.progress)]
        if seed == SHOWN_SEED:
            self.keep(name, motions)
        summary = self.summary(self.scored(self.names(row.split)), motions)
        for clip, recording in zip(summary["clips"], recordings[:CODED], strict=False):
            clip["own_code"] = self.own_code(system, run, recording)
        # Accuracy compares lexemes by number, which means the same in one lexicon only.
        standard = self.run(OURS, seed)
        if run.key(stages.LEXICON) == standard.key(stages.LEXICON):
            for clip in summary["clips"]:
                clip |= self.accuracies(system, standard.get(stages.LABELS), row.play, clip["name"])
        return summary

    def own_code(self, system: Gesticulator, run: stages.Run, recording: Recording) -> float:
        """The row's positive control: by how many mm the mean joint error falls when each block of a recording is
        played with its own lexeme instead of that of a block half the recording away. 0 says that lexemes do nothing.
        """
        corpus = run.get(stages.CORPUS)
        lexemes = run.get(stages.LABELS).hinted[corpus.blocks_of(corpus.names.index(recording.info.name))]
        another, true = (motion_error(fitted(played(system, recording, codes), recording.motion), recording.motion).maje
                        for codes in (np.roll(lexemes, len(lexemes) // 2), lexemes))
        return another - true

    def accuracies(self, system: Gesticulator, labelled: stages.Labelled, interpreter: str, name: str
                   ) -> dict[str, float]:
        """Free-running and teacher-forced (RG Table 6), of a recording and a row over the lexicon of `ours`."""
        corpus = self.context.corpus
        number = corpus.names.index(name)
        takes = [take for take in takes_of(corpus, labelled.hinted, corpus.splits[number]) if take.recording == number]
        decisions = Decisions(corpus, takes, labelled.silent, system.bundle.config.silence.mask,
                              len(system.bundle.lexicon.vectors))
        chooser = system.bundle.interpreter_named(interpreter, bool(corpus.has_text[number]))
        return {column: accuracy(chooser, decisions, takes[0], teacher)
                for column, teacher in (("accuracy", False), ("teacher_forced", True))}

    # ------------------------------------------------------------------------------------------------- motion, as shown

    def folder(self, name: str) -> Path:
        """Where the motion of a row's first seed is."""
        return self.first.work / "played" / f"{name}-{self.cell_key(name, SHOWN_SEED)[:12]}"

    def keep(self, name: str, motions: Sequence[Motion]) -> None:
        """A row's motion, for the figures."""
        self.folder(name).mkdir(parents=True, exist_ok=True)
        for clip, motion in zip(self.names(ROWS[name].split), motions, strict=True):
            write_bvh(self.folder(name) / f"{clip}.bvh", motion)

    def motions(self, name: str) -> list[Motion]:
        """The motion of a row's first seed, or of the performer, for the test speech; InputError where it is gone."""
        if name == PERFORMER:
            return [self.recording(clip).motion for clip in self.names("test")]
        # The figures draw what was measured: motion that is gone is not made again behind a finished cell.
        files = [self.folder(name) / f"{clip}.bvh" for clip in self.names(ROWS[name].split)]
        if not all(file.is_file() for file in files):
            raise InputError(self.folder(name), "does not hold the motion of this row", "remove its cell and run it")
        return [read_bvh(file) for file in files]

    # -------------------------------------------------------------------------------------------- cells without a seed

    def reference(self, name: str, split: str) -> dict[str, Any] | None:
        """The cell of a reference, a control or a dose of damage, which has distances alone; None where it cannot be
        made (no real take, too few recordings)."""
        if name == REAL_TAKE:
            return self._real_take()
        scored = self.scored(self.names(split))
        if name == FLOOR:
            return self._floor(scored)
        truth = scored.clips.motions[TRUTH]
        kind, _, dose = name.rpartition("-")
        if kind in DAMAGES:
            space = next(iter(self.context.networks.values()))
            distances = self._distances(pooled(DAMAGES[kind][int(dose) - 1](truth), space), truth)
            return {"clips": [{"name": clip, "fgd": float(value)} for clip, value in
                              zip(scored.clips.names, distances, strict=True)], "sets": {}}
        motions = truth if name == PERFORMER else control_rows(scored.clips, 0, scored.voices)[0].get(name)
        return None if motions is None else self.summary(scored, motions)

    def _real_take(self) -> dict[str, Any] | None:
        """A real person's take, beside nothing: it has no distance from the performer. None where it is not there."""
        take = real_take(FPS)
        if take is None:
            return None
        # Its own motion is its truth, so whatever compares with the performer would be zero and is taken out.
        clips = ClipSet(["take"], ["take"], [take[1]], {TRUTH: [take[0]]}, take[0].fps)
        summary = self.summary(self._read(clips), [take[0]])
        summary["clips"][0] |= dict.fromkeys(("maje", "mad", "fgd"), float("nan"))
        return summary

    def _floor(self, scored: ScoredClips) -> dict[str, Any] | None:
        """FGD between halves of the performer's clips, halved in several ways: no skill gets below it."""
        truth, clips = scored.clips.motions[TRUTH], []
        real = pooled(truth, next(iter(self.context.networks.values())))
        for seed in range(FLOOR_DRAWS):
            try:
                halves = split_halves(truth, scored.clips.groups, seed)
            except ValueError:
                return None
            value = fgd.of_clips(*([real[k] for k in half] for half in halves))
            clips += [{"name": f"halving {seed}", "fgd": value}] if np.isfinite(value) else []
        return {"clips": clips, "sets": {}} if clips else None

    def foreign(self, name: str, folder: Path) -> tuple[str, list[str]]:
        """The key of another system's motion, a file named as each recording is, and the recordings that it has.

        InputError when it has none.
        """
        files, _ = find_motions(folder)
        there = [clip for clip in self.names("test") if clip in files]
        if not there:
            raise InputError(folder, "holds no motion for a test recording",
                             f"name files {self.names('test')[0]}.bvh and so on, one for each")
        # By content, so that new motion under old names is measured anew.
        sums = [[clip, hashlib.sha256(files[clip].read_bytes()).hexdigest()] for clip in there]
        return configs.digest(self.shared, name, sums), there

    def foreign_measured(self, folder: Path, names: Sequence[str]) -> dict[str, Any]:
        """"clips" and "sets" of another system's cell: each clip as far as both motions last."""
        clips, _ = read_folder(folder, only=list(names))
        truth = self.scored(names).clips
        motions = [resample(clips[name].motion, reference.fps)
                   for name, reference in zip(names, truth.motions[TRUTH], strict=True)]
        # FGD and the joint errors compare frame by frame: the performer's clip is cut where the other system stops.
        shorter = [reference.crop(0, min(len(reference), len(motion)))
                   for reference, motion in zip(truth.motions[TRUTH], motions, strict=True)]
        return self.summary(self._read(replace(truth, motions={TRUTH: shorter})), motions)
