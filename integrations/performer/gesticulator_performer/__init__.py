"""The scripted performer: real strokes played by rule on speech."""
