"""The version of the package, as it stands in pyproject.toml; what writes it down need not import the package."""

__version__ = "0.1.0"
