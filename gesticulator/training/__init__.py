"""From a store to a bundle: presets, stages, the training loop."""
