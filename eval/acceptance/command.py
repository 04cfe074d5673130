"""Is the motion of a bundle accepted? Every clause with its figure, interval, bound and verdict.

    gesticulator acceptance --data STORE [--bundle DIR] [--system NAME=BUNDLE_OR_DIR ...] [--renderings 8]
                            [--only lexicon motion rest effort controls stability] [--work DIR] [--out FILE.json]

The clauses stand in `bounds.toml`, in six groups that can be run alone (`--only`):

- `motion`: does it read as a person, beside the corpus, the interpreter `statistical`, which ignores the sound, unit
  selection, other systems and a real take? (`voices`, `timing`)
- `lexicon`: does a lexeme name a movement, and does the generator sample it? (`lexicon`)
- `rest`: does it rest where nothing is said, is it alive there, and does it follow `--activity`? (`rest`)
- `effort`, `controls`, `stability`: what changes with the effort of a voice, with style controls and words, and with a
  second export of the same sound? (`response`)

The bundle is played as it is: guidance and temperature are those that it was frozen with, never chosen here. Voices are
that of the real take in GESTICULATOR_DATA (every seed) and a minute of every recording of the store's test split; all
are gestured for by one speaker, the default one or `--speaker`. Renderings are cached in the work folder. The mean is
judged; what fools a figure stands in its metric's chapter.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from data_module.errors import InputError
from data_module.store import Store
from eval.acceptance import lexicon, response, rest, voices
from eval.acceptance.bounds import Results, Verdict, count, judge, summary, table, verdict_table
from eval.acceptance.voices import OURS, REAL, WITHOUT_SOUND
from eval.baselines.unit_selection import NAME as UNITS
from eval.clip.foreign import named
from eval.clip.measure import real_take
from eval.context import EvalContext, provenance
from eval.metrics.eye.body import HZ
from eval.metrics.eye.frechet import REFERENCE
from eval.metrics.eye.sample import CORPUS
from eval.renderings import (
    TAKE,
    AcceptanceVoice,
    BundleSystem,
    KeptRenderings,
    RenderedSystem,
    UnitSystem,
    held_out_voices,
    system_at,
)
from eval.table import Cell, Column, Table, publish
from gesticulator.bundle.files import bundle_folder

TITLES = {"motion": "Perceptual figures", "lexicon": "Lexemes: consistency and obedience",
          "rest": "Rest and idle motion", "effort": "Effort and level of the voice",
          "controls": "Controls, words, interpreters, cost", "stability": "The same sound exported again"}


@dataclass
class Acceptance:
    """ours: the bundle that is judged; others: systems beside it; voices: that of the real take first, where it is at
    hand; renderings: seeds of that voice."""

    context: EvalContext
    ours: BundleSystem
    others: list[RenderedSystem]
    voices: list[AcceptanceVoice]
    renderings: int

    @property
    def store(self) -> Store | None:
        """The corpus, where one was given."""
        return None if self.context.data is None else self.context.store

    def held_out(self) -> list[AcceptanceVoice]:
        """The voices of the test split."""
        return [voice for voice in self.voices if voice.place != TAKE]


GROUPS: dict[str, Callable[[Acceptance], tuple[Results, list[Table]]]] = {
    "motion": lambda job: voices.measure([job.ours, *job.others], job.voices, job.renderings, job.context.space),
    "lexicon": lambda job: (lexicon.measure(job.ours, job.store, job.held_out(), job.renderings), []),
    "rest": lambda job: (rest.measure(job.ours, job.voices, job.renderings), []),
    "effort": lambda job: (response.effort(job.ours, job.voices[0].performer, job.renderings), []),
    "controls": lambda job: response.controls(job.ours, job.voices),
    "stability": lambda job: response.same_take(job.ours, job.voices, job.renderings)}


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add = parser.add_argument
    add("--bundle", metavar="NAME|DIR", help="bundle: default, paper, or a folder (default: default)")
    add("--data", metavar="STORE",
        help="store whose test split is the corpus and whose training split is used for unit selection")
    add("--system", action="append", default=[], metavar="NAME=DIR",
        help="another bundle, such as the paper's regressing generator, or motion files (take.bvh, RECORDING.bvh)")
    add("--speaker", metavar="NAME", help="speaker who gestures (default: that of the bundle)")
    add("--renderings", type=int, default=8, metavar="N", help="seeds for the real recording's voice (default 8)")
    add("--only", nargs="+", choices=sorted(GROUPS), metavar="GROUP",
        help=f"run only these: {', '.join(GROUPS)}")
    add("--limit", type=int, metavar="N", help="maximum number of test recordings")
    add("--work", type=Path, metavar="DIR", help="work folder for renderings and units (default: STORE.work)")
    add("--out", metavar="FILE.json", help="output file for the tables; a .md is written beside it")


def run(arguments: argparse.Namespace) -> int:
    """Print all clauses, and a table for each group; InputError for what cannot be used."""
    publish(tables(arguments), arguments.out, provenance(arguments))
    return 0


def tables(arguments: argparse.Namespace) -> list[Table]:
    """The counts of all groups, and for each its verdicts and what is shown beside them."""
    torch.set_num_threads(1)
    acceptance = _opened(arguments)
    verdicts: dict[str, list[Verdict]] = {}
    shown: list[Table] = []
    for name in GROUPS:
        if arguments.only is None or name in arguments.only:
            results, beside = GROUPS[name](acceptance)
            verdicts[name] = judge(table()[name], results)
            shown += [verdict_table(TITLES[name], verdicts[name]), *beside]
    return [_whole(acceptance, verdicts), *shown]


def _opened(arguments: argparse.Namespace) -> Acceptance:
    """Open the bundle, the store and the voices; InputError for options that cannot be used."""
    for name, value in (("--renderings", arguments.renderings), ("--limit", arguments.limit)):
        if value is not None and value < 1:
            raise InputError(name, f"is {value}", "give 1 or more")
    places = named(arguments.system, "--system")
    for name in (OURS, WITHOUT_SOUND, UNITS, CORPUS, REAL):
        if name in places:
            raise InputError(f"--system {name}", "is the name of another column", "choose another")
    # Without a store nothing is kept between runs: the take's voice alone is rendered in minutes.
    store = Store.open(arguments.data) if arguments.data else None
    work = arguments.work or (None if store is None else Path(f"{store.path}.work") / "acceptance")
    cache = KeptRenderings(None if work is None else work / "renderings")
    system = BundleSystem(OURS, bundle_folder(arguments.bundle), cache)
    _ = system.bundle.block_lexicon  # a bundle of RACER's own codec has no lexemes by which blocks are sampled
    system.gesticulator.resolver.speaker(arguments.speaker)
    chosen = _voices(arguments, store, system)
    others = [system_at(name, Path(place), cache) for name, place in places.items()]
    # First among the others: what it reaches without hearing anything is what the rest must beat.
    if WITHOUT_SOUND in system.gesticulator.bundle.interpreters:
        others.insert(0, system.asking(WITHOUT_SOUND, interpreter=WITHOUT_SOUND))
    if store is not None:
        others.append(UnitSystem(UNITS, store, work, cache))
    context = EvalContext(models=system.bundle) if store is None or work is None else EvalContext.over(
        store, system.bundle, work, arguments.limit)
    return Acceptance(context, system, others, chosen, arguments.renderings)


def _voices(arguments: argparse.Namespace, store: Store | None, system: BundleSystem) -> list[AcceptanceVoice]:
    """The real take's voice and those of the test split; InputError where there is neither."""
    take = real_take(HZ, own_rig=True)
    chosen = [] if take is None else [AcceptanceVoice(TAKE, take[1], TAKE, take[0])]
    if store is not None:
        chosen += held_out_voices(store, arguments.limit, system.bundle.config.motion.joints)
    if not chosen:
        raise InputError("acceptance", "has no voice to gesture for", "give --data, or set GESTICULATOR_DATA")
    # One speaker gestures for all voices, so that figures differ by the sound and not by the performer's habits.
    return [replace(voice, performer=arguments.speaker) for voice in chosen]


def _whole(acceptance: Acceptance, verdicts: dict[str, list[Verdict]]) -> Table:
    """How many clauses of each group hold; the facts have every clause of all, and what they are of."""
    groups = {name: [verdict.entry for verdict in group] for name, group in verdicts.items()}
    entries = [entry for group in groups.values() for entry in group]
    rows: dict[str, dict[str, Cell]] = {
        TITLES[name]: dict(zip(("hold", "of"), count(group), strict=True)) for name, group in groups.items()}
    selection = acceptance.ours.bundle.config.selection
    frozen = {name: getattr(selection, name) for name in sorted(vars(selection))}
    notes = [summary(entries),
             "Sampling settings of the bundle: "
             f"{', '.join(f'{name} {value}' for name, value in frozen.items())}.",
             "Intervals are bootstrap 95 % over recordings; for one voice rendered several times, over seeds."]
    if acceptance.context.space is None:
        notes.append(f"No Frechet distance: {REFERENCE} is not in GESTICULATOR_DATA.")
    facts = {"clauses": entries, "selection": frozen, "renderings": acceptance.renderings,
             "store": None if acceptance.store is None else acceptance.store.fingerprint,
             "bundle": acceptance.ours.key,
             "voices": [{"name": voice.name, "seconds": round(voice.speech.duration, 2), "place": voice.place}
                        for voice in acceptance.voices]}
    return Table("Acceptance of the motion", {"hold": Column("clauses that hold"), "of": Column("of")}, rows, "group",
                 notes, facts)
