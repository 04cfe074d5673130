"""Drawn blocks that edits start from."""
