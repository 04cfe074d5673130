"""What the Gumbel code of a flow generator tells: `python benchmarks/code_information.py STORE [--bundle DIR]`.

The flow loss (`generator.flow`) on the validation split with true pasts, lexemes and audio: with the codes as they are,
with the zero vector in their place, and with those of other blocks of the same recording. Differences are paired over
recordings, with the same times and noise; a code that tells something raises the loss when it is zeroed or shuffled.
The loss without the audio and without the lexemes stands beside it, for scale.
"""

from __future__ import annotations

import argparse
import shlex
import sys

import numpy as np
import torch
from torch import Tensor, nn

from data_module.errors import InputError
from eval import stats
from eval.context import opened
from eval.table import Column, Provenance, Table, publish
from generator.flow import FlowGenerator
from generator.model import GumbelCodes
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.files import INDEX, bundle_folder
from gesticulator.training.stages.corpus import Corpus, prepare
from gesticulator.training.stages.lexicon import token_labels
from gesticulator.training.stages.windows import AT_ONCE, Windows, sequences
from lexicon.movement import MovementLexicon

NOTHING = (0.0, 0.0, 0.0, 0.0)
HOW = {"codes as they are": ("kept", NOTHING), "codes zeroed": ("zeroed", NOTHING),
       "codes shuffled between blocks": ("shuffled", NOTHING), "without audio": ("kept", (1.0, 0.0, 0.0, 0.0)),
       "without lexemes": ("kept", (0.0, 1.0, 0.0, 0.0))}


class Changed(nn.Module):
    """Gumbel codes of which the vectors are kept, zeroed or shuffled between the blocks."""

    def __init__(self, codes: GumbelCodes) -> None:
        super().__init__()
        self.codes, self.how = codes, "kept"

    def best(self, hidden: Tensor) -> Tensor:
        """[B, N, K, W] of hidden [B, N, K, width]."""
        vectors = self.codes.best(hidden)
        if self.how == "zeroed":
            return torch.zeros_like(vectors)
        if self.how == "shuffled":
            blocks = vectors.flatten(0, 1)
            order = torch.randperm(len(blocks), generator=torch.Generator().manual_seed(0))
            return blocks[order].unflatten(0, vectors.shape[:2])
        return vectors


@torch.no_grad()
def losses(generator: FlowGenerator, lexicon: MovementLexicon, windows: Windows) -> dict[str, float]:
    """The flow loss of a recording's windows under each of `HOW`."""
    changed = generator.codes
    assert isinstance(changed, Changed)
    batch, out = next(iter(windows.tiled(AT_ONCE))), {}
    for name, (how, left_out) in HOW.items():
        changed.how = how
        torch.manual_seed(0)
        out[name] = float(generator.losses(batch, 1.0, lexicon.nearest, left_out)["flow"])
    return out


def measured(generator: FlowGenerator, lexicon: MovementLexicon, corpus: Corpus, split: str) -> dict[str, list[float]]:
    """The losses of every recording of a split."""
    generator.codes = Changed(generator.codes)  # type: ignore[assignment]
    labels = token_labels(lexicon, corpus)
    rows: dict[str, list[float]] = {name: [] for name in HOW}
    for part in sequences(corpus, labels, split, np.zeros(len(labels), np.int64)):
        for name, value in losses(generator, lexicon, Windows(
                corpus, [part], generator.config.blocks, moving=True)).items():
            rows[name].append(value)
    return rows


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("store", help="a store built by `gesticulator build`")
    p.add_argument("--bundle", metavar="NAME|DIR", help="bundle: default, paper, or a folder (default: default)")
    p.add_argument("--work", metavar="DIR", help="work folder with cached blocks (default: STORE.work)")
    p.add_argument("--split", default="val")
    p.add_argument("--out")
    a = p.parse_args()
    store, work = opened(a.store, a.work)
    folder = bundle_folder(a.bundle)
    bundle = bundles.load(folder)
    generator, lexicon = bundle.generator, bundle.lexicon
    if not isinstance(generator, FlowGenerator) or not isinstance(lexicon, MovementLexicon):
        raise InputError(folder, "has no flow generator", "give a bundle of system=movement")
    rows = measured(generator, lexicon, prepare(store, bundle.config, work, bundle.encoder, progress=False), a.split)
    publish([table(rows, a.split)], a.out, Provenance.now(
        shlex.join(["python", "benchmarks/code_information.py", *sys.argv[1:]]), folder / INDEX))


def table(rows: dict[str, list[float]], split: str) -> Table:
    """Losses, and by how much each lies above that of the codes as they are."""
    first = rows[next(iter(HOW))]
    cells = {name: {"loss": stats.mean_interval(own), "above": stats.paired(own, first)}
             for name, own in rows.items()}
    return Table("What the Gumbel code tells", {
        "loss": Column("flow loss", "", 4), "above": Column("above the codes as they are", "", 4)}, cells, "codes", [
        f"{len(first)} recordings of the {split} split; bootstrap 95 % intervals over recordings, differences paired."])


if __name__ == "__main__":
    main()
