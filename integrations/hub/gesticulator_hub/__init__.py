"""Weights by name: bundles of a hub, and what publishes them."""
