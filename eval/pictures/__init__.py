"""Pictures: of motion, of a lexicon, of what was measured.

`PLOTS` are those that `gesticulator plot NAME` makes. A plot is a module with `arguments(parser)`, which adds its
options, and `run(arguments)`, which gives the files that it wrote. A new one is a file and an entry here.
"""

from data_module.registry import Registry, RegistryEntry, Requirement


def is_tool(plugin: object) -> bool:
    """Whether an object is a module (or the like) with `arguments`, which adds its options to a parser, and `run`."""
    return callable(getattr(plugin, "arguments", None)) and callable(getattr(plugin, "run", None))


MATPLOTLIB = Requirement("matplotlib", "matplotlib", "figures")
PLOTS: Registry[RegistryEntry] = Registry("plots", "a plot", {
    "strip": RegistryEntry("motions as rows of figures, at the same seconds", "eval.pictures.strip_page",
                           needs=MATPLOTLIB),
    "lexicon": RegistryEntry("the lexemes that a store uses most, as a contact sheet", "eval.pictures.lexicon_sheet",
                             needs=MATPLOTLIB),
}, RegistryEntry, fits=is_tool)
