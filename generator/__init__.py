"""The generator: from lexeme, style, audio and the block before to the motion of a block (RG 5.2)."""

__part_of__ = "gesticulator"
"""Lets `gesticulator.version` distinguish this package from another of the same name."""
