"""The elements of a training run: nodes that are computed once, stages that are trained once, and the run.

A `Node` is a value with a name, the nodes that it needs and the settings that affect it; a `Stage` is a node that is
trained. A node's key is the hash of its settings and of the keys of what it needs, down to the data. So the work folder
knows which results remain valid after a change of settings.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import nn

from data_module.errors import InputError
from data_module.files import read_object, write_bytes, write_text
from data_module.layers import freeze
from data_module.store import Store
from gesticulator.bundle.config import Config, FitSettings, digest
from gesticulator.training import distributed
from gesticulator.training import fit as fitting

T = TypeVar("T")
M = TypeVar("M", bound=nn.Module)
Figures = dict[str, float]


@dataclass(frozen=True, eq=False)
class Node(Generic[T]):
    """A value that a run computes once, such as the corpus or the labels of its blocks.

    settings: the settings that affect it: paths ("rhythm", "silence.hint"), or functions of the settings. Settings that
    matter only to some users of a value (the words of a corpus) belong to those users. needs: the nodes that `make`
    gets from the run under these settings.
    """

    name: str
    settings: tuple[str | Callable[[Config], Any], ...]
    needs: Callable[[Config], Sequence[Node[Any]]] = lambda config: ()
    make: Callable[[Run], T] | None = None


@dataclass(frozen=True, eq=False)
class Stage(Node[M]):
    """A node that is a trained model.

    build: the untrained model. train: the task that it learns, or the figures of a model that was fitted without steps.
    schedule: name of its schedule in `Config.schedules` (schedule_of: if it depends on the settings). wanted: whether
    the settings require it. finish: converts the trained module to the one used (a learner also holds its target
    network). part: its name in a bundle, "" for none.
    """

    build: Callable[[Run], nn.Module] | None = None
    train: Callable[[Run, Any], fitting.Task | Figures] | None = None
    schedule: str = ""
    schedule_of: Callable[[Config], FitSettings] | None = None
    wanted: Callable[[Config], bool] = lambda config: True
    finish: Callable[[nn.Module], M] = cast(Any, lambda model: model)  # noqa: RUF009
    part: str = ""


def setting(config: Config, path: str) -> Any:
    """The value at a path of settings."""
    value: Any = config
    for name in path.split("."):
        value = value[name] if isinstance(value, Mapping) else getattr(value, name)
    return value


@dataclass
class Run:
    """A training run: settings, data, work folder and results so far."""

    config: Config
    store: Store
    work: Path
    device: str = "cpu"
    progress: bool = True
    workers: int = 1
    """Processes that cut and encode recordings."""
    figures: dict[str, Figures] = field(default_factory=dict)
    """Stage -> its validation figures, once it has been trained or loaded."""
    _values: dict[str, Any] = field(default_factory=dict, repr=False)
    _keys: dict[str, str] = field(default_factory=dict, repr=False)

    def get(self, node: Node[T]) -> T:
        """The value of a node, computed (or read from the work folder) on first use. Of several processes the first
        computes it, then the others from its files."""
        if node.name not in self._values:
            if isinstance(node, Stage):
                assert node.build is not None
                # A finished stage asks for what its shape depends on alone: its data set may take minutes to make.
                for need in () if distributed.agreed(self.finished(node)) else node.needs(self.config):
                    self.get(need)
                torch.manual_seed(self.seed(node))  # initial weights
                # Built whether finished or not: the shapes of the weights follow from the settings alone.
                model = node.build(self)
                self.figures[node.name] = self.train_stage(node, model)
                self._values[node.name] = node.finish(freeze(model))
            else:
                assert node.make is not None
                if distributed.processes() > 1:  # stages are trained by all processes together
                    for need in node.needs(self.config):
                        self.get(need)
                with distributed.first():
                    self._values[node.name] = node.make(self)
        return cast(T, self._values[node.name])

    def provide(self, node: Node[Any], value: Any, key: str | None = None) -> None:
        """Use `value` for a node instead of computing it; key: replaces its key in those of dependent nodes (omit it if
        the value is the same)."""
        self._values[node.name] = value
        # Without its own key, models trained on another corpus would pass for those of this one.
        if key is not None:
            self._keys[node.name] = key

    def key(self, node: Node[Any]) -> str:
        """Hash of everything that affects a node: data, settings, requirements, and for a stage its seed."""
        if node.name in self._keys:
            return self._keys[node.name]
        # Name and data first: equal settings of different nodes or stores must differ.
        parts: list[Any] = [node.name, self.store.fingerprint]
        parts += [setting(self.config, path) if isinstance(path, str) else path(self.config) for path in node.settings]
        if isinstance(node, Stage):
            parts += [self.config.seed, self.schedule(node)]
        return digest(*parts, [self.key(need) for need in node.needs(self.config)])

    def seed(self, node: Node[Any]) -> int:
        """The seed of a node, from the run's seed and the node's name, so that adding a node changes no other."""
        return int(digest(self.config.seed, node.name)[:12], 16) % 2**31

    def schedule(self, stage: Stage[Any]) -> FitSettings:
        """The schedule of a stage."""
        if stage.schedule_of is not None:
            return stage.schedule_of(self.config)
        return cast(FitSettings, getattr(self.config.schedules, stage.schedule))

    def folder(self, node: Node[Any]) -> Path:
        """The folder of a stage."""
        return self.work / f"{node.name}-{self.key(node)}"

    def finished(self, stage: Stage[Any]) -> bool:
        """Whether the work folder holds the complete stage."""
        return finished(self.folder(stage))

    def train_stage(self, stage: Stage[Any], model: nn.Module) -> Figures:
        """Load a finished stage into `model`, or train it; returns its validation figures."""
        folder = self.folder(stage)
        if not distributed.agreed(finished(folder, model)):
            folder.mkdir(parents=True, exist_ok=True)
            assert stage.train is not None
            task = stage.train(self, model)
            figures = task if isinstance(task, dict) else self._fit(stage, model, task, folder)
            with distributed.first():
                if not distributed.rank():
                    keep(folder, model, figures)
                    # Only now: a kill in between finds the finished stage or the checkpoint.
                    (folder / f"{stage.name}.ckpt").unlink(missing_ok=True)
        # Read back also after training, so that a first run uses exactly what a resumed one would.
        model.cpu().load_state_dict(load_file(folder / WEIGHTS))
        return read_object(folder / FIGURES, "delete it, and train again", python=True)

    def _fit(self, stage: Stage[Any], model: nn.Module, task: fitting.Task, folder: Path) -> Figures:
        figures = fitting.fit(stage.name, task.learner or model, task, self.schedule(stage), folder, fitting.FitOptions(
            seed=self.seed(stage), device=self.device, progress=self.progress))
        return figures if task.finish is None else task.finish()


def checked(run: Run, batches: list[fitting.Batch], figures: Callable[[list[fitting.Batch]], Figures]
            ) -> Callable[[], Figures]:
    """A validation that gives the figures of these batches, on the run's device and without gradients."""
    @torch.no_grad()
    def validate() -> Figures:
        return figures([fitting.moved(batch, run.device) for batch in batches])

    return validate


WEIGHTS, FIGURES = "weights.safetensors", "figures.json"
"""Files of a finished stage; the figures are written last and mark it complete."""


def keep(folder: Path, model: nn.Module, figures: Figures) -> None:
    """Write a trained stage: weights first, then the figures, each atomically."""
    weights = {key: value.detach().cpu().contiguous() for key, value in model.state_dict().items()}
    write_bytes(folder / WEIGHTS, save(weights))
    write_text(folder / FIGURES, json.dumps(figures))


def finished(folder: Path, model: nn.Module | None = None) -> bool:
    """Whether a stage's folder holds valid weights and figures, matching `model` if given."""
    try:
        read_object(folder / FIGURES, "delete it, and train again", python=True)
        weights = load_file(folder / WEIGHTS)
    except (InputError, OSError, ValueError, SafetensorError):
        return False
    if model is not None and {key: value.shape for key, value in weights.items()} != {
            key: value.shape for key, value in model.state_dict().items()}:
        return False
    # A run that diverged leaves whole files of numbers that are none.
    return len(weights) > 0 and all(
        bool(torch.isfinite(value).all()) for value in weights.values())
