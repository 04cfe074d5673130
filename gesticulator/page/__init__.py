"""The page of `gesticulator view`: it plays a performance, and edits its plan with the models behind it."""
