"""The verbs of `eval`. Cheap to import: what is heavy is imported when a verb runs."""

from __future__ import annotations

import argparse

from data_module.errors import InputError
from eval.probes import PROBES
from gesticulator.cli import Command


def _probe_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--list", action="store_true", help="show every probe with its question, and stop")
    parser.add_argument("name", nargs="?", metavar="NAME", help="see --list")
    parser.add_argument("rest", nargs=argparse.REMAINDER, metavar="...", help="NAME --help tells what it takes")


def _probe(arguments: argparse.Namespace) -> int:
    """List the probes, or run one and keep what it finds."""
    if arguments.list:
        width = max(map(len, PROBES))
        print("\n".join(f"{name:<{width}}  {probe.question}" for name, probe in PROBES.items()))
        return 0
    if arguments.name not in PROBES:
        told = f"{arguments.name!r} is unknown" if arguments.name else "is missing"
        raise InputError("the name of a probe", told, f"choose among {', '.join(PROBES)}")
    from eval.table import publish

    probe = PROBES[arguments.name]
    parser = argparse.ArgumentParser(f"gesticulator probe {arguments.name}", description=probe.question)
    probe.arguments(parser)
    parser.add_argument("--out", metavar="FILE.json", help="keep the tables; a .md is written beside it")
    chosen = parser.parse_args(arguments.rest)
    publish(probe.run(chosen), chosen.out)
    return 0


PROBE = Command("one question about a bundle or a data set (--list shows them)", _probe_arguments, _probe,
                ("probe --list", "probe quality --data STORE", "probe parts --data STORE --out parts.json"))


def _ablate_arguments(parser: argparse.ArgumentParser) -> None:
    from eval import ablate

    ablate.arguments(parser)


def _ablate(arguments: argparse.Namespace) -> int:
    from eval import ablate

    return ablate.run(arguments)


ABLATE = Command("every table, figure and claim of both papers, run again", _ablate_arguments, _ablate,
                 ("ablate --list", "ablate --data STORE --work DIR --only ours no-style --seeds 1",
                  "ablate --tables --out docs/results/ablation"))
