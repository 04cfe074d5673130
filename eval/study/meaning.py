"""A study of meanings: raters see one clip without sound and name what the gesture says, among five.

    gesticulator study meaning --speech talk.wav --out FOLDER [--gestures NAME ...] [--takes 1] [--seed 0]
    gesticulator study analyse --key FOLDER/key.json answers-*.json [--out meaning.json]

The gestures are marked in the recordings and performed by the bundle (`eval.clip.marked_gestures`). The page
(FOLDER/page/index.html) works from a disk without a server; raters must not get FOLDER/key.json. An answer is a
sentence that the character might say (`sayings.csv`), not a description of the movement.

Theory: with five answers chance is .2, if all are equally attractive. They are not, so that two controls measure what
an answer gets without its gesture: the same seconds without a gesture (`NONE`), and the clip of a gesture that is not
among the answers (`OTHER`). Catch trials name the answer that is to be chosen: who misses them did not read. The order
of clips and of answers is drawn anew for each rater.

What fools it: the wrong answers are drawn from the other gestures and some are near; raters who have seen all clips
learn what is not there; a figure without a face shows less than a person.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.files import read_table, write_text
from data_module.types import Motion
from eval.clip.marked_gestures import AFTER, BEFORE, MarkedGesture, checked_gestures, marked_gestures
from eval.study.command import FPS, STEPS_PER_METRE, encoded_points, page_of
from gesticulator.export.figure import figure_points
from gesticulator.pipeline import Gesticulator

KIND = "meaning"
"""Of the key."""
ANSWERS = 5
GESTURE, NONE, OTHER, CATCH = "gesture", "no gesture", "another gesture", "catch"
_CONTROLS, _CATCHES = 5, 15
"""Clips for each control of both kinds, and for each catch trial."""
_CLOSE = frozenset({"number one", "wait finger", "idea finger", "point up"})
"""Gestures of one form, which nothing but the words tells apart: never among the same answers."""


@dataclass(frozen=True)
class MeaningOptions:
    """gestures: names; None for those that talk often calls for. takes: clips of each; seed: of all that is drawn;
    raters: orders in the page."""

    gestures: Sequence[str] | None = None
    takes: int = 1
    seed: int = 0
    raters: int = 30

    def __post_init__(self) -> None:
        if self.takes < 1 or self.raters < 1:
            raise InputError("--takes, --raters", f"cannot be {self.takes} and {self.raters}", "ask for 1 or more")


@dataclass(frozen=True)
class Trial:
    """A clip with its answers. kind: see above; meaning: the answer that is asked for; answers: the gestures whose
    sayings are offered; shown: the gesture in the clip, None without one."""

    kind: str
    meaning: str
    answers: tuple[str, ...]
    shown: str | None
    recording: str
    start: float
    motion: Motion


def sayings() -> dict[str, str]:
    """Gesture -> what it says, as a sentence of the character."""
    table = read_table(Path(__file__).with_name("sayings.csv"), "install the program again")
    return {row["name"] or "": row["saying"] or "" for _, row in table}


def trials_of(clips: Sequence[MarkedGesture], gestures: Sequence[str], seed: int) -> list[Trial]:
    """A trial for each clip, one of each control for every `_CONTROLS` clips (two at least), and catch trials."""
    rng = np.random.default_rng(seed)
    trials = [Trial(GESTURE, clip.gesture, _answers(clip.gesture, gestures, (), rng), clip.gesture, clip.recording,
                    clip.start, clip.motion) for clip in clips]
    count = max(2, len(clips) // _CONTROLS)
    controls: list[Trial] = []
    for number in rng.permutation(len(clips))[:count]:
        clip, answers = clips[number], _answers(clips[number].gesture, gestures, (), rng)
        controls.append(Trial(NONE, clip.gesture, answers, None, clip.recording, clip.start, clip.without))
    for number in rng.permutation(len(clips))[:count]:
        clip = clips[number]
        meaning = str(rng.choice([name for name in gestures if not _alike(name, clip.gesture)]))
        answers = _answers(meaning, gestures, (clip.gesture,), rng)
        controls.append(Trial(OTHER, meaning, answers, clip.gesture, clip.recording, clip.start, clip.motion))
    for number in rng.permutation(len(clips))[:max(2, len(clips) // _CATCHES)]:
        own = trials[number]
        controls.append(replace(own, kind=CATCH, meaning=str(rng.choice([name for name in own.answers
                                                                        if name != own.shown]))))
    return trials + controls


def _answers(meaning: str, gestures: Sequence[str], without: Sequence[str], rng: np.random.Generator
             ) -> tuple[str, ...]:
    """The meaning and four others, in any order; none of `without`, and no two of one form: neither would be right."""
    chosen = [meaning]
    for name in rng.permutation(list(gestures)):
        if len(chosen) < ANSWERS and not any(_alike(str(name), one) for one in (*chosen, *without)):
            chosen.append(str(name))
    return tuple(str(name) for name in rng.permutation(chosen))


def _alike(first: str, second: str) -> bool:
    return first == second or {first, second} <= _CLOSE


def orders_of(trials: int, raters: int, seed: int) -> list[list[tuple[int, list[int]]]]:
    """For each rater the trials in the order to be shown, each with the order of its answers."""
    rng = np.random.default_rng([seed, 1])
    return [[(int(trial), [int(place) for place in rng.permutation(ANSWERS)]) for trial in rng.permutation(trials)]
            for _ in range(raters)]


def make(system: Gesticulator, recordings: Sequence[Path], out: Path, options: MeaningOptions) -> Path:
    """Write `out`/page/index.html and `out`/key.json; returns the page. The same input gives the same page and key."""
    gestures = checked_gestures(options.gestures)
    if len(gestures) < 2 * ANSWERS:
        raise InputError("--gestures", f"names {len(gestures)} gestures", f"name {2 * ANSWERS} or more")
    clips = list(marked_gestures(system, recordings, gestures * options.takes, options.seed))
    trials = trials_of(clips, gestures, options.seed)
    shown = [encoded_points(_points(trial.motion)) for trial in trials]
    # Ids are hashes of the motion, which no rater can compute; sorted, so that their order does not tell the kind.
    source = hashlib.sha256(json.dumps([shown, options.seed]).encode()).hexdigest()
    ids = [hashlib.sha256(f"{source} {number}".encode()).hexdigest()[:10] for number in range(len(trials))]
    study = hashlib.sha256(f"{source} study".encode()).hexdigest()[:10]
    ranks = np.argsort(ids)
    key = {"kind": KIND, "study": study, "seed": options.seed, "gestures": gestures, "items": {
        ids[number]: {"kind": trial.kind, "meaning": trial.meaning, "answers": list(trial.answers),
                      "shown": trial.shown, "recording": trial.recording, "start": round(trial.start, 3)}
        for number, trial in enumerate(trials)}}
    (out / "page").mkdir(parents=True, exist_ok=True)
    write_text(out / "key.json", json.dumps(key, indent=1) + "\n")
    write_text(out / "page" / "index.html", page_of("meaning_study.html", _data(
        study, [(ids[number], trials[number], shown[number]) for number in ranks], options)))
    return out / "page" / "index.html"


def _data(study: str, items: Sequence[tuple[str, Trial, str]], options: MeaningOptions) -> dict[str, Any]:
    """What the page reads."""
    says = sayings()
    return {"study": study, "fps": FPS, "seconds": BEFORE + AFTER, "stepsPerMetre": STEPS_PER_METRE,
            "points": list(_points(items[0][1].motion)),
            "items": [{"id": name, "motion": motion, "answers": [says[one] for one in trial.answers],
                       **({"choose": trial.answers.index(trial.meaning)} if trial.kind == CATCH else {})}
                      for name, trial, motion in items],
            "orders": orders_of(len(items), options.raters, options.seed)}


def _points(motion: Motion) -> dict[str, NDArray[np.float64]]:
    """The figure's points with fingers, [FPS * seconds, 3] metres each."""
    times = np.arange(round(FPS * (BEFORE + AFTER))) / FPS
    return figure_points(motion, np.minimum(times, (len(motion) - 1) / motion.fps), fingers=True)
