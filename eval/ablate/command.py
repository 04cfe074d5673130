"""Every table, figure and claim of both papers, run again on any data set.

    gesticulator ablate --data STORE --work DIR [--only NAME ...] [--preset ablation|tiny] [--seeds 3]
                        [--bundle DIR] [--system NAME=DIR ...] [--out docs/results/ablation]
    gesticulator ablate --list                          every row, table and figure
    gesticulator ablate --tables [--out DIR]            the tables and claims again, from the cells that are there

What there is (`--list`): the rows of rows.toml, each a few settings on top of a preset; RACER's rows (`racer-NAME`),
which share a lexicon and two reward models, those of a bundle or else trained here; and the figures (`figure-N`,
`eval.ablate.figures`), drawn from what the rows left. Without --only all of it is run, in that order. A finished row
and seed is a file OUT/cells/ROW-SEED.json, and a stage is kept in the work folder under the hash of its settings. So a
command that was stopped goes on, rows share what they have in common, and several commands, on several machines that
see both folders, may divide the rows between them. Other systems' motion for the test speech becomes a row of every
table by --system; SG, Ges, GTC, S2AG and Bailando have lines of their own.

What fools it: a row trained as long as the others may need longer; MAJE and MAD praise stillness; PMB at 0.2 s is what
the papers print and near its chance level, so read the share above chance at 0.1 s; and a few seeds of the same lexicon
do not show what another lexicon would do. The paper's figures stand beside ours for their order alone: other data,
other skeleton, another network for FGD.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from data_module.errors import InputError
from eval.ablate.rows import CONTROLS, PRESETS, REFERENCES, ROWS, TABLES, is_racer

if TYPE_CHECKING:
    from eval.ablate.ablation import Ablation
    from eval.table import Provenance

SEEDS = 3
FIGURES = ("figure-2", "figure-5", "figure-6", "figure-9-performer", "figure-9-ours", "figure-10", "figure-11",
           "figure-14", "figure-15", "figure-16", "figure-17", "figure-18")
"""Those of `eval.ablate.figures`, which is imported when one is drawn."""
ELSEWHERE: dict[str, str] = {
    "RG Fig. 6, as a contact sheet with words": "plot lexicon", "RG Fig. 9, of any motion": "plot strip",
    "RG Fig. 10, of a bundle": "probe style-editing", "RG Fig. 12, RACER Fig. 4 (people)": "study",
    "RG Fig. 13 (other languages)": "score on a folder of speech of that language",
    "RACER 4.2 (the reward)": "ablate --rewards", "all metrics, of any motion": "score"}
"""Figures that have a command of their own."""


def everything() -> list[str]:
    """All that --only can name, in the order in which it is run."""
    return [*ROWS, *FIGURES]


def listing() -> str:
    """The rows that can be run, and the commands of other figures."""
    lines = []
    for name, row in ROWS.items():
        changes = [*(f"--set {setting}" for setting in row.set),
                   *([f"--interpreter {row.play}"] if row.play != "lstm" else []),
                   *([f"{row.style} style codes"] if row.style != "interpreted" else []),
                   *([f"on {row.split}"] if row.split != "test" else []),
                   *([row.train] if row.train not in ("stages", "offline") else [])]
        stands = [title for title, table in TABLES.items() if any(line.row == name for line in table.lines)]
        lines.append(f"{name:20} {row.ask}\n{'':20} {' '.join(changes) or '(the preset as it is)'}\n{'':20} "
                     f"{', '.join(stands)}")
    lines += [f"{name:20} {about} (stands in every table)" for name, about in {**REFERENCES, **CONTROLS}.items()]
    lines += [f"{name:20} RG Fig. {name.split('-')[1]}" for name in FIGURES]
    lines += [f"tables: {', '.join(TABLES)}"]
    lines += [f"elsewhere: {what}: gesticulator {command}" for what, command in ELSEWHERE.items()]
    return "\n".join(lines)


def ablate(ablation: Ablation, *, only: Sequence[str] = (), seeds: int = SEEDS,
           systems: Mapping[str, Path] | None = None, about: Provenance | None = None) -> dict[str, Any]:
    """Run the rows and figures that are asked for (all) and not finished; write the tables of all that is finished.

    systems: folders of other systems' motion for the test speech. about: where the figures come from. Gives the facts
    of the first table.
    """
    from tqdm import tqdm

    from eval.ablate.cells import summaries
    from eval.ablate.tables import write
    from eval.table import Provenance

    names, out = [name for name in ROWS if name in (only or ROWS)], ablation.cells.out
    # All rows at one seed before the next: a run that is stopped has every row.
    bar = tqdm([(name, seed) for seed in range(1, seeds + 1) for name in names], desc="rows",
               disable=not ablation.rg.context.progress)
    for name, seed in bar:
        bar.set_postfix_str(f"{name}, seed {seed}")
        ablation.cell(name, seed)
    rg_names = [name for name in names if not is_racer(name)]
    shared = {True: ablation.racer.shared} if len(rg_names) < len(names) else {}
    if rg_names or not names:
        shared[False] = ablation.rg.shared
        for split in dict.fromkeys(["test", *(ROWS[name].split for name in rg_names)]):
            for name in (*REFERENCES, *CONTROLS):
                ablation.reference(name, split)
    for name, folder in (systems or {}).items():
        ablation.system(name, folder)
    cells = ablation.current(shared)
    store = ablation.rg.context.store
    facts: dict[str, Any] = {
        "preset": ablation.rg.first.config.name, "refused": {}, "rows": summaries(cells),
        "store": {"name": store.corpus, "fingerprint": store.fingerprint,
                  "test_recordings": len(ablation.rg.names("test"))}}
    drawn = [name for name in FIGURES if name in (only or FIGURES)]
    if drawn:
        from eval.ablate import figures as paper

        facts["refused"] = {name: why for name in drawn if (why := paper.draw(ablation.rg, name, facts["rows"], out))}
    write(cells, facts, out, about or Provenance.now("gesticulator ablate"))
    return facts


# ------------------------------------------------------------------------------------------------------------- command

def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `gesticulator ablate`."""
    add = parser.add_argument
    add("--data", metavar="STORE", help="required, except with --list and --tables")
    add("--work", metavar="DIR", help="work folder for stages (required, except with --list and --tables)")
    add("--only", nargs="+", default=[], metavar="NAME",
        help="rows and figures to run (default: all); the tables contain all finished ones")
    add("--preset", default="ablation", choices=tuple(PRESETS))
    add("--set", action="append", default=[], metavar="PATH=VALUE", dest="settings",
        help="change a setting of the preset for every row")
    add("--seeds", type=int, default=SEEDS, metavar="N", help=f"seeds 1 to N ({SEEDS})")
    add("--limit", type=int, metavar="N", help="use only the first N recordings of a split")
    add("--workers", type=int, default=os.cpu_count() or 1, metavar="N",
        help="processes for cutting and encoding the recordings")
    add("--bundle", metavar="NAME|DIR",
        help="bundle for RACER's rows: default, paper, or a folder (default: trained here)")
    add("--system", action="append", default=[], metavar="NAME=DIR", dest="systems",
        help="another system's motion for the test recordings, with the same file names")
    add("--out", default="docs/results/ablation", metavar="DIR", help="output folder for the cells and table.json, .md")
    add("--list", action="store_true", help="list every row, table and figure and exit")
    add("--tables", action="store_true", help="write the tables and claims again from OUT/cells and exit")
    add("--rewards", action="store_true",
        help="measure whether the two reward models of --bundle rank motion, write OUT/rewards.json and exit")
    add("--quiet", action="store_true", help="print no progress bars")


def _checked(given: argparse.Namespace) -> dict[str, Path]:
    """The folders of other systems; InputError for what cannot be run."""
    from eval.clip.foreign import named

    for name in ("seeds", "limit", "workers"):
        value = getattr(given, name)
        if value is not None and value <= 0:
            raise InputError(f"--{name} {value}", "is too little", "choose more than 0")
    unknown = [name for name in given.only if name not in everything()]
    if unknown:
        raise InputError(f"--only {' '.join(unknown)}", "is nothing to run", f"choose among {', '.join(everything())}")
    systems = named(given.systems, "--system")
    taken = [name for name in systems if name in (*everything(), *REFERENCES, *CONTROLS)]
    if taken:
        raise InputError(f"--system {taken[0]}", "is the name of a row", "choose another")
    if given.data is None or given.work is None:
        raise InputError("--data and --work", "are needed", "give a store and a folder to keep things in")
    return {name: Path(folder) for name, folder in systems.items()}


def run(arguments: argparse.Namespace) -> int:
    """The whole command."""
    if arguments.list:
        print(listing())
        return 0
    if arguments.tables:
        from eval.ablate.tables import redraw

        redraw(Path(arguments.out))
        return 0
    systems = _checked(arguments)
    from eval.context import EvalContext, provenance
    from eval.table import load, publish

    if arguments.rewards:
        from eval.ablate.rewards import rewards

        publish(rewards(EvalContext.of(arguments)), Path(arguments.out) / "rewards.json", provenance(arguments))
        return 0
    ablation = ablation_of(arguments)
    ablate(ablation, only=arguments.only, seeds=arguments.seeds, systems=systems, about=provenance(arguments))
    print("\n".join(table.terminal() for table in load(ablation.cells.out / "table.json")), end="")
    return 0


def ablation_of(given: argparse.Namespace) -> Ablation:
    """The rows and their cells, as the arguments say."""
    from eval.ablate.ablation import Ablation
    from eval.ablate.cells import CellStore
    from eval.ablate.run import RgRows
    from eval.context import EvalContext, opened
    from eval.metrics import gesture_features
    from gesticulator.bundle import config as configs
    from gesticulator.bundle.files import bundle_folder
    from gesticulator.training.stages import Run

    store, work = opened(given.data, given.work)
    base = configs.with_settings(PRESETS[given.preset](), given.settings)
    first = Run(base, store, work, progress=not given.quiet, workers=given.workers)
    # For a first look raw directions are enough: networks take minutes to train.
    by = ([gesture_features.RawFeatures(34, count=1)] if given.preset == "tiny"
          else gesture_features.networks(store, work, first.progress))
    bundle = str(bundle_folder(given.bundle)) if given.bundle else None
    context = EvalContext(first, networks=gesture_features.by_name(by), limit=given.limit)
    return Ablation(RgRows(context), CellStore(Path(given.out)), bundle)
