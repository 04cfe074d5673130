"""Pictures and films: of motion, of a lexicon, of what was measured.

`DRAWINGS` are those that `gesticulator draw NAME` makes. A drawing is a module with `arguments(parser)`, which adds
what it takes, and `run(arguments)`, which gives the files that it wrote. A new one is a file and an entry here.
"""

from __future__ import annotations

from data_module.registry import Registry, RegistryEntry, is_tool

DRAWINGS: Registry[RegistryEntry] = Registry("drawings", "a drawing", {
    "strip": RegistryEntry("a motion as a row of figures: one file, or several on one page",
                           "eval.pictures.strip_page"),
    "video": RegistryEntry("a motion with its sound as a video file", "eval.pictures.video"),
    "lexicon": RegistryEntry("every lexeme: a sample gesture, its speakers and its words", "eval.pictures.lexicon_map"),
}, RegistryEntry, fits=is_tool)
