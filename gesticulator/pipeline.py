"""The product in Python: `Gesticulator.from_pretrained()(speech) -> Performance`."""

from __future__ import annotations

from collections.abc import Callable
from os import PathLike
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from data_module.audio import SAMPLE_RATE, load_speech, resample
from data_module.blocks import denormalise
from data_module.errors import InputError
from data_module.skeletons import from_vector
from data_module.types import Array, Motion, Speech
from gesticulator import bundle as bundles
from gesticulator.hear import Heard, front_end_for, hear
from gesticulator.performance import BEST, Performance
from interpreters import INTERPRETERS, BlockFeatures, LexemeInterpreter, select

FPS = 60.0
"""Frames per second of the result when not told: the models' 20 fps knots, interpolated."""


class Gesticulator:
    """A loaded bundle that turns speech into gesture, block by block (RG 6, Eq. 15)."""

    def __init__(self, bundle: bundles.Bundle) -> None:
        self.bundle = bundle
        self._front_end = front_end_for(bundle.config)

    @classmethod
    def from_pretrained(cls, path: str | PathLike[str] | None = None) -> Gesticulator:
        """Load a bundle's folder; the shipped one when no path is given."""
        return cls(bundles.load(Path(path) if path is not None else bundles.SHIPPED))

    @property
    def speakers(self) -> tuple[str, ...]:
        """The performers whose habits the bundle knows."""
        return self.bundle.speakers

    def speaker_index(self, speaker: str | None) -> int:
        """The number of a performer; InputError lists the known ones."""
        if speaker is None:
            preferred = self.bundle.config.default_speaker
            return self.speakers.index(preferred) if preferred in self.speakers else 0
        if speaker not in self.speakers:
            raise InputError(f"--speaker {speaker}", "is not in the bundle", f"choose among {', '.join(self.speakers)}")
        return self.speakers.index(speaker)

    def interpreter(self, name: str) -> LexemeInterpreter:
        """The lexeme interpreter of that name, over the bundle's lexicon."""
        if name == "lstm":
            return self.bundle.interpreter
        if name == "statistical":
            return self.bundle.statistical()
        raise InputError(f"--interpreter {name}", "is not in the bundle", f"choose among {', '.join(INTERPRETERS)}")

    def __call__(self, speech: Speech | str | PathLike[str], *, speaker: str | None = None, seed: int = 0,
                 fps: float | None = None, interpreter: str | LexemeInterpreter = "lstm",
                 temperature: float | None = None, on_block: Callable[[int, int], None] | None = None) -> Performance:
        """Gesture for a recording.

        speech: a `Speech` at any sample rate, or the path of a sound file. speaker: a performer's habits. fps: frames
        per second of the result (60). interpreter: what chooses the lexemes, by name or as an object. temperature: how
        freely lexemes are drawn, 0 for always the likeliest; the bundle's own when not told. on_block(done, total) is
        called after each block. The same seed, bundle and speech give the same result.
        """
        if not isinstance(speech, Speech):
            speech = load_speech(speech)
        if fps is not None and not 1 <= fps <= 1000:
            raise InputError(f"--fps {fps:g}", "is out of range", "choose 1 to 1000")
        if temperature is not None and temperature < 0:
            raise InputError(f"--temperature {temperature:g}", "is negative", "choose 0 or more")
        speech = resample(speech, SAMPLE_RATE)
        who = self.speaker_index(speaker)
        heard = hear(speech, self.bundle.config, self._front_end)
        chosen = self.bundle.config.selection
        system = self.interpreter(interpreter) if isinstance(interpreter, str) else interpreter
        roll = _Roll(self.bundle, system, who, np.random.default_rng(seed),
                     chosen.temperature if temperature is None else temperature, chosen.top or None)
        features, lexemes, best, scores = roll.run(heard, on_block)
        motion = self.to_motion(features, heard, who, FPS if fps is None else fps)
        return Performance(motion=motion, speech=speech, blocks=heard.blocks, lexemes=lexemes, best=best, scores=scores)

    def to_motion(self, features: NDArray[np.float32], heard: Heard, speaker: int, fps: float) -> Motion:
        """Normalised blocks [N, K, D_m] on the speech's own clock, smoothed, as motion at `fps` (RG 4.2.2, 7.1.2)."""
        statistics = self.bundle.statistics
        poses: Array = statistics.denormalise(features.astype(np.float64), speaker)
        frames = denormalise(poses, statistics.rest_pose[speaker], heard.blocks, fps,
                             self.bundle.config.motion.smoothing)
        return from_vector(frames, fps)


class _Roll:
    """One performance in the making: the states of interpreter, style and generator."""

    def __init__(self, bundle: bundles.Bundle, interpreter: LexemeInterpreter, speaker: int,
                 rng: np.random.Generator, temperature: float, top: int | None) -> None:
        self.bundle, self.interpreter, self.speaker, self.rng = bundle, interpreter, speaker, rng
        self.temperature, self.top = temperature, top

    @torch.inference_mode()
    def run(self, heard: Heard, on_block: Callable[[int, int], None] | None
            ) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """Motion features [N, K, D_m], lexemes [N], the five best lexemes [N, 5] and their scores [N, 5]."""
        b = self.bundle
        vectors, count = b.lexicon.vectors, len(heard.blocks)
        best_count = min(BEST, len(vectors))
        previous = b.rest_lexeme(self.speaker)
        rest = b.rest_feature(self.speaker)
        past = rest.expand(1, b.lexicon.frames, -1)
        state = b.generator.first_state(rest[None], vectors[[previous]])
        inner, style_state = self.interpreter.start(self.speaker, previous), b.style.start(self.speaker)
        bounds = torch.as_tensor(b.statistics.bounds, dtype=torch.float32)
        motion = np.empty((count, *past.shape[1:]), dtype=np.float32)
        lexemes = np.empty(count, dtype=np.int64)
        best, best_scores = np.empty((count, best_count), np.int64), np.empty((count, best_count))
        for i in range(count):
            features = self._features(heard, i)
            scores, inner = self.interpreter.step(inner, features, previous)
            allowed = b.silent if features.silent and b.config.silence.mask else None
            previous = select(scores, allowed=allowed, temperature=self.temperature, top=self.top, rng=self.rng)
            code, style_state = b.style.step(style_state, features, previous)
            audio = b.generator.encode_audio(features.low[None])
            past, state, _ = b.generator.step(past, audio, vectors[[previous]], code, state)
            # What it was never shown it must not feed itself: one odd pose would lead to the next.
            past = torch.clamp(past, *bounds)
            motion[i], lexemes[i] = past[0].numpy(), previous
            best[i] = np.argsort(-scores, kind="stable")[:best_count]
            best_scores[i] = scores[best[i]]
            if on_block is not None:
                on_block(i + 1, count)
        return motion, lexemes, best, best_scores

    def _features(self, heard: Heard, i: int) -> BlockFeatures:
        s = self.bundle.statistics
        low = torch.as_tensor(s.low.apply(heard.low[i]), dtype=torch.float32)
        high = torch.as_tensor(s.high.apply(heard.high[i]), dtype=torch.float32)
        return BlockFeatures(low, high, bool(heard.blocks.silent[i]))

