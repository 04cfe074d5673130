"""The systems that a bundle may be: what names gestures, what draws them, and what follows from that.

`system_of` chooses one by the settings. Whoever needs to know asks the system, not the settings: so a further lexicon
or generator is one more value here. The classes that draw lie above bundles: `gesticulator.drawing` has one for each
`Drawing`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gesticulator.bundle.config import Config


@dataclass(frozen=True)
class Naming:
    """What names the gesture of a block.

    stage: the one that trains it. codebook: the tensor of its code vectors. blocks: it names blocks at the beat one by
    one, so that a block can be drawn anew; else all codes are decoded together. in_context: what a name shows depends
    on the block before. knows_silence: some of its names are silent.
    """

    stage: str
    codebook: str
    blocks: bool = True
    in_context: bool = False
    knows_silence: bool = True


@dataclass(frozen=True)
class Drawing:
    """What draws blocks. name: of it. parts: of a bundle, beside the lexicon, that it cannot do without. idle: stages
    that it has no use for. samples: it draws a lexeme in several ways. styled: it is taught style codes, one for each
    training block."""

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
"""RACER's own codec at a fixed rate (RACER 4.1)."""

REGRESSION = Drawing("regression", ("generator", "interpreter"), frozenset(("codec",)), styled=True)
"""The paper's generator with style codes (RG 5.2)."""
FLOW = Drawing("flow", ("generator", "interpreter"), frozenset(("codec",)), samples=True)
"""The generator with a flow head, which samples."""
DECODED = Drawing("decoded", ("q_network",), frozenset(
    ("lexicon", "generator", "interpreter", "interpreter_text", "style", "style_text", "gate", "advantage")))
"""Nothing beside the codec, which decodes its codes (RACER 5.2)."""


@dataclass(frozen=True)
class System:
    """What a bundle is. naming, drawing: see there. lives: rest is decided phrase by phrase, and the body that rests
    lives (silence.rest=life)."""

    naming: Naming
    drawing: Drawing
    lives: bool

    @property
    def blocks(self) -> bool:
        """Blocks are named and drawn one by one, with a generator and a lexeme interpreter."""
        return self.naming.blocks

    @property
    def varies(self) -> bool:
        """The same lexemes can be drawn in another manner."""
        return self.drawing.samples

    @property
    def streams(self) -> bool:
        """It knows how to rest without speech, so that a stream can go on for ever."""
        return self.blocks and self.lives

    def uses(self, stage: str) -> bool:
        """Whether a training stage of this name has a place in it."""
        return stage not in self.drawing.idle


def system_of(config: Config) -> System:
    """The system that these settings make."""
    lives = config.silence.rest == "life"
    if config.tokens == "racer":
        return System(CODES, DECODED, lives)
    return System(MOVEMENTS if config.lexicon.kind == "movement" else POSES,
                  FLOW if config.generator.head == "flow" else REGRESSION, lives)
