"""Makers of the folders that the performer plays: strokes of SmartBody, takes of named gestures."""
