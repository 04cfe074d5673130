"""The scripted performer: real strokes played by rule on speech, so that the truth of a corpus is known."""
