"""What a training run is made of: nodes that are made once, stages that are trained once, and the run that keeps them.

A `Node` is a value with a name, the nodes that it needs and the settings that shape it; a `Stage` is a node that is
trained. A node's key is the hash of its settings and of the keys of what it needs, down to the data. So the work folder
knows what is still good after a change of settings, and nobody has to say it twice.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import nn

from data_module.errors import InputError
from data_module.files import rename, write_text
from data_module.json_files import read_object
from data_module.layers import freeze
from data_module.settings import check
from data_module.store import Store
from gesticulator.bundle.config import Config, FitSettings, digest, from_dict, to_dict
from gesticulator.training import distributed
from gesticulator.training import fit as fitting

T = TypeVar("T")
M = TypeVar("M", bound=nn.Module)
Figures = dict[str, float]


def no_needs(config: Config) -> Sequence[Node[Any]]:
    """For a node that stands on the data alone."""
    return ()


def always(config: Config) -> bool:
    """For a stage that no settings leave out."""
    return True


@dataclass(frozen=True, eq=False)
class Node(Generic[T]):
    """A value that a run makes once, such as the corpus or the labels of its blocks.

    settings: what of the settings shapes it: paths ("rhythm", "silence.hint"), or functions of the settings. What
    shapes a value only for those who look at that side of it (the words of a corpus) stands with them. needs: the nodes
    that `make` asks the run for under these settings. of_data: what beside the store shapes it (folders of more sound).
    """

    name: str
    settings: tuple[str | Callable[[Config], Any], ...]
    needs: Callable[[Config], Sequence[Node[Any]]] = no_needs
    make: Callable[[Run], T] | None = None
    of_data: Callable[[Run], Sequence[Any]] | None = None


@dataclass(frozen=True, eq=False)
class Stage(Node[M]):
    """A node that is a trained model.

    build: the model, untrained. train: one call of `Run.fit`, with the last validation figures. schedule: where in
    `Config.schedules` its steps stand (schedule_of: where that depends on the settings; default: its own, of which
    `Config.schedules.others` may change a part). wanted: whether the settings
    ask for it. finish: what makes of the trained module the one that is used (a learner holds its target network too).
    part: its name in a bundle, empty for none.
    """

    build: Callable[[Run], nn.Module] | None = None
    train: Callable[[Run, Any, Path], Figures] | None = None
    schedule: str = ""
    schedule_of: Callable[[Config], FitSettings] | None = None
    default: FitSettings | None = None
    wanted: Callable[[Config], bool] = always
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
    """A training run: its settings, its data, its work folder and what it has made so far."""

    config: Config
    store: Store
    work: Path
    device: str = "cpu"
    progress: bool = True
    speech: tuple[Path, ...] = ()
    """Folders of more sound for the predictive coding."""
    workers: int = 1
    """Processes that cut and encode recordings."""
    precision: str = "float32"
    """See `gesticulator.training.fit.FitOptions`."""
    memory: float | None = None
    """Bytes that the corpus may take; a larger one stays on the disk. None for any."""
    figures: dict[str, Figures] = field(default_factory=dict)
    """Stage -> its figures on the validation split, once it was asked for."""
    _values: dict[str, Any] = field(default_factory=dict, repr=False)
    _keys: dict[str, str] = field(default_factory=dict, repr=False)

    def get(self, node: Node[T]) -> T:
        """The value of a node, made (or read from the work folder) when it is asked for first. Of several processes the
        first makes it, and then the others, of the files that are kept of it."""
        if node.name not in self._values:
            if isinstance(node, Stage):
                assert node.build is not None
                for need in node.needs(self.config):
                    self.get(need)
                torch.manual_seed(self.seed(node))  # the weights that it begins with
                model = node.build(self)
                self.figures[node.name] = self.train_stage(node, model)
                self._values[node.name] = node.finish(freeze(model))
            else:
                assert node.make is not None
                make = node.make
                if distributed.processes() > 1:  # stages are trained by all of them
                    for need in node.needs(self.config):
                        self.get(need)
                self._values[node.name] = distributed.lead_first(lambda: make(self))
        return cast(T, self._values[node.name])

    def provide(self, node: Node[Any], value: Any, key: str | None = None) -> None:
        """Take `value` for a node instead of making it; key: what stands for it in the keys of all that need it (its
        own, when it is the same that would be made)."""
        self._values[node.name] = value
        if key is not None:
            self._keys[node.name] = key

    def key(self, node: Node[Any]) -> str:
        """Hash of everything that shapes a node: the data, its settings, what it needs, and for a stage its seed."""
        if node.name in self._keys:
            return self._keys[node.name]
        parts: list[Any] = [node.name, self.store.fingerprint]
        parts += [setting(self.config, path) if isinstance(path, str) else path(self.config) for path in node.settings]
        if isinstance(node, Stage):
            parts += [self.config.seed, self.schedule(node)]
        if node.of_data is not None:
            parts.append(list(node.of_data(self)))
        return digest(*parts, [self.key(need) for need in node.needs(self.config)])

    def seed(self, node: Node[Any]) -> int:
        """A seed of its own for each node, from the run's seed and the node's name: another node changes no other."""
        return int(digest(self.config.seed, node.name)[:12], 16) % 2**31

    def schedule(self, stage: Stage[Any]) -> FitSettings:
        """How long a stage is trained."""
        if stage.schedule_of is not None:
            return stage.schedule_of(self.config)
        if stage.default is not None:
            settings = from_dict(FitSettings, {**to_dict(stage.default),
                                               **self.config.schedules.others.get(stage.name, {})})
            check(settings, f"schedules.others.{stage.name}")
            return settings
        return cast(FitSettings, getattr(self.config.schedules, stage.schedule))

    def folder(self, node: Node[Any]) -> Path:
        """Where a stage is kept."""
        return self.work / f"{node.name}-{self.key(node)}"

    def finished(self, stage: Stage[Any]) -> bool:
        """Whether the work folder has the stage, whole."""
        return finished(self.folder(stage))

    def train_stage(self, stage: Stage[Any], model: nn.Module) -> Figures:
        """Load a finished stage into `model`, or train it now; its figures on the validation split."""
        folder = self.folder(stage)
        if not distributed.lead(lambda: finished(folder, model)):
            folder.mkdir(parents=True, exist_ok=True)
            assert stage.train is not None
            figures = stage.train(self, model, folder)
            distributed.lead(lambda: keep(folder, model, figures))
            if distributed.leads():
                (folder / f"{stage.name}.ckpt").unlink(missing_ok=True)
        model.cpu().load_state_dict(load_file(folder / WEIGHTS))
        return read_object(folder / FIGURES, "delete it, and train again", python=True)

    def fit(self, stage: Stage[Any], model: nn.Module, task: fitting.Task, folder: Path) -> Figures:
        """The one loop, with this run's settings."""
        return fitting.fit(stage.name, model, task, self.schedule(stage), folder, fitting.FitOptions(
            seed=self.seed(stage), device=self.device, progress=self.progress, precision=self.precision))

    def redo(self, stage: Stage[Any]) -> None:
        """Forget a stage that is finished or under way."""
        shutil.rmtree(self.folder(stage), ignore_errors=True)


WEIGHTS, FIGURES = "weights.safetensors", "figures.json"
"""Of a finished stage; the figures are written last, so that they stand for the whole."""


def keep(folder: Path, model: nn.Module, figures: Figures) -> None:
    """Write a trained stage: weights first, then the figures, each whole, synced and renamed."""
    temporary = folder / f"{WEIGHTS}.tmp"
    save_file({key: value.detach().cpu().contiguous() for key, value in model.state_dict().items()}, temporary)
    with temporary.open("rb") as written:
        os.fsync(written.fileno())
    rename(temporary, folder / WEIGHTS)
    write_text(folder / FIGURES, json.dumps(figures))


def finished(folder: Path, model: nn.Module | None = None) -> bool:
    """Whether a stage's folder holds it whole, for this model where one is given; what a crash or a full disk left of
    one counts as nothing."""
    try:
        figures = read_object(folder / FIGURES, "delete it, and train again", python=True)
        weights = load_file(folder / WEIGHTS)
    except (InputError, OSError, ValueError, SafetensorError):
        return False
    if model is not None and {key: value.shape for key, value in weights.items()} != {
            key: value.shape for key, value in model.state_dict().items()}:
        return False
    return len(figures) >= 0 and len(weights) > 0 and all(
        bool(torch.isfinite(value).all()) for value in weights.values())


def closure(stages: Sequence[Stage[Any]], config: Config) -> Iterator[Stage[Any]]:
    """Every stage among what these need, and these themselves, each once, what is needed first."""
    seen: set[str] = set()

    def visit(node: Node[Any]) -> Iterator[Stage[Any]]:
        if node.name in seen:
            return
        seen.add(node.name)
        for need in node.needs(config):
            yield from visit(need)
        if isinstance(node, Stage):
            yield node

    for stage in stages:
        yield from visit(stage)
