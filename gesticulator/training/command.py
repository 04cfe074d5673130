"""`gesticulator train --data STORE --out BUNDLE`: all stages from a store to a bundle, resumable."""

import argparse
import dataclasses
import os
from pathlib import Path

from data_module.errors import InputError, complain
from gesticulator.cli import PROGRAM, Command


def arguments(p: argparse.ArgumentParser) -> None:
    p.add_argument("--data", required=True, metavar="STORE", help="a store made by gesticulator build")
    p.add_argument("--out", required=True, metavar="BUNDLE", help="output folder for the bundle")
    p.add_argument("--preset", default="default", help="a set of settings; a wrong name lists them")
    p.add_argument("--set", action="append", default=[], metavar="PATH=VALUE", dest="settings",
                   help="change a setting of the preset, for example generator.lstm_width=320")
    p.add_argument("--work", metavar="DIR",
                   help="work folder for finished stages, reused if it exists (default: BUNDLE.work)")
    p.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    p.add_argument("--threads", type=int, help="torch threads per process (default: all cores; preset tiny: 1)")
    p.add_argument("--seed", type=int, help="random seed")
    p.add_argument("--quiet", action="store_true", help="print no progress")


def run(args: argparse.Namespace) -> int:
    """Train; InputError for invalid arguments."""
    machine = int(os.environ.get("LOCAL_WORLD_SIZE", "1"))  # processes started here by torchrun
    # Threads wait for each other longer than the smallest matrices take, and a process is longer in starting.
    cores = 1 if args.preset == "tiny" else os.cpu_count() or 1
    threads = args.threads if args.threads is not None else max(1, cores // machine)
    if threads < 1:
        raise InputError(f"--threads {threads}", "is out of range", "choose 1 or more")
    import torch

    from data_module.build_report import doubts
    from data_module.store import Store
    from gesticulator.bundle.config import with_settings
    from gesticulator.training.distributed import joined, rank
    from gesticulator.training.presets import preset
    from gesticulator.training.stages import Run
    from gesticulator.training.stages.training import train

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
        try:
            bundle = train(Run(config, store, work, device, not args.quiet and not silent, threads * machine), out)
        except KeyboardInterrupt:
            if not silent:
                complain(f"\n{PROGRAM}: the same command goes on from what {work} holds: all finished stages, and the "
                         "present one but for the last minute")
            raise
    if not silent:
        hours = float(bundle.provenance["hours"]["train"])
        print(f"{out}: trained on {hours * 60:.0f} minutes of motion; use it with --bundle {out}")
    return 0


COMMAND = Command(
    "train a bundle from a store; interrupted runs resume", arguments, run,
    examples=("train --data store --out bundle", "train --data store --out bundle --preset tiny",
              "train --data store --out bundle --set generator.lstm_width=320 --seed 2",
              "train --data store --out bundle --device cuda"))
