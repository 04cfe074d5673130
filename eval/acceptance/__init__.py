"""What must hold of a bundle's motion, of RACER and of a corpus, claim by claim."""
