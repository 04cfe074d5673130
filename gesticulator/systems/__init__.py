"""The three systems that a bundle may be. Each is one file, which reads from top to bottom like its paper.

    paper      Rhythmic Gesticulator (RG): a lexicon of poses, a regression generator with style codes
    movement   the default: a lexicon of movements, gesture units, a flow generator that samples
    racer      RACER: a codec at a fixed rate, and a Q-network that chooses among its codes

`Config.system` names one; the rest of the product asks it through the protocol `System`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol, cast

from data_module.registry import Registry, RegistryEntry

if TYPE_CHECKING:
    from collections.abc import Callable

    from torch import nn

    from gesticulator.bundle.config import Config
    from gesticulator.bundle.features import Sizes


class System(Protocol):
    """A module of this package, as the rest of the product sees it. NAME: the word of `Config.system`. PARTS: the
    models that its bundle needs besides the lexicon; STAGES: the names of its training stages in order
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

    def generator(self, sizes: Sizes) -> nn.Module:
        """The untrained generator; InputError if the system has none."""

    def style(self, sizes: Sizes, reads: bool) -> nn.Module:
        """The untrained style interpreter; reads: it also takes the words. InputError if the system has none."""


SYSTEMS: Registry[RegistryEntry] = Registry("systems", "a system", {
    "paper": RegistryEntry("Rhythmic Gesticulator as published", "gesticulator.systems.paper"),
    "movement": RegistryEntry("movements, gesture units and a flow generator", "gesticulator.systems.movement"),
    "racer": RegistryEntry("RACER as published", "gesticulator.systems.racer"),
}, RegistryEntry)
"""By name. A bundle names one of these three; other packages add interpreters, not systems."""


def system_of(config: Config) -> System:
    """The system of these settings."""
    return cast(System, SYSTEMS.load(config.system))
