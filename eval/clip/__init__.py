"""Clips: motion and speech of anybody, read, brought onto one frame rate and length, and measured."""
