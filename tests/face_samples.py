"""Faces for the tests: posed ones, and the face of three spoken words."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest
from performances import perform

from data_module.face import FaceMotion, at_rest
from data_module.motion.skeletons import CHARACTER
from data_module.types import Motion, Speech
from data_module.visemes import VISEMES, VisemeSpan, of_ipa, spans
from gesticulator.body.face import FaceSettings, face_of
from gesticulator.performance import Performance

FPS, RATE = 30.0, 16000
WORDS = ("mama", "oh no", "fish")
PAUSE = 0.7


def still(seconds: float, fps: float = FPS) -> Motion:
    """The character at rest."""
    turns = np.zeros((round(seconds * fps), len(CHARACTER), 4))
    turns[..., 0] = 1.0
    return Motion(CHARACTER, turns, np.zeros((len(turns), 3)), fps)


def posed(**parts: float) -> FaceMotion:
    """One frame of a face: weights of visemes by name, and blink, brows, smile, left and up."""
    face = at_rest(1, FPS)
    named = {name: weight for name, weight in parts.items() if name in VISEMES}
    for name, weight in named.items():
        face.visemes[0, VISEMES.index(name)] = weight
    face.visemes[0, 0] = max(1.0 - sum(named.values()), 0.0)
    rest = {name: np.array([parts[name]]) for name in ("blink", "brows", "smile") if name in parts}
    return replace(face, gaze=np.array([[parts.get("left", 0.0), parts.get("up", 0.0)]]), **rest)


def spoken() -> tuple[Performance, list[VisemeSpan]]:
    """A still character that says the words of `WORDS` with pauses around them, and the visemes of its phones."""
    espeak = pytest.importorskip("data_module.performer.espeak")
    if shutil.which("espeak-ng") is None:
        pytest.skip("espeak-ng is not installed")
    lines = [espeak.Line("en-us", word, 130, 45, 50) for word in WORDS]
    pieces, track, at = [], [], PAUSE
    for samples, phones in espeak.ipa_phrases(lines):
        pieces += [np.zeros(round(PAUSE * RATE)), samples]
        track += [VisemeSpan(one.viseme, at + one.start, at + one.end)
                  for name, start, end in phones for one in spans(of_ipa(name), start, end)]
        at += len(samples) / RATE + PAUSE
    sound = np.concatenate([*pieces, np.zeros(round(PAUSE * RATE))])
    sound = (0.5 * sound / np.abs(sound).max()).astype(np.float32)
    motion = still(len(sound) / RATE)
    face = face_of(FaceSettings("lips"), sound, (), motion)
    return replace(perform(len(sound) / RATE), motion=motion, speech=Speech(sound, RATE), face=face), track
