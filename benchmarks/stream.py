"""How late and how costly a stream is.

    python benchmarks/stream.py SPEECH [SPEECH ...] [--out docs/results/stream.json]

For each latency mode, over all recordings, with sound in pieces of 20 ms as a microphone gives it:

Computing is counted in processor time, so that other programs on the machine do not count.

- late: seconds from the sound at t to the frame of t, computing included (sound comes by the clock, and what comes
  while it computes, waits).
- block: seconds of computing of a piece of sound that drew a block, or two that became certain together; other: of a
  piece that drew none.
- busy: share of a processor that a stream takes; 1 / busy streams keep it wholly busy.
- first: seconds of sound, and of computing, before the first frame.
- PMB, its chance level and the speed of the hands, as `eval` measures them. low_less_full: how much further above
  chance PMB is in the low mode, recording by recording and seed by seed, with the 95 % interval over both.
"""

import argparse
import json
import platform
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from realtime import processor
from threadpoolctl import threadpool_limits

from data_module.motion.skeletons import to_character
from data_module.speech.audio import SAMPLE_RATE, load_speech
from data_module.types import Motion, Speech
from eval.crossed import crossed
from eval.metrics.evaluate import MotionBeats, OnsetTrack, clip_values
from gesticulator.gesticulator import Gesticulator
from gesticulator.stream import StreamFrames

PIECE = 320
"""Samples (20 ms)."""


def percentiles(values: Sequence[float]) -> dict[str, float]:
    """p50, p95, p99 and the greatest."""
    found = np.percentile(values, [50, 95, 99, 100])
    return {name: round(float(one), 4) for name, one in zip(("p50", "p95", "p99", "max"), found, strict=True)}


def live(system: Gesticulator, speech: Speech, latency: str) -> dict[str, Any]:
    """One recording, as from a microphone."""
    stream = system.stream(latency=latency)
    parts: list[StreamFrames] = []
    late, drew, other, first, clock, spent = [], [], [], (0.0, 0.0), 0.0, 0.0
    for at in range(0, len(speech.samples), PIECE):
        heard = min(at + PIECE, len(speech.samples)) / SAMPLE_RATE
        begin = time.process_time()
        part = stream.feed(speech.samples[at:at + PIECE])
        took = time.process_time() - begin
        spent += took
        clock = max(clock, heard) + took  # what comes while it computes, waits
        (drew if part.blocks else other).append(took)
        late += (clock - part.times).tolist()
        if len(part) and not any(len(one) for one in parts):
            first = (heard, spent)
        parts.append(part)
    return {"late": late, "block": drew, "other": other, "busy": spent / speech.duration,
            "first": first, "bound": stream.look_ahead}


def quality(system: Gesticulator, speech: Speech, latency: str, seed: int) -> tuple[float, ...]:
    """PMB, its chance level, and how much it is above, percent."""
    stream = system.stream(latency=latency, seed=seed)
    parts = [stream.feed(speech.samples), stream.finish()]
    motion = to_character(Motion(stream.skeleton, np.concatenate([part.rotations for part in parts]),
                                 np.concatenate([part.root_positions for part in parts]), stream.fps))
    values = clip_values(motion, motion, MotionBeats.of(motion), OnsetTrack.of(speech), 0).numbers
    return values["pmb_A"], values["chance_A"], values["above_A"]


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("speech", nargs="+")
    p.add_argument("--seconds", type=float, default=float("inf"), help="of each recording")
    p.add_argument("--seeds", type=int, default=1, help="performances that PMB is averaged over")
    p.add_argument("--out")
    a = p.parse_args()
    threadpool_limits(1)
    system = Gesticulator.from_pretrained()
    read = [load_speech(name) for name in a.speech]
    recordings = [Speech(one.samples[:round(min(a.seconds, one.duration) * SAMPLE_RATE)], SAMPLE_RATE) for one in read]
    live(system, Speech(recordings[0].samples[:SAMPLE_RATE], SAMPLE_RATE), "full")  # what is slow once
    result: dict[str, Any] = {"processor": processor(), "threads": 1, "python": platform.python_version(),
                              "numpy": np.__version__, "files": [Path(name).name for name in a.speech],
                              "seconds": round(sum(one.duration for one in recordings), 1)}
    above: dict[str, Any] = {}
    for latency in ("full", "low"):
        found = [live(system, speech, latency) for speech in recordings]
        seconds = np.array([speech.duration for speech in recordings])
        each = np.array([[quality(system, speech, latency, seed) for speech in recordings] for seed in range(a.seeds)])
        above[latency] = each[..., 2]
        made = np.average(each, axis=1, weights=seconds)
        percent = made.mean(axis=0)
        result[latency] = {
            **{name: percentiles([value for one in found for value in one[name]])
               for name in ("late", "block", "other")},
            "late_at_most": round(found[0]["bound"], 3),
            "busy": round(float(np.average([one["busy"] for one in found], weights=seconds)), 4),
            "first_frame": {"sound": round(max(one["first"][0] for one in found), 3),
                            "computing": round(max(one["first"][1] for one in found), 3)},
            **dict(zip(("pmb", "pmb_chance", "pmb_above_chance"), percent.round(2).tolist(), strict=True)),
            "pmb_above_chance_by_seed": [round(float(one[2]), 1) for one in made]}
        print(latency, json.dumps(result[latency]), flush=True)
    apart = crossed(above["low"] - above["full"], [speech.duration for speech in recordings])
    result["low_less_full"] = {name: round(value, 1) for name, value in
                               (("mean", apart.mean), ("low", apart.low), ("high", apart.high))}
    print("low_less_full", result["low_less_full"], flush=True)
    if a.out:
        old = json.loads(Path(a.out).read_text()) if Path(a.out).exists() else {}  # with what load.py measured
        Path(a.out).write_text(json.dumps({**old, **result}, indent=1) + "\n")


if __name__ == "__main__":
    main()
