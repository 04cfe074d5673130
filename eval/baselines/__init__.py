"""Baselines that any system must beat: motion known to be wrong, interpreters that know nothing, unit selection."""
