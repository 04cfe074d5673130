"""Pictures and films: of motion, of a lexicon, of what was measured.

`DRAWINGS` are those that `gesticulator draw NAME` makes. Each module has `arguments(parser)` and `run(arguments)`, that
gives the files that it wrote; it is imported when it is called.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Drawing:
    """The module that draws, and what one sees."""

    module: str
    summary: str


DRAWINGS = {
    "strip": Drawing("eval.draw.strips", "a motion as a row of still figures, with its sound and beats"),
    "video": Drawing("eval.draw.video", "a motion with its sound as a video file"),
    "lexicon": Drawing("eval.draw.lexicon_map", "every lexeme: a sample gesture, who uses it, which words go with it"),
}
