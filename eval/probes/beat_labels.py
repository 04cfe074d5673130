"""Beats against beats that people marked by hand: are the beats that are found the ones that people gesture on?

    gesticulator probe beat-labels --labels FILE|DIR --store STORE [--recording NAME ...]
    gesticulator probe beat-labels --labels FILE --sound FILE.wav [--motion FILE.bvh]
    gesticulator probe beat-labels --labels TABLE.csv --column emphasis --motion DIR

Theory: RG cuts speech and motion at onsets of the sound, and says itself (limitation 1) that gesture beats need not
lie there; McClave (1994) found beats of the hands on unstressed syllables too. Labels are moments that somebody took
for gesture beats. A found beat and a label that lie within a tolerance of each other make a pair, one to one, as many
pairs as there can be (Hopcroft and Karp; on a line a greedy pass finds as many, `pmb.matched`):

    precision = pairs / found,  recall = pairs / labels,  F = 2 pairs / (found + labels)

which is mir_eval's `onset.f_measure` (Raffel et al. 2014). Precision and recall run from 0 to 1, higher is better. The
offset is the median of (nearest found beat - label) in ms over the labels with a found beat within `NEAR` seconds;
negative: found too early; it should be near 0.

What is scored: `onsets` (`detect_onsets`), `beats` (`find_beats` without the recording's two ends), the same by flag
(onset, loud pseudo, even pseudo), and motion beats of modes A and B. Recall of one flag is what this flag alone covers.

What fools it: many beats match anything, with 3 a second and 0.2 s to both sides nothing is missed. So controls stand
beside each F, and the table names those that reach it:

- `even`: as many beats, evenly spaced (the mean over `PHASES` phases);
- `shifted`: the labels moved round the recording, the mean over `SHIFTS` random shifts, with a one-sided p-value. It
  moves labels out of the stretches in which anything happens, so it is easily beaten by knowing when people move;
- `nearby`: the labels moved a little, by `NEARBY` tolerances either way. Only what finds the moment itself beats it.

Intervals: 95 % bootstrap over pieces of `PIECE` seconds (a shorter clip is one piece). Fewer than about ten pieces make
them too narrow, and one person's labels say nothing of how far two people would agree.

Which labels: MOCCA (the release of RG's Chinese data) marks when speaker01 puts emphasis, its gesture beats, in 29.27
min that are downloaded by themselves. Its published pages tell no more of these labels, neither file name nor layout
nor unit, and they were not to be had here. `eval.label_files` reads the layouts that people use for such marks; they
were tried on files that the tests write, and on real labels: the sync times of SmartBody's clips (a table of
recordings). If the labels count frames, say --label-fps.
"""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.motion.motion_beats import MODES, motion_beats
from data_module.speech.audio import load_speech
from data_module.speech.beats import detect_onsets, find_beats
from data_module.store import Store
from data_module.types import Array, BeatFlag, Motion, Speech
from eval import label_files
from eval.foreign import MOTIONS, find_sound, read_motion
from eval.label_files import AT, LabelChoice, Labels
from eval.metrics import pmb
from eval.stats import Interval, mean_interval
from eval.table import Cell, Column, Table

TOLERANCES = (0.1, 0.2)
"""Seconds to either side of a label."""
PIECE = 10.0
"""Seconds: what the bootstrap draws."""
NEAR = 0.5
"""Seconds: how far the nearest found beat may lie from a label to count in the offset."""
NEARBY = (1.5, 5.0)
"""How far `nearby` moves labels, in tolerances."""
SHIFTS = 200
PHASES = 20
CONTROLS = ("even", "shifted", "nearby")

_BEYOND = 0.5
_EPS = 1e-9
_FLAGS = {BeatFlag.ONSET: "beats: onset", BeatFlag.LOUD_PSEUDO: "beats: loud pseudo",
          BeatFlag.EVEN_PSEUDO: "beats: even pseudo"}


@dataclass(frozen=True)
class LabelledRecording:
    """A recording with its labels: [n] seconds; speech or motion is None where there is none."""

    name: str
    labels: Labels
    seconds: float
    speech: Speech | None = None
    motion: Motion | None = None

    def __post_init__(self) -> None:
        last = float(self.labels.times[-1])
        if last > self.seconds + _BEYOND:
            raise InputError(self.name, f"lasts {self.seconds:.2f} s and has a label at {last:.2f} s",
                             "if the labels count frames or milliseconds, say so with --label-fps")


@dataclass(frozen=True)
class Found:
    """What one detector found in one recording: times [m] and the labels [n], rising seconds in [0, seconds)."""

    times: Array
    labels: Array
    seconds: float


# ---------------------------------------------------------------------------------------------------- the figures

def pairs(found: Array, labels: Array, tolerance: float) -> NDArray[np.int64]:
    """For each found beat its label's index, -1 for none, [m]; at most `tolerance` seconds lie between the two."""
    return pmb.matched(found, labels, tolerance + _EPS)


def f_measure(clips: Sequence[Found], tolerance: float) -> float:
    """F over all clips; NaN with neither beats nor labels."""
    total = sum(len(clip.times) + len(clip.labels) for clip in clips)
    hits = sum(np.count_nonzero(pairs(clip.times, clip.labels, tolerance) >= 0) for clip in clips)
    return 2.0 * hits / total if total else float("nan")


def scores(clips: Sequence[Found], tolerance: float, seed: int = 0) -> dict[str, Any]:
    """Precision, recall and F with their intervals, and F of each control.

    Precision is NaN with a reason ("why") when nothing was found. "reached by": the controls that get as high
    an F in half of their draws.
    """
    found, hit_found, labels, hit_labels = (np.concatenate(part) for part in zip(
        *(_counts(clip, tolerance) for clip in clips), strict=True))
    out: dict[str, Any] = {
        "precision": _ratio(hit_found, found, seed), "recall": _ratio(hit_labels, labels, seed),
        "f": _ratio(hit_found + hit_labels, found + labels, seed)}
    if not found.sum():
        out["why"] = "nothing was found"
    f = f_measure(clips, tolerance)
    rng = np.random.default_rng(seed)
    shifted = np.array([f_measure([_moved(clip, _any_shift(clip, rng)) for clip in clips], tolerance)
                        for _ in range(SHIFTS)])
    nearby = [f_measure([_moved(clip, _near_shift(tolerance, rng)) for clip in clips], tolerance)
              for _ in range(SHIFTS)]
    even = [f_measure([_even(clip, (k + 0.5) / PHASES) for clip in clips], tolerance) for k in range(PHASES)]
    drawn = {"even": np.array(even), "shifted": shifted, "nearby": np.array(nearby)}
    out["controls"] = {name: float(own.mean()) for name, own in drawn.items()}
    out["p_value"] = (1 + int(np.count_nonzero(shifted >= f - _EPS))) / (1 + SHIFTS)
    out["reached by"] = [name for name in CONTROLS if float(np.median(drawn[name])) >= f - _EPS]
    return out


def offset(clips: Sequence[Found]) -> float:
    """Median of (nearest found beat - label) in ms over labels with a found beat within `NEAR`; NaN without one."""
    away: list[float] = []
    for clip in clips:
        if len(clip.times):
            gaps = clip.times[None, :] - clip.labels[:, None]
            away += gaps[np.arange(len(gaps)), np.abs(gaps).argmin(axis=1)].tolist()
    near = np.array(away)[np.abs(away) <= NEAR] if away else np.zeros(0)
    return 1000.0 * float(np.median(near)) if len(near) else float("nan")


def _counts(clip: Found, tolerance: float) -> tuple[Array, Array, Array, Array]:
    """For each piece of a clip: found beats, those with a label, labels, and those with a found beat."""
    of_found = pairs(clip.times, clip.labels, tolerance)
    of_labels = np.isin(np.arange(len(clip.labels)), of_found)
    pieces = max(1, math.ceil(clip.seconds / PIECE - _EPS))

    def count(times: Array) -> Array:
        return np.bincount(np.clip(times // PIECE, 0, pieces - 1).astype(int), minlength=pieces).astype(np.float64)

    return count(clip.times), count(clip.times[of_found >= 0]), count(clip.labels), count(clip.labels[of_labels])


def _ratio(hits: Array, total: Array, seed: int) -> Interval:
    """sum(hits) / sum(total) with its interval over pieces; pieces without anything to count are left out."""
    some = total > 0
    return mean_interval(hits[some] / total[some], total[some], seed=seed)


def _any_shift(clip: Found, rng: np.random.Generator) -> float:
    least = min(1.0, 0.1 * clip.seconds)
    return float(rng.uniform(least, clip.seconds - least))


def _near_shift(tolerance: float, rng: np.random.Generator) -> float:
    return float(rng.uniform(*NEARBY) * tolerance * rng.choice([-1.0, 1.0]))


def _moved(clip: Found, by: float) -> Found:
    return Found(clip.times, np.sort((clip.labels + by) % clip.seconds), clip.seconds)


def _even(clip: Found, phase: float) -> Found:
    count = len(clip.times)
    return Found((np.arange(count) + phase) * clip.seconds / max(count, 1), clip.labels, clip.seconds)


# ---------------------------------------------------------------------------------------------------- what is scored

def detections(clip: LabelledRecording) -> dict[str, Array]:
    """What each detector finds in a recording, [m] rising seconds, by the detector's name."""
    out: dict[str, Array] = {}
    if clip.speech is not None:
        out["onsets"] = detect_onsets(clip.speech.samples, clip.speech.sample_rate)
        beats = find_beats(clip.speech)
        out["beats"] = beats.times[beats.flags != BeatFlag.BOUNDARY]
        out |= {name: beats.times[beats.flags == flag] for flag, name in _FLAGS.items()}
    if clip.motion is not None:
        out |= {f"motion beats {mode}": motion_beats(clip.motion, mode) for mode in MODES}
    return out


def judge(clips: Sequence[LabelledRecording], tolerances: Sequence[float] = TOLERANCES, seed: int = 0
          ) -> dict[str, Any]:
    """Every detector on the recordings that it can work on, as plain values; InputError without recordings."""
    if not clips:
        raise InputError("--labels", "fit none of the recordings", "name labels like their recordings")
    if not all(np.isfinite(value) and value > 0 for value in tolerances):
        raise InputError("--tolerance", f"has a value that is not positive ({min(tolerances):g})", "give seconds")
    found: dict[str, list[Found]] = {}
    for clip in clips:
        labels = np.unique(np.minimum(clip.labels.times, clip.seconds))
        for name, times in detections(clip).items():
            found.setdefault(name, []).append(Found(times, labels, clip.seconds))
    return {"recordings": [clip.name for clip in clips], "layouts": sorted({clip.labels.layout for clip in clips}),
            "seconds": sum(clip.seconds for clip in clips), "labels": sum(len(clip.labels.times) for clip in clips),
            "rows": {name: _row(own, tolerances, seed) for name, own in found.items()}}


def _row(clips: Sequence[Found], tolerances: Sequence[float], seed: int) -> dict[str, Any]:
    count, seconds = sum(len(clip.times) for clip in clips), sum(clip.seconds for clip in clips)
    return {"recordings": len(clips), "labels": sum(len(clip.labels) for clip in clips), "found": count,
            "per_second": count / seconds, "offset_ms": offset(clips),
            "tolerances": {f"{value:g}": scores(clips, value, seed) for value in tolerances}}


COLUMNS = {"per_second": Column("found", "Hz"), "precision": Column("precision", digits=3),
           "recall": Column("recall", digits=3), "f": Column("F", digits=3, good="high"),
           **{name: Column(f"F, {name}", digits=3) for name in CONTROLS}, "p_value": Column("p", digits=3),
           "offset_ms": Column("offset", "ms", 0), "reached by": Column("reached by")}


def tables(result: Mapping[str, Any]) -> list[Table]:
    """One table a tolerance."""
    about = (f"{result['labels']} labels ({', '.join(result['layouts'])}) in {len(result['recordings'])} recordings, "
             f"{result['seconds'] / 60:.2f} min. Intervals are by pieces of {PIECE:g} s.")
    facts = {key: value for key, value in result.items() if key != "rows"}
    out: list[Table] = []
    for tolerance in next(iter(result["rows"].values()))["tolerances"]:
        rows: dict[str, dict[str, Cell]] = {}
        for name, row in result["rows"].items():
            own = row["tolerances"][tolerance]
            rows[name] = {"per_second": row["per_second"], "offset_ms": row["offset_ms"], **own["controls"],
                          **{key: own[key] for key in ("precision", "recall", "f", "p_value")},
                          "reached by": ", ".join(own["reached by"]) or own.get("why", "")}
        out.append(Table(f"Within {tolerance} s", COLUMNS, rows, "detector", [] if out else [about],
                         {} if out else facts))
    return out


# ---------------------------------------------------------------------------------------------------- what is read

def labels_by_name(path: Path, choice: LabelChoice) -> Callable[[str], Labels | None]:
    """How to get a recording's labels: from a table of recordings, a folder of files, or the one file for any name."""
    if path.is_dir():
        def in_folder(name: str) -> Labels | None:
            file = label_files.find_labels(path, name)
            return None if file is None else label_files.read_labels(file, choice)
        return in_folder
    if label_files.is_table_of_recordings(path):
        told: dict[str, Labels] = {}
        for name, labels in label_files.read_table(path, choice).items():
            if told.setdefault(_plain(name), labels) is not labels:
                raise InputError(path, f"names two recordings {_plain(name)}", "give them different names")
        return told.get
    only = label_files.read_labels(path, choice)
    return lambda name: only


def from_store(store: Store, names: Sequence[str] | None, labels_of: Callable[[str], Labels | None]
               ) -> list[LabelledRecording]:
    """The recordings of a store that have labels; of those that are named each must."""
    clips = []
    for name in names or store.names:
        labels = labels_of(name)
        if labels is None:
            if names:
                raise InputError(name, "has no labels", "name the label file like the recording")
            continue
        own = store.load(name)
        clips.append(LabelledRecording(name, labels, own.speech.duration, own.speech, own.motion))
    return clips


def from_files(sound: Path | None, motion: Path | None, labels_of: Callable[[str], Labels | None],
               fps: float | None = None, leave_out: str | None = None) -> list[LabelledRecording]:
    """A sound, a motion or both of one name, or all motions below a folder with the sounds of their names."""
    if motion is not None and motion.is_dir():
        files = [file for file in sorted(motion.rglob("*")) if file.suffix.lower() in MOTIONS and file.is_file()]
        clips = [_marked(file, find_sound(sound, file.stem) if sound else None, labels, fps) for file in files
                 if not _left_out(file.stem, leave_out) and (labels := labels_of(file.stem)) is not None]
        twice = {clip.name for clip in clips if sum(clip.name == other.name for other in clips) > 1}
        if twice:
            raise InputError(motion, f"holds two motions {min(twice)}", "keep one of them")
        return clips
    first = sound or motion
    if first is None:
        raise InputError("--store, --sound or --motion", "is missing", "name what the labels belong to")
    labels = labels_of(first.stem)
    if labels is None:
        raise InputError(first, "has no labels", "name the label file like the recording")
    return [_marked(motion, sound, labels, fps)]


def _left_out(name: str, pattern: str | None) -> bool:
    try:
        return pattern is not None and re.search(pattern, name) is not None
    except re.error as error:
        raise InputError("--leave-out", f"is no regular expression ({error})", "quote what is no pattern") from None


def _marked(motion: Path | None, sound: Path | None, labels: Labels, fps: float | None) -> LabelledRecording:
    speech = load_speech(sound) if sound is not None else None
    moves = read_motion(motion, fps) if motion is not None else None
    lengths = [one.duration for one in (speech, moves) if one is not None]
    return LabelledRecording((motion or sound or Path()).stem, labels, max(lengths), speech, moves)


def _plain(name: str) -> str:
    """A file's name without folders and without an ending that motion and sound have."""
    last = Path(name.replace("\\", "/"))
    return last.stem if last.suffix.lower() in label_files.OTHERS else last.name


def arguments(parser: argparse.ArgumentParser) -> None:
    """Labels, and what they belong to."""
    add = parser.add_argument
    add("--labels", required=True, metavar="FILE|DIR", help="marks of one recording, a table of recordings, "
        "or a folder of files named like the recordings")
    add("--store", metavar="STORE", help="whose sound and motion are judged")
    add("--recording", action="append", metavar="NAME", help="of the store; default: all with labels")
    add("--sound", metavar="FILE|DIR", help="instead of a store")
    add("--motion", metavar="FILE|DIR", help="BVH, SMPL-X npz or positions npy, alone or beside --sound")
    add("--fps", type=float, help="of the motion, where its file is wrong")
    add("--leave-out", metavar="REGEX", help="motions of a folder that are not judged")
    add("--tolerance", type=float, nargs="+", default=list(TOLERANCES), metavar="SECONDS")
    add("--at", choices=AT, default="start", help="which moment of a mark that lasts (default: start)")
    add("--tier", help="of a TextGrid with several")
    add("--column", help="of a table with several times")
    add("--label-fps", type=float, default=1.0, metavar="RATE",
                   help="when the labels are no seconds: their count a second (frames 20, milliseconds 1000)")
    add("--seed", type=int, default=0)


def run(arguments: argparse.Namespace) -> list[Table]:
    """Judge every detector; InputError for labels that belong to nothing."""
    choice = LabelChoice(arguments.at, arguments.tier, arguments.column, arguments.label_fps)
    labels_of = labels_by_name(Path(arguments.labels), choice)
    if arguments.store:
        if arguments.sound or arguments.motion:
            raise InputError("--store", "holds sound and motion", "leave --sound and --motion out")
        clips = from_store(Store.open(arguments.store), arguments.recording, labels_of)
    else:
        sound, motion = (Path(told) if told else None for told in (arguments.sound, arguments.motion))
        clips = from_files(sound, motion, labels_of, arguments.fps, arguments.leave_out)
    return tables(judge(clips, arguments.tolerance, arguments.seed))
