"""From a plan and wishes to what is drawn: knobs, cues, gestures by name, edits."""
