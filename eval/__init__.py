"""Floor 3: the judges; metrics, the suite and ablations."""

__part_of__ = "gesticulator"
"""By which `gesticulator.version` tells this package from another of the same name."""
