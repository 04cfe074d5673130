"""`gesticulator bundle inspect | card | push`."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from data_module.errors import InputError
from gesticulator.bundle.command import BUNDLE as INSPECT
from gesticulator.cli import Command

CARD_FILE = "README.md"


def _arguments(p: argparse.ArgumentParser) -> None:
    verbs = INSPECT.arguments(p)
    card = verbs.add_parser("card", help="write the page of a bundle on a hub, README.md with its front matter")
    card.add_argument("bundle", metavar="BUNDLE", help="default, paper, or the folder of a bundle")
    card.add_argument("-o", "--output", type=Path, metavar="FILE", help="where to (default: README.md in the folder)")
    card.set_defaults(run=_write_card)
    push = verbs.add_parser("push", help="upload a bundle to a hub, with its page, in one commit")
    push.add_argument("bundle", metavar="BUNDLE", help="default, paper, or the folder of a bundle")
    push.add_argument("repository", metavar="ORG/NAME", help="is made if there is none; HF_TOKEN must be set")
    push.add_argument("--revision", metavar="BRANCH", help="a branch, made if there is none (default: main)")
    push.add_argument("--private", action="store_true", help="make a repository that only its owners can read")
    push.set_defaults(run=_push)
    for parser in (card, push):
        parser.add_argument("--licence", default="other", metavar="ID", help="a licence that hubs know, such as "
                            "cc-by-4.0 (default: other; the page always names that of the training data)")


def card_text(folder: Path, repository: str, licence: str) -> str:
    """README.md of a bundle: front matter that hubs read, how to use it, and the model card."""
    from gesticulator.bundle.bundle import load
    from gesticulator.bundle.card import model_card

    bundle = load(folder)
    # Values of YAML in the notation of JSON, which quotes whatever needs it.
    front = {"library_name": "gesticulator", "license": licence,
             **({"license_name": "licence-of-the-training-data"} if licence == "other" else {}),
             "tags": ["co-speech-gesture", "motion-generation", "speech", "animation", bundle.config.name],
             **({"language": ["en"]} if bundle.text else {})}
    lines = "\n".join(f"{key}: {json.dumps(value, ensure_ascii=False)}" for key, value in front.items())
    return f"---\n{lines}\n---\n{model_card(bundle)}{_USE.replace('ORG/NAME', repository)}"


_USE = """
## Use
```sh
pip install "gesticulator[hub]"
gesticulator speech.wav --bundle ORG/NAME -o gesture.bvh
```
```python
from gesticulator import Gesticulator

Gesticulator.from_pretrained("ORG/NAME")("speech.wav").save("gesture.bvh")
```
"""


def _write_card(args: argparse.Namespace) -> int:
    from data_module.files import write_text
    from gesticulator.bundle.files import NAMED, bundle_folder

    if args.output is None and args.bundle in NAMED:
        raise InputError(args.bundle, "is part of the program", "name a file with -o")
    folder = bundle_folder(args.bundle)
    target = args.output or folder / CARD_FILE
    write_text(target, card_text(folder, f"org/{folder.resolve().name}", args.licence))
    print(target)
    return 0


def _push(args: argparse.Namespace) -> int:
    from gesticulator.bundle.files import bundle_folder
    from gesticulator_hub.download import REQUIREMENT, check_files
    from gesticulator_hub.upload import upload

    REQUIREMENT.check("bundle push")
    folder = bundle_folder(args.bundle)
    check_files(args.bundle, folder, "copy the bundle again")  # what is broken is not published
    address = upload(folder, args.repository, card_text(folder, args.repository, args.licence), args.revision or "main",
                     args.private)
    print(f"{args.repository}: {address}")
    return 0


BUNDLE = Command("show the content of a bundle, or publish it on a hub", _arguments, lambda args: args.run(args),
                 examples=("bundle inspect", "bundle card bundle", "bundle push bundle org/name --private"))
"""A bundle: the folder of weights, settings and statistics that inference needs."""
