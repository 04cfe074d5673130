"""How good are the models of a bundle on the test split: its lexicon and its interpreters, each beside baselines."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from sklearn.cluster import KMeans
from sklearn.decomposition import PCA

from data_module.motion.movement import Pasts
from eval import stats
from eval.ablate.policy import Decisions, accuracy
from eval.baselines.interpreters import Bigram, Majority
from eval.context import EvalContext, provenance
from eval.table import Cell, Column, Table, publish
from gesticulator.training.stages.lexicon import BlockLexicon, lexicon_figures, movement_figures
from interpreters.base import LexemeInterpreter
from interpreters.lstm import LstmInterpreter
from lexicon.movement import MovementLexicon

FIT_BLOCKS = 20_000
"""Blocks that PCA and k-means are fitted on: more changes their errors in the third digit."""
FREQUENT, ALONE, PREDICTED = "always the most frequent lexeme", "the lexeme alone", "predicted from the past alone"
Rows = dict[str, dict[str, Cell]]


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add a store, a bundle and the output file."""
    EvalContext.arguments(parser)
    parser.add_argument("--out", metavar="FILE.json", help="output file for the tables; a .md is written beside it")


def run(arguments: argparse.Namespace) -> int:
    """Print, and with --out write, the tables of lexicon and accuracy."""
    publish(tables(arguments), arguments.out, provenance(arguments))
    return 0


def tables(arguments: argparse.Namespace) -> Sequence[Table]:
    """Reconstruction by the lexicon, and accuracy of the interpreters."""
    context = EvalContext.of(arguments)
    bundle = context.bundle
    interpreters: dict[str, LexemeInterpreter] = {"lstm": bundle.interpreter}
    if bundle.interpreter_text is not None:
        interpreters["lstm with text"] = bundle.interpreter_text
    interpreters |= {
        "previous lexeme and speaker": Bigram.fitted(context.corpus, context.labels, bundle.config.lexicon.size),
        "statistical": bundle.statistical(), "majority": Majority(bundle)}
    return [lexicon_table(context), accuracy_table(context, interpreters)]


# ------------------------------------------------------------------------------------------------------------ lexicon

@torch.no_grad()
def retold(lexicon: BlockLexicon, motion: torch.Tensor, past: Pasts, frequent: int
           ) -> Iterator[tuple[str, torch.Tensor]]:
    """Blocks [N, K, D_m] by what a lexicon keeps of them, and by the lexeme `frequent` throughout.

    Movements are told from the true frames before each block: by their lexeme alone, and quantised, with the residual
    levels below it; "predicted" is what the body would do if nothing new came. Poses take no notice of the past.
    """
    if isinstance(lexicon, MovementLexicon):
        # A movement is an addition to what the body would do anyway, so all zeros is the prediction from the past.
        true, always = lexicon.basis.coefficients(motion, past), torch.full((len(motion),), frequent)
        for name, coefficients in (("unquantised", true), ("quantised", lexicon.quantised(true)),
                                   (ALONE, lexicon.quantised(true, 0)), (FREQUENT, lexicon.added(always)),
                                   (PREDICTED, torch.zeros_like(true))):
            yield name, lexicon.basis.compose(coefficients, past)
        return
    latents = lexicon.latents(motion)
    labels = lexicon.quantizer.labels(latents)
    for name, codes in (("unquantised", latents), ("quantised", lexicon.vectors[labels]),
                        (FREQUENT, lexicon.vectors[torch.full_like(labels, frequent)])):
        yield name, torch.cat([lexicon.decode(part) for part in codes.split(4096)])


def lexicon_table(context: EvalContext) -> Table:
    """Use of the codes and errors of reconstruction on the test split, in normalised features squared.

    PCA with as many components as a lexeme is wide, and k-means with as many means as there are lexemes, both fitted
    on the training split, are what a linear method of the same size does without knowing what came before.
    """
    bundle, corpus = context.bundle, context.corpus
    train = torch.as_tensor(corpus.select("train"))
    test = torch.as_tensor(np.concatenate([corpus.blocks_of(number) for number in context.numbers()]))
    motion, past, lexicon = corpus.motion[test], corpus.pasts[test], bundle.block_lexicon
    known, unknown = (corpus.motion[part].flatten(1).numpy().astype(np.float64) for part in (train, test))
    few = known[np.random.default_rng(0).permutation(len(known))[:FIT_BLOCKS]]
    # As many components as a lexeme is wide, but never more than the data can carry.
    linear = PCA(min(bundle.vectors.shape[1], *few.shape), random_state=0).fit(few)
    means = KMeans(min(bundle.config.lexicon.size, len(few)), n_init=3, random_state=0).fit(few)
    errors = {"PCA": ((linear.inverse_transform(linear.transform(unknown)) - unknown) ** 2).mean(1),
              "k-means": ((means.cluster_centers_[means.predict(unknown)] - unknown) ** 2).mean(1),
              **{name: ((decoded - motion) ** 2).mean(dim=(1, 2)).numpy() for name, decoded in
                 retold(lexicon, motion, past, int(bundle.frequencies.mean(axis=0).argmax()))}}
    owner = corpus.recording[test.numpy()]
    rows: Rows = {name: {"error": stats.mean_interval([error[owner == clip].mean() for clip in np.unique(owner)])}
                  for name, error in errors.items()}
    if isinstance(lexicon, MovementLexicon):
        used, note = movement_figures(lexicon, motion, past), " Movements are decoded from the true frames before each."
    else:
        used, note = lexicon_figures(lexicon, motion), ""
    variance = float(unknown.var(0).mean())
    return Table("Reconstruction", {"error": Column("error, normalised features squared", digits=3, good="low")}, rows,
                 "through", [f"Lexemes used on the test split: {100 * used['usage']:.0f} %; perplexity "
                             f"{used['perplexity']:.1f}. Variance of the features: {variance:.3f}. Means "
                             f"over recordings with bootstrap 95 % intervals.{note}"],
                 {**used, "variance": variance})


# ------------------------------------------------------------------------------------------------ accuracy and motion

def accuracy_table(context: EvalContext, rows: Mapping[str, LexemeInterpreter]) -> Table:
    """Share of test blocks whose lexeme is the performer's (with the silent hint), teacher-forced and free-running.

    Both take the best score, under the silent mask. The interval is over recordings (one that reads text: over those
    with words).
    """
    columns = {"teacher_forced": Column("teacher-forced", "%", 1), "free_running": Column("free-running", "%", 1)}
    decisions = replace(Decisions.of(context.bundle, context.corpus, context.labels), masked=True)
    body: Rows = {}
    for name, interpreter in rows.items():
        # An interpreter of words is asked where there are words; elsewhere it is the one without.
        wanted = context.numbers(with_text=isinstance(interpreter, LstmInterpreter) and interpreter.config.reads)
        takes = [take for take in decisions.takes if take.recording in wanted]
        body[name] = {kind: stats.mean_interval(
            [accuracy(interpreter, decisions, take, kind == "teacher_forced") for take in takes],
            [len(take.blocks) - 1 for take in takes]) for kind in columns}
    return Table("Lexeme accuracy", columns, body, "interpreter")
