"""Does the same sound give the same take? Exports, levels, noise and a changed word against the first rendering.

    gesticulator probe stability [--speech FILE ...] [--bundle DIR] [--seeds 2] [--out FILE.json]

Each sound is rendered as it is, then as a tool might export it again: quieter by 0.1, 1 and 6 dB, resampled from
48 kHz, as MP3 at 192 kbit/s, with white noise at -60 dB of full scale. `eval.metrics.eye.stability` tells how far the
take moved. Another seed shows how far two takes of one sound are apart, and a system that ignores the sound (the same
rendering for every sound) would have 0 everywhere, so these figures count only beside those of synchrony and meaning.
"""

from __future__ import annotations

import argparse
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from scipy.signal import resample_poly

from data_module.errors import InputError
from data_module.speech.audio import SAMPLE_RATE, amplified, load_speech, resample
from data_module.types import Speech
from eval import stats
from eval.clip.measure import real_take
from eval.metrics.eye import stability
from eval.metrics.eye.body import HZ, common_body
from eval.table import Column, Table
from gesticulator.performance import Performance
from gesticulator.pipeline import Gesticulator

_NOISE = 10.0 ** (-60.0 / 20.0)
"""Root mean square of the noise, of full scale 1."""
_STUDIO_RATE, _MP3_RATE = 48000, 192000
"""Hertz of the second sampling rate, and bits a second."""
COLUMNS = {
    "hands": Column("hands apart", "cm", 2, "low"), "joints": Column("joints apart", "cm", 2, "low"),
    "lexemes": Column("other lexemes", "%", 1, "low"), "apart": Column("a hand over 2 cm apart", "% of time", 1, "low"),
    "healed": Column("together again within 5 s", "%", 0, "high"), "first": Column("first parting", "s", 2),
    "speed": Column("hand speeds, r", "", 2, "high")}


def _quieter(decibels: float) -> Callable[[Speech], Speech]:
    return lambda speech: amplified(speech, -decibels)


def _resampled(speech: Speech) -> Speech:
    """At 48 kHz and back, by a polyphase filter that the product does not use."""
    up = resample_poly(speech.samples.astype(np.float64), _STUDIO_RATE // SAMPLE_RATE, 1)
    return replace(speech, samples=resample_poly(up, 1, _STUDIO_RATE // SAMPLE_RATE).astype(np.float32))


def _noisy(speech: Speech) -> Speech:
    noise = _NOISE * np.random.default_rng(0).standard_normal(len(speech.samples))
    return replace(speech, samples=np.clip(speech.samples + noise, -1.0, 1.0).astype(np.float32))


def _as_mp3(speech: Speech) -> Speech:
    """Encoded at 48 kHz and 192 kbit/s and decoded again; the delay of the encoder is taken off."""
    try:
        import av
    except ImportError:
        raise InputError("probe stability", "needs av for MP3", 'pip install "gesticulator[video]"') from None
    up = resample_poly(speech.samples.astype(np.float64), _STUDIO_RATE // SAMPLE_RATE, 1).astype(np.float32)
    file = io.BytesIO()
    with av.open(file, "w", format="mp3") as output:
        stream = output.add_stream("mp3", rate=_STUDIO_RATE, layout="mono")
        stream.bit_rate = _MP3_RATE
        frame = av.AudioFrame.from_ndarray(np.clip(up, -1.0, 1.0)[None], format="fltp", layout="mono")
        frame.sample_rate = _STUDIO_RATE
        for packet in (*stream.encode(frame), *stream.encode(None)):
            output.mux(packet)
    file.seek(0)
    with av.open(file, "r") as source:
        decoded = np.concatenate([frame.to_ndarray()[0] for frame in source.decode(audio=0)])
    back = resample_poly(decoded.astype(np.float64), 1, _STUDIO_RATE // SAMPLE_RATE)
    return replace(speech, samples=_aligned(back, speech.samples).astype(np.float32))


def _aligned(samples: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Samples moved to where they fit the reference best, and cut or padded to its length."""
    size = len(reference) + len(samples)
    spectrum = np.fft.rfft(samples, size) * np.conj(np.fft.rfft(reference, size))
    shift = int(np.fft.irfft(spectrum, size).argmax())
    shift -= size if shift > size // 2 else 0
    moved = samples[shift:] if shift >= 0 else np.concatenate([np.zeros(-shift), samples])
    return np.pad(moved, (0, max(len(reference) - len(moved), 0)))[:len(reference)]


VARIANTS: Mapping[str, Callable[[Speech], Speech]] = {
    "0.1 dB quieter": _quieter(0.1), "1 dB quieter": _quieter(1.0), "6 dB quieter": _quieter(6.0),
    "resampled from 48 kHz": _resampled, "MP3, 192 kbit/s": _as_mp3, "noise at -60 dB": _noisy}


def arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the probe."""
    parser.add_argument("--speech", nargs="+", type=Path, default=[], metavar="FILE",
                        help="audio files (default: the voice of the real recording in GESTICULATOR_DATA)")
    parser.add_argument("--bundle", metavar="DIR", help="bundle (default: the shipped one)")
    parser.add_argument("--speaker", metavar="NAME", help="speaker (default: that of the bundle)")
    parser.add_argument("--seeds", type=int, default=2, metavar="N", help="renderings of each sound (default 2)")


def run(arguments: argparse.Namespace) -> Sequence[Table]:
    """The table of how far each variant of a sound moves the take."""
    if arguments.seeds < 1:
        raise InputError("--seeds", f"is {arguments.seeds}", "give 1 or more")
    system = Gesticulator.from_pretrained(arguments.bundle)
    system.speaker_index(arguments.speaker)
    sounds = _sounds(arguments.speech)
    values: dict[str, list[dict[str, float]]] = {name: [] for name in (*VARIANTS, "another seed")}
    for speech in sounds.values():
        for seed in range(arguments.seeds):
            first = system(speech, seed=seed, speaker=arguments.speaker)
            for name, change in VARIANTS.items():
                values[name].append(moved(first, system(change(speech), seed=seed, speaker=arguments.speaker)))
            other = system(speech, seed=seed + arguments.seeds, speaker=arguments.speaker)
            values["another seed"].append(moved(first, other))
    rows = {name: {key: stats.mean_interval([row[key] for row in found]) for key in COLUMNS}
            for name, found in values.items()}
    note = (f"{len(sounds)} sounds, {arguments.seeds} seeds each, speaker "
            f"{system.speakers[system.speaker_index(arguments.speaker)]}. A first parting is left out where there is "
            "none.")
    return [Table("The same sound exported again, against its first rendering", COLUMNS, rows, head="sound",
                  notes=[note], facts={"sounds": list(sounds), "seeds": arguments.seeds})]


def moved(first: Performance, again: Performance) -> dict[str, float]:
    """The figures of `COLUMNS` of a rendering against the first one."""
    found = stability.difference(common_body(first.motion), common_body(again.motion))
    figures = asdict(found)
    other, _ = stability.other_lexemes(first.lexemes.tolist(), again.lexemes.tolist())
    return {key: other if key == "lexemes" else figures[key] for key in COLUMNS}


def _sounds(files: Sequence[Path]) -> dict[str, Speech]:
    """At 16 kHz, by name; those that are given, or the voice of the real recording."""
    if files:
        return {file.stem: resample(load_speech(file), SAMPLE_RATE) for file in files}
    take = real_take(HZ)
    if take is None:
        raise InputError("probe stability", "has no sound", "give --speech, or set GESTICULATOR_DATA")
    return {"take": resample(take[1], SAMPLE_RATE)}
