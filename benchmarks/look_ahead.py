"""What each tenth of a second of look-ahead is worth: `python benchmarks/look_ahead.py SPEECH... [--out FILE]`.

Between the two modes of a stream lies one number, the seconds that a block may wait, after its own end is certain, for
the block after it: none in the low mode, as long as it takes in the full one. Below the low mode, a beat is certain
earlier if the longest block is shorter, because the next onset is waited for less long. Both are varied here, on the
shipped bundle. For each setting, over all recordings and seeds:

- late: seconds from the sound at t to the frame of t, without computing (p50, p95, and the largest).
- foreseen: share of blocks that were generated without the block after them.
- same: share of blocks whose lexeme is that of the full mode (where the blocks are the same); moved: mean distance of
  the hands from where the full mode has them at the same time, metres. Noise is keyed by time, so both are what the
  look-ahead changes.
- PMB, its chance level, and how far above chance it is, percent; apart: the same less the full mode's, paired by
  recording and seed, with the 95 % interval.
- speed: of the hands in speech, m/s; acceleration: mean of the hands', m/s^2; blocks: per second.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from realtime import processor

from data_module.files import write_text
from data_module.motion.kinematics import positions_of
from data_module.speech.audio import SAMPLE_RATE, load_speech
from data_module.speech.beats import BeatTracker
from data_module.speech.silence import FRAME, VoiceLevel
from data_module.types import Motion, Speech
from eval.clip.measure import measure
from eval.stats import crossed
from gesticulator.bundle.features import SpeechBlock
from gesticulator.drawing.cutter import TICK, BlockCutter
from gesticulator.options import InferenceOptions
from gesticulator.pipeline import Gesticulator
from gesticulator.stream import Stream

SHORTER = (0.3, 0.4)
"""Longest blocks, seconds, in the low mode; the shipped one is 0.5. The shortest is at most half as long."""
WAITS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)
"""Seconds that a block may wait for the one after it; 0 is the low mode."""


class _Remembered(VoiceLevel):
    """A level that may be asked for twice: a block is cut as the next one, and again as the current one."""

    def __init__(self) -> None:
        super().__init__()
        self._known: dict[float, float] = {}

    def block(self, edge: float) -> float:
        if edge not in self._known:
            self._known[edge] = super().block(edge)
        return self._known[edge]


class WaitingCutter(BlockCutter):
    """Returns a block once the one after it is known, or `wait` seconds after its own end became certain."""

    def __init__(self, *arguments: Any, wait: float, longest: float, share: list[bool], start: float = 0.0) -> None:
        """share: receives for each block whether it was returned without the one after it."""
        super().__init__(*arguments, "low", start)
        beats = self._config.rhythm.beats
        self._beats = BeatTracker(replace(beats, d_max=longest, d_min=min(beats.d_min, longest / 2)), start)
        self._voice = _Remembered()
        self._wait, self._share, self._since = wait, share, dict[float, float]()

    def _ready_blocks(self) -> Iterator[SpeechBlock]:
        now = self._processed / SAMPLE_RATE
        for end, _ in self._edges[1:]:
            if self._ready(end):
                self._since.setdefault(end, now)
        while len(self._edges) > 1 and self._edges[1][0] in self._since:
            known = len(self._edges) > 2 and self._whole(self._edges[2][0])
            if not (known or self._ended or now >= self._since[self._edges[1][0]] + self._wait - 1e-6):
                return
            yield self._next(known)
            del self._edges[0]
            self._rises = [rise for rise in self._rises if rise >= self._edges[0][0] - 1e-6]
            self._forget(self._cut[0].start)

    def _next(self, known: bool) -> SpeechBlock:
        current, before = self._cut_block(self._edges[0][0], *self._edges[1]), self._cut[0] if self._cut else None
        known = known or (len(self._edges) > 2 and self._edges[2][0] in self._since)
        foreseen = not (known or self._ended)
        after = self._cut_block(self._edges[1][0], *self._edges[2]) if known else \
            self._foreseen(current) if foreseen else None
        block = replace(self._encoded(before, current, after), foreseen=foreseen)
        self._share.append(foreseen)
        self._count, self._cut = self._count + 1, [current]
        return block

    def _whole(self, end: float) -> bool:
        """Whether a block with this end is certain, its pauses included, as in the full mode."""
        return self._ended or (self._ready(end) and min(self._pauses.certain, self._quiet.certain) > end / FRAME + 1)


def stream_of(system: Gesticulator, seed: int, setting: tuple[str, float, float], share: list[bool]) -> Stream:
    """A stream with a setting: a mode's name, or "", the wait, and the longest block."""
    mode, wait, longest = setting
    if mode:
        return system.stream(latency=mode, seed=seed)
    options = InferenceOptions.of({"seed": seed})
    cutter = partial(WaitingCutter, system.bundle.config, None, None, wait=wait, longest=longest, share=share)
    return Stream(system.bundle, system.cast(options, False), options, cutter)


@dataclass(frozen=True)
class Performed:
    """One recording. figures: PMB, chance, above chance, speed, acceleration and blocks a second; late: [T] seconds;
    foreseen: of each block; lexemes: by the end of their block, seconds; hands: [T, 2, 3] metres."""

    figures: np.ndarray
    late: np.ndarray
    foreseen: list[bool]
    lexemes: dict[float, int]
    hands: np.ndarray

    def same(self, other: Performed) -> float:
        """Share of equal lexemes; NaN where the blocks are not the same."""
        if self.lexemes.keys() != other.lexemes.keys():
            return math.nan
        return float(np.mean([other.lexemes[end] == lexeme for end, lexeme in self.lexemes.items()]))

    def moved(self, other: Performed) -> float:
        """Mean distance of the hands, metres."""
        return float(np.linalg.norm(self.hands - other.hands, axis=-1).mean())


def performed(system: Gesticulator, speech: Speech, seed: int, setting: tuple[str, float, float]) -> Performed:
    """One recording in a setting."""
    share: list[bool] = []
    stream = stream_of(system, seed, setting, share)
    parts, late = [], []
    for at in range(0, len(speech.samples), TICK):
        part = stream.feed(speech.samples[at:at + TICK])
        late.append(min(at + TICK, len(speech.samples)) / SAMPLE_RATE - part.times)
        parts.append(part)
    parts.append(stream.finish())
    motion = Motion(stream.skeleton, np.concatenate([part.rotations for part in parts]),
                    np.concatenate([part.root_positions for part in parts]), stream.fps)
    clip = measure(motion, speech)
    rhythm = clip.rhythm()
    hands = positions_of(motion)[:, [stream.skeleton.index(hand) for hand in ("RightHand", "LeftHand")]]
    harder = np.linalg.norm(np.diff(hands, 2, axis=0), axis=-1).mean() * stream.fps ** 2
    lexemes = {round(block.end, 6): block.lexeme for part in parts for block in part.blocks}
    figures = np.array([rhythm.pmb, rhythm.chance, rhythm.above_chance, clip.speech_speed, harder,
                        len(lexemes) / speech.duration])
    return Performed(figures, np.concatenate(late), share, lexemes, hands)


def settings(longest: float) -> dict[str, tuple[str, float, float]]:
    """Names -> what is varied."""
    return {"full": ("full", 0.0, 0.0),
            **{f"longest {one:g}": ("", 0.0, one) for one in SHORTER},
            **{f"wait {one:g}": ("", one, longest) for one in WAITS}}


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("speech", nargs="+")
    p.add_argument("--seeds", type=int, default=3)
    p.add_argument("--seconds", type=float, default=float("inf"), help="of each recording")
    p.add_argument("--out", type=Path)
    a = p.parse_args()
    torch.set_num_threads(1)
    system, begin = Gesticulator.from_pretrained(), time.process_time()
    read = [load_speech(name) for name in a.speech]
    recordings = [Speech(one.samples[:round(min(a.seconds, one.duration) * SAMPLE_RATE)], SAMPLE_RATE) for one in read]
    seconds = [one.duration for one in recordings]
    system.warm()
    report: dict[str, Any] = {"processor": processor(), "files": [Path(name).name for name in a.speech],
                              "seconds": round(sum(seconds), 1), "seeds": a.seeds, "settings": {}}
    full: list[list[Performed]] = []
    for name, setting in settings(system.bundle.config.rhythm.beats.d_max).items():
        made = [[performed(system, speech, seed, setting) for speech in recordings] for seed in range(a.seeds)]
        full = full or made
        values, theirs = (np.array([[one.figures for one in row] for row in of]) for of in (made, full))
        late = np.concatenate([one.late for row in made for one in row])
        share = [foreseen for row in made for one in row for foreseen in one.foreseen]
        pairs = [(one, other) for row, others in zip(made, full, strict=True)
                 for one, other in zip(row, others, strict=True)]
        same = float(np.mean([one.same(other) for one, other in pairs]))
        means = np.average(values, axis=1, weights=seconds).mean(axis=0)
        apart = crossed(values[..., 2] - theirs[..., 2], seconds)
        report["settings"][name] = {
            "late": dict(zip(("p50", "p95", "max"), np.percentile(late, [50, 95, 100]).round(3).tolist(), strict=True)),
            "foreseen": round(float(np.mean(share)), 3) if share else 0.0,
            "same": None if math.isnan(same) else round(same, 3),
            "moved": round(float(np.mean([one.moved(other) for one, other in pairs])), 4),
            **dict(zip(("pmb", "chance", "above_chance"), means[:3].round(1).tolist(), strict=True)),
            "apart": [round(float(one), 1) for one in (apart.mean, apart.low, apart.high)],
            **dict(zip(("speed", "acceleration", "blocks"), means[3:].round(3).tolist(), strict=True))}
        print(name, json.dumps(report["settings"][name]), flush=True)
    report["processor_seconds"] = round(time.process_time() - begin)
    if a.out:
        write_text(a.out, json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
