"""The training loop: every stage uses `fit`.

A model offers `losses(batch, progress) -> dict[str, Tensor]` and `weights`, keyed alike; it does not know the trainer.
Every step is a function of (seed, step, process) alone: the batch, dropout and Gumbel noise come from generators seeded
with them. So a run that was stopped and resumed gives the same weights as an uninterrupted one.
"""

import json
import math
import os
import pickle
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel
from tqdm import tqdm

from data_module.errors import InputError
from data_module.files import new_file
from gesticulator.bundle.config import FitSettings
from gesticulator.training import distributed

__all__ = ["FitOptions", "Task", "fit"]

Batch = dict[str, Tensor]
MakeBatch = Callable[[np.random.Generator, int], Batch]
Losses = Callable[[Batch, float], dict[str, Tensor]]

LARGEST_GRADIENT = 1.0
"""Largest gradient norm; longer gradients are clipped."""
_WARM_UP, _LAST_RATE = 0.02, 0.01
"""Of the cosine schedule: share of the steps in which the rate rises, and share of the rate that is left at the end."""


def rate_factor(settings: FitSettings, step: int) -> float:
    """The learning rate at `step` as a share of `settings.rate`."""
    if settings.schedule == "constant":
        return 1.0
    # Adam's first moments are estimates from few batches, so the first steps are short.
    warm = max(1, round(_WARM_UP * settings.steps))
    if step < warm:
        return (step + 1) / warm
    share = (step - warm) / max(1, settings.steps - warm)
    return _LAST_RATE + (1 - _LAST_RATE) * 0.5 * (1 + math.cos(math.pi * share))


def moved(batch: Batch, device: str) -> Batch:
    return {key: value.to(device) for key, value in batch.items()}


def generator_for(seed: int, step: int, process: int = 0) -> np.random.Generator:
    """The random generator of one step, independent of earlier steps."""
    return np.random.default_rng([seed, step, process])


def _optimisers(model: nn.Module, settings: FitSettings) -> list[tuple[torch.optim.Optimizer, float]]:
    offered: Callable[[], Iterable[tuple[Tensor, float]]] | None = getattr(model, "sparse_parameters", None)
    sparse = list(offered()) if offered is not None else []
    # Tensors compare elementwise, so parameters are told apart by identity.
    apart = {id(parameter) for parameter, _ in sparse}
    dense = [p for p in model.parameters() if p.requires_grad and id(p) not in apart]
    out: list[tuple[torch.optim.Optimizer, float]] = [(torch.optim.AdamW(
        dense, lr=settings.rate, betas=settings.betas, weight_decay=settings.weight_decay), settings.rate)]
    for parameter, rate in sparse:
        out.append((torch.optim.SparseAdam([parameter], lr=rate, betas=settings.betas), rate))
    return out


def save_checkpoint(path: Path, step: int, parts: Sequence[Any]) -> None:
    """Save everything that the next step depends on in one file, replaced atomically."""
    with new_file(path) as stream:
        torch.save({"step": step, "parts": [part.state_dict() for part in parts]}, stream)


def load_checkpoint(path: Path, parts: Sequence[Any]) -> int:
    """Restore the saved state; returns the step to resume from. 0 without a valid checkpoint (missing, or damaged by a
    crash or a full disk)."""
    try:
        state = torch.load(path, weights_only=True, map_location="cpu")
        saved = list(zip(parts, state["parts"], strict=True))
    except (RuntimeError, ValueError, KeyError, TypeError, EOFError, OSError, pickle.UnpicklingError):
        return 0
    # After all of the file was read: a damaged one must not leave half of the parts restored.
    for part, values in saved:
        part.load_state_dict(values)
    return int(state["step"])


class BestWeights:
    """The weights with the best validation figure so far. figures: of that validation, with its step; stale:
    validations since."""

    def __init__(self, watch: str) -> None:
        self.watch, self.stale = watch, 0
        self.figures: dict[str, float] = {}
        self.weights: dict[str, Tensor] = {}

    def note(self, step: int, figures: dict[str, float], model: nn.Module) -> None:
        """Store the weights if the watched figure is lower than ever before."""
        if not self.figures or figures[self.watch] < self.figures[self.watch]:
            self.figures, self.stale = {**figures, "best_step": float(step)}, 0
            self.weights = {key: value.detach().cpu().clone() for key, value in model.state_dict().items()}
        else:
            self.stale += 1

    def state_dict(self) -> dict[str, Any]:
        return {"figures": self.figures, "stale": self.stale, "weights": self.weights}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.figures, self.stale, self.weights = dict(state["figures"]), int(state["stale"]), dict(state["weights"])


def open_log(path: Path, from_step: int) -> TextIO:
    """The log with one JSON line per step, written by the first process; lines after the resumed step are dropped."""
    if distributed.rank():
        path = Path(os.devnull)
    lines = path.read_text().splitlines() if path.is_file() else []
    path.write_text("".join(line + "\n" for line in lines[:from_step]))
    return path.open("a", buffering=1)


@dataclass(frozen=True)
class Task:
    """The training task of a stage.

    make_batch(rng, size): a batch from random numbers alone. losses(batch, progress): the terms, keyed like the model's
    `weights`; None for the model's own. validate(): figures on the validation split. before_step(step): a hook that
    must depend on the step alone. watch: the figure of `validate` to minimise for early stopping, if the settings have
    patience; "" for none. learner: what is trained, if not the model of the stage itself. finish(): what follows the
    last step; returns the figures.
    """

    make_batch: MakeBatch
    losses: Losses | None = None
    validate: Callable[[], dict[str, float]] | None = None
    before_step: Callable[[int], None] | None = None
    watch: str = ""
    learner: nn.Module | None = None
    finish: Callable[[], dict[str, float]] | None = None


@dataclass(frozen=True)
class FitOptions:
    """Options of the loop. checkpoint_seconds: interval between checkpoints, the most that a kill can lose."""

    seed: int
    device: str = "cpu"
    checkpoint_seconds: float = 60.0
    progress: bool = True


def fit(stage: str, model: nn.Module, task: Task, settings: FitSettings, folder: Path, options: FitOptions
        ) -> dict[str, float]:
    """Train `model` for `settings.steps` steps and return the last validation figures. With patience, stop after that
    many validations without improvement, and restore the best weights and figures.

    folder receives `STAGE.ckpt` (resumed from if valid) and `STAGE.jsonl` (one line per step), written by the first
    process. FloatingPointError if the loss becomes NaN or infinite.
    """
    model.to(options.device).train()
    learner = _Learner(model, task, settings, options)
    best = BestWeights(task.watch) if settings.patience and task.watch and task.validate is not None else None
    parts = [model, *(optimiser for optimiser, _ in learner.optimisers), *([] if best is None else [best])]
    checkpoint = folder / f"{stage}.ckpt"
    first = load_checkpoint(checkpoint, parts)
    # All processes must resume from the same step, or their batches would differ.
    if distributed.agreed(first) != first:
        raise InputError(folder, "holds different checkpoints on different machines", "put --work on shared storage")
    # Validations are spread evenly over the run.
    every = max(1, settings.steps // settings.validations)
    figures: dict[str, float] = {}
    saved_at = time.monotonic()
    with open_log(folder / f"{stage}.jsonl", first) as log, tqdm(
            total=settings.steps, initial=first, desc=stage, disable=not options.progress, mininterval=1.0) as bar:
        for step in range(first, settings.steps):
            # Also right after resuming, if the run had stopped for this reason.
            if best is not None and best.stale >= settings.patience:
                break
            row, done = learner.step(step), step + 1
            if task.validate is not None and (done % every == 0 or done == settings.steps):
                model.eval()
                # Processes with other processors may differ in the last digit, but must stop at the same step.
                figures = distributed.agreed(task.validate())
                model.train()
                if best is not None:
                    best.note(done, figures, model)
                row.update({f"val_{key}": value for key, value in figures.items()})
                bar.set_postfix({key: f"{value:.3g}" for key, value in list(figures.items())[:4]}, refresh=False)
            log.write(json.dumps(row) + "\n")
            bar.update()
            if not distributed.rank() and (
                    time.monotonic() - saved_at > options.checkpoint_seconds or done == settings.steps):
                save_checkpoint(checkpoint, done, parts)
                saved_at = time.monotonic()
    model.eval()
    if best is not None and best.weights:
        model.load_state_dict(best.weights)
        figures = best.figures
    if task.validate is not None and not figures:
        figures = task.validate()
    return figures


class _Objective(nn.Module):
    """The weighted sum of a model's losses as a forward pass, which DistributedDataParallel can wrap."""

    def __init__(self, model: nn.Module, losses: Losses) -> None:
        super().__init__()
        self.model, self.losses = model, losses
        self.weights: dict[str, float] = model.weights  # type: ignore[assignment]

    def forward(self, batch: Batch, progress: float) -> tuple[Tensor, dict[str, Tensor]]:
        """The sum [] and, for the log, its terms."""
        terms = self.losses(batch, progress)
        total = sum((self.weights[key] * term for key, term in terms.items() if self.weights[key]),
                    start=torch.zeros((), device=next(self.model.parameters()).device))
        return total, {key: term.detach() for key, term in terms.items()}


class _Learner:
    """A model with its optimisers; `step` makes one update."""

    def __init__(self, model: nn.Module, task: Task, settings: FitSettings, options: FitOptions) -> None:
        self.task, self.settings, self.options = task, settings, options
        self.objective: nn.Module = _Objective(model, task.losses or model.losses)  # type: ignore[arg-type]
        # Which parameters have a gradient changes during a run, as with the warm-up of a codebook.
        if distributed.processes() > 1:
            self.objective = DistributedDataParallel(self.objective, find_unused_parameters=True)
        self.optimisers = _optimisers(model, settings)

    def step(self, step: int) -> dict[str, Any]:
        """Make the update of a step, a function of (seed, step) alone; returns its row of the log."""
        if self.task.before_step is not None:
            self.task.before_step(step)
        rng = generator_for(self.options.seed, step, distributed.rank())
        factor = rate_factor(self.settings, step)
        for optimiser, rate in self.optimisers:
            for group in optimiser.param_groups:
                group["lr"] = rate * factor
            optimiser.zero_grad(set_to_none=True)
        # The batch of the settings is that of all processes together.
        size = max(1, self.settings.batch // distributed.processes())
        batch = moved(self.task.make_batch(rng, size), self.options.device)
        # Dropout and Gumbel noise follow from (seed, step), so a resumed run repeats them.
        torch.manual_seed(int(rng.integers(2**62)))
        total, terms = self.objective(batch, step / max(1, self.settings.steps))
        total.backward()
        (plain, _), *others = self.optimisers
        # Style codes, which are updated sparsely and have a rate of their own, are not clipped.
        norm = float(nn.utils.clip_grad_norm_([p for group in plain.param_groups for p in group["params"]
                                               if p.grad is not None], LARGEST_GRADIENT))
        figures, loss = {key: float(term) for key, term in terms.items()}, float(total.detach())
        # Before the update, so that the weights of the last checkpoint stay finite.
        if not math.isfinite(loss) or not math.isfinite(norm):
            raise FloatingPointError(f"the loss is not finite at step {step}: {figures}")
        for optimiser, _ in others:
            for parameter in optimiser.param_groups[0]["params"]:
                # A step touches the codes of its windows only, out of one for every block of the corpus.
                parameter.grad = None if parameter.grad is None else parameter.grad.to_sparse(1)
        for optimiser, _ in self.optimisers:
            optimiser.step()
        return {"step": step, "loss": round(loss, 6), "rate": self.settings.rate * factor,
                "gradient": round(norm, 5), **{key: round(value, 6) for key, value in figures.items()}}
