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
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from tqdm import tqdm

from data_module.corpora.performer import TEST_READINGS, TEST_VOICES, engine_of, synthetic_speech, tail_begins
from data_module.errors import InputError
from data_module.speech.audio import load_speech
from data_module.store import Store
from data_module.types import Array, Motion, Speech
from eval.clip.measure import ClipMeasurement, measure
from eval.metrics import pmb
from eval.metrics.diversity import entropy, expected_kinds
from eval.stats import Interval, mean_interval
from eval.table import Cell, Column, Table
from gesticulator.options import FPS
from gesticulator.pipeline import Gesticulator
from interpreters import INTERPRETERS

PIECE = 10.0
"""Seconds of the pieces whose means have an interval: half a minute of a language is three."""
NAMES = {"en": "English", "de": "German", "es": "Spanish", "cmn": "Mandarin"}
RULE = "the performer of the store, by its rule"
MEASURED = {"onsets_per_second": Column("onsets", "Hz"), "motion_beats_per_second": Column("motion beats", "Hz"),
            "pmb": Column("PMB", "%", 1), "chance": Column("chance", "%", 1),
            "above_chance": Column("above chance", "%", 1, "high"), "entropy": Column("entropy", "nats"),
            "speech_speed": Column("hands in speech", "m/s"), "silence_speed": Column("in silence", "m/s", 3)}
"""Of each piece."""
COLUMNS = {"seconds": Column("speech", "s", 0), "pieces": Column("pieces"), **MEASURED,
           "used": Column("lexicon used", "share"), "used_equally": Column("used by as many blocks", "share")}

Lexemes = NDArray[np.int64]


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


@dataclass(frozen=True)
class Piece:
    """A stretch of a performance: what was measured on it, and the lexemes of the blocks that begin in it."""

    clip: ClipMeasurement
    lexemes: Lexemes


Player = Callable[[Passage], list[list[Piece]]]
"""Gives [pieces][performances] of a passage."""


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
        if not own:
            raise InputError(place, "holds no speech kept for test", "name files LANGUAGE_NAME.flac: de_prose.flac")
        found |= {one.name: one for one in own if one.name not in found or found[one.name].motion is None}
    if spoken is None:
        spoken = () if any(one.language == "cmn" for one in found.values()) else ("cmn",)
    return [*found.values(), *(passage for language in spoken for passage in speak(language, seconds))]


def speak(language: str, seconds: float, seed: int = 1) -> list[Passage]:
    """About `seconds` of our own sentences by each test voice of a language."""
    out = []
    for number, voice in enumerate(TEST_VOICES[language]):
        rng = np.random.default_rng([seed, number])
        speech = synthetic_speech(voice, language, seconds, rng)
        out.append(Passage(f"spoken by {voice}", language, _engine(voice), speech))
    return out


def _of_folder(folder: Path) -> list[Passage]:
    if not folder.is_dir():
        raise InputError(folder, "is not a folder", "--data takes folders of speech and stores")
    out = []
    for file in sorted(f for f in folder.iterdir() if f.suffix.lower() in (".flac", ".wav")):
        language = file.stem.split("_")[0]
        if language == "en" and not file.stem.startswith(TEST_READINGS):
            continue
        name, speech = file.stem, load_speech(file)
        if language != "en":
            kept = speech.samples[tail_begins(speech.samples, speech.sample_rate):]
            name, speech = f"{name}_tail", replace(speech, samples=np.ascontiguousarray(kept))
        out.append(Passage(name, language, "", speech))
    return out


def _of_store(store: Store) -> list[Passage]:
    out = []
    for info in store.of_split("test"):
        recording = store.load(info.name)
        engine = _engine(info.voice)
        name = f"{store.path.name}/{info.name} by {info.voice}" if engine else info.group or info.name
        out.append(Passage(name, info.language, engine, recording.speech, recording.motion))
    return out


def _engine(voice: str) -> str:
    return {"espeak": "espeak-ng"}.get(engine_of(voice), engine_of(voice))


# ---------------------------------------------------------------------------------------------------- players

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
    assert passage.motion is not None
    clip = measure(passage.motion, passage.speech)
    return [[one] for one in pieces(clip, np.zeros(0), np.zeros(0, dtype=np.int64), passage.motion.fps)]


def pieces(clip: ClipMeasurement, starts: Array, lexemes: Lexemes, fps: float) -> list[Piece]:
    """A performance in pieces of one length near `PIECE`. starts, lexemes: [N] of its blocks."""
    edges = np.linspace(0.0, clip.duration, max(1, round(clip.duration / PIECE)) + 1)
    return [Piece(clip.piece(start, end, fps), lexemes[(starts >= start) & (starts < end)])
            for start, end in itertools.pairwise(edges.tolist())]


# ---------------------------------------------------------------------------------------------------- figures

def figures_of(piece: Piece) -> dict[str, float]:
    """The figures of one piece, by the keys of `MEASURED`; NaN where undefined."""
    clip, rhythm = piece.clip, piece.clip.rhythm()
    values = (len(clip.onsets) / clip.duration, clip.beats_per_second, rhythm.pmb, rhythm.chance, rhythm.above_chance,
              entropy(np.bincount(piece.lexemes)), clip.speech_speed, clip.silence_speed)
    return dict(zip(MEASURED, values, strict=True))


def player_table(title: str, heard: Iterable[Passage], play: Player, size: int) -> Table:
    """A row for each language, real and synthetic. size: of the lexicon that plays.

    A piece's figure is the mean over its performances, since it is pieces of speech that the interval draws.
    `used_equally` is the share of the lexicon that turns up in as many blocks as the smallest group has.
    """
    groups: dict[str, list[list[Piece]]] = {}
    for passage in heard:
        groups.setdefault(passage.group, []).extend(play(passage))
    lexemes = {name: np.concatenate([one.lexemes for players in own for one in players])
               for name, own in groups.items()}
    least = min(map(len, lexemes.values()))
    rows: dict[str, dict[str, Cell]] = {}
    for name, played in groups.items():
        figures = [[figures_of(one) for one in players] for players in played]
        rows[name] = {"seconds": sum(players[0].clip.duration for players in played), "pieces": len(played)}
        for key in MEASURED:
            values = np.ma.masked_invalid([[one[key] for one in players] for players in figures])
            rows[name][key] = mean_interval(values.mean(axis=1).filled(np.nan))
        if least:
            rows[name] |= {"used": len(np.unique(lexemes[name])) / size,
                           "used_equally": expected_kinds(lexemes[name], least) / size}
    return Table(title, COLUMNS, rows, "speech", facts={"equal_blocks": least})


def tables(systems: dict[str, Gesticulator], heard: Sequence[Passage], interpreters: Sequence[str] = ("lstm",), *,
           takes: int = 1, progress: bool = False) -> list[Table]:
    """Who spoke what, then every player: the store's performer, and each model with each interpreter.

    The facts of the first have the claim of RG Fig. 13: PMB above chance on each language but English, by the first
    bundle.
    """
    about = (f"Means over pieces of about {PIECE:.0f} s (intervals are too narrow under ten pieces); every performer "
             f"of a bundle plays every piece, in {takes} take(s); no words are given. PMB at {pmb.DELTA:g} s; entropy "
             "of the lexemes of a piece; lexicon used by all blocks, and by as many as the smallest group has.")
    known = [one for one in heard if one.motion is not None]
    out = [player_table(RULE, known, performed, 1)] if known else []
    for (name, system), who in itertools.product(systems.items(), interpreters):
        # Of the lexicon that plays: RACER's own codec has another size than the setting of ours.
        out.append(player_table(f"{name}, {who}", tqdm(heard, desc=name, disable=not progress),
                                functools.partial(played_by, system, interpreter=who, takes=takes),
                                len(system.bundle.vectors)))
    first = next(table for table in out if table.title != RULE)
    claim = [row["above_chance"].to_dict() for group, row in first.rows.items()
             if not group.startswith("English") and isinstance(row["above_chance"], Interval)]
    by: dict[str, set[str]] = {}
    for one in heard:
        by.setdefault(one.group, set()).add(one.engine or "a person")
    return [Table("Speech", {"by": Column("spoken by")},
                  {group: {"by": ", ".join(sorted(own))} for group, own in by.items()}, "language", [about],
                  {"claim": claim, "speech": [one.name for one in heard], "takes": takes}), *out]


def _listed(told: str) -> tuple[str, ...]:
    return tuple(filter(None, told.split(",")))


def arguments(parser: argparse.ArgumentParser) -> None:
    """Speech, bundles, who chooses the lexemes."""
    add = parser.add_argument
    add("--data", required=True, nargs="+", type=Path, metavar="DIR",
        help="folders of LANGUAGE_NAME.flac, and stores (their test split)")
    add("--bundle", metavar="NAME|DIR", help="bundle: default, paper, or a folder (default: default)")
    add("--reverse", metavar="DIR", help="a bundle trained on another language, on the same speech")
    add("--interpreters", default=("lstm",), type=_listed, metavar="A,B", help=f"of {', '.join(INTERPRETERS)} (lstm)")
    add("--speak", type=_listed, metavar="cmn,de",
        help="languages to synthesise (default: cmn, if --data has none; '' for none)")
    add("--seconds", type=float, default=60.0,
        help="seconds of --speak for each test voice of the language (default 60)")
    add("--takes", type=int, default=3,
        help="renderings by each performer, with other sampled lexemes and therefore another rhythm (default 3)")


def run(arguments: argparse.Namespace) -> list[Table]:
    """Play everything; InputError for options that cannot be."""
    torch.set_num_threads(1)
    for option, names, known in (("--interpreters", arguments.interpreters, INTERPRETERS),
                                 ("--speak", arguments.speak or (), TEST_VOICES)):
        if unknown := [name for name in names if name not in known]:
            raise InputError(f"{option} {unknown[0]}", "is not known", f"choose among {', '.join(known)}")
    if not (0 < arguments.seconds < float("inf") and arguments.takes >= 1):
        raise InputError("--seconds, --takes", f"are {arguments.seconds:g}, {arguments.takes}", "give numbers over 0")
    name = "shipped" if arguments.bundle is None else Path(arguments.bundle).name
    systems = {name: Gesticulator.from_pretrained(arguments.bundle)}
    if arguments.reverse is not None:
        systems[f"{Path(arguments.reverse).name} (reverse)"] = Gesticulator.from_pretrained(arguments.reverse)
    heard = passages(arguments.data, arguments.speak, arguments.seconds)
    return tables(systems, heard, arguments.interpreters, takes=arguments.takes, progress=True)
