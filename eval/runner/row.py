"""One row of an ablation at one seed: trained, played, measured, kept as a cell (see `eval.runner.ablate`).

A row plays the performer's speech in the performer's habits. Beside the rows stand cells without a seed, measured by
the same code (`eval.runner.judge`): the performer (whose motion is the truth), a real take, motion that is known to
be wrong (`eval.baselines`), and what other systems made of the same speech. The motion itself stays in the work
folder: its beats, onsets, block edges, latents and lexemes in played/ROW-SEED.npz, for the figures, and for the first
seed a BVH of each clip in played/ROW-SEED, to be looked at or given to `gesticulator score`.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from tqdm import tqdm

from data_module.errors import InputError
from data_module.motion.bvh import write_bvh
from data_module.motion.kinematics import resample
from data_module.store import Recording
from data_module.types import Motion
from eval.baselines import controls as baselines
from eval.clip.foreign import find_motions, read_folder
from eval.clip.measure import real_take
from eval.metrics import fgd
from eval.rows import CONTROLS, FLOOR, REAL_TAKE, REFERENCES, ROWS, STILL, racer
from eval.rows.cells import Cell, family
from eval.runner import racer as policy_training
from eval.runner.judge import ClipSpeech, JudgedClip, PlayedClip
from eval.runner.policy import Decisions, accuracy
from eval.runner.row_context import SHOWN_SEED, AblationContext, PlayedStore
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle import config as configs
from gesticulator.options import FPS
from gesticulator.pipeline import Gesticulator
from gesticulator.training.stages import (
    LABELS,
    LEXICON,
)
from gesticulator.training.stages.q_network import takes_of

FLOOR_DRAWS = 20
"""Ways to halve the performer's clips."""


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

def reference(context: AblationContext, name: str, split: str) -> Cell | None:
    """The cell of a reference or a control; None where it cannot be made (no real take, too few recordings)."""
    shown, key = name if split == "test" else f"{name}-{split}", context.reference_key(name, split)
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
    """The cell of another system: its motion for the test speech, a file named as each recording is.

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
