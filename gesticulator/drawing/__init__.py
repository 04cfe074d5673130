"""Cut speech into blocks, choose a lexeme for each, sample its motion."""
