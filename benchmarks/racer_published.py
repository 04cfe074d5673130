"""RACER at its published widths: `python benchmarks/racer_published.py [--steps N] [--windows N] [--out FILE.json]`.

The codec (512 wide, 512 codes) and the Q-network (768 wide, 12 heads, 12 layers) of the presets `racer-trinity` and
`racer-chinese` are built, asked for their shapes, and trained for some steps, each on new windows of made-up motion,
speech and codes, some of which are commoner than others. The losses of windows that were never trained on must fall. It
tells that the presets learn and what a step costs here, and nothing about quality.
"""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from collections.abc import Callable

import torch
from torch import Tensor

from data_module.layers import parameter_count
from eval.table import Column, Provenance, Table, publish
from gesticulator.training import presets
from interpreters.cql import ConservativeQ, QNetwork
from lexicon.racer import FRAMES, RacerCodec

_JOINTS, _SPEAKERS = 16, 1


Batch = dict[str, Tensor]


def trained(model: RacerCodec | ConservativeQ, make: Callable[[], Batch], steps: int, rate: float) -> dict[str, float]:
    """The weighted loss of windows that are not trained on, before and after some steps, and seconds a step.

    make: gives new windows at every call.
    """
    optimiser = torch.optim.Adam([p for p in model.parameters() if p.requires_grad], lr=rate, betas=(0.5, 0.999))

    def loss(batch: Batch) -> Tensor:
        terms = model.losses(batch, 1.0)
        return torch.stack([model.weights[key] * term for key, term in terms.items()]).sum()

    @torch.no_grad()
    def held_out() -> float:
        model.eval()
        value = float(loss(held))
        model.train()
        return value

    held = make()
    before, begin = held_out(), time.perf_counter()
    for _ in range(steps):
        optimiser.zero_grad()
        loss(make()).backward()
        optimiser.step()
    spent = time.perf_counter() - begin
    return {"weights, million": round(parameter_count(model) / 1e6, 1), "loss before": round(before, 3),
            "loss after": round(held_out(), 3), "seconds a step": round(spent / steps, 2)}


def motions(count: int, length: int) -> Batch:
    """`count` windows of sinusoids, of `length` frames."""
    time_axis = torch.linspace(0, 6.0, length)[None, :, None]
    rate, phase = 6 * torch.rand(2, count, 1, 3 * _JOINTS)
    return {"motion": torch.sin(time_axis * rate + phase), "mask": torch.ones(count, 3 * _JOINTS)}


def decisions_of(count: int, steps: int, codes: int, width: int) -> Batch:
    """`count` windows of codes, of which the k-th is drawn in proportion to 1 / k, with noise as speech."""
    action = torch.multinomial(1.0 / torch.arange(1, codes + 1), count * steps, replacement=True).reshape(count, steps)
    never = torch.zeros(count, steps, dtype=torch.bool)
    return {"previous": action.roll(1, 1), "action": action, "audio": torch.randn(count, steps, 3 * FRAMES, width),
            "speaker": torch.ones(count, _SPEAKERS), "silent": never, "reward": torch.rand(count, steps),
            "terminal": never, "valid": torch.ones(count, steps), "cloned": torch.ones(count, steps)}


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("--steps", type=int, default=40)
    p.add_argument("--windows", type=int, default=8, help="of a step, and held out (default 8)")
    p.add_argument("--out")
    a = p.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    config = presets.preset("racer-trinity")
    decisions, count, width = config.cql.decisions, a.windows, config.front_end.bands + 2
    codec = RacerCodec(config.racer, 3 * _JOINTS)
    motion = motions(count, decisions * FRAMES)["motion"]
    codes = codec.label(motion)
    assert codes.shape == (count, decisions) and codec.decode_tokens(codes).shape == (count, decisions, FRAMES, 48)
    rows = {"codec": trained(codec, lambda: motions(count, decisions * FRAMES), a.steps, 3e-4)}
    network = QNetwork(config.cql, FRAMES, width, config.racer.size, _SPEAKERS)
    batch = decisions_of(count, decisions + 1, config.racer.size, width)
    assert network.values(batch["previous"][:, :decisions], batch["audio"][:, :decisions], batch["speaker"],
                          batch["silent"][:, :decisions]).shape == (count, decisions, config.racer.size)
    rows["Q-network and target"] = trained(
        ConservativeQ(network), lambda: decisions_of(count, decisions + 1, config.racer.size, width), a.steps, 1e-4)
    publish([table(rows, count, a.steps)], a.out,
            Provenance.now(shlex.join(["python", "benchmarks/racer_published.py", *sys.argv[1:]])))


def table(rows: dict[str, dict[str, float]], windows: int, steps: int) -> Table:
    """What is shown."""
    return Table("RACER at its published widths", {
        key: Column(key, digits=3) for key in next(iter(rows.values()))}, rows,
                 f"{steps} steps of {windows} new windows; losses of {windows} others",
                 facts={"windows": windows, "steps": steps})


if __name__ == "__main__":
    main()
