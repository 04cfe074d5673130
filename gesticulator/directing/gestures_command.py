"""`gesticulator gestures`: list the named gestures, what they mean, and how long they last; needs no sound."""

from __future__ import annotations

import argparse
import json
from typing import Any

from gesticulator.cli import Command


def arguments(p: argparse.ArgumentParser) -> None:
    """The arguments of the command."""
    p.add_argument("--json", action="store_true", help="as JSON, with the seconds of the phases")
    p.add_argument("--core", action="store_true", help="only those that talk often calls for")


def run(parsed: argparse.Namespace) -> int:
    """Run the command."""
    rows = [row for row in gesture_rows() if row["core"] or not parsed.core]
    print(json.dumps(rows, indent=1, ensure_ascii=False) if parsed.json else "\n".join(map(_line, rows)))
    return 0


def gesture_rows() -> list[dict[str, Any]]:
    """What is known of every gesture, in plain values: name, other names, meaning, category, hands, whether it is core,
    weak or offensive, seconds of its phases (at most), and its mark in a text."""
    from gesticulator.directing.gesture_phases import longest
    from gesticulator.plan.gestures import ALIASES, REPERTOIRE, mark_of

    rows: list[dict[str, Any]] = []
    for name, gesture in REPERTOIRE.items():
        also, phases = [alias for alias, of in ALIASES.items() if of == name], longest(name)
        rows.append({"name": name, "also": also, "meaning": gesture.meaning, "category": list(gesture.category),
                     "hands": gesture.hands, "core": gesture.core, "weak": gesture.weak,
                     "offensive": gesture.offensive, "preparation": round(phases.preparation, 3),
                     "stroke": round(phases.stroke, 3), "hold": round(phases.hold, 3),
                     "retraction": round(phases.retraction, 3), "mark": mark_of((*also, name)[0])})
    return rows


def _line(row: dict[str, Any]) -> str:
    notes = [kind for kind in ("core", "weak", "offensive") if row[kind]]
    also = f" (or {', '.join(row['also'])})" if row["also"] else ""
    return f"{row['name']}{also}: {row['meaning']}{' [' + ', '.join(notes) + ']' if notes else ''}"


COMMAND = Command("list the gestures that have a name, what they mean and how long they last", arguments, run,
                  examples=("gestures", "gestures --core", "gestures --json"))
