"""The nouns of data sets: what a reader is, what it may be told, and what it gives.

A reader lists its recordings without opening them, then reads them one by one, in any order and in any process. What
it gives is in metres and seconds, on the source's own skeleton, at the source's own frame rate; `load` cuts sound and
motion to the same length.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from data_module.store import SPLITS, Recording, RecordingInfo, Split
from data_module.types import Motion, Speech, Word

__all__ = ["DroppedError", "Imported", "Item", "Options", "Reader", "StrokeSource"]


@dataclass(frozen=True)
class Options:
    """What the user may tell a reader.

    seed, hours, preset, languages (empty: the reader's own choice): for corpora that are made, not read. fps: frames
    per second of the motion files, where their header is wrong. unit: metres per unit of the motion files, where it
    cannot be guessed. split, speaker: of a folder's recordings, as `data_module.corpora.folder` reads them; empty for
    its own choice.
    """

    seed: int = 1
    hours: float = 4.2
    preset: str = "default"
    fps: float | None = None
    unit: float | None = None
    languages: tuple[str, ...] = ()
    split: str = ""
    speaker: str = ""


@dataclass(frozen=True)
class Item:
    """A recording that a reader can read. content: whatever the reader needs for it (must survive pickling). size: of
    the work, against that of its other recordings (bytes, seconds): only who does it, and when, depends on it."""

    info: RecordingInfo
    index: int
    content: Any = None
    size: float = 1.0


@dataclass(frozen=True)
class Imported(Recording):
    """A recording from files, with what had to be decided on reading them, for the build's report.

    unit: what a unit of length in its motion was taken as, and why. words: how its words got their times: "given",
    "heard", "guessed", or "" without words.
    """

    unit: str = ""
    words: str = ""


class DroppedError(Exception):
    """A recording cannot be used; the message says why. The build goes on and reports it."""


class Reader(Protocol):
    """A data set as the build sees it."""

    licence: str
    """In a few words, who may use what is built from it."""

    def settings(self) -> Mapping[str, Any]:
        """Everything that the result depends on, as JSON; two builds with equal settings give equal stores."""

    def items(self) -> Sequence[Item]:
        """The recordings in a fixed order; names are unique."""

    def read(self, item: Item) -> Recording:
        """One recording on its own skeleton, metres and seconds; `DroppedError` when it cannot be used."""

    def notes(self) -> Sequence[str]:
        """Lines for the build's report: what was left out, and why."""


class StrokeSource(Protocol):
    """Clips without speech: no store can be made of them, but the folder `strokes/` that the performer plays."""

    licence: str
    """In a few words, who may use what is made of them."""

    def write(self, out: Path) -> int:
        """Write the folder `out` whole or not at all; how many clips it holds."""

    def notes(self) -> Sequence[str]:
        """Lines for the report: what was left out, and why."""


def split_of(index: int) -> Split:
    """The split of the recording at `index`: of every 40, 35 train, 2 validate and 3 test, well spread."""
    place = index % 40
    return "test" if place in (6, 19, 32) else "val" if place in (12, 26) else "train"


def spread(count: int, shares: tuple[float, float, float]) -> tuple[Split, ...]:
    """The splits of `count` recordings in order, [count]: shares for train, val and test, spread evenly.

    Of two recordings one is for test, of three one for val as well, unless their share is 0.
    """
    val, test = (round(count * share / sum(shares)) for share in shares[1:])
    test = max(test, 1) if count >= 2 and shares[2] > 0 else test
    val = max(val, 1) if count >= 3 and shares[1] > 0 else val
    if shares[0] <= 0:  # what rounding left over
        val, test = (val, count - val) if shares[2] > 0 else (count, 0)
    while val + test > count - (shares[0] > 0):
        val, test = (val, test - 1) if test >= val else (val - 1, test)
    out: list[Split] = ["train"] * count
    for split, wanted in zip(SPLITS[1:], (val, test), strict=True):
        free = [place for place in range(count) if out[place] == "train"]
        for turn in range(wanted):
            # The middle of each of `wanted` equal parts of what is left.
            out[free[int((turn + 0.5) * len(free) / wanted)]] = split
    return tuple(out)


def load(reader: Reader, item: Item) -> Recording:
    """Read a recording and cut its sound and its motion to the shorter of the two."""
    recording = reader.read(item)
    speech, motion = trimmed(recording.speech, recording.motion)
    return replace(recording, speech=speech, motion=motion)


def trimmed(speech: Speech, motion: Motion) -> tuple[Speech, Motion]:
    """Both cut to the whole frames of motion that lie within both; words that begin later are left out.

    `DroppedError` when less than one second is left.
    """
    frames = min(len(motion), int(speech.duration * motion.fps + 1e-6))
    if frames < motion.fps:
        raise DroppedError(f"sound ({speech.duration:.2f} s) and motion ({motion.duration:.2f} s) share under a second")
    end = frames / motion.fps
    words = speech.words
    if words is not None:
        words = tuple(Word(w.text, w.start, min(w.end, end)) for w in words if w.start < end)
    # Rounded up, so that what was cut once is not cut again.
    samples = speech.samples[:math.ceil(end * speech.sample_rate - 1e-6)]
    return replace(speech, samples=samples, words=words), motion.crop(0, frames)
