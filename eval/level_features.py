"""A recording as every level of a speech encoder hears it, frame by frame, beside its pitch, energy and words."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from data_module import blocks as block_module
from data_module.speech.front_ends import MelFrontEnd, scaled_windows
from data_module.speech.silence import reference_level
from data_module.speech.speech_encoder import LEVELS, SpeechEncoder
from data_module.store import Recording
from data_module.text.word_vectors import word_frames
from data_module.types import Array, Samples
from gesticulator.config import Config

MEL = "mel"
_LOWEST, _HIGHEST = 60.0, 500.0  # Hz, of the voice
_BATCH = 4


@dataclass(frozen=True)
class LevelFeatures:
    """One recording as the levels hear it, frame by frame. N blocks, K frames.

    features: [N, K, C] by name of the row; energy: [N, K] log power; pitch: [N, K] log2 Hz, NaN where unvoiced;
    word_at: [N, K] which of `words` sounds, -1 for none; silent: [N]. group: recordings of one group share speech.
    """

    name: str
    group: str
    voice: str
    features: Mapping[str, NDArray[np.float16]]
    energy: Array
    pitch: Array
    word_at: NDArray[np.int64]
    words: tuple[str, ...]
    silent: NDArray[np.bool_]


def level_name(level: int) -> str:
    """What a row of the table is called."""
    return f"level {level}"


def untrained(encoder: SpeechEncoder, seed: int = 0) -> SpeechEncoder:
    """An encoder of the same shape as it was before training."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return SpeechEncoder(encoder.config).eval()


def pitch_of(stretched: Samples, frames: int, sample_rate: int) -> Array:
    """[N, K] log2 of the fundamental frequency in Hz in the middle of each frame of blocks [N, L]; NaN if unvoiced."""
    import librosa

    hop = stretched.shape[1] // frames
    # pyin's frames stand at multiples of the hop: half a frame is cut off, so that they stand in the middles.
    sound = np.append(stretched.ravel()[hop // 2:], np.zeros(hop, np.float32))
    found, _, _ = librosa.pyin(sound, fmin=_LOWEST, fmax=_HIGHEST, sr=sample_rate, frame_length=1024, hop_length=hop,
                               resolution=0.2)
    return np.asarray(np.log2(found[:stretched.shape[0] * frames]), dtype=np.float64).reshape(-1, frames)


def listen(recording: Recording, config: Config, encoders: Mapping[str, SpeechEncoder]) -> LevelFeatures:
    """A recording through every encoder (rows "NAMElevel L") and the mel front end, as in use: windows of three blocks
    at the voice's own level."""
    speech, rate = recording.speech, recording.speech.sample_rate
    blocks = block_module.cut(speech, config.rhythm)
    frames, per_frame = blocks.frames, block_module.samples_per_frame(rate, blocks.fps)
    mel = MelFrontEnd(frames=3 * frames, samples_per_frame=per_frame, sample_rate=rate)
    stretched = block_module.stretch_speech(speech, blocks)
    windows = block_module.windows_of(stretched)
    reference = reference_level(speech.samples, rate, blocks.edges)
    parts: dict[str, list[NDArray[np.float16]]] = {}
    middle = slice(frames, 2 * frames)
    for _, scaled in scaled_windows(windows, reference, windows.shape[1], _BATCH):
        parts.setdefault(MEL, []).append(mel.rows(scaled)[:, middle].astype(np.float16))
        for prefix, encoder in encoders.items():
            with torch.inference_mode():
                levels = encoder.levels(torch.from_numpy(scaled), 3 * frames, range(1, LEVELS + 1))
            for level, rows in enumerate(levels, 1):
                parts.setdefault(prefix + level_name(level), []).append(rows[:, middle].numpy().astype(np.float16))
    features = {name: np.concatenate(rows) for name, rows in parts.items()}
    words, info = speech.words or (), recording.info
    return LevelFeatures(
        info.name, info.group or info.name, info.voice, features,
        features[MEL][..., -1].astype(np.float64),
        pitch_of(stretched, frames, rate), word_frames(words, blocks, config.text.bridge),
        tuple(plain(word.text, info.language) for word in words), blocks.silent)


def plain(word: str, language: str) -> str:
    """A word in small letters without the marks around it, after its language; "" for none."""
    bare = re.sub(r"^[\W_]+|[\W_]+$", "", word.lower())
    return f"{language}:{bare}" if bare else ""
