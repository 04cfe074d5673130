"""Floor 0: the nouns; speech, beats, blocks, motion and data sets."""

__part_of__ = "gesticulator"
"""Lets `gesticulator.version` distinguish this package from another of the same name."""
