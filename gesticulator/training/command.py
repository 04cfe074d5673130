"""`gesticulator train --data STORE --out BUNDLE`: every stage, resumable, from a store to a bundle.

What is heavy is imported when the arguments are understood.
"""

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
"""More threads than any machine has cores: a slip of the finger, which torch would try to start."""
LARGEST_SEED = 2**31 - 1


class _List(argparse.Action):
    """Print the names of presets or stages and leave, whatever else is asked."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any, **__: Any) -> None:
        from gesticulator.training.presets import PRESETS
        from gesticulator.training.stages import STAGES

        print("presets: " + ", ".join(PRESETS) + "\nstages: " + ", ".join(STAGES))
        parser.exit()


def arguments(p: argparse.ArgumentParser) -> None:
    """What the command takes."""
    p.add_argument("--data", required=True, metavar="STORE", help="a store made by gesticulator build")
    p.add_argument("--out", required=True, metavar="BUNDLE", help="output folder for the bundle")
    p.add_argument("--preset", default="default", help="a set of settings (--list shows them)")
    p.add_argument("--speech", action="append", default=[], metavar="DIR",
                   help="folder of additional audio (no motion, no text) for the first stage of the speech encoder")
    p.add_argument("--set", action="append", default=[], metavar="PATH=VALUE", dest="settings",
                   help="change a setting of the preset, for example generator.lstm_width=320")
    p.add_argument("--work", metavar="DIR",
                   help="work folder for finished stages, reused if it exists (default: BUNDLE.work)")
    p.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    p.add_argument("--threads", type=int, help="torch threads per process (default: all cores)")
    p.add_argument("--precision", default="float32", choices=("float32", "bfloat16"),
                   help="bfloat16 is mixed precision, on a GPU (default float32)")
    p.add_argument("--corpus-memory", type=float, default=4.0, metavar="GB",
                   help="read the corpus from disk if it takes more memory than this (default 4)")
    p.add_argument("--stage", metavar="STAGE", help="train this stage and those it needs, then stop")
    p.add_argument("--redo", action="append", default=[], metavar="STAGE", help="train this stage again")
    p.add_argument("--seed", type=int, help="random seed")
    p.add_argument("--verbose", action="store_true", help="print the validation figures of every stage")
    p.add_argument("--quiet", action="store_true", help="print no progress")
    p.add_argument("--list", action=_List, nargs=0, help="list the presets and the stages and exit")


def run(asked: argparse.Namespace) -> int:
    """Train; InputError for what cannot be."""
    machine = int(os.environ.get("LOCAL_WORLD_SIZE", "1"))  # processes here, that torchrun started
    threads = asked.threads if asked.threads is not None else max(1, (os.cpu_count() or 1) // machine)
    for flag, value, least, most in (("--threads", threads, 1, MOST_THREADS),
                                     ("--seed", asked.seed or 0, 0, LARGEST_SEED),
                                     ("--corpus-memory", asked.corpus_memory, 0, 1e6)):
        if not least <= value <= most:
            raise InputError(f"{flag} {value}", "is out of range", f"choose {least} to {most}")
    import torch

    from data_module.build_report import doubts
    from data_module.store import Store
    from gesticulator.bundle.config import with_settings
    from gesticulator.training.distributed import joined, leads
    from gesticulator.training.presets import preset
    from gesticulator.training.stages import STAGES
    from gesticulator.training.stages.training import TrainOptions, train

    for flag, names in (("--stage", [asked.stage] if asked.stage else []), ("--redo", asked.redo)):
        for name in names:
            if name not in STAGES:
                raise InputError(f"{flag} {name}", "is not a stage", f"choose among {', '.join(STAGES)}")
    if asked.device == "cuda" and not torch.cuda.is_available():
        raise InputError("--device cuda", "there is no CUDA device", "use --device cpu")
    if asked.precision != "float32" and asked.device == "cpu":
        raise InputError(f"--precision {asked.precision}", "is for GPUs", "add --device cuda, or leave it out")
    torch.set_num_threads(threads)
    config = with_settings(preset(asked.preset), asked.settings)
    if asked.seed is not None:
        config = dataclasses.replace(config, seed=asked.seed)
    out = Path(asked.out)
    work = Path(asked.work) if asked.work else out.with_name(out.name + ".work")
    store = Store.open(asked.data)
    for line in () if asked.quiet else doubts(store):
        complain(f"{PROGRAM}: warning: {asked.data}: {line}")
    with joined(asked.device) as device:
        made = train(config, store, out, work, TrainOptions(
            device, threads * machine, not asked.quiet, tuple(map(Path, asked.speech)), tuple(asked.redo), asked.stage,
            asked.precision, asked.corpus_memory * 1e9))
        speaks = leads()
    if made is not None and speaks:
        hours = float(made.provenance["hours"]["train"])
        print(f"{out}: trained on {hours * 60:.0f} minutes of motion; use it with --bundle {out}")
        for stage, figures in made.figures.items() if asked.verbose else ():
            print(f"  {stage}: " + ", ".join(f"{name} {value:.4g}" for name, value in figures.items()))
    return 0


COMMAND = Command(
    "train a bundle from a store; interrupted runs resume", arguments, run,
    examples=("train --data store --out bundle", "train --data store --out bundle --preset tiny",
              "train --data store --out bundle --set generator.lstm_width=320 --seed 2",
              "train --data store --out bundle --stage generator",
              "train --data store --out bundle --device cuda --precision bfloat16"))


def main(argv: Sequence[str] | None = None) -> int:
    """Parse and run, as `gesticulator train` does; the exit code."""
    return COMMAND.main(f"{PROGRAM} train", argv)
