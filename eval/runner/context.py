"""What a probe stands on: a store, a bundle and a work folder, opened once."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.store import Recording, Store
from eval.runner.judges import with_judges
from eval.table import Provenance
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.files import INDEX
from gesticulator.cli import PROGRAM
from gesticulator.pipeline import Gesticulator
from gesticulator.training.stages.corpus import Corpus, prepare
from gesticulator.training.stages.lexicon import token_labels
from lexicon.inventory import nearest_silent

Lexemes = NDArray[np.int64]


def hinted_labels(bundle: bundles.Bundle, corpus: Corpus) -> Lexemes:
    """[N] lexemes of all blocks, silent blocks with the silent lexeme nearest to their own (RG 6.4.1)."""
    labels = token_labels(bundle.block_models.lexicon, corpus)
    nearest = nearest_silent(bundle.vectors.double().numpy(), bundle.silent)
    return np.where(corpus.silent, nearest[labels], labels) if bundle.config.silence.hint else labels


@dataclass
class EvalContext:
    """A bundle on the recordings of a store. work: where blocks are cached; limit: recordings of a split at most."""

    store: Store
    bundle: bundles.Bundle
    work: Path
    limit: int | None = None
    progress: bool = True

    @staticmethod
    def arguments(parser: argparse.ArgumentParser) -> None:
        """What `of` reads."""
        parser.add_argument("--data", required=True, metavar="STORE", help="a store built by `gesticulator build`")
        parser.add_argument("--bundle", metavar="DIR", help="bundle (default: the shipped one)")
        parser.add_argument("--work", metavar="DIR",
                            help="work folder: cached blocks and networks, and the reward models of the bundle's "
                            "training (default: STORE.work)")
        parser.add_argument("--limit", type=int, metavar="N", help="use only the first N recordings of a split")
        parser.add_argument("--quiet", action="store_true", help="print no progress bars")

    @classmethod
    def of(cls, arguments: argparse.Namespace) -> EvalContext:
        """Opened; InputError for what cannot be, and for a store without a test split."""
        torch.set_num_threads(1)
        if arguments.limit is not None and arguments.limit < 1:
            raise InputError(f"--limit {arguments.limit}", "leaves no recording", "choose 1 or more")
        store = Store.open(arguments.data)
        if not any(info.split == "test" for info in store.recordings):
            raise InputError(store.path, "has no test split", "build the store again")
        work = Path(arguments.work) if arguments.work else Path(f"{store.path}.work")
        work.mkdir(parents=True, exist_ok=True)
        bundle = with_judges(bundles.load(arguments.bundle or bundles.SHIPPED), work)
        return cls(store, bundle, work, arguments.limit, not arguments.quiet)

    @cached_property
    def corpus(self) -> Corpus:
        """The store's blocks as the bundle cuts and hears them."""
        return prepare(self.store, self.bundle.config, self.work, self.bundle.encoder, workers=os.cpu_count() or 1,
                       progress=self.progress)

    @cached_property
    def labels(self) -> Lexemes:
        """[N] the performer's lexemes, with the silent hint."""
        return hinted_labels(self.bundle, self.corpus)

    @cached_property
    def system(self) -> Gesticulator:
        """What plays the bundle."""
        return Gesticulator(self.bundle)

    def numbers(self, split: str = "test", with_text: bool = False) -> list[int]:
        """Recordings of a split by their number in the corpus, `limit` at most; with_text: those that have words."""
        return self.corpus.recordings(split, with_text)[:self.limit]

    def recordings(self, split: str = "test") -> list[Recording]:
        """The same with sound and motion."""
        joints = self.bundle.config.motion.joints
        return [self.store.load(self.corpus.names[number], joints) for number in self.numbers(split)]

    def described(self) -> dict[str, Any]:
        """What figures are of, for the facts of a table."""
        return {"store": {"name": self.store.corpus, "fingerprint": self.store.fingerprint,
                          "test_recordings": len(self.numbers())}}


def provenance(arguments: argparse.Namespace) -> Provenance:
    """Where the figures of the command that is running come from: `--bundle` is measured, the shipped one where it is
    left out, and none where the command has no such option."""
    named = getattr(arguments, "bundle", None)
    folder = bundles.SHIPPED if named in (None, "shipped") else Path(named)
    index = folder / INDEX
    return Provenance.now(shlex.join([PROGRAM, *sys.argv[1:]]),
                          index if hasattr(arguments, "bundle") and index.is_file() else None)
