"""Writers: each takes a `gesticulator.export.scene.Scene`; `gesticulator.export.writers.WRITERS` selects by suffix."""
