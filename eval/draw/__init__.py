"""Pictures and films: of motion, of a lexicon, of what was measured.

`DRAWINGS` are those that `gesticulator draw NAME` makes. A drawing is a module with `arguments(parser)`, which adds
what it takes, and `run(arguments)`, which gives the files that it wrote. A new one is a file and an entry here.
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Drawing:
    """module: imported when it is called, since most need torch or matplotlib. summary: what one sees."""

    module: str
    summary: str

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add what it takes."""
        self._load().arguments(parser)

    def run(self, arguments: argparse.Namespace) -> Sequence[Path]:
        """Draw; InputError for input that cannot be used."""
        files: Sequence[Path] = self._load().run(arguments)
        return files

    def _load(self) -> Any:
        return importlib.import_module(self.module)


DRAWINGS = {
    "strip": Drawing("eval.draw.strip_page", "motion as rows of still figures: one file, or several on one page"),
    "video": Drawing("eval.draw.video", "a motion with its sound as a video file"),
    "lexicon": Drawing("eval.draw.lexicon_map", "every lexeme: a sample gesture, who uses it, which words go with it"),
}
