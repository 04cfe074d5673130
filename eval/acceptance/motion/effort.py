"""Does the motion follow the effort of a voice, and not its level?

Every reading in GESTICULATOR_DATA is said again twice by Praat (Boersma and Weenink; PSOLA, Moulines and Charpentier
1990): lively, with a wide pitch range, a flat spectrum and a fast rate, and subdued, with all of them the other way
round. Both have the level of the reading. With the same seed, size is the median stroke amplitude and speed the mean
hand speed in speech; what is asked is the ratio of lively to subdued, the geometric mean over readings of the better of
the two, and in how many readings it has the right order. A reading that is 6 dB quieter must be the same take.

The model has heard voices of the corpus, whose effort was planted by rules of another program; here is none of it. What
fools it: rate alone makes strokes faster. Amplitude does not gain by that, so both are shown.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from data_module.corpora.folder import SOUNDS
from data_module.speech.audio import SAMPLE_RATE, amplified, load_speech, resample
from data_module.types import Array, Speech
from eval import stats
from eval.claim import Verdict, at_least, at_most, judged, skipped
from eval.metrics import eye
from eval.metrics.eye import common_body, hear
from eval.metrics.eye.stability import difference
from eval.renderings import AcceptanceVoice, BundleSystem
from eval.stats import Interval
from eval.table import Column, Table

READINGS = "speech"
"""Folder of GESTICULATOR_DATA."""
FIGURES = {"size": "eye_stroke_amplitude", "speed": "eye_speech_speed"}
RATIO, ORDERED = 1.2, 0.8
"""Least ratio of lively to subdued, and share of the readings in which it is over 1."""
QUIETER, SAME = 6.0, 2.0
"""Decibels, and centimetres between the hands of the two takes."""
_LOWEST, _HIGHEST = 60.0, 500.0
_TILT_FROM, _TILT_TO = 500.0, 4000.0
"""Hertz between which the spectrum is tilted."""
_LOUD = 25.0
"""Decibels under the loudest frame that count for the level."""


@dataclass(frozen=True)
class VocalEffort:
    """pitch: factor on the distance from the median pitch, in semitones; tilt: dB an octave over 500 Hz; rate: factor
    on the rate of speech."""

    pitch: float
    tilt: float
    rate: float


LIVELY, SUBDUED = VocalEffort(1.8, 3.0, 1.15), VocalEffort(0.5, -3.0, 0.87)


def said_with(speech: Speech, effort: VocalEffort) -> Speech:
    """A reading with another effort at its own level, without its words. ImportError without praat-parselmouth."""
    import parselmouth
    from parselmouth.praat import call

    sound = parselmouth.Sound(speech.samples.astype(np.float64), speech.sample_rate)
    manipulation = call(sound, "To Manipulation", 0.01, _LOWEST, _HIGHEST)
    pitch = call(manipulation, "Extract pitch tier")
    if call(pitch, "Get number of points"):
        median = float(np.median([call(pitch, "Get value at index", k + 1)
                                  for k in range(call(pitch, "Get number of points"))]))
        call(pitch, "Formula", f"{median} * exp({effort.pitch} * ln(self / {median}))")
        call([pitch, manipulation], "Replace pitch tier")
    lasting = call("Create DurationTier", "rate", 0, speech.duration)
    call(lasting, "Add point", 0, 1.0 / effort.rate)
    call([lasting, manipulation], "Replace duration tier")
    samples = np.asarray(call(manipulation, "Get resynthesis (overlap-add)").values[0], dtype=np.float64)
    samples = tilted(samples, speech.sample_rate, effort.tilt)
    own = loudness(speech.samples.astype(np.float64), speech.sample_rate)
    gain = own / max(loudness(samples, speech.sample_rate), 1e-9)
    return replace(speech, samples=(gain * samples).astype(np.float32), words=None)


def tilted(samples: Array, rate: int, decibels: float) -> Array:
    """Samples [n] whose spectrum rises by so many dB an octave from 500 to 4000 Hz."""
    spectrum, frequencies = np.fft.rfft(samples), np.fft.rfftfreq(len(samples), 1.0 / rate)
    octaves = np.log2(np.clip(frequencies, _TILT_FROM, _TILT_TO) / _TILT_FROM)
    return np.asarray(np.fft.irfft(spectrum * 10.0 ** (decibels * octaves / 20.0), len(samples)))


def loudness(samples: Array, rate: int) -> float:
    """Root mean square of the frames of 20 ms that are within 25 dB of the loudest one."""
    size = round(0.02 * rate)
    power = (samples[:len(samples) // size * size].reshape(-1, size) ** 2).mean(axis=1)
    return float(np.sqrt(power[power >= power.max() * 10.0 ** (-_LOUD / 10.0)].mean()))


# ----------------------------------------------------------------------------------------------------------- clauses

def clauses(values: Array, apart: Sequence[float]) -> list[Verdict]:
    """values: [figures, lively and subdued, readings] of `FIGURES`; apart: cm between the hands of each reading and the
    same reading 6 dB quieter."""
    logs = np.log(values[:, 0] / values[:, 1])
    best = int(np.nanargmax(np.nanmean(logs, axis=1)))
    told = ", ".join(f"{name} {np.exp(np.nanmean(own)):.2f}, in order in {int((own > 0).sum())} of {len(own)}"
                     for name, own in zip(FIGURES, logs, strict=True))
    mean = stats.mean_interval(logs[best])
    ratio = Interval(math.exp(mean.mean), math.exp(mean.low), math.exp(mean.high), mean.n)
    which = list(FIGURES)[best]
    return [judged("size or speed, lively over subdued reading", ratio, at_least(RATIO), reason=told),
            judged("readings in the right order, share", stats.mean_interval((logs[best] > 0).astype(float)),
                   at_least(ORDERED), reason=f"by {which}"),
            judged("hands apart, a reading 6 dB quieter, cm", stats.mean_interval(apart), at_most(SAME))]


# ------------------------------------------------------------------------------------------------------------- group

def readings() -> list[tuple[str, Speech]]:
    """Those of the outside data, at the models' rate; none without it."""
    place = os.environ.get("GESTICULATOR_DATA")
    files = sorted((Path(place) / READINGS).glob("*")) if place else []
    return [(file.stem, resample(load_speech(file), SAMPLE_RATE)) for file in files if file.suffix.lower() in SOUNDS]


def run(ours: BundleSystem, speaker: str | None, renderings: int) -> tuple[list[Verdict], list[Table]]:
    """Everything of this group; two seeds of every reading."""
    name = "size or speed, lively over subdued reading"
    try:
        import parselmouth  # noqa: F401 - fail before anything is rendered
    except ImportError:
        return [skipped(name, "praat-parselmouth is not installed (pip install 'gesticulator[effort]')")], []
    found = readings()
    if not found:
        return [skipped(name, f"GESTICULATOR_DATA has no folder {READINGS}")], []
    seeds = range(min(2, renderings))
    values = np.array([[_measured(ours, speaker, f"{stem} {told}", said_with(speech, effort), seeds)
                        for stem, speech in found] for told, effort in (("lively", LIVELY), ("subdued", SUBDUED))])
    values = values.transpose(2, 0, 1)
    apart = [_apart(ours, speaker, stem, speech) for stem, speech in found]
    return clauses(values, apart), [_table([stem for stem, _ in found], values, apart)]


def _voice(name: str, speech: Speech, speaker: str | None) -> AcceptanceVoice:
    return AcceptanceVoice(name, replace(speech, words=None), "made", None, speaker, name)


def _measured(ours: BundleSystem, speaker: str | None, name: str, speech: Speech, seeds: Sequence[int]) -> list[float]:
    """`FIGURES` of a sound, the mean of its seeds."""
    voice = _voice(name, speech, speaker)
    rows = [eye.figures(ours.render(voice, seed).motion, hear(speech)) for seed in seeds]
    return [float(np.mean([row[figure] for row in rows])) for figure in FIGURES.values()]


def _apart(ours: BundleSystem, speaker: str | None, name: str, speech: Speech) -> float:
    """Centimetres between the hands of a reading and of the same reading with another level."""
    first, second = (common_body(ours.render(_voice(name, sound, speaker), 0).motion)
                     for sound in (speech, amplified(speech, -QUIETER)))
    return difference(first, second).hands


def _table(names: Sequence[str], values: Array, apart: Sequence[float]) -> Table:
    """Every reading by itself."""
    columns = {f"{figure} {told}": Column(f"{figure}, {told}", "cm" if figure == "size" else "m/s", 2)
               for figure in FIGURES for told in ("lively", "subdued")}
    rows = {name: {**{f"{figure} {told}": float(values[i, j, k]) for i, figure in enumerate(FIGURES)
                      for j, told in enumerate(("lively", "subdued"))}, "apart": apart[k]}
            for k, name in enumerate(names)}
    return Table("Readings with another effort", {**columns, "apart": Column("hands apart at -6 dB", "cm", 2)}, rows,
                 "reading")
