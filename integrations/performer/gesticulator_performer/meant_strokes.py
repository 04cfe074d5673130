"""Strokes with a meaning for every performer: labelled, lent by those who have them, and made from further clips.

A clip that is listed with a label shows that gesture. A performer without a stroke of a label borrows the strokes of
all who have some. Some labels exist only in clips of free motion, or in clips that are no strokes to speak with (a hand
at the chin); those are made into short strokes here.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from data_module.errors import InputError
from data_module.motion.bvh import read_bvh
from data_module.types import Motion
from gesticulator_performer import strokes as performed
from gesticulator_performer.cues import Cues, MeantClip, mirrored, read_cues
from gesticulator_performer.strokes import PerformerBody, Repertoire, Stroke, StrokeSet, lent, mirror
from gesticulator_performer.tables import read_clips, table

LENDER = "pn"
_LEXEMES = table("clips.toml")["borrowed"]
FOLDER = "meaning"
_CLIPS = table("clips.toml")["meanings"]
# Seconds from the start of such a stroke to its beat, to the end of its hold and to its end, at most: some clap for a
# quarter of a minute.
_LONGEST_PREPARATION, _LONGEST_HOLD, _RETRACTION = 1.2, 0.9, 0.7


def lexemes_of_clip(stem: str) -> tuple[str, ...]:
    """Lexemes of a clip by its file's stem ("pn_bigger_intense2"); () for one that is no stroke ("pn_idle")."""
    return tuple(_LEXEMES.get(stem.removeprefix(LENDER + "_").rstrip("0123456789").removesuffix("_intense"), ()))


def load_borrowed(folder: str | Path) -> tuple[PerformerBody, tuple[Stroke, ...]]:
    rows = [row for row in read_clips(folder, {"file", "person", "emphasis"}) if row["person"] == LENDER]
    chosen = [{"file": row["file"], "speaker": LENDER, "posture": "", "hand": "", "emphasis": row["emphasis"] or "1.0",
               "lexeme": lexemes_of_clip(Path(row["file"]).stem)[0]}
              for row in rows if lexemes_of_clip(Path(row["file"]).stem)]
    if not chosen:
        raise InputError(Path(folder) / "manifest.csv", f"names no stroke of {LENDER}",
                         "take the manifest that came with the clips")
    figure, strokes = performed.speaker_strokes(Path(folder), LENDER, chosen)
    held_out = performed.held_out_keys((LENDER, stroke.base) for stroke in strokes)
    return figure, tuple(replace(stroke, held_out=(LENDER, stroke.base) in held_out) for stroke in strokes)


def with_borrowed(strokes: StrokeSet, lender: PerformerBody, borrowed: Sequence[Stroke]) -> StrokeSet:
    """Add a lender's strokes for every performer, as `lent`. A lexeme takes the first of its names that the
    performer knows."""
    out = list(strokes.strokes)
    for performer in strokes.performers:
        known = {stroke.lexeme for stroke in strokes.of(performer, "test")}
        for stroke in borrowed:
            # A mirror image has its own lexeme already ("YouLeft" becomes "YouRight").
            wanted = [stroke.lexeme, *lexemes_of_clip(stroke.base)[1:]]
            usual = "BeatMid" if "BeatMid" in known else stroke.lexeme
            lexeme = next((name for name in wanted if name in known), usual)
            out.append(replace(lent(stroke, lender, strokes.figures[performer]), lexeme=lexeme))
    return StrokeSet(tuple(out), strokes.figures)


def with_meanings(strokes: StrokeSet, source: Path) -> StrokeSet:
    """The strokes with the labels and the cues of the folder `meaning` in `source`, and the strokes of the labels that
    a performer lacks. InputError as of `read_cues`, and for a clip that is missing or broken."""
    cues = read_cues(source / FOLDER)
    own = [_labelled(stroke, cues) for stroke in strokes.strokes]
    clips = _further_clips(source, cues, strokes)
    bodies = {**strokes.figures, **_lenders(clips)}
    further = [stroke for clip, motion in clips for stroke in _made(bodies, clip, motion)]
    out = list(own)
    for performer in strokes.performers:
        known = {stroke.meaning for stroke in own if stroke.speaker == performer} | {""}
        # A label that is made of further clips may be the performer's own.
        foreign = [stroke for stroke in own if stroke.speaker != performer]
        out += [lent(stroke, bodies[stroke.speaker], bodies[performer], stroke.meaning in _CLIPS["head"])
                for stroke in (*further, *foreign) if stroke.meaning not in known]
    return replace(strokes, strokes=_playable(out), cues=cues)


def with_repertoire(strokes: StrokeSet, takes: Repertoire, source: Path) -> StrokeSet:
    """The strokes with takes of named gestures, which come at the words that the detector finds. source: with the
    folder `meaning`, whose table tells which labels suit a standing speaker."""
    allowed = read_cues(source / FOLDER, takes.labels)
    return replace(strokes, repertoire=takes, cues=replace(allowed, detected=True))


def _labelled(stroke: Stroke, cues: Cues) -> Stroke:
    clip = cues.clips.get(stroke.base)
    if clip is None:
        return stroke
    label = clip.label if stroke.clip == stroke.base else mirrored(clip.label)
    return replace(stroke, meaning=label, faithful=clip.label in _CLIPS["faithful"])


def _further_clips(source: Path, cues: Cues, strokes: StrokeSet) -> list[tuple[MeantClip, Motion]]:
    """The clips with phases that are no strokes yet: those of the listed people, and those of labels that have none."""
    known = {stroke.base for stroke in strokes.strokes}
    there = {clip.label for clip in cues.clips.values() if clip.stem in known}
    folders = {folder for folder in ("strokes", "free_motion") if (source / folder / "manifest.csv").is_file()}
    out = []
    for clip in cues.clips.values():
        able = clip.person in _CLIPS["people"] or (clip.label not in there and clip.person in strokes.figures)
        fit = able and clip.stem not in known.union(_CLIPS["unfit"])
        if clip.phases and fit and Path(clip.file).parts[0] in folders:
            out.append((clip, read_bvh(source / clip.file, unit=1.0)))
    return out


def _lenders(clips: Iterable[tuple[MeantClip, Motion]]) -> dict[str, PerformerBody]:
    motions: dict[str, list[Motion]] = defaultdict(list)
    for clip, motion in clips:
        if clip.person in _CLIPS["people"]:
            motions[clip.person].append(motion)
    return {person: performed.standing_body(person, own) for person, own in motions.items()}


def _made(bodies: dict[str, PerformerBody], clip: MeantClip, motion: Motion) -> list[Stroke]:
    """The stroke of a clip and its mirror image, of bounded length; none where no hand moves."""
    figure = bodies[clip.person]
    ready, _, emphasis, end, relax = clip.phases
    row = {"file": clip.file, "speaker": figure.name, "posture": "", "lexeme": clip.label.title().replace("_", ""),
           "emphasis": str(emphasis)}
    listed = (max(0.0, ready - 0.5), emphasis, max(end, emphasis + 0.1), max(relax, end) + 0.5)
    stroke = performed.measured_stroke(figure, row, motion.rotations, motion.fps, listed)
    if stroke is None:
        return []
    hold_end = min(stroke.hold_end, stroke.beat + _LONGEST_HOLD)
    stroke = replace(stroke, start=max(stroke.start, stroke.beat - _LONGEST_PREPARATION), hold_end=hold_end,
                     end=min(stroke.end, hold_end + _RETRACTION), meaning=clip.label,
                     faithful=clip.label in _CLIPS["faithful"], steady=True)
    stroke = _cut(stroke)
    return [stroke, mirror(stroke)]


def _cut(stroke: Stroke) -> Stroke:
    """The stroke without the frames before and after it."""
    first, last = int(stroke.start * stroke.fps), int(np.ceil(stroke.end * stroke.fps)) + 1
    start, beat, hold_end, end = (time - first / stroke.fps for time in
                                  (stroke.start, stroke.beat, stroke.hold_end, stroke.end))
    return replace(stroke, arms=stroke.arms[:, first:last], trunk=stroke.trunk[first:last], start=start, beat=beat,
                   hold_end=hold_end, end=end, _splines={})


def _playable(strokes: Sequence[Stroke]) -> tuple[Stroke, ...]:
    """The strokes with at least one clip of each label that is not held out for test."""
    free = {stroke.meaning for stroke in strokes if not stroke.held_out}
    return tuple(replace(stroke, held_out=stroke.held_out and stroke.meaning in free | {""}) for stroke in strokes)
