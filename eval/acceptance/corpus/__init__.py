"""Acceptance of a corpus of gestures."""
