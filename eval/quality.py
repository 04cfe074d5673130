"""How good are the models of a bundle on the test split: its lexicon and its interpreters, each beside baselines."""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch

from eval import stats
from eval.ablate.policy import Decisions, accuracy
from eval.baselines.interpreters import Bigram, Majority
from eval.context import EvalContext, provenance
from eval.table import Cell, Column, Table, publish
from gesticulator.training.stages.lexicon import lexicon_figures, movement_figures
from interpreters.base import LexemeInterpreter
from interpreters.lstm import LstmInterpreter
from lexicon.movement import MovementLexicon

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
    # By their own names: a row is what `--interpreter` plays.
    interpreters: dict[str, LexemeInterpreter] = {"lstm": bundle.runners["interpreter"]}
    if "interpreter_text" in bundle.parts:
        interpreters["lstm with text"] = bundle.runners["interpreter_text"]
    interpreters |= {
        "previous lexeme and speaker": Bigram.fitted(context.corpus, context.labels, bundle.config.lexicon.size),
        "statistical": bundle.interpreter_named("statistical"), "majority": Majority(bundle)}
    return [lexicon_table(context), accuracy_table(context, interpreters)]


# ------------------------------------------------------------------------------------------------------------ lexicon

@torch.no_grad()
def lexicon_table(context: EvalContext) -> Table:
    """Use of the codes and errors of reconstruction on the test split, in normalised features squared.

    Movements are told from the true frames before each block: by their lexeme alone, and quantised, with the residual
    levels below it; "predicted" is what the body would do if nothing new came. Poses take no notice of the past.
    """
    lexicon, corpus = context.bundle.block_lexicon, context.corpus
    test = torch.as_tensor(np.concatenate([corpus.blocks_of(number) for number in context.numbers()]))
    motion = corpus.motion[test]
    figures = (movement_figures(lexicon, motion, corpus.pasts[test]) if isinstance(lexicon, MovementLexicon) else
               lexicon_figures(lexicon, motion))
    # The variance is what always playing the mean pose would cost.
    figures["variance"] = float(motion.double().var(0).mean())
    used = (f"Lexemes used on the test split: {100 * figures.pop('usage'):.0f} %; perplexity "
            f"{figures.pop('perplexity'):.1f}.")
    return Table("Reconstruction", {"error": Column("error, normalised features squared", digits=3, good="low")},
                 {name: {"error": error} for name, error in figures.items()}, "through", [used])


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
