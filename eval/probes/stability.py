"""Does the same sound give the same take? Exports, levels, noise and a changed word against the first rendering.

    gesticulator probe stability [--speech FILE ... [--text FILE ...]] [--bundle DIR] [--seeds 2] [--out FILE.json]

Each sound is rendered as it is, then as a tool might export it again: quieter by 0.1, 1 and 6 dB, resampled from
48 kHz, as MP3 at 192 kbit/s, with white noise at -60 dB of full scale. `eval.metrics.eye.stability` tells how far the
take moved, and what is asked of it: a change of level moves nothing, and after any other change the take comes back
within a gesture unit. Another seed shows how far two takes of one sound are apart, and a system that ignores the sound
(the same rendering for every sound) would have 0 everywhere, so these figures count only beside those of synchrony and
meaning.

With transcripts one word in the middle is changed, too: nothing may move before the gesture unit (of either hand, in
either take) in which the word falls, and from the second unit after it on the lexemes must be the old ones again.
"""

from __future__ import annotations

import argparse
import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from scipy.signal import resample_poly

from data_module.errors import InputError
from data_module.speech.audio import SAMPLE_RATE, amplified, load_speech, resample
from data_module.types import Speech
from eval import stats
from eval.claim import Verdict, at_least, at_most, judged, skipped, verdict_table
from eval.clip.measure import real_take
from eval.metrics.eye import stability
from eval.metrics.eye.body import HZ, CommonBody, common_body
from eval.metrics.eye.together import hand_speeds
from eval.metrics.eye.units import gesture_units
from eval.stats import Interval
from eval.table import Cell, Column, Table
from gesticulator.performance import Performance
from gesticulator.pipeline import Gesticulator

_NOISE = 10.0 ** (-60.0 / 20.0)
"""Root mean square of the noise, of full scale 1."""
_STUDIO_RATE, _MP3_RATE = 48000, 192000
"""Hertz of the second sampling rate, and bits a second."""
COLUMNS = {
    "hands": Column("hands apart", "cm", 2, "low"), "joints": Column("joints apart", "cm", 2, "low"),
    "lexemes": Column("other lexemes", "% of time", 1, "low"),
    "apart": Column("a hand over 2 cm apart", "% of time", 1, "low"),
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


LEVELS = ("0.1 dB quieter", "1 dB quieter", "6 dB quieter")
"""The variants in which nothing but the level changes."""
APART, OTHER, HEALED = (2.0, 5.0), (2.0, 10.0), 90.0
"""Centimetres between the hands and percentage of other lexemes, of levels and of other exports; percentage of the
partings after which the hands are together again."""


def verdicts(name: str, figures: Mapping[str, Interval]) -> list[Verdict]:
    """What is asked of a variant, held against its row of the table."""
    other = int(name not in LEVELS)
    out = [judged(f"hands apart, {name}, cm", figures["hands"], at_most(APART[other])),
           judged(f"other lexemes, {name}, %", figures["lexemes"], at_most(OTHER[other]), digits=1)]
    if other:
        told = f"together again within a unit, {name}, % of partings"
        # Takes that never part have nothing to come back from.
        out.append(skipped(told, "they never part") if math.isnan(figures["healed"].mean) else
                   judged(told, figures["healed"], at_least(HEALED), digits=0))
    return out


def arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the probe."""
    parser.add_argument("--speech", nargs="+", type=Path, default=[], metavar="FILE",
                        help="audio files (default: the voice of the real recording in GESTICULATOR_DATA)")
    parser.add_argument("--text", nargs="+", type=Path, default=[], metavar="FILE",
                        help="their transcripts in the same order; then one word is changed, too")
    parser.add_argument("--bundle", metavar="NAME|DIR", help="bundle: default, paper, or a folder (default: default)")
    parser.add_argument("--speaker", metavar="NAME", help="speaker (default: that of the bundle)")
    parser.add_argument("--seeds", type=int, default=2, metavar="N", help="renderings of each sound (default 2)")


def run(arguments: argparse.Namespace) -> Sequence[Table]:
    """The table of how far each variant of a sound moves the take."""
    if arguments.seeds < 1:
        raise InputError("--seeds", f"is {arguments.seeds}", "give 1 or more")
    if len(arguments.text) not in (0, len(arguments.speech)):
        raise InputError("--text", f"names {len(arguments.text)} transcripts of {len(arguments.speech)} sounds",
                         "give one for each sound of --speech")
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
    found = [verdict for name in VARIANTS for verdict in verdicts(name, rows[name])]
    words = _words_changed(system, arguments, sounds)
    found += words[0]
    note = (f"{len(sounds)} sounds, {arguments.seeds} seeds each, speaker "
            f"{system.speakers[system.speaker_index(arguments.speaker)]}. A first parting is left out where there is "
            "none.")
    return [Table("The same sound exported again, against its first rendering", COLUMNS, rows, head="sound",
                  notes=[note], facts={"sounds": list(sounds), "seeds": arguments.seeds}),
            verdict_table("Stability: what is asked of it", found, ["It counts only for weights that pass the "
                          "acceptance of the motion: a constant choice is stable, too."]), *words[1]]


def moved(first: Performance, again: Performance) -> dict[str, float]:
    """The figures of `COLUMNS` of a rendering against the first one."""
    found = stability.difference(common_body(first.motion), common_body(again.motion))
    figures = asdict(found)
    other = stability.other_lexemes((first.blocks.edges, first.lexemes), (again.blocks.edges, again.lexemes))
    return {key: other if key == "lexemes" else figures[key] for key in COLUMNS}


# -------------------------------------------------------------------------------------------------------- one word

def word_changed(speech: Speech) -> tuple[Speech, float]:
    """The longest word in the middle third becomes the longest other word of the transcript, at its time; and when it
    begins, seconds. InputError where there are not two words."""
    words = [word for word in speech.words or () if word.text.strip()]
    middle = words[len(words) // 3:max(2 * len(words) // 3, len(words) // 3 + 1)]
    chosen = max(middle, key=lambda word: len(word.text), default=None)
    others = [word.text for word in words if chosen is not None and word.text.lower() != chosen.text.lower()]
    if chosen is None or not others:
        raise InputError("--text", "holds fewer than two words", "give the transcript of what is said")
    longest = max(others, key=len)
    changed = tuple(replace(word, text=longest) if word is chosen else word for word in speech.words or ())
    return replace(speech, words=changed), chosen.start


def units_of(body: CommonBody) -> list[tuple[float, float]]:
    """Seconds from and to of the gesture units of a motion; those of both hands that overlap are one."""
    speed, active = hand_speeds(body), np.zeros(len(body), bool)
    for hand in (0, 1):
        for begin, stop in gesture_units(body.hands[:, hand, 1], speed[:, hand]):
            active[begin:stop] = True
    return [(begin / HZ, stop / HZ) for begin, stop in stats.runs(active).tolist()]


def moved_by_word(first: Performance, again: Performance, time: float) -> dict[str, float]:
    """The figures of `WORD_COLUMNS` after a change of the word at a time. NaN for what the motion is too short for."""
    one, two = common_body(first.motion), common_body(again.motion)
    units, news = units_of(one), units_of(two)
    at, new = _unit_at(units, time), _unit_at(news, time)
    # The new word may call for a gesture that is prepared earlier than that of the old one.
    begin = min([time, *(unit[0] for unit in (*units[at:at + 1], *news[new:new + 1]))])
    before = stability.difference(one.crop(0, round(begin * HZ)), two.crop(0, round(begin * HZ))).hands \
        if begin > 1.0 else math.nan
    if at + 2 >= len(units):
        return {"before": before, "after": math.nan}
    late = int(np.searchsorted(first.blocks.edges[:-1], units[at + 2][0]))
    rest = first.blocks.edges[late:], first.lexemes[late:]
    return {"before": before, "after": stability.other_lexemes(rest, (again.blocks.edges, again.lexemes))}


def _unit_at(units: Sequence[tuple[float, float]], time: float) -> int:
    """The index of the unit at a time, or of the next one; their number without any."""
    return next((k for k, (_, stop) in enumerate(units) if stop > time), len(units))


WORD_COLUMNS = {"before": Column("hands apart before its unit", "cm", 2, "low"),
                "after": Column("other lexemes from the second unit after it", "%", 1, "low")}
_NOTHING, _AFTER = 0.01, 5.0
"""Centimetres that count as nothing, and percentage of other lexemes."""


def _words_changed(system: Gesticulator, arguments: argparse.Namespace, sounds: Mapping[str, Speech]
                   ) -> tuple[list[Verdict], list[Table]]:
    """What one changed word does to every sound with a transcript."""
    if not arguments.text:
        return [], []
    rows: dict[str, dict[str, Cell]] = {}
    values: dict[str, list[float]] = {key: [] for key in WORD_COLUMNS}
    for (name, speech), text in zip(sounds.items(), arguments.text, strict=True):
        said, _ = system.read(speech, text)
        changed, time = word_changed(said)
        found = [moved_by_word(system(said, seed=seed, speaker=arguments.speaker),
                               system(changed, seed=seed, speaker=arguments.speaker), time)
                 for seed in range(arguments.seeds)]
        for key in WORD_COLUMNS:
            values[key] += [own[key] for own in found]
        rows[name] = {key: stats.mean_interval([own[key] for own in found]) for key in WORD_COLUMNS}
    means = {key: stats.mean_interval(own) for key, own in values.items()}
    titles = "hands apart before the unit of a changed word, cm", "other lexemes from the second unit after it, %"
    out = [judged(title, means[key], at_most(bound)) if math.isfinite(means[key].mean) else
           skipped(title, "the sounds are too short")
           for title, key, bound in zip(titles, WORD_COLUMNS, (_NOTHING, _AFTER), strict=True)]
    return out, [Table("One word changed", WORD_COLUMNS, rows, "sound")]


def _sounds(files: Sequence[Path]) -> dict[str, Speech]:
    """At 16 kHz, by name; those that are given, or the voice of the real recording."""
    if files:
        return {file.stem: resample(load_speech(file), SAMPLE_RATE) for file in files}
    take = real_take(HZ)
    if take is None:
        raise InputError("probe stability", "has no sound", "give --speech, or set GESTICULATOR_DATA")
    return {"take": resample(take[1], SAMPLE_RATE)}
