"""Every table and figure of both papers, run again on any data set.

    gesticulator ablate --data STORE --work DIR [--only NAME ...] [--preset ablation|tiny] [--seeds 3]
                        [--bundle DIR] [--system NAME=DIR ...] [--out docs/results/ablation]
    gesticulator ablate --list                          every row, table and figure
    gesticulator ablate --tables [--out DIR]            the tables and claims again, from the cells that are there

What there is (`--list`): the rows of Rhythmic Gesticulator's tables, each a few settings on top of a preset
(`eval.rows.rg`); RACER's rows (`racer-NAME`, `eval.rows.racer`), which share a lexicon and two reward models, those
of a bundle or else trained here; and the figures (`figure-N`, `eval.ablate.figures`), drawn from what the rows left.
Without --only all of it is run, in that order. A finished (row, seed) is appended at once to OUT/cells.jsonl and a
stage is kept in the work folder under the hash of its settings, so a command that was stopped goes on, rows share
what they have in common, and two commands may divide the rows between them. When a long run is done its cells may go:
table.json and claims.json have all that was found. Other systems' motion for the test speech becomes a row of every
table by --system; SG, Ges, GTC, S2AG and Bailando have lines of their own.

What fools it: a row trained as long as the others may need longer; MAJE and MAD praise stillness; PMB at 0.2 s is what
the papers print and near its chance level, so read the share above chance at 0.1 s; and a few seeds of the same lexicon
do not show what another lexicon would do. The paper's figures stand beside ours for their order alone: other data,
other skeleton, another network for FGD.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from data_module.errors import InputError
from eval.rows import CONTROLS, REFERENCES, ROWS, TABLES, rg

if TYPE_CHECKING:
    from eval.rows.cells import Cells
    from eval.runner.row import Ablation
    from eval.table import Provenance

SEEDS = 3
TABLES_COMMAND = "gesticulator ablate --tables"
FIGURES = ("figure-2", "figure-5", "figure-6", "figure-9-performer", "figure-9-ours", "figure-10", "figure-11",
           "figure-14", "figure-15", "figure-16", "figure-17", "figure-18")
"""Those of `eval.ablate.figures`, which is imported when one is drawn."""
ELSEWHERE: dict[str, str] = {
    "RG Fig. 6, as a contact sheet with words": "plot lexicon", "RG Fig. 9, of any motion": "plot strip",
    "RG Fig. 10, of a bundle": "probe style-editing", "RG Fig. 12, RACER Fig. 4 (people)": "study",
    "RG Fig. 13 (other languages)": "probe languages",
    "RACER 4.2 (the reward)": "probe rewards",
    "all metrics, of any motion": "score"}
"""What has a verb of its own."""


def everything() -> list[str]:
    """All that --only can name, in the order in which it is run."""
    return [*ROWS, *FIGURES]


def listing() -> str:
    """What there is to run, and where the rest is."""
    lines = []
    for name, row in ROWS.items():
        changes = [*(f"--set {setting}" for setting in row.settings),
                   *([f"--interpreter {row.interpreter}"] if row.interpreter != "lstm" else []),
                   *([f"{row.style} style codes"] if row.style != "interpreted" else []),
                   *([f"on {row.split}"] if row.split != "test" else []),
                   *([row.training] if row.training not in ("stages", "offline") else [])]
        stands = dict.fromkeys(title.split(",")[0] for title, table in TABLES.items()
                               if any(line.row == name for line in table.lines))
        lines.append(f"{name:20} {row.question}\n{'':20} {' '.join(changes) or '(the preset as it is)'}\n{'':20} "
                     f"{', '.join(stands)}")
    lines += [f"{name:20} {about} (stands in every table)" for name, about in {**REFERENCES, **CONTROLS}.items()]
    lines += [f"{name:20} RG Fig. {name.split('-')[1]}" for name in FIGURES]
    lines += [f"tables: {', '.join(TABLES)}"]
    lines += [f"elsewhere: {what}: gesticulator {verb}" for what, verb in ELSEWHERE.items()]
    return "\n".join(lines)


# ------------------------------------------------------------------------------------------------------------- running

AtOnce: TypeAlias = "Callable[[Ablation, Sequence[tuple[str, int]]], dict[str, str]]"
"""Does rows and seeds at once; gives what failed, and why."""


def chosen_rows(only: Sequence[str]) -> list[str]:
    """The rows among what is asked for (all)."""
    return [name for name in ROWS if name in (only or ROWS)]


def row_seeds(names: Sequence[str], seeds: int) -> list[tuple[str, int]]:
    """All rows at one seed before the next."""
    return [(name, seed) for seed in range(1, seeds + 1) for name in names]


def run_rows(ablation: Ablation, names: Sequence[str], seeds: int) -> None:
    """Run the rows that are not finished, one after the other."""
    from tqdm import tqdm

    bar = tqdm(row_seeds(names, seeds), desc="rows", disable=not ablation.context.progress)
    for name, seed in bar:
        bar.set_postfix_str(f"{name}, seed {seed}")
        ablation.cell(name, seed)


def ablate(ablation: Ablation, *, only: Sequence[str] = (), seeds: int = SEEDS,
           systems: Mapping[str, Path] | None = None, at_once: AtOnce | None = None,
           about: Provenance | None = None) -> dict[str, Any]:
    """Run the rows and figures that are asked for (all) and not finished; write the tables of all that is finished.

    systems: folders of other systems' motion for the test speech. at_once: does rows and seeds at once and gives what
    failed. about: where the figures come from. Gives the facts of the first table.
    """
    from eval.rows.cells import family, summaries
    from eval.table import Provenance

    names, out = chosen_rows(only), ablation.cells.folder
    ablation.cells.gather()
    refused: dict[str, str] = at_once(ablation, row_seeds(names, seeds)) if at_once is not None else {}
    if not refused:  # those that failed are not tried again here
        run_rows(ablation, names, seeds)
    shared = {group: ablation.family(group).shared for group in dict.fromkeys(map(family, names))}
    if shared.keys() != {"racer"}:
        shared["rg"] = ablation.rg.shared
        for split in dict.fromkeys(["test", *(ROWS[name].split for name in names if name in rg.ROWS)]):
            for name in (*REFERENCES, *CONTROLS):
                ablation.reference(name, split)
    for name, folder in (systems or {}).items():
        ablation.system(name, folder)
    cells = current(ablation, ablation.cells.read(shared))
    facts: dict[str, Any] = {
        "preset": ablation.rg.first.config.name, "shared": shared, "refused": refused, "rows": summaries(cells),
        "store": {"name": ablation.context.store.corpus, "fingerprint": ablation.context.store.fingerprint,
                  "test_recordings": len(ablation.rg.names("test"))}}
    drawn = [name for name in FIGURES if name in (only or FIGURES)]
    if drawn:
        from eval.ablate import figures as paper

        refused |= {name: why for name in drawn if (why := paper.draw(ablation.rg, name, facts["rows"], out))}
    write(cells, facts, out, about or Provenance.now("gesticulator ablate"))
    return facts


def current(ablation: Ablation, cells: Cells) -> Cells:
    """Without the cells of rows whose settings have changed since."""
    fresh = {name: {seed: own for seed, own in by_seed.items()
                    if name not in rg.ROWS or own["key"] == ablation.key(name, seed)}
             for name, by_seed in cells.items()}
    return {name: by_seed for name, by_seed in fresh.items() if by_seed}


def write(cells: Cells, facts: Mapping[str, Any], out: Path, about: Provenance,
          decided: Provenance | None = None) -> None:
    """Table.json and claims.json with their Markdown; the claims read the probes' results beside the folder.

    about: where the cells come from; decided: where the verdicts do, if they are of another commit.
    """
    from eval.rows.decisions import claims_table
    from eval.rows.tables import all_tables
    from eval.table import save

    save(all_tables(cells, facts), out / "table.json", about)
    save([claims_table(cells, out.parent)], out.parent / "claims.json", decided or about)


def redraw(out: Path) -> None:
    """The tables and claims from the cells that are there; what they are of is read from table.json.

    InputError without either.
    """
    from eval.rows.cells import CellStore, summaries
    from eval.table import Provenance, load_with_provenance

    cells = CellStore(out).read()
    if not cells:
        raise InputError(out, "holds no cells", "run the rows first")
    held, about = load_with_provenance(out / "table.json")
    write(cells, {**held[0].facts, "rows": summaries(cells)}, out, about, Provenance.now(TABLES_COMMAND))


# ------------------------------------------------------------------------------------------------------------- command

def arguments(p: argparse.ArgumentParser) -> None:
    """What the command takes."""
    p.add_argument("--data", metavar="STORE", help="required, except with --list and --tables")
    p.add_argument("--work", metavar="DIR", help="work folder for stages (required, except with --list and --tables)")
    p.add_argument("--only", nargs="+", default=[], metavar="NAME",
                   help="rows and figures to run (default: all); the tables contain all finished ones")
    p.add_argument("--preset", default="ablation", choices=tuple(rg.PRESETS))
    p.add_argument("--set", action="append", default=[], metavar="PATH=VALUE", dest="settings",
                   help="change a setting of the preset for every row")
    p.add_argument("--seeds", type=int, default=SEEDS, metavar="N", help=f"seeds 1 to N ({SEEDS})")
    p.add_argument("--limit", type=int, metavar="N", help="use only the first N recordings of a split")
    p.add_argument("--workers", type=int, default=os.cpu_count() or 1, metavar="N",
                   help="processes for cutting and encoding the recordings")
    p.add_argument("--speech", action="append", default=[], metavar="DIR",
                   help="folder of additional audio, if the speech encoder was trained with it")
    p.add_argument("--bundle", metavar="NAME|DIR",
                   help="bundle for RACER's rows: default, paper, or a folder (default: trained here)")
    p.add_argument("--system", action="append", default=[], metavar="NAME=DIR", dest="systems",
                   help="another system's motion for the test recordings, with the same file names")
    p.add_argument("--out", default="docs/results/ablation", metavar="DIR",
                   help="output folder for cells.jsonl, table.json and .md")
    p.add_argument("--list", action="store_true", help="list every row, table and figure and exit")
    p.add_argument("--tables", action="store_true", help="write the tables again from OUT/cells.jsonl and exit")
    p.add_argument("--quiet", action="store_true", help="print no progress bars")
    many = p.add_argument_group("several machines")
    many.add_argument("--ray", metavar="WHERE",
                      help="run rows and seeds in parallel on a Ray cluster: auto, its address, or local:N for N "
                      "workers on this machine")
    many.add_argument("--slurm", nargs="*", metavar="NAME=VALUE",
                      help="submit each row and seed as a Slurm job and exit; options of submitit, such as "
                      "slurm_partition=cpu timeout_min=600 (needs submitit)")


def _checked(arguments: argparse.Namespace) -> dict[str, Path]:
    """The folders of other systems; InputError for what cannot be asked."""
    from eval.clip.foreign import named

    for name in ("seeds", "limit", "workers"):
        value = getattr(arguments, name)
        if value is not None and value <= 0:
            raise InputError(f"--{name} {value}", "is too little", "choose more than 0")
    unknown = [name for name in arguments.only if name not in everything()]
    if unknown:
        raise InputError(f"--only {' '.join(unknown)}", "is nothing to run", f"choose among {', '.join(everything())}")
    systems = named(arguments.systems, "--system")
    taken = [name for name in systems if name in (*everything(), *REFERENCES, *CONTROLS)]
    if taken:
        raise InputError(f"--system {taken[0]}", "is the name of a row", "choose another")
    if arguments.data is None or arguments.work is None:
        raise InputError("--data and --work", "are needed", "give a store and a folder to keep things in")
    return {name: Path(folder) for name, folder in systems.items()}


def run(arguments: argparse.Namespace) -> int:
    """The whole command."""
    if arguments.list:
        print(listing())
        return 0
    if arguments.tables:
        redraw(Path(arguments.out))
        return 0
    systems = _checked(arguments)
    from eval.table import load

    make = partial(ablation_of, arguments)
    if arguments.slurm is not None:
        return _submit(arguments, make)
    at_once: AtOnce | None = None
    if arguments.ray:
        from eval.runner import sweep
        from gesticulator.batch.ray_pool import check_ray, done_on_ray

        check_ray(arguments.ray)
        own = partial(ablation_of, argparse.Namespace(**{**vars(arguments), "quiet": True, "workers": 1}))
        at_once = partial(sweep.rows_at_once, make=own, outcomes=partial(done_on_ray, arguments.ray, doubles=False))
    from eval.context import provenance

    ablation = make()
    facts = ablate(ablation, only=arguments.only, seeds=arguments.seeds, systems=systems, at_once=at_once,
                   about=provenance(arguments))
    print("\n".join(table.terminal() for table in load(ablation.cells.folder / "table.json")), end="")
    return 1 if any(", seed " in name for name in facts["refused"]) else 0


def ablation_of(arguments: argparse.Namespace) -> Ablation:
    """The rows and their cells, as `arguments` ask for it; workers on other machines make it anew."""
    from eval.context import EvalContext, opened
    from eval.metrics import gesture_features
    from eval.rows.cells import CellStore
    from eval.runner.rg import RgRows
    from eval.runner.row import Ablation
    from gesticulator.bundle import config as configs
    from gesticulator.bundle.files import bundle_folder
    from gesticulator.training.stages import Run

    store, work = opened(arguments.data, arguments.work)
    base = configs.with_settings(rg.PRESETS[arguments.preset](), arguments.settings)
    first = Run(base, store, work, progress=not arguments.quiet, workers=arguments.workers,
                speech=tuple(Path(folder) for folder in arguments.speech))
    # For a first look raw directions are enough: networks take minutes to train.
    by = ([gesture_features.RawFeatures(34, count=1)] if arguments.preset == "tiny"
          else gesture_features.networks(store, work, first.progress))
    bundle = str(bundle_folder(arguments.bundle)) if arguments.bundle else None
    context = EvalContext(first, networks=gesture_features.by_name(by), limit=arguments.limit)
    return Ablation(RgRows(context), CellStore(Path(arguments.out)), bundle)


def _submit(arguments: argparse.Namespace, make: Callable[[], Ablation]) -> int:
    """Submit jobs for the rows, and say what to do when they have ended."""
    from eval.runner import sweep

    options = sweep.slurm_options(arguments.slurm)
    tasks = row_seeds(chosen_rows(arguments.only), arguments.seeds)
    if not tasks:
        raise InputError("--slurm", "is for rows, and none is asked for", "leave it out")
    folder = Path(arguments.work).absolute() / "slurm"
    jobs = sweep.submit(make, tasks, folder, options)
    print(f"{folder}: {len(jobs)} jobs, {jobs[0]} for what the rows share and {jobs[1]} to {jobs[-1]} for rows and "
          "seeds\nwhen they have ended, the same command without --slurm does what is missing and writes the tables")
    return 0
