"""Does motion change over minutes? `python benchmarks/drift.py STORE [--bundle DIR] [--minutes 5] [--limit 3]`.

Readings of the test split, one after the other until so many minutes are full, are gestured for as one recording. Each
half minute has three figures: the mean place of both hands, how fast they move, and how far they spread about that
place. Drift is how far the mean place lies from that of the first half minute; a system that forgets nothing and
accumulates nothing is no farther off after five minutes than after one. The slopes are those of least squares over the
half minutes after the first, by recording. Beside it stands the performer: half minutes of other recordings of the same
speaker against each other, which is how far two pieces of one person lie apart without any drift.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from data_module.motion.phases import hand_places
from data_module.speech import audio
from data_module.types import Array, Samples, Speech
from eval import stats
from eval.context import opened
from eval.renderings import AcceptanceVoice, held_out_voices
from eval.table import Column, Provenance, Table, publish
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.files import INDEX, bundle_folder
from gesticulator.pipeline import Gesticulator

RATE, WINDOW = 20.0, 30.0
"""Hertz; seconds of a window."""


def windows(hands: Array) -> dict[str, Array]:
    """Of hands [T, 2, 3] at `RATE`, by window [N]: drift from the first, cm; speed, m/s; spread about the mean, cm."""
    frames = round(RATE * WINDOW)
    count = max(1, round(len(hands) / frames))
    # Motion ends a few frames before the sound: the last window is then filled with its last frame.
    index = np.minimum(np.arange(count * frames), len(hands) - 1)
    parts = hands[index].reshape(count, frames, 2, 3)
    places = parts.mean(axis=1)
    speed = np.linalg.norm(np.diff(parts, axis=1), axis=-1).mean(axis=(1, 2)) * RATE
    spread = np.linalg.norm(parts - places[:, None], axis=-1).mean(axis=(1, 2))
    return {"drift": 100 * np.linalg.norm(places - places[0], axis=-1).mean(axis=1), "speed": speed,
            "spread": 100 * spread}


def slope(values: Array) -> float:
    """What a figure [N] grows by in a minute, by least squares over the windows after the first."""
    minutes = (np.arange(1, len(values)) + 0.5) * WINDOW / 60
    return float(np.polyfit(minutes, values[1:], 1)[0])


def long_readings(voices: Sequence[AcceptanceVoice], seconds: float) -> Iterator[Speech]:
    """As many recordings of that length as the voices fill, each voice once."""
    held: list[Samples] = []
    for voice in voices:
        held.append(audio.resample(voice.speech, audio.SAMPLE_RATE).samples)
        if sum(map(len, held)) >= seconds * audio.SAMPLE_RATE:
            yield Speech(np.concatenate(held)[:round(seconds * audio.SAMPLE_RATE)], audio.SAMPLE_RATE)
            held = []


def apart(voices: Sequence[AcceptanceVoice]) -> list[float]:
    """Centimetres between the mean hands of half minutes of two recordings of one speaker, for each pair."""
    places = [(voice.performer, hand_places(voice.own, RATE)[:round(RATE * WINDOW)].mean(axis=0)) for voice in voices
              if voice.own is not None and voice.own.duration >= WINDOW]
    return [100 * float(np.linalg.norm(one - other, axis=-1).mean())
            for (first, one), (second, other) in combinations(places, 2) if first == second]


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("store", help="a store built by `gesticulator build`")
    p.add_argument("--bundle", metavar="NAME|DIR", help="bundle: default, paper, or a folder (default: default)")
    p.add_argument("--minutes", type=float, default=5.0)
    p.add_argument("--limit", type=int, default=3, help="recordings, at most")
    p.add_argument("--out")
    a = p.parse_args()
    store, _ = opened(a.store, None)
    folder = bundle_folder(a.bundle)
    system = Gesticulator(bundles.load(folder))
    voices = held_out_voices(store, None, system.bundle.config.motion.joints, seconds=60.0)
    found = []
    for number, speech in enumerate(long_readings(voices, 60 * a.minutes)):
        if number == a.limit:
            break
        found.append(windows(hand_places(system(speech, seed=number).motion, RATE)))
        print({key: values.round(2).tolist() for key, values in found[-1].items()}, flush=True)
    columns = {key: Column(title, unit, digits) for key, title, unit, digits in (
        ("drift", "hands from the first half minute", "cm", 1), ("speed", "hand speed", "m/s", 3),
        ("spread", "spread of the hands", "cm", 1))}
    count = min(len(one["drift"]) for one in found)
    rows = {f"{WINDOW * k / 60:g} to {WINDOW * (k + 1) / 60:g} min": {
        key: stats.mean_interval([one[key][k] for one in found]) for key in columns} for k in range(count)}
    rows["growth in a minute"] = {key: stats.mean_interval([slope(one[key]) for one in found]) for key in columns}
    rows["performer, two recordings of one speaker"] = {"drift": stats.mean_interval(apart(voices))}
    publish([Table("Motion over minutes", columns, rows, "time", [
        f"{len(found)} recordings of {a.minutes:g} minutes, made of readings of the test split; bootstrap 95 % "
        "intervals over recordings. A growth whose interval holds zero is no drift."])], a.out, Provenance.now(
            shlex.join(["python", "benchmarks/drift.py", *sys.argv[1:]]), folder / INDEX))


if __name__ == "__main__":
    main()
