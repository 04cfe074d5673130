"""Which recordings are looked at, and which stretch of each; the real take of GESTICULATOR_DATA."""

import os
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar, cast

import numpy as np

from data_module.errors import InputError
from data_module.motion import bvh, skeletons
from data_module.motion.kinematics import resample
from data_module.speech.audio import load_speech
from data_module.store import Recording, RecordingInfo, Split, Store
from data_module.types import Motion, Speech, Word

T = TypeVar("T")
TAKE = Path("takes") / "beat_scott"
"""In GESTICULATOR_DATA: a real take, one BVH and one WAV."""
TAKE_FPS = 15.0
"""Frame rate of the take (BEAT states 1/15 s in the file)."""


def evenly(store: Store, split: str, limit: int | None = None) -> list[RecordingInfo]:
    """The recordings of a split ("all" for every one), or `limit` of them, evenly chosen; InputError when empty."""
    infos = store.recordings if split == "all" else store.of_split(cast(Split, split))
    if not infos:
        raise InputError(store.path, f"has no recordings in its {split} split", "choose another split")
    if limit is not None and limit < 1:
        raise InputError("--limit", "must be 1 or more", "leave it out for all")
    return spread_out(infos, len(infos) if limit is None else limit)


def spread_out(items: Sequence[T], count: int) -> list[T]:
    """That many of the items (all where they are fewer), the first one and others evenly chosen."""
    # Evenly over the list, as neighbours in it are often of one speaker.
    return [items[k] for k in np.linspace(0, len(items) - 1, min(count, len(items))).round().astype(int)]


def excerpt(recording: Recording, seconds: float) -> Recording:
    """The middle `seconds` of a recording (all of it when it is shorter), with the words that lie in it."""
    speech, motion = recording.speech, recording.motion
    start, stop = _middle(speech, seconds)
    frames = motion.crop(round(start * motion.fps), max(round(stop * motion.fps), round(start * motion.fps) + 1))
    return replace(recording, speech=excerpt_of_speech(speech, seconds), motion=frames)


def excerpt_of_speech(speech: Speech, seconds: float) -> Speech:
    """The middle `seconds` of speech, with the words that lie in it."""
    start, stop = _middle(speech, seconds)
    first, last = (round(at * speech.sample_rate) for at in (start, stop))
    # Words that are cut off at either end are left out: half a word has no meaning.
    words = None if speech.words is None else tuple(
        Word(word.text, word.start - start, word.end - start) for word in speech.words
        if start <= word.start and word.end <= stop)
    return replace(speech, samples=np.ascontiguousarray(speech.samples[first:last]), words=words)


def _middle(speech: Speech, seconds: float) -> tuple[float, float]:
    """Where the middle `seconds` begin and end."""
    start = max(0.0, (speech.duration - seconds) / 2)
    return start, min(speech.duration, start + seconds)


def real_take(fps: float, own_rig: bool = False) -> tuple[Motion, Speech] | None:
    """The real take that lies in GESTICULATOR_DATA at this frame rate; None without it. It is on our character, or on
    its own rig with its fingers."""
    place = os.environ.get("GESTICULATOR_DATA")
    folder = Path(place) / TAKE if place else None
    if folder is None or not folder.is_dir():
        return None
    with warnings.catch_warnings():
        # The file's header contradicts itself; `TAKE_FPS` is what its authors state.
        warnings.simplefilter("ignore", bvh.BvhWarning)
        motion = bvh.read_bvh(next(iter(sorted(folder.glob("*.bvh")))), fps=TAKE_FPS)
    motion = motion if own_rig else skeletons.to_character(motion)
    return resample(motion, fps), load_speech(next(iter(sorted(folder.glob("*.wav")))))
