"""`gesticulator train --data STORE --out BUNDLE`: all stages from a store to a bundle, resumable."""

from __future__ import annotations

import argparse
import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from data_module.errors import InputError, complain
from gesticulator.cli import PROGRAM, Command

MOST_THREADS = 1024
"""Upper limit of --threads: catches typing errors, which torch would try to start."""


class _List(argparse.Action):
    """Print the names of presets and stages and exit, ignoring other arguments."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any, **__: Any) -> None:
        from gesticulator.training.presets import PRESETS
        from gesticulator.training.stages import STAGES

        print("presets: " + ", ".join(PRESETS) + "\nstages: " + ", ".join(STAGES))
        parser.exit()


def arguments(p: argparse.ArgumentParser) -> None:
    p.add_argument("--data", required=True, metavar="STORE", help="a store made by gesticulator build")
    p.add_argument("--out", required=True, metavar="BUNDLE", help="output folder for the bundle")
    p.add_argument("--preset", default="default", help="a set of settings (--list shows them)")
    p.add_argument("--set", action="append", default=[], metavar="PATH=VALUE", dest="settings",
                   help="change a setting of the preset, for example generator.lstm_width=320")
    p.add_argument("--work", metavar="DIR",
                   help="work folder for finished stages, reused if it exists (default: BUNDLE.work)")
    p.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    p.add_argument("--threads", type=int, help="torch threads per process (default: all cores)")
    p.add_argument("--stage", metavar="STAGE", help="train this stage and those it needs, then stop")
    p.add_argument("--redo", action="append", default=[], metavar="STAGE", help="train this stage again")
    p.add_argument("--seed", type=int, help="random seed")
    p.add_argument("--verbose", action="store_true", help="print the validation figures of every stage")
    p.add_argument("--quiet", action="store_true", help="print no progress")
    p.add_argument("--list", action=_List, nargs=0, help="list the presets and the stages and exit")


def run(args: argparse.Namespace) -> int:
    """Train; InputError for invalid arguments."""
    machine = int(os.environ.get("LOCAL_WORLD_SIZE", "1"))  # processes started here by torchrun
    threads = args.threads if args.threads is not None else max(1, (os.cpu_count() or 1) // machine)
    for flag, value, least, most in (("--threads", threads, 1, MOST_THREADS), ("--seed", args.seed or 0, 0, 2**31 - 1)):
        if not least <= value <= most:
            raise InputError(f"{flag} {value}", "is out of range", f"choose {least} to {most}")
    import torch

    from data_module.build_report import doubts
    from data_module.store import Store
    from gesticulator.bundle.config import with_settings
    from gesticulator.training.distributed import joined, rank
    from gesticulator.training.presets import preset
    from gesticulator.training.stages import STAGES, Run
    from gesticulator.training.stages.training import train

    for flag, names in (("--stage", [args.stage] if args.stage else []), ("--redo", args.redo)):
        for name in names:
            if name not in STAGES:
                raise InputError(f"{flag} {name}", "is not a stage", f"choose among {', '.join(STAGES)}")
    if args.device == "cuda" and not torch.cuda.is_available():
        raise InputError("--device cuda", "there is no CUDA device", "use --device cpu")
    torch.set_num_threads(threads)
    config = with_settings(preset(args.preset), args.settings)
    if args.seed is not None:
        config = dataclasses.replace(config, seed=args.seed)
    out = Path(args.out)
    # Beside the bundle by default, so that the same command resumes.
    work = Path(args.work) if args.work else out.with_name(out.name + ".work")
    store = Store.open(args.data)
    for line in () if args.quiet else doubts(store):
        complain(f"{PROGRAM}: warning: {args.data}: {line}")
    with joined(args.device) as device:
        silent = rank() > 0
        run = Run(config, store, work, device, not args.quiet and not silent, threads * machine)
        bundle = train(run, out, args.redo, args.stage)
    if bundle is not None and not silent:
        hours = float(bundle.provenance["hours"]["train"])
        print(f"{out}: trained on {hours * 60:.0f} minutes of motion; use it with --bundle {out}")
        for stage, figures in bundle.figures.items() if args.verbose else ():
            print(f"  {stage}: " + ", ".join(f"{name} {value:.4g}" for name, value in figures.items()))
    return 0


COMMAND = Command(
    "train a bundle from a store; interrupted runs resume", arguments, run,
    examples=("train --data store --out bundle", "train --data store --out bundle --preset tiny",
              "train --data store --out bundle --set generator.lstm_width=320 --seed 2",
              "train --data store --out bundle --stage generator",
              "train --data store --out bundle --device cuda"))


def main(argv: Sequence[str] | None = None) -> int:
    """Parse and run, as `gesticulator train` does; the exit code."""
    return COMMAND.main(f"{PROGRAM} train", argv)
