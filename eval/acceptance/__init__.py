"""The acceptance: does the motion of a bundle keep the bounds of `bounds.toml`? Clause by clause."""
