"""`gesticulator bundle`: inspect a bundle, edit its silent lexemes."""

from __future__ import annotations

import argparse
from typing import Any

from gesticulator.bundle import silent
from gesticulator.cli import Command


def _arguments(p: argparse.ArgumentParser) -> None:
    verbs = p.add_subparsers(dest="what", required=True, metavar="inspect|silent")
    inspect = verbs.add_parser("inspect", help="show the content, sizes, hashes and training data of a bundle")
    inspect.add_argument("bundle", nargs="?", metavar="BUNDLE",
                         help="default, paper, or the folder of a bundle (default: default)")
    inspect.add_argument("--settings", action="store_true", help="also show every setting")
    silent.arguments(verbs.add_parser("silent", help="list or edit the silent lexemes (RG 6.4.1)"))


def _run(args: argparse.Namespace) -> int:
    if args.what == "silent":
        return silent.run(args)
    print(_inspected(args.bundle, args.settings))
    return 0


def _inspected(given: str | None, settings: bool) -> str:
    """The output of `bundle inspect`. Every part is opened, so a broken one is found here."""
    from data_module.layers import parameter_count
    from gesticulator.bundle.bundle import load
    from gesticulator.bundle.files import bundle_folder, read_index
    from gesticulator.bundle.models import part_table

    folder = bundle_folder(given)
    index, bundle = read_index(folder), load(folder)
    sizes = {name: parameter_count(bundle.parts[name]) for name in bundle.parts}
    lines = [f"{folder}: format {index['format']}, preset {bundle.config.name}, made by "
             + ", ".join(f"{name} {version}" for name, version in index.get("made_by", {}).items()),
             f"speakers: {', '.join(bundle.speakers)}; interpreters: {', '.join(bundle.interpreters)}",
             f"lexemes: {len(bundle.vectors)}; {silent.line(bundle.silent.tolist(), len(bundle.vectors))}",
             f"words: {bundle.text.encoder if bundle.text else 'not read'}", "", "trained on"]
    lines += [f"  {name}: {_short(value)}" for name, value in bundle.provenance.items()]
    lines += ["", f"{'file':<36}{'bytes':>12}{'weights':>12}  sha256"]
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


BUNDLE = Command(
    "inspect a bundle, or edit its silent lexemes", _arguments, _run,
    examples=("bundle inspect", "bundle inspect bundle --settings", "bundle silent bundle --set 3,7,9",
              "bundle silent --add 12 --out mine"))
