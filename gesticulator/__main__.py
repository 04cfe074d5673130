"""`python -m gesticulator VERB ...`: the one door."""

from gesticulator.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
