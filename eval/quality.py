"""How good are the models of a bundle on the test split: its lexicon and its interpreters, each beside baselines.

Each table has the rows that a reader asks for: the performer (the rule that made the corpus), the systems, always the
speaker's most frequent lexeme, and, where GESTICULATOR_DATA is set, a real take of a person speaking.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from sklearn.cluster import KMeans
from sklearn.decomposition import PCA

from data_module.blocks import cut
from data_module.motion.movement import Pasts
from data_module.store import Recording
from data_module.types import Array, Motion, Speech
from eval import stats
from eval.ablate.policy import Decisions, accuracy
from eval.baselines.interpreters import Bigram, Majority
from eval.clip.measure import real_take
from eval.context import EvalContext, provenance
from eval.metrics.encode import normalised_blocks
from eval.table import Cell, Column, Table, publish
from gesticulator.bundle import bundle as bundles
from gesticulator.options import FPS
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
        "statistical": bundle.interpreter_named("statistical"), "majority": Majority(bundle)}
    return [lexicon_table(context, context.recordings(), real_take(FPS)), accuracy_table(context, interpreters)]


# ------------------------------------------------------------------------------------------------------------ lexicon

def stroke_kinds(recording: Recording, edges: Array) -> NDArray[np.int64]:
    """For each block [N]: 1 when its middle lies in a stroke that training never showed, 0 in a known one, else -1."""
    kinds = np.full(len(edges) - 1, -1)
    middles = (edges[1:] + edges[:-1]) / 2
    for stroke in recording.truth.strokes if recording.truth else ():
        kinds[(middles >= stroke.start) & (middles < stroke.end)] = int(stroke.held_out)
    return kinds


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


def reconstructions(bundle: bundles.Bundle, motion: torch.Tensor, past: Pasts) -> dict[str, NDArray[np.float32]]:
    """Squared error of each block [N] through the lexicon, for blocks [N, K, D_m] and what came before each."""
    commonest = int(bundle.frequencies.mean(axis=0).argmax())
    return {name: ((decoded - motion) ** 2).mean(dim=(1, 2)).numpy()
            for name, decoded in retold(bundle.block_lexicon, motion, past, commonest)}


def use_of_codes(lexicon: BlockLexicon, motion: torch.Tensor, past: Pasts) -> dict[str, float]:
    """Share of the lexemes in use and their perplexity, with the mean errors."""
    if isinstance(lexicon, MovementLexicon):
        return movement_figures(lexicon, motion, past)
    return lexicon_figures(lexicon, motion)


def lexicon_table(context: EvalContext, recordings: Sequence[Recording], take: tuple[Motion, Speech] | None) -> Table:
    """Use of the codes and errors of reconstruction on the test split, in normalised features squared.

    PCA with as many components as a lexeme is wide, and k-means with as many means as there are lexemes, both fitted
    on the training split, are what a linear method of the same size does without knowing what came before. Blocks in
    strokes that training showed and in strokes that it did not are told apart. The real take is centred on its own mean
    pose, like every performer.
    """
    bundle, corpus = context.bundle, context.corpus
    train = torch.as_tensor(corpus.select("train"))
    test = torch.as_tensor(np.concatenate([corpus.blocks_of(number) for number in context.numbers()]))
    known, unknown = (corpus.motion[part].flatten(1).numpy().astype(np.float64) for part in (train, test))
    few = known[np.random.default_rng(0).permutation(len(known))[:FIT_BLOCKS]]
    # As many components as a lexeme is wide, but never more than the data can carry.
    linear = PCA(min(bundle.vectors.shape[1], *few.shape), random_state=0).fit(few)
    means = KMeans(min(bundle.config.lexicon.size, len(few)), n_init=3, random_state=0).fit(few)
    errors = {"PCA": ((linear.inverse_transform(linear.transform(unknown)) - unknown) ** 2).mean(1),
              "k-means": ((means.cluster_centers_[means.predict(unknown)] - unknown) ** 2).mean(1),
              **reconstructions(bundle, corpus.motion[test], corpus.pasts[test])}
    # Held-out strokes tell a lexicon that has learned movements from one that has stored them.
    kinds = np.concatenate([stroke_kinds(recording, cut(recording.speech, bundle.config.rhythm).edges)
                            for recording in recordings])
    for name, kind in (("quantised, strokes seen in training", 0), ("quantised, strokes never seen", 1)):
        errors[name] = np.where(kinds == kind, errors["quantised"], np.nan)
    owner = corpus.recording[test.numpy()]
    rows: Rows = {name: {"error": stats.mean_interval([
        np.nanmean(error[owner == clip]) if np.isfinite(error[owner == clip]).any() else np.nan
        for clip in np.unique(owner)])} for name, error in errors.items()}
    if take is not None:
        normalised, past = normalised_blocks(bundle.config, bundle.statistics, take[0],
                                             cut(take[1], bundle.config.rhythm))
        rows |= {f"real take (BEAT), {name}": {"error": float(error.mean())} for name, error in
                 reconstructions(bundle, normalised, past).items()}
    note = (" Movements are decoded from the true frames before each block."
            if isinstance(bundle.lexicon, MovementLexicon) else "")
    used = use_of_codes(bundle.block_lexicon, corpus.motion[test], corpus.pasts[test])
    variance = float(unknown.var(0).mean())
    return Table("Reconstruction", {"error": Column("error, normalised features squared", digits=3, good="low")}, rows,
                 "through", [f"Lexemes used on the test split: {100 * used['usage']:.0f} %; perplexity "
                             f"{used['perplexity']:.1f}. Variance of the features: {variance:.3f}. Means "
                             f"over recordings with bootstrap 95 % intervals.{note}"],
                 {**used, "variance": variance, **context.described(),
                  "seconds": sum(recording.speech.duration for recording in recordings)})


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
