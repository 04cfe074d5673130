"""From plan and options to instructions for each block: knobs, cues, named gestures, edits."""
