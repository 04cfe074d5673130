"""RACER at its published widths, on one batch: `python benchmarks/racer_published.py [--out FILE.json]`.

The codec (512 wide, 512 codes) and the Q-network (768 wide, 12 heads, 12 layers) of the presets `racer-trinity` and
`racer-chinese` are built, asked for their shapes, and trained on one small batch of made-up motion and speech for a few
steps: the losses must fall. It tells that the presets run and what a step costs here, and nothing about quality.
"""

from __future__ import annotations

import argparse
import shlex
import sys
import time

import torch
from torch import Tensor

from data_module.layers import parameter_count
from eval.table import Column, Provenance, Table, publish
from gesticulator.training import presets
from interpreters.cql import ConservativeQ, QNetwork
from lexicon.racer import FRAMES, RacerCodec

_JOINTS, _SPEAKERS = 16, 1


def trained(model: RacerCodec | ConservativeQ, batch: dict[str, Tensor], steps: int, rate: float) -> dict[str, float]:
    """The weighted loss before and after some steps on one batch, and seconds a step."""
    optimiser = torch.optim.Adam([p for p in model.parameters() if p.requires_grad], lr=rate, betas=(0.5, 0.999))
    values, begin = [], time.perf_counter()
    for _ in range(steps):
        terms = model.losses(batch, 1.0)
        total = torch.stack([model.weights[key] * term for key, term in terms.items()]).sum()
        optimiser.zero_grad()
        total.backward()
        optimiser.step()
        values.append(float(total.detach()))
    return {"weights, million": round(parameter_count(model) / 1e6, 1), "loss before": round(values[0], 3),
            "loss after": round(values[-1], 3), "seconds a step": round((time.perf_counter() - begin) / steps, 2)}


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("--steps", type=int, default=15)
    p.add_argument("--windows", type=int, default=2, help="in the batch")
    p.add_argument("--out")
    a = p.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    config = presets.preset("racer-trinity")
    decisions, count, width = config.cql.decisions, a.windows, config.front_end.bands + 2
    codec = RacerCodec(config.racer, 3 * _JOINTS)
    time_axis = torch.linspace(0, 6.0, decisions * FRAMES)[None, :, None]
    motion = torch.sin(time_axis * torch.rand(count, 1, 3 * _JOINTS) * 6 + torch.rand(count, 1, 3 * _JOINTS) * 6)
    codes = codec.label(motion)
    assert codes.shape == (count, decisions) and codec.decode_tokens(codes).shape == (count, decisions, FRAMES, 48)
    rows = {"codec": trained(codec, {"motion": motion, "mask": torch.ones(count, 48)}, a.steps, 3e-4)}
    network = QNetwork(config.cql, FRAMES, width, config.racer.size, _SPEAKERS)
    steps = decisions + 1
    action = torch.randint(config.racer.size, (count, steps))
    batch = {"previous": action.roll(1, 1), "action": action, "audio": torch.randn(count, steps, 3 * FRAMES, width),
             "speaker": torch.ones(count, _SPEAKERS), "silent": torch.zeros(count, steps, dtype=torch.bool),
             "reward": torch.rand(count, steps), "terminal": torch.zeros(count, steps, dtype=torch.bool),
             "valid": torch.ones(count, steps), "cloned": torch.ones(count, steps)}
    assert network.values(batch["previous"][:, :decisions], batch["audio"][:, :decisions], batch["speaker"],
                          batch["silent"][:, :decisions]).shape == (count, decisions, config.racer.size)
    rows["Q-network and target"] = trained(ConservativeQ(network), batch, a.steps, 1e-4)
    publish([table(rows, count, a.steps)], a.out,
            Provenance.now(shlex.join(["python", "benchmarks/racer_published.py", *sys.argv[1:]])))


def table(rows: dict[str, dict[str, float]], windows: int, steps: int) -> Table:
    """What is shown."""
    return Table("RACER at its published widths", {
        key: Column(key, digits=3) for key in next(iter(rows.values()))}, rows,
                 f"one batch of {windows} windows", facts={"windows": windows, "steps": steps})


if __name__ == "__main__":
    main()
