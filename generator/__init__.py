"""The generator: from lexeme, style, audio and the block before to the motion of a block (RG 5.2)."""
