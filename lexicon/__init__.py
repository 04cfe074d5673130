"""The gesture lexicon: a VQ-VAE that names the gesture of each block (RG 5.1)."""

__part_of__ = "gesticulator"
"""Lets `gesticulator.version` distinguish this package from another of the same name."""
