"""Floor 3: the judges; metrics, the suite, ablations and the report."""

__part_of__ = "gesticulator"
"""By which `gesticulator.version` tells this package from another of the same name."""
