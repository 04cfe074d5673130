"""Cut speech into blocks, choose a lexeme for each block, sample its motion."""
