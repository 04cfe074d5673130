"""The words of the speech: transcripts, their alignment with the sound, and word vectors."""
