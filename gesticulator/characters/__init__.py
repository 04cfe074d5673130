"""Characters of any origin: their files, their joints, motion brought onto them."""
