"""How well a recogniser hears words and their times: word error rate, time errors and cost, against known texts.

    python benchmarks/transcription.py MODEL SPEECH TEXT [SPEECH TEXT ...] [--out FILE.json]

MODEL is what `gesticulator infer --transcribe` takes (tiny.en). The times of reference are those of the aligner, which
knows the text; errors are of words that both have. What fools it: the aligner errs, too, by .03 s in the median, and a
synthetic voice is easier than a person in a room.
"""

from __future__ import annotations

import argparse
import re
import time
from collections.abc import Sequence
from difflib import SequenceMatcher
from pathlib import Path

import numpy as np

from data_module.speech.audio import load_speech
from data_module.text.alignment import align
from data_module.text.transcription import transcribed
from data_module.types import Word
from eval.table import Cell, Column, Provenance, Table, publish

COLUMNS = {"words": Column("words"), "error": Column("word error rate", "", 3), "start": Column("start, median error",
           "s", 3), "far": Column("starts off by over .2 s", "", 3), "cost": Column("real-time factor", "", 3)}


def spelled(words: Sequence[Word]) -> list[str]:
    """Words in one spelling."""
    return [re.sub(r"[^a-z0-9']", "", word.text.lower()) for word in words]


def word_error_rate(said: Sequence[str], heard: Sequence[str]) -> float:
    """Substitutions, deletions and insertions (Levenshtein) over the words that are said."""
    row = np.arange(len(heard) + 1)
    for number, word in enumerate(said, 1):
        above, row = row, np.empty_like(row)
        row[0] = number
        for place, other in enumerate(heard, 1):
            row[place] = min(above[place] + 1, row[place - 1] + 1, above[place - 1] + (word != other))
    return float(row[-1]) / max(len(said), 1)


def measured(model: str, sound: Path, text: Path) -> dict[str, Cell]:
    """The figures of a recording."""
    speech = load_speech(sound)
    said = align(speech, text.read_text(encoding="utf-8"))
    begun = time.perf_counter()
    transcript = transcribed(speech, model)
    spent = time.perf_counter() - begun
    heard = () if transcript is None or transcript.words is None else transcript.words
    matches = SequenceMatcher(None, spelled(said), spelled(heard), autojunk=False).get_matching_blocks()
    errors = np.array([abs(said[one.a + k].start - heard[one.b + k].start) for one in matches for k in range(one.size)])
    return {"words": len(said), "error": word_error_rate(spelled(said), spelled(heard)),
            "start": float(np.median(errors)) if errors.size else np.nan,
            "far": float((errors > 0.2).mean()) if errors.size else np.nan, "cost": spent / speech.duration}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="word error rate and time errors of a recogniser")
    parser.add_argument("model")
    parser.add_argument("files", nargs="+", type=Path, metavar="SPEECH TEXT")
    parser.add_argument("--out", metavar="FILE.json")
    given = parser.parse_args()
    if len(given.files) % 2:
        parser.error("give a text for each recording")
    rows = {sound.stem: measured(given.model, sound, text)
            for sound, text in zip(given.files[::2], given.files[1::2], strict=True)}
    names = " ".join(f"{sound.name} {text.name}" for sound, text in zip(given.files[::2], given.files[1::2],
                                                                         strict=True))
    publish([Table("Words by a recogniser", COLUMNS, rows, "recording", [
        "Times against those of the aligner, which knows the text. One thread; the first row loads the model, too."])],
        given.out, Provenance.now(f"python benchmarks/transcription.py {given.model} {names}"))


if __name__ == "__main__":
    main()
