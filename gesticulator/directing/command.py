"""`gesticulator plan`: look at gesture plans, and at the names that they can use; no sound is opened."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from data_module.errors import InputError
from data_module.files import write_text
from gesticulator.cli import Command

_BUNDLE_HELP = "folder of trained weights (default: the shipped ones)"


def arguments(p: argparse.ArgumentParser) -> None:
    """What the command takes."""
    verbs = p.add_subparsers(dest="what", required=True, metavar="check|names|convert|schema")
    check = verbs.add_parser("check", help="report the errors of a plan with their lines, or its edits")
    check.add_argument("plan", metavar="PLAN", help="a plan, .json or .bml")
    names = verbs.add_parser("names", help="list the named gestures and the names of the lexemes")
    names.add_argument("--bundle", metavar="DIR", help=_BUNDLE_HELP)
    convert = verbs.add_parser("convert", help="convert JSON to BML or back")
    convert.add_argument("plan", metavar="PLAN", help="a plan, .json or .bml")
    convert.add_argument("out", type=Path, metavar="OUT", help="the file to write, .json or .bml")
    verbs.add_parser("schema", help="print the JSON Schema of plans")


def run(asked: argparse.Namespace) -> int:
    """Do it; `InputError` for a plan that cannot be used."""
    from gesticulator.plan.plan_file import schema

    if asked.what == "schema":
        print(json.dumps(schema(), indent=1))
    elif asked.what == "names":
        _print_names(asked.bundle)
    elif asked.what == "convert":
        _convert(asked.plan, asked.out)
    else:
        print(_checked(asked.plan))
    return 0


def _checked(path: str) -> str:
    from gesticulator.plan.bml import read_any_plan
    from gesticulator.plan.plan import edited_blocks

    plan = read_any_plan(path)
    anew = sum(edited_blocks(plan))
    locked = sum(block.locked for block in plan.blocks)
    return (f"{path}: {plan.sound.name or 'a sound'}, {plan.duration:.1f} s, {len(plan.blocks)} blocks, of which "
            f"{anew} are drawn anew and {locked} are locked; {len(plan.cues)} cues")


def _print_names(bundle: str | None) -> None:
    from gesticulator.bundle.bundle import SHIPPED, load
    from gesticulator.directing.lexeme_names import lexeme_names
    from gesticulator.plan.plan import GESTURES

    print("gestures")
    for name, about in GESTURES.items():
        print(f"  {name}: {about}")
    print("lexemes (movements that were learned, named by what the hands do)")
    for one in lexeme_names(load(Path(bundle) if bundle else SHIPPED)):
        print(f"  {one.lexeme}: {one.name}{'  (silent)' if one.silent else ''}")


def _convert(source: str, target: Path) -> None:
    from gesticulator.plan.bml import bml_of, read_any_plan

    writers = {".json": lambda plan: plan.to_json(), ".bml": bml_of}
    if target.suffix.lower() not in writers:
        raise InputError(target, "is neither .json nor .bml", "name it so")
    write_text(target, writers[target.suffix.lower()](read_any_plan(source)))
    print(f"{target}: written from {source}")


COMMAND = Command(
    "check a gesture plan, list the gesture names, convert it to BML and back", arguments, run,
    examples=("plan names", "plan check plan.json", "plan convert plan.json plan.bml", "plan schema"))
