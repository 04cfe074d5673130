"""The face: the mouth from the sound and the words, lids, brows and gaze, and how formats and characters show them.

The rest of the program needs two names: `track.FaceTrack`, which turns sound and events into frames, and
`motion.FaceMotion`, the frames.
"""
