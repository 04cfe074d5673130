"""`gesticulator bundle`: inspect a bundle, list and edit its silent lexemes."""

from __future__ import annotations

import argparse
import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from data_module.errors import InputError
from data_module.files import write_text
from gesticulator.cli import Command

FOUND = "silent_lexemes_found"
"""Key in the provenance of an edited bundle: the list detected by training."""


def _arguments(p: argparse.ArgumentParser) -> None:
    verbs = p.add_subparsers(dest="what", required=True, metavar="inspect|silent")
    inspect = verbs.add_parser("inspect", help="show the content, sizes, hashes and training data of a bundle")
    silent = verbs.add_parser("silent", help="list or edit the silent lexemes (RG 6.4.1)")
    for verb in (inspect, silent):
        verb.add_argument("bundle", nargs="?", metavar="BUNDLE",
                          help="default, paper, or the folder of a bundle (default: default)")
    inspect.add_argument("--settings", action="store_true", help="also show every setting")
    silent.add_argument("--set", metavar="3,7,9", help="use exactly these")
    silent.add_argument("--out", type=Path, metavar="DIR", help="with --set: write an edited copy here instead of "
                        "changing BUNDLE")


def _run(args: argparse.Namespace) -> int:
    print(_inspected(args.bundle, args.settings) if args.what == "inspect" else
          _silent(args.bundle, args.set, args.out))
    return 0


def _inspected(given: str | None, settings: bool) -> str:
    """The output of `bundle inspect`. Every part is opened, so a broken one is found here."""
    from data_module.layers import parameter_count
    from gesticulator.bundle.bundle import load
    from gesticulator.bundle.files import bundle_folder, read_index
    from gesticulator.bundle.models import part_table

    folder = bundle_folder(given)
    # Every part is opened for its size, which also checks its hash and its shapes.
    index, bundle = read_index(folder), load(folder)
    sizes = {name: parameter_count(bundle.parts[name]) for name in bundle.parts}
    lines = [f"{folder}: format {index['format']}, preset {bundle.config.name}, made by "
             + ", ".join(f"{name} {version}" for name, version in index.get("made_by", {}).items()),
             f"speakers: {', '.join(bundle.speakers)}; interpreters: {', '.join(bundle.interpreters)}",
             f"lexemes: {len(bundle.vectors)}; {_listed(bundle.silent.tolist(), len(bundle.vectors))}",
             f"words: {bundle.text.encoder if bundle.text else 'not read'}", "", "trained on"]
    lines += [f"  {name}: {_short(value)}" for name, value in bundle.provenance.items()]
    lines += ["", f"{'file':<36}{'bytes':>12}{'weights':>12}  sha256"]
    # Files are listed, not parts: the card and the statistics have hashes, too.
    parts = {f"{part.file}.safetensors": name for name, part in part_table().items()}
    for name, digest in sorted(index["files"].items()):
        count = f"{sizes[parts[name]]:,}" if parts.get(name) in sizes else ""
        lines.append(f"{name:<36}{(folder / name).stat().st_size:>12,}{count:>12}  {digest}")
    lines += ["", "figures on the validation split"]
    lines += [f"  {stage}: " + ", ".join(f"{name} {value:.4g}" for name, value in figures.items())
              for stage, figures in bundle.figures.items()]
    if settings:
        lines += ["", "settings", *_settings(index["config"])]
    return "\n".join(lines)


def _short(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name} {_short(inner)}" for name, inner in value.items())
    return ", ".join(map(str, value)) or "none" if isinstance(value, list) else str(value)


def _settings(tree: dict[str, Any], path: str = "") -> list[str]:
    """Each setting as an argument of --set."""
    out = []
    for name, value in tree.items():
        out += _settings(value, f"{path}{name}.") if isinstance(value, dict) else [f"  {path}{name}={value}"]
    return out


def _silent(given: str | None, numbers: str | None, out: Path | None) -> str:
    """The output of `bundle silent`, after the edit that is asked for.

    Only `bundle.json` is rewritten. Inference uses the new list at once: the choice in silent blocks, the resting
    lexeme, the blocks that the gate closes. What was trained with the old list stays: the hint in the lexeme
    interpreter, and the gate.
    """
    from gesticulator.bundle.bundle import load
    from gesticulator.bundle.files import NAMED, bundle_folder, replace_folder

    folder = bundle_folder(given)
    bundle = load(folder)
    before, size = bundle.silent.tolist(), len(bundle.vectors)
    if numbers is None:
        if out is not None:
            raise InputError("--out", "has nothing to write", "give --set, too")
        return _listed(before, size)
    silent = lexemes(numbers, size)
    if out is not None:
        if out.exists():
            raise InputError(out, "exists", "choose another path for the copy")

        def write(copy: Path) -> None:
            shutil.copytree(folder, copy, dirs_exist_ok=True)
            _rewrite(copy, silent)

        replace_folder(out, write)
    # An installed bundle is shared, and an update would undo the edit.
    elif folder.resolve() in {shipped.resolve() for shipped in NAMED.values()}:
        raise InputError(folder, "is shipped with the package and is not changed",
                         "add --out DIR for an edited copy, and use that")
    else:
        _rewrite(folder, silent)
    return (f"{_listed(silent, size)}\nto train with these: gesticulator train ... --set "
            f"'silence.lexemes={list(silent)}'")


def lexemes(text: str, size: int) -> tuple[int, ...]:
    """The silent lexemes of "3, 7,9", sorted. size: S. `InputError` for a number outside 0 to S - 1, for an empty list
    (silence would have no lexeme) and for the whole lexicon (speech would have none)."""
    try:
        # Spaces count as commas, so that a list can be pasted from Python.
        chosen = {int(part) for part in text.replace(",", " ").split()}
    except ValueError:
        chosen = set()
    if not chosen or not all(0 <= number < size for number in chosen) or len(chosen) == size:
        raise InputError(f"--set {text[:40]}", "is not a list of silent lexemes",
                         f"write some of 0 to {size - 1} with commas, such as 3,7,9")
    return tuple(sorted(chosen))


def _rewrite(folder: Path, silent: Sequence[int]) -> None:
    """Put a new list into `bundle.json`, atomically; the list detected by training is kept in the provenance."""
    from gesticulator.bundle.files import INDEX, read_index

    index = read_index(folder)
    # The list of training is kept once; later edits do not overwrite it.
    index["provenance"].setdefault(FOUND, index["silent_lexemes"])
    index["silent_lexemes"] = list(silent)
    write_text(folder / INDEX, json.dumps(index, indent=1, sort_keys=True) + "\n")


def _listed(silent: Sequence[int], size: int) -> str:
    """Such as "silent: 3,7,9 (3 of 100 lexemes)"."""
    return f"silent: {','.join(map(str, silent)) or 'none'} ({len(silent)} of {size} lexemes)"


BUNDLE = Command(
    "inspect a bundle, or edit its silent lexemes", _arguments, _run,
    examples=("bundle inspect", "bundle inspect bundle --settings", "bundle silent bundle --set 3,7,9",
              "bundle silent --set 3,7,9 --out mine"))
