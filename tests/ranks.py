"""A small model trained by `gesticulator.training.fit`, in a test or by `torchrun ... tests/ranks.py FOLDER`."""

import sys
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from gesticulator.training import distributed
from gesticulator.training.fit import Batch, FitOptions, FitSettings, Task, fit
from lexicon.quantizer import Quantizer

STEPS, SEED, BATCH = 12, 3, 16


class Model(nn.Module):
    """A dense map, codes with a sparse update, and a codebook that follows its latents."""

    def __init__(self) -> None:
        super().__init__()
        torch.manual_seed(0)
        self.net = nn.Sequential(nn.Linear(3, 8), nn.Tanh(), nn.Linear(8, 4))
        self.unused = nn.Linear(2, 2)  # as a model in its warm-up: some parameters have no gradient yet
        self.table = nn.Embedding(10, 4)
        self.quantizer = Quantizer(6, 4, revive_below=0.0)
        self.weights = {"error": 1.0, "commitment": 0.5}

    def sparse_parameters(self) -> list[tuple[Tensor, float]]:
        return [(self.table.weight, 0.05)]

    def losses(self, batch: Batch, progress: float) -> dict[str, Tensor]:
        latents = self.net(batch["x"]) + self.table(batch["row"])
        quantised = self.quantizer(latents)
        return {"error": (latents.sum(1) - batch["y"]).pow(2).mean(), "commitment": quantised.commitment}


def make_batch(rng: np.random.Generator, size: int) -> Batch:
    x = torch.as_tensor(rng.normal(size=(size, 3)), dtype=torch.float32)
    return {"x": x, "y": x[:, 0] * 2 + 1, "row": torch.as_tensor(rng.integers(10, size=size))}


def trained(folder: Path, task: Task) -> Model:
    folder.mkdir(parents=True, exist_ok=True)
    model = Model()
    fit("stage", model, task, FitSettings(steps=STEPS, batch=BATCH, rate=1e-2), folder,
        FitOptions(seed=SEED, progress=False))
    return model


if __name__ == "__main__":
    torch.set_num_threads(1)
    with distributed.joined():
        whole = Path(sys.argv[1])
        with distributed.first(), distributed.first():
            (whole / f"turn-{distributed.rank()}").write_text(str(sorted(file.name for file in whole.glob("turn-*"))))
        weights = trained(whole / "two", Task(make_batch)).state_dict()
        torch.save(weights, whole / f"weights-{distributed.rank()}.pt")
