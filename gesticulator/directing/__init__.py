"""From plan and options to directions for each block: knobs, cues, named gestures, edits."""
