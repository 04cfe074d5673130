"""What each tenth of a second of look-ahead is worth: `python benchmarks/look_ahead.py [SPEECH...] [--store STORE]
[--seconds 16] [--minutes 25] [--out docs/results/look_ahead]`.

Between the two modes of a stream lies one number, the seconds that a block may wait, after its own end is certain, for
the block after it: none in the low mode, as long as it takes in the full one. Below the low mode, a beat is certain
earlier if the longest block is shorter, because the next onset is waited for less long. Both are varied here, on the
shipped bundle, over recordings (of a store, the beginnings of its test split). For each setting:

- late: seconds from the sound at t to the frame of t, without computing (p50, p95, and the largest).
- foreseen: share of blocks that were generated without the block after them.
- same: share of blocks whose lexeme is that of the full mode (where the blocks are the same); moved: mean distance of
  the hands from where the full mode has them at the same time, metres. Noise is keyed by time, so both are what the
  look-ahead changes. The row `another seed` is the full mode with other noise: what chance changes.
- the figures of `FIGURES`, each with its mean, and its mean less the full mode's, paired by recording, with the 95 %
  interval over recordings. A figure whose intervals hold 0 for every setting is not moved by the look-ahead beyond what
  so many recordings show; the half width of the interval says how much that is.

Processor time ends the run after `--minutes`, between two recordings, each of which goes through all settings.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import torch
from realtime import processor

from data_module.files import write_text
from data_module.motion.kinematics import positions_of
from data_module.speech.audio import SAMPLE_RATE, load_speech, resample
from data_module.speech.beats import BeatTracker
from data_module.speech.onsets import detect_onsets
from data_module.speech.silence import FRAME, VoiceLevel
from data_module.store import Store
from data_module.types import Motion, Speech
from eval.clip.measure import measure
from eval.metrics import eye
from eval.metrics.eye.units import leads, sound_figures
from eval.metrics.eye.voice import VoiceActivity
from eval.stats import Interval, mean_interval
from gesticulator.bundle.features import SpeechBlock
from gesticulator.options import InferenceOptions
from gesticulator.pipeline import Gesticulator
from gesticulator.sampling.cutter import TICK, BlockCutter
from gesticulator.stream import Stream

SHORTER = (0.3, 0.4)
"""Longest blocks, seconds, in the low mode; the shipped one is 0.5. The shortest is at most half as long."""
OTHER = "another seed"
"""The full mode with other noise."""
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


FIGURES = {
    "above_chance": ("PMB above chance, %", 0), "loud": ("hand speed with loudness, r", 2),
    "lead": ("first movement from the voice, s", 2), "pause_moving": ("hands moving in pauses, %", 0),
    "held": ("hands held while speaking, %", 0), "speed": ("hands in speech, m/s", 3),
    "acceleration": ("acceleration of the hands, m/s^2", 2), "seam": ("fastest joint at block edges, m/s", 2),
    "blocks": ("blocks a second", 2)}
"""Figure -> its heading and digits. Synchrony: PMB, and the correlation of speed and loudness. Anticipation: the time
of the first movement about the voice's return after a pause, less is earlier. Stillness, pace, smoothness and seams."""


@dataclass(frozen=True)
class Performed:
    """One recording. figures: of `FIGURES`, NaN where undefined; late: [T] seconds; foreseen: of each block; lexemes:
    by the end of their block, seconds; hands: [T, 2, 3] metres."""

    figures: dict[str, float]
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


@dataclass(frozen=True)
class Heard:
    """A recording, and what the figures need of its sound."""

    speech: Speech
    onsets: np.ndarray
    voice: VoiceActivity

    @classmethod
    def of(cls, speech: Speech) -> Heard:
        """Listened to once."""
        return cls(speech, detect_onsets(speech.samples, speech.sample_rate), eye.hear(speech))


def performed(system: Gesticulator, heard: Heard, seed: int, setting: tuple[str, float, float]) -> Performed:
    """One recording in a setting."""
    speech = heard.speech
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
    lexemes = {round(block.end, 6): block.lexeme for part in parts for block in part.blocks}
    hands = positions_of(motion)[:, [stream.skeleton.index(hand) for hand in ("RightHand", "LeftHand")]]
    harder = np.linalg.norm(np.diff(hands, 2, axis=0), axis=-1).mean() * stream.fps ** 2
    return Performed(measured(motion, heard, np.array([0.0, *lexemes])) | {"acceleration": float(harder)},
                     np.concatenate(late), share, lexemes, hands)


def measured(motion: Motion, heard: Heard, edges: np.ndarray) -> dict[str, float]:
    """The figures of a motion but for its acceleration; edges: of its blocks, seconds."""
    clip, body = measure(motion, heard.speech, edges, heard.onsets), eye.common_body(motion)
    beside, first = sound_figures(body, heard.voice), leads(body, heard.voice, 1).seconds
    return {"above_chance": clip.rhythm().above_chance, "loud": beside["eye_loud"],
            "lead": float(first.mean()) if len(first) else math.nan, "pause_moving": beside["eye_pause_moving"],
            "held": beside["eye_held"], "speed": clip.speech_speed, "seam": float(clip.seam_speed.mean()),
            "blocks": (len(edges) - 1) / heard.speech.duration}


def settings(longest: float) -> dict[str, tuple[str, float, float]]:
    """Names -> what is varied."""
    return {"full": ("full", 0.0, 0.0), OTHER: ("full", 0.0, 0.0),
            **{f"longest {one:g}": ("", 0.0, one) for one in SHORTER},
            **{f"wait {one:g}": ("", one, longest) for one in WAITS}}


def summary(made: list[Performed], full: list[Performed], seconds: list[float]) -> dict[str, Any]:
    """A setting's row of the report, beside the full mode's performances of the same recordings."""
    late = np.concatenate([one.late for one in made])
    share = [foreseen for one in made for foreseen in one.foreseen]
    figures = {}
    for name, (_, digits) in FIGURES.items():
        own, theirs = (np.array([one.figures[name] for one in of]) for of in (made, full))
        apart = mean_interval(own - theirs, seconds)
        figures[name] = [round(number, digits + 1) for number in (mean_interval(own, seconds).mean, apart.mean,
                                                                  apart.low, apart.high)]
    same = _of([one.same(other) for one, other in zip(made, full, strict=True)], seconds, 3)
    return {"late": dict(zip(("p50", "p95", "max"), np.percentile(late, [50, 95, 100]).round(3).tolist(), strict=True)),
            "foreseen": round(float(np.mean(share)), 3) if share else 0.0,
            "same": None if math.isnan(same[0]) else same,
            "moved": _of([one.moved(other) for one, other in zip(made, full, strict=True)], seconds, 4),
            "figures": figures}


def _of(values: list[float], seconds: list[float], digits: int) -> list[float]:
    found: Interval = mean_interval(values, seconds)
    return [round(number, digits) for number in (found.mean, found.low, found.high)]


def table(report: dict[str, Any]) -> str:
    """The report as Markdown."""
    lines = ["# Look-ahead", "", f"`{report['command']}`: {report['recordings']} recordings, {report['seconds']:g} s, "
             f"on {report['processor']}, {report['processor_seconds']} s of processor time.", "",
             "| | audio at t to the frame of t, s: p50 / p95 / largest | blocks without the one after them, % | same "
             "lexemes as full, % | hands away from full, cm |", "|---|---|---|---|---|"]
    for name, row in report["settings"].items():
        same = "" if row["same"] is None else f"{100 * row['same'][0]:.0f}"
        late = " / ".join(f"{one:.2f}" for one in row["late"].values())
        lines.append(f"| {name} | {late} | {100 * row['foreseen']:.0f} | {same} | {100 * row['moved'][0]:.1f} |")
    lines += ["", "Less the full mode, paired by recording, with the 95 % interval (in bold where it does not hold 0); "
              "for `full`, the mean:", "", "| | " + " | ".join(title for title, _ in FIGURES.values()) + " |",
              "|---" * (len(FIGURES) + 1) + "|"]
    for name, row in report["settings"].items():
        cells = []
        for figure, (_, digits) in FIGURES.items():
            mean, apart, low, high = row["figures"][figure]
            text = f"{apart:+.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"
            text = f"**{text}**" if low > 0 or high < 0 else text
            cells.append(f"{mean:.{digits}f}" if name == "full" else text)
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join([*lines, ""])


def write(a: argparse.Namespace, made: dict[str, list[Performed]], seconds: list[float], spent: float) -> str:
    """Write what there is so far; returns the table."""
    source = " ".join([*a.speech, *(["--store STORE"] if a.store else [])])
    report = {"command": f"python benchmarks/look_ahead.py {source} --seconds {a.seconds:g}", "processor": processor(),
              "recordings": len(seconds), "seconds": round(sum(seconds), 1), "processor_seconds": round(spent),
              "settings": {name: summary(of, made["full"], seconds) for name, of in made.items()}}
    if a.out:
        write_text(a.out.with_suffix(".json"), json.dumps(report, indent=1) + "\n")
        write_text(a.out.with_suffix(".md"), table(report))
    return table(report)


def speeches(a: argparse.Namespace) -> Iterator[Speech]:
    """The recordings, cut to `--seconds`; those of a store in an order without a pattern, so that any first ones of
    them are of all parts."""
    store = Store.open(a.store) if a.store else None
    infos = () if store is None else store.of_split("test")
    order = np.random.default_rng(0).permutation(len(infos))
    for one in chain(map(load_speech, a.speech), (store.load(infos[k].name).speech for k in order if store)):
        samples = resample(one, SAMPLE_RATE).samples
        yield Speech(samples[:round(a.seconds * SAMPLE_RATE)], SAMPLE_RATE)


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("speech", nargs="*")
    p.add_argument("--store", help="folder of a store, whose test split is taken")
    p.add_argument("--seconds", type=float, default=16.0, help="of each recording (default 16)")
    p.add_argument("--minutes", type=float, default=25.0, help="of processor time, at most about (default 25)")
    p.add_argument("--out", type=Path, help="path of the report, without .json and .md")
    a = p.parse_args()
    torch.set_num_threads(1)
    system, begin = Gesticulator.from_pretrained(), time.process_time()
    system.warm()
    every = settings(system.bundle.config.rhythm.beats.d_max)
    made: dict[str, list[Performed]] = {name: [] for name in every}
    seconds: list[float] = []
    for number, speech in enumerate(speeches(a)):
        if time.process_time() - begin > 60 * a.minutes:
            break
        heard = Heard.of(speech)
        for name, setting in every.items():
            made[name].append(performed(system, heard, number + 1000 * (name == OTHER), setting))
        seconds.append(speech.duration)
        print(number, round(time.process_time() - begin), flush=True)
        write(a, made, seconds, time.process_time() - begin)
    print(write(a, made, seconds, time.process_time() - begin))


if __name__ == "__main__":
    main()
