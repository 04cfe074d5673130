"""Pictures and films: of motion, of a lexicon, of what was measured."""
