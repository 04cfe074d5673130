"""Pictures: of motion, of a lexicon, of what was measured.

`PLOTS` are those that `gesticulator plot NAME` makes. A plot is a module with `arguments(parser)`, which adds its
options, and `run(arguments)`, which gives the files that it wrote. A new one is a file and an entry here.
"""

from __future__ import annotations

from data_module.registry import Registry, RegistryEntry, is_tool

PLOTS: Registry[RegistryEntry] = Registry("plots", "a plot", {
    "strip": RegistryEntry("a motion as a row of figures: one file, or several on one page",
                           "eval.pictures.strip_page"),
    "lexicon": RegistryEntry("the lexemes: a contact sheet, t-SNE of their blocks, and a table",
                             "eval.pictures.lexicon_map"),
}, RegistryEntry, fits=is_tool)
