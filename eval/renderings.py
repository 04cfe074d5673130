"""Voices, the bundle that gestures for them, and its renderings."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.speech import audio
from data_module.store import Store
from data_module.types import Array, Motion, Speech
from eval.baselines import controls
from eval.clip.excerpts import excerpt
from eval.metrics.eye import VoiceActivity, hear
from eval.metrics.eye.pitch import pitch_track
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.features import SpeechFeatures
from gesticulator.gesticulator import Gesticulator
from gesticulator.performance import Assembler, Performance
from gesticulator.sampling.loop import GeneratedMotion

TAKE, TEST, DERIVED = "take", "test", "derived"
"""Where a voice comes from: the real take, the store's test split, or another voice that was changed."""
SECONDS = 60.0
"""Of each test recording: a minute, over which drift is asked for."""
SHORTEST = 20.0
"""Seconds: shorter recordings have no repetition and hardly a stroke to speak of; they are left out."""


@dataclass(frozen=True)
class AcceptanceVoice:
    """A voice. own: what its speaker does, where known; group: voices of one group are alike."""

    name: str
    speech: Speech
    place: str = DERIVED
    own: Motion | None = None
    group: str = ""

    @cached_property
    def heard(self) -> VoiceActivity:
        """The onsets, levels and silences of the sound, for the figures."""
        return hear(self.speech)

    @cached_property
    def pitch(self) -> Array:
        """Its track for `eval.metrics.eye.pitch`."""
        return pitch_track(self.speech)


def held_out_voices(store: Store, limit: int | None, joints: int) -> list[AcceptanceVoice]:
    """The middle of every test recording that lasts long enough, the first `limit` of them, with its performer's motion
    in so many joints."""
    chosen = [info for info in store.of_split("test") if info.seconds >= SHORTEST][:limit]
    pieces = [excerpt(store.load(info.name, joints), SECONDS) for info in chosen]
    return [AcceptanceVoice(info.name, piece.speech, TEST, piece.motion, info.group or info.name)
            for info, piece in zip(chosen, pieces, strict=True)]


@dataclass(frozen=True)
class Rendering:
    """Motion with its blocks. edges: [N + 1] seconds; silent: [N]; lexemes: [N] those played; drawn: [N, K, D_m] the
    blocks as they were sampled, before rest and life."""

    motion: Motion
    edges: Array
    silent: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))
    lexemes: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    drawn: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0, 0), np.float32))


class ListeningGesticulator(Gesticulator):
    """Keeps the normalised motion of the last blocks that were sampled."""

    drawn: NDArray[np.float32]

    def assemble(self, assembler: Assembler, generated: GeneratedMotion) -> Performance:
        """The performance of generated blocks."""
        # Rest and life are laid over the blocks later, and are no answer to a lexeme.
        self.drawn = generated.motion
        return super().assemble(assembler, generated)


class BundleSystem:
    """A bundle that is played here, at the guidance and temperature that it was frozen with, in the habits of one
    speaker for all voices: figures then differ by the sound and not by the performer."""

    def __init__(self, folder: Path, speaker: str | None = None) -> None:
        """speaker: None for the bundle's own default."""
        self.folder, self.speaker = folder, speaker
        self.gesticulator = ListeningGesticulator(bundles.load(folder))
        self._last: tuple[AcceptanceVoice, SpeechFeatures] | None = None

    @property
    def bundle(self) -> bundles.Bundle:
        """The bundle that is rendered."""
        return self.gesticulator.bundle

    @property
    def megabytes(self) -> float:
        """Of its files."""
        return sum(file.stat().st_size for file in self.folder.iterdir() if file.is_file()) / 1e6

    def render(self, voice: AcceptanceVoice, seed: int, **options: Any) -> Rendering:
        """A voice with a seed. options: of the performance, beside speaker and seed."""
        performance = self.perform(voice, seed, **options)
        blocks = performance.blocks
        return Rendering(performance.motion, blocks.edges, blocks.silent, performance.lexemes, self.gesticulator.drawn)

    def perform(self, voice: AcceptanceVoice, seed: int, rolled: bool = False, **options: Any) -> Performance:
        """The same as a performance. rolled: the sound comes `controls.ROLLED` blocks late, on the same blocks: the
        control of everything that is in time."""
        speech = audio.resample(voice.speech, audio.SAMPLE_RATE)
        # A voice is rendered with several seeds in a row; the features of all voices would fill the memory.
        if self._last is None or self._last[0] is not voice:
            self._last = voice, self.gesticulator.encode_speech(speech)
        encoded = controls.rolled(self._last[1]) if rolled else self._last[1]
        return self.gesticulator(speech, encoded=encoded, seed=seed, speaker=self.speaker, **options)
