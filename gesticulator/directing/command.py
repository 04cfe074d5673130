"""`gesticulator plan` and `gesticulator gestures`: check gesture plans, list the names that they can use; no sound."""

import argparse
import json

from gesticulator.cli import Command


def _plan_arguments(p: argparse.ArgumentParser) -> None:
    verbs = p.add_subparsers(dest="what", required=True, metavar="check|names|schema")
    check = verbs.add_parser("check", help="report the first error of a plan, or its edits")
    check.add_argument("plan", metavar="PLAN.json")
    names = verbs.add_parser("names", help="list the named gestures and the names of the lexemes")
    names.add_argument("--bundle", metavar="NAME|DIR", help="default, paper, or the folder of one (default: default)")
    verbs.add_parser("schema", help="print the JSON Schema of plans")


def _run_plan(parsed: argparse.Namespace) -> int:
    # Imported here: listing the verbs of the program must not load the plan.
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
    locked = sum(block.locked for block in plan.blocks)
    return (f"{path}: {plan.sound.name or 'unnamed sound'}, {plan.duration:.1f} s, {len(plan.blocks)} blocks, of which "
            f"{sum(edited_blocks(plan))} will be generated again and {locked} are locked; {len(plan.cues)} cues")


def _print_names(bundle: str | None) -> None:
    from gesticulator.bundle.bundle import load
    from gesticulator.bundle.files import bundle_folder
    from gesticulator.directing.lexeme_names import lexeme_names
    from gesticulator.plan.gestures import GESTURES

    print("gestures", *(f"  {name}: {about}" for name, about in GESTURES.items()), sep="\n")
    print("lexemes (learned movements, named by what the hands do)",
          *(f"  {entry.lexeme}: {entry.name}{'  (silent)' if entry.silent else ''}"
            for entry in lexeme_names(load(bundle_folder(bundle)))), sep="\n")


def _run_gestures(_parsed: argparse.Namespace) -> int:
    from gesticulator.plan.gestures import ALIASES, REPERTOIRE

    for name, gesture in REPERTOIRE.items():
        also = ", ".join(alias for alias, meant in ALIASES.items() if meant == name)
        notes = ", ".join(kind for kind in ("core", "weak", "offensive") if getattr(gesture, kind))
        print(name + (f" (or {also})" if also else "") + f": {gesture.meaning}" + (f" [{notes}]" if notes else ""))
    return 0


COMMAND = Command("check a gesture plan, list the gesture names", _plan_arguments, _run_plan,
                  examples=("plan names", "plan check plan.json", "plan schema"))
GESTURES_COMMAND = Command("list the gestures that have a name, and what they mean", lambda _: None, _run_gestures,
                           examples=("gestures",))
