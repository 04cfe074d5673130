"""Metrics: a chapter each, with its theory, its unit, and what fools it."""
