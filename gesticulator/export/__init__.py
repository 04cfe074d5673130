"""Writers: each takes a `gesticulator.export.writers.Scene`; `WRITERS` beside it selects by suffix."""
