"""Characters of any origin: their files read into one type, `Character`, and their joints found."""

from gesticulator.characters.rig import Character

__all__ = ["Character"]
