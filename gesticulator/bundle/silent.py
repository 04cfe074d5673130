"""`gesticulator bundle silent [BUNDLE]`: which lexemes count as stillness, seen and edited by hand (RG 6.4.1).

Training finds the silent lexemes by itself. A look at the lexicon (`gesticulator draw lexicon`) may say otherwise, and
then the list is changed here. `bundle.json` alone is rewritten; the weights and their hashes stay as they are. What
reads the list at inference follows at once: the choice in silent blocks, the resting lexeme, the blocks that the gate
closes. What was taught with the old list stays: the hint in the lexeme interpreter, and the gate.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from data_module.errors import InputError
from data_module.files import write_text

FOUND = "silent_lexemes_found"
"""In the provenance of a bundle that was edited: the list that training found."""


def numbers(text: str) -> tuple[int, ...]:
    """Lexeme numbers from "3, 7,9"; InputError for what is no number."""
    try:
        return tuple(int(part) for part in text.replace(",", " ").split())
    except ValueError:
        raise InputError(text, "is not a list of lexemes", "write numbers with commas, such as 3,7,9") from None


def edited(silent: Iterable[int], size: int, *, chosen: Iterable[int] | None = None, add: Iterable[int] = (),
           remove: Iterable[int] = ()) -> tuple[int, ...]:
    """The silent lexemes after an edit, in order: `chosen` instead of them, or with `add` and without `remove`.

    size: S. InputError for a number outside 0 to S - 1, for a set that is empty (silence would have no lexeme) and for
    one that holds the whole lexicon (speech would have none).
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
    """The silent lexemes of `bundle.json` and how many lexemes there are; InputError when they do not make sense."""
    try:
        size, silent = int(index["config"]["lexicon"]["size"]), tuple(index["silent_lexemes"])
        return edited(silent, size), size
    except (KeyError, TypeError, ValueError, InputError) as error:
        raise InputError(folder / "bundle.json", f"holds no usable list of silent lexemes ({error})",
                         "copy the bundle again, or write silent_lexemes by hand") from None


def rewrite(folder: Path, silent: Iterable[int]) -> None:
    """Put a new list into a bundle's `bundle.json`, whole or not at all; the list of training is kept beside it."""
    from gesticulator.bundle.files import read_index

    index = read_index(folder)
    index["provenance"].setdefault(FOUND, index["silent_lexemes"])
    index["silent_lexemes"] = list(silent)
    write_text(folder / "bundle.json", json.dumps(index, indent=1, sort_keys=True) + "\n")


def rewritten_copy(folder: Path, target: Path, silent: Iterable[int]) -> None:
    """A copy of a bundle with another list, whole or not at all; InputError when `target` is there already."""
    if target.exists():
        raise InputError(target, "exists", "choose another path for the copy")
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(dir=target.parent, prefix=f".{target.name}."))
    try:
        shutil.copytree(folder, temporary, dirs_exist_ok=True)
        rewrite(temporary, silent)
        temporary.chmod(0o755)  # mkdtemp keeps others out; a bundle is there to be shared
        temporary.rename(target)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise


def arguments(p: argparse.ArgumentParser) -> None:
    """What the command takes."""
    p.add_argument("bundle", nargs="?", metavar="BUNDLE", help="folder of the bundle (default: the shipped one)")
    p.add_argument("--set", metavar="3,7,9", help="use exactly these")
    p.add_argument("--automatic", action="store_true", help="restore those that training detected")
    p.add_argument("--add", metavar="3,7,9", default="", help="add these")
    p.add_argument("--remove", metavar="3,7,9", default="", help="remove these")
    p.add_argument("--out", type=Path, metavar="DIR", help="write an edited copy here instead of changing BUNDLE")


def run(asked: argparse.Namespace) -> int:
    """List or edit; InputError for what cannot be."""
    from gesticulator.bundle.bundle import SHIPPED
    from gesticulator.bundle.files import read_index

    folder = Path(asked.bundle) if asked.bundle else SHIPPED
    index = read_index(folder)
    before, size = silent_of(index, folder)
    add, remove = numbers(asked.add), numbers(asked.remove)
    chosen = None if asked.set is None else numbers(asked.set)
    if asked.automatic:
        if chosen is not None:
            raise InputError("--automatic", "cannot go with --set", "give one of them")
        chosen = _found(index, folder)
    if chosen is not None and (add or remove):
        raise InputError("--set or --automatic", "cannot go with --add or --remove",
                         "give the whole list, or the changes")
    if chosen is None and not add and not remove:
        if asked.out is not None:
            raise InputError("--out", "has nothing to write", "give --set, --add or --remove too")
        print(line(before, size))
        return 0
    after = edited(before, size, chosen=chosen, add=add, remove=remove)
    if asked.out is not None:
        rewritten_copy(folder, asked.out, after)
    elif folder.resolve() == SHIPPED.resolve():
        raise InputError(folder, "comes with the package and is left as it is",
                         "add --out DIR for an edited copy, and use that")
    else:
        rewrite(folder, after)
    gone, come = sorted(set(before) - set(after)), sorted(set(after) - set(before))
    print(f"{line(after, size)} (new: {_listed(come)}; no longer: {_listed(gone)})")
    print(f"taught anew with these: gesticulator train ... --set 'silence.lexemes={list(after)}'")
    return 0


def _found(index: dict[str, Any], folder: Path) -> tuple[int, ...]:
    """The list of training: the one beside the edited list, or the list itself where nothing was edited."""
    return silent_of({**index, "silent_lexemes": index["provenance"].get(FOUND, index["silent_lexemes"])}, folder)[0]


def _listed(lexemes: Iterable[int]) -> str:
    return ",".join(map(str, lexemes)) or "none"


def line(silent: Sequence[int], size: int) -> str:
    """Such as "silent: 3,7,9 (3 of 100 lexemes)"."""
    return f"silent: {_listed(silent)} ({len(silent)} of {size} lexemes)"
