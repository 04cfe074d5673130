"""The generator: from lexeme, style, audio and the block before to the motion of a block (RG 5.2)."""

__part_of__ = "gesticulator"
"""By which `gesticulator.version` tells this package from another of the same name."""
