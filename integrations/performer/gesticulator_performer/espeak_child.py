"""Subprocess that speaks a list of phrases through libespeak-ng and writes samples and events.

The library keeps noise and filter state from phrase to phrase; a fresh process gives the same bytes for the same list.
Reads JSON from standard input: [{"voice", "text", "rate", "pitch", "range"}]; writes an npz to the path in argv[1].
"""

from __future__ import annotations

import ctypes
import json
import os
import sys
from typing import Any

import numpy as np

_LIBRARIES = ("libespeak-ng.so.1", "libespeak-ng.so", "libespeak-ng.dylib", "libespeak-ng.dll", "espeak-ng.dll")
_SYNCHRONOUS, _PHONEME_EVENTS, _UTF8 = 2, 1, 1
_RATE, _PITCH, _RANGE = 1, 3, 4
WORD_EVENT, END_EVENT, PHONEME_EVENT = 1, 5, 7
NO_LIBRARY, NO_VOICE = 3, 4


class _Identity(ctypes.Union):
    _fields_ = [("number", ctypes.c_int), ("name", ctypes.c_char_p), ("string", ctypes.c_char * 8)]


class _Event(ctypes.Structure):
    _fields_ = [("type", ctypes.c_int), ("unique", ctypes.c_uint), ("text_position", ctypes.c_int),
                ("length", ctypes.c_int), ("audio_position", ctypes.c_int), ("sample", ctypes.c_int),
                ("user_data", ctypes.c_void_p), ("id", _Identity)]


_Callback = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.POINTER(ctypes.c_short), ctypes.c_int, ctypes.POINTER(_Event))


def library() -> ctypes.CDLL | None:
    for name in _LIBRARIES:
        try:
            return ctypes.CDLL(name)
        except OSError:
            continue
    return None


def speak_all(phrases: list[dict[str, Any]]) -> dict[str, np.ndarray]:
    """samples_i [n] int16, names_i and events_i [e, 3] (type, text position from 1, sample) of phrase i; rate."""
    espeak = library()
    if espeak is None:
        raise SystemExit(NO_LIBRARY)
    chunks: list[np.ndarray] = []
    events: list[tuple[int, int, int, str]] = []

    def receive(wave: Any, count: int, event: Any) -> int:
        if wave and count > 0:
            chunks.append(np.ctypeslib.as_array(wave, (count,)).copy())
        index = 0
        while event[index].type != 0:
            item = event[index]
            name = bytes(item.id.string).decode("utf-8", "replace") if item.type == PHONEME_EVENT else ""
            events.append((item.type, item.text_position, item.sample, name))
            index += 1
        return 0

    callback = _Callback(receive)
    rate = espeak.espeak_Initialize(_SYNCHRONOUS, 0, None, _PHONEME_EVENTS | 0x8000)
    if rate <= 0:
        raise SystemExit(NO_LIBRARY)
    espeak.espeak_SetSynthCallback(callback)
    result: dict[str, np.ndarray] = {"rate": np.array(rate)}
    for index, phrase in enumerate(phrases):
        if espeak.espeak_SetVoiceByName(phrase["voice"].encode()) != 0:
            raise SystemExit(NO_VOICE)
        for parameter, key in ((_RATE, "rate"), (_PITCH, "pitch"), (_RANGE, "range")):
            espeak.espeak_SetParameter(parameter, int(phrase[key]), 0)
        chunks.clear()
        events.clear()
        text = phrase["text"].encode("utf-8") + b"\0"
        espeak.espeak_Synth(text, len(text), 0, 1, 0, _UTF8, None, None)
        espeak.espeak_Synchronize()
        spoken = [e for e in events if e[0] in (WORD_EVENT, PHONEME_EVENT, END_EVENT)]
        result[f"samples_{index}"] = np.concatenate(chunks) if chunks else np.zeros(0, np.int16)
        result[f"events_{index}"] = np.array([e[:3] for e in spoken], dtype=np.int64).reshape(-1, 3)
        result[f"names_{index}"] = np.array([e[3] for e in spoken], dtype="U8")
    return result


def main() -> None:
    spoken_phrases = speak_all(json.load(sys.stdin))
    with open(sys.argv[1], "wb") as stream:
        np.savez(stream, **spoken_phrases)  # type: ignore[arg-type]
    # The library's clean-up at exit can wait for a thread that never ends.
    sys.stdout.flush()
    os._exit(0)
