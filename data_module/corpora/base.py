"""The types of data sets: readers, their options and their results.

A reader lists its recordings without opening them, then reads them one by one, in any order and in any process. The
result is in metres and seconds, on the skeleton and at the frame rate of the source; `load` cuts sound and motion to
the same length.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from data_module.errors import InputError
from data_module.store import SPLITS, Recording, RecordingInfo, Split
from data_module.types import Motion, Speech, Word

__all__ = ["DroppedError", "Imported", "Item", "Options", "Reader"]


@dataclass(frozen=True)
class Options:
    """The user's options that every reader takes; a reader with more has a class derived from it.

    fps: frames per second of the motion files, if their header is wrong. unit: metres per unit of the motion files, if
    it cannot be guessed. seed: random seed of a synthetic corpus, recorded in its store; 1 for files. joints: joint of
    `WHOLE_BODY` -> its name in the motion files (`data_module.motion.joint_map`), if their names are not known.
    """

    fps: float | None = None
    unit: float | None = None
    seed: int = 1
    joints: Mapping[str, str] | None = None


@dataclass(frozen=True)
class Item:
    """A recording that a reader can read. content: data for the reader (picklable)."""

    info: RecordingInfo
    index: int
    content: Any = None


@dataclass(frozen=True)
class Imported(Recording):
    """A recording from files, with decisions made in reading them, for the build's report. unit: the assumed unit of
    length of its motion, and why. words: the source of the word times: "given", "heard" (by the aligner), "guessed", or
    "" without words."""

    unit: str = ""
    words: str = ""


class DroppedError(Exception):
    """A recording cannot be used; the message says why. The build goes on and reports it."""


class Reader(Protocol):
    """A data set as the build sees it: an object of a class that is opened as `reader(source, options)`.

    A class with command-line options of its own has two static methods: `arguments(parser)` adds them to the parser
    of `build NAME`, and `options(arguments)` returns an instance of its class derived from `Options`, or raises
    `InputError`.
    """

    licence: str
    """In a few words, who may use the stores built from it."""

    def settings(self) -> Mapping[str, Any]:
        """Everything that the result depends on, as JSON; two builds with equal settings give equal stores."""

    def items(self) -> Sequence[Item]:
        """The recordings in a fixed order; names are unique."""

    def read(self, item: Item) -> Recording:
        """One recording on the skeleton of the source, metres and seconds; `DroppedError` if it cannot be used."""

    def notes(self) -> Sequence[str]:
        """Lines for the build's report: what was left out, and why."""


def needed(source: Path | None, advice: str) -> Path:
    """The folder of --source; `InputError` with `advice` if it was not given."""
    if source is None:
        raise InputError("--source", "is missing", advice)
    return source


def split_of(index: int) -> Split:
    """The split of the recording at `index`: of every 40, 35 train, 2 validate and 3 test, evenly spread."""
    # The places lie apart, so that neighbours (often of one session) do not all test.
    place = index % 40
    return "test" if place in (6, 19, 32) else "val" if place in (12, 26) else "train"


def spread(count: int, shares: tuple[float, float, float]) -> tuple[Split, ...]:
    """The splits of `count` recordings in order, [count]: shares for train, val and test, spread evenly. Of two
    recordings one is for test, of three also one for val, unless their share is 0."""
    val, test = (round(count * share / sum(shares)) for share in shares[1:])
    test = max(test, 1) if count >= 2 and shares[2] > 0 else test
    val = max(val, 1) if count >= 3 and shares[1] > 0 else val
    if shares[0] <= 0:  # assign the remainder of rounding
        val, test = (val, count - val) if shares[2] > 0 else (count, 0)
    # Least numbers may add up to more than there are: the larger of the two gives way.
    while val + test > count - (shares[0] > 0):
        val, test = (val, test - 1) if test >= val else (val - 1, test)
    out: list[Split] = ["train"] * count
    for split, wanted in zip(SPLITS[1:], (val, test), strict=True):
        free = [place for place in range(count) if out[place] == "train"]
        for turn in range(wanted):
            # The middle of each of `wanted` equal parts of the remaining places.
            out[free[int((turn + 0.5) * len(free) / wanted)]] = split
    return tuple(out)


def load(reader: Reader, item: Item) -> Recording:
    recording = reader.read(item)
    speech, motion = trimmed(recording.speech, recording.motion)
    return replace(recording, speech=speech, motion=motion)


def trimmed(speech: Speech, motion: Motion) -> tuple[Speech, Motion]:
    """Cut both to the whole frames of motion that lie within both; words that begin later are left out. `DroppedError`
    if less than one second is left."""
    # The small number keeps a duration of exactly n frames from losing one to rounding.
    frames = min(len(motion), int(speech.duration * motion.fps + 1e-6))
    if frames < motion.fps:
        raise DroppedError(f"sound ({speech.duration:.2f} s) and motion ({motion.duration:.2f} s) share under a second")
    end = frames / motion.fps
    words = speech.words
    if words is not None:
        words = tuple(Word(w.text, w.start, min(w.end, end)) for w in words if w.start < end)
    # Rounded up, so that trimming twice changes nothing.
    samples = speech.samples[:math.ceil(end * speech.sample_rate - 1e-6)]
    return replace(speech, samples=samples, words=words), motion.crop(0, frames)
