"""Is the motion of a bundle accepted? Every clause with its figure, interval, bound and verdict.

    gesticulator probe motion --store STORE [--bundle DIR] [--system NAME=BUNDLE_OR_DIR ...] [--renderings 8]
                              [--only lexicon motion rest effort controls] [--work DIR] [--write DIR] [--out FILE.json]

Five groups, which can be run alone (`--only`; those that were run before on the same bundle, store and program are
taken from the work folder):

- `motion`: does it read as a person, beside the corpus, the interpreter `statistical`, which ignores the sound, unit
  selection, other systems and a real take? (`seen`, against `bounds`)
- `lexicon`: does a lexeme name a movement, and is it obeyed? (`movements`)
- `rest`: does it rest where nothing is said, does it live there, and follow `--activity`? (`rest`)
- `effort`: do lively and subdued readings differ, and does level alone change nothing? (`effort`, extra `effort`)
- `controls`: do the hand controls, words, interpreters and the plan still work, and what does it cost? (`steering`)

Ours is the bundle as it is: guidance and temperature are those that it was frozen with, never chosen here. Voices are
that of the real take in GESTICULATOR_DATA (every seed) and a minute of every recording of the store's test split; all
are gestured for by one speaker, the default one or `--speaker`.
Renderings are kept in the work folder. What is judged is the mean; what fools a figure stands in its metric's chapter.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch

from data_module.errors import InputError
from data_module.files import write_text
from data_module.motion.bvh import write_bvh
from data_module.store import Store
from eval.acceptance.motion import effort, movements, rest, seen, steering
from eval.acceptance.motion.seen import DEAF, OURS, REAL
from eval.baselines.unit_selection import NAME as UNITS
from eval.claim import Verdict, count, summary, verdict_table
from eval.clip.foreign import named
from eval.clip.measure import real_take
from eval.context import EvalContext
from eval.metrics.eye.body import HZ
from eval.metrics.eye.frechet import REFERENCE
from eval.metrics.eye.sample import CORPUS
from eval.renderings import (
    PROGRAM,
    TAKE,
    AcceptanceVoice,
    BundleSystem,
    KeptRenderings,
    RenderedSystem,
    UnitSystem,
    described,
    held_out_voices,
    plan_of,
    program_key,
    system_at,
)
from eval.table import Cell, Column, Table, dumps, loads
from gesticulator.bundle.files import bundle_folder

TITLES = {"motion": "Perceptual figures", "lexicon": "Lexemes: consistency and obedience",
          "rest": "Rest and idle motion", "effort": "Effort and level of the voice",
          "controls": "Controls, words, interpreters, cost"}


@dataclass
class Acceptance:
    """Who is judged, and on which voices: the real take's first, where it is at hand."""

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
        """Those of the test split."""
        return [voice for voice in self.voices if voice.place != TAKE]


def _motion(own: Acceptance) -> tuple[list[Verdict], list[Table]]:
    return seen.run([own.ours, *own.others], own.voices, own.renderings, own.context.space)


def _lexicon(own: Acceptance) -> tuple[list[Verdict], list[Table]]:
    return movements.run(own.ours, own.store, own.held_out(), own.renderings)


def _rest(own: Acceptance) -> tuple[list[Verdict], list[Table]]:
    return rest.run(own.ours, own.voices, own.renderings)


def _effort(own: Acceptance) -> tuple[list[Verdict], list[Table]]:
    return effort.run(own.ours, own.voices[0].performer, own.renderings)


def _controls(own: Acceptance) -> tuple[list[Verdict], list[Table]]:
    return steering.run(own.ours, own.voices)


GROUPS: dict[str, Callable[[Acceptance], tuple[list[Verdict], list[Table]]]] = {
    "motion": _motion, "lexicon": _lexicon, "rest": _rest, "effort": _effort,
    "controls": _controls}


def arguments(parser: argparse.ArgumentParser) -> None:
    """What the probe takes."""
    add = parser.add_argument
    add("--bundle", metavar="NAME|DIR", help="bundle: default, paper, or a folder (default: default)")
    add("--store", metavar="STORE",
        help="store whose test split is the corpus and whose training split is used for unit selection")
    add("--system", action="append", default=[], metavar="NAME=DIR",
        help="another bundle, such as the paper's regressing generator, or motion files (take.bvh, RECORDING.bvh)")
    add("--speaker", metavar="NAME", help="speaker who gestures (default: that of the bundle)")
    add("--renderings", type=int, default=8, metavar="N", help="seeds for the real recording's voice (default 8)")
    add("--only", nargs="+", choices=sorted(GROUPS), metavar="GROUP",
        help=f"run only these: {', '.join(GROUPS)}")
    add("--limit", type=int, metavar="N", help="maximum number of test recordings")
    add("--work", type=Path, metavar="DIR", help="work folder for renderings and units (default: STORE.work)")
    add("--write", type=Path, metavar="DIR",
        help="also write our motion as DIR/VOICE.SEED.bvh, for use as a --system later")


def run(arguments: argparse.Namespace) -> list[Table]:
    """All clauses, and a table for each group; InputError for what cannot be used."""
    torch.set_num_threads(1)
    own, work = _opened(arguments)
    key = _key(own)
    entries: dict[str, list[dict[str, Any]]] = {}
    shown: list[Table] = []
    for name, group in GROUPS.items():
        file = None if work is None else work / f"{name}.{key}.json"
        if arguments.only is None or name in arguments.only:
            found, tables = group(own)
            made = [verdict_table(TITLES[name], found), *tables]
            if file is not None:
                file.parent.mkdir(parents=True, exist_ok=True)
                write_text(file, dumps([table.to_dict() for table in made]))
        elif file is not None and file.is_file():
            made = [Table.from_dict(held) for held in loads(file.read_text(encoding="utf-8"))]
        else:
            continue
        entries[TITLES[name]] = list(made[0].facts["clauses"])
        shown += made
    if arguments.write is not None:
        _write(own, arguments.write)
    return [_whole(own, entries), *shown]


def _opened(arguments: argparse.Namespace) -> tuple[Acceptance, Path | None]:
    """What is judged, and the work folder."""
    for name, value in (("--renderings", arguments.renderings), ("--limit", arguments.limit)):
        if value is not None and value < 1:
            raise InputError(name, f"is {value}", "give 1 or more")
    places = named(arguments.system, "--system")
    for name in (OURS, DEAF, UNITS, CORPUS, REAL):
        if name in places:
            raise InputError(f"--system {name}", "is the name of a column of its own", "choose another")
    store = Store.open(arguments.store) if arguments.store else None
    work = arguments.work or (None if store is None else Path(f"{store.path}.work") / "acceptance")
    kept = KeptRenderings(None if work is None else work / "renderings")
    ours = BundleSystem(OURS, bundle_folder(arguments.bundle), kept)
    _ = ours.bundle.block_models  # a bundle of RACER's own codec has no lexemes that blocks are drawn by
    ours.gesticulator.speaker_index(arguments.speaker)
    take = real_take(HZ, own_rig=True)
    voices = [] if take is None else [AcceptanceVoice("take", take[1], TAKE, take[0])]
    if store is not None:
        voices += held_out_voices(store, arguments.limit, ours.bundle.config.motion.joints)
    voices = [replace(voice, performer=arguments.speaker) for voice in voices]
    if not voices:
        raise InputError("probe motion", "has no voice to gesture for", "give --store, or set GESTICULATOR_DATA")
    others = [system_at(name, Path(place), kept) for name, place in places.items()]
    if DEAF in ours.gesticulator.interpreters:
        others.insert(0, ours.asking(DEAF, interpreter=DEAF))
    if store is not None:
        others.append(UnitSystem(UNITS, store, work, kept))
    context = EvalContext(models=ours.bundle) if store is None or work is None else EvalContext.over(
        store, ours.bundle, work, arguments.limit)
    return Acceptance(context, ours, others, voices, arguments.renderings), work


def _key(own: Acceptance) -> str:
    """Of what the figures are of, and of what measures them."""
    told = [own.ours.key, program_key((*PROGRAM, "eval")), [voice.key for voice in own.voices], own.renderings,
            [system.name for system in own.others], own.voices[0].performer]
    return hashlib.sha256(json.dumps(told).encode()).hexdigest()[:16]


def _whole(own: Acceptance, groups: Mapping[str, Sequence[Mapping[str, Any]]]) -> Table:
    """How many clauses of each group hold; the facts have every clause of all, and what they are of."""
    entries = [entry for each in groups.values() for entry in each]
    rows: dict[str, dict[str, Cell]] = {
        title: dict(zip(("hold", "of"), count(each), strict=True)) for title, each in groups.items()}
    selection = own.ours.bundle.config.selection
    frozen = {name: getattr(selection, name) for name in sorted(vars(selection))}
    notes = [summary(entries),
             "Sampling settings of the bundle: "
             f"{', '.join(f'{name} {value}' for name, value in frozen.items())}.",
             "Intervals are bootstrap 95 % over recordings; for one voice rendered several times, over seeds."]
    if own.context.space is None:
        notes.append(f"No Frechet distance: {REFERENCE} is not in GESTICULATOR_DATA.")
    facts = {"clauses": entries, "selection": frozen, "renderings": own.renderings,
             "store": None if own.store is None else own.store.fingerprint, "bundle": own.ours.key,
             **described(own.voices)}
    return Table("Acceptance of the motion", {"hold": Column("clauses that hold"), "of": Column("of")}, rows, "group",
                 notes, facts)


def _write(own: Acceptance, folder: Path) -> None:
    """Ours as files that `--system NAME=folder` reads: every voice as in the group `motion`."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, (voice, (made, _)) in enumerate(seen.renderings_on(own.ours, own.voices, own.renderings)):
        stem = folder / f"{voice.name}.{number}"
        write_bvh(stem.with_name(stem.name + ".bvh"), made.motion)
        write_text(stem.with_name(stem.name + ".json"), plan_of(made))
