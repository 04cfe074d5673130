"""Whether several streams are cheaper in one batch: `python benchmarks/batching.py [--streams 4] [--out FILE]`.

What the models are given for the blocks of a real stream is recorded: the flow head's contexts, its drawing, and the
interpreter's memory of blocks. Then the same is computed for so many streams one after the other, and in one batch, and
counted in processor time on one thread. `block` is all that a block costs, with what cannot be batched: cutting, beats,
rest and life, knots. `gain` is what batching would make of it if the blocks of all streams fell due at one time, which
they do not: to wait for each other would add up to a block (0.3 s in the mean) to every stream's latency.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from realtime import processor
from torch import Tensor

from data_module.layers import run_lstm
from data_module.speech.audio import SAMPLE_RATE, load_speech
from generator.flow import FlowGenerator, FlowInputs, FlowTime
from gesticulator.pipeline import Gesticulator
from interpreters import lstm

ROOT = Path(__file__).resolve().parents[1]


def processor_seconds(work: Callable[[], Any], turns: int = 40) -> float:
    """Processor time of one call; the least of five measurements."""
    work()
    least = float("inf")
    for _ in range(5):
        begin = time.process_time()
        for _ in range(turns):
            work()
        least = min(least, (time.process_time() - begin) / turns)
    return least


def recorded(system: Gesticulator, seconds: float) -> tuple[dict[str, tuple[Any, ...]], float]:
    """What the models were given for the last block of so many seconds of the example, and what a block cost."""
    generator, given = system.bundle.generator, {}
    sound = load_speech(ROOT / "examples" / "speech.flac").samples
    system.stream(latency="low").feed(sound[:2 * SAMPLE_RATE])  # what is slow once
    stream, least = system.stream(latency="low"), float("inf")
    stream.feed(sound[:2 * SAMPLE_RATE])
    for start in (2.0, 2.0 + seconds, 2.0 + 2 * seconds):
        begin = time.process_time()
        part = stream.feed(sound[round(start * SAMPLE_RATE):round((start + seconds) * SAMPLE_RATE)])
        least = min(least, (time.process_time() - begin) / max(len(part.blocks), 1))
    # The models are called through these two, and the interpreter through its LSTM.
    contexts, draw, run = FlowGenerator.contexts, FlowGenerator.draw, lstm.run_lstm

    def noted_contexts(self: FlowGenerator, *args: Any, **named: Any) -> Any:
        given["contexts"] = args
        return contexts(self, *args, **named)

    def noted_draw(self: FlowGenerator, *args: Any) -> Any:
        given["draw"] = args
        return draw(self, *args)

    def noted_run(*args: Any) -> Any:
        given["lstm"] = args
        return run(*args)

    FlowGenerator.contexts, FlowGenerator.draw = noted_contexts, noted_draw  # type: ignore[assignment]
    lstm.run_lstm = noted_run
    try:
        stream.feed(sound[:round(seconds * SAMPLE_RATE)])
    finally:
        FlowGenerator.contexts, FlowGenerator.draw = contexts, draw  # type: ignore[method-assign]
        lstm.run_lstm = run
    assert isinstance(generator, FlowGenerator)
    return given, least


def wider(given: FlowInputs, added: Tensor, state: Any, count: int) -> tuple[FlowInputs, Tensor, Any]:
    """The inputs of a block for so many streams."""
    def many(one: Tensor | None, axis: int = 0) -> Any:
        if one is None:
            return None
        # What is the same for all that guides is given once.
        each = one if axis else one.expand(len(given.lexeme), *one.shape[1:])
        return torch.cat([each] * count, axis)

    names = ("audio", "lexeme", "before", "ratio", "circumstances", "speaker", "control", "deaf", "forgets")
    return (FlowInputs(*(many(getattr(given, name)) for name in names)), many(added),
            None if state is None else tuple(many(part, 1) for part in state))


def drawn_together(generator: FlowGenerator, contexts: Tensor, gains: Tensor, noise: Tensor, steps: int) -> Tensor:
    """As `FlowGenerator.draw` for streams [S]: contexts [S, 1 + G, C], noise [S, M, n] -> [S, M, n]."""
    conditions = [(scale[:, :, None], shift[:, :, None]) for scale, shift in generator.head.conditions(contexts)]
    mix = torch.cat([1.0 + gains.sum(0, keepdim=True), -gains])[:, None]
    u, step = noise, 1.0 / steps

    def v(at: Tensor, now: float) -> Tensor:
        wide = at[:, None].expand(-1, contexts.shape[1], -1, -1)
        return (generator.head(wide, FlowTime.of(torch.full((1,), now)), conditions) * mix).sum(1)

    for i in range(steps):
        first = v(u, i * step)
        u = u + step * (first + v(u + step * first, (i + 1) * step)) / 2
    return generator.stretch(u)


@torch.inference_mode()
def measured(system: Gesticulator, count: int, seconds: float) -> dict[str, Any]:
    """Milliseconds of processor time for one block of each of so many streams."""
    given, block = recorded(system, seconds)
    generator = system.bundle.generator
    assert isinstance(generator, FlowGenerator)
    inputs, added, state = given["contexts"]
    together = wider(inputs, added, state, count)
    contexts, gains, noise, steps = given["draw"]
    apart, all_noise = torch.stack([contexts] * count), torch.stack([noise] * count)
    memory, rows = given["lstm"][:2]
    torch.testing.assert_close(drawn_together(generator, apart, gains, all_noise, steps)[-1],
                               generator.draw(contexts, gains, noise, steps), atol=1e-4, rtol=1e-4)
    many_rows = torch.cat([rows] * count)
    pairs = {"contexts": (lambda: generator.contexts(inputs, added, state), lambda: generator.contexts(*together)),
             "draw": (lambda: generator.draw(contexts, gains, noise, steps),
                      lambda: drawn_together(generator, apart, gains, all_noise, steps)),
             # It is asked with sound and without, in one.
             "interpreter": (lambda: run_lstm(memory, rows), lambda: run_lstm(memory, many_rows))}
    parts, saved = {}, 0.0
    for name, (one, many) in pairs.items():
        turn, batch = count * processor_seconds(one), processor_seconds(many)
        parts[name] = {"in_turn": round(1e3 * turn, 2), "in_a_batch": round(1e3 * batch, 2),
                       "gain": round(turn / batch, 2)}
        saved += turn - batch
    whole = count * block
    return {"streams": count, "parts": parts, "block": round(1e3 * block, 2), "gain": round(whole / (whole - saved), 2)}


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--streams", type=int, nargs="*", default=[4])
    p.add_argument("--seconds", type=float, default=3.0)
    p.add_argument("--out", type=Path)
    a = p.parse_args()
    torch.set_num_threads(1)
    system = Gesticulator.from_pretrained()
    report = {"processor": processor(), "threads": 1, "torch": torch.__version__,
              "batches": [measured(system, count, a.seconds) for count in a.streams]}
    print(json.dumps(report, indent=1))
    if a.out:
        a.out.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
