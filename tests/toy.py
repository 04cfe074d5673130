"""A toy corpus: nine recordings of twenty seconds, as BVH, WAV and JSON with the words, for `build folder`.

    python tests/toy.py FOLDER

The speech is made of vowels of known times: harmonics of a voice with two formants, between phrases of silence. The
motion is a gesture at every content word, whose stroke ends on the vowel; which gesture it is depends on the word, and
its size on the loudness of the phrase. So there is something to learn for every stage, in seconds and without data.
"""

import sys
from pathlib import Path

import numpy as np
import soundfile
from scipy.ndimage import gaussian_filter1d

from data_module.corpora.folder import write_recording
from data_module.motion import rotation
from data_module.motion.kinematics import minimum_jerk
from data_module.motion.skeletons import CHARACTER, HIP_HEIGHT
from data_module.store import Recording, RecordingInfo, Split
from data_module.types import Array, Motion, Speech, Word

RATE, FPS, SECONDS = 16000, 60.0, 20.0
SPLITS: tuple[Split, ...] = ("train", "train", "train", "train", "val", "train", "train", "test", "test")
PITCH = {"train": 110.0, "val": 110.0, "test": 190.0}
"""Hertz. The voice of the test split is another one."""
FILLERS = ("the", "of", "and", "in")
# The gesture of each content word: (hands, angles in radians of upper arm (3) and forearm (1) at its end).
GESTURES: dict[str, tuple[str, tuple[float, ...]]] = {
    "big": ("both", (0.2, -0.5, -0.9, -0.9)), "whole": ("both", (0.1, -0.4, -0.8, -1.1)),
    "wind": ("right", (0.0, -0.6, -1.1, -1.0)), "stone": ("right", (0.2, -0.5, -1.2, -0.8)),
    "you": ("right", (0.0, -1.2, -1.0, -0.3)), "there": ("left", (0.1, -1.0, -0.8, -0.2)),
    "high": ("left", (0.3, -0.7, -0.4, -1.3)), "river": ("left", (0.1, -0.6, -1.2, -1.1)),
}
HANGING = np.array([0.0, -0.1, -1.35, -0.25])
"""The same angles of an arm at rest."""
PREPARATION, STROKE, HOLD, RETRACTION = 0.30, 0.20, 0.25, 0.45
"""Seconds of the phases of a gesture."""
BRAKING = 0.5 + 3 ** 0.5 / 6
"""Where a minimum-jerk movement brakes hardest, as a share of its time: its third derivative is 0 there."""
FORMANTS = ((700.0, 1200.0), (350.0, 2200.0), (550.0, 900.0))
"""Hertz, of a, i and o."""


def _vowel(seconds: float, pitch: float, formants: tuple[float, float]) -> Array:
    """[samples] of a voice: the harmonics of `pitch` up to 4 kHz, louder near the formants, faded in within 15 ms."""
    times = np.arange(round(seconds * RATE)) / RATE
    harmonics = pitch * np.arange(1, int(4000 / pitch))
    loudness = sum(np.exp(-0.5 * ((harmonics - formant) / 150.0) ** 2) for formant in formants) + 0.02
    fade = np.minimum(1.0, np.minimum(times, times[::-1]) / 0.015)
    wave = (loudness[:, None] * np.sin(2 * np.pi * harmonics[:, None] * times)).sum(axis=0)
    return np.asarray(fade * wave / np.sqrt(np.mean(wave ** 2)))


def recording(number: int, seed: int = 5) -> Recording:
    """Recording `number` of the corpus, with the times of its words."""
    rng = np.random.default_rng([seed, number])
    split = SPLITS[number]
    samples = 3e-4 * rng.normal(size=round(SECONDS * RATE))
    words: list[Word] = []
    content: list[tuple[float, str, float]] = []  # onset of the vowel, word, effort of its phrase
    clock = 0.5
    while clock < SECONDS - 4.5:
        effort = float(rng.uniform(-1.0, 1.0))
        for place in range(int(rng.integers(4, 9))):
            filler = place % 3 == 1
            text = str(rng.choice(FILLERS if filler else list(GESTURES)))
            length = float(rng.uniform(0.12, 0.16) if filler else rng.uniform(0.22, 0.34))
            pitch = PITCH[split] * 2 ** ((0.0 if filler else 2.5) / 12 - 0.02 * place)
            level = 0.05 * 10 ** ((6.0 * effort - (6.0 if filler else 0.0)) / 20)
            vowel = clock + 0.05
            sound = level * _vowel(length, pitch, FORMANTS[len(text) % 3])
            at = round(vowel * RATE)
            samples[round(clock * RATE):at] += 0.3 * level * rng.normal(size=at - round(clock * RATE))  # the consonant
            samples[at:at + len(sound)] += sound
            words.append(Word(text, clock, vowel + length))
            if not filler:
                content.append((vowel, text, effort))
            clock = vowel + length + float(rng.uniform(0.01, 0.04))
        clock += float(rng.uniform(0.7, 1.6))
    speech = Speech(samples.clip(-1, 1).astype(np.float32), RATE, tuple(words))
    info = RecordingInfo(f"talk_{number:04d}_puppet", split, "puppet", f"voice_{PITCH[split]:.0f}", "en",
                         group=f"talk_{number:04d}_puppet")
    return Recording(info, speech, _gestures(content, rng, split), stands=True)


def _gestures(content: list[tuple[float, str, float]], rng: np.random.Generator, split: Split) -> Motion:
    """A gesture at each content word, if its hands are at rest: up, down to the target with the hardest braking at the
    beat, a hold, and back to rest. A third of the test split's are variants that occur in no other split."""
    times = np.arange(round(SECONDS * FPS)) / FPS
    arms = {side: np.tile(HANGING, (len(times), 1)) for side in ("left", "right")}
    free = {"left": 0.0, "right": 0.0}
    for place, (vowel, word, effort) in enumerate(content):
        hands, target = GESTURES[word]
        beat = vowel + float(rng.normal(0.0, 0.03))
        start = beat - BRAKING * STROKE - PREPARATION
        sides = ("left", "right") if hands == "both" else (hands,)
        if start < max(free[side] for side in sides):
            continue
        held_out = split == "test" and place % 3 == 0
        gain = (1.0 + 0.3 * effort) * (1.25 if held_out else 1.0)
        hold_end = beat + HOLD
        for side in sides:
            free[side] = hold_end + RETRACTION
            away = gain * (np.array(target) - HANGING)
            ready = away + np.array([0.0, -0.25, 0.45, -0.3]) * gain
            phases = ((ready, start, PREPARATION), (away - ready, start + PREPARATION, STROKE),
                      (-away, hold_end, RETRACTION))
            for change, begin, length in phases:
                arms[side] += change * minimum_jerk(np.clip((times - begin) / length, 0.0, 1.0))[:, None]
    maps = 0.02 * gaussian_filter1d(rng.normal(size=(len(times), len(CHARACTER), 3)), 30.0, axis=0) * 30.0 ** 0.5
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        angles = arms[side.lower()]
        maps[:, CHARACTER.index(side + "Arm")] += angles[:, :3] * [1.0, sign, sign]
        maps[:, CHARACTER.index(side + "ForeArm"), 1] += sign * angles[:, 3]
    turns = rotation.continuous(rotation.from_exponential_map(maps))
    return Motion(CHARACTER, turns, np.tile([0.0, HIP_HEIGHT, 0.0], (len(times), 1)), FPS)


def write(folder: Path, seed: int = 5) -> int:
    """Write the corpus into a new folder: NAME.bvh, NAME.wav and NAME.json. Returns 0, as a command does."""
    folder.mkdir(parents=True)
    for number in range(len(SPLITS)):
        made = recording(number, seed)
        write_recording(folder, made)
        soundfile.write(folder / f"{made.info.name}.wav", made.speech.samples, RATE, subtype="PCM_16")
    return 0


if __name__ == "__main__":
    sys.exit(write(Path(sys.argv[1])))
