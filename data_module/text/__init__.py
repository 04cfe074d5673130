"""What was said: transcripts, their alignment with the sound, and word vectors."""
