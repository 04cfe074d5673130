"""Faces for the tests: posed ones, and the face of three spoken words."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from performances import perform, turned

from data_module.motion.skeletons import CHARACTER
from data_module.speech.audio import load_speech
from data_module.types import Motion, Samples, Speech
from gesticulator.face.motion import FaceMotion
from gesticulator.face.track import face_of
from gesticulator.face.visemes import VISEMES
from gesticulator.options import InferenceOptions
from gesticulator.performance import Performance

FPS, RATE = 30.0, 16000
WORDS = ("mama", "oh no", "fish")
PAUSE = 0.7
STORED = Path(__file__).with_name("spoken_words.flac")


_SHAPES = {"m": ("PP",), "ɑː": ("aa",), "ɐ": ("aa",), "oʊ": ("oh", "ou"), "n": ("nn",), "f": ("FF",), "ɪ": ("ih",),
           "ʃ": ("CH",)}
"""Phone of `WORDS` -> its visemes."""


@dataclass(frozen=True)
class VisemeSpan:
    """A viseme (an index in `VISEMES`) from `start` to `end` seconds."""

    viseme: int
    start: float
    end: float


def still(seconds: float, fps: float = FPS) -> Motion:
    """The character at rest."""
    return turned(CHARACTER, round(seconds * fps), fps)


def at_rest(count: int, fps: float) -> FaceMotion:
    """A face that does nothing, with a shut mouth."""
    none, visemes = np.zeros(count), np.tile(np.eye(1, len(VISEMES)), (count, 1))
    return FaceMotion(visemes, none.copy(), none.copy(), none.copy(), np.zeros((count, 2)), fps)


def posed(**parts: float) -> FaceMotion:
    """One frame of a face: weights of visemes by name, and blink, brows, smile, left and up."""
    face = at_rest(1, FPS)
    named = {name: weight for name, weight in parts.items() if name in VISEMES}
    for name, weight in named.items():
        face.visemes[0, VISEMES.index(name)] = weight
    face.visemes[0, 0] = max(1.0 - sum(named.values()), 0.0)
    rest = {name: np.array([parts[name]]) for name in ("blink", "brows", "smile") if name in parts}
    return replace(face, gaze=np.array([[parts.get("left", 0.0), parts.get("up", 0.0)]]), **rest)


def _word(word: str) -> tuple[Samples, list[tuple[str, float, float]]]:
    """A word of spoken_words.flac (a synthetic voice), and its phones with their times in it, seconds."""
    sound = load_speech(STORED).samples
    entry = next(entry for entry in json.loads(STORED.with_suffix(".json").read_text()) if entry["word"] == word)
    samples = sound[round(entry["start"] * RATE):round(entry["end"] * RATE)]
    return samples, [(name, start - entry["start"], end - entry["start"]) for name, start, end in entry["phones"]]


def _performed(pieces: list[Samples], fps: float) -> Performance:
    """A still character with the lips of a sound, which ends with a pause."""
    sound = np.concatenate([*pieces, np.zeros(round(PAUSE * RATE), np.float32)])
    sound = (0.5 * sound / np.abs(sound).max()).astype(np.float32)
    motion = still(len(sound) / RATE, fps)
    face = face_of(InferenceOptions(face="lips"), sound, (), motion)
    return replace(perform(len(sound) / RATE), motion=motion, speech=Speech(sound, RATE), face=face)


def spoken() -> tuple[Performance, list[VisemeSpan]]:
    """A still character that says the words of `WORDS` with pauses around them, and the visemes of its phones."""
    pieces, track, at = [], [], PAUSE
    for word in WORDS:
        samples, phones = _word(word)
        pieces += [np.zeros(round(PAUSE * RATE), np.float32), samples]
        for name, start, end in phones:
            shapes = _SHAPES.get(name, ())
            edges = at + np.linspace(start, end, len(shapes) + 1)
            track += [VisemeSpan(VISEMES.index(shape), *edges[k:k + 2]) for k, shape in enumerate(shapes)]
        at += len(samples) / RATE + PAUSE
    return _performed(pieces, FPS), track
