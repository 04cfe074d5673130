"""Use audio that is already in memory, such as the output of a speech synthesiser.

    python examples/samples.py gesture.bvh
"""

from __future__ import annotations

import sys

import numpy as np

from gesticulator import Gesticulator

SAMPLE_RATE = 24_000


def synthesise(seconds: float = 4.0) -> np.ndarray:
    """A stand-in for your synthesiser: three vowel-like bursts a second, [n] in [-1, 1]."""
    time = np.arange(round(seconds * SAMPLE_RATE)) / SAMPLE_RATE
    syllables = np.clip(np.sin(2 * np.pi * 3 * time), 0, 1) ** 2
    vowel = sum(np.sin(2 * np.pi * 130 * k * time) / k for k in range(1, 8))
    return 0.2 * syllables * vowel


def main(output: str) -> None:
    """Samples [n] (or [n, channels]) and their rate are all that is asked for."""
    gesture = Gesticulator.from_pretrained()(synthesise(), SAMPLE_RATE)
    print(f"{len(gesture.motion)} frames at {gesture.fps:g} per second -> {gesture.save(output)}")


if __name__ == "__main__":
    main(*sys.argv[1:])
