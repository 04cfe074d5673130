"""Writers of a performance that need more than a few lines; `gesticulator.performance.WRITERS` picks by the suffix."""
