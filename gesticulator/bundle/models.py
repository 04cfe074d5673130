"""Constructs every model of a bundle, for training and for loading.

Lexicon, generator and style interpreter are those of the system (`System`). Model shapes that depend on
the data and not on the settings are passed as `Sizes`. Each model's module is imported by the function that builds it,
so that loading one part imports only that part. The parts of a bundle on disk are loaded on first use (`LazyParts`).
"""

from __future__ import annotations

from collections import UserDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast

from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.layers_run import Tensors
from data_module.registry import Registry, RegistryEntry
from gesticulator.bundle.config import Config, RewardConfig
from gesticulator.bundle.features import CONTROL_WIDTH, Sizes
from gesticulator.bundle.files import Weights, lexicon_hash
from interpreters import InterpreterEntry, class_at, entries
from interpreters.base import InterpreterSizes

if TYPE_CHECKING:
    from torch import nn

    from interpreters.reward import RewardEnsemble


class System(Protocol):
    """A module of `gesticulator.systems`, as the rest of the product sees it. NAME: the word of `Config.system`. PARTS:
    the models that its bundle needs besides the lexicon; STAGES: the names of its training stages in order
    (`gesticulator.training.stages`), whether or not the settings want each. CODEBOOK: the name of the tensor of code
    vectors in the lexicon's file. BLOCKS: blocks at the beat are generated one by one, so that a single one can be
    generated again; IN_CONTEXT: the motion of a lexeme depends on the block before; SILENCE: some lexemes are silent
    (RG 6.4.1); VARIES: the same lexemes can be sampled as different motion. begin, step: of the same arguments as those
    of `gesticulator.sampling.loop`; motion_of: the motion [N, K, D_m] of all N blocks."""

    NAME: str
    PARTS: tuple[str, ...]
    STAGES: tuple[str, ...]
    CODEBOOK: str
    BLOCKS: bool
    IN_CONTEXT: bool
    SILENCE: bool
    VARIES: bool
    begin: Callable[..., Any]
    step: Callable[..., Any]
    motion_of: Callable[..., Any]

    def codebook_shape(self, config: Config) -> tuple[int, int]:
        """(S, D_s): the number of lexemes, and the width of a lexeme's vector."""

    def lexicon(self, sizes: Sizes) -> nn.Module:
        """The untrained lexicon or codec."""

    def lexicon_runner(self, sizes: Sizes, tensors: Tensors) -> Any:
        """The lexicon or codec as it is played."""

    def generator(self, sizes: Sizes) -> nn.Module:
        """The untrained generator; InputError if the system has none."""

    def generator_runner(self, sizes: Sizes, tensors: Tensors) -> Any:
        """The generator as it is played."""

    def style(self, sizes: Sizes, reads: bool) -> nn.Module:
        """The untrained style interpreter; reads: it also takes the words. InputError if the system has none."""

    def style_runner(self, sizes: Sizes, reads: bool, tensors: Tensors) -> Any:
        """The style interpreter as it is played."""


SYSTEMS: Registry[RegistryEntry] = Registry("systems", "a system", {
    "paper": RegistryEntry("Rhythmic Gesticulator as published", "gesticulator.systems.paper"),
    "movement": RegistryEntry("movements, gesture units and a flow generator", "gesticulator.systems.movement"),
    "racer": RegistryEntry("RACER as published", "gesticulator.systems.racer"),
}, RegistryEntry)
"""By name. A bundle names one of these three; other packages add interpreters, not systems."""


def system_of(config: Config) -> System:
    """The system of these settings."""
    return cast(System, SYSTEMS.load(config.system))


def reward(sizes: Sizes, config: RewardConfig) -> RewardEnsemble:
    """An ensemble of E_m and E_u (RACER 4.2): the one that trains a policy (settings "reward"), or one of other sizes
    that evaluates it ("judge")."""
    from interpreters.reward import RewardEnsemble

    # The term compares lexemes that follow one another.
    if not system_of(sizes.config).IN_CONTEXT:
        config = replace(config, choice=0.0)  # only movements are decoded in context, lexeme by lexeme
    return RewardEnsemble(config, sizes.frames, sizes.motion, sizes.block_audio)


@dataclass(frozen=True)
class BundlePart:
    """A part of a bundle. file: without the suffix; build: returns the untrained model; play: returns the runner that
    plays its weights; tied: whether its weights are valid only for the codebook that they were trained with."""

    file: str
    build: Callable[[Sizes], nn.Module]
    play: Callable[[Sizes, Tensors], Any]
    tied: bool = False


def _of_modules(file: str, model: str, runner: str, settings: Callable[[Sizes], tuple[Any, ...]], tied: bool = False
                ) -> BundlePart:
    """A part whose model and runner, each a module and a class, take the same arguments."""
    return BundlePart(file, lambda sizes: class_at(model)(*settings(sizes)),
                      lambda sizes, tensors: class_at(runner)(*settings(sizes), tensors), tied)


PARTS = {"encoder": _of_modules("speech_encoder", "data_module.speech.speech_encoder:SpeechEncoder",
                                "data_module.speech.speech_encoder_run:SpeechEncoderRunner",
                                lambda sizes: (sizes.config.encoder.width,)),
         "lexicon": BundlePart("lexicon", lambda sizes: system_of(sizes.config).lexicon(sizes),
                               lambda sizes, tensors: system_of(sizes.config).lexicon_runner(sizes, tensors)),
         "generator": BundlePart("generator", lambda sizes: system_of(sizes.config).generator(sizes),
                                 lambda sizes, tensors: system_of(sizes.config).generator_runner(sizes, tensors)),
         "style": BundlePart("style_interpreter", lambda sizes: system_of(sizes.config).style(sizes, False),
                             lambda sizes, tensors: system_of(sizes.config).style_runner(sizes, False, tensors)),
         "style_text": BundlePart("style_interpreter_text", lambda sizes: system_of(sizes.config).style(sizes, True),
                                  lambda sizes, tensors: system_of(sizes.config).style_runner(sizes, True, tensors)),
         "gate": _of_modules("gate", "interpreters.gate:ActivityGate", "interpreters.gate_run:GateRunner",
                             lambda sizes: (sizes.config.gate, sizes.frames, sizes.low, sizes.speakers)),
         "planner": _of_modules("planner", "interpreters.planner:UnitPlanner", "interpreters.planner_run:PlannerRunner",
                                lambda sizes: (sizes.config.planner, sizes.frames, sizes.low, sizes.speakers,
                                               len(sizes.lexemes)), tied=True)}
"""The parts other than lexeme interpreters; only the lexicon is always present."""


def part_table() -> dict[str, BundlePart]:
    """Every part that a bundle may have, including those of all registered lexeme interpreters."""
    # Computed on each call, because packages can be registered while the program runs.
    return {**PARTS, **{part: BundlePart(file, partial(_interpreter, entry, part), partial(_playing, entry, part),
                                     entry.tied)
                        for entry in entries().values() for part, file in entry.files.items()}}


def _interpreter(entry: InterpreterEntry, part: str, sizes: Sizes) -> nn.Module:
    """The model of a lexeme interpreter, with or without text."""
    model: nn.Module = entry.load_model().build(*_settled(entry, part, sizes))
    return model


def _playing(entry: InterpreterEntry, part: str, sizes: Sizes, tensors: Tensors) -> Any:
    """The runner of a lexeme interpreter, with or without text."""
    return entry.load_runner()(*_settled(entry, part, sizes), tensors)


def _settled(entry: InterpreterEntry, part: str, sizes: Sizes) -> tuple[Any, InterpreterSizes]:
    """The settings and the sizes of a lexeme interpreter."""
    # The audio-only twin has the same settings, but no layer for words.
    settings = getattr(sizes.config, entry.settings)
    if entry.text_part and part != entry.text_part:
        settings = settings.without_text()
    return settings, interpreter_sizes(sizes)


def interpreter_sizes(sizes: Sizes) -> InterpreterSizes:
    """Those that interpreters depend on."""
    return InterpreterSizes(sizes.frames, sizes.low, sizes.high, sizes.speakers, sizes.text, CONTROL_WIDTH,
                            sizes.motion, sizes.lexemes, sizes.silent)


def build(part: str, sizes: Sizes) -> Any:
    return part_table()[part].build(sizes)


def runner_of(name: str, sizes: Sizes, model: Any, source: object = "the weights") -> Any:
    """The runner of a part: of its trained model, or of its tensors by name, which are from `source`. A model without
    weights is played itself. InputError for inconsistent settings, and for tensors of others."""
    if not isinstance(model, Mapping):
        if not hasattr(model, "state_dict"):
            return model
        model = {key: value.detach().cpu().numpy() for key, value in trained_tensors(model).items()}
    tensors = Tensors(model, source)
    try:
        runner = part_table()[name].play(sizes, tensors)
    except (ValueError, IndexError, OverflowError, ZeroDivisionError) as error:
        raise InputError("settings", f"no {name} can be built of them ({str(error).splitlines()[0][:200]})",
                         "change them") from None
    tensors.finish()
    return runner


def trained_tensors(model: nn.Module) -> dict[str, Any]:
    """The tensors of a trained model that are used at inference."""
    # The table of style codes ("styles.") belongs to the training blocks.
    return {key: value for key, value in model.state_dict().items() if not key.startswith("styles.")}


JUDGES = ("reward", "reward_judge")
"""Models that train and evaluate a policy and are not used at inference: they stay in the work folder of the training;
evaluation adds them to an opened bundle (`with_parts`). Saving a bundle omits them."""


@dataclass(frozen=True)
class StoredPart:
    """A part of a bundle on disk, under its name in `part_table`."""

    name: str
    weights: Weights
    sizes: Sizes

    def played(self) -> Any:
        """The runner; InputError for a broken file, or one of other settings."""
        return runner_of(self.name, self.sizes, *self.read())

    def trained(self) -> nn.Module:
        """The trained model, for training and evaluation; InputError as of `played`."""
        import torch

        from data_module.layers import freeze

        part = part_table()[self.name]
        # Its shapes are checked before the model is built: a width in a broken index could take all memory.
        self.played()
        (tensors, file), model = self.read(), part.build(self.sizes)
        try:
            model.load_state_dict({key: torch.as_tensor(value) for key, value in tensors.items()})
        except RuntimeError as error:
            raise InputError(file, f"does not fit the settings ({str(error)[:200]})", "train it again") from None
        return freeze(model)

    def read(self) -> tuple[dict[str, NDArray[Any]], Path]:
        """Its tensors, and the file that they are from."""
        part = part_table()[self.name]
        tied = lexicon_hash(self.sizes.lexemes) if part.tied else None
        return self.weights.read(part.file, tied), self.weights.path(part.file)


class LazyParts(UserDict[str, Any]):
    """Parts by name; those that are given by a function are made when they are first used."""

    def get(self, name: str, default: Any = None) -> Any:
        # Not that of `Mapping`, which would hide a KeyError raised while loading.
        return self[name] if name in self.data else default

    def __getitem__(self, name: str) -> Any:
        part = self.data[name]
        if isinstance(part, partial):
            # Kept, because loading reads and checks a file.
            part = self.data[name] = part()
        return part


def stored_parts(weights: Weights, sizes: Sizes) -> dict[str, StoredPart]:
    """The parts of a bundle on disk."""
    return {name: StoredPart(name, weights, sizes) for name, part in part_table().items() if part.file in weights}
