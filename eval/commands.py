"""The verbs of `eval`. Cheap to import: what is heavy is imported when a verb runs."""

from __future__ import annotations

import argparse

from data_module.errors import InputError
from eval.draw import DRAWINGS
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


def _score_arguments(parser: argparse.ArgumentParser) -> None:
    from eval import score

    score.arguments(parser)


def _score(arguments: argparse.Namespace) -> int:
    from eval import score
    from eval.table import publish

    publish(score.tables(score.run(arguments)), arguments.out)
    return 0


SCORE = Command("real, generated and foreign motion side by side, with the controls", _score_arguments, _score,
                ("score --truth STORE --system ours=bvh_folder",
                 "score --truth real --system ours=generated --speech wav --bundle shipped --out score.json"))


def _draw_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--list", action="store_true", help="show every drawing, and stop")
    parser.add_argument("name", nargs="?", metavar="NAME", help="see --list")
    parser.add_argument("rest", nargs=argparse.REMAINDER, metavar="...", help="NAME --help tells what it takes")


def _draw(arguments: argparse.Namespace) -> int:
    """List the drawings, or make one and name its files."""
    if arguments.list:
        width = max(map(len, DRAWINGS))
        print("\n".join(f"{name:<{width}}  {drawing.summary}" for name, drawing in DRAWINGS.items()))
        return 0
    if arguments.name not in DRAWINGS:
        told = f"{arguments.name!r} is unknown" if arguments.name else "is missing"
        raise InputError("the name of a drawing", told, f"choose among {', '.join(DRAWINGS)}")
    drawing = DRAWINGS[arguments.name]
    parser = argparse.ArgumentParser(f"gesticulator draw {arguments.name}", description=drawing.summary)
    drawing.arguments(parser)
    for file in drawing.run(parser.parse_args(arguments.rest)):
        print(file)
    return 0


DRAW = Command("pictures and films: a strip, a video, the lexicon (--list shows them)", _draw_arguments, _draw,
               ("draw strip gesture.bvh --sound speech.wav", "draw video gesture.bvh --sound speech.wav --out film.mp4",
                "draw lexicon --data STORE --out FOLDER"))
