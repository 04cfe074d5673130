"""Baselines that any system must beat: motion that is known to be wrong, interpreters that know nothing, unit selection."""
