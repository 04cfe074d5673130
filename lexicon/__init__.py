"""The gesture lexicon: a VQ-VAE that names the gesture of each block (RG 5.1)."""
