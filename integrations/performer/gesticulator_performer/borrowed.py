"""Strokes of a person whose body is not among the performers, lent to every performer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from data_module.errors import InputError
from gesticulator_performer.clips import read_clips
from gesticulator_performer.lending import lent
from gesticulator_performer.strokes import PerformerBody, Stroke, StrokeSet, held_out_keys, speaker_strokes

LENDER = "pn"
# Part of a clip's name between "pn_" and its version -> names of lexemes, the best first.
_LEXEMES: dict[str, tuple[str, ...]] = {
    "bigger": ("EmptyLarge", "BeatHigh"), "inclusivity": ("InclusivityPos", "BeatMid"), "me": ("Me",),
    "negation": ("Negate", "NegateForwardMid"), "pointcenter": ("Point", "BeatForward"),
    "pointhere": ("Here", "BeatPointMid"), "pointleft": ("YouLeft",), "pointright": ("YouRight",),
    "question": ("Shrug", "BeatFlip"), "stop": ("StopForward", "Stop"), "us": ("We", "BeatMid"), "we": ("We",),
    "you": ("YouForward", "You"),
}


def lexemes_of_clip(stem: str) -> tuple[str, ...]:
    """Lexemes of a clip by its file's stem ("pn_bigger_intense2"); () for one that is no stroke ("pn_idle")."""
    return _LEXEMES.get(stem.removeprefix(LENDER + "_").rstrip("0123456789").removesuffix("_intense"), ())


def load_borrowed(folder: str | Path) -> tuple[PerformerBody, tuple[Stroke, ...]]:
    rows = [row for row in read_clips(folder, {"file", "person", "emphasis"}) if row["person"] == LENDER]
    chosen = [{"file": row["file"], "speaker": LENDER, "posture": "", "hand": "", "emphasis": row["emphasis"] or "1.0",
               "lexeme": lexemes_of_clip(Path(row["file"]).stem)[0]}
              for row in rows if lexemes_of_clip(Path(row["file"]).stem)]
    if not chosen:
        raise InputError(Path(folder) / "manifest.csv", f"names no stroke of {LENDER}",
                         "take the manifest that came with the clips")
    figure, strokes = speaker_strokes(Path(folder), LENDER, chosen)
    held_out = held_out_keys((LENDER, stroke.base) for stroke in strokes)
    return figure, tuple(replace(stroke, held_out=(LENDER, stroke.base) in held_out) for stroke in strokes)


def with_borrowed(strokes: StrokeSet, lender: PerformerBody, borrowed: Sequence[Stroke]) -> StrokeSet:
    """Add a lender's strokes for every performer, as `lending.lent`. A lexeme takes the first of its names that the
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
