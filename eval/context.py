"""The common ground of every evaluation: recordings, settings, models, networks and a work folder, opened once.

A bundle plays; the reward models that taught its policies and judge them play nothing, so it does not hold them: they
are found in the work folder of its training, under the hash of all that shapes them.
"""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.store import Recording, Store
from eval.metrics.gesture_features import Features
from eval.table import Provenance
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.files import INDEX, bundle_folder
from gesticulator.cli import PROGRAM
from gesticulator.gesticulator import Gesticulator
from gesticulator.training.stages import CORPUS, ENCODER, Corpus, Run
from gesticulator.training.stages.caches import weights_hash
from gesticulator.training.stages.corpus import prepare
from gesticulator.training.stages.lexicon import token_labels
from lexicon.inventory import nearest_silent

Lexemes = NDArray[np.int64]


@dataclass
class EvalContext:
    """data: settings, store and work folder as training has them; None where no store was given. models: the bundle
    that is measured; None where what is measured is trained first. networks: what FGD is measured in, by name, the
    first of which tables show. limit: recordings of a split at most. seed: of renderings, draws and intervals. What is
    costly is made at its first use."""

    data: Run | None = None
    models: Bundle | None = None
    networks: Mapping[str, Features] = field(default_factory=dict)
    limit: int | None = None
    seed: int = 0

    @classmethod
    def over(cls, store: Store, bundle: Bundle, work: Path, limit: int | None = None, progress: bool = True
             ) -> EvalContext:
        """A bundle on the recordings of a store."""
        # The bundle's encoder stands in for the stage that would train one, so blocks are cut as the bundle cuts them.
        run = Run(bundle.config, store, work, progress=progress, workers=os.cpu_count() or 1)
        run.provide(ENCODER, bundle.encoder, weights_hash(bundle.encoder) if bundle.encoder else "")
        return cls(run, bundle, limit=limit)

    @staticmethod
    def arguments(parser: argparse.ArgumentParser) -> None:
        """Add the options that `of` reads."""
        parser.add_argument("--data", required=True, metavar="STORE", help="a store built by `gesticulator build`")
        parser.add_argument("--bundle", metavar="NAME|DIR",
                            help="bundle: default, paper, or a folder (default: default)")
        parser.add_argument("--work", metavar="DIR", help="work folder for cached blocks (default: STORE.work)")
        parser.add_argument("--limit", type=int, metavar="N", help="use only the first N recordings of a split")
        parser.add_argument("--quiet", action="store_true", help="print no progress bars")

    @classmethod
    def of(cls, arguments: argparse.Namespace) -> EvalContext:
        """Opened; InputError for what cannot be, and for a store without a test split."""
        if arguments.limit is not None and arguments.limit < 1:
            raise InputError(f"--limit {arguments.limit}", "leaves no recording", "choose 1 or more")
        store, work = opened(arguments.data, arguments.work)
        bundle = bundles.load(bundle_folder(arguments.bundle))
        return cls.over(store, bundle, work, arguments.limit, not arguments.quiet)

    @property
    def run(self) -> Run:
        """The data with its settings."""
        assert self.data is not None
        return self.data

    @property
    def store(self) -> Store:
        """The recordings."""
        return self.run.store

    @property
    def work(self) -> Path:
        """Where blocks, networks and renderings are kept."""
        return self.run.work

    @property
    def progress(self) -> bool:
        """True if progress bars are printed."""
        return self.run.progress

    @property
    def bundle(self) -> Bundle:
        """The bundle that is measured."""
        assert self.models is not None
        return self.models

    @cached_property
    def corpus(self) -> Corpus:
        """The store's blocks as the settings cut and hear them."""
        if self.models is None:
            return self.run.get(CORPUS)
        # A bundle that reads words is also measured on recordings without any, which training refuses.
        run = self.run
        return prepare(run.store, run.config, run.work, self.models.encoder, workers=run.workers,
                       progress=run.progress)

    @cached_property
    def labels(self) -> Lexemes:
        """[N] lexemes of all blocks by the bundle, silent blocks with the silent lexeme nearest to their own (RG
        6.4.1)."""
        bundle = self.bundle
        labels = token_labels(bundle.block_lexicon, self.corpus)
        nearest = nearest_silent(bundle.vectors.astype(np.float64), bundle.silent)
        return np.where(self.corpus.silent, nearest[labels], labels) if bundle.config.silence.hint else labels

    @cached_property
    def system(self) -> Gesticulator:
        """The pipeline that plays the bundle."""
        return Gesticulator(self.bundle)

    def numbers(self, split: str = "test", with_text: bool = False) -> list[int]:
        """Recordings of a split by their number in the corpus, `limit` at most; with_text: those that have words."""
        # The first ones, so that a limited run is a part of the whole one.
        return self.corpus.recordings(split, with_text)[:self.limit]

    def loaded(self, number: int) -> Recording:
        """A recording with its sound and motion."""
        return self.store.load(self.corpus.names[number], self.run.config.motion.joints)

def opened(data: str, work: str | None) -> tuple[Store, Path]:
    """A store with a test split, and its work folder (default: STORE.work), made where it is not there."""
    # Sums in another order differ in the last digits: one thread gives the same figures whatever the cores.
    torch.set_num_threads(1)
    store = Store.open(data)
    if not any(info.split == "test" for info in store.recordings):
        raise InputError(store.path, "has no test split", "build the store again")
    folder = Path(work) if work else Path(f"{store.path}.work")
    folder.mkdir(parents=True, exist_ok=True)
    return store, folder


def without_work(words: Sequence[str]) -> list[str]:
    """The words of a command without `--work DIR`: where what is between is kept is of this machine alone, and changes
    no figure."""
    named = {place for place, word in enumerate(words) if word == "--work"}
    return [word for place, word in enumerate(words)
            if not {place, place - 1} & named and not word.startswith("--work=")]


def provenance(arguments: argparse.Namespace) -> Provenance:
    """Where the figures of the command that is running come from: `--bundle` is measured, the shipped one where it is
    left out, and none where the command has no such option."""
    named = getattr(arguments, "bundle", None)
    # A command without the option measures no bundle, even where a shipped one is installed.
    index = bundle_folder(named) / INDEX
    return Provenance.now(shlex.join([PROGRAM, *without_work(sys.argv[1:])]),
                          index if hasattr(arguments, "bundle") and index.is_file() else None)
