"""One of several processes that train together: `python tests/ranks.py ORDERS.json`, started by `test_distributed.py`
as torchrun would start it."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from data_module.motion.movement import PAST, Pasts
from data_module.parallel import own_rows
from data_module.store import Store
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.config import FitSettings
from gesticulator.training import command as train
from gesticulator.training import distributed
from gesticulator.training import fit as fitting
from gesticulator.training.stages import Run, Stage, closure, wanted
from gesticulator.training.stages.base import Figures
from gesticulator.training.stages.caches import weights_hash
from lexicon.autoencoder import Lexicon
from lexicon.movement import MovementVqVae
from lexicon.movement_vqvae import MovementLearner
from lexicon.racer import RacerCodec
from lexicon.settings import LexiconConfig, RacerConfig


def first_trained(bundle: Path, stage: str) -> Path:
    """The folder of a stage that a bundle was trained in: the oldest, since other tests train with other settings."""
    found = bundle.with_name(bundle.name + ".work").glob(f"{stage}-*/figures.json")
    return min(found, key=lambda file: file.stat().st_mtime).parent


class StoppedRun(Run):
    """A run that trains each stage for its first steps, or for as long as its settings say."""

    steps: int | None = None

    def fit(self, stage: Stage[Any], model: nn.Module, task: fitting.Task, folder: Path) -> Figures:
        """See `Run.fit`; a checkpoint each step."""
        return fitting.fit(stage.name, model, task, self.schedule(stage), folder, fitting.FitOptions(
            seed=self.seed(stage), progress=False, checkpoint_seconds=0.0, precision=self.precision,
            stop_after=self.steps))


def finished_run(store: Path, bundle: Path) -> StoppedRun:
    """A run over the work folder that a bundle was made in."""
    return StoppedRun(bundles.load(bundle).config, Store.open(store), bundle.with_name(bundle.name + ".work"),
                      progress=False)


def first_steps(store: Path, bundle: Path, out: Path, steps: int | None = None, precision: str = "float32",
                only: list[str] | None = None, memory: float | None = None) -> None:
    """Train the stages of a bundle again, each on what the bundle's work folder has of the others, into `out`."""
    run = finished_run(store, bundle)
    run.steps, run.precision, run.memory = steps, precision, memory
    asked = [stage for stage in wanted(run.config) if only is None or stage.name in only]
    for stage in closure(asked, run.config):
        run.get(stage)
    for stage in asked:
        folder = out / stage.name
        folder.mkdir(parents=True, exist_ok=True)
        assert stage.build is not None and stage.train is not None
        torch.manual_seed(run.seed(stage))
        model = stage.build(run)
        stage.train(run, model, folder)
        note(folder, model)


def note(folder: Path, model: nn.Module) -> None:
    """Leave a hash of this process's own weights."""
    rank = torch.distributed.get_rank() if torch.distributed.is_initialized() else 0
    (folder / f"weights-{rank}").write_text(weights_hash(model.cpu()))


def codebooks(out: Path, steps: int) -> None:
    """Train the codebook models on made-up motion, quantised from the first step."""
    generator = torch.Generator().manual_seed(0)
    motion = torch.randn(200, 16, 6, generator=generator).cumsum(1) / 4
    torch.manual_seed(1)
    models: dict[str, Any] = {
        "lexicon": Lexicon(LexiconConfig(size=16, code_width=8, widths=(8, 8), warm_up=0.0), 16, 6),
        "codec": RacerCodec(RacerConfig(size=16, width=8, dilations=(1, 3)), 6)}
    movements = MovementVqVae(LexiconConfig(quantizer="vq-vae", size=16, arm_components=12, levels=(),
                                            code_width=8, hidden=8, warm_up=0.0), 16, {"body": tuple(range(6))})
    still = Pasts(motion[:, :1].expand(-1, PAST, -1), torch.ones(len(motion)))
    coefficients = movements.basis.fit(motion, still, torch.ones(len(motion), 6))
    models["movements"] = MovementLearner(movements)
    for name, model in models.items():
        folder = out / name
        folder.mkdir(parents=True, exist_ok=True)

        def make_batch(rng: np.random.Generator) -> fitting.Batch:
            rows = torch.as_tensor(rng.integers(len(motion), size=16)[own_rows(16)])
            mask = torch.ones(len(rows), 6)
            mask[rows % 3 == 0, 4:] = 0.0  # as many numbers in every row, or a wrong mean would go unseen
            known = torch.ones(len(rows), coefficients.shape[1])
            known[rows % 3 == 0, 4:] = 0.0
            return {"motion": motion[rows], "mask": mask, "coefficients": coefficients[rows], "known": known}

        def before_step(step: int, model: Any = model, name: str = name) -> None:
            if step == 0:
                points = coefficients if name == "movements" else motion
                distributed.lead_model(model, lambda: model.start_codebook(points, 3))

        fitting.fit(name, model, fitting.Task(make_batch, before_step=before_step),
                    FitSettings(steps=steps, batch=16, rate=1e-3), folder,
                    fitting.FitOptions(seed=2, progress=False))
        note(folder, model)


def main() -> None:
    """Follow the orders: calls of the functions above, or the arguments of `gesticulator train`."""
    torch.set_num_threads(1)
    for port, name, order in json.loads(Path(sys.argv[1]).read_text()):
        os.environ["MASTER_PORT"] = str(port)  # one each: the first process may be late to leave the one before
        if name == "train":
            try:
                code: Any = train.main(order["arguments"])
            except SystemExit as stopped:
                code = stopped.code
            assert code == order["code"]
            continue
        given = {key: Path(value) if key in ("store", "bundle", "out") else value for key, value in order.items()}
        with distributed.joined():
            {"first_steps": first_steps, "codebooks": codebooks}[name](**given)


if __name__ == "__main__":
    main()
