"""The verbs of `eval`. Cheap to import: what is heavy is imported when a verb runs."""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from data_module.errors import InputError
from data_module.registry import Registry, RegistryEntry
from eval.pictures import PLOTS
from eval.probes import PROBES
from gesticulator.cli import PROGRAM, Command

if TYPE_CHECKING:
    from eval.table import Table


def verb(about: str, module: str, *examples: str) -> Command:
    """A command that is a module with `arguments(parser)`, which adds its options, and `run(arguments)`, which gives
    the exit code."""
    # The module is imported only when its own verb runs: torch and matplotlib take seconds.
    return Command(about, lambda parser: importlib.import_module(module).arguments(parser),
                   lambda given: importlib.import_module(module).run(given), examples)


def choice(word: str, about: str, known: Registry[RegistryEntry], show: Callable[[Any, Any], None],
           extra: Callable[[argparse.ArgumentParser], None], examples: Sequence[str]) -> Command:
    """The command `word NAME ...` over a table of modules with `arguments` and `run`, with --list.

    show: takes what the module's `run` gave, and the arguments. extra: adds arguments that all of the table have.
    """
    def arguments(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--list", action="store_true", help="list the names and exit")
        parser.add_argument("name", nargs="?", metavar="NAME", help="see --list")
        parser.add_argument("rest", nargs=argparse.REMAINDER, metavar="...", help="NAME --help lists its options")

    def run(given: argparse.Namespace) -> int:
        if given.list:
            width = max(map(len, known), default=0)
            print("\n".join(f"{name:<{width}}  {entry.about}" for name, entry in known.items()))
            return 0
        # Distributions bring entries of this table, so an empty one is no error of the program.
        if not given.name:
            raise InputError(f"the name after {word}", "is missing", f"choose among {', '.join(known)}" if known else
                             "install a distribution that brings one, such as gesticulator-performer")
        tool = known.load(given.name)
        parser = argparse.ArgumentParser(f"{PROGRAM} {word} {given.name}", description=known.entry(given.name).about)
        # The tool's options first: those of the table stand below them in --help.
        tool.arguments(parser)
        extra(parser)
        chosen = parser.parse_args(given.rest)
        show(tool.run(chosen), chosen)
        return 0

    return Command(about, arguments, run, examples)


# --------------------------------------------------------------------------------------------------------- the verbs

def _publish(tables: Sequence[Table], arguments: argparse.Namespace) -> None:
    from eval.context import provenance
    from eval.table import publish

    publish(tables, arguments.out, provenance(arguments))


def _out(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--out", metavar="FILE.json", help="output file for the tables; a .md is written beside it")


def _name_files(files: Sequence[Path], arguments: argparse.Namespace) -> None:
    print("\n".join(map(str, files)))


SCORE = verb("compare real, generated and other motion, with negative controls", "eval.score.command",
             "score --truth STORE --system ours=bvh_folder",
             "score --truth real --system ours=generated --speech wav --bundle default --out score.json")
ABLATE = verb("repeat the tables, figures and claims of both papers", "eval.ablate.command",
              "ablate --list", "ablate --data STORE --work DIR --only ours no-style --seeds 1",
              "ablate --tables --out docs/results/ablation")
PROBE = choice("probe", "answer one question about a bundle or a data set (--list shows them)", PROBES, _publish, _out,
               ("probe --list", "probe corpus --data STORE"))
ACCEPTANCE = verb("judge the motion of a bundle by the table of bounds", "eval.acceptance.command",
                  "acceptance --data STORE --out motion.json", "acceptance --data STORE --only rest effort --limit 4")
QUALITY = verb("measure the models of a bundle on the test split, beside baselines", "eval.quality",
               "quality --data STORE --out docs/results/quality.json")
STUDY = verb("make a user study, or analyse its ratings", "eval.study.command",
             "study make --systems ours=DIR truth=DIR --out FOLDER",
             "study analyse --key FOLDER/key.json ratings-*.json --out study.json")
PLOT = choice("plot", "plot a strip of motion or the lexicon (--list shows them)", PLOTS, _name_files,
              lambda parser: None, ("plot strip gesture.bvh --sound speech.wav",
                                    "plot lexicon --data STORE --out FOLDER"))
