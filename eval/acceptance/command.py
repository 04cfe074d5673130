"""Is the motion of a bundle accepted? Every clause with its figure, interval, bound and verdict.

    gesticulator acceptance --data STORE [--bundle DIR] [--renderings 8]
                            [--only lexicon motion rest effort controls stability] [--out FILE.json]

The clauses stand in `bounds.toml`, in six groups that can be run alone (`--only`):

- `motion`: does it read as a person, beside the interpreter `statistical`, which ignores the sound, and beside the
  speakers themselves, the real take and the corpus? (`voices`)
- `lexicon`: does a lexeme name a movement, and does the generator sample it? (`lexicon`)
- `rest`: does it rest where nothing is said, is it alive there, and does it follow `--activity`? (`rest`)
- `effort`, `controls`, `stability`: what changes with the effort of a voice, with style controls and words, and with a
  second export of the same sound? (`response`)

The bundle is played as it is: guidance and temperature are those that it was frozen with, never chosen here. Voices are
that of the real take in GESTICULATOR_DATA (every seed) and a minute of every recording of the store's test split; all
are gestured for by one speaker, the default one or `--speaker`. The mean is judged; what fools a figure stands in its
metric's chapter.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass

import torch

from data_module.errors import InputError
from data_module.store import Store
from eval.acceptance import lexicon, response, rest, voices
from eval.acceptance.bounds import Results, Verdict, judge, summary, table, verdict_table
from eval.acceptance.voices import OURS
from eval.clip.excerpts import real_take
from eval.context import provenance
from eval.metrics.eye import ReferenceSpace
from eval.metrics.eye.body import HZ
from eval.metrics.eye.frechet import REFERENCE
from eval.renderings import TAKE, AcceptanceVoice, BundleSystem, held_out_voices
from eval.table import Table, publish
from gesticulator.bundle.files import bundle_folder

TITLES = {"motion": "Perceptual figures", "lexicon": "Lexemes: consistency and obedience",
          "rest": "Rest and idle motion", "effort": "Effort and level of the voice",
          "controls": "Controls, words, interpreters, cost", "stability": "The same sound exported again"}


@dataclass(frozen=True)
class Acceptance:
    """system: the bundle that is judged; store: the corpus, where one was given; voices: that of the real take first,
    where it is at hand; renderings: seeds of that voice."""

    system: BundleSystem
    store: Store | None
    voices: list[AcceptanceVoice]
    renderings: int


Group = Callable[[Acceptance], dict[str, Results]]
GROUPS: dict[str, Group] = {
    "motion": lambda job: voices.measure(job.system, job.voices, job.renderings, ReferenceSpace.found()),
    "lexicon": lambda job: {OURS: lexicon.measure(
        job.system, job.store, [voice for voice in job.voices if voice.place != TAKE], job.renderings)},
    "rest": lambda job: {OURS: rest.measure(job.system, job.voices, job.renderings)},
    "effort": lambda job: {OURS: response.effort(job.system, job.renderings)},
    "controls": lambda job: {OURS: response.controls(job.system, job.voices)},
    "stability": lambda job: {OURS: response.same_take(job.system, job.voices, job.renderings)}}
"""Figures by group, of ours and of what stands beside it."""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add = parser.add_argument
    add("--bundle", metavar="NAME|DIR", help="bundle: default, paper, or a folder (default: default)")
    add("--data", metavar="STORE", help="store whose test split is the corpus")
    add("--speaker", metavar="NAME", help="speaker who gestures (default: that of the bundle)")
    add("--renderings", type=int, default=8, metavar="N", help="seeds for the real recording's voice (default 8)")
    add("--only", nargs="+", choices=sorted(GROUPS), default=list(GROUPS), metavar="GROUP",
        help=f"run only these: {', '.join(GROUPS)}")
    add("--limit", type=int, metavar="N", help="maximum number of test recordings")
    add("--out", metavar="FILE.json", help="output file for the tables; a .md is written beside it")


def run(arguments: argparse.Namespace) -> int:
    """Print all clauses, and a table for each group; InputError for what cannot be used."""
    publish(tables(arguments), arguments.out, provenance(arguments))
    return 0


def tables(arguments: argparse.Namespace) -> list[Table]:
    """How many clauses hold, and for each group its verdicts."""
    torch.set_num_threads(1)
    acceptance = _opened(arguments)
    every: list[Verdict] = []
    shown: list[Table] = []
    for name in (name for name in GROUPS if name in arguments.only):
        verdicts = {column: judge(table()[name], results) for column, results in GROUPS[name](acceptance).items()}
        every += (ours := verdicts.pop(OURS))
        shown.append(verdict_table(TITLES[name], ours, verdicts))
    notes = [summary(every), "Intervals are bootstrap 95 % over recordings; for one voice rendered several times, over "
             'seeds. "!": outside of the bound.']
    if ReferenceSpace.found() is None:
        notes.append(f"No Frechet distance: {REFERENCE} is not in GESTICULATOR_DATA.")
    return [Table("Acceptance of the motion", {}, {}, notes=notes), *shown]


def _opened(arguments: argparse.Namespace) -> Acceptance:
    """Open the bundle, the store and the voices; InputError for options that cannot be used."""
    for name, value in (("--renderings", arguments.renderings), ("--limit", arguments.limit)):
        if value is not None and value < 1:
            raise InputError(name, f"is {value}", "give 1 or more")
    store = Store.open(arguments.data) if arguments.data else None
    system = BundleSystem(bundle_folder(arguments.bundle), arguments.speaker)
    _ = system.bundle.block_lexicon  # a bundle of RACER's own codec has no lexemes by which blocks are sampled
    system.gesticulator.resolver.speaker(arguments.speaker)
    take = real_take(HZ, own_rig=True)
    chosen = [] if take is None else [AcceptanceVoice(TAKE, take[1], TAKE, take[0])]
    if store is not None:
        chosen += held_out_voices(store, arguments.limit, system.bundle.config.motion.joints)
    if not chosen:
        raise InputError("acceptance", "has no voice to gesture for",
                         "give --data with test recordings of 20 s, or set GESTICULATOR_DATA")
    return Acceptance(system, store, chosen, arguments.renderings)
