"""The parts of a bundle: the models by name, each loaded when it is first used."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from torch import nn

from data_module.layers import freeze
from gesticulator.bundle.files import Weights, lexicon_hash
from gesticulator.bundle.models import Sizes, part_table, shapes

JUDGES = ("reward", "reward_judge")
"""Models that train and evaluate a policy and are not used at inference: they stay in the work folder of the training;
evaluation adds them to an opened bundle (`with_parts`). Saving a bundle omits them."""


class ChangedParts(Mapping[str, nn.Module]):
    """Parts with some replaced or removed; the others are loaded only when used."""

    def __init__(self, parts: Mapping[str, nn.Module], changes: Mapping[str, nn.Module | None]) -> None:
        unknown = sorted(set(changes) - {*part_table(), *JUDGES})
        if unknown:
            raise ValueError(f"no parts of a bundle: {', '.join(unknown)}")
        self._parts, self._changes = parts, dict(changes)

    def __getitem__(self, name: str) -> nn.Module:
        if name not in self._changes:
            return self._parts[name]
        changed = self._changes[name]
        if changed is None:
            raise KeyError(name)
        return changed

    def __iter__(self) -> Iterator[str]:
        names = [*self._parts, *(name for name in self._changes if name not in self._parts)]
        return (name for name in names if self._changes.get(name, self) is not None)

    def __len__(self) -> int:
        return sum(1 for _ in self)


class StoredParts(Mapping[str, nn.Module]):
    """The models of a bundle on disk, each loaded when it is first used."""

    def __init__(self, weights: Weights, sizes: Sizes) -> None:
        self._weights, self._sizes = weights, sizes
        self._opened: dict[str, nn.Module] = {}

    def __getitem__(self, name: str) -> nn.Module:
        if name not in self._opened:
            part = part_table().get(name)
            if part is None or part.file not in self._weights:
                raise KeyError(name)
            tied = lexicon_hash(self._sizes.lexemes) if part.tied else None
            tensors = self._weights.read(part.file, shapes(name, self._sizes), tied)
            model = part.build(self._sizes)
            model.load_state_dict(tensors)
            self._opened[name] = freeze(model)
        return self._opened[name]

    def __contains__(self, name: object) -> bool:
        part = part_table().get(str(name))
        return part is not None and part.file in self._weights

    def __iter__(self) -> Iterator[str]:
        return (name for name in part_table() if name in self)

    def __len__(self) -> int:
        return sum(1 for _ in self)
