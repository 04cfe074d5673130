"""Every table and figure of both papers, run again on any data set.

    python -m eval.ablate --data STORE --work DIR [--only NAME ...] [--preset ablation|tiny] [--seeds 3]
                          [--budget SECONDS] [--bundle DIR] [--system NAME=DIR ...] [--out docs/results/ablation]
                          [--list]

What there is (`--list`): the rows of Rhythmic Gesticulator's tables, each a few settings on top of a preset
(`eval.ablations`); RACER's rows (`racer-NAME`, `eval.racer_ablation`), which share a lexicon and two reward models,
those of a bundle or else trained here; and the figures (`figure-N`, `eval.ablation_figures`), drawn from what the rows
left. Without --only all of it is run, in that order. A finished (row, seed) is written at once as ROW-SEED.json and a
stage is kept in the work folder under the hash of its settings, so a command that was stopped goes on, rows share what
they have in common, and two commands may divide the rows between them. Other systems' motion for the test speech
becomes a row of every table by --system; SG, Ges, GTC, S2AG and Bailando have lines of their own.

What fools it: a row trained as long as the others may need longer; MAJE and MAD praise stillness (see joint_error.py);
PMB at 0.2 s is what the papers print and near its chance level, so read the share above chance at 0.1 s; and a few
seeds of the same lexicon do not show what another lexicon would do. The paper's figures stand beside ours for their
order alone: other data, other skeleton, another network for FGD.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from tqdm import tqdm

from data_module.errors import InputError, one_line_errors
from data_module.store import Store
from eval import policies, racer_ablation
from eval.ablation_bench import Bench, counted
from eval.ablation_cells import bundle_of, cell, reference, row_key, system
from eval.ablation_figures import FIGURES, draw
from eval.ablation_tables import file_of, finished, markdown, read_cells, tabled
from eval.ablations import CONTROLS, PRESETS, RACER, RACER_PRESETS, REFERENCES, ROWS, listing
from eval.metrics import gesture_features
from eval.results import keep
from eval.score import named
from gesticulator import bundle as bundles
from gesticulator import config as configs
from gesticulator.racer import train_reward

SEEDS = 3
RACER_FOLDER = "racer"
"""Where RACER's cells are, beside the folder of the others."""


def everything() -> list[str]:
    """All that --only can name, in the order in which it is run."""
    return [*ROWS, *RACER, *FIGURES]



def over(bench: Bench, name: str, seed: int, budget: float) -> str:
    """Why a row is refused: what its training would cost at a seed, where that is over the budget in seconds."""
    cost = counted(bench, name, seed)
    if sum(cost.values()) <= budget:
        return ""
    return (f"{sum(cost.values()):.0f} s of training counted at seed {seed}, {budget:g} s allowed "
            f"({', '.join(f'{stage} {s:.0f}' for stage, s in cost.items() if s)})")


def run_rows(bench: Bench, out: Path, names: Sequence[str], seeds: int, budget: float | None) -> dict[str, str]:
    """Run the rows that are not finished, all of them at one seed before the next; those refused, with the reason."""
    refused: dict[str, str] = {}
    jobs = [(name, seed) for seed in range(1, seeds + 1) for name in names]
    bar = tqdm(jobs, desc="rows", disable=not bench.first.progress)
    for name, seed in bar:
        bar.set_postfix_str(f"{name}, seed {seed}")
        if name in refused:
            continue
        if budget is not None and finished(file_of(out, name, seed), row_key(bench, name, seed)) is None:
            why = over(bench, name, seed, budget)
            if why:
                refused[name] = why
                continue
        cell(bench, name, seed, out)
    return refused


def ablate(bench: Bench, out: Path, *, only: Sequence[str] = (), seeds: int = SEEDS, budget: float | None = None,
           systems: Mapping[str, Path] | None = None) -> dict[str, Any]:
    """Run the rows and figures that are asked for (all) and not finished; all rows that are finished, as plain values.

    budget: seconds of training that a row may take at one seed; one that would take more is refused, not shortened,
    since a row trained for fewer steps than the others would be compared with them. systems: folders of other systems'
    motion for the test speech.
    """
    out.mkdir(parents=True, exist_ok=True)
    names = [name for name in ROWS if name in (only or ROWS)]
    refused = run_rows(bench, out, names, seeds, budget)
    for split in dict.fromkeys(["test", *(ROWS[name].split for name in names)]):
        for name in (*REFERENCES, *CONTROLS):
            reference(bench, name, split, out)
    for name, folder in (systems or {}).items():
        system(bench, name, folder, out)
    cells = {name: {seed: own for seed, own in by_seed.items()
                    if name not in ROWS or own["key"] == row_key(bench, name, seed)}
             for name, by_seed in read_cells(out, bench.shared).items()}
    rows = tabled({name: own for name, own in cells.items() if own})
    for name in FIGURES:
        if name in (only or FIGURES):
            why = draw(bench, name, rows, out)
            if why:
                refused[name] = why
    return {"preset": bench.first.config.name, "shared": bench.shared, "refused": refused,
            "store": {"name": bench.first.store.corpus, "fingerprint": bench.first.store.fingerprint,
                      "test_recordings": len(bench.recordings("test"))}, "rows": rows}


def racer_ground(bench: Bench) -> bundles.Bundle:
    """What RACER's rows stand on where no bundle is given: the row "q-network" and a reward model to judge by."""
    bundle, run, labelled = bundle_of(bench, "q-network", 1)
    judge, _ = train_reward(run, bundle.drawn.lexicon, labelled, judge=True)
    return replace(bundle, reward_judge=judge)


def run_racer(bench: Bench, folder: Path, only: Sequence[str], seeds: int, given: str | None) -> None:
    """RACER's rows that are asked for, over the lexicon and rewards of a bundle, with their tables."""
    first = bench.first
    bundle = bundles.load(given) if given else racer_ground(bench)
    result = racer_ablation.ablation(
        first.store, bundle, first.work, folder, only=[RACER[name] for name in only], seeds=seeds,
        preset=RACER_PRESETS[first.config.name], limit=bench.limit, by=bench.by, progress=first.progress)
    keep(result, racer_ablation.markdown(result), folder / "table.json")


def networks(store: Store, work: Path, preset: str) -> Sequence[gesture_features.Features]:
    """What FGD is measured in: our own networks and the papers' where it is; for a first look, raw directions."""
    if preset == "tiny":
        return [gesture_features.RawFeatures(34, count=1)]
    return policies.networks(store, work)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser("eval.ablate", description="The ablations of the papers.")
    p.add_argument("--data", metavar="STORE", help="needed, except with --list")
    p.add_argument("--work", metavar="DIR", help="where stages are kept (needed likewise)")
    p.add_argument("--only", nargs="+", default=[], metavar="NAME",
                   help="rows and figures to run (all); tables have all finished ones")
    p.add_argument("--preset", default="ablation", choices=tuple(PRESETS))
    p.add_argument("--set", action="append", default=[], metavar="PATH=VALUE", dest="settings",
                   help="change a setting of the preset, for every row alike")
    p.add_argument("--seeds", type=int, default=SEEDS, metavar="N", help=f"seeds 1 to N ({SEEDS})")
    p.add_argument("--budget", type=float, metavar="SECONDS", help="refuse a row that would train longer at one seed")
    p.add_argument("--limit", type=int, metavar="N", help="the first N recordings of a split only")
    p.add_argument("--workers", type=int, default=os.cpu_count() or 1, metavar="N", help="processes that cut and hear")
    p.add_argument("--speech", action="append", default=[], metavar="DIR",
                   help="a folder of more sound, where the speech encoder was trained with it")
    p.add_argument("--bundle", metavar="DIR", help="what RACER's rows stand on (default: trained here)")
    p.add_argument("--system", action="append", default=[], metavar="NAME=DIR", dest="systems",
                   help="another system's motion for the test recordings, files named as they are (see eval.score)")
    p.add_argument("--out", default="docs/results/ablation", metavar="DIR", help="for ROW-SEED.json, table.json, .md")
    p.add_argument("--list", action="store_true", help="show the rows and stop")
    p.add_argument("--quiet", action="store_true", help="no progress bars")
    return p


def _checked(arguments: argparse.Namespace) -> None:
    for name in ("seeds", "budget", "limit", "workers"):
        value = getattr(arguments, name)
        if value is not None and value <= 0:
            raise InputError(f"--{name} {value}", "is too little", "choose more than 0")
    unknown = [name for name in arguments.only if name not in everything()]
    if unknown:
        raise InputError(f"--only {' '.join(unknown)}", "is nothing to run", f"choose among {', '.join(everything())}")
    taken = [name for name in named(arguments.systems, "--system") if name in (*everything(), *REFERENCES, *CONTROLS)]
    if taken:
        raise InputError(f"--system {taken[0]}", "is the name of a row", "choose another")
    if arguments.data is None or arguments.work is None:
        raise InputError("--data and --work", "are needed", "give a store and a folder to keep things in")


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    arguments = parser().parse_args(argv)
    if arguments.list:
        print(listing({name: f"{own.title} ({own.paper})" for name, own in FIGURES.items()}))
        return 0
    with one_line_errors("eval.ablate"):
        _checked(arguments)
        torch.set_num_threads(1)
        store, work, out = Store.open(arguments.data), Path(arguments.work), Path(arguments.out)
        work.mkdir(parents=True, exist_ok=True)
        base = configs.with_settings(PRESETS[arguments.preset](), arguments.settings)
        bench = Bench.of(store, base, work, networks(store, work, arguments.preset), limit=arguments.limit,
                         speech=[Path(folder) for folder in arguments.speech], workers=arguments.workers,
                         progress=not arguments.quiet)
        result = ablate(bench, out, only=arguments.only, seeds=arguments.seeds, budget=arguments.budget,
                        systems={name: Path(folder) for name, folder in named(arguments.systems, "--system").items()})
        keep(result, markdown(result), out / "table.json")
        racer = [name for name in RACER if name in (arguments.only or RACER)]
        if racer:
            run_racer(bench, out.parent / RACER_FOLDER, racer, arguments.seeds, arguments.bundle)
        print(markdown(result))
    return 0


if __name__ == "__main__":
    sys.exit(main())
