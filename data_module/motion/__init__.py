"""Motion: formats, rotations, skeletons, representations, and when a motion has its beats."""
