"""The network of the lips: its training on speech of known phones."""
