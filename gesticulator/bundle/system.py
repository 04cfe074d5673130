"""The kinds of systems that a bundle may hold: its lexicon, its generator, and what follows from them.

`system_of` derives the system from the settings. Other code asks the system, not the settings, so another lexicon or
generator is one more value here. The classes that generate blocks are in higher packages: `gesticulator.drawing` has
one for each `Drawing`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gesticulator.bundle.config import Config


@dataclass(frozen=True)
class Naming:
    """A kind of lexicon.

    stage: the stage that trains it. codebook: the tensor of its code vectors. blocks: it labels blocks at the beat one
    by one, so that a block can be generated again; otherwise all codes are decoded together. in_context: what a lexeme
    shows depends on the block before. knows_silence: some of its lexemes are silent.
    """

    stage: str
    codebook: str
    blocks: bool = True
    in_context: bool = False
    knows_silence: bool = True


@dataclass(frozen=True)
class Drawing:
    """A kind of generator. name: its name. parts: required parts of a bundle besides the lexicon. idle: training stages
    that it does not use. samples: it can render a lexeme in several ways. styled: it is trained with style codes, one
    for each training block."""

    name: str
    parts: tuple[str, ...] = ()
    idle: frozenset[str] = frozenset()
    samples: bool = False
    styled: bool = False


POSES = Naming("lexicon", "quantizer.vectors")
"""The lexicon of poses (RG 5.1)."""
MOVEMENTS = Naming("lexicon", "vectors", in_context=True)
"""The lexicon of movements."""
CODES = Naming("codec", "quantizer.vectors", blocks=False, knows_silence=False)
"""RACER's codec at a fixed rate (RACER 4.1)."""

REGRESSION = Drawing("regression", ("generator", "interpreter"), frozenset(("codec",)), styled=True)
"""The paper's generator with style codes (RG 5.2)."""
FLOW = Drawing("flow", ("generator", "interpreter"), frozenset(("codec",)), samples=True)
"""The generator with a flow head, which samples."""
DECODED = Drawing("decoded", ("q_network",), frozenset(
    ("lexicon", "generator", "interpreter", "interpreter_text", "style", "style_text", "gate", "planner",
     "advantage")))
"""No generator: the codec decodes its codes (RACER 5.2)."""


@dataclass(frozen=True)
class System:
    """The kind of a bundle. naming: its lexicon; drawing: its generator; lives: rest is decided phrase by phrase, with
    idle motion (silence.rest=life)."""

    naming: Naming
    drawing: Drawing
    lives: bool

    @property
    def blocks(self) -> bool:
        """Blocks are labelled and generated one by one, with a generator and a lexeme interpreter."""
        return self.naming.blocks

    @property
    def varies(self) -> bool:
        """The same lexemes can be rendered in different ways."""
        return self.drawing.samples

    @property
    def streams(self) -> bool:
        """It can rest without speech, so that a stream can continue indefinitely."""
        return self.blocks and self.lives

    def uses(self, stage: str) -> bool:
        """Whether it uses the training stage of this name."""
        return stage not in self.drawing.idle


def system_of(config: Config) -> System:
    lives = config.silence.rest == "life"
    if config.tokens == "racer":
        return System(CODES, DECODED, lives)
    return System(MOVEMENTS if config.lexicon.kind == "movement" else POSES,
                  FLOW if config.generator.head == "flow" else REGRESSION, lives)
