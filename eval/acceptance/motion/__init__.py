"""Acceptance of a bundle's motion, in four groups of claims."""
