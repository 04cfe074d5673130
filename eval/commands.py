"""The verbs of `eval`. Cheap to import: what is heavy is imported when a verb runs."""

import argparse
import importlib

from data_module.errors import InputError
from eval.pictures import PLOTS
from gesticulator.cli import PROGRAM, Command


def verb(about: str, module: str, *examples: str) -> Command:
    """A command that is a module with `arguments(parser)`, which adds its options, and `run(arguments)`, which gives
    the exit code."""
    # The module is imported only when its own verb runs: torch and matplotlib take seconds.
    return Command(about, lambda parser: importlib.import_module(module).arguments(parser),
                   lambda given: importlib.import_module(module).run(given), examples)


# --------------------------------------------------------------------------------------------------------- the verbs

def _plot_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--list", action="store_true", help="list the names and exit")
    parser.add_argument("name", nargs="?", metavar="NAME", help="see --list")
    parser.add_argument("rest", nargs=argparse.REMAINDER, metavar="...", help="NAME --help lists its options")


def _plot(given: argparse.Namespace) -> int:
    """The picture of a name, by the module of the table, which has `arguments` and `run`."""
    if given.list:
        width = max(map(len, PLOTS))
        print("\n".join(f"{name:<{width}}  {entry.about}" for name, entry in PLOTS.items()))
        return 0
    if not given.name:
        raise InputError("the name after plot", "is missing", f"choose among {', '.join(PLOTS)}")
    tool = PLOTS.load(given.name)
    parser = argparse.ArgumentParser(f"{PROGRAM} plot {given.name}", description=PLOTS.entry(given.name).about)
    tool.arguments(parser)
    print("\n".join(map(str, tool.run(parser.parse_args(given.rest)))))
    return 0


SCORE = verb("compare real, generated and other motion, with negative controls", "eval.score.command",
             "score --truth STORE --system ours=bvh_folder",
             "score --truth real --system ours=generated --speech wav --bundle default --out score.json")
ABLATE = verb("repeat the tables, figures and claims of both papers", "eval.ablate.command",
              "ablate --list", "ablate --data STORE --work DIR --only ours no-style --seeds 1",
              "ablate --tables --out docs/results/ablation")
ACCEPTANCE = verb("judge the motion of a bundle by the table of bounds", "eval.acceptance.command",
                  "acceptance --data STORE --out motion.json", "acceptance --data STORE --only rest effort --limit 4")
QUALITY = verb("measure the models of a bundle on the test split, beside baselines", "eval.quality",
               "quality --data STORE --out docs/results/quality.json")
STUDY = verb("make a user study, or analyse its ratings", "eval.study.command",
             "study make --systems ours=DIR truth=DIR --out FOLDER",
             "study analyse --key FOLDER/key.json ratings-*.json --out study.json")
PLOT = Command("plot a strip of motion or the lexicon (--list shows them)", _plot_arguments, _plot,
               ("plot strip gesture.bvh --sound speech.wav", "plot lexicon --data STORE --out lexemes.png"))
