"""Does the mouth follow the sound? The lips network beside a mouth by volume and a formant rule.

On synthetic voices and languages that the network was not trained on, and on human readings. `frames`: share of frames
with a phone whose viseme is the one with the largest weight. `closed`: share of p, b and m at which the mouth, as it is
drawn, shuts (under a tenth of its widest) within 40 ms of their middle. `open`: share of the same for the middles of
vowels of aa and oh at which it does *not* shut, so that a mouth that is always shut fails. `shut`: mean opening in
silence. `level` and `F1`: correlation of the opening with the level over frames with a phone, and with the first
formant over vowels.
The controls are the network on sound that is moved by 0.2 s, and on that of another clip: they must fail.

For English the words are given, too: with times by pocketsphinx, and as a control with the words of another clip in
their place. The phones of the readings are by pocketsphinx, too; those of the synthetic voices are not, so that their
figures do not depend on it.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.files import read_text
from data_module.speech.audio import load_speech
from data_module.text.alignment import alignment
from data_module.types import Array, Samples, Speech, Word
from eval.stats import mean_interval, paired
from eval.table import Column, Table
from gesticulator.face.lips import LOOK_AHEAD, SHIPPED, Lips, load_weights, with_dominance
from gesticulator.face.visemes import CLOSED, SILENT, VISEMES, VOWELS, opening
from gesticulator_performer.face.known_phones import PhonedSpeech, aligned, synthetic
from gesticulator_performer.face.mouths import RATE, by_formants, by_volume, formants, loudness

WITHIN = 0.04
"""Seconds from the middle of a closure within which the mouth must shut."""
SHUT = 0.1
"""Opening under which a mouth counts as shut."""
SHIFT = 0.2
"""Seconds by which the sound of a control is moved."""
PIECE = 4.0
"""Seconds of a piece of speech; intervals are over pieces."""
COLUMNS = {
    "frames": Column("frames right", "share", good="high"), "closed": Column("p, b, m closed", "share", good="high"),
    "open": Column("aa, oh open", "share", good="high"), "shut": Column("opening in silence", "share", 3, "low"),
    "level": Column("r with level", "", good="high"), "f1": Column("r with F1", "", good="high")}
Mouth = Callable[[Samples], tuple[Array, Array]]
"""Samples at 16 kHz -> [T, 15] weights of visemes as found, and as drawn."""
WITH_WORDS, OTHER_WORDS = "network, with words", "network, words of another clip"


@dataclass(frozen=True)
class FaceSound:
    """A clip with the figures of its sound: labels [T] (-1 unknown), level and F1 [T], middles of closures and of open
    vowels in seconds."""

    clip: PhonedSpeech
    labels: NDArray[np.int64]
    level: Array
    f1: Array

    @property
    def closures(self) -> list[float]:
        return [(one.start + one.end) / 2 for one in self.clip.track if one.viseme == CLOSED]

    @property
    def vowels(self) -> list[float]:
        wide = VISEMES.index("aa"), VISEMES.index("oh")
        return [(one.start + one.end) / 2 for one in self.clip.track if one.viseme in wide]


def measured(clip: PhonedSpeech) -> FaceSound:
    count = len(loudness(clip.samples))
    labels = clip.labels(RATE)[:count]
    return FaceSound(clip, np.pad(labels, (0, count - len(labels)), constant_values=-1), loudness(clip.samples),
                 formants(clip.samples)[0])


def network(folder: Path = SHIPPED) -> Mouth:
    """The lips network as it is drawn."""
    def mouth(samples: Samples) -> tuple[Array, Array]:
        lips = Lips(0.0, load_weights(folder))
        lips.feed(samples)
        lips.finish()
        count = len(samples) * RATE // 16000
        return lips.weights[:count], lips.rows(0, count)
    return mouth


def with_words(samples: Samples, words: Sequence[Word], folder: Path = SHIPPED) -> tuple[Array, Array]:
    """The lips network with the phones of words, as found and as drawn."""
    lips = Lips(0.0, load_weights(folder))
    lips.feed(samples)
    lips.finish()
    lips.follow(words)
    count = len(samples) * RATE // 16000
    return lips.weights[:count], lips.rows(0, count)


def words_of(clip: PhonedSpeech) -> tuple[Word, ...]:
    """The words of an English clip, with times by the aligner."""
    return alignment(Speech(clip.samples, 16000), clip.text, warn=False).words


def seconds_per_frame(samples: Samples) -> float:
    """Processor seconds of one frame of the network on one core, its features and the smoothing included."""
    lips, threads = Lips(), torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        lips.feed(samples[:16000])  # what is loaded on first use
        begin = time.process_time()
        for at in range(16000, len(samples), 320):
            lips.feed(samples[at:at + 320])
            lips.rows(max(len(lips.weights) - 1, 0), len(lips.weights))
        return (time.process_time() - begin) / max((len(samples) - 16000) / 320, 1)
    finally:
        torch.set_num_threads(threads)


def rule(weights: Callable[[Samples], Array]) -> Mouth:
    """A baseline, drawn with the same dominance."""
    def mouth(samples: Samples) -> tuple[Array, Array]:
        found = weights(samples)
        return found, with_dominance(found)
    return mouth


def figures(mouth: tuple[Array, Array], one: FaceSound) -> dict[str, Array]:
    """Figures of each piece of a clip, NaN where a piece has nothing to count."""
    weights, shown = mouth
    count = min(len(weights), len(shown), len(one.labels), len(one.level), len(one.f1))
    drawn, labels = opening(shown[:count]), one.labels[:count]
    size = round(PIECE * RATE)
    pieces = np.arange(count) // size
    right = (weights[:count].argmax(axis=1) == labels).astype(float)
    spoken = labels > SILENT

    def mean(values: Array, where: NDArray[np.bool_]) -> Array:
        return np.array([values[where & (pieces == piece)].mean() if (where & (pieces == piece)).any() else np.nan
                         for piece in range(pieces[-1] + 1)])

    def least(middles: Sequence[float]) -> Array:
        reach = round(WITHIN * RATE)
        values = np.array([[middle / PIECE, drawn[max(round(middle * RATE - 0.5) - reach, 0):
                                                  round(middle * RATE - 0.5) + reach + 1].min(initial=1.0)]
                           for middle in middles if middle * RATE < count]).reshape(-1, 2)
        return np.array([(values[values[:, 0].astype(int) == piece, 1] < SHUT).mean()
                         if (values[:, 0].astype(int) == piece).any() else np.nan for piece in range(pieces[-1] + 1)])

    def related(values: Array, where: NDArray[np.bool_]) -> Array:
        return np.array([_r(drawn[inside], values[:count][inside]) for piece in range(pieces[-1] + 1)
                         for inside in [where & (pieces == piece)]])

    return {"frames": mean(right, spoken), "closed": least(one.closures), "open": 1.0 - least(one.vowels),
            "shut": mean(drawn, deep(labels)), "level": related(one.level, spoken),
            "f1": related(one.f1, np.isin(labels, VOWELS))}


def deep(labels: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Frames of silence that are 0.1 s or more from any sound: lips move a little before and after a voice."""
    sounds = np.convolve(labels != SILENT, np.ones(11), "same") > 0
    return np.asarray(~sounds)


def _r(one: Array, other: Array) -> float:
    if len(one) < 10 or one.std() == 0 or other.std() == 0:
        return float("nan")
    return float(np.corrcoef(one, other)[0, 1])


def table(title: str, clips: Sequence[PhonedSpeech], mouths: Mapping[str, Mouth], folder: Path | None = None) -> Table:
    """A row for each mouth, and the two controls of the first; facts: the network minus the formant rule, paired, and
    with words minus without. folder: weights to use with the words of the clips; None for no words."""
    sounds = [measured(clip) for clip in clips]
    drawn = {name: [mouth(one.clip.samples) for one in sounds] for name, mouth in mouths.items()}
    first = next(iter(drawn))
    shift = round(SHIFT * RATE)
    drawn[f"{first}, moved by {SHIFT} s"] = [(np.roll(found, shift, axis=0), np.roll(shown, shift, axis=0))
                                             for found, shown in drawn[first]]
    drawn[f"{first}, another clip"] = [drawn[first][(place + 1) % len(sounds)] for place in range(len(sounds))]
    if folder is not None:
        words = [words_of(clip) for clip in clips]
        drawn[WITH_WORDS] = [with_words(clip.samples, some, folder) for clip, some in zip(clips, words, strict=True)]
        drawn[OTHER_WORDS] = [with_words(clip.samples, _replaced(some, words[(place + 1) % len(words)]), folder)
                              for place, (clip, some) in enumerate(zip(clips, words, strict=True))]
    known = {name: _joined([figures(mouth, one) for mouth, one in zip(rows, sounds, strict=True)])
             for name, rows in drawn.items()}
    rows = {name: {key: mean_interval(values) for key, values in found.items()} for name, found in known.items()}
    facts = {}
    for one, other in ((first, "formant rule"), (WITH_WORDS, first)):
        for key in COLUMNS if {one, other} <= known.keys() else ():
            a, b = (known[name][key] for name in (one, other))
            both = np.isfinite(a) & np.isfinite(b)
            facts[f"{one} minus {other}, {key}"] = paired(a[both], b[both]).to_dict()
    differences = [f"{name}: {fact['mean']:+.2f} [{fact['low']:+.2f}, {fact['high']:+.2f}]"
                   for name, fact in facts.items() if name.rpartition(", ")[2] in ("frames", "closed", "f1")]
    seconds = sum(clip.duration for clip in clips)
    return Table(title, COLUMNS, rows, "mouth", [f"{seconds:.0f} s in {len(clips)} clips: "
                 + ", ".join(sorted({f"{clip.language} {clip.voice}".strip() for clip in clips})), *differences], facts)


def _replaced(words: Sequence[Word], others: Sequence[Word]) -> list[Word]:
    """Other words at the times of these."""
    return [replace(word, text=others[place % len(others)].text) for place, word in enumerate(words)]


def _joined(parts: Sequence[Mapping[str, Array]]) -> dict[str, Array]:
    return {key: np.concatenate([part[key] for part in parts]) for key in COLUMNS}


def arguments(parser: argparse.ArgumentParser) -> None:
    """Readings, weights, and how much to synthesise."""
    parser.add_argument("--reading", action="append", default=[], type=Path, metavar="FILE",
                        help="an English reading with its text beside it (.txt); can be repeated")
    parser.add_argument("--weights", type=Path, default=SHIPPED, metavar="DIR",
                        help="weights of gesticulator train-face (default: the shipped ones)")
    parser.add_argument("--seconds", type=float, default=300.0,
                        help="seconds of held-out synthetic speech; 0 for none (default 300)")


def run(arguments: argparse.Namespace) -> list[Table]:
    """All mouths on all speech; InputError where there is none."""
    mouths = {"network": network(arguments.weights), "formant rule": rule(by_formants), "volume": rule(by_volume)}
    tables = []
    if arguments.reading:
        clips = []
        for path in arguments.reading:
            text = path.with_suffix(".txt")
            if not text.exists():
                raise InputError(path, f"has no {text.name} beside it", "write what is spoken there")
            clips.append(aligned(load_speech(path), read_text(text, "write what is spoken there"), path.stem))
        made = table("Human readings", clips, mouths, arguments.weights)
        spent = 1000 * seconds_per_frame(max((clip.samples for clip in clips), key=len))
        tables.append(replace(made, notes=[*made.notes, f"{spent:.2f} ms of one core per frame of 20 ms; look-ahead of "
                                           f"the network {1000 * LOOK_AHEAD:.0f} ms"]))
    if arguments.seconds > 0:
        clips = list(synthetic(np.random.default_rng(2), arguments.seconds, held_out=True))
        tables.append(table("Synthetic voices and languages that were held out", clips, mouths))
        english = [clip for clip in clips if clip.text]
        tables.append(table("The English ones among them, with their words", english,
                            {"network": mouths["network"]}, arguments.weights))
    if not tables:
        raise InputError("--reading, --seconds", "leave no speech", "give one of them")
    return tables
