"""`gesticulator bundle inspect`: the content of a bundle."""

from __future__ import annotations

import argparse
import json

from gesticulator.cli import Command


def _arguments(p: argparse.ArgumentParser) -> argparse._SubParsersAction[argparse.ArgumentParser]:
    verbs = p.add_subparsers(required=True)
    inspect = verbs.add_parser("inspect", help="show the content, sizes and training data of a bundle")
    inspect.add_argument("bundle", nargs="?", metavar="BUNDLE",
                         help="default, paper, a folder, or ORG/NAME of a hub (default: default)")
    inspect.set_defaults(run=_run)
    return verbs


def _run(args: argparse.Namespace) -> int:
    from gesticulator.bundle.bundle import load
    from gesticulator.bundle.files import FORMAT, bundle_folder

    folder = bundle_folder(args.bundle)
    bundle = load(folder)
    print(f"{folder}: format {FORMAT}, preset {bundle.config.name}\n"
          f"speakers: {', '.join(bundle.speakers)}\n"
          f"interpreters: {', '.join(bundle.interpreters)}\n"
          f"lexemes: {len(bundle.vectors)}, silent: {', '.join(map(str, bundle.silent.tolist())) or 'none'}\n"
          f"words: {bundle.text.encoder if bundle.text else 'not read'}\n\nweights")
    # Every part is opened, which also checks its hash and its shapes.
    for name, part in bundle.parts.items():
        _ = bundle.runners[name]
        print(f"  {name:<20}{sum(tensor.size for tensor in part.read()[0].values()):>12,}")
    print("\ntrained on", *(f"  {name}: {json.dumps(value)}" for name, value in bundle.provenance.items()), sep="\n")
    print("\nfigures on the validation split")
    for stage, figures in bundle.figures.items():
        print(f"  {stage}: " + ", ".join(f"{name} {value:.4g}" for name, value in figures.items()))
    return 0


BUNDLE = Command("show the content of a bundle", _arguments, _run, examples=("bundle inspect", "bundle inspect paper"))
