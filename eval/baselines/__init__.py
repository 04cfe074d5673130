"""Baselines that any system must beat: motion known to be wrong and interpreters that know nothing."""
