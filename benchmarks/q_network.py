"""Cost of a block of the Q-network: `python benchmarks/q_network.py [--out docs/results/q_network.json]`.

Milliseconds a block on one thread, the median over blocks of made-up speech: while the window fills, with keys and
values kept ("cached": two tokens a block) and without ("full"); and past the window, where the last T pairs are
computed anew in either case. The LSTM interpreter stands beside it for scale; so does a network of the paper's size
(768 wide, 12 heads, 12 layers), with random weights.
"""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from dataclasses import replace

import numpy as np
import torch

from data_module.layers import freeze
from eval.table import Column, Provenance, Table, publish
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.files import bundle_folder
from interpreters.base import BlockFeatures, LexemeInterpreter
from interpreters.cql import QNetwork


def milliseconds(system: LexemeInterpreter, blocks: list[BlockFeatures], repeats: int) -> np.ndarray:
    """[repeats, N] of each step."""
    out = np.zeros((repeats, len(blocks)))
    for repeat in range(repeats):
        state, previous = system.start(0, 0), 0
        for i, heard in enumerate(blocks):
            begin = time.perf_counter()
            scores, state = system.step(state, heard, previous)
            out[repeat, i] = 1000 * (time.perf_counter() - begin)
            previous = int(scores.argmax())
    return out


def row(system: LexemeInterpreter, blocks: list[BlockFeatures], window: int, repeats: int) -> dict[str, float]:
    """Medians of the first `window` blocks and of those after, the first one left out (it warms up)."""
    spent = milliseconds(system, blocks, repeats)
    return {"window filling": round(float(np.median(spent[:, 1:window])), 3),
            "past the window": round(float(np.median(spent[:, window:])), 3)}


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("--bundle")
    p.add_argument("--out")
    a = p.parse_args()
    torch.set_num_threads(1)
    bundle = bundles.load(bundle_folder(a.bundle))
    network = bundle.q_network
    if network is None:
        raise SystemExit("the bundle holds no Q-network")
    torch.manual_seed(0)
    width, window = bundle.statistics.high.to_dict()["mean"].shape[0], network.config.decisions
    heard = [torch.randn(3 * bundle.config.rhythm.frames, width) for _ in range(2 * window)]
    blocks = [BlockFeatures(rows, rows) for rows in heard]
    full = freeze(QNetwork(network.config, network.frames, width, network.lexemes, network.speakers))
    full.load_state_dict(network.state_dict())
    full.cached = False  # type: ignore[union-attr]
    paper = freeze(QNetwork(replace(network.config, width=768, heads=12, layers=12), network.frames, width,
                            network.lexemes, network.speakers))
    rows = {"Q-network, cached": row(network, blocks, window, 5), "Q-network, full": row(full, blocks, window, 5),
            "Q-network of the paper's size, cached": row(paper, blocks, window, 1),
            "lstm": row(bundle.interpreter, blocks, window, 5)}
    publish([table(rows, window)], a.out,
            Provenance.now(shlex.join(["python", "benchmarks/q_network.py", *sys.argv[1:]])))


def table(rows: dict[str, dict[str, float]], window: int) -> Table:
    """What is shown."""
    return Table("Cost of a block of the Q-network", {
        key: Column(key, "ms a block") for key in ("window filling", "past the window")}, rows,
                 "one thread", facts={"decisions": window})


if __name__ == "__main__":
    main()
