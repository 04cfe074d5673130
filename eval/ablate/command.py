"""Every table, figure and claim of both papers, run again on any data set.

    gesticulator ablate --data STORE --work DIR [--only NAME ...] [--preset NAME] [--seeds 3]
                        [--system NAME=DIR ...] [--out docs/results/ablation]
    gesticulator ablate --list                          every row, table and figure
    gesticulator ablate --tables [--out DIR] [--earlier DIR]
                                                        the tables and claims again, from the cells that are there, with
                                                        what an earlier run has and this one lacks

What there is (`--list`): the rows of rows.toml, each a few settings on top of a preset; RACER's rows (`racer-NAME`),
which share the lexicon and the two reward models of the row `q-network`; and the figures (`figure-N`,
`eval.ablate.figures`), drawn from what the rows left. Without --only all of it is run, in that order. A finished row
and seed is a file OUT/cells/ROW-SEED.json, and a stage is kept in the work folder under the hash of its settings. So a
command that was stopped goes on, and rows share what they have in common. Other systems' motion for the test speech
becomes a row of every table by --system; SG, Ges, GTC, S2AG and Bailando have lines of their own.

What fools it: a row trained as long as the others may need longer; MAJE and MAD praise stillness; PMB at 0.2 s is what
the papers print and near its chance level, so read the share above chance at 0.1 s; and a few seeds of the same lexicon
do not show what another lexicon would do. The paper's figures stand beside ours for their order alone: other data,
other skeleton, another network for FGD.
"""

import argparse
import os
from pathlib import Path

from data_module.errors import InputError
from eval.ablate.rows import CONTROLS, REFERENCES, ROWS, TABLES, base
from gesticulator.training.presets import PRESETS

SEEDS = 3
FIGURES = ("figure-2", "figure-5", "figure-6", "figure-9-performer", "figure-9-ours", "figure-10", "figure-11",
           "figure-14", "figure-15", "figure-16", "figure-17", "figure-18")
"""Those of `eval.ablate.figures`, which is imported when one is drawn."""


def listing() -> str:
    """The rows and figures that can be run."""
    lines = []
    for name, row in ROWS.items():
        changes = [*(f"--set {setting}" for setting in row.set), row.play, row.style, row.split, row.train]
        lines.append(f"{name:20} {row.ask}\n{'':20} {' '.join(changes)}")
    lines += [f"{name:20} {about} (stands in every table)" for name, about in {**REFERENCES, **CONTROLS}.items()]
    lines += [f"{name:20} RG Fig. {name.split('-')[1]}" for name in FIGURES]
    return "\n".join([*lines, f"tables: {', '.join(TABLES)}"])


# ------------------------------------------------------------------------------------------------------------- command

def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `gesticulator ablate`."""
    add = parser.add_argument
    add("--data", metavar="STORE", help="required, except with --list and --tables")
    add("--work", metavar="DIR", help="work folder for stages (required, except with --list and --tables)")
    add("--only", nargs="+", default=[], metavar="NAME", choices=(*ROWS, *FIGURES),
        help="rows and figures to run (default: all); the tables contain all finished ones")
    add("--preset", default="paper-quick", choices=tuple(PRESETS),
        help="the system that the rows change (paper-quick: a row and seed in a few minutes of one core)")
    add("--seeds", type=int, default=SEEDS, metavar="N", help=f"seeds 1 to N ({SEEDS})")
    add("--limit", type=int, metavar="N", help="use only the first N recordings of a split")
    add("--system", action="append", default=[], metavar="NAME=DIR", dest="systems",
        help="another system's motion for the test recordings, with the same file names")
    add("--out", default="docs/results/ablation", metavar="DIR", help="output folder for the cells and table.json, .md")
    add("--earlier", metavar="DIR", help="with --tables: the results of an earlier run (DIR/table.json and claims.json "
        "beside DIR), from which what this run lacks is taken")
    add("--list", action="store_true", help="list every row, table and figure and exit")
    add("--tables", action="store_true", help="write the tables and claims again from OUT/cells and exit")
    add("--quiet", action="store_true", help="print no progress bars")


def _checked(given: argparse.Namespace) -> dict[str, Path]:
    """The folders of other systems; InputError for what cannot be run."""
    from eval.clip.foreign import named

    for name in ("seeds", "limit"):
        value = getattr(given, name)
        if value is not None and value <= 0:
            raise InputError(f"--{name} {value}", "is too little", "choose more than 0")
    systems = named(given.systems, "--system")
    taken = [name for name in systems if name in (*ROWS, *FIGURES, *REFERENCES, *CONTROLS)]
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

        redraw(Path(arguments.out), Path(arguments.earlier) if arguments.earlier else None)
        return 0
    systems = _checked(arguments)
    # Imported here: --list and --tables need not wait for torch.
    from eval.ablate.ablation import Ablation
    from eval.ablate.cells import CellStore
    from eval.ablate.run import RgRows
    from eval.context import EvalContext, opened, provenance
    from eval.metrics.gesture_features import at_hand, spaces
    from eval.table import load, markdown
    from gesticulator.training.stages import Run

    store, work = opened(arguments.data, arguments.work)
    first = Run(base(arguments.preset), store, work, progress=not arguments.quiet, workers=os.cpu_count() or 1)
    rg = RgRows(EvalContext(first, networks=spaces(at_hand()), limit=arguments.limit))
    Ablation(rg, CellStore(Path(arguments.out))).run(arguments.only, arguments.seeds, systems, provenance(arguments))
    print(markdown(load(Path(arguments.out) / "table.json")), end="")
    return 0
