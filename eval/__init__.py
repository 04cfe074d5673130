"""Floor 3: the judges; metrics, the suite, ablations and the report."""
