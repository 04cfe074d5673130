"""Floor 0: the nouns; speech, beats, blocks, motion and data sets."""

__part_of__ = "gesticulator"
"""By which `gesticulator.version` tells this package from another of the same name."""
