"""Floor 0: the nouns; speech, beats, blocks, motion and data sets."""
