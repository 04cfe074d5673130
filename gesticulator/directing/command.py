"""`gesticulator plan`: check gesture plans, and list the names that they can use; needs no sound."""

from __future__ import annotations

import argparse
import json

from gesticulator.cli import Command

_BUNDLE_HELP = "default, paper, or the folder of a bundle (default: default)"


def arguments(p: argparse.ArgumentParser) -> None:
    """The arguments of the command."""
    verbs = p.add_subparsers(dest="what", required=True, metavar="check|names|schema")
    check = verbs.add_parser("check", help="report the first error of a plan, or its edits")
    check.add_argument("plan", metavar="PLAN.json")
    names = verbs.add_parser("names", help="list the named gestures and the names of the lexemes")
    names.add_argument("--bundle", metavar="NAME|DIR", help=_BUNDLE_HELP)
    verbs.add_parser("schema", help="print the JSON Schema of plans")


def run(parsed: argparse.Namespace) -> int:
    """Run the command; `InputError` for an invalid plan."""
    from gesticulator.plan.plan_file import schema

    if parsed.what == "schema":
        print(json.dumps(schema(), indent=1))
    elif parsed.what == "names":
        _print_names(parsed.bundle)
    else:
        print(_summary(parsed.plan))
    return 0


def _summary(path: str) -> str:
    from gesticulator.plan.plan import edited_blocks
    from gesticulator.plan.plan_file import read_plan

    plan = read_plan(path)
    edited = sum(edited_blocks(plan))
    locked = sum(block.locked for block in plan.blocks)
    return (f"{path}: {plan.sound.name or 'unnamed sound'}, {plan.duration:.1f} s, {len(plan.blocks)} blocks, of which "
            f"{edited} will be generated again and {locked} are locked; {len(plan.cues)} cues")


def _print_names(bundle: str | None) -> None:
    from gesticulator.bundle.bundle import load
    from gesticulator.bundle.files import bundle_folder
    from gesticulator.directing.lexeme_names import lexeme_names
    from gesticulator.plan.gestures import GESTURES

    print("gestures")
    for name, about in GESTURES.items():
        print(f"  {name}: {about}")
    print("lexemes (learned movements, named by what the hands do)")
    for entry in lexeme_names(load(bundle_folder(bundle))):
        print(f"  {entry.lexeme}: {entry.name}{'  (silent)' if entry.silent else ''}")


COMMAND = Command(
    "check a gesture plan, list the gesture names", arguments, run,
    examples=("plan names", "plan check plan.json", "plan schema"))
