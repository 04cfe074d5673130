"""Acceptance of a corpus of gestures."""

from data_module.registry import RegistryEntry

ENTRY = RegistryEntry("is a built data set good enough to learn from?", "gesticulator_performer.acceptance.command")
