"""Cut speech into blocks, choose a lexeme for each, draw its motion."""
