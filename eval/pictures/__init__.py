"""Pictures and films: of motion, of a lexicon, of what was measured.

`DRAWINGS` are those that `gesticulator draw NAME` makes. A drawing is a module with `arguments(parser)`, which adds
what it takes, and `run(arguments)`, which gives the files that it wrote. A new one is a file and an entry here.
"""

from __future__ import annotations

DRAWINGS: dict[str, tuple[str, str]] = {
    "strip": ("eval.pictures.strip_page", "a motion as a row of figures: one file, or several on one page"),
    "video": ("eval.pictures.video", "a motion with its sound as a video file"),
    "lexicon": ("eval.pictures.lexicon_map", "every lexeme: a sample gesture, its speakers and its words"),
}
"""By name: the module, and one line about it."""
