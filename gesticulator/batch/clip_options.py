"""Options of clips for animation tools on the command line."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from data_module.errors import InputError
from gesticulator.export.clip import CLIPS, NAME, ClipLayout

TOGETHER = (".glb",)
"""Suffixes of formats that hold several clips."""


def clip_from_args(args: argparse.Namespace) -> ClipLayout:
    """The clip of the command line. `InputError` for options that exclude each other."""
    if args.layer == "additive" and args.loop is False and args.root == "none":
        raise InputError("--root", "has no effect on an additive clip", "leave it out: it moves the upper body alone")
    keys = ClipLayout().keys if args.keys is None else args.keys
    return ClipLayout(args.clip_name or NAME, keys, args.loop, args.mask == "upper", args.layer == "additive",
                args.root != "none", args.sound)


def check_clip_outputs(args: argparse.Namespace, suffixes: Sequence[str]) -> None:
    """`InputError` for clip options that none of the outputs can follow, and for --one-file without a format for it."""
    clip = clip_from_args(args)
    other = [suffix for suffix in suffixes if suffix not in CLIPS]
    if clip.additive and [suffix for suffix in other if suffix != ".json"]:
        raise InputError("--layer additive", f"makes no sense in {other[0]}", f"write {', '.join(CLIPS)}")
    if clip.sound and not set(suffixes) & set(CLIPS):
        raise InputError("--sound", "is for formats without sound of their own", f"write {', '.join(CLIPS)}")
    if not args.one_file:
        return
    bad = [suffix for suffix in suffixes if suffix not in TOGETHER]
    if bad:
        raise InputError("--one-file", f"is not for {bad[0]}", f"write {' or '.join(TOGETHER)}")
    for name in ("manifest", "shard", "ray", "clip_name", "sound", "plan"):
        if getattr(args, name):
            raise InputError("--one-file", f"does not go with --{name.replace('_', '-')}",
                             "leave one of them out; clips are named after their recordings")
