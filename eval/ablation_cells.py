"""A row of an ablation played and measured at one seed: its cell, kept as ROW-SEED.json (see `eval.ablate`).

What is judged is motion on the split's recordings. A row plays the performer's speech in the performer's habits. Beside
the rows stand cells without a seed, measured by the same code: the performer (whose motion is the truth), a real take,
motion that is known to be wrong (`eval.baselines`), and what other systems made of the same speech.

Lexemes of the motion are those of one lexicon, that of `ours`, so that rows without a lexicon, or with another, can be
compared. Figures of a set (FGD, diversity, motion variance) have no value for a clip; each clip gets the jackknife's:
n times the figure of all less n - 1 times the figure without it. So one paired test serves all (`eval.claims`), and
small sets are freed of the greater part of their bias.

The motion itself stays in the work folder: its beats, onsets, block edges, latents and lexemes in played/ROW-SEED.npz,
for the figures, and for the first seed a BVH of each clip in played/ROW-SEED, to be looked at or given to `eval.score`.
"""

from __future__ import annotations

import hashlib
import io
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from tqdm import tqdm

from data_module.blocks import normalise_motion
from data_module.errors import InputError
from data_module.files import write_bytes, write_text
from data_module.motion.bvh import write_bvh
from data_module.motion.kinematics import resample
from data_module.types import Array, Blocks, Motion
from eval import baselines as controls
from eval import policies
from eval.ablation_bench import Bench, RowRun, Said, features_of, fitted
from eval.ablation_tables import COLUMNS, PAPERS_DELTA, file_of, finished
from eval.ablations import CONTROLS, FLOOR, REAL_TAKE, REFERENCES, ROWS, STILL
from eval.bootstrap import pseudo_values
from eval.figures import Clip, likeliest, measure, real_take
from eval.foreign import find_motions, read_folder
from eval.metrics import fgd, pmb
from eval.metrics.accuracy import lexeme_accuracy
from eval.metrics.diversity import diversity, motion_variance
from eval.results import dumped
from gesticulator import bundle as bundles
from gesticulator import config as configs
from gesticulator.config import Config
from gesticulator.pipeline import Gesticulator
from gesticulator.prepare import Statistics, representation_of
from gesticulator.train import Labelled, label, train_lexicon
from interpreters import BlockFeatures
from interpreters.style import StyleInterpreter

SHOWN_SEED = 1
"""The seed whose motion is kept as BVH and drawn."""
FLOOR_DRAWS = 20
"""Ways to halve the performer's clips."""

Lexemes = NDArray[np.int64]
Values = dict[str, float]


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


# --------------------------------------------------------------------------------------------------------- measuring

@dataclass(frozen=True)
class Seen:
    """What is measured on one clip. latents: [N, D] and lexemes: [N] of its blocks, by the judging lexicon; features:
    [n, E] of each network; pmb_curve: PMB for each delta; beats of the motion, onsets of the speech and edges [B + 1]
    of the blocks that the motion was made in, all in seconds."""

    name: str
    values: Values
    latents: Array
    lexemes: Lexemes
    features: list[Array]
    pmb_curve: Array
    beats: Array
    onsets: Array
    edges: Array


def rhythm_values(clip: Clip) -> Values:
    """PMB as the papers print it, in percent."""
    return {"pmb": pmb.pmb(clip.beats, clip.onsets, PAPERS_DELTA)}


def blocks_of(motion: Motion, blocks: Blocks, config: Config, statistics: Statistics, speaker: int | None) -> Tensor:
    """[N, K, D_m] a motion as the judging lexicon reads it; without a speaker it is centred on its own mean pose."""
    poses = normalise_motion(motion, blocks, representation_of(config))
    normalised = (statistics.normalise(poses, speaker) if speaker is not None
                  else (poses - poses.mean(axis=(0, 1))) / statistics.deviation)
    return torch.as_tensor(normalised, dtype=torch.float32)


def seen(bench: Bench, name: str, motion: Motion, said: Said, truth: Motion | None, speaker: int | None,
         values: Values, place: int, lexemes: Lexemes | None = None, edges: Array | None = None) -> Seen:
    """Everything that is measured on a clip. truth: the performer's motion, None where there is none; lexemes: those
    that the motion was made of, where they are the judge's."""
    lexicon, _ = bench.judge
    first = bench.first
    clip = measure(motion, said.speech, edges, said.onsets)
    own = policies.motion_values(clip, motion, motion if truth is None else truth, seed=place)
    if truth is None:
        own |= {"maje": float("nan"), "mad": float("nan")}
    blocks = blocks_of(motion, said.blocks, first.config, first.corpus.statistics, speaker)
    latents = lexicon.latents(blocks)
    nearest = lexicon.quantizer.labels(latents).numpy()
    fits = lexemes is not None and len(lexemes) == len(nearest)
    found = {**dict.fromkeys(COLUMNS, float("nan")), **own, **rhythm_values(clip), **values}
    return Seen(name, {**found, "conditioned": float(fits)}, latents.double().numpy(),
                cast(Lexemes, lexemes) if fits else nearest, features_of(motion, bench.by),
                pmb.delta_curve(clip.beats, clip.onsets).percent, clip.beats, clip.onsets,
                said.blocks.edges if edges is None else edges)


def summary(bench: Bench, clips: Sequence[Seen], real: Sequence[Sequence[Array]], paired: bool = True
            ) -> dict[str, Any]:
    """The cell of a row: values of each clip, those of the whole set among them by the jackknife.

    real: for each clip the performer's features, one of each network; not paired: any number of clips of the
    performer's, all of which are compared with. Diversity is of the motion's own lexemes, read
    from it again; the variance is about the lexemes that it was made of, where those are the judge's (RG 7.4.2).
    """
    lexicon, _ = bench.judge
    vectors = lexicon.vectors.double().numpy()
    read = [lexicon.quantizer.labels(torch.as_tensor(clip.latents, dtype=torch.float32)).numpy() for clip in clips]

    def distance(which: int, chosen: list[int]) -> float:
        beside = [real[k] for k in chosen] if paired else real
        ours, theirs = ([one[which] for one in features if len(one[which])]
                        for features in ([clips[k].features for k in chosen], beside))
        if min(sum(map(len, ours)), sum(map(len, theirs))) < 2:
            return float("nan")
        return fgd.distance(np.concatenate(ours), np.concatenate(theirs))

    def variety(chosen: list[int]) -> float:
        return diversity(np.concatenate([read[k] for k in chosen]), len(vectors)).nats

    def variance(chosen: list[int]) -> float:
        return motion_variance(np.concatenate([clips[k].latents for k in chosen]),
                               np.concatenate([clips[k].lexemes for k in chosen]), vectors).mean

    every, count = list(range(len(clips))), len(clips)
    added = {"diversity": pseudo_values(variety, count), "variance": pseudo_values(variance, count),
             "fgd": pseudo_values(lambda k: distance(0, k), count) if bench.by else np.full(count, np.nan)}
    return {
        "clips": [{"name": clip.name, **clip.values, **{key: float(values[k]) for key, values in added.items()}}
                  for k, clip in enumerate(clips)],
        "sets": {"diversity": variety(every), "variance": variance(every),
                 "fgd": [fgd.measure([clip.features[w] for clip in clips], [one[w] for one in real], network,
                                     paired=paired).to_dict() for w, network in enumerate(bench.by)],
                 "pmb_curve": {"deltas": list(pmb.DELTAS),
                               "percent": np.mean([clip.pmb_curve for clip in clips], axis=0).tolist()}}}


def accuracy(bench: Bench, system: Gesticulator, interpreter: str, recording: int) -> Values:
    """Free-running and teacher-forced (RG Table 6); only of a row over the judge's lexicon."""
    corpus, (_, labelled) = bench.first.corpus, bench.judge
    chooser = system.interpreter(interpreter, bool(corpus.has_text[recording]))
    own = labelled.hinted[corpus.blocks_of(recording)[1:]]
    free, forced = (lexeme_accuracy(likeliest(chooser, corpus, labelled.hinted, labelled.silent, recording, teacher),
                                    own).percent for teacher in (False, True))
    return {"accuracy": free, "teacher_forced": forced}


def played(bench: Bench, name: str, bundle: bundles.Bundle, over_judge: bool, seed: int,
           show: Callable[[str, Motion], None]) -> list[Seen]:
    """A row's motion for the split's speech, shown and measured. over_judge: the row has the judge's lexicon."""
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
                      encoded=bench.heard(system, recording),
                      temperature=1.0 if row.interpreter == "statistical" else None)
        show(corpus.names[number], made.motion)
        right_ones = accuracy(bench, system, row.interpreter, number) if over_judge else {}
        out.append(seen(bench, corpus.names[number], made.motion, bench.said(recording), recording.motion,
                        int(corpus.speaker_of[number]), right_ones, k, made.lexemes if over_judge else None,
                        made.blocks.edges))
    return out


# ------------------------------------------------------------------------------------------------------------- cells

def row_key(bench: Bench, name: str, seed: int) -> str:
    """Hash of everything that shapes a cell."""
    row, (before, run) = ROWS[name], bench.runs(name, seed)
    stages = ("interpreter", "interpreter_text", "generator", "style", "style_text", "reward", "cql")
    config = run.config
    return configs.digest(bench.shared, before.key("lexicon"), [run.key(stage) for stage in stages], row.interpreter,
                          row.style, config.selection, config.silence, config.statistical, config.motion,
                          _names(bench, row.split))


def _names(bench: Bench, split: str) -> list[str]:
    return [bench.first.corpus.names[number] for number in bench.recordings(split)]


@dataclass(frozen=True)
class Kept:
    """Where the motion of a cell is kept, and whether of the same key (`there`)."""

    folder: Path
    key: str

    @classmethod
    def of(cls, bench: Bench, name: str, seed: int, key: str) -> Kept:
        """In the work folder."""
        return cls(bench.first.work / "played" / f"{name}-{seed}", key)

    @property
    def file(self) -> Path:
        """What was seen of the motion; beside the folder, in which all files are motion."""
        return self.folder.with_name(f"{self.folder.name}.npz")

    def begin(self) -> None:
        """An empty folder."""
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)

    def show(self, clip: str, motion: Motion) -> None:
        """A clip as BVH."""
        write_bvh(self.folder / f"{clip}.bvh", motion)

    def write(self, clips: Sequence[Seen]) -> None:
        """The plain arrays of what was seen."""
        memory, arrays = io.BytesIO(), dict[str, Any]()
        for k, clip in enumerate(clips):
            arrays |= {f"{what}_{k}": np.asarray(getattr(clip, what)) for what in SEEN}
        np.savez_compressed(memory, key=np.array(self.key), names=np.array([clip.name for clip in clips]), **arrays)
        write_bytes(self.file, memory.getvalue())

    def read(self) -> list[dict[str, NDArray[Any]]]:
        """What was seen of each clip, by name; InputError when it is not there, or of other settings."""
        try:
            with np.load(self.file, allow_pickle=False) as held:
                if str(held["key"]) == self.key:
                    return [{"name": name, **{what: held[f"{what}_{k}"] for what in SEEN}}
                            for k, name in enumerate(held["names"])]
        except FileNotFoundError:
            pass
        raise InputError(self.folder, "does not hold the motion of this row", "remove its cell and run the row again")


SEEN = ("latents", "lexemes", "beats", "onsets", "edges")
"""What is kept of each clip for the figures."""


def kept(bench: Bench, name: str, seed: int = SHOWN_SEED) -> Kept:
    """Where the motion of a row or of a reference is."""
    if name in ROWS:
        return Kept.of(bench, name, seed, row_key(bench, name, seed))
    return Kept.of(bench, name, 0, reference_key(bench, name, "test"))


def bundle_of(bench: Bench, name: str, seed: int) -> tuple[bundles.Bundle, RowRun, Labelled]:
    """What a row plays with, its run and the corpus as its lexicon reads it; what is not in the work folder is trained.
    """
    before, run = bench.runs(name, seed)
    bench.cut(before, run)
    began = time.monotonic()
    lexicon, _ = train_lexicon(before)
    run.seconds["lexicon"] = round(time.monotonic() - began, 1)
    labelled = label(run, lexicon)
    return fitted(run, lexicon, labelled, bench.encoder), run, labelled


def cell(bench: Bench, name: str, seed: int, out: Path) -> dict[str, Any]:
    """One row at one seed: read from `out` if it was finished under the same key, else trained, played, written."""
    key = row_key(bench, name, seed)
    known = finished(file_of(out, name, seed), key)
    if known is not None:
        return known
    began, row = time.monotonic(), ROWS[name]
    bundle, run, _ = bundle_of(bench, name, seed)
    trained = sum(own for stage, own in run.seconds.items() if stage != "lexicon")
    over_judge = bench.runs(name, seed)[0].key("lexicon") == bench.first.key("lexicon")
    place = Kept.of(bench, name, seed, key)
    place.begin()
    clips = played(bench, name, bundle, over_judge, seed, place.show if seed == SHOWN_SEED else _unshown)
    place.write(clips)
    result = {"row": name, "seed": seed, "key": key, "shared": bench.shared, "question": row.question,
              "settings": list(row.settings), "interpreter": row.interpreter, "style": row.style, "split": row.split,
              "stages": run.seconds, "seconds": {"lexicon": run.seconds["lexicon"], "training": round(trained, 1),
                                                 "in_all": round(time.monotonic() - began, 1)},
              **summary(bench, clips, bench.real(row.split))}
    write_text(file_of(out, name, seed), dumped(result))
    return result


def _unshown(clip: str, motion: Motion) -> None:
    """Motion of the other seeds is measured and forgotten."""


# ------------------------------------------------------------------------------------------------ cells without a seed

def reference_key(bench: Bench, name: str, split: str) -> str:
    """Hash of everything that shapes the cell of a reference or a control."""
    return configs.digest(bench.shared, name, split, _names(bench, split))


def reference(bench: Bench, name: str, split: str, out: Path) -> dict[str, Any] | None:
    """The cell of a reference or a control; None where it cannot be made (no real take, too few recordings)."""
    shown, key = name if split == "test" else f"{name}-{split}", reference_key(bench, name, split)
    known = finished(file_of(out, shown, 0), key)
    if known is not None:
        return known
    if name == FLOOR:
        found = floor(bench, split)
    elif name == REAL_TAKE:
        take = real_take()
        found = take and summary(bench, [seen(bench, "take", take[0], Said.of(take[1], bench.first.config.rhythm), None,
                                              None, {}, 0)], bench.real(split), paired=False)
    else:
        found = moved(bench, name, split, Kept.of(bench, shown, 0, key))
    if not found:
        return None
    kind = "reference" if name in REFERENCES else "control"
    return _write_cell(bench, shown, kind, {**REFERENCES, **CONTROLS}[name], split, key, found, out)


def _write_cell(bench: Bench, name: str, kind: str, about: str, split: str, key: str, found: Mapping[str, Any],
                out: Path) -> dict[str, Any]:
    result = {"row": name, "seed": 0, "kind": kind, "key": key, "shared": bench.shared, "question": about,
              "settings": [], "split": split, **found}
    write_text(file_of(out, name, 0), dumped(result))
    return result


def moved(bench: Bench, name: str, split: str, place: Kept) -> dict[str, Any] | None:
    """The performer's own motion, or one made of it, measured as a row's is; None where none can be made."""
    recordings, rhythm = [bench.loaded(number) for number in bench.recordings(split)], bench.first.config.rhythm
    own = [recording.motion for recording in recordings]
    if name == STILL:
        own = controls.mean_pose(own)
    elif name in controls.CONTROLS:
        groups = [recording.info.group or recording.info.name for recording in recordings]
        try:
            own = (controls.shuffled(own, 0, groups) if name == "shuffled" else controls.CONTROLS[name](own, 0))
        except ValueError:
            return None
    clips = []
    for k, (recording, motion) in enumerate(zip(recordings, own, strict=True)):
        clips.append(seen(bench, recording.info.name, motion, bench.said(recording).lasting(motion.duration, rhythm),
                          recording.motion, bench.speaker(recording), {}, k))
    place.begin()
    place.write(clips)
    return summary(bench, clips, bench.real(split))


def floor(bench: Bench, split: str) -> dict[str, Any] | None:
    """FGD between halves of the performer's clips, halved in several ways: no skill gets below it."""
    motions = [bench.loaded(number).motion for number in bench.recordings(split)]
    place, real = {id(motion): k for k, motion in enumerate(motions)}, bench.real(split)
    clips = []
    for seed in range(FLOOR_DRAWS if bench.by else 0):
        try:
            halves = controls.split_halves(motions, seed, bench.groups(split))
        except ValueError:
            return None
        one, other = (np.concatenate([real[place[id(motion)]][0] for motion in half]) for half in halves)
        if min(len(one), len(other)) > 1:
            clips.append({"name": f"halving {seed}", "fgd": fgd.distance(one, other)})
    return {"clips": clips, "sets": {}} if clips else None


def system(bench: Bench, name: str, folder: Path, out: Path) -> dict[str, Any]:
    """The cell of another system: its motion for the test speech, a file (`eval.foreign`) named as each recording is.

    InputError when none is.
    """
    files, _ = find_motions(folder)
    numbers = {bench.first.corpus.names[number]: k for k, number in enumerate(bench.recordings("test"))}
    theirs = {clip: file for clip, file in files.items() if clip in numbers}
    if not theirs:
        raise InputError(folder, "holds no motion for a test recording", f"name files {next(iter(numbers))}.bvh and so "
                         "on, one for each")
    sums = [[clip, hashlib.sha256(file.read_bytes()).hexdigest()] for clip, file in theirs.items()]
    key = configs.digest(bench.shared, name, sums)
    known = finished(file_of(out, name, 0), key)
    if known is not None:
        return known
    clips, real, rhythm = [], [], bench.first.config.rhythm
    for k, (clip, own) in enumerate(read_folder(folder, only=list(theirs))[0].items()):
        recording = bench.loaded(bench.recordings("test")[numbers[clip]])
        motion = resample(own.motion, recording.motion.fps)
        motion = motion.crop(0, min(len(motion), len(recording.motion)))
        clips.append(seen(bench, clip, motion, bench.said(recording).lasting(motion.duration, rhythm), recording.motion,
                          bench.speaker(recording), {}, k))
        real.append(bench.real("test")[numbers[clip]])
    place = Kept.of(bench, name, 0, key)
    place.begin()
    place.write(clips)
    return _write_cell(bench, name, "system", f"another system's motion, {len(clips)} clips", "test", key,
                       summary(bench, clips, real), out)
