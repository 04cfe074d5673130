"""Floor 3: the judges; metrics, the suite and ablations."""
