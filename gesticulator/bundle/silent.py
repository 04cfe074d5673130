"""`gesticulator bundle silent [BUNDLE]`: list and edit the silent lexemes (RG 6.4.1).

Training detects the silent lexemes. After inspecting the lexicon (`gesticulator plot lexicon`) the list can be changed
here. Only `bundle.json` is rewritten; weights and hashes stay. Inference uses the new list at once: the choice in
silent blocks, the resting lexeme, the blocks that the gate closes. What was trained with the old list stays: the hint
in the lexeme interpreter, and the gate.
"""

from __future__ import annotations

import argparse
import json
import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from data_module.errors import InputError
from data_module.files import write_text

FOUND = "silent_lexemes_found"
"""Key in the provenance of an edited bundle: the list detected by training."""


def numbers(text: str) -> tuple[int, ...]:
    """Lexeme numbers from "3, 7,9"; InputError for anything else."""
    try:
        return tuple(int(part) for part in text.replace(",", " ").split())
    except ValueError:
        raise InputError(text, "is not a list of lexemes", "write numbers with commas, such as 3,7,9") from None


def edited(silent: Iterable[int], size: int, *, chosen: Iterable[int] | None = None, add: Iterable[int] = (),
           remove: Iterable[int] = ()) -> tuple[int, ...]:
    """The silent lexemes after an edit, sorted: `chosen` instead of them, or with `add` and without `remove`.

    size: S. InputError for a number outside 0 to S - 1, for an empty set (silence would have no lexeme) and for the
    whole lexicon (speech would have none).
    """
    start = set(silent) if chosen is None else set(chosen)
    unknown = sorted(n for n in {*start, *add, *remove} if not 0 <= n < size)
    if unknown:
        raise InputError(", ".join(map(str, unknown)), "is not in the lexicon", f"its lexemes are 0 to {size - 1}")
    both = sorted(set(add) & set(remove))
    if both:
        raise InputError(", ".join(map(str, both)), "is to be added and to be removed", "give it once")
    result = (start | set(add)) - set(remove)
    if not result:
        raise InputError("the silent lexemes", "would be none", "keep one at least, for the blocks without speech")
    if len(result) == size:
        raise InputError("the silent lexemes", "would be the whole lexicon", "leave some to gesture with")
    return tuple(sorted(result))


def silent_of(index: dict[str, Any], folder: Path) -> tuple[tuple[int, ...], int]:
    """The silent lexemes of `bundle.json` and the size of the lexicon; InputError if they are inconsistent."""
    try:
        size, silent = int(index["config"]["lexicon"]["size"]), tuple(index["silent_lexemes"])
        return edited(silent, size), size
    except (KeyError, TypeError, ValueError, InputError) as error:
        raise InputError(folder / "bundle.json", f"holds no usable list of silent lexemes ({error})",
                         "copy the bundle again, or write silent_lexemes by hand") from None


def rewrite(folder: Path, silent: Iterable[int]) -> None:
    """Put a new list into `bundle.json`, atomically; the list detected by training is kept in the provenance."""
    from gesticulator.bundle.files import read_index

    index = read_index(folder)
    index["provenance"].setdefault(FOUND, index["silent_lexemes"])
    index["silent_lexemes"] = list(silent)
    write_text(folder / "bundle.json", json.dumps(index, indent=1, sort_keys=True) + "\n")


def rewritten_copy(folder: Path, target: Path, silent: Iterable[int]) -> None:
    """A copy of a bundle with another list, written atomically; InputError if `target` exists."""
    from gesticulator.bundle.files import replace_folder

    if target.exists():
        raise InputError(target, "exists", "choose another path for the copy")

    def write(temporary: Path) -> None:
        shutil.copytree(folder, temporary, dirs_exist_ok=True)
        rewrite(temporary, silent)

    replace_folder(target, write)


def arguments(p: argparse.ArgumentParser) -> None:
    p.add_argument("bundle", nargs="?", metavar="BUNDLE",
                   help="default, paper, or the folder of a bundle (default: default)")
    p.add_argument("--set", metavar="3,7,9", help="use exactly these")
    p.add_argument("--automatic", action="store_true", help="restore those that training detected")
    p.add_argument("--add", metavar="3,7,9", default="", help="add these")
    p.add_argument("--remove", metavar="3,7,9", default="", help="remove these")
    p.add_argument("--out", type=Path, metavar="DIR", help="write an edited copy here instead of changing BUNDLE")


def run(args: argparse.Namespace) -> int:
    """List or edit the silent lexemes; InputError for invalid arguments."""
    from gesticulator.bundle.files import NAMED, bundle_folder, read_index

    folder = bundle_folder(args.bundle)
    index = read_index(folder)
    before, size = silent_of(index, folder)
    add, remove = numbers(args.add), numbers(args.remove)
    chosen = None if args.set is None else numbers(args.set)
    if args.automatic:
        if chosen is not None:
            raise InputError("--automatic", "cannot go with --set", "give one of them")
        chosen = _found(index, folder)
    if chosen is not None and (add or remove):
        raise InputError("--set or --automatic", "cannot go with --add or --remove",
                         "give the whole list, or the changes")
    if chosen is None and not add and not remove:
        if args.out is not None:
            raise InputError("--out", "has nothing to write", "give --set, --add or --remove too")
        print(line(before, size))
        return 0
    after = edited(before, size, chosen=chosen, add=add, remove=remove)
    if args.out is not None:
        rewritten_copy(folder, args.out, after)
    elif folder.resolve() in {shipped.resolve() for shipped in NAMED.values()}:
        raise InputError(folder, "is shipped with the package and is not changed",
                         "add --out DIR for an edited copy, and use that")
    else:
        rewrite(folder, after)
    gone, come = sorted(set(before) - set(after)), sorted(set(after) - set(before))
    print(f"{line(after, size)} (new: {_listed(come)}; no longer: {_listed(gone)})")
    print(f"to train with these: gesticulator train ... --set 'silence.lexemes={list(after)}'")
    return 0


def _found(index: dict[str, Any], folder: Path) -> tuple[int, ...]:
    """The list detected by training."""
    return silent_of({**index, "silent_lexemes": index["provenance"].get(FOUND, index["silent_lexemes"])}, folder)[0]


def _listed(lexemes: Iterable[int]) -> str:
    return ",".join(map(str, lexemes)) or "none"


def line(silent: Sequence[int], size: int) -> str:
    """Such as "silent: 3,7,9 (3 of 100 lexemes)"."""
    return f"silent: {_listed(silent)} ({len(silent)} of {size} lexemes)"
