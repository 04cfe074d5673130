"""Does a model trained on one language gesture in time with another? (RG 6.3, 7.2, Fig. 13)

    gesticulator probe languages --data SPEECH_FOLDER STORE ... [--bundle DIR] [--reverse DIR]

The words are kept from the model, so that it follows the sound alone; what is measured needs no reference motion. Real
readings and synthetic voices stand in rows of their own, because a synthesiser's rhythm is easier to hear. What fools
these figures: a deaf model that moves often is near chance, not near zero, so PMB is to be read above its chance; a
language spoken faster has more onsets and a higher chance; entropy grows with the number of blocks, so that it is taken
over pieces of one length and lexemes are counted in equal numbers of blocks; and with fewer than about ten pieces an
interval is too narrow. Where a store brings the motion that its performer made, that is a row to hold against.
"""

from __future__ import annotations

import argparse
import functools
import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import gammaln
from tqdm import tqdm

from data_module.corpora.performer import TEST_READINGS, tail_begins
from data_module.errors import InputError
from data_module.performer import voices
from data_module.performer.text import compose
from data_module.speech.audio import load_speech
from data_module.store import Store
from data_module.types import Array, Motion, Speech
from eval.clip import ClipMeasurement, measure
from eval.metrics import pmb
from eval.metrics.diversity import entropy
from eval.stats import mean_interval
from eval.table import Column, Table
from gesticulator.pipeline import FPS, Gesticulator
from interpreters import INTERPRETERS

PIECE = 15.0
"""Seconds of the pieces whose means have an interval."""
NAMES = {"en": "English", "de": "German", "es": "Spanish", "cmn": "Mandarin"}
RULE = "the performer of the store, by its rule"
_FOLDER_SOUNDS = (".flac", ".wav")
_ROWS = ("onsets_per_second", "motion_beats_per_second", "pmb", "chance", "above_chance", "entropy", "speech_speed",
         "silence_speed")


@dataclass(frozen=True)
class Passage:
    """A stretch of speech that no model was trained on. engine: the synthesiser that speaks it, "" for a person.

    motion: what the corpus's own performer does with it, where a store tells.
    """

    name: str
    language: str
    engine: str
    speech: Speech
    motion: Motion | None = None

    @property
    def group(self) -> str:
        """The row it counts in: "German, real"."""
        return f"{NAMES.get(self.language, self.language)}, {'synthetic' if self.engine else 'real'}"


# --------------------------------------------------------------------------------------------------- passages

def passages(places: Sequence[Path], spoken: Sequence[str] | None, seconds: float) -> list[Passage]:
    """Everything in folders and stores that was kept for test, and `seconds` by each test voice of `spoken`.

    A folder holds LANGUAGE_NAME.flac: of English the readings kept for test, of other languages their kept ends. A
    store gives its test split. A reading that comes twice is taken once, with its motion. spoken: languages; None for
    Mandarin where nothing else brings it.
    """
    found: dict[str, Passage] = {}
    for place in places:
        own = _of_store(Store.open(place)) if (place / "store.json").is_file() else _of_folder(place)
        for one in own:
            if one.name not in found or found[one.name].motion is None:
                found[one.name] = one
    listed = list(found.values())
    if spoken is None:
        spoken = () if any(one.language == "cmn" for one in listed) else ("cmn",)
    return listed + [passage for language in spoken for passage in speak(language, seconds)]


def speak(language: str, seconds: float, seed: int = 1) -> list[Passage]:
    """About `seconds` of our own sentences by each test voice of a language."""
    if language not in voices.VOICES_OF:
        raise InputError(f"--speak {language}", "nobody here speaks it", f"choose among {', '.join(voices.VOICES_OF)}")
    out = []
    for number, voice in enumerate(voices.VOICES_OF[language][1]):
        rng = np.random.default_rng([seed, number])
        said = voices.speak(voice, compose(rng, seconds, "test", language=language), voice, rng)
        out.append(Passage(f"spoken by {voice}", language, _engine(voice), said.speech))
    return out


def _of_folder(folder: Path) -> list[Passage]:
    if not folder.is_dir():
        raise InputError(folder, "is not a folder", "--data takes folders of speech and stores")
    out = []
    for file in sorted(f for f in folder.iterdir() if f.suffix.lower() in _FOLDER_SOUNDS):
        language = file.stem.split("_")[0]
        if language == "en":
            if file.stem.startswith(TEST_READINGS):
                out.append(Passage(file.stem, language, "", load_speech(file)))
        else:
            speech = load_speech(file)
            kept = speech.samples[tail_begins(speech.samples, speech.sample_rate):]
            tail = replace(speech, samples=np.ascontiguousarray(kept))
            out.append(Passage(f"{file.stem}_tail", language, "", tail))
    if not out:
        raise InputError(folder, "holds no speech kept for test", "name files LANGUAGE_NAME.flac: de_prose.flac")
    return out


def _of_store(store: Store) -> list[Passage]:
    out = []
    for info in store.of_split("test"):
        recording = store.load(info.name)
        engine = _engine(info.voice) if info.voice in voices.VOICES else ""
        name = f"{store.path.name}/{info.name} by {info.voice}" if engine else info.group or info.name
        out.append(Passage(name, info.language, engine, recording.speech, recording.motion))
    if not out:
        raise InputError(store.path, "has no test split", "build it again")
    return out


def _engine(voice: str) -> str:
    return {"espeak": "espeak-ng"}.get(voices.VOICES[voice].engine, voices.VOICES[voice].engine)


# ---------------------------------------------------------------------------------------------------- figures

def expected_kinds(labels: NDArray[np.int64], drawn: int) -> float:
    """How many different lexemes `drawn` of the labels, drawn without replacement, hold on average (rarefaction)."""
    counts = np.unique(labels, return_counts=True)[1].astype(np.float64)
    total = float(len(labels))
    if not 0 <= drawn <= total:
        raise ValueError(f"{drawn} of {len(labels)} labels cannot be drawn")
    rest = total - counts
    # The probability that a kind is missed, C(rest, drawn) / C(total, drawn); impossible where too few others exist.
    missed = np.where(rest >= drawn, np.exp(gammaln(rest + 1) - gammaln(np.maximum(rest - drawn, 0) + 1)
                                            - gammaln(total + 1) + gammaln(total - drawn + 1)), 0.0)
    return float((1 - missed).sum())


@dataclass(frozen=True)
class Piece:
    """A stretch of a performance: what was measured on it, and the lexemes of the blocks that begin in it."""

    clip: ClipMeasurement
    lexemes: NDArray[np.int64]


def pieces(clip: ClipMeasurement, starts: Array, lexemes: NDArray[np.int64], fps: float, seconds: float = PIECE
           ) -> list[Piece]:
    """A performance in pieces of one length near `seconds`. starts, lexemes: [N] of its blocks.

    The whole is measured before it is cut, so that a piece keeps the thresholds of its recording.
    """
    count = max(1, round(clip.duration / seconds))
    edges = np.linspace(0.0, clip.duration, count + 1)
    frames = np.round(edges * fps).astype(int)
    frames[-1] = len(clip.hand_speed) + 1
    out = []
    for start, end, first, last in zip(edges, edges[1:], frames, frames[1:], strict=False):
        onsets, beats = (own[(own >= start) & (own < end)] - start for own in (clip.onsets, clip.beats))
        part = ClipMeasurement(onsets, beats, float(end - start), clip.hand_speed[first:last],
                               clip.silent[first:last], clip.heights[first:last])
        out.append(Piece(part, lexemes[(starts >= start) & (starts < end)]))
    return out


def figures_of(piece: Piece) -> dict[str, float]:
    """The figures of one piece by the names of `_ROWS`: per second, percent, nats and m/s; NaN where undefined."""
    clip, rhythm = piece.clip, piece.clip.rhythm()
    values = (len(clip.onsets) / clip.duration, clip.beats_per_second, rhythm.pmb, rhythm.chance, rhythm.above_chance,
              lexeme_entropy(piece.lexemes), clip.speech_speed, clip.silence_speed)
    return dict(zip(_ROWS, values, strict=True))


def lexeme_entropy(labels: NDArray[np.int64]) -> float:
    """Of the lexemes' frequencies, nats (RG Eq. 23); NaN for none."""
    return entropy(np.unique(labels, return_counts=True)[1])


def _row(played: Sequence[Sequence[Piece]], size: int) -> dict[str, Any]:
    """A row over pieces of speech, each played several times: [pieces][performances].

    A piece's figure is the mean over its performances, since it is pieces of speech that the interval draws.
    """
    row: dict[str, Any] = {"seconds": round(sum(players[0].clip.duration for players in played), 1)}
    own = [[figures_of(piece) for piece in players] for players in played]
    for name in _ROWS:
        values = np.array([[one[name] for one in players] for players in own])
        known = np.isfinite(values)
        means = np.where(known, values, 0).sum(1) / np.where(known.any(1), known.sum(1), np.nan)
        row[name] = mean_interval(means)
    labels = _lexemes(played)
    return row | {"pieces": len(played), "blocks": len(labels), "entropy_of_all": lexeme_entropy(labels),
                  "used": len(np.unique(labels)) / size if len(labels) else float("nan")}


def _lexemes(played: Sequence[Sequence[Piece]]) -> NDArray[np.int64]:
    return np.concatenate([piece.lexemes for players in played for piece in players])


def rows(heard: Iterable[Passage], play: Callable[[Passage], list[list[Piece]]], size: int) -> dict[str, Any]:
    """{"groups": {"German, real": row}, "clips": {name: row}, "equal_blocks": n} of whoever plays the passages.

    play: what gives [pieces][performances] for a passage; size: of the lexicon. `used_equally` is the share of it that
    turns up in n blocks, n being the blocks of the smallest group.
    """
    clips: dict[str, list[list[Piece]]] = {}
    groups: dict[str, list[list[Piece]]] = {}
    for passage in heard:
        played = play(passage)
        clips[f"{passage.name} ({passage.group})"] = played
        groups.setdefault(passage.group, []).extend(played)
    table = {name: _row(own, size) for name, own in groups.items()}
    least = min(row["blocks"] for row in table.values())
    for name, row in table.items():
        row["used_equally"] = expected_kinds(_lexemes(groups[name]), least) / size if least else float("nan")
    return {"groups": table, "clips": {name: _row(own, size) for name, own in clips.items()}, "equal_blocks": least}


def played_by(system: Gesticulator, passage: Passage, interpreter: str, takes: int = 1) -> list[list[Piece]]:
    """[pieces][performances]: every performer of the bundle, `takes` times each, on one passage without its words."""
    wordless = replace(passage.speech, words=None)
    players = []
    for speaker, seed in itertools.product(system.speakers, range(takes)):
        made = system(wordless, speaker=speaker, seed=seed, interpreter=interpreter)
        clip = measure(made.motion, wordless, made.blocks.edges)
        players.append(pieces(clip, made.blocks.edges[:-1], made.lexemes, FPS))
    return [list(one) for one in zip(*players, strict=True)]


def performed(passage: Passage) -> list[list[Piece]]:
    """[pieces][1]: what the corpus's performer did with a passage that has its motion; lexemes are unknown."""
    if passage.motion is None:
        raise ValueError(f"{passage.name} has no motion")
    clip = measure(passage.motion, passage.speech)
    return [[one] for one in pieces(clip, np.zeros(0), np.zeros(0, dtype=np.int64), passage.motion.fps)]


def figures(systems: dict[str, Gesticulator], heard: Sequence[Passage], interpreters: Sequence[str] = ("lstm",), *,
            takes: int = 1, progress: bool = False) -> dict[str, Any]:
    """Rows of every model and interpreter on the same passages, and which of them a person speaks."""
    told: dict[str, Any] = {}
    known = [one for one in heard if one.motion is not None]
    if known:
        told[RULE] = rows(known, performed, 1)
    for name, system in systems.items():
        for interpreter in interpreters:
            label = f"{name}, {interpreter}"
            play = functools.partial(played_by, system, interpreter=interpreter, takes=takes)
            # Of the lexicon that plays: RACER's own codec has another size than the setting of ours.
            told[label] = rows(tqdm(heard, desc=label, disable=not progress), play,
                               system.bundle.lexicon.quantizer.size)
    speech = [{"name": one.name, "language": one.language, "spoken_by": one.engine or "a person", "group": one.group,
               "seconds": round(one.speech.duration, 1)} for one in heard]
    return {"speech": speech, "takes": takes, "systems": told}


# ------------------------------------------------------------------------------------------------------ tables

COLUMNS = {"seconds": Column("speech", "s", 0), "pieces": Column("pieces"),
           "onsets_per_second": Column("onsets", "Hz"), "motion_beats_per_second": Column("motion beats", "Hz"),
           "pmb": Column("PMB", "%", 1), "chance": Column("chance", "%", 1),
           "above_chance": Column("above chance", "%", 1, "high"), "entropy": Column("entropy", "nats"),
           "used": Column("lexicon used", "share"), "used_equally": Column("used by as many blocks", "share"),
           "speech_speed": Column("hands in speech", "m/s"), "silence_speed": Column("in silence", "m/s", 3)}


def tables(result: dict[str, Any]) -> list[Table]:
    """By group and by clip for every player, and who spoke what.

    The facts of the first have the claim of RG Fig. 13: PMB above chance on each language but English, by the first
    bundle.
    """
    spoken: dict[str, set[str]] = {}
    for one in result["speech"]:
        spoken.setdefault(one["group"], set()).add(one["spoken_by"])
    about = (f"Means over pieces of about {PIECE:.0f} s (intervals are too narrow under ten pieces); every performer "
             f"of a bundle plays every piece, in {result['takes']} take(s); no words are given. PMB at {pmb.DELTA:g} "
             "s; entropy of the lexemes of a piece; lexicon used by all blocks, and by as many as the smallest group "
             "has.")
    first: dict[str, Any] = next((of for name, of in result["systems"].items() if name != RULE), {"groups": {}})
    claim = [row["above_chance"].to_dict() for name, row in first["groups"].items() if not name.startswith("English")]
    voices = Table("Speech", {"by": Column("spoken by")},
                   {group: {"by": ", ".join(sorted(by))} for group, by in spoken.items()}, "language", [about],
                   {"claim": claim, "speech": result["speech"], "takes": result["takes"],
                    "equal_blocks": {name: of["equal_blocks"] for name, of in result["systems"].items()}})
    out = [voices]
    for name, of in result["systems"].items():
        for title, key in ((name, "groups"), (f"{name}, each clip", "clips")):
            columns = {key: column for key, column in COLUMNS.items()
                       if any(key in row for row in of["groups" if title == name else "clips"].values())}
            out.append(Table(title, columns, {label: {key: row.get(key) for key in columns}
                                              for label, row in of[key].items()}, "speech"))
    return out


def _listed(told: str | None, known: Iterable[str], option: str) -> tuple[str, ...] | None:
    if told is None:
        return None
    names = tuple(filter(None, told.split(",")))
    for name in names:
        if name not in known:
            raise InputError(f"{option} {name}", "is not known", f"choose among {', '.join(known)}")
    return names


def arguments(parser: argparse.ArgumentParser) -> None:
    """Speech, bundles, who chooses the lexemes."""
    add = parser.add_argument
    add("--data", required=True, nargs="+", type=Path, metavar="DIR",
        help="folders of LANGUAGE_NAME.flac, and stores (their test split)")
    add("--bundle", metavar="DIR", help="default: the shipped one")
    add("--reverse", metavar="DIR", help="a bundle trained on another language, on the same speech")
    add("--interpreters", default="lstm", metavar="A,B", help=f"of {', '.join(INTERPRETERS)} (lstm)")
    add("--speak", metavar="cmn,de", help="languages to speak here with synthetic voices (cmn, where --data has none; "
        "'' for none)")
    add("--seconds", type=float, default=60.0, help="of --speak, by each of the language's test voices (60)")
    add("--takes", type=int, default=3, help="times that each performer plays everything, with other lexemes sampled "
        "and so with another rhythm (3)")


def run(arguments: argparse.Namespace) -> list[Table]:
    """Play everything; InputError for options that cannot be."""
    torch.set_num_threads(1)
    if not (math.isfinite(arguments.seconds) and arguments.seconds > 0):
        raise InputError("--seconds", f"is {arguments.seconds:g}", "give a number over 0")
    if arguments.takes < 1:
        raise InputError("--takes", f"is {arguments.takes}", "give 1 or more")
    interpreters = _listed(arguments.interpreters, INTERPRETERS, "--interpreters") or ("lstm",)
    spoken = _listed(arguments.speak, voices.VOICES_OF, "--speak")
    name = "shipped" if arguments.bundle is None else Path(arguments.bundle).name
    systems = {name: Gesticulator.from_pretrained(arguments.bundle)}
    if arguments.reverse is not None:
        systems[f"{Path(arguments.reverse).name} (reverse)"] = Gesticulator.from_pretrained(arguments.reverse)
    heard = passages(arguments.data, spoken, arguments.seconds)
    return tables(figures(systems, heard, interpreters, takes=arguments.takes, progress=True))
