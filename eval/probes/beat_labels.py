"""Beats against beats that people marked by hand: are the beats that are found the ones that people gesture on?

    gesticulator probe beat-labels --labels FILE|DIR --store STORE
    gesticulator probe beat-labels --labels FILE --sound FILE.wav [--motion FILE.bvh]
    gesticulator probe beat-labels --labels TABLE.csv --column emphasis --motion DIR

Theory: RG cuts speech and motion at onsets of the sound, and says itself (limitation 1) that gesture beats need not
lie there; McClave (1994) found beats of the hands on unstressed syllables too. A found beat and a label that lie within
a tolerance of each other make a pair, one to one, as many pairs as there can be; precision = pairs / found, recall =
pairs / labels, F = 2 pairs / (found + labels), which is mir_eval's `onset.f_measure` (Raffel et al. 2014). The offset
is the median of (nearest found beat - label) over labels with a found beat within `NEAR`; negative: too early.

What fools it: many beats match anything. So each F has controls beside it, and the table names those that reach it in
half of their draws: `even`, as many beats, evenly spaced; `shifted`, the labels moved round the recording (p is the
one-sided share that does as well), which is easily beaten by knowing when people move at all; `nearby`, the labels
moved by `NEARBY` tolerances, which only what finds the moment itself beats. Intervals draw pieces of `PIECE` seconds,
and one person's labels say nothing of how far two people would agree.

Which labels: MOCCA (the release of RG's Chinese data) marks when speaker01 puts emphasis; neither file name nor layout
nor unit are published, so `eval.label_files` reads what people use. Real ones: the sync times of SmartBody's clips.
"""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data_module.errors import InputError
from data_module.motion.motion_beats import MODES, motion_beats
from data_module.speech.audio import load_speech
from data_module.speech.beats import find_beats
from data_module.speech.onsets import detect_onsets
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
COLUMNS = {"per_second": Column("found", "Hz"), "precision": Column("precision", digits=3),
           "recall": Column("recall", digits=3), "f": Column("F", digits=3, good="high"),
           **{name: Column(f"F, {name}", digits=3) for name in CONTROLS}, "p_value": Column("p", digits=3),
           "offset_ms": Column("offset", "ms", 0), "reached by": Column("reached by")}

_BEYOND = 0.5
"""Seconds that a label may lie after the end."""
_EPS = 1e-9
_NONE = "$^"
"""A pattern that no name has."""
_FLAGS = {BeatFlag.ONSET: "beats: onset", BeatFlag.LOUD_PSEUDO: "beats: loud pseudo",
          BeatFlag.EVEN_PSEUDO: "beats: even pseudo"}
LabelsOf = Callable[[str], Labels | None]


@dataclass(frozen=True)
class LabelledRecording:
    """A recording with its labels; speech or motion is None where there is none. InputError for labels beyond it."""

    name: str
    labels: Labels
    speech: Speech | None = None
    motion: Motion | None = None

    def __post_init__(self) -> None:
        last = float(self.labels.times[-1])
        if last > self.seconds + _BEYOND:
            raise InputError(self.name, f"lasts {self.seconds:.2f} s and has a label at {last:.2f} s",
                             "if the labels count frames or milliseconds, say so with --label-fps")

    @property
    def seconds(self) -> float:
        """Of the longer of sound and motion."""
        return max(one.duration for one in (self.speech, self.motion) if one is not None)


@dataclass(frozen=True)
class Found:
    """What one detector found in one recording: times [m] and the labels [n], rising seconds in [0, seconds)."""

    times: Array
    labels: Array
    seconds: float


# ---------------------------------------------------------------------------------------------------- the figures

def f_measure(clips: Sequence[Found], tolerance: float) -> float:
    """F over all clips; NaN with neither beats nor labels."""
    total = sum(len(clip.times) + len(clip.labels) for clip in clips)
    hits = sum(np.count_nonzero(pmb.matched(clip.times, clip.labels, tolerance + _EPS) >= 0) for clip in clips)
    return 2.0 * hits / total if total else math.nan


def scores(clips: Sequence[Found], tolerance: float, seed: int = 0) -> dict[str, Cell]:
    """Precision, recall and F with their intervals, F of each control and who reaches it; keys of `COLUMNS`."""
    found, hit_found, labels, hit_labels = (np.concatenate(part) for part in zip(
        *(_counts(clip, tolerance) for clip in clips), strict=True))
    f, drawn = f_measure(clips, tolerance), _controls(clips, tolerance, seed)
    reached = [name for name in CONTROLS if float(np.median(drawn[name])) >= f - _EPS]
    return {"precision": _ratio(hit_found, found, seed), "recall": _ratio(hit_labels, labels, seed),
            "f": _ratio(hit_found + hit_labels, found + labels, seed),
            **{name: float(np.mean(own)) for name, own in drawn.items()},
            "p_value": (1 + int(np.count_nonzero(np.array(drawn["shifted"]) >= f - _EPS))) / (1 + SHIFTS),
            "reached by": ", ".join(reached) if found.sum() else "nothing was found"}


def _controls(clips: Sequence[Found], tolerance: float, seed: int) -> dict[str, list[float]]:
    """F of every draw of each control."""
    rng = np.random.default_rng(seed)

    def round_the_clip(clip: Found) -> float:
        least = min(1.0, 0.1 * clip.seconds)
        return float(rng.uniform(least, clip.seconds - least))

    def a_little(clip: Found) -> float:
        return float(rng.uniform(*NEARBY) * tolerance * rng.choice([-1.0, 1.0]))

    def moved(by: Callable[[Found], float]) -> list[float]:
        return [f_measure([Found(clip.times, np.sort((clip.labels + by(clip)) % clip.seconds), clip.seconds)
                           for clip in clips], tolerance) for _ in range(SHIFTS)]

    def even(clip: Found, phase: float) -> Found:
        count = len(clip.times)
        return Found((np.arange(count) + phase) * clip.seconds / max(count, 1), clip.labels, clip.seconds)

    shifted, nearby = moved(round_the_clip), moved(a_little)
    return {"even": [f_measure([even(clip, (k + 0.5) / PHASES) for clip in clips], tolerance) for k in range(PHASES)],
            "shifted": shifted, "nearby": nearby}


def offset(clips: Sequence[Found]) -> float:
    """Median of (nearest found beat - label) in ms over labels with a found beat within `NEAR`; NaN without one."""
    gaps = [clip.times[None, :] - clip.labels[:, None] for clip in clips if len(clip.times)]
    away = np.concatenate([np.zeros(0), *(own[np.arange(len(own)), np.abs(own).argmin(axis=1)] for own in gaps)])
    near = away[np.abs(away) <= NEAR]
    return 1000.0 * float(np.median(near)) if len(near) else math.nan


def _counts(clip: Found, tolerance: float) -> list[Array]:
    """For each piece of a clip: found beats, those with a label, labels, and those with a found beat."""
    pairs = pmb.matched(clip.times, clip.labels, tolerance + _EPS)
    pieces = max(1, math.ceil(clip.seconds / PIECE - _EPS))
    return [np.bincount(np.clip(times // PIECE, 0, pieces - 1).astype(int), minlength=pieces).astype(np.float64)
            for times in (clip.times, clip.times[pairs >= 0], clip.labels, clip.labels[pairs[pairs >= 0]])]


def _ratio(hits: Array, total: Array, seed: int) -> Interval:
    """sum(hits) / sum(total) with its interval over pieces; pieces without anything to count are left out."""
    some = total > 0
    return mean_interval(hits[some] / total[some], total[some], seed=seed)


def detections(clip: LabelledRecording) -> dict[str, Array]:
    """What each detector finds in a recording, [m] rising seconds: onsets, beats but the two ends, each flag's alone
    (recall then is what the flag covers), motion beats of both modes."""
    out: dict[str, Array] = {}
    if clip.speech is not None:
        out["onsets"] = detect_onsets(clip.speech.samples, clip.speech.sample_rate)
        beats = find_beats(clip.speech)
        out["beats"] = beats.times[beats.flags != BeatFlag.BOUNDARY]
        out |= {name: beats.times[beats.flags == flag] for flag, name in _FLAGS.items()}
    if clip.motion is not None:
        out |= {f"motion beats {mode}": motion_beats(clip.motion, mode) for mode in MODES}
    return out


def judge(clips: Sequence[LabelledRecording], tolerances: Sequence[float] = TOLERANCES, seed: int = 0) -> list[Table]:
    """Every detector on the recordings that it can work on, a table a tolerance; InputError without recordings."""
    if not clips:
        raise InputError("--labels", "fit none of the recordings", "name labels like their recordings")
    if not all(np.isfinite(value) and value > 0 for value in tolerances):
        raise InputError("--tolerance", f"has a value that is not positive ({min(tolerances):g})", "give seconds")
    found: dict[str, list[Found]] = {}
    for clip in clips:
        labels = np.unique(np.minimum(clip.labels.times, clip.seconds))
        for name, times in detections(clip).items():
            found.setdefault(name, []).append(Found(times, labels, clip.seconds))
    shared: dict[str, dict[str, Cell]] = {name: {
        "per_second": sum(len(clip.times) for clip in own) / sum(clip.seconds for clip in own),
        "offset_ms": offset(own)} for name, own in found.items()}
    layouts, seconds = sorted({clip.labels.layout for clip in clips}), sum(clip.seconds for clip in clips)
    count = sum(len(clip.labels.times) for clip in clips)
    about = (f"{count} labels ({', '.join(layouts)}) in {len(clips)} recordings, {seconds / 60:.2f} min. Intervals are "
             f"by pieces of {PIECE:g} s.")
    facts = {"recordings": [clip.name for clip in clips], "layouts": layouts, "seconds": seconds, "labels": count}
    return [Table(f"Within {tolerance:g} s", COLUMNS,
                  {name: {**shared[name], **scores(own, tolerance, seed)} for name, own in found.items()},
                  "detector", [] if later else [about], facts) for later, tolerance in enumerate(tolerances)]


# ---------------------------------------------------------------------------------------------------- what is read

def labels_by_name(path: Path, choice: LabelChoice) -> LabelsOf:
    """How to get a recording's labels: from a table of recordings, a folder of files, or the one file for any name."""
    if path.is_dir():
        return lambda name: label_files.read_labels(file, choice) if (file := label_files.find_labels(path, name)) \
            else None
    told = label_files.read_recordings(path, choice)
    named = {_plain(name): labels for name, labels in told.items()}
    if len(named) < len(told):
        raise InputError(path, "names two recordings alike", "give them different names")
    return lambda name: named.get(name, named.get(""))


def _plain(name: str) -> str:
    """A file's name without folders and without an ending that motion and sound have."""
    last = Path(name.replace("\\", "/"))
    return last.stem if last.suffix.lower() in label_files.OTHERS else last.name


def from_store(store: Store, labels_of: LabelsOf) -> list[LabelledRecording]:
    """The recordings of a store that have labels."""
    told = ((store.load(name), labels) for name in store.names if (labels := labels_of(name)))
    return [LabelledRecording(own.info.name, labels, own.speech, own.motion) for own, labels in told]


def from_files(sound: Path | None, motion: Path | None, labels_of: LabelsOf, fps: float | None = None,
               leave_out: str = _NONE) -> list[LabelledRecording]:
    """A sound, a motion or both of one name, or all motions below a folder with the sounds of their names."""
    try:
        left_out = re.compile(leave_out)
    except re.error as error:
        raise InputError("--leave-out", f"is no regular expression ({error})", "quote what is no pattern") from None
    pairs = [(sound, motion)]
    if motion is not None and motion.is_dir():
        pairs = [(find_sound(sound, file.stem) if sound else None, file) for file in sorted(motion.rglob("*"))
                 if file.suffix.lower() in MOTIONS and not left_out.search(file.stem)]
    clips = []
    for heard, moved in pairs:
        first = heard or moved
        if first is None:
            raise InputError("--store, --sound or --motion", "is missing", "name what the labels belong to")
        if labels := labels_of(first.stem):
            clips.append(LabelledRecording((moved or first).stem, labels, load_speech(heard) if heard else None,
                                           read_motion(moved, fps) if moved else None))
    return clips


def arguments(parser: argparse.ArgumentParser) -> None:
    """Labels, and what they belong to."""
    add = parser.add_argument
    add("--labels", required=True, type=Path, metavar="FILE|DIR", help="marks of one recording, a table of recordings, "
        "or a folder of files named like the recordings")
    add("--store", metavar="STORE", help="whose sound and motion are judged, where it has labels")
    add("--sound", type=Path, metavar="FILE|DIR", help="instead of a store")
    add("--motion", type=Path, metavar="FILE|DIR", help="BVH, SMPL-X npz or positions npy, alone or beside --sound")
    add("--fps", type=float, help="of the motion, where its file is wrong")
    add("--leave-out", default=_NONE, metavar="REGEX", help="motions of a folder that are not judged")
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
    labels_of = labels_by_name(arguments.labels, choice)
    if not arguments.store:
        clips = from_files(arguments.sound, arguments.motion, labels_of, arguments.fps, arguments.leave_out)
    elif arguments.sound or arguments.motion:
        raise InputError("--store", "holds sound and motion", "leave --sound and --motion out")
    else:
        clips = from_store(Store.open(arguments.store), labels_of)
    return judge(clips, arguments.tolerance, arguments.seed)
